"""Measurements made from a log's raw scans, in place of those that the log brings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from comparisons.adapters.motion import motion_between
from comparisons.errors import InputError
from comparisons.logs.log import NO_LANDMARK, LandmarkMeasurements, Log
from ekf_reference.features.tree_detection import ROUNDNESS, TreeTracker
from graphslam.scan import planar
from graphslam.scan.points import planar_points

SIGMA_BEARING_RAD = np.deg2rad(1.0)


def with_tree_features(log: Log) -> Log:
    """Return the log with trunks found in its scans in place of its measurements.

    Range, bearing and diameter of tracked trunks (Guivant 2002, section 3.1). The vehicle's motion
    between scans, which the tracks need, is dead reckoned. Trunks are found and followed in the
    scanner's frame, and expressed in the vehicle's. Raises InputError for a log without scans, or
    without trunks in them.
    """
    scans = log.scans
    if scans is None:
        raise InputError(f"{log.name}: holds no scans to find trees in; use --features log")
    if not len(log.odometry.time_s):
        raise InputError(f"{log.name}: holds no odometry, which following trunks needs")
    inside = (scans.time_s >= log.prior.time_s) & (scans.time_s <= log.odometry.time_s[-1])
    rows = np.flatnonzero(inside)
    tracker = TreeTracker()
    parts = []
    motion = motion_between(log, scans.time_s[rows]).displacement
    mount = scans.mount.pose
    for row, driven in zip(rows.tolist(), motion, strict=True):
        moved = planar.between(mount, planar.compose(driven, mount))
        trunks = tracker.detect(scans.angle_rad, scans.range_m[row], moved)
        sigma = np.hypot(tracker.model.sigma_range_m, ROUNDNESS * np.sqrt(trunks.diameter_variance))
        count = len(trunks.track)
        time = np.full(count, scans.time_s[row])
        place = planar_points(trunks.bearing_rad, trunks.range_m, mount)
        distance, bearing = np.hypot(*place.T[:2]), np.arctan2(place[:, 1], place[:, 0])
        parts.append((time, distance, bearing, sigma, trunks.diameter_m))
    if not sum(len(part[0]) for part in parts):
        raise InputError(f"{log.name}: no trunks in its scans")
    time, distance, bearing, sigma, diameter = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    measurements = LandmarkMeasurements(
        time_s=time,
        range_m=distance,
        bearing_rad=bearing,
        sigma_range_m=sigma,
        sigma_bearing_rad=np.full(len(time), SIGMA_BEARING_RAD),
        landmark=np.full(len(time), NO_LANDMARK),
        diameter_m=diameter,
        needs_confirmation=True,
    )
    provenance = {**log.provenance, "features": "tree trunks from the scans"}
    return replace(log, measurements=measurements, provenance=provenance)
