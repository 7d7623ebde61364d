"""The surface around a place in a cloud, as planar motion meets it: a line in the ground plan."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from graphslam.arrays import Array

_FLAT = 6.0
"""A neighbourhood is a surface when it is this much thinner across than along, in variance."""


class Patches(NamedTuple):
    """N neighbourhoods in the ground plan. centre: (N, 2). normal: (N, 2) unit. flat, filled: (N,).

    flat: the neighbourhood is a surface with that normal; filled: it has points enough to have a
    centre.
    """

    centre: Array
    normal: Array
    flat: NDArray[np.bool_]
    filled: NDArray[np.bool_]


class SurfaceMap:
    """A cloud, searchable for the surface near a place.

    Neighbours are near in space, so that what stands at different heights stays apart; their
    scatter is taken in the ground plan, where a wall is a line even if one ring of a scanner met
    it alone.
    """

    def __init__(
        self, points: Array, neighbours: int = 6, radius_m: float = 0.5, lone: bool = False
    ) -> None:
        """points: (M, 3), used as (M, 2) when all lie at z = 0. neighbours: most per patch.

        lone: a patch that is no surface is filled only if it is small and holds all points within
        the radius. The few points nearest to a place in a dense, noisy wall, and those of a wall
        far off, look like a pole otherwise, which would fix the place along the wall.
        """
        flat = not points[:, 2].any()
        self.points = np.ascontiguousarray(points[:, :2] if flat else points)
        self._plan = np.ascontiguousarray(points[:, :2])
        self._tree = cKDTree(self.points, balanced_tree=False)
        self._neighbours, self._radius_m = min(neighbours, len(points)), radius_m
        self._lone = lone

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.points.shape[1])

    def patches(self, places: Array) -> Patches:
        """What lies around places (N, d)."""
        distance, row = self._tree.query(
            places, range(1, self._neighbours + 1), distance_upper_bound=self._radius_m
        )
        inside = np.isfinite(distance)
        count = inside.sum(axis=1)
        share = inside / np.maximum(count, 1)[:, None]
        near = self._plan[np.where(inside, row, 0)]
        centre = np.einsum("nk,nki->ni", share, near)
        offset = near - centre[:, None]
        scatter = np.einsum("nk,nki,nkj->nij", share, offset, offset)
        normal, across, along = _thinnest(scatter)
        filled = count >= 3
        if self._lone:
            small = np.einsum("nii->n", scatter) < (0.25 * self._radius_m) ** 2
            filled &= small & (count < self._neighbours)
        return Patches(centre, normal, (count >= 4) & (along > _FLAT * across), filled)


def _thinnest(scatter: Array) -> tuple[Array, Array, Array]:
    """Normals (N, 2), and the variances across and along (N,) each, of scatters (N, 2, 2)."""
    xx, xy, yy = scatter[:, 0, 0], scatter[:, 0, 1], scatter[:, 1, 1]
    half = 0.5 * (xx - yy)
    root = np.hypot(half, xy)
    middle = 0.5 * (xx + yy)
    turn = 0.5 * np.arctan2(xy, half)  # of the direction along the surface
    return np.column_stack((-np.sin(turn), np.cos(turn))), middle - root, middle + root
