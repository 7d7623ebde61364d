from __future__ import annotations

import numpy as np
import pytest

from ekf_reference.dense.box_tree import BoxTree, boxes
from ekf_reference.dense.conditions import Conditions
from ekf_reference.dense.local_pose import Frames, local_pose
from ekf_reference.dense.regions import Index, LocalRegions, PlacedRegions, Potential
from ekf_reference.dense.view import FilterView
from ekf_reference.dense.waiting import WaitingRoom
from ekf_reference.kalman import KalmanState, state_columns
from ekf_reference.motion import AckermannModel, MotionModel, RelativePoseModel, UnicycleModel
from ekf_reference.observation import RangeBearing
from tests.helpers import Array, central_difference

MODEL = RangeBearing()
EVERYWHERE = np.array([[(-1e4, -1e4), (1e4, -1e4), (0.0, 1e4)]])
LANDMARK = np.array([(10.0, 4.0), (2.0, 12.0), (-7.0, 6.0), (4.0, -9.0)])
START = np.array((1.0, 0.5, 2.0))
DENSE = np.array([(3.0, 7.0), (8.0, 9.0), (-4.0, 2.0)])


def anywhere(*axis: tuple[int, int]) -> Potential:
    """Potential regions of these axes, the first of which has the whole plane."""
    triangle = np.repeat(EVERYWHERE, len(axis), axis=0)
    tree = BoxTree.pack(boxes(triangle), np.arange(len(axis)))
    return Potential(np.array(axis).reshape(-1, 2), PlacedRegions(triangle, tree))


class NoCross(WaitingRoom):
    """A broken variant: the covariance with the vehicle is left out."""

    def add(
        self, view: FilterView, point: Array, noise: Array, scan: int, potential: Potential
    ) -> Index:
        number = super().add(view, point, noise, scan, potential)
        self.points.cross[:] = 0.0
        return number


class NoMotion(WaitingRoom):
    """A broken variant: F is left out."""

    def predicted(self, view: FilterView) -> None:
        self._read(view)


class WrongSign(WaitingRoom):
    """A broken variant: the correction goes the other way."""

    def updated(self, view: FilterView) -> None:
        before = self.points.point
        super().updated(view)
        self.points = self.points._replace(point=2.0 * before - self.points.point)


BROKEN = [NoCross, NoMotion, WrongSign]


