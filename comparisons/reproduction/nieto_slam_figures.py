"""Nieto 2005, Figs. 2.8 to 2.12 and 3.4: what they claim, and how they look."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from comparisons.checks.normalised import mean_band
from comparisons.report.plots import SMOOTHER_COLOUR, draw_correlation
from comparisons.reproduction.contract import AnyFigure, Claim, Figure, at_least, at_most
from comparisons.reproduction.drawing import chart, draw_error, draw_slam, mark, plan
from comparisons.reproduction.nieto_slam import (
    FIXED_EXPERIMENT,
    LOOP_EXPERIMENT,
    Fixed,
    LoopDrive,
    Loops,
    Moment,
)
from comparisons.runs.estimate import Array

NEAR_M, FAR_M = 12.0, 50.0
"""Landmarks nearer than that are close to each other; farther ones are not."""
_ELLIPSE = 9.0
"""Three sigmas, squared."""
_TOO_SURE = "EKF-SLAM grows too sure as its heading errs; see `slamcheck montecarlo`"


def _rms(values: Iterable[Array]) -> float:
    """Root mean square of all numbers of several arrays."""
    every = np.concatenate([np.ravel(value) for value in values])
    return float(np.sqrt(np.mean(np.square(every))))


def _far(drives: tuple[LoopDrive, ...], moment: Callable[[LoopDrive], Moment]) -> list[Array]:
    """Per drive, which landmarks of a moment are farthest from the start."""
    return [moment(d).far(d.true_path[0]) for d in drives]


def claims_2_8(loops: Loops) -> list[Claim]:
    """The largest error is at the far side; closing the loop corrects the map."""
    left, right = [], []
    for d in loops.drives:
        east = d.true_path[:, 0]
        open_ = d.poses.time_s <= d.before.time_s
        low, high = np.quantile(east, (1.0 / 3.0, 2.0 / 3.0))
        left.append(d.poses.error[open_ & (east <= low), :2])
        right.append(d.poses.error[open_ & (east >= high), :2])
    before, after = ([getattr(d, name).error_m for d in loops.drives] for name in _SIDES)
    return [
        at_least(
            "before the loop closes the path errs most on its left third (RMS over the right's)",
            _rms(left) / _rms(right),
            1.0,
            why="our loop begins at the right, where the thesis begins at the bottom",
        ),
        at_most(
            "closing the loop reduces the landmarks' error (RMS after over before)",
            _rms(after) / _rms(before),
            1.0,
        ),
    ]


_SIDES = ("before", "after")


def claims_2_9(loops: Loops) -> list[Claim]:
    """Of the far part of the map: errors lie within the ellipses, and both shrink."""
    drives = loops.drives
    far = _far(drives, lambda d: d.before)
    drawn = drives[0].before.squared[far[0]] <= _ELLIPSE
    farthest = [
        d.before.squared[np.argmax(np.linalg.norm(d.before.true - d.true_path[0], axis=1))]
        for d in drives
    ]
    error = {
        name: _rms(getattr(d, name).error_m[f] for d, f in zip(drives, far, strict=True))
        for name in _SIDES
    }
    sigma = {
        name: _rms(getattr(d, name).sigma_m[f] for d, f in zip(drives, far, strict=True))
        for name in _SIDES
    }
    return [
        at_least(
            "the far landmarks lie within their 3-sigma ellipses before the loop closes (share, of "
            "the drive drawn)",
            float(drawn.mean()),
            1.0,
        ),
        at_most(
            "over drives the farthest landmark's error is as large as stated (mean NEES; limit: "
            "upper end of its 95 % band)",
            float(np.mean(farthest)),
            mean_band(len(drives), 2).high,
            why=_TOO_SURE,
        ),
        at_most("their error falls with the closing (ratio)", error["after"] / error["before"], 1),
        at_most(
            "their uncertainty falls with the closing (ratio)",
            sigma["after"] / sigma["before"],
            1.0,
        ),
    ]


def claims_2_10(loops: Loops) -> list[Claim]:
    """Errors are as large as stated; a landmark's uncertainty only ever falls."""
    drives = loops.drives
    claims = [
        at_least(
            f"the error in {name} stays within 3 sigma (share of all scans of all drives)",
            float(np.mean(np.concatenate([_within(d, i) for d in drives]))),
            0.99,
            why=_TOO_SURE,
        )
        for i, name in enumerate(("east", "north", "heading"))
    ]
    squared = np.array(
        [d.poses.pose.squared[np.searchsorted(d.poses.time_s, d.before.time_s)] for d in drives]
    )
    highest = mean_band(len(drives), 3).high
    growth = max(float(np.max(d.first_landmark_m[1:] / d.first_landmark_m[:-1])) for d in drives)
    return [
        *claims,
        at_most(
            "before the loop closes the pose's error is as large as stated (mean NEES over drives; "
            "limit: upper end of its 95 % band)",
            float(squared.mean()),
            highest,
            why=_TOO_SURE,
        ),
        at_most(
            "a landmark's uncertainty never grows (largest ratio from scan to scan)",
            growth,
            1.0 + 1e-9,
        ),
    ]


