"""The pytest plugin, and the workflow for continuous integration, in projects of their own."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from comparisons.baseline import build_baseline, write_baseline
from comparisons.config import CheckConfig
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.folder import tum_text, write_estimate
from comparisons.jobs.check import check
from comparisons.logs.log import Log
from comparisons.logs.log_folder import write_log_folder
from comparisons.report.check import CheckReport
from tests.helpers import compared, simulated
from tests.processes import ROOT, python, run_pytest

WORKFLOW = ROOT / "examples" / "ci" / "slamcheck.yml"
STRICT = """\
[pytest]
slam_logs = logs
addopts = --strict-markers --strict-config
filterwarnings = error
xfail_strict = true
"""
COUNTING = """\
import warnings
from comparisons.pipeline import solve as module
plain = module.solve

def solve(*arguments):
    warnings.warn("as of a library; would be an error in the test's own code")
    with open("solved.txt", "a") as file:
        file.write("solved\\n")
    return plain(*arguments)

module.solve = solve
"""
TESTS = """\
import pytest

def test_right(slam_log, slam_check):
    found = slam_check(slam_log, estimate="mine", require="like")
    assert found.outcome == "agree"
    assert found.result.grade == "equal"
    wrong = slam_check(slam_log, estimate="late.tum")
    assert found and not wrong
    assert "time" in [cause.gap for cause in wrong.causes]
    assert "short, estimate late.tum: disagree (" in repr(wrong)

class TestGate:
    def test_late(self, slam_log, slam_check):
        assert slam_check(slam_log, estimate="late.tum").outcome == "agree"

def test_baseline(slam_log, slam_baseline):
    slam_baseline(slam_log, "mine.json", estimate="mine")
    slam_baseline(slam_log, "mine.json", estimate="late.tum")

def test_missing(slam_log, slam_check):
    slam_check(slam_log, estimate="nowhere.tum")

def test_other_settings(slam_log, slam_check):
    assert slam_check(slam_log, estimate="mine", robust="huber").outcome == "agree"

@pytest.mark.xfail
def test_known_fault(slam_log, slam_check):
    assert slam_check(slam_log, estimate="late.tum").outcome == "agree"
"""


@pytest.fixture(scope="module")
def log() -> Log:
    return replace(simulated(loop_s=20.0), name="short")


@pytest.fixture(scope="module")
def right(log: Log) -> Estimate:
    """The reference EKF's, standing in for somebody's filter."""
    return compared(log).ekf.estimate


def late(right: Estimate) -> str:
    return tum_text(right.time_s + 0.2, right.pose)


def project(folder: Path, log: Log, right: Estimate) -> None:
    """A log, a right and a wrong estimate, and the right one's baseline."""
    write_log_folder(log, folder / "logs" / "short")
    (folder / "mine").mkdir()
    write_estimate(right, folder / "mine")
    (folder / "late.tum").write_text(late(right))
    result = CheckReport.build(check(log, ExternalEstimate.of(right)))
    write_baseline(build_baseline([result], CheckConfig()), folder / "mine.json")


@pytest.mark.slow
def test_a_failure_shows_verdict_causes_and_report(
    tmp_path: Path, log: Log, right: Estimate
) -> None:
    project(tmp_path, log, right)
    (tmp_path / "pytest.ini").write_text(STRICT)
    (tmp_path / "conftest.py").write_text(COUNTING)
    (tmp_path / "test_gate.py").write_text(TESTS)
    done = run_pytest(cwd=tmp_path)
    assert "3 failed, 2 passed, 1 xfailed" in done.stdout, done.stdout + done.stderr
    for line in (
        "E       AssertionError: assert 'disagree' == 'agree': time: the time stamps are 0.200 s",
        "E       Failed: time: the time stamps are 0.200 s too late",
        "E         short, estimate late.tum: disagree, grade wrong, required plausible",
        "\n  time: the time stamps are 0.200 s too late",
        "E         report: slamcheck-reports/test_gate/TestGate--test_late-short",
        "mine.json: ",
        "E       broken: grade: equal then, wrong now",
        "E       comparisons.errors.InputError: nowhere.tum: no such file or folder, expected",
        "slamcheck: short, estimate late.tum",
        "\nverdict: disagree; grade: wrong (required: plausible)\n",
    ):
        assert line in done.stdout, (line, done.stdout)
    assert re.search(r"^E         hint: check the clocks", done.stdout, re.MULTILINE)
    assert "external.py" not in done.stdout
    reports = tmp_path / "slamcheck-reports" / "test_gate"
    assert sorted(path.name for path in reports.iterdir()) == [
        "TestGate--test_late-short",
        "test_baseline-short",
        "test_baseline-short-2",
    ]
    assert (reports / "test_baseline-short-2" / "check.json").exists()
    # Once for each of the smoother's settings, whatever the estimate and what is required of it.
    assert (tmp_path / "solved.txt").read_text().count("solved") == 2


