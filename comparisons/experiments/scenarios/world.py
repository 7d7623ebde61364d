"""What a scenario describes, exactly: the path, the landmarks, and what is seen when.

The noise-free controls drive the path, so it is the same in all runs; a run's noise is in what it
measures. So all runs see the same landmarks at the same time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError, naming
from comparisons.experiments.scenarios.scenario import (
    Circle,
    PointLandmarks,
    RelativePositionSensor,
    Ring,
    Scenario,
    Waypoints,
)
from comparisons.experiments.variants.batch_ekf import Robot
from comparisons.experiments.variants.batch_models import (
    BatchRangeBearing,
    BatchSensor,
    RelativePosition,
    unicycle,
)
from comparisons.logs.log import LandmarkMeasurements, Log, Prior
from comparisons.logs.odometry import OdometryNoise, VelocityOdometry
from comparisons.logs.simulate.polygons import along_sides
from comparisons.logs.simulate.worlds import nieto_loop
from ekf_reference.core.geometry import wrap_angle

_MOST_LOOKAHEADS = 100_000
_FULL_TURN = 2.0 * math.pi
_STABILISATION = (1e-12, 0.0)
"""Of a log [m^2/s, rad^2/s]: makes one step's motion regular, and is far below every sensor."""


@dataclass(frozen=True, kw_only=True)
class ScenarioWorld:
    """Truth. pose: (K + 1, 3). control: (K, 2). landmark: (L, 2), of those that are ever seen.

    seen: per step the landmarks (m,) measured after it. sigma: per step their sigmas (m, 2).
    """

    robot: Robot
    pose: Array
    control: Array
    landmark: Array
    seen: tuple[NDArray[np.intp], ...]
    sigma: tuple[Array, ...]

    @property
    def first_seen(self) -> NDArray[np.intp]:
        """(L,) landmarks in the order in which they are first measured."""
        every = np.concatenate(self.seen)
        return every[np.sort(np.unique(every, return_index=True)[1])]


@dataclass(frozen=True)
class WorldMeasurements:
    """control: (B, K, 2). z: per step (B, m, 2)."""

    control: Array
    z: tuple[Array, ...]


def build_world(scenario: Scenario, place: str = "scenario") -> ScenarioWorld:
    """The truth of a scenario. place: where it was read, for errors.

    Raises InputError where no landmark is ever seen, or no way.
    """
    with naming(place):
        return _world(scenario)


def _world(scenario: Scenario) -> ScenarioWorld:
    control, pose = _drive(scenario)
    landmark = _landmarks(scenario)
    offset = landmark[None] - pose[1:, None, :2]
    distance = np.linalg.norm(offset, axis=2)
    bearing = wrap_angle(np.arctan2(offset[..., 1], offset[..., 0]) - pose[1:, 2:])
    sensor = scenario.sensor
    view = (distance <= sensor.max_range_m) & (distance > 0.0)
    if sensor.field_of_view_rad < _FULL_TURN:
        view &= np.abs(bearing) <= 0.5 * sensor.field_of_view_rad
    view[(np.arange(len(view)) + 1) % sensor.every != 0] = False
    used = np.flatnonzero(view.any(axis=0))
    if not len(used):
        raise InputError("no landmark is ever within the sensor's range")
    sigma = _sigma(scenario, distance)[:, used]
    seen = [np.flatnonzero(row) for row in view[:, used]]
    odometry = scenario.odometry
    robot = Robot(
        pose[0],
        np.diag((scenario.sigma_start_m, scenario.sigma_start_m, scenario.sigma_start_rad)) ** 2,
        _sensor(scenario),
        scenario.step_s,
        np.array((odometry.sigma_speed_mps, odometry.sigma_yaw_rate_radps)),
    )
    return ScenarioWorld(
        robot=robot,
        pose=pose,
        control=control,
        landmark=landmark[used],
        seen=tuple(seen),
        sigma=tuple(row[which] for row, which in zip(sigma, seen, strict=True)),
    )


def measure(world: ScenarioWorld, runs: range) -> WorldMeasurements:
    """What the runs of these numbers measure; a run's number is its seed."""
    counts = [len(which) for which in world.seen]
    ends = np.cumsum(counts)
    where = np.repeat(world.pose[1:], counts, axis=0)
    offset = world.landmark[np.concatenate(world.seen)] - where[:, :2]
    exact = world.robot.sensor.predict(where[:, 2], offset)
    sigma = np.concatenate(world.sigma)
    control = np.empty((len(runs), *world.control.shape))
    z = np.empty((len(runs), *exact.shape))
    for row, run in enumerate(runs):
        rng = np.random.default_rng(run)
        noise = rng.standard_normal(world.control.shape)
        control[row] = world.control + world.robot.sigma_odometry * noise
        z[row] = exact + sigma * rng.standard_normal(exact.shape)
    return WorldMeasurements(control, tuple(np.split(z, ends[:-1], axis=1)))


