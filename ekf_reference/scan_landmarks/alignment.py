"""Alignment of two sums of Gaussians by maximum correlation (Nieto 2005, eqs. 5.13 and 5.14)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ekf_reference.scan_landmarks.correlation import Look, Pairs
from ekf_reference.scan_landmarks.search import Lattice, starts
from ekf_reference.scan_landmarks.sog import SumOfGaussians, rotation

Array = NDArray[np.float64]

_COUNTERPART = 9.21
"""Squared Mahalanobis distance, 99 % of two degrees of freedom, of a Gaussian's counterpart."""
_STIFFEST = 1e-9
"""Least curvature over the greatest that a Newton step divides by."""
_SHORTEST_M = 0.1
"""Least lever of a sum that is all in one place."""
_COARSE = 0.03
"""A step so short, in inflations, ends a stage that another follows."""
_SLACK = 0.25
"""Pairs are looked up again after a motion by so many typical sigmas."""


@dataclass(frozen=True)
class AlignmentOptions:
    """How maxima are sought.

    inflation_m: sigmas by which all covariances are inflated, in stages; the last must be 0, the
    correlation itself. spacing_m: of the starts; the first inflation must bridge it. starts: most
    that are followed; finished: most that are followed to the end. neighbours: most Gaussians of
    the second sum that one of the first is paired with, neighbours_inflated: in stages that only
    prepare another; reach: within so many sigmas. iterations:
    most per stage. converged_m: a step so small, at the lever's end, is the last.
    """

    inflation_m: tuple[float, ...] = (0.6, 0.2, 0.0)
    spacing_m: float = 0.8
    starts: int = 4
    finished: int = 2
    neighbours: int = 32
    neighbours_inflated: int = 12
    reach: float = 3.5
    iterations: int = 30
    converged_m: float = 1e-6

    def __post_init__(self) -> None:
        """Check the stages."""
        if not self.inflation_m or self.inflation_m[-1] != 0.0:
            raise ValueError(f"inflations {self.inflation_m} m, expected the last to be 0")


@dataclass(frozen=True)
class Alignment:
    """Where the first sum lies in the second one's frame, with evidence.

    pose: (3,) x_M of Nieto 2005, eq. 5.14: x, y [m], heading [rad], the nearest to the guess's.
    log_likelihood: ln Lambda there, -inf where the two do not meet. correlation: Lambda over the
    geometric mean of what the first sum and those of the second that it meets have with
    themselves, 0 to 1. overlap: share of the first sum's weight that finds a counterpart.
    runner_up: Lambda of the second-best maximum found over that of the best; near 1 the result is
    a guess among two, and 0 says that there was no other within the prior. iterations: of all
    stages on the way to the result. converged: whether the last stage ended at a maximum.
    """

    pose: Array
    log_likelihood: float
    correlation: float
    overlap: float
    runner_up: float
    iterations: int
    converged: bool


@dataclass(frozen=True)
class Climb:
    """Where a climb ended. value: Lambda."""

    pose: Array
    value: float
    iterations: int
    converged: bool


@dataclass(frozen=True)
class Problem:
    """Two sums to align. first is about its centroid, so that turns and shifts are nearly apart.

    guess: (3,) and covariance: (3, 3) of the centred sum's pose. unit: (3,) in which the three
    directions weigh alike, metres at the lever's end.
    """

    first: SumOfGaussians
    second: SumOfGaussians
    centre: Array
    guess: Array
    covariance: Array
    unit: Array
    options: AlignmentOptions

    @classmethod
    def of(
        cls,
        first: SumOfGaussians,
        second: SumOfGaussians,
        guess: Array,
        covariance: Array,
        options: AlignmentOptions | None = None,
    ) -> Problem:
        """Raises ValueError for a guess (3,) or a covariance (3, 3) that cannot be used."""
        guess, covariance = np.asarray(guess, dtype=float), np.asarray(covariance, dtype=float)
        if guess.shape != (3,) or not np.isfinite(guess).all():
            raise ValueError(f"the guess is {guess}, expected three finite numbers")
        if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
            raise ValueError("the guess's covariance must be three by three, and finite")
        if np.linalg.eigvalsh(covariance)[0] < 0.0:
            raise ValueError("the guess's covariance has a negative eigenvalue")
        centre = first.centroid
        jacobian = carried(guess, centre)
        return cls(
            SumOfGaussians(first.mean - centre, first.covariance, first.weight, first.seam),
            second,
            centre,
            moved(guess, centre),
            jacobian @ covariance @ jacobian.T,
            np.array((1.0, 1.0, 1.0 / max(first.lever_m, _SHORTEST_M))),
            options or AlignmentOptions(),
        )

    @property
    def covariance_scaled(self) -> Array:
        """(3, 3) the guess's, in units."""
        return self.covariance / np.outer(self.unit, self.unit)

    def pairs(self, pose: Array, inflation_m: float = 0.0) -> Pairs:
        """Neighbours at a pose (3,)."""
        o = self.options
        most = o.neighbours_inflated if inflation_m > 0.0 else o.neighbours
        slack = self.slack_m(inflation_m)
        far = o.reach * math.sqrt(
            self.first.typical_variance + self.second.typical_variance + inflation_m**2
        )
        return Pairs.near(
            self.first, self.second, pose, Look(most, far, o.reach, inflation_m, slack)
        )

    def slack_m(self, inflation_m: float = 0.0) -> float:
        """How far, at the lever's end, pairs may move before they are looked up again."""
        return _SLACK * math.sqrt(self.first.typical_variance + inflation_m**2)

    def each(self, pose: Array) -> Array:
        """(N,) what each of the first sum adds to Lambda at a pose (3,)."""
        pairs = self.pairs(pose)
        return np.bincount(pairs.row, pairs.terms(pose), minlength=len(self.first))


