"""Fingerprints let another processor's rounding pass, and nothing that is ten times as large."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.golden.cases import CASES
from tests.golden.fingerprint import (
    COVARIANCE,
    EXACT,
    GAP,
    OPTIMUM,
    Fingerprint,
    Kind,
    differences,
    of_folder,
)
from tests.golden.run import run_case

CASE = CASES["loop-0-full-known"]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run."""
    work = tmp_path_factory.mktemp("fingerprint")
    run_case(CASE, work)
    return work / CASE.name


def moved(values: np.ndarray, kind: Kind, times: float) -> np.ndarray:
    """Numbers off by `times` what their kind allows."""
    return np.asarray(values + times * kind.relative * kind.size(values))


def moved_array(folder: Path, name: str, kind: Kind, times: float) -> None:
    """The first variance of all matrices."""
    path, key = folder / name.split(":")[0], name.split(":")[1]
    with np.load(path) as arrays:
        found = dict(arrays)
    found[key][:, 0, 0] = moved(found[key][:, 0, 0], kind, times)
    np.savez(path, **found)


def moved_column(folder: Path, name: str, kind: Kind, times: float) -> None:
    """The second number of all lines."""
    path = folder / name
    lines = [line.split() for line in path.read_text().splitlines()]
    values = moved(np.array([float(line[1]) for line in lines]), kind, times)
    rows = [[a, repr(b), *rest] for (a, _, *rest), b in zip(lines, values.tolist(), strict=True)]
    path.write_text("\n".join(" ".join(row) for row in rows) + "\n")


def moved_figure(folder: Path, name: str, kind: Kind, times: float) -> None:
    """One number of the result."""
    path, keys = folder / "result.json", name.split(".")
    whole = json.loads(path.read_text())
    inner = whole
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = float(moved(np.array([inner[keys[-1]]]), kind, times)[0])
    path.write_text(json.dumps(whole))


PERTURBED = {
    "a filter's covariances": (EXACT, moved_array, "ekf/covariances.npz:pose"),
    "a filter's path": (EXACT, moved_column, "ekf/trajectory.tum"),
    "a filter's consistency": (EXACT, moved_figure, "consistency.ekf.pose.mean"),
    "an optimum's covariances": (COVARIANCE, moved_array, "smoother/covariances.npz:pose"),
    "an optimum's path": (OPTIMUM, moved_column, "smoother/trajectory.tum"),
    "a distance from the optimum": (OPTIMUM, moved_figure, "agreement.pose.distance_sigma"),
    "a gap at rounding": (GAP, moved_figure, "agreement.algebra_gap_sigma"),
}


@pytest.mark.parametrize(("times", "equal"), [(0.3, True), (10.0, False)])
@pytest.mark.parametrize("name", PERTURBED)
def test_each_kind_has_its_limit(
    name: str, times: float, equal: bool, sound: Path, tmp_path: Path
) -> None:
    """Figures are off by `times` what their kind allows."""
    kind, change, what = PERTURBED[name]
    shutil.copytree(sound, tmp_path / "run")
    change(tmp_path / "run", what, kind, times)
    found = differences(of_folder(sound, ""), of_folder(tmp_path / "run", ""))
    assert (not found) is equal, found
    assert all(what.split(":")[0].split(".")[0] in line for line in found)


def test_equal_to_the_bit_is_asked_for(sound: Path, tmp_path: Path) -> None:
    shutil.copytree(sound, tmp_path / "run")
    moved_array(tmp_path / "run", "ekf/covariances.npz:pose", EXACT, 1e-6)
    kept, found = of_folder(sound, ""), of_folder(tmp_path / "run", "")
    assert differences(kept, found) == []
    assert differences(kept, found, bits=True) == ["ekf/covariances.npz:pose: its last bits differ"]


@pytest.mark.parametrize(
    ("said", "equal"),
    [
        ("distance 0.124 m of 60 landmarks: agree", True),
        ("distance 0.173 m of 60 landmarks: agree", False),
        ("distance 0.123 m of 61 landmarks: agree", False),
        ("distance 0.123 m of 60 landmarks: disagree", False),
        ("distance -0.123 m of 60 landmarks: agree", False),
        ("distance 1.2e-02 m of 60 landmarks: agree", False),
    ],
)
def test_a_text_may_differ_by_its_last_digit(said: str, equal: bool, tmp_path: Path) -> None:
    """A rounded number lies between two others; words and counts do not."""
    kept = of_folder(tmp_path, "distance 0.123 m of 60 landmarks: agree")
    assert (not differences(kept, of_folder(tmp_path, said))) is equal


def test_a_gap_at_rounding_may_be_any(tmp_path: Path) -> None:
    kept = of_folder(tmp_path, "algebra gap 1.4e-12 sigma")
    assert differences(kept, of_folder(tmp_path, "algebra gap 3.3e-11 sigma")) == []
    assert differences(kept, of_folder(tmp_path, "algebra gap 3.3e-05 sigma")) != []


def test_what_appears_and_disappears_is_named(sound: Path) -> None:
    kept = of_folder(sound, "")
    fewer: dict[str, Fingerprint] = {k: v for k, v in kept.items() if k != "printed"}
    assert differences(kept, fewer) == ["printed: is no longer there"]
    assert differences(fewer, kept) == ["printed: was not there"]


def test_a_lost_line_is_seen(sound: Path, tmp_path: Path) -> None:
    shutil.copytree(sound, tmp_path / "run")
    path = tmp_path / "run" / "ekf" / "trajectory.tum"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    found = differences(of_folder(sound, ""), of_folder(tmp_path / "run", ""))
    assert len(found) == 8
    assert all(line.startswith("ekf/trajectory.tum:") for line in found)
