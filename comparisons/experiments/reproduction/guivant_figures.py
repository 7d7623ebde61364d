"""Guivant, Masson and Nebot 2002, Figs. 7 to 9: what they claim, and how they look."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure as Canvas

from comparisons.experiments.reproduction.drawing import TRUE_PATH_COLOUR, chart, mark, plan
from comparisons.experiments.reproduction.guivant import AIDED, COVERED, NEAR_M, Aided, Covered
from comparisons.experiments.reproduction.interface import (
    AnyFigure,
    Claim,
    Figure,
    at_least,
    at_most,
)
from comparisons.experiments.reproduction.update_split import SPLIT, claims, draw
from comparisons.report.figures.style import draw_reference, draw_trajectory
from comparisons.report.marks import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR
from ekf_reference.models.position import PositionFixes

_EARLY_S = 20.0
_COLOURS = (SMOOTHER_COLOUR, SCANS_COLOUR, TRUTH_COLOUR)
_LAST = 5


def claims_7(found: Covered) -> list[Claim]:
    """GPS fails where trees stand."""
    return [
        at_least(
            f"GPS is missing where trees are dense (mean number within {NEAR_M:.0f} m where it is "
            "missing, over where it is not)",
            float(found.around[~found.heard].mean() / found.around[found.heard].mean()),
            1.0,
        ),
        at_least(
            "it is missing on a good part of the way (share of the epochs)",
            float(np.mean(~found.heard)),
            0.1,
        ),
    ]


def claims_8(found: Aided) -> list[Claim]:
    """Deviations grow while exploring, and fall on revisiting and by GPS."""
    first, sigma, alone = found.first, found.sigma_m, found.alone_sigma_m
    passed_s = found.time_s[-1] - found.time_s[first]
    early = int(np.searchsorted(found.time_s, found.time_s[0] + _EARLY_S))
    peak = int(np.argmax(alone))
    landmarks = np.square(found.landmark_sigma_m[-1] / found.landmark_sigma_m[first - 1])
    return [
        at_least(
            f"the vehicle's deviation grows while exploring (median before GPS over that after "
            f"{_EARLY_S:.0f} s)",
            float(np.median(sigma[early:first]) / sigma[early]),
            1.0,
        ),
        at_most(
            "it falls on revisiting a known place (without GPS: least after its peak over the "
            "peak)",
            float(alone[peak:].min() / alone[peak]),
            0.9,
        ),
        at_most(
            "GPS reduces the vehicle's covariance significantly (variance after the first position "
            "over that before)",
            float(np.square(sigma[first] / sigma[first - 1])),
            0.5,
            why="one position of this GPS weighs little against what SLAM knows of itself",
        ),
        at_most(
            f"and the landmarks' within {passed_s:.0f} s (median of those shown, variance "
            "after over before)",
            float(np.median(landmarks)),
            0.5,
        ),
    ]


def claims_9(found: Aided) -> list[Claim]:
    """GPS comes as a surprise and is taken in step by step."""
    moves = np.linalg.norm(np.diff(found.parts, axis=0), axis=1)
    off = found.off_fix_m()
    claims = [
        at_least(
            "when GPS arrives it differs significantly from SLAM (first difference over GPS sigma)",
            found.surprise_m / found.sigma_fix_m,
            3.0,
            why=f"SLAM is {found.surprise_m:.2f} m off then, and a position has a sigma of "
            f"{found.sigma_fix_m:.1f} m",
        ),
        at_most(
            "it is taken in by updates small enough for their Jacobians (largest move by one)",
            float(moves.max()),
            PositionFixes().splitter.largest_move_m,
            "m",
        ),
        at_most(
            f"the sequence of updates brings both together (median distance of the last {_LAST} "
            "positions over the first difference)",
            float(np.median(off[-_LAST:])) / found.surprise_m,
            0.5,
        ),
    ]
    if found.true is not None:
        error = np.linalg.norm(found.pose[:, :2] - found.true, axis=1)
        claims.append(
            at_most(
                "and the vehicle to where it truly is (error at the end over that before GPS)",
                float(error[-1] / error[found.first - 1]),
                0.5,
            )
        )
    return claims


def draw_7(canvas: Canvas, found: Covered) -> None:
    """The path, thick where GPS reports, among trees."""
    axis = canvas.add_subplot()
    draw_trajectory(axis, found.path, SMOOTHER_COLOUR, "estimated path")
    heard = np.where(found.heard[:, None], found.path, np.nan)
    axis.plot(*heard.T, color=EKF_COLOUR, linewidth=3.0, alpha=0.6, label="GPS reports")
    draw_reference(axis, found.trees, "*", "trees")
    plan(axis, "GPS and trees")
    axis.legend(fontsize=8)


def draw_8(canvas: Canvas, found: Aided) -> None:
    """Deviations of the vehicle and of some landmarks."""
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


def draw_9(canvas: Canvas, found: Aided) -> None:
    """The way around the first position."""
    left, right = canvas.subplots(1, 2)
    near = slice(max(found.first - 60, 0), None)
    for axis, rows in ((left, slice(None)), (right, near)):
        if found.true is not None:
            draw_trajectory(axis, found.true[rows], TRUE_PATH_COLOUR, "true path")
        draw_trajectory(axis, found.pose[rows], EKF_COLOUR, "estimated path")
        axis.plot(*found.fix_m.T, ".", color=SMOOTHER_COLOUR, markersize=4, label="GPS")
    right.plot(*found.parts.T, "o-", color=SCANS_COLOUR, markersize=4, label="first position")
    plan(left, f"{found.time_s[found.first] - found.time_s[0]:.0f} s of SLAM alone, then GPS")
    plan(right, "where GPS begins")
    right.legend(fontsize=8)


FIGURES: tuple[AnyFigure, ...] = (
    Figure(
        name="G7",
        title="The path, the trees, and where GPS reports",
        source="Guivant et al. 2002, Fig. 7",
        says="GPS is unavailable where trees are dense and reliable in the open; dense trees are "
        "where "
        "SLAM has its landmarks.",
        experiment=COVERED,
        draw=draw_7,
        claims=claims_7,
        size=(8.0, 6.5),
    ),
    Figure(
        name="G8",
        title="Deviations of vehicle and landmarks",
        source="Guivant et al. 2002, Fig. 8",
        says="The vehicle's deviation grows while it explores, falls when it revisits a known "
        "place, "
        "and falls significantly, as do the landmarks', when GPS is incorporated.",
        experiment=AIDED,
        draw=draw_8,
        claims=claims_8,
        size=(11.0, 4.4),
    ),
    Figure(
        name="G9",
        title="GPS arrives after 200 s of SLAM alone",
        source="Guivant et al. 2002, Fig. 9",
        says="After 200 s of pure SLAM the first GPS positions differ significantly from the "
        "estimate; "
        "they are incorporated as a sequence of updates, and the filter stays sound.",
        experiment=AIDED,
        draw=draw_9,
        claims=claims_9,
        size=(11.0, 4.8),
    ),
    Figure(
        name="G4.2",
        title="Updates made in parts",
        source="Guivant et al. 2002, section 4.2",
        says="A sequence of weaker updates, each linearised anew, works better than one large "
        "update, as in closing a loop.",
        experiment=SPLIT,
        draw=draw,
        claims=claims,
        size=(11.0, 4.8),
    ),
)
