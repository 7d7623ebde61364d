"""In which order an estimate is read in other ways, which way is taken, and what that costs."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.config import CheckConfig, EkfConfig
from comparisons.estimates.external import ExternalEstimate
from comparisons.jobs.check import check, explained
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.grading import Grader
from comparisons.jobs.readings import FAULT, READINGS, Reading, ReadingKind
from comparisons.logs.log import Log
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.pipeline import references
from comparisons.pipeline.solve import Solution, solve

GRADER = cast(Grader, None)
Rule = Callable[[Grader, ExternalCheck, Iterable[ReadingKind]], ExternalCheck | None]


@dataclass(frozen=True)
class Verdict:
    """Stands for a check: its outcome, and the readings that led to it."""

    outcome: str
    by: tuple[str, ...] = ()


class Way(Reading):
    """A reading by which an estimate has an outcome."""

    def __init__(self, name: str, outcome: str, *, stands: bool = False, says: bool = True) -> None:
        self.name, self.outcome, self.says, self.tried = name, outcome, says, list[str]()
        self.__dict__["stands"] = stands

    def apply(self, grader: Grader) -> ExternalCheck:
        """Return the outcome."""
        return cast(ExternalCheck, Verdict(self.outcome))

    def reported(self, check: ExternalCheck) -> ExternalCheck | None:
        """Return the outcome with the name before others."""
        verdict = cast(Any, check)
        return replace(verdict, by=(self.name, *verdict.by)) if self.says else None


def kind(*ways: Way, beside: tuple[ReadingKind, ...] = ()) -> ReadingKind:
    """Readings that are there for any estimate."""
    return ReadingKind(lambda grader, check: iter(ways), beside)


RIGHT = kind(Way("right", "agree"))
WRONG = kind(Way("wrong", "disagree"))
PAIRED = kind(Way("half", "disagree"), beside=(WRONG, RIGHT))
CHOICES: dict[str, tuple[list[ReadingKind], tuple[str, ...] | None]] = {
    "none": ([], None),
    "none explains": ([WRONG, WRONG], None),
    "the first of two": ([WRONG, RIGHT, kind(Way("later", "agree"))], ("right",)),
    "a pair before what comes later": ([PAIRED, RIGHT], ("half", "right")),
    "a filter that reproduces it": (
        [WRONG, kind(Way("fault", "disagree", stands=True)), RIGHT],
        ("fault",),
    ),
    "the second of a kind": ([kind(Way("a", "disagree"), Way("b", "agree"))], ("b",)),
    "one that explains nothing after all": (
        [kind(Way("a", "agree", says=False)), RIGHT],
        ("right",),
    ),
}


def taken(rule: Rule, kinds: Iterable[ReadingKind]) -> tuple[str, ...] | None:
    """The readings by which a rule takes an estimate that does not agree."""
    found: Any = rule(GRADER, cast(ExternalCheck, Verdict("disagree")), kinds)
    return None if found is None else found.by


@pytest.mark.parametrize("choice", CHOICES)
def test_the_first_reading_that_explains_an_estimate_is_taken(choice: str) -> None:
    kinds, by = CHOICES[choice]
    assert taken(explained, kinds) == by


def test_a_sound_estimate_is_read_in_no_other_way() -> None:
    sound = cast(ExternalCheck, Verdict("agree"))
    assert explained(GRADER, sound, [RIGHT]) is sound


def without_pairs(
    grader: Grader, check: ExternalCheck, kinds: Iterable[ReadingKind]
) -> ExternalCheck | None:
    """A rule that knows no pairs."""
    return explained(grader, check, [one._replace(beside=()) for one in kinds])


def the_last(
    grader: Grader, check: ExternalCheck, kinds: Iterable[ReadingKind]
) -> ExternalCheck | None:
    """A rule that takes what comes last."""
    return explained(grader, check, list(kinds)[::-1])


@pytest.mark.parametrize("rule", [without_pairs, the_last])
def test_another_rule_is_found(rule: Rule) -> None:
    assert any(taken(rule, kinds) != by for kinds, by in CHOICES.values())


def of_filter(log: Log) -> ExternalEstimate:
    """What a filter estimates from a log."""
    return ExternalEstimate.of(run_ekf(log, build_timeline(log), settle(EkfConfig(), log)).estimate)


@pytest.fixture(scope="module")
def drive() -> tuple[Log, ExternalEstimate]:
    """A drive of 12 s, and a sound filter's estimate of it."""
    log = simulate(np.random.default_rng(0), Drive(loop_s=12.0))
    return log, of_filter(log)


def turned(given: ExternalEstimate) -> ExternalEstimate:
    """The same in a frame turned by half a degree, its covariances left alone."""
    turn = np.exp(1j * np.deg2rad(0.5))

    def about(places: Any) -> Any:
        moved = (places @ (1.0, 1j)) * turn
        return np.column_stack((moved.real, moved.imag))

    pose = np.column_stack((about(given.pose[:, :2]), given.pose[:, 2] + np.deg2rad(0.5)))
    return replace(given, pose=pose, landmark=about(given.landmark))


def of_wide_noise(log: Log) -> ExternalEstimate:
    """The estimate of a filter that takes ranges for three times as uncertain."""
    seen = log.measurements
    wide = replace(seen, sigma_range_m=3.0 * seen.sigma_range_m)
    return of_filter(replace(log, measurements=wide))


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Logs that are solved, and filters that run on a log to its end with nobody beside them.

    Faults are not searched for: their filters run beside the estimate.
    """
    counts, run = Counter[str](), references._run

    def counted(*given: Any) -> Any:
        counts["filters"] += given[3:] in ((), (None,))
        return run(*given)

    monkeypatch.setattr(references, "_run", counted)
    kinds = [one for one in READINGS if one != FAULT]
    monkeypatch.setattr("comparisons.jobs.check.READINGS", kinds)
    return counts


def checked(log: Log, given: ExternalEstimate, work: Counter[str]) -> ExternalCheck:
    """Check an estimate, and count the logs that are solved."""

    def solver(*asked: Any) -> Solution:
        work["solutions"] += 1
        return solve(*asked)

    return check(log, given, CheckConfig(), solver=solver)


def test_a_sound_estimate_costs_one_solution_and_one_filter(
    drive: tuple[Log, ExternalEstimate], work: Counter[str]
) -> None:
    log, given = drive
    assert checked(log, given, work).grade.value == "equal"
    assert work == {"solutions": 1, "filters": 1}


def test_an_estimate_that_is_read_in_another_frame_is_compared_with_the_same_filters(
    drive: tuple[Log, ExternalEstimate], work: Counter[str]
) -> None:
    """The log is solved once, and no filter runs twice on it for the same times."""
    log, _ = drive
    checked(log, turned(of_wide_noise(log)), work)
    assert work == {"solutions": 1, "filters": len(references.FILTERS)}
