"""The states of a trace as a table of the audit's page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from comparisons.report.html.shell import table

if TYPE_CHECKING:
    from comparisons.audit.states import BlockState

MOST_BLOCKS = 200


def states_table(blocks: Sequence[BlockState]) -> str:
    """Return a section with the blocks of the error state, those of the prior first."""
    rows = [
        (
            block.name,
            block.dims,
            block.chart,
            f"{block.since:,}",
            "" if block.until is None else f"{block.until:,}",
        )
        for block in blocks[:MOST_BLOCKS]
    ]
    entries = sum(block.dims for block in blocks if block.until is None)
    note = f"{len(blocks):,} blocks, of which those that stay have {entries:,} entries."
    if len(blocks) > MOST_BLOCKS:
        note += f" The first {MOST_BLOCKS} are here."
    head = ("block", "entries", "chart", "from event", "until event")
    return (
        f'<section id="states"><h2>States</h2><p class="note">{note}</p>'
        f'<div class="scroll">{table(head, rows)}</div></section>'
    )
