"""High level landmarks on their way from the dense map into the filter's state."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import NEW, Ekf, Stabilisation
from ekf_reference.core.geometry import Array, Mask, to_world
from ekf_reference.core.landmark_types import POSE
from ekf_reference.dense.local_pose import local_pose
from ekf_reference.dense.view import FilterView
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.relative_pose import RelativePose
from ekf_reference.scan_landmarks.high_level import PlacedTemplate, search
from ekf_reference.scan_landmarks.high_level_lifecycle import Glimpse, HighLevelLandmarks
from ekf_reference.scan_landmarks.templates import SensorView
from ekf_reference.scan_matching.scan_shape import of_scan
from tests.ekf_reference.numerics import central_difference, relative_error
from tests.ekf_reference.ray_casting import cast
from tests.ekf_reference.scan_landmarks.test_high_level import (
    BEAMS,
    FEW,
    NONE,
    SENSOR,
    around,
    yard,
)

START = np.array((1.0, 0.5, 0.7))
POINTS = np.array(((-20.0, 10.0), (0.0, 10.0), (-10.0, 0.0)))
SIGMA = np.array((0.05, 0.005))
ALL_ROUND = SensorView(60.0, -math.pi, math.pi)


def filter_at(pose: Array, points: Array = POINTS) -> Ekf:
    """It has seen three landmarks, exactly where they are."""
    ekf = Ekf(
        UnicycleModel(), KnownAssociation(), pose, np.diag((0.05, 0.04, 0.01)) ** 2, Stabilisation()
    )
    apart = points - pose[:2]
    bearing = np.arctan2(apart[:, 1], apart[:, 0]) - pose[2]
    z = np.column_stack((np.hypot(*apart.T), bearing))
    ekf.observe(z, np.tile(SIGMA, (len(z), 1)), np.arange(len(z)))
    return ekf


def glimpse(pose: Array, mount: Array, seed: int = 0) -> Glimpse:
    """The yard from a pose (3,) of the vehicle."""
    scanner = RelativePose().invert(pose, mount[None]).landmark[0]
    noise = 0.05 * np.random.default_rng(seed).standard_normal(len(BEAMS))
    seen = cast(BEAMS, scanner, yard()) + noise
    return Glimpse(of_scan(BEAMS, seen, SENSOR), mount, ALL_ROUND)


def found() -> list[PlacedTemplate]:
    return list(search(around(), NONE, FEW).found)


def kept(
    settled: tuple[float, float, float] = (0.3, 0.3, 0.05),
    *,
    only_in_view: bool = True,
    variance_factor: float = 4.0,
) -> HighLevelLandmarks:
    landmarks = HighLevelLandmarks(
        settled=settled, only_in_view=only_in_view, variance_factor=variance_factor
    )
    for one in found():
        landmarks.take(one, np.array((0, 1, 2)), POINTS)
    return landmarks


@pytest.mark.parametrize("mount", [np.zeros(3), np.array((1.2, -0.4, 0.6))])
def test_passive_until_seen_then_in_the_state_then_observed(mount: Array) -> None:
    ekf, landmarks = filter_at(START), kept()
    before = landmarks.places(ekf)
    assert np.allclose(before, [one.place for one in found()], atol=0.05)
    for look in range(2):
        seen = landmarks.look(ekf, glimpse(START, mount, look))
        assert [one.number for one in seen] == [0, 2]  # of the other one wall is in view
        landmark_index = np.array([landmarks.landmark[one.number].landmark_index for one in seen])
        assert (landmark_index == NEW).all() == (look == 0)
        size = len(ekf.state.mean)
        z, noise = np.array([one.z for one in seen]), np.array([one.covariance for one in seen])
        landmarks.initialised(seen, ekf.observe_known(z, noise, landmark_index, POSE))
        assert len(ekf.state.mean) == size + (6 if look == 0 else 0)
    assert landmarks.counts == {"seen": 4, "a direction is open": 2}
    assert [one.landmark_index for one in landmarks.landmark] == [0, NEW, 1]
    moved = np.abs(landmarks.places(ekf) - before)
    assert moved[:, :2].max() < 0.2
    assert moved[:, 2].max() < 0.05
    assert not np.array_equal(landmarks.places(ekf), before)  # the state says where they are now


def test_a_passive_one_moves_with_its_landmarks_and_leaves_with_them() -> None:
    landmarks, turn = kept(), 0.4
    rotation = np.array(((math.cos(turn), -math.sin(turn)), (math.sin(turn), math.cos(turn))))
    shift = np.array((3.0, -1.0))
    base = filter_at(START)
    moved = filter_at(
        np.append(rotation @ START[:2] + shift, START[2] + turn), POINTS @ rotation.T + shift
    )
    ours, theirs = landmarks.places(base), landmarks.places(moved)
    assert np.allclose(theirs[:, :2], ours[:, :2] @ rotation.T + shift, atol=1e-9)
    assert np.allclose(theirs[:, 2], ours[:, 2] + turn, atol=1e-9)
    rectangle, other = landmarks.rectangles(base), landmarks.rectangles(moved)
    assert np.allclose(other, rectangle @ rotation.T + shift, atol=1e-9)
    base.state.remove(np.array([int(landmarks.landmark[0].base[0])]))
    assert np.isnan(landmarks.places(base)).all()
    assert not landmarks.look(base, glimpse(START, np.zeros(3)))


def test_the_prior_of_a_match_is_the_covariance_carried_through() -> None:
    """By central differences of the whole way: pose, both landmarks, and the place among them."""
    ekf, landmarks = filter_at(START), kept()
    one, view = landmarks.landmark[0], FilterView.of(ekf)
    expected = landmarks.expected(ekf, view, one)
    assert expected is not None
    measured = RelativePose()

    def way(x: Array) -> Array:
        vehicle = local_pose(x[:3], x[3:5], x[5:7])
        return np.asarray(measured.predict(vehicle, x[None, 7:]).z[0])

    first, second = view.landmark[one.base]
    x = np.concatenate((view.pose, first, second, one.held))
    jacobian = central_difference(way, x)
    joint = np.zeros((10, 10))
    joint[:7, :7] = view.joint(np.sort(one.base))
    joint[7:, 7:] = np.diag(np.square(landmarks.settled))
    assert np.allclose(expected.z, way(x))
    carried = jacobian @ joint @ jacobian.T
    assert relative_error(expected.covariance, carried) < 1e-6
    joint[:3, 3:7] = joint[3:7, :3] = 0.0  # broken: pose and landmarks taken as independent
    assert relative_error(expected.covariance, jacobian @ joint @ jacobian.T) > 0.05


def test_what_lies_elsewhere_does_not_pass_the_gate() -> None:
    """A template found 0.9 m off is met by the scan, and rejected; with a wide prior it is not."""

    def looked(settled: tuple[float, float, float]) -> HighLevelLandmarks:
        landmarks = kept(settled)
        off = (0.0, 0.9, 0.0)
        landmarks.landmark = [replace(one, held=one.held + off) for one in landmarks.landmark]
        landmarks.look(filter_at(START), glimpse(START, np.zeros(3)))
        return landmarks

    assert looked((0.1, 0.1, 0.02)).counts["seen"] == 0
    assert looked((1.0, 1.0, 0.02)).counts["seen"] > 0


def test_a_measurement_has_the_noise_of_a_visit() -> None:
    """Not of its scan alone: what the template holds wrongly is in all of a visit."""

    def noises(factor: float) -> Array:
        landmarks = kept(variance_factor=factor)
        seen = landmarks.look(filter_at(START), glimpse(START, np.zeros(3)))
        return np.array([one.covariance for one in seen])

    assert np.allclose(noises(HighLevelLandmarks.variance_factor), 4.0 * noises(1.0))


def test_what_a_scan_cannot_see_of_a_template_does_not_count() -> None:
    """Of the second box one wall is in view; broken: its other walls have no counterpart."""

    def looked(only_in_view: bool) -> HighLevelLandmarks:
        landmarks = kept(only_in_view=only_in_view)
        landmarks.look(filter_at(START), glimpse(START, np.zeros(3)))
        return landmarks

    assert looked(True).counts == {"seen": 2, "a direction is open": 1}
    assert looked(False).counts == {"seen": 2, "no counterpart": 1}


def test_no_landmark_begins_with_an_open_direction() -> None:
    """A template of a piece of a wall says nothing along it: it must not enter the state."""
    landmarks, ekf = kept(), filter_at(START)
    south = int(landmarks.places(ekf)[:, 1].argmin())
    whole, place = landmarks.landmark[south], landmarks.places(ekf)[south]
    point = to_world(place, whole.template.shape.mean)
    piece = (np.abs(point[:, 0]) < 2.5) & (point[:, 1] > -9.0)
    shape = whole.template.shape.take(piece)
    landmarks.landmark = [replace(whole, template=replace(whole.template, shape=shape))]
    assert not landmarks.look(ekf, glimpse(START, np.zeros(3)))
    assert landmarks.counts == {"a direction is open": 1}


def test_the_longest_side_between_real_landmarks_carries() -> None:
    landmarks = HighLevelLandmarks()
    landmarks.take(found()[0], np.array((2, 0, -1)), POINTS)
    landmarks.take(found()[0], np.array((0, 1, 2)), POINTS)
    assert [sorted(one.base.tolist()) for one in landmarks.landmark] == [[0, 2], [0, 1]]


class Around:
    """A guard: something moves within a radius of a place."""

    def __init__(self, place: Array, radius_m: float) -> None:
        self.place, self.radius_m = place, radius_m

    def is_dynamic(self, point: Array) -> Mask:
        near: Mask = np.linalg.norm(point - self.place, axis=1) <= self.radius_m
        return near


@pytest.mark.parametrize(("share", "used"), [(0.1, True), (0.3, False)])
def test_one_whose_template_moves_is_used_no_more(share: float, used: bool) -> None:
    """Nieto 2005, section 6.5; a template of which less than a fifth moves stays."""
    ekf, landmarks = filter_at(START), kept()
    points = landmarks.landmark[0].template.placed(landmarks.places(ekf)[0])
    away = np.linalg.norm(points - points[0], axis=1)
    landmarks.guard = Around(points[0], float(np.quantile(away, share)))
    for _ in range(2):  # once found to move it stays so, whatever the guard says
        seen = [one.number for one in landmarks.look(ekf, glimpse(START, np.zeros(3)))]
        assert (0 in seen) is used
        assert 2 in seen
        assert landmarks.moving == (set() if used else {0})
        landmarks.guard = Around(points[0], 0.0)
