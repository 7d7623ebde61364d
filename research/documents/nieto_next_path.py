"""Nieto 2005, section 7.2.4 (future research): the next path, by what it would leave unknown.

The thesis asks for a path that maximises the information gain, planned over the map, and gives no
method. Here every candidate is a shortest way over the cells of the dense map that nothing is near
of, all of one length. The filter and the smoother each say what it would leave: the covariance of
the last pose and of all landmarks after the motions and the measurements that are predicted along
it. Without innovations neither moves, so that both differ by their points of linearisation alone.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure as Canvas
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from comparisons.adapters.ekf_factory import build_ekf, motion_model, settle
from comparisons.adapters.filter_loop import Beside, run_filter_loop
from comparisons.adapters.smoother_input import assemble, position_rows
from comparisons.adapters.time_window import cut_log
from comparisons.adapters.timeline import Timeline, build_timeline
from comparisons.arrays import Array, Index
from comparisons.config import EkfConfig
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.accuracy import OCCUPIED
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.figure import draw_occupied
from comparisons.extensions.dense_maps.source import DenseWatcher
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.report.figures.style import draw_reference, draw_trajectory
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.state import FilterDivergedError
from ekf_reference.core.trace import Trace
from ekf_reference.dense.layers.layer import Samples
from ekf_reference.models.motion import RelativePoseModel
from ekf_reference.models.range_bearing import RangeBearing
from graphslam.graph_builder import build_graph, to_values
from graphslam.marginals import last_pose_and_landmarks, to_global
from graphslam.problem import SlamProblem
from graphslam.smoother import smooth
from research.documents.claims import Claims, at_least, at_most
from research.documents.drawing import chart, plan
from research.documents.drives import true_surroundings
from research.documents.interface import Experiment, Figure, Sources

UNTIL_S = 95.0
"""When the path is chosen: in the second loop, each of which takes 77 s."""
CELL_M, CLEARANCE_M, WAY_M = 1.0, 2.0, 30.0
"""Cells of the plan; how far it keeps from what is occupied; length of all candidates."""
DIRECTIONS = 36
"""In each of which one candidate ends, if any way of that length does."""
_MODEL, _MOTION = RangeBearing(), RelativePoseModel()


class Left(NamedTuple):
    """What a path leaves of the last pose and all landmarks: log-determinant, and trace [m^2].

    The trace is of positions alone.
    """

    log_determinant: float
    trace_m2: float

    @classmethod
    def of(cls, covariance: Array) -> Left:
        """Of a joint covariance (3 + 2 L, 3 + 2 L) of x, y, heading and landmarks."""
        variance = np.delete(np.diag(covariance), 2)
        return cls(float(np.linalg.slogdet(covariance)[1]), float(variance.sum()))


@dataclass(frozen=True)
class Prediction:
    """Of one estimator. now: without a path. left: by each path."""

    now: Left
    left: tuple[Left, ...]

    @property
    def gain(self) -> Array:
        """(C,) information gained by each path [nat], what motion loses taken off."""
        left = np.array([one.log_determinant for one in self.left])
        gained: Array = 0.5 * (self.now.log_determinant - left)
        return gained

    @property
    def trace_m2(self) -> Array:
        """(C,) of what each path leaves."""
        return np.array([one.trace_m2 for one in self.left])


@dataclass(frozen=True, kw_only=True)
class Path:
    """K motions ahead and what they show.

    increment: (K, 3) from each pose to the next, in the frame of the first of both. noise: (K, 3,
    3) of the right perturbation. seen: landmarks in view of each pose at which they lead. sigma:
    (2,) of range [m] and bearing [rad].
    """

    increment: Array
    noise: Array
    seen: tuple[Index, ...]
    sigma: Array

    def poses(self, start: Array) -> Array:
        """(K + 1, 3) from a pose (3,) on."""
        found = [start]
        for step in self.increment:
            found.append(_MOTION.step(found[-1], step, 1.0).pose)
        return np.array(found)


def covariance_by_filter(ekf: Ekf, path: Path) -> Array:
    """(3 + 2 L, 3 + 2 L) after a path, by a full filter's own steps; the filter stays as it is."""
    ahead = Ekf(_MOTION, ekf.association, ekf.state.pose, ekf.state.pose_covariance)
    ahead.state = copy.deepcopy(ekf.state)
    for increment, noise, seen in zip(path.increment, path.noise, path.seen, strict=True):
        ahead.predict(increment, noise, 1.0)
        if len(seen):
            z = _MODEL.predict(ahead.state.pose, ahead.state.landmarks[seen]).z
            ahead.observe_known(z, np.tile(np.diag(path.sigma**2), (len(seen), 1, 1)), seen)
    return ahead.state.covariance.copy()


