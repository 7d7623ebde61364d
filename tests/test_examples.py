"""The examples run, and print the figures they promise."""

import math
import resource
import runpy
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

from comparisons.config import CheckConfig
from comparisons.estimates.external import read_external
from comparisons.experiments.scenarios.scenario import read_scenario
from comparisons.experiments.scenarios.world import build_world, log_of_run
from comparisons.jobs.check import check
from comparisons.jobs.external_check import ExternalCheck
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from tests.helpers import present
from tests.processes import compiled, ran, works

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run(name: str, *arguments: str) -> Any:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"](*arguments)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["01_ekf_slam", "05_dense_map"])
def test_a_figure_is_drawn(name: str, tmp_path: Path) -> None:
    figure = tmp_path / "figure.png"
    run(name, str(figure))
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_ekf_slam_is_consistent(capsys: pytest.CaptureFixture[str]) -> None:
    assert 0.07 < run("01_ekf_slam") < 14.2  # 99 % of chi-square of 3, two-sided
    assert "30 landmarks" in capsys.readouterr().out


def test_the_compressed_filter_equals_the_full_one() -> None:
    assert run("02_compressed_equals_full") < 1e-9


@pytest.mark.slow
def test_a_fix_in_parts_is_nearer_to_consistent() -> None:
    nees = run("03_sequential_gps")
    assert nees["in parts"] < 6.0 < 30.0 < nees["at once"]


@pytest.mark.slow
def test_the_renormalised_filter_is_near_that_of_the_heading() -> None:
    heading, published, renormalised = run("04_misono").values()
    assert math.isclose(heading, renormalised, rel_tol=0.01)
    assert published > 10.0 * heading


@pytest.mark.slow
def test_a_dense_map_moves_with_its_landmarks() -> None:
    errors = run("05_dense_map")
    assert errors["in regions"] < 0.5 * errors["placed once"]


@pytest.mark.slow
def test_a_bug_shows_in_its_gap() -> None:
    found = list(run("06_check_my_filter").values())
    assert [one.outcome for one in found] == ["agree", "disagree", "disagree"]
    gaps = [[cause.gap for cause in one.causes] for one in found]
    assert gaps == [[], ["fault", "algebra"], ["fault", "model"]]


@pytest.fixture(scope="module")
def log_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `slamcheck montecarlo nieto-loop --keep 0` leaves, the beginning of it."""
    scenario = read_scenario("nieto-loop").model_copy(update={"steps": 400})
    folder = tmp_path_factory.mktemp("own") / "log"
    write_log_folder(log_of_run(build_world(scenario), 0, "nieto-loop-0"), folder)
    return folder


OWN = (EXAMPLES / "own_filter" / "my_ekf.py").read_text()


def checked(source: str, folder: Path, log: Path) -> ExternalCheck:
    """What `slamcheck check --require like` finds of an own filter's output."""
    program, out = folder / "my_ekf.py", folder / "out"
    program.write_text(source)
    alone = (sys.executable, "-I", str(program), str(log), str(out))
    subprocess.run(alone, check=True, cwd=folder, timeout=120)
    return check(read_log_folder(log), read_external(out), CheckConfig(require="like"))


@pytest.mark.slow
def test_the_own_filter_is_like_ours(log_folder: Path, tmp_path: Path) -> None:
    assert all(name not in OWN for name in ("import comparisons", "from comparisons", "gtsam"))
    assert len([one for one in OWN.splitlines() if one.strip()]) < 120
    found = checked(OWN, tmp_path, log_folder)
    assert (found.outcome, found.grade.value) == ("agree", "equal")
    assert found.trace is not None


SEEN = 'seen["bearing_rad"][k]'


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "gaps", "reported"),
    [
        (SEEN, f"-{SEEN}", ["fault", "model"], "the bearing has the opposite sign"),
        ("self.p[:, :3] @ f.T", "self.p[:, :3] @ f", ["algebra"], ""),
    ],
)
def test_a_broken_own_filter_is_wrong(
    log_folder: Path, tmp_path: Path, old: str, new: str, gaps: list[str], reported: str
) -> None:
    assert old in OWN
    found = checked(OWN.replace(old, new), tmp_path, log_folder)
    assert found.outcome == "disagree"
    assert found.grade.value == "wrong"
    assert [one.gap for one in found.causes[: len(gaps)]] == gaps
    assert reported in found.causes[len(gaps) - 1].hint


