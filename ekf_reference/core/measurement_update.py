"""Absolute information, fused as a sequence of weaker updates (Guivant 2002, section 4.2).

One observation of covariance R counts as L observations of K_i R with sum 1 / K_i = 1. For a
linear observation that is the same update; for a nonlinear one every part is linearised where
the last one led, so that a strong correction does not rest on Jacobians taken far away. The same
serves a large correction at loop closing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.local_map import LocalMap
from ekf_reference.core.state import Correction

_WEAKEST = 2.0**-40


class Linearised(NamedTuple):
    """An observation at the present state.

    local: the pose and landmarks it depends on. jacobian: (m, p + 2 l) with respect to them.
    innovation: (m,), wrapped.
    """

    local: LocalMap
    jacobian: Array
    innovation: Array


class Part(NamedTuple):
    """One of the L updates: weight 1 / K_i, and the observation linearised anew."""

    weight: float
    at: Linearised


class Fused(NamedTuple):
    """A part, and what the filter did with it."""

    weight: float
    at: Linearised
    done: Correction


@dataclass(frozen=True)
class Steps:
    """How far one update may move the vehicle before it is split.

    largest_turn_rad, largest_move_m: bounds on heading and position. most: L at the most.
    """

    largest_turn_rad: float = float("inf")
    largest_move_m: float = float("inf")
    most: int = 64

    def split(self, linearise: Callable[[], Linearised], noise: Array) -> Iterator[Part]:
        """Yield parts until their weights add up to one; the caller fuses each with noise / weight.

        noise: (m, m), R. A weight is halved until the predicted correction of the pose is within
        the bounds; the first parts of a strong correction are therefore very weak. When only one
        part may follow, it takes what is left.
        """
        left = 1.0
        for remaining in range(self.most, 0, -1):
            at = linearise()
            weight = left
            while remaining > 1 and weight > _WEAKEST and not self._within(at, noise / weight):
                weight *= 0.5
            left -= weight
            yield Part(weight, at)
            if left == 0.0:
                return

    def _within(self, at: Linearised, noise: Array) -> bool:
        if self.largest_turn_rad == self.largest_move_m == float("inf"):
            return True
        step = _pose_step(at, noise)
        turn, move = float(np.linalg.norm(step[2:])), float(np.hypot(step[0], step[1]))
        return turn <= self.largest_turn_rad and move <= self.largest_move_m


class AbsolutePosition(Protocol):
    """Contract of all models of an absolute position."""

    def predict(self, pose: Array) -> tuple[Array, Array]:
        """Expected position (2,) and its Jacobian (2, p) with respect to the pose (p,)."""
        ...


@dataclass(frozen=True)
class PositionModel:
    """An antenna at `lever_m` (forward, left) of the vehicle's reference point."""

    lever_m: tuple[float, float] = (0.0, 0.0)

    def predict(self, pose: Array) -> tuple[Array, Array]:
        """Expected position (2,) and its Jacobian (2, 3) with respect to the pose."""
        forward, left = self.lever_m
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        east, north = cos * forward - sin * left, sin * forward + cos * left
        jacobian = np.array([[1.0, 0.0, -north], [0.0, 1.0, east]])
        return pose[:2] + (east, north), jacobian


@dataclass(frozen=True)
class PositionFixes:
    """How absolute positions are fused.

    gate: normalised innovation squared (2 degrees of freedom) beyond which a fix is rejected; a
    wrong fix fused in silence is worse than none. steps: how far one part may move the vehicle.
    """

    model: AbsolutePosition = PositionModel()
    gate: float = 13.82  # 99.9 %
    steps: Steps = Steps(largest_turn_rad=np.deg2rad(1.0), largest_move_m=1.0)

    def linearise(self, pose_only: LocalMap, z: Array) -> Linearised:
        """The observation of position z (2,) at the present pose."""
        expected, jacobian = self.model.predict(pose_only.pose)
        return Linearised(pose_only, jacobian, z - expected)

    def accepts(self, at: Linearised, covariance: Array) -> bool:
        """Whether the fix passes the gate."""
        return normalised_innovation_squared(at, covariance) <= self.gate


def normalised_innovation_squared(at: Linearised, noise: Array) -> float:
    """nu^T S^-1 nu (Nieto 2005, eq. 2.58) of a stacked observation."""
    s = at.jacobian @ at.local.covariance @ at.jacobian.T + noise
    return float(at.innovation @ np.linalg.solve(s, at.innovation))


def _pose_step(at: Linearised, noise: Array) -> Array:
    """(p,) what an update would add to the pose."""
    gain_left = at.local.covariance @ at.jacobian.T
    s = at.jacobian @ gain_left + noise
    step: Array = gain_left[: len(at.local.pose)] @ np.linalg.solve(s, at.innovation)
    return step


NO_LANDMARKS: Index = np.zeros(0, dtype=np.intp)
"""The slots of an observation of the pose alone."""
