"""A filter that carries dense points in its state, against those that wait beside it."""

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import NewLandmarks
from ekf_reference.core.state import KalmanState
from ekf_reference.dense.delayed_initialisation import DelayedInitialisation
from ekf_reference.dense.local_pose import Frames
from ekf_reference.dense.triangles import turned
from ekf_reference.dense.view import FilterView
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.dense.waiting_rooms import (
    BROKEN,
    DENSE,
    LANDMARK,
    START,
    NoMotion,
    anywhere,
)
from tests.ekf_reference.numerics import central_difference, point_columns

MODEL = RangeBearing()
SIGMA = np.array((0.1, 0.01))
"""Of the landmarks' ranges and bearings, at scale 1."""


class Joint:
    """A filter that carries the dense points in its state, beside a waiting room that does not.

    The true vehicle, landmarks and points are drawn from the filter's own prior.
    """

    def __init__(
        self, room: DelayedInitialisation, scale: float, landmark_m: float, seed: int
    ) -> None:
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
        self.state.augment(NewLandmarks(LANDMARK, np.zeros((count, 2, 3)), one), noise)

    @property
    def view(self) -> FilterView:
        """What dense mapping sees: the pose and the landmarks."""
        landmark_index = np.arange(len(LANDMARK))
        columns = point_columns(landmark_index)
        covariance = self.state.covariance[np.ix_(columns, columns)]
        return FilterView(
            self.state.pose, self.state.landmarks[: len(LANDMARK)], landmark_index, covariance
        )

    def see_dense(self, sigma: tuple[float, float] = (0.05, 0.005)) -> None:
        spread = self.scale * np.array(sigma)
        noise = np.broadcast_to(np.diag(spread**2), (len(DENSE), 2, 2))
        z = MODEL.predict(self.true_pose, DENSE).z
        z = z + spread * self.rng.standard_normal(z.shape)
        new = MODEL.invert(self.state.pose, z)
        in_world = new.jacobian_z @ noise @ new.jacobian_z.transpose(0, 2, 1)
        self.room.add(self.view, new.landmark, in_world, 0, anywhere((0, 1)))
        self.state.augment(new, noise)

    def drive(self, process: float = 1.0) -> None:
        """A step of the vehicle with process noise, in which the true vehicle slips."""
        step = UnicycleModel().step(self.state.pose, np.array((2.0, 0.4)), 0.5)
        sigma = process * self.scale * np.array((0.05, 0.05, 0.01))
        true = UnicycleModel().step(self.true_pose, np.array((2.0, 0.4)), 0.5).pose
        self.true_pose = true + sigma * self.rng.standard_normal(3)
        self.state.predict(step.pose, step.jacobian_pose, np.diag(sigma**2))

    def expected(self) -> tuple[Array, Array, Array]:
        """Measurements (L, 2) of all landmarks, their Jacobian and their noise."""
        seen = np.arange(len(LANDMARK))
        expected = MODEL.predict(self.state.pose, self.state.landmarks[seen])
        jacobian = np.zeros((2 * len(seen), 3 + 2 * len(seen)))
        jacobian[:, :3] = expected.jacobian_pose.reshape(-1, 3)
        for k in seen:
            jacobian[2 * k : 2 * k + 2, 3 + 2 * k : 5 + 2 * k] = expected.jacobian_landmark[k]
        return expected.z, jacobian, np.diag(np.tile((self.scale * SIGMA) ** 2, len(seen)))

    def see_landmarks(self) -> None:
        self.room.predicted(self.view)
        expected, jacobian, noise = self.expected()
        z = MODEL.predict(self.true_pose, self.true_landmark).z
        z = z + self.scale * SIGMA * self.rng.standard_normal(z.shape)
        innovation = MODEL.innovation(z, expected).ravel()
        self.state.update(point_columns(np.arange(len(LANDMARK))), jacobian, innovation, noise)
        self.room.updated(self.view)

    def drive_away(self, process: float = 1.0) -> None:
        """See landmarks, then dense points, and drive on."""
        self.see_landmarks()
        self.drive(process)
        self.see_dense((0.01, 0.001))
        for _ in range(10):
            for _ in range(5):
                self.drive(process)
            self.see_landmarks()

    def dense(self) -> tuple[Array, Array]:
        """The joint filter's points in the frame and their variances there, both (N, 2)."""
        count = len(LANDMARK)
        mean = self.state.landmarks
        variance = []
        for k in range(count, count + len(DENSE)):

            def in_the_frame(x: Array) -> Array:
                local: Array = Frames.of(x[:2], x[2:4]).to_local(x[4:])
                return local

            columns = point_columns(np.array((0, 1, k)))[3:]
            j = central_difference(in_the_frame, mean[[0, 1, k]].ravel())
            variance.append(np.diag(j @ self.state.covariance[np.ix_(columns, columns)] @ j.T))
        return Frames.of(mean[0], mean[1]).to_local(mean[count:]), np.array(variance)


