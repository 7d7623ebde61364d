"""A foreign filter's trace: the same gaps as from within, the same causes, damage in one line."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import fused_positions, settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.smoother_input import recorded_system_of, solve_recorded
from comparisons.adapters.timeline import build_timeline
from comparisons.audit.own_filter import write_run
from comparisons.audit.replay import Replay
from comparisons.checks.agreement import Gap, Gaussian, gap
from comparisons.checks.causes import FILTER_FAULTS
from comparisons.checks.diagnosis.trace_recursion import replay
from comparisons.config import CheckConfig, EkfConfig
from comparisons.errors import InputError
from comparisons.estimates.external import read_external
from comparisons.estimates.folder import write_estimate
from comparisons.estimates.landmark_names import LandmarkNames
from comparisons.estimates.planar_trace import OUTDATED_TRACE, TRACE, read_trace
from comparisons.faults.catalogue import NAMED
from comparisons.faults.fault import Fault
from comparisons.faults.tried import TriedFaults
from comparisons.jobs.check import check
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.grading import check_external
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry
from comparisons.pipeline.known import Known
from comparisons.pipeline.solve import solve
from comparisons.report.check import CheckReport
from comparisons.report.panels import external_panels
from comparisons.trace.events import TracePrior
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import Recorder
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.trace import TraceArrays
from research.trust.defects import CAUSES, named_first, shows
from research.trust.drives import open_case
from tests.commands import refused, works
from tests.comparisons.edited_trace import Columns, edit_trace
from tests.helpers import Array, compared, first_seconds, present

Plain = tuple[Log, EkfConfig, EkfRun]
Case = tuple[Log, EkfConfig, Comparison]
NEW_EVERY = 4
"""So many of the catalogue's defects pass for each that is planted here."""
UNSAID = ("landmark initialised again",)
"""An estimate cannot say it: two landmarks of one id are refused."""


def filtered(
    log: Log, choices: EkfConfig, modify: Callable[[Ekf], None] = lambda ekf: None
) -> EkfRun:
    chosen = settle(choices, log)
    positions = fused_positions(log, chosen)
    return run_ekf(
        log, build_timeline(log, positions), chosen, positions, FilterSetup(modify=[modify])
    )


def hand_in(run: EkfRun, folder: Path) -> None:
    write_estimate(run.estimate, folder)
    write_run(run, folder / TRACE)


def checked(folder: Path, log: Log, choices: EkfConfig) -> ExternalCheck:
    """What the trace says, without the faults that reproduce an estimate."""
    return check_external(read_external(folder), solve(log, CheckConfig(gps=choices.gps)))


@pytest.fixture(scope="module", params=["loop", "positions"])
def case(request: pytest.FixtureRequest) -> Case:
    log, choices = open_case(request.param, seed=4)
    return log, choices, compared(log, ekf=choices)


def assert_same(found: Gap | None, expected: Gap, rel: float = 1e-6) -> None:
    """To rounding, which for gaps that are rounding themselves means both are."""
    assert found is not None
    for name in ("sigma", "covariance"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=rel, abs=1e-9)


def assert_as_from_within(check: ExternalCheck, comparison: Comparison) -> None:
    assert check.trace is not None
    assert_same(check.trace.algebra, comparison.agreement.algebra)
    assert_same(check.trace.agreement.model, comparison.agreement.model)
    assert_same(check.trace.agreement.linearisation, comparison.agreement.linearisation, rel=1e-5)
    assert check.outcome == "agree", check.causes


@pytest.mark.slow
def test_gaps_are_those_from_within(tmp_path: Path, case: Case) -> None:
    log, choices, comparison = case
    hand_in(comparison.ekf, tmp_path)
    found = checked(tmp_path, log, choices)
    assert_as_from_within(found, comparison)
    assert found.trace is not None
    assert found.trace.known.result is found.solution.result, "S is solved twice"
    of_events = ("NIS of ", "autocorrelation of innovations", "spurious knowledge of the heading")
    for one, there in ((found, True), (replace(found, before=without_trace(found)), False)):
        titles = [panel.title for panel in external_panels(one)[1]]
        assert all(any(name in title for title in titles) == there for name in of_events)


