"""What a log's measurements tell of their landmarks besides where they are, and how surely."""

from __future__ import annotations

import numpy as np

from comparisons.adapters.motion import CLOCK_S
from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.log import Log
from ekf_reference.association.attributes import AttributeEstimates
from ekf_reference.core.measurements import MeasuredAttributes

AROUND_M = 0.3
"""Returns so near to a landmark, or to a measurement, are taken to be of it."""
BRIGHTNESS = 1
"""Column of the intensity."""
SIGMA_WIDTH_RAD = 0.006
SIGMA_SHAPE_M = 0.05
"""Of a diameter (Guivant 2002, eq. 15). Set by hand, so that differences between measurements of
one tree, more than a minute apart on Victoria Park, have a mean normalised square of about one,
near and far (0.96 to 1.33; benchmarks/attributes.py): least squares would follow the outliers, 0.15
m at any range. The first is 1.7 times what beams half a degree apart explain."""
SIGMA_INTENSITY = 0.45
"""Of an intensity, as a share of the median over the log, for its unit is the sensor's own; from
the spread within the reflectors of the ACFR car park."""
LEAST_SHARE = 0.05
"""Of the median of what is around measurements: least sigma of one."""
REPEATS = 12.0
"""Measurements that equal one independent one: the sum of the autocorrelation of what is left
of diameters on Victoria Park, measurement by measurement."""


def measured_attributes(log: Log, choice: str = "on") -> MeasuredAttributes:
    """Diameter and intensity of each measurement (M, 2), NaN where the log has none.

    choice: `layer` for intensities that the scans show around a measurement; the log must have
    scans.
    """
    seen = log.measurements
    variance = np.empty((len(seen.time_s), 2))
    variance[:, 0] = (seen.range_m * SIGMA_WIDTH_RAD) ** 2 + SIGMA_SHAPE_M**2
    intensity = seen.intensity
    variance[:, BRIGHTNESS] = (SIGMA_INTENSITY * _unit(intensity)) ** 2
    if choice == "layer":
        intensity, variance[:, BRIGHTNESS] = _around(log)
    return MeasuredAttributes(np.column_stack((seen.diameter_m, intensity)), variance)


def _around(log: Log) -> tuple[Array, float]:
    """What its scan shows around each measurement (M,), NaN where nothing, and the noise of one.

    The mean over returns; their noise is what they differ by around one measurement, all in all.
    """
    from comparisons.adapters.planar_scans import PlanarScans  # only for attributes of a layer

    seen, scans = log.measurements, PlanarScans(log)
    number = np.searchsorted(scans.time_s, seen.time_s - CLOCK_S)
    there = np.flatnonzero(number < len(scans.time_s))
    there = there[np.abs(scans.time_s[number[there]] - seen.time_s[there]) <= CLOCK_S]
    place = seen.range_m * np.stack((np.cos(seen.bearing_rad), np.sin(seen.bearing_rad)))
    mean, freedom, square_sum = np.full(len(seen.time_s), np.nan), 0, 0.0
    for one in np.unique(number[there]):
        rows, scan = there[number[there] == one], scans.scan(int(one), np.zeros(3))
        near = np.hypot(*(scan.point.T[:, None] - place[:, rows, None])) <= AROUND_M
        for row, met in zip(rows, near, strict=True):
            if scan.value is not None and met.any():
                reported = scan.value[met]
                mean[row] = reported.mean()
                freedom += len(reported) - 1
                square_sum += float(np.square(reported - mean[row]).sum())
    return mean, max(square_sum / max(freedom, 1), (LEAST_SHARE * _unit(mean)) ** 2)


def _unit(value: Array) -> float:
    """The median size of values (M,), of those that are known; 1 where that is zero."""
    reported = value[~np.isnan(value)]
    return float(np.median(np.abs(reported))) or 1.0 if len(reported) else 1.0


def no_estimates() -> AttributeEstimates:
    """A memory that has seen nothing yet."""
    return AttributeEstimates(np.full(2, REPEATS))


def check_attributes(log: Log, choice: str) -> None:
    """Raises InputError where they are asked for and the log does not have them."""
    if choice == "off":
        return
    if choice == "layer":
        if log.scans is None or not log.scans.measures_intensity:
            raise InputError(
                f"{log.name}: holds no scans with intensities; use --attributes on or off"
            )
        return
    if np.isnan(log.measurements.diameter_m).all() and np.isnan(log.measurements.intensity).all():
        raise InputError(
            f"{log.name}: its measurements hold no diameter and no intensity; use --attributes off"
        )
