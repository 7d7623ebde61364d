"""What a path would leave: by the filter, by the smoother, and by a dense information matrix."""

from dataclasses import replace

import numpy as np
import pytest

from comparisons.arrays import Array, Index
from comparisons.errors import InputError
from comparisons.logs.bundled import open_log
from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import NEW, Ekf
from ekf_reference.core.state import KalmanState
from ekf_reference.dense.layers.layer import Samples
from ekf_reference.models.motion import RelativePoseModel
from ekf_reference.models.range_bearing import RangeBearing
from graphslam.problem import SlamProblem
from research.documents import nieto_next_path
from research.documents.nieto_next_path import (
    CLEARANCE_M,
    WAY_M,
    Left,
    Path,
    covariance_by_filter,
    covariance_by_smoother,
    crossings,
    ways,
)
from tests.helpers import first_seconds

PRIOR = np.array((0.5, -1.0, 0.3))
PRIOR_COVARIANCE = np.diag((0.2, 0.1, 0.05)) ** 2
NOISE = np.array(((0.02, 0.001, 0.0), (0.001, 0.01, 0.002), (0.0, 0.002, 0.004)))
SIGMA = np.array((0.1, 0.02))
LANDMARK = np.array(((4.0, 3.0), (9.0, -2.0), (12.0, 4.0), (18.0, 1.0), (15.0, -6.0)))


def path(turn: float, *seen: tuple[int, ...]) -> Path:
    """Motions of 2 m, each with a turn."""
    count = len(seen)
    return Path(
        increment=np.tile((2.0, 0.3, turn), (count, 1)),
        noise=np.tile(NOISE, (count, 1, 1)),
        seen=tuple(np.array(one, dtype=np.intp) for one in seen),
        sigma=SIGMA,
    )


DRIVEN = path(0.1, (0, 1), (0, 1, 2), (2, 1), (3, 2), (4,), (3, 4))
AHEAD = path(-0.4, (0,), (), (1, 0, 4), (2,))
POSES = DRIVEN.poses(PRIOR)


def filtered() -> Ekf:
    """After the drive; landmarks are where they are, and measured without error."""
    ekf = Ekf(RelativePoseModel(), KnownAssociation(), PRIOR, PRIOR_COVARIANCE)
    for increment, noise, seen in zip(DRIVEN.increment, DRIVEN.noise, DRIVEN.seen, strict=True):
        ekf.predict(increment, noise, 1.0)
        z = RangeBearing().predict(ekf.state.pose, LANDMARK[seen]).z
        index = np.where(seen < ekf.state.landmark_count, seen, NEW)
        order = np.argsort(seen)
        r = np.tile(np.diag(SIGMA**2), (len(seen), 1, 1))
        ekf.observe_known(z[order], r, index[order])
    return ekf


def problem() -> SlamProblem:
    """The same drive."""
    count = [len(seen) for seen in DRIVEN.seen]
    z = [RangeBearing().predict(POSES[k + 1], LANDMARK[s]).z for k, s in enumerate(DRIVEN.seen)]
    return SlamProblem(
        prior_pose=PRIOR,
        prior_covariance=PRIOR_COVARIANCE,
        increment=DRIVEN.increment,
        increment_covariance=DRIVEN.noise,
        measurement_pose=1 + np.repeat(np.arange(len(count)), count),
        measurement_landmark=np.concatenate(DRIVEN.seen),
        z=np.concatenate(z),
        sigma=np.tile(SIGMA, (sum(count), 1)),
        landmark_count=len(LANDMARK),
    )


def dense(side: float = 1.0) -> Array:
    """The inverse of the information of all poses and landmarks. side: sign of the bearing."""
    increment = np.vstack((DRIVEN.increment, AHEAD.increment))
    seen, poses = (*DRIVEN.seen, *AHEAD.seen), np.vstack((POSES, AHEAD.poses(POSES[-1])[1:]))
    pose_size = poses.size
    information = np.zeros((pose_size + LANDMARK.size,) * 2)

    def add(columns: Index, jacobian: Array, covariance: Array) -> None:
        information[np.ix_(columns, columns)] += jacobian.T @ np.linalg.solve(covariance, jacobian)

    add(np.arange(3), np.eye(3), PRIOR_COVARIANCE)
    for k in range(len(increment)):
        moved, heading = poses[k + 1] - poses[k], poses[k + 1, 2]
        by_pose = np.array(((1.0, 0.0, -moved[1]), (0.0, 1.0, moved[0]), (0.0, 0.0, 1.0)))
        turn = np.eye(3)
        turn[:2, :2] = (np.cos(heading), -np.sin(heading)), (np.sin(heading), np.cos(heading))
        rows = np.hstack((-by_pose, np.eye(3)))
        add(np.arange(3 * k, 3 * k + 6), rows, turn @ NOISE @ turn.T)
        for j in seen[k].tolist():
            x, y = LANDMARK[j] - poses[k + 1, :2]
            r = np.hypot(x, y)
            by_place = np.array(((x / r, y / r), (-side * y / r**2, side * x / r**2)))
            by_heading = np.array(((0.0,), (-1.0,)))
            first = 3 * (k + 1), pose_size + 2 * j
            columns = np.concatenate((first[0] + np.arange(3), first[1] + np.arange(2)))
            add(columns, np.hstack((-by_place, by_heading, by_place)), np.diag(SIGMA**2))
    return np.asarray(np.linalg.inv(information)[pose_size - 3 :, pose_size - 3 :])


