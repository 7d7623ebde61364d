"""Raw scans as clouds of points in the vehicle's frame: forward, left, up in metres."""

from __future__ import annotations

import math

import numpy as np

from graphslam.arrays import Array
from graphslam.scan import planar
from graphslam.scan.registration import ScanError

LEAST_POINTS = 20
_LEAST_SPREAD_M = 0.05
_LOWEST = 0.02
_MEDIAN_OF_NORMAL = 0.6745
"""Median of |x| for a standard normal x."""


def planar_points(angle_rad: Array, range_m: Array, mount: Array) -> Array:
    """(M, 3) where the beams (B,) of a planar scan ended, at z = 0; beams without return left out.

    mount: (3,) the scanner's place and heading on the vehicle.
    """
    seen = np.isfinite(range_m)
    return swept_points(angle_rad[seen], range_m[seen], np.tile(mount, (int(seen.sum()), 1)))


def swept_points(angle_rad: Array, range_m: Array, scanner: Array) -> Array:
    """(B, 3) ends of beams (B,), each from the scanner's own pose (B, 3) in the frame wanted.

    With the scanner's poses at the beams' own times this compensates the motion within a scan.
    """
    direction = scanner[:, 2] + angle_rad
    x = scanner[:, 0] + range_m * np.cos(direction)
    y = scanner[:, 1] + range_m * np.sin(direction)
    return np.column_stack((x, y, np.zeros(len(x))))


def compensated(points: Array, seconds: Array, motion: Array, duration_s: float) -> Array:
    """Points (M, 3) measured `seconds` (M,) after the scan began, seen from where it began.

    motion: (3,) of the vehicle within duration_s, taken as even.
    """
    share = (seconds / duration_s)[:, None]
    pose = share * motion
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x, y, z = points.T
    return np.column_stack((pose[:, 0] + cos * x - sin * y, pose[:, 1] + sin * x + cos * y, z))


def beam_noise(range_m: Array) -> float:
    """Standard deviation of single ranges [m], from scans (N, B) themselves; NaN without any.

    Along a wall the second difference of neighbouring ranges is noise alone, of six times the
    variance; corners and gaps are too few to shift the median.
    """
    bend = np.abs(range_m[:, 2:] - 2.0 * range_m[:, 1:-1] + range_m[:, :-2])
    seen = bend[np.isfinite(bend)]
    return float(np.median(seen)) / _MEDIAN_OF_NORMAL / math.sqrt(6.0) if len(seen) else math.nan


def above_ground(points: Array, margin_m: float) -> Array:
    """The points (M, 3) more than a margin above the lowest ones; all of them in planar scans.

    Raises ScanError when these are no points.
    """
    cloud = _numbers(points)
    height = cloud[:, 2]
    if not height.any():
        return cloud
    seen = height[np.isfinite(height)]
    if not seen.any():
        return cloud
    return cloud[height > np.quantile(seen, _LOWEST) + margin_m]


def usable(
    points: Array, least_range_m: float, most_range_m: float, least: int = LEAST_POINTS
) -> Array:
    """The points (M, 3) that are numbers and within range of the vehicle, `least` of them or more.

    Raises ScanError when that is not a cloud to align: wrong shape, too few, or all in one place.
    """
    cloud = _numbers(points)
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.sqrt(np.einsum("ni,ni->n", cloud, cloud))
        kept: Array = cloud[(distance >= least_range_m) & (distance <= most_range_m)]
    if len(kept) < least:
        raise ScanError(
            f"{len(kept)} of {len(cloud)} points lie within {least_range_m:g} to "
            f"{most_range_m:g} m, expected {least} at least"
        )
    x, y = kept[:, 0], kept[:, 1]
    if max(x.max() - x.min(), y.max() - y.min()) < _LEAST_SPREAD_M:
        raise ScanError("all points lie in one place")
    return kept


def _numbers(points: Array) -> Array:
    """The same (M, 3) as doubles. Raises ScanError for another shape or type."""
    if np.ma.isMaskedArray(points):
        raise ScanError("points are a masked array, expected NaN where there are none")
    try:
        cloud = np.asarray(points)
    except ValueError:
        raise ScanError("points are rows of different lengths, expected (N, 3) floats") from None
    if cloud.ndim != 2 or cloud.shape[1] != 3 or cloud.dtype.kind not in "fiu":
        raise ScanError(f"points have shape {cloud.shape} of {cloud.dtype}, expected (N, 3) floats")
    if cloud.dtype == np.float64 and cloud.flags.c_contiguous:
        return cloud
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(cloud, dtype=np.float64)


def placed(clouds: list[Array], poses: Array) -> Array:
    """(P, 3) clouds of points seen from poses (N, 3), together in the poses' frame."""
    parts = [planar.moved(pose, cloud) for cloud, pose in zip(clouds, poses, strict=True)]
    return np.vstack(parts) if parts else np.zeros((0, 3))
