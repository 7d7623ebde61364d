"""The sum of Gaussians of a scan (Nieto 2005, section 4.3.1), and what its returns lie on."""

from __future__ import annotations

import math

import numpy as np

from ekf_reference.core.geometry import Array, Mask
from ekf_reference.dense.scan import NEXT, Scan, ScanSensor
from ekf_reference.scan_matching.sog import SumOfGaussians

_MEET = 0.5
"""Sigma of a piece of surface over its length, at which a row of pieces has an even height."""
_LIMB_RAD = math.radians(25.0)
"""Met at less than that a surface goes on behind its last return."""
_BACK = 4
"""Returns over which the direction of a surface at its end is taken."""
_BESIDE_BOUNDARY = 3
"""Returns next to where the scan loses a surface that cannot tell where it ends."""
_FARTHEST = 0.9
"""Share of the greatest range beyond which a surface may go on out of reach."""
_TIE_M = 1e-6
"""Far above rounding. Recorded ranges are multiples of a step, so that two are often equal, or one
is at a bound; to so much they count as equal, and as not beyond it."""


def of_scan(bearing_rad: Array, range_m: Array, sensor: ScanSensor) -> SumOfGaussians:
    """The returns of a scan in the scanner's frame; beams (B,), those without return left out.

    Means and covariances are Nieto 2005, eqs. 4.15 and 4.16. Each Gaussian is longer by the surface
    between the return and its neighbours on the same surface, if any (ScanSensor.joins). There is a
    boundary where the scan loses a surface that goes on. Otherwise two scans of one wall would
    match by where beams hit and views end. In a full circle the surface behind is cut in two.
    """
    scan = Scan.of_ranges(np.zeros(3), bearing_rad, range_m, sensor)
    if len(scan.range_m) < 2:
        return SumOfGaussians.of_equal_height(scan.point, scan.covariance)
    one = sensor.joins(scan.range_m[:-1], scan.range_m[1:], np.diff(scan.bearing_rad))
    half = 0.5 * np.where(one[:, None], np.diff(scan.point, axis=0), 0.0)
    none = np.zeros((1, 2))
    piece = np.vstack((half, none)) + np.vstack((none, half))
    covariance = scan.covariance + _MEET**2 * piece[:, :, None] * piece[:, None, :]
    beams = np.mod(bearing_rad[np.isfinite(bearing_rad)] + np.pi, 2.0 * np.pi) - np.pi
    return SumOfGaussians.of_equal_height(
        scan.point, covariance, _boundaries(scan, one, float(beams.min()), float(beams.max()))
    )


def _boundaries(scan: Scan, one: Mask, first_rad: float, last_rad: float) -> Mask:
    """(B,) returns near where a surface goes on unseen: each side of the scan in turn.

    It does at the rims of the view, behind something nearer, out of reach, and round a limb.
    Anything else that ends before something farther is an edge.
    """
    boundary: Mask = _one_sided(
        scan.bearing_rad, scan.range_m, scan.point, one, last_rad, scan.sensor
    )
    back = slice(None, None, -1)
    mirrored = _one_sided(
        -scan.bearing_rad[back], scan.range_m[back], scan.point[back], one[back], -first_rad,
        scan.sensor,
    )  # fmt: skip
    return boundary | mirrored[back]


def _one_sided(
    bearing_rad: Array, range_m: Array, point: Array, one: Mask, rim_rad: float, sensor: ScanSensor
) -> Mask:
    """The same where surfaces end towards greater bearings."""
    count = len(range_m)
    row = np.arange(count)
    run = np.append(0, np.cumsum(~one))
    begin = np.searchsorted(run, run)
    last = np.append(~one, True)
    beside = np.append(np.diff(bearing_rad), rim_rad - bearing_rad[-1])
    empty = beside > NEXT * sensor.beam_rad
    farther = np.append(range_m[1:], np.inf)
    behind = ~empty & (farther < range_m - _TIE_M)
    behind[-1] = not empty[-1]
    lost = empty & (range_m > _FARTHEST * range_m.max() + _TIE_M)
    inner = np.maximum(row - _BACK, begin)
    along = point - point[inner]
    across = np.abs(along[:, 0] * point[:, 1] - along[:, 1] * point[:, 0])
    limb = (row - begin >= 2) & (
        across < math.sin(_LIMB_RAD) * np.linalg.norm(along, axis=1) * range_m
    )
    ends = last & (behind | lost | limb)
    boundary = ends.copy()
    for k in range(1, _BESIDE_BOUNDARY):
        boundary[:-k] |= ends[k:] & (run[:-k] == run[k:])
    return np.asarray(boundary)