def without_trace(found: ExternalCheck) -> Known:
    given = replace(present(found.before.given), sensors=())
    return replace(found.before, run=None, kept=None, given=given, findings={}, absent={})


@pytest.mark.slow
def test_a_right_trace_does_not_stand_for_a_path(tmp_path: Path, case: Case) -> None:
    """Of a path of one pose, the last."""
    log, choices, comparison = case
    hand_in(comparison.ekf, tmp_path)
    given = read_external(tmp_path)
    one = replace(
        given,
        time_s=given.time_s[-1:],
        pose=given.pose[-1:],
        pose_covariance=present(given.pose_covariance)[-1:],
    )
    found = check(log, one, CheckConfig(gps=choices.gps))
    assert found.outcome == "disagree"
    assert found.causes[0].gap == "coverage"
    assert "it has a single pose" in found.causes[0].evidence


@pytest.mark.slow
def test_the_trace_says_what_the_run_says_of_its_heading(
    tmp_path: Path, victoria_park: Comparison
) -> None:
    hand_in(victoria_park.ekf, tmp_path)
    check = checked(tmp_path, victoria_park.log, EkfConfig())
    assert check.trace is not None
    said = [
        [part for part in cause.evidence.split("; ") if "claims its absolute heading" in part]
        for cause in (*victoria_park.verdict.causes, *check.trace.verdict.causes)
    ]
    assert len(said) == 2
    assert said[0] == said[1] != []


def wrapped(columns: Columns) -> None:
    """As a filter that keeps every heading between -pi and pi."""
    for name in (
        "step_departed",
        "step_arrived",
        "update_pose",
        "initialise_pose",
        "position_pose",
    ):
        columns[name][:, 2] = np.angle(np.exp(1j * columns[name][:, 2]))


def coarse(columns: Columns) -> None:
    """As a filter that predicts once from observation to observation."""
    steps = len(columns["step_f"])
    parts = ("update", "initialise", "position")
    stops = np.unique(np.concatenate([columns[f"{part}_step"] for part in parts]))
    stops = np.unique(np.concatenate((stops[stops > 0], [steps]))).astype(int)
    starts = np.concatenate(([0], stops[:-1]))
    f, q = [], []
    for begin, end in zip(starts, stops, strict=True):
        total, spread = np.eye(3), np.zeros((3, 3))
        for k in range(begin, end):
            step = columns["step_f"][k]
            total, spread = step @ total, step @ spread @ step.T + columns["step_q"][k]
        f.append(total)
        q.append(spread)
    q_symmetric = 0.5 * (np.array(q) + np.array(q).transpose(0, 2, 1))
    columns |= {
        "step_time_s": columns["step_time_s"][stops - 1],
        "step_departed": columns["step_departed"][starts],
        "step_arrived": columns["step_arrived"][stops - 1],
        "step_f": np.array(f),
        "step_q": q_symmetric,
    }
    for part in parts:
        step = columns[f"{part}_step"]
        reached = np.searchsorted(stops, step) + (step > 0)
        columns[f"{part}_step"] = reached.astype(np.float64)


@pytest.mark.parametrize("chosen", [False, True])
def test_a_trace_in_arrays_is_refused(tmp_path: Path, plain: Plain, chosen: bool) -> None:
    """Beside today's trace it does not count, unless it is asked for."""
    hand_in(plain[2], tmp_path)
    former = tmp_path / OUTDATED_TRACE
    np.savez(former, step_f=np.eye(3)[None])
    assert present(read_external(tmp_path).trace).path == tmp_path / TRACE
    if not chosen:
        (tmp_path / TRACE).unlink()
    said = refused(
        *("check", "simulated-loop", "--estimate", str(tmp_path)),
        *(("--trace", str(former)) if chosen else ()),
        cwd=tmp_path,
    )
    assert said == (
        f"slamcheck: {former}: is a trace in arrays, which slamcheck 0.2 reads and this release "
        "does not; record the filter anew with slamcheck.Recorder"
    )


