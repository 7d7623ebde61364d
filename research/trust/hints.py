"""Are hints right, and is single precision taken for what it is?

    python -m research.trust.hints [--quick] [--log FOLDER] [--list] [--only WORD]
                                     [--held-out]

A stranger's filter (strangers.py beside this) is given one fault at a time, its trace is checked,
and the hint is judged: right, general (none, or the general advice), or wrong. A part of a hint
that is neither the fault nor a consequence of it makes the whole hint wrong. --log adds a real log,
such as the car park's; --list prints every hint on faults whose names hold the word, or that the
hints never saw.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from comparisons.adapters.ekf_run import run_ekf
from comparisons.arrays import Array
from comparisons.checks import algebra, model
from comparisons.config import CheckConfig, EkfConfig, SolveConfig
from comparisons.estimates.external import read_external
from comparisons.estimates.planar_trace import TRACE
from comparisons.jobs.external_trace import TraceCheck, check_trace, trace_run
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.logs.log_folder import write_log_folder
from comparisons.logs.odometry import SteeringOdometry
from comparisons.pipeline.prepare import prepare
from comparisons.pipeline.prepared import Prepared
from comparisons.trace.events import Event
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import Recorder
from graphslam.smoother import SmootherOptions
from research.script import options
from research.trust.drives import open_case
from research.trust.row import PromiseRow, print_table
from research.trust.stranger_faults import FORGETFUL, HELD_OUT, HINTS, StrangerFault
from research.trust.strangers import Car, Single, TextbookEkf, read_log
from research.trust.strangers import StrangerLog as Read

IN_SINGLE = "computes in single precision"


@dataclass(frozen=True)
class HintCase:
    """A log, prepared and as a stranger reads it, and a sound filter. kinds: of faults it shows."""

    name: str
    prepared: Prepared[SolveConfig]
    log: Read
    sound: type[TextbookEkf]
    kinds: tuple[str, ...]


def case(name: str, log: Log, choices: EkfConfig, *kinds: str) -> HintCase:
    """Return a case of a log with labels."""
    prepared: Prepared[SolveConfig] = prepare(log, CheckConfig(gps=choices.gps), choices)
    with tempfile.TemporaryDirectory() as folder:
        write_log_folder(log, Path(folder) / "log")
        read = read_log(Path(folder) / "log")
    steers = isinstance(log.odometry, SteeringOdometry)
    return HintCase(
        name, prepared, read, Car if steers else TextbookEkf, ("any", *["car"] * steers, *kinds)
    )


def simulated(seed: int = 4, loop_s: float = 60.0) -> HintCase:
    """Return a loop with positions; its vehicle steers."""
    return case("simulated loop", *open_case("positions", seed, loop_s), "positions")


def recorded(folder: str) -> HintCase:
    """Return a log of a folder, labelled as the reference filter associates."""
    log = replace(open_log(folder, None, 1, SimulationChoices()), positions=None)
    p: Prepared[SolveConfig] = prepare(log, CheckConfig(), EkfConfig())
    index = run_ekf(p.log, p.timeline, p.ekf, p.positions).landmark_index
    seen = p.log.measurements.chosen(index >= 0)
    labelled = replace(p.log, measurements=replace(seen, landmark=index[index >= 0]))
    return case(Path(folder).name, labelled, EkfConfig(association="known"))


def checked(kind: type[TextbookEkf], one: HintCase, *, stored_single: bool = False) -> TraceCheck:
    """Run a filter, hand in what it leaves, check that."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "mine"
        kind(one.log).run().write(folder, traced=True)
        if stored_single:
            in_single(folder)
        given = read_external(folder)
        followed = trace_run(given, one.prepared)
        return check_trace(given, followed, one.prepared, SmootherOptions())


def _rounded(event: Event) -> dict[str, Array]:
    """Return an event's numbers in single precision; numbers of measurements stay whole."""
    return {
        name: value.astype(np.float32)
        for name, value in event._asdict().items()
        if isinstance(value, np.ndarray) and name != "numbers"
    }


