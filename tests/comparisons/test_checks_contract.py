"""Every check keeps its contract: it says what it asks and needs, and finds or says why not."""

import inspect
import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache, cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.checks.accuracy import CheckAccuracy
from comparisons.checks.check import Answers, Check, Question
from comparisons.checks.explaining import CheckDropouts, Explaining
from comparisons.checks.finding import Absent, Finding
from comparisons.checks.qualifiers import TRUTH_GAP
from comparisons.checks.registry import BASIS, CHECKS, EXPLAINING, OF_RUN
from comparisons.checks.smoother import AboutSmoother
from comparisons.checks.verdict import counting, decided, faulty
from comparisons.estimates.external import ExternalEstimate
from comparisons.figures import kept_fields, meanings
from comparisons.jobs.check import check
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log, Truth
from comparisons.pipeline.known import Known
from comparisons.pipeline.records import FilterRecords
from comparisons.pipeline.solve import solve
from comparisons.report.explain import event_checks, every_check
from comparisons.report.html.page import page
from comparisons.report.job import Report, report_of
from comparisons.report.panels import known_panels
from comparisons.report.run import RunReport
from comparisons.rounding import Allowed
from comparisons.words import Cause
from tests.commands import refused, works
from tests.helpers import altered, compared, present, simulated


def bare(log: Log) -> Log:
    return replace(log, truth=Truth())


def as_it_is(log: Log) -> Log:
    return log


@pytest.mark.parametrize(
    "check",
    [*every_check(), *event_checks()],
    ids=lambda one: f"{one.name} ({one.of})",
)
def test_a_check_says_what_it_asks_and_needs_and_what_its_figures_mean(
    check: type[Question[Any]],
) -> None:
    question = inspect.cleandoc(check.__doc__ or "").splitlines()[0]
    assert question.endswith("?")
    assert check.needs
    assert check.errs
    for _, kind in check.figures:
        assert kept_fields(kind).keys() <= meanings(kind).keys()


POSITIONS = {"positions", "unused_positions"}
"""Checks that need absolute positions."""
NO_POSITIONS = {
    "association": "by the log's labels",
    "unused_positions": "absolute positions that no estimator has used",
}


def unaccounted(c: Comparison) -> list[str]:
    """Checks that neither found something nor said why not, or did both."""
    return [one.name for one in CHECKS if (one.name in c.findings) == (one.name in c.known.absent)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "association", "lacking"),
    [
        (as_it_is, "known", {"association", *POSITIONS}),
        (as_it_is, "nn", {*POSITIONS}),
        (bare, "known", {"accuracy", "association", "truth_gap", *POSITIONS}),
    ],
)
def test_a_check_finds_or_says_what_the_log_lacks(
    change: Callable[[Log], Log], association: str, lacking: set[str]
) -> None:
    c = compared(change(simulated()), association=association)
    assert c.known.absent.keys() == lacking
    assert unaccounted(c) == []
    silent = altered(c, "known.absent", {})
    assert set(unaccounted(silent)) == lacking, "a check that is silent was not seen"


def test_what_is_found_and_what_is_not_stand_in_result_and_table() -> None:
    c = compared(bare(simulated()))
    result = RunReport.build(c)
    kept = json.loads(result.model_dump_json())
    assert kept["not_checked"] == dict(c.known.absent)
    entries = {key for found in c.findings.values() for key in found.entries}
    parts = [type(part) for part in (*BASIS, *OF_RUN)]
    assert entries <= {key for check in (*parts, *every_check()) for key, _ in check.figures}
    assert entries <= {key for key, value in kept.items() if value is not None}
    assert all(kept[name] is None for name in ("accuracy", "association", "truth_gap"))
    rows = [row for row in RunReport.of(c).summary().rows if row.group == "Not checked"]
    said = {name: row.value for row in rows for name in row.quantity.split(", ")}
    assert said == {name.replace("_", " "): why for name, why in c.known.absent.items()}
    assert len({row.value for row in rows}) == len(rows)


class Hidden(FilterRecords):
    """Those of a filter of which double precision tells nothing."""

    @cached_property
    def algebra(self) -> Allowed:
        return Allowed(1.0, 1.0)


OF_EVENTS = ("spurious_heading", "positions", "data", "algebra", "model", "breakdown",
             "linearisation")  # fmt: skip
"""Checks that need a filter with the events that it went through."""