@pytest.mark.slow
@pytest.mark.parametrize("edit", [wrapped, coarse])
def test_other_habits_make_no_difference(
    tmp_path: Path, case: Case, edit: Callable[[Columns], None]
) -> None:
    log, choices, comparison = case
    hand_in(comparison.ekf, tmp_path)
    edit_trace(tmp_path / TRACE, edit)
    assert_as_from_within(checked(tmp_path, log, choices), comparison)


@pytest.mark.slow
@pytest.mark.parametrize(
    "defect",
    [one for one in NAMED if one.name not in UNSAID][::NEW_EVERY],
    ids=lambda defect: defect.name,
)
def test_a_planted_defect_has_its_cause(tmp_path: Path, defect: Fault) -> None:
    """Of algebra only the gap can be reported: which operation is wrong needs the filter itself."""
    log, choices = open_case(shows(defect), seed=4)
    hand_in(filtered(log, choices, present(defect.plant)), tmp_path)
    found = checked(tmp_path, log, choices)
    assert found.outcome == "disagree"
    first = found.causes[0]
    if CAUSES[defect.name][0] == "algebra":
        assert first.gap == "algebra", first
    else:
        assert named_first(defect, found), first


@pytest.mark.slow
def test_a_coarse_filter_that_fuses_late_is_told(tmp_path: Path, case: Case) -> None:
    """No step ends when the measurements are taken: each is fused 25 ms later."""
    log, choices, comparison = case
    hand_in(comparison.ekf, tmp_path)

    def later(columns: Columns) -> None:
        columns["update_step"] = np.minimum(columns["update_step"] + 1, len(columns["step_f"]))

    edit_trace(tmp_path / TRACE, later)
    found = checked(tmp_path, log, choices)
    assert found.grade.value == "equal"  # for the estimate has been fused in time
    assert any("measurements are used too late, by 0.025 s" in said for said in found.remarks)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "the measurements are fused 1 odometry sample early",
        "the heading term of the x row of F is m",
    ],
)
def test_what_follows_from_a_fault_is_none(tmp_path: Path, plain: Plain, words: str) -> None:
    """Measurements of another time: no algebra, no model. A wrong F: no Q, though composed."""
    log, choices, _ = plain
    log = first_seconds(log, 12.0)
    fault = TriedFaults(log).named(words)
    run = filtered(log, choices, fault.plant or (lambda ekf: None))
    if fault.feed is not None:
        run = filtered(fault.feed(log), choices)
    hand_in(run, tmp_path)
    causes = present(checked(tmp_path, log, choices).trace).verdict.causes
    own = [one for one in causes if one.gap in FILTER_FAULTS]
    if fault.feed is not None:
        assert [one.gap for one in own] == ["data"]
        assert "measurements are used too early, by 0.025 s (median)" in own[0].evidence
    else:
        assert [one.gap for one in own] == ["model"]
        assert "the Jacobian with respect to heading differs" in own[0].evidence
        assert "noise covariance" not in own[0].evidence


@pytest.mark.slow
def test_a_late_path_is_not_moved_back_beside_its_trace(tmp_path: Path) -> None:
    """The trace would no longer fit it, and says how its filter moved."""
    log, choices = open_case("loop", seed=4)
    log = first_seconds(log, 12.0)
    assert isinstance(log.odometry, SteeringOdometry)
    speed, steering = (
        np.concatenate((np.zeros(8), values[:-8]))
        for values in (log.odometry.speed_mps, log.odometry.steering_rad)
    )
    late = replace(log.odometry, speed_mps=speed, steering_rad=steering)
    hand_in(filtered(replace(log, odometry=late), choices), tmp_path)
    found = check(log, read_external(tmp_path), CheckConfig(gps=choices.gps))
    assert found.outcome == "disagree"
    assert found.causes[0].gap == "model"


