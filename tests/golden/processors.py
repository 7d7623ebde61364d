"""What moves between processors: `python -m tests.golden.processors` runs golden cases as on them.

By kind of figure, and by flavour (`benchmarks/flavours.py`), the largest change against this
processor, in which run and in which figure. Words must be equal. Ten minutes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.flavours import flavours
from tests.golden.cases import CASES
from tests.golden.fingerprint import COVARIANCE, EXACT, GAP, OPTIMUM, Kind, kind_of, parts

RUNS = (
    *(name for name, case in CASES.items() if case.quick),
    "loop-gnc",
    "loop-isam2",
    "car-park-scan",
    "car-park-trees",
    "mrclam-2",
    "scan-slam-own",
    "scan-slam-fused",
    "scan-slam-enriched",
    "solve",
)
KINDS = {
    "logs and filters": EXACT,
    "the optimum": OPTIMUM,
    "its covariances": COVARIANCE,
    "gaps": GAP,
}
_RUN = "from pathlib import Path; from tests.golden import cases, run; " + (
    "[run.run_case(cases.CASES[name], Path(sys.argv[1])) for name in sys.argv[2:]]"
)


class Change(NamedTuple):
    """The change relative to its column's size, in the figure's unit, and where it is."""

    of_size: float
    apart: float
    where: str


def changes(first: Path, second: Path) -> Iterator[tuple[Kind | None, Change]]:
    """What differs between two folders of a run; of no kind where it is words, or a count."""
    for one, other in zip(parts(first, ""), parts(second, ""), strict=True):
        columns, others = one.columns, other.columns
        where = f"{first.name}, {one.name}"
        if (one.name, one.words, list(columns)) != (other.name, other.words, list(others)):
            yield None, Change(np.inf, np.inf, where)
            continue
        for name, values in columns.items():
            kind = kind_of(one.name + name)
            if len(values) != len(others[name]):
                yield None, Change(np.inf, np.inf, where + name)
            elif len(values):
                apart = np.nan_to_num(np.abs(values - others[name])).max()
                size = kind.size(np.nan_to_num(values))
                yield kind, Change(apart / size, apart, where + name)


def main() -> int:
    """Print the table; 1 where words or counts differ."""
    with tempfile.TemporaryDirectory() as work:
        for name, environment in flavours().items():
            command = [sys.executable, "-c", f"import sys; {_RUN}", str(Path(work, name)), *RUNS]
            subprocess.run(command, env={**os.environ, **environment}, check=True)
        this, *names = flavours()
        print("| as on | figures | largest change | of its column | where |")
        print("| --- | --- | --- | --- | --- |")
        differ = []
        for name in names:
            found = [
                change
                for run in RUNS
                for change in changes(Path(work, this, run), Path(work, name, run))
            ]
            differ += [f"{name}: {change.where}" for kind, change in found if kind is None]
            for words, kind in KINDS.items():
                size, apart, where = max(change for of, change in found if of is kind)
                print(f"| {name} | {words} | {apart:.1e} | {size:.1e} | {where} |")
    print()
    print("\n".join(differ) or f"All words, verdicts and counts of {len(RUNS)} runs are equal.")
    return bool(differ)


if __name__ == "__main__":
    sys.exit(main())
