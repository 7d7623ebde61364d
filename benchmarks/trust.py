"""What the verdict promises, and what was measured of it, as one table.

    python -m benchmarks.trust [--quick]

The parts can be run alone: trust_sound, trust_damaged, trust_optimum, trust_association,
trust_check, trust_hints, trust_bands. --quick takes a few of each, some minutes; in full it is an
hour or more on one core.
Rows of real logs come where ../shared/data is there. The exit code is 1 where a promise does not
hold.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

from benchmarks import (
    trust_association,
    trust_bands,
    trust_check,
    trust_damaged,
    trust_hints,
    trust_optimum,
    trust_sound,
)
from benchmarks.script import options
from benchmarks.trust_row import Row, print_table


def rows(quick: bool) -> Iterator[Row]:
    """Of every part, in the order of docs/verdicts.md."""
    for part in (trust_sound, trust_damaged, trust_optimum, trust_association, trust_check):
        yield from part.rows(quick)
    car_park = trust_association.DATA / "acfr_car_park"
    yield from trust_hints.rows(quick, str(car_park) if car_park.is_dir() and not quick else "")
    yield from trust_bands.rows(quick)


if __name__ == "__main__":
    sys.exit(print_table(rows(options(__doc__, quick=False).quick)))
