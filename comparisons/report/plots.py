"""Pictures. Functions draw on a given axis and compute nothing; `..._figure` puts one together."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from comparisons.estimates.estimate import Estimate
from comparisons.extensions.high_level.source import HighLevelRun
from comparisons.extensions.scan_landmarks.result import axes_of, place_covariances, template_points
from comparisons.logs.log import Log
from comparisons.pipeline.check import GivenCheck
from comparisons.pipeline.compare import Comparison
from comparisons.pipeline.odometry import FrontEnd
from comparisons.pipeline.solve import Solution
from comparisons.report.picture import blank
from ekf_reference.correlation import correlation_coefficients
from ekf_reference.scan_landmarks.scan_slam import ScanLandmarks

Array = NDArray[np.float64]

EKF_COLOUR = "#d1495b"
SMOOTHER_COLOUR = "#00798c"
TRUTH_COLOUR = "#444444"
HIGH_LEVEL_COLOUR = "#2e7d32"
_MOST_DRAWN = 100_000
SCANS_COLOUR = "#edae49"
_LOOK = {
    "smoother": (SMOOTHER_COLOUR, "s", "-"),
    "EKF": (EKF_COLOUR, "o", "--"),
    "smoother on scans": (SCANS_COLOUR, "^", "-."),
}


def ellipses(centre: Array, covariance: Array, sigmas: float, points: int = 48) -> Array:
    """Outlines (L, points, 2) of the error ellipses of centres (L, 2), covariances (L, 2, 2).

    A covariance that is not finite, as a broken filter leaves it, is drawn as a point.
    """
    finite = np.isfinite(covariance).all(axis=(1, 2), keepdims=True)
    covariance = np.where(finite, covariance, 0.0)
    values, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    circle = np.column_stack((np.cos(angle), np.sin(angle)))
    scaled = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    result: Array = centre[:, None] + sigmas * circle @ scaled.transpose(0, 2, 1)
    return result


def draw_trajectory(axis: Axes, position: Array, colour: str, label: str, style: str = "-") -> None:
    """A path (K, 2)."""
    axis.plot(position[:, 0], position[:, 1], style, color=colour, linewidth=0.9, label=label)


def draw_aside(axis: Axes, position: Array, label: str) -> None:
    """A path (K, 2 or more columns) that is cut off where it leaves what else is drawn."""
    x, y = position[:, 0], position[:, 1]
    line = Line2D(x, y, color="#999999", linestyle=":", linewidth=0.9, label=label)
    axis.add_artist(line)  # unlike plot, this leaves the limits alone


def draw_landmarks(
    axis: Axes, position: Array, outline: Array, colour: str, marker: str, label: str
) -> None:
    """Landmarks (L, 2) with their ellipses' outlines (L, P, 2)."""
    axis.add_collection(LineCollection(list(outline), colors=colour, linewidths=0.7, alpha=0.8))
    axis.plot(
        position[:, 0],
        position[:, 1],
        marker,
        color=colour,
        markersize=4,
        markerfacecolor="none",
        label=label,
    )


def draw_reference(axis: Axes, position: Array, marker: str, label: str) -> None:
    """True or surveyed places (N, 2), without uncertainty."""
    axis.plot(
        position[:, 0],
        position[:, 1],
        marker,
        color=TRUTH_COLOUR,
        markersize=5 if marker == "*" else 1.5,
        linestyle="none",
        label=label,
        zorder=1,
    )


def map_figure(comparison: Comparison) -> Figure:
    """The map: both trajectories, landmarks and 3-sigma ellipses of both, truth where known."""
    a = comparison.agreement
    title = (
        f"{comparison.log.name}: EKF and smoother {comparison.verdict.outcome}\n"
        f"gaps: algebra {a.algebra.sigma:.1e}, model {a.model.sigma:.1e}, "
        f"linearisation {a.linearisation.sigma:.2g} sigma; optimism {a.whole.least:.3g}"
    )
    estimates = {"smoother": comparison.smoothed, "EKF": comparison.ekf.estimate}
    if comparison.three_way is not None:
        estimates["smoother on scans"] = comparison.three_way.estimate
    figure = _map(comparison.log, comparison.dead_reckoned, estimates, title)
    axis = figure.axes[0]
    if comparison.high_level is not None:
        draw_high_level(axis, comparison.high_level)
    if comparison.scan_slam is not None:
        _add_scan_landmarks(axis, comparison, comparison.scan_slam.found)
    if len(comparison.ekf.estimate.oriented):
        axis.legend(loc="best", fontsize=8)
    return figure


