"""Nieto 2005, section 2.9: feature SLAM in simulation, Figs. 2.8 to 2.12, and Fig. 3.4.

The drive is that of Table 2.2. Where its landmarks stand and where it starts is ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from comparisons.arrays import Array
from comparisons.checks.consistency.nees import PoseErrors, pose_errors
from comparisons.estimates.estimate import landmark_blocks
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log, Positions
from comparisons.logs.simulate.drive import Drive
from comparisons.report.figures.style import draw_correlation
from comparisons.report.marks import SMOOTHER_COLOUR
from comparisons.statistics import mean_band, normalise
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.layout import Layout
from ekf_reference.core.state import correlation_coefficients
from research.documents.claims import (
    Claims,
    at_least,
    at_most,
    elsewhere,
    theirs,
    within,
)
from research.documents.drawing import (
    Place,
    chart,
    draw_error,
    draw_slam,
    mark,
    plan,
)
from research.documents.drives import Drives, truth_in_order, watched_run
from research.documents.interface import Experiment, Figure, Sources
from research.documents.measures import (
    SHARE_WITHIN_3_SIGMA,
    THREE_SIGMA_SQUARED,
    rms,
)

LOOPS = 3
"""The thesis goes round "several times"."""
LOOP_S = Drive().loop_s
_AWAY_S = 30.0
_CLOCK_S = 1e-6
_FIXES, _EVERY_S, _SIGMA_FIX_M = 5, 17.0, 0.1


@dataclass(frozen=True)
class Moment:
    """The filter after a scan. landmark, true: (L, 2). covariance: (3 + 2 L, 3 + 2 L)."""

    time_s: float
    landmark: Array
    true: Array
    covariance: Array

    @classmethod
    def of(cls, time_s: float, ekf: Ekf, true: Array) -> Moment:
        """true: (K, 2) of all landmarks, in the filter's order, K at least its number."""
        place = ekf.state.landmarks.copy()
        return cls(time_s, place, true[: len(place)], ekf.state.covariance.copy())

    @property
    def blocks(self) -> Array:
        """(L, 2, 2) covariances of the landmarks."""
        return landmark_blocks(self.covariance)

    @property
    def error_m(self) -> Array:
        """(L,) distances to the truth."""
        error: Array = np.linalg.norm(self.landmark - self.true, axis=1)
        return error

    @property
    def squared(self) -> Array:
        """(L,) normalised errors squared."""
        error = self.landmark - self.true
        return normalise(error, self.blocks).squared

    @property
    def sigma_m(self) -> Array:
        """(L,) root of the sum of a landmark's variances."""
        sigma: Array = np.sqrt(np.trace(self.blocks, axis1=1, axis2=2))
        return sigma

    @property
    def coefficients(self) -> Array:
        """Correlation coefficients of the whole state (eq. 2.62)."""
        return correlation_coefficients(self.covariance)

    @property
    def mean_correlation(self) -> float:
        """Of two landmarks along the same axis, all pairs."""
        rho, n = self.coefficients[3:, 3:], len(self.landmark)
        pairs = np.triu_indices(n, 1)
        return float(np.mean([rho[axis::2, axis::2][pairs] for axis in (0, 1)]))

    def among(self, *landmark_index: int) -> Array:
        """(2 k, 2 k) covariance of k landmarks, in this order."""
        layout = Layout.packed(3, len(self.landmark))
        columns = layout.columns(np.array(landmark_index))[3:]
        return self.covariance[np.ix_(columns, columns)]

    def far(self, start: Array) -> Array:
        """(L,) which landmarks are among the third that is farthest from a place (2,)."""
        distance = np.linalg.norm(self.true - start, axis=1)
        chosen: Array = distance >= np.quantile(distance, 2.0 / 3.0)
        return chosen


@dataclass(frozen=True, kw_only=True)
class LoopDrive:
    """One drive. poses: at the scans. pose: (T, 3). first_landmark_m: (T, 2) sigmas of the first.

    quarter, before, after, end: the filter after a quarter of the loop, with the last scan before
    the start is seen again, at the end of the first loop, and after all loops.
    """

    pose: Array
    poses: PoseErrors
    first_landmark_m: Array
    quarter: Moment
    before: Moment
    after: Moment
    end: Moment

    @property
    def true_path(self) -> Array:
        """(T, 2) at the scans."""
        path: Array = (self.pose - self.poses.error)[:, :2]
        return path