class Joint:
    """A filter that carries the dense points in its state, beside a waiting room that does not.

    The true vehicle, landmarks and points are drawn from the filter's own prior.
    """

    def __init__(self, room: WaitingRoom, scale: float, landmark_m: float, seed: int) -> None:
        """landmark_m: standard deviation of the landmarks; 0 where they are known."""
        self.rng, self.room, self.scale = np.random.default_rng(seed), room, scale
        sigma = scale * np.array((0.5, 0.5, 0.05))
        self.true_pose = START + sigma * self.rng.standard_normal(3)
        spread = landmark_m * scale * self.rng.standard_normal(LANDMARK.shape)
        self.true_landmark = LANDMARK + spread
        self.state = KalmanState(START, np.diag(sigma**2))
        count = len(LANDMARK)
        noise = np.broadcast_to((landmark_m * scale) ** 2 * np.eye(2), (count, 2, 2))
        one = np.broadcast_to(np.eye(2), (count, 2, 2))
        self.state.augment(LANDMARK, np.zeros((count, 2, 3)), one, noise)

    @property
    def view(self) -> FilterView:
        """What dense mapping sees: the pose and the landmarks."""
        slot = np.arange(len(LANDMARK))
        columns = state_columns(slot)
        covariance = self.state.covariance[np.ix_(columns, columns)]
        return FilterView(self.state.pose, self.state.landmarks[: len(LANDMARK)], slot, covariance)

    def see_dense(self, sigma: tuple[float, float] = (0.05, 0.005)) -> None:
        spread = self.scale * np.array(sigma)
        noise = np.broadcast_to(np.diag(spread**2), (len(DENSE), 2, 2))
        z = MODEL.predict(self.true_pose, DENSE).z
        z = z + spread * self.rng.standard_normal(z.shape)
        new = MODEL.invert(self.state.pose, z)
        in_world = new.jacobian_sighting @ noise @ new.jacobian_sighting.transpose(0, 2, 1)
        self.room.add(self.view, new.point, in_world, 0, anywhere((0, 1)))
        self.state.augment(new.point, new.jacobian_pose, new.jacobian_sighting, noise)

    def drive(self, process: float = 1.0) -> None:
        """A step of the vehicle with process noise, in which the true vehicle slips."""
        step = UnicycleModel().step(self.state.pose, np.array((2.0, 0.4)), 0.5)
        sigma = process * self.scale * np.array((0.05, 0.05, 0.01))
        true = UnicycleModel().step(self.true_pose, np.array((2.0, 0.4)), 0.5).pose
        self.true_pose = true + sigma * self.rng.standard_normal(3)
        self.state.predict(step.pose, step.jacobian_pose, np.diag(sigma**2))

    def see_landmarks(self) -> None:
        self.room.predicted(self.view)
        seen = np.arange(len(LANDMARK))
        expected = MODEL.predict(self.state.pose, self.state.landmarks[seen])
        sigma = self.scale * np.array((0.1, 0.01))
        z = MODEL.predict(self.true_pose, self.true_landmark).z
        z = z + sigma * self.rng.standard_normal(z.shape)
        innovation = MODEL.innovation(z, expected.z).ravel()
        jacobian = np.zeros((2 * len(seen), 3 + 2 * len(seen)))
        jacobian[:, :3] = expected.jacobian_pose.reshape(-1, 3)
        for k in seen:
            jacobian[2 * k : 2 * k + 2, 3 + 2 * k : 5 + 2 * k] = expected.jacobian_landmark[k]
        noise = np.diag(np.tile(sigma**2, len(seen)))
        self.state.update(state_columns(seen), jacobian, innovation, noise)
        self.room.updated(self.view)

    def dense(self) -> tuple[Array, Array]:
        """The joint filter's points in the frame and their variances there, both (N, 2)."""
        count = len(LANDMARK)
        mean = self.state.landmarks
        variance = []
        for k in range(count, count + len(DENSE)):

            def in_the_frame(x: Array) -> Array:
                local: Array = Frames.of(x[:2], x[2:4]).to_local(x[4:])
                return local

            columns = state_columns(np.array((0, 1, k)))[3:]
            j = central_difference(in_the_frame, mean[[0, 1, k]].ravel())
            variance.append(np.diag(j @ self.state.covariance[np.ix_(columns, columns)] @ j.T))
        return Frames.of(mean[0], mean[1]).to_local(mean[count:]), np.array(variance)


def corrections(kind: type[WaitingRoom], landmark_m: float, scale: float, seed: int) -> Array:
    """(4, N, 2): what the joint filter and the room changed in the points and their variances."""
    room = kind()
    joint = Joint(room, scale, landmark_m, seed)
    joint.drive()
    joint.see_dense()
    before, variance_before = joint.dense()
    assert np.allclose(room.points.point, before, atol=1e-6 * scale)
    assert np.allclose(room.points.variance, variance_before, rtol=1e-4, atol=0.0)
    for _ in range(4):
        for _ in range(5):
            joint.drive()
        joint.see_landmarks()
    after, variance = joint.dense()
    return np.stack(
        (
            (after - before) / scale,
            (room.points.point - before) / scale,
            (variance - variance_before) / scale**2,
            (room.points.variance - variance_before) / scale**2,
        )
    )


def test_a_new_point_has_the_covariance_of_the_joint_filter() -> None:
    """Equation 3.30, with landmarks known and unknown; as printed it fails."""
    for landmark_m in (0.0, 1.0):
        room = WaitingRoom()
        joint = Joint(room, 1e-5, landmark_m, 0)
        joint.drive()
        joint.see_dense((0.5, 0.05))
        expected = joint.dense()[1]
        assert np.allclose(room.points.variance, expected, rtol=1e-4, atol=0.0)
        new = MODEL.invert(joint.state.pose, MODEL.predict(joint.state.pose, DENSE).z)
        j = new.jacobian_sighting
        noise = np.diag(np.square(joint.scale * np.array((0.5, 0.05))))
        turn = Frames.of(*joint.view.landmark[:2]).turn
        right = np.einsum("ji,njk,ki->ni", turn, j @ noise @ j.transpose(0, 2, 1), turn)
        printed = np.einsum("ji,njk,ki->ni", turn, j @ noise @ j, turn)
        assert not np.allclose(expected - right + printed, expected, rtol=0.1, atol=0.0)


