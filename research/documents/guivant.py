"""Guivant, Masson and Nebot 2002: SLAM that meets GPS (section 5), updates in parts (4.2).

With Victoria Park's raw detections (--data) Figs. 7 to 9 run on it; without, Figs. 8 and 9 run on a
simulated loop of 220 s, long enough for the "200 s navigating with pure SLAM" of Fig. 9.
"A gradual equivalent update will work better than a single large update": measured by the distance
of the filter to the smoother that linearises anew, on simulated loops, on the Victoria Park log
that comes with gtsam, and with --data on MR.CLAM.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from comparisons.adapters.ekf_factory import build_ekf
from comparisons.adapters.filter_loop import run_filter_loop
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.config import EkfConfig, RunConfig
from comparisons.errors import InputError
from comparisons.jobs.run import compare, run_filter
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log, Positions
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.pipeline.prepare import prepare
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.read import as_asked
from comparisons.report.figures.style import draw_reference, draw_trajectory
from comparisons.report.marks import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.trace import RecordedTrace, Trace
from ekf_reference.models.position import PositionFixes
from research.documents.claims import Claims, at_least, at_most, elsewhere, theirs
from research.documents.drawing import TRUE_PATH_COLOUR, chart, mark, plan
from research.documents.drives import Drives, truth_in_order
from research.documents.interface import DocumentFigure, Experiment, Sources

ALONE_S, AFTER_S = 200.0, 30.0
"""How long the filter goes without positions (Fig. 9), and how long it is watched with them."""
SLOW = Drive(speed_mps=1.15, loop_s=255.0 / 1.15)
RTK_M = 0.1
"""Sigma of simulated positions: "10 cm accuracy for short periods"."""
NEAR_M = 20.0
_GAP_S, _CLOCK_S = 2.0, 1e-6
WATCHED = 3


@dataclass(frozen=True, kw_only=True)
class Aided:
    """SLAM alone, then with positions; one row per epoch.

    time_s: (T,). pose: (T, 3). sigma_m: (T,) of the position, both axes together; alone_sigma_m:
    (T,) of a filter that gets no positions at all. landmark_sigma_m: (T, WATCHED) of landmarks
    begun at different times, NaN before. first: row of the first epoch with a position fused.
    fix_s: (G,), fix_m: (G, 2) that were given, sigma_fix_m of each. parts: (P + 1, 2) where the
    vehicle was before each part of the first fused position, and after the last. true: (T, 2), or
    None.
    """

    log: str
    time_s: Array
    pose: Array
    sigma_m: Array
    alone_sigma_m: Array
    landmark_sigma_m: Array
    first: int
    fix_s: Array
    fix_m: Array
    sigma_fix_m: float
    parts: Array
    true: Array | None

    def off_fix_m(self) -> Array:
        """(G,) distances of the vehicle, once it has used them, to the positions."""
        row = np.minimum(np.searchsorted(self.time_s, self.fix_s - _CLOCK_S), len(self.time_s) - 1)
        apart: Array = np.linalg.norm(self.pose[row, :2] - self.fix_m, axis=1)
        return apart

    @property
    def surprise_m(self) -> float:
        """How far the first position that is fused lies from where SLAM thought to be."""
        number = int(np.searchsorted(self.fix_s, self.time_s[self.first] - _CLOCK_S))
        return float(np.linalg.norm(self.fix_m[number] - self.parts[0]))


@dataclass(frozen=True)
class Covered:
    """A whole drive with GPS. path: (T, 2). trees: (L, 2). heard: (T,) whether GPS reported.

    around: (T,) trees within NEAR_M.
    """

    log: str
    path: Array
    trees: Array
    heard: NDArray[np.bool_]
    around: NDArray[np.int64]


def aided(sources: Sources) -> Aided:
    """On Victoria Park where given, else simulated; positions begin after ALONE_S."""
    if sources.folder("victoria_park") is not None:
        return aid(sources.log("victoria_park"), "compressed")
    log = simulate(np.random.default_rng(0), SLOW)
    poses = truth_in_order(log)[0]
    time = np.arange(ALONE_S, log.end_s, 1.0)
    noise = RTK_M * np.random.default_rng(1).standard_normal((len(time), 2))
    spread = np.broadcast_to(RTK_M**2 * np.eye(2), (len(time), 2, 2))
    return aid(replace(log, positions=Positions(time, poses.at(time)[:, :2] + noise, spread)))


def as_published(log: Log, filter_name: str) -> Prepared[RunConfig]:
    """Return a log and settings as `--preset guivant-2002 --gps on` has them.

    Of Victoria Park's positions only those are given that lie in stretches of RTK quality.
    """
    config = RunConfig.of(
        preset="guivant-2002",
        log={"source": log.name, "format": log.format},
        ekf={"filter": filter_name, "gps": "on"},
    )
    return prepare(as_asked(log, config.log), config)


def aid(log: Log, filter_name: str = "full") -> Aided:
    """Withhold a log's positions for ALONE_S, then watch for AFTER_S from the first."""
    prepared = as_published(log, filter_name)
    log, choices = prepared.log, prepared.ekf
    positions = _late(log, prepared.positions)
    until_s = float(positions.time_s[0]) + AFTER_S
    time, pose, sigma, maps, parts, first = [], [], [], [], np.empty((0, 2)), -1
    trace = RecordedTrace()
    for time_s, ekf, fused in _epochs(log, choices, positions, until_s, trace):
        time.append(time_s)
        pose.append(ekf.read_pose().pose)
        sigma.append(_sigma_m(ekf))
        maps.append(np.sqrt(np.diag(ekf.state.covariance)[3:].reshape(-1, 2).sum(axis=1)))
        if fused and first < 0:
            first = len(time) - 1
            used = trace.arrays().positions
            parts = np.vstack((used.pose[used.number == used.number[0], :2], pose[-1][:2]))
    if first < 0:
        raise InputError(f"{log.name}: no position was accepted after {ALONE_S:.0f} s")
    none = positions.chosen(np.zeros(0, dtype=np.intp))
    epochs = _epochs(log, choices, none, until_s, Trace())
    alone_s, alone = np.array([(time_s, _sigma_m(ekf)) for time_s, ekf, _ in epochs]).T
    at = np.array(time)
    whole = np.full((len(at), WATCHED), np.nan)
    chosen = np.linspace(0, len(maps[first]) - 1, WATCHED + 2).astype(int)[:WATCHED]
    for row, sigmas in enumerate(maps):
        there = chosen < len(sigmas)
        whole[row, there] = sigmas[chosen[there]]
    return Aided(
        log=f"{log.name}, positions withheld for {ALONE_S:.0f} s",
        time_s=at,
        pose=np.array(pose),
        sigma_m=np.array(sigma),
        alone_sigma_m=np.interp(at, alone_s, alone),
        landmark_sigma_m=whole,
        first=first,
        fix_s=positions.time_s,
        fix_m=positions.position_m,
        sigma_fix_m=float(np.sqrt(positions.covariance[0, 0, 0])),
        parts=parts,
        true=None if log.truth.poses is None else log.truth.poses.at(at)[:, :2],
    )


