"""Where a filter takes its Jacobians, and in which error it corrects: one argument of the filter.

The frame of the map is not observable: the Jacobians must not see a common shift or turn of vehicle
and landmarks, N = [I, J c; 0, 1; I, J l_1; I, J l_2; ...]. That holds for all time when every F
turns about the travel of c and every H uses the offset l - c, for one fixed l per landmark.

Poses are x, y, heading. Arrays may have leading axes: of many filters that run at once.
"""

from __future__ import annotations

from typing import ClassVar, Protocol

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.invariant_state import InvariantState, RobocentricState
from ekf_reference.core.landmark_types import KINDS, LandmarkKind
from ekf_reference.core.state import KalmanState

Points = tuple[Array, Array]
"""A pose (..., p) and landmarks (..., m, w) at which a Jacobian is taken."""


class MeanState(Protocol):
    """The estimate that a linearisation reads."""

    @property
    def pose(self) -> Array:
        """(..., p) of the vehicle."""

    def places(self, kind: LandmarkKind) -> Array:
        """Return all landmarks of a kind.

        Args:
            kind: Of the landmarks.

        Returns:
            (..., L, w) by landmark index; NaN where one was removed.
        """


class Linearisation:
    """At the newest estimate, in additive errors: the EKF. Base of the others.

    Each method is called before its event changes the state. None stands for the estimate itself.
    An object serves one filter.
    """

    state: ClassVar[type[KalmanState]] = KalmanState
    """Which error an update corrects."""

    def start(self, pose: Array) -> None:
        """Begin at a pose, with an empty map.

        Args:
            pose: (..., p) of the prior.
        """

    def control(self, state: MeanState, control: Array) -> Points | None:
        """Return where the Jacobian by the control is taken; called before `step`.

        Args:
            state: At the departure.
            control: (..., c) as measured.

        Returns:
            A pose (..., p) and a control (..., c).
        """
        return None

    def step(self, state: MeanState, arrived: Array) -> Array | None:
        """Return the displacement of F = [[I, J travel], [0, 1]].

        Args:
            state: At the departure.
            arrived: (..., p) pose at the arrival.

        Returns:
            (..., 2) travel [m].
        """
        return None

    def measurement(
        self, state: MeanState, landmark_index: Index, kind: LandmarkKind
    ) -> Points | None:
        """Return where H is taken, of landmarks that are in the map.

        Args:
            state: Before the update.
            landmark_index: (m,) landmark indices.
            kind: Of the landmarks.

        Returns:
            A pose (..., p) and landmarks (..., m, w).
        """
        return None

    def initialisation(self, state: MeanState, place: Array, kind: LandmarkKind) -> Points | None:
        """Return where the Jacobians of new landmarks are taken.

        Args:
            state: Before they are appended.
            place: (..., m, w) where they will be.
            kind: Of the landmarks.

        Returns:
            A pose (..., p) and landmarks (..., m, w).
        """
        return None

    def append(self, state: MeanState, place: Array, kind: LandmarkKind) -> None:
        """Note that landmarks are appended, surveyed ones among them.

        Args:
            state: Before they are.
            place: (..., m, w) where they will be.
            kind: Of the landmarks.
        """


class FirstEstimates(Linearisation):
    """The Jacobians of the first estimates: FEJ-EKF.

    c is the predicted position, l each landmark's first place, also where it is initialised, so
    that what cannot be observed stays so. Innovations are the current ones.

    Source: Huang, Mourikis and Roumeliotis 2008.
    """

    def start(self, pose: Array) -> None:
        """Begin at a pose (..., 3), without landmarks."""
        self.predicted: Array = pose.copy()
        self.first = {kind: np.zeros((*pose.shape[:-1], 0, kind.width)) for kind in KINDS}

    def step(self, state: MeanState, arrived: Array) -> Array | None:
        """Return the way from the predicted position before the update to the next one."""
        travel: Array = arrived[..., :2] - self.predicted[..., :2]
        self.predicted = arrived
        return travel

    def measurement(
        self, state: MeanState, landmark_index: Index, kind: LandmarkKind
    ) -> Points | None:
        """Return the predicted pose and the first estimates of the landmarks."""
        return self.predicted, self.first[kind][..., landmark_index, :]

    def initialisation(self, state: MeanState, place: Array, kind: LandmarkKind) -> Points | None:
        """Return the predicted pose, like that of the measurements of this instant."""
        return self.predicted, place

    def append(self, state: MeanState, place: Array, kind: LandmarkKind) -> None:
        """Keep where they begin: their first estimate."""
        self.first[kind] = np.concatenate((self.first[kind], place), axis=-2)


class ObservabilityConstrained(Linearisation):
    """Under the constraint that the frame is not observable, and near the estimate: OC-EKF.

    The points of the vehicle p* and of the landmarks l* at one time may all be moved by a common
    shift u against c and l. The shift is the least-squares one: the mean of what vehicle and all
    mapped landmarks have moved by; u comes with each prediction, for the measurements that follow.

    Source: Huang, Mourikis and Roumeliotis 2010.
    """

    def start(self, pose: Array) -> None:
        """Begin at a pose (..., 3), without landmarks."""
        self.anchor: Array = pose[..., :2].copy()
        self.first = {kind: np.zeros((*pose.shape[:-1], 0, kind.width)) for kind in KINDS}

    def step(self, state: MeanState, arrived: Array) -> Array | None:
        """Return the way from p* = c + u to the predicted position, which becomes the new c + u."""
        moved = np.concatenate(
            (
                (state.pose[..., :2] - self.anchor)[..., None, :],
                *((state.places(kind) - self.first[kind])[..., :2] for kind in KINDS),
            ),
            axis=-2,
        )
        present = np.isfinite(moved).all(axis=-1).reshape(-1, moved.shape[-2]).any(axis=0)
        if not present.all():
            moved = moved[..., present, :]
        shift = moved.mean(axis=-2)
        travel: Array = arrived[..., :2] - (self.anchor + shift)
        self.anchor = arrived[..., :2] - shift
        return travel

    def measurement(
        self, state: MeanState, landmark_index: Index, kind: LandmarkKind
    ) -> Points | None:
        """Return points with l* - p* = l - c, and the headings of the estimate."""
        pose, place = state.pose.copy(), self.first[kind][..., landmark_index, :].copy()
        pose[..., :2] = self.anchor
        place[..., 2:] = state.places(kind)[..., landmark_index, 2:]
        return pose, place

    def append(self, state: MeanState, place: Array, kind: LandmarkKind) -> None:
        """Put l where its offset is right from c."""
        first, offset = place.copy(), place[..., :2] - state.pose[..., None, :2]
        first[..., :2] = self.anchor[..., None, :] + offset
        self.first[kind] = np.concatenate((self.first[kind], first), axis=-2)


class RightInvariant(Linearisation):
    """At the estimate, in right-invariant errors of SE(2) with landmarks.

    F, Q, H and new landmarks are those of the EKF. Source: Barrau and Bonnabel 2015; Zhang et al.
    2017.
    """

    state = InvariantState


class Robocentric(Linearisation):
    """At the estimate, in the errors of origin and landmarks in the vehicle's frame.

    Source: Castellanos, Neira and Tardos 2004.
    """

    state = RobocentricState
