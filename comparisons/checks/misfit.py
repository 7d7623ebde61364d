"""How far measurements lie from where an estimate expects them, in units of their own noise."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.logs.log import LandmarkMeasurements
from ekf_reference.models.range_bearing import RangeBearing


def squared_misfit(
    measurements: LandmarkMeasurements, rows: Index, pose: Array, landmark: Array
) -> Array:
    """(m,) of some measurements (m,), each from a pose (m, 3) of a landmark (m, 2); 2 is usual."""
    model = RangeBearing()
    z = np.column_stack((measurements.range_m, measurements.bearing_rad))[rows]
    sigma = np.column_stack((measurements.sigma_range_m, measurements.sigma_bearing_rad))[rows]
    innovation = model.innovation(z, model.predict(pose.T, landmark).z)
    squared: Array = np.sum((innovation / sigma) ** 2, axis=1)
    return squared
