import numpy as np
import pytest

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.state import KalmanState
from ekf_reference.dense.conditions import Conditions, overlap
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.virtual_landmarks import VirtualLandmarks, behind
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.dense.scenes import flipped
from tests.ekf_reference.dense.test_conditions import shared
from tests.ekf_reference.numerics import central_difference, random_covariance

POSE = np.array((2.0, -6.0, 1.2))
WALL = np.array([(0.0, 0.0), (12.0, 1.0)])
BEHIND = WALL.mean(axis=0) + (-0.1, 1.2)
BOTH = np.arange(2)
ANYWHEN = Conditions(least_correlation=-1.0, flip_sigmas=0.0, longest_edge_m=1e3)


def at_a_wall(position_m: float, range_m: float) -> KalmanState:
    """Two landmarks on a wall, seen once: the pose's uncertainty and the sensor's."""
    state = KalmanState(POSE, np.diag((position_m**2, position_m**2, 1e-6)))
    model = RangeBearing()
    new = model.invert(POSE, model.predict(POSE, WALL).z)
    noise = np.broadcast_to(np.diag((range_m**2, 1e-6)), (2, 2, 2))
    state.augment(new, noise)
    return state


def extended(regions: LocalRegions, state: KalmanState, point: Array, least: int = 1) -> Index:
    landmark_index = np.arange(state.landmark_count)
    return regions.extend_virtual(
        state.landmarks, landmark_index, state.pose, state.covariance, point, least
    )


def test_it_makes_a_region_behind_two_landmarks() -> None:
    """The region is accepted and includes the wall; the filter's arrays are what they were."""
    state = at_a_wall(2.0, 0.1)
    mean, covariance = state.mean.copy(), state.covariance.copy()
    regions = LocalRegions()
    assert len(regions.extend(state.landmarks, BOTH, state.covariance[3:, 3:])) == 0
    assert extended(regions, state, BEHIND[None]).tolist() == [0]
    assert regions.base[0].min() == -1
    assert regions.placed(state.landmarks).locate(BEHIND[None]).region[0] == 0
    assert not len(flipped(regions, state.landmarks))
    assert len(extended(regions, state, BEHIND[None])) == 0  # the ground is taken
    assert np.array_equal(state.mean, mean)
    assert np.array_equal(state.covariance, covariance)


def test_not_while_the_vehicle_is_poorly_correlated() -> None:
    """A loose pose is refused though the two landmarks hang together; so are loose landmarks."""
    assert not len(extended(LocalRegions(), at_a_wall(0.3, 0.5), BEHIND[None]))
    state = at_a_wall(2.0, 0.1)
    loose = state.covariance.copy()
    loose[:2, :2] += 4.0 * np.eye(2)  # the vehicle has driven on by dead reckoning
    pair = Conditions().pairs(state.landmarks, loose[3:, 3:])
    assert pair[0, 1]
    given = (state.landmarks, BOTH, POSE)
    assert not len(LocalRegions().extend_virtual(*given, loose, BEHIND[None]))
    lax = LocalRegions(conditions=Conditions(least_correlation=-1.0))  # the check left out
    assert len(lax.extend_virtual(*given, loose, BEHIND[None])) == 1


def test_the_vehicle_counts_among_the_pairs_by_correlation() -> None:
    """Landmarks that correlate, and a vehicle that is near them but correlates too little."""
    state = at_a_wall(0.3, 0.01)
    made = LocalRegions()
    assert len(extended(made, state, BEHIND[None])) == 1
    assert made.by_correlation.tolist() == [True]
    loose = state.covariance.copy()
    loose[:2, :2] += 0.1 * np.eye(2)
    known = LocalRegions(conditions=Conditions(known_apart_m=0.5))
    assert len(known.extend_virtual(state.landmarks, BOTH, POSE, loose, BEHIND[None])) == 1
    assert known.by_correlation.tolist() == [False]


def test_not_without_points_to_cover() -> None:
    state = at_a_wall(2.0, 0.1)
    assert not len(extended(LocalRegions(), state, np.empty((0, 2))))
    assert not len(extended(LocalRegions(), state, POSE[None, :2]))  # on the vehicle's side
    assert not len(extended(LocalRegions(), state, BEHIND[None], least=2))
    assert not len(extended(LocalRegions(), state, np.full((1, 2), np.nan)))
    assert len(extended(LocalRegions(), state, np.tile(BEHIND, (2, 1)), least=2)) == 1


