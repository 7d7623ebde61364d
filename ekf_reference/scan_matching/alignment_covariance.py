"""Covariance of an alignment, from the shape of the correlation (Nieto 2005, section 5.4).

Eqs. 5.16 and 5.17 fit a Gaussian to Lambda about its maximum. Its covariance, C, is about as wide
as that of one pair of Gaussians, however many there are: it is not that of the maximum's error.
That is the sandwich of an M-estimator,

    P = C J C,    J = covariance of the gradient of ln Lambda,

with J from the independent gradients that each return of both scans adds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Mask
from ekf_reference.scan_matching.alignment import Alignment, aligned, ascend
from ekf_reference.scan_matching.correlation import Pairs
from ekf_reference.scan_matching.problem import (
    AlignmentOptions,
    Problem,
    carried,
    moved,
    on_no_boundary,
    within_boundaries,
)
from ekf_reference.scan_matching.sog import SumOfGaussians

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
    tested. open_sigmas: sigma of a direction that is not fixed, over the neighbourhood.
    NEES per degree of freedom is 0.9 with 2 cm of range noise, 1.0 to 1.1 with 10 cm and 1 degree.
    """

    sample_sigmas: float = 0.5
    neighbourhood_m: float = 0.5
    fallen: float = 0.1
    beyond_chance: float = 4.0
    sharp: float = 100.0
    open_sigmas: float = 10.0


@dataclass(frozen=True)
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
    if len(shape.loose.T) and len(shape.fixed.T):
        # What lies across moves a little when the pose goes back along what is not fixed.
        peak = peak - unit * (shape.loose @ (shape.loose.T @ ((peak - problem.guess) / unit)))
        peak = ascend(within_boundaries(problem, peak), peak, 0.0, held=shape.loose).pose
        shape = _Shape.at(problem, peak, about, belief)
    peak = peak - unit * (shape.loose @ (shape.loose.T @ ((peak - problem.guess) / unit)))
    # From the centred sum's pose to that of its frame.
    jacobian = carried(peak, -problem.centre)
    inverse, scale = np.linalg.inv(jacobian), np.outer(unit, unit)
    spread = jacobian @ (shape.covariance * scale) @ jacobian.T
    return ScanAlignment(
        pose=moved(peak, -problem.centre),
        covariance=0.5 * (spread + spread.T),
        curvature=inverse.T @ (shape.curvature / scale) @ inverse,
        open_directions=shape.loose.shape[1],
        alignment=found,
        by_second=jacobian @ (unit[:, None] * shape.by_second),
        first_share=shape.first_share,
    )


@dataclass(frozen=True)
class _Shape:
    """What the correlation fixes at a pose, scaled.

    curvature: (3, 3). fixed: (3, k) and loose: (3, 3 - k) directions. covariance: (3, 3).
    by_second, first_share: see ScanAlignment.
    """

    curvature: Array
    fixed: Array
    loose: Array
    covariance: Array
    by_second: Array
    first_share: float

    @classmethod
    def at(cls, problem: Problem, peak: Array, about: Array, belief: CovarianceOptions) -> _Shape:
        unit, axes, size, curvature = problem.unit, np.eye(3), np.zeros(3), np.zeros((3, 3))
        off_boundaries = on_no_boundary(problem, peak)
        inside = problem.taking(off_boundaries)
        pairs = inside.pairs(peak) if len(inside.first) and len(problem.second) else None
        if pairs is not None and pairs.value(peak) > 0.0:
            curvature = fitted_curvature(pairs, peak, unit, about, belief.sample_sigmas)
            size, axes = np.linalg.eigh(curvature)
        near = _along(about, axes)
        met = size * near > belief.sharp
        valley, bent = axes.copy(), np.zeros((3, 3))
        for k in np.flatnonzero(~met).tolist() if curvature.any() else ():
            way = math.sqrt(near[k]) * axes[:, k]
            edges = [_edge(problem, peak, side * way) for side in (-1.0, 1.0)]
            met[k] = size[k] > 0.0 and all(
                _falls(problem, peak, edge, belief, off_boundaries) for edge in edges
            )
            if not met[k]:
                low, high = ((edge - peak) / unit for edge in edges)
                valley[:, k] = high - low
                bow = 0.5 * (high + low)
                bent += bow[:, None] * bow
        # The valley's own direction: the curvature's axis is not as exact.
        order = np.concatenate((valley[:, ~met], axes[:, met]), axis=1)
        axes = np.linalg.qr(order)[0]
        count = int(np.count_nonzero(~met))
        loose, fixed = axes[:, :count], axes[:, count:]
        covariance = (loose * _along(about, loose)) @ loose.T * belief.open_sigmas**2
        by_second, first_share = np.zeros((3, len(problem.second))), 0.0
        if pairs is not None and met.any():
            flattest = belief.fallen / _along(about, fixed).max()
            error = _sandwich(pairs, peak, unit, curvature, fixed, flattest)
            covariance += error.covariance + fixed @ (fixed.T @ bent @ fixed) @ fixed.T
            by_second[:, : error.by_second.shape[1]] = error.by_second
            first_share = error.first_share
        return cls(curvature, fixed, loose, covariance, by_second, first_share)


