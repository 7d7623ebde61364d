"""States that only receive information (Nieto 2005, section 3.7.1, Example 3.3).

Beside a filter of n entries, q pairs of passive states need their covariance with it, 2 q x n, and
each pair its own, but no covariance with each other. They take the place of the filter's trace,
read every linearisation as it was used, and write nothing: the filter stays the same to the bit.
"""

from typing import NamedTuple

import numpy as np

from ekf_reference.core.blocks import block_diagonal, stack
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.state import KalmanState
from ekf_reference.core.trace import VEHICLE, MeasurementRecord, RemovalRecord, StepRecord, Trace
from ekf_reference.dense.triangles import local_jacobians, to_local


class Watched(NamedTuple):
    """Pairs of states x = x0 + J (state - state0) + w, w ~ N(0, noise), all at one instant.

    value: (k, 2). landmark_index: (k, m) the landmarks that each depends on. jacobian: (k, 2, 3 + 2
    m) by the pose and these. noise: (k, 2, 2).
    """

    value: Array
    landmark_index: Index
    jacobian: Array
    noise: Array


class PassiveStates(Trace):
    """q pairs of passive states beside a running filter, exactly as if they were in its state.

    value: (q, 2) now. initial: (q, 2) when they were first watched. cross: (2 q, n) covariance with
    the filter's state. own: (q, 2, 2).
    """

    def __init__(self, ekf: Ekf) -> None:
        """Take the place of the filter's trace, which goes on receiving everything.

        Raises TypeError for a filter whose updates do more than its trace says, or whose
        covariance cannot be read without changing later rounding (compressed ones).
        """
        if type(ekf.state) is not KalmanState or len(ekf.state.pose) != 3:
            raise TypeError(
                f"{type(ekf).__name__} keeps a {type(ekf.state).__name__} of "
                f"{len(ekf.state.pose)} pose entries, expected a KalmanState of 3"
            )
        self.value = np.empty((0, 2))
        self.initial = np.empty((0, 2))
        self.cross = np.empty((0, len(ekf.state.mean)))
        self.own = np.empty((0, 2, 2))
        self._ekf, self._next = ekf, ekf.trace
        ekf.trace = self

    @property
    def change(self) -> Array:
        """(q, 2) what eq. 3.16 adds up to since the states were first watched."""
        return self.value - self.initial

    def watch(self, new: Watched) -> Index:
        """Append pairs of states, correlated through the filter's (3.2); returns numbers (k,)."""
        p = self._ekf.state.covariance
        columns = [
            self._ekf.state.layout.columns(landmark_index) for landmark_index in new.landmark_index
        ]
        cross = [j @ p[c] for j, c in zip(new.jacobian, columns, strict=True)]
        own = [x[:, c] @ j.T for x, c, j in zip(cross, columns, new.jacobian, strict=True)]
        first = len(self.value)
        self.value = np.concatenate((self.value, new.value))
        self.initial = np.concatenate((self.initial, new.value))
        self.cross = np.concatenate((self.cross, *cross))
        self.own = np.concatenate((self.own, np.reshape(own, (-1, 2, 2)) + new.noise))
        return np.arange(first, len(self.value))

    def prior(self, pose: Array, covariance: Array) -> None:
        """Pass on."""
        self._next.prior(pose, covariance)

    def step(self, step: StepRecord) -> None:
        """C_v <- C_v F^T: the vehicle moves, passive states do not."""
        self.cross[:, :3] = self.cross[:, :3] @ step.f.T
        self._next.step(step)

    def measurement(self, used: MeasurementRecord) -> None:
        """Fused measurements, whatever they are of."""
        layout, columns = self._ekf.state.layout, np.arange(3)
        if used.kind is not None and used.origin == VEHICLE:
            columns = layout.columns(used.landmark_index, used.kind)
        elif used.kind is not None:
            both = np.append(used.origin, used.landmark_index)
            columns = layout.columns(both, used.kind)[3:]
        jacobian = stack(used.jacobian_pose, used.jacobian_other)
        self._receive(columns, jacobian, used.innovation.ravel(), block_diagonal(used.noise))
        self._next.measurement(used)

    def initialisation(self, new: MeasurementRecord) -> None:
        """Columns C_v G_x^T of the new landmarks; what they add of their own is independent."""
        stacked = new.jacobian_pose.reshape(-1, 3)
        self.cross = np.hstack((self.cross, self.cross[:, :3] @ stacked.T))
        self._next.initialisation(new)

    def removal(self, gone: RemovalRecord) -> None:
        """Columns of landmarks that went."""
        self.cross = np.delete(self.cross, gone.entries, axis=1)
        self._next.removal(gone)

    def _receive(self, columns: Index, jacobian: Array, innovation: Array, noise: Array) -> None:
        """What an update of the filter does to states it did not see (Nieto 2005, eq. 3.16).

        columns: (c,) state entries of the observation. jacobian: (m, c). innovation: (m,). noise:
        (m, m). The trace speaks after the fact, when the covariance is P+ already. From it
        S^-1 = R^-1 - R^-1 H P+ H^T R^-1 and the gain is P+ H^T R^-1. The trap: digits of S^-1 are
        lost as H P H^T outgrows R, all of them at 1e16, which only a boundless prior comes near.
        """
        if not len(self.value):
            return
        weight = np.linalg.inv(noise)
        gain = self._ekf.state.covariance[:, columns] @ (jacobian.T @ weight)
        inverse = weight - weight @ jacobian @ gain[columns]
        seen = self.cross[:, columns] @ jacobian.T  # C H^T, (2 q, m)
        share = seen @ (0.5 * (inverse + inverse.T))
        pairs = (len(self.value), 2, -1)
        self.value = self.value + (share @ innovation).reshape(-1, 2)
        self.own = self.own - share.reshape(pairs) @ seen.reshape(pairs).transpose(0, 2, 1)
        self.cross -= seen @ gain.T


def points(observation: MeasurementModel, pose: Array, z: Array, noise: Array) -> Watched:
    """Where what is seen at z (k, 2) with noise (k, 2, 2) from pose (3,) is, as passive states."""
    new = observation.invert(pose, z)
    spread = new.jacobian_z @ noise @ new.jacobian_z.transpose(0, 2, 1)
    nothing = np.empty((len(z), 0), dtype=np.intp)
    return Watched(new.landmark, nothing, new.jacobian_pose, spread)


def local_coordinates(seen: Watched, base: Index, landmark: Array) -> Watched:
    """Alpha and beta of points in their triangles, as passive states.

    Their change is the error of a dense map, which keeps them (Nieto 2005, section 3.6).

    seen: from `points`. base: (k, 3) places of L1, L2, L3. landmark: (L, 2) [m]. Raises
    DegenerateTriangleError.
    """
    triangle = landmark[base]
    h = local_jacobians(triangle, seen.value)
    jacobian = np.concatenate((h.by_point @ seen.jacobian, h.by_landmarks), axis=-1)
    noise = h.by_point @ seen.noise @ h.by_point.transpose(0, 2, 1)
    return Watched(to_local(triangle, seen.value), base, jacobian, noise)


class StaleCross(PassiveStates):
    """Broken: what a measurement does to the covariance with the filter is forgotten."""

    def _receive(self, columns: Index, jacobian: Array, innovation: Array, noise: Array) -> None:
        kept = self.cross.copy()
        super()._receive(columns, jacobian, innovation, noise)
        self.cross = kept
