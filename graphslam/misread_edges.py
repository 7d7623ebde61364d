"""Edges of a pose graph that fit when they are read otherwise.

A graph whose chi-square is far outside its band was often written by a program that means other
numbers: covariances or square roots where informations belong, closures in the other direction, or
closures of a sensor's frame beside odometry of the vehicle's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from graphslam.arrays import Array
from graphslam.extreme_edges import READINGS, extreme_edges, meant
from graphslam.goodness_of_fit import Goodness, far_less
from graphslam.graph_builder import build_graph
from graphslam.increments import dead_reckoned
from graphslam.optimisers import levenberg_marquardt, optimise, polish
from graphslam.optimum import ChiSquareTest, chi_square_test
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.search import relaxed_values
from graphslam.sensor_frame import in_words, mount

_NEAR = 0.1
"""A frame that the odometry tells leaves at most so much of the chi-square, before it is fitted."""
_HOPELESS = {0: np.inf, 1: 1e3, 10: 2.0}
"""After so many iterations more a reading is given up that is so many times above the band."""


class EdgeReading(NamedTuple):
    """words: which edges are read how, after "fit". chi_square: of the optimum found so."""

    words: str
    chi_square: ChiSquareTest


def misread_edges(
    problem: SlamProblem, test: ChiSquareTest, *, verified: bool = False
) -> EdgeReading | None:
    """Return the first other reading of the edges between poses whose chi-square is plausible.

    Closures may be inverted where informations are too small to tell: that they are is told by an
    optimum that is lower than chance makes it, whatever its chi-square.

    Args:
        problem: A graph with closures.
        test: Of its optimum.
        verified: Whether nothing speaks against that optimum but, perhaps, its chi-square.

    Returns:
        None where the chi-square at hand needs no other reading, or none fits.
    """
    if not len(problem.loop_closures.first) or test.dof <= 0:
        return None
    if verified and not test.extreme:
        return None
    found = _fitted(_inverted(problem), (0.0, min(test.chi2, test.upper)), test)
    if found is not None and far_less(found, test):
        return EdgeReading("the loop closures fit when inverted", found)
    for words, other in _readings(problem, test) if test.extreme else ():
        found = _fitted(other, (test.lower, test.upper), test)
        if found is not None:
            return EdgeReading(words, found)
    return None


def few_misread(problem: SlamProblem) -> EdgeReading | None:
    """Return the reading of the few edges of extreme information by which a graph fits.

    Args:
        problem: A graph.

    Returns:
        None where there are no such edges, or no reading makes them like the others and the graph
        fit.
    """
    closed, steps = problem.loop_closures, problem.steps
    covariance = np.concatenate((problem.increment_covariance[steps], closed.covariance))
    test = chi_square_test(np.inf, problem.residual_dimension - problem.state_dimension)
    extreme = extreme_edges(covariance)
    for how, other in meant(covariance, extreme) if len(extreme.rows) else ():
        moved = problem.increment_covariance.copy()
        moved[steps] = other[: len(steps)]
        closures = replace(closed, covariance=other[len(steps) :])
        read = replace(problem, increment_covariance=moved, loop_closures=closures)
        found = _fitted(read, (test.lower, test.upper), test)
        if found is not None:
            return EdgeReading(f"they fit when what stands there is {how}", found)
    return None


def _fitted(
    problem: SlamProblem, band: tuple[float, float], test: ChiSquareTest
) -> ChiSquareTest | None:
    """Return the test of an optimum that fits, None where there is none.

    Its chi-square lies in a band, and so do its residuals by kind of edge and along the graph; in a
    band that is wider than the test's below, none is larger than stated.
    """
    goodness = _solved(problem, band)
    if goodness is None or not (goodness.within if band[0] < test.lower else goodness.sound):
        return None
    return replace(test, chi2=goodness.test.chi2)


def _solved(problem: SlamProblem, band: tuple[float, float]) -> Goodness | None:
    """Return an optimum whose chi-square is in a band, None where there is none.

    The descent ends as soon as it is below the band, or far above it after some iterations.
    """
    graph, (lower, upper) = build_graph(problem), band
    try:
        values = relaxed_values(problem)
        for iterations, factor in _HOPELESS.items():
            values = levenberg_marquardt(graph, values, 1e-2, iterations)[0]
            if not lower <= 2.0 * graph.error(values) <= factor * upper:
                return None
        values = polish(graph, optimise(graph, values)[0])[0]
    except RuntimeError:
        return None
    goodness = Goodness(problem, graph, values)
    return goodness if lower <= goodness.test.chi2 <= upper else None


def _optimum(problem: SlamProblem) -> float:
    """Return the error at an optimum. Raises RuntimeError where there is none."""
    graph = build_graph(problem)
    return polish(graph, optimise(graph, relaxed_values(problem))[0])[1]


def _readings(problem: SlamProblem, test: ChiSquareTest) -> Iterator[tuple[str, SlamProblem]]:
    """Other meanings of the edges, and the problem that has them."""
    closed = problem.loop_closures
    sizes = [
        np.median(np.einsum("nii->ni", np.linalg.inv(one)), axis=0)
        for one in (problem.increment_covariance[problem.steps], closed.covariance)
        if len(one)
    ]
    for how, covariance in READINGS:
        odometry = replace(problem, increment_covariance=covariance(problem.increment_covariance))
        closures = replace(closed, covariance=covariance(closed.covariance))
        stated = "what stands for their information"
        every = replace(odometry, loop_closures=closures)
        yield f"all edges between poses fit when {stated} is {how}", every
        if not len(problem.steps):
            continue
        steps, loops = sizes
        size = _size(steps / loops, "loop closures'")
        yield f"the odometry's edges fit when {stated}{size} is {how}", odometry
        size = _size(loops / steps, "odometry's")
        fitting = replace(problem, loop_closures=closures)
        yield f"the loop closures fit when {stated}{size} is {how}", fitting
    yield from _of_another_frame(problem, test)


def _inverted(problem: SlamProblem) -> SlamProblem:
    closed = problem.loop_closures
    return replace(problem, loop_closures=replace(closed, first=closed.second, second=closed.first))


def _of_another_frame(
    problem: SlamProblem, test: ChiSquareTest
) -> Iterator[tuple[str, SlamProblem]]:
    """Closures of a sensor that stands elsewhere on the vehicle, which the odometry alone tells."""
    if len(problem.steps) < len(problem.increment):
        return
    closed, moved_on = problem.loop_closures, dead_reckoned(problem.prior_pose, problem.increment)

    def moved(frame: Array) -> SlamProblem:
        return replace(problem, loop_closures=_in_vehicle(closed, frame))

    def error(frame: Array) -> float:
        return _optimum(moved(frame))

    frame = mount(closed.first, closed.second, closed.motion, moved_on)
    if _solved(moved(frame), (0.0, _NEAR * test.chi2)) is None:
        return
    from scipy.optimize import minimize  # takes long to load, and is rarely needed

    try:
        frame = minimize(error, frame, method="BFGS", options={"gtol": 0.01}).x
    except RuntimeError:
        return
    yield (
        (
            f"the loop closures fit as motions of a frame {in_words(*frame[:2])} and turned by "
            f"{np.degrees(frame[2]):.1f} degrees"
        ),
        moved(frame),
    )


def _in_vehicle(closed: LoopClosures, frame: Array) -> LoopClosures:
    """Return motions of a frame as those of the vehicle; covariances by its adjoint."""
    heading, place, turn = closed.motion[:, 2], complex(*frame[:2]), np.exp(1j * frame[2])
    moved = turn * (closed.motion[:, :2] @ (1.0, 1.0j)) + (1.0 - np.exp(1j * heading)) * place
    adjoint = np.array(
        (
            (turn.real, -turn.imag, place.imag),
            (turn.imag, turn.real, -place.real),
            (0.0, 0.0, 1.0),
        )
    )
    return replace(
        closed,
        motion=np.column_stack((moved.real, moved.imag, heading)),
        covariance=adjoint @ closed.covariance @ adjoint.T,
    )


def _size(ratio: Array, other: str) -> str:
    """How large informations (3,) are beside those of other edges, as they were read."""
    return f" ({ratio.min():.2g} to {ratio.max():.2g} times the {other})"