def _within(d: LoopDrive, column: int) -> NDArray[np.bool_]:
    return np.abs(d.poses.error[:, column]) <= 3.0 * d.poses.sigma[:, column]


def claims_2_11(loops: Loops) -> list[Claim]:
    """The map grows more correlated by the closing, and by every further loop."""
    before, after, end = (
        np.array([getattr(d, name).mean_correlation for d in loops.drives])
        for name in ("before", "after", "end")
    )
    quarter = [len(d.quarter.landmark) / len(d.before.landmark) for d in loops.drives]
    return [
        at_most("after a quarter of the loop not all landmarks are in (share)", max(quarter), 0.99),
        at_least(
            "closing the loop makes the map more correlated (mean coefficient, least ratio)",
            float(np.min(after / before)),
            1.0,
        ),
        at_least(
            "further loops make it more correlated still (mean coefficient, least ratio)",
            float(np.min(end / after)),
            1.0,
        ),
    ]


def claims_2_12(found: Fixed) -> list[Claim]:
    """A few absolute observations take the correlation away."""
    return [
        at_most(
            f"{len(found.fix_s)} positions reduce the map's correlation rapidly (mean coefficient, "
            "after over before)",
            found.after.mean_correlation / found.before.mean_correlation,
            0.5,
        )
    ]


def claims_3_4(loops: Loops) -> list[Claim]:
    """What is close is correlated, equally uncertain, and corrected alike."""
    near_rho, far_rho, near_sigma, far_sigma, near_move, moved = [], [], [], [], [], []
    for d in loops.drives:
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
    return [
        at_least(
            f"landmarks within {NEAR_M:.0f} m of each other are highly correlated (mean)",
            float(np.mean(np.concatenate(near_rho))),
            0.9,
            why="those around the start are known too well to share an error",
        ),
        at_most(
            f"those more than {FAR_M:.0f} m apart are less so (mean over the near ones')",
            float(np.mean(np.concatenate(far_rho)) / np.mean(np.concatenate(near_rho))),
            1.0,
        ),
        at_most(
            "close landmarks are about equally uncertain (log ratio of sigmas, near over far)",
            _rms(near_sigma) / _rms(far_sigma),
            0.5,
        ),
        at_most(
            "the closing moves close landmarks alike (difference over motion, RMS)",
            _rms(near_move) / _rms(moved),
            0.5,
        ),
    ]


def _moment(axis: Axes, d: LoopDrive, m: Moment, title: str) -> None:
    until = d.poses.time_s <= m.time_s
    draw_slam(axis, d.true_path[until], d.pose[until, :2], m.true, m.landmark, m.blocks)
    plan(axis, title)


def draw_2_8(canvas: Canvas, loops: Loops) -> None:
    """Before and after the closing."""
    d, axes = loops.drives[0], canvas.subplots(1, 2, sharex=True, sharey=True)
    _moment(axes[0], d, d.before, f"before the loop closes, {d.before.time_s:.1f} s")
    _moment(axes[1], d, d.after, f"after, {d.after.time_s:.1f} s")
    axes[0].legend(fontsize=8, loc="center")


def draw_2_9(canvas: Canvas, loops: Loops) -> None:
    """The same, where the map is farthest from the start."""
    draw_2_8(canvas, loops)
    d = loops.drives[0]
    west, north = d.true_path[:, 0].min(), d.true_path[:, 1].max()
    for axis in canvas.axes:
        axis.set(xlim=(west - 10.0, west + 35.0), ylim=(north - 35.0, north + 10.0))