def _late(log: Log, given: Positions | None) -> Positions:
    """The first positions after ALONE_S, and those of AFTER_S more."""
    start_s = log.prior.time_s + ALONE_S - _CLOCK_S
    if given is None or not (given.time_s >= start_s).any():
        raise InputError(f"{log.name}: holds no positions after {ALONE_S:.0f} s")
    first_s = given.time_s[given.time_s >= start_s][0]
    return given.chosen((given.time_s >= first_s) & (given.time_s <= first_s + AFTER_S))


def _sigma_m(ekf: Ekf) -> float:
    """Of the position, both axes together."""
    return float(np.sqrt(np.trace(ekf.state.pose_covariance[:2, :2])))


def _epochs(
    log: Log, choices: EkfConfig, positions: Positions, until_s: float, trace: Trace
) -> Iterator[tuple[float, Ekf, bool]]:
    """Time, the filter, and whether it has used a position; until a time."""
    ekf = build_ekf(log, choices, trace)
    started, given, rejected = False, positions.time_s, 0
    for state in run_filter_loop(ekf, log, build_timeline(log, positions), positions):
        if state.fault is not None:
            raise InputError(f"{log.name}: {state.fault}")
        if state.time_s > until_s:
            return
        rejected += state.rejected_fixes
        started = int(np.searchsorted(given, state.time_s + _CLOCK_S)) > rejected
        yield state.time_s, ekf, started


