"""What every page is wrapped in: no network, nothing but its own style, script and pictures."""

from __future__ import annotations

import base64
import hashlib
import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from itertools import groupby

from comparisons.words import Row

_SCRIPTS = ("common.js", "map.js", "curves.js", "tables.js", "folder.js")
DARK: Mapping[str, str] = {
    "#00798c": "#3fb6c8",
    "#1b3a4b": "#9cc0d4",
    "#2a7d4f": "#5cb585",
    "#2e7d32": "#6dbf73",
    "#333333": "#c4c4c4",
    "#3a6ea5": "#6f9fd8",
    "#444444": "#b5b5b5",
    "#5b7c8d": "#7fa6ba",
    "#5c6f2b": "#a3b765",
    "#666666": "#a6a6a6",
    "#6a3d9a": "#b18be0",
    "#6a4c93": "#a78bd6",
    "#7b4fa3": "#bb93e6",
    "#8f5d2b": "#c99a68",
    "#b05f9e": "#d68cc5",
    "#d1495b": "#f0788a",
}
"""Colours of lines that are hard to see on a dark page, and what they are there."""


def document(title: str, parts: Iterable[str], script: str = "") -> str:
    """A whole page. title: any text. parts: HTML, in order. script: ours, if any."""
    look = style()
    ending = f"<script>{script}</script>" if script else ""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy(look, script)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{look}</style></head>"
        f"<body>{''.join(parts)}{ending}</body></html>\n"
    )


def table(head: Sequence[str], rows: Iterable[Sequence[object]], bad: Iterable[int] = ()) -> str:
    """Cells may hold any text. bad: rows whose last cell is marked."""
    heads = "".join(f"<th>{escape(name)}</th>" for name in head)
    top = f"<thead><tr>{heads}</tr></thead>" if any(head) else ""
    marked, body = set(bad), []
    for number, row in enumerate(rows):
        cells = "".join(f"<td>{escape(str(cell))}</td>" for cell in row)
        body.append(f'<tr class="bad">{cells}</tr>' if number in marked else f"<tr>{cells}</tr>")
    return f'<div class="held"><table>{top}<tbody>{"".join(body)}</tbody></table></div>'


def prose(text: str) -> str:
    """Any text as HTML; numbers with an exponent are kept in one line."""
    return re.sub(r"\d[\d.]*e[-+]\d+", r'<span class="whole">\g<0></span>', escape(text))


def figures(rows: Sequence[Row]) -> str:
    """A table of quantity, value, band and whether the value lies in it, by group."""
    note = ""
    if any(_SINGLE in f"{row.group} {row.band}" for row in rows):
        note = f'<p class="note">{_BANDS}</p>'
    head = "".join(f"<th>{name}</th>" for name in ("quantity", "value", "band", "in or out"))
    parts = []
    for group, found in groupby(rows, key=lambda row: row.group):
        parts.append(f'<tbody><tr class="group"><th colspan="4">{escape(group)}</th></tr>')
        for row in found:
            cells = (row.quantity, row.value, row.band, _MARKS[row.inside])
            body = "".join(f"<td>{escape(cell)}</td>" for cell in cells)
            parts.append(f'<tr class="{_KINDS[row.inside]}">{body}</tr>')
        parts.append("</tbody>")
    return f'{note}<table class="figures"><thead><tr>{head}</tr></thead>{"".join(parts)}</table>'


_SINGLE = "95 %"
_BANDS = (
    "One value in twenty is outside its 95 % band by chance, so a single one outside is no "
    "failure: the verdict on the filter's consistency allows more. A mean NEES over the epochs of "
    "one run has the band of a single epoch, for its errors are correlated; so has one over "
    "landmarks."
)
_KINDS = {True: "good", False: "bad", None: ""}
_MARKS = {True: "in", False: "out", None: ""}


