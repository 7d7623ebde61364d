"""Where landmarks of two kinds lie in a state, and what removal leaves."""

import numpy as np
import pytest

from ekf_reference.core.landmark_types import POINT, POSE, LandmarkKind, NewLandmarks
from ekf_reference.core.layout import ABSENT, Layout
from ekf_reference.core.state import KalmanState
from tests.ekf_reference.numerics import random_covariance


def mixed() -> Layout:
    """A pose, two points, a frame, a point, two frames."""
    layout = Layout.of_pose(3).appended(2, POINT).appended(1, POSE)
    return layout.appended(1, POINT).appended(2, POSE)


def state(rng: np.random.Generator) -> KalmanState:
    made = KalmanState(rng.standard_normal(3), random_covariance(rng, 3))
    for count, kind in ((2, POINT), (1, POSE), (1, POINT), (2, POSE)):
        width = kind.width
        made.augment(
            NewLandmarks(
                rng.standard_normal((count, width)),
                rng.standard_normal((count, width, 3)),
                np.tile(np.eye(width), (count, 1, 1)),
            ),
            np.array([random_covariance(rng, width) for _ in range(count)]),
            kind,
        )
    return made


def test_landmarks_lie_in_the_order_of_their_arrival() -> None:
    layout = mixed()
    assert layout.first[POINT].tolist() == [3, 5, 10]
    assert layout.first[POSE].tolist() == [7, 12, 15]
    assert layout.size == 18
    assert layout.columns(np.array([2, 0])).tolist() == [0, 1, 2, 10, 11, 3, 4]
    assert layout.columns(np.array([1]), POSE).tolist() == [0, 1, 2, 12, 13, 14]
    assert layout.by_kind().tolist() == [0, 1, 2, 3, 4, 5, 6, 10, 11, 7, 8, 9, *range(12, 18)]


def test_a_removed_landmark_index_stays_empty() -> None:
    layout = mixed().part(np.setdiff1d(np.arange(18), (5, 6, 7, 8, 9)))
    assert layout.first[POINT].tolist() == [3, ABSENT, 5]
    assert layout.first[POSE].tolist() == [ABSENT, 7, 10]
    assert layout.size == 13
    assert layout.present().tolist() == [0, 2]
    assert layout.appended(1, POINT).first[POINT].tolist() == [3, ABSENT, 5, 13]
    with pytest.raises(ValueError, match=r"point landmarks \[1\] were removed"):
        layout.columns(np.array([0, 1]))


def test_a_part_and_what_it_gains_go_back_into_the_whole() -> None:
    whole = mixed()
    columns = np.array([0, 1, 2, 5, 6, 12, 13, 14])
    part = whole.part(columns)
    assert part.first[POINT].tolist() == [ABSENT, 3, ABSENT]
    assert part.first[POSE].tolist() == [ABSENT, 5, ABSENT]
    grown = part.appended(1, POSE).appended(1, POINT)
    back = whole.continued(grown, len(columns))
    expected = whole.appended(1, POSE).appended(1, POINT)
    for kind in (POINT, POSE):
        assert back.first[kind].tolist() == expected.first[kind].tolist()
    assert back.size == expected.size


@pytest.mark.parametrize(
    ("landmark_index", "kind"), [([1], POINT), ([0, 2], POSE), ([0, 2], POINT)]
)
def test_removal_is_the_marginal(landmark_index: list[int], kind: LandmarkKind) -> None:
    made = state(np.random.default_rng(0))
    points, frames = made.landmarks.copy(), made.places(POSE).copy()
    gone = made.layout.columns(np.array(landmark_index), kind)[3:]
    kept = np.setdiff1d(np.arange(18), gone)
    mean, covariance = made.mean[kept].copy(), made.covariance[np.ix_(kept, kept)].copy()
    made.remove(np.array(landmark_index), kind)
    assert np.array_equal(made.mean, mean)
    assert np.array_equal(made.covariance, covariance)
    (points if kind == POINT else frames)[landmark_index] = np.nan
    assert np.array_equal(made.landmarks, points, equal_nan=True)
    assert np.array_equal(made.places(POSE), frames, equal_nan=True)
    seen = made.snapshot()
    assert seen.landmark_index.tolist() == [
        i for i in range(3) if kind != POINT or i not in landmark_index
    ]
    columns = made.layout.columns(seen.landmark_index)
    assert np.array_equal(made.covariance_of(columns), made.map_of(seen.landmark_index).covariance)
    assert seen.landmark_index.tolist() == made.local_map(1e9).landmark_index.tolist()
    with pytest.raises(ValueError, match="removed"):
        made.remove(np.array(landmark_index), kind)


def test_blocks_of_a_local_map() -> None:
    made = state(np.random.default_rng(2))
    local = made.map_of(np.array([2, 0]), POSE)
    assert np.array_equal(local.landmark, made.places(POSE)[[2, 0]])
    for i, landmark_index in enumerate((2, 0)):
        own = made.layout.first[POSE][landmark_index] + np.arange(3)
        assert np.array_equal(local.own[i], made.covariance[np.ix_(own, own)])
        assert np.array_equal(local.cross[i], made.covariance[np.ix_(range(3), own)])


def test_a_packed_layout_has_kind_after_kind() -> None:
    layout = Layout.packed(3, 2, 1)
    assert layout.size == 10
    assert layout.columns(np.array([1])).tolist() == [0, 1, 2, 5, 6]
    assert layout.columns(np.array([0]), POSE).tolist() == [0, 1, 2, 7, 8, 9]
    assert layout.angles.tolist() == [2, 9]
    covariance = random_covariance(np.random.default_rng(0), 10)
    assert np.array_equal(layout.blocks(covariance)[1], covariance[5:7, 5:7])
    assert np.array_equal(layout.blocks(covariance, POSE)[0], covariance[7:, 7:])
    assert Layout.packed(4, 1).angles.tolist() == []  # cosine and sine
    assert mixed().angles.tolist() == [2, 9, 14, 17]
