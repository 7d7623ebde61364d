"""What logs of scans alone have in common."""

from __future__ import annotations

import numpy as np

from comparisons.logs.log import LandmarkMeasurements

PRIOR_SIGMA = 1e-6


def no_measurements() -> LandmarkMeasurements:
    """What a log of scans alone brings."""
    return LandmarkMeasurements.of(np.zeros(0), np.zeros((0, 2)), np.zeros(2))
