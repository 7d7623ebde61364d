"""Panels as data for the page's script: few points, but every extreme among them."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from math import floor, isfinite, log10
from typing import Any

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.figures import json_text
from comparisons.report.html.shell import themed
from comparisons.report.marks import EVENT, TIME, Panel

MOST_POINTS = 2000
_DIGITS = 4
_LARGE = 1e9


def thinned(*values: Array, most: int = MOST_POINTS) -> Index:
    """At most `most` rows of values (n,), with the least and the largest of every stretch.

    Of several values each has its own extremes kept. What is not finite is no extreme.
    """
    count = len(values[0])
    if count <= most:
        return np.arange(count)
    stretches = max((most - 2) // (2 * len(values)), 1)
    bounds = np.linspace(0, count, stretches + 1).astype(np.intp)
    rows = [0, count - 1]
    for value in values:
        low, high = (np.where(np.isfinite(value), value, worst) for worst in (np.inf, -np.inf))
        for begin, end in pairwise(bounds.tolist()):
            rows.append(begin + int(low[begin:end].argmin()))
            rows.append(begin + int(high[begin:end].argmax()))
    return np.unique(np.array(rows, dtype=np.intp))


def panel_data(panel: Panel, start_s: float) -> dict[str, Any]:
    """For the script. Times and events count from start_s; figures are rounded to what is seen."""
    timed = panel.x_label in (TIME, EVENT)
    start = start_s if timed else 0.0
    curves, bands = [], []
    for curve in panel.curves:
        row = thinned(curve.y)
        curves.append(
            {"name": curve.name, "colour": themed(curve.colour),
             "x": rounded(curve.x[row] - start, 3), "y": short(curve.y[row])}
        )  # fmt: skip
    for band in panel.bands:
        row = thinned(band.low, band.high)
        bands.append(
            {"name": band.name, "colour": themed(band.colour),
             "x": rounded(band.x[row] - start, 3),
             "low": short(band.low[row]), "high": short(band.high[row]), "lack": band.lack}
        )  # fmt: skip
    return {
        "title": panel.title,
        "x": panel.x_label,
        "timed": timed,
        "log": panel.logarithmic,
        "level": panel.level,
        "curves": curves,
        "bands": bands,
        "moments": [
            {"name": moment.name, "colour": themed(moment.colour), "x": round(moment.x - start, 3)}
            for moment in panel.moments
        ],
    }


def curve_data(panels: Iterable[Panel], start_s: float) -> list[dict[str, Any]]:
    """All panels, in order."""
    return [panel_data(panel, start_s) for panel in panels]


def data_block(data: object) -> str:
    """A block of JSON for the page that no text within can end or turn into markup."""
    text = json_text(data)
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return f'<script type="application/json" id="data">{text}</script>'


def short(values: Iterable[float]) -> list[float | None]:
    """Rounded to four digits; none where not finite."""
    return [_short(float(v)) for v in values]


def rounded(values: Array, decimals: int) -> list[float]:
    """To so many decimals, and whole numbers without any."""
    near = np.round(values, decimals).tolist()
    return [_plain(v) for v in near]


def _short(value: float) -> float | None:
    if not isfinite(value):
        return None
    if value == 0.0:
        return 0
    return _plain(round(value, _DIGITS - 1 - floor(log10(abs(value)))))


def _plain(value: float) -> float:
    """A whole number without its decimals, where that is shorter."""
    return int(value) if abs(value) < _LARGE and value == int(value) else value
