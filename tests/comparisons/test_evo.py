"""Against evo, where it is installed: it reads our trajectories and finds the same errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.accuracy import assess_trajectory
from comparisons.config import EkfConfig
from comparisons.estimates.trajectory_files import Trajectory, write_trajectory
from comparisons.logs.log import Poses
from tests.helpers import simulated


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
    assert log.truth.poses is not None
    true = log.truth.poses.at(estimate.time_s)
    judged = replace(log, truth=replace(log.truth, poses=Poses(estimate.time_s, true)))
    ours = assess_trajectory(estimate.time_s, estimate.pose, judged)
    assert ours is not None
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
