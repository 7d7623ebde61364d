"""One line of the table that `trust.py` prints: a promise, and what was measured of it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from research.script import print_head, print_row


class PromiseRow(NamedTuple):
    """A promise of the verdict. asked and found: in words with figures. holds: found keeps it."""

    promise: str
    asked: str
    found: str
    holds: bool


def print_table(rows: Iterable[PromiseRow]) -> int:
    """Print rows as a Markdown table; return 1, an exit code, where one does not hold."""
    print_head("promise", "asked", "found", "holds")
    broken = 0
    for row in rows:
        print_row(*row[:3], "yes" if row.holds else "NO")
        broken |= not row.holds
    return int(broken)