def covered(sources: Sources) -> Covered:
    """Victoria Park with GPS."""
    prepared = as_published(sources.log("victoria_park"), "compressed")
    log, positions = prepared.log, prepared.positions
    if positions is None:
        raise InputError(f"{log.name}: holds no positions")
    run = run_filter(prepared)[0]
    time, path = run.estimate.time_s, run.estimate.pose[:, :2]
    apart = cKDTree(positions.time_s[:, None]).query(time[:, None])[0]
    trees = cKDTree(run.estimate.landmark)
    return Covered(
        f"{log.name}, --gps on, --filter compressed, --preset guivant-2002",
        path,
        run.estimate.landmark,
        apart <= _GAP_S,
        trees.query_ball_point(path, NEAR_M, return_length=True).astype(np.int64),
    )


AIDED = Experiment("Guivant's Figs. 8 and 9", aided)
COVERED = Experiment("Guivant's Fig. 7", covered, "victoria_park")


_EARLY_S = 20.0
_COLOURS = (SMOOTHER_COLOUR, SCANS_COLOUR, TRUTH_COLOUR)
_LAST = 5


def _claims_7(found: Covered) -> Claims:
    text = (
        f"GPS is missing where trees are dense (mean number within {NEAR_M:.0f} m where it is "
        "missing, over where it is not)"
    )
    why = elsewhere("the public log does not say which positions have the 10 cm")
    ratio = found.around[~found.heard].mean() / found.around[found.heard].mean()
    yield at_least(text, ratio, 1.0, why=why)


def _claims_8(found: Aided) -> Claims:
    first, sigma, alone = found.first, found.sigma_m, found.alone_sigma_m
    passed_s = found.time_s[-1] - found.time_s[first]
    early = int(np.searchsorted(found.time_s, found.time_s[0] + _EARLY_S))
    landmarks = np.square(found.landmark_sigma_m[-1] / found.landmark_sigma_m[first - 1])
    text = (
        f"the vehicle's deviation grows while exploring (median before GPS over that after "
        f"{_EARLY_S:.0f} s)"
    )
    yield at_least(text, np.median(sigma[early:first]) / sigma[early], 1.0)
    text = "it falls on revisiting a known place (without GPS: least over the largest before it)"
    yield at_most(text, np.min(alone / np.maximum.accumulate(alone)), 0.9, own=True)
    why = elsewhere("one position of this GPS weighs little against what SLAM knows of itself")
    text = (
        "GPS reduces the vehicle's covariance significantly (variance after the first position "
        "over that before)"
    )
    yield at_most(text, np.square(sigma[first] / sigma[first - 1]), 0.5, why=why, own=True)
    text = (
        f"and the landmarks' within {passed_s:.0f} s (median of those shown, variance "
        "after over before)"
    )
    yield at_most(text, np.median(landmarks), 0.5, own=True)


def _claims_9(found: Aided) -> Claims:
    moves = np.linalg.norm(np.diff(found.parts, axis=0), axis=1)
    off = found.off_fix_m()
    why = elsewhere(
        f"SLAM is {found.surprise_m:.2f} m off then, and a position has a sigma of "
        f"{found.sigma_fix_m:.1f} m"
    )
    text = "when GPS arrives it differs significantly from SLAM (first difference over GPS sigma)"
    yield at_least(text, found.surprise_m / found.sigma_fix_m, 3.0, why=why, own=True)
    text = "it is taken in by updates small enough for their Jacobians (largest move by one)"
    yield at_most(text, moves.max(), PositionFixes().splitter.largest_move_m, "m")
    why = elsewhere(f"the first difference is {found.surprise_m:.2f} m alone")
    text = (
        f"the sequence of updates brings both together (median distance of the last {_LAST} "
        "positions over the first difference)"
    )
    yield at_most(text, np.median(off[-_LAST:]) / found.surprise_m, 0.5, why=why, own=True)
    if found.true is not None:
        error = np.linalg.norm(found.pose[:, :2] - found.true, axis=1)
        text = "and the vehicle to where it truly is (error at the end over that before GPS)"
        yield at_most(text, error[-1] / error[found.first - 1], 0.5, own=True)


