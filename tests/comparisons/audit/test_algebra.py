"""The algebra of the reference EKF, event by event: in `run`, `check` and `audit` alike."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

from comparisons.arrays import Array
from comparisons.audit import algebra
from comparisons.audit.algebra import AlgebraCheck, AuditFinding, faults_of
from comparisons.audit.audit import Audit, audit
from comparisons.audit.own_filter import run_events, write_run
from comparisons.config import CheckConfig
from comparisons.estimates.external import read_external
from comparisons.estimates.folder import write_estimate
from comparisons.estimates.planar_trace import TRACE
from comparisons.explain.events import PLAIN, digits
from comparisons.faults.catalogue import NAMED
from comparisons.faults.grammar import number_text
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.grading import check_external
from comparisons.jobs.run import Comparison, Modified, repeat_filter
from comparisons.pipeline.solve import solve
from comparisons.trace.events import Event, Predict, Snapshot, TracePrior, Update
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
            record.event(event)


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
        ("F transposed", "F is transposed"),
        (
            "cross-covariance dropped at prediction",
            "the covariance of pose with all others is as before the event",
        ),
        (
            "cross-covariance dropped at update",
            "the covariance of pose with all others is as before the event",
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
    named = numbered(first.text.partition(": ")[0], events)
    check = handed_in(c, tmp_path)
    for verdict, own in ((c.verdict, []), (present(check.trace).verdict, events)):
        cause = next(one for one in verdict.causes if one.gap == "algebra")
        assert numbered(cause.hint.removeprefix("check "), own) == named
        assert what in cause.evidence
        assert what not in cause.hint
    assert_same_gap(c, check, found)


def assert_same_gap(c: Comparison, check: ExternalCheck, found: Audit) -> None:
    """Of both figures, at the end; where they are rounding, by their size."""
    one, last = c.agreement.algebra, found.gaps[-1]
    for other in (present(check.trace).agreement.algebra, last):
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
    cause = present(check.trace).verdict.causes[0]
    assert cause.gap == "algebra"
    assert "record a snapshot after each event" in cause.hint


BLOCKS, DIMS = ("place", "speed", "bias"), (2, 1, 1)
P = np.array(
    [[4.0, 0.7, 0.5, 0.3], [0.7, 3.0, 0.4, 0.2], [0.5, 0.4, 2.0, 0.6], [0.3, 0.2, 0.6, 1.0]]
)
F = np.array([[1.0, 0.1, 0.5], [0.2, 0.9, 0.3], [0.4, 0.2, 0.8]])
Q = np.diag((0.1, 0.2, 0.3))
H = np.array([[1.0, 0.2], [0.0, 1.0]])
R = np.array([[0.5, 0.1], [0.1, 0.4]])
MOVE = Predict(1, None, ("place", "speed"), F, Q)
MEASURE = Update(2, None, "gps", ("place",), np.array([0.5, -0.3]), H, R, True, None, None)
BEGIN = TracePrior(0, None, BLOCKS, DIMS, P)


def predicted(p: Array, f: Array = F, q: Array = Q) -> Array:
    whole, noise = np.eye(4), np.zeros((4, 4))
    whole[:3, :3], noise[:3, :3] = f, q
    return np.asarray(whole @ p @ whole.T + noise)


def gain_of(p: Array, r: Array = R) -> tuple[Array, Array]:
    """Kalman's gain (4, 2), and H on the whole state."""
    whole = np.hstack((H, np.zeros((2, 2))))
    return p @ whole.T @ np.linalg.inv(whole @ p @ whole.T + r), whole


def updated(p: Array) -> Array:
    k, h = gain_of(p)
    return np.asarray(p - k @ h @ p)


def lacking_r(p: Array) -> Array:
    k, h = gain_of(p)
    return np.asarray(p - k @ h @ p @ h.T @ k.T)


def changed(f: Array, rows: slice, columns: slice, value: ArrayLike) -> Array:
    found = f.copy()
    found[rows, columns] = value
    return found


def alone(p: Array) -> Array:
    """The last block without covariances with the others."""
    found = p.copy()
    found[3, :3] = found[:3, 3] = 0.0
    return found


