"""Covariance of an alignment, from the shape of the correlation (Nieto 2005, section 5.4).

Eqs. 5.16 and 5.17 fit a Gaussian to Lambda about its maximum. Its covariance, C, is about as wide
as that of one pair of Gaussians, however many there are: it is not that of the maximum's error.
That is the sandwich of an M-estimator,

    P = C J C,    J = covariance of the gradient of ln Lambda,

with J from the independent gradients that each return of both scans adds. R is P, C if asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Mask
from ekf_reference.scan_matching.alignment import COARSE, Alignment, Ascents, aligned, ascend
from ekf_reference.scan_matching.correlation import Pairs
from ekf_reference.scan_matching.problem import (
    AlignmentOptions,
    Problem,
    carried,
    moved,
    on_no_boundary,
)
from ekf_reference.scan_matching.sog import SumOfGaussians

Form = Literal["sandwich", "curvature"]
_GOLDEN = 0.5 * (1.0 + math.sqrt(5.0))
_DIRECTIONS = np.array(
    [
        corner
        for a in (-1.0, 1.0)
        for b in (-_GOLDEN, _GOLDEN)
        for corner in ((0.0, a, b), (a, b, 0.0), (b, 0.0, a))
    ]
) / math.hypot(1.0, _GOLDEN)
"""(12, 3) corners of an icosahedron: samples on all sides that fix six unknowns equally well."""
LEAST_SAMPLES = 6
"""Unknowns of eq. 5.17."""
_ROWS, _COLUMNS = np.triu_indices(3)
_TWICE = np.where(_ROWS == _COLUMNS, 1.0, 2.0)
_ASIDE = 7.0
"""Sigmas off a surface beyond which something has left it by its side."""
_EDGE_SLACK = 1.0
"""Of pairs at edges, in typical sigmas (see `ascend`): they only tell whether Lambda has fallen."""
_RIPPLE = 0.5
"""Share of what a return adds that noise alone may take from it."""
_NOTHING = 1e-100
"""Lambda over its maximum below which it is no smaller."""
_LEAST = 0.1
"""Least variance of a fixed direction, over what it were with all returns independent."""


@dataclass(frozen=True, kw_only=True)
class CovarianceOptions:
    """When a direction counts as fixed by a maximum, and how it is sampled.

    sample_sigmas: how far off the maximum Lambda is sampled, in sigmas of its own curvature.
    neighbourhood_m: least distance, at the lever's end, within which Lambda has to fall along a
    fixed direction; a wider prior adds to it. fallen: least -2 ln of Lambda over its maximum on
    both edges of the neighbourhood. beyond_chance: least fall in standard deviations of the ripples
    that noise makes on a wall. sharp: curvature by squared neighbourhood beyond which edges are not
    tested. open_sigmas: sigma of a direction that is not fixed, over the neighbourhood. form: of R
    along fixed directions, the sandwich P = C J C or the correlation's own curvature, P = C.
    NEES of the sandwich per degree of freedom is 0.9 with 2 cm of range noise, 1.0 to 1.1 with
    10 cm and 1 degree.
    """

    sample_sigmas: float = 0.5
    neighbourhood_m: float = 0.5
    fallen: float = 0.1
    beyond_chance: float = 4.0
    sharp: float = 100.0
    open_sigmas: float = 10.0
    form: Form = "sandwich"


@dataclass(frozen=True, kw_only=True)
class ScanAlignment:
    """A measurement of an alignment: z and R of Nieto 2005, section 5.2.1, and the evidence.

    pose: (3,) z; where the shape does not fix a direction it is as guessed along it. covariance:
    (3, 3) R, of the error added to x, y and heading, positive definite. curvature: (3, 3) P^-1 of
    eqs. 5.16 and 5.17, of -2 ln Lambda by x, y, heading. open_directions: how many of the three
    the shape does not fix. alignment: the maximum itself. by_second: (3, N) one standard deviation
    of the error that each return of the second sum causes. first_share: of R, what the noise of the
    first sum causes.
    """

    pose: Array
    covariance: Array
    curvature: Array
    open_directions: int
    alignment: Alignment
    by_second: Array
    first_share: float


def scan_align(
    first: SumOfGaussians,
    second: SumOfGaussians,
    guess: Array,
    covariance: Array,
    options: AlignmentOptions | None = None,
    belief: CovarianceOptions | None = None,
) -> ScanAlignment:
    """Align two sums, with covariance: x_M and P_M of Nieto 2005, section 5.4.

    guess: (3,) x_0, the first sum's pose in the second's frame; covariance: (3, 3) of its error.
    Where the two do not meet the guess comes back with all directions open. Raises ValueError as
    `align` does.
    """
    problem = Problem.of(first, second, guess, covariance, options)
    belief = belief or CovarianceOptions()
    found = aligned(problem)
    unit = problem.unit
    about = problem.covariance_scaled + belief.neighbourhood_m**2 * np.eye(3)
    peak = moved(found.pose, problem.centre)
    shape = _Shape.at(problem, peak, about, belief)
    split = _Split.of(problem, shape, about, belief)
    if split.loose.shape[1] in (1, 2):
        # What lies across moves a little when the pose goes back along what is not fixed.
        back = _guessed(problem, peak, split.loose)[None]
        back = ascend(problem, back, 0.0, on_no_boundary(problem, back), split.loose[None]).pose
        shape = _Shape.at(problem, back[0], about, belief)
        split = _Split.of(problem, shape, about, belief, split)
    loose = split.loose
    peak = _guessed(problem, shape.peak, loose)
    # From the centred sum's pose to that of its frame.
    jacobian = carried(peak, -problem.centre)
    inverse, scale = np.linalg.inv(jacobian), np.outer(unit, unit)
    error = _error(shape, split, problem, about, belief)
    spread = jacobian @ (error.covariance * scale) @ jacobian.T
    return ScanAlignment(
        pose=moved(peak, -problem.centre),
        covariance=0.5 * (spread + spread.T),
        curvature=inverse.T @ (shape.curvature / scale) @ inverse,
        open_directions=loose.shape[1],
        alignment=found,
        by_second=jacobian @ (unit[:, None] * error.by_second),
        first_share=error.first_share,
    )


@dataclass(frozen=True)
class _Shape:
    """Lambda about a pose (3,). counted: (N,) which of the first sum are on no boundary there.

    pairs: of those. curvature: (3, 3) scaled; zeros where they meet nothing.
    """

    peak: Array
    counted: Mask
    pairs: Pairs | None
    curvature: Array

    @classmethod
    def at(cls, problem: Problem, peak: Array, about: Array, belief: CovarianceOptions) -> _Shape:
        counted = on_no_boundary(problem, peak[None])[0]
        pairs = None
        if counted.any() and len(problem.second):
            pairs = problem.pairs(peak, 0.0, counted)
        if pairs is None or not pairs.value(peak) > 0.0:
            return cls(peak, counted, None, np.zeros((3, 3)))
        curvature = fitted_curvature(pairs, peak, problem.unit, about, belief.sample_sigmas)
        return cls(peak, counted, pairs, curvature)


@dataclass(frozen=True)
class _Split:
    """Directions, scaled: fixed (3, k) and loose (3, 3 - k).

    bent: (3, 3) covariance of how far the loose ones leave straight lines.
    """

    fixed: Array
    loose: Array
    bent: Array

    @classmethod
    def of(
        cls,
        problem: Problem,
        shape: _Shape,
        about: Array,
        belief: CovarianceOptions,
        known: _Split | None = None,
    ) -> _Split:
        """Those are fixed along which Lambda falls on both edges of the neighbourhood.

        known: whose loose directions stay loose.
        """
        known = known or cls(np.eye(3), np.zeros((3, 0)), np.zeros((3, 3)))
        if shape.pairs is None:
            return cls(np.zeros((3, 0)), np.eye(3), known.bent)
        size, own = np.linalg.eigh(known.fixed.T @ shape.curvature @ known.fixed)
        axes = known.fixed @ own
        near = _along(about, axes)
        met = size * near > belief.sharp
        asked = np.flatnonzero(~met)
        if not len(asked):
            return cls(axes, known.loose, known.bent)
        way = (np.sqrt(near[asked]) * axes[:, asked]).T
        edge, falls = _edges(problem, shape, np.concatenate((-way, way)), belief)
        met[asked] = (size[asked] > 0.0) & falls.reshape(2, -1).all(axis=0)
        low, high = ((edge - shape.peak) / problem.unit).reshape(2, -1, 3)[:, ~met[asked]]
        bow = 0.5 * (high + low)
        # The valley's own direction: the curvature's axis is not as exact.
        order = np.concatenate((known.loose, (high - low).T, axes[:, met]), axis=1)
        turned, count = np.linalg.qr(order)[0], 3 - int(met.sum())
        return cls(turned[:, count:], turned[:, :count], known.bent + bow.T @ bow)


def _guessed(problem: Problem, pose: Array, loose: Array) -> Array:
    """(3,) a pose (3,), as guessed along directions (3, k), scaled."""
    apart = (pose - problem.guess) / problem.unit
    return np.asarray(pose - problem.unit * (loose @ (loose.T @ apart)))


class _Error(NamedTuple):
    """Of a maximum, scaled: covariance (3, 3); see ScanAlignment of by_second and first_share."""

    covariance: Array
    by_second: Array
    first_share: float


def _error(
    shape: _Shape, split: _Split, problem: Problem, about: Array, belief: CovarianceOptions
) -> _Error:
    """Wide along what is loose, that of the maximum's error along what is fixed."""
    fixed, loose = split.fixed, split.loose
    wide = (loose * _along(about, loose)) @ loose.T * belief.open_sigmas**2
    if shape.pairs is None or not fixed.shape[1]:
        return _Error(wide, np.zeros((3, len(problem.second))), 0.0)
    flattest = belief.fallen / _along(about, fixed).max()
    if belief.form == "curvature":
        known = _fitted(shape, fixed, flattest)
    else:
        known = _sandwich(shape.pairs, shape, problem.unit, fixed, flattest)
    by_second = np.zeros((3, len(problem.second)))
    by_second[:, : known.by_second.shape[1]] = known.by_second
    bent = fixed @ (fixed.T @ split.bent @ fixed) @ fixed.T
    return _Error(wide + known.covariance + bent, by_second, known.first_share)


