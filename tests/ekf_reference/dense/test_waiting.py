import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.conditions import Conditions
from ekf_reference.dense.delayed_initialisation import DelayedInitialisation
from ekf_reference.dense.local_pose import Frames, local_pose
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.triangles import to_global
from ekf_reference.dense.view import FilterView
from ekf_reference.models.motion import (
    AckermannModel,
    MotionModel,
    RelativePoseModel,
    UnicycleModel,
)
from tests.ekf_reference.dense.waiting_rooms import DENSE, LANDMARK, START, anywhere, noise, view_at
from tests.ekf_reference.numerics import central_difference, point_columns


@pytest.mark.parametrize(
    ("model", "control"),
    [
        (AckermannModel(2.8, 0.7, 3.8, 0.5), (4.0, 0.3)),
        (UnicycleModel(), (4.0, 0.8)),
        (RelativePoseModel(), (2.0, -0.7, 0.9)),
    ],
)
def test_motion_enters_by_its_jacobian_in_the_frame(
    model: MotionModel, control: tuple[float, ...]
) -> None:
    """F of any equivariant model, over several steps, by central differences of the local pose."""
    axis = (2, 0)
    first, second = LANDMARK[axis[0]], LANDMARK[axis[1]]
    turn = local_pose(np.zeros(3), first, second)[2]

    def after(pose: Array) -> Array:
        for _ in range(3):
            pose = model.step(pose, np.array(control), 0.7).pose
        return pose

    def local_after(local: Array) -> Array:
        place = Frames.of(first, second).to_world(local[:2])
        moved: Array = local_pose(after(np.append(place, local[2] - turn)), first, second)
        return moved

    room = DelayedInitialisation()
    room.add(view_at(START), DENSE, noise(3), 0, anywhere((0, 2)))
    swapped = np.array([axis])  # whichever of the two landmarks the axis starts from
    room.axis, room.mean = swapped, local_pose(START, first, second)[None]
    before = room.points.cross.copy()
    room.predicted(view_at(after(START)))
    f = central_difference(local_after, local_pose(START, first, second))
    assert np.allclose(room.points.cross, before @ f.T, atol=1e-8)
    assert not np.allclose(room.points.cross, before, atol=1e-3)


def test_a_heading_that_turns_past_pi_is_no_correction() -> None:
    """Same pose, a turn further: nothing is learnt, nothing moves."""
    room = DelayedInitialisation()
    room.add(view_at(START), DENSE, noise(3), 0, anywhere((0, 1)))
    before = room.points.point.copy()
    room.predicted(view_at(START))
    room.updated(view_at(START + (0.0, 0.0, 2.0 * np.pi)))
    assert np.allclose(room.points.point, before, atol=1e-12)


@pytest.mark.parametrize("sigma", [0.0, 1e-9, 0.3])
def test_what_is_known_already_is_not_corrected(sigma: float) -> None:
    """A singular covariance of the local pose is no fault."""
    known = view_at(START, sigma=0.0)
    known.covariance[2, 2] = sigma**2  # only the heading is in doubt, or nothing is
    room = DelayedInitialisation()
    room.add(known, DENSE, noise(3), 0, anywhere((0, 1)))
    room.predicted(known)
    certain = view_at(START + (0.0, 0.0, sigma), sigma=0.0)
    certain.covariance[2, 2] = 0.0
    room.updated(certain)
    frame = Frames.of(LANDMARK[0], LANDMARK[1])
    linear = frame.to_local(DENSE + sigma * (DENSE - START[:2])[:, ::-1] * (-1.0, 1.0))
    assert np.allclose(room.points.point, linear, atol=1e-9)
    assert np.allclose(room.points.variance, 0.01, rtol=1e-6)
    assert np.allclose(room.points.cross, 0.0, atol=1e-12)


def test_points_join_the_frame_of_the_region_they_may_belong_to() -> None:
    """Each where it lies; what lies in none, or is no number, is refused and counted."""
    regions = LocalRegions(conditions=Conditions(flip_sigmas=0.0))
    view = view_at(START)
    potential = regions.potential(view.landmark, view.landmark_index, view.pose, view.covariance)
    strange = np.array([(500.0, 0.0), (np.nan, 1.0), (3.0, 7.0)])
    spread = noise(6).copy()
    spread[5] = np.nan
    room = DelayedInitialisation()
    number = room.add(view, np.vstack((DENSE, strange)), spread, 7, potential)
    assert number.tolist() == [0, 1, 2, -1, -1, -1]
    assert room.counts.refused == 3
    assert room.points.scan.tolist() == [7, 7, 7]
    region = potential.placed.locate(DENSE).region
    assert np.array_equal(room.axis[room.points.group], potential.axis[region])
    again = room.add(view, DENSE[::-1], noise(3), 8, potential)
    assert again.tolist() == [3, 4, 5]
    assert np.array_equal(room.points.group[3:], room.points.group[2::-1])
    assert len(room.axis) == len(np.unique(room.axis, axis=0))
    passive = FilterView(view.pose, view.landmark, view.landmark_index[:2], view.covariance[:7, :7])
    assert (room.add(passive, DENSE, noise(3), 9, anywhere((0, 2))) == -1).all()
    assert room.counts.refused == 6