def again(
    job: str,
    *,
    file: str = "config.toml",
    options: Sequence[str] = (),
    place: str = "in the folder of this page",
) -> str:
    """The command that makes the folder's result again, and a button that copies it.

    file: with its settings, quoted. options: behind it. place: where the command is to be given,
    in words; with options also where the page knows the path of the file.
    """
    more = f" {shlex.join(options)}" if options else ""
    return (
        f'<div id="again" data-job="{escape(job)}" data-more="{escape(more)}"><p class="note">'
        f'The command that runs this again<span class="where">, {escape(place)}</span>:</p><p>'
        f'<code tabindex="0">slamcheck {escape(job)} {escape(file)}{escape(more)}</code> '
        '<button type="button" hidden>Copy</button> <span role="status" class="note"></span></p>'
        "</div>"
    )


def sortable(name: str, head: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    """A table to sort. Rows of an attribute text, ours, and cells, anybody's."""
    heads = "".join(f"<th><button>{escape(title)}</button></th>" for title in head)
    body = "".join(
        f"<tr {attributes}>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"
        for attributes, cells in rows
    )
    return (
        f'<div class="scroll"><table id="{name}" class="sortable"><thead><tr>{heads}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def number(value: float | None) -> str:
    """Three digits; `none` for what is no number."""
    if value is None or not isinstance(value, int | float) or not math.isfinite(value):
        return "none"
    return f"{value:.3g}"


def colour_bar(
    legend: str,
    title: str,
    colours: Sequence[str],
    words: Sequence[str],
    ends: tuple[str, str] = ("", ""),
) -> str:
    """Return a legend, hidden at first: colours from left to right, and words evenly below them.

    legend: its id. ends: what stands left and right of it. Without these the title stands left.
    """
    width = 164.0 / len(colours)
    blocks = "".join(
        f'<rect x="{10 + width * i:.1f}" width="{width + 0.3:.1f}" height="10" fill="{colour}"/>'
        for i, colour in enumerate(colours)
    )
    step = 164.0 / (len(words) - 1)
    figures = "".join(
        f'<text x="{10 + step * i:.0f}" y="22">{escape(word)}</text>'
        for i, word in enumerate(words)
    )
    left, right = ends
    return (
        f'<div id="{legend}" class="legend" hidden><span>{escape(left or title)}</span>'
        f'<svg viewBox="0 0 184 24" role="img" aria-label="{escape(title)}">{blocks}{figures}</svg>'
        f"<span>{escape(right)}</span></div>"
    )


def picture(title: str, png: bytes) -> str:
    """A PNG within the page. title: any text."""
    data = base64.b64encode(png).decode("ascii")
    return f'<img alt="{escape(title)}" src="data:image/png;base64,{data}">'


def style() -> str:
    """The page's only style sheet."""
    dark = "".join(f"{_variable(light)}:{colour};" for light, colour in DARK.items())
    return f"{_text('page.css')}@media screen and (prefers-color-scheme: dark){{:root{{{dark}}}}}"


def themed(colour: str) -> str:
    """Return a colour as the page writes it: the same on white, lighter on a dark page."""
    return f"var({_variable(colour)}, {colour})" if colour in DARK else colour


def script(names: Sequence[str] = _SCRIPTS) -> str:
    """The page's only script: its parts, each a function of its own, in order."""
    parts = "\n".join(_text(name) for name in names)
    return f"'use strict';\n{parts}\ndocument.documentElement.dataset.ready = 'yes';\n"


def policy(style_text: str, script_text: str) -> str:
    """Nothing is loaded, and nothing runs but these two; without a script, none."""
    script_source = f"script-src '{_hash(script_text)}'; " if script_text else ""
    return f"default-src 'none'; style-src '{_hash(style_text)}'; {script_source}img-src data:"


def _variable(colour: str) -> str:
    return f"--c{colour.removeprefix('#')}"


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()


def _text(name: str) -> str:
    return (files(__package__) / name).read_text(encoding="utf-8")
