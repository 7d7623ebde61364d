"""The same work by us and by others, side by side, by processor time.

    python -m research.peers [--only NAME ...] [--repeat 5] [--quick] [--json FILE]

Each pair is measured in turns: ours, the peer's, ours, and so on. Times are medians, in
milliseconds by the unit that the work names. The ratio is ours over the peer's processor time,
median, least and largest of the repetitions. OPENBLAS_NUM_THREADS is 1 for all. Peers that are not
installed are named with what installs them; `make peers` installs what PyPI has.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path

from research.timing import MissingError, PairTimes, TimedPair, interleaved, median

SOURCES = {
    "mrpt": "research.peers.mrpt",
    "gtsam": "research.peers.gtsam",
    "dense-ekf": "research.peers.dense_ekf",
    "filterpy": "research.peers.filterpy",
    "trajectory": "research.peers.trajectory",
    "grid": "research.peers.grid",
}
"""Modules with `rows(quick=...)`, which returns pairs or raises MissingError."""


def pairs_of(name: str, *, quick: bool) -> Sequence[TimedPair]:
    """Return the pairs of a source. Raises MissingError for a peer or a module."""
    module = SOURCES[name]
    try:
        found = import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("research"):
            raise MissingError(f"{error.name} not installed: make peers") from None
        raise MissingError(f"no module {module}") from None
    pairs: Sequence[TimedPair] = found.rows(quick=quick)
    return pairs


def line(pair: TimedPair, measured: PairTimes) -> str:
    """Return a row of the table."""
    count, unit = pair.parts
    mine, other = median(measured.ours), median(measured.theirs)
    times = [1e3 * s / count for s in (mine.cpu_s, other.cpu_s, mine.wall_s, other.wall_s)]
    ratios, repeats = measured.ratios, len(measured.ours)
    goal, met = "", ""
    if pair.goal is not None:
        goal, met = f"{pair.goal:g}", "yes" if measured.ratio <= pair.goal else "no"
    shown = " | ".join(f"{one:.4g}" for one in times)
    spread = f"{measured.ratio:.3f} | {min(ratios):.3f} to {max(ratios):.3f}"
    return (
        f"| {pair.name} | {pair.work} | {unit} | {shown} | {spread} | {goal} | {met} | {repeats} |"
    )


TITLES = (
    "pair", "work", "ms of the processor by", "ours", "peer's", "wall: ours", "peer's", "ratio",
    "least to largest", "goal", "met", "repetitions",
)  # fmt: skip


def table(
    names: Sequence[str], repeat: int, *, quick: bool, kept: list[dict[str, object]]
) -> Iterator[str]:
    """Yield the lines of the table as they are measured, then the notes and what is skipped.

    kept: receives the same as data.
    """
    yield "| " + " | ".join(TITLES) + " |"
    yield "|" + " --- |" * len(TITLES)
    notes, skipped = [], []
    for name in names:
        try:
            pairs = pairs_of(name, quick=quick)
        except MissingError as missing:
            skipped.append(f"skipped: {name}: {missing}")
            continue
        for pair in pairs:
            times = 1 if quick else min(repeat, pair.repeat or repeat)
            try:
                measured = interleaved(pair.ours, pair.theirs, times)
                found = tuple(pair.notes())
            except RuntimeError as error:
                skipped.append(f"failed: {pair.name}: {error}")
                continue
            yield line(pair, measured)
            notes += [f"{pair.name}: {note}" for note in found]
            kept.append(
                {
                    "name": pair.name,
                    "work": pair.work,
                    "unit": pair.parts[1],
                    "ratios": measured.ratios,
                    "goal": pair.goal,
                    "ours_cpu_s": [one.cpu_s for one in measured.ours],
                    "theirs_cpu_s": [one.cpu_s for one in measured.theirs],
                    "notes": found,
                }
            )
    yield ""
    yield f"OPENBLAS_NUM_THREADS={os.environ['OPENBLAS_NUM_THREADS']} for all."
    yield from (*notes, *skipped)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m research.peers", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--only", nargs="+", choices=SOURCES, default=list(SOURCES), metavar="NAME")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="small work, once: a test")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep every repetition's times")
    choices = parser.parse_args()
    if choices.repeat < 1:
        parser.error(f"--repeat {choices.repeat}: expected at least 1")
    kept: list[dict[str, object]] = []
    for text in table(choices.only, choices.repeat, quick=choices.quick, kept=kept):
        print(text, flush=True)
    if choices.json:
        choices.json.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
