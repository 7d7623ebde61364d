"""The motion since the last sampled pose, as one Gaussian that all particles share."""

from __future__ import annotations

import numpy as np

from ekf_reference.core.ekf import StepNoise
from ekf_reference.core.geometry import Array, rotation
from ekf_reference.models.motion import MotionModel


class AccumulatedMotion:
    """Mean and covariance of the motion, in the frame of the last sampled pose.

    The vehicle models are SE(2)-equivariant: moving the start moves the result alike. So one
    Gaussian, predicted as the EKF does from the origin, holds for every particle in its own frame;
    a noise that depends on the place or heading on the map is not served.

    mean: (3,) x, y, heading in the departing frame. covariance: (3, 3), additive there.
    """

    def __init__(self) -> None:
        """Start without motion."""
        self.mean: Array = np.zeros(3)
        self.covariance: Array = np.zeros((3, 3))

    def add(
        self,
        model: MotionModel,
        control: Array,
        control_covariance: Array,
        duration_s: float,
        stabilisation: StepNoise,
    ) -> None:
        """Append a step.

        Args:
            model: The vehicle model, SE(2)-equivariant.
            control: (m,) in the model's units, constant during the step.
            control_covariance: (m, m) of the control's error.
            duration_s: The step's [s].
            stabilisation: Noise that every step adds, the same in all frames.

        Source: Nieto 2005, eqs. 2.32 to 2.36.
        """
        pose, f, b = model.step(self.mean, control, duration_s)
        noise = b @ control_covariance @ b.T + stabilisation.covariance(duration_s, pose)
        self.mean, self.covariance = pose, f @ self.covariance @ f.T + noise

    def root_at_arrival(self) -> Array:
        """Return a root (3, 3) of the covariance, P = root root^T, in the frame of the arrival.

        The covariance may be singular: a root by eigenvalues exists in any case.
        """
        turned = np.eye(3)
        turned[:2, :2] = rotation(-float(self.mean[2]))
        value, vector = np.linalg.eigh(self.covariance)
        root: Array = turned @ (vector * np.sqrt(np.maximum(value, 0.0)))
        return root


def moved(pose: Array, step: Array) -> Array:
    """Return poses moved by steps that are seen in their own frames.

    Args:
        pose: (N, 3) x, y [m], heading [rad].
        step: (3,) the same for all, or (N, 3): forward, left [m], turn [rad].

    Returns:
        (N, 3). Headings are added without wrapping.
    """
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    forward, left, turn = step.T
    east, north = cos * forward - sin * left, sin * forward + cos * left
    found: Array = pose + np.stack((east, north, turn + np.zeros(len(pose))), axis=1)
    return found