def draw_high_level(axis: Axes, made: HighLevelRun) -> None:
    """Rectangles of high level landmarks, dashed where never seen again, and their axes."""
    closed = np.concatenate((made.rectangle, made.rectangle[:, :1]), axis=1)
    for style, name, chosen in (
        ("solid", "high level landmarks", made.slot >= 0),
        ("dashed", "found, not seen again", made.slot < 0),
    ):
        lines = LineCollection(list(closed[chosen]), linestyles=style, linewidths=0.9, label=name)
        lines.set_color(HIGH_LEVEL_COLOUR)
        axis.add_collection(lines)
    both = list(np.stack(made.axes, axis=1))
    axis.add_collection(LineCollection(both, colors=HIGH_LEVEL_COLOUR, linewidths=1.6))


def _add_scan_landmarks(axis: Axes, c: Comparison, found: ScanLandmarks) -> None:
    """Templates where the filter has them, and both estimates' axes and ellipses."""
    ekf = c.ekf.estimate
    if c.log.truth.surfaces is not None:
        segment = c.log.truth.surfaces.segment.reshape(-1, 2, 2)
        axis.add_collection(LineCollection(list(segment), colors="#bbbbbb", linewidths=1.5))
    points = template_points(found, ekf.oriented_id, ekf.oriented)
    axis.plot(*points.T, ".", color="#222222", markersize=1.2, label="EKF's templates", zorder=1)
    for name, estimate in (("smoother", c.smoothed), ("EKF", ekf)):
        colour = _LOOK[name][0]
        outline = ellipses(estimate.oriented[:, :2], place_covariances(estimate), 3.0)
        axis.add_collection(LineCollection(list(outline), colors=colour, linewidths=0.7))
        label = f"{name} scan landmarks, 3 sigma"
        frames = LineCollection(list(axes_of(estimate)), colors=colour, linewidths=1.2, label=label)
        axis.add_collection(frames)


def solution_figure(solution: Solution) -> Figure:
    """The same of the smoother alone."""
    proof = solution.result.proof
    title = (
        f"{solution.log.name}: optimum {'proven' if proof.proven else 'NOT proven'}, "
        f"chi2 {proof.chi_square.chi2:.0f} for {proof.chi_square.dof} degrees of freedom"
    )
    return _map(solution.log, solution.dead_reckoned, {"smoother": solution.estimate}, title)


def check_figure(check: GivenCheck) -> Figure:
    """An estimate from elsewhere on top of the smoother's."""
    solution, given = check.solution, check.given
    title = f"{solution.log.name}: {check.outcome}"
    estimates = {"smoother": solution.estimate}
    figure = _map(solution.log, solution.dead_reckoned, estimates, title)
    axis = figure.axes[0]
    draw_trajectory(axis, given.pose[:, :2], EKF_COLOUR, "given trajectory", "--")
    if given.landmark is not None:
        spread = given.landmark_covariance
        if spread is None:
            spread = np.zeros((len(given.landmark), 2, 2))
        outline = ellipses(given.landmark, spread, 3.0)
        draw_landmarks(axis, given.landmark, outline, EKF_COLOUR, "o", "given landmarks")
    axis.legend(loc="best", fontsize=8)
    return figure


