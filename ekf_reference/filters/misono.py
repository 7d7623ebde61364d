"""Misono's EKF-SLAM, as published and with what it leaves out (Misono et al. 2007, section 3).

The pose is x, y, xi, eta with xi = cos(heading) and eta = sin(heading) (eq. 3). Motion is linear
in it, and measurements in the vehicle's own axes are bilinear. The price is a fourth number where
three are free: nothing in the published filter keeps the pair on the unit circle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ekf_reference.core import trace as records
from ekf_reference.core.chart import Chart
from ekf_reference.core.ekf import Ekf, PoseReading, Stabilisation, StepNoise
from ekf_reference.core.geometry import Array, Index, rotation
from ekf_reference.core.landmark_types import POINT, POSE, NewLandmarks, PredictedMeasurements
from ekf_reference.core.measurements import Association, Measurements
from ekf_reference.core.state import Correction, FilterDivergedError, KalmanState
from ekf_reference.models.motion import MotionModel, MotionStep
from ekf_reference.models.position import PositionFixes
from ekf_reference.models.relative_pose import RelativePose

RADIAL_VARIANCE = 1e-12
"""Of the pair's length, in the prior and added by every step where it is free. Without it the
covariance of four numbers that are known as three would be singular (Nieto 2005, section 2.1.1)."""
LEAST_LENGTH = 0.1
"""A pair shorter than this, or longer than its inverse, no longer says where the vehicle points."""


def from_heading(pose: Array) -> Array:
    """Return a pose with the cosine and sine of its heading.

    Args:
        pose: (3,) x, y [m], heading [rad].

    Returns:
        (4,) x, y, xi, eta.

    Source: Misono 2007, eq. 3.
    """
    return np.array([pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])])


def along_circle(pose: Array) -> Array:
    """Return d(x, y, xi, eta) / d(x, y, heading), the tangent of the unit circle.

    Args:
        pose: (4,) x, y, xi, eta.

    Returns:
        (4, 3).
    """
    jacobian = np.eye(4, 3)
    jacobian[2:, 2] = -pose[3], pose[2]
    return jacobian


def heading_jacobian(pose: Array) -> Array:
    """Return d(x, y, heading) / d(x, y, xi, eta), the heading being atan2(eta, xi).

    Args:
        pose: (4,) x, y, xi, eta, also off the unit circle.

    Returns:
        (3, 4).
    """
    jacobian = along_circle(pose).T.copy()
    jacobian[2] /= pose[2] ** 2 + pose[3] ** 2
    return jacobian


def lift(pose: Array, covariance: Array, radial_variance: float) -> Array:
    """Return the covariance of x, y, xi, eta from that of x, y, heading.

    Args:
        pose: (4,) x, y, xi, eta, on the unit circle.
        covariance: (3, 3) of x, y, heading.
        radial_variance: Of the pair's length; zero makes the result singular.

    Returns:
        (4, 4).
    """
    along, across = along_circle(pose), np.array([0.0, 0.0, pose[2], pose[3]])
    return along @ covariance @ along.T + radial_variance * np.outer(across, across)


@dataclass
class UnwrappedPose:
    """Reads poses (4,) as x, y, heading (3,), unwrapped to lie nearest to the heading read last.

    Of that one only the whole turns are kept: reading more often must not change a bit.
    """

    heading_rad: float

    def __call__(self, own: Array) -> Array:
        """Return x, y, heading."""
        wrapped = math.atan2(own[3], own[2])
        turns = round((self.heading_rad - wrapped) / (2.0 * math.pi))
        self.heading_rad = wrapped + turns * 2.0 * math.pi
        return np.array([own[0], own[1], self.heading_rad])


@dataclass(frozen=True)
class DirectionCosineMotion:
    """Any vehicle model on this pose: x' = F x + B n (Misono 2007, eqs. 1 to 6 and 10).

    `motion` gives the way dx, dy and the turn in the vehicle's frame. Eq. 4 is the case of a turn
    first and the way d afterwards: dx = d cos(turn), dy = d sin(turn). Erratum: eq. 5 prints
    xi(k), eta(k) in B where the direction of arrival, k + 1, holds; the two differ by the turn.
    """

    motion: MotionModel

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """Return the pose (4,) after a control, F and B."""
        own = self.motion.step(np.zeros(3), control, duration_s)
        dx, dy, turn = own.pose.tolist()
        f = np.eye(4)
        f[:2, 2:], f[2:, 2:] = [[dx, -dy], [dy, dx]], rotation(turn)  # 4
        arrived = f @ pose
        b = along_circle(arrived) @ own.jacobian_control  # 5, the turn's part
        xi, eta = pose[2:]
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
        polar = np.column_stack((-sin, -r * cos, cos, -r * sin)).reshape(-1, 2, 2)
        noise = np.einsum("mij,mj,mkj->mik", polar, sigma**2, polar)
        return np.column_stack((-r * sin, r * cos)), noise

    def range_m(self, z: Array) -> Array:
        """Return the distances (m,) from the vehicle."""
        return np.hypot(z[:, 0], z[:, 1])

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Return H x and H for landmarks (m, 2) from a pose (4,) (eqs. 9 and 12)."""
        x, y, xi, eta = pose.tolist()
        dx, dy = landmarks[:, 0] - x, landmarks[:, 1] - y
        z = np.column_stack((eta * dx - xi * dy, xi * dx + eta * dy))
        turn = np.array([[eta, -xi], [xi, eta]])
        jacobian_pose = np.zeros((len(z), 2, 4))
        jacobian_pose[:, :, :2] = -turn
        if self.full_jacobian:
            jacobian_pose[:, :, 2:] = np.column_stack((-dy, dx, dx, dy)).reshape(-1, 2, 2)
        return PredictedMeasurements(z, jacobian_pose, np.broadcast_to(turn, (len(z), 2, 2)))

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Return the innovation of eq. 14; no angle, nothing to wrap."""
        return z - predicted

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Return the landmarks seen at z (m, 2) from a pose (4,) (eq. 16, first row corrected).

        Erratum: the first row is printed (eta, -xi, ...), which is no inverse of eq. 9. The
        Jacobians, which the paper leaves out, are those that Nieto 2005, eqs. 2.54 and 2.55 define.
        """
        x, y, xi, eta = pose.tolist()
        right, ahead = z[:, 0], z[:, 1]
        point = np.column_stack((x + eta * right + xi * ahead, y - xi * right + eta * ahead))
        jacobian_pose = np.tile(np.eye(2, 4), (len(z), 1, 1))
        jacobian_pose[:, :, 2:] = np.column_stack((ahead, right, -right, ahead)).reshape(-1, 2, 2)
        jacobian_z = np.broadcast_to(np.array([[eta, xi], [-xi, eta]]), (len(z), 2, 2))
        return NewLandmarks(point, jacobian_pose, jacobian_z)


