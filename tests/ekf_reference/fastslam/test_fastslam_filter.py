"""FastSLAM against the Kalman filter, plain loops, and itself."""

import math
from copy import deepcopy
from typing import NamedTuple

import numpy as np
import pytest

from ekf_reference.core.ekf import Stabilisation
from ekf_reference.core.geometry import Array, Index, wrap_angle
from ekf_reference.core.landmark_types import MeasurementModel, diagonal_noise
from ekf_reference.core.measurements import Measurements
from ekf_reference.fastslam import filter as filter_module
from ekf_reference.fastslam.accumulated_motion import AccumulatedMotion
from ekf_reference.fastslam.association import KnownIdentities
from ekf_reference.fastslam.filter import FastSlam, FastSlamOptions, Proposal
from ekf_reference.fastslam.particle_maps import ParticleMaps, ParticlePredictions, inverse_2x2
from ekf_reference.models.motion import (
    AckermannModel,
    MotionModel,
    RelativePoseModel,
    UnicycleModel,
)
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.fastslam.linear_sensor import PlaceDifference, standing

PROPOSALS: tuple[Proposal, ...] = ("motion", "measurement")
PRIOR = np.diag((0.2, 0.1, 0.0))
CONTROL, STEP_NOISE = np.array([1.0, 0.3, 0.0]), np.diag((0.3, 0.2, 0.0))
R = np.array([[[0.2, 0.05], [0.05, 0.15]]])
LEVEL = 1e-4
"""Of one-sided chi-square tests; the seeds are fixed."""


class Kalman(NamedTuple):
    mean: Array
    covariance: Array
    log_evidence: float


def scans() -> list[Array]:
    generator = np.random.default_rng(3)
    truth, place, found = np.zeros(2), np.array([6.0, 2.0]), []
    for _ in range(4):
        truth = truth + CONTROL[:2] + generator.multivariate_normal((0, 0), STEP_NOISE[:2, :2])
        found.append(place - truth + generator.multivariate_normal((0, 0), R[0]))
    return found


def kalman() -> Kalman:
    """One landmark and linear motion, exactly: x, y of the vehicle and of the landmark."""
    mean, p, evidence = np.zeros(4), np.zeros((4, 4)), 0.0
    p[:2, :2] = PRIOR[:2, :2]
    h = np.hstack((-np.eye(2), np.eye(2)))
    for k, z in enumerate(scans()):
        mean[:2] += CONTROL[:2]
        p[:2, :2] += STEP_NOISE[:2, :2]
        if k == 0:
            mean[2:], by = mean[:2] + z, np.vstack((np.eye(2), np.eye(2)))
            p = by @ p[:2, :2] @ by.T
            p[2:, 2:] += R[0]
            continue
        s, nu = h @ p @ h.T + R[0], z - h @ mean
        evidence -= 0.5 * float(nu @ np.linalg.solve(s, nu) + np.linalg.slogdet(2 * math.pi * s)[1])
        gain = p @ h.T @ np.linalg.inv(s)
        mean, p = mean + gain @ nu, p - gain @ h @ p
    return Kalman(mean, p, evidence)


class Runs(NamedTuple):
    """First and second moments of the clouds (S, 4) and (S, 4, 4), and ln of the evidence (S,)."""

    mean: Array
    square: Array
    log_evidence: Array


def small_runs(proposal: Proposal, seeds: int, particles: int = 30) -> Runs:
    exact, found = kalman(), ([], [], [])  # type: ignore[var-annotated]
    options = FastSlamOptions(particles=particles, proposal=proposal, sensor=PlaceDifference())
    for seed in range(seeds):
        generator = np.random.default_rng((seed, 11))
        slam = FastSlam(RelativePoseModel(), np.zeros(3), PRIOR, generator, options)
        for z in scans():
            slam.predict(CONTROL, STEP_NOISE, 1.0)
            slam.observe(Measurements(z[None], R, np.array([5])))
        weight, vehicle = slam.weight, slam.pose[:, :2]
        column = slam.maps.columns_of(np.array([5]))[0]
        both = np.hstack((vehicle, slam.maps.mean[:, column])) - exact.mean
        square = np.einsum("n,ni,nj->ij", weight, both, both)
        square[2:, 2:] += np.einsum("n,nij->ij", weight, slam.maps.covariance[:, column])
        for held, value in zip(found, (weight @ both, square, slam.log_evidence), strict=True):
            held.append(value)
    return Runs(*map(np.array, found))


