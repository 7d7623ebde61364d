import numpy as np
import pytest

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import NO_LANDMARKS, Ekf, Stabilisation
from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.measurement_update import Linearised, UpdateSplitter
from ekf_reference.core.state import KalmanState
from ekf_reference.core.trace import RecordedTrace
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.position import PositionFixes, PositionModel
from tests.ekf_reference.numerics import central_difference, random_covariance, relative_error

LEVER = (2.0, -0.7)


def ekf_at(pose: Array, covariance: Array, fixes: PositionFixes) -> Ekf:
    ekf = Ekf(
        UnicycleModel(), KnownAssociation(), pose, covariance, Stabilisation(), RecordedTrace()
    )
    ekf.fixes = fixes
    return ekf


@pytest.mark.parametrize("lever", [(0.0, 0.0), LEVER])
def test_position_jacobian_equals_central_differences(lever: tuple[float, float]) -> None:
    model, pose = PositionModel(lever), np.array((3.0, -4.0, 2.2))
    exact = central_difference(lambda p: model.predict(p)[0], pose)
    assert relative_error(model.predict(pose)[1], exact) < 1e-9


def test_parts_equal_the_single_update_when_linear() -> None:
    """Guivant 2002, section 4.2: sum 1 / K_i = 1 makes L updates one, to rounding."""
    rng = np.random.default_rng(0)
    covariance, noise = 25.0 * random_covariance(rng, 3), random_covariance(rng, 2)
    z = np.array((9.0, -7.0))
    steps = UpdateSplitter(largest_turn_rad=0.02, largest_move_m=0.3)
    single = ekf_at(np.zeros(3), covariance, PositionFixes(gate=1e9, splitter=UpdateSplitter()))
    parts = ekf_at(np.zeros(3), covariance, PositionFixes(gate=1e9, splitter=steps))
    for ekf in (single, parts):
        assert ekf.fix_position(z, noise)
    trace = parts.trace
    assert isinstance(trace, RecordedTrace)
    weights = trace.arrays().positions.weight
    assert len(weights) > 10
    assert np.isclose(weights.sum(), 1.0, rtol=0, atol=1e-15)
    assert relative_error(parts.state.mean, single.state.mean) < 1e-12
    assert relative_error(parts.state.covariance, single.state.covariance) < 1e-12


def of_position(state: KalmanState, z: Array) -> Linearised:
    local = state.map_of(NO_LANDMARKS)
    expected, jacobian = PositionModel().predict(local.pose)
    return Linearised(local, jacobian, z - expected)


def true_minimum(z: Array, r: Array, covariance: Array, model: PositionModel) -> Array:
    """The maximum a posteriori pose, by Gauss-Newton to convergence."""
    pose = np.zeros(3)
    for _ in range(200):
        expected, h = model.predict(pose)
        information = np.linalg.inv(covariance) + h.T @ np.linalg.inv(r) @ h
        gradient = h.T @ np.linalg.inv(r) @ (z - expected) - np.linalg.solve(covariance, pose)
        pose = pose + 0.5 * np.linalg.solve(information, gradient)
    return pose


def test_parts_come_nearer_to_the_optimum_when_nonlinear() -> None:
    """A long lever and an unknown heading: the fix says where the nose is, 50 degrees off."""
    model = PositionModel((20.0, 0.0))
    covariance, noise = np.diag((0.01, 0.01, 1.0)), 0.04 * np.eye(2)
    z = model.predict(np.array((0.0, 0.0, np.deg2rad(50.0))))[0]
    best = true_minimum(z, noise, covariance, model)
    error = {}
    for name, steps in (
        ("single", UpdateSplitter()),
        ("parts", UpdateSplitter(largest_turn_rad=0.05)),
    ):
        ekf = ekf_at(np.zeros(3), covariance, PositionFixes(model, 1e9, steps))
        ekf.fix_position(z, noise)
        error[name] = abs(ekf.state.pose[2] - best[2])
    assert error["parts"] < 0.25 * error["single"]


def test_a_wild_fix_is_rejected_and_changes_nothing() -> None:
    ekf = ekf_at(np.zeros(3), np.diag((0.04, 0.04, 0.001)), PositionFixes())
    before = ekf.state.mean.copy()
    assert not ekf.fix_position(np.array((50.0, 0.0)), 0.25 * np.eye(2))
    assert np.array_equal(ekf.state.mean, before)
    assert ekf.fix_position(np.array((0.5, 0.0)), 0.25 * np.eye(2))
    trace = ekf.trace
    assert isinstance(trace, RecordedTrace)
    assert set(trace.arrays().positions.number.tolist()) == {1}


def test_the_gate_decides_just_inside_and_just_outside() -> None:
    for nis, accepted in ((13.5, True), (14.1, False)):
        ekf = ekf_at(np.zeros(3), np.diag((3.0, 3.0, 1e-6)), PositionFixes())
        z = np.array((np.sqrt(4.0 * nis), 0.0))
        assert ekf.fix_position(z, np.eye(2)) is accepted


