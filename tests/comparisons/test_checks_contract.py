"""Every check keeps its contract: it says what it asks and needs, and finds or says why not."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from comparisons.checks.check import Check
from comparisons.checks.finding import Absent, Finding
from comparisons.checks.registry import CHECKS
from comparisons.figures import kept_fields, meanings
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log, Truth
from comparisons.report.explain import every_check
from comparisons.report.run import RunReport, run_rows
from tests.commands import refused, works
from tests.helpers import compared, simulated


def bare(log: Log) -> Log:
    return replace(log, truth=Truth())


def as_it_is(log: Log) -> Log:
    return log


@pytest.mark.parametrize("check", every_check(), ids=lambda one: one.name)
def test_a_check_says_what_it_asks_and_needs_and_what_its_figures_mean(check: type[Check]) -> None:
    question = inspect.cleandoc(check.__doc__ or "").splitlines()[0]
    assert question.endswith("?")
    assert check.needs
    assert check.errs
    for kind in check.figures:
        assert kept_fields(kind).keys() <= meanings(kind).keys()


def unaccounted(c: Comparison) -> list[str]:
    """Checks that neither found something nor said why not, or did both."""
    return [one.name for one in CHECKS if (one.name in c.findings) == (one.name in c.absent)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "association", "lacking"),
    [
        (as_it_is, "known", {"association", "positions"}),
        (as_it_is, "nn", {"positions"}),
        (bare, "known", {"accuracy", "association", "positions", "truth_gap"}),
    ],
)
def test_a_check_finds_or_says_what_the_log_lacks(
    change: Callable[[Log], Log], association: str, lacking: set[str]
) -> None:
    c = compared(change(simulated()), association=association)
    assert c.absent.keys() == lacking
    assert unaccounted(c) == []
    silent = replace(c, absent={})
    assert set(unaccounted(silent)) == lacking, "a check that is silent was not seen"


def test_what_is_found_and_what_is_not_stand_in_result_and_table() -> None:
    c = compared(bare(simulated()))
    result = RunReport.build(c)
    kept = json.loads(result.model_dump_json())
    assert kept["not_checked"] == dict(c.absent)
    entries = {key for found in c.findings.values() for key in found.entries}
    assert entries <= {key for key, value in kept.items() if value is not None}
    assert all(kept[name] is None for name in ("accuracy", "association", "truth_gap"))
    rows = [row for row in run_rows(c, result) if row.group == "Not checked"]
    assert [(row.quantity.replace(" ", "_"), row.value) for row in rows] == list(c.absent.items())


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
