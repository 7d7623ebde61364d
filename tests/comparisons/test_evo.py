"""Against evo, where it is installed: it reads our trajectories and finds the same errors."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.accuracy import RPE_M, assess_trajectory, relative_errors
from comparisons.config import EkfConfig
from comparisons.estimates.trajectory_files import Trajectory, write_trajectory
from comparisons.logs.log import Poses
from tests.helpers import present, simulated


@pytest.fixture(scope="module")
def evo() -> Any:
    """Its modules that are needed; it is not a requirement of the project."""
    pytest.importorskip("evo", reason="evo is not installed")
    from evo.core import metrics
    from evo.tools import file_interface

    return metrics, file_interface


@pytest.mark.filterwarnings("ignore")
def test_evo_finds_the_same_errors(tmp_path: Path, evo: Any) -> None:
    """Absolute trajectory errors, as they are and after a rigid alignment, to 1e-9 m."""
    metrics, file_interface = evo
    log = simulated(loop_s=40.0)
    estimate = run_ekf(log, build_timeline(log), settle(EkfConfig(), log)).estimate
    true = present(log.truth.poses).at(estimate.time_s)
    judged = replace(log, truth=replace(log.truth, poses=Poses(estimate.time_s, true)))
    ours = present(assess_trajectory(estimate.time_s, estimate.pose, judged))
    for name, pose in (("ours", estimate.pose), ("true", true)):
        (tmp_path / name).mkdir()
        trajectory = Trajectory(estimate.time_s, pose)
        write_trajectory(trajectory, tmp_path / name / "poses.tum", "tum")
        write_trajectory(trajectory, tmp_path / name / "poses.kitti", "kitti")
    for suffix, read in (
        ("tum", file_interface.read_tum_trajectory_file),
        ("kitti", file_interface.read_kitti_poses_file),
    ):
        reference, theirs = (
            read(str(tmp_path / name / f"poses.{suffix}")) for name in ("true", "ours")
        )
        for aligned, expected in ((False, ours.ate_m), (True, ours.ate_aligned_m)):
            if aligned:
                theirs.align(reference, correct_scale=False)
            error = metrics.APE(metrics.PoseRelation.translation_part)
            error.process_data((reference, theirs))
            found = error.get_statistic(metrics.StatisticsType.rmse)
            assert found == pytest.approx(expected, abs=1e-9)
            assert np.isfinite(found)
        for relation, expected in (("translation_part", ours.rpe_10m_m),
                                   ("rotation_angle_rad", ours.rpe_10m_rad)):  # fmt: skip
            assert rpe(metrics, relation, reference, theirs) == pytest.approx(expected, abs=1e-9)


def rpe(metrics: Any, relation: str, reference: Any, theirs: Any, way_m: float = RPE_M) -> float:
    """The root mean square of evo's relative errors, over metres of the reference's path."""
    error = metrics.RPE(
        metrics.PoseRelation[relation],
        delta=way_m,
        delta_unit=metrics.Unit.meters,
        all_pairs=True,
        pairs_from_reference=True,
    )
    error.process_data((reference, theirs))
    return float(error.get_statistic(metrics.StatisticsType.rmse))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("way_m", [0.5, 3.0, 20.0])
def test_evo_pairs_the_same_poses(tmp_path: Path, evo: Any, way_m: float) -> None:
    """On a path with stops, of uneven steps, and with headings that turn through pi."""
    metrics, file_interface = evo
    rng = np.random.default_rng(4)
    steps = rng.uniform(0.0, 1.0, 300) * (rng.random(300) > 0.3)
    heading = np.cumsum(rng.normal(0.0, 0.4, 300))
    true = np.column_stack(
        (np.cumsum(steps * np.cos(heading)), np.cumsum(steps * np.sin(heading)), heading)
    )
    pose = true + rng.normal(0.0, 0.3, true.shape)
    apart, turned = relative_errors(pose, true, way_m)
    time_s = np.arange(300.0)
    for name, path in (("true", true), ("ours", pose)):
        write_trajectory(Trajectory(time_s, path), tmp_path / f"{name}.tum", "tum")
    read = file_interface.read_tum_trajectory_file
    reference, theirs = (read(str(tmp_path / f"{name}.tum")) for name in ("true", "ours"))
    for relation, error in (("translation_part", apart), ("rotation_angle_rad", turned)):
        expected = rpe(metrics, relation, reference, theirs, way_m)
        assert float(np.sqrt(np.mean(error**2))) == pytest.approx(expected, abs=1e-9)
