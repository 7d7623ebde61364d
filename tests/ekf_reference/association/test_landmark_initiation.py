from dataclasses import replace

import numpy as np
import pytest

from ekf_reference.association.known import KnownAssociation
from ekf_reference.association.landmark_initiation import LandmarkInitiation, Reliability
from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core.measurements import CANDIDATE, Measurements
from ekf_reference.core.state import KalmanState
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.association import scenes

MODEL = RangeBearing()
STATE = KalmanState(np.zeros(3), 1e-6 * np.eye(3))


def seen(time_s: float, *points: tuple[float, float]) -> Measurements:
    return replace(scenes.seen(list(points), (0.01, 0.01)), time_s=time_s)


def managed(**reliability: float) -> LandmarkInitiation:
    return LandmarkInitiation(rule=NearestNeighbour(), reliability=Reliability(**reliability))  # type: ignore[arg-type]


def feed(
    tracks: LandmarkInitiation, times: list[float], *points: tuple[float, float]
) -> list[list[int]]:
    return [tracks.assign(STATE, MODEL, seen(t, *points)).tolist() for t in times]


def test_a_stable_feature_becomes_a_landmark_once_it_is_old_enough() -> None:
    tracks = managed(measurements=4, age_s=0.5)
    result = feed(tracks, [0.0, 0.1, 0.2, 0.3, 0.4, 0.55], (8.0, 1.0), (5.0, -3.0))
    assert result[:5] == [[CANDIDATE, CANDIDATE]] * 5
    assert result[5] == [0, 1]
    assert tracks.promoted == 2
    assert tracks.dropped == 0


def test_too_few_measurements_never_suffice() -> None:
    tracks = managed(measurements=4, age_s=0.5, silence_s=10.0)
    assert feed(tracks, [0.0, 1.0, 2.0], (8.0, 1.0)) == [[CANDIDATE]] * 3


def test_a_spurious_detection_is_dropped_after_its_silence() -> None:
    tracks = managed(measurements=2, age_s=0.0, silence_s=1.0)
    feed(tracks, [0.0], (8.0, 1.0))
    assert feed(tracks, [1.5], (8.0, 1.0)) == [[CANDIDATE]]  # it starts anew
    assert tracks.dropped == 1


def test_a_feature_that_wanders_is_not_stable() -> None:
    tracks = managed(measurements=3, age_s=0.0, spread_m=0.2, join_m=1.0)
    for k in range(10):
        landmark_indices = tracks.assign(STATE, MODEL, seen(0.1 * k, (8.0, 1.0 + 0.6 * (k % 2))))
        assert landmark_indices.tolist() == [CANDIDATE]
    assert tracks.promoted == 0


def test_two_measurements_of_one_candidate_make_one_landmark() -> None:
    tracks = managed(measurements=4, age_s=0.0)
    feed(tracks, [0.0], (8.0, 1.0))
    feed(tracks, [0.1], (8.0, 1.0), (8.05, 1.0))
    assert feed(tracks, [0.2], (8.0, 1.0), (8.05, 1.0)) == [[0, CANDIDATE]]
    assert tracks.promoted == 1


def test_a_rule_that_keeps_landmark_indices_of_its_own_is_refused() -> None:
    """It would fuse a landmark's measurements into the one that was confirmed before it."""
    with pytest.raises(TypeError, match="before a landmark is confirmed"):
        LandmarkInitiation(rule=KnownAssociation())
