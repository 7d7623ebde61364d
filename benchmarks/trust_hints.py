"""Are hints right, and is single precision taken for what it is?

    python benchmarks/trust_hints.py [--quick] [--log FOLDER] [--list] [--only WORD]
                                     [--held-out]

A foreign filter (comparisons.experiments.foreign) is given one fault at a time, its trace is
checked, and the hint is judged: right, general (none, or the general advice), or wrong. A part of a hint that is
neither the fault nor a consequence of it makes the whole hint wrong. --log adds a real log, such as
the car park's; --list prints every hint.
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

from comparisons.adapters.ekf_run import run_ekf
from comparisons.config import CheckConfig, EkfConfig, SolveConfig
from comparisons.estimates.external import read_given
from comparisons.experiments.defects.logs import open_case
from comparisons.experiments.foreign.faults import FAULTS, HELD_OUT, Fault
from comparisons.experiments.foreign.filter import Foreign, in_single
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.pipeline.given_trace import TraceCheck, check_trace
from comparisons.pipeline.prepare import Prepared, prepare
from graphslam.smoother import SmootherOptions

AS_IF = "the records are as if: "
GENERAL = "look for "


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
    slot = run_ekf(p.log, p.timeline, p.ekf, p.positions).slot
    return Case(name, p, Foreign(p.log, p.timeline, slot, p.positions), ("any", *kinds))


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
        return check_trace(read_given(folder), prepared, SmootherOptions())


def hint_parts(check: TraceCheck) -> list[str]:
    """What the hints of the filter's own gaps say in particular; nothing for general advice."""
    parts: list[str] = []
    for cause in check.verdict.causes:
        if "is wrong, the other is right" in cause.hint:
            continue  # right, and little more than general advice
        if cause.gap == "data":
            parts.append(cause.evidence)
        elif cause.gap == "model" and cause.hint.startswith(AS_IF):
            parts += cause.hint.removeprefix(AS_IF).split("; ")
        elif cause.gap in ("model", "algebra") and not cause.hint.startswith(GENERAL):
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
    print(judge_hints(cases, faults, listed=options.list))


if __name__ == "__main__":
    main()
