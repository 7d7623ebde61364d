"""The map of a run: both estimates, what is known of the truth, associations, variance ratios."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.estimates.estimate import Estimate
from comparisons.extensions.scan_landmarks.result import axes_of, place_covariances, template_points
from comparisons.pipeline.compare import Comparison
from comparisons.report.html.drawing import Drawing, kept
from comparisons.report.plots import EKF_COLOUR, HIGH_LEVEL_COLOUR, SMOOTHER_COLOUR, ellipses

Array = NDArray[np.float64]
Index = NDArray[np.intp]

RATIO_LAYER = "variance ratio, least"
_SIGMAS = 3.0
_SEEN = {True: "seen again", False: "never seen again"}
_MOST_LINES = 3000
_NO_RATIO = "#888888"
_OWN_MATCHER_COLOUR = "#6a3d9a"
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
    if c.dense_check is not None:
        for name, layer in c.dense_check.layers.items():
            drawing.dots(f"dense {name}", "#5b7c8d", layer.point)
    if c.high_level is not None:
        made, colour = c.high_level, HIGH_LEVEL_COLOUR
        told = [f"high level landmark, {_SEEN[s >= 0]}" for s in made.slot.tolist()]
        drawing.outlines("high level landmarks", colour, made.rectangle, told)
        drawing.links("their axes", colour, *made.axes)
    if c.own_matching is not None:
        path = c.own_matching.estimate.pose[:, :2]
        drawing.path("smoother trajectory, own matcher", _OWN_MATCHER_COLOUR, path, "2 2")
    _associations(drawing, c)
    finite = np.isfinite(ekf.pose).all(axis=1) & np.isfinite(smoothed.pose).all(axis=1)
    row = np.flatnonzero(finite)
    row = row[kept(len(row))]
    labels = [
        f"landmark {i}: {b.difference_m:.3f} m apart, {b.distance:.2g} sigma"
        for i, b in zip(ekf.landmark_id.tolist(), c.agreement.landmarks, strict=True)
    ]
    for name, colour, estimate, dashes in (
        ("smoother", SMOOTHER_COLOUR, smoothed, ""),
        ("EKF", EKF_COLOUR, ekf, "5 3"),
    ):
        drawing.path(f"{name} trajectory", colour, estimate.pose[row, :2], dashes, name)
        told = [f"{name}, {label}" for label in labels]
        outline = ellipses(estimate.landmark, estimate.landmark_covariances(), _SIGMAS, 32)
        drawing.outlines(f"{name} landmarks, 3 sigma", colour, outline, told)
        drawing.marks(f"{name} landmarks", colour, estimate.landmark, told, _keys(estimate))
    _scan_landmarks(drawing, c)
    drawing.links("differences", "#7b4fa3", ekf.landmark, smoothed.landmark)
    ratio = np.array([b.least for b in c.agreement.landmarks])
    decades = _decades(ratio)
    told = [f"{a}; variance ratio {b:.3g}" for a, b in zip(labels, ratio.tolist(), strict=True)]
    colours = ratio_colours(ratio, decades)
    drawing.marks(
        RATIO_LAYER, "#666666", ekf.landmark, told, _keys(ekf), colours, shown=False
    )  # fmt: skip
    return RunMap(drawing, np.round(ekf.time_s[row], 3).tolist(), decades)


def _scan_landmarks(drawing: Drawing, c: Comparison) -> None:
    """Templates, ellipses and axes; their keys tell them from points."""
    if c.scan_slam is None:
        return
    ekf = c.ekf.estimate
    drawing.dots(
        "templates", "#333333", template_points(c.scan_slam.found, ekf.oriented_id, ekf.oriented)
    )
    keys = [f"s{i}" for i in ekf.oriented_id.tolist()]
    for name, colour, estimate in (
        ("smoother", SMOOTHER_COLOUR, c.smoothed),
        ("EKF", EKF_COLOUR, ekf),
    ):
        told = [
            f"{name}, scan landmark {i}: {b.difference_m:.3f} m apart, {b.distance:.2g} sigma"
            for i, b in zip(ekf.oriented_id.tolist(), c.agreement.oriented, strict=True)
        ]
        place, ends = estimate.oriented[:, :2], axes_of(estimate)
        outline = ellipses(place, place_covariances(estimate), _SIGMAS, 32)
        drawing.outlines(f"{name} scan landmarks, 3 sigma", colour, outline, told)
        start, end = np.repeat(place, 2, axis=0), ends[:, ::2].reshape(-1, 2)
        drawing.links(f"{name} scan landmarks' axes", colour, start, end)
        drawing.marks(f"{name} scan landmarks", colour, place, told, keys)


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
    thinned = used[np.round(np.linspace(0, len(used) - 1, min(len(used), _MOST_LINES))).astype(int)]
    _lines(drawing, "associations", "#8a8a8a", c.ekf.estimate, epoch, slot, thinned)
    own = c.own_association
    if own is None:
        return
    row = own.differing[:_MOST_LINES]
    for name, colour, estimate, slots in (
        ("associations that differ: EKF", EKF_COLOUR, c.ekf.estimate, slot),
        ("associations that differ: smoother", SMOOTHER_COLOUR, own.estimate, own.slot),
    ):
        _lines(drawing, name, colour, estimate, epoch, slots, row[slots[row] >= 0])


def _lines(
    drawing: Drawing, name: str, colour: str, estimate: Estimate, epoch: Index, slot: Index,
    row: Index,
) -> None:  # fmt: skip
    start, end = estimate.pose[epoch[row], :2], estimate.landmark[slot[row]]
    drawing.links(name, colour, start, end, shown=False, faint=True)


def _keys(estimate: Estimate) -> list[int]:
    keys: list[int] = estimate.landmark_id.tolist()
    return keys
