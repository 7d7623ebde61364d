"""Pose landmarks in the frozen smoother F2 and in the smoother."""

from dataclasses import replace

import gtsam
import numpy as np

from graphslam.arrays import Marginal
from graphslam.graph_builder import right_perturbation
from graphslam.layout import POINT, POSE_LANDMARK
from graphslam.linear_problem import solve
from graphslam.model_system import LinearisationPoints, RelationPoints, model_system
from graphslam.problem import Merges, PoseLandmarkMeasurements, SlamProblem
from graphslam.smoother import SmootherEvidence, SmootherOptions, smooth
from tests.graphslam import worlds
from tests.graphslam.numerics import Array, Index, angle, central_difference, relative_error
from tests.graphslam.worlds import World

POSES = 120


def drive(noise: float = 1.0) -> World:
    return worlds.with_frames(worlds.loop(0, POSES, noise), 0, noise)


def linearised(problem: SlamProblem, poses: Array, landmarks: Array, frames: Array) -> Marginal:
    """F2 at poses (K, 3), points (L, 2) and pose landmarks (Q, 3)."""
    rows, seen, merges = (
        np.arange(len(problem.z)),
        problem.pose_landmarks,
        problem.pose_landmarks.merges,
    )
    points = LinearisationPoints(
        departed=poses,
        arrived=poses,
        measurements={
            POINT: RelationPoints(
                rows,
                np.ones(len(rows)),
                poses[problem.measurement_pose],
                landmarks[problem.measurement_landmark],
            ),
            POSE_LANDMARK: RelationPoints(
                np.arange(len(seen.pose)),
                np.ones(len(seen.pose)),
                poses[seen.pose],
                frames[seen.landmark],
            ),
        },
        merges={
            POSE_LANDMARK: RelationPoints(
                np.arange(len(merges.pose)),
                np.ones(len(merges.pose)),
                frames[merges.first],
                frames[merges.second],
            )
        },
        position=np.zeros(0, dtype=np.intp),
        position_weight=np.zeros(0),
        position_pose=np.zeros((0, 3)),
    )
    places = {POINT: landmarks, POSE_LANDMARK: frames}
    return solve(model_system(problem, points), poses, places)


def headings(result: SmootherEvidence) -> Index:
    """Where headings are in the marginal's mean."""
    first = 3 + result.landmarks.size
    return np.concatenate(([2], np.arange(first + 2, first + result.pose_landmarks().size, 3)))


def gap(result: SmootherEvidence, other: Marginal) -> tuple[float, float]:
    """Largest difference from the smoother: of means in sigmas, of covariances in their product."""
    mean, covariance = result.marginal()
    sigma, at = np.sqrt(covariance.diagonal()), headings(result)
    apart = other.mean - mean
    apart[at] = angle(apart[at])
    spread = np.abs(other.covariance - covariance) / np.outer(sigma, sigma)
    return float(np.abs(apart / sigma).max()), float(spread.max())


def test_without_noise_the_frozen_smoother_is_the_smoother() -> None:
    """Both linearised at the truth, which is the optimum."""
    world = drive(noise=0.0)
    problem = world.problem
    result = smooth(problem, {})
    truth = (world.poses, world.landmarks, world.frames)
    mean, spread = gap(result, linearised(problem, *truth))
    assert mean < 1e-4
    assert spread < 1e-6
    # Blind to the merges, or with the frames' noise in the axes of who sees them, it is not.
    seen = problem.pose_landmarks
    turned = right_perturbation(seen.measured * (1.0, 1.0, -1.0), seen.covariance)
    for wrong in (replace(seen, merges=Merges()), replace(seen, covariance=turned)):
        assert gap(result, linearised(replace(problem, pose_landmarks=wrong), *truth))[1] > 1e-2