def apart(first: Array, second: Array) -> float:
    return float(np.linalg.norm(first - second) / np.linalg.norm(second))


def test_filter_smoother_and_dense_information_leave_the_same() -> None:
    ekf = filtered()
    before = ekf.state.covariance.copy()
    ours = covariance_by_filter(ekf, AHEAD)
    theirs = covariance_by_smoother(problem(), POSES, LANDMARK, AHEAD)
    assert np.array_equal(before, ekf.state.covariance)
    assert apart(ours, theirs) < 1e-9
    assert apart(ours, dense()) < 1e-9
    assert apart(ours, dense(side=-1.0)) > 1e-2  # broken: the bearing's sign
    one, other = Left.of(ours), Left.of(theirs)
    assert one.log_determinant == pytest.approx(other.log_determinant, rel=1e-9)
    assert one.trace_m2 == pytest.approx(other.trace_m2, rel=1e-9)
    unseen = replace(AHEAD, seen=tuple(one[:0] for one in AHEAD.seen))
    assert Left.of(covariance_by_filter(ekf, unseen)).trace_m2 > 1.01 * one.trace_m2


def test_a_filter_that_forgets_cross_covariances_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    ekf, sound = filtered(), KalmanState.predict

    def forgets(state: KalmanState, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        sound(state, pose, np.eye(3), noise)

    monkeypatch.setattr(KalmanState, "predict", forgets)
    assert apart(covariance_by_filter(ekf, AHEAD), dense()) > 1e-3


def wall(gap_m: float) -> Samples:
    """Known ground around the origin; in front of it, in east, a wall with a gap in the north."""
    side = np.arange(-35.0, 35.1, 0.5)
    point = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    stands = (np.abs(point[:, 0] - 10.0) < 0.3) & (np.abs(point[:, 1] - 8.0) > 0.5 * gap_m)
    return Samples(point, np.where(stands, 0.95, 0.1), np.zeros(len(point), dtype=np.intp))


def test_ways_lead_around_what_is_occupied() -> None:
    across = np.array(((10.2, -35.0, 10.2, 3.0), (10.2, 13.0, 10.2, 35.0)))
    held = wall(10.0)
    found = ways(np.zeros(2), held)
    through = [way for way in found if way[-1, 0] > 12.0]
    assert len(through) > 3
    assert sum(crossings(way, across) for way in found) == 0
    assert sum(crossings(way[[0, -1]], across) for way in found) > 0
    for way in found:
        length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
        assert abs(length - WAY_M) <= 0.5
        assert np.array_equal(way[0], np.zeros(2))
    occupied = held.point[held.occupancy > 0.8]
    near = np.linalg.norm(np.vstack(through)[:, None] - occupied, axis=2).min()
    assert near >= CLEARANCE_M
    closed = ways(np.zeros(2), wall(2.0))
    assert max(way[:, 0].max() for way in closed) < 10.0
    free = ways(np.zeros(2), held._replace(occupancy=np.where(held.point[:, 1] < -30, 0.9, 0.1)))
    assert sum(crossings(way, across) for way in free) > 0  # broken: a map that has missed the wall


def test_ways_do_not_lead_where_nothing_is_known() -> None:
    held = wall(10.0)
    held = held._replace(occupancy=np.full(len(held.point), 0.1))
    here = np.linalg.norm(held.point, axis=1) < WAY_M - 10.0
    assert len(ways(np.zeros(2), held)) > 30
    with pytest.raises(InputError, match="no free way of 30 m"):
        ways(np.zeros(2), Samples(*(column[here] for column in held)))


@pytest.mark.slow
def test_a_drive_ends_in_a_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nieto_next_path, "WAY_M", 8.0)
    found = nieto_next_path.of_log(first_seconds(open_log("occupancy-loop"), 20.0))
    assert len(found.way) > 1
    ours, theirs = found.by_filter, found.by_smoother
    assert np.allclose(ours.gain, theirs.gain, atol=0.1 * np.ptp(theirs.gain))
    assert ours.now.log_determinant == pytest.approx(theirs.now.log_determinant, rel=0.02)
