"""`report.html`: verdict and causes, map and gaps beside them, then curves, figures and tables.

What a section needs is loaded where the page has it: an audit's page knows nothing of planar maps.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from comparisons.report.html.curves import curve_data, data_block
from comparisons.report.html.shell import again, document, figures, picture, prose, script, table
from comparisons.report.marks import EVENT, TIME, Panel
from comparisons.words import SETTINGS, SPENT, Row, cause_name, facts

if TYPE_CHECKING:
    from comparisons.report.html.map import MapContent
    from comparisons.report.html.tables import LandmarkRow
    from comparisons.report.ladder import LadderStep
    from comparisons.report.settings import SettingLine
    from comparisons.report.terminal import Summary
    from comparisons.words import Cause

_ROW = "; click a landmark to find its row"
_TIME = "Point at a time to see it on all curves and on the map. "


class DatedFinding(NamedTuple):
    """A finding. kind: its title. at: where on the axis of the curves it is first, if anywhere."""

    kind: str
    text: str
    at: float | None
    fault: bool


@dataclass(frozen=True, kw_only=True)
class PageContent:
    """What a job puts on its page, in the order in which it stands there. Texts may hold anything.

    Of what a job lacks there is no section. job: the command that `config.toml` beside the page
    runs again, if one is there. name: of the log. headline: the verdict in full. colour: `agree`,
    `disagree`, `unverified`, or none. about: of log and estimate. words: the verdict as sentences.
    reasons: for it, that are no causes. facts: the figures that it rests on, by name. steps: the
    ladder of gaps. reported: what the curves show, and why others are not there. curves_file: a
    picture with the same curves. pictures: files, to be embedded. sections: HTML of ours.
    landmarks_note: above the table of landmarks, or in its place. dated: findings on the axis of
    the curves.
    """

    name: str
    headline: str
    job: str = ""
    colour: str = ""
    about: str = ""
    words: str = ""
    causes: Sequence[Cause] = ()
    reasons: Sequence[str] = ()
    dated: Sequence[DatedFinding] = ()
    steps: Sequence[LadderStep] = ()
    notes: Sequence[str] = ()
    facts: Sequence[tuple[str, str]] = ()
    remarks: Sequence[str] = ()
    map: MapContent | None = None
    reported: str = ""
    panels: Sequence[Panel] = ()
    curves_file: str = ""
    rows: Sequence[Row] = ()
    pictures: Sequence[Path] = ()
    sections: Sequence[str] = ()
    landmarks: Sequence[LandmarkRow] = ()
    landmarks_note: str = ""
    settings: Sequence[SettingLine] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)
    cpu_s: Mapping[str, float] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)


def facts_of(
    lines: Iterable[tuple[str, str]], leave: Collection[str] = ()
) -> list[tuple[str, str]]:
    """Return lines of what is printed as facts of the page, but those that it says elsewhere."""
    return [(name[:1].upper() + name[1:], text) for name, text in lines if name not in leave]


def page_of(summary: Summary, name: str) -> PageContent:
    """Return a page that has what a job prints. name: of the log, or of the trace."""
    return PageContent(
        name=name,
        headline=summary.headline.removeprefix("verdict: "),
        colour="agree" if summary.look == "verified" else summary.look,
        causes=summary.causes,
        reasons=summary.reasons,
        steps=summary.steps,
        facts=facts_of(summary.lines),
        remarks=summary.remarks,
        rows=summary.rows,
    )


def write_page(content: PageContent, path: Path) -> None:
    """Write the whole page."""
    path.write_text(page(content), encoding="utf-8")


def page(content: PageContent) -> str:
    """The whole page."""
    c, data = content, dict[str, object]()
    start_s = _start(c)
    header = [
        f"<header><h1>{escape(c.name)}</h1><p>"
        f'<span class="{f"verdict {c.colour}" if c.colour else "plain"}">{escape(c.headline)}'
        "</span> "
        f'<span class="about">{escape(c.about)}</span></p></header>'
    ]
    where = when = ""
    if c.map is not None:
        where, data = _where(c.map, start_s, _ROW if c.landmarks else "")
    panels = sorted([*c.panels, *_over_time(c)], key=lambda panel: not panel.timed)
    data |= {"start": start_s, "event": _of_events(c), **curve_data(panels, start_s)}
    now = '<output id="now"></output>'
    if panels or c.reported:
        when = (
            f'<section id="when"><h2>Curves {"" if where else now}</h2>'
            f'<p class="note">{escape(c.reported)}</p>'
            f'<div id="curves"></div><p class="note hand">{_TIME if where else ""}'
            '<span class="mouse">Wheel or drag to zoom, double click for all.</span></p></section>'
        )
    same = f"; the same curves are in {c.curves_file}" if c.curves_file else ""
    parts = [
        *header,
        f"<main>{_top(c, where)}"
        f'<noscript><p class="note">Curves, layers and sorting need JavaScript{same}.</p>'
        f"</noscript>{when}{_slider(now) if where else ''}</main>",
        _figures(c.rows),
        *_embedded(c.pictures),
        *c.sections,
        _job_tables(c) if c.settings else "",
        _versions(c.versions),
        data_block(data),
    ]
    drawn = [name for name, there in (("map.js", where), ("curves.js", when)) if there]
    scripts = ("common.js", *drawn, "tables.js", "folder.js")
    return document(f"{c.name}: {c.headline}", parts, script(scripts))


def _start(c: PageContent) -> float:
    """The time from which those of tracks count, or else those of curves."""
    if c.map is not None:
        return min((float(track.time_s[0]) for track in c.map.tracks[:2]), default=0.0)
    return min((float(curve.x[0]) for panel in c.panels for curve in panel.curves[:1]), default=0.0)


def _top(c: PageContent, where: str) -> str:
    """Verdict and causes with what they rest on, and beside these the map and the gaps."""
    facts = "".join(f"<dt>{escape(name)}</dt><dd>{prose(text)}</dd>" for name, text in c.facts)
    words = f'<p class="words">{escape(c.words)}</p>' if c.words else ""
    why = "".join(f"<li>{prose(reason)}</li>" for reason in c.reasons)
    gaps = ""
    if c.steps:
        from comparisons.report.html.ladder import ladder_picture

        ladder = ladder_picture(c.steps)
        gaps = f'<section id="gaps"><h2>Gaps between the estimates</h2>{ladder}</section>'
    told = "".join(
        [
            f'<section id="outcome">{words}',
            *(_cause(cause) for cause in c.causes),
            *(_dated(finding, EVENT if _of_events(c) else TIME) for finding in c.dated),
            f'<ul class="reasons">{why}</ul>' if why else "",
            '</section><section id="beside">',
            *(f"<p>{prose(note)}</p>" for note in c.notes),
            f"<dl>{facts}</dl>{_remarks(c.remarks)}{again(c.job) if c.job else ''}</section>",
        ]
    )
    drawn = f'<div class="column">{where}{_errors(c.map)}{gaps}</div>' if where or gaps else ""
    return f'<div id="top"><div class="column">{told}</div>{drawn}</div>'


def _over_time(c: PageContent) -> list[Panel]:
    """The paths of the map against time, marked as the other curves are."""
    if c.map is None:
        return []
    from comparisons.report.html.paths import path_panels

    moments = next((panel.moments for panel in c.panels if panel.moments), ())
    return [replace(panel, moments=moments) for panel in path_panels(c.map)]


def _errors(content: MapContent | None) -> str:
    """The statistics of the errors that colour the map."""
    if content is None:
        return ""
    from comparisons.report.html.errors import error_table

    return error_table(content.errors)


def _where(content: MapContent, start_s: float, more: str) -> tuple[str, dict[str, object]]:
    """The map, and what the script has to know of it. more: that can be done with it."""
    from comparisons.report.html.errors import error_colours, error_legends
    from comparisons.report.html.map import draw_map, ratio_legend

    drawn = draw_map(content)
    off = "".join(f"The {name} trajectory leaves the map. " for name in drawn.outside)
    tracks = {name: [round(t - start_s, 3) for t in at] for name, at in drawn.times.items()}
    return (
        '<section id="where"><h2>Map</h2><div id="layers"></div>'
        f'<div id="frame">{drawn.drawing.svg()}<div id="scale"></div></div>'
        f"{ratio_legend(drawn.decades)}{error_legends(content.errors)}"
        f'<p id="chosen" role="status"></p>'
        f'<p class="note">{escape(off)}<span class="hand mouse">Wheel to zoom, drag to move, '
        f'double click for all{more}.</span><span class="hand touch">Pinch to zoom, drag to '
        f"move{more}.</span></p></section>",
        {
            "tracks": tracks,
            "spreads": drawn.spreads,
            "names": content.names,
            "errorColours": error_colours(),
        },
    )


def _slider(now: str) -> str:
    """What moves the vehicle, its ellipse and the cursors of the curves; it stays in view."""
    slider = '<input type="range" id="time" aria-label="time" step="any">'
    return f'<div id="times" class="hand" hidden>{slider}{now}</div>'


def _figures(rows: Sequence[Row]) -> str:
    shown = [row for row in rows if row.group not in (SETTINGS, *SPENT)]
    return f"<h2>Figures</h2>{figures(shown)}" if shown else ""


def _job_tables(c: PageContent) -> str:
    """Landmarks, all settings, and the time of each stage."""
    from comparisons.report.html.tables import landmarks, settings, timing

    compared = c.landmarks or c.landmarks_note
    return (
        f"{landmarks(c.landmarks, c.landmarks_note) if compared else ''}{settings(c.settings)}"
        f"<h2>Time</h2>{timing(c.seconds, c.cpu_s)}"
    )


def _versions(versions: Mapping[str, str]) -> str:
    listed = table(("package", "version"), list(versions.items()))
    return f"<h2>Versions</h2>{listed}" if versions else ""


def _cause(cause: Cause) -> str:
    """What it is, what to do, what was found, a sentence a fact, and what such a cause means."""
    from comparisons.report.explain import explained

    kind = cause_name(cause.gap)
    title, more = f"<b>{escape(kind)}</b>", ""
    if (known := explained(cause.gap)) is not None:
        title = f"<b>{escape(known.title)}</b> <span>{escape(kind)}</span>"
        more = (
            f"<details><summary>What this means</summary><p>{escape(known.meaning)}</p>"
            f"<p>{escape(known.check)}</p></details>"
        )
    hint = f'<p class="hint">{prose(cause.hint)}</p>' if cause.hint else ""
    every = facts(cause.evidence)
    shown = "".join(f"<li>{prose(fact)}</li>" for fact in every)
    evidence = f"<ul>{shown}</ul>" if every[1:] else f"<p>{prose(cause.evidence)}</p>"
    return f'<div class="cause"><h3>{title}</h3>{hint}{evidence}{more}</div>'


def _of_events(c: PageContent) -> bool:
    """Whether the curves stand over the numbers of events."""
    return any(panel.x_label == EVENT for panel in c.panels)


def _dated(finding: DatedFinding, axis: str) -> str:
    """A finding with what shows its place on all curves."""
    where = ""
    if finding.at is not None:
        place = f"event {finding.at:,.0f}" if axis == EVENT else f"{finding.at:.6g} s"
        where = f' <button class="at hand" data-time="{finding.at:.9g}">show {place}</button>'
    kind = "cause" if finding.fault else "cause named"
    return (
        f'<div class="{kind}"><h3><b>{escape(finding.kind)}</b>{where}</h3>'
        f"<p>{prose(finding.text)}</p></div>"
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
