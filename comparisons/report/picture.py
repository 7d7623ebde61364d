"""A figure to draw on, panels drawn on it, and its way to a file."""

from __future__ import annotations

import io
from collections.abc import Collection
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from comparisons.report.marks import TRUTH_COLOUR, Panel

_SOFT = "#63686f"
_MARKERS = ("o-", "o--", "s-", "s--", "^-", "v-")


def blank(width: float, height: float, *, fitted: bool = True) -> Figure:
    """An empty figure, in inches. fitted: margins follow what is drawn."""
    figure = Figure(figsize=(width, height), layout="constrained" if fitted else None)
    FigureCanvasAgg(figure)
    return figure


FORMATS = ("png", "pdf")
_PNG: dict[str, Any] = {
    "dpi": 130,
    "metadata": {"Software": None},
    "pil_kwargs": {"compress_level": 3},
}
"""Compressed less than usual: half the time, and curves and maps hardly grow."""


def save(figure: Figure, path: Path, formats: Collection[str] = ()) -> None:
    """Write a PNG and, where formats hold `pdf`, a PDF beside it that a paper can take.

    The PDF keeps text as text, in TrueType, which publishers ask for, and no date: the same run
    gives the same file.
    """
    figure.savefig(path, **_PNG)
    if "pdf" in formats:
        path.with_suffix(".pdf").write_bytes(_pdf(figure))


def encoded(figure: Figure) -> tuple[bytes, bytes]:
    """A PNG and a PDF, as `save` writes them."""
    png = io.BytesIO()
    figure.savefig(png, format="png", **_PNG)
    return png.getvalue(), _pdf(figure)


def _pdf(figure: Figure) -> bytes:
    drawn = io.BytesIO()
    with matplotlib.rc_context({"pdf.fonttype": 42}):
        figure.savefig(drawn, format="pdf", dpi=300, metadata={"CreationDate": None})
    return drawn.getvalue()


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
    for moment in panel.moments:
        axis.axvline(moment.x, color=moment.colour, linewidth=0.9, linestyle=":", label=moment.name)
    if panel.logarithmic:
        axis.set_yscale("log")
        axis.yaxis.set_major_formatter("{x:g}")  # powers of ten set as formulas take far longer
        axis.minorticks_off()
    axis.set_ylabel(panel.title)
    if panel.lacking:
        place: dict[str, Any] = {
            "transform": axis.transAxes,
            "fontsize": 6,
            "color": _SOFT,
            "parse_math": False,
        }
        axis.text(0.01, 0.02, "\n".join(panel.lacking), va="bottom", **place)
