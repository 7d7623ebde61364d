"""Pictures of Monte Carlo studies. They draw on a given axis and compute nothing."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from comparisons.arrays import Array
from comparisons.experiments.montecarlo.statistics import DOF, ERRORS
from comparisons.report.picture import blank

if TYPE_CHECKING:
    from comparisons.experiments.montecarlo.study import StudyOutcome

COLOURS = {
    "ekf": "#d1495b",
    "fej": "#edae49",
    "oc": "#00798c",
    "riekf": "#6a4c93",
    "ideal": "#444444",
}
_OTHERS = ("#3a6ea5", "#8f5d2b", "#2a7d4f", "#b05f9e")


def colour_of(name: str, names: Iterable[str]) -> str:
    """A filter's colour; those of external ones in the order of the names."""
    others = [one for one in names if one not in COLOURS]
    return COLOURS.get(name) or _OTHERS[others.index(name) % len(_OTHERS)]


def draw_curves(axis: Axes, time_s: Array, curves: dict[str, Array]) -> None:
    """One line per filter; the ideal one dashed, since it needs the truth."""
    for name, curve in curves.items():
        style = "--" if name == "ideal" else "-"
        axis.plot(time_s, curve, style, color=colour_of(name, curves), linewidth=0.9, label=name)
    axis.set_ylim(bottom=0.0)


def curves_figure(outcome: StudyOutcome) -> Figure:
    """ANEES above, RMSE below."""
    figure = blank(15.0, 6.8)
    above, below = figure.subplots(2, 4, sharex=True)
    time, by_filter = outcome.time_s, outcome.filters
    for axis, block in zip(above, DOF, strict=True):
        band = next(iter(by_filter.values())).consistency[block].band
        curves = {name: f.nees_curve[block] for name, f in by_filter.items()}
        axis.axhspan(*band, color="#8fb996", alpha=0.35, linewidth=0)
        draw_curves(axis, time, curves)
        axis.set_title(f"ANEES of {block}, 95 % band", fontsize=10)
    for axis, (what, unit) in zip(below[1:], ERRORS.items(), strict=True):
        draw_curves(axis, time, {name: f.rmse_curve[what] for name, f in by_filter.items()})
        axis.set_title(f"RMSE of {what} [{unit}]", fontsize=10)
        axis.set_xlabel("time [s]")
    below[0].axis("off")
    below[0].legend(*above[0].get_legend_handles_labels(), loc="center", frameon=False)
    for axis in above:
        axis.tick_params(labelbottom=True)
    figure.suptitle(f"{outcome.scenario}: {outcome.runs} runs", fontsize=11)
    return figure
