"""Misono's EKF-SLAM, as published and with what it leaves out (Misono et al. 2007, section 3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ekf_reference.association.nearest_neighbour import Association
from ekf_reference.core.ekf import Ekf, PoseReading, Stabilisation, StepNoise
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.measurement_update import PositionFixes
from ekf_reference.core.state import Correction, FilterDivergedError, KalmanState
from ekf_reference.core.trace import (
    Beginning,
    FusionUse,
    NullTrace,
    PositionUse,
    Prediction,
    Removal,
    SightingUse,
    Trace,
)
from ekf_reference.filters.direction_cosine import (
    DirectionCosineMotion,
    DirectionCosinePosition,
    OwnAxesObservation,
    along_circle,
    from_heading,
    to_heading,
)
from ekf_reference.models.motion import MotionModel

RADIAL_VARIANCE = 1e-12
"""Of the pair's length, in the prior and added by every step where it is free. Without it the
covariance of four numbers that are known as three would be singular (Nieto 2005, section 2.1.1)."""


LEAST_LENGTH = 0.1
"""A pair shorter than this, or longer than its inverse, no longer says where the vehicle points."""


class FreePairState(KalmanState):
    """The pair goes where updates take it, as published, until it means no direction any more."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Fuse; FilterDivergedError, and nothing fused, where the pair has lost its length."""
        length = float(np.hypot(*self.pose[2:]))
        if not LEAST_LENGTH <= length <= 1.0 / LEAST_LENGTH:
            raise FilterDivergedError(
                f"the cosine and sine of the heading have the length {length:.2g} in place of 1"
            )
        return super().update(columns, jacobian, innovation, noise)


class CircleState(KalmanState):
    """Keeps the pair on the unit circle: after every update it is renormalised.

    The correction along the circle is taken as a turn by so much, and what points off it is
    dropped from mean and covariance. Dividing by the length would turn by the arctangent instead;
    this way the filter is the one on x, y, heading, exactly.
    """

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Fuse, then go back to the circle."""
        before = self.pose
        done = super().update(columns, jacobian, innovation, noise)
        after = self.pose
        tangent = along_circle(before)
        turn = float(tangent[2:, 2] @ (after[2:] - before[2:]))
        cos, sin = math.cos(turn), math.sin(turn)
        after[2:] = np.array([[cos, -sin], [sin, cos]]) @ before[2:]
        after[2:] /= np.hypot(after[2], after[3])
        self.predict(after, along_circle(after) @ tangent.T, np.zeros((4, 4)))
        return done


@dataclass(frozen=True)
class PairStabilisation:
    """The stabilisation noise of x, y, heading on x, y, xi, eta. radial_variance: per step."""

    heading: StepNoise
    radial_variance: float

    def covariance(self, duration_s: float, pose: Array) -> Array:
        """(4, 4) noise of a step that arrives at a pose (4,)."""
        lift = along_circle(pose)
        return _off_circle(pose, self.radial_variance) + (
            lift @ self.heading.covariance(duration_s, pose[:3]) @ lift.T
        )


@dataclass(frozen=True)
class DirectionCosineOptions:
    """What is added to the published filter; as it stands, nothing is.

    full_jacobian: sightings are linearised by the pair, too (OwnAxesObservation). renormalise:
    every update goes back to the circle (CircleState).
    """

    full_jacobian: bool = False
    renormalise: bool = False


AS_PUBLISHED = DirectionCosineOptions()


class DirectionCosineEkf(Ekf):
    """The full filter's steps on x, y, xi, eta; poses are read as x, y, heading.

    The trace of a renormalised filter is written in x, y, heading, for it has no error off the
    circle; otherwise it has all four.
    """

    def __init__(
        self,
        motion: MotionModel,
        association: Association,
        prior_pose: Array,
        prior_covariance: Array,
        stabilisation: StepNoise | None = None,
        trace: Trace | None = None,
        *,
        options: DirectionCosineOptions = AS_PUBLISHED,
    ) -> None:
        """prior_pose: (3,) and prior_covariance: (3, 3) of x, y, heading, as in Ekf."""
        renormalise = options.renormalise
        pose, free = from_heading(prior_pose), 0.0 if renormalise else RADIAL_VARIANCE
        lift = along_circle(pose)
        covariance = lift @ prior_covariance @ lift.T + _off_circle(pose, free)
        trace = trace or NullTrace()
        self.renormalise = renormalise
        self._heading_rad = float(prior_pose[2])
        super().__init__(
            DirectionCosineMotion(motion),
            association,
            pose,
            covariance,
            PairStabilisation(stabilisation or Stabilisation(), free),
            HeadingTrace(trace, self._heading_rad) if renormalise else trace,
        )
        self.observation = OwnAxesObservation(options.full_jacobian)
        self.fixes = PositionFixes(DirectionCosinePosition())
        self.state = (CircleState if renormalise else FreePairState)(pose, covariance)

    def read_pose(self) -> PoseReading:
        """The pose now; its heading goes on from where it was read last, unwrapped."""
        own = self.state.pose
        self._heading_rad = _nearest(self._heading_rad, own)
        return PoseReading(np.array([own[0], own[1], self._heading_rad]), own, to_heading(own))

    def read_recorded_pose(self) -> PoseReading:
        """The pose now, against the trace's."""
        reading = self.read_pose()
        if self.renormalise:
            return PoseReading(reading.pose, reading.pose, np.eye(3))
        return reading


