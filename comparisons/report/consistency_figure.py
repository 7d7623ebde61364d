"""The picture of consistency: errors with their bands, NEES and NIS over time."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from comparisons.pipeline.compare import Comparison
from comparisons.report.marks import TRUTH_COLOUR
from comparisons.report.panels import ConsistencyPanels, Panel
from comparisons.report.picture import blank

_MARKERS = ("o-", "o--", "s-", "s--", "^-", "v-")
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


def draw_panel(axis: Axes, panel: Panel, *, marked: bool = False) -> None:
    """Bands and curves of a panel; several may share an axis. marked: the points, too."""
    for band in panel.bands:
        known = band.name in axis.get_legend_handles_labels()[1]
        axis.fill_between(
            band.x, band.low, band.high, color=band.colour, alpha=0.22, linewidth=0.0,
            label="" if known else band.name,
        )  # fmt: skip
    for i, curve in enumerate(panel.curves):
        style = _MARKERS[i % len(_MARKERS)] if marked else "-"
        axis.plot(
            curve.x, curve.y, style, color=curve.colour, linewidth=0.8, markersize=3,
            label=curve.name,
        )  # fmt: skip
    if panel.level is not None:
        axis.axhline(panel.level, color=TRUTH_COLOUR, linewidth=0.5)
    if panel.logarithmic:
        axis.set_yscale("log")
        axis.yaxis.set_major_formatter("{x:g}")  # powers of ten set as formulas take far longer
        axis.minorticks_off()
    axis.set_ylabel(panel.title)


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
    axes[0, 1].set_ylabel("NEES" if comparison.consistency.ekf is not None else "squared")
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
    for axis in (axes[0, 0], *axes[:, 1]):
        if axis.has_data():
            axis.legend(fontsize=7, loc="upper right")
    for axis in (axes[0, 0], axes[1, 0], axes[0, 1]):
        axis.tick_params(labelbottom=False)
    axes[2, 0].set_xlabel("time [s]")
    axes[1, 1].set_xlabel("time [s]")
    title = f"{comparison.log.name}: {panels.reported}"
    figure.suptitle(title, fontsize=10, parse_math=False)
    return figure
