"""Known faults of EKF-SLAM filters: planted in the filter, or made by feeding it another log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from comparisons.adapters.defects.defect import (
    OtherMotion,
    OtherObservation,
    Plant,
    with_motion,
    with_observation,
    with_state,
    with_steps,
)
from comparisons.adapters.defects.registry import REGISTRY
from comparisons.arrays import Array
from comparisons.logs.log import LandmarkMeasurements, Log
from comparisons.logs.odometry import (
    OdometryNoise,
    RelativePoses,
    SteeringOdometry,
    VelocityOdometry,
)
from comparisons.logs.transforms.calibration import controlled, driven, sensed
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Index
from ekf_reference.core.landmark_types import (
    POINT,
    LandmarkKind,
    NewLandmarks,
    PredictedMeasurements,
)
from ekf_reference.core.state import Correction, KalmanState
from ekf_reference.models.motion import MotionStep
from ekf_reference.models.range_bearing import RangeBearing

_STEERING = {"steering sign", "wheelbase wrong", "sensor's place left out"}
_POSITIONS = {"lever arm left out", "position fused twice"}
_RATES = ("variance_rate_position", "variance_rate_heading")
_VARIANCES = (0.0, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0)
_SIMULATED = {"interval ignored"}
"""Of one interval only, that of the logs that it is planted in."""


Feed = Callable[[Log], Log]
Change = Callable[[LandmarkMeasurements], LandmarkMeasurements]


class Fault(NamedTuple):
    """what: in words. plant: in the filter. feed: makes its log."""

    what: str
    plant: Plant | None = None
    feed: Feed | None = None


class NoiseInBodyAxes(OtherMotion):
    """Q is that of the vehicle's axes, added as if these were the map's."""

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """B by the axes of the vehicle."""
        step = super().step(pose, control, duration_s)
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        jacobian = step.jacobian_control.copy()
        jacobian[:2] = np.array([[cos, sin], [-sin, cos]]) @ jacobian[:2]
        return step._replace(jacobian_control=jacobian)


class InDeadReckonedFrame(OtherMotion):
    """Steps lead along the heading of plain dead reckoning, which no update corrects."""

    _heading_rad: float | None = None

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """From the filter's place, by the other heading; the Jacobians are right."""
        heading = float(pose[2]) if self._heading_rad is None else self._heading_rad
        own = super().step(pose, control, duration_s)
        other = super().step(np.append(pose[:2], heading), control, duration_s)
        self._heading_rad = float(other.pose[2])
        return own._replace(pose=np.append(other.pose[:2], own.pose[2]))


def _heading_column(change: Callable[[float, float, float], tuple[float, float]]) -> Plant:
    """F with another column by the heading. change: of a step's east, north [m] and turn per metre.

    Sound is (-north, east).
    """

    class OtherColumn(OtherMotion):
        def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
            step = super().step(pose, control, duration_s)
            east, north, turn = (step.pose - pose).tolist()
            way = float(np.hypot(east, north))
            jacobian = step.jacobian_pose.copy()
            jacobian[:2, 2] = change(east, north, turn / way if way else 0.0)
            return step._replace(jacobian_pose=jacobian)

    return with_motion(OtherColumn)


_COLUMNS: dict[str, Callable[[float, float, float], tuple[float, float]]] = {
    "cosine and sine are exchanged": lambda e, n, t: (-e, n),
    "the x row has the opposite sign": lambda e, n, t: (n, e),
    "the y row has the opposite sign": lambda e, n, t: (-n, -e),
    "the turn stands for the way in the x row": lambda e, n, t: (-n * t, e),
    "the turn stands for the way in the y row": lambda e, n, t: (-n, e * t),
    "the turn stands for the way": lambda e, n, t: (-n * t, e * t),
}
"""Errors in the heading's column of F."""


def _opposite_sign(row: int, of: str) -> Plant:
    """Signs in one row of H. of: the pose's position or heading, or the landmark's."""

    class OppositeSign(OtherObservation):
        def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
            found = super().predict(pose, landmarks)
            by_pose, by_landmark = found.jacobian_pose, found.jacobian_landmark
            parts = {
                "position": by_pose[:, row, :2],
                "heading": by_pose[:, row, 2:],
                "landmark": by_landmark[:, row],
            }
            parts[of] *= -1.0
            return found

    return with_observation(OppositeSign)


