"""The environments of Nieto's figures: their extent, room to drive, what stands in them."""

import numpy as np
import pytest

from comparisons.logs.simulate.drive import true_drive
from comparisons.logs.simulate.ray_casting import cast
from comparisons.logs.simulate.scan_drive import ScanExperiment, dense_slam, occupancy, scan_slam
from comparisons.logs.simulate.scan_worlds import Mover

EXPERIMENTS = [dense_slam(), occupancy(), scan_slam()]
EXTENT_M = {"scan-loop": (100, 80), "occupancy-loop": (100, 80), "scan-slam": (180, 160)}
BODY_M = 1.5


@pytest.fixture(params=EXPERIMENTS, ids=lambda experiment: str(experiment.name))
def experiment(request: pytest.FixtureRequest) -> ScanExperiment:
    found = request.param
    assert isinstance(found, ScanExperiment)
    return found


def test_the_extent_is_the_thesis_s(experiment: ScanExperiment) -> None:
    world = experiment.world
    everything = np.vstack((world.path, world.landmark, *world.outline))
    assert np.abs(np.ptp(everything, axis=0) - EXTENT_M[experiment.name]).max() < 3.0


def test_the_path_is_a_smooth_loop_driven_counter_clockwise_from_the_origin(
    experiment: ScanExperiment,
) -> None:
    path = experiment.world.path
    after = np.roll(path, -1, axis=0)
    step = np.linalg.norm(after - path, axis=1)
    assert np.ptp(step) < 0.01 * step.mean()
    assert np.array_equal(path[0], (0.0, 0.0))
    assert 0.5 * np.sum(path[:, 0] * after[:, 1] - path[:, 1] * after[:, 0]) > 1000.0
    turn = np.diff(np.unwrap(np.arctan2(*(after - path).T[::-1])))
    assert np.abs(turn / step[1:]).max() < 1.0 / 6.0  # the vehicle's smallest radius, and some


def test_the_vehicle_has_room(experiment: ScanExperiment) -> None:
    """Nothing within the body's width of laser or rear axle, all the way."""
    _, _, pose = true_drive(experiment.drive, experiment.world)
    ahead = experiment.drive.vehicle.sensor_forward_m
    back = pose[:, :2] - ahead * np.column_stack((np.cos(pose[:, 2]), np.sin(pose[:, 2])))
    solids = experiment.world.solids()
    for place in np.vstack((pose[::8, :2], back[::8])):
        near = solids.within(place, BODY_M)
        assert not len(near.segment), place
        assert not len(near.disc), place


def test_the_loop_is_closed_and_the_start_passed_again(experiment: ScanExperiment) -> None:
    _, _, pose = true_drive(experiment.drive, experiment.world)
    away = np.linalg.norm(pose[:, :2] - pose[0, :2], axis=1)
    late = away[len(away) // 2 :]
    assert late.min() < 1.0
    assert 20.0 < away[-1] < 40.0
    assert pose[-1, 2] == pytest.approx(2 * np.pi, abs=0.5)


def test_outlines_are_counter_clockwise_and_apart(experiment: ScanExperiment) -> None:
    world = experiment.world
    solids = world.solids()
    assert len(world.outline) == len(world.outline_height_m)
    for i, corner in enumerate(world.outline):
        after = np.roll(corner, -1, axis=0)
        assert 0.5 * np.sum(corner[:, 0] * after[:, 1] - corner[:, 1] * after[:, 0]) > 5.0
        others = solids.outline != i
        for point in corner:
            near = solids.within(point, 1.0)
            assert not np.isin(near.outline, solids.outline[others]).any()


def test_every_scan_sees_something(experiment: ScanExperiment) -> None:
    _, _, pose = true_drive(experiment.drive, experiment.world)
    angle = np.deg2rad(np.linspace(-90.0, 90.0, 361))
    solids = experiment.world.solids()
    for place in pose[::100]:
        seen = cast(angle, place, solids) <= experiment.drive.max_range_m
        assert np.count_nonzero(seen) > 50


def test_landmarks_stand_clear_and_are_poles(experiment: ScanExperiment) -> None:
    world = experiment.world
    if experiment.name == "scan-slam":
        assert not len(world.landmark)
        return
    assert len(world.landmark) > 25
    assert np.array_equal(world.pole[:, :2], world.landmark)
    solids = world.solids()
    for place in world.landmark:
        assert not len(solids.within(place, 1.4).segment)
        outward = cast(np.linspace(-np.pi, np.pi, 8), np.array((*place, 0.0)), solids)
        assert not np.isfinite(outward).all()  # inside an object every beam would return


def test_truth_surfaces_are_the_outlines_and_nearly_the_poles(experiment: ScanExperiment) -> None:
    world = experiment.world
    segment = world.surfaces().segment
    sides = len(world.segment)
    assert np.array_equal(segment[:sides], world.segment)
    start, end = segment[sides:, :2], segment[sides:, 2:]
    around = np.repeat(world.pole, 32, axis=0)
    for points in (start, end, 0.5 * (start + end)):
        radius = np.linalg.norm(points - around[:, :2], axis=1)
        assert np.allclose(radius, 0.5 * around[:, 2], rtol=0.005, atol=0)


def test_a_mover_goes_there_and_back() -> None:
    mover = Mover(start=(0.0, 0.0), end=(4.0, 0.0), speed_mps=2.0, lead_s=0.5)
    place = mover.place(np.array((-0.5, 0.0, 1.5, 2.5, 3.5, 4.0, 7.5)))
    assert np.allclose(place[:, 0], (0.0, 1.0, 4.0, 2.0, 0.0, 1.0, 0.0), atol=1e-12)
    assert not place[:, 1].any()
