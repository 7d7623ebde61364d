"""EKF-SLAM with the full covariance (Nieto 2005, section 2.3; Guivant 2002, section 2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ekf_reference.absolute_updates import (
    NO_LANDMARKS,
    Fused,
    Linearised,
    PositionFixes,
    Steps,
)
from ekf_reference.association import Association, MappedState, Slots
from ekf_reference.kalman import (
    Array,
    Correction,
    Glance,
    Index,
    KalmanState,
    block_diagonal,
    diagonal_blocks,
    stack,
    unstack,
)
from ekf_reference.motion import MotionModel
from ekf_reference.observation import Observation, RangeBearing
from ekf_reference.sightings import NOTHING_SIGHTED, SightedAttributes, Sightings
from ekf_reference.trace import Beginning, NullTrace, PositionUse, Prediction, SightingUse, Trace


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


class FilterState(MappedState, Protocol):
    """What the filter's steps ask of a state; KalmanState is one."""

    @property
    def mean(self) -> Array:
        """(n,) pose, then landmarks."""
        ...

    @property
    def covariance(self) -> Array:
        """(n, n)."""
        ...

    @property
    def pose(self) -> Array:
        """(p,) x, y and the direction."""
        ...

    @property
    def pose_covariance(self) -> Array:
        """(p, p)."""
        ...

    @property
    def landmarks(self) -> Array:
        """(L, 2)."""
        ...

    def glance(self) -> Glance:
        """All there is, without moving anything."""
        ...

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        """Move the vehicle."""
        ...

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Fuse one stacked observation."""
        ...

    def augment(
        self, point: Array, jacobian_pose: Array, jacobian_sighting: Array, noise: Array
    ) -> None:
        """Append landmarks."""
        ...


class FullEkf:
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
        self.steps = Steps()
        self.fixes = PositionFixes()
        self.boundless_variance: float | None = None
        self.stabilisation: StepNoise = stabilisation or Stabilisation()
        self.trace: Trace = trace or NullTrace()
        self.state: FilterState = KalmanState(prior_pose, prior_covariance)
        self._sightings_seen = 0
        self._fixes_seen = 0
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
        attributes: SightedAttributes = NOTHING_SIGHTED,
    ) -> Slots:
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
        self._begin(np.full(count, -1), slots, point, apart, own, covariance, weight=0.0)

    def fix_position(self, z: Array, covariance: Array) -> bool:
        """Fuse an absolute position (2,) with covariance (2, 2); False when the gate rejects it."""
        number, self._fixes_seen = self._fixes_seen, self._fixes_seen + 1

        def linearise() -> Linearised:
            return self.fixes.linearise(self.state.map_of(NO_LANDMARKS), z)

        if not self.fixes.accepts(linearise(), covariance):
            return False
        for weight, at, done in self._fuse(self.fixes.steps, linearise, covariance):
            noise, pose, spread = covariance / weight, at.local.pose, done.spread
            self.trace.position(
                PositionUse(number, pose, at.innovation, at.jacobian, noise, spread, weight)
            )
        return True

    def _fuse(
        self, steps: Steps, linearise: Callable[[], Linearised], noise: Array
    ) -> Iterator[Fused]:
        """Fuse an observation in as many parts as the steps ask for; yields each once it is."""
        for weight, at in steps.split(linearise, noise):
            done = self.state.update(at.local.columns, at.jacobian, at.innovation, noise / weight)
            yield Fused(weight, at, done)

    def _update(self, chosen: NDArray[np.bool_], slots: Slots, z: Array, noise: Array) -> None:
        rows = np.flatnonzero(chosen)
        if not len(rows):
            return
        slot, r = slots[rows], noise[rows]

        def linearise() -> Linearised:
            return self._linearise(slot, z[rows])

        for weight, at, done in self._fuse(self.steps, linearise, block_diagonal(r)):
            self.trace.update(
                SightingUse(
                    self._sightings_seen + rows,
                    slot,
                    at.local.pose,
                    at.local.landmark,
                    at.innovation.reshape(-1, 2),
                    *unstack(at.jacobian),
                    r / weight,
                    diagonal_blocks(done.spread),
                    done.whitened.reshape(-1, 2),
                    weight,
                )
            )

    def _linearise(self, slot: Slots, z: Array) -> Linearised:
        local = self.state.map_of(slot)
        predicted = self.observation.predict(local.pose, local.landmark)
        innovation = self.observation.innovation(z, predicted.z)
        jacobian = stack(predicted.jacobian_pose, predicted.jacobian_landmark)
        return Linearised(local, jacobian, innovation.ravel())

    def _augment(self, chosen: NDArray[np.bool_], slots: Slots, z: Array, noise: Array) -> None:
        rows = np.flatnonzero(chosen)
        if not len(rows):
            return
        spread, new = noise[rows], self.observation.invert(self.state.pose, z[rows])
        by_pose, by_sighting, weight = new.jacobian_pose, new.jacobian_sighting, 1.0
        if self.boundless_variance is not None:  # eq. 2.56: know nothing, then fuse the sighting
            by_pose, weight = np.zeros_like(by_pose), 0.0
            by_sighting = np.broadcast_to(np.eye(2), by_sighting.shape)
            spread = self.boundless_variance * by_sighting
        seen = self._sightings_seen + rows
        self._begin(seen, slots[rows], new.point, by_pose, by_sighting, spread, weight)
        if self.boundless_variance is not None:
            self._update(chosen, slots, z, noise)

    def _begin(
        self,
        sighting: Index,
        slot: Slots,
        point: Array,
        by_pose: Array,
        by_sighting: Array,
        noise: Array,
        weight: float,
    ) -> None:
        """Append landmarks to the state and note how."""
        pose, nothing = self.state.pose, np.zeros((len(slot), 2))
        surprise = np.zeros((len(slot), 2, 2)), nothing
        how = by_pose, by_sighting, noise
        self.state.augment(point, *how)
        self.trace.augmentation(
            SightingUse(sighting, slot, pose, point, nothing, *how, *surprise, weight)
        )
