"""Landmarks surveyed beforehand: absolute information through measurements (Guivant 2002, 4.2)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.logs.log import Landmarks, Log
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from comparisons.logs.transforms.known_landmarks import SURVEYED, join_known_measurements
from tests.helpers import assert_followed, compared, present, simulated

SIGMA = 0.05


def with_survey(log: Log, every: int = 6) -> Log:
    """Every sixth landmark is surveyed to 5 cm, and its measurements refer to the survey."""
    truth = present(log.truth.landmarks)
    rng = np.random.default_rng(1)
    ids = truth.id[::every]
    place = truth.position_m[::every] + SIGMA * rng.standard_normal((len(ids), 2))
    covariance = np.broadcast_to(SIGMA**2 * np.eye(2), (len(ids), 2, 2))
    is_known = np.isin(log.measurements.landmark, ids)
    return replace(
        log,
        measurements=log.measurements.chosen(~is_known),
        known_landmarks=Landmarks(ids, place, covariance),
        known_measurements=log.measurements.chosen(is_known),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["full", "compressed"])
@pytest.mark.parametrize("association", ["known", "nn"])
def test_gaps_stay_at_rounding(name: str, association: str) -> None:
    c = compared(with_survey(simulated(seed=2)), filter=name, association=association)
    assert_followed(c, 1e-8)
    assert c.smoother.optimality.verified
    assert c.smoother.optimality.chi_square.reading == "plausible"
    assert c.ekf.unused["rejected"] == 0


@pytest.mark.slow
def test_the_survey_bounds_the_error() -> None:
    log = simulated(seed=2)
    plain = compared(log).ekf.estimate
    fixed = compared(with_survey(log)).ekf.estimate
    assert fixed.landmark_id[:3].tolist() == [SURVEYED, SURVEYED + 6, SURVEYED + 12]
    sigma = np.sqrt(np.trace(plain.pose_covariance[:, :2, :2], axis1=1, axis2=2))
    bounded = np.sqrt(np.trace(fixed.pose_covariance[:, :2, :2], axis1=1, axis2=2))
    assert bounded.max() < 0.5 * sigma.max()


def test_a_surveyed_landmark_never_seen_keeps_its_prior() -> None:
    log = with_survey(simulated(seed=2, loop_s=10.0))
    c = compared(log)
    assert log.known_landmarks is not None
    unseen = np.flatnonzero(
        ~np.isin(log.known_landmarks.id, present(log.known_measurements).landmark)
    )
    assert len(unseen)
    for estimate in (c.ekf.estimate, c.smoothed):
        k = 3 + 2 * int(unseen[0])
        own = estimate.joint_covariance[k : k + 2, k : k + 2]
        assert np.allclose(own, SIGMA**2 * np.eye(2), rtol=1e-4)
        assert np.allclose(estimate.landmark[unseen[0]], log.known_landmarks.position_m[unseen[0]])


@pytest.mark.slow
def test_a_wrong_measurement_of_a_surveyed_landmark_is_rejected() -> None:
    log = with_survey(simulated(seed=2))
    known = present(log.known_measurements)
    distance = known.range_m.copy()
    distance[40] += 8.0
    c = compared(replace(log, known_measurements=replace(known, range_m=distance)))
    assert c.ekf.unused["rejected"] == 1


def test_streams_join_in_order_of_time_and_survive_the_disk(tmp_path: Path) -> None:
    log = with_survey(simulated(seed=2, loop_s=20.0))
    joined = join_known_measurements(log).measurements
    assert np.all(np.diff(joined.time_s) >= 0)
    assert len(joined.time_s) == len(simulated(seed=2, loop_s=20.0).measurements.time_s)
    write_log_folder(log, tmp_path / "log")
    again = compared(read_log_folder(tmp_path / "log"))
    assert np.array_equal(again.ekf.estimate.joint_mean, compared(log).ekf.estimate.joint_mean)