def test_a_large_update_at_loop_closing_is_split_too() -> None:
    """Measurements with bounds on the step: parts in the trace, whose weights add up to one."""
    ekf = ekf_at(np.zeros(3), np.diag((0.01, 0.01, 1e-4)), PositionFixes())
    ekf.observe(np.array(((10.0, 0.3),)), np.array(((0.1, 0.01),)), np.array([7]))
    ekf.predict(np.array((1.0, 0.0)), np.diag((4.0, 0.5)), 1.0)
    ekf.splitter = UpdateSplitter(largest_turn_rad=0.01)
    ekf.observe(np.array(((8.0, 0.9),)), np.array(((0.1, 0.01),)), np.array([7]))
    trace = ekf.trace
    assert isinstance(trace, RecordedTrace)
    updates = trace.arrays().measurements[POINT]
    assert len(updates.weight) > 3
    assert set(updates.number.tolist()) == {1}
    assert np.isclose(updates.weight.sum(), 1.0)
    assert np.all(np.abs(np.diff(updates.pose[:, 2])) < 0.015)


class Offset:
    """A linear model of points: where they lie east and north of the vehicle."""

    def predict(self, pose: Array, landmark: Array) -> tuple[Array, Array, Array]:
        m = len(landmark)
        by_pose = np.tile(-np.eye(2, 3), (m, 1, 1))
        return landmark - pose[:2], by_pose, np.tile(np.eye(2), (m, 1, 1))

    def innovation(self, z: Array, expected: Array) -> Array:
        return z - expected


BOUNDS = {
    "turn": UpdateSplitter(largest_turn_rad=0.01),
    "move": UpdateSplitter(largest_move_m=0.1),
    "shrink": UpdateSplitter(largest_shrink=0.3),
}


def at_known_landmarks(splitter: UpdateSplitter) -> Ekf:
    """Two landmarks of known place are measured by a vehicle that is lost by metres."""
    rng = np.random.default_rng(4)
    ekf = ekf_at(np.zeros(3), 9.0 * random_covariance(rng, 3), PositionFixes())
    known = np.array(((5.0, 2.0), (-3.0, 8.0)))
    ekf.insert_surveyed(known, np.tile(1e-4 * np.eye(2), (2, 1, 1)))
    ekf.models[POINT] = Offset()  # type: ignore[assignment]
    ekf.splitter = splitter
    z = known - (2.0, -1.5) + 0.05 * rng.standard_normal((2, 2))
    ekf.observe_known(z, np.tile(0.01 * np.eye(2), (2, 1, 1)), np.arange(2))
    return ekf


@pytest.mark.parametrize("bound", BOUNDS)
def test_known_landmarks_are_fused_in_parts_that_equal_one_update(bound: str) -> None:
    """Guivant 2002, section 4.2: absolute information of landmarks whose position is known."""
    single, parts = at_known_landmarks(UpdateSplitter()), at_known_landmarks(BOUNDS[bound])
    trace = parts.trace
    assert isinstance(trace, RecordedTrace)
    weight = trace.arrays().measurements[POINT].weight
    assert len(weight) >= 4 * 2
    assert np.isclose(weight.sum(), 2.0, rtol=0, atol=1e-12)
    assert trace.arrays().initialisations[POINT].number.tolist() == [-1, -1]  # of no measurement
    assert_equal_states(parts, single)


def assert_equal_states(first: Ekf, second: Ekf) -> None:
    assert relative_error(first.state.mean, second.state.mean) < 1e-10
    sigma = np.sqrt(np.diag(second.state.covariance))
    apart = first.state.covariance - second.state.covariance
    assert np.max(np.abs(apart) / np.outer(sigma, sigma)) < 1e-9


def test_no_part_takes_more_of_a_variance_than_allowed() -> None:
    """Guivant 2002, section 4.2: innovations may be small and updates of the covariance strong."""
    state, noise = KalmanState(np.zeros(3), np.diag((9.0, 4.0, 0.1))), 0.01 * np.eye(2)
    parts = 0
    for weight, at in UpdateSplitter(largest_shrink=0.5).split(
        lambda: of_position(state, np.zeros(2)), noise
    ):
        before = np.diag(state.covariance)[:2].copy()
        state.update(np.arange(3), at.jacobian, at.innovation, noise / weight)
        assert np.all(np.diag(state.covariance)[:2] >= (0.5 - 1e-9) * before)
        parts += 1
    assert 8 <= parts <= 16  # each doubles the information: log2 of 900, and a half more
    exact = np.array((1 / (1 / 9.0 + 100.0), 1 / (1 / 4.0 + 100.0), 0.1))
    assert relative_error(np.diag(state.covariance), exact) < 1e-12


class Careless(UpdateSplitter):
    """Broken: every part but the first counts in full, so that weights do not sum to one."""

    def split(self, linearise, noise):  # type: ignore[no-untyped-def]
        for k, (weight, at) in enumerate(super().split(linearise, noise)):
            yield (weight if k == 0 else 1.0), at


@pytest.mark.parametrize("bound", BOUNDS)
def test_weights_that_do_not_sum_to_one_are_rejected(bound: str) -> None:
    sound = BOUNDS[bound]
    broken = Careless(sound.largest_turn_rad, sound.largest_move_m, sound.largest_shrink)
    single, parts = at_known_landmarks(UpdateSplitter()), at_known_landmarks(broken)
    with pytest.raises(AssertionError):
        assert_equal_states(parts, single)
    assert parts.state.covariance[0, 0] < 0.6 * single.state.covariance[0, 0]
