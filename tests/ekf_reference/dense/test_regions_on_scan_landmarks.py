"""Regions that hang on scan landmarks are those that hang on points (Nieto 2005, section 6.2)."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import POINT, POSE
from ekf_reference.core.layout import Layout
from ekf_reference.dense.dense_map import DenseMap
from ekf_reference.dense.scan import Scan
from ekf_reference.dense.view import FilterView, by_number, numbered
from tests.ekf_reference.both_kinds import Script, build, drive
from tests.ekf_reference.dense.scenes import LAYERS, SENSOR
from tests.ekf_reference.dense.test_dense_map import content, dense_map, room

BOTH = (POINT, POSE)
BEARING = np.linspace(-1.2, 1.2, 31)


def driven(kind: str, script: Script, look: Callable[[Ekf], None]) -> Ekf:
    """A drive, its filter looked at before every prediction."""
    ekf = build(kind)
    predict = ekf.predict

    def looked(*given: object) -> None:
        look(ekf)
        predict(*given)  # type: ignore[arg-type]

    ekf.predict = looked  # type: ignore[method-assign, assignment]
    drive(ekf, 1, script)
    return ekf


def as_points(ekf: Ekf) -> FilterView:
    """The definition, by whole state: pose landmarks, their x and y alone."""
    first = ekf.state.layout.first[POSE]
    entries = (first[:, None] + (0, 1)).ravel()
    kept = np.concatenate((np.arange(3), entries))
    return FilterView(
        ekf.state.pose,
        ekf.state.mean[entries].reshape(-1, 2),
        np.arange(len(first)),
        ekf.state.covariance[np.ix_(kept, kept)],
    )


def without_cross(ekf: Ekf) -> FilterView:
    """Broken: what vehicle and landmarks share is left out."""
    view = as_points(ekf)
    covariance = view.covariance.copy()
    covariance[:3, 3:] = covariance[3:, :3] = 0.0
    return FilterView(view.pose, view.landmark, view.landmark_index, covariance)


def shifted(ekf: Ekf) -> FilterView:
    """Broken: y and heading are taken for x and y in the covariance."""
    first = ekf.state.layout.first[POSE]
    kept = np.concatenate((np.arange(3), (first[:, None] + (1, 2)).ravel()))
    view = as_points(ekf)
    return FilterView(
        view.pose, view.landmark, view.landmark_index, ekf.state.covariance[np.ix_(kept, kept)]
    )


@cache
def mapped(read: Callable[[Ekf], FilterView]) -> tuple[DenseMap, FilterView]:
    """A dense map kept beside a drive among pose landmarks."""
    dense, rng = dense_map(*LAYERS, waiting=room()), np.random.default_rng(2)

    def look(ekf: Ekf) -> None:
        view = read(ekf)
        dense.predicted(view)
        dense.updated(view)
        way = rng.uniform(3.0, 12.0, len(BEARING))
        dense.insert(view, Scan.of_ranges(view.pose, BEARING, way, SENSOR))

    return dense, read(driven("full", Script(order="frames only"), look))


def by_filter(ekf: Ekf) -> FilterView:
    return FilterView.of(ekf, (POSE,))


@pytest.mark.slow
def test_the_map_is_that_between_points_of_the_same_mean_and_covariance() -> None:
    dense, view = mapped(by_filter)
    points, same = mapped(as_points)
    assert len(dense.regions.base) > 4
    assert dense.tally.late > 10
    assert content(dense, view) == content(points, same)


@pytest.mark.slow
@pytest.mark.parametrize("broken", [without_cross, shifted])
def test_another_covariance_makes_another_map(broken: Callable[[Ekf], FilterView]) -> None:
    dense, view = mapped(by_filter)
    other, same = mapped(broken)
    assert content(dense, view) != content(other, same)


SCRIPT = Script(order="in turn", fuse_at=90, remove_at=100)


def test_both_kinds_are_shown_by_number() -> None:
    ekf = driven("full", SCRIPT, lambda _: None)
    view, state = FilterView.of(ekf, BOTH), ekf.state
    assert np.array_equal(view.landmark[0::2][: len(state.landmarks)], state.landmarks, True)
    assert np.array_equal(
        view.landmark[1::2][: len(state.places(POSE))], state.places(POSE)[:, :2], True
    )
    assert np.isfinite(view.landmark[view.landmark_index]).all()
    for number in view.landmark_index[[0, 3, -1]].tolist():
        landmark_index, kind = divmod(number, 2)
        first = int(state.layout.first[BOTH[kind]][landmark_index])
        columns = np.array((0, 1, 2, first, first + 1))
        wanted = state.covariance[np.ix_(columns, columns)]
        assert np.array_equal(view.joint(np.array([number])), wanted)


def test_numbers_are_for_good() -> None:
    """Through arrivals of either kind, a fusion and removals, a landmark keeps its own."""
    first: dict[int, Array] = {}

    def look(ekf: Ekf) -> None:
        view = FilterView.of(ekf, BOTH)
        for number in view.landmark_index.tolist():
            known = first.setdefault(number, view.landmark[number].copy())
            assert np.hypot(*(known - view.landmark[number])) < 2.0

    driven("full", SCRIPT, look)
    places = np.array(list(first.values()))
    apart = np.linalg.norm(places[:, None] - places, axis=2) + 9.0 * np.eye(len(places))
    assert len(first) > 12
    assert np.median(apart.min(axis=1)) > 2.0  # so that a mix-up would have been seen


def test_the_compressed_filter_shows_what_the_full_one_does() -> None:
    seen: dict[str, list[FilterView]] = {"full": [], "compressed": []}
    for kind, views in seen.items():
        driven(kind, SCRIPT, lambda ekf, views=views: views.append(FilterView.of(ekf, BOTH)))  # type: ignore[misc]
    passive = 0
    for full, part in zip(*seen.values(), strict=True):
        assert (np.diff(part.landmark_index) > 0).all()
        ours = part.landmark[part.landmark_index]
        assert np.allclose(ours, full.landmark[part.landmark_index], rtol=0.0, atol=1e-9)
        assert np.allclose(
            part.joint(part.landmark_index), full.joint(part.landmark_index), rtol=1e-7, atol=1e-12
        )
        passive += len(full.landmark_index) - len(part.landmark_index)
    assert passive > 0


def test_with_points_alone_numbers_are_landmark_indices() -> None:
    layout = Layout.of_pose(3).appended(2, POINT).appended(1, POSE).appended(1, POINT)
    landmark_indices = [layout.present(kind) for kind in BOTH]
    number, first = numbered(layout, (POINT,), landmark_indices[:1])
    assert number.tolist() == [0, 1, 2]
    assert first.tolist() == [3, 5, 10]
    number, first = numbered(layout, BOTH, landmark_indices)
    assert number.tolist() == [0, 1, 2, 4]
    assert first.tolist() == [3, 7, 5, 10]
    point = np.arange(4.0).reshape(2, 2)
    assert np.array_equal(by_number([point]), point)
    assert not len(by_number([point[:0], point[:0]]))
