"""The algebra of the reference EKF, event by event: in `run`, `check` and `audit` alike."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from comparisons.audit.algebra import faults_of
from comparisons.audit.audit import Audit, audit
from comparisons.audit.own_filter import run_events
from comparisons.audit.run_trace import write_event, write_run
from comparisons.config import CheckConfig
from comparisons.estimates.external import read_external
from comparisons.estimates.folder import write_estimate
from comparisons.estimates.trace_file import TRACE
from comparisons.faults.catalogue import NAMED
from comparisons.pipeline.check import ExternalCheck, check_external
from comparisons.pipeline.compare import Comparison, Modified, repeat_filter
from comparisons.pipeline.solve import solve
from comparisons.trace.events import Event, Snapshot, Update
from comparisons.trace.recorder import Recorder
from tests.comparisons.audit.test_own_filter import CASES, same
from tests.helpers import compared, present, simulated


def planted(name: str) -> Modified:
    """The reference EKF with a fault of the catalogue."""
    (fault,) = (one for one in NAMED if one.name == name)
    return Modified(present(fault.plant))


def repeated(c: Comparison) -> list[Event]:
    """Its events, each with the state that follows."""
    events: list[Event] = []
    repeat_filter(c.prepared, c.ekf, events.append)
    return events


def write(events: list[Event], path: Path) -> None:
    with Recorder(path) as record:
        for event in events:
            if event.time_s is not None:
                record.at(event.time_s)
            write_event(event, record)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_sound_run_has_no_faults_and_the_same_events(name: str) -> None:
    c = CASES[name]()
    again, known = repeated(c), list(run_events(c.ekf))[:-1]
    assert faults_of(again, 1e-8) == ()
    events = [one for one in again if not isinstance(one, Snapshot)]
    for one, other in zip(events, known, strict=True):
        assert type(one) is type(other)
        parts = [other if isinstance(other, Update) else one, other]
        if isinstance(one, Update) and isinstance(other, Update):
            parts = [one._replace(correction=None), other]
        assert all(map(same, *parts)), (one, other)
    assert sum(isinstance(one, Snapshot) for one in again) == len(again) - len(events) > 100


def test_a_compressed_state_is_left_alone() -> None:
    c = compared(simulated(seed=3, loop_s=20.0), filter="compressed")
    assert repeated(c) == []


def numbered(text: str, events: list[Event]) -> tuple[int, str]:
    """The event that a finding names, by its place among those that are no snapshots; the rest."""
    found = re.match(r"(\D+)(\d+)(.*?)(?: \(at [\d.]+ s\))?(?:; and .*)?$", text)
    assert found is not None, text
    number = int(found[2])
    before = sum(isinstance(one, Snapshot) for one in events[:number])
    return number - before, found[1] + found[3]


def handed_in(c: Comparison, folder: Path) -> ExternalCheck:
    return check_external(read_external(folder), solve(c.log, CheckConfig()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("F transposed", "F was applied transposed"),
        (
            "cross-covariance dropped at prediction",
            "F was not applied to the covariance with other blocks",
        ),
        (
            "cross-covariance dropped at update",
            "the covariances of block pose with all others were not updated",
        ),
    ],
)
def test_run_check_and_audit_name_the_same_event_and_fault(
    name: str, what: str, tmp_path: Path
) -> None:
    c = compared(simulated(seed=3, loop_s=10.0), planted(name))
    events = repeated(c)
    write_estimate(c.ekf.estimate, tmp_path)
    write(events, tmp_path / TRACE)
    found = audit(tmp_path / TRACE)
    first = found.findings[0]
    assert first.check == "algebra"
    assert what in first.text
    named = numbered(first.text, events)
    check = handed_in(c, tmp_path)
    assert check.trace is not None
    for verdict, own in ((c.verdict, []), (check.trace.verdict, events)):
        cause = next(one for one in verdict.causes if one.gap == "algebra")
        assert numbered(cause.hint.removeprefix("check "), own) == named
    assert_same_gap(c, check, found)


def assert_same_gap(c: Comparison, check: ExternalCheck, found: Audit) -> None:
    """Of both figures, at the end; where they are rounding, by their size."""
    assert check.trace is not None
    one, last = c.agreement.algebra, found.gaps[-1]
    for other in (check.trace.agreement.algebra, last):
        figures = other.sigma, other.covariance
        assert figures == pytest.approx((one.sigma, one.covariance), rel=1e-6, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "choices"),
    [("full", "known"), ("compressed", "nn"), ("compressed", "consensus"), ("full", "euclidean")],
)
def test_run_check_and_audit_have_the_same_gap(name: str, choices: str, tmp_path: Path) -> None:
    c = compared(simulated(seed=3, loop_s=20.0), filter=name, association=choices)
    write_estimate(c.ekf.estimate, tmp_path)
    write_run(c.ekf, tmp_path / TRACE)
    found = audit(tmp_path / TRACE)
    assert found.sound
    assert_same_gap(c, handed_in(c, tmp_path), found)


@pytest.mark.slow
def test_a_trace_without_snapshots_says_what_is_lacking(tmp_path: Path) -> None:
    c = compared(simulated(seed=3, loop_s=10.0), planted("F transposed"))
    write_estimate(c.ekf.estimate, tmp_path)
    write_run(c.ekf, tmp_path / TRACE)
    check = handed_in(c, tmp_path)
    assert check.trace is not None
    cause = check.trace.verdict.causes[0]
    assert cause.gap == "algebra"
    assert "a snapshot of the covariance, recorded after each event" in cause.hint


def test_the_estimate_after_a_prediction_is_checked() -> None:
    c = CASES["points"]()
    events = repeated(c)
    at = next(i for i, one in enumerate(events) if one.number == 40 and isinstance(one, Snapshot))
    shifted = events[at]
    assert isinstance(shifted, Snapshot)
    assert shifted.mean is not None
    moved = shifted._replace(mean=shifted.mean + 1e-3 * (np.arange(len(shifted.mean)) == 0))
    found = faults_of([*events[:at], moved], 1e-6)
    assert len(found) == 1
    assert "40" in found[0]
    assert ": the estimate of pose is off by" in found[0]