def moved(pose: Array, shift: Array) -> Array:
    """(3,) the pose of a point (2,) of a body at a pose (3,), heading as the body's."""
    return np.append(pose[:2] + rotation(float(pose[2])) @ shift, pose[2])


def carried(pose: Array, shift: Array) -> Array:
    """(3, 3) derivative of `moved` by the pose."""
    jacobian = np.eye(3)
    x, y = rotation(float(pose[2])) @ shift
    jacobian[:2, 2] = -y, x
    return jacobian


def align(
    first: SumOfGaussians,
    second: SumOfGaussians,
    guess: Array,
    covariance: Array,
    options: AlignmentOptions | None = None,
) -> Alignment:
    """The pose of the first sum in the second's frame that has the highest correlation.

    guess: (3,) x, y [m], heading [rad]. covariance: (3, 3) of its error: starts are spread over
    it, so a wide one costs time, and a narrow one keeps other maxima out. It is no evidence and
    does not pull. A sum without Gaussians meets nothing. Raises ValueError for a guess or a
    covariance that cannot be used.
    """
    return aligned(Problem.of(first, second, guess, covariance, options))


def aligned(problem: Problem) -> Alignment:
    """The same for a problem that is put."""
    if not len(problem.first) or not len(problem.second):
        return _apart(problem)
    o = problem.options
    coarse = [_thinned(problem, s) for s in o.inflation_m]
    lattice = Lattice.over(
        problem.guess, problem.covariance, o.spacing_m, problem.first.lever_m
    )
    begin = starts(coarse[0].first, coarse[0].second, lattice, o.inflation_m[0], o.starts)
    ends = [climb(coarse[0], pose, o.inflation_m[0]) for pose in begin]
    ends = _distinct(problem, ends, o.inflation_m[0])[: o.finished]
    finished = []
    for end in ends:
        steps = end.iterations
        for stage, inflation_m in zip(coarse[1:], o.inflation_m[1:], strict=True):
            end = climb(stage, end.pose, inflation_m)
            steps += end.iterations
        finished.append(Climb(end.pose, end.value, steps, end.converged))
    finished = _distinct(problem, finished, o.spacing_m)
    if not finished:
        return _apart(problem)
    best = finished[0]
    runner_up = finished[1].value / best.value if len(finished) > 1 else 0.0
    inside = within_seams(problem, best.pose)
    if len(inside.first):
        again = climb(inside, best.pose, 0.0)
        best = replace(again, iterations=best.iterations + again.iterations)
    return evidence(problem, best, runner_up)


def within_seams(problem: Problem, pose: Array) -> Problem:
    """Without those of the first sum that lie on a seam of the second, or beyond, at a pose (3,).

    What a view loses moves with the sensor. Two views of one wall overlap most where both sensors
    were at the same place along it; with all ends of the first view inside of the second, or
    gone, the correlation stays as it is when one is moved along the other. (Turk and Levoy 1994
    leave out such pairs of meshes.)
    """
    inside = on_no_seam(problem, pose)
    return problem if inside.all() else replace(problem, first=problem.first.take(inside))


def on_no_seam(
    problem: Problem, pose: Array, across_sigmas: float = math.inf
) -> NDArray[np.bool_]:
    """(N,) which of the first sum lie nearest to something of the second that is on no seam.

    Or are farther off the surface at the seam than so many sigmas: they have left it by
    its side, not by its end.
    """
    second = problem.second
    if not second.seam.any():
        return np.ones(len(problem.first), dtype=bool)
    place = problem.first.mean @ rotation(float(pose[2])).T + pose[:2]
    near = second.tree.query(place)[1]
    inside: NDArray[np.bool_] = ~second.seam[near]
    lost = np.flatnonzero(~inside)
    if math.isfinite(across_sigmas) and len(lost):
        size, axes = np.linalg.eigh(second.covariance[near[lost]])
        apart = second.mean[near[lost]] - place[lost]
        across = np.square(np.einsum("ni,ni->n", apart, axes[:, :, 0]))
        inside[lost] = across > across_sigmas**2 * size[:, 0]
    return inside


