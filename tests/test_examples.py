"""The examples run, and print the figures they promise."""

from __future__ import annotations

import math
import runpy
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run(name: str, *arguments: str) -> Any:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"](*arguments)


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


def test_a_fix_in_parts_is_nearer_to_consistent() -> None:
    nees = run("03_sequential_gps")
    assert nees["in parts"] < 6.0 < 30.0 < nees["at once"]


def test_the_renormalised_filter_is_near_that_of_the_heading() -> None:
    heading, published, renormalised = run("04_misono").values()
    assert math.isclose(heading, renormalised, rel_tol=0.01)
    assert published > 10.0 * heading


def test_a_dense_map_moves_with_its_landmarks() -> None:
    errors = run("05_dense_map")
    assert errors["in regions"] < 0.5 * errors["placed once"]


def test_a_bug_shows_in_its_gap() -> None:
    found = list(run("06_check_my_filter").values())
    assert [one.outcome for one in found] == ["agree", "disagree", "disagree"]
    assert [{cause.gap for cause in one.causes} for one in found] == [set(), {"algebra"}, {"model"}]


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path) -> None:
    notebook = nbformat.reads(path.read_text(), as_version=4)  # type: ignore[no-untyped-call]
    assert not any(cell.get("outputs") for cell in notebook.cells), "kept without outputs"
    resources = {"metadata": {"path": str(EXAMPLES)}}
    NotebookClient(notebook, timeout=120, resources=resources).execute()