def _map(log: Log, dead_reckoned: Array, estimates: dict[str, Estimate], title: str) -> Figure:
    """Estimates by name, on top of what the log knows."""
    figure, axis = _plan()
    if log.truth.poses is not None:
        pose = log.truth.poses.pose
        axis.plot(pose[:, 0], pose[:, 1], color="#bbbbbb", linewidth=2.5, label="truth", zorder=0)
    if log.positions is not None:
        draw_reference(axis, log.positions.position_m, ".", "GPS")
    if log.truth.landmarks is not None:
        draw_reference(axis, log.truth.landmarks.position_m, "*", "true landmarks")
    for name, estimate in estimates.items():
        colour, marker, style = _LOOK[name]
        draw_trajectory(axis, estimate.pose[:, :2], colour, f"{name} trajectory", style)
        outline = ellipses(estimate.landmark, estimate.landmark_covariances(), 3.0)
        if not len(estimate.landmark) and len(estimate.oriented):
            continue
        label = f"{name} landmarks, 3 sigma"
        draw_landmarks(axis, estimate.landmark, outline, colour, marker, label)
    axis.set_aspect("equal", adjustable="datalim")
    if log.truth.poses is not None:
        draw_aside(axis, dead_reckoned, "dead reckoning")
    _entitle(axis, title)
    return figure


def _plan() -> tuple[Figure, Axes]:
    """An empty map."""
    figure = blank(9.0, 7.5)
    axis = figure.add_subplot()
    axis.set_xlabel("east [m]")
    axis.set_ylabel("north [m]")
    axis.grid(visible=True, color="#eeeeee")
    return figure, axis


def _entitle(axis: Axes, title: str) -> None:
    """A map's title, and its legend, once everything is drawn."""
    axis.set_title(title, fontsize=10, parse_math=False)
    axis.legend(fontsize=8, loc="best")


def draw_cloud(axis: Axes, points: Array) -> None:
    """What scans saw, (P, 2 or more) from above, at most so many points that a picture shows."""
    shown = points[:: max(1, len(points) // _MOST_DRAWN)]
    axis.plot(
        shown[:, 0], shown[:, 1], ".", color="#999999", markersize=0.6, label="scans", zorder=0
    )


def front_end_figure(front_end: FrontEnd, points: Array) -> Figure:
    """The map that the scans make, with the trajectories of wheels, scan odometry and graph."""
    f = front_end
    figure, axis = _plan()
    draw_cloud(axis, points)
    if f.log.truth.poses is not None:
        draw_reference(axis, f.log.truth.poses.pose, ".", "truth")
    elif f.log.positions is not None:
        draw_reference(axis, f.log.positions.position_m, ".", "GPS")
    draw_trajectory(axis, f.odometry, EKF_COLOUR, "scan odometry", "--")
    draw_trajectory(axis, f.estimate.pose, SMOOTHER_COLOUR, "scan graph")
    for first, second in zip(f.graph.problem.closures.first, f.graph.problem.closures.second,
                             strict=True):  # fmt: skip
        ends = f.estimate.pose[[first, second]]
        axis.plot(ends[:, 0], ends[:, 1], color=SCANS_COLOUR, linewidth=0.7, zorder=3)
    axis.set_aspect("equal", adjustable="datalim")
    if f.wheels is not None:
        draw_aside(axis, f.wheels, "wheels")
    title = (
        f"{f.log.name}: {len(f.motion.row)} scans, {len(f.graph.problem.closures.first)} loops "
        "closed (yellow)"
    )
    _entitle(axis, title)
    return figure


def draw_correlation(axis: Axes, coefficients: Array) -> None:
    """Correlation coefficients (n, n) as grey levels, black for 1 (Nieto 2005, Fig. 2.11)."""
    axis.imshow(coefficients, cmap="Greys", vmin=0.0, vmax=1.0, interpolation="nearest")
    axis.set_xlabel("state entry: pose, then landmarks in order of arrival")


def correlation_figure(comparison: Comparison) -> Figure:
    """Correlation coefficients of the last pose and all landmarks, EKF beside smoother."""
    figure = blank(9.0, 4.8, fitted=False)
    axes = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.05, right=0.99, bottom=0.08, top=0.95, wspace=0.12)
    for axis, estimate, name in (
        (axes[0], comparison.ekf.estimate, "EKF"),
        (axes[1], comparison.smoothed, "smoother"),
    ):
        draw_correlation(axis, correlation_coefficients(estimate.joint_covariance))
        axis.set_title(f"{name}: correlation coefficients", fontsize=10)
    return figure
