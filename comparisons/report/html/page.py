"""`report.html`: verdict, causes and gaps first, then map and curves, figures and tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from comparisons.checks.causes import EXPLANATIONS, Cause
from comparisons.report.html.curves import curve_data, data_block
from comparisons.report.html.ladder import ladder_picture
from comparisons.report.html.map import RATIO_LAYER, MapContent, draw_map, ratio_legend
from comparisons.report.html.shell import again, document, figures, picture, prose, script, table
from comparisons.report.html.tables import LandmarkRow, landmarks, settings, timing
from comparisons.report.ladder import Step
from comparisons.report.marks import Panel
from comparisons.report.settings import SETTINGS, SettingLine
from comparisons.words import Row, cause_name

_HINT = {
    "map": "Wheel to zoom, drag to move, double click for all; click a landmark to find its row.",
    "curves": "Point at a time to see it on all curves and on the map; wheel or drag to zoom, "
    "double click for all.",
}


@dataclass(frozen=True, kw_only=True)
class PageContent:
    """What a job puts on its page, in the order in which it stands there. Texts may hold anything.

    job: the command. name: of the log. headline: the verdict in full. colour: `agree`, `disagree`
    or `unverified`. words: the verdict as sentences; facts: the figures that it rests on, by name.
    about: of log and estimate. steps: the ladder of gaps. reported: what the curves show, and why
    others are not there. curves_file: a picture with the same curves. pictures: files, to be
    embedded. sections: HTML of ours. landmarks_note: above the table of landmarks, or in its place.
    """

    job: str
    name: str
    headline: str
    colour: str
    words: str
    facts: Sequence[tuple[str, str]]
    about: str
    notes: Sequence[str]
    causes: Sequence[Cause]
    remarks: Sequence[str]
    steps: Sequence[Step]
    map: MapContent
    reported: str
    panels: Sequence[Panel]
    curves_file: str = ""
    rows: Sequence[Row]
    pictures: Sequence[Path] = ()
    sections: Sequence[str] = ()
    landmarks: Sequence[LandmarkRow]
    landmarks_note: str
    settings: Sequence[SettingLine]
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
    facts = "".join(f"<dt>{escape(name)}</dt><dd>{prose(text)}</dd>" for name, text in c.facts)
    same = f"; the same curves are in {c.curves_file}" if c.curves_file else ""
    off = "".join(f"The {name} trajectory leaves the map. " for name in drawn.outside)
    parts = [
        f"<header><h1>{escape(c.name)}</h1><p>"
        f'<span class="verdict {c.colour}">{escape(c.headline)}</span> '
        f'<span class="about">{escape(c.about)}</span></p></header>',
        f'<div id="top"><section id="outcome"><p class="words">{escape(c.words)}</p>',
        *map(_cause, c.causes),
        '</section><section id="gaps"><h2>Gaps between the estimates</h2>',
        f'{ladder_picture(c.steps)}</section><section id="beside">',
        *(f"<p>{prose(note)}</p>" for note in c.notes),
        f"<dl>{facts}</dl>{_remarks(c.remarks)}{again(c.job)}</section></div>",
        f'<noscript><p class="note">Curves, layers and sorting need JavaScript{same}.</p>'
        "</noscript>",
        '<main><section id="where"><h2>Map</h2><div id="layers"></div>',
        f'<div id="frame">{drawn.drawing.svg()}<div id="scale"></div></div>',
        f'{ratio_legend(drawn.decades)}<p id="chosen" role="status"></p>',
        f'<p class="note">{escape(off)}<span class="hand">{_HINT["map"]}</span></p></section>',
        f'<section id="when"><h2>Curves <span id="now"></span></h2>'
        f'<p class="note">{escape(c.reported)}</p>',
        f'<div id="curves"></div><p class="note hand">{_HINT["curves"]}</p></section></main>',
        "<h2>Figures</h2>",
        figures([row for row in c.rows if row.group != SETTINGS]),
        *_embedded(c.pictures),
        *c.sections,
        landmarks(c.landmarks, c.landmarks_note),
        settings(c.settings),
        f"<h2>Time</h2>{timing(c.seconds, c.cpu_s)}",
        f"<h2>Versions</h2>{table(('package', 'version'), list(c.versions.items()))}",
        data_block(data),
    ]
    return document(f"{c.name}: {c.headline}", parts, script())


def _cause(cause: Cause) -> str:
    """What was found, what to look at, and what such a cause means."""
    kind = cause_name(cause.gap)
    title, more = f"<b>{escape(kind)}</b>", ""
    if (known := EXPLANATIONS.get(cause.gap)) is not None:
        title = f"<b>{escape(known.title)}</b> <span>{escape(kind)}</span>"
        more = (
            f"<details><summary>What this means</summary><p>{escape(known.meaning)}</p>"
            f"<p>{escape(known.check)}</p></details>"
        )
    return (
        f'<div class="cause"><h3>{title}</h3><p>{prose(cause.evidence)}</p>'
        f'<p class="hint">{prose(cause.hint)}</p>{more}</div>'
    )


def _remarks(remarks: Sequence[str]) -> str:
    listed = "".join(f"<li>{prose(remark)}</li>" for remark in remarks)
    return f'<ul class="note">{listed}</ul>' if remarks else ""


def _embedded(pictures: Sequence[Path]) -> list[str]:
    shown = []
    for file in pictures:
        title = file.stem.replace("-", " ").capitalize()
        shown.append(f"<h2>{title}</h2>{picture(title, file.read_bytes())}")
    return shown