@cache
def jobs() -> dict[str, tuple[Known, Report[Any, Any]]]:
    """A short log by each job whose checks are asked; its truth lies elsewhere."""
    log = simulated(loop_s=20.0)
    poses = present(log.truth.poses)
    turned = replace(poses, pose=poses.pose + (3.0, 3.0, 0.0))
    log = replace(log, truth=Truth(poses=turned))
    c = compared(log)
    checked = check(log, ExternalEstimate.of(c.ekf.estimate))
    solution = solve(log)
    return {
        "run": (c.known, report_of(c)),
        "check": (checked.known, report_of(checked)),
        "solve": (solution.known, report_of(solution)),
    }


PARTS = {
    "run": {one.name for one in OF_RUN},
    "check": {"smoother", "grade"},
    "solve": {"map", "smoother"},
}
"""What a job has besides its log and settings."""


@pytest.mark.parametrize(
    ("job", "lacking"),
    [
        ("run", {**NO_POSITIONS, "positions": "no absolute positions"}),
        ("check", {**NO_POSITIONS, **dict.fromkeys(OF_EVENTS, "no trace")}),
        ("solve", {**NO_POSITIONS, **dict.fromkeys(OF_EVENTS, "no filter")}),
    ],
)
def test_every_job_asks_every_check_and_shows_what_it_says(
    job: str, lacking: dict[str, str]
) -> None:
    known, report = jobs()[job]
    asked = {*known.findings, *known.absent}
    assert asked == {one.name for one in CHECKS} | {one.name for one in BASIS} | PARTS[job]
    assert not known.findings.keys() & known.absent.keys()
    assert known.absent.keys() == lacking.keys()
    assert all(words in known.absent[name] for name, words in lacking.items())
    result, shown = report.result, page(report.page())
    kept = json.loads(result.model_dump_json())
    assert kept["not_checked"] == known.absent
    assert known.entries.keys() <= {key for key, value in kept.items() if value is not None}
    assert json.loads(type(result).model_validate(kept).model_dump_json()) == kept
    rows = report.summary().rows
    assert set(known.rows()) <= set(rows)
    for row in known.rows():
        assert escape(row.value) in shown, row
    assert TRUTH_GAP in result.qualifiers
    causes = [f"{one.gap} gap: {one.evidence}" for one in getattr(result, "causes", ())]
    said = [one for one in (*causes, *result.remarks) if one.startswith("truth gap: ")]
    assert len(said) == 1
    assert "the smoother is far from the truth" in said[0]
    assert f"{result.verdict}, truth gap" in report.summary().headline


def new_job(log: Log) -> Answers:
    """A job with no report of its own: what it knows, which checks, and its name."""
    before = solve(log).answers.before
    return Answers(replace(before, name="likely"), (*BASIS, AboutSmoother(), CheckAccuracy()))


def test_a_new_job_is_reported_as_every_other(tmp_path: Path) -> None:
    report = report_of(new_job(simulated(loop_s=20.0)))
    found = json.loads(report.write(tmp_path / "job").read_text())
    assert (tmp_path / "job" / "likely.json").is_file()
    assert {"log", "settings", "smoother", "accuracy", "seconds", "files"} <= found.keys()
    assert found["log"]["name"] in (tmp_path / "job" / "report.html").read_text()
    assert "smoother/trajectory.tum" in found["files"]
    summary = report.summary()
    assert summary.headline == "likely: simulated-loop"
    assert [name for name, _ in summary.lines] == ["accuracy"]
    groups = dict.fromkeys(row.group for row in summary.rows)
    assert [*groups][:3] == ["Log", "Settings", "Smoother"]
    assert report.outcome == "agree"


def test_the_page_of_a_job_without_a_filter_shows_the_errors_of_its_optimum() -> None:
    known, report = jobs()["solve"]
    reported, panels = known_panels(known)
    assert reported == "the smoother's pose against truth"
    assert [one.title[:5] for one in panels] == ["east ", "north", "headi", "NEES "]
    east = panels[0].curves[0]
    at = np.isin(known.smoothed.time_s, east.x)
    poses = present(known.prepared.log.truth.poses)
    true = np.interp(east.x, poses.time_s, poses.pose[:, 0])
    assert np.allclose(east.y, known.smoothed.pose[at, 0] - true, atol=1e-9)
    assert np.abs(east.y).min() > 1.0, "the truth lies 3 m farther east"
    assert "smoother - truth" in page(report.page())
    assert known_panels(replace(known, findings={})) == ("", ())


