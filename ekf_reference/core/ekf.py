"""EKF-SLAM with the full covariance (Nieto 2005, section 2.3; Guivant 2002, section 2)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.blocks import block_diagonal, diagonal_blocks, stack, unstack
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT, POSE, MeasurementModel, NewLandmarks
from ekf_reference.core.measurement_update import (
    Linearised,
    UpdateSplitter,
    fuse,
    normalised_innovation_squared,
)
from ekf_reference.core.measurements import (
    NOT_MEASURED,
    Association,
    MeasuredAttributes,
    Measurements,
)
from ekf_reference.core.state import KalmanState
from ekf_reference.core.trace import (
    VEHICLE,
    MeasurementRecord,
    PriorRecord,
    RemovalRecord,
    StepRecord,
    Trace,
)
from ekf_reference.models.motion import MotionModel
from ekf_reference.models.position import PositionFixes
from ekf_reference.models.range_bearing import RangeBearing
from ekf_reference.models.relative_pose import RelativePose

NEW = -1
"""The slot of a measurement of a landmark that is not in the state yet, for `observe_known`."""
NO_LANDMARKS: Index = np.zeros(0, dtype=np.intp)


class Control(NamedTuple):
    """A control (m,) that holds for a time [s], with covariance (m, m)."""

    value: Array
    covariance: Array
    duration_s: float


class StepNoise(Protocol):
    """Contract of the noise that every step adds, whatever the control."""

    def covariance(self, duration_s: float, pose: Array) -> Array:
        """Return the noise (p, p) of a step that arrives at a pose (p,)."""
        ...


@dataclass(frozen=True)
class Stabilisation:
    """Small noise that keeps one step's covariance regular (Nieto 2005, section 2.1.1).

    Isotropic in position, so that it is the same in every frame. Variances grow with time.
    variance_rate_position: m^2 / s. variance_rate_heading: rad^2 / s.
    """

    variance_rate_position: float = 0.0
    variance_rate_heading: float = 0.0

    def covariance(self, duration_s: float, pose: Array) -> Array:
        """Return the noise (3, 3) of a step, the same everywhere."""
        position = self.variance_rate_position * duration_s
        return np.diag((position, position, self.variance_rate_heading * duration_s))


class PoseReading(NamedTuple):
    """A pose as x, y, heading. pose: (3,). own: (p,) the same as the state has it.

    jacobian: (3, p) of the former by the latter.
    """

    pose: Array
    own: Array
    jacobian: Array


class MeasurementLabel(NamedTuple):
    """What m measurements are recorded as. number, slot: (m,). origin: as in MeasurementRecord."""

    number: Index
    slot: Index
    origin: int = VEHICLE


class Ekf:
    """Predict, associate, update, augment. Public attributes are its parts; all can be replaced.

    models: how landmarks are measured, by their width. fixes: how absolute positions are fused.
    splitter: bounds beyond which one update is split; without bounds by default.
    boundless_variance: of a new landmark's position before it is updated with its first
    measurement (Nieto 2005, eq. 2.56), None to initialise it from that measurement directly
    (eqs. 2.48 to 2.55).
    """

    def __init__(
        self,
        motion: MotionModel,
        association: Association,
        prior_pose: Array,
        prior_covariance: Array,
        stabilisation: StepNoise | None = None,
        trace: Trace | None = None,
    ) -> None:
        """prior_pose: (p,). prior_covariance: (p, p), positive definite."""
        self.motion, self.association = motion, association
        self.models: dict[int, MeasurementModel] = {POINT: RangeBearing(), POSE: RelativePose()}
        self.fixes, self.splitter = PositionFixes(), UpdateSplitter()
        self.boundless_variance: float | None = None
        self.stabilisation: StepNoise = stabilisation or Stabilisation()
        self.trace: Trace = trace or Trace()
        self.state: KalmanState = KalmanState(prior_pose, prior_covariance)
        self._count: Counter[str | int] = Counter()
        self.trace.prior(PriorRecord(prior_pose, prior_covariance))

    def step(self, control: Control, seen: Measurements) -> Index:
        """Do one cycle of the filter; return the measurements' slots (m,), negative where unused.

        Nieto 2005, section 2.3: prediction, association, update of what is known, and augmentation
        of the state with what is new, at the updated pose.
        """
        self.predict(*control)
        slots = self.associate(seen)
        self.update(seen, slots)
        self.augment(seen, slots)
        return slots

    def predict(self, control: Array, covariance: Array, duration_s: float) -> None:
        """Move under a control (m,) with covariance (m, m) for a time.

        Source: Guivant 2002, eq. 7; Misono 2007, eqs. 10 and 11; Nieto 2005, eqs. 2.32 to 2.36.
        """
        departed = self.state.pose
        step = self.motion.step(departed, control, duration_s)
        b = step.jacobian_control
        noise = b @ covariance @ b.T + self.stabilisation.covariance(duration_s, step.pose)
        self.state.predict(step.pose, step.jacobian_pose, noise)
        self.trace.step(StepRecord(departed, step.pose, step.jacobian_pose, noise))

    def associate(self, seen: Measurements) -> Index:
        """Return the slots (m,) that the association rule gives (Nieto 2005, section 2.4)."""
        return self.association.assign(self.state, self.models[seen.width], seen)

    def update(self, seen: Measurements, slots: Index) -> None:
        """Fuse the measurements of landmarks that are in the state (Nieto 2005, 2.37 to 2.47)."""
        mapped = len(self.state.layout.first[seen.width])
        self._fuse(seen, slots, np.flatnonzero((slots >= 0) & (slots < mapped)))

    def augment(self, seen: Measurements, slots: Index) -> None:
        """Initialise the landmarks that are not in the state yet (Nieto 2005, 2.48 to 2.56).

        A second measurement of the same new landmark is fused after that. Comes after `update`.
        """
        new = slots >= len(self.state.layout.first[seen.width])
        first = np.zeros(len(slots), dtype=bool)
        first[np.unique(slots, return_index=True)[1]] = True
        self._initialise(seen, slots, np.flatnonzero(new & first))
        self._fuse(seen, slots, np.flatnonzero(new & ~first))
        self.take_numbers(seen.width, len(slots))

    def measurements(
        self,
        z: Array,
        sigma: Array,
        identity: NDArray[np.int64],
        time_s: float = 0.0,
        attributes: MeasuredAttributes = NOT_MEASURED,
    ) -> Measurements:
        """Return ranges and bearings of points as the filter's model has them.

        z: (m, 2) range [m] and bearing [rad]. sigma: (m, 2). identity: (m,) labels, negative for
        none. attributes: for association.
        """
        own = self.models[POINT].measured(z, sigma)
        return Measurements(*own, identity, time_s=time_s, attributes=attributes)

    def observe(
        self,
        z: Array,
        sigma: Array,
        identity: NDArray[np.int64],
        time_s: float = 0.0,
        attributes: MeasuredAttributes = NOT_MEASURED,
    ) -> Index:
        """Do a cycle without a step; the arguments are those of `measurements`."""
        seen = self.measurements(z, sigma, identity, time_s, attributes)
        slots = self.associate(seen)
        self.update(seen, slots)
        self.augment(seen, slots)
        return slots

    def observe_known(self, z: Array, noise: Array, slot: Index) -> Index:
        """Update and augment with measurements whose landmarks are known; return their slots (m,).

        z: (m, w) with R (m, w, w). slot: (m,), NEW for new landmarks. Raises ValueError for one
        that is not in the state.
        """
        seen = Measurements(z, noise, slot)
        mapped = len(self.state.layout.first[seen.width])
        if ((slot < NEW) | (slot >= mapped)).any():
            raise ValueError(f"slots {slot.tolist()}, expected {NEW} or less than {mapped}")
        slots = slot.copy()
        slots[slot == NEW] = mapped + np.arange(np.count_nonzero(slot == NEW))
        self.update(seen, slots)
        self.augment(seen, slots)
        return slots

    def fix_position(self, z: Array, covariance: Array) -> bool:
        """Fuse an absolute position (2,) with covariance (2, 2); False when the gate rejects it."""
        label = MeasurementLabel(self.take_numbers("position"), np.array((-1,)))

        def linearise() -> Linearised:
            local = self.state.map_of(NO_LANDMARKS)
            expected, jacobian = self.fixes.model.predict(local.pose)
            return Linearised(local, jacobian, z - expected)

        if normalised_innovation_squared(linearise(), covariance) > self.fixes.gate:
            return False
        self.fuse(linearise, covariance[None], label, self.fixes.splitter)
        return True

    def fuse(
        self,
        linearise: Callable[[], Linearised],
        noise: Array,
        label: MeasurementLabel,
        splitter: UpdateSplitter | None = None,
    ) -> None:
        """Fuse m measurements together, in as many parts as the splitter asks for, and record each.

        linearise: the measurements at the state as it then is. noise: (m, r, r), R of each.
        splitter: the filter's own unless told.
        """
        m = len(noise)
        parts = fuse(self.state, splitter or self.splitter, linearise, block_diagonal(noise))
        for weight, at, done in parts:
            frame, landmark, jacobian = at.local.pose, at.local.landmark, at.jacobian
            if label.origin != VEHICLE:
                jacobian = jacobian[:, len(frame) :]
                frame, landmark = landmark[0], landmark[1:]
            width = (jacobian.shape[1] - len(frame)) // m
            by_frame, by_landmark = unstack(jacobian, m, width)
            self.trace.measurement(
                MeasurementRecord(
                    number=label.number,
                    slot=label.slot,
                    pose=frame,
                    landmark=landmark.reshape(m, width),
                    innovation=at.innovation.reshape(m, -1),
                    jacobian_pose=by_frame,
                    jacobian_other=by_landmark,
                    noise=noise / weight,
                    spread=diagonal_blocks(done.spread, m),
                    whitened=done.whitened.reshape(m, -1),
                    weight=weight,
                    origin=label.origin,
                )
            )

    def take_numbers(self, kind: str | int, count: int = 1) -> Index:
        """Return the next numbers (count,) of a kind of measurements, for a MeasurementLabel."""
        first = self._count[kind]
        self._count[kind] += count
        return first + np.arange(count)

    def insert_surveyed(self, point: Array, covariance: Array) -> None:
        """Put points of known position (k, 2) and covariance (k, 2, 2) into the map.

        Guivant 2002, section 4.2: their measurements are absolute information. They are
        independent of the vehicle and of each other to begin with.
        """
        if len(point):
            slots = self.state.landmark_count + np.arange(len(point))
            new = _independent(point, len(self.state.pose))
            self._append(np.full(len(point), -1), slots, new, covariance, weight=0.0)

    def remove(self, slot: Index, width: int = POINT) -> None:
        """Marginalise landmarks (m,) of a kind out of the state, such as ones that may move.

        Raises ValueError for landmarks that were removed before.
        """
        entries = self.state.layout.columns(slot, width)[len(self.state.pose) :]
        self.state.remove(slot, width)
        self.trace.removal(RemovalRecord(slot, width, entries))

    def read_pose(self) -> PoseReading:
        """Return the pose now, against the state's."""
        pose = self.state.pose
        return PoseReading(pose, pose, np.eye(3))

    def read_recorded_pose(self) -> PoseReading:
        """Return the pose now, against the trace's."""
        return self.read_pose()

    def _fuse(self, seen: Measurements, slots: Index, rows: Index) -> None:
        if not len(rows):
            return
        width, slot, z, noise = seen.width, slots[rows], seen.z[rows], seen.noise[rows]
        model = self.models[width]

        def linearise() -> Linearised:
            local = self.state.map_of(slot, width)
            predicted = model.predict(local.pose, local.landmark)
            innovation = model.innovation(z, predicted.z)
            jacobian = stack(predicted.jacobian_pose, predicted.jacobian_landmark)
            return Linearised(local, jacobian, innovation.ravel())

        self.fuse(linearise, noise, MeasurementLabel(self._count[width] + rows, slot))

    def _initialise(self, seen: Measurements, slots: Index, rows: Index) -> None:
        if not len(rows):
            return
        noise, number = seen.noise[rows], self._count[seen.width] + rows
        new = self.models[seen.width].invert(self.state.pose, seen.z[rows])
        if self.boundless_variance is None:
            self._append(number, slots[rows], new, noise)
            return
        apart = _independent(new.landmark, len(self.state.pose))  # 2.56: know nothing, then fuse
        boundless = self.boundless_variance * apart.jacobian_z
        self._append(number, slots[rows], apart, boundless, weight=0.0)
        self._fuse(seen, slots, rows)

    def _append(
        self, number: Index, slot: Index, new: NewLandmarks, noise: Array, weight: float = 1.0
    ) -> None:
        pose, zero = self.state.pose, np.zeros(new.landmark.shape)
        self.state.augment(*new, noise)
        self.trace.initialisation(
            MeasurementRecord(
                number=number,
                slot=slot,
                pose=pose,
                landmark=new.landmark,
                innovation=zero,
                jacobian_pose=new.jacobian_pose,
                jacobian_other=new.jacobian_z,
                noise=noise,
                spread=np.zeros_like(new.jacobian_z),
                whitened=zero,
                weight=weight,
            )
        )


def _independent(landmark: Array, p: int) -> NewLandmarks:
    """Landmarks (m, w) that have nothing to do with the pose (p,); their noise is their own."""
    count, width = landmark.shape
    own = np.broadcast_to(np.eye(width), (count, width, width))
    return NewLandmarks(landmark, np.zeros((count, width, p)), own)
