"""What estimates know beside the odometry alone, and that is said where it is next to nothing."""

from dataclasses import replace

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.checks.gained import GainFinding
from comparisons.config import EkfConfig
from comparisons.logs.log import Log
from ekf_reference.core.trace import Trace
from graphslam import increments
from graphslam.increments import dead_reckoned_covariance
from research.trust.odometry_drives import drive
from tests.helpers import compared, simulated

SAID = "know next to nothing that the odometry alone does not tell"


def predicted(log: Log) -> Array:
    """(K, 3, 3) of a filter that measures nothing, at the epochs."""
    ekf = build_ekf(log, settle(EkfConfig(), log), Trace())
    timeline, found, done = build_timeline(log), [], 0
    for until in timeline.steps_until().tolist():
        for i in range(done, until):
            duration_s = float(timeline.step_duration_s[i])
            ekf.predict(timeline.control[i], timeline.control_covariance[i], duration_s)
        done = until
        found.append(ekf.state.pose_covariance)
    return np.array(found)


def of_odometry(log: Log) -> Array:
    known = compared(log).known
    problem = known.result.problem
    return dead_reckoned_covariance(
        problem.prior_covariance, known.dead_reckoned, problem.increment_covariance
    )


@pytest.mark.parametrize("kind", ["velocity", "steering", "relative poses"])
def test_it_is_what_a_filter_predicts_without_measurements(kind: str) -> None:
    log = drive(1, kind, 101)
    expected, found = predicted(log), of_odometry(log)
    unit = np.sqrt(np.einsum("kii->ki", expected))
    assert np.abs((found - expected) / (unit[:, :, None] * unit[:, None])).max() < 1e-9


def test_errors_that_turn_nothing_after_them_would_be_noticed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = drive(1, "velocity", 101)
    expected = predicted(log)
    monkeypatch.setattr(increments, "_about", lambda place: np.tile(np.eye(3), (len(place), 1, 1)))
    assert of_odometry(log)[-1, 0, 0] < 0.9 * expected[-1, 0, 0]


def test_landmarks_that_tell_nothing_are_said_to() -> None:
    log = simulated(loop_s=20.0)
    c = compared(log)
    said = c.findings["gain"]
    assert isinstance(said, GainFinding)
    assert all(gain.sigma_left < 0.5 for gain in said.value.values())
    assert not any(SAID in remark for remark in c.verdict.remarks)
    seen, every = log.measurements, np.ones(len(log.measurements.time_s))
    vague = replace(seen, sigma_range_m=30.0 * every, sigma_bearing_rad=3.0 * every)
    c = compared(replace(log, measurements=vague))
    (remark,) = [remark for remark in c.verdict.remarks if SAID in remark]
    assert remark.startswith("EKF and smoother")
