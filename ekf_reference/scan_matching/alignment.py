"""Alignment of two sums of Gaussians by maximum correlation (Nieto 2005, eqs. 5.13 and 5.14)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.scan_matching.correlation import Pairs
from ekf_reference.scan_matching.problem import (
    SLACK,
    AlignmentOptions,
    Problem,
    moved,
    on_no_boundary,
)
from ekf_reference.scan_matching.search import Lattice, starts
from ekf_reference.scan_matching.sog import SumOfGaussians

_COUNTERPART = 9.21
"""Squared Mahalanobis distance, 99 % of two degrees of freedom, of a Gaussian's counterpart."""
_STIFFEST = 1e-9
"""Least curvature over the greatest that a Newton step divides by."""
_NOTHING = 1e-300
"""Least Lambda that has a logarithm."""
_BRIDGED = 1.25
"""Typical sigmas within which a start finds its maximum."""
_FRESH = 0.025
"""Typical sigmas from where its pairs were looked up within which an exact maximum may lie."""
_ANEW = 5
"""Most times that they are looked up for that: along an open direction it may never end."""
COARSE = 0.1
"""A step so short, in typical sigmas, ends an ascent that need not be exact."""


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
class Ascents:
    """Where trust-region ascents ended.

    pose: (K, 3). value: (K,) Lambda. converged: (K,). pairs: that counted.
    """

    pose: Array
    value: Array
    converged: Mask
    pairs: Pairs

    def distinct(self, unit: Array, apart_m: float) -> Index:
        """Rows, best first, without those within a distance of a better one or empty ones."""
        kept: list[int] = []
        for row in np.argsort(-self.value, kind="stable").tolist():
            apart = (self.pose[kept] - self.pose[row]) / unit
            if self.value[row] > 0.0 and (np.linalg.norm(apart, axis=1) > apart_m).all():
                kept.append(row)
        return np.array(kept, dtype=np.intp)


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
    lattice = Lattice.over(problem.guess, problem.covariance, o.spacing_m, problem.first.lever_m)
    stages = _stages(problem, lattice)
    blurred = _thinned(problem, stages[0])
    pose = starts(blurred.first, blurred.second, lattice, stages[0], o.starts)
    for inflation_m in stages[:-1]:
        ends = ascend(_thinned(problem, inflation_m), pose, inflation_m)
        pose = ends.pose[ends.distinct(problem.unit, stages[0])[: o.finished]]
    # A lone maximum only shows what is on a boundary; several are compared.
    close_m = COARSE * problem.size_m() if len(pose) == 1 else None
    ends = ascend(problem, pose, 0.0, close_m=close_m)
    rows = ends.distinct(problem.unit, o.spacing_m)
    runner_up = float(ends.value[rows[1]] / ends.value[rows[0]]) if len(rows) > 1 else 0.0
    pose = ends.pose[rows]
    if not len(pose):
        return _apart(problem)
    return evidence(problem, ascend(problem, pose[:1], 0.0, _inside(problem, pose[:1])), runner_up)


