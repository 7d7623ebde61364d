"""A robot drives from its base along waypoints and back, among obstacles (Misono 2007, 4.1).

The vehicle is the paper's: in every sample it turns, then goes straight, and measures both with
noise (eqs. 4 and 5). A pursuit controller steers it by what a navigator believes: the truth, or a
filter that is fed as the log grows. The log has everything that was measured on the way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.logs.log import LandmarkMeasurements, Log, Poses, Positions, Prior, Truth
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.scans import Scans
from comparisons.logs.simulate.drive import exact_landmarks
from comparisons.logs.simulate.ray_casting import Solids, cast
from comparisons.logs.simulate.scanners import half_degrees


class Navigator(Protocol):
    """Says where the robot is; it receives all that the robot measures, and the truth."""

    def departed(self, displacement: Array, covariance: Array, true_pose: Array) -> None:
        """One sample of odometry, as in RelativePoses, and where it truly led (3,)."""

    def saw(self, z: Array, sigma: Array, landmark: NDArray[np.int64]) -> None:
        """Measurements of one instant: range and bearing (m, 2) with sigmas, ids (m,)."""

    def fixed(self, position: Array, covariance: Array) -> None:
        """An absolute position (2,) with covariance (2, 2)."""

    def pose(self) -> Array:
        """(3,) where it believes to be."""


class TrueNavigator:
    """Knows the truth."""

    def __init__(self) -> None:
        """Start at the base."""
        self._pose = np.zeros(3)

    def departed(self, displacement: Array, covariance: Array, true_pose: Array) -> None:
        """Take the truth."""
        self._pose = true_pose

    def saw(self, z: Array, sigma: Array, landmark: NDArray[np.int64]) -> None:
        """Nothing to learn."""

    def fixed(self, position: Array, covariance: Array) -> None:
        """Nothing to learn."""

    def pose(self) -> Array:
        """The truth."""
        return self._pose


_COURSE = ((12, 4), (22, 14), (34, 12), (40, 26), (28, 34), (14, 30), (4, 38), (-6, 24), (2, 12))


@dataclass(frozen=True, kw_only=True)
class WaypointRun:
    """Course, vehicle and sensors. The course is ours; the paper shows its own in a figure only.

    waypoint: (W, 2), driven in order from the base at the origin, which is the last goal.
    obstacles: how many, at random beside the course. reached_m: a goal counts as reached within
    this distance. most_s: when the run ends at the latest. noise_scale: multiplies every sigma,
    what is added to the data and what the log states alike. exact: nothing is added, and the log
    states its sigmas all the same.
    """

    waypoint: Array = field(default_factory=lambda: np.array(_COURSE, dtype=float))
    obstacles: int = 45
    speed_mps: float = 1.0
    most_turn_radps: float = math.radians(60.0)
    sample_s: float = 0.1
    scan_every: int = 5
    reached_m: float = 0.5
    most_s: float = 300.0
    sigma_way_m: float = 0.01
    sigma_turn_rad: float = math.radians(0.2)
    sigma_range_m: float = 0.05
    sigma_bearing_rad: float = math.radians(0.5)
    sigma_scan_m: float = 0.01
    sigma_gps_m: float = 0.3
    max_range_m: float = 12.0
    noise_scale: float = 1.0
    exact: bool = False

    @property
    def added_scale(self) -> float:
        """What the sigmas are multiplied by where noise is added."""
        return 0.0 if self.exact else self.noise_scale


_STABILISATION = 1e-8
_BEAMS = half_degrees()
_PRIOR = 1e-10


def simulate(
    rng: np.random.Generator, run: WaypointRun | None = None, navigator: Navigator | None = None
) -> Log:
    """One run. With the same generator state and navigator the log is the same."""
    run, navigator = run or WaypointRun(), navigator or TrueNavigator()
    place, diameter = _obstacles(rng, run)
    goals = np.vstack((run.waypoint, (0.0, 0.0)))
    variance = np.array((run.sigma_way_m**2, run.sigma_turn_rad**2))
    stated = run.noise_scale**2
    pose, reached = np.zeros(3), 0
    poses, moves, spreads = [pose], [], []
    seen: list[tuple[Array, Array, Array, NDArray[np.int64]]] = []
    scans: list[tuple[float, Array]] = []
    fixes: list[tuple[float, Array]] = []
    gps = stated * run.sigma_gps_m**2 * np.eye(2)
    for k in range(1, round(run.most_s / run.sample_s) + 1):
        turn, way = _pursue(run, navigator.pose(), goals[reached])
        pose = _moved(pose, turn, way)
        added = run.added_scale * rng.standard_normal(2) * np.sqrt(variance)
        move = _moved(np.zeros(3), turn + added[1], way + added[0])
        spread = stated * _spread(way + added[0], variance)
        poses.append(pose)
        moves.append(move)
        spreads.append(spread)
        navigator.departed(move, spread, pose)
        time = k * run.sample_s
        if k % run.scan_every == 0:
            z, landmark = _measurements(rng, run, pose, place)
            sigma = run.noise_scale * np.tile(
                (run.sigma_range_m, run.sigma_bearing_rad), (len(z), 1)
            )
            seen.append((np.full(len(z), time), z, sigma, landmark))
            navigator.saw(z, sigma, landmark)
            scans.append((time, _scan(rng, run, pose, place, diameter)))
        if np.linalg.norm(navigator.pose()[:2] - goals[reached]) < run.reached_m:
            fix = pose[:2] + run.added_scale * run.sigma_gps_m * rng.standard_normal(2)
            fixes.append((time, fix))
            navigator.fixed(fix, gps)
            reached += 1
            if reached == len(goals):
                break
    time_s = run.sample_s * np.arange(float(len(poses)))
    stamp, z, sigma, landmark = (np.concatenate(column) for column in zip(*seen, strict=True))
    return Log(
        name="waypoint-run",
        format="simulated",
        prior=Prior(0.0, np.zeros(3), stated * _PRIOR * np.eye(3)),
        odometry=RelativePoses(time_s[1:], np.array(moves), np.array(spreads)),
        measurements=LandmarkMeasurements.of(stamp, z, sigma, landmark),
        positions=Positions(
            np.array([t for t, _ in fixes]),
            np.array([fix for _, fix in fixes]).reshape(-1, 2),
            np.broadcast_to(gps, (len(fixes), 2, 2)),
        ),
        scans=Scans(
            time_s=np.array([t for t, _ in scans]),
            angle_rad=_BEAMS,
            range_m=np.array([r for _, r in scans]),
            intensity=np.zeros((len(scans), len(_BEAMS))),
        ),
        truth=Truth(Poses(time_s, np.array(poses)), exact_landmarks(place)),
        provenance={
            "source": "Misono 2007, section 4.1; the course is ours",
            "waypoints": str(len(run.waypoint)),
            "goals_reached": f"{reached} of {len(goals)}",
            "noise_scale": f"{run.noise_scale:g}",
        },
    )


def _pursue(run: WaypointRun, pose: Array, goal: Array) -> tuple[float, float]:
    """Turn towards the goal [rad], then drive [m]; slower while the goal is aside."""
    error = math.atan2(goal[1] - pose[1], goal[0] - pose[0]) - pose[2]
    error = math.remainder(error, 2.0 * math.pi)
    most = run.most_turn_radps * run.sample_s
    turn = min(max(0.3 * error, -most), most)
    way = run.speed_mps * run.sample_s * max(math.cos(error), 0.1)
    return turn, way


def _moved(pose: Array, turn: float, way: float) -> Array:
    """Misono 2007, eq. 4 on x, y, heading: the turn first."""
    heading = pose[2] + turn
    return np.array([pose[0] + way * math.cos(heading), pose[1] + way * math.sin(heading), heading])


def _spread(way: float, variance: Array) -> Array:
    """(3, 3) covariance of one sample in the frame of arrival (Misono 2007, eq. 5).

    An error of the way lies ahead, one of the turn swings the vehicle sideways, too. As two
    numbers leave three singular, a small stabilisation noise is added.
    """
    b = np.array([[1.0, 0.0], [0.0, way], [0.0, 1.0]])
    spread: Array = (b * variance) @ b.T + _STABILISATION * np.eye(3)
    return spread


def _obstacles(rng: np.random.Generator, run: WaypointRun) -> tuple[Array, Array]:
    """Places (L, 2) beside the course, apart from it and from each other, and diameters (L,)."""
    corners = np.vstack(((0.0, 0.0), run.waypoint, (0.0, 0.0)))
    course = np.vstack(
        [a + np.linspace(0.0, 1.0, 40)[:, None] * (b - a) for a, b in pairwise(corners)]
    )
    low, high = course.min(axis=0) - 6.0, course.max(axis=0) + 6.0
    place: list[Array] = []
    while len(place) < run.obstacles:
        candidate = rng.uniform(low, high)
        beside = np.linalg.norm(course - candidate, axis=1).min()
        others = [float(np.linalg.norm(candidate - other)) for other in place]
        if 1.5 < beside < 8.0 and min(others, default=np.inf) > 3.0:
            place.append(candidate)
    return np.array(place), rng.uniform(0.2, 0.6, run.obstacles)


def _measurements(
    rng: np.random.Generator, run: WaypointRun, pose: Array, place: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Range and bearing (m, 2) of the obstacles ahead within reach, and which they are."""
    offset = place - pose[:2]
    distance = np.hypot(offset[:, 0], offset[:, 1])
    bearing = np.angle(np.exp(1j * (np.arctan2(offset[:, 1], offset[:, 0]) - pose[2])))
    inside = np.flatnonzero((distance <= run.max_range_m) & (np.abs(bearing) <= 0.5 * np.pi))
    noise = run.added_scale * rng.standard_normal((len(inside), 2))
    z = np.column_stack((distance[inside], bearing[inside]))
    return z + noise * (run.sigma_range_m, run.sigma_bearing_rad), inside.astype(np.int64)


def _scan(
    rng: np.random.Generator, run: WaypointRun, pose: Array, place: Array, diameter: Array
) -> Array:
    """The range profile r(k, i) of the obstacles, with noise; NaN where nothing is hit."""
    discs = Solids(disc=np.column_stack((place, diameter)))
    nearest = cast(_BEAMS, pose, discs)
    nearest = np.where(nearest <= run.max_range_m, nearest, np.nan)
    return nearest + run.added_scale * run.sigma_scan_m * rng.standard_normal(len(nearest))