def snapshot(number: int, p: Array, mean: Array | None = None) -> Snapshot:
    return Snapshot(number, None, BLOCKS, p, mean, None)


PLACE, SPEED, ALL = slice(0, 2), slice(2, 3), slice(None)
DONE_WRONG: dict[str, tuple[Event, Callable[[Array], Array]]] = {
    "the part of F that leads from speed to place is zero": (
        MOVE,
        lambda p: predicted(p, changed(F, PLACE, SPEED, 0.0)),
    ),
    "the part of F that leads from speed to place has the opposite sign": (
        MOVE,
        lambda p: predicted(p, changed(F, PLACE, SPEED, -F[:2, 2:])),
    ),
    "the row block of speed in F is as in the identity": (
        MOVE,
        lambda p: predicted(p, changed(F, SPEED, ALL, [[0.0, 0.0, 1.0]])),
    ),
    "the column block of speed in F is as in the identity": (
        MOVE,
        lambda p: predicted(p, changed(F, ALL, SPEED, [[0.0], [0.0], [1.0]])),
    ),
    "the covariance of bias with all others is zero": (
        MEASURE,
        lambda p: alone(updated(p)),
    ),
    "the covariance has +0.02 added on its diagonal": (
        MEASURE,
        lambda p: updated(p) + 0.02 * np.eye(4),
    ),
    "S is H P H^T, not H P H^T + R, in the covariance alone": (MEASURE, lacking_r),
}
"""What is said of an event, the event, and what it did to P."""


@pytest.mark.parametrize("said", DONE_WRONG)
def test_what_an_event_did_wrong_is_named(said: str) -> None:
    event, wrong = DONE_WRONG[said]
    (found,) = faults_of((BEGIN, event, snapshot(3, wrong(P))), 1e-6)
    assert said in found
    right = predicted(P) if event is MOVE else updated(P)
    assert faults_of((BEGIN, event, snapshot(3, right)), 1e-6) == ()


@pytest.mark.parametrize(
    ("number", "neutral", "count"),
    [
        (0.5, 1.0, 1),
        (0.25, 1.0, 1),  # the inverse of 4
        (1.02, 1.0, 1),  # 0.02 more than one
        (0.37, 1.0, 2),
        (1.0000237, 1.0, PLAIN + 1),  # not one, though near it
        (0.5371, 1.0, PLAIN + 1),
        (0.02, 0.0, 1),
    ],
)
def test_a_number_that_somebody_has_written_has_few_digits(
    number: float, neutral: float, count: int
) -> None:
    assert digits(number, neutral) == count