@pytest.mark.parametrize("seed", range(5))
def test_it_equals_the_joint_filter_where_landmarks_are_known(seed: int) -> None:
    """With noise of the motion, and so small that everything is linear: mean and variance."""
    expected, found, variance, found_variance = corrections(WaitingRoom, 0.0, 1e-5, seed)
    assert np.abs(expected).max() > 0.1  # of deviations of half a metre
    assert np.allclose(found, expected, atol=1e-4 * np.abs(expected).max())
    assert np.allclose(found_variance, variance, atol=1e-3 * np.abs(variance).max())


@pytest.mark.parametrize("kind", BROKEN)
def test_the_equality_rejects(kind: type[WaitingRoom]) -> None:
    expected, found, *_ = corrections(kind, 0.0, 1e-5, 0)
    assert np.abs(found - expected).max() > 0.02 * np.abs(expected).max()


def test_where_landmarks_are_learnt_it_does_most_of_what_the_joint_filter_does() -> None:
    """Corrections differ by a twentieth of their size, variances by a hundredth."""
    gap, whole, learnt, learnt_by_joint = 0.0, 0.0, 0.0, 0.0
    for seed in range(30):
        expected, found, variance, found_variance = corrections(WaitingRoom, 1.0, 1e-5, seed)
        gap += np.square(found - expected).sum()
        whole += np.square(expected).sum()
        learnt += found_variance.sum()
        learnt_by_joint += variance.sum()
    assert gap < 0.1**2 * whole
    assert 0.98 < learnt / learnt_by_joint < 1.0


def view_at(pose: Array, landmark: Array = LANDMARK, sigma: float = 0.3) -> FilterView:
    """A filter that knows the pose and the landmarks so well, each on its own."""
    slot = np.arange(len(landmark))
    variance = np.concatenate(((sigma**2, sigma**2, 0.01), np.full(2 * len(slot), sigma**2)))
    return FilterView(pose, landmark, slot, np.diag(variance))


def noise(count: int, sigma: float = 0.1) -> Array:
    return np.broadcast_to(sigma**2 * np.eye(2), (count, 2, 2))


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

    room = WaitingRoom()
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
    room = WaitingRoom()
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
    room = WaitingRoom()
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
    regions = LocalRegions(Conditions(flip_sigmas=0.0))
    view = view_at(START)
    potential = regions.potential(view.landmark, view.slot, view.pose, view.covariance)
    strange = np.array([(500.0, 0.0), (np.nan, 1.0), (3.0, 7.0)])
    spread = noise(6).copy()
    spread[5] = np.nan
    room = WaitingRoom()
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
    passive = FilterView(view.pose, view.landmark, view.slot[:2], view.covariance[:7, :7])
    assert (room.add(passive, DENSE, noise(3), 9, anywhere((0, 2))) == -1).all()
    assert room.counts.refused == 6


def test_points_leave_once_a_region_has_them() -> None:
    """They follow their landmarks until then; variance turns with the frame."""
    room, view = WaitingRoom(), view_at(START)
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
    frame = Frames.of(moved.landmark[0], moved.landmark[1])
    assert np.allclose(
        frame.turn.T @ out.covariance @ frame.turn, [np.diag(v) for v in variance[inside]]
    )
    assert np.array_equal(out.number, np.flatnonzero(inside))
    assert (out.scan == 4).all()
    assert (out.region == 0).all()
    assert room.counts.released == inside.sum()
    assert np.array_equal(room.points.point, local[~inside])