def _draw_7(canvas: Canvas, found: Covered) -> None:
    axis = canvas.add_subplot()
    draw_trajectory(axis, found.path, SMOOTHER_COLOUR, "estimated path")
    heard = np.where(found.heard[:, None], found.path, np.nan)
    axis.plot(*heard.T, color=EKF_COLOUR, linewidth=3.0, alpha=0.6, label="GPS reports")
    draw_reference(axis, found.trees, "*", "trees")
    plan(axis, "GPS and trees", legend="best")


def _draw_8(canvas: Canvas, found: Aided) -> None:
    left, right = canvas.subplots(1, 2)
    left.plot(found.time_s, found.alone_sigma_m, "--", color="#999999", label="without GPS")
    left.plot(found.time_s, found.sigma_m, "-", color=EKF_COLOUR, label="vehicle")
    for column, colour in enumerate(_COLOURS):
        label = f"landmark {column + 1}"
        right.plot(found.time_s, found.landmark_sigma_m[:, column], color=colour, label=label)
    for axis, title in ((left, "the vehicle's position"), (right, "selected landmarks")):
        mark(axis, float(found.time_s[found.first]), "GPS begins")
        chart(axis, title, "time [s]", "deviation [m]")
        axis.set_ylim(bottom=0.0)


def _draw_9(canvas: Canvas, found: Aided) -> None:
    left, right = canvas.subplots(1, 2)
    near = slice(max(found.first - 60, 0), None)
    for axis, rows in ((left, slice(None)), (right, near)):
        if found.true is not None:
            draw_trajectory(axis, found.true[rows], TRUE_PATH_COLOUR, "true path")
        draw_trajectory(axis, found.pose[rows], EKF_COLOUR, "estimated path")
        axis.plot(*found.fix_m.T, ".", color=SMOOTHER_COLOUR, markersize=4, label="GPS")
    right.plot(*found.parts.T, "o-", color=SCANS_COLOUR, markersize=4, label="first position")
    plan(left, f"{found.time_s[found.first] - found.time_s[0]:.0f} s of SLAM alone, then GPS")
    plan(right, "where GPS begins", legend="best")


MRCLAM = "mrclam"
ONE = "one update"
SPLITS: Mapping[str, Mapping[str, float]] = {
    ONE: {},
    "1 degree, 1 m": {"split_turn_rad": float(np.deg2rad(1.0)), "split_move_m": 1.0},
    "0.1 degree, 0.05 m": {"split_turn_rad": float(np.deg2rad(0.1)), "split_move_m": 0.05},
    "half of a variance": {"split_shrink": 0.5},
}
NOISY = 3.0
"""Factor on the noise of the second kind of simulated loops, which close with larger errors."""
_SPLIT_COLOURS = (TRUTH_COLOUR, EKF_COLOUR, SMOOTHER_COLOUR, SCANS_COLOUR)


@dataclass(frozen=True, kw_only=True)
class SplitRun:
    """A filter with one splitting of its updates. gap: linearisation gap [smoother's sigma].

    optimism: its variance over the smoother's in the worst direction.
    """

    gap: float
    optimism: float


@dataclass(frozen=True)
class SplitLog:
    """Medians over one or more drives, by splitting."""

    name: str
    runs: Mapping[str, SplitRun]


def split(sources: Sources) -> Drives[SplitLog]:
    """Run every splitting on every log."""
    found = tuple(_median(name, [runs(log) for log in logs]) for name, logs in _logs(sources))
    return Drives("; ".join(one.name for one in found), found)


def _logs(sources: Sources) -> Iterator[tuple[str, list[Log]]]:
    for name, scale in (("simulated loops", 1.0), (f"loops of {NOISY:g} times the noise", NOISY)):
        drives = [
            open_log("simulated-loop", choices=SimulationChoices(seed, noise_scale=scale))
            for seed in range(sources.drives)
        ]
        yield f"{name} ({sources.drives})", drives
    yield "Victoria Park (gtsam)", [open_log("victoria-park")]
    folder = sources.folder(MRCLAM)
    for path in () if folder is None else sorted(folder.glob("MRCLAM_Dataset*")):
        yield path.name.replace("MRCLAM_Dataset", "MR.CLAM "), [open_log(str(path))]


