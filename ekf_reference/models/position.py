"""Absolute positions, such as those of a satellite receiver (Guivant 2002, section 4.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.core.measurement_update import UpdateSplitter

POSITION_SPLITTER = UpdateSplitter(largest_turn_rad=np.deg2rad(1.0), largest_move_m=1.0)


class AbsolutePosition(Protocol):
    """Contract of all models of an absolute position."""

    def predict(self, T_world_vehicle: Array) -> tuple[Array, Array]:
        """Predict the position of the antenna.

        Args:
            T_world_vehicle: (p,) the pose.

        Returns:
            The position (2,) east, north [m], and its Jacobian (2, p) by the pose.
        """


@dataclass(frozen=True)
class PositionModel:
    """An antenna at `lever_m` (forward, left) of the vehicle's reference point."""

    lever_m: tuple[float, float] = (0.0, 0.0)

    def predict(self, T_world_vehicle: Array) -> tuple[Array, Array]:
        """Predict from a pose (3,)."""
        forward, left = self.lever_m
        cos, sin = np.cos(T_world_vehicle[2]), np.sin(T_world_vehicle[2])
        east, north = cos * forward - sin * left, sin * forward + cos * left
        p_antenna_world = T_world_vehicle[:2] + (east, north)
        return p_antenna_world, np.array([[1.0, 0.0, -north], [0.0, 1.0, east]])


class Streak(NamedTuple):
    """Fixes beyond the gate, each as far off as the one before: the filter may be what is wrong.

    length: of it. innovation: (2,) of the last once it was fused or rejected. covariance: (2, 2),
    its R.
    """

    length: int = 0
    innovation: Array = np.zeros(2)
    covariance: Array = np.eye(2)

    def length_with(self, innovation: Array, covariance: Array, gate: float) -> int:
        """Return the length with one more fix beyond the gate.

        Args:
            innovation: (2,) of the fix [m].
            covariance: (2, 2), its R [m^2].
            gate: Normalised squared difference from the last fix up to which it continues the
                streak.

        Returns:
            One more than before, or 1 where the fix starts a streak of its own.
        """
        apart = innovation - self.innovation
        agrees = apart @ np.linalg.solve(covariance + self.covariance, apart) <= gate
        return self.length + 1 if agrees else 1


@dataclass(frozen=True)
class PositionFixes:
    """How absolute positions are fused.

    gate: normalised innovation squared (2 degrees of freedom) beyond which a fix is rejected; a
    wrong fix fused in silence is worse than none. recovery: so many rejected fixes in a streak
    re-admit those that continue it, None for never. splitter: how far one part may move the
    vehicle.
    """

    model: AbsolutePosition = PositionModel()
    gate: float = 13.82  # 99.9 %
    splitter: UpdateSplitter = POSITION_SPLITTER
    recovery: int | None = None