def test_the_triangle_with_most_points_comes_first() -> None:
    """Three landmarks on a bent wall: the triangles behind its parts overlap."""
    landmark = np.array([(0.0, 0.0), (10.0, 0.0), (16.0, -8.0)])
    covariance = shared(3.0, 0.05, 4)
    covariance = np.insert(np.insert(covariance, 2, 0.0, axis=0), 2, 0.0, axis=1)
    pose = np.array((5.0, -15.0, 0.0))
    rng = np.random.default_rng(0)
    left, right = rng.normal((4.0, 2.0), 0.3, (30, 2)), rng.normal((13.5, -3.0), 0.3, (30, 2))
    for many, few in ((left, right), (right, left)):
        regions = LocalRegions(conditions=Conditions(longest_edge_m=12.0))
        point = np.vstack((many, few[:10]))
        number = regions.extend_virtual(landmark, np.arange(3), pose, covariance, point)
        region = regions.placed(landmark).locate(point).region
        assert (region[:30] == 0).all()
        assert np.array_equal(number, np.arange(len(regions.base)))
        triangle = regions.corners(landmark)[regions.base]
        assert not np.triu(overlap(triangle[:, None], triangle), 1).any()


@pytest.mark.parametrize("seed", range(20))
def test_it_lies_across_the_line_from_the_vehicle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose, landmark = rng.uniform(-20, 20, 3), rng.uniform(-20, 20, (2, 2))
    for corners in (landmark, landmark[::-1]):
        new = behind(BOTH[None], corners, pose[:2], np.sqrt(0.75))
        triangle = np.vstack((corners, new.point(corners)))
        sides = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1)
        assert np.allclose(sides, sides[0])
        edge = corners[1] - corners[0]
        across = [
            edge[0] * (p - corners[0])[1] - edge[1] * (p - corners[0])[0]
            for p in (pose[:2], triangle[2])
        ]
        assert across[0] * across[1] < 0.0
        regions = LocalRegions(conditions=ANYWHEN)
        point = triangle.mean(axis=0)[None]
        assert len(regions.extend_virtual(corners, BOTH, pose, np.eye(7), point)) == 1
        assert np.allclose(regions.corners(corners)[2], triangle[2])
        assert not len(flipped(regions, corners))


@pytest.mark.parametrize(
    "landmark", [[(3.0, 3.0), (3.0, 3.0)], [(2.0, 0.0), (2.0, 9.0)], [(2.0, -6.0), (2.0, -6.0)]]
)
def test_no_far_side_no_landmark(landmark: list[tuple[float, float]]) -> None:
    """Landmarks that coincide, or with the vehicle on their line."""
    corners = np.array(landmark)
    point = corners.mean(axis=0) + np.array([(0.1, 0.1), (-0.1, 0.1), (0.1, -0.1), (-0.1, -0.1)])
    assert len(behind(BOTH[None], corners, POSE[:2], 1.0).depth) == 0
    regions = LocalRegions(conditions=ANYWHEN)
    assert len(regions.extend_virtual(corners, BOTH, POSE, np.eye(7), point)) == 0


def test_it_is_a_linear_function_of_its_landmarks() -> None:
    rng = np.random.default_rng(1)
    landmark = rng.uniform(-20, 20, (3, 2))
    table = VirtualLandmarks(np.array([(0, 2), (2, 1)]), np.array((0.9, -0.4)))
    for k, pair in enumerate(table.pair):

        def moved(corners: Array, k: int = k, pair: Index = pair) -> Array:
            everything = landmark.copy()
            everything[pair] = corners.reshape(2, 2)
            corner: Array = table.point(everything)[k]
            return corner

        by_pair = central_difference(moved, landmark[pair].ravel(), 1.0)  # linear: any step
        assert np.allclose(by_pair, table.jacobian()[k], atol=1e-12)
        wrong_side = VirtualLandmarks(table.pair, -table.depth).jacobian()[k]
        assert not np.allclose(by_pair, wrong_side, atol=0.1)


@pytest.mark.parametrize("turn", range(3))
def test_covariance_of_corners_follows_from_the_landmarks(turn: int) -> None:
    """Regions with a virtual corner anywhere, and one without."""
    rng = np.random.default_rng(turn)
    landmark = rng.uniform(-20, 20, (5, 2))
    table = VirtualLandmarks(np.array([(1, 4), (2, 0)]), np.array((0.9, -0.9)))
    base = np.roll(np.array([(1, 4, -1), (0, 2, -2), (3, 1, 2)]), turn, axis=1)
    regions = LocalRegions(base=base, virtual=table)
    place, lift = table.lift(base)
    joint = random_covariance(rng, 10)
    for k in range(3):

        def corners(x: Array, k: int = k) -> Array:
            found: Array = regions.corners(x.reshape(-1, 2))[base[k]].ravel()
            return found

        by_map = central_difference(corners, landmark.ravel(), 1.0)
        columns = (2 * place[k][:, None] + np.arange(2)).ravel()
        found = lift[k] @ joint[np.ix_(columns, columns)] @ lift[k].T
        assert np.allclose(found, by_map @ joint @ by_map.T, atol=1e-9)


