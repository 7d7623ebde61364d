from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from scipy.stats import binomtest, chi2, norm

from ekf_reference.association.attributes import (
    AttributeDistances,
    AttributeEstimates,
    Attributes,
    RememberedAttributes,
    same_tail,
)
from ekf_reference.association.joint_compatibility import JointCompatibility
from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core.measurements import (
    AMBIGUOUS,
    NOT_MEASURED,
    MeasuredAttributes,
    Measurements,
)
from ekf_reference.core.state import KalmanState
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.association import scenes

MODEL = RangeBearing()
SIGMA = (0.05, 0.005)
ANYTHING = 1e9
TRIALS = 2000


def mapped(points: scenes.Points, pose_covariance: np.ndarray) -> KalmanState:
    return scenes.mapped(points, pose_covariance, 1e-3)


def seen(z: np.ndarray, value: np.ndarray, sigma: float | np.ndarray) -> Measurements:
    """Measurements (m, 2) with attributes (m, A)."""
    reported = MeasuredAttributes(value, np.broadcast_to(np.square(sigma), value.shape))
    return replace(scenes.measurements(z, SIGMA), attributes=reported)


def remembered(mean: np.ndarray, sigma: np.ndarray, repeats: float = 1.0) -> AttributeEstimates:
    """Landmarks (L, A) whose attributes are known to a sigma (L, A), NaN for unknown."""
    memory = AttributeEstimates(np.full(mean.shape[1], repeats))
    reported = seen(np.ones((len(mean), 2)), mean, sigma)
    memory.note(np.arange(len(mean)), reported.attributes)
    return memory


def expected_share(share: float, right: int, trials: int = TRIALS) -> bool:
    """A two-sided test at 1 in 1000."""
    return bool(binomtest(right, trials, share).pvalue > 1e-3)


def test_a_constant_is_filtered() -> None:
    """Without repeats the estimate is a Kalman filter's that the first measurement initialised."""
    rng = np.random.default_rng(0)
    memory = AttributeEstimates(np.ones(1))
    mean, variance = np.nan, np.inf
    for k in range(20):
        z, sigma = rng.normal(0.4, 0.1), rng.uniform(0.05, 0.2)
        gain = 1.0 if k == 0 else variance / (variance + sigma**2)
        mean = z if k == 0 else mean + gain * (z - mean)
        variance = sigma**2 if k == 0 else (1.0 - gain) * variance
        memory.note(np.array([2]), seen(np.ones((1, 2)), np.array([[z]]), sigma).attributes)
        assert np.allclose((memory.mean[2, 0], memory.variance[2, 0]), (mean, variance), rtol=1e-12)
    assert memory.count.tolist() == [[0], [0], [20]]
    assert np.isnan(memory.mean[:2]).all()


def test_repeated_measurements_are_worth_less_but_never_less_than_one() -> None:
    memory = AttributeEstimates(np.array([10.0]))
    sigmas = []
    for _ in range(40):
        memory.note(np.array([0]), seen(np.ones((1, 2)), np.array([[0.4]]), 0.1).attributes)
        sigmas.append(float(np.sqrt(memory.variance[0, 0])))
    assert np.allclose(sigmas[:10], 0.1, rtol=1e-12)
    assert np.isclose(sigmas[39], 0.1 * np.sqrt(10.0 / 40.0), rtol=1e-12)


def test_the_density_is_the_product_of_the_gaussians() -> None:
    rng = np.random.default_rng(1)
    mean, sigma = rng.normal(size=(3, 2)), rng.uniform(0.1, 2.0, (3, 2))
    memory = remembered(mean, sigma)
    reported = seen(np.ones((4, 2)), rng.normal(size=(4, 2)), 0.3)
    found = memory.distances(np.array([2, 0]), reported)
    for i, j in product(range(4), range(2)):
        own = norm(mean[(2, 0)[j]], np.hypot(sigma[(2, 0)[j]], 0.3))
        log_density = float(own.logpdf(reported.attributes.value[i]).sum()) + np.log(2.0 * np.pi)
        assert np.isclose(found.n[i, j], -2.0 * log_density, rtol=1e-10)
        innovation = reported.attributes.value[i] - mean[(2, 0)[j]]
        assert np.isclose(found.nis[i, j], np.sum((innovation / own.std()) ** 2), rtol=1e-10)
    assert (found.dof == 2).all()


