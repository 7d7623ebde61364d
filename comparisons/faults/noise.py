"""Faults of what the filter takes the noise to be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.fault import Fault, Plant, observing, stepping
from ekf_reference.core.landmark_types import NewLandmarks


def _sigma(change: Callable[[Array], Array]) -> Plant:
    """R by other sigmas (m, 2)."""
    return observing(measured=lambda original, z, sigma: original(z, change(sigma)))


def _control(change: Callable[[Array], Array]) -> Plant:
    """Q by another covariance of the control."""
    return stepping(predict=lambda original, u, covariance, dt: original(u, change(covariance), dt))


def new_landmarks(updates: float, new: float) -> Plant:
    """R times a factor in updates, and times another for new landmarks."""

    def invert(original: Any, *args: Array) -> NewLandmarks:
        landmarks: NewLandmarks = original(*args)
        return landmarks._replace(jacobian_z=np.sqrt(new / updates) * landmarks.jacobian_z)

    return observing(
        measured=lambda original, z, sigma: original(z, np.sqrt(updates) * sigma), invert=invert
    )


FAULTS = {
    "sigma squared twice": Fault("R holds sigma^4", _sigma(lambda sigma: sigma**2)),
    "sigma for variance in R": Fault("R holds sigma", _sigma(np.sqrt)),
    "twice the variance in R": Fault(
        "R holds 2 sigma^2",
        observing(measured=lambda original, z, sigma: (z, 2.0 * original(z, sigma)[1])),
    ),
    "degrees for radians in R": Fault(
        "the bearing's sigma is in degrees", _sigma(lambda sigma: sigma * (1.0, np.degrees(1.0)))
    ),
    "sigma for variance in Q": Fault("the control's covariance holds sigma", _control(np.sqrt)),
    "twice the variance in Q": Fault(
        "the control's covariance is doubled", _control(lambda covariance: 2.0 * covariance)
    ),
}
