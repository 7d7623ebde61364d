"""Are hints right, and is single precision taken for what it is?

    python -m benchmarks.trust_hints [--quick] [--log FOLDER] [--list] [--only WORD]
                                     [--held-out]

A foreign filter (comparisons.experiments.foreign) is given one fault at a time, its trace is
checked, and the hint is judged: right, general (none, or the general advice), or wrong. A part of a
hint that is neither the fault nor a consequence of it makes the whole hint wrong. --log adds a real
log, such as the car park's; --list prints every hint.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.fault_logs import open_case
from benchmarks.foreign_faults import FAULTS, HELD_OUT, Fault
from benchmarks.foreign_filter import Foreign, in_single
from benchmarks.trust_row import Row, print_table
from comparisons.adapters.ekf_run import run_ekf
from comparisons.arrays import Array
from comparisons.checks.causes import ALGEBRA_HINT, FITTED, MODEL_HINT
from comparisons.config import CheckConfig, EkfConfig, SolveConfig
from comparisons.estimates.external import read_external
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.pipeline.external_trace import TraceCheck, check_trace
from comparisons.pipeline.prepare import Prepared, prepare
from graphslam.smoother import SmootherOptions

IN_SINGLE = "computes in single precision"


@dataclass(frozen=True)
class Case:
    """A log, and a sound foreign filter for it. kinds: of faults that it can show."""

    name: str
    prepared: Prepared[SolveConfig]
    sound: Foreign
    kinds: tuple[str, ...]


def case(name: str, log: Log, choices: EkfConfig, *kinds: str) -> Case:
    """With the reference filter's association."""
    prepared: Prepared[SolveConfig] = prepare(log, CheckConfig(gps=choices.gps), choices)
    p = prepared
    landmark_index = run_ekf(p.log, p.timeline, p.ekf, p.positions).landmark_index
    return Case(
        name,
        p,
        Foreign(
            log=p.log, timeline=p.timeline, landmark_index=landmark_index, positions=p.positions
        ),
        ("any", *kinds),
    )


def simulated(seed: int = 4) -> Case:
    """A loop of 60 s with positions; its vehicle steers."""
    return case("simulated loop", *open_case("positions", seed), "car", "positions")


def recorded(folder: str) -> Case:
    """A log of a folder."""
    log = open_log(folder, None, 1, SimulationChoices())
    steers = hasattr(log.odometry, "vehicle")
    return case(Path(folder).name, replace(log, positions=None), EkfConfig(),
                *(("car",) if steers else ()))  # fmt: skip


def checked(one: Foreign, prepared: Prepared[SolveConfig], *, stored_single: bool = False
            ) -> TraceCheck:  # fmt: skip
    """Run a filter, hand in what it leaves, check that."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        one.run(folder)
        if stored_single:
            in_single(folder)
        return check_trace(read_external(folder), prepared, SmootherOptions())


def hint_parts(check: TraceCheck) -> list[str]:
    """What the hints of the filter's own gaps say in particular; nothing for general advice."""
    parts: list[str] = []
    for cause in check.verdict.causes:
        if "is wrong, the other row is right" in cause.hint:
            continue  # right, and little more than general advice
        if cause.gap == "data":
            parts.append(cause.evidence)
        elif cause.gap == "model" and cause.hint.startswith(FITTED):
            parts += cause.hint.removeprefix(FITTED).split("; ")
        elif cause.gap in ("model", "algebra") and cause.hint not in (ALGEBRA_HINT, MODEL_HINT):
            parts.append(cause.hint)
    return parts


def judge_hints(
    cases: Iterable[Case], faults: Sequence[Fault], *, listed: bool = False
) -> Counter[str]:
    """Count right, general and wrong hints, and faults that pass unseen."""
    found: Counter[str] = Counter()
    for one in cases:
        for fault in faults:
            if fault.log not in one.kinds:
                continue
            check = checked(fault.plant(one.sound), one.prepared)
            gaps = [cause.gap for cause in check.verdict.causes]
            caught = bool({"data", "algebra", "model"} & set(gaps))
            how = fault.judge(hint_parts(check)) if caught else "unseen"
            found[how] += 1
            if listed:
                said = "; ".join(hint_parts(check))
                print(f"{one.name:<15} {fault.name:<38} {how:<8} {said}", flush=True)
    return found


