"""Simulated drives as the smoother's arrays, drawn from exactly the noise that it assumes."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from graphslam.graph_builder import right_perturbation
from graphslam.problem import Merges, PoseLandmarkMeasurements, SlamProblem
from tests.graphslam.numerics import Array, Index, angle, exponential, product, quotient

LOOP = 425
"""Poses of one round of 255 m."""
REACH_M = 20.0
SIGMA = np.array((0.15, np.deg2rad(1.0)))
"""Of range and bearing."""
PRIOR = np.diag((0.01, 0.01, 0.001)) ** 2
STEP = np.array(((4e-4, 0.0, 0.0), (0.0, 1.6e-4, 3.5e-5), (0.0, 3.5e-5, 1.6e-5)))
"""Of an increment's right perturbation: a sensor ahead of the axle swings as it turns."""


@dataclass(frozen=True)
class World:
    """What is true, and what is measured of it.

    poses: (K, 3), headings unwrapped. landmarks: (L, 2), numbered by first measurement.
    frames: (Q, 3) pose landmarks.
    """

    problem: SlamProblem
    poses: Array
    landmarks: Array
    frames: Array


def chain(increment: Array, covariance: Array, **more: Any) -> SlamProblem:
    """A drive from the origin by increments (K, 3) and their covariances (K, 3, 3), blind.

    more: fields of the problem in place of these.
    """
    nothing = np.zeros(0, dtype=np.intp)
    given: dict[str, Any] = {
        "prior_pose": np.zeros(3),
        "prior_covariance": np.eye(3),
        "measurement_pose": nothing,
        "measurement_landmark": nothing,
        "z": np.zeros((0, 2)),
        "sigma": np.zeros((0, 2)),
        "landmark_count": 0,
    }
    return SlamProblem(increment=increment, increment_covariance=covariance, **{**given, **more})


def path(count: int) -> Array:
    """(count, 3) poses counter-clockwise on an ellipse of 255 m, with headings along it."""
    turn = 2.0 * np.pi * np.arange(count) / LOOP
    x, y = 45.0 * np.cos(turn), 36.0 * np.sin(turn)
    heading = np.unwrap(np.arctan2(36.0 * np.cos(turn), -45.0 * np.sin(turn)))
    return np.column_stack((x, y, heading))


def posts() -> Array:
    """(60, 2) points at uneven spacing inside and outside the path."""
    number = np.arange(60)
    turn = 2.0 * np.pi * (number + 0.3 * np.sin(2.4 * number)) / 60
    away = np.resize((-7.0, 4.0, -13.0, 7.0), 60)
    return np.column_stack(((45.0 + away) * np.cos(turn), (36.0 + away) * np.sin(turn)))


def loop(seed: int, poses: int = LOOP, noise: float = 1.0) -> World:
    """A drive past points; noise scales what is drawn, not the covariances that are stated."""
    rng = np.random.default_rng(seed)
    true = path(poses)

    def draw(covariance: Array) -> Array:
        return noise * np.linalg.cholesky(covariance) @ rng.standard_normal(len(covariance))

    increment = [
        product(quotient(here, there), exponential(draw(STEP))) for here, there in pairwise(true)
    ]
    node, label, z = _measured(true, posts())
    seen, first, landmark_index = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(first)
    problem = SlamProblem(
        prior_pose=true[0] + draw(PRIOR),
        prior_covariance=PRIOR,
        increment=np.array(increment),
        increment_covariance=np.tile(STEP, (poses - 1, 1, 1)),
        measurement_pose=node,
        measurement_landmark=np.argsort(order)[landmark_index],
        z=z + noise * SIGMA * rng.standard_normal(z.shape),
        sigma=np.tile(SIGMA, (len(z), 1)),
        landmark_count=len(seen),
    )
    return World(problem, true, posts()[seen[order]], np.zeros((0, 3)))


def with_frames(world: World, seed: int, noise: float = 1.0) -> World:
    """The same with measurements of pose landmarks, two of which are found to be one thing.

    Measurement errors are additive in x, y, heading, with correlated covariances.
    """
    rng = np.random.default_rng(seed)
    place = world.landmarks[::3] + (1.5, -1.0)
    frames = np.column_stack((place, rng.uniform(-3.0, 3.0, len(place))))

    def draw() -> tuple[Array, Array]:
        root = np.diag((0.03, 0.04, 0.004)) @ (np.eye(3) + 0.4 * rng.uniform(-1.0, 1.0, (3, 3)))
        return noise * root @ rng.standard_normal(3), root @ root.T

    def measured(first: Array, second: Array) -> tuple[Array, Array]:
        off, spread = draw()
        return quotient(first, second) + off, spread

    node, label, _ = _measured(world.poses, place)
    seen, landmark_index = np.unique(label, return_inverse=True)
    frames = frames[seen]
    pairs = [measured(world.poses[k], frames[j]) for k, j in zip(node, landmark_index, strict=True)]
    z, spread = (np.array(column) for column in zip(*pairs, strict=True))
    z[:, 2] = angle(z[:, 2])
    found = max(node[landmark_index == 0].min(), node[landmark_index == 1].min()) + 20
    where, beside = (np.array([value]) for value in measured(frames[0], frames[1]))
    where[:, 2] = angle(where[:, 2])
    one = np.zeros(1, dtype=np.intp)
    merges = Merges(one + found, one, one + 1, where, right_perturbation(where, beside))
    pose_landmarks = PoseLandmarkMeasurements(
        node, landmark_index, z, right_perturbation(z, spread), merges
    )
    return replace(
        world, problem=replace(world.problem, pose_landmarks=pose_landmarks), frames=frames
    )


def _measured(poses: Array, places: Array) -> tuple[Index, Index, Array]:
    """Numbers of poses (M,) and places (M,) in view ahead, and exact ranges and bearings (M, 2)."""
    offset = places - poses[:, None, :2]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    bearing = angle(np.arctan2(offset[..., 1], offset[..., 0]) - poses[:, None, 2])
    node, which = np.nonzero((distance < REACH_M) & (np.abs(bearing) < 0.5 * np.pi))
    return node, which, np.column_stack((distance[node, which], bearing[node, which]))
