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
from comparisons.report.marks import DIGITS, MOST_POINTS, FilledBand, Panel

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
    """For the script. Times and events count from start_s; figures are rounded to what is seen.

    What stands over the same x is thinned together, so that it still does.
    """
    start = start_s if panel.timed else 0.0
    over: dict[int, list[Array]] = {}
    for curve in panel.curves:
        over.setdefault(id(curve.x), []).append(curve.y)
    for band in panel.bands:
        over.setdefault(id(band.x), []).extend((band.low, band.high))
    rows = {key: thinned(*values, most=panel.points) for key, values in over.items()}
    curves, bands = [], []
    for curve in panel.curves:
        row = rows[id(curve.x)]
        curves.append(
            {"name": curve.name, "colour": themed(curve.colour),
             "x": rounded(curve.x[row] - start, 3), "y": short(curve.y[row], panel.digits)}
        )  # fmt: skip
    for band in panel.bands:
        row = rows[id(band.x)]
        bands.append(
            {"name": band.name, "colour": themed(band.colour),
             "x": rounded(band.x[row] - start, 3), **_sides(band, row, panel)}
        )  # fmt: skip
    return {
        "title": panel.title,
        "x": panel.x_label,
        "timed": panel.timed,
        "log": panel.logarithmic,
        "level": panel.level,
        "lacks": panel.lacking,
        "curves": curves,
        "bands": bands,
        "moments": [
            {"name": moment.name, "colour": themed(moment.colour), "x": round(moment.x - start, 3)}
            for moment in panel.moments
        ],
    }


def _sides(band: FilledBand, row: Index, panel: Panel) -> dict[str, Any]:
    """Low and high, or half the width of what is even about zero or about a curve."""
    low, high = band.low[row], band.high[row]
    if band.about:
        names = [curve.name for curve in panel.curves]
        return {"half": short(0.5 * (high - low)), "about": names.index(band.about)}
    if np.array_equal(low, -high, equal_nan=True):
        return {"half": short(high), "about": None}
    return {"low": short(low), "high": short(high)}


def curve_data(panels: Iterable[Panel], start_s: float) -> dict[str, Any]:
    """All panels, in order, with the number of the list of x in place of each list."""
    axes: dict[tuple[float, ...], int] = {}
    every = [panel_data(panel, start_s) for panel in panels]
    for panel in every:
        for drawn in (*panel["curves"], *panel["bands"]):
            drawn["x"] = axes.setdefault(tuple(drawn["x"]), len(axes))
    return {"axes": list(axes), "panels": every}


def data_block(data: object) -> str:
    """A block of JSON for the page that no text within can end or turn into markup."""
    text = json_text(data)
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return f'<script type="application/json" id="data">{text}</script>'


def short(values: Iterable[float], digits: int = DIGITS) -> list[float | None]:
    """Rounded to so many digits; none where not finite."""
    return [_short(float(v), digits) for v in values]


def rounded(values: Array, decimals: int) -> list[float]:
    """To so many decimals, and whole numbers without any."""
    near = np.round(values, decimals).tolist()
    return [_plain(v) for v in near]


def _short(value: float, digits: int) -> float | None:
    if not isfinite(value):
        return None
    if value == 0.0:
        return 0
    return _plain(round(value, digits - 1 - floor(log10(abs(value)))))


def _plain(value: float) -> float:
    """A whole number without its decimals, where that is shorter."""
    return int(value) if abs(value) < _LARGE and value == int(value) else value