@dataclass(frozen=True, kw_only=True)
class Fixed:
    """A map while a few absolute positions arrive.

    fix_s: their times. before, after: all of them. time_s, mean_correlation: (T,) at the scans.
    """

    log: str
    fix_s: Array
    before: Moment
    after: Moment
    time_s: Array
    mean_correlation: Array


def loops(sources: Sources) -> Drives[LoopDrive]:
    """Drives of three loops, seeds from 0."""
    seeds = range(sources.drives)
    logs = (open_log("simulated-loop", choices=SimulationChoices(seed, LOOPS)) for seed in seeds)
    name = f"simulated-loop --loops {LOOPS}, {len(seeds)} drives from seed 0"
    return Drives(name, tuple(loop_drive(log) for log in logs))


def loop_drive(log: Log) -> LoopDrive:
    """Run the filter over a labelled simulated log of at least one loop."""
    until = {
        "quarter": 0.25 * LOOP_S,
        "before": closing_s(log) - _CLOCK_S,
        "after": LOOP_S,
        "end": log.end_s,
    }
    poses, true = truth_in_order(log)
    kept: dict[str, Moment] = {}
    time, pose, spread, first = [], [], [], []
    for time_s, ekf in watched_run(log):
        covariance = ekf.state.covariance
        time.append(time_s)
        pose.append(ekf.state.pose)
        spread.append(covariance[:3, :3].copy())
        first.append(np.sqrt(np.diag(covariance)[3:5]))
        for name, latest in until.items():
            if time_s <= latest + _CLOCK_S:
                kept[name] = Moment.of(time_s, ekf, true)
    at = np.array(time)
    errors = pose_errors(at, np.array(pose), np.array(spread), poses.at(at))
    return LoopDrive(pose=np.array(pose), poses=errors, first_landmark_m=np.array(first), **kept)


def fixed(sources: Sources) -> Fixed:
    """One loop, then a few positions on the next, evenly along it."""
    log = open_log("simulated-loop", choices=SimulationChoices(0, 2))
    poses, true = truth_in_order(log)
    time = LOOP_S + _EVERY_S * np.arange(_FIXES, dtype=float)
    noise = np.random.default_rng(1).standard_normal((_FIXES, 2))
    place = poses.at(time)[:, :2] + _SIGMA_FIX_M * noise
    fixes = Positions(time, place, np.broadcast_to(_SIGMA_FIX_M**2 * np.eye(2), (_FIXES, 2, 2)))
    seen = []
    for time_s, ekf in watched_run(log, positions=fixes):
        if time_s > time[-1] + _CLOCK_S:
            break
        if time_s > time[0] - 1.0:
            seen.append(Moment.of(time_s, ekf, true))
    return Fixed(
        log="simulated-loop, seed 0, with positions of our own",
        fix_s=time,
        before=next(m for m in reversed(seen) if m.time_s < time[0] - _CLOCK_S),
        after=seen[-1],
        time_s=np.array([m.time_s for m in seen]),
        mean_correlation=np.array([m.mean_correlation for m in seen]),
    )


LOOP_EXPERIMENT = Experiment("section 2.9", loops)
FIXED_EXPERIMENT = Experiment("section 2.9 with positions", fixed)


def closing_s(log: Log) -> float:
    """When the first scan's landmarks are seen again after a while."""
    seen = log.measurements
    early = seen.landmark[seen.time_s <= seen.time_s[0]]
    time = seen.time_s[np.isin(seen.landmark, early)]
    return float(time[1:][np.diff(time) > _AWAY_S][0])


NEAR_M, FAR_M = 12.0, 50.0
"""Landmarks nearer than that are close to each other; farther ones are not."""
_SIDES = ("before", "after")
_TOO_SURE = theirs("EKF-SLAM grows too sure as its heading errs; see `slamcheck montecarlo`")


