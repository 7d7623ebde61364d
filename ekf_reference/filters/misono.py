"""Misono's EKF-SLAM, as published and with what it leaves out (Misono et al. 2007, section 3).

The pose is x, y, xi, eta with xi = cos(heading) and eta = sin(heading) (eq. 3). Motion is linear
in it and measurements in the vehicle's own axes are bilinear, so nothing needs a trigonometric
function of the state. The price is a fourth number where three are free: the pair belongs on the
unit circle, and nothing in the published filter keeps it there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ekf_reference.core.ekf import Ekf, PoseReading, Stabilisation, StepNoise
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import (
    POINT,
    POSE,
    NewLandmarks,
    PredictedMeasurements,
)
from ekf_reference.core.measurements import Association
from ekf_reference.core.state import Correction, FilterDivergedError, KalmanState
from ekf_reference.core.trace import (
    VEHICLE,
    MeasurementRecord,
    RemovalRecord,
    StepRecord,
    Trace,
)
from ekf_reference.models.motion import MotionModel, MotionStep
from ekf_reference.models.position import PositionFixes
from ekf_reference.models.relative_pose import RelativePose

RADIAL_VARIANCE = 1e-12
"""Of the pair's length, in the prior and added by every step where it is free. Without it the
covariance of four numbers that are known as three would be singular (Nieto 2005, section 2.1.1)."""


LEAST_LENGTH = 0.1
"""A pair shorter than this, or longer than its inverse, no longer says where the vehicle points."""


def from_heading(pose: Array) -> Array:
    """(4,) x, y, xi, eta of (3,) x, y, heading."""
    return np.array([pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])])


def along_circle(pose: Array) -> Array:
    """(4, 3) d(x, y, xi, eta) / d(x, y, heading) where the pair (4,) is."""
    jacobian = np.zeros((4, 3))
    jacobian[0, 0] = jacobian[1, 1] = 1.0
    jacobian[2, 2], jacobian[3, 2] = -pose[3], pose[2]
    return jacobian


def to_heading(pose: Array) -> Array:
    """(3, 4) d(x, y, heading) / d(x, y, xi, eta), of atan2(eta, xi), on the circle or off it."""
    square = pose[2] ** 2 + pose[3] ** 2
    jacobian = np.zeros((3, 4))
    jacobian[0, 0] = jacobian[1, 1] = 1.0
    jacobian[2, 2], jacobian[2, 3] = -pose[3] / square, pose[2] / square
    return jacobian


@dataclass(frozen=True)
class DirectionCosineMotion:
    """Any vehicle model on this pose: x' = F x + B n (Misono 2007, eqs. 1 to 6 and 10).

    `motion` says how far the vehicle goes in its own frame: dx, dy and a turn. Eq. 4 is the case
    of a turn first and the way afterwards, dx = d cos(turn), dy = d sin(turn), where dx and dy
    stand beside xi and eta. Erratum: eq. 5 prints xi(k), eta(k) in B where the direction of
    arrival, k + 1, holds; the two differ by the turn.
    """

    motion: MotionModel

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """The pose (4,) after a control; jacobian_pose is F, jacobian_control is B."""
        own = self.motion.step(np.zeros(3), control, duration_s)
        dx, dy, turn = own.pose.tolist()
        cos, sin = math.cos(turn), math.sin(turn)
        f = np.array(
            [[1.0, 0.0, dx, -dy], [0.0, 1.0, dy, dx], [0.0, 0.0, cos, -sin], [0.0, 0.0, sin, cos]]
        )  # 4
        arrived = f @ pose
        b = along_circle(arrived) @ own.jacobian_control  # 5, the turn's part
        xi, eta = pose[2], pose[3]
        b[:2] = np.array([[xi, -eta], [eta, xi]]) @ own.jacobian_control[:2]  # 5, the way's part
        return MotionStep(arrived, f, b)


@dataclass(frozen=True)
class OwnAxesObservation:
    """A landmark in the vehicle's own axes, x to the right, y ahead (Misono 2007, eqs. 8, 9, 12).

    full_jacobian: eq. 9 has zeros for xi and eta, which makes the published filter a pseudo-linear
    one; true gives the columns that the bilinear measurement has.
    """

    full_jacobian: bool = True

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """Return ranges and bearings in the vehicle's axes: (m, 2) [m], R (m, 2, 2) [m^2]."""
        r, sin, cos = z[:, 0], np.sin(z[:, 1]), np.cos(z[:, 1])
        polar = np.empty((len(r), 2, 2))
        polar[:, 0, 0], polar[:, 0, 1] = -sin, -r * cos
        polar[:, 1, 0], polar[:, 1, 1] = cos, -r * sin
        noise = np.einsum("mij,mj,mkj->mik", polar, sigma**2, polar)
        return np.column_stack((-r * sin, r * cos)), noise

    def range_m(self, z: Array) -> Array:
        """(m,) distance from the vehicle."""
        distance: Array = np.hypot(z[:, 0], z[:, 1])
        return distance

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """H x and H for landmarks (m, 2) from pose (4,) (eqs. 9 and 12)."""
        x, y, xi, eta = pose.tolist()
        dx, dy = landmarks[:, 0] - x, landmarks[:, 1] - y
        z = np.column_stack((eta * dx - xi * dy, xi * dx + eta * dy))
        turn = np.array([[eta, -xi], [xi, eta]])
        jacobian_pose = np.zeros((len(z), 2, 4))
        jacobian_pose[:, :, :2] = -turn
        if self.full_jacobian:
            jacobian_pose[:, 0, 2], jacobian_pose[:, 0, 3] = -dy, dx
            jacobian_pose[:, 1, 2], jacobian_pose[:, 1, 3] = dx, dy
        return PredictedMeasurements(z, jacobian_pose, np.broadcast_to(turn, (len(z), 2, 2)))

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Innovation of eq. 14; no angle, nothing to wrap."""
        return z - predicted

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Places in the map of what is seen at z (m, 2) (eq. 16, its first row corrected).

        Erratum: the first row is printed (eta, -xi, ...), which is no inverse of eq. 9. The
        Jacobians, which the paper leaves out, are those of Nieto 2005, eq. 2.53.
        """
        x, y, xi, eta = pose.tolist()
        right, ahead = z[:, 0], z[:, 1]
        point = np.column_stack((x + eta * right + xi * ahead, y - xi * right + eta * ahead))
        jacobian_pose = np.zeros((len(z), 2, 4))
        jacobian_pose[:, 0, 0] = jacobian_pose[:, 1, 1] = 1.0
        jacobian_pose[:, 0, 2], jacobian_pose[:, 0, 3] = ahead, right
        jacobian_pose[:, 1, 2], jacobian_pose[:, 1, 3] = -right, ahead
        jacobian_z = np.broadcast_to(np.array([[eta, xi], [-xi, eta]]), (len(z), 2, 2))
        return NewLandmarks(point, jacobian_pose, jacobian_z)


