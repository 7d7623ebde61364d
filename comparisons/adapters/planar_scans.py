"""A log's raw scans as the planar scans that dense maps take."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.scan_source import ScanSource
from comparisons.arrays import Array
from comparisons.logs.log import Log
from comparisons.logs.scans import Scans
from ekf_reference.dense.scan import Scan, ScanSensor
from ekf_reference.scan_landmarks.templates import SensorView
from graphslam.scan import planar
from graphslam.scan.points import above_ground, beam_noise

_LEAST_SIGMA_M = 0.02
_GRAZING_RAD = np.deg2rad(8.0)
_CLOUD_BEAM_RAD = np.deg2rad(0.5)
"""Clouds are seen as scans with beams so far apart, each ending at the nearest point."""


class PlanarScans:
    """The scans of a log that its odometry covers. time_s: (N,). sensor: what made them."""

    def __init__(self, log: Log, most_range_m: float = 50.0) -> None:
        """most_range_m: returns from farther away are left out. Raises InputError without scans."""
        self._source = ScanSource(log)
        self._most = most_range_m
        self._options = self._source.suited_options()
        self.time_s = self._source.time_s
        self._mount = np.zeros(3)
        self.sensor = ScanSensor(0.05, _CLOUD_BEAM_RAD, _CLOUD_BEAM_RAD, _GRAZING_RAD)
        if log.clouds is None and log.scans is not None:
            self._mount = log.scans.mount.pose
            self.sensor = _sensor(log.scans)
        self._flat = log.clouds is None

    def scan(self, number: int, vehicle: Array) -> Scan:
        """Scan `number` of them, seen with the vehicle at a pose (3,)."""
        points = self._source.points(number)
        if not self._flat:
            points = above_ground(points, self._options.ground_m)
        cos, sin = np.cos(self._mount[2]), np.sin(self._mount[2])
        own = (points[:, :2] - self._mount[:2]) @ np.array(((cos, -sin), (sin, cos)))
        distance, bearing = np.hypot(*own.T), np.arctan2(own[:, 1], own[:, 0])
        near = (distance >= self._options.least_range_m) & (distance <= self._most)
        if not self._flat:
            near &= _nearest(bearing, distance)
        pose = planar.compose(vehicle, self._mount)
        return Scan.of_ranges(pose, bearing[near], distance[near], self.sensor)


def view_to(scans: Scans, reach_m: float) -> SensorView:
    """What planar scans can show up to a reach: as far round as their beams go."""
    return SensorView(reach_m, float(scans.angle_rad.min()), float(scans.angle_rad.max()))


def _sensor(scans: Scans) -> ScanSensor:
    spacing = float(np.median(np.abs(np.diff(scans.angle_rad)))) if len(scans.angle_rad) > 1 else 0
    some = scans.range_m[:: max(1, len(scans.range_m) // 50)]
    sigma_m = float(np.fmax(beam_noise(some), _LEAST_SIGMA_M))  # NaN where no three beams returned
    return ScanSensor(sigma_m, spacing or _CLOUD_BEAM_RAD, spacing, _GRAZING_RAD)


def _nearest(bearing: Array, distance: Array) -> NDArray[np.bool_]:
    """(N,) the nearest point of each direction."""
    order = np.argsort(distance, kind="stable")
    sector = np.floor(bearing[order] / _CLOUD_BEAM_RAD)
    kept = np.zeros(len(bearing), dtype=bool)
    kept[order[np.unique(sector, return_index=True)[1]]] = True
    return kept
