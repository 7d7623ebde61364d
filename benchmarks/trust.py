"""What the verdict promises, and what was measured of it, as one table.

    python -m benchmarks.trust [--quick]

The parts can be run alone: trust_sound.py, trust_optimum.py, trust_association.py, trust_check.py,
trust_hints.py, trust_bands.py. --quick takes a few of each, some minutes; in full it is an hour or
more on one core. Rows of real logs come where ../shared/data is there.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from benchmarks import (
    trust_association,
    trust_bands,
    trust_check,
    trust_hints,
    trust_optimum,
    trust_sound,
)
from benchmarks.trust_row import Row, print_table


def rows(quick: bool) -> Iterator[Row]:
    """Of every part, in the order of docs/verdicts.md."""
    for part in (trust_sound, trust_optimum, trust_association, trust_check):
        yield from part.rows(quick)
    car_park = trust_association.DATA / "acfr_car_park"
    yield from trust_hints.rows(quick, str(car_park) if car_park.is_dir() and not quick else "")
    yield from trust_bands.rows(quick)


def main() -> None:
    """Print the table; exit with 1 where a promise does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_AS_WRITTEN)
    parser.add_argument("--quick", action="store_true", help="a few logs of each part")
    raise SystemExit(0 if print_table(rows(parser.parse_args().quick)) else 1)


_AS_WRITTEN = argparse.RawDescriptionHelpFormatter

if __name__ == "__main__":
    main()
