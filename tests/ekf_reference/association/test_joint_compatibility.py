import numpy as np
import pytest
from scipy.stats import chi2

from ekf_reference.association.distances import normalised_distances
from ekf_reference.association.joint_compatibility import JointCompatibility
from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core.measurements import AMBIGUOUS, Measurements
from ekf_reference.core.state import KalmanState
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.association import scenes

MODEL = RangeBearing()
SIGMA = (0.05, 0.005)


def row_of_posts(heading_sigma: float) -> KalmanState:
    """Posts 0.6 m apart, 10 m ahead; the vehicle is unsure of its heading only."""
    points = [(10.0, 0.6 * k) for k in range(-3, 4)]
    return scenes.mapped(points, np.diag((1e-6, 1e-6, heading_sigma**2)), 0.01)


def seen_from(heading: float, points: scenes.Points) -> Measurements:
    return scenes.seen(points, SIGMA, heading)


def test_a_row_seen_with_a_turned_heading() -> None:
    """Turned by most of the spacing, each post alone fits its neighbour; together they do not."""
    state = row_of_posts(0.05)
    truth = [0, 1, 2, 3, 4, 5, 6]
    seen = seen_from(0.045, [(10.0, 0.6 * (k - 3)) for k in truth])
    joint = JointCompatibility().assign(state, MODEL, seen)
    single = NearestNeighbour().assign(state, MODEL, seen)
    assert joint.tolist() == truth
    assert single.tolist() != truth


@pytest.mark.parametrize("seed", range(6))
def test_equals_exhaustive_search(seed: int) -> None:
    """The largest jointly compatible set, with the least joint distance, found by trying all."""
    rng = np.random.default_rng(seed)
    state = row_of_posts(0.04)
    points = [(10.0, 0.6 * k) for k in rng.choice(np.arange(-3, 4), 4, replace=False)]
    seen = seen_from(float(rng.normal(0, 0.04)), [*points[:3], (10.0 + rng.normal(0, 0.3), 0.3)])

    def judge(pairs: scenes.Pairs) -> tuple[float, float, int]:
        nis = scenes.joint_nis(state, seen, pairs)
        return nis, nis, 2 * len(pairs)

    nis = normalised_distances(state.local_map(1e3), MODEL, seen).nis
    found = JointCompatibility(new_gate=1e9).assign(state, MODEL, seen)
    expected = scenes.best_pairs(nis <= chi2.ppf(0.999, 2), judge)
    assert np.where(found == AMBIGUOUS, -1, found).tolist() == expected


def test_new_and_ambiguous_as_with_the_nearest_neighbour() -> None:
    state = row_of_posts(0.001)
    seen = seen_from(0.0, [(10.0, 0.6), (20.0, 5.0), (10.0, 0.86)])
    assert JointCompatibility().assign(state, MODEL, seen).tolist() == [4, 7, AMBIGUOUS]


def test_a_crowded_scan_ends_within_its_bound() -> None:
    """Thirty measurements that fit every post: the search gives its best set, not an eternity."""
    state = row_of_posts(0.3)
    seen = seen_from(0.0, [(10.0, 0.02 * k) for k in range(30)])
    rule = JointCompatibility(most_nodes=500)
    landmark_indices = rule.assign(state, MODEL, seen)
    used = landmark_indices[(landmark_indices >= 0) & (landmark_indices < 7)]
    assert len(used) == len(set(used.tolist())) > 0
    assert rule.counts["cut off"] == 1
    rule.assign(state, MODEL, seen_from(0.0, [(10.0, 0.0)]))  # within its bound
    assert rule.counts["cut off"] == 1


@pytest.mark.parametrize(("left", "cut"), [(0, 0), (-1, 1)])
def test_a_search_that_ends_on_its_last_node_is_not_cut_off(left: int, cut: int) -> None:
    state, seen = row_of_posts(0.001), seen_from(0.0, [(10.0, 0.0), (20.0, 5.0)])
    needed = next(
        n for n in range(1, 50) if not _cut(JointCompatibility(most_nodes=n), state, seen)
    )
    assert _cut(JointCompatibility(most_nodes=needed + left), state, seen) == cut


def _cut(rule: JointCompatibility, state: KalmanState, seen: Measurements) -> int:
    rule.assign(state, MODEL, seen)
    return rule.counts["cut off"]


def test_the_order_of_measurements_does_not_matter() -> None:
    """A set that passes its own gate counts, even where a part of it would not pass a smaller one.

    Three posts far apart and a certain pose: nis 10, 10 and 0 are each within 13.8, and 20
    together within 22.5 for three pairs, though not within 18.5 for two.
    """
    points = [(10.0, 0.0), (0.0, 12.0), (-9.0, -9.0)]
    state = scenes.mapped(points, 1e-12 * np.eye(3), 1e-6)
    z = seen_from(0.0, points).z
    z[:2, 0] += np.sqrt(10.0) * 0.05
    for order in ([0, 1, 2], [2, 0, 1], [1, 2, 0]):
        seen = scenes.measurements(z[order], SIGMA)
        assert JointCompatibility().assign(state, MODEL, seen).tolist() == order


def test_a_scan_of_a_thousand_falls_back_to_the_nearest_neighbour() -> None:
    state = row_of_posts(0.3)
    seen = seen_from(0.0, [(10.0, 0.002 * k) for k in range(1100)])
    landmark_indices = JointCompatibility().assign(state, MODEL, seen)
    assert np.array_equal(landmark_indices, NearestNeighbour().assign(state, MODEL, seen))
