"""Pictures of a result: its map, and the correlations."""

from __future__ import annotations

from matplotlib.figure import Figure

from comparisons.pipeline.check import ExternalCheck
from comparisons.pipeline.compare import Comparison
from comparisons.pipeline.solve import Solution
from comparisons.report.figures.plots import plot_map
from comparisons.report.figures.style import draw_correlation, plan
from comparisons.report.picture import blank
from ekf_reference.core.state import correlation_coefficients


def map_figure(result: Comparison | ExternalCheck | Solution) -> Figure:
    """The map of a run, of a check or of the smoother alone."""
    figure, axis = plan()
    plot_map(result, axis)
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
