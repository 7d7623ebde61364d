"""`report.html`: verdict and causes first, then map and curves, figures, pictures and tables."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from comparisons.pipeline.compare import Comparison
from comparisons.report.html.curves import curve_data, data_block
from comparisons.report.html.look import script
from comparisons.report.html.map import RATIO_LAYER, ratio_legend, run_map
from comparisons.report.html.shell import document, picture, table
from comparisons.report.html.tables import landmarks, timing
from comparisons.report.models import Result
from comparisons.report.panels import ConsistencyPanels
from comparisons.report.result import run_rows

_HINT = {
    "map": "Wheel to zoom, drag to move, double click for all; click a landmark to find its row.",
    "curves": "Point at a time to see it on all curves and on the map; wheel or drag to zoom, "
    "double click for all.",
}


def page(
    comparison: Comparison, panels: ConsistencyPanels, result: Result, pictures: Sequence[Path]
) -> str:
    """The whole page. pictures: files of those that have been drawn, to be shown."""
    name, drawn = escape(result.log.name), run_map(comparison)
    start_s = float(comparison.ekf.estimate.time_s[0])
    data = {
        "start": start_s,
        "track": [round(t - start_s, 3) for t in drawn.track_s],
        "ratioLayer": RATIO_LAYER,
        "panels": curve_data(panels, start_s),
    }
    parts = [
        f"<header><h1>{name}</h1><p>"
        f'<span class="verdict {_colour(result)}">{escape(result.headline)}</span> '
        f"{escape(result.log.format)}, {result.log.duration_s:,.0f} s</p></header>",
        _consistency(result),
        _causes(result),
        '<noscript><p class="note">Curves, layers and sorting need JavaScript; the same curves '
        "are in consistency.png.</p></noscript>",
        '<main><section id="where"><h2>Map</h2><div id="layers"></div>',
        f'<div id="frame">{drawn.drawing.svg()}<div id="scale"></div></div>',
        f'{ratio_legend(drawn.decades)}<p id="told" role="status"></p>',
        f'<p class="note">{_HINT["map"]}</p></section>',
        f'<section id="when"><h2>Curves <span id="now"></span></h2>'
        f'<p class="note">{escape(panels.told)}</p>',
        f'<div id="curves"></div><p class="note">{_HINT["curves"]}</p></section></main>',
        "<h2>Figures</h2>",
        table(("", ""), run_rows(comparison, result)),
        *_embedded(pictures),
        *(section for one in comparison.findings.values() for section in one.sections()),
        landmarks(comparison, result),
        f"<h2>Time</h2>{timing(result.seconds, result.cpu_s or {})}",
        f"<h2>Versions</h2>{table(('package', 'version'), list(result.versions.items()))}",
        data_block(data),
    ]
    return document(f"{result.log.name}: {result.headline}", parts, script())


def _causes(result: Result) -> str:
    shown = [
        f'<div class="cause"><b>{escape(c.gap)}</b>: {escape(c.evidence)}'
        f'<div class="hint">{escape(c.hint)}</div></div>'
        for c in result.causes
    ]
    remarks = "".join(f"<li>{escape(remark)}</li>" for remark in result.remarks)
    return "".join(shown) + (f'<ul class="note">{remarks}</ul>' if remarks else "")


def _embedded(pictures: Sequence[Path]) -> list[str]:
    shown = []
    for file in pictures:
        title = file.stem.replace("-", " ").capitalize()
        shown.append(f"<h2>{title}</h2>{picture(title, file.read_bytes())}")
    return shown


def _colour(result: Result) -> str:
    """An agreement that is qualified is no plain one."""
    return "unverified" if result.verdict == "agree" and result.qualifiers else result.verdict


def _consistency(result: Result) -> str:
    """What of the filter's consistency is outside its band."""
    found = "; ".join(result.inconsistent or ())
    return f'<p class="note">The filter is inconsistent: {escape(found)}.</p>' if found else ""
