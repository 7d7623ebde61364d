"""The map of a run: both estimates, what is known of the truth, associations, variance ratios."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.estimates.estimate import Estimate
from comparisons.pipeline.compare import Comparison
from comparisons.report.figures.style import EKF_COLOUR, SMOOTHER_COLOUR, ellipses
from comparisons.report.html.drawing import MOST_LINES, Drawing, association_lines, kept

MOST_LANDMARKS = 1000
"""Landmarks that the page has, each with two ellipses, three marks and a row."""
RATIO_LAYER = "variance ratio, least"
_SIGMAS = 3.0
_NO_RATIO = "#888888"
_RATIO_COLOURS = ("#7f3b08", "#e08214", "#fee0b6", "#f7f7f7", "#d8daeb", "#8073ac", "#2d004b")
"""From too sure to too careful; ColorBrewer's PuOr, which the colour-blind can read."""
_LEAST_DECADES, _MOST_DECADES = 0.5, 3.0


@dataclass(frozen=True)
class RunMap:
    """The drawing, and what the script is told besides.

    track_s: times [s] of the points of both trajectories. decades: the colours of the variance
    ratio end at 10 to the power of so much, either way.
    """

    drawing: Drawing
    track_s: list[float]
    decades: float


def run_map(c: Comparison) -> RunMap:
    """Draw it. Layers come in the order in which they lie upon each other."""
    ekf, smoothed = c.ekf.estimate, c.smoothed
    truth, positions = c.log.truth, c.log.positions
    walls = np.empty((0, 4)) if truth.surfaces is None else truth.surfaces.segment
    drawing = Drawing.of(
        ekf.pose[:, :2],
        smoothed.pose[:, :2],
        ekf.landmark,
        smoothed.landmark,
        walls[:, :2],
        walls[:, 2:],
        ekf.oriented[:, :2],
        smoothed.oriented[:, :2],
    )
    if len(walls):
        drawing.links("true surfaces", "#9a9a9a", walls[:, :2], walls[:, 2:])
    if truth.poses is not None:
        drawing.path("truth", "#9a9a9a", truth.poses.pose[:, :2])
    if positions is not None:
        drawing.dots("GPS", "#b08d57", positions.position_m)
    _associations(drawing, c)
    finite = np.isfinite(ekf.pose).all(axis=1) & np.isfinite(smoothed.pose).all(axis=1)
    row = np.flatnonzero(finite)
    row = row[kept(len(row))]
    labels = [
        f"landmark {i}: {b.difference_m:.3f} m apart, {b.distance:.2g} sigma"
        for i, b in zip(ekf.landmark_id.tolist(), c.agreement.landmarks, strict=True)
    ]
    marked = shown_landmarks(c)
    labels = [labels[i] for i in marked.tolist()]
    if len(marked) < len(ekf.landmark):
        drawing.dots("all landmarks", "#666666", ekf.landmark)
    for name, colour, estimate, dashes in (
        ("smoother", SMOOTHER_COLOUR, smoothed, ""),
        ("EKF", EKF_COLOUR, ekf, "5 3"),
    ):
        drawing.path(f"{name} trajectory", colour, estimate.pose[row, :2], dashes, name)
        told = [f"{name}, {label}" for label in labels]
        place, spread = estimate.landmark[marked], estimate.landmark_covariances()[marked]
        outline = ellipses(place, spread, _SIGMAS, 32)
        drawing.outlines(f"{name} landmarks, 3 sigma", colour, outline, told)
        drawing.marks(f"{name} landmarks", colour, place, told, _keys(estimate, marked))
    for found in c.findings.values():
        found.layers(drawing)
    drawing.links("differences", "#7b4fa3", ekf.landmark[marked], smoothed.landmark[marked])
    ratio = np.array([b.least for b in c.agreement.landmarks])[marked]
    decades = _decades(ratio)
    told = [f"{a}; variance ratio {b:.3g}" for a, b in zip(labels, ratio.tolist(), strict=True)]
    colours = ratio_colours(ratio, decades)
    drawing.marks(
        RATIO_LAYER, "#666666", ekf.landmark[marked], told, _keys(ekf, marked), colours,
        shown=False,
    )  # fmt: skip
    return RunMap(drawing, np.round(ekf.time_s[row], 3).tolist(), decades)


def ratio_colours(ratio: Array, decades: float) -> list[str]:
    """Of variance ratios (n,), on a logarithmic scale from 10^-decades to 10^decades."""
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.clip(np.log10(ratio) / decades, -1.0, 1.0)
    stops = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in _RATIO_COLOURS])
    at = np.linspace(-1.0, 1.0, len(stops))
    mixed = np.column_stack([np.interp(place, at, stops[:, i]) for i in range(3)])
    usable = np.isfinite(ratio) & (ratio > 0.0)
    return [
        "#{:02x}{:02x}{:02x}".format(*np.rint(colour).astype(int).tolist()) if good else _NO_RATIO
        for colour, good in zip(mixed, usable.tolist(), strict=True)
    ]


def ratio_legend(decades: float) -> str:
    """The colours of the variance ratio with their figures."""
    place = np.linspace(-decades, decades, 41)
    colours = ratio_colours(10.0**place, decades)
    blocks = "".join(
        f'<rect x="{4 * i + 10}" y="0" width="4.3" height="10" fill="{c}"/>'
        for i, c in enumerate(colours)
    )
    words = "".join(
        f'<text x="{10 + 82 * (1 + share):.0f}" y="22">{10.0 ** (share * decades):.2g}</text>'
        for share in (-1.0, -0.5, 0.0, 0.5, 1.0)
    )
    return (
        '<div id="ratio-legend" hidden><span>the filter is too sure</span>'
        f'<svg viewBox="0 0 184 24" role="img" aria-label="variance ratio">{blocks}{words}</svg>'
        "<span>too careful</span></div>"
    )


def _decades(ratio: Array) -> float:
    usable = ratio[np.isfinite(ratio) & (ratio > 0.0)]
    most = float(np.abs(np.log10(usable)).max(initial=0.0))
    return min(max(float(np.ceil(2.0 * most)) / 2.0, _LEAST_DECADES), _MOST_DECADES)


def _associations(drawing: Drawing, c: Comparison) -> None:
    """A line from the pose to the landmark for each sighting that is used."""
    slot, epoch = c.ekf.slot, c.ekf.timeline.sighting_epoch
    used = np.flatnonzero(slot >= 0)
    row = used[np.round(np.linspace(0, len(used) - 1, min(len(used), MOST_LINES))).astype(int)]
    look = ("associations", "#8a8a8a")
    association_lines(drawing, look, c.ekf.estimate, epoch[row], slot[row])


def shown_landmarks(c: Comparison) -> Index:
    """Return the landmarks (m,) that the page has: all, or those farthest apart in sigma."""
    distance = np.array([block.distance for block in c.agreement.landmarks])
    if len(distance) <= MOST_LANDMARKS:
        return np.arange(len(distance))
    farthest = np.argsort(-np.nan_to_num(distance, nan=np.inf), kind="stable")
    return np.sort(farthest[:MOST_LANDMARKS])


def _keys(estimate: Estimate, marked: Index) -> list[int]:
    keys: list[int] = estimate.landmark_id[marked].tolist()
    return keys
