"""Faults drawn from the grammar, planted in a filter, and what is named of its records.

    python -m research.trust.composed [--faults 200] [--seed 0] [--log simulated-loop] [--list]
                                      [--estimates]

Slot, part, change and number are drawn at random; a filter with the fault drives the first seconds
of a log. What it recorded is explained without knowing the fault: by its own words, by others of
the same slot, by others that make the same values of the records, or by nothing. A fault counts
where it has an effect. --estimates: poses and covariances alone are handed to `slamcheck check`, of
faults that move a pose by a tenth of a sigma and more; they are drawn from models, algebra, times
and data, the latter and lines of code in a filter that shares none with the reference. What a
check costs is counted in steps of reference filters.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.time_window import cut_log
from comparisons.checks.diagnosis.known_model_errors import explain
from comparisons.faults.fault import Fault
from comparisons.faults.grammar import VELOCITY, Composition, Q, Slot, Values, compositions
from comparisons.faults.planting import (
    AT_OLD,
    FROM_OLD,
    HALF_WRAPPED,
    NOT_WRAPPED,
    QUADRANT,
    TURN_PER_METRE,
    planted,
    sound_values,
)
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from research.script import options, present, print_head, print_row
from research.trust.drawn_estimates import print_estimates, run_of

SECONDS = 25.0
OUTCOMES = "own words", "its slot", "another's words", "nothing"


_UNRECORDED = {AT_OLD, TURN_PER_METRE, NOT_WRAPPED, HALF_WRAPPED, FROM_OLD, QUADRANT}
"""What faults read that is not made of records: hypotheses of their own explain these."""
_BEHIND_RECORDS = VELOCITY, Q
"""What is planted where the filter has recorded it already."""


class DrawnFault(NamedTuple):
    """A fault with its numbers."""

    fault: Composition
    numbers: tuple[float, ...]

    @property
    def words(self) -> str:
        """What it is."""
        return self.fault.said(*self.numbers)


def drawn(rng: np.random.Generator, values: Mapping[Slot, Values]) -> DrawnFault:
    """A fault at random: each slot, then each kind of change, is as likely as any other.

    values: what a sound filter has in each slot. None of what records are explained by otherwise.
    """
    slots = [one for one in values if one not in _BEHIND_RECORDS]
    slot = slots[rng.integers(len(slots))]
    every = [one for one in compositions(slot, values[slot]) if one.reads not in _UNRECORDED]
    changes = sorted({one.change for one in every})
    change = changes[rng.integers(len(changes))]
    some = [one for one in every if one.change == change]
    fault = some[rng.integers(len(some))]
    numbers = {
        "times": rng.choice((0.5, 0.9, 1.2, 2.0, 3.0)),
        "plus": rng.choice((-0.1, 0.01, 0.2)),
    }
    return DrawnFault(fault, (float(numbers[change]),) if fault.start else ())


def run_with(log: Log, drawn_fault: DrawnFault | None) -> EkfRun | None:
    """The filter's run with a fault; None where it breaks down."""
    if drawn_fault is None:
        return run_of(log, None)
    return run_of(log, Fault(drawn_fault.words, planted(drawn_fault.fault, *drawn_fault.numbers)))


def without_effect(sound: EkfRun, run: EkfRun) -> bool:
    """Whether a run is the sound one, to rounding."""
    pairs = (
        (sound.departed, run.departed),
        (sound.estimate.pose_covariance, run.estimate.pose_covariance),
        (sound.estimate.landmark, run.estimate.landmark),
    )
    return all(
        first.shape == second.shape and np.allclose(first, second, rtol=1e-6, atol=1e-12)
        for first, second in pairs
    )


def judged(one: DrawnFault, said: Sequence[str]) -> str:
    """How a fault was named, of OUTCOMES."""
    if not said:
        return "nothing"
    if said[0].startswith(one.words):
        return "own words"
    return "its slot" if f"{one.fault.slot.name} " in f"{said[0]} " else "another's words"


def main() -> None:
    """Draw, plant, explain and count."""
    given = options(__doc__, faults=200, seed=0, log="simulated-loop", list=False, estimates=False)
    rng = np.random.default_rng(given.seed)
    log = cut_log(open_log(given.log, choices=SimulationChoices(given.seed)), None, SECONDS)
    if given.estimates:
        print_estimates(log, rng, given.faults, listed=given.list)
        return
    counts: Counter[tuple[str, str]] = Counter()
    sound, values = present(run_with(log, None)), sound_values(log)
    while sum(counts.values()) < given.faults:
        one = drawn(rng, values)
        run = run_with(log, one)
        if run is None:
            continue
        if without_effect(sound, run):
            continue
        with np.errstate(all="ignore"):
            said = explain(log, run)
        slot = one.fault.slot.name
        outcome = judged(one, said)
        counts[slot, outcome] += 1
        if given.list and outcome != "own words":
            print(f"{outcome:12} {one.words}\n{'':13}{'; '.join(said)[:200]}", flush=True)
    print_head("slot", "drawn", *OUTCOMES)
    for slot in sorted({slot for slot, _ in counts}):
        each = [counts[slot, outcome] for outcome in OUTCOMES]
        print_row(slot, sum(each), *each)
    total = [sum(n for (_, which), n in counts.items() if which == one) for one in OUTCOMES]
    print_row("all", sum(total), *total)


if __name__ == "__main__":
    main()
