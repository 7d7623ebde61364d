"""What a run says of its heading that nothing measured: cause, result.json, curve."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.audit import spurious
from comparisons.audit.audit import audit
from comparisons.audit.own_filter import write_run
from comparisons.audit.spurious import HEADING, LargestShare, Learnt, LearntDirection
from comparisons.checks.linearisation import linearisation_cause
from comparisons.checks.spurious import SpuriousFinding, spurious_rows
from comparisons.jobs.run import Comparison
from comparisons.report.html.curves import panel_data
from comparisons.report.panels import consistency_panels
from comparisons.report.run import RunReport
from comparisons.trace.events import Event, Update
from comparisons.trace.reader import TraceReader
from tests.comparisons.test_known_landmarks import with_survey
from tests.helpers import altered, compared, present, simulated
from tests.scenarios import scenario


@cache
def sound() -> Comparison:
    return compared(simulated(seed=3, loop_s=30.0))


def learnt(c: Comparison) -> Learnt:
    return present(c.known.value(SpuriousFinding))


def with_information(information: float) -> Learnt:
    """One that has learnt its heading alone, most of it in the second half."""
    largest = LargestShare(8, 15.0, "landmarks", 40.0, ("pose", "landmark 7"))
    heading = LearntDirection(HEADING, "deg", information, {}, largest)
    growth = np.array([[0.0], [0.1], [1.0]]) * information
    return Learnt((heading,), np.eye(1), np.arange(3), np.array([0.0, 10.0, 20.0]), growth)


def test_a_run_says_how_its_information_grew() -> None:
    c = sound()
    found, result = learnt(c), RunReport.build(c).spurious_heading
    assert result is not None
    time_s, information = found.curve(HEADING)
    assert found.of(HEADING).information > 1.0
    assert (np.diff(information) >= 0.0).all()
    assert time_s[0] == c.ekf.estimate.time_s[0]
    assert time_s[-1] == c.ekf.estimate.time_s[-1]
    assert result.information == found.of(HEADING).information == result.growth[-1]
    assert np.isclose(np.deg2rad(present(result.sigma_deg)), result.information**-0.5, rtol=1e-12)
    assert len(result.time_s) == len(result.growth) <= 101
    assert result.largest is not None
    assert result.largest.landmark.startswith("landmark ")
    assert 0.0 < result.largest.information <= result.information
    assert 0.0 < result.fastest <= result.information


def test_the_cause_says_it_where_it_matters() -> None:
    c = sound()
    found = with_information(np.deg2rad(0.8) ** -2)

    def evidence(own_deg: float, found: Learnt = found) -> str:
        own = np.tile(np.deg2rad(own_deg) ** 2 * np.eye(3), (len(c.ekf.estimate.pose), 1, 1))
        run = replace(c.ekf, estimate=replace(c.ekf.estimate, pose_covariance=own))
        return linearisation_cause(c.agreement, run, None, found).evidence

    assert evidence(0.2).endswith(
        "the filter claims its absolute heading to 0.8 degrees, which no measurement observes "
        "(gained fastest from 10.0 to 20.0 s; the largest single gain is with landmark 7 at 15.0 s)"
    )
    assert "claims" not in evidence(0.07)
    nothing = found._replace(
        directions=(replace(found.of(HEADING), information=0.0, largest=None),)
    )
    assert "claims" not in evidence(0.2, nothing)


def half_of_the_updates(events: Iterable[Event]) -> Iterator[Event]:
    """Broken: every second update is forgotten."""
    updates = 0
    for event in events:
        updates += isinstance(event, Update)
        if updates % 2 or not isinstance(event, Update):
            yield event


def first_estimates(events: Iterable[Event]) -> Iterator[Event]:
    """Broken: updates have Jacobians of landmarks as they were when first measured."""
    first: dict[tuple[str, ...], Array] = {}
    for event in events:
        if isinstance(event, Update):
            jacobian = first.setdefault(event.blocks, event.jacobian)
            if jacobian.shape == event.jacobian.shape:
                yield event._replace(jacobian=jacobian)
                continue
        yield event


GOLDEN: dict[str, Callable[[], Comparison]] = {
    "loop-1-compressed-nn": lambda: compared(
        scenario("simulated-loop", seed=1), filter="compressed", association="nn"
    ),
    "loop-2-misono-jcbb": lambda: compared(
        scenario("simulated-loop", seed=2), filter="misono", association="jcbb"
    ),
    "scan-slam-own": lambda: compared(
        scenario("scan-slam", seed=1, seconds=14.0),
        landmarks="scans",
        smoother_matcher="generalised-icp",
        template_extraction="per-segment",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", GOLDEN)
def test_run_and_audit_say_the_same(name: str, tmp_path: Path) -> None:
    c, trace = GOLDEN[name](), tmp_path / "run.trace"
    said = learnt(c).of(HEADING).sigma
    write_run(c.ekf, trace)
    found = present(audit(trace).learnt)
    assert 0.0 < said < 180.0
    assert found.of(HEADING).sigma == pytest.approx(said, rel=1e-6)
    for broken in (half_of_the_updates, first_estimates):
        wrong = present(spurious.learnt(broken(TraceReader(trace))))
        assert wrong.of(HEADING).sigma != pytest.approx(said, rel=1e-6)


def test_surveyed_landmarks_tell_the_heading() -> None:
    c = compared(with_survey(simulated(seed=2, loop_s=30.0)))
    assert c.known.value(SpuriousFinding) is None
    assert RunReport.build(c).spurious_heading is None
    assert consistency_panels(c).learnt is None


@pytest.mark.slow
def test_a_pose_of_four_entries_is_turned_in_its_own() -> None:
    """Misono's full filter is linearised much like the EKF; without the columns it is not."""
    log = simulated(seed=1, loop_s=40.0)
    usual, full, published = (
        learnt(compared(log, filter=f)).of(HEADING).information
        for f in ("full", "misono-full", "misono")
    )
    assert 0.2 < full / usual < 5.0
    assert published > 10.0 * usual


def test_the_curve_starts_where_something_was_learnt() -> None:
    c = sound()
    panel = present(consistency_panels(c).learnt)
    assert panel.logarithmic
    data = panel_data(panel, 0.0)
    told, own = data["curves"]
    assert told["name"] == "spurious"
    assert told["y"][0] is None
    known = [y for y in told["y"] if y is not None]
    assert known == sorted(known, reverse=True)
    assert own["name"] == "EKF's own"


def test_the_page_has_its_figures() -> None:
    c = sound()
    result = RunReport.build(c)
    rows = [
        row for row in RunReport.of(c).summary().rows if row.group.startswith("Absolute heading")
    ]
    named = ["standard deviation", "gained fastest", "largest gain by one update"]
    assert [row.quantity for row in rows] == named
    assert rows[0].value == f"{present(result.spurious_heading).sigma_deg:.3g} deg"
    nothing = present(result.spurious_heading).model_copy(update={"sigma_deg": 1e12})
    assert [row.value for row in spurious_rows(nothing)] == ["none claimed"]


def test_nothing_learnt_is_not_drawn() -> None:
    c, faint = sound(), SpuriousFinding(with_information(1e-26))
    nothing = altered(c, "known.findings", {**c.findings, "spurious_heading": faint})
    assert consistency_panels(nothing).learnt is None
