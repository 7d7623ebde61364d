"""What logs of scans alone have in common."""

from __future__ import annotations

import numpy as np

from comparisons.logs.log import LandmarkMeasurements

PRIOR_SIGMA = 1e-6


def no_measurements() -> LandmarkMeasurements:
    """What a log of scans alone brings."""
    none = np.zeros(0)
    return LandmarkMeasurements(
        time_s=none,
        range_m=none,
        bearing_rad=none,
        sigma_range_m=none,
        sigma_bearing_rad=none,
        landmark=np.zeros(0, dtype=np.int64),
    )