def test_virtual_corners_follow_their_landmarks() -> None:
    """Any turn, shift and growth of the landmarks takes the regions along, oldest corner last."""
    rng = np.random.default_rng(2)
    landmark = np.array([(0.0, 0.0), (10.0, 0.0), (40.0, 0.0), (50.0, 1.0)])
    table = VirtualLandmarks(np.array([(0, 1), (2, 3)]), np.array((0.9, -0.9)))
    regions = LocalRegions(base=np.array([(0, 1, -1), (3, 2, -2)]), virtual=table)
    regions._order = np.arange(2)
    share = rng.dirichlet(np.ones(3), (2, 100))
    turn = np.array([(0.8, -0.6), (0.6, 0.8)])
    for now in (landmark, 1.3 * landmark @ turn.T + (7.0, -3.0)):
        corners = regions.corners(now)
        assert np.array_equal(corners[[-1, -2]], table.point(now))
        point = np.einsum("rnk,rkd->rnd", share, corners[regions.base]).reshape(-1, 2)
        region = regions.placed(now).locate(point).region
        assert np.array_equal(region, np.repeat((0, 1), 100))


def test_regions_of_a_landmark_that_left_the_map_are_empty() -> None:
    """The others stand; the ground is free for new ones; what left is no corner again."""
    landmark = np.array([(0.0, 0.0), (10.0, 0.0), (5.0, 8.0), (15.0, 8.0)])
    covariance = shared(3.0, 0.05, 5)
    covariance = np.insert(np.insert(covariance, 2, 0.0, axis=0), 2, 0.0, axis=1)
    pose, landmark_index = np.array((4.0, 3.0, 0.0)), np.arange(4)
    regions = LocalRegions()
    assert len(regions.extend(landmark, landmark_index, covariance[3:, 3:])) == 2
    below = np.array([(5.0, -2.0)])
    assert len(regions.extend_virtual(landmark, landmark_index, pose, covariance, below)) == 1
    point = np.vstack((landmark[:3].mean(axis=0), landmark[1:].mean(axis=0), below))
    assert sorted(regions.placed(landmark).locate(point).region) == [0, 1, 2]
    gone = landmark.copy()
    gone[0] = np.nan
    unknown = covariance.copy()
    unknown[3:5] = unknown[:, 3:5] = np.nan
    region = regions.placed(gone).locate(point).region
    assert np.array_equal(region >= 0, (False, True, False))
    assert not len(flipped(regions, gone))
    before = len(regions.base)
    assert len(regions.extend(gone, landmark_index, unknown[3:, 3:])) == 0
    assert len(regions.extend_virtual(gone, landmark_index, pose, unknown, below)) == 0
    assert len(regions.potential(gone, landmark_index, pose, unknown).axis) > 0
    assert (regions.potential(gone, landmark_index, pose, unknown).axis > 0).all()
    found_again = np.vstack((gone, landmark[:1]))
    everyone = np.insert(np.insert(shared(3.0, 0.05, 6), 2, 0.0, axis=0), 2, 0.0, axis=1)
    everyone[3:5] = everyone[:, 3:5] = np.nan
    assert len(regions.extend(found_again, np.arange(5), everyone[3:, 3:])) == 1
    assert regions.placed(found_again).locate(point).region[0] == before


def test_potential_regions_are_those_that_lack_correlation_alone() -> None:
    landmark = np.array([(0.0, 0.0), (10.0, 0.0), (5.0, 8.0), (15.0, 8.0)])
    loose = np.insert(np.insert(shared(0.01, 0.3, 5), 2, 0.0, axis=0), 2, 0.0, axis=1)
    pose, landmark_index = np.array((5.0, -5.0, 0.0)), np.arange(4)
    regions = LocalRegions()
    assert len(regions.extend(landmark, landmark_index, loose[3:, 3:])) == 0
    found = regions.potential(landmark, landmark_index, pose, loose)
    region = found.placed.locate(np.array([(5.0, 3.0), (10.0, 5.0), (10.0, 14.0)])).region
    assert (region >= 0).all()
    assert (found.axis[:, 0] < found.axis[:, 1]).all()
    assert set(map(tuple, found.axis[region].tolist())) <= {(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)}
    assert tuple(found.axis[region[2]]) == (2, 3)  # behind the far pair there is no landmark
    taken = LocalRegions()
    taken.extend(landmark, landmark_index, shared(3.0, 0.05, 4))
    rest = taken.potential(landmark, landmark_index, pose, loose)
    inside = np.array([(5.0, 3.0), (10.0, 5.0)])
    assert (taken.placed(landmark).locate(inside).region >= 0).all()
    assert (rest.placed.locate(inside).region == -1).all()
    alone = taken.potential(landmark, landmark_index[:1], pose, loose[:5, :5])
    assert alone.axis.shape == (0, 2)
    assert (alone.placed.locate(inside).region == -1).all()
