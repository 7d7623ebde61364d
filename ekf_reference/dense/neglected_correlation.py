"""Bound of the correlation that dense maps neglect (Nieto 2005, section 3.6).

A map that keeps local coordinates for good ignores eq. 3.16. The sum of all later changes is
bounded by the relative uncertainty of the vehicle and the base landmarks when a point was fused.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT
from ekf_reference.dense.layers.gaussians import largest_sigma
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.triangles import global_jacobians, to_local, turned
from ekf_reference.dense.view import FilterView


class Carriers(NamedTuple):
    """What points that keep their local coordinates follow: a linear function of landmarks.

    landmark_index: (k, m) landmarks, of which one may come twice. share: (k, 2, 2 m) of each in the
    point.
    """

    landmark_index: Index
    share: Array


def neglected_covariance(view: FilterView, carriers: Carriers, point: Array) -> Array:
    """Covariance (k, 2, 2) [m^2] of points against what carries them, seen from the pose now.

    Source: Nieto 2005, section 3.6. It is the one of alpha and beta, J P J^T with J by pose and
    base landmarks, in metres along the axes: 3.7 differentiated at a fixed point gives
    (a, b) J = (G_x, -share), with G_x = d point / d pose, so that no triangle need be inverted.

    point: (k, 2) [m]. NaN where a carrier's covariance is not current (compressed filters).
    """
    landmark_index, share = carriers
    current = np.isin(landmark_index, view.landmark_index).all(axis=1)
    first = np.full(len(view.landmark), 0)
    first[view.landmark_index] = view.layout.first[POINT]
    place = (first[landmark_index][..., None] + (0, 1)).reshape(-1, share.shape[2])
    columns = np.hstack((np.tile(np.arange(3), (len(point), 1)), place))
    by_state = np.empty((len(point), 2, columns.shape[1]))
    by_state[:, :, :2] = np.eye(2)
    by_state[:, :, 2] = turned(point - view.pose[:2])
    by_state[:, :, 3:] = -share
    by_state[~current] = np.nan
    joint = view.covariance[columns[:, :, None], columns[:, None, :]]
    spread: Array = by_state @ joint @ by_state.transpose(0, 2, 1)
    return spread


@dataclass
class NeglectedCorrelation:
    """Per region, the standard deviation [m] that its data's place was fused with.

    The arrays grow with the regions: largest_m: (R,). mean_m: (R,), over points. count: (R,) points
    noted. NaN where there are none.
    """

    regions: LocalRegions
    largest_m: Array = field(default_factory=lambda: np.empty(0))
    mean_m: Array = field(default_factory=lambda: np.empty(0))
    count: Array = field(default_factory=lambda: np.empty(0))

    def carriers(self, view: FilterView, region: Index, point: Array) -> Carriers:
        """Landmarks that points (k, 2) [m] in regions (k,) follow (Nieto 2005, eq. 3.7).

        Their shares are 1 - alpha - beta, alpha and beta of the corners, of which virtual ones
        follow their two landmarks in turn. Raises DegenerateTriangleError.
        """
        base = self.regions.base[region]
        triangle = self.regions.corners(view.landmark)[base]
        landmark_index, lift = self.regions.virtual.lift(base)
        by_corners = global_jacobians(triangle, to_local(triangle, point)).by_landmarks
        return Carriers(landmark_index, by_corners @ lift)

    def note(
        self, view: FilterView, region: Index, point: Array, weight: Array | None = None
    ) -> Array:
        """Note one scan; returns its standard deviations (k,) [m], in the worst direction.

        region: (k,) those that got points, each once. point: (k, 2) [m] the mean of what each got.
        weight: (k,) how many that were; one by default. A region that is NaN in the answer is left
        as it was: not all of its covariance is current.
        """
        self._grow(len(self.regions.base))
        sigma = self.sigma_now(view, region, point)
        known = np.isfinite(sigma)
        row, new = region[known], sigma[known]
        more = np.ones(len(row)) if weight is None else weight[known]
        self.largest_m[row] = np.fmax(self.largest_m[row], new)
        self.count[row] += more
        before = np.nan_to_num(self.mean_m[row])
        self.mean_m[row] = before + (new - before) * more / self.count[row]
        return sigma

    def sigma_now(self, view: FilterView, region: Index, point: Array) -> Array:
        """(k,) standard deviations [m] of one scan, as `note` returns them, without noting."""
        return largest_sigma(neglected_covariance(view, self.carriers(view, region, point), point))

    def sigma_m(self, region: Index) -> Array:
        """(k,) mean standard deviation of regions (k,); twice of it is rarely exceeded."""
        self._grow(int(np.max(region, initial=-1)) + 1)
        return self.mean_m[region]

    def _grow(self, regions: int) -> None:
        more = regions - len(self.count)
        if more <= 0:
            return
        self.largest_m = np.concatenate((self.largest_m, np.full(more, np.nan)))
        self.mean_m = np.concatenate((self.mean_m, np.full(more, np.nan)))
        self.count = np.concatenate((self.count, np.zeros(more)))
