"""Extensions: one that is asked for takes part, one that is not costs nothing."""

import json
from pathlib import Path

import pytest

from comparisons.config import RunConfig
from comparisons.errors import InputError
from comparisons.extension_names import EXTENSIONS
from comparisons.jobs.run import compare
from comparisons.report.run import RunReport
from comparisons.settings import configure, run_config
from comparisons.words import Row
from tests.comparisons.test_startup import loaded
from tests.comparisons.toy_extension.extension import DockingFinding
from tests.helpers import simulated, written

ELSEWHERE = (
    "comparisons.audit.algebra",
    "comparisons.baseline",
    "comparisons.checks.grade",
    "comparisons.experiments",
    "comparisons.extensions",
    "comparisons.faults",
    "comparisons.fingerprints",
    "comparisons.jobs.check",
    "comparisons.jobs.external_check",
    "comparisons.jobs.grading",
    "comparisons.jobs.readings",
    "comparisons.report.check",
    "ekf_reference.dense",
    "ekf_reference.fastslam",
    "ekf_reference.features",
    "ekf_reference.scan_",
    "graphslam.association",
    "graphslam.sampling",
    "graphslam.scan.match",
)
"""Beginnings of what other jobs, extensions and doubts about a verdict need."""


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one line that an extension needs outside its folder."""
    monkeypatch.setitem(
        EXTENSIONS, "docking", "tests.comparisons.toy_extension.config:DockingConfig"
    )


@pytest.mark.slow
@pytest.mark.usefixtures("registered")
def test_a_toy_adds_a_source_a_finding_a_row_and_a_figure(tmp_path: Path) -> None:
    log = simulated(seed=1, loop_s=20.0)
    config = configure(RunConfig, settings=["docking.x_m=30", "docking.y_m=20"])
    found = compare(log, config)
    station = found.find(DockingFinding)
    assert found.verdict.outcome == "agree"
    assert station.result.measurements > 10
    assert station.result.ekf_m == pytest.approx((30.0, 20.0), abs=0.5)
    row = Row("Docking", "measurements", str(station.result.measurements))
    assert row in RunReport.of(found).summary().rows
    folder = written(found, tmp_path / "run")
    kept = json.loads((folder / "result.json").read_text())
    assert kept["docking"]["ekf_m"] == list(station.result.ekf_m)
    assert "docking.png" in kept["files"]
    assert (folder / "docking.png").read_bytes().startswith(b"\x89PNG")
    assert "<h2>Docking</h2>" in (folder / "report.html").read_text()
    again = configure(RunConfig, folder / "config.toml")
    assert again.extensions == found.prepared.config.extensions


@pytest.mark.usefixtures("registered")
def test_a_toy_that_lies_is_found_out() -> None:
    """What a source measures reaches the smoother, whose chi-square then contradicts."""
    log = simulated(seed=1, loop_s=20.0)
    right, wrong = (
        compare(
            log,
            configure(
                RunConfig, settings=["docking.x_m=30", "docking.y_m=20", f"docking.bias_m={bias}"]
            ),
        )
        for bias in (0.0, 1.0)
    )
    assert (
        wrong.smoother.optimality.chi_square.chi2 > 2.0 * right.smoother.optimality.chi_square.chi2
    )


@pytest.mark.usefixtures("registered")
def test_a_toys_settings_are_checked_like_any() -> None:
    with pytest.raises(InputError, match=r"extensions\.docking\.reach_m is -1: input should be"):
        configure(RunConfig, settings=["docking.reach_m=-1"])


def test_without_its_line_it_is_unknown() -> None:
    with pytest.raises(InputError, match="docking is unknown, expected one of preset, log, ekf"):
        configure(RunConfig, settings=["docking.x_m=1"])


@pytest.mark.slow
@pytest.mark.parametrize("log", ["simulated-loop", "victoria-park"])
def test_a_run_on_points_loads_no_extension(log: str, tmp_path: Path) -> None:
    """And little else that it does not need."""
    house = ("comparisons", "ekf_reference", "graphslam")
    found = {name for name in loaded(f"run {log}", tmp_path) if name.split(".")[0] in house}
    assert "comparisons.jobs.run" in found
    assert [name for name in sorted(found) if name.startswith(ELSEWHERE)] == []


def test_an_option_loads_its_extension_only() -> None:
    config = run_config(smoother_association="own")
    assert set(config.extensions) == {"own_association"}
