"""The page's tables: figures by group, landmarks, and the time of each stage."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, NamedTuple

from comparisons.report.html.shell import number, sortable

if TYPE_CHECKING:
    from comparisons.checks.agreement import BlockAgreement
    from comparisons.report.settings import SettingLine


class LandmarkRow(NamedTuple):
    """One landmark: its key on the map, its name, how it agrees, and how far truth is [m]."""

    key: str
    name: str
    block: BlockAgreement
    error_m: float = math.nan


def landmarks(rows: Sequence[LandmarkRow], note: str) -> str:
    """A table to sort and to search, worst first; its rows' keys are those of the map's marks.

    note: text of ours.
    """
    true = any(math.isfinite(row.error_m) for row in rows)
    head = ("landmark", "apart [m]", "sigma", "least variance", "largest variance")
    cells = [
        (
            f'data-key="{row.key}" tabindex="0" class="{"" if row.block.agrees else "bad"}"',
            (
                row.name,
                f"{row.block.difference_m:.3f}",
                f"{row.block.distance_sigma:.2f}",
                number(row.block.variance_ratio_least),
                number(row.block.variance_ratio_largest),
                *((number(row.error_m),) if true else ()),
                "agrees" if row.block.agrees else "disagrees",
            ),
        )
        for row in sorted(rows, key=_badness, reverse=True)
    ]
    shown = sortable("landmarks", (*head, *(("off truth [m]",) if true else ()), ""), cells)
    find = (
        '<p class="hand"><label>Find <input type="search" id="find" placeholder="landmark">'
        "</label></p>"
    )
    return f'<h2>Landmarks</h2><p class="note">{escape(note)}</p>{f"{find}{shown}" if rows else ""}'


def _badness(row: LandmarkRow) -> tuple[bool, float]:
    """What disagrees is worse than what agrees, then what is farther apart; no number is worst."""
    sigma = row.block.distance_sigma
    return not row.block.agrees, sigma if math.isfinite(sigma) else math.inf


def landmarks_note(shown: int, every: int, file: str, whose: str) -> str:
    """What there is to know of the table. whose: the variances, in words."""
    part = ""
    if shown < every:
        part = (
            f"{shown:,} of {every:,} landmarks, those farthest apart in sigma, are here and on "
            f"the map; {file} has all. "
        )
    return (
        f"{part}The worst come first. A row finds its landmark on the map, and the other way "
        f"round. Variances are {whose} over the smoother's."
    )


def settings(lines: Sequence[SettingLine]) -> str:
    """All settings; those that are no default, or not a document's, before the others."""
    shown = [line for line in lines if line.changed or line.document]
    others = [line for line in lines if not (line.changed or line.document)]
    count = sum(line.changed for line in lines)
    words = f"{count} {'differs' if count == 1 else 'differ'} from the default."
    parts = [f'<p class="note">{words if count else "All are at their defaults."}</p>']
    if shown:
        documents = any(line.document for line in shown)
        if documents:
            parts.append(f'<p class="note">{_DOCUMENTS}</p>')
        parts.append(_setting_table(shown, 4 if documents else 3))
    title = f"{'The other ' if shown else ''}{len(others)} settings, inputs or at their defaults"
    parts.append(f"<details><summary>{title}</summary>{_setting_table(others, 2)}</details>")
    return f'<section id="settings"><h2>Settings that ran</h2>{"".join(parts)}</section>'


_DOCUMENTS = (
    "Source documents, with section, figure or table: G: Guivant, Masson, Nebot 2002; M: Misono "
    "et al. 2007; N: Nieto 2005."
)


def _setting_table(lines: Sequence[SettingLine], columns: int) -> str:
    heads = ("setting", "value", "default", "in a document")[:columns]
    body = []
    for line in lines:
        texts = (line.value, line.default, line.document)[: columns - 1]
        cells = "".join(
            f'<td data-name="{name}">{escape(text)}</td>'
            for name, text in zip(heads[1:], texts, strict=True)
        )
        kind = ' class="changed"' if line.changed else ""
        body.append(
            f"<tr{kind}><td><b>{escape(line.setting)}</b><div>{escape(line.meaning)}</div></td>"
            f"{cells}</tr>"
        )
    top = "".join(f"<th>{name}</th>" for name in heads)
    return (
        f'<div class="held"><table><thead><tr>{top}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


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