def climb(
    problem: Problem,
    start: Array,
    inflation_m: float,
    held: Array | None = None,
    iterations: int | None = None,
) -> Climb:
    """The maximum of Lambda uphill of a pose (3,), by Newton's method in a trust region.

    held: (3, k) orthonormal directions, scaled, along which the pose stays. iterations:
    fewer than the options'.

    Where the exact Hessian of ln Lambda bends the wrong way its eigenvalues change sign, so that
    every step is uphill. In scaled units the step's length is within the region.
    """
    o, unit = problem.options, problem.unit
    close = max(o.converged_m, _COARSE * inflation_m)
    slack = problem.slack_m(inflation_m)
    pose, radius, taken = start, slack / _SLACK, 0
    pairs = problem.pairs(pose, inflation_m)
    looked = pose
    here = pairs.derivatives(pose)
    while taken < (iterations or o.iterations) and here.value > 0.0:
        taken += 1
        slope = here.gradient / here.value * unit
        bend = np.outer(unit, unit) * here.hessian / here.value - np.outer(slope, slope)
        step = _newton(slope, bend, radius)
        if held is not None:
            step -= held @ (held.T @ step)
        length = float(np.linalg.norm(step))
        if length < close:
            return Climb(pose, here.value, taken, converged=True)
        tried = pairs.derivatives(pose + unit * step)
        expected = float(slope @ step + 0.5 * step @ bend @ step)
        gained = math.log(tried.value / here.value) if tried.value > 0.0 else -math.inf
        if gained < 0.25 * expected:
            radius = 0.25 * length
        elif length > 0.9 * radius and gained > 0.5 * expected:
            radius *= 2.0
        if gained <= 0.0:
            if length < 100.0 * close:
                return Climb(pose, here.value, taken, converged=True)
            continue
        pose, here = pose + unit * step, tried
        if np.abs((pose - looked) / unit).max() > slack:
            pairs, looked = problem.pairs(pose, inflation_m), pose
            here = pairs.derivatives(pose)
    return Climb(pose, here.value, taken, converged=False)


def evidence(problem: Problem, best: Climb, runner_up: float) -> Alignment:
    """What is said of a maximum."""
    pairs = problem.pairs(best.pose)
    value = pairs.value(best.pose)
    if not value > 0.0:
        return _apart(problem)
    laid = problem.first.transformed(best.pose)
    distance, column = problem.second.tree.query(laid.mean)
    apart = problem.second.mean[column] - laid.mean
    spread = laid.covariance + problem.second.covariance[column]
    square = np.einsum("ni,ni->n", apart, np.linalg.solve(spread, apart[:, :, None])[:, :, 0])
    overlap = float(problem.first.weight[square < _COUNTERPART].sum())
    met = np.unique(pairs.column)
    own = _self_correlation(problem, problem.first)
    its = _self_correlation(problem, problem.second.take(met))
    share = float(problem.second.weight[met].sum())
    return Alignment(
        pose=moved(best.pose, -problem.centre),
        log_likelihood=math.log(value),
        correlation=min(value / (share * math.sqrt(own * its)), 1.0),
        overlap=overlap,
        runner_up=runner_up,
        iterations=best.iterations,
        converged=best.converged,
    )


def _apart(problem: Problem) -> Alignment:
    pose = moved(problem.guess, -problem.centre)
    return Alignment(pose, -math.inf, 0.0, 0.0, 0.0, 0, converged=False)


def _newton(slope: Array, bend: Array, radius: float) -> Array:
    size, axes = np.linalg.eigh(bend)
    size = np.maximum(np.abs(size), _STIFFEST * np.abs(size).max(initial=1e-300))
    step: Array = axes @ ((axes.T @ slope) / size)
    length = float(np.linalg.norm(step))
    return step * (radius / length) if length > radius else step


def _thinned(problem: Problem, inflation_m: float) -> Problem:
    if not inflation_m > 0.0:
        return problem
    first, second = (s.thinned(inflation_m) for s in (problem.first, problem.second))
    return replace(problem, first=first, second=second)


def _distinct(problem: Problem, ends: list[Climb], apart_m: float) -> list[Climb]:
    """Best first, without those within a distance of a better one, and without empty ones."""
    kept: list[Climb] = []
    for end in sorted(ends, key=lambda e: -e.value):
        far = (np.linalg.norm((end.pose - k.pose) / problem.unit) > apart_m for k in kept)
        if end.value > 0.0 and all(far):
            kept.append(end)
    return kept


def _self_correlation(problem: Problem, one: SumOfGaussians) -> float:
    still = np.zeros(3)
    o = problem.options
    look = Look(o.neighbours, o.reach * math.sqrt(2.0 * one.typical_variance), o.reach)
    return Pairs.near(one, one, still, look).value(still)