def _claims_2_8(found: Drives[LoopDrive]) -> Claims:
    left, right = [], []
    for d in found.each:
        east = d.true_path[:, 0]
        open_ = d.poses.time_s <= d.before.time_s
        low, high = np.quantile(east, (1.0 / 3.0, 2.0 / 3.0))
        left.append(d.poses.error[open_ & (east <= low), :2])
        right.append(d.poses.error[open_ & (east >= high), :2])
    before, after = ([getattr(d, name).error_m for d in found.each] for name in _SIDES)
    why = elsewhere("our loop begins at the right, where the thesis begins at the bottom")
    text = "before the loop closes the path errs most on its left third (RMS over the right's)"
    yield at_least(text, rms(*left) / rms(*right), 1.0, why=why)
    text = "closing the loop reduces the landmarks' error (RMS after over before)"
    yield at_most(text, rms(*after) / rms(*before), 1.0)


def _claims_2_9(found: Drives[LoopDrive]) -> Claims:
    drives = found.each
    far = [d.before.far(d.true_path[0]) for d in drives]
    each = list(zip(drives, far, strict=True))
    inside = [d.before.squared[f] <= THREE_SIGMA_SQUARED for d, f in each]
    farthest = [
        d.before.squared[np.argmax(np.linalg.norm(d.before.true - d.true_path[0], axis=1))]
        for d in drives
    ]
    error_before, sigma_before, error_after, sigma_after = (
        rms(*(getattr(getattr(d, when), what)[f] for d, f in each))
        for when in _SIDES
        for what in ("error_m", "sigma_m")
    )
    text = (
        "the far landmarks lie within their 3-sigma ellipses before the loop closes (share, of "
        "the drive drawn)"
    )
    yield at_least(text, inside[0].mean(), 1.0)
    text = (
        "over drives the farthest landmark's error is as large as stated (mean NEES; limits: "
        "its 95 % band)"
    )
    yield within(text, np.mean(farthest), mean_band(len(drives), 2), why=_TOO_SURE)
    yield at_most("their error falls with the closing (ratio)", error_after / error_before, 1)
    text = "their uncertainty falls with the closing (ratio)"
    yield at_most(text, sigma_after / sigma_before, 1.0)
    why = theirs(
        "the landmarks of one drive share their error, so that one drive in ten decides "
        "this number; the NEES above takes one landmark a drive"
    )
    text = (
        "and over all drives as many far landmarks lie within their ellipses as of a Gaussian "
        "(share)"
    )
    yield at_least(text, np.mean(np.concatenate(inside)), SHARE_WITHIN_3_SIGMA, why=why)


def _claims_2_10(found: Drives[LoopDrive]) -> Claims:
    drives = found.each
    inside = np.concatenate([np.abs(d.poses.error) <= 3.0 * d.poses.sigma for d in drives])
    for name, share in zip(("east", "north", "heading"), inside.mean(axis=0), strict=True):
        text = f"the error in {name} stays within 3 sigma (share of all scans of all drives)"
        yield at_least(text, share, 0.99, why=_TOO_SURE, own=True)
    squared = np.array(
        [d.poses.pose.squared[np.searchsorted(d.poses.time_s, d.before.time_s)] for d in drives]
    )
    growth = max(float(np.max(d.first_landmark_m[1:] / d.first_landmark_m[:-1])) for d in drives)
    text = (
        "before the loop closes the pose's error is as large as stated (mean NEES over drives; "
        "limits: its 95 % band)"
    )
    yield within(text, squared.mean(), mean_band(len(drives), 3), why=_TOO_SURE)
    text = "a landmark's uncertainty never grows (largest ratio from scan to scan)"
    yield at_most(text, growth, 1.0 + 1e-9)


def _claims_2_11(found: Drives[LoopDrive]) -> Claims:
    before, after, end = (
        np.array([getattr(d, name).mean_correlation for d in found.each])
        for name in (*_SIDES, "end")
    )
    quarter = [len(d.quarter.landmark) / len(d.before.landmark) for d in found.each]
    text = "after a quarter of the loop not all landmarks are in (share)"
    yield at_most(text, max(quarter), 0.99, own=True)
    text = "closing the loop makes the map more correlated (mean coefficient, least ratio)"
    yield at_least(text, np.min(after / before), 1.0)
    text = "further loops make it more correlated still (mean coefficient, least ratio)"
    yield at_least(text, np.min(end / after), 1.0)


