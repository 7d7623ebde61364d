"""Trajectories against another one: evo's figures, and what `slamcheck compare` says of them."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.checks.path_errors import path_errors
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.trajectory_files import Trajectory, write_trajectory
from comparisons.statistics import chi2_quantile
from tests.commands import refused, works

SIGMA = np.array((0.2, 0.1, 0.02))
EVO = {"rms": "rmse", "mean": "mean", "median": "median", "std": "std", "min": "min", "max": "max"}


def drive(count: int = 400, step_s: float = 0.1) -> ExternalEstimate:
    """Two loops, so that the heading passes pi."""
    time_s = np.arange(count, dtype=np.float64) * step_s
    heading = 4.0 * np.pi * time_s / time_s[-1]
    steps = 2.0 * step_s * np.column_stack((np.cos(heading), np.sin(heading)))
    place = np.vstack((np.zeros(2), np.cumsum(steps[:-1], axis=0)))
    return ExternalEstimate(time_s=time_s, pose=np.column_stack((place, heading)))


def disturbed(reference: ExternalEstimate, seed: int = 3) -> Array:
    rng = np.random.default_rng(seed)
    pose: Array = reference.pose + SIGMA * rng.standard_normal(reference.pose.shape)
    return pose


def moved(pose: Array, turn: float = 0.7) -> Array:
    rotation = np.array(((np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))))
    return np.column_stack((pose[:, :2] @ rotation.T + (30.0, -5.0), pose[:, 2] + turn))


def written(path: Path, estimate: ExternalEstimate) -> Path:
    write_trajectory(Trajectory(estimate.time_s, estimate.pose), path, "tum")
    return path


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("align", [False, True])
@pytest.mark.parametrize("more", ["reference", "estimate", "neither"])
def test_evo_has_the_same_errors(tmp_path: Path, align: bool, more: str) -> None:
    """Of stamps that agree within its tolerance, with more of them in either."""
    pytest.importorskip("evo", reason="evo is not installed")
    from evo.core import metrics, sync
    from evo.tools import file_interface

    whole = drive()
    pose = moved(disturbed(whole)) if align else disturbed(whole)
    few, every = slice(20, None, 3), slice(None)
    ours, theirs = (few if more == other else every for other in ("reference", "estimate"))
    reference = ExternalEstimate(time_s=whole.time_s[theirs], pose=whole.pose[theirs])
    estimate = ExternalEstimate(time_s=whole.time_s[ours] + 0.004, pose=pose[ours])
    figures = path_errors(estimate, reference, align=align).figures()
    read = file_interface.read_tum_trajectory_file
    true, other = sync.associate_trajectories(
        read(str(written(tmp_path / "reference", reference))),
        read(str(written(tmp_path / "estimate", estimate))),
        max_diff=0.01,
    )
    if align:
        other.align(true, correct_scale=False)
    assert evo_figures(metrics, true, other) == pytest.approx(
        {name: number for name, number in figures.items() if name != "nees_per_dof"}, abs=1e-6
    )


def evo_figures(metrics: Any, true: Any, theirs: Any) -> dict[str, float]:
    along = {"delta": 10.0, "delta_unit": metrics.Unit.meters}
    paired = {**along, "all_pairs": True, "pairs_from_reference": True}
    errors = {
        "ape_m": metrics.APE(metrics.PoseRelation.translation_part),
        "ape_deg": metrics.APE(metrics.PoseRelation.rotation_angle_deg),
        "rpe_10m_m": metrics.RPE(metrics.PoseRelation.translation_part, **paired),
        "rpe_10m_deg": metrics.RPE(metrics.PoseRelation.rotation_angle_deg, **paired),
    }
    figures: dict[str, float] = {}
    for name, error in errors.items():
        error.process_data((true, theirs))
        statistics = error.get_all_statistics()
        figures |= {f"{name}.{word}": statistics[theirs_word] for word, theirs_word in EVO.items()}
    return figures


@pytest.mark.parametrize(("factor", "sound"), [(1.0, True), (0.8, False), (1.25, False)])
def test_nees_tells_whether_the_covariances_are_right(factor: float, sound: bool) -> None:
    reference = drive()
    covariance = np.tile(np.diag((factor * SIGMA) ** 2), (len(reference.time_s), 1, 1))
    estimate = ExternalEstimate(
        time_s=reference.time_s, pose=disturbed(reference), pose_covariance=covariance
    )
    nees, dof = path_errors(estimate, reference).nees, reference.pose.size
    assert nees is not None
    inside = chi2_quantile(0.0005, dof) < nees * dof < chi2_quantile(0.9995, dof)
    assert inside == sound
    assert path_errors(estimate, reference, align=True).nees is None


def test_a_heading_a_turn_further_is_the_same() -> None:
    reference = drive()
    turned = ExternalEstimate(
        time_s=reference.time_s, pose=reference.pose + (0.0, 0.0, 2.0 * np.pi)
    )
    assert path_errors(turned, reference).heading_rad.max() < 1e-12


def test_stamps_that_do_not_agree_are_refused() -> None:
    reference = drive()
    later = ExternalEstimate(time_s=reference.time_s + 1e3, pose=reference.pose)
    with pytest.raises(InputError, match=r"no stamps .* within 0.01 s .* 1000.0+ to 1039.9"):
        path_errors(later, reference)


def test_the_command(tmp_path: Path) -> None:
    reference = drive()
    written(tmp_path / "truth.tum", reference)
    pose = disturbed(reference)
    for name, poses in (("mine.tum", pose), ("moved.tum", moved(pose))):
        written(tmp_path / name, ExternalEstimate(time_s=reference.time_s, pose=poses))
    paths = ("truth.tum", "mine.tum", "moved.tum")
    apart = works("compare", *paths, "--out", "t.csv", cwd=tmp_path)
    assert "400 of 400" in apart
    assert "ape_m.rms" in apart
    works("compare", *paths, "--align", "--out", "t.csv", cwd=tmp_path)  # over the earlier table
    text = (tmp_path / "t.csv").read_text()
    rows = {row[0]: row[1:] for row in csv.reader(text.splitlines())}
    assert rows["name"] == ["mine.tum", "moved.tum"]
    assert rows["alignment"] == ["turned and moved"] * 2
    mine, other = map(float, rows["ape_m.rms"])
    assert mine == pytest.approx(other, rel=1e-6)
    assert mine == pytest.approx(np.hypot(*SIGMA[:2]), rel=0.1)


def test_the_page_has_a_map_curves_and_the_table(tmp_path: Path) -> None:
    reference = drive()
    written(tmp_path / "truth.tum", reference)
    name = "<i>mine.tum"
    written(tmp_path / name, ExternalEstimate(time_s=reference.time_s, pose=disturbed(reference)))
    for _ in range(2):  # the second over the first
        works("compare", "truth.tum", name, "--out", "t.html", cwd=tmp_path)
    page = (tmp_path / "t.html").read_text()
    assert "<i>" not in page
    for part in (
        'id="map"',
        "truth.tum trajectory",
        "turn from the reference [deg]",
        "ape_<wbr>m.",
    ):
        assert part in page
    assert refused("compare", "truth.tum", name, "--out", "truth.tum", cwd=tmp_path)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("truth.tum",), "truth.tum: holds no result of a job, and a trajectory alone has nothing"),
        (("truth.tum", "nowhere.tum"), "nowhere.tum: no such file or folder"),
        (("truth.tum", "empty"), "empty"),
        (("run", "--align"), "run: holds a result; --align is for trajectories"),
        (("truth.tum", "run"), "truth.tum: holds no result"),
        (("truth.tum", "truth.tum", "--only", "x_y"), "--only x_y: no figure is called so"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    written(tmp_path / "truth.tum", drive())
    (tmp_path / "empty").mkdir()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "result.json").write_text("{}")
    assert words in refused("compare", *arguments, cwd=tmp_path)
