"""Delayed initialisation of points where there is no region yet (Nieto 2005, section 3.7.3).

A point is kept in the frame of two landmarks near it, with its variances and its covariance with
the vehicle's pose in that frame, by which the filter's updates correct it. Information flows to
points only (section 3.7), so a scan costs time linear in the points.

Approximation: the filter's information reaches a point through the vehicle's current pose alone:
C, the covariance of a point's error with the whole state, is taken for A P_v, the regression on the
pose. That is exact for known landmarks, with any noise of the motion. Where landmarks are estimated
too, noise of the motion takes from the pose what the landmarks still know, and an update makes

    P_dd <- P_dd + G S G^T - G H C^T - C H^T G^T,  C <- C (I - K H)^T,  G = A K_v,

with K, H, S of the filter. The true variance is then 1.04 to 1.22 of the stated one in the mean,
never less than it and less than 1.4 of it for any coordinate, with a third to three times the noise
of the motion (test_waiting_oracle.py derives it exactly; 1.13 and 1.25 in two simulated drives).
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask, wrap_angle
from ekf_reference.dense.local_pose import Frames, read_local_poses
from ekf_reference.dense.regions import Potential
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.triangles import turned
from ekf_reference.dense.view import FilterView

SINGULAR = 1e-9
"""Share of a correlation matrix' largest eigenvalue below which the local pose is known."""


@dataclass
class DelayedCounts:
    """What became of points. Every point offered is waiting or counted here.

    released: handed out. refused: in no potential region. dropped: the oldest, over the capacity.
    vanished: with a landmark of their frame, or when its two landmarks coincided.
    """

    released: int = 0
    refused: int = 0
    dropped: int = 0
    vanished: int = 0


class Released(NamedTuple):
    """Points that a region covers now.

    region: (k,) number. local: (k, 2) coordinates in it. point: (k, 2) [m] in the world.
    covariance: (k, 2, 2) [m^2] in the world's directions, of the place *relative to the
    landmarks*: what the point shares with these is not in it, as local coordinates want it.
    number: (k,) as `add` gave it. scan: (k,). origin: (k, 2) [m] where it was seen from.
    """

    region: Index
    local: Array
    point: Array
    covariance: Array
    number: Index
    scan: Index
    origin: Array


class DelayedPoints(NamedTuple):
    """Points (N,), oldest first (Nieto 2005, eq. 3.26).

    group: (N,) which frame. point: (N, 2) [m] in it. variance: (N, 2) [m^2], the diagonal of
    P_dd. cross: (N, 2, 3) P_dv with the vehicle's local pose. scan, number: (N,). back: (N, 2) [m]
    from the point to where it was seen from, in the frame; what corrects one corrects both.
    """

    group: Index
    point: Array
    variance: Array
    cross: Array
    scan: Index
    number: Index
    back: Array

    @classmethod
    def none(cls) -> Self:
        """No points."""
        index = np.empty(0, dtype=np.intp)
        two = np.empty((0, 2))
        return cls(index, two, two, np.empty((0, 2, 3)), index, index, two)