def _along(covariance: Array, axes: Array) -> Array:
    """(k,) variances along axes (3, k)."""
    variance: Array = np.einsum("ik,ij,jk->k", axes, covariance, axes)
    return variance


def _edges(
    problem: Problem, shape: _Shape, way: Array, belief: CovarianceOptions
) -> tuple[Array, Mask]:
    """(K, 3) the best poses beside the ends of ways (K, 3), scaled; (K,) where Lambda has fallen.

    A curved valley may be farther away than the exact correlation feels it, so that the blurred one
    goes first. Where that has fallen by more than chance could ever do, no closer look is needed.
    """
    edge, falls = shape.peak + problem.unit * way, np.zeros(len(way), dtype=bool)
    held = (way / np.linalg.norm(way, axis=1, keepdims=True))[:, :, None]
    close_m = COARSE * problem.size_m()
    for inflation_m in problem.options.inflation_m[-2:]:
        rest = np.flatnonzero(~falls)
        if len(rest):
            counted = on_no_boundary(problem, edge[rest])
            end = ascend(
                problem, edge[rest], inflation_m, counted, held[rest], close_m, slack=_EDGE_SLACK
            )
            edge[rest], falls[rest] = end.pose, _falls(problem, shape, end, inflation_m, belief)
    return edge, falls