class Derived(Joint):
    """Beside it, exactly, the covariance that the errors of waiting points have.

    variance: (N, 2), the diagonal of P_dd. cross: (N, 2, n) C, with the whole state. F moves it to
    C F^T. An update with gain K, Jacobian H and innovations of S, of which the room adds A J K nu
    to the points (J of the local pose), makes it C (I - K H)^T, and P_dd + G S G^T - G H C^T -
    C H^T G^T with G = A J K. The room takes C for A J P, which no motion with noise leaves true.
    """

    variance: Array
    cross: Array

    def local_jacobian(self) -> Array:
        """(3, n) of the vehicle's pose in the frame of the first two landmarks."""

        def local(x: Array) -> Array:
            axis = x[5:7] - x[3:5]
            place = Frames.of(x[3:5], x[5:7]).to_local(x[:2])
            return np.append(place, x[2] - np.arctan2(axis[1], axis[0]))

        known = self.state.landmarks[: len(LANDMARK)]
        return central_difference(local, np.append(self.state.pose, known))

    def see_dense(self, sigma: tuple[float, float] = (0.05, 0.005)) -> None:
        super().see_dense(sigma)
        points = self.room.points
        by_pose = np.zeros((len(DENSE), 2, 3))
        by_pose[:, 0, 0] = by_pose[:, 1, 1] = 1.0
        by_pose[:, :, 2] = turned(points.point - self.room.mean[points.group, :2])
        self.cross = by_pose @ self.local_jacobian() @ self.view.covariance
        self.variance = points.variance

    def drive(self, process: float = 1.0) -> None:
        step = UnicycleModel().step(self.state.pose, np.array((2.0, 0.4)), 0.5)
        super().drive(process)
        if len(self.room.points.scan):
            self.cross[:, :, :3] = self.cross[:, :, :3] @ step.jacobian_pose.T

    def see_landmarks(self) -> None:
        if len(self.room.points.scan):
            self.room.predicted(self.view)
            _, h, noise = self.expected()
            p, points = self.view.covariance, self.room.points
            s = h @ p @ h.T + noise
            gain = p @ h.T @ np.linalg.inv(s)
            a = points.cross @ np.linalg.inv(self.room.covariance)[points.group]
            g = a @ self.local_jacobian() @ gain
            with_nu = self.cross @ h.T
            self.variance = self.variance + np.einsum("nij,nij->ni", g @ s - 2.0 * with_nu, g)
            self.cross = self.cross - with_nu @ gain.T
        super().see_landmarks()
        if len(self.room.points.scan):
            self.ratio.append(self.variance / self.room.points.variance)

    def ratios(self, process: float = 1.0) -> Array:
        """(10, N, 2) variances over those that the room states, as the drive goes on."""
        self.ratio: list[Array] = []
        self.drive_away(process)
        return np.array(self.ratio)


