"""What the verdict promises, and what was measured of it, as one table.

    python -m research.trust [--quick]

The parts can be run alone: sound, damaged, optimum, association, check, hints, bands, as
`python -m research.trust.sound`. --quick takes a few of each, some minutes; in full it is an hour
or more on one core.
Rows of real logs come where ../shared/data is there. The exit code is 1 where a promise does not
hold.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

from research.script import options
from research.trust import (
    association,
    bands,
    check,
    damaged,
    hints,
    optimum,
    sound,
)
from research.trust.row import PromiseRow, print_table


def rows(quick: bool) -> Iterator[PromiseRow]:
    """Of every part, in the order of docs/verdicts.md."""
    for part in (sound, damaged, optimum, association, check):
        yield from part.rows(quick)
    car_park = association.DATA / "acfr_car_park"
    yield from hints.rows(quick, str(car_park) if car_park.is_dir() and not quick else "")
    yield from bands.rows(quick)


if __name__ == "__main__":
    sys.exit(print_table(rows(options(__doc__, quick=False).quick)))
