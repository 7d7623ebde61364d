"""Cases by their seed, tried one after the other from the command line."""

from __future__ import annotations

import sys
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple


class Ending(NamedTuple):
    """What became of a case. kind: to be counted. wrong: what is printed of a wrong one."""

    kind: str
    wrong: str = ""


def try_all(case: Callable[[int, Path], Ending], usual: int) -> int:
    """Try the seeds that the command line asks for, and say what came of them.

    Args:
        case: Tries a seed in a folder; may raise anything.
        usual: How many are tried where the command line says nothing; COUNT, or FIRST END.

    Returns:
        1 where a case raises or is wrong, else 0.
    """
    seeds = range(*([int(word) for word in sys.argv[1:]] or [usual]))
    ends: Counter[str] = Counter()
    bad = 0
    with TemporaryDirectory() as place:
        for seed in seeds:
            try:
                ending = case(seed, Path(place))
            except Exception:
                lines = [line.strip() for line in traceback.format_exc().splitlines()]
                ending = Ending(f"raised: {' '.join(lines[-3:])[:200]}", f"raised {lines[-1]}")
            ends[ending.kind] += 1
            if ending.wrong:
                bad += 1
                print(f"{seed}: {ending.wrong}")
    for kind, count in ends.most_common():
        print(f"{count:6,}  {kind}")
    return int(bad > 0)