def _claims_2_12(found: Fixed) -> Claims:
    text = (
        f"{len(found.fix_s)} positions reduce the map's correlation rapidly (mean coefficient, "
        "after over before)"
    )
    yield at_most(text, found.after.mean_correlation / found.before.mean_correlation, 0.5, own=True)


def _claims_3_4(found: Drives[LoopDrive]) -> Claims:
    near_rho, far_rho, near_sigma, far_sigma, near_move, moved = [], [], [], [], [], []
    for d in found.each:
        m = d.before
        first, second = np.triu_indices(len(m.landmark), 1)
        apart = np.linalg.norm(m.landmark[first] - m.landmark[second], axis=1)
        rho = m.coefficients[3:, 3:]
        both = 0.5 * (rho[::2, ::2] + rho[1::2, 1::2])[first, second]
        unlike = np.abs(np.log(m.sigma_m[first] / m.sigma_m[second]))
        move = d.after.landmark[: len(m.landmark)] - m.landmark
        differing = np.linalg.norm(move[first] - move[second], axis=1)
        near, far = apart <= NEAR_M, apart >= FAR_M
        near_rho.append(both[near])
        far_rho.append(both[far])
        near_sigma.append(unlike[near])
        far_sigma.append(unlike[far])
        near_move.append(differing[near])
        moved.append(np.linalg.norm(move, axis=1))
    why = elsewhere("those around the start are known too well to share an error")
    text = f"landmarks within {NEAR_M:.0f} m of each other are highly correlated (mean)"
    yield at_least(text, np.mean(np.concatenate(near_rho)), 0.9, why=why, own=True)
    text = f"those more than {FAR_M:.0f} m apart are less so (mean over the near ones')"
    yield at_most(text, np.mean(np.concatenate(far_rho)) / np.mean(np.concatenate(near_rho)), 1.0)
    text = "close landmarks are about equally uncertain (log ratio of sigmas, near over far)"
    yield at_most(text, rms(*near_sigma) / rms(*far_sigma), 0.5, own=True)
    text = "the closing moves close landmarks alike (difference over motion, RMS)"
    yield at_most(text, rms(*near_move) / rms(*moved), 0.5, own=True)


_LONGER = 10.0


def _moment(
    axis: Axes, d: LoopDrive, m: Moment, title: str, *, legend: Place | None = None
) -> None:
    until = d.poses.time_s <= m.time_s
    draw_slam(axis, d.true_path[until], d.pose[until, :2], m.true, m.landmark, m.blocks)
    plan(axis, title, legend=legend)


def _draw_2_8(canvas: Canvas, found: Drives[LoopDrive]) -> None:
    d, axes = found.each[0], canvas.subplots(1, 2, sharex=True, sharey=True)
    title = f"before the loop closes, {d.before.time_s:.1f} s"
    _moment(axes[0], d, d.before, title, legend="center")
    _moment(axes[1], d, d.after, f"after, {d.after.time_s:.1f} s")


def _draw_2_9(canvas: Canvas, found: Drives[LoopDrive]) -> None:
    _draw_2_8(canvas, found)
    d = found.each[0]
    canvas.axes[0].legend(fontsize=8, loc="lower right")
    west, north = d.true_path[:, 0].min(), d.true_path[:, 1].max()
    for axis in canvas.axes:
        axis.set(xlim=(west - 10.0, west + 35.0), ylim=(north - 35.0, north + 10.0))


def _draw_2_10(canvas: Canvas, found: Drives[LoopDrive]) -> None:
    d = found.each[0]
    axes = canvas.subplots(2, 2).ravel()
    names = (("east", "m", 1.0), ("north", "m", 1.0), ("heading", "deg", 180.0 / np.pi))
    for i, (name, unit, scale) in enumerate(names):
        error, sigma = scale * d.poses.error[:, i], scale * d.poses.sigma[:, i]
        draw_error(axes[i], d.poses.time_s, error, sigma)
        chart(axes[i], f"error in {name}", "time [s]", f"[{unit}]")
    for column, style, name in ((0, "-", "east"), (1, "--", "north")):
        axes[3].plot(
            d.poses.time_s, d.first_landmark_m[:, column], style, color=SMOOTHER_COLOUR, label=name
        )
    chart(axes[3], "deviation of the first landmark", "time [s]", "sigma [m]")