def covariance_by_smoother(
    problem: SlamProblem, poses: Array, landmark: Array, path: Path
) -> Array:
    """(3 + 2 L, 3 + 2 L) after a path, by the marginal of the graph with the path's factors.

    poses: (K, 3) and landmark: (L, 2) where the problem's factors are linearised.
    """
    ahead = path.poses(poses[-1])
    step = np.repeat(np.arange(len(path.seen)), [len(seen) for seen in path.seen])
    which = np.concatenate(path.seen)
    z = [_MODEL.predict(ahead[k + 1], landmark[seen]).z for k, seen in enumerate(path.seen)]
    longer = replace(
        problem,
        increment=np.concatenate((problem.increment, path.increment)),
        increment_covariance=np.concatenate((problem.increment_covariance, path.noise)),
        measurement_pose=np.concatenate((problem.measurement_pose, len(poses) + step)),
        measurement_landmark=np.concatenate((problem.measurement_landmark, which)),
        z=np.concatenate((problem.z, *z)),
        sigma=np.concatenate((problem.sigma, np.tile(path.sigma, (len(which), 1)))),
    )
    every = np.concatenate((poses, ahead[1:]))
    graph = build_graph(longer).linearize(to_values(every, landmark, longer.seen_landmarks))
    local = last_pose_and_landmarks(graph, len(every), len(landmark)).covariance
    return to_global(local, float(every[-1, 2]))


def ways(place: Array, held: Samples) -> list[Array]:
    """Shortest ways (K + 1, 2) over the map, all about WAY_M long, one in each direction.

    place: (2,) where they begin. held: the occupancy layer; a way leads where the layer knows
    something, and keeps CLEARANCE_M from what is occupied, but at its start. Raises InputError for
    none.
    """
    half = math.ceil(WAY_M / CELL_M)
    north, east = np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1)
    cell = place + CELL_M * np.column_stack((east, north))
    start = len(cell) // 2
    occupied = held.point[held.occupancy > OCCUPIED]
    free = cKDTree(occupied).query(cell)[0] >= CLEARANCE_M + 0.5 * CELL_M
    free &= cKDTree(held.point).query(cell)[0] <= 0.5 * CELL_M
    free[start] = True
    first, second = cKDTree(cell).query_pairs(1.5 * CELL_M, output_type="ndarray").T
    both = free[first] & free[second]
    first, second = first[both], second[both]
    length = np.linalg.norm(cell[first] - cell[second], axis=1)
    graph = coo_array((length, (first, second)), shape=(len(cell), len(cell))).tocsr()
    away, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    rim = np.flatnonzero(np.abs(away - WAY_M) <= 0.5 * CELL_M)
    bearing = np.arctan2(*(cell[rim] - place).T[::-1])
    sector = np.floor((bearing + np.pi) / (2.0 * np.pi) * DIRECTIONS).astype(int)
    found = []
    for one in np.unique(sector).tolist():
        own = rim[sector == one]
        end = int(own[np.abs(away[own] - WAY_M).argmin()])
        found.append(_traced(cell, before, end))
    if not found:
        raise InputError(f"no free way of {WAY_M:g} m over the map")
    return found


def _traced(cell: Array, before: Index, end: int) -> Array:
    """Follow predecessors from a cell back to the first."""
    place = [cell[end]]
    while before[end] >= 0:
        end = int(before[end])
        place.append(cell[end])
    return np.array(place)[::-1]


