"""Drives that record scans: settings, truth, measurements, and the logs that have a name."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from comparisons.logs.bundled import NAMED, SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.scans import Clouds, Scans
from comparisons.logs.simulate.scan_drive import (
    ScanExperiment,
    dense_slam,
    dense_slam_fine,
    dense_slam_in_space,
    occupancy,
    scan_slam,
)
from comparisons.logs.simulate.scanners import Planar, Rings
from ekf_reference.models.motion import AckermannModel
from tests.comparisons.logs.test_log_folder import assert_same
from tests.comparisons.logs.test_scanners import exact, in_bounds, log_of, short

Array = NDArray[np.float64]


def test_odometry_and_measurements_are_as_uncertain_as_stated() -> None:
    noisy, quiet = log_of(occupancy()), log_of(exact(occupancy()))
    wheels, true_wheels = noisy.odometry, quiet.odometry
    assert isinstance(wheels, SteeringOdometry)
    assert isinstance(true_wheels, SteeringOdometry)
    assert wheels.noise == true_wheels.noise
    seen, true = noisy.measurements, quiet.measurements
    assert np.array_equal(seen.landmark, true.landmark)
    for difference, sigma in (
        (wheels.speed_mps - true_wheels.speed_mps, 0.5),
        (wheels.steering_rad - true_wheels.steering_rad, np.deg2rad(5.0)),
        (seen.range_m - true.range_m, 0.1),
        (seen.bearing_rad - true.bearing_rad, np.deg2rad(1.0)),
    ):
        error = difference / sigma
        assert in_bounds(float(error @ error), len(error))
        assert not in_bounds(float(error @ error) * 1.2**2, len(error))


def test_truth_is_there_at_every_sample_and_obeys_the_model() -> None:
    experiment = short(exact(scan_slam()), 30.0)
    log = log_of(experiment)
    odometry = log.odometry
    assert isinstance(odometry, SteeringOdometry)
    assert log.truth.poses is not None
    assert log.truth.surfaces is not None
    time, pose = log.truth.poses.time_s, log.truth.poses.pose
    assert np.array_equal(time[:-1], odometry.time_s)
    model = AckermannModel(**vars(odometry.vehicle))
    for k in range(0, len(odometry.time_s), 29):
        control = np.array((odometry.speed_mps[k], odometry.steering_rad[k]))
        step = model.step(pose[k], control, float(time[k + 1] - time[k]))
        assert np.allclose(step.pose, pose[k + 1], rtol=0, atol=1e-12)


def test_objects_hide_landmarks() -> None:
    """A landmark is measured if, and only if, no side of an object crosses the line of sight."""
    experiment = exact(dense_slam())
    drive = replace(experiment.drive, max_range_m=60.0)
    world, log = experiment.world, log_of(replace(experiment, drive=drive))
    assert log.truth.poses is not None
    samples = drive.scan_samples(len(log.odometry.time_s))
    hidden = 0
    for k in samples[::5]:
        pose, time = log.truth.poses.pose[k], log.truth.poses.time_s[k]
        seen = set(log.measurements.landmark[log.measurements.time_s == time].tolist())
        for i, place in enumerate(world.landmark):
            way = place - pose[:2]
            ahead = np.cos(np.arctan2(way[1], way[0]) - pose[2]) >= 0.0
            if not ahead or np.hypot(*way) > drive.max_range_m:
                assert i not in seen
                continue
            blocked = crossed(pose[:2], place, world.segment)
            assert (i in seen) != blocked
            hidden += blocked
    assert hidden > 100


def crossed(a: Array, b: Array, segment: Array) -> bool:
    """A segment crosses the line from a to b: each pair of ends lies on different sides."""

    def side(p: Array, q: Array, r: Array) -> Array:
        first, second = (q - p).T, (r - p).T
        return np.asarray(first[0] * second[1] - first[1] * second[0])

    c, d = segment[:, :2], segment[:, 2:]
    across = (side(a, b, c) < 0) != (side(a, b, d) < 0)
    return bool((across & ((side(c, d, a) < 0) != (side(c, d, b) < 0))).any())


TABLES = {
    "scan-loop": (dense_slam, 3.0, 0.35, 25.0, 0.15, 1.5),
    "occupancy-loop": (occupancy, 5.0, 0.35, 25.0, 0.10, 1.0),
    "scan-slam": (scan_slam, 5.0, 0.20, 35.0, 0.10, 1.0),
}


@pytest.mark.parametrize("name", TABLES)
def test_settings_are_the_tables(name: str) -> None:
    """Nieto 2005, Tables 3.1, 4.1, 5.1."""
    make, steering_deg, scan_s, reach_m, range_m, bearing_deg = TABLES[name]
    experiment = make()
    drive, laser = experiment.drive, experiment.scanner
    assert experiment.name == name
    assert drive.speed_mps == 3.0
    assert drive.sample_s == 0.025
    assert drive.sigma_speed_mps == 0.5
    assert np.isclose(np.rad2deg(drive.sigma_steering_rad), steering_deg)
    assert np.isclose(drive.scan_every * drive.sample_s, scan_s)
    for sensor in (drive, laser):
        assert sensor.max_range_m == reach_m
    assert drive.sigma_range_m == range_m
    assert np.isclose(np.rad2deg(drive.sigma_bearing_rad), bearing_deg)
    assert laser.sigma_range_m == range_m
    assert np.isclose(np.rad2deg(laser.sigma_beam_rad), bearing_deg)


def test_a_finer_laser_changes_nothing_but_the_beams() -> None:
    table, fine = (short(make()) for make in (dense_slam, dense_slam_fine))
    laser = fine.scanner
    assert isinstance(laser, Planar)
    assert laser.max_range_m == fine.drive.max_range_m == table.drive.max_range_m
    assert (laser.sigma_range_m, laser.sigma_beam_rad) == (0.02, np.deg2rad(0.1))
    rough, exact_beams = log_of(table, 3), log_of(fine, 3)
    without = [replace(log, scans=None, name="", provenance={}) for log in (rough, exact_beams)]
    assert_same(*without)
    assert not np.array_equal(scans_of(rough)[0], scans_of(exact_beams)[0], equal_nan=True)


@pytest.mark.parametrize("make", [dense_slam, dense_slam_in_space, scan_slam])
def test_a_seed_is_a_log_to_the_bit_and_survives_the_disk(
    make: Callable[[], ScanExperiment], tmp_path: Path
) -> None:
    experiment = short(make())
    first, again, other = (
        replace(log_of(experiment, seed), format="log-folder") for seed in (3, 3, 4)
    )
    assert_same(first, again)
    one, two = scans_of(first), scans_of(other)
    for a, b in zip(one, two, strict=True):
        assert not np.array_equal(a, b, equal_nan=True)
    write_log_folder(first, tmp_path / "log")
    read = read_log_folder(tmp_path / "log")
    assert_same(first, read)
    if read.clouds is not None:
        size = np.isfinite(read.clouds.point_m[: read.clouds.first[1], 0])
        assert len(read.clouds.points(0)) == np.count_nonzero(size)


def scans_of(log: Log) -> list[Array]:
    data = [log.scans.range_m] if log.scans is not None else []
    return data + ([log.clouds.point_m] if log.clouds is not None else [])


@pytest.mark.parametrize("name", [*TABLES, "scan-loop-fine", "scan-loop-3d"])
def test_logs_by_name(name: str) -> None:
    log = open_log(name, choices=SimulationChoices(seed=2))
    assert log.name == name
    assert "--seed" in NAMED[name].takes
    assert log.truth.surfaces is not None
    assert len(log.measurements.time_s) == 0 if name == "scan-slam" else log.measurements.labelled
    record = log.clouds if name == "scan-loop-3d" else log.scans
    assert isinstance(record, Clouds if name == "scan-loop-3d" else Scans)
    assert len(record.time_s) > 200
    if isinstance(record, Clouds):
        assert len(np.unique(np.diff(record.first))) == 1
        assert record.first[1] == 16 * Rings().azimuths
        heights = record.points(50)[:, 2]
        assert heights.min() < 0.1
        assert heights.max() > 2.0


def test_more_loops_are_a_longer_log() -> None:
    once, thrice = (open_log("scan-loop", choices=SimulationChoices(loops=n)) for n in (1, 3))
    assert once.truth.poses is not None
    loop = dense_slam().drive.loop_s
    assert np.isclose(thrice.duration_s - once.duration_s, 2 * loop, atol=0.1)