class HeadingTrace:
    """Writes down a filter on the circle as one of x, y, heading."""

    def __init__(self, trace: Trace, heading_rad: float) -> None:
        """Trace: who keeps it. heading_rad: the prior's, from which headings go on unwrapped."""
        self._trace = trace
        self._heading_rad = heading_rad

    def prior(self, start: Beginning) -> None:
        """The covariance along the circle."""
        back = along_circle(start.pose).T
        self._trace.prior(Beginning(self._pose(start.pose), back @ start.covariance @ back.T))

    def prediction(self, step: Prediction) -> None:
        """F and Q along the circle."""
        back = along_circle(step.arrived).T
        f = back @ step.f @ along_circle(step.departed)
        q = back @ step.q @ back.T
        departed = self._pose(step.departed)
        self._trace.prediction(Prediction(departed, self._pose(step.arrived), f, q))

    def update(self, use: SightingUse) -> None:
        """H along the circle."""
        self._trace.update(self._sightings(use))

    def augmentation(self, use: SightingUse) -> None:
        """G_x along the circle."""
        self._trace.augmentation(self._sightings(use))

    def position(self, use: PositionUse) -> None:
        """H along the circle."""
        jacobian = use.jacobian_pose @ along_circle(use.pose)
        self._trace.position(use._replace(pose=self._pose(use.pose), jacobian_pose=jacobian))

    def oriented_update(self, use: SightingUse) -> None:
        """H along the circle."""
        self._trace.oriented_update(self._sightings(use))

    def oriented_augmentation(self, use: SightingUse) -> None:
        """G_x along the circle."""
        self._trace.oriented_augmentation(self._sightings(use))

    def fusion(self, use: FusionUse) -> None:
        """Pass on: the pose has no part in it."""
        self._trace.fusion(use)

    def removal(self, gone: Removal) -> None:
        """Pass on, the pose having one entry less."""
        self._trace.removal(gone._replace(entries=gone.entries - 1))

    def _sightings(self, use: SightingUse) -> SightingUse:
        jacobian = use.jacobian_pose @ along_circle(use.pose)
        return use._replace(pose=self._pose(use.pose), jacobian_pose=jacobian)

    def _pose(self, own: Array) -> Array:
        self._heading_rad = _nearest(self._heading_rad, own)
        return np.array([own[0], own[1], self._heading_rad])


def _nearest(heading_rad: float, own: Array) -> float:
    """The heading of a pose (4,), unwrapped to lie nearest to the one given.

    Of that one only the whole turns are kept: reading more often must not change a bit.
    """
    wrapped = math.atan2(own[3], own[2])
    turns = round((heading_rad - wrapped) / (2.0 * math.pi))
    return wrapped + turns * 2.0 * math.pi


def _off_circle(pose: Array, variance: float) -> Array:
    """(4, 4) covariance of the pair's length alone."""
    across = np.array([0.0, 0.0, pose[2], pose[3]])
    return variance * np.outer(across, across)