class SwingsBack(OtherObservation):
    """G_x by the heading has the opposite sign."""

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """With its last column turned."""
        found = super().invert(pose, z)
        found.jacobian_pose[:, :, 2] *= -1.0
        return found


class ExpectedWrapped(RangeBearing):
    """The expected bearing is wrapped, its difference from the measured one is not."""

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Off by a turn where the two lie on either side of the cut."""
        wrapped = predicted.copy()
        wrapped[..., 1] = np.angle(np.exp(1j * predicted[..., 1]))
        return z - wrapped


class IndependentAtAugmentation(KalmanState):
    """New landmarks know neither the vehicle nor the map nor each other."""

    variance: float | None = None
    """[m^2] that they have instead of their own."""

    def augment(self, new: NewLandmarks, noise: Array, kind: LandmarkKind = POINT) -> None:
        """Append, then forget."""
        n = len(self.covariance)
        super().augment(new, noise, kind)
        count, width = new.landmark.shape
        p = self._covariance[: self._layout.size, : self._layout.size]
        p[n:, n:] *= np.kron(np.eye(count), np.ones((width, width)))
        if self.variance is not None:
            p[n:, n:] = self.variance * np.eye(count * width)
        p[:n, n:] = 0.0
        p[n:, :n] = 0.0


def _constant(value: float) -> Plant:
    """New landmarks with the same covariance, whatever is known."""

    class Constant(IndependentAtAugmentation):
        variance = value

    return with_state(Constant)


def _other_gain(factor: float) -> Plant:
    """W with another R."""

    class OtherGain(KalmanState):
        def update(
            self, columns: Index, jacobian: Array, innovation: Array, noise: Array
        ) -> Correction:
            n = self._layout.size
            p = self._covariance[:n, :n].copy()
            done = super().update(columns, jacobian, innovation, factor * noise)
            h = np.zeros((len(jacobian), n))
            np.add.at(h.T, columns, jacobian.T)
            gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + factor * noise)
            keep = np.eye(n) - gain @ h
            self._covariance[:n, :n] = keep @ p @ keep.T + gain @ noise @ gain.T
            return done

    return with_state(OtherGain)


def _new_landmarks(updates: float, new: float) -> Plant:
    """R times a factor in updates, and times another for new landmarks."""

    class OtherNoise(OtherObservation):
        def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
            return super().measured(z, np.sqrt(updates) * sigma)

        def invert(self, pose: Array, z: Array) -> NewLandmarks:
            found = super().invert(pose, z)
            return found._replace(jacobian_z=np.sqrt(new / updates) * found.jacobian_z)

    return with_observation(OtherNoise)


class WaitsForControl(Ekf):
    """Nothing is predicted before the first control that moves."""

    _moved = False

    def predict(self, control: Array, covariance: Array, duration_s: float) -> None:
        """Wait, then move."""
        self._moved = self._moved or bool(control.any())
        if self._moved:
            super().predict(control, covariance, duration_s)


_waiting = with_steps(WaitsForControl)


class Family(NamedTuple):
    """Faults that differ by a number. what: in words, with its place.

    feed: makes the log of it. plant: puts it into the filter. neutral: the number of no fault.
    factor: it multiplies, so that it is fitted as a logarithm.
    """

    what: str
    feed: Callable[[Log, float], Log] | None = None
    neutral: float = 1.0
    factor: bool = True
    plant: Callable[[float], Plant] | None = None

    def member(self, number: float) -> Fault:
        """The fault with a number."""
        what, feed = self.what.format(f"{number:.4g}"), self.feed
        plant = None if self.plant is None else self.plant(number)
        return Fault(what, plant, None if feed is None else lambda log: feed(log, number))


def catalogue(log: Log) -> Iterator[Fault]:
    """Yield the faults without a number that a filter of this log may have."""
    skipped = set(_SIMULATED)
    if not isinstance(log.odometry, SteeringOdometry):
        skipped |= _STEERING
    if log.positions is None:
        skipped |= _POSITIONS
    yield from (Fault(one.what, plant=one.plant) for one in REGISTRY if one.name not in skipped)
    yield Fault("Q is not rotated into the map's axes", plant=with_motion(NoiseInBodyAxes))
    for row, of in ((0, "position"), (1, "position"), (1, "heading"), (0, "landmark"),
                    (1, "landmark")):  # fmt: skip
        yield Fault(f"the {of}'s terms in the {('range', 'bearing')[row]} row of H have the "
                    "opposite sign", plant=_opposite_sign(row, of))  # fmt: skip
    yield Fault("the heading's column of G_x has the opposite sign",
                plant=with_observation(SwingsBack))  # fmt: skip
    yield Fault("the innovation is not wrapped, but the expected bearing is",
                plant=with_observation(ExpectedWrapped))  # fmt: skip
    yield Fault("a landmark is initialised without any cross-covariance",
                plant=with_state(IndependentAtAugmentation))  # fmt: skip
    for value in _VARIANCES:
        yield Fault(f"a landmark is initialised with the covariance {value:g} m^2 I, whatever is "
                    "known, and without any cross-covariance", plant=_constant(value))  # fmt: skip
    yield Fault("steps lead along the heading of plain dead reckoning, not the filter's",
                plant=with_motion(InDeadReckonedFrame))  # fmt: skip
    for what, column in _COLUMNS.items():
        yield Fault(f"{what} in the heading's column of F", plant=_heading_column(column))
    yield Fault("measurements of landmarks in the map are used twice in one update",
                plant=_new_landmarks(0.5, 1.0))  # fmt: skip
    yield from (Fault(what, feed=_seen(change)) for what, change in _MEASUREMENTS.items())
    yield Fault("the prior's covariance contains sigmas, not their squares", feed=_prior_of_sigmas)
    if not isinstance(log.odometry, RelativePoses):
        yield from (Fault(what, feed=_noise(change)) for what, change in _WHEELS.items())
        yield from _shifted_odometry()
        yield Fault("the turn counts to the right", feed=lambda log: driven(log, turn=(-1.0, 0.0)))


def own_start(log: Log, covariance: Array) -> Fault:
    """The fault of a filter whose first pose has a covariance (3, 3) of its own."""
    prior = log.prior.covariance
    ratio = np.diag(covariance) / np.diag(prior)
    named = ", ".join(f"{one:.3g}" for one in ratio)
    if np.ptp(ratio) <= 1e-6 * ratio.max():
        named = f"{ratio[0]:.3g}"
    what = f"the prior's covariance is {named} times the log's"
    return Fault(what, feed=lambda log: _with_prior(log, covariance))


def families(log: Log) -> Iterator[Family]:
    """Yield the faults with a number."""
    for what, in_range, in_bearing in (
        ("R", True, True), ("R of the range", True, False), ("R of the bearing", False, True)
    ):  # fmt: skip
        yield Family(f"{what} is {{}} times the log's", _wider_noise(in_range, in_bearing))
    yield Family("R of new landmarks is {} times the log's", plant=lambda k: _new_landmarks(1.0, k))
    yield Family("R of updates, or of the gain alone, but not of new landmarks, is {} times the "
                 "log's", plant=lambda k: _new_landmarks(k, 1.0))  # fmt: skip
    yield Family("the gain is computed with {} R, the covariance by Joseph's form with R",
                 plant=_other_gain)  # fmt: skip
    yield Family("the prior's covariance is {} times the log's", _wider_prior)
    yield Family("the ranges are {} times the log's", lambda log, k: sensed(log, range_=(k, 0.0)))
    yield Family("the ranges have a bias of {} m", lambda log, b: sensed(log, range_=(1.0, b)),
                 0.0, factor=False)  # fmt: skip
    yield Family("the bearings have a bias of {} rad", lambda log, b: sensed(log, bearing=(1.0, b)),
                 0.0, factor=False)  # fmt: skip
    if isinstance(log.odometry, RelativePoses):
        return
    for what, parts in (
        ("Q", ("sigma_speed_mps", "sigma_turn", *_RATES)),
        ("the controls' part of Q", ("sigma_speed_mps", "sigma_turn")),
        ("the speed's part of Q", ("sigma_speed_mps",)),
        ("the turn's part of Q", ("sigma_turn",)),
        ("the stabilisation noise", _RATES),
    ):
        yield Family(f"{what} is {{}} times the log's", _wider_control(parts))
    yield Family("the speed is {} times the log's", lambda log, k: driven(log, speed=(k, 0.0)))
    yield Family("the turn is {} times the log's", lambda log, k: driven(log, turn=(k, 0.0)))
    yield Family("the turn has a bias of {} (rad or rad/s)",
                 lambda log, b: driven(log, turn=(1.0, b)), 0.0, factor=False)  # fmt: skip


def _kept(first: int) -> Change:
    return lambda s: s.chosen(np.arange(len(s.time_s)) % 2 == first)


def _every_second_scan(seen: LandmarkMeasurements) -> LandmarkMeasurements:
    return seen.chosen(np.unique(seen.time_s, return_inverse=True)[1] % 2 == 0)


_MEASUREMENTS: dict[str, Change] = {
    "R of the range contains sigma, not its square": lambda s: replace(
        s, sigma_range_m=np.sqrt(s.sigma_range_m)
    ),
    "R of the bearing contains sigma, not its square": lambda s: replace(
        s, sigma_bearing_rad=np.sqrt(s.sigma_bearing_rad)
    ),
    "the sigmas of range and bearing are exchanged": lambda s: replace(
        s, sigma_range_m=s.sigma_bearing_rad, sigma_bearing_rad=s.sigma_range_m
    ),
    "every second measurement is left out, the second first": _kept(0),
    "every second measurement is left out, the first first": _kept(1),
    "every second scan is left out": _every_second_scan,
}
_WHEELS: dict[str, Callable[[OdometryNoise], OdometryNoise]] = {
    "Q of the speed contains sigma, not its square": lambda n: replace(
        n, sigma_speed_mps=np.sqrt(n.sigma_speed_mps)
    ),
    "Q of the turn contains sigma, not its square": lambda n: replace(
        n, sigma_turn=np.sqrt(n.sigma_turn)
    ),
    "the stabilisation noise is left out": lambda n: replace(
        n, variance_rate_position=0.0, variance_rate_heading=0.0
    ),
}


def _shifted_odometry() -> Iterator[Fault]:
    for lag, side in ((1, "late"), (2, "late"), (-1, "early")):
        what = f"the odometry is used {abs(lag)} sample{'s' * (abs(lag) > 1)} {side}"
        yield Fault(what, feed=_shifted(lag))
        if lag > 0:
            yield Fault(f"{what}, the first twice", feed=_shifted(lag, held=True))
            yield Fault(f"{what}, none before the first", _waiting, _shifted(lag))


def _shifted(lag: int, *, held: bool = False) -> Feed:
    """Each control is that of so many samples before. held: the first acts before it, too."""

    def late(values: Array) -> Array:
        found = np.full(len(values), values[0] if held else 0.0)
        if lag > 0:
            found[lag:] = values[:-lag]
        else:
            found[:lag], found[lag:] = values[-lag:], values[-1]
        return found

    return lambda log: controlled(log, late, late)


def _wider_noise(in_range: bool, in_bearing: bool) -> Callable[[Log, float], Log]:
    def feed(log: Log, factor: float) -> Log:
        seen, root = log.measurements, np.sqrt(factor)
        wider = replace(
            seen,
            sigma_range_m=(root if in_range else 1.0) * seen.sigma_range_m,
            sigma_bearing_rad=(root if in_bearing else 1.0) * seen.sigma_bearing_rad,
        )
        return replace(log, measurements=wider)

    return feed


def _wider_control(parts: tuple[str, ...]) -> Callable[[Log, float], Log]:
    """parts: fields of the odometry's noise; rates are variances, the others sigmas."""

    def feed(log: Log, factor: float) -> Log:
        def wider(noise: OdometryNoise) -> OdometryNoise:
            changed = {
                part: (factor if part in _RATES else float(np.sqrt(factor))) * getattr(noise, part)
                for part in parts
            }
            return replace(noise, **changed)

        return _noise(wider)(log)

    return feed


def _with_prior(log: Log, covariance: Array) -> Log:
    return replace(log, prior=replace(log.prior, covariance=covariance))


def _wider_prior(log: Log, factor: float) -> Log:
    return _with_prior(log, factor * log.prior.covariance)


def _prior_of_sigmas(log: Log) -> Log:
    return _with_prior(log, np.diag(np.sqrt(np.diag(log.prior.covariance))))


def _noise(change: Callable[[OdometryNoise], OdometryNoise]) -> Feed:
    def feed(log: Log) -> Log:
        odometry = _wheels(log)
        return replace(log, odometry=replace(odometry, noise=change(odometry.noise)))

    return feed


def _seen(change: Change) -> Feed:
    return lambda log: replace(log, measurements=change(log.measurements))


def _wheels(log: Log) -> SteeringOdometry | VelocityOdometry:
    if isinstance(log.odometry, RelativePoses):
        raise TypeError("no wheels")
    return log.odometry