def log_of_run(world: ScenarioWorld, run: int, name: str) -> Log:
    """Return what one run measures as a log, without any truth.

    Landmarks have the world's numbers as ids. Relative positions become range and bearing, with
    their noise to first order at the true distance, which is where it is known. The last odometry
    sample is repeated at the end, so that the log ends where the run does.
    """
    data, robot = measure(world, range(run, run + 1)), world.robot
    time_s: Array = robot.step_s * np.arange(len(world.control) + 1, dtype=float)
    control = data.control[0][[*range(len(world.control)), -1]]
    sigma_speed_mps, sigma_turn = robot.sigma_odometry.tolist()
    label, sigma = np.concatenate(world.seen), np.concatenate(world.sigma)
    step = np.repeat(np.arange(1, len(time_s)), [len(which) for which in world.seen])
    z = np.concatenate([one[0] for one in data.z])
    if isinstance(robot.sensor, RelativePosition):
        distance = np.linalg.norm(world.landmark[label] - world.pose[step, :2], axis=1)
        sigma = np.column_stack((sigma[:, 0], sigma[:, 1] / distance))
        z = np.column_stack((np.hypot(z[:, 0], z[:, 1]), np.arctan2(z[:, 1], z[:, 0])))
    real = z[:, 0] > 0.0  # noise may make a short range negative, which no sensor says
    return Log(
        name=name,
        format="log-folder",
        prior=Prior(0.0, robot.pose, robot.covariance),
        odometry=VelocityOdometry(
            time_s,
            control[:, 0],
            control[:, 1],
            OdometryNoise(sigma_speed_mps, sigma_turn, *_STABILISATION),
        ),
        measurements=LandmarkMeasurements(
            time_s=time_s[step[real]],
            range_m=z[real, 0],
            bearing_rad=wrap_angle(z[real, 1]),
            sigma_range_m=sigma[real, 0],
            sigma_bearing_rad=sigma[real, 1],
            landmark=label[real].astype(np.int64),
        ),
    )


def _sensor(scenario: Scenario) -> BatchSensor:
    if isinstance(scenario.sensor, RelativePositionSensor):
        return RelativePosition()
    return BatchRangeBearing()


def _sigma(scenario: Scenario, distance: Array) -> Array:
    """(K, L, 2) sigmas of measurements; a sensor states its noise, so they are known exactly."""
    sensor = scenario.sensor
    if isinstance(sensor, RelativePositionSensor):
        along = sensor.sigma_m + sensor.sigma_share * distance
        return np.stack((along, along), axis=2)
    along = sensor.sigma_range_m + sensor.sigma_range_share * distance
    return np.stack((along, np.full_like(along, sensor.sigma_bearing_rad)), axis=2)


def _landmarks(scenario: Scenario) -> Array:
    landmarks = scenario.landmarks
    if isinstance(landmarks, Ring):
        angle = _FULL_TURN * np.arange(landmarks.count) / landmarks.count
        radius = np.resize(np.array(landmarks.radii_m), landmarks.count)
        ring = np.column_stack((radius * np.cos(angle), radius * np.sin(angle)))
        point: Array = np.array(landmarks.centre) + ring
        return point
    if isinstance(landmarks, PointLandmarks):
        return np.array(landmarks.points)
    return nieto_loop().landmark


def _drive(scenario: Scenario) -> tuple[Array, Array]:
    """True controls (K, 2) and poses (K + 1, 3)."""
    course, steps = scenario.course, scenario.steps
    if isinstance(course, Circle):
        control = np.tile((course.speed_mps, course.yaw_rate_radps), (steps, 1))
        pose = np.zeros((steps + 1, 3))
        for k in range(steps):
            pose[k + 1] = unicycle(pose[k], control[k], scenario.step_s)
        return control, pose
    corners = np.array(course.points) if isinstance(course, Waypoints) else nieto_loop().path
    return _pursue(corners, course.speed_mps, course.lookahead_m, scenario.step_s, steps)


def _pursue(
    corner: Array, speed_mps: float, lookahead_m: float, step_s: float, steps: int
) -> tuple[Array, Array]:
    """Pure pursuit of the point that lies ahead on a closed polygon (C, 2)."""
    length_m = float(np.linalg.norm(corner - np.roll(corner, -1, axis=0), axis=1).sum())
    if not 0.0 < length_m <= _MOST_LOOKAHEADS * lookahead_m:
        raise InputError(
            f"course: {length_m:g} m long with a lookahead_m of {lookahead_m:g}, "
            f"expected up to {_MOST_LOOKAHEADS:,} times that"
        )
    path = along_sides(corner, 0.1 * lookahead_m)
    first = path[1] - path[0]
    pose, control = np.empty((steps + 1, 3)), np.empty((steps, 2))
    pose[0] = *path[0], math.atan2(first[1], first[0])
    goal = 0
    for k in range(steps):
        x, y, heading = pose[k]
        ahead_of_us = np.roll(path, -goal, axis=0) - (x, y)
        far = np.hypot(ahead_of_us[:, 0], ahead_of_us[:, 1]) >= lookahead_m
        if not far.any():
            raise InputError("course: all of it lies within lookahead_m of the robot")
        goal = (goal + int(far.argmax())) % len(path)
        ahead = math.atan2(path[goal, 1] - y, path[goal, 0] - x) - heading
        distance = math.hypot(path[goal, 1] - y, path[goal, 0] - x)
        control[k] = speed_mps, 2.0 * speed_mps * math.sin(ahead) / distance
        pose[k + 1] = unicycle(pose[k], control[k], step_s)
    return control, pose