@pytest.mark.slow
def test_the_plugin_judges_every_log_of_a_folder_and_under_xdist(tmp_path: Path, log: Log) -> None:
    write_log_folder(log, tmp_path / "logs" / "short")
    other = replace(simulated(seed=1, loop_s=20.0), name="other")
    write_log_folder(other, tmp_path / "logs" / "other")
    (tmp_path / "pytest.ini").write_text(STRICT)
    (tmp_path / "test_gate.py").write_text(
        "def test_log(slam_log, slam_check):\n"
        "    expected = 'agree' if slam_log.name == 'short' else 'unverified'\n"
        "    assert slam_check(slam_log).outcome == expected\n"
    )
    done = run_pytest("-v", "-n", "2", "--slam-reports", "kept", cwd=tmp_path)
    assert "1 failed, 1 passed" in done.stdout, done.stdout + done.stderr
    assert "PASSED test_gate.py::test_log[short]" in done.stdout
    assert "assert 'agree' == 'unverified'" in done.stdout
    report = tmp_path / "kept" / "test_gate" / "test_log-other" / "report.html"
    assert report.exists()
    assert [path.name for path in (tmp_path / "kept" / "test_gate").iterdir()] == ["test_log-other"]


@pytest.mark.slow
def test_a_log_by_name_path_or_nothing_that_is_one(
    tmp_path: Path, log: Log, right: Estimate
) -> None:
    """As a name the settings of reading hold; a log that was read is not read again."""
    project(tmp_path, log, right)
    (tmp_path / "pytest.ini").write_text(STRICT)
    (tmp_path / "test_gate.py").write_text(
        "from pathlib import Path\n"
        "def test_path(slam_check, slam_baseline):\n"
        "    assert slam_check(Path('logs/short'), estimate='mine').outcome == 'agree'\n"
        "    slam_baseline('logs/short', 'mine.json', estimate='mine')\n"
        "def test_seed(slam_check):\n"
        "    found = [slam_check('simulated-loop', seed=n).result.log.sha256 for n in (0, 1)]\n"
        "    assert found[0] != found[1]\n"
        "def test_number(slam_check):\n"
        "    slam_check(3)\n"
        "def test_read(slam_log, slam_check):\n"
        "    slam_check(slam_log, seed=5)\n"
    )
    done = run_pytest(cwd=tmp_path)
    assert "2 failed, 2 passed" in done.stdout, done.stdout + done.stderr
    assert "InputError: log: is a int, expected slam_log, a name or a path" in done.stdout
    assert "InputError: option seed: is unknown" in done.stdout
    assert "AttributeError" not in done.stdout


@pytest.mark.slow
def test_the_plugin_loads_nothing_before_a_test_asks() -> None:
    """Broken variant: the module of the fixtures' work, which does load it."""
    code = (
        "import sys, pytest, {}\n"
        "heavy = {{'numpy', 'gtsam', 'scipy', 'matplotlib', 'pydantic', 'rich'}}\n"
        "assert not heavy & set(sys.modules), sorted(heavy & set(sys.modules))\n"
    )
    assert python("-c", code.format("slamcheck.pytest_plugin")).returncode == 0
    assert python("-c", code.format("comparisons.baseline")).returncode == 1


def steps() -> list[dict[str, Any]]:
    """The workflow's steps."""
    yaml = pytest.importorskip("ruamel.yaml").YAML(typ="safe")
    (job,) = yaml.load(WORKFLOW.read_text())["jobs"].values()
    return list(job["steps"])


def test_the_workflow_keeps_reports_of_a_failure() -> None:
    found = {step.get("name"): step for step in steps()}
    kept = found["Keep the reports"]
    assert kept["if"] == "${{ !cancelled() }}"
    assert kept["with"]["path"] == "reports/"
    assert "reports/check" in found["Check the estimate"]["run"]
    assert "reports/baseline.xml" in found["Compare with the baseline"]["run"]
    installed = next(step["with"] for step in steps() if "setup-python" in step.get("uses", ""))
    assert installed["cache"] == "pip"