@dataclass(frozen=True)
class Precisions:
    """Verdicts on sound filters, and on one that drops covariances, by how numbers are kept."""

    stored: int = 0
    computed: int = 0
    dropped: int = 0
    total: int = 0


def forgets_map(one: Foreign, p: Array, before: int) -> Array:
    """Return the covariance without that of the vehicle with the map, a hundredth of it."""
    p[:3, 3:] *= 0.99
    p[3:, :3] *= 0.99
    return p


def judge_precisions(cases: Iterable[Case], *, listed: bool = False) -> Precisions:
    """Count what is called by its name.

    stored: agrees. computed: agrees, or is named a computation in single precision. dropped: an
    algebra gap, stored in single precision, that is not called a matter of precision.
    """
    found = Precisions()
    for one in cases:
        single = replace(one.sound, dtype=np.float32)
        causes = [
            [c for c in check.verdict.causes if c.gap in ("data", "algebra", "model")]
            for check in (
                checked(one.sound, one.prepared, stored_single=True),
                checked(single, one.prepared),
                checked(replace(one.sound, keep=forgets_map), one.prepared, stored_single=True),
            )
        ]
        stored, computed, dropped = causes
        if listed:
            for how, listing in zip(("stored", "computed", "dropped"), causes, strict=True):
                print(one.name, how, [c.hint for c in listing] or "agrees", flush=True)
        found = Precisions(
            found.stored + (not stored),
            found.computed + all(IN_SINGLE in c.hint for c in computed),
            found.dropped + (bool(dropped) and not any(IN_SINGLE in c.hint for c in dropped)),
            found.total + 1,
        )
    return found


def sound_hints(cases: Iterable[Case]) -> tuple[int, int]:
    """Count hints on sound filters, and these."""
    found = [len(hint_parts(checked(one.sound, one.prepared))) for one in cases]
    return sum(map(bool, found)), len(found)


def rows(quick: bool = False, folder: str = "") -> list[Row]:
    """Return the table's rows. quick: a part of the faults, one loop. folder: of a real log."""
    cases = [simulated(), *([recorded(folder)] if folder else [])]
    step = 8 if quick else 1
    found = judge_hints(cases, FAULTS[::step])
    held = judge_hints(cases, HELD_OUT[:: min(step, 2)])
    loops = [simulated(seed) for seed in range(1 if quick else 20)]
    precision = judge_precisions([*loops, *cases[1:]])
    false, sound = sound_hints([*loops, *cases[1:]])
    table = []
    for name, counts, share in (
        ("faults written before the hints", found, 0.9), ("faults held out", held, 0.5),
    ):  # fmt: skip
        total = sum(counts.values())
        table.append(
            Row(
                f"hints on {name}, with a trace",
                f"{share:.0%} named right, none wrong",
                ", ".join(f"{counts[how]} {how}" for how in ("right", "general", "wrong", "unseen"))
                + f" of {total}",
                counts["right"] >= share * total and not counts["wrong"],
            )
        )
    table.append(Row("no hint on sound filters", "0", f"{false} of {sound}", not false))
    n = precision.total
    for what, asked, count in (
        ("stored in single precision, sound", "no fault", precision.stored),
        ("computed in single precision", "named as such, or agrees", precision.computed),
        ("stored in single precision, 1 % of a covariance dropped", "an algebra gap",
         precision.dropped),
    ):  # fmt: skip
        table.append(Row(what, f"{asked} in all", f"{count} of {n}", count == n))
    return table


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--log", default="", help="a real log's folder")
    parser.add_argument("--only", default="", help="faults whose name holds this")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--held-out", action="store_true", help="faults the hints never saw")
    options = parser.parse_args()
    cases = [simulated(), *([recorded(options.log)] if options.log else [])]
    faults = [
        fault for fault in (HELD_OUT if options.held_out else FAULTS) if options.only in fault.name
    ]
    if options.list:
        print(judge_hints(cases, faults, listed=True))
        print(judge_precisions(cases, listed=True))
    else:
        print_table(rows(options.quick, options.log))


if __name__ == "__main__":
    main()
