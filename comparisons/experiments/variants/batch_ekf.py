"""EKF-SLAM of many runs at once, with a choice of where it linearises.

A step is predict, then observe. All runs see the same landmarks at the same time and know which.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.experiments.variants.batch_models import (
    BatchSensor,
    control_jacobian,
    turned,
    unicycle,
)
from comparisons.experiments.variants.batch_state import BatchInvariantState, BatchState
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.linearisation import Linearisation


@dataclass(frozen=True)
class Robot:
    """What a filter knows of the robot. sigma_odometry: of speed and yaw rate, per step."""

    pose: Array
    covariance: Array
    sensor: BatchSensor
    step_s: float
    sigma_odometry: Array


class BatchFilter(Protocol):
    """Contract of the filters."""

    @property
    def state(self) -> BatchState:
        """The runs' Gaussians."""
        ...

    @property
    def label(self) -> Index:
        """(L,) landmarks' labels, in the state's order."""
        ...

    def predict(self, control: Array) -> None:
        """Move under measured (v, omega), (B, 2)."""
        ...

    def observe(self, z: Array, sigma: Array, label: Index) -> None:
        """Fuse one instant's measurements (B, m, 2), sigmas (m, 2), of distinct landmarks (m,)."""
        ...


class _Labelled:
    """Which landmark is where in the state. label: (L,), in the state's order."""

    def __init__(self) -> None:
        self.label: Index = np.zeros(0, dtype=np.intp)

    def _split(self, label: Index) -> tuple[Index, Index, Index]:
        """Rows seen before, their landmark_indices, and rows that are new."""
        same = label[:, None] == self.label
        known = same.any(axis=1)
        return np.flatnonzero(known), np.nonzero(same)[1], np.flatnonzero(~known)


class BatchEkf(_Labelled):
    """The EKF with additive errors; where it linearises is its only freedom."""

    def __init__(self, robot: Robot, linearisation: Linearisation, runs: int, capacity: int):
        """capacity: the most landmarks there may be."""
        super().__init__()
        self._robot, self._linearisation = robot, linearisation
        self.state = BatchState(robot.pose, robot.covariance, runs, capacity)
        linearisation.start(self.state.pose)

    def predict(self, control: Array) -> None:
        """P becomes Phi P Phi^T + B Q B^T."""
        robot, state, points = self._robot, self.state, self._linearisation
        arrival = unicycle(state.pose, control, robot.step_s)
        departed, by = points.control(state, control) or (state.pose, control)
        b = control_jacobian(departed[:, 2], by, robot.step_s)
        noise = (b * robot.sigma_odometry**2) @ b.transpose(0, 2, 1)
        travel = points.step(state, arrival)
        if travel is None:
            travel = arrival[:, :2] - state.pose[:, :2]
        state.predict(arrival, travel, noise)

    def observe(self, z: Array, sigma: Array, label: Index) -> None:
        """Update with what is known, then begin what is new, at the updated pose."""
        old, landmark_index, new = self._split(label)
        if len(old):
            self._update(z[:, old], sigma[old], landmark_index)
        if len(new):
            self._augment(z[:, new], sigma[new], label[new])

    def _update(self, z: Array, sigma: Array, landmark_index: Index) -> None:
        sensor, pose = self._robot.sensor, self.state.pose
        offset = self.state.landmarks[:, landmark_index] - pose[:, None, :2]
        innovation = sensor.innovation(z, sensor.predict(pose[:, 2:], offset))
        at = self._linearisation.measurement(self.state, landmark_index, POINT)
        heading, lever = _seen_from(*(at or (pose, self.state.landmarks[:, landmark_index])))
        matrix = sensor.by_offset(heading, lever)
        self.state.update(landmark_index, matrix, lever, innovation, sigma**2)

    def _augment(self, z: Array, sigma: Array, label: Index) -> None:
        sensor, pose = self._robot.sensor, self.state.pose
        point = pose[:, None, :2] + sensor.offset(pose[:, 2:], z)
        at = self._linearisation.initialisation(self.state, point, POINT)
        heading, lever = _seen_from(*(at or (pose, point)))
        by_measurement = np.linalg.inv(sensor.by_offset(heading, lever))
        spread = (by_measurement * sigma[:, None] ** 2) @ by_measurement.transpose(0, 1, 3, 2)
        self._linearisation.append(self.state, point, POINT)
        self.state.augment(point, lever, spread)
        self.label = np.concatenate((self.label, label))


def _seen_from(pose: Array, landmark: Array) -> tuple[Array, Array]:
    """Headings (B, 1) of poses (B, 3), and offsets (B, m, 2) of landmarks from these."""
    return pose[:, 2:], landmark - pose[:, None, :2]


class BatchInvariantEkf(_Labelled):
    """The right-invariant EKF (Barrau and Bonnabel 2015): its errors do not see the heading."""

    def __init__(self, robot: Robot, runs: int, capacity: int):
        """capacity: the most landmarks there may be."""
        super().__init__()
        self._robot = robot
        start = np.eye(3)
        start[:2, 2] = -turned(robot.pose[:2])
        covariance = start @ robot.covariance @ start.T
        self.state = BatchInvariantState(robot.pose, covariance, runs, capacity)

    def predict(self, control: Array) -> None:
        """Phi is the identity; a turn that went wrong shows in every point."""
        robot, state = self._robot, self.state
        arrival = unicycle(state.pose, control, robot.step_s)
        b = control_jacobian(state.pose[:, 2], control, robot.step_s)
        gamma = np.zeros((*state.mean.shape, 2))
        gamma[:, :3] = b
        gamma[:, :2] -= turned(arrival[:, :2])[..., None] * b[:, None, 2]
        arm = turned(state.landmarks).reshape(len(arrival), -1)
        gamma[:, 3:] = -arm[..., None] * b[:, None, 2]
        state.predict_invariant(arrival, gamma, robot.sigma_odometry**2)

    def observe(self, z: Array, sigma: Array, label: Index) -> None:
        """Update with what is known, then begin what is new, at the updated pose."""
        sensor, state = self._robot.sensor, self.state
        old, landmark_index, new = self._split(label)
        if len(old):
            offset = state.landmarks[:, landmark_index] - state.pose[:, None, :2]
            heading = state.pose[:, 2:]
            innovation = sensor.innovation(z[:, old], sensor.predict(heading, offset))
            matrix = sensor.by_offset(heading, offset)
            state.update(landmark_index, matrix, None, innovation, sigma[old] ** 2)
        if len(new):
            heading = state.pose[:, 2:]
            offset = sensor.offset(heading, z[:, new])
            by_measurement = np.linalg.inv(sensor.by_offset(heading, offset))
            spread = (by_measurement * sigma[new, None] ** 2) @ by_measurement.transpose(0, 1, 3, 2)
            state.augment(state.pose[:, None, :2] + offset, np.zeros_like(offset), spread)
            self.label = np.concatenate((self.label, label[new]))
