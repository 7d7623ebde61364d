import numpy as np
import pytest

from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.logs.simulate.worlds import nieto_loop
from ekf_reference.models.motion import AckermannModel
from ekf_reference.models.range_bearing import RangeBearing
from tests.helpers import present, simulated


def test_the_environment_is_that_of_section_2_9() -> None:
    world = nieto_loop()
    closed = np.vstack((world.path, world.path[:1]))
    assert np.isclose(np.linalg.norm(np.diff(closed, axis=0), axis=1).sum(), 255.0)
    everything = np.vstack((world.path, world.landmark))
    assert np.all(np.abs(np.ptp(everything, axis=0) - (100.0, 80.0)) < 5.0)
    (x0, y0), (x1, y1) = world.path[0], world.path[1]
    assert x0 * y1 - y0 * x1 > 0  # counter-clockwise


def test_truth_obeys_the_models_exactly_when_there_is_no_noise() -> None:
    log = simulated(exact=True)
    odometry, truth = log.odometry, log.truth
    assert isinstance(odometry, SteeringOdometry)
    assert truth.poses is not None
    model, pose = AckermannModel(**vars(odometry.vehicle)), truth.poses.pose
    for k in range(0, len(odometry.time_s), 97):
        control = np.array((odometry.speed_mps[k], odometry.steering_rad[k]))
        step = model.step(pose[k], control, Drive().sample_s)
        assert np.allclose(step.pose, pose[k + 1], rtol=0, atol=1e-12)
    at = pose[np.searchsorted(truth.poses.time_s, log.measurements.time_s)]
    landmark = present(truth.landmarks).position_m[log.measurements.landmark]
    for k in range(0, len(at), 41):
        expected = RangeBearing().predict(at[k], landmark[k : k + 1]).z
        seen = np.array([[log.measurements.range_m[k], log.measurements.bearing_rad[k]]])
        assert np.allclose(RangeBearing().innovation(seen, expected), 0.0, atol=1e-12)


def test_the_loop_closes_and_repeats() -> None:
    log = simulated(exact=True, loops=2)
    pose = present(log.truth.poses).pose
    middle = len(pose) // 2
    assert np.linalg.norm(pose[middle, :2] - pose[0, :2]) < 5.0
    assert np.isclose(pose[-1, 2] - pose[0, 2], 4 * np.pi, atol=0.2)


@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_noise_has_the_stated_sigmas(scale: float) -> None:
    """Sigmas of the noise added are those stated, and of the settings times the scale."""
    quiet, noisy = simulated(exact=True), simulated(noise_scale=scale)
    assert isinstance(quiet.odometry, SteeringOdometry)
    assert isinstance(noisy.odometry, SteeringOdometry)
    noise, seen, true = noisy.odometry.noise, noisy.measurements, quiet.measurements
    for difference, sigma, setting in (
        (noisy.odometry.speed_mps - quiet.odometry.speed_mps, noise.sigma_speed_mps, 0.3),
        (
            noisy.odometry.steering_rad - quiet.odometry.steering_rad,
            noise.sigma_turn,
            np.deg2rad(3.0),
        ),
        (seen.range_m - true.range_m, seen.sigma_range_m[0], 0.15),
        (seen.bearing_rad - true.bearing_rad, seen.sigma_bearing_rad[0], np.deg2rad(1.0)),
    ):
        assert sigma == pytest.approx(scale * setting)
        n = len(difference)
        assert abs(np.mean(difference)) < 4 * sigma / np.sqrt(n)
        assert abs(np.std(difference) / sigma - 1) < 4 / np.sqrt(2 * n)


def test_a_seed_is_a_log() -> None:
    first, again = (simulate(np.random.default_rng(3)) for _ in range(2))
    other = simulate(np.random.default_rng(4))
    assert np.array_equal(first.measurements.range_m, again.measurements.range_m)
    assert not np.array_equal(first.odometry.speed_mps, other.odometry.speed_mps)  # type: ignore[union-attr]
