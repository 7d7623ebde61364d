"""Drives with three kinds of odometry among random posts, drawn from a seed each."""

from __future__ import annotations

from itertools import accumulate, pairwise

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.log import Log
from graphslam.scan import planar

_STEP_S = 0.1
_SIGMA_POSITION_M = 0.1


def drive(seed: int, kind: str, count: int = 400, fixes: int = 0) -> Log:
    """A vehicle that winds among posts, as a log of one kind of odometry, by that one's model.

    fixes: samples from one absolute position to the next; none for 0.
    """
    rng = np.random.default_rng(seed)
    time_s = _STEP_S * np.arange(count)
    speed = rng.uniform(0.7, 1.5) + 0.2 * np.sin(2 * np.pi * time_s / rng.uniform(7.0, 20.0))
    sway = rng.uniform(0.1, 0.4) * np.sin(2 * np.pi * time_s / rng.uniform(8.0, 25.0))
    turn = rng.uniform(0.1, 0.25) + sway
    wheelbase = 2.0
    pose = travelled(speed * _STEP_S, turn * _STEP_S, 0.0 if kind == "steering" else 0.5)
    low, high = pose[:, :2].min(axis=0) - 6.0, pose[:, :2].max(axis=0) + 6.0
    posts = rng.uniform(low, high, (40, 2))
    sigma_range, sigma_bearing = 0.05, 0.01
    rows = []
    for k in range(5, count, 5):
        away = (posts - pose[k, :2]) @ np.array([1.0, 1j]) * np.exp(-1j * pose[k, 2])
        for post in np.flatnonzero((np.abs(away) < 8.0) & (np.abs(away) > 0.5)):
            z = np.array((np.abs(away[post]), np.angle(away[post])))
            rows.append((time_s[k], post, *(z + rng.normal(0.0, (sigma_range, sigma_bearing)))))
    t, post, distance, bearing = np.array(rows).T
    seen = {
        "time_s": t,
        "landmark": post.astype(int),
        "range_m": distance,
        "bearing_rad": np.angle(np.exp(1j * bearing)),
        "sigma_range_m": sigma_range,
        "sigma_bearing_rad": sigma_bearing,
    }
    sigma_speed, sigma_turn = 0.05, 0.02
    v = speed + rng.normal(0.0, sigma_speed, count)
    w = turn + rng.normal(0.0, sigma_turn, count)
    sigmas = {"sigma_speed_mps": sigma_speed, "sigma_turn": sigma_turn}
    moved: dict[str, Array | float] = {"speed_mps": v, "yaw_rate_radps": w}
    if kind == "steering":
        angle = np.arctan(turn * wheelbase / speed) + rng.normal(0.0, 0.03, count)
        moved = {"speed_mps": v, "steering_rad": angle, "wheelbase_m": wheelbase}
        sigmas["sigma_turn"] = 0.03
    elif kind == "poses":
        sigmas = {"sigma_move_m": 0.006, "sigma_turn": 0.003}
        steps = np.array([planar.between(*pair) for pair in pairwise(pose[:count])])
        steps += rng.normal(0.0, (0.006, 0.006, 0.003), steps.shape)
        path = np.array(list(accumulate(steps, planar.compose, initial=np.zeros(3))))
        moved = dict(zip(("x_m", "y_m", "heading_rad"), path.T, strict=True))
    positions = None
    if fixes:
        every = np.arange(fixes, count, fixes)
        place = pose[every, :2] + rng.normal(0.0, _SIGMA_POSITION_M, (len(every), 2))
        x, y = place.T
        positions = {"time_s": time_s[every], "x_m": x, "y_m": y, "sigma_m": _SIGMA_POSITION_M}
    odometry = {"time_s": time_s, **moved, **sigmas}
    return Log.from_arrays(odometry, seen, positions=positions, name=f"{kind} {seed}")


def travelled(step: Array, turned: Array, share: float) -> Array:
    """Poses (N + 1, 3) of steps and turns (N,), along the heading after a share of a turn."""
    along = np.append(0.0, np.cumsum(turned)[:-1]) + share * turned
    moves = np.column_stack((step * np.cos(along), step * np.sin(along), turned))
    return np.vstack((np.zeros(3), np.cumsum(moves, axis=0)))


def sound(count: int = 60) -> list[Log]:
    """Drives as they are."""
    kinds = ("velocity", "steering", "poses")
    return [drive(1000 + k, kinds[k % 3]) for k in range(count)]