def test_what_is_missing_is_not_compared() -> None:
    memory = remembered(np.array([[0.4, 7.0], [0.6, np.nan]]), np.full((2, 2), 0.1))
    nothing, half = (np.nan, np.nan), (0.5, np.nan)
    found = memory.distances(np.arange(3), seen(np.ones((2, 2)), np.array([nothing, half]), 0.1))
    assert found.dof.tolist() == [[0, 0, 0], [1, 1, 0]]
    assert (found.nis[0] == 0.0).all()
    assert (found.n[0] == 0.0).all()
    assert found.nis[1, 2] == 0.0


def test_a_landmark_that_lacks_an_attribute_stands_with_all_that_have_it() -> None:
    """With the mean of theirs, and with their spread and their own variances together."""
    memory = remembered(np.array([[0.4], [0.8], [np.nan]]), np.array([[0.1], [0.3], [0.1]]))
    found = memory.distances(np.array([2]), seen(np.ones((1, 2)), np.array([[1.0]]), 0.2))
    variance = 0.2**2 + 0.5 * (0.1**2 + 0.3**2) + 0.2**2
    assert found.n[0, 0] == pytest.approx(0.4**2 / variance + np.log(variance), rel=1e-12)


def tree_drive(
    rule: Callable[[Attributes], NearestNeighbour | JointCompatibility],
    memory: AttributeEstimates,
    unit: float,
) -> list[list[int]]:
    """Landmark indices of some scans by a rule; every other landmark tells nothing of itself."""
    rng = np.random.default_rng(5)
    points = [(10.0, 0.5 * k) for k in range(-3, 4)]
    state = mapped(points, np.diag((0.2**2, 0.2**2, 0.01**2)))
    landmark_indices = []
    for _ in range(40):
        which = rng.choice(7, 3, replace=False)
        pose = rng.multivariate_normal(np.zeros(3), state.pose_covariance)
        z = MODEL.predict(pose, np.array(points)[which]).z + rng.normal(0, SIGMA, (3, 2))
        value = unit * rng.normal(0.3 + 0.05 * which, 0.05)[:, None]
        landmark_indices.append(
            rule(memory).assign(state, MODEL, seen(z, value, 0.05 * unit)).tolist()
        )
    return landmark_indices


@dataclass
class Broken:
    """Another n of what was found."""

    memory: AttributeEstimates
    n: Callable[[AttributeDistances], np.ndarray]

    def distances(
        self, landmark_index: np.ndarray, measurements: Measurements
    ) -> AttributeDistances:
        found = self.memory.distances(landmark_index, measurements)
        return found._replace(n=self.n(found))


def left_out(found: AttributeDistances) -> np.ndarray:
    """A landmark without the attribute goes without the term."""
    return np.where(found.dof > 0, found.n, 0.0)


def unnormalised(found: AttributeDistances) -> np.ndarray:
    """The exponent alone, which is least for a landmark of which little is known."""
    return found.nis


@pytest.mark.parametrize("kind", [NearestNeighbour, JointCompatibility])
def test_the_unit_does_not_matter(kind: type) -> None:
    """Even where some landmarks lack the attribute; leaving their term out would let it matter."""
    diameter = np.array([np.nan if k % 2 else 0.3 + 0.05 * k for k in range(7)])[:, None]
    for rule, same in (
        (lambda memory: kind(attributes=memory), True),
        (lambda memory: kind(attributes=Broken(memory, left_out)), False),
    ):
        metres, millimetres = (
            tree_drive(rule, remembered(u * diameter, np.full((7, 1), 0.02 * u)), u)
            for u in (1.0, 1000.0)
        )
        assert (metres == millimetres) is same


