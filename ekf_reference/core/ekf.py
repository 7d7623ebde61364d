"""EKF-SLAM with the full covariance (Nieto 2005, section 2.3; Guivant 2002, section 2)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.blocks import block_diagonal, diagonal_blocks, stack
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import (
    POINT,
    POSE,
    LandmarkKind,
    MeasurementModel,
    NewLandmarks,
)
from ekf_reference.core.linearisation import Linearisation
from ekf_reference.core.measurement_update import Linearised, UpdateSplitter
from ekf_reference.core.measurements import (
    NOT_MEASURED,
    Association,
    MeasuredAttributes,
    Measurements,
)
from ekf_reference.core.state import KalmanState
from ekf_reference.core.trace import VEHICLE, MeasurementRecord, RemovalRecord, StepRecord, Trace
from ekf_reference.models.motion import MotionModel, pose_jacobian
from ekf_reference.models.position import PositionFixes, Streak
from ekf_reference.models.range_bearing import RangeBearing
from ekf_reference.models.relative_pose import RelativePose

NEW = -1
"""Landmark index of a landmark that is not in the state yet, for `observe_known`."""
NO_LANDMARKS: Index = np.zeros(0, dtype=np.intp)


class Control(NamedTuple):
    """A control (m,) that holds for a time [s], with covariance (m, m)."""

    value: Array
    covariance: Array
    duration_s: float


class StepNoise(Protocol):
    """Contract of the noise that every step adds, whatever the control."""

    def covariance(self, duration_s: float, pose: Array) -> Array:
        """Return the noise of a step.

        Args:
            duration_s: The step's [s].
            pose: (p,) at which the step arrives.

        Returns:
            (p, p), positive semidefinite, additive in the pose's entries.
        """


@dataclass(frozen=True)
class Stabilisation:
    """Small noise that keeps one step's covariance regular (Nieto 2005, section 2.1.1).

    Rates [m^2 / s] and [rad^2 / s], isotropic in position to be the same in every frame.
    """

    variance_rate_position: float = 0.0
    variance_rate_heading: float = 0.0

    def covariance(self, duration_s: float, pose: Array) -> Array:
        """Return the noise (3, 3) of a step, the same everywhere."""
        position, heading = self.variance_rate_position, self.variance_rate_heading
        return duration_s * np.array(
            [[position, 0.0, 0.0], [0.0, position, 0.0], [0.0, 0.0, heading]]
        )


class PoseReading(NamedTuple):
    """A pose as x, y, heading (3,), as the state has it (p,), and the Jacobian (3, p)."""

    pose: Array
    own: Array
    jacobian: Array


class Ekf:
    """Predict, associate, update, augment. Public attributes are its parts; all can be replaced.

    models: how landmarks of each kind are measured. fixes: how absolute positions are fused.
    splitter: splits updates whose correction of the pose is too large. boundless_variance: of a new
    landmark before it is updated with its first measurement (Nieto 2005, eq. 2.56), None to
    initialise it from that measurement directly (eqs. 2.48 to 2.55).
    """

    def __init__(
        self,
        motion: MotionModel,
        association: Association,
        prior_pose: Array,
        prior_covariance: Array,
        stabilisation: StepNoise | None = None,
        trace: Trace | None = None,
        linearisation: Linearisation | None = None,
    ) -> None:
        """Start at a prior, with an empty map.

        Args:
            motion: The vehicle model.
            association: Which rule finds the landmark of a measurement.
            prior_pose: (p,) x, y [m], heading [rad], unwrapped.
            prior_covariance: (p, p), positive definite, of the additive global error.
            stabilisation: Noise that every step adds; none by default.
            trace: Receives every linearisation; by default nothing is recorded.
            linearisation: Where Jacobians are taken, and in which error updates correct: at the
                newest estimate, in the additive one, by default.
        """
        self.motion, self.association = motion, association
        self.models: dict[LandmarkKind, MeasurementModel] = {
            POINT: RangeBearing(),
            POSE: RelativePose(),
        }
        self.fixes, self.splitter = PositionFixes(), UpdateSplitter()
        self.boundless_variance: float | None = None
        self.stabilisation: StepNoise = stabilisation or Stabilisation()
        self.trace: Trace = trace or Trace()
        self.linearisation = linearisation or Linearisation()
        self.state: KalmanState = self.linearisation.state(prior_pose, prior_covariance)
        self.linearisation.start(self.state.pose)
        self._count: Counter[str] = Counter()
        self._beyond = Streak()
        self.trace.prior(prior_pose, prior_covariance)

    def step(self, control: Control, seen: Measurements) -> Index:
        """Do one cycle: predict, associate, update, augment.

        Args:
            control: What moved the vehicle since the last cycle.
            seen: The measurements at the end of the step, all of point landmarks.

        Returns:
            (m,) landmark index of each measurement, or a negative code where it was not used
            (core.measurements).

        Raises:
            ValueError: The measurements are of pose landmarks, which no rule associates.
            FilterDivergedError: The innovation covariance is not positive definite.

        Source: Nieto 2005, section 2.3.
        """
        self.predict(*control)
        return self.cycle(seen)

    def cycle(self, seen: Measurements) -> Index:
        """Do a cycle without a step: associate, update, augment.

        Args:
            seen: The measurements of this instant, all of point landmarks.

        Returns:
            (m,) landmark indices as `step` returns them.

        Raises:
            ValueError: The measurements are of pose landmarks, which no rule associates.
            FilterDivergedError: The innovation covariance is not positive definite.
        """
        landmark_indices = self.associate(seen)
        self.use(seen, landmark_indices)
        return landmark_indices

    def predict(self, control: Array, covariance: Array, duration_s: float) -> None:
        """Move the vehicle; the map stays.

        Args:
            control: (m,) in the motion model's units, constant during the step.
            covariance: (m, m) of the control's error.
            duration_s: The step's [s].

        Source: Guivant 2002, eq. 7; Misono 2007, eqs. 10 and 11; Nieto 2005, eqs. 2.32 to 2.36.
        """
        departed = self.state.pose
        pose, f, b = self.motion.step(departed, control, duration_s)
        if (at := self.linearisation.control(self.state, control)) is not None:
            b = self.motion.step(*at, duration_s).jacobian_control
        if (travel := self.linearisation.step(self.state, pose)) is not None:
            f = pose_jacobian(*travel.tolist())
        noise = b @ covariance @ b.T + self.stabilisation.covariance(duration_s, pose)
        self.state.predict(pose, f, noise)
        self.trace.step(StepRecord(departed, pose, f, noise))

    def associate(self, seen: Measurements) -> Index:
        """Find the landmark of each measurement; the state does not change.

        Args:
            seen: Measurements of point landmarks.

        Returns:
            (m,) landmark indices. Indices from the present landmark count upward are of new
            landmarks, in order; negative codes are of measurements that are not used
            (core.measurements).

        Raises:
            ValueError: The measurements are of pose landmarks, which no rule associates.

        Source: Nieto 2005, section 2.4.
        """
        if seen.kind != POINT:
            raise ValueError(f"measurements of {seen.kind.name} landmarks, expected points")
        if not len(seen):
            return NO_LANDMARKS
        return self.association.assign(self.state, self.models[seen.kind], seen)

    def use(self, seen: Measurements, landmark_indices: Index) -> None:
        """Update and augment with measurements whose landmarks are known.

        Those of landmarks that are in the state are fused, all of them as one. Then the others are
        initialised; a second measurement of a new landmark is fused.

        Args:
            seen: The measurements of this instant.
            landmark_indices: (m,) landmark indices as `associate` returns them.

        Raises:
            FilterDivergedError: The innovation covariance is not positive definite.

        Source: Nieto 2005, eqs. 2.37 to 2.56.
        """
        mapped = len(self.state.layout.first[seen.kind])
        known = (landmark_indices >= 0) & (landmark_indices < mapped)
        self._fuse(seen, landmark_indices, np.flatnonzero(known))
        new = np.flatnonzero(landmark_indices >= mapped)
        if len(new):
            first = np.sort(new[np.unique(landmark_indices[new], return_index=True)[1]])
            self._initialise(seen, landmark_indices, first)
            self._fuse(seen, landmark_indices, np.setdiff1d(new, first))
        self.take_numbers(seen.kind.name, len(landmark_indices))

    def observe(
        self,
        z: Array,
        sigma: Array,
        identity: NDArray[np.int64],
        time_s: float = 0.0,
        attributes: MeasuredAttributes = NOT_MEASURED,
    ) -> Index:
        """Do a cycle without a step, with ranges and bearings of points.

        Args:
            z: (m, 2) range [m] and bearing [rad], relative to the heading, counter-clockwise.
            sigma: (m, 2) standard deviations [m, rad].
            identity: (m,) labels, negative for none.
            time_s: When [s]; rules that wait for a second measurement need it.
            attributes: What else was measured, for association.

        Returns:
            (m,) landmark indices, negative where a measurement was not used.
        """
        own = self.models[POINT].measured(z, sigma)
        return self.cycle(Measurements(*own, identity, time_s=time_s, attributes=attributes))

    def observe_known(
        self, z: Array, noise: Array, landmark_index: Index, kind: LandmarkKind = POINT
    ) -> Index:
        """Update and augment with measurements whose landmarks are known.

        Args:
            z: (m, w).
            noise: (m, w, w), R.
            landmark_index: (m,) landmark index among those of this kind, or NEW for a new landmark.
            kind: Of the landmarks.

        Returns:
            (m,) landmark indices, NEW replaced by the index that the landmark was given.

        Raises:
            ValueError: A landmark is not in the state.
        """
        seen = Measurements(z, noise, landmark_index, kind=kind)
        mapped = len(self.state.layout.first[seen.kind])
        if ((landmark_index < NEW) | (landmark_index >= mapped)).any():
            raise ValueError(
                f"landmark indices {landmark_index.tolist()}, expected {NEW} or less than {mapped}"
            )
        landmark_indices = np.where(
            landmark_index == NEW, mapped + np.cumsum(landmark_index == NEW) - 1, landmark_index
        )
        self.use(seen, landmark_indices)
        return landmark_indices

    def fix_position(self, z: Array, covariance: Array) -> bool:
        """Fuse an absolute position, such as GPS, if it is within the gate.

        Args:
            z: (2,) east, north [m], of the antenna.
            covariance: (2, 2) [m^2].

        Returns:
            False where the fix was rejected.

        Source: Guivant 2002, section 4.2.
        """
        number = self.take_numbers("position")

        def linearise() -> Linearised:
            local = self.state.map_of(NO_LANDMARKS)
            expected, jacobian = self.fixes.model.predict(local.pose)
            return Linearised(local, jacobian, z - expected)

        at, fixes = linearise(), self.fixes
        fused, length = at.normalised_squared(covariance) <= fixes.gate, 0
        if fixes.recovery is not None and not fused:
            length = self._beyond.length_with(at.innovation, covariance, fixes.gate)
            fused = length > fixes.recovery
        if fused:
            landmark_index = np.array([VEHICLE])
            self.fuse(linearise, covariance[None], number, landmark_index, splitter=fixes.splitter)
        if fixes.recovery is not None:
            self._beyond = Streak(length, linearise().innovation, covariance)
        return fused

    def fuse(
        self,
        linearise: Callable[[], Linearised],
        noise: Array,
        number: Index,
        landmark_index: Index,
        origin: int = VEHICLE,
        splitter: UpdateSplitter | None = None,
    ) -> None:
        """Fuse m measurements together, in as many parts as the splitter asks for, and record each.

        Args:
            linearise: Linearises the measurements at the state as it then is; called once a part.
            noise: (m, r, r), R of each.
            number: (m,) as in MeasurementRecord; of `take_numbers`.
            landmark_index: (m,) landmark indices as in MeasurementRecord.
            origin: VEHICLE, or the landmark from which the others are measured (a merge).
            splitter: How far one part may correct the pose; by default the filter's own.

        Raises:
            FilterDivergedError: The innovation covariance is not positive definite.
        """
        m, r = len(noise), block_diagonal(noise)
        for weight, at in (splitter or self.splitter).split(linearise, r):
            done = self.state.update(at.local.columns, at.jacobian, at.innovation, r / weight)
            frame, landmark, jacobian = at.local.pose, at.local.landmark, at.jacobian
            if origin != VEHICLE:
                jacobian = jacobian[:, len(frame) :]
                frame, landmark = landmark[0], landmark[1:]
            p = len(frame)
            record = MeasurementRecord(
                kind=at.local.kind if len(landmark) else None,
                number=number,
                landmark_index=landmark_index,
                pose=frame,
                landmark=landmark.reshape(m, -1),
                jacobian_pose=jacobian[:, :p].reshape(m, -1, p),
                jacobian_other=diagonal_blocks(jacobian[:, p:], m),
                noise=noise / weight,
                innovation=at.innovation.reshape(m, -1),
                whitened=done.whitened.reshape(m, -1),
                spread=diagonal_blocks(done.spread, m),
                weight=weight,
                origin=origin,
            )
            self.trace.measurement(record)

    def take_numbers(self, kind: str, count: int = 1) -> Index:
        """Return the next numbers of a kind of measurements, for `fuse`.

        Args:
            kind: The name of the landmarks' kind, or one of one's own.
            count: How many.

        Returns:
            (count,) numbers, ascending from the kind's first that is free.
        """
        self._count[kind] += count
        return self._count[kind] - count + np.arange(count)

    def insert_surveyed(self, point: Array, covariance: Array) -> None:
        """Put points of known position into the map, independent of the vehicle so far.

        Args:
            point: (k, 2) east, north [m].
            covariance: (k, 2, 2) [m^2], positive definite.

        Source: Guivant 2002, section 4.2.
        """
        if m := len(point):
            new = NewLandmarks.independent(point, len(self.state.pose))
            landmark_indices = self.state.landmark_count + np.arange(m)
            self._append(POINT, np.full(m, -1), landmark_indices, new, covariance, weight=0.0)

    def remove(self, landmark_index: Index, kind: LandmarkKind = POINT) -> None:
        """Marginalise landmarks out of the state; the estimate of everything else stays.

        Args:
            landmark_index: (m,) landmark indices, which are not given again.
            kind: Of the landmarks.

        Raises:
            ValueError: A landmark was removed already.
        """
        entries = self.state.layout.columns(landmark_index, kind)[len(self.state.pose) :]
        self.state.remove(landmark_index, kind)
        self.trace.removal(RemovalRecord(landmark_index, kind, entries))

    def read_pose(self) -> PoseReading:
        """Return the pose now, with the Jacobian by the pose in the state."""
        return PoseReading(self.state.pose, self.state.pose, np.eye(3))

    def read_recorded_pose(self) -> PoseReading:
        """Return the pose now, with the Jacobian by the pose in the trace."""
        return self.read_pose()

    def _fuse(self, seen: Measurements, landmark_indices: Index, rows: Index) -> None:
        if not len(rows):
            return
        landmark_index, z, model = landmark_indices[rows], seen.z[rows], self.models[seen.kind]

        def linearise() -> Linearised:
            local = self.state.map_of(landmark_index, seen.kind)
            expected, *jacobians = model.predict(local.pose, local.landmark)
            at = self.linearisation.measurement(self.state, landmark_index, seen.kind)
            if at is not None:
                _, *jacobians = model.predict(*at)
            return Linearised(local, stack(*jacobians), model.innovation(z, expected).ravel())

        self.fuse(linearise, seen.noise[rows], self._count[seen.kind.name] + rows, landmark_index)

    def _initialise(self, seen: Measurements, landmark_indices: Index, rows: Index) -> None:
        landmark_index, number = landmark_indices[rows], self._count[seen.kind.name] + rows
        model = self.models[seen.kind]
        new = model.invert(self.state.pose, seen.z[rows])
        at = self.linearisation.initialisation(self.state, new.landmark, seen.kind)
        if at is not None:
            _, by_pose, by_landmark = model.predict(*at)
            by_z = np.asarray(np.linalg.inv(by_landmark))
            new = NewLandmarks(new.landmark, -by_z @ by_pose, by_z)
        if self.boundless_variance is None:
            self._append(seen.kind, number, landmark_index, new, seen.noise[rows])
        else:  # 2.56: know nothing, then fuse
            new = NewLandmarks.independent(new.landmark, len(self.state.pose))
            boundless = self.boundless_variance * new.jacobian_z
            self._append(seen.kind, number, landmark_index, new, boundless, weight=0.0)
            self._fuse(seen, landmark_indices, rows)

    def _append(
        self,
        kind: LandmarkKind,
        number: Index,
        landmark_index: Index,
        new: NewLandmarks,
        noise: Array,
        *,
        weight: float = 1.0,
    ) -> None:
        zeros = np.zeros(new.landmark.shape), np.zeros(new.landmark.shape), np.zeros(noise.shape)
        record = MeasurementRecord(
            kind, number, landmark_index, self.state.pose, *new, noise, *zeros, weight
        )
        self.linearisation.append(self.state, new.landmark, kind)
        self.state.augment(new, noise, kind)
        self.trace.initialisation(record)