@dataclass(frozen=True)
class DirectionCosinePosition:
    """An antenna at `lever_m` (forward, left): on this pose an absolute position is linear."""

    lever_m: tuple[float, float] = (0.0, 0.0)

    def predict(self, pose: Array) -> tuple[Array, Array]:
        """Return the expected position (2,) and its Jacobian (2, 4)."""
        forward, left = self.lever_m
        jacobian = np.array([[1.0, 0.0, forward, -left], [0.0, 1.0, left, forward]])
        return jacobian @ pose, jacobian


@dataclass(frozen=True)
class PairRelativePose(RelativePose):
    """RelativePose on the pose x, y, xi, eta."""

    read: UnwrappedPose

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Predict the measurements from a pose (4,)."""
        predicted = super().predict(self.read(pose), landmarks)
        return predicted._replace(jacobian_pose=predicted.jacobian_pose @ heading_jacobian(pose))

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Return the landmarks that are measured from a pose (4,)."""
        new = super().invert(self.read(pose), z)
        return new._replace(jacobian_pose=new.jacobian_pose @ heading_jacobian(pose))


class FreePairState(KalmanState):
    """The pair goes where updates take it, as published, until it means no direction any more."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Fuse; FilterDivergedError, and nothing fused, where the pair has lost its length."""
        length = float(np.hypot(*self.pose[2:]))
        if not LEAST_LENGTH <= length <= 1.0 / LEAST_LENGTH:
            raise FilterDivergedError(f"direction cosines have length {length:.2g} in place of 1")
        return super().update(columns, jacobian, innovation, noise)


class UnitCircle(Chart):
    """Keeps the pair on the unit circle.

    The correction along the circle is taken as a turn by so much (its arctangent is what dividing
    by the length would give), so that the filter is exactly the one on x, y, heading. What points
    off the circle is dropped from mean and covariance.
    """

    def plus(self, pose: Array, step: Array) -> Array:
        """Turn by the step's part along the circle."""
        after = pose + step
        turn = float(along_circle(pose)[2:, 2] @ (after[2:] - pose[2:]))
        after[2:] = rotation(turn) @ pose[2:]
        after[2:] /= np.hypot(after[2], after[3])
        return after

    def minus(self, pose: Array, other: Array) -> Array:
        """Return the shortest turn as a step along the circle."""
        cos, sin = rotation(math.atan2(other[3], other[2])).T @ pose[2:]
        step = pose - other
        step[2:] = math.atan2(sin, cos) * along_circle(other)[2:, 2]
        return step

    def reset(self, pose: Array, step: Array) -> Array:
        """Turn the error along the circle with the pair, and drop the other."""
        return along_circle(self.plus(pose, step)) @ along_circle(pose).T