@pytest.mark.slow
def test_without_the_joint_covariance_the_model_is_still_judged(tmp_path: Path, case: Case) -> None:
    log, choices, comparison = case
    hand_in(comparison.ekf, tmp_path)
    (tmp_path / "covariances.npz").unlink()
    found = checked(tmp_path, log, choices)
    assert present(found.trace).algebra is None
    assert_same(present(found.trace).agreement.model, comparison.agreement.model)
    assert any("algebra is not checked" in remark for remark in found.remarks)


def put(name: str, row: int, value: float) -> Callable[[Columns], None]:
    def edit(columns: Columns) -> None:
        columns[name][row] = value

    return edit


BAD: dict[str, tuple[Callable[[Columns], object], str]] = {
    "fraction": (
        put("update_measurement", 3, 0.5),
        "numbers holds a value that is not a whole",
    ),
    "backwards": (put("step_time_s", 7, 0.0), "expected a time after"),
    "no measurement": (put("update_measurement", 0, 1e9), "uses measurement 1000000000"),
    "weight": (put("update_weight", 0, 0.0), "weight is 0, expected 1e-09 to 1"),
    "end": (put("step_time_s", -1, 1e3), "the last step ends at"),
    "too early": (lambda a: a["step_time_s"].__isub__(1e3), "the first step ends at"),
}


@pytest.fixture(scope="module")
def plain() -> Plain:
    log, choices = open_case("loop", seed=4)
    return log, choices, filtered(log, choices)