def test_with_noise_they_are_near_and_the_marginal_has_both_kinds() -> None:
    """F2 at the truth and S differ by linearisation only; batch and a lag of all poses agree."""
    world = drive()
    problem = world.problem
    result = smooth(problem, {"truth": (world.poses, world.landmarks)})
    assert result.optimality.verified
    assert {start.name for start in result.starts if np.isfinite(start.error)} >= {"truth"}
    mean, covariance = result.marginal()
    points, frames = problem.landmark_count, problem.pose_landmarks.count
    assert frames == len(world.frames) > 2
    assert len(mean) == 3 + 2 * points + 3 * frames == len(covariance)
    own = linearised(problem, world.poses, world.landmarks, world.frames)
    assert gap(result, own)[0] < 0.5
    ratio = covariance.diagonal() / own.covariance.diagonal()
    assert ratio.min() > 0.8
    assert ratio.max() < 1.25
    joint = result.joint([problem.pose_count - 1], list(range(points)), list(range(frames)))
    assert relative_error(joint, covariance) < 1e-9
    lagged = smooth(problem, {}, options=SmootherOptions("fixed-lag", lag=len(result.poses)))
    assert gap(result, lagged.marginal())[1] < 0.05


def test_errors_are_as_large_as_the_covariance_says() -> None:
    """Of the last pose and both kinds of landmarks: 20 seeds within two-sided 99.8 % bounds."""
    nees, freedom = 0.0, 0
    for seed in range(20):
        world = worlds.with_frames(worlds.loop(seed, 60), seed)
        result = smooth(world.problem, {})
        mean, covariance = result.marginal()
        truth = np.concatenate((world.poses[-1], world.landmarks.ravel(), world.frames.ravel()))
        error, at = mean - truth, headings(result)
        error[at] = angle(error[at])
        nees += float(error @ np.linalg.solve(covariance, error))
        freedom += len(error)
    bound = 3.1 * np.sqrt(2.0 * freedom)
    assert abs(nees - freedom) < bound
    # Sigmas 10 % too small, or too large, would be caught.
    assert abs(nees / 0.81 - freedom) > bound
    assert abs(nees / 1.21 - freedom) > bound


def test_prefixes_keep_what_was_known() -> None:
    problem = drive().problem
    [found] = problem.pose_landmarks.merges.pose.tolist()
    early, late = problem.prefix(found), problem.prefix(found + 1)
    assert len(early.pose_landmarks.merges.pose) == 0
    assert len(late.pose_landmarks.merges.pose) == 1
    assert late.residual_dimension - early.residual_dimension > 6
    assert smooth(late, {}).optimality.verified


def test_a_frame_in_a_frame_by_central_differences() -> None:
    """F2's rows, unwhitened, at residuals that are not zero; the noise is the measurement's."""
    rng = np.random.default_rng(3)
    first, second, measured = (rng.uniform(-2.0, 2.0, (1, 3)) for _ in range(3))
    sigma = np.array((1.0, 2.0, 0.5))
    own = right_perturbation(measured, np.diag(sigma**2)[None])
    nothing = np.zeros(0, dtype=np.intp)
    at = RelationPoints(np.zeros(1, dtype=np.intp), np.ones(1), first, second)
    seen = PoseLandmarkMeasurements(
        np.zeros(1, dtype=np.intp), np.zeros(1, dtype=np.intp), measured, own
    )
    problem = worlds.chain(np.zeros((0, 3)), np.zeros((0, 3, 3)), pose_landmarks=seen)
    points = LinearisationPoints(
        departed=first,
        arrived=first,
        measurements={POSE_LANDMARK: at},
        merges={},
        position=nothing,
        position_weight=np.zeros(0),
        position_pose=np.zeros((0, 3)),
    )
    rows = model_system(problem, points).measurements[POSE_LANDMARK]

    def expected(x: Array) -> Array:
        between = gtsam.Pose2(*x[:3]).between(gtsam.Pose2(*x[3:]))
        return np.array([between.x(), between.y(), between.theta()])

    jacobian = central_difference(expected, np.concatenate((first[0], second[0])))
    unwhitened = sigma[:, None] * np.hstack((rows.a[0], rows.c[0]))
    assert relative_error(unwhitened, jacobian) < 1e-8
    residual = measured[0] - expected(np.concatenate((first[0], second[0])))
    residual[2] = np.angle(np.exp(1j * residual[2]))
    assert relative_error(sigma * rows.b[0], residual) < 1e-12
