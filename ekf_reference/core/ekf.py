"""EKF-SLAM with the full covariance (Nieto 2005, section 2.3; Guivant 2002, section 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ekf_reference.association.nearest_neighbour import Association
from ekf_reference.core.filter_state import FilterState
from ekf_reference.core.fusing import begin, fuse, fuse_sightings
from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.core.layout import POINT, POSE
from ekf_reference.core.local_map import LocalMap
from ekf_reference.core.measurement_update import NO_LANDMARKS, Linearised, PositionFixes, Steps
from ekf_reference.core.measurements import NOT_MEASURED, MeasuredAttributes, Sightings
from ekf_reference.core.state import KalmanState, stack
from ekf_reference.core.trace import (
    Beginning,
    FusionUse,
    NullTrace,
    PositionUse,
    Prediction,
    Removal,
    Trace,
)
from ekf_reference.models.motion import MotionModel
from ekf_reference.models.range_bearing import NewLandmarks, Observation, RangeBearing
from ekf_reference.models.relative_pose import RelativePose

NEW = -1
"""The slot of a sighting of a landmark with a direction that is not in the map yet."""


class StepNoise(Protocol):
    """Contract of the noise that every step adds, whatever the control."""

    def covariance(self, duration_s: float, pose: Array) -> Array:
        """(p, p) noise of a step that arrives at a pose (p,)."""
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
        """(3, 3) noise of a step, the same everywhere."""
        position = self.variance_rate_position * duration_s
        return np.diag((position, position, self.variance_rate_heading * duration_s))


class PoseReading(NamedTuple):
    """A pose as x, y, heading. pose: (3,). own: (p,) the same as it is kept, with p entries.

    jacobian: (3, p) of the former by the latter.
    """

    pose: Array
    own: Array
    jacobian: Array


class Ekf:
    """Predict, associate, update, augment. Public attributes are its parts; all can be replaced.

    steps: bounds beyond which one update is split; without bounds by default.
    fixes: how absolute positions are fused. boundless_variance: None to begin landmarks by Nieto
    2005, eq. 2.53; or the P_LL* [m^2] of eq. 2.56, which the thesis advises against.
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
        """prior_pose: (p,). prior_covariance: (p, p), of the additive global error."""
        self.motion = motion
        self.association = association
        self.observation: Observation = RangeBearing()
        self.oriented_observation = RelativePose()
        self.steps = Steps()
        self.fixes = PositionFixes()
        self.boundless_variance: float | None = None
        self.stabilisation: StepNoise = stabilisation or Stabilisation()
        self.trace: Trace = trace or NullTrace()
        self.state: FilterState = KalmanState(prior_pose, prior_covariance)
        self._sightings_seen = 0
        self._oriented_seen = 0
        self._fixes_seen = 0
        self._fusions_made = 0
        self.trace.prior(Beginning(prior_pose, prior_covariance))

    def read_pose(self) -> PoseReading:
        """The pose now, against the state's."""
        pose = self.state.pose
        return PoseReading(pose, pose, np.eye(3))

    def read_recorded_pose(self) -> PoseReading:
        """The pose now, against the trace's."""
        return self.read_pose()

    def predict(self, control: Array, covariance: Array, duration_s: float) -> None:
        """Move under a control (m,) with covariance (m, m) for a time (Nieto 2005, 2.32, 2.36)."""
        departed = self.state.pose
        step = self.motion.step(departed, control, duration_s)
        b = step.jacobian_control
        noise = b @ covariance @ b.T + self.stabilisation.covariance(duration_s, step.pose)
        self.state.predict(step.pose, step.jacobian_pose, noise)
        self.trace.prediction(Prediction(departed, step.pose, step.jacobian_pose, noise))

    def observe(
        self,
        z: Array,
        sigma: Array,
        identity: NDArray[np.int64],
        time_s: float = 0.0,
        attributes: MeasuredAttributes = NOT_MEASURED,
    ) -> Index:
        """Fuse the sightings of one instant; returns their slots, negative where unused.

        z: (m, 2) range and bearing. sigma: (m, 2). identity: (m,) labels, negative for none.
        attributes: for association.
        New landmarks are added after the update, at the updated pose; a second sighting of the
        same new landmark is fused after that.
        """
        z, noise = self.observation.measured(z, sigma)
        mapped = self.state.landmark_count
        slots = self.association.assign(
            self.state, self.observation, Sightings(z, noise, identity, time_s, attributes)
        )
        first = np.zeros(len(slots), dtype=bool)
        first[np.unique(slots, return_index=True)[1]] = True
        new = slots >= mapped
        self._update((slots >= 0) & ~new, slots, z, noise)
        self._augment(new & first, slots, z, noise)
        self._update(new & ~first, slots, z, noise)
        self._sightings_seen += len(slots)
        return slots

    def observe_oriented(self, z: Array, covariance: Array, slot: Index) -> Index:
        """Fuse the sightings of landmarks with a direction at one instant; returns their slots.

        z: (m, 3) x, y, heading in the vehicle's frame. covariance: (m, 3, 3) of what is added to
        these. slot: (m,) which landmarks they are, or NEW; new ones are added after the update,
        at the updated pose (Nieto 2005, eqs. 2.51 to 2.53). Raises ValueError for a slot that is
        not in the map.
        """
        mapped, old = len(self.state.layout.oriented), np.flatnonzero(slot != NEW)
        if ((slot[old] < 0) | (slot[old] >= mapped)).any():
            raise ValueError(f"slots {slot.tolist()}, expected {NEW} or less than {mapped}")
        new, slots = np.flatnonzero(slot == NEW), slot.copy()
        slots[new] = mapped + np.arange(len(new))
        if len(old):
            r, seen, known = covariance[old], self._oriented_seen + old, slots[old]

            def linearise() -> Linearised:
                return self._linearise_oriented(known, z[old])

            for use in fuse_sightings(self.state, self.steps, linearise, r, seen, known):
                self.trace.oriented_update(use)
        if len(new):
            reading = self.read_pose()
            begun = self.oriented_observation.invert(reading.pose, z[new])
            begun = begun._replace(jacobian_pose=begun.jacobian_pose @ reading.jacobian)
            seen = self._oriented_seen + new
            use = begin(self.state, seen, slots[new], begun, covariance[new])
            self.trace.oriented_augmentation(use)
        self._oriented_seen += len(slots)
        return slots

    def fuse_oriented(self, first: int, second: int, z: Array, covariance: Array) -> LocalMap:
        """Fuse two landmarks with a direction that are one (Nieto 2005, section 5.2.3).

        z: (3,) where the second's frame is in the first's, such as the alignment of their
        templates says, with covariance (3, 3); zero with little covariance makes them equal. The
        second is removed. Returns the two as they were before that, to move what the second's
        frame holds (scan_landmarks.frames). Raises ValueError for one landmark, or one removed.
        """
        if first == second:
            raise ValueError(f"landmark {first} is one already")
        both = np.array((first, second), dtype=np.intp)

        def linearise() -> Linearised:
            local = self.state.map_of(both, POSE)
            at = self.oriented_observation.predict(local.landmark[0], local.landmark[1:])
            innovation = self.oriented_observation.innovation(z, at.z[0])
            by_pose = np.zeros((3, len(local.pose)))
            jacobian = np.hstack((by_pose, at.jacobian_pose[0], at.jacobian_landmark[0]))
            return Linearised(local, jacobian, innovation)

        for weight, at, _ in fuse(self.state, self.steps, linearise, covariance):
            places, by_both = at.local.landmark, at.jacobian[:, -6:].reshape(3, 2, 3)
            self.trace.fusion(
                FusionUse(
                    self._fusions_made,
                    first,
                    second,
                    places[0],
                    places[1],
                    at.innovation,
                    by_both[:, 0],
                    by_both[:, 1],
                    covariance / weight,
                    weight,
                )
            )
        self._fusions_made += 1
        known = self.state.map_of(both, POSE)
        self.remove(both[1:], POSE)
        return known

    def remove(self, slot: Index, width: int = POINT) -> None:
        """Marginalise landmarks (m,) of a kind out of the state, such as ones that may move.

        Raises ValueError for landmarks that were removed before.
        """
        entries = self.state.layout.columns(slot, width)[len(self.state.pose) :]
        self.state.remove(slot, width)
        self.trace.removal(Removal(slot, width, entries))

    def insert_surveyed(self, point: Array, covariance: Array) -> None:
        """Put landmarks of known position (k, 2) and covariance (k, 2, 2) into the map.

        Guivant 2002, section 4.2: their sightings are absolute information. They are independent
        of the vehicle and of each other to begin with.
        """
        count = len(point)
        if not count:
            return
        slots = self.state.landmark_count + np.arange(count)
        apart = np.zeros((count, 2, len(self.state.pose)))
        own = np.broadcast_to(np.eye(2), (count, 2, 2))
        nobody = np.full(count, -1)
        new = NewLandmarks(point, apart, own)
        self.trace.augmentation(begin(self.state, nobody, slots, new, covariance, weight=0.0))

    def fix_position(self, z: Array, covariance: Array) -> bool:
        """Fuse an absolute position (2,) with covariance (2, 2); False when the gate rejects it."""
        number, self._fixes_seen = self._fixes_seen, self._fixes_seen + 1

        def linearise() -> Linearised:
            return self.fixes.linearise(self.state.map_of(NO_LANDMARKS), z)

        if not self.fixes.accepts(linearise(), covariance):
            return False
        for weight, at, done in fuse(self.state, self.fixes.steps, linearise, covariance):
            noise, pose, spread = covariance / weight, at.local.pose, done.spread
            self.trace.position(
                PositionUse(number, pose, at.innovation, at.jacobian, noise, spread, weight)
            )
        return True

    def _update(self, chosen: Mask, slots: Index, z: Array, noise: Array) -> None:
        rows = np.flatnonzero(chosen)
        if not len(rows):
            return
        slot = slots[rows]

        def linearise() -> Linearised:
            return self._linearise(slot, z[rows])

        what = noise[rows], self._sightings_seen + rows, slot
        for use in fuse_sightings(self.state, self.steps, linearise, *what):
            self.trace.update(use)

    def _linearise(self, slot: Index, z: Array) -> Linearised:
        local = self.state.map_of(slot)
        predicted = self.observation.predict(local.pose, local.landmark)
        innovation = self.observation.innovation(z, predicted.z)
        jacobian = stack(predicted.jacobian_pose, predicted.jacobian_landmark)
        return Linearised(local, jacobian, innovation.ravel())

    def _linearise_oriented(self, slot: Index, z: Array) -> Linearised:
        local, reading = self.state.map_of(slot, POSE), self.read_pose()
        predicted = self.oriented_observation.predict(reading.pose, local.landmark)
        innovation = self.oriented_observation.innovation(z, predicted.z)
        by_pose = predicted.jacobian_pose @ reading.jacobian
        return Linearised(local, stack(by_pose, predicted.jacobian_landmark), innovation.ravel())

    def _augment(self, chosen: Mask, slots: Index, z: Array, noise: Array) -> None:
        rows = np.flatnonzero(chosen)
        if not len(rows):
            return
        spread, new = noise[rows], self.observation.invert(self.state.pose, z[rows])
        weight = 1.0
        if self.boundless_variance is not None:  # eq. 2.56: know nothing, then fuse the sighting
            apart, own = np.zeros_like(new.jacobian_pose), np.broadcast_to(np.eye(2), spread.shape)
            new, weight = NewLandmarks(new.point, apart, own), 0.0
            spread = self.boundless_variance * own
        seen = self._sightings_seen + rows
        self.trace.augmentation(begin(self.state, seen, slots[rows], new, spread, weight))
        if self.boundless_variance is not None:
            self._update(chosen, slots, z, noise)
