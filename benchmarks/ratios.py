"""Ratios of processor time, compared with those kept: what has become slower?

    python -m benchmarks.ratios [--only NAME ...] [--keep] [--file benchmarks/ratios.toml]

Each benchmark is our work over a reference, measured in turns in the same minutes; a ratio carries
from machine to machine better than a time, not perfectly. The median of five repetitions counts;
one that seems to have fallen back is measured once more, and the better median counts. A ratio
above the kept one by more than its tolerance is named, and the exit code is 1. --keep writes the
new ratios; those of references that are not installed stay. `make bench` runs this.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import datetime
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from benchmarks.peer_pairs import (
    ROOT,
    MissingError,
    Side,
    Spent,
    here,
    interleaved,
    program,
    scratch,
)
from benchmarks.peers import pairs_of

FILE = ROOT / "benchmarks" / "ratios.toml"
TOLERANCE = 0.2
REPEAT = 5
LOG = "simulated-loop"


class RatiosError(Exception):
    """The file cannot be used: what, where, and how to mend it, in one line."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Kept(_Strict):
    """A ratio as it was measured; tolerance: the share by which a new one may be greater."""

    name: str = Field(min_length=1)
    ratio: float = Field(gt=0.0, allow_inf_nan=False)
    commit: str = Field(pattern=r"^[0-9a-f]{7,40}$")
    date: datetime.date
    tolerance: float = Field(default=TOLERANCE, gt=0.0, lt=1.0)


class _File(_Strict):
    ratio: tuple[Kept, ...] = ()


Sides = tuple[Side, Side]
Make = Callable[[], Sides]
"""Builds our work and its reference. Raises MissingError where the reference is not installed."""


def read(path: Path, known: Sequence[str]) -> dict[str, Kept]:
    """Return the kept ratios by name. Raises RatiosError."""
    try:
        file = _File.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise RatiosError(f"{path.name}: no such file; make it with --keep") from None
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(map(str, fault["loc"]))
        raise RatiosError(f"{path.name}: {place}: {fault['msg'].lower()}") from None
    except (OSError, ValueError) as error:
        raise RatiosError(f"{path.name}: {error}") from None
    found: dict[str, Kept] = {}
    for one in file.ratio:
        if one.name not in known:
            raise RatiosError(f"{path.name}: {one.name}: no such benchmark; take it out")
        if one.name in found:
            raise RatiosError(f"{path.name}: {one.name}: stands there twice, expected once")
        found[one.name] = one
    return found


def write(kept: Mapping[str, Kept], path: Path) -> None:
    """Write the ratios."""
    text = "# Ratios of processor time, ours over the reference: `make bench KEEP=1` writes them.\n"
    for one in kept.values():
        text += (
            f'\n[[ratio]]\nname = "{one.name}"\nratio = {one.ratio:.4g}\ncommit = "{one.commit}"\n'
            f"date = {one.date}\ntolerance = {one.tolerance:g}\n"
        )
    path.write_text(text, encoding="utf-8")


@dataclass(frozen=True)
class Found:
    """What became of a benchmark: its line, the new ratio if it was measured, whether it fell."""

    line: str
    ratio: float | None = None
    fallen: bool = False


def compare(name: str, make: Make, kept: Kept | None, repeat: int = REPEAT) -> Found:
    """Measure a benchmark and compare it with the kept ratio.

    Args:
        name: Of the benchmark.
        make: Builds it.
        kept: None where nothing was kept.
        repeat: Repetitions, of which the median counts.

    Returns:
        A line for the reader, and whether the ratio is above the kept one's tolerance twice, or a
        program failed.
    """
    try:
        ours, reference = make()
        measured = interleaved(ours, reference, repeat)
        if kept is not None and measured.ratio > kept.ratio * (1.0 + kept.tolerance):
            again = interleaved(ours, reference, repeat)
            measured = min(measured, again, key=lambda one: one.ratio)
    except MissingError as missing:
        return Found(f"{name}: skipped: {missing}")
    except RuntimeError as error:
        return Found(f"{name}: FAILED: {error}", fallen=True)
    ratio, ratios = measured.ratio, measured.ratios
    line = f"{name}: {ratio:.4g} ({min(ratios):.4g} to {max(ratios):.4g})"
    if kept is None:
        return Found(f"{line}, none kept", ratio)
    change = ratio / kept.ratio - 1.0
    line += f", kept {kept.ratio:.4g} of {kept.date}: {100.0 * change:+.0f} %"
    if change > kept.tolerance:
        return Found(f"{line}, SLOWER by more than {100.0 * kept.tolerance:.0f} %", ratio, True)
    return Found(line, ratio)