def _draw_2_11(canvas: Canvas, found: Drives[LoopDrive]) -> None:
    d = found.each[0]
    titles = ("a quarter of the loop", "before the closing", "after it", "after three loops")
    moments = (d.quarter, d.before, d.after, d.end)
    for axis, m, title in zip(canvas.subplots(2, 2).ravel(), moments, titles, strict=True):
        draw_correlation(axis, m.coefficients)
        axis.set_title(f"{title}: mean {m.mean_correlation:.2f}", fontsize=10)


def _draw_2_12(canvas: Canvas, found: Fixed) -> None:
    axes = canvas.subplots(1, 3)
    for axis, m, title in zip(axes, (found.before, found.after), ("before", "after"), strict=False):
        draw_correlation(axis, m.coefficients)
        axis.set_title(f"{title} {len(found.fix_s)} positions", fontsize=10)
    axes[2].plot(found.time_s, found.mean_correlation, color=SMOOTHER_COLOUR)
    for time in found.fix_s.tolist():
        mark(axes[2], time, "")
    chart(axes[2], "positions (dotted)", "time [s]", "mean coefficient", legend=None)


def _draw_3_4(canvas: Canvas, found: Drives[LoopDrive]) -> None:
    d, axes = found.each[0], canvas.subplots(1, 2, sharex=True, sharey=True)
    _moment(axes[0], d, d.before, "neighbours are alike in their uncertainty", legend="center")
    _moment(axes[1], d, d.after, f"and in how the closing moves them ({_LONGER:g} times)")
    for start, end in zip(d.before.landmark, d.after.landmark, strict=False):
        shown = start + _LONGER * (end - start)
        axes[1].plot(*np.stack((start, shown)).T, "-", color=SMOOTHER_COLOUR, linewidth=1.2)


FIGURES = (
    Figure(
        name="N2.8", title="Feature SLAM before and after a loop closes",
        says="On a loop of 255 m the estimate drifts, most at the far side, and closing the loop "
        "corrects the map.",
        experiment=LOOP_EXPERIMENT, draw=_draw_2_8, claims=_claims_2_8, size=(11.0, 5.0),
    ),
    Figure(
        name="N2.9", title="The far corner of the same map",
        says="The landmarks' errors lie within their 3-sigma ellipses, and errors and ellipses "
        "shrink when the loop closes.",
        experiment=LOOP_EXPERIMENT, draw=_draw_2_9, claims=_claims_2_9, size=(11.0, 5.0),
    ),
    Figure(
        name="N2.10", title="Errors and stated deviations along the drive",
        says="The filter's stated deviations fit its actual errors, and a landmark's uncertainty "
        "falls with every observation of the map.",
        experiment=LOOP_EXPERIMENT, draw=_draw_2_10, claims=_claims_2_10, size=(11.0, 7.0),
    ),
    Figure(
        name="N2.11", title="Correlation of the map as it is explored and closed",
        says="The map becomes more correlated when the loop closes, and more still on further "
        "loops.",
        experiment=LOOP_EXPERIMENT, draw=_draw_2_11, claims=_claims_2_11, size=(8.0, 8.0),
    ),
    Figure(
        name="N2.12", title="Correlation after a few absolute observations",
        says="A few absolute observations of the vehicle take the correlation out of the map "
        "rapidly.",
        experiment=FIXED_EXPERIMENT, draw=_draw_2_12, claims=_claims_2_12, size=(12.0, 4.2),
    ),
    Figure(
        name="N3.4", title="Close landmarks have close errors",
        says="Landmarks that are close to each other are highly correlated, about equally "
        "uncertain, and moved alike when the loop closes.",
        experiment=LOOP_EXPERIMENT, draw=_draw_3_4, claims=_claims_3_4, size=(11.0, 5.0),
    ),
)  # fmt: skip