def test_the_oldest_make_room_and_are_counted() -> None:
    room, view = WaitingRoom(capacity=7), view_at(START)
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
    room, view = WaitingRoom(), view_at(START)
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
    room, view = WaitingRoom(), view_at(START)
    room.add(view, DENSE, noise(3), 0, anywhere((0, 1)))
    room.add(view, DENSE, noise(3), 0, anywhere((2, 3)))
    point, variance = room.points.point.copy(), room.points.variance.copy()
    slot = np.array((2, 3))
    columns = state_columns(slot)
    moved = FilterView(
        START + (0.3, 0.1, 0.05), LANDMARK, slot, 0.5 * view.covariance[np.ix_(columns, columns)]
    )
    room.predicted(view)
    room.updated(moved)
    assert room.counts.uncoupled == 3
    assert np.array_equal(room.points.point[:3], point[:3])
    assert np.array_equal(room.points.variance[:3], variance[:3])
    assert (room.points.variance[3:] < variance[3:]).all()
    active = view_at(START + (0.3, 0.1, 0.05), sigma=0.1)
    room.predicted(active)
    room.updated(active)  # active again: what happened meanwhile is not known
    assert np.array_equal(room.points.point[:3], point[:3])
    assert room.counts.uncoupled == 3


def test_what_has_waited_long_gets_a_virtual_region() -> None:
    """Two landmarks and nothing behind them: the points wait for a third one in vain."""
    landmark = np.array([(0.0, 0.0), (10.0, 0.0)])
    view = view_at(np.array((5.0, -6.0, 1.5)), landmark, 0.01)
    wall = np.column_stack((np.linspace(3, 7, 20), np.full(20, 1.5)))
    regions = LocalRegions(Conditions(known_apart_m=0.1))
    room = WaitingRoom(patience=10)
    given = (view.landmark, view.slot, view.pose, view.covariance)
    potential = regions.potential(*given)
    room.add(view, wall, noise(20), 0, potential)
    assert room.counts.refused == 0
    assert len(room.overdue(view, 9)) == 0
    overdue = room.overdue(view, 10)
    assert np.allclose(overdue, wall)
    assert len(regions.extend_virtual(*given, overdue, 5)) == 1
    assert len(room.release(view, regions.placed(landmark)).region) == 20
    assert len(room.points.scan) == 0


def test_without_points_nothing_happens() -> None:
    room, view = WaitingRoom(), view_at(START)
    nothing = np.empty((0, 2))
    assert len(room.add(view, nothing, noise(0), 0, anywhere((0, 1)))) == 0
    no_landmark = FilterView(START, np.empty((0, 2)), np.arange(0), np.eye(3))
    regions = LocalRegions()
    for now in (no_landmark, view):
        potential = regions.potential(now.landmark, now.slot, now.pose, now.covariance)
        room.add(now, nothing, noise(0), 0, potential)
        room.predicted(now)
        room.updated(now)
        assert len(room.release(now, regions.placed(now.landmark)).region) == 0
        assert len(room.overdue(now, 1)) == 0
    assert (
        room.add(
            no_landmark,
            DENSE,
            noise(3),
            0,
            regions.potential(no_landmark.landmark, no_landmark.slot, START, np.eye(3)),
        )
        == -1
    ).all()


def test_every_point_is_somewhere() -> None:
    """Whatever happens, the counts add up."""
    rng = np.random.default_rng(0)
    room, offered = WaitingRoom(capacity=60), 0
    regions = LocalRegions(Conditions(known_apart_m=0.2, flip_sigmas=0.0))
    landmark = rng.uniform(-15, 15, (12, 2))
    for scan in range(40):
        if scan == 20:
            landmark[3] = np.nan
        now = view_at(np.append(rng.uniform(-5, 5, 2), 0.3), landmark, 0.05 if scan % 4 else 0.5)
        given = (now.landmark, now.slot, now.pose, now.covariance)
        room.predicted(now)
        room.updated(now)
        if scan % 10 == 9:
            regions.extend(
                landmark, now.slot[scan % 7 :][:4], now.joint_of_landmarks(now.slot[scan % 7 :][:4])
            )
        room.release(now, regions.placed(landmark))
        point = rng.uniform(-25, 25, (10, 2))
        outside = point[regions.placed(landmark).locate(point).region < 0]
        room.add(now, outside, noise(len(outside)), scan, regions.potential(*given))
        offered += len(outside)
        counts = room.counts
        gone = counts.released + counts.refused + counts.dropped + counts.vanished
        assert offered == len(room.points.scan) + gone
    assert min(counts.released, counts.refused, counts.dropped, counts.vanished) > 0
