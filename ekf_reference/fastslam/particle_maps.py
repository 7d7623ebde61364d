"""The maps of all particles, and what a particle expects to measure of its landmarks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.core.landmark_types import MeasurementModel

FREE = -1
"""Number of a column that belongs to no landmark."""
_ORIGIN = np.zeros(3)
_AHEAD = np.array([1.0, 0.0])


def inverse_2x2(matrix: Array) -> tuple[Array, Array]:
    """Return the inverses and determinants of 2 x 2 matrices.

    Args:
        matrix: (..., 2, 2), regular; it is not checked.

    Returns:
        Inverses (..., 2, 2) and determinants (...).
    """
    a, b, c, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1]
    determinant: Array = a * d - b * c
    inverse = np.empty_like(matrix)
    inverse[..., 0, 0], inverse[..., 1, 1] = d / determinant, a / determinant
    inverse[..., 0, 1], inverse[..., 1, 0] = -b / determinant, -c / determinant
    return inverse, determinant


class ParticlePredictions(NamedTuple):
    """What particles expect to measure of K landmarks each.

    z: (N, K, 2). by_pose: (N, K, 2, 3), by the pose's error in its own frame. by_landmark:
    (N, K, 2, 2), by the landmark's place on the map. spread: (N, K, 2, 2), H C H^T of the
    landmark's covariance C. local: (N, K, 2) place in the vehicle's frame [m].
    """

    z: Array
    by_pose: Array
    by_landmark: Array
    spread: Array
    local: Array


class ParticleMaps:
    """One Gaussian per particle and landmark, of which the map of each particle is made.

    Nieto 2005, eq. 2.20: given the path, landmarks are independent. A column is a landmark: that of
    a label, or one that some particles initialised from the same measurement. A particle need not
    have every landmark: evidence is above zero where it has.

    mean: (N, C, 2) [m]. covariance: (N, C, 2, 2) [m^2]. evidence: (N, C) log odds that the landmark
    exists, zero for a landmark that the particle does not have. number: (C,) label or serial number
    of the column, FREE where no particle has it.

    Resampling copies the maps of new children only (see resampling.systematic_parents). At 1,000
    particles and 300 landmarks that costs less than one measurement update, so pages shared between
    particles would save nothing that is measured.
    """

    def __init__(self, particles: int, columns: int = 16) -> None:
        """Start with empty maps and room for some landmarks.

        Args:
            particles: Their number N.
            columns: Room at first, in landmarks; `allocate` adds more.
        """
        self.mean: Array = np.zeros((particles, columns, 2))
        self.covariance: Array = np.zeros((particles, columns, 2, 2))
        self.evidence: Array = np.zeros((particles, columns))
        self.number: NDArray[np.int64] = np.full(columns, FREE, dtype=np.int64)
        self._row: Index = np.arange(particles)[:, None]

    def inherit(self, parents: Index) -> None:
        """Replace each particle's map by that of its parent; free unused columns.

        Args:
            parents: (N,) indices of particles.
        """
        new = np.flatnonzero(parents != self._row[:, 0])
        source = parents[new]
        for held in (self.mean, self.covariance, self.evidence):
            held[new] = held[source]
        self.number[~(self.evidence > 0.0).any(axis=0)] = FREE

    def columns_of(self, number: NDArray[np.int64]) -> Index:
        """Return the columns of labels.

        Args:
            number: (m,) labels, negative for none.

        Returns:
            (m,), FREE where no column has the label.
        """
        found = np.equal.outer(number, self.number) & (number >= 0)[:, None]
        return np.where(found.any(axis=1), found.argmax(axis=1), FREE)

    def allocate(self, number: NDArray[np.int64]) -> Index:
        """Give new landmarks free columns; add columns where too few are free.

        Args:
            number: (k,) labels or serial numbers of the landmarks.

        Returns:
            (k,) their columns.
        """
        free = np.flatnonzero(self.number == FREE)
        if len(free) < len(number):
            more = max(len(self.number), len(number))
            free = np.concatenate((free, len(self.number) + np.arange(more)))
            self.mean = np.pad(self.mean, ((0, 0), (0, more), (0, 0)))
            self.covariance = np.pad(self.covariance, ((0, 0), (0, more), (0, 0), (0, 0)))
            self.evidence = np.pad(self.evidence, ((0, 0), (0, more)))
            self.number = np.pad(self.number, (0, more), constant_values=FREE)
        chosen = free[: len(number)]
        self.number[chosen] = number
        return chosen

    def near(self, pose: Array, reach_m: float) -> Index:
        """Return the columns of landmarks within reach of any particle that has them.

        Args:
            pose: (N, 3) x, y [m], heading [rad].
            reach_m: Largest distance between vehicle and landmark [m].

        Returns:
            (K,) ascending.
        """
        used = np.flatnonzero(self.number != FREE)
        x = self.mean[:, used, 0] - pose[:, None, 0]
        y = self.mean[:, used, 1] - pose[:, None, 1]
        close = (x * x + y * y <= reach_m * reach_m) & (self.evidence[:, used] > 0.0)
        return used[close.any(axis=0)]

    def around(self, pose: Array, point: Array, reach_m: Array) -> Index:
        """Return the columns (K,) that may lie near points, in any particle that has them.

        Args:
            pose: (N, 3).
            point: (m, 2) in the vehicle's frame [m].
            reach_m: (m,) how far a landmark may lie from the point.

        Returns:
            Those whose bounding box over the particles, in the vehicle's frame, is in reach.
        """
        used = np.flatnonzero(self.number != FREE)
        place = self._local(pose, self.mean[:, used])
        held = self.has(used)[..., None]
        low = np.where(held, place, np.inf).min(axis=0)
        high = np.where(held, place, -np.inf).max(axis=0)
        gap = np.maximum(low - point[:, None], point[:, None] - high)
        gap = np.maximum(gap, 0.0)
        close = (gap * gap).sum(axis=2) <= (reach_m * reach_m)[:, None]
        return used[np.any(close, axis=0)]

    @staticmethod
    def _local(pose: Array, place: Array) -> Array:
        """Places (N, K, 2) on the map, seen from poses (N, 3)."""
        cos, sin = np.cos(pose[:, 2])[:, None], np.sin(pose[:, 2])[:, None]
        x, y = place[..., 0] - pose[:, None, 0], place[..., 1] - pose[:, None, 1]
        found = np.empty(place.shape)
        found[..., 0], found[..., 1] = cos * x + sin * y, cos * y - sin * x
        return found

    def has(self, columns: Index) -> Mask:
        """Return which particles have some landmarks.

        Args:
            columns: (N, K), or (K,) the same for all particles.

        Returns:
            (N, K), True where the particle has the landmark.
        """
        return self.evidence[self._row, columns] > 0.0

    def expected(
        self, pose: Array, columns: Index, sensor: MeasurementModel
    ) -> ParticlePredictions:
        """Return what particles expect to measure of some landmarks.

        Args:
            pose: (N, 3) x, y [m], heading [rad].
            columns: (N, K), or (K,) the same for all particles.
            sensor: Predicts in the vehicle's frame; its measurements depend on relative place
                alone.

        Returns:
            Measurements, Jacobians and spread; of a landmark that a particle does not have, the
            values mean nothing and are finite.

        Source: Nieto 2005, eqs. 2.37 and 2.40 to 2.44.
        """
        local = self._local(pose, self.mean[self._row, columns])
        local = np.where(self.has(columns)[..., None], local, _AHEAD)
        z, by_pose, by_local = sensor.predict(_ORIGIN, local.reshape(-1, 2))
        shape = local.shape[:2]
        by_landmark = by_local.reshape(*shape, 2, 2) @ _to_frame(pose)[:, None]
        covariance = self.covariance[self._row, columns]
        return ParticlePredictions(
            z.reshape(*shape, 2),
            by_pose.reshape(*shape, 2, 3),
            by_landmark,
            by_landmark @ covariance @ by_landmark.swapaxes(-1, -2),
            local,
        )

    def update(
        self, columns: Index, used: Mask, at: ParticlePredictions, innovation: Array, noise: Array
    ) -> None:
        """Fuse measurements with the landmarks, the pose being known (Nieto 2005, eq. 2.20).

        Args:
            columns: (N, m), distinct in each row where used.
            used: (N, m), True where the measurement is fused.
            at: Expected there.
            innovation: (N, m, 2), its angle wrapped.
            noise: (m, 2, 2), R.

        Source: Nieto 2005, eqs. 2.45 to 2.47, for each landmark alone.
        """
        n, j = np.nonzero(used)
        column, h = columns[n, j], at.by_landmark[n, j]
        prior = self.covariance[n, column]
        inverse, _ = inverse_2x2(at.spread[n, j] + noise[j])
        gain = prior @ h.swapaxes(-1, -2) @ inverse
        self.mean[n, column] += (gain @ innovation[n, j][..., None])[..., 0]
        posterior = prior - gain @ h @ prior
        self.covariance[n, column] = 0.5 * (posterior + posterior.swapaxes(-1, -2))

    def initialise(
        self,
        pose: Array,
        columns: Index,
        new: Mask,
        measured: tuple[Array, Array],
        sensor: MeasurementModel,
    ) -> None:
        """Put new landmarks into the maps, the pose being known.

        Args:
            pose: (N, 3).
            columns: (m,) of each measurement; anything where no particle takes it as new.
            new: (N, m), True where the particle takes the measurement as of a new landmark.
            measured: z (m, 2) and R (m, 2, 2).
            sensor: Inverts measurements in the vehicle's frame.

        Source: Nieto 2005, eqs. 2.48 to 2.55 without the pose's uncertainty.
        """
        n, j = np.nonzero(new)
        local, _, by_z = sensor.invert(_ORIGIN, measured[0])
        to_map = _to_frame(pose).swapaxes(-1, -2)[n]
        self.mean[n, columns[j]] = pose[n, :2] + (to_map @ local[j][..., None])[..., 0]
        by_z = to_map @ by_z[j]
        self.covariance[n, columns[j]] = by_z @ measured[1][j] @ by_z.swapaxes(-1, -2)

    def remove(self, columns: Index) -> None:
        """Remove landmarks whose evidence has fallen below zero; free unused columns.

        Args:
            columns: (K,) of the landmarks that are checked.
        """
        held = self.evidence[:, columns]
        self.evidence[:, columns] = np.maximum(held, 0.0)
        self.number[columns[~(held > 0.0).any(axis=0)]] = FREE


def _to_frame(pose: Array) -> Array:
    """Rotations (N, 2, 2) from the map into the frames of poses (N, 3)."""
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    return np.stack((cos, sin, -sin, cos), axis=-1).reshape(-1, 2, 2)