def excess(runs: Runs) -> float:
    """Least p-value of means, covariance and evidence against the Kalman filter's.

    Runs weighted by their estimate of the evidence make one cloud without bias, however few
    particles each has; how they scatter is the Monte Carlo error.
    """
    from scipy.stats import chi2

    exact = kalman()
    z = np.exp(runs.log_evidence - exact.log_evidence)
    corners = np.triu_indices(4)
    offset = runs.square - exact.covariance
    parts = (runs.mean, offset[:, corners[0], corners[1]])
    least = 1.0
    for part in parts:
        centre = z @ part / z.sum()
        scatter = z[:, None] * (part - centre) / z.sum()
        t2 = float(centre @ np.linalg.solve(scatter.T @ scatter, centre))
        least = min(least, float(chi2.sf(t2, part.shape[1])))
    t2 = (z.mean() - 1.0) ** 2 / (z.var() / len(z))
    return min(least, float(chi2.sf(t2, 1)))


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [250, pytest.param(2000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("proposal", PROPOSALS)
def test_linear_posterior_and_evidence_are_the_kalman_filters(
    proposal: Proposal, seeds: int
) -> None:
    assert excess(small_runs(proposal, seeds)) > LEVEL


def wide_motion(self: AccumulatedMotion) -> Array:
    return 1.3 * np.sqrt(np.maximum(self.covariance, 0.0))


def certain_landmarks(
    maps: ParticleMaps, pose: Array, columns: Array, sensor: MeasurementModel
) -> ParticlePredictions:
    at = EXPECTED(maps, pose, columns, sensor)  # type: ignore[arg-type]
    return at._replace(spread=0.0 * at.spread)


EXPECTED = ParticleMaps.expected


@pytest.mark.slow
@pytest.mark.parametrize("proposal", PROPOSALS)
@pytest.mark.parametrize("fault", ["motion too wide", "landmark taken for certain", "no ln |S|"])
def test_broken_filters_are_rejected(
    fault: str, proposal: Proposal, monkeypatch: pytest.MonkeyPatch
) -> None:
    if fault == "motion too wide":
        monkeypatch.setattr(AccumulatedMotion, "root_at_arrival", wide_motion)
    elif fault == "landmark taken for certain":
        monkeypatch.setattr(ParticleMaps, "expected", certain_landmarks)
    else:
        true = inverse_2x2
        monkeypatch.setattr(filter_module, "inverse_2x2", lambda q: (true(q)[0], true(q)[1] ** 0))
    assert excess(small_runs(proposal, 120)) < LEVEL


MODELS: tuple[tuple[MotionModel, Array, Array], ...] = (
    (RelativePoseModel(), np.array([0.5, 0.05, 0.2]), np.diag((0.02, 0.01, 0.003))),
    (UnicycleModel(), np.array([1.0, 0.4]), np.diag((0.1, 0.02))),
    (AckermannModel(2.8, 0.7, 3.0, 0.5), np.array([2.0, 0.2]), np.diag((0.1, 0.02))),
)
POINTS = np.array([[8.0, 3.0], [5.0, -6.0], [-4.0, 5.0], [12.0, 0.5]])
SIGMA = np.tile((0.2, 0.05), (4, 1))


def world_scan(pose: Array, generator: np.random.Generator) -> Measurements:
    z = RangeBearing().predict(pose, POINTS).z + SIGMA * generator.standard_normal((4, 2))
    return Measurements(z, diagonal_noise(SIGMA), np.arange(4, dtype=np.int64))


def slam_of(model: MotionModel, options: FastSlamOptions, seed: int = 1) -> FastSlam:
    prior = np.array([0.3, -0.2, 0.9])
    generator = np.random.default_rng(seed)
    return FastSlam(
        model, prior, np.diag((0.1, 0.1, 0.01)), generator, options, Stabilisation(1e-3, 1e-4)
    )


def drive(slam: FastSlam, control: Array, noise: Array, scans: int, skip: int = 0) -> None:
    """Go on for some scans; the world's random numbers are their own."""
    generator, pose = np.random.default_rng(77), slam.pose[0] * 0 + (0.3, -0.2, 0.9)
    for k in range(skip + scans):
        for _ in range(2):
            pose = slam.model.step(pose, control, 0.3).pose
        scan = world_scan(pose, generator)
        if k >= skip:
            slam.predict(control, noise, 0.3)
            slam.predict(control, noise, 0.3)
            slam.observe(scan)


@pytest.mark.parametrize("proposal", PROPOSALS)
@pytest.mark.parametrize(("model", "control", "noise"), MODELS)
def test_an_epoch_equals_a_plain_loop_over_particles(
    model: MotionModel, control: Array, noise: Array, proposal: Proposal
) -> None:
    options = FastSlamOptions(particles=7, proposal=proposal, resample_share=0.0)
    slam = slam_of(model, options)
    drive(slam, control, noise, 2)
    start, maps, weight = slam.pose.copy(), deepcopy(slam.maps), slam.log_weight.copy()
    twin = np.random.default_rng(1)
    twin.bit_generator.state = slam.generator.bit_generator.state
    drive(slam, control, noise, 1, skip=2)
    generator, pose = np.random.default_rng(77), np.array((0.3, -0.2, 0.9))
    for _ in range(3):
        for _ in range(2):
            pose = model.step(pose, control, 0.3).pose
        scan = world_scan(pose, generator)
    draws = [twin.standard_normal((7, 3)) for _ in range(2 if proposal == "motion" else 1)]
    value, vector = np.linalg.eigh(_increment(model, control, noise)[1])
    for i in range(7):
        expected = loop_particle(
            (start[i], maps.mean[i], maps.covariance[i]),
            _increment(model, control, noise),
            (vector * np.sqrt(value), [d[i] for d in draws]),
            (scan, maps.columns_of(scan.identity)),
            proposal,
        )
        np.testing.assert_allclose(slam.pose[i], expected[0], atol=1e-9)
        np.testing.assert_allclose(slam.maps.mean[i], expected[1], atol=1e-9)
        np.testing.assert_allclose(slam.maps.covariance[i], expected[2], atol=1e-9)
        assert slam.log_weight[i] - weight[i] == pytest.approx(expected[3], abs=1e-8)


def _increment(model: MotionModel, control: Array, noise: Array) -> tuple[Array, Array]:
    mean, covariance = np.zeros(3), np.zeros((3, 3))
    for _ in range(2):
        mean, f, b = model.step(mean, control, 0.3)
        stabilisation = 0.3 * np.diag((1e-3, 1e-3, 1e-4))
        covariance = f @ covariance @ f.T + b @ noise @ b.T + stabilisation
    return mean, covariance


def loop_particle(
    particle: tuple[Array, Array, Array],
    increment: tuple[Array, Array],
    random: tuple[Array, list[Array]],
    measured: tuple[Measurements, Index],
    proposal: Proposal,
) -> tuple[Array, Array, Array, float]:
    """One particle in the map's frame, with stacked Jacobians (Montemerlo 2003)."""
    (start, mean, covariance), (scan, columns) = particle, measured
    mean, covariance, sensor = mean.copy(), covariance.copy(), RangeBearing()

    def turn(heading: float) -> Array:
        c, s = math.cos(heading), math.sin(heading)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    pose = start + turn(start[2]) @ increment[0]
    root = turn(start[2]) @ random[0]
    draws = list(random[1])
    if proposal == "motion":
        pose, root = pose + root @ draws.pop(0), 0.0 * root
    at = sensor.predict(pose, mean[columns])
    nu = (scan.z - at.z).ravel()
    nu[1::2] = wrap_angle(nu[1::2])
    h, q = at.jacobian_pose.reshape(-1, 3), np.zeros((8, 8))
    for j, column in enumerate(columns):
        hm = at.jacobian_landmark[j]
        part = slice(2 * j, 2 * j + 2)
        q[part, part] = hm @ covariance[column] @ hm.T + scan.noise[j]
    s = h @ root @ root.T @ h.T + q
    weight = -0.5 * float(nu @ np.linalg.solve(s, nu) + np.linalg.slogdet(2 * math.pi * s)[1])
    hu = h @ root
    information = np.eye(3) + hu.T @ np.linalg.inv(q) @ hu
    half = np.linalg.cholesky(information)
    u = np.linalg.solve(information, hu.T @ np.linalg.solve(q, nu))
    pose = pose + root @ (u + np.linalg.solve(half.T, draws.pop(0)))
    at = sensor.predict(pose, mean[columns])
    nu = scan.z - at.z
    nu[:, 1] = wrap_angle(nu[:, 1])
    for j, column in enumerate(columns):
        hm, prior = at.jacobian_landmark[j], covariance[column]
        gain = prior @ hm.T @ np.linalg.inv(hm @ prior @ hm.T + scan.noise[j])
        mean[column] += gain @ nu[j]
        covariance[column] = prior - gain @ hm @ prior
    return pose, mean, covariance, weight


def test_one_particle_with_exact_odometry_is_mapping_with_known_poses() -> None:
    sensor, generator = RangeBearing(), np.random.default_rng(4)
    options = FastSlamOptions(particles=1)
    pose = np.array([1.0, 2.0, 0.5])
    slam = FastSlam(RelativePoseModel(), pose, np.zeros((3, 3)), generator, options)
    step, world = np.array([0.4, 0.0, 0.1]), np.random.default_rng(5)
    mean, covariance = np.zeros((4, 2)), np.zeros((4, 2, 2))
    for k in range(12):
        slam.predict(step, np.zeros((3, 3)), 1.0)
        pose = RelativePoseModel().step(pose, step, 1.0).pose
        scan = world_scan(pose, world)
        slam.observe(scan)
        if k == 0:
            found = sensor.invert(pose, scan.z)
            mean, by = found.landmark, found.jacobian_z
            covariance = by @ scan.noise @ by.swapaxes(1, 2)
            continue
        at = sensor.predict(pose, mean)
        h, nu = at.jacobian_landmark, sensor.innovation(scan.z, at.z)
        gain = covariance @ h.swapaxes(1, 2)
        gain = gain @ np.linalg.inv(h @ gain + scan.noise)
        mean = mean + np.einsum("mij,mj->mi", gain, nu)
        covariance = covariance - gain @ h @ covariance
    found_map = slam.mixture_map()
    np.testing.assert_allclose(slam.pose[0], pose, atol=1e-12)
    np.testing.assert_array_equal(found_map.number, np.arange(4))
    np.testing.assert_allclose(found_map.mean, mean, atol=1e-10)
    np.testing.assert_allclose(found_map.covariance, covariance, atol=1e-10)


def bits(slam: FastSlam) -> tuple[bytes, ...]:
    maps = slam.maps
    arrays = (slam.pose, slam.log_weight, maps.mean, maps.covariance, maps.evidence)
    return tuple(a.tobytes() for a in (*arrays, *slam.history.pose)) + (
        repr((slam.log_evidence, slam.history.effective)).encode(),
    )


def test_the_same_seed_gives_the_same_bits_and_inputs_are_not_changed() -> None:
    model, control, noise = MODELS[2]
    runs = [slam_of(model, FastSlamOptions(particles=30), seed) for seed in (1, 1, 2)]
    given = control.copy(), noise.copy()
    for slam in runs:
        drive(slam, control, noise, 6)
    assert bits(runs[0]) == bits(runs[1]) != bits(runs[2])
    np.testing.assert_array_equal(given[0], control)
    np.testing.assert_array_equal(given[1], noise)
    scan = world_scan(np.zeros(3), np.random.default_rng(0))
    before = scan.z.copy(), scan.noise.copy(), scan.identity.copy()
    runs[0].observe(scan)
    for held, kept in zip((scan.z, scan.noise, scan.identity), before, strict=True):
        np.testing.assert_array_equal(held, kept)


def test_paths_by_ancestry_are_those_that_particles_carried() -> None:
    model, control, noise = MODELS[0]
    slam = slam_of(model, FastSlamOptions(particles=25, resample_share=0.8))
    drive(slam, control, noise, 15)
    carried: Array = np.zeros((0, 25, 3))
    for pose, parents in zip(slam.history.pose, slam.history.parents, strict=True):
        carried = np.concatenate((carried, pose[None]))
        carried = carried if parents is None else carried[:, parents]
    paths = [p[a] for p, a in zip(slam.history.pose, slam.history.ancestors(), strict=True)]
    np.testing.assert_array_equal(paths, carried)
    distinct = [len(np.unique(x[:, 0])) for x in carried]
    np.testing.assert_array_equal(slam.history.distinct(), distinct)
    assert distinct[0] < distinct[-1]


def test_a_label_that_occurs_twice_in_a_scan_is_fused_twice() -> None:
    slam, once = (standing(FastSlamOptions(particles=5)) for _ in range(2))
    z = np.array([[4.0, 0.1], [4.0, 0.1], [3.0, 0.0]])
    noise, label = diagonal_noise(np.full((3, 2), 0.1)), np.array([3, 3, -1])
    numbers = slam.observe(Measurements(z, noise, label))
    np.testing.assert_array_equal(numbers, np.tile((3, 3, -1), (5, 1)))
    once.observe(Measurements(z[:1], noise[:1], label[:1]))
    np.testing.assert_allclose(
        2.0 * slam.mixture_map().covariance, once.mixture_map().covariance, atol=1e-9
    )


def test_a_misread_label_is_not_fused_and_counts_as_at_the_gate() -> None:
    """Not also as a measurement of no landmark."""
    maps = []
    for gate in (20.0, math.inf):
        slam = standing(FastSlamOptions(particles=5, association=KnownIdentities(gate, -7.0)))
        noise = diagonal_noise(np.full((1, 2), 0.1))
        for bearing in (0.0, 1.5):
            z = np.array([[4.0, bearing]])
            slam.observe(Measurements(z, noise, np.array([3])))
        maps.append((slam.mixture_map().mean[0], slam.log_evidence))
    np.testing.assert_allclose(maps[0][0], (4.0, 0.0), atol=1e-12)
    assert np.linalg.norm(maps[1][0] - (4.0, 0.0)) > 0.5
    at_the_gate = -10.0 - math.log(2.0 * math.pi * 0.02)
    assert maps[0][1] == pytest.approx(at_the_gate - 7.0, abs=1e-6)  # of the first scan, once


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"particles": 0}, "particles is 0"),
        ({"resample_share": 1.5}, r"resample_share is 1\.5"),
        ({"largest_heading_sigma_rad": 0.0}, "largest_heading_sigma_rad"),
    ],
)
def test_numbers_that_make_no_filter_are_named(given: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FastSlamOptions(**given)  # type: ignore[arg-type]


def test_what_is_no_prior_or_no_measurement_is_refused() -> None:
    generator, model = np.random.default_rng(0), RelativePoseModel()
    with pytest.raises(ValueError, match="shapes"):
        FastSlam(model, np.zeros(4), np.eye(4), generator)
    with pytest.raises(ValueError, match="not finite"):
        FastSlam(model, np.full(3, np.nan), np.eye(3), generator)
    slam = FastSlam(model, np.zeros(3), np.eye(3), generator)
    with pytest.raises(ValueError, match="not of points"):
        slam.observe(Measurements(np.full((1, 2), np.nan), R, np.array([1])))