def test_points_leave_once_a_region_has_them() -> None:
    """They follow their landmarks until then; variance turns with the frame."""
    room, view = DelayedInitialisation(), view_at(START)
    room.add(view, DENSE, noise(3), 4, anywhere((0, 1)))
    local, variance = room.points.point.copy(), room.points.variance.copy()
    regions = LocalRegions()
    assert len(room.release(view, regions.placed(view.landmark)).region) == 0
    turn = np.array([(0.0, -1.0), (1.0, 0.0)])
    moved = view_at(START, LANDMARK @ turn.T + (30.0, 5.0))
    regions.base, regions._order = np.array([(0, 1, 2)]), np.arange(1)
    inside = regions.placed(LANDMARK).locate(DENSE).region == 0
    assert 0 < inside.sum() < 3
    out = room.release(moved, regions.placed(moved.landmark))
    assert np.allclose(out.point, (DENSE @ turn.T + (30.0, 5.0))[inside])
    assert np.allclose(to_global(moved.landmark[:3], out.local), out.point)
    frame = Frames.of(moved.landmark[0], moved.landmark[1])
    assert np.allclose(
        frame.turn.T @ out.covariance @ frame.turn, [np.diag(v) for v in variance[inside]]
    )
    assert np.array_equal(out.number, np.flatnonzero(inside))
    assert (out.region == 0).all()
    assert room.counts.released == inside.sum()
    assert np.array_equal(room.points.point, local[~inside])


def test_the_oldest_make_room_and_are_counted() -> None:
    room, view = DelayedInitialisation(capacity=7), view_at(START)
    for scan in range(4):
        room.add(view, DENSE, noise(3), scan, anywhere((0, 1)) if scan else anywhere((1, 2)))
    assert room.points.number.tolist() == [5, 6, 7, 8, 9, 10, 11]
    assert room.counts.dropped == 5
    assert len(room.axis) == 1  # the first frame has no points any more
    room.add(view, np.tile(DENSE, (5, 1)), noise(15), 4, anywhere((2, 3)))
    assert room.points.number.tolist() == list(range(20, 27))
    assert room.counts.dropped == 20
    assert room.axis.tolist() == [[2, 3]]


def test_points_vanish_with_a_landmark_and_are_counted() -> None:
    room, view = DelayedInitialisation(), view_at(START)
    room.add(view, DENSE, noise(3), 0, anywhere((0, 1)))
    room.add(view, DENSE[:2], noise(2), 0, anywhere((2, 3)))
    gone = LANDMARK.copy()
    gone[1] = np.nan
    left = FilterView(
        view.pose,
        gone,
        np.array((0, 2, 3)),
        np.delete(np.delete(view.covariance, (5, 6), axis=0), (5, 6), axis=1),
    )
    everywhere = anywhere((2, 3)).placed
    stay = room.release(left, everywhere)
    assert stay.number.tolist() == [3, 4]
    room.predicted(left)
    assert room.counts.vanished == 3
    assert len(room.points.scan) == len(room.axis) == 0
    room.updated(left)


def test_points_whose_frame_turns_passive_stay_as_they_are() -> None:
    """A compressed filter's passive landmarks have no current covariance to be corrected by."""
    room, view = DelayedInitialisation(), view_at(START)
    room.add(view, DENSE, noise(3), 0, anywhere((0, 1)))
    room.add(view, DENSE, noise(3), 0, anywhere((2, 3)))
    point, variance = room.points.point.copy(), room.points.variance.copy()
    landmark_index = np.array((2, 3))
    columns = point_columns(landmark_index)
    moved = FilterView(
        START + (0.3, 0.1, 0.05),
        LANDMARK,
        landmark_index,
        0.5 * view.covariance[np.ix_(columns, columns)],
    )
    room.predicted(view)
    room.updated(moved)
    assert room.points.cross.any(axis=(1, 2)).tolist() == [False] * 3 + [True] * 3
    assert np.array_equal(room.points.point[:3], point[:3])
    assert np.array_equal(room.points.variance[:3], variance[:3])
    assert (room.points.variance[3:] < variance[3:]).all()
    active = view_at(START + (0.3, 0.1, 0.05), sigma=0.1)
    room.predicted(active)
    room.updated(active)  # active again: what happened meanwhile is not known
    assert np.array_equal(room.points.point[:3], point[:3])
    assert room.points.cross.any(axis=(1, 2)).tolist() == [False] * 3 + [True] * 3


def test_what_has_waited_long_gets_a_virtual_region() -> None:
    """Two landmarks and nothing behind them: the points wait for a third one in vain."""
    landmark = np.array([(0.0, 0.0), (10.0, 0.0)])
    view = view_at(np.array((5.0, -6.0, 1.5)), landmark, 0.01)
    wall = np.column_stack((np.linspace(3, 7, 20), np.full(20, 1.5)))
    regions = LocalRegions(conditions=Conditions(known_apart_m=0.1))
    room = DelayedInitialisation(patience=10)
    given = (view.landmark, view.landmark_index, view.pose, view.covariance)
    potential = regions.potential(*given)
    room.add(view, wall, noise(20), 0, potential)
    assert room.counts.refused == 0
    assert len(room.overdue(view, 9)) == 0
    overdue = room.overdue(view, 10)
    assert np.allclose(overdue, wall)
    assert len(regions.extend_virtual(*given, overdue, 5)) == 1
    assert len(room.release(view, regions.placed(landmark)).region) == 20
    assert len(room.points.scan) == 0
