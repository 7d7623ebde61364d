"""Every particle associates for itself."""

import numpy as np
import pytest

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import diagonal_noise
from ekf_reference.core.measurements import Measurements
from ekf_reference.fastslam.association import (
    ExpectedDetection,
    KnownIdentities,
    PerParticleLikelihood,
    best_pairs,
)
from ekf_reference.fastslam.filter import FastSlam, FastSlamOptions, Proposal
from ekf_reference.fastslam.particle_maps import FREE, ParticleMaps
from ekf_reference.models.motion import RelativePoseModel
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.fastslam.linear_sensor import standing

SIGMA = np.array([0.1, 0.02])


def scan(pose: Array, points: Array) -> Measurements:
    z = RangeBearing().predict(pose, points).z
    noise = diagonal_noise(np.tile(SIGMA, (len(z), 1)))
    return Measurements(z, noise, np.full(len(z), -1, dtype=np.int64))


def watching(particles: int, proposal: Proposal = "measurement", loss: float = 0.3) -> FastSlam:
    options = FastSlamOptions(
        particles=particles,
        proposal=proposal,
        association=PerParticleLikelihood(view=ExpectedDetection(20.0, 1.5), loss=loss),
        resample_share=0.0,
    )
    return standing(options)


def greedy(score: Array) -> Index:
    """The same by a plain loop."""
    choice = np.full(score.shape[:2], -1)
    for n, own in enumerate(score.copy()):
        while np.isfinite(own).any():
            j, k = np.unravel_index(own.argmax(), own.shape)
            choice[n, j] = k
            own[j], own[:, k] = -np.inf, -np.inf
    return choice


def test_best_pairs_equal_a_plain_loop_and_exclude_each_other() -> None:
    score = np.random.default_rng(0).normal(size=(60, 5, 7))
    score[score < 0.3] = -np.inf
    choice = best_pairs(score)
    np.testing.assert_array_equal(choice, greedy(score))
    for row in choice:
        taken = row[row >= 0]
        assert len(np.unique(taken)) == len(taken)
    apart = score.argmax(axis=2)  # without exclusion
    assert any(len(np.unique(row)) < len(row) for row in apart)


@pytest.mark.parametrize("proposal", ["motion", "measurement"])
def test_particles_at_different_places_take_a_measurement_for_different_landmarks(
    proposal: Proposal,
) -> None:
    slam = watching(2, proposal)
    points = np.array([[6.0, 0.0], [6.0, 3.0]])
    first = slam.observe(scan(np.zeros(3), points))
    assert (first[0] == first[1]).all()
    assert len(np.unique(first)) == 2
    slam.pose = np.array([[0.0, 0.0, 0.0], [0.0, 3.0, 0.0]])
    z = scan(np.zeros(3), points[:1])  # straight ahead
    found = slam.observe(z)
    np.testing.assert_array_equal(found[:, 0], first[0])
    assert slam.log_weight[0] == pytest.approx(slam.log_weight[1], abs=0.5)


def test_new_matched_and_ambiguous_measurements() -> None:
    slam = watching(3)
    known = slam.observe(scan(np.zeros(3), np.array([[5.0, 0.0]])))[0, 0]
    points = np.array([[5.05, 0.01], [5.64, 0.0], [5.0, 4.0]])
    found = slam.observe(scan(np.zeros(3), points))
    assert (found[:, 0] == known).all()
    assert (found[:, 1] < 0).all()  # between the gates: sqrt(20) sigma away
    assert (found[:, 2] > known).all()
    assert len(slam.mixture_map().number) == 2


def test_evidence_removes_a_landmark_that_is_not_seen_again_but_not_one_out_of_view() -> None:
    slam = watching(4, loss=0.4)
    steady, phantom, behind = [5.0, 0.0], [6.0, 4.0], [-5.0, 1.0]
    slam.observe(scan(np.zeros(3), np.array([steady, phantom, behind])))
    for _ in range(2):
        slam.observe(scan(np.zeros(3), np.array([steady])))
    assert len(slam.mixture_map().number) == 3
    slam.observe(scan(np.zeros(3), np.array([steady])))
    np.testing.assert_allclose(slam.mixture_map().mean, [steady, behind], atol=0.1)
    room = len(slam.maps.number)
    for k in range(3 * room):  # the column of a removed landmark serves the next
        slam.observe(scan(np.zeros(3), np.array([steady, [10.0, 6.0 if k % 4 else -6.0]])))
    assert len(slam.maps.number) == room


