"""How often `slamcheck logs LOG` names what was done to a log, and accuses a sound one.

    python -m benchmarks.log_doctor            # 37 damaged logs, 60 sound ones

Three kinds of odometry; drives among random posts, drawn from a seed each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.diagnosis.log_doctor import examine, other_frame
from comparisons.logs.log import Log
from comparisons.logs.odometry import VelocityOdometry
from comparisons.logs.transforms.calibration import delayed, driven, sensed
from graphslam.scan import planar

Change = Callable[[Log], Log]
_STEP_S = 0.1


def drive(seed: int, kind: str, count: int = 400) -> Log:
    """A vehicle that winds among posts, as a log of one kind of odometry, by that one's model."""
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
    return Log.from_arrays({"time_s": time_s, **moved, **sigmas}, seen, name=f"{kind} {seed}")


def travelled(step: Array, turned: Array, share: float) -> Array:
    """Poses (N + 1, 3) of steps and turns (N,), along the heading after a share of a turn."""
    along = np.append(0.0, np.cumsum(turned)[:-1]) + share * turned
    moves = np.column_stack((step * np.cos(along), step * np.sin(along), turned))
    return np.vstack((np.zeros(3), np.cumsum(moves, axis=0)))


def stated(name: str, change: Callable[[Array], Any]) -> Change:
    """Other sigmas than the log has."""
    return lambda log: replace(
        log,
        measurements=replace(log.measurements, **{name: change(getattr(log.measurements, name))}),
    )


def in_milliseconds(log: Log) -> Log:
    """Speeds per millisecond, and turns where they are rates, too."""
    rate = 1e3 if isinstance(log.odometry, VelocityOdometry) else 1.0
    return driven(log, (1e3, 0.0), (rate, 0.0))


_DEGREE = np.pi / 180
EVERY: dict[str, tuple[Change, str]] = {
    "clockwise bearings": (lambda g: sensed(g, bearing=(-1.0, 0.0)), "bearings grow clockwise"),
    "clockwise turns": (lambda g: driven(g, turn=(-1.0, 0.0)), "grows clockwise"),
    "bearings from the left": (
        lambda g: sensed(g, bearing=(1.0, np.pi / 2)),
        "bearings are from the left",
    ),
    "radians taken for degrees": (
        lambda g: sensed(g, bearing=(_DEGREE, 0.0)),
        "bearings are radians",
    ),
    "ranges in cm": (lambda g: sensed(g, (100.0, 0.0)), "ranges are cm"),
    "turns in degrees": (lambda g: driven(g, turn=(1.0 / _DEGREE, 0.0)), "is in degrees"),
    "a clock of 0.5 s": (lambda g: delayed(g, 0.5), "s later than the log says"),
    "a scale of 1.1": (lambda g: driven(g, (1.1, 0.0)), "times the log's"),
    "range's variance": (stated("sigma_range_m", np.square), "the sigma of ranges"),
    "bearing's variance": (stated("sigma_bearing_rad", np.square), "the sigma of bearings"),
    "bearing's sigma taken for degrees": (
        stated("sigma_bearing_rad", lambda sigma: _DEGREE * sigma),
        "was taken for degrees",
    ),
}
WHEELS: dict[str, tuple[Change, str]] = {
    "milliseconds": (in_milliseconds, "times are milliseconds"),
    "km/h": (lambda g: driven(g, (3.6, 0.0)), "speeds are km/h"),
}
POSES: dict[str, tuple[Change, str]] = {
    "y to the right": (
        lambda g: other_frame(g, "x", "-y", 1.0),
        "y of the poses grows to the right",
    ),
    "x and y exchanged": (
        lambda g: other_frame(g, "y", "x", 1.0),
        "x and y of the poses are exchanged",
    ),
}


def damaged() -> list[tuple[str, Log, str]]:
    """What was done, the log, and what is to be said first."""
    found = []
    for number, kind in enumerate(("velocity", "steering", "poses")):
        more = POSES if kind == "poses" else WHEELS
        for row, (name, (change, words)) in enumerate({**EVERY, **more}.items()):
            if kind == "poses" and name == "a clock of 0.5 s":
                continue  # measurements must be at poses' times
            if kind == "steering" and name == "turns in degrees":
                continue  # no steering angle is so large
            log = drive(100 * number + row, kind)
            found.append((f"{kind}: {name}", change(log), words))
    return found


def sound(count: int = 60) -> list[Log]:
    """Drives as they are."""
    kinds = ("velocity", "steering", "poses")
    return [drive(1000 + k, kinds[k % 3]) for k in range(count)]


def main() -> None:
    """Print the table."""
    named = 0
    cases = damaged()
    for name, log, words in cases:
        first = examine(log).words or "nothing"
        named += words in first
        print(f"{'named ' if words in first else 'MISSED'} {name}: {first}", flush=True)
    flagged = [log.name for log in sound() if examine(log).findings]
    print(f"{named} of {len(cases)} named first; {len(flagged)} of 60 sound logs accused {flagged}")


if __name__ == "__main__":
    main()
