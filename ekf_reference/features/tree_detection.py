"""Tree trunks in planar scans: clusters, diameters, centres (Guivant 2002, section 3.1).

A trunk seen by a laser is a run of consecutive returns on a circle. Its angular width times its
distance is an observation of the diameter (eq. 10), which a Kalman filter per tracked tree
averages (eq. 16); the diameter then leads from the surface that was measured to the centre that
serves as landmark.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask

ROUNDNESS = math.pi / 8.0
"""The mean range over a circle's visible half lies this many diameters before its centre.

Over the angles that hit it, the surface is on average R pi / 4 nearer than the centre.
"""


@dataclass(frozen=True)
class Clusters:
    """C runs of consecutive returns. Beams are evenly spaced.

    first, last: (C,) beams i_i and i_n. range_m: (C,) mean range (eq. 11). bearing_rad: (C,) of
    the middle. width_rad: (C,) angular width.
    """

    first: Index
    last: Index
    range_m: Array
    bearing_rad: Array
    width_rad: Array


@dataclass(frozen=True, kw_only=True)
class TrunkModel:
    """What a trunk looks like, and how well it is seen.

    gap_m: returns farther apart in range belong to different objects. least_m, largest_m: of a
    trunk's diameter. range_limit_m: farther objects are left out. sigma_range_m; sigma_width_rad:
    of the angular width, by the spacing of the beams; sigma_shape_m: omega_s of eq. 15, trunks
    being neither round nor equally thick at every height.
    """

    gap_m: float = 0.3
    least_m: float = 0.05
    largest_m: float = 1.2
    range_limit_m: float = 40.0
    sigma_range_m: float = 0.03
    sigma_width_rad: float = math.radians(0.5) / math.sqrt(6.0)
    sigma_shape_m: float = 0.03


def cluster(angle_rad: Array, range_m: Array, gap_m: float) -> Clusters:
    """Split a scan where the range jumps.

    Args:
        angle_rad: (B,) of the beams, evenly spaced.
        range_m: (B,), NaN for no return.
        gap_m: Neighbouring returns farther apart in range belong to different objects.

    Returns:
        Runs of consecutive returns, one beam spacing wider than from first to last beam.

    Source: Guivant 2002, eqs. 10 and 11.
    Erratum: eq. 11 takes (i_n - i_i) beam spacings as the width, which leaves out half a spacing at
    either edge; on average the object is one spacing wider, and that is what is used.
    """
    returned = np.flatnonzero(np.isfinite(range_m))
    if not len(returned):
        empty, none = np.zeros(0, dtype=np.intp), np.zeros(0)
        return Clusters(empty, empty, none, none, none)
    r = range_m[returned]
    fresh = (np.diff(returned, prepend=-9) != 1) | (np.abs(np.diff(r, prepend=np.inf)) > gap_m)
    run = np.cumsum(fresh) - 1
    size = np.bincount(run)
    first = returned[fresh]
    last = first + size - 1
    spacing = (angle_rad[-1] - angle_rad[0]) / (len(angle_rad) - 1)
    return Clusters(
        first,
        last,
        np.bincount(run, r) / size,
        0.5 * (angle_rad[first] + angle_rad[last]),
        size * spacing,
    )


def observed_diameter(range_m: Array, width_rad: Array) -> Array:
    """Return the diameter of an object by its angular width.

    z_D = width * distance of the centre, which itself lies ROUNDNESS diameters behind the mean
    range; solved for the diameter.

    Args:
        range_m: (C,) mean range.
        width_rad: (C,) angular width.

    Returns:
        (C,) [m].

    Source: Guivant 2002, eq. 10.
    """
    return range_m * width_rad / (1.0 - ROUNDNESS * width_rad)


def diameter_variance(range_m: Array, width_rad: Array, model: TrunkModel) -> Array:
    """Return the variance of an observed diameter.

    Args:
        range_m: (C,) mean range.
        width_rad: (C,) angular width.
        model: Standard deviations of range, width and shape.

    Returns:
        (C,) [m^2].

    Source: Guivant 2002, eq. 12 with the shape noise of eq. 15. Eqs. 13 and 14 leave the first term
    out, being small; it is kept.
    """
    return (
        width_rad**2 * model.sigma_range_m**2
        + range_m**2 * model.sigma_width_rad**2
        + model.sigma_shape_m**2
    )


@dataclass(frozen=True, kw_only=True)
class Trunks:
    """T detections of one scan: centres and diameters.

    track: (T,) number of the tracked tree. range_m, bearing_rad: (T,) of the centre.
    diameter_m, diameter_variance: (T,) as filtered. scans: (T,) in which it was seen so far.
    """

    track: Index
    range_m: Array
    bearing_rad: Array
    diameter_m: Array
    diameter_variance: Array
    scans: Index


@dataclass(kw_only=True)
class TreeTracker:
    """Follows trunks from scan to scan and filters their diameters (Guivant 2002, eq. 16).

    join_m: a cluster belongs to the nearest track within this distance, after the vehicle's own
    motion. silence: scans without a measurement after which a track is given up.
    """

    model: TrunkModel = field(default_factory=TrunkModel)
    join_m: float = 0.8
    silence: int = 5
    _next: int = 0
    _track: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    _place: Array = field(default_factory=lambda: np.zeros((0, 2)))
    _diameter: Array = field(default_factory=lambda: np.zeros(0))
    _variance: Array = field(default_factory=lambda: np.zeros(0))
    _scans: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    _unseen: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    def detect(self, angle_rad: Array, range_m: Array, motion: Array) -> Trunks:
        """Find the trunks of a scan, and filter the diameters of those that were seen before.

        Args:
            angle_rad: (B,) of the beams, relative to the sensor.
            range_m: (B,), NaN for no return.
            motion: (3,) of the sensor since the last scan, in its old frame [m, m, rad].

        Returns:
            Centres, not surfaces, relative to the sensor, with filtered diameters.

        Source: Guivant 2002, section 3.1, eq. 16.
        """
        self._move(motion)
        found = self._trunk_like(cluster(angle_rad, range_m, self.model.gap_m))
        z = observed_diameter(found.range_m, found.width_rad)
        variance = diameter_variance(found.range_m, found.width_rad, self.model)
        centre = found.range_m + ROUNDNESS * z
        place = centre[:, None] * np.column_stack(
            (np.cos(found.bearing_rad), np.sin(found.bearing_rad))
        )
        row = self._associate(place)
        self._grow(row, place, z, variance)
        self._filter(row, z, variance)
        self._place[row] = place
        self._unseen += 1
        self._unseen[row] = 0
        self._scans[row] += 1
        diameter = self._diameter[row]
        trunks = Trunks(
            track=self._track[row],
            range_m=found.range_m + ROUNDNESS * diameter,
            bearing_rad=found.bearing_rad,
            diameter_m=diameter,
            diameter_variance=self._variance[row],
            scans=self._scans[row],
        )
        self._keep(self._unseen <= self.silence)
        return trunks

    def _trunk_like(self, found: Clusters) -> Clusters:
        diameter = observed_diameter(found.range_m, found.width_rad)
        good = (
            (diameter >= self.model.least_m)
            & (diameter <= self.model.largest_m)
            & (found.range_m <= self.model.range_limit_m)
        )
        return Clusters(*(column[good] for column in vars(found).values()))

    def _associate(self, place: Array) -> Index:
        """Row of each cluster's track; new tracks get the rows behind the present ones."""
        row = np.full(len(place), -1, dtype=np.intp)
        if len(self._place):
            distance = np.linalg.norm(place[:, None] - self._place[None], axis=2)
            for i in np.argsort(distance.min(axis=1), kind="stable").tolist():
                j = int(np.argmin(distance[i]))
                if distance[i, j] <= self.join_m:
                    row[i] = j
                    distance[:, j] = np.inf
        fresh = row < 0
        row[fresh] = len(self._place) + np.arange(np.count_nonzero(fresh))
        return row

    def _grow(self, row: Index, place: Array, z: Array, variance: Array) -> None:
        """Start tracks with the first observation as initial condition (eq. 16)."""
        fresh = row >= len(self._track)
        count = int(np.count_nonzero(fresh))
        self._track = np.concatenate((self._track, self._next + np.arange(count)))
        self._next += count
        self._place = np.vstack((self._place, place[fresh]))
        self._diameter = np.concatenate((self._diameter, z[fresh]))
        self._variance = np.concatenate((self._variance, np.full(count, np.inf)))
        self._scans = np.concatenate((self._scans, np.zeros(count, dtype=np.intp)))
        self._unseen = np.concatenate((self._unseen, np.zeros(count, dtype=np.intp)))

    def _filter(self, row: Index, z: Array, variance: Array) -> None:
        """Update of a constant: the diameter's derivative is zero (eq. 16)."""
        prior = self._variance[row]
        gain = np.where(
            np.isinf(prior), 1.0, prior / np.where(np.isinf(prior), 1.0, prior + variance)
        )
        self._diameter[row] += gain * (z - self._diameter[row])
        self._variance[row] = gain * variance

    def _move(self, motion: Array) -> None:
        """Bring the tracks into the sensor's present frame."""
        cos, sin = np.cos(motion[2]), np.sin(motion[2])
        offset = self._place - motion[:2]
        self._place = offset @ np.array([[cos, -sin], [sin, cos]])

    def _keep(self, kept: Mask) -> None:
        self._track, self._place = self._track[kept], self._place[kept]
        self._diameter, self._variance = self._diameter[kept], self._variance[kept]
        self._scans, self._unseen = self._scans[kept], self._unseen[kept]
