"""`report.html`: verdict and causes first, then map and curves, figures, pictures and tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from comparisons.extensions.interface import Row
from comparisons.report.html.curves import curve_data, data_block
from comparisons.report.html.look import script
from comparisons.report.html.map import RATIO_LAYER, MapContent, draw_map, ratio_legend
from comparisons.report.html.shell import document, picture, table
from comparisons.report.html.tables import LandmarkRow, figures, landmarks, timing
from comparisons.report.models import CauseResult
from comparisons.report.panels import Panel

_HINT = {
    "map": "Wheel to zoom, drag to move, double click for all; click a landmark to find its row.",
    "curves": "Point at a time to see it on all curves and on the map; wheel or drag to zoom, "
    "double click for all.",
}


@dataclass(frozen=True, kw_only=True)
class PageContent:
    """What a job puts on its page, in the order in which it stands there. Texts may hold anything.

    name: of the log. headline: the verdict in full. colour: `agree`, `disagree` or `unverified`.
    about: of log and estimate. reported: what the curves show, and why others are not there.
    curves_file: a picture with the same curves. pictures: files, to be embedded. sections: HTML of
    ours. landmarks_note: above the table of landmarks, or in its place.
    """

    name: str
    headline: str
    colour: str
    about: str
    notes: Sequence[str]
    causes: Sequence[CauseResult]
    remarks: Sequence[str]
    map: MapContent
    reported: str
    panels: Sequence[Panel]
    curves_file: str = ""
    rows: Sequence[Row]
    pictures: Sequence[Path] = ()
    sections: Sequence[str] = ()
    landmarks: Sequence[LandmarkRow]
    landmarks_note: str
    seconds: Mapping[str, float]
    cpu_s: Mapping[str, float]
    versions: Mapping[str, str]


def page(content: PageContent) -> str:
    """The whole page."""
    c, drawn = content, draw_map(content.map)
    start_s = min(float(track.time_s[0]) for track in c.map.tracks[:2])
    data = {
        "start": start_s,
        "tracks": {name: [round(t - start_s, 3) for t in at] for name, at in drawn.times.items()},
        "ratioLayer": RATIO_LAYER,
        "panels": curve_data(c.panels, start_s),
    }
    same = f"; the same curves are in {c.curves_file}" if c.curves_file else ""
    off = "".join(f"The {name} trajectory leaves the map. " for name in drawn.outside)
    parts = [
        f"<header><h1>{escape(c.name)}</h1><p>"
        f'<span class="verdict {c.colour}">{escape(c.headline)}</span> '
        f"{escape(c.about)}</p></header>",
        *(f'<p class="note">{escape(note)}</p>' for note in c.notes),
        _causes(c.causes, c.remarks),
        f'<noscript><p class="note">Curves, layers and sorting need JavaScript{same}.</p>'
        "</noscript>",
        '<main><section id="where"><h2>Map</h2><div id="layers"></div>',
        f'<div id="frame">{drawn.drawing.svg()}<div id="scale"></div></div>',
        f'{ratio_legend(drawn.decades)}<p id="told" role="status"></p>',
        f'<p class="note">{escape(off)}{_HINT["map"]}</p></section>',
        f'<section id="when"><h2>Curves <span id="now"></span></h2>'
        f'<p class="note">{escape(c.reported)}</p>',
        f'<div id="curves"></div><p class="note">{_HINT["curves"]}</p></section></main>',
        "<h2>Figures</h2>",
        figures(c.rows),
        *_embedded(c.pictures),
        *c.sections,
        landmarks(c.landmarks, c.landmarks_note),
        f"<h2>Time</h2>{timing(c.seconds, c.cpu_s)}",
        f"<h2>Versions</h2>{table(('package', 'version'), list(c.versions.items()))}",
        data_block(data),
    ]
    return document(f"{c.name}: {c.headline}", parts, script())


def _causes(causes: Sequence[CauseResult], remarks: Sequence[str]) -> str:
    shown = [
        f'<div class="cause"><b>{escape(c.gap)}</b>: {escape(c.evidence)}'
        f'<div class="hint">{escape(c.hint)}</div></div>'
        for c in causes
    ]
    listed = "".join(f"<li>{escape(remark)}</li>" for remark in remarks)
    return "".join(shown) + (f'<ul class="note">{listed}</ul>' if remarks else "")


def _embedded(pictures: Sequence[Path]) -> list[str]:
    shown = []
    for file in pictures:
        title = file.stem.replace("-", " ").capitalize()
        shown.append(f"<h2>{title}</h2>{picture(title, file.read_bytes())}")
    return shown