def two_trees(
    rule: NearestNeighbour, diameter: tuple[float, float], sigma: float, offset_m: float = 0.6
) -> int:
    """How often the right one of two trees is taken, by a vehicle that hardly knows where it is."""
    rng = np.random.default_rng(11)
    points = np.array([(10.0, 0.0), (10.0, offset_m)])
    state = mapped([tuple(p) for p in points], np.diag((0.5**2, 0.5**2, 1e-8)))
    right = 0
    for k in range(TRIALS):
        pose = rng.multivariate_normal(np.zeros(3), state.pose_covariance)
        z = MODEL.predict(pose, points[[k % 2]]).z + rng.normal(0.0, SIGMA)
        value = np.array([[rng.normal(diameter[k % 2], sigma)]])
        right += rule.assign(state, MODEL, seen(z, value, sigma)).tolist() == [k % 2]
    return right


@pytest.mark.slow
def test_two_trees_are_told_apart_as_often_as_theory_says() -> None:
    """Two Gaussians of one covariance are told apart in Phi(d / 2) of all cases.

    d: their Mahalanobis distance, the squares of position and attribute added.
    """
    spread = np.hypot(0.5, 10.0 * SIGMA[1])
    apart = 0.6 / spread
    memory = remembered(np.array([[0.3], [0.6]]), np.full((2, 1), 0.02))
    beside = 0.3 / np.hypot(0.02, 0.1)
    without, with_it = (
        two_trees(NearestNeighbour(ANYTHING, ANYTHING, attributes), (0.3, 0.6), 0.1)
        for attributes in (NearestNeighbour().attributes, memory)
    )
    alone, both = norm.cdf(0.5 * apart), norm.cdf(0.5 * np.hypot(apart, beside))
    assert expected_share(alone, without)
    assert expected_share(both, with_it)
    assert not expected_share(both, without)
    assert both - alone > 0.2


@pytest.mark.slow
def test_a_vague_landmark_is_not_preferred() -> None:
    """Trees at one place, one of them hardly known: right in half the integral of the larger."""
    memory = remembered(np.array([[0.3], [0.5]]), np.array([[0.01], [0.4]]))
    grid = np.linspace(-4.0, 5.0, 20001)
    densities = [
        norm.pdf(grid, mean, np.hypot(spread, 0.05)) for mean, spread in ((0.3, 0.01), (0.5, 0.4))
    ]
    best = 0.5 * float(np.maximum(*densities).sum() * (grid[1] - grid[0]))
    shares = []
    for attributes in (memory, Broken(memory, unnormalised)):
        rng, right = np.random.default_rng(3), 0
        state = mapped([(10.0, 0.0), (10.0, 0.0)], 1e-4 * np.eye(3))
        rule = NearestNeighbour(ANYTHING, ANYTHING, attributes)
        z = np.array([[10.0, 0.0]])
        for k in range(TRIALS):
            true = (0.3, rng.normal(0.5, 0.4))[k % 2] if k % 2 else rng.normal(0.3, 0.01)
            value = np.array([[rng.normal(true, 0.05)]])
            right += rule.assign(state, MODEL, seen(z, value, 0.05)).tolist() == [k % 2]
        shares.append(right)
    assert expected_share(best, shares[0])
    assert not expected_share(best, shares[1])
    assert shares[1] < shares[0]


@pytest.mark.slow
def test_the_gate_holds_what_it_says() -> None:
    """With a third degree of freedom as many right pairings pass as with two."""
    state = mapped([(10.0, 0.0)], np.diag((0.3**2, 0.3**2, 1e-8)))
    memory = remembered(np.array([[0.4]]), np.array([[0.1]]))
    gate = float(chi2.ppf(0.9, 2))
    rng, passed, misgated = np.random.default_rng(8), 0, 0
    rule = NearestNeighbour(gate, ANYTHING, memory)
    for _ in range(TRIALS):
        pose = rng.multivariate_normal(np.zeros(3), state.pose_covariance)
        z = MODEL.predict(pose, np.array([(10.0, 0.0)])).z + rng.normal(0.0, SIGMA)
        measurement = seen(z, np.array([[rng.normal(0.4, np.hypot(0.1, 0.1))]]), 0.1)
        passed += rule.assign(state, MODEL, measurement).tolist() == [0]
        nis = memory.distances(np.zeros(1, dtype=np.intp), measurement).nis[0, 0]
        misgated += nis + scenes.joint_nis(state, measurement, ((0, 0),)) <= gate
    assert expected_share(0.9, passed)
    assert not expected_share(0.9, misgated)


