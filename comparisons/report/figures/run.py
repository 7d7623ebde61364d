"""Pictures of a run: its map, and the correlations."""

from __future__ import annotations

from matplotlib.figure import Figure

from comparisons.pipeline.compare import Comparison
from comparisons.report.figures.style import draw_correlation, estimates_figure
from comparisons.report.picture import blank
from ekf_reference.core.state import correlation_coefficients


def map_figure(comparison: Comparison) -> Figure:
    """The map: both trajectories, landmarks and 3-sigma ellipses of both, truth where known."""
    a = comparison.agreement
    title = (
        f"{comparison.log.name}: EKF and smoother {comparison.verdict.headline}\n"
        f"gaps: algebra {a.algebra.sigma:.1e}, model {a.model.sigma:.1e}, "
        f"linearisation {a.linearisation.sigma:.2g} sigma; optimism {a.optimism:.3g}"
    )
    estimates = {"smoother": comparison.smoothed, "EKF": comparison.ekf.estimate}
    figure = estimates_figure(comparison.log, comparison.dead_reckoned, estimates, title)
    axis = figure.axes[0]
    for found in comparison.findings.values():
        found.draw(axis)
    if comparison.findings:
        axis.legend(loc="best", fontsize=8)
    return figure


def correlation_figure(comparison: Comparison) -> Figure:
    """Correlation coefficients of the last pose and all landmarks, EKF beside smoother."""
    figure = blank(9.0, 4.8, fitted=False)
    axes = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.05, right=0.92, bottom=0.08, top=0.95, wspace=0.12)
    for axis, estimate, name in (
        (axes[0], comparison.ekf.estimate, "EKF"),
        (axes[1], comparison.smoothed, "smoother"),
    ):
        draw_correlation(axis, correlation_coefficients(estimate.joint_covariance))
        axis.set_title(f"{name}: absolute correlation coefficients", fontsize=10)
    scale = figure.add_axes((0.935, 0.14, 0.012, 0.75))
    figure.colorbar(axes[1].images[0], cax=scale)
    return figure
