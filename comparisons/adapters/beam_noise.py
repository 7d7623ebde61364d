"""How noisy the ranges and the bearings of a planar scanner are, from its scans themselves."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.scans import Scans
from ekf_reference.dense.scan import ScanSensor

_BEAMS = 9
"""Neighbouring beams to which a quadratic is fitted, a wall being nearly one."""
_MEDIAN = 0.8914
"""Median of chi-square with six degrees of freedom, over six."""
_CLASSES = 12
_STEEPEST = 0.9
"""Share of the slopes that are looked at; the rest are mostly edges."""
_DIGITS = 6
"""Slopes in metres per radian that are the same in so many decimals stay in their scans' order."""
_SCANS = 200
_LEAST_M = 0.02
_LEAST_RAD = 1e-3
_GRAZING_RAD = np.deg2rad(8.0)


def sensor_of(scans: Scans) -> ScanSensor:
    """The scanner with the noise that its scans show; the least where they are too few to tell.

    Along a wall a range is wrong by its own noise and by the bearing's times the wall's slope in
    range over bearing: variance = range's + bearing's slope^2. Medians over classes of slopes, so
    that corners count little.
    """
    spacing = float(np.median(np.abs(np.diff(scans.angle_rad)))) if len(scans.angle_rad) > 1 else 0
    spacing = spacing or np.deg2rad(0.5)
    sigma_m, sigma_rad = _noise(scans.range_m, spacing)
    return ScanSensor(max(sigma_m, _LEAST_M), max(sigma_rad, _LEAST_RAD), spacing, _GRAZING_RAD)


def _noise(range_m: Array, spacing_rad: float) -> tuple[float, float]:
    some = range_m[:: max(1, len(range_m) // _SCANS)]
    if some.shape[1] < _BEAMS:
        return 0.0, 0.0
    piece = np.lib.stride_tricks.sliding_window_view(some, _BEAMS, axis=1).reshape(-1, _BEAMS)
    piece = piece[np.isfinite(piece).all(axis=1)]
    if len(piece) < 10 * _CLASSES:
        return 0.0, 0.0
    bearing = (np.arange(_BEAMS) - (_BEAMS - 1) / 2) * spacing_rad
    basis = np.linalg.qr(np.vander(bearing / bearing[-1], 3))[0]
    left = np.square(piece).sum(axis=1) - np.square(piece @ basis).sum(axis=1)
    variance = np.maximum(left, 0.0) / (_BEAMS - 3)
    steepness = np.abs(piece @ bearing / (bearing @ bearing))
    slope = np.square(steepness)
    # Recorded ranges are multiples of a step, so many slopes are equal but for rounding.
    rank = np.argsort(np.round(steepness, _DIGITS), kind="stable")[: int(_STEEPEST * len(slope))]
    classes = np.array_split(rank, _CLASSES)
    seen = np.array([np.median(variance[rows]) for rows in classes]) / _MEDIAN
    steep = np.array([np.median(slope[rows]) for rows in classes])
    weight = 1.0 / np.maximum(seen, 1e-12)
    design = np.column_stack((weight, weight * steep))
    of_range, of_bearing = np.linalg.lstsq(design, weight * seen, rcond=None)[0]
    return float(np.sqrt(max(of_range, 0.0))), float(np.sqrt(max(of_bearing, 0.0)))