def runs(log: Log) -> dict[str, SplitRun]:
    """Run every splitting on one log."""
    found: dict[str, SplitRun] = {}
    for name, bounds in SPLITS.items():
        said = compare(log, RunConfig(ekf=EkfConfig.of(**bounds))).agreement
        found[name] = SplitRun(gap=said.linearisation.sigma, optimism=said.optimism)
    return found


def _median(name: str, drives: list[dict[str, SplitRun]]) -> SplitLog:
    runs = {}
    for split in SPLITS:
        each = [(drive[split].gap, drive[split].optimism) for drive in drives]
        gap, optimism = np.median(each, axis=0).tolist()
        runs[split] = SplitRun(gap=gap, optimism=optimism)
    return SplitLog(name, runs)


def _claims_4_2(found: Drives[SplitLog]) -> Claims:
    for one in found.each:
        whole, *finer = one.runs.items()
        of_one = whole[1]
        for name, run in finer:
            why = theirs(
                f"{run.gap:.2f} sigma, {of_one.gap:.2f} in one update: a part linearises the "
                "new measurement anew, what went before stays as it was"
            )
            text = (
                f"a gradual update works better: {one.name}, parts of {name} (linearisation "
                "gap over that of one update)"
            )
            yield at_most(text, run.gap / of_one.gap, 1.0, why=why)
            why = theirs(f"{run.optimism:.3f}, {of_one.optimism:.3f} in one update")
            text = (
                f"and is less optimistic: {one.name}, parts of {name} (least variance over the "
                "smoother's, over that of one update)"
            )
            yield at_least(text, run.optimism / of_one.optimism, 1.0, why=why)


def _draw_4_2(canvas: Canvas, found: Drives[SplitLog]) -> None:
    axes = canvas.subplots(1, 2)
    place = np.arange(len(found.each))
    for number, (name, colour) in enumerate(zip(SPLITS, _SPLIT_COLOURS, strict=True)):
        at = place + 0.2 * (number - 1.5)
        for axis, field in zip(axes, ("gap", "optimism"), strict=True):
            values = [getattr(one.runs[name], field) for one in found.each]
            axis.bar(at, values, 0.18, color=colour, label=name)
    for axis, title in zip(axes, ("linearisation gap [sigma]", "optimism (1: none)"), strict=True):
        chart(axis, title, "", "")
        axis.set_yscale("log")
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("{x:g}")
        axis.set_xticks(place, [one.name for one in found.each], fontsize=7, rotation=12)


FIGURES = (
    DocumentFigure(
        name="G7", title="The path, the trees, and where GPS reports",
        says="GPS is unavailable where trees are dense and reliable in the open; dense trees are "
        "where SLAM has its landmarks.",
        experiment=COVERED, draw=_draw_7, claims=_claims_7, size=(8.0, 6.5),
    ),
    DocumentFigure(
        name="G8", title="Deviations of vehicle and landmarks",
        says="The vehicle's deviation grows while it explores, falls when it revisits a known "
        "place, and falls significantly, as do the landmarks', when GPS is incorporated.",
        experiment=AIDED, draw=_draw_8, claims=_claims_8, size=(11.0, 4.4),
    ),
    DocumentFigure(
        name="G9", title="GPS arrives after 200 s of SLAM alone",
        says="After 200 s of pure SLAM the first GPS positions differ significantly from the "
        "estimate; they are incorporated as a sequence of updates, and the filter stays sound.",
        experiment=AIDED, draw=_draw_9, claims=_claims_9, size=(11.0, 4.8),
    ),
    DocumentFigure(
        name="G4.2", title="Updates made in parts",
        says="A sequence of weaker updates, each linearised anew, works better than one large "
        "update, as in closing a loop.",
        experiment=Experiment("Guivant's updates in parts", split), draw=_draw_4_2,
        claims=_claims_4_2, size=(11.0, 4.8), place="section 4.2",
    ),
)  # fmt: skip