def corrections(
    kind: type[DelayedInitialisation], landmark_m: float, scale: float, seed: int
) -> Array:
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
        room = DelayedInitialisation()
        joint = Joint(room, 1e-5, landmark_m, 0)
        joint.drive()
        joint.see_dense((0.5, 0.05))
        expected = joint.dense()[1]
        assert np.allclose(room.points.variance, expected, rtol=1e-4, atol=0.0)
        new = MODEL.invert(joint.state.pose, MODEL.predict(joint.state.pose, DENSE).z)
        j = new.jacobian_z
        noise = np.diag(np.square(joint.scale * np.array((0.5, 0.05))))
        turn = Frames.of(*joint.view.landmark[:2]).turn
        right = np.einsum("ji,njk,ki->ni", turn, j @ noise @ j.transpose(0, 2, 1), turn)
        printed = np.einsum("ji,njk,ki->ni", turn, j @ noise @ j, turn)
        assert not np.allclose(expected - right + printed, expected, rtol=0.1, atol=0.0)


@pytest.mark.parametrize("seed", range(5))
def test_it_equals_the_joint_filter_where_landmarks_are_known(seed: int) -> None:
    """With noise of the motion, and so small that everything is linear: mean and variance."""
    expected, found, variance, found_variance = corrections(DelayedInitialisation, 0.0, 1e-5, seed)
    assert np.abs(expected).max() > 0.1  # of deviations of half a metre
    assert np.allclose(found, expected, atol=1e-4 * np.abs(expected).max())
    assert np.allclose(found_variance, variance, atol=1e-3 * np.abs(variance).max())


@pytest.mark.parametrize("kind", BROKEN)
def test_the_equality_rejects(kind: type[DelayedInitialisation]) -> None:
    expected, found, *_ = corrections(kind, 0.0, 1e-5, 0)
    assert np.abs(found - expected).max() > 0.02 * np.abs(expected).max()


def test_where_landmarks_are_learnt_it_does_most_of_what_the_joint_filter_does() -> None:
    """Corrections differ by a twentieth of their size, variances by a hundredth."""
    gap, whole, learnt, learnt_by_joint = 0.0, 0.0, 0.0, 0.0
    for seed in range(30):
        expected, found, variance, found_variance = corrections(
            DelayedInitialisation, 1.0, 1e-5, seed
        )
        gap += np.square(found - expected).sum()
        whole += np.square(expected).sum()
        learnt += found_variance.sum()
        learnt_by_joint += variance.sum()
    assert gap < 0.1**2 * whole
    assert 0.98 < learnt / learnt_by_joint < 1.0


@pytest.mark.parametrize("process", [0.3, 1.0, 3.0])
def test_its_variance_is_right_with_known_landmarks_and_else_at_most_two_fifths_too_small(
    process: float,
) -> None:
    """Never too large, a fourth too small in the mean: the correlations that the pose lacks."""
    known = Derived(DelayedInitialisation(), 1e-4, 0.0, 0).ratios(process)
    assert np.allclose(known, 1.0, atol=1e-3)
    learnt = Derived(DelayedInitialisation(), 1e-4, 1.0, 0).ratios(process)
    assert 1.0 < learnt.min() < learnt.max() < 1.4
    assert 1.03 < learnt[-1].mean() < 1.25


def test_the_derivation_rejects_a_room_that_forgets_the_motion() -> None:
    ratio = Derived(NoMotion(), 1e-4, 0.0, 0).ratios()
    assert np.abs(ratio - 1.0).max() > 0.1


@pytest.mark.slow
def test_errors_of_drives_have_the_derived_variance() -> None:
    """Squared errors over their variances, 1 where honest; those of one drive go together.

    The joint filter goes on learning from the landmarks seen together with the points; the room
    has stopped.
    """
    derived, error, count = Derived(DelayedInitialisation(), 1e-4, 1.0, 0), np.zeros(2), 400
    ratio = derived.ratios()[-1]
    for seed in range(count):
        joint = Joint(DelayedInitialisation(), 1e-4, 1.0, seed)
        joint.drive_away()
        true = Frames.of(*joint.true_landmark[:2]).to_local(DENSE)
        points = joint.room.points
        both = joint.dense(), (points.point, ratio * points.variance)
        error += [((mean - true) ** 2 / spread).mean() / count for mean, spread in both]
    assert np.allclose(error, 1.0, atol=0.1)
    assert joint.dense()[1].sum() < derived.variance.sum()
