"""Alignment of two sums of Gaussians by maximum correlation (Nieto 2005, eqs. 5.13 and 5.14)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.scan_matching.problem import (
    SLACK,
    AlignmentOptions,
    Problem,
    moved,
    within_boundaries,
)
from ekf_reference.scan_matching.search import Lattice, starts
from ekf_reference.scan_matching.sog import SumOfGaussians

_COUNTERPART = 9.21
"""Squared Mahalanobis distance, 99 % of two degrees of freedom, of a Gaussian's counterpart."""
_STIFFEST = 1e-9
"""Least curvature over the greatest that a Newton step divides by."""
_COARSE = 0.03
"""A step so short, in inflations, ends a stage that another follows."""


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """Where the first sum lies in the second one's frame, with evidence.

    pose: (3,) x_M of Nieto 2005, eq. 5.14: x, y [m], heading [rad], the nearest to the guess's.
    overlap: share of the first sum's weight that finds a counterpart. runner_up: Lambda of the
    second-best maximum found over that of the best; near 1 the pose is ambiguous, at 0 there was no
    other maximum within the prior. converged: whether the last stage ended at a maximum.
    """

    pose: Array
    overlap: float = 0.0
    runner_up: float = 0.0
    converged: bool = False


@dataclass(frozen=True)
class Ascent:
    """Where a trust-region ascent ended. value: Lambda."""

    pose: Array
    value: float
    converged: bool


def align(
    first: SumOfGaussians,
    second: SumOfGaussians,
    guess: Array,
    covariance: Array,
    options: AlignmentOptions | None = None,
) -> Alignment:
    """The pose of the first sum in the second's frame that has the highest correlation.

    guess: (3,) x, y [m], heading [rad]. covariance: (3, 3) of its error, over which starts are
    spread; it does not pull the result. Raises ValueError for a guess or covariance that is not
    finite, has another shape, or a negative eigenvalue.
    """
    return aligned(Problem.of(first, second, guess, covariance, options))


def aligned(problem: Problem) -> Alignment:
    """The same for a problem that is put."""
    if not len(problem.first) or not len(problem.second):
        return _apart(problem)
    o = problem.options
    coarse = [_thinned(problem, s) for s in o.inflation_m]
    lattice = Lattice.over(problem.guess, problem.covariance, o.spacing_m, problem.first.lever_m)
    begin = starts(coarse[0].first, coarse[0].second, lattice, o.inflation_m[0], o.starts)
    ends = [ascend(coarse[0], pose, o.inflation_m[0]) for pose in begin]
    ends = _distinct(problem, ends, o.inflation_m[0])[: o.finished]
    for stage, inflation_m in zip(coarse[1:], o.inflation_m[1:], strict=True):
        ends = [ascend(stage, end.pose, inflation_m) for end in ends]
    finished = _distinct(problem, ends, o.spacing_m)
    if not finished:
        return _apart(problem)
    best = finished[0]
    runner_up = finished[1].value / best.value if len(finished) > 1 else 0.0
    inside = within_boundaries(problem, best.pose)
    if len(inside.first):
        best = ascend(inside, best.pose, 0.0)
    return evidence(problem, best, runner_up)


def ascend(
    problem: Problem,
    start: Array,
    inflation_m: float,
    held: Array | None = None,
    iterations: int | None = None,
) -> Ascent:
    """The maximum of Lambda uphill of a pose (3,), by Newton's method in a trust region.

    held: (3, k) orthonormal directions, scaled, along which the pose stays. iterations:
    fewer than the options'.

    Where the exact Hessian of ln Lambda bends the wrong way its eigenvalues change sign, so that
    every step is uphill. In scaled units the step's length is within the region.
    """
    o, unit = problem.options, problem.unit
    units = np.outer(unit, unit)
    close = max(o.converged_m, _COARSE * inflation_m)
    slack = problem.slack_m(inflation_m)
    pose, radius, taken = start, slack / SLACK, 0
    pairs = problem.pairs(pose, inflation_m)
    looked = pose
    here = pairs.derivatives(pose)
    while taken < (iterations or o.iterations) and here.value > 0.0:
        taken += 1
        slope = here.gradient / here.value * unit
        bend = units * here.hessian / here.value - slope[:, None] * slope
        step = _newton(slope, bend, radius)
        if held is not None:
            step -= held @ (held.T @ step)
        length = float(np.linalg.norm(step))
        if length < close:
            return Ascent(pose, here.value, converged=True)
        tried = pairs.derivatives(pose + unit * step)
        expected = float(slope @ step + 0.5 * step @ bend @ step)
        gained = math.log(tried.value / here.value) if tried.value > 0.0 else -math.inf
        if gained < 0.25 * expected:
            radius = 0.25 * length
        elif length > 0.9 * radius and gained > 0.5 * expected:
            radius *= 2.0
        if gained <= 0.0:
            if length < 100.0 * close:
                return Ascent(pose, here.value, converged=True)
            continue
        pose, here = pose + unit * step, tried
        if np.abs((pose - looked) / unit).max() > slack:
            pairs, looked = problem.pairs(pose, inflation_m), pose
            here = pairs.derivatives(pose)
    return Ascent(pose, here.value, converged=False)


def evidence(problem: Problem, best: Ascent, runner_up: float) -> Alignment:
    """What is said of a maximum."""
    if not problem.pairs(best.pose).value(best.pose) > 0.0:
        return _apart(problem)
    laid = problem.first.transformed(best.pose)
    column = problem.second.tree.query(laid.mean)[1]
    apart = problem.second.mean[column] - laid.mean
    spread = laid.covariance + problem.second.covariance[column]
    square = np.einsum("ni,ni->n", apart, np.linalg.solve(spread, apart[:, :, None])[:, :, 0])
    overlap = float(problem.first.weight[square < _COUNTERPART].sum())
    return Alignment(
        pose=moved(best.pose, -problem.centre),
        overlap=overlap,
        runner_up=runner_up,
        converged=best.converged,
    )


def _apart(problem: Problem) -> Alignment:
    """Two sums that do not meet: the guess."""
    return Alignment(pose=moved(problem.guess, -problem.centre))


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


def _distinct(problem: Problem, ends: list[Ascent], apart_m: float) -> list[Ascent]:
    """Best first, without those within a distance of a better one, and without empty ones."""
    kept: list[Ascent] = []
    for end in sorted(ends, key=lambda e: -e.value):
        far = (np.linalg.norm((end.pose - k.pose) / problem.unit) > apart_m for k in kept)
        if end.value > 0.0 and all(far):
            kept.append(end)
    return kept