@pytest.mark.parametrize(
    ("most", "said"),
    [
        (2, "event 1 (prediction): Q is zero"),
        (1, "the covariance at event 3 is not that of the events before it"),
    ],
)
def test_as_many_events_are_searched_as_are_kept(
    most: int, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(algebra, "MOST_KEPT", most)
    wrong = updated(predicted(P, q=0.0 * Q))
    assert faults_of((BEGIN, MOVE, MEASURE, snapshot(3, wrong)), 1e-6) == (said,)


def checked(*events: Event) -> AlgebraCheck:
    check = AlgebraCheck()
    for event in (BEGIN, *events):
        check.take(event)
    return check


def test_an_events_own_fault_goes_first_and_a_slight_one_last() -> None:
    check = checked()
    for text, name, event, weight in (
        ("far off", "nees", None, 50.0),
        ("slight", "algebra", 2, -1.0),
        ("later", "algebra", 4, 0.0),
        ("of an event", "algebra", 3, 0.0),
    ):
        check.add(AuditFinding(name, True, text, event), text, weight)
    check.add(AuditFinding("gain", False, "no fault", 1), "gain")
    order = ["of an event", "later", "far off", "slight", "no fault"]
    assert [one.text for one in check.findings()] == order


def test_a_correction_is_compared_without_a_gain() -> None:
    """By the covariance: without one, a filter may use any gain."""
    right = gain_of(P)[0] @ MEASURE.residual
    for correction, gains, said in ((None, 0, []), (right, 1, []), (2.0 * right, 1, ["twice"])):
        update = MEASURE._replace(correction=correction)
        check = checked(update)
        assert check.gains == gains
        assert check.faults() == ()
        assert check.optimal == (not said)
        check = checked(update, snapshot(3, updated(P)))
        assert [text.split()[-1] for text in check.faults()] == said


def test_asymmetry_is_what_two_sides_of_the_diagonal_differ_by() -> None:
    """Where each is within the tolerance of what is right, too."""
    right, odd = updated(P), np.zeros((4, 4))
    odd[0, 2] = 0.7e-6 * np.sqrt(right[0, 0] * right[2, 2])
    (found,) = faults_of((BEGIN, MEASURE, snapshot(3, right + odd - odd.T)), 1e-6)
    assert "is asymmetric, by 1.4e-06 of its sigmas" in found
    assert faults_of((BEGIN, MEASURE, snapshot(3, right + odd)), 1e-6) == ()


def test_after_an_asymmetric_covariance_the_next_fault_is_named() -> None:
    """Of a filter that takes the even part of it from there on."""
    skewed = predicted(P)
    skewed[0, 3] += 0.02
    later = snapshot(5, lacking_r(0.5 * (skewed + skewed.T)))
    events = BEGIN, MOVE, snapshot(2, skewed), MEASURE._replace(number=4), later
    found = faults_of(events, 1e-6)
    assert any("is asymmetric" in text for text in found)
    assert found[-1].startswith("event 4 (update of sensor `gps`): ")
    assert "S is H P H^T, not H P H^T + R" in found[-1]


def test_an_estimate_is_off_by_the_largest_of_its_numbers() -> None:
    p, after = predicted(P), np.array([1.0, 2.0, 3.0])
    mean = np.array([*after, 7.0]) + np.array([0.01, 0.5, 0.0, 0.0]) * np.sqrt(np.diag(p))
    (found,) = faults_of((BEGIN, MOVE._replace(after=after), snapshot(3, p, mean)), 1e-6)
    assert found == "event 1 (prediction): the estimate of place is off by 0.5 sigma"


def test_an_estimate_may_go_round() -> None:
    """An angle that the filter wraps to (-pi, pi] before its snapshot, and one that it does not."""
    p, after = predicted(P), np.array([3.2, 2.0, -9.5])
    wrapped = np.array([3.2 - 2.0 * np.pi, 2.0, -9.5 + 4.0 * np.pi, 7.0])
    assert faults_of((BEGIN, MOVE._replace(after=after), snapshot(3, p, wrapped)), 1e-6) == ()
    half = wrapped + np.pi * np.array([1.0, 0.0, 0.0, 0.0])
    assert faults_of((BEGIN, MOVE._replace(after=after), snapshot(3, p, half)), 1e-6)


def test_an_unknown_error_is_said_of_the_update_with_another_gain() -> None:
    kalman, h = gain_of(predicted(P))
    gain = kalman * [[1.0], [1.0], [0.7], [1.3]]
    less = np.eye(4) - gain @ h
    p = less @ predicted(P) @ less.T + gain @ R @ gain.T
    p[1, 3] = p[3, 1] = p[1, 3] + 0.123
    check = checked(MOVE, MEASURE._replace(gain=gain), snapshot(3, p))
    check.end()
    first = check.findings()[0]
    assert (first.check, first.event, first.sensor) == ("algebra", 2, "gps")
    assert "off by" in first.text


def test_a_gain_that_is_named_with_the_covariance_is_one_finding() -> None:
    k, h = gain_of(P, R @ R)
    check = checked(MEASURE._replace(gain=k), snapshot(3, P - k @ h @ P))
    check.end()
    (found,) = check.findings()
    assert "gain and covariance are those where R is multiplied by itself" in found.text
    assert not check.optimal


def test_the_one_before_of_the_second_event_is_the_first_of_the_third() -> None:
    """One finding of a kind, in the words that hold for all."""
    check = checked()
    for event, which in ((5, "update before"), (7, "first update"), (9, "first update")):
        text = f"the H of the {which} was used"
        check._add_cause(AuditFinding("algebra", True, text, event), text, 0.0)
    (found,) = check.findings()
    assert found.text == "the H of the first update was used; and 2 more"


def test_a_heading_by_its_cosines_is_recorded_as_an_angle() -> None:
    """The state has four entries for the pose, the trace three."""
    c = compared(simulated(seed=3, loop_s=4.0), filter="misono-full")
    events = repeated(c)
    assert c.ekf.trace.prior_pose.shape == (3,)
    assert sum(isinstance(one, Snapshot) for one in events) > 20
    assert faults_of(events, 1e-8) == ()


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


def test_numbers_of_faults_tell_themselves_from_none() -> None:
    """Never "multiplied by 1"."""
    assert number_text(1.00001, 1.0) == "1.00001"
    assert number_text(0.25, 1.0) == "0.25"
    assert number_text(2.0, 1.0) == "2"
    assert number_text(1e-7, 0.0) == "1e-07"


def test_two_errors_that_explain_a_covariance_alike_are_both_named() -> None:
    """Without noise, a prediction that is left out is one without F, and nothing tells which."""
    still = MOVE._replace(noise=np.zeros((3, 3)))
    (text,) = faults_of((BEGIN, still, snapshot(2, P)), 1e-6)
    assert "the covariance was not predicted, or F is the identity" in text
    (text,) = faults_of((BEGIN, MOVE, snapshot(2, P)), 1e-6)
    assert "the covariance was not predicted" in text
    assert ", or " not in text


def test_snapshots_in_a_row_that_differ_are_said_to() -> None:
    """With nothing between them: none of the known errors is looked for."""
    for events in ((), (MOVE,)):
        last = predicted(P) if events else P
        number = len(events) + 1
        first = snapshot(number, last)
        again = first._replace(number=number + 1)
        assert faults_of((BEGIN, *events, first, again), 1e-6) == ()
        off = again._replace(covariance=2.0 * last)
        (text,) = faults_of((BEGIN, *events, first, off), 1e-6)
        assert text.startswith(f"event {number + 1}: the covariance of block ")
        assert f"with no event between it and the snapshot at event {number}" in text
    (text,) = faults_of((BEGIN, snapshot(1, 2.0 * P)), 1e-6)
    assert "with no event between it and the prior" in text


@pytest.mark.parametrize("told", ["correction", "gain", "both"])
@pytest.mark.parametrize("form", ["schmidt", "fixed"])
def test_a_gain_of_ones_choice_is_no_fault(form: str, told: str) -> None:
    """Whatever is recorded of it, if its covariance is Joseph's; with Kalman's it is."""
    gain, h = gain_of(P)
    if form == "schmidt":
        gain[3] = 0.0
    else:
        gain = 0.6 * gain + 0.01
    keep = np.eye(4) - gain @ h
    p = keep @ P @ keep.T + gain @ R @ gain.T
    correction = gain @ MEASURE.residual
    update = MEASURE._replace(number=1)
    if told != "gain":
        update = update._replace(correction=correction)
    if told != "correction":
        update = update._replace(gain=gain)
    assert faults_of((BEGIN, update, snapshot(2, p)), 1e-6) == ()
    assert faults_of((BEGIN, update, snapshot(2, updated(P))), 1e-6) != ()
    wrong = update._replace(correction=-gain_of(P)[0] @ MEASURE.residual, gain=None)
    assert faults_of((BEGIN, wrong, snapshot(2, updated(P))), 1e-6) != ()


def test_a_perfect_measurement_is_sound() -> None:
    """R = 0: what is left of the measured variances is rounding, of either sign."""
    perfect = MEASURE._replace(number=1, noise=np.zeros((2, 2)))
    gain, h = gain_of(P, np.zeros((2, 2)))
    p = P - gain @ h @ P
    assert np.abs(p[:2, :2]).max() < 1e-14
    odd = np.zeros((4, 4))
    odd[0, 0], odd[1, 1] = -3e-16, 5e-16
    for left in (p, 0.5 * (p + p.T) + odd):
        assert faults_of((BEGIN, perfect, snapshot(2, left)), 1e-6) == ()
    odd[0, 0] = 1e-4
    assert faults_of((BEGIN, perfect, snapshot(2, p + odd)), 1e-6) != ()
