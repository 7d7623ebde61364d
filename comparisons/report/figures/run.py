"""Pictures of a result: its map, and the correlations."""

from __future__ import annotations

from matplotlib.figure import Figure

from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.run import Comparison
from comparisons.pipeline.solve import Solution
from comparisons.report.figures.plots import plot_map
from comparisons.report.figures.style import draw_correlation, plan
from comparisons.report.panels import ConsistencyPanels
from comparisons.report.picture import blank, draw_panel
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


_MARGINS = {
    "left": 0.07,
    "right": 0.99,
    "bottom": 0.07,
    "top": 0.94,
    "hspace": 0.28,
    "wspace": 0.18,
}
"""Fixed, for finding them takes longer than drawing."""
_LEAST_DRAWN = 1e-2
"""The lower end of squares, whose first ones rounding makes."""


def consistency_figure(comparison: Comparison, panels: ConsistencyPanels) -> Figure:
    """Left: the pose's error by truth, or by the smoother; right: NEES, NIS, whiteness."""
    figure = blank(10.0, 6.5, fitted=False)
    axes = figure.subplots(3, 2, gridspec_kw=_MARGINS)
    for axis, panel in zip(axes[:, 0], panels.errors, strict=False):
        draw_panel(axis, panel)
    if panels.squared is not None:
        draw_panel(axes[0, 1], panels.squared)
    for panel in panels.nis:
        draw_panel(axes[1, 1], panel)
    axes[1, 1].set_ylabel("NIS (2 dof)")
    if panels.whiteness is not None:
        draw_panel(axes[2, 1], panels.whiteness, marked=True)
        axes[2, 1].set_xlabel(panels.whiteness.x_label)
        axes[2, 1].set_ylabel("autocorrelation")
    for axis in axes[:2, 1]:
        if axis.has_data():
            axis.set_ylim(bottom=max(axis.get_ylim()[0], _LEAST_DRAWN))
    for axis in (*axes[:, 0], *axes[:2, 1]):
        axis.set_xlim(comparison.ekf.estimate.time_s[[0, -1]])
    for axis in axes.flat:
        if axis.has_data():
            axis.legend(fontsize=7, loc="upper right")
    for axis in (axes[0, 0], axes[1, 0], axes[0, 1]):
        axis.tick_params(labelbottom=False)
    axes[2, 0].set_xlabel("time [s]")
    axes[1, 1].set_xlabel("time [s]")
    title = f"{comparison.log.name}: {panels.reported}"
    figure.suptitle(title, fontsize=10, parse_math=False)
    return figure
