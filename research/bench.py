"""What has become slower than at a commit? Its code and the tree's in turns, by processor time.

    python -m research.bench [BASE ...] [--only NAME ...] [--repeat 5]

The bases are by default main and the last release, so that a little with each change does not add
up unseen. The code of a base is put into build/bench. Each job runs with that and with the tree's,
in processes of their own, by turns: what else the machine does slows both alike, and how fast it is
does not count. A job is slower where the median of the ratios is above 1 by more than the tolerance
in two measurements. The exit code is 1 where one is, or fails with the tree's code.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from research.timing import ROOT, Side, Spent, interleaved, run, scratch
from tests.golden.same import check_out

PLACE = ROOT / "build" / "bench"
TOLERANCE = 0.1
REPEAT = 5
JOBS = {
    "start": "--help",
    "full EKF, smoother, report": "run simulated-loop --association nn",
    "compressed EKF": "run simulated-loop --filter compressed --association known",
    "own association": "solve simulated-loop --association own",
    "smoother": "solve victoria-park",
    "scan odometry": "odometry scan-loop-fine",
    "dense map": "map scan-loop",
    "Monte Carlo": "montecarlo circle --runs 25 --filters ekf,riekf --workers 1",
}
"""Command lines of slamcheck, by name."""


@dataclass(frozen=True)
class JobTiming:
    """What became of a job: its line, and whether the tree is slower or fails."""

    line: str
    fallen: bool = False


def compare(name: str, tree: Side, base: Side, repeat: int = REPEAT) -> JobTiming:
    """Measure a job with the tree's code and with the base's.

    Args:
        name: Of the job.
        tree: Does it with the tree's code.
        base: With the base's.
        repeat: Repetitions, of which the median counts.

    Returns:
        A line for the reader, and whether the tree is slower twice, or a side failed.
    """
    try:
        measured = interleaved(tree, base, repeat)
        if measured.ratio > 1.0 + TOLERANCE:
            again = interleaved(tree, base, repeat)
            measured = min(measured, again, key=lambda one: one.ratio)
    except RuntimeError as error:
        return JobTiming(f"{name}: FAILED: {error}", fallen=True)
    ratio, ratios = measured.ratio, measured.ratios
    seconds = sum(one.cpu_s for one in measured.ours) / len(measured.ours)
    line = (
        f"{name}: {seconds:.2f} s, {100.0 * (ratio - 1.0):+.0f} % "
        f"({100.0 * (min(ratios) - 1.0):+.0f} to {100.0 * (max(ratios) - 1.0):+.0f} %)"
    )
    if ratio > 1.0 + TOLERANCE:
        return JobTiming(f"{line}, SLOWER by more than {100.0 * TOLERANCE:.0f} %", fallen=True)
    return JobTiming(line)


def side(words: str, code: Path, out: Path) -> Side:
    """Return what runs slamcheck with the code in a folder; out: a folder of its own."""
    writes = () if words.startswith("-") else ("--out", out)

    def once() -> Spent:
        shutil.rmtree(out, ignore_errors=True)
        command = (sys.executable, "-m", "slamcheck", *words.split(), *writes)
        return run(command, fine=(0, 1, 3), code=code).spent

    return once


def compare_all(names: Sequence[str], make: Callable[[str], tuple[Side, Side]], repeat: int) -> int:
    """Print a line for each job; return 1 where one is slower or fails."""
    fallen = []
    for name in names:
        found = compare(name, *make(name), repeat)
        print(found.line, flush=True)
        fallen += [found.line] * found.fallen
    if fallen:
        print("\n".join(("", "slower than the base, or failed:", *fallen)), file=sys.stderr)
    return int(bool(fallen))


def main() -> None:
    """Compare, and exit with 1 where something is slower."""
    parser = argparse.ArgumentParser(
        prog="python -m research.bench", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "bases", nargs="*", metavar="BASE", help="a commit; main and the last release if left out"
    )
    parser.add_argument("--only", nargs="+", choices=JOBS, default=list(JOBS), metavar="NAME")
    parser.add_argument("--repeat", type=int, default=REPEAT)
    choices = parser.parse_args()
    slower = 0
    for base in choices.bases or ("main", last_release()):
        shutil.rmtree(PLACE, ignore_errors=True)
        try:
            check_out(base, PLACE)
        except subprocess.CalledProcessError as error:
            print(f"bench: {base}: {error.stderr.decode().strip()}", file=sys.stderr)
            raise SystemExit(2) from None
        print(f"beside {base}:", flush=True)
        slower |= compare_all(choices.only, _sides, choices.repeat)
    raise SystemExit(slower)


def last_release() -> str:
    """Return the commit that changed the version last."""
    words = ("git", "log", "-1", "--format=%h", "-G^version = ", "--", "pyproject.toml")
    said = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True)
    return said.stdout.strip()


def _sides(name: str) -> tuple[Side, Side]:
    """Return what runs a job with the tree's code, and with the base's."""
    work = scratch()
    return side(JOBS[name], ROOT, work / "tree"), side(JOBS[name], PLACE, work / "base")


if __name__ == "__main__":
    main()
