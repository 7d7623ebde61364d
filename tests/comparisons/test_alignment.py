"""A log's truth, and an estimate, of another frame: laid onto the log's start."""

from dataclasses import replace

import numpy as np
import pytest

from comparisons.adapters.alignment import PlaneMotion, with_prior_pose, with_truth_at_start
from comparisons.checks.diagnosis.alignment import laid_at_start
from comparisons.config import LogSection, RunConfig
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.logs.log import Log, Poses, Truth
from comparisons.pipeline.read import read_for
from tests.helpers import present, simulated

MOTION = PlaneMotion(0.7, np.array([30.0, -4.0]))
START = (5.0, 6.0, 0.3)


def moved(poses: Poses, motion: PlaneMotion = MOTION) -> Poses:
    """Poses in another frame."""
    places = motion.places(poses.pose[:, :2])
    return Poses(poses.time_s, np.column_stack((places, poses.pose[:, 2] + motion.turn_rad)))


@pytest.fixture(scope="module")
def log() -> Log:
    return simulated(loop_s=5.0)


def test_truth_of_another_frame_comes_back(log: Log) -> None:
    """With its map; it is exact, since the log starts at the truth."""
    truth = log.truth
    marks, poses = present(truth.landmarks), present(truth.poses)
    covariance = MOTION.rotation @ marks.covariance @ MOTION.rotation.T
    elsewhere = replace(marks, position_m=MOTION.places(marks.position_m), covariance=covariance)
    given = replace(log, truth=Truth(moved(poses), elsewhere))
    found = with_truth_at_start(given).truth
    assert present(found.poses).pose == pytest.approx(poses.pose, abs=1e-9)
    assert present(found.landmarks).position_m == pytest.approx(marks.position_m, abs=1e-9)
    assert present(found.landmarks).covariance == pytest.approx(marks.covariance, abs=1e-12)
    assert present(given.truth.poses).pose != pytest.approx(poses.pose, abs=1.0)


def test_truth_that_begins_later_lies_on_the_odometry(log: Log) -> None:
    poses = present(log.truth.poses)
    late = Poses(poses.time_s[4:], poses.pose[4:])
    found = with_truth_at_start(replace(log, truth=Truth(moved(late))))
    assert present(found.truth.poses).pose[0] == pytest.approx(poses.pose[4], abs=0.05)
    never = Poses(poses.time_s + 1e4, poses.pose)
    with pytest.raises(InputError, match="no true pose lies in the log's time, expected one for"):
        with_truth_at_start(replace(log, truth=Truth(never)))


def test_another_start_is_taken_with_its_truth(log: Log) -> None:
    found = with_truth_at_start(with_prior_pose(log, START))
    assert found.prior.pose.tolist() == list(START)
    assert found.prior.covariance.tolist() == log.prior.covariance.tolist()
    assert present(found.truth.poses).at(np.array([log.prior.time_s]))[0] == pytest.approx(START)


def test_an_estimate_of_another_frame_comes_back(log: Log) -> None:
    """Poses, map and covariances as one; by the opposite turn they would not."""
    poses, rng = present(log.truth.poses), np.random.default_rng(0)
    roots = rng.normal(size=(len(poses.time_s), 3, 3))
    turn = np.eye(3)
    turn[:2, :2] = MOTION.rotation
    covariance = roots @ roots.swapaxes(1, 2)
    marks = np.array([[1.0, 2.0], [3.0, -4.0]])
    given = ExternalEstimate(
        time_s=poses.time_s,
        pose=moved(poses).pose,
        landmark_id=np.arange(2),
        landmark=MOTION.places(marks),
        pose_covariance=turn @ covariance @ turn.T,
    )
    found, said = laid_at_start(given, given.time_s, log)
    assert found.pose == pytest.approx(poses.pose, abs=1e-9)
    assert present(found.landmark) == pytest.approx(marks, abs=1e-9)
    assert present(found.pose_covariance) == pytest.approx(covariance, abs=1e-9)
    assert found.time_s.tolist() == given.time_s.tolist()
    assert said.startswith("aligned: the estimate was turned by -40.11 degrees and moved by (")
    wrong = moved(poses, PlaneMotion(-0.7, MOTION.shift_m))
    other, _ = laid_at_start(replace(given, pose=wrong.pose), given.time_s, log)
    assert present(other.landmark) != pytest.approx(marks, abs=1e-3)


def test_what_cannot_be_aligned_is_refused(log: Log) -> None:
    poses = present(log.truth.poses)
    given = ExternalEstimate(time_s=poses.time_s + 1e4, pose=poses.pose)
    with pytest.raises(InputError, match="--align: no pose of the estimate lies in the log's time"):
        laid_at_start(given, given.time_s, log)
    for pose in ("1,2", "1,2,x", "1,2,nan"):
        with pytest.raises(ValueError, match="expected x,y,heading in m and rad"):
            LogSection.model_validate({"prior_pose": pose})


def test_a_job_reads_its_log_so() -> None:
    section = LogSection(source="simulated-loop", prior_pose=START, align=True)
    log, config, _ = read_for(RunConfig(log=section))
    assert log.prior.pose.tolist() == list(START)
    assert present(log.truth.poses).at(np.array([log.prior.time_s]))[0] == pytest.approx(START)
    assert config.log.prior_pose == START