def test_bounds_of_one_probability() -> None:
    assert same_tail(13.82, np.array([2])).tolist() == [13.82]
    dof = np.array([[2, 3], [4, 2]])
    assert np.allclose(chi2.sf(same_tail(25.0, dof), dof), np.exp(-12.5), rtol=1e-9)
    assert np.isinf(same_tail(1e9, np.array([3]))).all()


@pytest.mark.parametrize("seed", range(8))
def test_joint_compatibility_equals_exhaustive_search(seed: int) -> None:
    """The largest set that passes the gate of its own dof, the least in cost: found by trying all.

    Some measurements and landmarks lack the attribute.
    """
    rng = np.random.default_rng(seed)
    points = np.array([(10.0, 0.5 * k) for k in range(5)])
    state = mapped([tuple(p) for p in points], np.diag((0.3**2, 0.3**2, 0.02**2)))
    diameter = rng.uniform(0.2, 0.8, (5, 1))
    memory = remembered(np.where(rng.random((5, 1)) < 0.2, np.nan, diameter), np.full((5, 1), 0.05))
    which = rng.choice(5, 4, replace=False)
    pose = rng.multivariate_normal(np.zeros(3), state.pose_covariance)
    z = MODEL.predict(pose, points[which]).z + rng.normal(0.0, SIGMA, (4, 2))
    value = np.where(rng.random((4, 1)) < 0.2, np.nan, rng.normal(diameter[which], 0.1))
    measurements = seen(z, value, 0.1)
    beside = memory.distances(np.arange(5), measurements)
    single = [scenes.joint_nis(state, measurements, (p,)) for p in product(range(4), range(5))]
    allowed = np.reshape(single, (4, 5)) + beside.nis <= chi2.ppf(0.999, 2 + beside.dof)
    least = np.where(allowed, beside.n, np.inf).min(axis=1)

    def judge(pairs: scenes.Pairs) -> tuple[float, float, int]:
        position = scenes.joint_nis(state, measurements, pairs)
        more = sum(float(beside.n[i, j] - least[i]) for i, j in pairs)
        dof = 2 * len(pairs) + sum(int(beside.dof[p]) for p in pairs)
        return position + sum(float(beside.nis[p]) for p in pairs), position + more, dof

    rule = JointCompatibility(new_gate=ANYTHING, attributes=memory)
    found = rule.assign(state, MODEL, measurements)
    expected = scenes.best_pairs(allowed, judge)
    assert np.where(found == AMBIGUOUS, -1, found).tolist() == expected


@pytest.mark.parametrize("kind", [NearestNeighbour, JointCompatibility])
def test_nothing_told_changes_nothing(kind: type) -> None:
    """Without columns, or with nothing in them, the assignment is that by position."""
    rng = np.random.default_rng(2)
    points = [(10.0, 0.4 * k) for k in range(6)]
    state = mapped(points, np.diag((0.2**2, 0.2**2, 0.01**2)))
    memory = remembered(np.full((6, 2), 0.4), np.full((6, 2), 0.1))
    for _ in range(20):
        z = MODEL.predict(rng.normal(0.0, 0.1, 3), np.array(points)[:3]).z
        unknown = seen(z, np.full((3, 2), np.nan), 0.1)
        bare = Measurements(z, unknown.noise, unknown.identity)
        assert bare.take(np.array([1, 0])).attributes is NOT_MEASURED
        plain = kind().assign(state, MODEL, bare)
        for measurements in (bare, unknown):
            found = kind(attributes=memory).assign(state, MODEL, measurements)
            assert np.array_equal(found, plain)


def test_only_used_measurements_are_remembered() -> None:
    memory = AttributeEstimates(np.ones(1))
    state = mapped([(10.0, 0.0)], 1e-6 * np.eye(3))
    rule = RememberedAttributes(NearestNeighbour(attributes=memory), memory)
    z = MODEL.predict(np.zeros(3), np.array([(10.0, 0.0), (10.0, 0.25), (10.0, 5.0)])).z
    landmark_indices = rule.assign(state, MODEL, seen(z, np.array([[0.3], [0.4], [0.5]]), 0.1))
    assert landmark_indices.tolist() == [0, AMBIGUOUS, 1]
    assert memory.mean[:, 0].tolist() == pytest.approx([0.3, 0.5], rel=1e-12)