@dataclass(kw_only=True)
class DelayedInitialisation:
    """Waiting points (3.25). Per scan call predicted, the filter's update, updated, release, add.

    capacity: most points. patience: scans after which a point is `overdue`. axis: (G, 2) landmarks
    L1 and L2 of the frames. mean, covariance: (G, 3), (G, 3, 3) of the vehicle's local poses when
    last read.
    """

    capacity: int = 5_000
    patience: int = 16
    counts: DelayedCounts = field(default_factory=DelayedCounts)
    points: DelayedPoints = field(default_factory=DelayedPoints.none)
    axis: Index = field(default_factory=lambda: np.empty((0, 2), dtype=np.intp))
    mean: Array = field(default_factory=lambda: np.empty((0, 3)))
    covariance: Array = field(default_factory=lambda: np.empty((0, 3, 3)))
    _taken: int = 0

    def predicted(self, view: FilterView) -> None:
        """Follow the vehicle's motion: after the filter's predictions, before its update.

        P_dv <- P_dv F^T. All vehicle models are SE(2)-equivariant, so F follows from the
        displacement of the mean, however many steps it took; noise of the motion is in P_vv.
        """
        mean, _ = self._read(view)
        moved = self.mean - mean
        dx, dy = moved[self.points.group, :2].T
        turn = self.points.cross[:, :, 2]
        self.points.cross[:, :, 0] -= turn * dy[:, None]
        self.points.cross[:, :, 1] += turn * dx[:, None]

    def updated(self, view: FilterView) -> None:
        """Correct the points by the change of the vehicle's local pose in the filter's update.

        Regression on it (section 3.7.3), A = P_dv (P_vv^-)^-1: d += A dv, P_dv <- A P_vv^+,
        P_dd <- P_dd - A (P_vv^- - P_vv^+) A^T.
        """
        mean, covariance = self._read(view)
        change = self.mean - mean
        change[:, 2] = wrap_angle(change[:, 2])
        inverse = _inverse(covariance)
        learnt = inverse @ (covariance - self.covariance) @ inverse
        shift = inverse @ change[:, :, None]
        by_cross = np.concatenate((inverse @ self.covariance, learnt, shift), axis=2)
        cross = self.points.cross
        effect = cross @ by_cross[self.points.group]  # (N, 2, 7)
        variance = self.points.variance - np.einsum("nij,nij->ni", effect[:, :, 3:6], cross)
        self.points = self.points._replace(
            point=self.points.point + effect[:, :, 6],
            variance=np.maximum(variance, 0.0),  # rounding
            cross=effect[:, :, :3].copy(),
        )

    def add(
        self,
        view: FilterView,
        point: Array,
        noise: Array,
        scan: int,
        potential: Potential,
        origin: Array | None = None,
    ) -> Index:
        """Take in points outside all regions; returns their numbers, -1 where refused.

        Source: Nieto 2005, eqs. 3.29 and 3.30. Erratum: 3.30 prints the last factor without
        its transpose, grad h_z R grad h_z^T holds.

        view: as `updated` read it. point: (N, 2) [m] in the world, from the vehicle's estimated
        pose. noise: (N, 2, 2) [m^2] of the measurements, the pose's not included. potential: as of
        now; a point joins the frame of the first of them that contains it. origin: (2,) of the
        scanner; the vehicle's place by default.
        """
        region = potential.placed.locate(point).region
        known: Mask = np.isfinite(noise).all(axis=(1, 2)) & (region >= 0)
        wanted = potential.axis[region[known]]  # of a while ago: its landmarks have moved on
        known[known] = _current(view, wanted) & _spans(view, wanted)
        axis = potential.axis[region[known]]
        group = self._groups(view, axis)
        frame = Frames.of(view.landmark[axis[:, 0]], view.landmark[axis[:, 1]])
        local = frame.to_local(point[known])
        by_pose = np.zeros((len(axis), 2, 3))
        by_pose[:, 0, 0] = by_pose[:, 1, 1] = 1.0
        by_pose[:, :, 2] = turned(local - self.mean[group, :2])
        cross = by_pose @ self.covariance[group]
        own = np.einsum("nji,njk,nki->ni", frame.turn, noise[known], frame.turn)
        variance = np.einsum("nij,nij->ni", cross, by_pose) + own
        number = np.full(len(point), -1, dtype=np.intp)
        number[known] = self._taken + np.arange(len(axis))
        self._taken += len(axis)
        self.counts.refused += len(point) - len(axis)
        when = np.full(len(axis), scan, dtype=np.intp)
        seen_from = view.pose[:2] if origin is None else origin
        back = frame.to_local(np.broadcast_to(seen_from, local.shape)) - local
        new = DelayedPoints(group, local, variance, cross, when, number[known], back)
        joined = zip(self.points, new, strict=True)
        self.points = DelayedPoints(*(np.concatenate(pair) for pair in joined))
        excess = len(self.points.scan) - self.capacity
        if excess > 0:
            self.counts.dropped += excess
            self._keep(np.arange(excess, len(self.points.scan)))
        return number

    def release(self, view: FilterView, placed: RegionsAtMap) -> Released:
        """Hand out the points that lie in a region now; they leave the room."""
        world, frame = self._in_the_world(view)
        found = placed.locate(world)
        out = np.flatnonzero(found.region >= 0)
        turn, variance = frame.turn[out], self.points.variance[out]
        covariance = np.einsum("nij,nj,nkj->nik", turn, variance, turn)
        released = Released(
            found.region[out],
            found.local[out],
            world[out],
            covariance,
            self.points.number[out],
            self.points.scan[out],
            world[out] + np.einsum("nij,nj->ni", turn, self.points.back[out]),
        )
        if len(out):
            self.counts.released += len(out)
            self._keep(np.flatnonzero(found.region < 0))
        return released

    def overdue(self, view: FilterView, scan: int) -> Array:
        """Return the points (k, 2) [m] that have waited for `patience` scans or more."""
        world, _ = self._in_the_world(view)
        return world[scan - self.points.scan >= self.patience]

    def _in_the_world(self, view: FilterView) -> tuple[Array, Frames]:
        """All points (N, 2) [m] and their frames; NaN where a landmark has left the map."""
        frame = Frames.of(view.landmark[self.axis[:, 0]], view.landmark[self.axis[:, 1]])
        frame = Frames(frame.origin[self.points.group], frame.turn[self.points.group])
        return frame.to_world(self.points.point), frame

    def _read(self, view: FilterView) -> tuple[Array, Array]:
        """Read the local poses anew; returns those read before, mean and covariance."""
        there = _spans(view, self.axis)
        if not there.all():
            kept = there[self.points.group]
            self.counts.vanished += int(np.count_nonzero(~kept))
            self._keep(np.flatnonzero(kept))
        current = _current(view, self.axis)
        if not current.all():
            # Passive in a compressed filter: corrected no more.
            self.points.cross[~current[self.points.group]] = 0.0
        before = self.mean, self.covariance
        self.mean, self.covariance = self.mean.copy(), self.covariance.copy()
        read = read_local_poses(view, self.axis[current])
        self.mean[current], self.covariance[current] = read
        return before

    def _groups(self, view: FilterView, axis: Index) -> Index:
        """The groups (k,) of axes (k, 2), founded where there is none."""
        count = len(view.landmark)
        key, asked = self.axis @ (count, 1), axis @ (count, 1)
        founded = np.setdiff1d(asked, key)
        if len(founded):
            new = np.column_stack(np.divmod(founded, count))
            mean, covariance = read_local_poses(view, new)
            self.axis = np.concatenate((self.axis, new))
            self.mean = np.concatenate((self.mean, mean))
            self.covariance = np.concatenate((self.covariance, covariance))
            key = np.concatenate((key, founded))
        order = np.argsort(key)
        return order[np.searchsorted(key[order], asked)]

    def _keep(self, chosen: Index) -> None:
        """Leave all other points out, and frames without points."""
        columns: Any = (column[chosen] for column in self.points)
        self.points = DelayedPoints(*columns)
        used, group = np.unique(self.points.group, return_inverse=True)
        if len(used) < len(self.axis):
            self.points = self.points._replace(group=group)
            self.axis, self.mean = self.axis[used], self.mean[used]
            self.covariance = self.covariance[used]


