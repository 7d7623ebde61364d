"""What a log's measurements tell of their landmarks besides where they are, and how surely."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.log import Log
from ekf_reference.association.attributes import AttributeEstimates
from ekf_reference.core.measurements import MeasuredAttributes

BRIGHTNESS = 1
"""Column of the intensity."""
SIGMA_WIDTH_RAD = 0.006
SIGMA_SHAPE_M = 0.05
"""Of a diameter (Guivant 2002, eq. 15). Set by hand, so that differences between measurements of
one tree, more than a minute apart on Victoria Park, have a mean normalised square of about one,
near and far (0.96 to 1.33; research/attributes.py): least squares would follow the outliers, 0.15
m at any range. The first is 1.7 times what beams half a degree apart explain."""
SIGMA_INTENSITY = 0.45
"""Of an intensity, as a share of the median over the log, for its unit is the sensor's own; from
the spread within the reflectors of the ACFR car park."""
REPEATS = 12.0
"""Measurements that equal one independent one: the sum of the autocorrelation of what is left
of diameters on Victoria Park, measurement by measurement."""


def measured_attributes(log: Log) -> MeasuredAttributes:
    """Diameter and intensity of each measurement (M, 2), NaN where the log has none."""
    measurements = log.measurements
    variance = np.empty((len(measurements.time_s), 2))
    variance[:, 0] = (measurements.range_m * SIGMA_WIDTH_RAD) ** 2 + SIGMA_SHAPE_M**2
    intensity = measurements.intensity
    variance[:, BRIGHTNESS] = (SIGMA_INTENSITY * _unit(intensity)) ** 2
    return MeasuredAttributes(np.column_stack((measurements.diameter_m, intensity)), variance)


def _unit(value: Array) -> float:
    """The median size of values (M,), of those that are known; 1 where that is zero."""
    reported = value[~np.isnan(value)]
    return float(np.median(np.abs(reported))) or 1.0 if len(reported) else 1.0


def no_estimates() -> AttributeEstimates:
    """A memory that has seen nothing yet."""
    return AttributeEstimates(np.full(2, REPEATS))


def check_attributes(log: Log) -> None:
    """Raises InputError where the log has none."""
    if np.isnan(log.measurements.diameter_m).all() and np.isnan(log.measurements.intensity).all():
        raise InputError(
            f"{log.name}: its measurements hold no diameter and no intensity; use --attributes off"
        )