@dataclass(frozen=True)
class DirectionCosinePosition:
    """An antenna at `lever_m` (forward, left): on this pose an absolute position is linear."""

    lever_m: tuple[float, float] = (0.0, 0.0)

    def predict(self, pose: Array) -> tuple[Array, Array]:
        """Expected position (2,) and its Jacobian (2, 4)."""
        forward, left = self.lever_m
        jacobian = np.array([[1.0, 0.0, forward, -left], [0.0, 1.0, left, forward]])
        return jacobian @ pose, jacobian


class PairRelativePose(RelativePose):
    """RelativePose on the pose x, y, xi, eta."""

    def __init__(self, read: Callable[[], PoseReading]) -> None:
        """Read: gives the filter's pose as x, y, heading."""
        self._read = read

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Predict from the filter's pose (4,)."""
        at = self._read()
        predicted = super().predict(at.pose, landmarks)
        return predicted._replace(jacobian_pose=predicted.jacobian_pose @ at.jacobian)

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Return the landmarks that are measured from the filter's pose (4,)."""
        at = self._read()
        new = super().invert(at.pose, z)
        return new._replace(jacobian_pose=new.jacobian_pose @ at.jacobian)


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
        trace = trace or Trace()
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
        self.models = {
            POINT: OwnAxesObservation(options.full_jacobian),
            POSE: PairRelativePose(self.read_pose),
        }
        self.fixes = PositionFixes(DirectionCosinePosition())
        self.state = (CircleState if renormalise else FreePairState)(pose, covariance)

    def read_pose(self) -> PoseReading:
        """Return the pose now; its heading goes on from where it was read last, unwrapped."""
        own = self.state.pose
        self._heading_rad = _nearest(self._heading_rad, own)
        return PoseReading(np.array([own[0], own[1], self._heading_rad]), own, to_heading(own))

    def read_recorded_pose(self) -> PoseReading:
        """Return the pose now, against the trace's."""
        reading = self.read_pose()
        if self.renormalise:
            return PoseReading(reading.pose, reading.pose, np.eye(3))
        return reading


class HeadingTrace(Trace):
    """Records a filter on the circle as one of x, y, heading."""

    def __init__(self, trace: Trace, heading_rad: float) -> None:
        """Trace: who keeps it. heading_rad: the prior's, from which headings go on unwrapped."""
        self._trace = trace
        self._heading_rad = heading_rad

    def prior(self, pose: Array, covariance: Array) -> None:
        """Record the covariance along the circle."""
        back = along_circle(pose).T
        self._trace.prior(self._pose(pose), back @ covariance @ back.T)

    def step(self, step: StepRecord) -> None:
        """Record F and Q along the circle."""
        back = along_circle(step.arrived).T
        f = back @ step.f @ along_circle(step.departed)
        q = back @ step.q @ back.T
        departed = self._pose(step.departed)
        self._trace.step(StepRecord(departed, self._pose(step.arrived), f, q))

    def measurement(self, used: MeasurementRecord) -> None:
        """Record H along the circle."""
        self._trace.measurement(self._along(used))

    def initialisation(self, new: MeasurementRecord) -> None:
        """Record G_x along the circle."""
        self._trace.initialisation(self._along(new))

    def removal(self, gone: RemovalRecord) -> None:
        """Pass on, the pose having one entry less."""
        self._trace.removal(gone._replace(entries=gone.entries - 1))

    def _along(self, record: MeasurementRecord) -> MeasurementRecord:
        if record.origin != VEHICLE:
            return record
        jacobian = record.jacobian_pose @ along_circle(record.pose)
        return record._replace(pose=self._pose(record.pose), jacobian_pose=jacobian)

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