def _current(view: FilterView, axis: Index) -> Mask:
    """Which axes (G, 2) have both landmarks among those whose covariance is current; (G,)."""
    known = np.zeros(len(view.landmark), dtype=bool)
    known[view.landmark_index] = True
    return np.logical_and(known[axis[:, 0]], known[axis[:, 1]])


def _spans(view: FilterView, axis: Index) -> Mask:
    """Which axes (G, 2) are in the map and longer than nothing; (G,)."""
    first, second = view.landmark[axis[:, 0]], view.landmark[axis[:, 1]]
    apart: Mask = np.isfinite(second - first).all(axis=1) & (first != second).any(axis=1)
    return apart


def _inverse(covariance: Array) -> Array:
    """Pseudo-inverses of covariances (G, 3, 3); zero where one is not finite."""
    finite = np.isfinite(covariance).all(axis=(1, 2), keepdims=True)
    covariance = np.where(finite, covariance, 0.0)
    sigma = np.sqrt(np.einsum("gii->gi", covariance))
    sigma = np.where(sigma > 0.0, sigma, 1.0)
    scale = sigma[:, :, None] * sigma[:, None, :]
    value, vector = np.linalg.eigh(covariance / scale)
    usable = value > SINGULAR * value[:, -1:]
    inverse = np.where(usable, 1.0 / np.where(usable, value, 1.0), 0.0)
    whole: Array = (vector * inverse[:, None]) @ np.swapaxes(vector, 1, 2) / scale
    return whole