def _along(covariance: Array, axes: Array) -> Array:
    """(k,) variances along axes (3, k)."""
    variance: Array = np.einsum("ik,ij,jk->k", axes, covariance, axes)
    return variance


def _edge(problem: Problem, peak: Array, way: Array) -> Array:
    """(3,) the best pose beside the end of a way (3,), scaled."""
    pose = peak + problem.unit * way
    held = (way / np.linalg.norm(way))[:, None]
    # A curved valley may be farther away than the exact correlation feels it.
    for inflation_m in problem.options.inflation_m[-2:]:
        pose = ascend(within_boundaries(problem, pose), pose, inflation_m, held, iterations=8).pose
    return pose


def _falls(
    problem: Problem, peak: Array, edge: Array, belief: CovarianceOptions, off_boundaries: Mask
) -> bool:
    """Whether Lambda falls from its maximum to an edge (3,), by more than chance.

    Only what is on no boundary at either pose counts (off_boundaries: at the maximum).
    """
    both = off_boundaries & on_no_boundary(problem, edge, _ASIDE)
    if not both.any():
        return False
    common = problem.taking(both)
    here, there = (common.each(pose) for pose in (peak, edge))
    lost = here - there
    fall = -2.0 * math.log(max(there.sum() / here.sum(), _NOTHING)) if here.sum() > 0.0 else 0.0
    chance = belief.beyond_chance * float(np.linalg.norm(np.minimum(np.abs(lost), _RIPPLE * here)))
    return fall >= belief.fallen and float(lost.sum()) >= chance


def fitted_curvature(
    pairs: Pairs, peak: Array, unit: Array, about: Array, sample_sigmas: float
) -> Array:
    """(3, 3) P^-1 of Nieto 2005, eq. 5.16, by scaled x, y, heading, from samples by SVD (5.17).

    unit: (3,) of the scales. about: (3, 3) scaled covariance of the neighbourhood, which no sample
    leaves by more than a sigma. The samples lie on an ellipsoid of the exact curvature's axes.
    """
    at = pairs.derivatives(peak)
    slope = unit * at.gradient / at.value
    bend = np.outer(slope, slope) - np.outer(unit, unit) * at.hessian / at.value
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


class _Error(NamedTuple):
    """Of a maximum, scaled: covariance (3, 3); see ScanAlignment of by_second and first_share."""

    covariance: Array
    by_second: Array
    first_share: float


def _sandwich(
    pairs: Pairs, peak: Array, unit: Array, curvature: Array, axes: Array, flattest: float
) -> _Error:
    """C J C on axes (3, k); positive definite there, no curvature below a least."""
    scale = unit[:, None] / pairs.value(peak)
    score, twice = scale * pairs.scores(peak), scale * pairs.scores_across(peak)
    of_first = np.stack([np.bincount(pairs.row, one) for one in score])
    of_second = np.stack([np.bincount(pairs.column, one) for one in score])
    # A pair's own share is in the gradient of both of its returns.
    spread = of_first @ of_first.T + of_second @ of_second.T - twice @ twice.T
    size, own = np.linalg.eigh(axes.T @ curvature @ axes)
    root = axes @ own / np.sqrt(np.maximum(size, flattest))
    first, second = (root.T @ one for one in (of_first, of_second))
    share, turn = np.linalg.eigh(root.T @ spread @ root)
    share = np.maximum(share, _LEAST / len(np.unique(pairs.row)))
    half = root @ turn
    of_both = np.square(first).sum() + np.square(second).sum()
    return _Error((half * share) @ half.T, root @ second, float(np.square(first).sum() / of_both))