WRITER = """
#include "estimate_writer.hpp"
#include <iostream>
int main(int count, char** words) try {
  slamcheck::Estimate e;
  for (int k = 0; k < 50; ++k) {
    const double u = 1.0 / (k + 3);
    e.time_s.push_back(1e9 + k + u);
    e.pose.push_back({u, -1e5 * u, 0.25 * k});
    e.pose_covariance.push_back({1 + u, u, 0, u, 2, -u, 0, -u, 3 - u});
  }
  e.landmark_id = {9007199254740991, 0};
  e.landmark = {{1.0 / 3.0, -2e-300}, {1e9 + 0.1, 4}};
  for (int i = 0; i < 49; ++i) e.joint_covariance.push_back(1.0 / (1 + i));
  e.information = "smoothed";
  if (count > 2) e.landmark.pop_back();
  slamcheck::write_estimate(e, words[1]);
} catch (const std::exception& error) {
  std::cerr << error.what() << std::endl;
  return 1;
}
"""


@pytest.fixture
def build(tmp_path: Path) -> Callable[..., Path]:
    """A program of a source, with a piece of the header replaced."""
    header = EXAMPLES / "cpp" / "estimate_writer.hpp"
    return lambda source, old="", new="": compiled(tmp_path, source, header, old=old, new=new)


@pytest.mark.slow
def test_what_cpp_writes_is_read_to_the_bit(build: Callable[..., Path], tmp_path: Path) -> None:
    program, out = build(WRITER), tmp_path / "out"
    works(program, out)
    given, k = read_external(out), np.arange(50)
    u = 1.0 / (k + 3.0)
    assert np.array_equal(given.time_s, 1e9 + k + u)
    assert np.array_equal(given.pose[:, :2], np.column_stack((u, -1e5 * u)))
    assert given.pose[:, 2] == pytest.approx(0.25 * k, abs=1e-14)
    assert present(given.pose_covariance)[7].ravel().tolist() == [
        1 + u[7], u[7], 0, u[7], 2, -u[7], 0, -u[7], 3 - u[7]
    ]  # fmt: skip
    assert present(given.landmark_id).tolist() == [9007199254740991, 0]
    assert present(given.landmark).tolist() == [[1.0 / 3.0, -2e-300], [1e9 + 0.1, 4.0]]
    assert np.array_equal(present(given.joint_covariance).ravel(), 1.0 / np.arange(1.0, 50.0))
    assert given.information == "smoothed"
    assert sorted(path.name for path in tmp_path.iterdir() if "part" in path.name) == []
    for words, reported in (
        ((str(out),), "already exists: "),
        ((f"{out}2", "x"), "landmark: expect"),
    ):
        done = ran(program, *words)
        assert done.returncode == 1
        assert reported in done.stderr
    assert not (tmp_path / "out2").exists()


def _little_room() -> None:
    """A file beyond 3000 bytes ends the process where it is, in the middle of its work."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


@pytest.mark.slow
@pytest.mark.parametrize("broken", [False, True])
def test_a_killed_cpp_writer_leaves_no_half_folder(
    build: Callable[..., Path], tmp_path: Path, broken: bool
) -> None:
    part = 'target.parent_path() / ("." + target.filename().string() + ".part-" +'
    program = build(WRITER, part, f"true ? target : {part}") if broken else build(WRITER)
    words = (program, str(tmp_path / "out"))
    done = subprocess.run(words, preexec_fn=_little_room, capture_output=True, timeout=60)
    assert done.returncode == -signal.SIGXFSZ
    assert (tmp_path / "out").exists() == broken


@pytest.mark.slow
def test_the_cpp_example_runs(build: Callable[..., Path], log_folder: Path, tmp_path: Path) -> None:
    program = build((EXAMPLES / "cpp" / "write_estimate.cpp").read_text())
    log = read_log_folder(log_folder)
    works(program, log_folder, tmp_path / "out", *map(str, log.prior.pose.tolist()))
    given = read_external(tmp_path / "out")
    assert np.array_equal(given.time_s, log.odometry.time_s)
    assert given.absent == ["landmarks", "landmark covariances", "joint covariance"]


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path) -> None:
    notebook = nbformat.reads(path.read_text(), as_version=4)  # type: ignore[no-untyped-call]
    assert not any(cell.get("outputs") for cell in notebook.cells), "kept without outputs"
    resources = {"metadata": {"path": str(EXAMPLES)}}
    NotebookClient(notebook, timeout=120, resources=resources).execute()