def _falls(
    problem: Problem, shape: _Shape, edge: Ascents, inflation_m: float, belief: CovarianceOptions
) -> Mask:
    """(K,) whether Lambda falls from its maximum to K edges, by more than chance.

    Only what is on no boundary at either pose counts.
    """
    both = shape.counted & on_no_boundary(problem, edge.pose, _ASIDE)
    blurred = inflation_m > 0.0
    pairs = problem.pairs(shape.peak, inflation_m, shape.counted) if blurred else shape.pairs
    if pairs is None:
        return np.zeros(len(both), dtype=bool)
    here = both * problem.each(pairs, shape.peak[None])
    there = both * problem.each(edge.pairs, edge.pose)
    lost, before = here - there, here.sum(axis=1)
    left = there.sum(axis=1) / np.where(before > 0.0, before, 1.0)
    ripple = _RIPPLE * here
    if not blurred:
        ripple = np.minimum(np.abs(lost), ripple)
    chance = belief.beyond_chance * np.linalg.norm(ripple, axis=1)
    falls = -2.0 * np.log(np.maximum(left, _NOTHING)) >= belief.fallen
    return np.asarray(falls & (lost.sum(axis=1) >= chance) & (before > 0.0))


def fitted_curvature(
    pairs: Pairs, peak: Array, unit: Array, about: Array, sample_sigmas: float
) -> Array:
    """(3, 3) P^-1 of Nieto 2005, eq. 5.16, by scaled x, y, heading, from samples by SVD (5.17).

    unit: (3,) of the scales. about: (3, 3) scaled covariance of the neighbourhood, which no sample
    leaves by more than a sigma. The samples lie on an ellipsoid of the exact curvature's axes.
    """
    at = pairs.derivatives(peak)
    bend = -at.of_logarithm(unit)[1]
    size, axes = np.linalg.eigh(bend)
    near = np.sqrt(np.einsum("ik,ij,jk->k", axes, about, axes))
    reach = np.minimum(sample_sigmas / np.sqrt(np.maximum(size, 1e-12)), near)
    sample = _DIRECTIONS * reach
    value = np.array([pairs.value(peak + unit * (axes @ one)) for one in sample])
    form = quadratic_form(sample, -2.0 * np.log(np.maximum(value / at.value, _NOTHING)))
    fitted: Array = axes @ form @ axes.T
    return fitted


