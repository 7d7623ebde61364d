"""Short logs of every kind: each odometry, each kind of map, each way of measuring."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from comparisons.adapters.motion import motion_samples
from comparisons.adapters.timeline import build_timeline
from comparisons.logs.log import LandmarkMeasurements, Landmarks, Log, Positions
from comparisons.logs.odometry import (
    OdometryNoise,
    RelativePoses,
    SteeringOdometry,
    VelocityOdometry,
)
from comparisons.logs.readers.victoria_park import UTE
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.logs.stamps import resolved
from tests.helpers import present, simulated, without_labels

SURVEY_SIGMA_M = 0.05


@cache
def steering() -> Log:
    """Speed and steering angle; fifty steps, twelve scans."""
    return simulated(seed=2, loop_s=5.0, sample_s=0.1, scan_every=4)


@cache
def velocity() -> Log:
    """Speed and turn rate, of a vehicle whose sensor is at its axle."""
    axle = replace(UTE, encoder_offset_m=0.0, sensor_forward_m=0.0, sensor_left_m=0.0)
    drive = Drive(loop_s=5.0, sample_s=0.1, scan_every=4, vehicle=axle)
    log = simulate(np.random.default_rng(2), drive)
    o = log.odometry
    assert isinstance(o, SteeringOdometry)
    rate = o.speed_mps * np.tan(o.steering_rad) / axle.wheelbase_m
    noise = OdometryNoise(0.3, 0.06, 1e-7, 1e-9)
    return replace(log, odometry=VelocityOdometry(o.time_s, o.speed_mps, rate, noise))


@cache
def relative() -> Log:
    """Displacements from instant to instant, each with a covariance."""
    log = steering()
    timeline = build_timeline(log)
    moved = motion_samples(log, timeline).displacement
    covariance = np.tile(np.diag((0.03, 0.01, 0.005)) ** 2, (len(moved), 1, 1))
    measurements = replace(log.measurements, time_s=resolved(log.measurements.time_s))
    odometry = RelativePoses(resolved(timeline.step_end_s), moved, covariance)
    return replace(log, odometry=odometry, measurements=measurements)


ODOMETRY: dict[str, Callable[[], Log]] = {
    "steering": steering,
    "velocity": velocity,
    "relative poses": relative,
}


def surveyed_landmarks(log: Log, every: int) -> Log:
    """Every n-th landmark is known beforehand, and its measurements refer to it."""
    truth = present(log.truth.landmarks)
    ids = truth.id[::every]
    covariance = np.tile(SURVEY_SIGMA_M**2 * np.eye(2), (len(ids), 1, 1))
    known = np.isin(log.measurements.landmark, ids)
    return replace(
        log,
        measurements=log.measurements.chosen(~known),
        known_landmarks=Landmarks(ids, truth.position_m[::every], covariance),
        known_measurements=log.measurements.chosen(known),
    )


def no_measurements(log: Log) -> LandmarkMeasurements:
    """None at all."""
    return log.measurements.chosen(np.zeros(len(log.measurements.time_s), dtype=bool))


def with_positions(log: Log, first_s: float = 0.0, *, alone: bool = False) -> Log:
    """Positions at the scans from a time on, of an antenna ahead of the pose."""
    poses = present(log.truth.poses)
    time_s = np.unique(log.measurements.time_s)
    time_s = time_s[time_s >= first_s]
    pose = poses.pose[np.searchsorted(poses.time_s, time_s - 1e-6)]
    ahead = np.column_stack((np.cos(pose[:, 2]), np.sin(pose[:, 2])))
    covariance = np.tile(0.04 * np.eye(2), (len(time_s), 1, 1))
    positions = Positions(time_s, pose[:, :2] + 0.5 * ahead, covariance, (0.5, 0.0))
    measurements = no_measurements(log) if alone else log.measurements
    return replace(log, positions=positions, measurements=measurements)


def one_landmark(log: Log) -> Log:
    """The one that is measured most."""
    label = log.measurements.landmark
    most = int(np.argmax(np.bincount(label)))
    return replace(log, measurements=log.measurements.chosen(label == most))


def unconfirmed(log: Log) -> Log:
    """Detections without labels that may be spurious."""
    bare = without_labels(log)
    return replace(bare, measurements=replace(bare.measurements, needs_confirmation=True))


MAPS: dict[str, Callable[[Log], Log]] = {
    "labels": lambda log: log,
    "gated labels": lambda log: replace(
        log, measurements=replace(log.measurements, label_gate=12.0)
    ),
    "no labels": without_labels,
    "unconfirmed detections": unconfirmed,
    "one landmark": one_landmark,
    "some landmarks surveyed": lambda log: surveyed_landmarks(log, 3),
    "all landmarks surveyed": lambda log: surveyed_landmarks(log, 1),
    "some surveyed, no labels": lambda log: without_labels(surveyed_landmarks(log, 3)),
    "positions": with_positions,
    "positions at the end": lambda log: with_positions(log, 4.0),
    "positions alone": lambda log: with_positions(log, alone=True),
    "surveyed, and positions": lambda log: surveyed_landmarks(with_positions(log), 3),
    "the first scan alone": lambda log: replace(
        log, measurements=log.measurements.chosen(
            log.measurements.time_s == log.measurements.time_s[0]
        )
    ),
    "dead reckoning": lambda log: replace(log, measurements=no_measurements(log)),
}  # fmt: skip