@pytest.mark.parametrize("name", BAD)
def test_damage_is_one_line(
    tmp_path: Path, plain: Plain, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before any reference filter runs."""
    monkeypatch.setattr("comparisons.jobs.grading._references", pytest.fail)
    log, choices, run = plain
    hand_in(run, tmp_path)
    edit, reported = BAD[name]
    edit_trace(tmp_path / TRACE, edit)
    with pytest.raises(InputError, match=reported) as caught:
        checked(tmp_path, log, choices)
    assert str(tmp_path / TRACE) in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [False, True])
def test_each_kind_of_record_that_differs_is_named(
    tmp_path: Path, plain: Plain, steps: bool
) -> None:
    """A wrong F is not lost beside three differences of landmark initialisation, nor invented."""
    log, choices, run = plain
    begun, f = run.trace.initialisations[POINT], run.trace.f.copy()
    f[:, 0, 2] += 1e-4 if steps else 0.0
    begun = replace(
        begun,
        jacobian_pose=1.1 * begun.jacobian_pose,
        jacobian_other=2.0 * begun.jacobian_other,
        noise=9.0 * begun.noise,
    )
    kinds = {**run.trace.initialisations, POINT: begun}
    hand_in(replace(run, trace=replace(run.trace, initialisations=kinds, f=f)), tmp_path)
    found = checked(tmp_path, log, choices)
    causes = present(found.trace).verdict.causes  # the estimate itself is right
    (said,) = [one.evidence for one in causes if one.gap == "model"]
    assert re.search(
        r"Jacobian with respect to [\w ]+ differs [^;]* landmark initialisations", said
    )
    assert re.search(r"the noise covariance differs [^;]* landmark initialisations", said)
    wrong = re.search(r"the Jacobian with respect to heading differs [^;]* predictions", said)
    assert (wrong is not None) is steps
    assert "measurement updates" not in said


@pytest.mark.slow
def test_a_noise_that_is_no_covariance_is_the_first_cause(tmp_path: Path, plain: Plain) -> None:
    """Though the estimate equals the reference; with the sound noise it agrees."""
    log, choices, run = plain
    kinds = dict(run.trace.measurements)
    noise = kinds[POINT].noise.copy()
    noise[5, 0, 1] += 0.5 * np.sqrt(noise[5, 0, 0] * noise[5, 1, 1])
    kinds[POINT] = replace(kinds[POINT], noise=noise)
    wrong = replace(run, trace=replace(run.trace, measurements=kinds))
    hand_in(wrong, tmp_path / "wrong")
    hand_in(run, tmp_path / "right")
    found = check(log, read_external(tmp_path / "wrong"), CheckConfig(gps=choices.gps))
    assert found.outcome == "disagree"
    first = found.causes[0]
    assert first.gap == "invalid"
    assert "noise (R) is not symmetric at" in first.evidence
    assert "its trace shows a fault" in CheckReport.of(found).page().words
    assert checked(tmp_path / "right", log, choices).outcome == "agree"


def test_a_start_and_a_step_may_be_known_exactly_in_some_direction(plain: Plain) -> None:
    """Its equations, filtered, are its equations, solved; what stands for nothing is not."""
    run = plain[2]
    along = run.trace.q[0] @ np.array((1.0, 0.0, 0.0))
    rest = run.trace.q * np.outer((1.0, 0.0, 1.0), (1.0, 0.0, 1.0))
    assert along.any()
    start = np.diag((0.0, 1e-3, 0.0))
    trace = replace(run.trace, prior_covariance=start, q=rest)
    until, landmarks = run.timeline.steps_until(), len(run.estimate.landmark)
    filtered_again = replay(trace, until, landmarks, np.float64).last

    def apart(other: TraceArrays) -> Gap:
        moved = replace(run, trace=other)
        solved = Gaussian(*solve_recorded(recorded_system_of(moved), moved), run.estimate.layout)
        return gap(solved, filtered_again, np.sqrt(np.diag(filtered_again.covariance)))

    assert apart(trace).within(1e-9)
    assert not apart(replace(trace, q=rest + 1e-6 * run.trace.q)).within(1e-9)
    assert not apart(replace(trace, prior_covariance=start + 1e-6 * np.eye(3))).within(1e-9)


def test_a_landmark_that_begins_and_is_measured_at_one_instant(tmp_path: Path) -> None:
    """Filtered again in the order of events: measured first, it would not be there yet."""
    rng, path = np.random.default_rng(3), tmp_path / TRACE
    h, r = rng.normal(size=(2, 5)), np.diag((0.5, 0.25))
    with Recorder(path) as record:
        record.prior({"pose": 3}, np.eye(3), point=np.zeros(3))
        record.at(1.0)
        record.predict(P, 0.1 * P, point=np.zeros(3), after=np.zeros(3))
        record.augment("landmark 1", HALF, EYE, r, ["pose"], after=np.ones(2), **AT)
        blocks, point = ["pose", "landmark 1"], np.array((0.0, 0.0, 0.0, 1.0, 1.0))
        record.update("x", EYE[0], h, r, blocks, point=point, numbers=1)
    filtered_again = replay(read_trace(path).trace, np.array((0, 1)), 1, np.float64).last
    prior, *others = TraceReader(path)
    assert isinstance(prior, TracePrior)
    by_events = Replay(prior)
    fused = [by_events.apply(event) for event in others][-1]
    np.testing.assert_allclose(filtered_again.covariance, by_events.covariance, rtol=1e-12)
    np.testing.assert_allclose(filtered_again.mean, point + present(fused).applied, rtol=1e-12)


@pytest.mark.slow
def test_steps_without_noise_are_a_difference_of_the_models(tmp_path: Path, plain: Plain) -> None:
    log, choices, run = plain
    hand_in(run, tmp_path)
    edit_trace(tmp_path / TRACE, lambda columns: columns.update(step_q=0.0 * columns["step_q"]))
    causes = present(checked(tmp_path, log, choices).trace).verdict.causes
    said = next(one.evidence for one in causes if one.gap == "model")
    assert "the noise covariance differs by up to 1 (relative)" in said


P, EYE, HALF = np.eye(3), np.eye(2), np.eye(2, 3)
AT: dict[str, Any] = {"point": np.zeros(3), "numbers": 0}


def copied_landmark(record: Recorder) -> None:
    """Two landmarks, an update of both, and a copy of one."""
    pair(record, np.eye(4, 7, 3), np.eye(4))
    record.clone("landmark 1", "copy")


def removed_pose(record: Recorder) -> None:
    """Two landmarks, an update of both, and no pose after that."""
    pair(record, np.eye(4, 7, 3), np.eye(4))
    record.remove("pose")


def pair(record: Recorder, h: Array, r: Array) -> None:
    """Two landmarks, and an update of both."""
    for name in ("landmark 1", "landmark 2"):
        record.augment(name, HALF, EYE, EYE, ["pose"], after=np.zeros(2), **AT)
    blocks, point = ["pose", "landmark 1", "landmark 2"], np.zeros(7)
    record.update("x", np.zeros(len(h)), h, r, blocks, point=point, numbers=[0, 1])


def predict(record: Recorder, **points: Any) -> None:
    record.at(1.0)
    record.predict(P, P, **points)


UNLIKE: dict[str, tuple[Callable[[Recorder], None], str]] = {
    "no time": (lambda r: r.predict(P, P, point=P[0], after=P[0]), "event 1: has no time; set it"),
    "no point": (predict, "event 1: has no point, which a comparison with a log needs"),
    "no after": (lambda r: predict(r, point=P[0]), "event 1: has no after"),
    "no numbers": (lambda r: r.update("x", EYE[0], HALF, EYE, point=P[0]), "has no numbers"),
    "numbers": (
        lambda r: r.update("x", EYE[0], HALF, EYE, point=P[0], numbers=[1, 2, 3]),
        "event 1: numbers has 3 numbers, expected 1",
    ),
    "odd": (lambda r: r.update("x", P[0], P, P, **AT), "event 1: has a residual that is not of"),
    "clone": (
        copied_landmark,
        "event 4: copies 'landmark 1'; expected a copy of the pose",
    ),
    "pose removed": (removed_pose, "event 4: removes the pose"),
    "three entries": (
        lambda r: pair(r, np.eye(3, 7, 3), np.eye(3)),
        "event 3: has a residual that is not of two entries for each measurement; expected so, or",
    ),
    "wide": (
        lambda r: r.augment("tree 1", P, P, P, after=P[0], **AT),
        "event 1: block 'tree 1' has 3 entries, expected a point",
    ),
    "two in one": (lambda r: pair(r, np.ones((2, 7)), EYE), "event 3: has a measurement that"),
    "correlated": (
        lambda r: pair(r, np.eye(4, 7, 3), np.eye(4) + 0.1),
        "event 3: has noise that is correlated between measurements",
    ),
}


@pytest.mark.parametrize("name", UNLIKE)
def test_events_of_another_filter_are_one_line(tmp_path: Path, name: str) -> None:
    call, said = UNLIKE[name]
    with Recorder(tmp_path / TRACE) as record:
        record.prior({"pose": 3}, P, point=np.zeros(3))
        call(record)
    with pytest.raises(InputError, match=said):
        read_trace(tmp_path / TRACE).placed(LandmarkNames({}, [1, 2]))


def test_a_trace_stands_anywhere(tmp_path: Path, plain: Plain) -> None:
    hand_in(plain[2], tmp_path)
    beside, elsewhere = read_external(tmp_path), tmp_path.parent / "elsewhere.trace"
    (tmp_path / TRACE).rename(elsewhere)
    assert read_external(tmp_path).trace is None
    found = read_external(tmp_path, trace=elsewhere)
    np.testing.assert_array_equal(present(found.trace).trace.f, present(beside.trace).trace.f)
    assert "elsewhere.trace" in found.sha256
    with pytest.raises(InputError, match="is no folder; --trace needs one"):
        read_external(tmp_path / "trajectory.tum", trace=elsewhere)


def test_a_trace_needs_landmarks(tmp_path: Path, plain: Plain) -> None:
    hand_in(plain[2], tmp_path)
    (tmp_path / "landmarks.csv").unlink()
    (tmp_path / "covariances.npz").unlink()
    with pytest.raises(InputError, match=r"filter\.trace: needs landmarks\.csv beside"):
        read_external(tmp_path)


@pytest.mark.slow
def test_the_commands(tmp_path: Path) -> None:
    works("run", "simulated-loop", "--trace", "--out", "report", cwd=tmp_path)
    printed = works(
        "check", "simulated-loop", "--estimate", "report/ekf", "--out", "c", cwd=tmp_path
    )
    assert "\nalgebra " in printed
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c", "report"]
