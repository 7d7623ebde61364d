"""What every page is wrapped in: no network, nothing but its own style, script and pictures."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Iterable, Sequence
from html import escape

from comparisons.report.html.look import policy, style


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


def again(job: str) -> str:
    """The command that makes the folder's result again, and a button that copies it."""
    return (
        f'<div id="again" data-job="{escape(job)}"><p class="note">The command that runs this '
        f'again<span class="where">, in the folder of this page</span>:</p><p><code tabindex="0">'
        f'slamcheck {escape(job)} config.toml</code> <button type="button" hidden>Copy</button> '
        '<span role="status" class="note"></span></p></div>'
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


def picture(title: str, png: bytes) -> str:
    """A PNG within the page. title: any text."""
    data = base64.b64encode(png).decode("ascii")
    return f'<img alt="{escape(title)}" src="data:image/png;base64,{data}">'
