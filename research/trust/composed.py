"""Faults drawn from the grammar, planted in a filter, and what is named of its records.

    python -m research.trust.composed [--faults 200] [--seed 0] [--log simulated-loop] [--list]
                                      [--estimates]

Slot, part, change and number are drawn at random; a filter with the fault drives the first seconds
of a log. What it recorded is explained without knowing the fault: by its own words, by others of
the same slot, by others that make the same values of the records, or by nothing. A fault counts
where it has an effect. --estimates: poses and covariances alone are handed to `slamcheck check`,
of faults that move a pose by a tenth of a sigma and more.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.time_window import cut_log
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.diagnosis.known_model_errors import explain
from comparisons.config import EkfConfig
from comparisons.estimates.external import ExternalEstimate
from comparisons.faults.grammar import Composition, Slot, Values, compositions
from comparisons.faults.planting import planted, sound_values
from comparisons.jobs.check import check
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.words import Cause
from ekf_reference.core.state import FilterDivergedError
from research.script import options, present, print_head, print_row

SECONDS, LEAST_SIGMA = 25.0, 0.1
ACCEPTED = "accepted"
"""The estimate is as good as one of a sound filter: nothing is asked of it."""
OUTCOMES = "own words", "its slot", "another's words", "nothing", ACCEPTED


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

    values: what a sound filter has in each slot.
    """
    slots = list(values)
    slot = slots[rng.integers(len(slots))]
    every = list(compositions(slot, values[slot]))
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
    config = settle(EkfConfig(), log)
    setup = FilterSetup()
    if drawn_fault is not None:
        setup = FilterSetup(modify=[planted(drawn_fault.fault, *drawn_fault.numbers)])
    try:
        with np.errstate(all="ignore"):
            run = run_ekf(log, build_timeline(log), config, None, setup)
    except (FilterDivergedError, np.linalg.LinAlgError, ValueError, FloatingPointError):
        return None
    return None if run.breakdown else run


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


def moved_sigma(sound: EkfRun, run: EkfRun) -> float:
    """How far a fault moves the poses, in the sound filter's sigma."""
    known = sound.estimate
    sigma = np.sqrt(np.maximum(np.diagonal(known.pose_covariance, 0, 1, 2), 1e-20))
    return float(np.nan_to_num(np.abs(run.estimate.pose - known.pose) / sigma, nan=0.0).max())


def causes_of_estimate(log: Log, run: EkfRun) -> tuple[Cause, ...]:
    """What `check` says of a run's poses and covariances alone."""
    known = run.estimate
    given = ExternalEstimate(
        time_s=known.time_s,
        pose=known.pose,
        pose_covariance=known.pose_covariance,
        information="filtered",
    )
    return check(log, given).causes


def said_of_estimate(log: Log, run: EkfRun) -> list[str]:
    """What `check` names of poses and covariances alone: faults, no symptoms."""
    causes = causes_of_estimate(log, run)
    if not causes:
        return [ACCEPTED]
    return [cause.evidence for cause in causes if cause.gap == "fault"]


def judged(one: DrawnFault, said: Sequence[str]) -> str:
    """How a fault was named, of OUTCOMES."""
    if not said:
        return "nothing"
    if said[0] == ACCEPTED:
        return ACCEPTED
    if said[0].startswith(one.words):
        return "own words"
    return "its slot" if f"{one.fault.slot.name} " in f"{said[0]} " else "another's words"


def main() -> None:
    """Draw, plant, explain and count."""
    given = options(__doc__, faults=200, seed=0, log="simulated-loop", list=False, estimates=False)
    rng = np.random.default_rng(given.seed)
    log = cut_log(open_log(given.log, choices=SimulationChoices(given.seed)), None, SECONDS)
    counts: Counter[tuple[str, str]] = Counter()
    sound, values = present(run_with(log, None)), sound_values(log)
    while sum(counts.values()) < given.faults:
        one = drawn(rng, values)
        run = run_with(log, one)
        if run is None:
            continue
        least = LEAST_SIGMA if given.estimates else 0.0
        if without_effect(sound, run) or moved_sigma(sound, run) < least:
            continue
        with np.errstate(all="ignore"):
            said = said_of_estimate(log, run) if given.estimates else explain(log, run)
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
