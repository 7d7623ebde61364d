from dataclasses import replace

import numpy as np
import pytest

from ekf_reference.association.distances import Distances, normalised_distances
from ekf_reference.association.known import KnownAssociation
from ekf_reference.association.nearest_neighbour import EuclideanNeighbour, NearestNeighbour
from ekf_reference.core.blocks import stack
from ekf_reference.core.landmark_types import NewLandmarks
from ekf_reference.core.measurements import AMBIGUOUS, REJECTED, Measurements
from ekf_reference.core.state import FilterDivergedError, KalmanState
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.association import scenes
from tests.ekf_reference.numerics import point_columns

MODEL = RangeBearing()


def state_with(points: scenes.Points, sigmas: list[float]) -> KalmanState:
    return scenes.mapped(points, np.diag((1e-4, 1e-4, 1e-6)), sigmas)


def measurements(points: scenes.Points, labels: tuple[int, ...] = ()) -> Measurements:
    unlabelled = scenes.seen(points, (0.1, 0.01))
    return replace(unlabelled, identity=np.array(labels)) if labels else unlabelled


def distances(state: KalmanState, seen: Measurements) -> Distances:
    return normalised_distances(state.local_map(1e3), MODEL, seen)


def test_distances_equal_the_textbook_for_every_pair() -> None:
    rng = np.random.default_rng(0)
    state = state_with([(10, 3), (5, -8), (-4, 9)], [0.5, 1.0, 0.2])
    state.predict(np.zeros(3), np.eye(3) + 0.1 * rng.standard_normal((3, 3)), 0.01 * np.eye(3))
    state.augment(
        NewLandmarks(np.array([[7.0, 7.0]]), rng.standard_normal((1, 2, 3)), np.eye(2)[None]),
        np.eye(2)[None],
    )
    seen = measurements([(10.2, 3.1), (-4.1, 9.3)])
    nis, distance, innovation = distances(state, seen)
    predicted = MODEL.predict(state.pose, state.landmarks)
    for i in range(len(seen)):
        for j in range(state.landmark_count):
            columns = point_columns(np.array([j]))
            h = stack(predicted.jacobian_pose[[j]], predicted.jacobian_landmark[[j]])
            s = h @ state.covariance[np.ix_(columns, columns)] @ h.T + seen.noise[i]
            nu = seen.z[i] - predicted.z[j]
            nu[1] = np.angle(np.exp(1j * nu[1]))
            assert np.allclose(innovation[i, j], nu, rtol=0.0, atol=1e-12)
            expected = nu @ np.linalg.solve(s, nu)
            assert np.isclose(nis[i, j], expected, rtol=1e-10)
            assert np.isclose(distance[i, j], expected + np.log(np.linalg.det(s)), rtol=1e-10)


def test_a_broken_covariance_is_a_diverged_filter() -> None:
    """What reads the filter catches that one error, and no other."""
    state = scenes.mapped([(10.0, 3.0)], np.diag((1e-4, 1e-4, -1e-6)), [0.5])
    with pytest.raises(FilterDivergedError, match="negative"):
        NearestNeighbour().assign(state, MODEL, measurements([(10.2, 3.1)]))


def test_nearest_by_n_not_by_nis() -> None:
    """Between a vague and a sharp landmark, N of eq. 2.60 prefers the sharp one."""
    state = state_with([(10.0, 0.0), (10.45, 0.0)], [3.0, 0.12])
    seen = measurements([(10.15, 0.0)])
    nis, distance, _ = distances(state, seen)
    assert nis[0, 0] < nis[0, 1] < 9.0
    assert distance[0, 1] < distance[0, 0]
    assert NearestNeighbour().assign(state, MODEL, seen).tolist() == [1]


def test_gate_ambiguity_and_new_landmarks() -> None:
    state = state_with([(10.0, 0.0), (0.0, 12.0)], [0.1, 0.1])
    rule = NearestNeighbour()
    inside, between, far = (10.2, 0.0), (10.62, 0.0), (10.0, 8.0)
    seen = measurements([inside, between, far])
    nis = distances(state, seen).nis
    assert rule.gate < nis[1].min() < rule.new_gate < nis[2].min()
    assert rule.assign(state, MODEL, seen).tolist() == [0, AMBIGUOUS, 2]


def test_each_landmark_is_taken_once_in_a_scan() -> None:
    state = state_with([(10.0, 0.0)], [0.2])
    landmark_indices = NearestNeighbour().assign(
        state, MODEL, measurements([(10.25, 0.0), (10.05, 0.0)])
    )
    assert landmark_indices.tolist() == [AMBIGUOUS, 0]


def test_labels_map_to_landmark_indices_in_order_of_arrival() -> None:
    state = KalmanState(np.zeros(3), np.eye(3))
    seen = measurements([(1, 1), (2, 2), (3, 3), (1, 1)], (40, 7, -1, 40))
    landmark_indices = KnownAssociation().assign(state, MODEL, seen)
    assert landmark_indices.tolist() == [0, 1, REJECTED, 0]


def test_a_misread_label_is_rejected_by_the_gate_only() -> None:
    state = state_with([(10.0, 0.0)], [0.1])
    seen = measurements([(-10.0, 1.0)], (5,))
    for gate, expected in ((60.0, REJECTED), (float("inf"), 0)):
        rule = KnownAssociation(gate, {5: 0})
        assert rule.assign(state, MODEL, seen).tolist() == [expected]


def test_euclidean_distance_decides() -> None:
    """Misono 2007, eq. 17: within d_min or new, whatever the covariances say."""
    state = state_with([(10.0, 0.0), (10.0, 3.0)], [5.0, 0.01])
    seen = measurements([(10.6, 0.0), (10.0, 3.9), (10.0, -1.2), (10.3, 0.3)])
    landmark_indices = EuclideanNeighbour(d_min_m=1.0).assign(state, MODEL, seen)
    assert landmark_indices.tolist() == [AMBIGUOUS, 1, 2, 0]  # the fourth is nearer to the first
    assert NearestNeighbour().assign(state, MODEL, seen).tolist()[1] != 1


def test_a_lost_vehicle_searches_farther() -> None:
    """At loop closing the pose may be off by more than any fixed margin; the gate still decides."""
    state = scenes.mapped([(28.0, 0.0)], np.diag((225.0, 1e-4, 1e-8)), 0.01)
    seen = measurements([(10.0, 0.0)])  # 18 m short: 1.2 sigma
    assert NearestNeighbour().assign(state, MODEL, seen).tolist() == [0]
