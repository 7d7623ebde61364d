"""Worlds whose least-squares problem has many minima, as the smoother's arrays with their truth.

Six classes: `sides` (ranges to centimetres, bearings to a radian: each landmark may stand on either
side of the path), `winding` (blind loops with a poor gyro: the heading may be wound by a turn),
`rooms` (symmetric rooms joined by blind corridors), `labels` (some measurements carry another
landmark's name), `kidnapped` (the vehicle is moved and its odometry says nothing of it), `quiet`
(one minimum, for comparison).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphslam.problem import SlamProblem

Array = NDArray[np.float64]

PRIOR = np.diag((0.01, 0.01, 0.002)) ** 2


@dataclass(frozen=True)
class BasinWorld:
    """What the smoother is told, and the truth: poses (K, 3), landmarks (L, 2)."""

    name: str
    problem: SlamProblem
    poses: Array
    landmarks: Array


def wrap(angle: Array) -> Array:
    """To [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def drive(
    increments: Array,
    landmarks: Array,
    sees: NDArray[np.bool_],
    noise: tuple[ArrayLike, ArrayLike],
    rng: np.random.Generator,
    name: str,
) -> BasinWorld:
    """Simulate.

    increments: (K-1, 3) true ones. sees: (K, L) who is measured from where. noise: sigmas (3,) or
    (K-1, 3) of increments, and (2,) of range and bearing.
    """
    step, sensor = np.broadcast_to(noise[0], increments.shape), np.asarray(noise[1])
    poses = np.zeros((len(increments) + 1, 3))
    for k, (forward, left, turn) in enumerate(increments):
        x, y, heading = poses[k]
        c, s = np.cos(heading), np.sin(heading)
        poses[k + 1] = (x + c * forward - s * left, y + s * forward + c * left, heading + turn)
    pose, landmark = np.nonzero(sees)
    seen, landmark = np.unique(landmark, return_inverse=True)
    offset = landmarks[seen][landmark] - poses[pose, :2]
    bearing = np.arctan2(offset[:, 1], offset[:, 0]) - poses[pose, 2]
    z = np.column_stack((np.hypot(*offset.T), bearing))
    z += sensor * rng.standard_normal(z.shape)
    z = np.column_stack((np.maximum(z[:, 0], 0.05), wrap(z[:, 1])))
    problem = SlamProblem(
        prior_pose=poses[0] + np.sqrt(np.diag(PRIOR)) * rng.standard_normal(3),
        prior_covariance=PRIOR,
        increment=increments + step * rng.standard_normal(increments.shape),
        increment_covariance=np.array([np.diag(s**2) for s in step]),
        measurement_pose=pose,
        measurement_landmark=landmark,
        z=z,
        sigma=np.tile(sensor, (len(z), 1)),
        landmark_count=len(seen),
    )
    return BasinWorld(name, problem, poses, landmarks[seen])


def integrate(increments: Array) -> Array:
    """(K, 2) places of a path from the origin."""
    heading = np.concatenate(([0.0], np.cumsum(increments[:, 2])))
    step = (increments[:, 0] + 1j * increments[:, 1]) * np.exp(1j * heading[:-1])
    place = np.concatenate(([0.0], np.cumsum(step)))
    return np.column_stack((place.real, place.imag))


def in_reach(increments: Array, landmarks: Array, reach_m: float) -> NDArray[np.bool_]:
    """(K, L) who is nearer than the reach."""
    apart = integrate(increments)[:, None] - landmarks
    near: NDArray[np.bool_] = np.linalg.norm(apart, axis=2) < reach_m
    return near


def sides(seed: int) -> BasinWorld:
    """A nearly straight drive between landmarks that a range-only sensor sees."""
    rng = np.random.default_rng((1, seed))
    count = int(rng.integers(50, 140))
    turn = rng.uniform(0.0, 0.02) * np.sin(np.arange(count) / rng.uniform(8.0, 25.0))
    increments = np.column_stack((np.full(count, 1.0), np.zeros(count), turn))
    number = int(rng.integers(8, 26))
    along = integrate(increments)[rng.integers(0, count, number)]
    away = rng.uniform(1.5, 9.0, number) * rng.choice((-1.0, 1.0), number)
    landmarks = along + np.column_stack((rng.normal(0.0, 0.5, number), away))
    sensor = rng.choice((0.02, 0.05, 0.1)), rng.choice((0.7, 1.0))
    step = 0.05, 0.02, np.deg2rad(rng.choice((0.5, 1.0, 2.0)))
    sees = in_reach(increments, landmarks, 12.0)
    return drive(increments, landmarks, sees, (step, sensor), rng, f"sides {seed}")


def winding(seed: int) -> BasinWorld:
    """Blind loops from a base and back, with a poor gyro."""
    rng = np.random.default_rng((2, seed))
    parts = []
    for _ in range(int(rng.integers(1, 4))):
        still = int(rng.integers(4, 9))
        parts.append(np.tile((0.5, 0.0, 0.0), (still, 1)))
        loop = int(rng.integers(30, 70))
        turns = rng.choice((-1.0, 1.0))
        wave = 0.5 * rng.uniform() * np.sin(np.linspace(0.0, 2.0 * np.pi, loop))
        turning = turns * (2.0 * np.pi / loop) * (1.0 + wave)
        length = rng.uniform(0.4, 1.2)
        parts.append(np.column_stack((np.full(loop, length), np.zeros(loop), turning)))
    parts.append(np.tile((0.5, 0.0, 0.0), (6, 1)))
    increments = np.vstack(parts)
    number = int(rng.integers(5, 10))
    landmarks = np.column_stack((rng.uniform(0.0, 8.0, number), rng.uniform(-5.0, 5.0, number)))
    sees = in_reach(increments, landmarks, 6.0)
    moving = np.abs(np.concatenate((increments[:, 2], [0.0]))) > 1e-6
    sees[moving] = False
    step = np.tile((0.05, 0.03, np.deg2rad(1.0)), (len(increments), 1))
    step[moving[:-1], 2] = np.deg2rad(rng.choice((10.0, 15.0, 22.0)))
    sensor = 0.1, np.deg2rad(2.0)
    return drive(increments, landmarks, sees, (step, sensor), rng, f"winding {seed}")


def rooms(seed: int) -> BasinWorld:
    """Symmetric rooms, each circled once and revisited at the end, joined by blind corridors."""
    rng = np.random.default_rng((3, seed))
    sensor = rng.choice((0.03, 0.1)), rng.choice((0.5, 0.8))
    circle = np.tile((0.8, 0.0, 2.0 * np.pi / 24), (24, 1))
    corridor = np.tile((1.0, 0.0, 0.0), (12, 1))
    corridor[6, 2] = rng.choice((-1.0, 1.0)) * 0.5 * np.pi
    count = int(rng.integers(2, 4))
    increments = np.vstack([part for _ in range(count) for part in (circle, corridor)] + [circle])
    place, heading = integrate(increments), np.cumsum(np.concatenate(([0.0], increments[:, 2])))
    landmarks = []
    for room in range(count + 1):
        first = room * 36
        ahead = place[first] + 3.06 * np.array((-np.sin(heading[first]), np.cos(heading[first])))
        fold = int(rng.choice((2, 4)))
        around = heading[first] + 2.0 * np.pi * np.arange(fold) / fold
        radius = rng.uniform(1.2, 5.0)
        landmarks.append(ahead + radius * np.column_stack((np.cos(around), np.sin(around))))
    everywhere = np.vstack(landmarks)
    sees = in_reach(increments, everywhere, 7.0)
    blind = np.arange(len(increments) + 1) % 36 > 24
    sees[blind] = False
    step = np.tile((0.04, 0.02, np.deg2rad(1.0)), (len(increments), 1))
    step[blind[:-1], 2] = np.deg2rad(rng.choice((3.0, 10.0)))
    return drive(increments, everywhere, sees, (step, sensor), rng, f"rooms {seed}")


def quiet(seed: int) -> BasinWorld:
    """Two rounds past landmarks with a good sensor."""
    rng = np.random.default_rng((4, seed))
    count = int(rng.integers(60, 120))
    increments = np.tile((1.0, 0.0, 2 * np.pi / count), (2 * count, 1))
    number = int(rng.integers(12, 30))
    along = integrate(increments)[rng.integers(0, count, number)]
    landmarks = along + rng.uniform(-7.0, 7.0, (number, 2))
    sees = in_reach(increments, landmarks, 10.0)
    noise = (0.05, 0.02, np.deg2rad(0.5)), (0.1, np.deg2rad(1.0))
    return drive(increments, landmarks, sees, noise, rng, f"quiet {seed}")


def labels(seed: int) -> BasinWorld:
    """A quiet or one-sided world in which some measurements carry another landmark's name."""
    rng = np.random.default_rng((5, seed))
    world = quiet(seed + 1000) if seed % 2 else sides(seed + 1000)
    problem = world.problem
    named = problem.measurement_landmark.copy()
    swaps = rng.choice(len(named), int(rng.integers(1, 6)), replace=False)
    for row in swaps:
        place = world.poses[problem.measurement_pose[row], :2]
        near = np.linalg.norm(world.landmarks - place, axis=1)
        near[named[row]] = np.inf
        named[row] = int(np.argmin(near))
    kept = np.unique(named)
    if len(kept) < problem.landmark_count:
        return world
    return replace(
        world, name=f"labels {seed}", problem=replace(problem, measurement_landmark=named)
    )


def kidnapped(seed: int) -> BasinWorld:
    """Between two poses the vehicle was carried away, and the odometry does not tell."""
    rng = np.random.default_rng((6, seed))
    world = quiet(seed + 2000) if seed % 2 else sides(seed + 2000)
    problem = world.problem
    increment = problem.increment.copy()
    k = int(rng.integers(len(increment) // 4, 3 * len(increment) // 4))
    # The truth keeps; the odometry lacks what carried the vehicle there.
    increment[k] -= (*rng.uniform(-6.0, 6.0, 2), rng.uniform(-np.pi, np.pi))
    return replace(world, name=f"kidnapped {seed}", problem=replace(problem, increment=increment))


CLASSES: tuple[Callable[[int], BasinWorld], ...] = (sides, winding, rooms, labels, kidnapped, quiet)
