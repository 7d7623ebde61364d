"""The documented way from an empty folder to a verdict, and on to a gate, in a fresh environment.

Commands, files and outputs are those of the pages; each step is a test, in the pages' order.
"""

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.fresh_environment import ROOT
from tests.processes import ran

WAY = ROOT / "docs" / "your-own-filter.md"
GATES = ROOT / "docs" / "regression-gates.md"
WORKFLOW = ROOT / "examples" / "ci" / "slamcheck.yml"
STRICT = "addopts = --strict-markers --strict-config\nfilterwarnings = error\nxfail_strict = true\n"

pytestmark = pytest.mark.slow


class Step(NamedTuple):
    """A command of a page and what the page shows of its output."""

    command: str
    shown: str


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


def steps(block: str) -> Iterator[Step]:
    """The commands behind `$`, those that go on after a backslash as one."""
    for part in re.split(r"^\$ ", block.replace("\\\n", ""), flags=re.MULTILINE)[1:]:
        command, _, shown = part.partition("\n")
        yield Step(" ".join(command.split()), shown)


def missing(shown: str, printed: str) -> list[str]:
    """Pieces of what a page shows, between `...`, that a command has not printed in this order.

    However lines are broken; figures of rounding errors are as good as any other.
    """

    def flat(text: str) -> str:
        return re.sub(r"\d(\.\d+)?e-1\d", "0", " ".join(text.split()))

    faults, rest = [], flat(printed)
    for line in shown.splitlines():
        for piece in filter(None, (flat(one) for one in line.split("..."))):
            _, found, behind = rest.partition(piece)
            if not found:
                faults.append(piece)
            rest = behind if found else rest
    return faults


TEN = list(steps(blocks(WAY, "console")[0]))
BREAK, TEST = (list(steps(block)) for block in blocks(GATES, "console"))


@pytest.fixture(scope="module")
def project(scripts: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty folder beside the project's, with the environment that the first commands make."""
    folder = tmp_path_factory.mktemp("mine") / "project"
    folder.mkdir()
    (folder.parent / "slamcheck").symlink_to(ROOT)
    (folder / ".venv").symlink_to(scripts.parent)
    return folder


def run(project: Path, command: str, **more: str) -> subprocess.CompletedProcess[str]:
    """A command as in a terminal in which `. .venv/bin/activate` was run."""
    env = {"PATH": os.defpath, "OPENBLAS_NUM_THREADS": "1", **more}
    return ran("bash", "-e", "-c", f". .venv/bin/activate\n{command}", cwd=project, env=env)


def follow(project: Path, step: Step, code: int = 0) -> None:
    """Run a step; it must end with a code and print what its page shows."""
    done = run(project, step.command)
    assert done.returncode == code, done.stdout + done.stderr
    assert missing(step.shown, done.stdout) == [], done.stdout


def test_there_are_ten_commands_and_the_first_make_this_environment(
    scripts: Path, project: Path
) -> None:
    assert len(TEN) == 10
    assert [step.command for step in TEN[:3]] == [
        "python3 -m venv .venv",
        ". .venv/bin/activate",
        "pip install ../slamcheck pytest",
    ]
    where = run(project, "command -v slamcheck; python -c 'import comparisons as c; print(c)'")
    program, package = where.stdout.splitlines()
    assert program == str(scripts / "slamcheck")
    assert f"'{scripts.parent}/lib/" in package  # installed, not the sources


@pytest.mark.parametrize("step", TEN[3:], ids=lambda step: step.command[:40])
def test_a_command_does_what_the_page_shows(step: Step, project: Path) -> None:
    follow(project, step)


def test_what_the_page_does_not_show_is_noticed() -> None:
    printed = "grade    equal to\n    an EKF\ngap 1.3e-12 sigma\nverdict: agree\n"
    assert missing("...\ngrade equal to ... EKF\ngap 2e-15 sigma\nverdict: agree\n", printed) == []
    assert missing("verdict: disagree\n", printed) == ["verdict: disagree"]
    assert missing("verdict: agree\ngrade equal\n", printed) == ["grade equal"]


def test_the_workflow_passes(project: Path) -> None:
    """All its steps but the installation, with the shell that runs them in earnest."""
    assert set(workflow(project).values()) == {0}
    assert (project / "reports" / "check" / "report.html").exists()


def workflow(project: Path) -> dict[str, int]:
    """Exit codes of the workflow's commands by name, each run whatever the others did."""
    found: Any = pytest.importorskip("ruamel.yaml").YAML(typ="safe").load(WORKFLOW.read_text())
    names = {name: str(value) for name, value in found["env"].items()}
    return {
        step["name"]: run(project, step["run"], **names).returncode
        for step in found["jobs"]["gate"]["steps"]
        if "run" in step and step["name"] != "Install"
    }


@pytest.mark.parametrize(
    ("step", "code"),
    list(zip(BREAK, (0, 0, 1), strict=True)),
    ids=lambda value: str(getattr(value, "command", value))[:40],
)
def test_a_broken_filter_is_worse_than_the_baseline(step: Step, code: int, project: Path) -> None:
    follow(project, step, code)


def test_the_workflow_stops_the_broken_filter(project: Path) -> None:
    shutil.rmtree(project / "reports", ignore_errors=True)
    assert list(workflow(project).values()) == [0, 1, 1]
    assert (project / "reports" / "check" / "check.json").exists()
    assert "<failure" in (project / "reports" / "baseline.xml").read_text()


@pytest.mark.parametrize(
    ("step", "code"),
    list(zip(TEST, (1, 0, 0), strict=True)),
    ids=lambda value: str(getattr(value, "command", value))[:40],
)
def test_tests_fail_with_the_broken_filter_and_pass_with_the_mended_one(
    step: Step, code: int, project: Path
) -> None:
    (ini,), (test,) = blocks(GATES, "ini"), blocks(GATES, "python")
    (project / "pytest.ini").write_text(ini + STRICT)
    (project / "test_my_filter.py").write_text(test)
    follow(project, step, code)
    assert (project / "slamcheck-reports/test_my_filter/test_my_filter-my-drive").is_dir()