@dataclass(frozen=True)
class PairStabilisation:
    """The stabilisation noise of x, y, heading on x, y, xi, eta. radial_variance: per step."""

    heading: StepNoise
    radial_variance: float

    def covariance(self, duration_s: float, pose: Array) -> Array:
        """Return the noise (4, 4) of a step that arrives at a pose (4,)."""
        return lift(pose, self.heading.covariance(duration_s, pose[:3]), self.radial_variance)


@dataclass(frozen=True)
class DirectionCosineOptions:
    """Additions to the published filter. stacked: an instant's measurements are fused together."""

    full_jacobian: bool = False
    renormalise: bool = False
    stacked: bool = False


class DirectionCosineEkf(Ekf):
    """The full filter's steps on x, y, xi, eta; poses are read as x, y, heading.

    Its trace is in x, y, heading where it is renormalised (no error off the circle), else in four.
    """

    def __init__(
        self,
        motion: MotionModel,
        association: Association,
        prior_pose: Array,
        prior_covariance: Array,
        stabilisation: StepNoise | None = None,
        trace: records.Trace | None = None,
        *,
        options: DirectionCosineOptions | None = None,
    ) -> None:
        """Start at a prior of x, y, heading, kept as x, y, cosine, sine.

        Args:
            motion: The vehicle model, of x, y, heading.
            association: Which rule finds the landmark of a measurement.
            prior_pose: (3,) x, y [m], heading [rad].
            prior_covariance: (3, 3), positive definite, of the additive global error.
            stabilisation: Noise of x, y, heading that every step adds; none by default.
            trace: Receives every linearisation; by default nothing is recorded.
            options: Additions to the published filter; none by default.

        Source: Misono 2007, eqs. 1 to 16.
        """
        options = options or DirectionCosineOptions()
        self.renormalise, self.stacked = options.renormalise, options.stacked
        self._unwrapped = UnwrappedPose(float(prior_pose[2]))
        radial_variance = 0.0 if self.renormalise else RADIAL_VARIANCE
        pose = from_heading(prior_pose)
        covariance = lift(pose, prior_covariance, radial_variance)
        noise = PairStabilisation(stabilisation or Stabilisation(), radial_variance)
        if trace and self.renormalise:
            trace = HeadingTrace(trace, UnwrappedPose(float(prior_pose[2])))
        super().__init__(DirectionCosineMotion(motion), association, pose, covariance, noise, trace)
        own_axes = OwnAxesObservation(options.full_jacobian)
        self.models = {POINT: own_axes, POSE: PairRelativePose(self._unwrapped)}
        self.fixes = PositionFixes(DirectionCosinePosition())
        if self.renormalise:
            self.state = KalmanState(pose, covariance, UnitCircle())
        else:
            self.state = FreePairState(pose, covariance)

    def read_pose(self) -> PoseReading:
        """Return the pose now; its heading goes on from where it was read last, unwrapped."""
        own = self.state.pose
        return PoseReading(self._unwrapped(own), own, heading_jacobian(own))

    def read_recorded_pose(self) -> PoseReading:
        """Return the pose now, against the trace's."""
        read = self.read_pose()
        return PoseReading(read.pose, read.pose, np.eye(3)) if self.renormalise else read

    def _fuse(self, seen: Measurements, landmark_indices: Index, rows: Index) -> None:
        for some in [rows] if self.stacked else rows[:, None]:  # 12 to 15, repeated M times
            super()._fuse(seen, landmark_indices, some)


@dataclass(frozen=True)
class HeadingTrace(records.Trace):
    """Records a filter on the circle as one of x, y, heading: in `trace`, with poses as `read`."""

    trace: records.Trace
    read: UnwrappedPose

    def prior(self, pose: Array, covariance: Array) -> None:
        """Record the covariance along the circle."""
        back = along_circle(pose).T
        self.trace.prior(self.read(pose), back @ covariance @ back.T)

    def step(self, step: records.StepRecord) -> None:
        """Record F and Q along the circle."""
        back = along_circle(step.arrived).T
        f, q = back @ step.f @ along_circle(step.departed), back @ step.q @ back.T
        self.trace.step(records.StepRecord(self.read(step.departed), self.read(step.arrived), f, q))

    def measurement(self, used: records.MeasurementRecord) -> None:
        """Record H along the circle."""
        self.trace.measurement(self._along(used))

    def initialisation(self, new: records.MeasurementRecord) -> None:
        """Record G_x along the circle."""
        self.trace.initialisation(self._along(new))

    def removal(self, gone: records.RemovalRecord) -> None:
        """Pass on, the pose having one entry less."""
        self.trace.removal(gone._replace(entries=gone.entries - 1))

    def _along(self, record: records.MeasurementRecord) -> records.MeasurementRecord:
        if record.origin != records.VEHICLE:
            return record
        jacobian = record.jacobian_pose @ along_circle(record.pose)
        return record._replace(pose=self.read(record.pose), jacobian_pose=jacobian)