def draw_2_10(canvas: Canvas, loops: Loops) -> None:
    """Errors of the pose between their bounds, and one landmark's deviations."""
    d = loops.drives[0]
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


def draw_2_11(canvas: Canvas, loops: Loops) -> None:
    """Four normalised covariance matrices."""
    d = loops.drives[0]
    titles = ("a quarter of the loop", "before the closing", "after it", "after three loops")
    moments = (d.quarter, d.before, d.after, d.end)
    for axis, m, title in zip(canvas.subplots(2, 2).ravel(), moments, titles, strict=True):
        draw_correlation(axis, m.coefficients)
        axis.set_title(f"{title}: mean {m.mean_correlation:.2f}", fontsize=10)


def draw_2_12(canvas: Canvas, found: Fixed) -> None:
    """The matrix without and with positions, and how it went."""
    axes = canvas.subplots(1, 3)
    for axis, m, title in zip(axes, (found.before, found.after), ("before", "after"), strict=False):
        draw_correlation(axis, m.coefficients)
        axis.set_title(f"{title} {len(found.fix_s)} positions", fontsize=10)
    axes[2].plot(found.time_s, found.mean_correlation, color=SMOOTHER_COLOUR)
    for time in found.fix_s.tolist():
        mark(axes[2], time, "")
    chart(axes[2], "positions (dotted)", "time [s]", "mean coefficient", legend=False)


def draw_3_4(canvas: Canvas, loops: Loops) -> None:
    """Ellipses before the closing, and where it takes the landmarks."""
    d, axes = loops.drives[0], canvas.subplots(1, 2, sharex=True, sharey=True)
    _moment(axes[0], d, d.before, "neighbours are alike in their uncertainty")
    _moment(axes[1], d, d.after, "and in how the closing moves them")
    for start, end in zip(d.before.landmark, d.after.landmark, strict=False):
        axes[1].plot(*np.stack((start, end)).T, "-", color=SMOOTHER_COLOUR, linewidth=1.5)
    axes[0].legend(fontsize=8, loc="center")


def _row(
    number: str, title: str, says: str, draw: Callable[[Canvas, Loops], None],
    claims: Callable[[Loops], list[Claim]], size: tuple[float, float] = (11.0, 5.0),
) -> AnyFigure:  # fmt: skip
    source = f"Nieto 2005, Fig. {number}"
    return Figure(f"N{number}", title, source, says, LOOP_EXPERIMENT, draw, claims, size)


FIGURES: tuple[AnyFigure, ...] = (
    _row(
        "2.8",
        "Feature SLAM before and after a loop closes",
        "On a loop of 255 m the estimate drifts, most at the far side, and closing the loop "
        "corrects the map.",
        draw_2_8,
        claims_2_8,
    ),
    _row(
        "2.9",
        "The far corner of the same map",
        "The landmarks' errors lie within their 3-sigma ellipses, and errors and ellipses shrink "
        "when the loop closes.",
        draw_2_9,
        claims_2_9,
    ),
    _row(
        "2.10",
        "Errors and stated deviations along the drive",
        "The filter's stated deviations fit its actual errors, and a landmark's uncertainty falls "
        "with every look at the map.",
        draw_2_10,
        claims_2_10,
        (11.0, 7.0),
    ),
    _row(
        "2.11",
        "Correlation of the map as it is explored and closed",
        "The map becomes more correlated when the loop closes, and more still on further loops.",
        draw_2_11,
        claims_2_11,
        (8.0, 8.0),
    ),
    Figure(
        "N2.12",
        "Correlation after a few absolute observations",
        "Nieto 2005, Fig. 2.12",
        "A few absolute observations of the vehicle take the correlation out of the map rapidly.",
        FIXED_EXPERIMENT,
        draw_2_12,
        claims_2_12,
        (12.0, 4.2),
    ),
    _row(
        "3.4",
        "Close landmarks have close errors",
        "Landmarks that are close to each other are highly correlated, about equally uncertain, "
        "and moved alike when the loop closes.",
        draw_3_4,
        claims_3_4,
    ),
)
