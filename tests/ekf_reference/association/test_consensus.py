import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ekf_reference.association.consensus import ConsensusAssociation
from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core.measurements import AMBIGUOUS, Measurements
from ekf_reference.core.state import KalmanState
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.association import scenes

MODEL = RangeBearing()
POSTS = [(5.0, 0.0), (5.0, 2.0), (5.0, 5.0)]


def mapped(points: scenes.Points = POSTS, heading_sigma: float = 0.01) -> KalmanState:
    return scenes.mapped(points, np.diag((1e-4, 1e-4, heading_sigma**2)), 0.01)


def seen(*points: tuple[float, float], heading: float = 0.0) -> Measurements:
    return scenes.seen(list(points), (0.05, 0.02), heading)


def test_known_landmarks_and_new_ones() -> None:
    rule = ConsensusAssociation()
    assert rule.assign(mapped(POSTS[:0]), MODEL, seen((5.0, 0.0), (5.0, 2.0))).tolist() == [0, 1]
    some = seen((5.0, 2.0), (5.0, -3.0), (5.0, 0.0))
    assert rule.assign(mapped(), MODEL, some).tolist() == [1, 3, 0]


def test_a_clump_is_one_landmark() -> None:
    """What is 0.3 m apart shares a landmark, mapped or new; the nearest neighbour splits it."""
    scan = seen((5.0, 0.1), (5.2, -0.2), (5.0, -3.0), (5.2, -3.2))
    assert ConsensusAssociation().assign(mapped(), MODEL, scan).tolist() == [0, 0, 3, 3]
    assert len(set(NearestNeighbour().assign(mapped(), MODEL, scan).tolist())) == 4


def test_a_measurement_that_fits_two_landmarks_is_ambiguous() -> None:
    """Turned by half the spacing with a heading that allows for it: either post could be meant."""
    lost, one = mapped(heading_sigma=0.2), seen((5.0, 1.0))
    assert ConsensusAssociation().assign(lost, MODEL, one).tolist() == [AMBIGUOUS]
    assert NearestNeighbour().assign(lost, MODEL, one).tolist() != [AMBIGUOUS]
    sure = mapped(heading_sigma=0.01)
    assert ConsensusAssociation().assign(sure, MODEL, seen((5.0, 0.4))).tolist() == [0]


def test_two_together_decide_what_one_cannot() -> None:
    """Posts equally far, 0.4 and 0.8 rad apart: one could be any, the gap between two tells."""
    ring = [(6.0 * float(np.cos(b)), 6.0 * float(np.sin(b))) for b in (-0.6, -0.2, 0.6)]
    lost = mapped(ring, heading_sigma=0.4)
    rule = ConsensusAssociation()
    for post in ring[:2]:
        assert rule.assign(lost, MODEL, seen(post, heading=-0.25)).tolist() == [AMBIGUOUS]
    both = seen(ring[0], ring[1], heading=-0.25)
    assert rule.assign(lost, MODEL, both).tolist() == [0, 1]


@pytest.mark.parametrize(("share", "decided"), [(0.9, True), (1.1, False)])
def test_odds_are_a_ratio_of_densities(share: float, decided: bool) -> None:
    """Discs and new landmarks apart, two hypotheses have the Gaussians' densities."""
    lost, scan = mapped(heading_sigma=0.2), seen((5.08, 1.0))
    local = lost.local_map(1e3)
    predicted = MODEL.predict(local.pose, local.landmark[:2])
    densities = []
    for i in range(2):
        by_pose, by_landmark = predicted.jacobian_pose[i], predicted.jacobian_landmark[i]
        spread = by_pose @ local.vehicle @ by_pose.T + scan.noise[0]
        spread += by_landmark @ local.own[i] @ by_landmark.T
        densities.append(multivariate_normal.pdf(scan.z[0], predicted.z[i], spread))
    odds = share * densities[0] / densities[1]
    assert odds > 1.0
    rule = ConsensusAssociation(resolution_m=1e-9, odds=odds, new_density=1e-30)
    assert rule.assign(lost, MODEL, scan).tolist() == [0 if decided else AMBIGUOUS]


def test_a_crowded_scan_ends_within_its_bound() -> None:
    """Twelve places that fit twelve posts in many ways: the hypotheses followed stay few."""
    points = [(8.0, 1.2 * k) for k in range(-6, 6)]
    state, scan = mapped(points, heading_sigma=0.3), seen(*points)
    landmark_indices = ConsensusAssociation(most_hypotheses=20).assign(state, MODEL, scan)
    used = landmark_indices[landmark_indices >= 0]
    assert len(used) == len(set(used.tolist()))