class Vehicle(NamedTuple):
    """What paths are predicted with: noise per metre straight on, reach, and sigmas as of Path.

    sample: (3, 3) noise of a motion of `sample_m` straight on. reach_m and half_rad: of the
    sensor.
    """

    sample: Array
    sample_m: float
    reach_m: float
    half_rad: float
    sigma: Array

    @classmethod
    def of(cls, log: Log, timeline: Timeline, ekf: Ekf) -> Vehicle:
        """As the log has them: its last control's noise at its median speed."""
        seen, duration_s = log.measurements, float(timeline.step_duration_s[-1])
        speed = float(np.median(timeline.control[:, 0]))
        _, _, by_control = motion_model(log).step(np.zeros(3), np.array((speed, 0.0)), duration_s)
        noise = by_control @ timeline.control_covariance[-1] @ by_control.T
        return cls(
            noise + ekf.stabilisation.covariance(duration_s, np.zeros(3)),
            speed * duration_s,
            float(seen.range_m.max()),
            float(np.abs(seen.bearing_rad).max()),
            np.array((np.median(seen.sigma_range_m), np.median(seen.sigma_bearing_rad))),
        )

    def noise(self, length_m: float) -> Array:
        """(3, 3) right perturbation of a motion straight on, sample by sample."""
        found, single = np.zeros((3, 3)), np.eye(3)
        for _ in range(max(round(length_m / self.sample_m), 1)):
            single[1, 2] = self.sample_m
            found = single @ found @ single.T + self.sample
        return found

    def path(self, pose: Array, way: Array, landmark: Array) -> Path:
        """Along a way (K + 1, 2) from a pose (3,), each motion heading for the next place."""
        step = np.diff(way, axis=0)
        heading = np.concatenate((pose[2:], np.arctan2(step[:, 1], step[:, 0])))
        cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
        ahead, left = cos * step[:, 0] + sin * step[:, 1], cos * step[:, 1] - sin * step[:, 0]
        turn = wrap_angle(np.diff(heading))
        seen = []
        for place, towards in zip(way[1:], heading[1:], strict=True):
            z = _MODEL.predict(np.append(place, towards), landmark).z
            inside = (z[:, 0] <= self.reach_m) & (np.abs(wrap_angle(z[:, 1])) <= self.half_rad)
            seen.append(np.flatnonzero(inside))
        return Path(
            increment=np.column_stack((ahead, left, turn)),
            noise=np.array([self.noise(float(np.hypot(*one))) for one in step]),
            seen=tuple(seen),
            sigma=self.sigma,
        )


@dataclass(frozen=True, kw_only=True)
class NextPath:
    """The candidates at one instant.

    way: (K + 1, 2) of each. by_filter, by_smoother: what each would leave. landmark: (L, 2).
    driven: (T, 2). held: the occupancy layer. segment: (S, 4) true surfaces.
    """

    log: str
    way: tuple[Array, ...]
    by_filter: Prediction
    by_smoother: Prediction
    driven: Array
    landmark: Array
    held: Samples
    segment: Array


def next_path(sources: Sources) -> NextPath:
    """The drive of section 4.1.3, in its second loop."""
    log = open_log("occupancy-loop", choices=SimulationChoices(0, 2))
    return of_log(cut_log(log, end_s=UNTIL_S))


def of_log(log: Log) -> NextPath:
    """Candidates from where a log ends. Raises InputError for a log without true surfaces."""
    segment, timeline = true_surroundings(log)[1], build_timeline(log)
    watcher = DenseWatcher(log, DenseMapsConfig(layers=("occupancy",)))
    ekf = build_ekf(log, settle(EkfConfig(), log), Trace())
    driven, landmark_index = [], []
    for state in run_filter_loop(ekf, log, timeline, beside=Beside(watching=watcher)):
        if state.fault is not None:
            raise FilterDivergedError(state.fault)
        driven.append(ekf.state.pose.copy())
        landmark_index.append(state.landmark_indices)
    dense = watcher.dense
    held = dense.layers["occupancy"].samples(dense.regions.placed(dense.landmark))
    pose, landmark = ekf.state.pose, ekf.state.landmarks
    way = ways(pose[:2], held)
    vehicle = Vehicle.of(log, timeline, ekf)
    paths = [vehicle.path(pose, one, landmark) for one in way]
    problem = assemble(
        log, timeline, np.concatenate(landmark_index), len(landmark), position_rows(timeline, None)
    )
    best = smooth(problem, {"ekf": (np.array(driven), landmark)})
    return NextPath(
        log=f"{log.name} until {log.end_s:.0f} s, seed 0",
        way=tuple(way),
        by_filter=Prediction(
            Left.of(ekf.state.covariance),
            tuple(Left.of(covariance_by_filter(ekf, path)) for path in paths),
        ),
        by_smoother=Prediction(
            Left.of(best.marginal().covariance),
            tuple(
                Left.of(covariance_by_smoother(problem, best.poses, best.landmarks, path))
                for path in paths
            ),
        ),
        driven=np.array(driven)[:, :2],
        landmark=landmark.copy(),
        held=held,
        segment=segment,
    )


