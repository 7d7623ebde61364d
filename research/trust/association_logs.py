"""Logs on which an association is put to the test: simulated sensors, and pieces of real logs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.log import LandmarkMeasurements, Landmarks, Log, Poses, Prior, Truth
from comparisons.logs.odometry import OdometryNoise, VelocityOdometry
from research.script import present

_STEP_S = 0.25
_STEPS = 480


class RandomVehicle(NamedTuple):
    """A vehicle and its sensor, drawn at random.

    side_m: of the square that it drives in. drive: `waypoints`, `rounds` or `aisles`. spacing_m:
    least distance of two landmarks. excess: factor on the noise that the log does not state.
    """

    side_m: float
    speed_mps: float
    drive: str
    reach_m: float
    view_rad: float
    visible: float
    spacing_m: float
    detected: float
    sigma_range_m: float
    sigma_bearing_rad: float
    sigma_speed_mps: float
    heading_rate: float
    excess: float


def draw_sensor(rng: np.random.Generator) -> RandomVehicle:
    """Draw sizes, densities and noise, each over a wide range."""

    def spread(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    side = spread(6.0, 60.0)
    speed = side * rng.uniform(6.0, 16.0) / (_STEPS * _STEP_S)
    reach = side * rng.uniform(0.25, 0.6)
    return RandomVehicle(
        side_m=side,
        speed_mps=speed,
        drive=str(rng.choice(["waypoints", "rounds", "aisles"])),
        reach_m=reach,
        view_rad=float(rng.choice([1.0, 2.0, math.pi])),
        visible=rng.uniform(0.7, 6.0),
        spacing_m=spread(0.3, 2.5),
        detected=rng.uniform(0.4, 1.0),
        sigma_range_m=reach * spread(0.004, 0.03),
        sigma_bearing_rad=spread(0.006, 0.05),
        sigma_speed_mps=speed * spread(0.03, 0.4),
        heading_rate=spread(1e-5, 3e-3),
        excess=rng.uniform(0.7, 1.5),
    )


def simulated_sensor(seed: int) -> Log:
    """Return a labelled log with truth, of a sensor, a map and a drive that the seed draws."""
    rng = np.random.default_rng((seed, 18))
    sensor = draw_sensor(rng)
    landmark = _landmarks(rng, sensor)
    pose, control = _driven(rng, sensor)
    time = _STEP_S * np.arange(float(len(pose)))
    noise = OdometryNoise(sensor.sigma_speed_mps, 0.0, 1e-6, sensor.heading_rate)
    drawn = sensor.excess * rng.standard_normal((len(control), 2))
    odometry = VelocityOdometry(
        time[:-1],
        control[:, 0] + sensor.sigma_speed_mps * drawn[:, 0],
        control[:, 1] + math.sqrt(sensor.heading_rate / _STEP_S) * drawn[:, 1],
        noise,
    )
    return Log(
        name=f"sensor-{seed}",
        format="simulated",
        prior=Prior(0.0, pose[0], np.diag((0.01, 0.01, 0.01)) ** 2),
        odometry=odometry,
        measurements=_measurements(rng, sensor, landmark, time, pose),
        truth=Truth(
            Poses(time, pose),
            Landmarks(np.arange(len(landmark)), landmark, np.zeros((len(landmark), 2, 2))),
        ),
        provenance={name: str(value) for name, value in sensor._asdict().items()},
    )


def _landmarks(rng: np.random.Generator, s: RandomVehicle) -> Array:
    """(L, 2), none nearer to another than the spacing."""
    seen_m2 = 0.5 * s.view_rad * s.reach_m**2
    count = int(np.clip(s.visible * s.side_m**2 / seen_m2, 4, 90))
    found = np.zeros((0, 2))
    for _ in range(60 * count):
        place = rng.uniform(-0.1 * s.side_m, 1.1 * s.side_m, 2)
        if not len(found) or np.linalg.norm(found - place, axis=1).min() > s.spacing_m:
            found = np.vstack((found, place))
        if len(found) == count:
            break
    return found


def _driven(rng: np.random.Generator, s: RandomVehicle) -> tuple[Array, Array]:
    """True poses (N + 1, 3) and controls (N, 2) of a vehicle that heads for goal after goal."""
    goals = _goals(rng, s)
    pose = np.empty((_STEPS + 1, 3))
    ahead = goals[1] - goals[0]
    pose[0] = (*goals[0], math.atan2(ahead[1], ahead[0]))
    control, at = np.empty((_STEPS, 2)), 1
    most = 1.6 * s.speed_mps / (0.08 * s.side_m)
    for k in range(_STEPS):
        off = goals[at % len(goals)] - pose[k, :2]
        if np.linalg.norm(off) < 0.1 * s.side_m:
            at += 1
            off = goals[at % len(goals)] - pose[k, :2]
        wrong = math.remainder(math.atan2(off[1], off[0]) - pose[k, 2], 2.0 * math.pi)
        rate = float(np.clip(wrong / (2.0 * _STEP_S), -most, most))
        control[k] = s.speed_mps, rate
        along = pose[k, 2] + 0.5 * _STEP_S * rate
        pose[k + 1] = pose[k] + _STEP_S * np.array(
            (s.speed_mps * math.cos(along), s.speed_mps * math.sin(along), rate)
        )
    return pose, control


def _goals(rng: np.random.Generator, s: RandomVehicle) -> Array:
    """(G, 2), of which the first is the start."""
    if s.drive == "rounds":
        turn = 2.0 * np.pi * np.arange(12) / 12
        return s.side_m * (0.5 + 0.4 * np.column_stack((np.cos(turn), np.sin(turn))))
    if s.drive == "aisles":
        lanes = np.linspace(0.1, 0.9, 4)
        ends = [(x, y) for i, y in enumerate(lanes) for x in ((0.1, 0.9), (0.9, 0.1))[i % 2]]
        return s.side_m * np.array(ends)
    return s.side_m * rng.uniform(0.1, 0.9, (40, 2))


def _measurements(
    rng: np.random.Generator, s: RandomVehicle, landmark: Array, time: Array, pose: Array
) -> LandmarkMeasurements:
    offset = landmark - pose[:, None, :2]
    distance = np.linalg.norm(offset, axis=2)
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - pose[:, None, 2]
    bearing = np.angle(np.exp(1j * bearing))
    seen = (distance <= s.reach_m) & (distance > 0.3) & (np.abs(bearing) <= 0.5 * s.view_rad)
    scan, which = np.nonzero(seen & (rng.random(seen.shape) < s.detected))
    noise = s.excess * rng.standard_normal((len(scan), 2))
    count = len(scan)
    drawn = distance[scan, which] + s.sigma_range_m * noise[:, 0]
    return LandmarkMeasurements(
        time_s=time[scan],
        range_m=np.maximum(drawn, 0.1),
        bearing_rad=bearing[scan, which] + s.sigma_bearing_rad * noise[:, 1],
        sigma_range_m=np.full(count, s.sigma_range_m),
        sigma_bearing_rad=np.full(count, s.sigma_bearing_rad),
        landmark=which,
    )


def piece(log: Log, begin_s: float, end_s: float, seed: int = 0, noise: float = 0.0) -> Log:
    """Return a stretch of a log with wheel odometry, its prior from the true poses.

    noise: further noise on measurements and on the turns, in units of their sigmas; the stated ones
    grow with it.
    """
    rng, odometry, seen = np.random.default_rng((seed, 7)), log.odometry, log.measurements
    assert isinstance(odometry, VelocityOdometry)
    rows = (odometry.time_s >= begin_s) & (odometry.time_s <= end_s)
    kept = seen.chosen((seen.time_s > begin_s) & (seen.time_s <= end_s))
    drawn, grown = noise * rng.standard_normal((2, len(kept.time_s))), math.hypot(1.0, noise)
    rate = noise**2 * odometry.noise.variance_rate_heading
    step_s = float(np.median(np.diff(odometry.time_s)))
    driven = odometry.chosen(rows)
    turned = math.sqrt(rate / step_s) * rng.standard_normal(len(driven.time_s))
    spread = odometry.noise.variance_rate_heading + rate
    return replace(
        log,
        name=f"{log.name}-{begin_s:.0f}-{noise:g}",
        prior=replace(
            log.prior, time_s=begin_s, pose=present(log.truth.poses).at(np.array([begin_s]))[0]
        ),
        odometry=replace(
            driven,
            yaw_rate_radps=driven.yaw_rate_radps + turned,
            noise=replace(odometry.noise, variance_rate_heading=spread),
        ),
        measurements=replace(
            kept,
            range_m=np.maximum(kept.range_m + kept.sigma_range_m * drawn[0], 0.1),
            bearing_rad=kept.bearing_rad + kept.sigma_bearing_rad * drawn[1],
            sigma_range_m=grown * kept.sigma_range_m,
            sigma_bearing_rad=grown * kept.sigma_bearing_rad,
        ),
    )