def in_single(folder: Path) -> None:
    """Store in single precision what a folder holds in double."""
    with np.load(folder / "covariances.npz") as archive:
        arrays = {key: a.astype(np.float32) for key, a in archive.items()}
    np.savez(folder / "covariances.npz", **arrays)
    events = list(TraceReader(folder / TRACE))
    (folder / TRACE).unlink()
    with Recorder(folder / TRACE) as record:
        for event in events:
            record.event(event._replace(**_rounded(event)))  # type: ignore[arg-type]
    for name, separator in (("trajectory.tum", " "), ("landmarks.csv", ",")):
        lines = []
        for line in (folder / name).read_text(encoding="utf-8").splitlines():
            first, *rest = line.split(separator)
            if not first[0].isalpha():
                rest = [repr(float(np.float32(value))) for value in rest]
            lines.append(separator.join((first, *rest)))
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def hint_parts(check: TraceCheck) -> list[str]:
    """What the hints of the filter's own gaps say in particular; nothing for general advice."""
    parts: list[str] = []
    for cause in check.verdict.causes:
        if "is wrong, the other row is right" in cause.hint:
            continue  # right, and little more than general advice
        if cause.gap == "data":
            parts.append(cause.evidence)
        elif cause.gap == "model" and cause.hint.startswith(model.FITTED):
            parts += cause.hint.removeprefix(model.FITTED).split("; ")
        elif cause.gap in ("model", "algebra") and cause.hint not in (algebra.HINT, model.HINT):
            parts.append(cause.hint)
    return parts


def judge_hints(
    cases: Iterable[HintCase], faults: Sequence[StrangerFault], *, listed: bool = False
) -> Counter[str]:
    """Count right, general and wrong hints, and faults that pass unseen."""
    found: Counter[str] = Counter()
    for one in cases:
        for fault in faults:
            if fault.log not in one.kinds:
                continue
            check = checked(fault.plant(one.sound), one)
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


def judge_precisions(cases: Iterable[HintCase], *, listed: bool = False) -> Precisions:
    """Count what is called by its name.

    stored: agrees. computed: agrees, or is named a computation in single precision. dropped: an
    algebra gap, stored in single precision, that is not called a matter of precision.
    """
    found = Precisions()
    for one in cases:
        single = type("InSingle", (Single, one.sound), {})
        causes = [
            [c for c in check.verdict.causes if c.gap in ("data", "algebra", "model")]
            for check in (
                checked(one.sound, one, stored_single=True),
                checked(single, one),
                checked(FORGETFUL(one.sound), one, stored_single=True),
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


def sound_hints(cases: Iterable[HintCase]) -> tuple[int, int]:
    """Count hints on sound filters, and these."""
    found = [len(hint_parts(checked(one.sound, one))) for one in cases]
    return sum(map(bool, found)), len(found)


def rows(quick: bool = False, folder: str = "") -> list[PromiseRow]:
    """Return the table's rows. quick: a part of the faults, one loop. folder: of a real log."""
    cases = [simulated(), *([recorded(folder)] if folder else [])]
    step = 8 if quick else 1
    found = judge_hints(cases, HINTS[::step])
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
            PromiseRow(
                f"hints on {name}, with a trace",
                f"{share:.0%} named right, none wrong",
                ", ".join(f"{counts[how]} {how}" for how in ("right", "general", "wrong", "unseen"))
                + f" of {total}",
                counts["right"] >= share * total and not counts["wrong"],
            )
        )
    table.append(PromiseRow("no hint on sound filters", "0", f"{false} of {sound}", not false))
    n = precision.total
    for what, asked, count in (
        ("stored in single precision, sound", "no fault", precision.stored),
        ("computed in single precision", "named as such, or agrees", precision.computed),
        ("stored in single precision, 1 % of a covariance dropped", "an algebra gap",
         precision.dropped),
    ):  # fmt: skip
        table.append(PromiseRow(what, f"{asked} in all", f"{count} of {n}", count == n))
    return table


if __name__ == "__main__":
    asked = options(__doc__, quick=False, log="", only="", list=False, held_out=False)
    if not asked.list:
        sys.exit(print_table(rows(asked.quick, asked.log)))
    logs = [simulated(), *([recorded(asked.log)] if asked.log else [])]
    chosen = [one for one in (HELD_OUT if asked.held_out else HINTS) if asked.only in one.name]
    print(judge_hints(logs, chosen, listed=True))
    print(judge_precisions(logs, listed=True))