def crossings(way: Array, segment: Array) -> int:
    """Count how often a way (K + 1, 2) crosses segments (S, 4)."""
    first, second = way[:-1, None], way[1:, None]
    begin, end = segment[None, :, :2], segment[None, :, 2:]
    apart = _side(first, second, begin) * _side(first, second, end) < 0.0
    return int(
        np.count_nonzero(apart & (_side(begin, end, first) * _side(begin, end, second) < 0.0))
    )


def _side(first: Array, second: Array, point: Array) -> Array:
    """On which side of lines points lie: above zero on the left."""
    along, off = second - first, point - first
    side: Array = along[..., 0] * off[..., 1] - along[..., 1] * off[..., 0]
    return side


def _claims_7_2_4(found: NextPath) -> Claims:
    ours, theirs = found.by_filter, found.by_smoother
    spread = np.ptp(theirs.gain)
    text = (
        "filter and smoother agree on what each path would gain (largest difference over the "
        "spread of the paths)"
    )
    yield at_most(text, np.abs(ours.gain - theirs.gain).max() / spread, _AGREED, own=True)
    less = theirs.gain.max() - theirs.gain[ours.gain.argmax()]
    text = (
        "and choose alike (what the smoother would gain less by the filter's choice than by its "
        "own, over the spread)"
    )
    yield at_most(text, less / spread, _AGREED, own=True)
    more = theirs.trace_m2[ours.trace_m2.argmin()] - theirs.trace_m2.min()
    text = "by the trace, too (what the filter's choice would leave more, over the spread)"
    yield at_most(text, more / np.ptp(theirs.trace_m2), _AGREED, own=True)
    text = "no path over the dense map crosses a true surface (crossings)"
    yield at_most(text, sum(crossings(way, found.segment) for way in found.way), 0.0)
    text = "which straight ways to the same ends do (crossings)"
    yield at_least(text, sum(crossings(way[[0, -1]], found.segment) for way in found.way), 1.0)


def _draw_7_2_4(canvas: Canvas, found: NextPath) -> None:
    left, right = canvas.subplots(1, 2)
    ours, theirs = found.by_filter.gain, found.by_smoother.gain
    draw_occupied(left, found.held)
    draw_reference(left, found.landmark, "*", "landmarks")
    draw_trajectory(left, found.driven, TRUTH_COLOUR, "driven")
    for way in found.way:
        left.plot(*way.T, color=SMOOTHER_COLOUR, linewidth=0.8)
    left.plot(*found.way[ours.argmax()].T, color=EKF_COLOUR, linewidth=2.2, label="chosen")
    plan(left, f"ways of {WAY_M:g} m, {CLEARANCE_M:g} m from what is occupied", legend="best")
    order = np.argsort(theirs)
    place = np.arange(len(order))
    right.plot(place, theirs[order], "o", color=SMOOTHER_COLOUR, label="smoother")
    right.plot(place, ours[order], "x", color=EKF_COLOUR, label="filter")
    chart(right, "information gained by each way", "way, by the smoother's gain", "gain [nat]")


_AGREED = 0.1
EXPERIMENT = Experiment("section 7.2.4", next_path)

FIGURES = (
    Figure(
        name="N7.2.4", place="section 7.2.4", title="The next path, by what it would leave unknown",
        says="Future research: with a dense map the next path can be planned, and chosen for what "
        "it would add to the information of the whole system.",
        experiment=EXPERIMENT, draw=_draw_7_2_4, claims=_claims_7_2_4, size=(11.0, 5.0),
    ),
)  # fmt: skip
