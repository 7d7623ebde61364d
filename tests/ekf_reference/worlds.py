"""A vehicle that drives a circle among point landmarks, and the filter that follows it."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf, Stabilisation
from ekf_reference.core.geometry import Array, Index, wrap_angle
from ekf_reference.core.measurements import Association
from ekf_reference.core.trace import Trace
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.range_bearing import RangeBearing

LOOP_S = 85.0
"""Duration of a loop."""
STEP_S, STEPS_PER_SCAN = 0.1, 2
SPEED_MPS = 3.0
RADIUS_M = SPEED_MPS * LOOP_S / (2.0 * math.pi)
CONTROL = np.array((SPEED_MPS, SPEED_MPS / RADIUS_M))
Q = np.diag((0.15, 0.028)) ** 2
"""Covariance of a control: speed [m/s] and yaw rate [rad/s]."""
SIGMA = np.array((0.15, math.radians(1.0)))
"""Standard deviations of a measurement: range [m] and bearing [rad]."""
PRIOR_POSE = np.array((RADIUS_M, 0.0, 0.5 * math.pi))
PRIOR_COVARIANCE = 1e-10 * np.eye(3)
DRIFT = Stabilisation(1e-7, 1e-9)
_RINGS = ((-7.0, 16, 0.1), (4.0, 20, 0.3), (-14.0, 10, 0.5), (5.0, 14, 0.9))
"""Of landmarks: distance outwards from the circle [m], their number, the first one's angle."""


class Scan(NamedTuple):
    """Measurements of the landmarks in view after some steps. z: (m, 2). label: (m,)."""

    step: int
    z: Array
    label: Index


@dataclass(frozen=True)
class Circuit:
    """A recorded drive.

    pose: (N + 1, 3) true poses. control: (N, 2) speed and yaw rate as measured. scan: those with
    at least one measurement, in the order of time. landmark: (L, 2) true places by label.
    """

    pose: Array
    control: Array
    scan: tuple[Scan, ...]
    landmark: Array

    @property
    def met(self) -> Array:
        """(K, 2) true places in the order in which a filter that knows labels adds landmarks."""
        label = np.concatenate([scan.label for scan in self.scan])
        first = np.unique(label, return_index=True)[1]
        places: Array = self.landmark[label[np.sort(first)]]
        return places


def landmarks() -> Array:
    """(60, 2) landmarks on rings inside and outside the circle, at uneven spacing."""
    rings = []
    for offset_m, count, phase in _RINGS:
        turn = phase + 2.0 * np.pi * np.arange(count) / count
        turn = turn + 0.15 * np.sin(2.4 * np.arange(count) + phase)
        rings.append((RADIUS_M + offset_m) * np.column_stack((np.cos(turn), np.sin(turn))))
    return np.vstack(rings)


def circuit(seed: int = 0, duration_s: float = LOOP_S, range_m: float = 20.0) -> Circuit:
    """Drive the circle counter-clockwise; landmarks within half a circle ahead are measured.

    The truth moves as the filter's model does. range_m: reach of the sensor. The same seed gives
    the same drive.
    """
    rng, landmark, model = np.random.default_rng(seed), landmarks(), UnicycleModel()
    steps = round(duration_s / STEP_S)
    control = CONTROL + rng.standard_normal((steps, 2)) @ np.sqrt(Q)
    pose, scans = [PRIOR_POSE], []
    for k in range(1, steps + 1):
        pose.append(model.step(pose[-1], CONTROL, STEP_S).pose)
        if k % STEPS_PER_SCAN:
            continue
        z = RangeBearing().predict(pose[-1], landmark).z
        bearing = wrap_angle(z[:, 1])
        label = np.flatnonzero((z[:, 0] <= range_m) & (np.abs(bearing) <= 0.5 * np.pi))
        if len(label):
            noise = SIGMA * rng.standard_normal((len(label), 2))
            scans.append(Scan(k, z[label] + noise, label))
    return Circuit(np.array(pose), control, tuple(scans), landmark)


def build(
    make: Callable[..., Ekf] = Ekf,
    trace: Trace | None = None,
    association: Association | None = None,
    prior_covariance: Array = PRIOR_COVARIANCE,
) -> Ekf:
    """Build a filter at the start of the circle; it knows labels if no association is given."""
    rule = association or KnownAssociation()
    return make(UnicycleModel(), rule, PRIOR_POSE, prior_covariance, DRIFT, trace)


def follow(
    drive: Circuit, ekf: Ekf | None = None, predicted: Callable[[Ekf], object] = lambda ekf: None
) -> Iterator[tuple[int, Ekf]]:
    """Give a filter the drive's data; yield it after every scan, with the steps made until then.

    predicted: shown the filter between prediction and update. The full filter by default.
    """
    ekf, done = ekf or build(), 0
    for scan in drive.scan:
        for control in drive.control[done : scan.step]:
            ekf.predict(control, Q, STEP_S)
        done = scan.step
        predicted(ekf)
        ekf.observe(scan.z, np.tile(SIGMA, (len(scan.z), 1)), scan.label, done * STEP_S)
        yield done, ekf


def followed(drive: Circuit, ekf: Ekf | None = None) -> Ekf:
    """Return the filter after the drive's last scan."""
    *_, (_, last) = follow(drive, ekf)
    return last