def peer(source: str, *, quick: bool = False) -> Make:
    """Return the first pair of a source of `benchmarks/peers.py`."""

    def make() -> Sides:
        pair = pairs_of(source, quick=quick)[0]
        return pair.ours, pair.theirs

    return make


def compressed(landmarks: int, scans: int) -> Make:
    """One scan of the compressed EKF, over the full one."""

    def make() -> Sides:
        from benchmarks.map_size import measure

        def side(kind: str) -> Side:
            def once() -> Spent:
                scan_ms, _ = measure(kind, landmarks, scans)
                return Spent(1e-3 * scan_ms, 0.0)

            return once

        return side("compressed"), side("full")

    return make


def ekf() -> Sides:
    """The full EKF by nearest neighbour through a simulated log, over products of matrices."""
    from comparisons.adapters.ekf_factory import build_ekf, settle
    from comparisons.adapters.filter_loop import run_filter_loop
    from comparisons.adapters.timeline import build_timeline
    from comparisons.config import EkfConfig
    from comparisons.logs.bundled import open_log
    from ekf_reference.core.trace import Trace

    log = open_log(LOG)
    timeline, config = build_timeline(log), settle(EkfConfig(association="nn"), log)

    def ours() -> None:
        for _ in run_filter_loop(build_ekf(log, config, Trace()), log, timeline):
            pass

    return here(ours), here(matrix_products)


def matrix_products() -> None:
    """A fixed amount of small and middling products, as a filter's steps are."""
    small, large = np.eye(3), np.eye(100)
    for _ in range(500):
        for _ in range(100):
            small = small @ small
        large = large @ large


def own_association() -> Sides:
    """`solve` with the smoother's own association, over `solve` with the log's labels."""
    from slamcheck import load_log, solve

    log = load_log(LOG)
    return here(lambda: solve(log, association="own")), here(lambda: solve(log))


def whole_run() -> Sides:
    """`slamcheck run` with its report, over the comparison alone."""
    folder = scratch()
    code = f"import slamcheck; slamcheck.compare(slamcheck.load_log({LOG!r}))"
    words = sys.executable, "-m", "slamcheck", "run", LOG, "--out", folder / "run"
    return program(*words, fine=(0, 1, 3)), program(sys.executable, "-c", code)


def help_page() -> Sides:
    """`slamcheck --help`, over Python doing nothing."""
    return program(sys.executable, "-m", "slamcheck", "--help"), program(
        sys.executable, "-c", "pass"
    )


BENCHMARKS: dict[str, Make] = {
    "smoother over bare gtsam": peer("gtsam"),
    "compressed over full EKF, 70 landmarks": compressed(70, 60),
    "compressed over full EKF, 2000 landmarks": compressed(2000, 10),
    "EKF over matrix products": ekf,
    "own association over labels in solve": own_association,
    "run with report over compare": whole_run,
    "help page over bare Python": help_page,
    "linear filter over filterpy": peer("filterpy"),
    "EKF over kf-slam": peer("mrpt"),
    "trajectory check over evo": peer("trajectory", quick=True),
    "occupancy grid over MRPT": peer("grid", quick=True),
}


def compare_all(names: Sequence[str], kept: Mapping[str, Kept]) -> Iterator[tuple[str, Found]]:
    """Yield each benchmark's name and what became of it."""
    for name in names:
        yield name, compare(name, BENCHMARKS[name], kept.get(name))


def _commit() -> str:
    words = ["git", "rev-parse", "--short=10", "HEAD"]
    found = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    return found.stdout.strip()


def main() -> None:
    """Compare, and exit with 1 where something is slower."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ratios", description=__doc__.splitlines()[0]
    )
    every = list(BENCHMARKS)
    parser.add_argument("--only", nargs="+", choices=every, default=every, metavar="NAME")
    parser.add_argument("--keep", action="store_true", help="write the new ratios")
    parser.add_argument("--file", type=Path, default=FILE)
    choices = parser.parse_args()
    try:
        kept = {} if choices.keep and not choices.file.exists() else read(choices.file, every)
    except RatiosError as error:
        print(f"ratios: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    slower, today = [], datetime.datetime.now(datetime.UTC).date()
    for name, found in compare_all(choices.only, kept):
        print(found.line, flush=True)
        if choices.keep and found.ratio is not None:
            tolerance = kept[name].tolerance if name in kept else TOLERANCE
            kept[name] = Kept(
                name=name, ratio=found.ratio, commit=_commit(), date=today, tolerance=tolerance
            )
        elif found.fallen:
            slower.append(found.line)
    if choices.keep:
        write({name: kept[name] for name in every if name in kept}, choices.file)
    elif slower:
        print("\n".join(("", "slower than kept, or failed:", *slower)), file=sys.stderr)
        raise SystemExit(1)


if __name__ == "__main__":
    main()