@pytest.mark.parametrize(
    ("kinds", "outcome"),
    [
        ((), "agree"),
        (("noise", "dropout", "truth"), "agree"),
        (("oracle",), "unverified"),
        (("linearisation",), "disagree"),
        (("linearisation", "oracle"), "unverified"),
        (("oracle", "motion"), "disagree"),
        (("algebra", "oracle"), "disagree"),
        (("a check's own",), "disagree"),
        (("a check's own", "oracle"), "unverified"),
    ],
)
def test_the_kinds_of_causes_decide(kinds: tuple[str, ...], outcome: str) -> None:
    causes = [Cause(kind, "evidence", "hint") for kind in kinds]
    assert decided(causes) == decided(causes[::-1]) == outcome


def found(known: Known, *kinds: str) -> list[str]:
    """The causes that count of those that checks have found."""
    causes = [Cause(kind, "evidence", "hint") for kind in kinds]
    return [one.gap for one in counting(replace(known, findings={"all": Explaining(causes)}))]


@pytest.mark.parametrize(
    ("kinds", "count"),
    [
        (("positions", "linearisation"), ("positions", "linearisation")),
        (("motion", "linearisation", "log"), ("log", "linearisation", "motion")),
        (("dropout", "noise"), ()),
        (("dropout", "oracle", "noise"), ("oracle", "noise", "dropout")),
        (("linearisation", "oracle", "association"), ("association", "oracle")),
        (("log", "oracle", "model", "data"), ("model", "data")),
    ],
)  # fmt: skip
def test_causes_count_by_their_kinds_in_the_order_of_the_catalogue(
    kinds: tuple[str, ...], count: tuple[str, ...]
) -> None:
    known = jobs()["run"][0]
    assert found(known, *kinds) == list(count)


def test_where_rounding_hides_everything_no_other_cause_counts() -> None:
    known = jobs()["run"][0]
    hidden = replace(known, kept=Hidden(known.gaps))
    kinds = "linearisation", "association", "oracle", "noise"
    assert found(hidden, *kinds) == ["oracle"]
    assert found(hidden, *kinds, "algebra") == ["algebra"]
    assert faulty(hidden)
    assert not faulty(known)


def test_what_explains_is_asked_where_there_is_something_to_explain() -> None:
    known = jobs()["run"][0]
    off = replace(known, findings={"all": Explaining([Cause("linearisation", "far", "look")])})
    for one in EXPLAINING:
        assert one.find(known) is None
    assert isinstance(CheckDropouts().find(off), Explaining)
    wrong = replace(off, findings={"all": Explaining([Cause("model", "wrong", "look")])})
    assert CheckDropouts().find(wrong) is None


def test_a_check_is_asked_once_and_what_it_reads_is_kept() -> None:
    """A check may ask another that it reads; poses that one has reckoned serve the report."""
    asked = []

    class Once(Check):
        name = "once"

        def find(self, known: Known) -> Finding:
            asked.append(known)
            return Finding()

    known = jobs()["run"][0]
    again = replace(known, findings={}, absent={})
    Once().ask(again)
    Once().ask(again)
    assert asked == [again]
    assert "dead_reckoned" in vars(known)
    assert "dead_reckoned" not in vars(again)


def test_a_finding_of_nothing_adds_nothing() -> None:
    found = Finding()
    assert not (*found.entries, *found.causes, *found.remarks, *found.rows(), *found.sections())
    assert Absent("the log has no truth").why == "the log has no truth"


def test_explain_lists_checks_and_causes_and_says_what_each_means(tmp_path: Path) -> None:
    listed = works("explain", cwd=tmp_path)
    assert all(f"\n  {one.name} " in listed for one in every_check())
    assert "asks:   Does the verdict hold" in works("explain", "own-association", cwd=tmp_path)
    assert "\n  linearisation " in listed
    check = works("explain", "truth_gap", cwd=tmp_path)
    assert works("explain", "truth gap", cwd=tmp_path).startswith(check.rstrip())
    assert "needs:  truth, or labels" in check
    assert "stands: the smoother is far from truth" in check
    assert "linearised at the wrong points" in works("explain", "linearisation", cwd=tmp_path)
    assert "expected one of spurious_heading" in refused("explain", "weather", cwd=tmp_path)
