"""Errors of paths on a page: colours of the map's layers, their legend, a table of statistics."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.path_errors import error_statistics
from comparisons.report.html.drawing import Drawing
from comparisons.report.html.shell import colour_bar, number, table
from comparisons.report.track_errors import TRUTH, TrackErrors

_CLASSES = "0123456789abcdefghijklmnopqrstuv"
"""A digit for each colour, from no error to the path's largest."""
_STOPS = ("#4575d4", "#8a5fc9", "#c9519b", "#e0583f", "#e08a00")
"""From no error to the largest: seen on white and on black, and by the colour-blind."""
_STATISTICS = {"mean": "mean", "median": "median", "rms": "RMS", "max": "max", "std": "std"}


def layer_name(errors: TrackErrors) -> str:
    """Return what the layer of a path's errors is called."""
    what = "error" if errors.reference == TRUTH else "difference"
    return f"{errors.name}, coloured by {what}"


def draw_errors(drawing: Drawing, errors: TrackErrors, time_s: Array, number: int) -> None:
    """Add a path's layer. time_s: (K,) of its points as drawn. number: of its legend."""
    inside = (time_s >= errors.time_s[0]) & (time_s <= errors.time_s[-1])
    share = np.interp(time_s, errors.time_s, errors.distance_m) / largest_m(errors)
    known = inside & np.isfinite(share)
    place = np.clip(np.where(known, share, 0.0) * len(_CLASSES), 0, len(_CLASSES) - 1)
    digits = "".join(
        _CLASSES[colour] if shown else "."
        for colour, shown in zip(place.astype(int).tolist(), known.tolist(), strict=True)
    )
    drawing.coloured(layer_name(errors), _STOPS[-2], errors.name, digits, _legend_id(number))


def largest_m(errors: TrackErrors) -> float:
    """Return where a path's colours end."""
    largest = float(np.nanmax(errors.distance_m, initial=0.0))
    return largest if np.isfinite(largest) and largest > 0.0 else 1.0


def error_colours() -> list[str]:
    """Return the colours of the classes."""
    stops = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in _STOPS])
    place, ends = np.linspace(0.0, 1.0, len(_CLASSES)), np.linspace(0.0, 1.0, len(_STOPS))
    mixed = np.column_stack([np.interp(place, ends, stops[:, i]) for i in range(3)])
    return ["#{:02x}{:02x}{:02x}".format(*rgb) for rgb in np.rint(mixed).astype(int).tolist()]


def error_legends(every: Sequence[TrackErrors]) -> str:
    """Return a colour bar with its metres for each path, shown with its layer."""
    bars = []
    for i, errors in enumerate(every):
        whose = errors.reference if errors.reference == TRUTH else f"the {errors.reference}"
        end_m, title = largest_m(errors), f"{errors.name}, distance from {whose}"
        words = [f"{share * end_m:.3g} m" for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
        bars.append(colour_bar(_legend_id(i), title, error_colours(), words))
    return "".join(bars)


def _legend_id(number: int) -> str:
    return f"error-legend-{number}"


def error_table(every: Sequence[TrackErrors]) -> str:
    """Return statistics of the errors, by path, as evo prints them; nothing without errors."""
    if not every:
        return ""
    reference = every[0].reference
    rows = []
    for errors in every:
        place = error_statistics(errors.distance_m) | {"rms": errors.rms_m}
        heading = error_statistics(np.degrees(errors.heading_rad))
        for what, figures in (("position [m]", place), ("heading [deg]", heading)):
            rows.append((f"{errors.name}, {what}", *(number(figures[key]) for key in _STATISTICS)))
    said = f"Difference from the {reference} (APE, absolute pose error)"
    if reference == TRUTH:
        said = "Error against truth (APE, absolute pose error, without alignment)"
    instants = max(len(errors.time_s) for errors in every)
    note = f"{said}, at {instants:,} instants. The map has it as a layer."
    return (
        f'<section id="errors"><h2>Errors of the path</h2>'
        f"{table(('', *_STATISTICS.values()), rows)}"
        f'<p class="note">{escape(note)}</p></section>'
    )
