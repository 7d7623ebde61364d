"""One line of the table that `trust.py` prints: a promise, and what was measured of it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Row(NamedTuple):
    """A promise of the verdict. asked and found: in words with figures. holds: found keeps it."""

    promise: str
    asked: str
    found: str
    holds: bool


def print_table(rows: Iterable[Row]) -> bool:
    """Print rows as a Markdown table; return whether all hold."""
    listed = list(rows)
    print("| promise | asked | found | holds |\n|---|---|---|---|")
    for row in listed:
        print(f"| {row.promise} | {row.asked} | {row.found} | {'yes' if row.holds else 'NO'} |")
    return all(row.holds for row in listed)
