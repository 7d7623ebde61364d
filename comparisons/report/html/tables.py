"""The page's tables: landmarks, and the time of each stage."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from comparisons.pipeline.compare import Comparison
from comparisons.report.html.map import shown_landmarks
from comparisons.report.html.shell import number, sortable
from comparisons.report.models import LandmarkResult, Result


def landmarks(comparison: Comparison, result: Result) -> str:
    """A table to sort; its rows' keys are those of the map's marks."""
    head = ("landmark", "apart [m]", "sigma", "least variance", "largest variance", "")
    rows = [
        (
            f'data-key="{key}" tabindex="0" class="{"" if row.agrees else "bad"}"',
            (
                name,
                f"{row.difference_m:.3f}",
                f"{row.distance_sigma:.2f}",
                number(row.variance_ratio_least),
                number(row.variance_ratio_largest),
                "agrees" if row.agrees else "disagrees",
            ),
        )
        for key, name, row in _rows(comparison, result)
    ]
    shown, every = len(shown_landmarks(comparison)), len(result.agreement.landmarks)
    part = ""
    if shown < every:
        part = (
            f"{shown:,} of {every:,} landmarks, those farthest apart in sigma, are here and on "
            "the map; result.json has all. "
        )
    return (
        f'<h2>Landmarks</h2><p class="note">{part}A row finds its landmark on the map, and the '
        "other way round. Variances are the filter's over the smoother's.</p>"
        f"{sortable('landmarks', head, rows)}"
    )


def _rows(comparison: Comparison, result: Result) -> list[tuple[str, str, LandmarkResult]]:
    """Every landmark with its key on the map and its name."""
    points = [
        (str(row.id), str(row.id), row)
        for row in (result.agreement.landmarks[i] for i in shown_landmarks(comparison).tolist())
    ]
    others = [row for found in comparison.findings.values() for row in found.landmarks()]
    return points + [(f"s{row.id}", f"scan {row.id}", row) for row in others]


def timing(seconds: Mapping[str, float], cpu_s: Mapping[str, float]) -> str:
    """A bar per stage, of the wall's time, and the processor's beside it."""
    longest = max([*seconds.values(), 1e-9])
    rows = "".join(
        f'<tr><td>{escape(name)}</td><td class="number">{value:.2f} s</td>'
        f'<td class="number">{_cpu(cpu_s.get(name))}</td><td class="wide">'
        f'<svg class="bar"><rect width="{100.0 * value / longest:.1f}%" height="100%"/></svg></td>'
        "</tr>"
        for name, value in seconds.items()
    )
    return f'<table id="timing"><tbody>{rows}</tbody></table>'


def _cpu(value: float | None) -> str:
    return "" if value is None else f"processor {value:.2f} s"