def test_a_landmark_that_no_survivor_has_leaves_the_map() -> None:
    slam = watching(2)
    slam.observe(scan(np.zeros(3), np.array([[5.0, 0.0]])))
    column = slam.maps.allocate(np.array([70]))
    slam.maps.evidence[1, column] = 1.0
    slam.maps.inherit(np.array([0, 0]))
    assert 70 not in slam.maps.number


def test_labels_occur_once_in_a_round() -> None:
    label = np.array([4, -1, 7, 4, -1, 4], dtype=np.int64)
    z = np.ones((6, 2))
    seen = Measurements(z, diagonal_noise(z), label)
    parts = KnownIdentities().rounds(seen)
    assert [part.tolist() for part in parts] == [[0, 1, 2, 4], [3], [5]]


def test_a_landmark_that_nobody_has_any_more_gives_its_column_back() -> None:
    """Where it fell below zero in one particle, and the other never had it."""
    maps = ParticleMaps(2)
    kept, gone = maps.allocate(np.array([70, 71])).tolist()
    maps.evidence[:, kept], maps.evidence[:, gone] = (1.0, -0.2), (0.0, -0.2)
    maps.remove(np.array([kept, gone]))
    assert maps.number[[kept, gone]].tolist() == [70, FREE]
    assert maps.evidence[:, [kept, gone]].tolist() == [[1.0, 0.0], [0.0, 0.0]]


def test_a_loop_of_unlabelled_points_is_mapped_without_duplicates() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    points = np.column_stack((np.cos(angle), np.sin(angle))) * 14.0
    generator, truth = np.random.default_rng(3), np.array([9.0, 0.0, np.pi / 2])
    options = FastSlamOptions(
        particles=400, association=PerParticleLikelihood(view=ExpectedDetection(9.0, 1.2))
    )
    slam = FastSlam(RelativePoseModel(), truth, np.zeros((3, 3)), generator, options)
    step, sigma = np.array([0.9, 0.0, 0.1]), np.array([0.03, 0.01, 0.004])
    model = RelativePoseModel()
    for _ in range(80):
        truth = model.step(truth, step, 1.0).pose
        noisy = step + sigma * generator.standard_normal(3)
        slam.predict(noisy, np.diag(sigma**2), 1.0)
        away = points - truth[:2]
        bearing = np.arctan2(away[:, 1], away[:, 0]) - truth[2]
        inside = (np.hypot(*away.T) < 10.0) & (np.cos(bearing) > 0.2)
        seen = scan(truth, points[inside])
        z = seen.z + SIGMA * generator.standard_normal(seen.z.shape)
        slam.observe(Measurements(z, seen.noise, seen.identity))
    assert np.linalg.norm(slam.mean_pose()[:2] - truth[:2]) < 0.5
    found = slam.mixture_map()
    certain = found.mean[found.share > 0.5]
    assert len(certain) == len(points)
    away = np.linalg.norm(certain[:, None] - points, axis=2)
    assert away.min(axis=0).max() < 0.6


def test_no_landmark_in_reach_of_a_point_is_passed_over() -> None:
    generator = np.random.default_rng(4)
    maps = ParticleMaps(6, 40)
    maps.number[:30] = np.arange(30)
    maps.mean[:, :30] = 30.0 * generator.standard_normal((1, 30, 2))
    maps.mean[:, :30] += generator.standard_normal((6, 30, 2))
    maps.evidence[:, :30] = generator.random((6, 30)) < 0.6
    pose = np.column_stack((generator.normal(0, 1.0, (6, 2)), generator.normal(0, 0.1, 6)))
    point, reach_m = 30.0 * generator.standard_normal((5, 2)), np.array([3.0, 9.0, 6.0, 12.0, 1.0])
    expected = set()
    for n, (x, y, heading) in enumerate(pose):
        turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        for p, reach in zip(point @ turn.T + (x, y), reach_m, strict=True):
            near = np.linalg.norm(maps.mean[n] - p, axis=1) <= reach
            expected |= set(np.flatnonzero(near & (maps.evidence[n] > 0.0)).tolist())
    found = maps.around(pose, point, reach_m).tolist()
    assert 0 < len(expected) <= len(found) < 30
    assert expected <= set(found)
    assert not expected <= set(maps.around(pose, point, 0.3 * reach_m).tolist())