def ascend(
    problem: Problem,
    start: Array,
    inflation_m: float,
    counted: Mask | None = None,
    held: Array | None = None,
    close_m: float | None = None,
    slack: float = SLACK,
) -> Ascents:
    """The maxima of Lambda uphill of poses (K, 3), all at once, by trust-region Newton.

    counted: (K, N) which of the first sum. held: (K, 3, k) orthonormal directions, scaled, along
    which a pose stays. close_m: a step so short, at the lever's end, is the last; by default the
    options'. slack: pairs are looked up again after a motion by so many typical sigmas.

    Where the exact Hessian of ln Lambda bends the wrong way its eigenvalues change sign, so that
    every step is uphill. In scaled units the step's length is within the region. A step that is
    short enough to be the last is taken unseen.
    """
    o, unit, pose = problem.options, problem.unit, start
    size = problem.size_m(inflation_m)
    close = close_m or (COARSE * size if inflation_m > 0.0 else o.converged_m)
    # Which pairs count at an exact maximum must not depend on the way there.
    fresh = math.inf if close_m or inflation_m > 0.0 else _FRESH * size
    pairs, looked = problem.pairs(pose, inflation_m, counted), pose
    here, radius = pairs.derivatives(pose), np.full(len(pose), size)
    converged, ended = np.zeros(len(pose), dtype=bool), ~(here.value > 0.0)
    anew, length = _ANEW, np.full(len(pose), np.inf)
    for _ in range(o.iterations):
        slope, bend = here.of_logarithm(unit)
        if held is not None:
            slope, bend = _across(slope, bend, held)
        step = _newton(slope, bend, radius)
        step[ended] = 0.0
        length = np.linalg.norm(step, axis=1)
        last = ~ended & (length < close)
        off = np.abs((pose - looked) / unit).max(axis=1)
        if anew and (off[last] > fresh).any():
            anew -= 1
            pairs, looked = problem.pairs(pose, inflation_m, counted), pose
            here = pairs.derivatives(pose)
            continue
        converged |= last
        ended |= last
        there = pose + unit * step
        pose = np.where(last[:, None], there, pose)
        if ended.all():
            break
        tried = pairs.derivatives(there)
        expected = ((slope + 0.5 * (bend @ step[:, :, None])[:, :, 0]) * step).sum(axis=1)
        gained = np.log(np.maximum(tried.value, _NOTHING) / np.maximum(here.value, _NOTHING))
        further = (length > 0.9 * radius) & (gained > 0.5 * expected)
        radius = np.where(gained < 0.25 * expected, 0.25 * length, radius * (1.0 + further))
        better = (gained > 0.0) | last
        stuck = ~ended & ~better & (length < 100.0 * close)
        converged |= stuck
        ended |= stuck
        pose = np.where(better[:, None], there, pose)
        here = here.replaced(better, tried)
        if (np.abs((pose - looked) / unit) > slack * size).any():
            pairs, looked = problem.pairs(pose, inflation_m, counted), pose
            here = pairs.derivatives(pose)
    # Out of iterations, so near to the end that no decision is another.
    converged |= ~ended & (length < 100.0 * close)
    return Ascents(pose, here.value, converged, pairs)


def evidence(problem: Problem, best: Ascents, runner_up: float) -> Alignment:
    """What is said of one maximum."""
    pose = best.pose[0]
    if not best.value[0] > 0.0:
        return _apart(problem)
    laid = problem.first.transformed(pose)
    column = problem.second.tree.query(laid.mean)[1]
    apart = problem.second.mean[column] - laid.mean
    spread = laid.covariance + problem.second.covariance[column]
    square = np.einsum("ni,ni->n", apart, np.linalg.solve(spread, apart[:, :, None])[:, :, 0])
    overlap = float(problem.first.weight[square < _COUNTERPART].sum())
    return Alignment(
        pose=moved(pose, -problem.centre),
        overlap=overlap,
        runner_up=runner_up,
        converged=bool(best.converged[0]),
    )


def _apart(problem: Problem) -> Alignment:
    """Two sums that do not meet: the guess."""
    return Alignment(pose=moved(problem.guess, -problem.centre))


def _stages(problem: Problem, lattice: Lattice) -> tuple[float, ...]:
    """The inflations of the options from the first that is needed.

    From a single start a later one may bridge the prior on its own.
    """
    stages = problem.options.inflation_m
    while (
        len(lattice.pose) == 1
        and len(stages) > 2
        and lattice.reach_m < _BRIDGED * problem.size_m(stages[1])
    ):
        stages = stages[1:]
    return stages


def _inside(problem: Problem, pose: Array) -> Mask | None:
    """(1, N) which of the first sum are on no boundary of the second; all where there are none."""
    inside = on_no_boundary(problem, pose)
    return inside if inside.any() else None


def _across(slope: Array, bend: Array, held: Array) -> tuple[Array, Array]:
    """Slopes (K, 3) and Hessians (K, 3, 3) of steps with no part along directions (K, 3, k).

    An unconstrained step without that part need not lead uphill.
    """
    along = held @ held.transpose(0, 2, 1)
    free = np.eye(3) - along
    stiff = np.abs(bend).max(axis=(1, 2), keepdims=True)
    return (free @ slope[:, :, None])[:, :, 0], free @ bend @ free - stiff * along


def _newton(slope: Array, bend: Array, radius: Array) -> Array:
    """(K, 3) steps of no more than radii (K,)."""
    size, axes = np.linalg.eigh(bend)
    size = np.abs(size)
    size = np.maximum(size, _STIFFEST * size.max(axis=1, initial=1e-300, keepdims=True))
    step = (axes @ ((slope[:, None] @ axes)[:, 0] / size)[:, :, None])[:, :, 0]
    length = np.linalg.norm(step, axis=1)
    shorter: Array = step * np.minimum(1.0, radius / np.maximum(length, radius))[:, None]
    return shorter


def _thinned(problem: Problem, inflation_m: float) -> Problem:
    if not inflation_m > 0.0:
        return problem
    first, second = (s.thinned(inflation_m) for s in (problem.first, problem.second))
    return replace(problem, first=first, second=second)