def quadratic_form(apart: Array, drop: Array) -> Array:
    """(3, 3) symmetric M that fits x^T M x = c to offsets x (N, 3) and c (N,) best; eq. 5.17.

    Least squares by singular values, N at least 6. Raises ValueError for fewer.
    """
    if len(apart) < LEAST_SAMPLES:
        raise ValueError(f"{len(apart)} samples, expected at least {LEAST_SAMPLES}")
    scale = np.abs(apart).max(axis=0)
    x = apart / scale
    design = _TWICE * x[:, _ROWS] * x[:, _COLUMNS]
    entries = np.linalg.lstsq(design, drop, rcond=None)[0]
    form = np.empty((3, 3))
    form[_ROWS, _COLUMNS] = form[_COLUMNS, _ROWS] = entries
    return form / np.outer(scale, scale)


def _fitted(shape: _Shape, axes: Array, flattest: float) -> _Error:
    """P of eq. 5.16 on axes (3, k), no curvature below a least; no part of it is of one return."""
    size, own = np.linalg.eigh(axes.T @ shape.curvature @ axes)
    root = axes @ own / np.sqrt(np.maximum(size, flattest))
    return _Error(root @ root.T, np.zeros((3, 0)), 0.0)


def _sandwich(pairs: Pairs, shape: _Shape, unit: Array, axes: Array, flattest: float) -> _Error:
    """C J C on axes (3, k); positive definite there, no curvature below a least."""
    peak = shape.peak
    scale = unit[:, None] / pairs.value(peak)
    score, twice = scale * pairs.scores(peak), scale * pairs.scores_across(peak)
    of_first = np.stack([np.bincount(pairs.row, one) for one in score])
    of_second = np.stack([np.bincount(pairs.column, one) for one in score])
    # A pair's own share is in the gradient of both of its returns.
    spread = of_first @ of_first.T + of_second @ of_second.T - twice @ twice.T
    size, own = np.linalg.eigh(axes.T @ shape.curvature @ axes)
    root = axes @ own / np.sqrt(np.maximum(size, flattest))
    first, second = (root.T @ one for one in (of_first, of_second))
    share, turn = np.linalg.eigh(root.T @ spread @ root)
    share = np.maximum(share, _LEAST / len(np.unique(pairs.row)))
    half = root @ turn
    of_both = np.square(first).sum() + np.square(second).sum()
    return _Error((half * share) @ half.T, root @ second, float(np.square(first).sum() / of_both))
