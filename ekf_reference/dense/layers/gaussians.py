"""A sum of Gaussians over the places that returns come from (Nieto 2005, section 4.3)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.layers.association import associate, doubled
from ekf_reference.dense.layers.layer import Hits, in_world
from ekf_reference.dense.layers.points import PointLayer
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan
from ekf_reference.dense.triangles import determinant, solve, turned

_NEGLIGIBLE = 1e-3
"""Sums of Gaussians below which nothing is known about a place."""
_SURE = 1.0 - 1e-12
_REACH = math.sqrt(-2.0 * math.log(_NEGLIGIBLE))
"""So many sigmas away a Gaussian is negligible."""


class Ellipses(NamedTuple):
    """Gaussians in the world. mean: (N, 2) [m]. covariance: (N, 2, 2) [m^2]. region: (N,)."""

    mean: Array
    covariance: Array
    region: Index


class Gaussians(PointLayer):
    """Means and covariances that are local, so they move, turn and shear with the landmarks.

    d_min_m: old Gaussians with an observed one closer than that are fused with the nearest; others
    observed are added. thinned: old ones on each other become one, else their number grows without
    end, as in the thesis' maps, which are not subsampled. widest: k of Nieto 2005, eq. 4.18:
    sigmas add up until their sum passes k d_min. There "the Gaussian variance" is compared to a
    length; it is the largest standard deviation here. 4.17 to 4.20 are no Bayesian update, and free
    space takes no Gaussian away.
    """

    def __init__(self, d_min_m: float = 0.2, widest: float = 0.8, *, thinned: bool = True) -> None:
        """Raises ValueError for bounds that are not above zero."""
        if not widest > 0.0:
            raise ValueError(f"k is {widest}, it must be above zero")
        super().__init__(5, d_min_m)
        self.widest, self.thinned = widest, thinned

    def fuse(self, hits: Hits, placed: RegionsAtMap, scan: Scan | None, near: Index) -> None:
        """Widen and shift old Gaussians by the nearest returns, then add the other returns."""
        old, where = self._placed(placed, np.union1d(near, hits.region))
        pair = associate(where, hits.point, self._reach_m)
        region = old.region[pair.old]
        value = old.value[pair.old]
        value[:, :2] += solve(placed.triangle[region], hits.point[pair.new])
        value[:, :2] *= 0.5  # 4.17
        prior = in_world_axes(placed, region, value[:, 2:])
        observed = hits.covariance[pair.new]
        total = largest_sigma(prior) + largest_sigma(observed)
        grow = np.flatnonzero(total <= self.widest * self._reach_m)  # 4.18
        value[grow, 2:] += in_local_axes(placed, region[grow], observed[grow])  # 4.19, else 4.20
        old.value[pair.old] = value
        self._store.put(old)
        if self.thinned:
            kept = np.ones(len(where), dtype=bool)
            kept[doubled(pair, self._reach_m, -pair.apart_m)] = False
            self._store.keep(old, kept)
        add = np.flatnonzero(~pair.met)
        spread = in_local_axes(placed, hits.region[add], hits.covariance[add])
        self._store.append(hits.region[add], np.hstack((hits.local[add], spread)))

    def ellipses(self, placed: RegionsAtMap, regions: Index | None = None) -> Ellipses:
        """All Gaussians, or those in distinct regions (r,), as the landmarks lie now."""
        region, value = self._store.gather(regions)
        return Ellipses(
            in_world(placed, region, value[:, :2]),
            in_world_axes(placed, region, value[:, 2:]),
            region,
        )

    def occupancy(self, point: Array, placed: RegionsAtMap) -> Array:
        """1 - prod(1 - g) over the Gaussians g, peaks one, in the regions that points are in.

        The sum of 4.14 that stays below one, as if each Gaussian were by itself the chance that
        a place is occupied (Nieto 2005, section 4.3.2, Fig. 4.12 b). NaN where it is negligible,
        and outside all regions.
        """
        found = placed.locate(point).region
        inside = np.flatnonzero(found >= 0)
        known = self.ellipses(placed, np.unique(found[inside]))
        none = np.zeros(len(point))
        if len(known.region) and len(inside):
            reach = _REACH * largest_sigma(known.covariance)
            near = cKDTree(point[inside]).query_ball_point(known.mean, reach)
            row = inside[np.concatenate([np.asarray(n, dtype=np.intp) for n in near])]
            which = np.repeat(np.arange(len(near)), [len(n) for n in near])
            apart = point[row] - known.mean[which]
            inverse = np.linalg.inv(known.covariance)[which]
            square = np.einsum("ni,nij,nj->n", apart, inverse, apart)
            np.add.at(none, row, np.log1p(-np.minimum(np.exp(-0.5 * square), _SURE)))
        height = -np.expm1(none)
        return np.where(height >= _NEGLIGIBLE, height, np.nan)


def in_world_axes(placed: RegionsAtMap, region: Index, local: Array) -> Array:
    """Covariances (N, 2, 2) [m^2] of local ones (N, 3), their aa, ab and bb, in regions (N,)."""
    _, a, b = placed.frames
    return _through(a[region], b[region], local)


def in_local_axes(placed: RegionsAtMap, region: Index, world: Array) -> Array:
    """The inverse: (N, 3) of covariances (N, 2, 2) [m^2]. No region may be degenerate.

    The Jacobian by the point alone (Nieto 2005, eqs. C.11 and C.12): the landmarks' own
    uncertainty is the filter's.
    """
    _, a, b = placed.frames
    delta = determinant(placed.triangle[region])[:, None]
    alpha, beta = turned(b[region]) / delta, -turned(a[region]) / delta
    entries = np.stack((world[:, 0, 0], world[:, 0, 1], world[:, 1, 1]), axis=1)
    columns = np.stack((alpha[:, 0], beta[:, 0]), axis=1), np.stack((alpha[:, 1], beta[:, 1]), 1)
    local = _through(*columns, entries)
    return np.stack((local[:, 0, 0], local[:, 0, 1], local[:, 1, 1]), axis=1)


def largest_sigma(covariance: Array) -> Array:
    """Largest standard deviation (N,) of covariances (N, 2, 2), in any direction."""
    mean = 0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1])
    half = 0.5 * (covariance[:, 0, 0] - covariance[:, 1, 1])
    return np.sqrt(np.maximum(mean + np.hypot(half, covariance[:, 0, 1]), 0.0))


def _through(first: Array, second: Array, entries: Array) -> Array:
    """J P J^T (N, 2, 2) of J with columns first and second (N, 2), P by its entries (N, 3)."""
    aa, ab, bb = entries.T
    by_first = aa[:, None] * first + ab[:, None] * second
    by_second = ab[:, None] * first + bb[:, None] * second
    world: Array = by_first[:, :, None] * first[:, None] + by_second[:, :, None] * second[:, None]
    return world
