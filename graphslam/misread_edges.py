"""Edges of a pose graph that fit when they are read otherwise.

A graph whose chi-square is far outside its band was often written by a program that means other
numbers: covariances or square roots where informations belong, or closures in the other direction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import gammainc, gammaincc

from graphslam.arrays import Array
from graphslam.graph_builder import build_graph
from graphslam.optimisers import optimise, polish
from graphslam.optimum import ChiSquareTest, chi_square_test
from graphslam.problem import SlamProblem
from graphslam.search import relaxed_values

EXTREME = 1e-20
"""A chi-square as far out by chance is no matter of noise that is somewhat larger or smaller."""


class EdgeReading(NamedTuple):
    """words: which edges are read how, after "fit". chi_square: of the optimum found so."""

    words: str
    chi_square: ChiSquareTest


def misread_edges(problem: SlamProblem, test: ChiSquareTest) -> EdgeReading | None:
    """Return the first other reading of the edges between poses whose chi-square is plausible.

    Args:
        problem: A graph with closures.
        test: Of its optimum.

    Returns:
        None where the chi-square at hand needs no other reading, or none fits.
    """
    if not len(problem.loop_closures.first) or test.dof <= 0:
        return None
    if min(tail(0.5 * test.dof, 0.5 * test.chi2) for tail in (gammainc, gammaincc)) > EXTREME:
        return None
    for words, other in _readings(problem):
        graph = build_graph(other)
        try:
            end = optimise(graph, relaxed_values(other))[0]
            error = polish(graph, end)[1]
        except RuntimeError:
            continue
        found = chi_square_test(error, test.dof)
        if found.reading == "plausible":
            return EdgeReading(words, found)
    return None


def _readings(problem: SlamProblem) -> Iterator[tuple[str, SlamProblem]]:
    """Other meanings of the edges, and the problem that has them."""
    closed = problem.loop_closures
    steps, loops = (
        np.median(np.einsum("nii->ni", np.linalg.inv(one)), axis=0)
        for one in (problem.increment_covariance[problem.steps], closed.covariance)
    )
    swapped = replace(closed, first=closed.second, second=closed.first)
    yield "the loop closures fit when inverted", replace(problem, loop_closures=swapped)
    for how, covariance in (("the covariance", _inverse), ("a square root of it", _squared)):
        odometry = replace(problem, increment_covariance=covariance(problem.increment_covariance))
        closures = replace(closed, covariance=covariance(closed.covariance))
        for what, size, other in (
            ("all edges between poses fit", "", replace(odometry, loop_closures=closures)),
            ("the odometry's edges fit", _size(steps / loops, "loop closures'"), odometry),
            (
                "the loop closures fit",
                _size(loops / steps, "odometry's"),
                replace(problem, loop_closures=closures),
            ),
        ):
            yield f"{what} when what stands for their information{size} is {how}", other


def _size(ratio: Array, other: str) -> str:
    """How large informations (3,) are beside those of other edges, as they were read."""
    return f" ({ratio.min():.2g} to {ratio.max():.2g} times the {other})"


def _inverse(covariance: Array) -> Array:
    """(N, n, n) the informations that were read; NaN where nothing was."""
    return np.asarray(np.linalg.inv(covariance))


def _squared(covariance: Array) -> Array:
    """(N, n, n) covariances where the upper triangles that were read are roots of informations."""
    root = np.linalg.inv(np.triu(np.linalg.inv(covariance)))
    squared: Array = root @ root.transpose(0, 2, 1)
    return squared
