"""The equations of F2 beside central differences of residuals written out without gtsam."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest

from graphslam import model_system as f2
from graphslam.graph_builder import measurement_factors, position_factor, to_tangent
from graphslam.layout import POINT
from graphslam.linear_problem import solve
from graphslam.model_system import LinearisationPoints, RelationPoints, model_system
from graphslam.problem import SlamProblem
from tests.graphslam import worlds
from tests.graphslam.numerics import (
    Array,
    angle,
    central_difference,
    random_covariance,
    relative_error,
)

BLOCK = 7
LEVER_M = np.array((1.5, -0.4))
FIXED = np.array((3, 11))
"""Poses that have a position fix."""


def drive() -> tuple[SlamProblem, LinearisationPoints, Array, Array]:
    """A short drive with fixes, where it is linearised, and these poses and landmarks.

    Every use of a measurement has a weight of its own, and points beside those of the others.
    """
    world, rng = worlds.loop(0, poses=20), np.random.default_rng(1)
    poses = world.poses + 0.1 * rng.standard_normal(world.poses.shape)
    landmarks = world.landmarks + 0.3 * rng.standard_normal(world.landmarks.shape)
    problem = replace(
        world.problem,
        position_pose=FIXED,
        position=world.poses[FIXED, :2] + rng.standard_normal((2, 2)),
        position_covariance=np.array([random_covariance(rng, 2) for _ in FIXED]),
        lever_m=tuple(LEVER_M.tolist()),
    )
    count = len(problem.z)
    used = RelationPoints(
        row=np.arange(count),
        weight=rng.uniform(0.2, 1.0, count),
        first=poses[problem.measurement_pose] + 0.1 * rng.standard_normal((count, 3)),
        second=landmarks[problem.measurement_landmark] + 0.1 * rng.standard_normal((count, 2)),
    )
    points = LinearisationPoints(
        departed=poses,
        arrived=poses,
        measurements={POINT: used},
        merges={},
        position=np.arange(2),
        position_weight=np.array((0.5, 0.8)),
        position_pose=poses[FIXED] + 0.1 * rng.standard_normal((2, 3)),
    )
    return problem, points, poses, landmarks


def equations(residual: Callable[[Array], Array], covariance: Array, at: Array) -> Array:
    """[J, r]^T C^-1 [J, r] of J (x - at) = r + noise, whose residual r falls as x grows by J."""
    rows = np.column_stack((-central_difference(residual, at), residual(at)))
    product: Array = rows.T @ np.linalg.inv(covariance) @ rows
    return product


def cartesian(z: Array) -> Array:
    return np.array((z[0] * np.cos(z[1]), z[0] * np.sin(z[1])))


@pytest.mark.parametrize("own_axes", [False, True])
def test_measurements_equal_central_differences(
    own_axes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As range and bearing, and in the vehicle's axes, of few at a time; each is not the other."""
    problem, points, _, _ = drive()
    used, counts = points.measurements[POINT], list[int]()

    def counted(*arguments: Any) -> Sequence[gtsam.NonlinearFactor]:
        factors = measurement_factors(*arguments)
        counts.append(len(factors))
        return factors

    monkeypatch.setattr(f2, "BLOCK", BLOCK)
    monkeypatch.setattr(f2, "measurement_factors", counted)
    ours, other = (
        model_system(problem, replace(points, own_axes=which)).measurements[POINT]
        for which in (own_axes, not own_axes)
    )
    assert max(counts) == BLOCK
    assert sum(counts) == len(problem.z) > 2 * BLOCK
    for row, (z, sigma, weight) in enumerate(
        zip(problem.z, problem.sigma, used.weight, strict=True)
    ):

        def residual(x: Array, z: Array = z) -> Array:
            local = to_tangent(x[2:3])[0][:2, :2] @ (x[3:] - x[:2])
            if own_axes:
                return np.asarray(cartesian(z) - local)
            bearing = angle(z[1:] - np.arctan2(local[1], local[0]))
            return np.array((z[0] - np.hypot(*local), *bearing))

        root = central_difference(cartesian, z) if own_axes else np.eye(2)
        covariance = root @ np.diag(sigma**2 / weight) @ root.T
        expected = equations(
            residual, covariance, np.concatenate((used.first[row], used.second[row]))
        )
        errors = []
        for system in (ours, other):
            rows = np.column_stack((system.a[row], system.c[row], system.b[row]))
            errors.append(relative_error(rows.T @ rows, expected))
        assert errors[0] < 1e-6 < 1e-4 < errors[1]


def test_position_fixes_equal_central_differences() -> None:
    problem, points, _, _ = drive()
    mirrored = replace(problem, lever_m=(LEVER_M[0], -LEVER_M[1]))
    ours, wrong = (model_system(one, points).positions for one in (problem, mirrored))
    for row in range(2):

        def residual(x: Array, z: Array = problem.position[row]) -> Array:
            antenna: Array = x[:2] + to_tangent(x[2:])[0][:2, :2].T @ LEVER_M
            return z - antenna

        covariance = problem.position_covariance[row] / points.position_weight[row]
        expected = equations(residual, covariance, points.position_pose[row])
        errors = []
        for system in (ours, wrong):
            rows = np.column_stack((system.a[row], system.b[row]))
            errors.append(relative_error(rows.T @ rows, expected))
        assert errors[0] < 1e-6 < 1e-2 < errors[1]


def test_the_reference_of_the_unknowns_moves_nothing() -> None:
    """Errors around another reference are the same states; relations that stay behind are not."""
    problem, points, poses, landmarks = drive()
    system, rng = model_system(problem, points), np.random.default_rng(2)
    away = poses + rng.standard_normal(poses.shape)
    aside = landmarks + rng.standard_normal(landmarks.shape)
    whole = solve(system, poses, {POINT: landmarks})
    moved = solve(system, away, {POINT: aside})
    sigma = np.sqrt(whole.covariance.diagonal())
    assert np.abs((moved.mean - whole.mean) / sigma).max() < 1e-6
    assert relative_error(moved.covariance, whole.covariance) < 1e-9
    shifted = replace(points, position_pose=points.position_pose + (1.0, 0.0, 0.0))
    wrong = solve(model_system(problem, shifted), poses, {POINT: landmarks})
    assert np.abs((wrong.mean - whole.mean) / sigma).max() < 1e-6  # a fix is linear in the place
    turned = replace(points, position_pose=points.position_pose + (0.0, 0.0, 0.5))
    wrong = solve(model_system(problem, turned), poses, {POINT: landmarks})
    assert np.abs((wrong.mean - whole.mean) / sigma).max() > 1e-3


def test_our_position_factor_equals_central_differences() -> None:
    lever, z = (1.5, -0.4), np.array((3.0, 4.0))
    factor = position_factor(0, z, np.diag((0.04, 0.09)), lever)
    pose = gtsam.Pose2(1.0, 2.0, 0.8)

    def values(xi: Array) -> gtsam.Values:
        result = gtsam.Values()
        result.insert(0, pose.retract(xi))
        return result

    def whitened(xi: Array) -> Array:
        p = pose.retract(xi)
        antenna = p.transformFrom(np.array(lever))
        residual: Array = (antenna - z) / (0.2, 0.3)
        return residual

    linear = factor.linearize(values(np.zeros(3)))
    a, b = linear.jacobian()
    assert relative_error(a, central_difference(whitened, np.zeros(3))) < 1e-8
    assert np.allclose(b.ravel(), -whitened(np.zeros(3)))
