"""The compressed filter is the full filter; its suboptimal form is conservative."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core import machine
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT, NewLandmarks
from ekf_reference.core.machine import STRIP
from ekf_reference.core.measurements import Association
from ekf_reference.core.state import Correction, KalmanState, subtract
from ekf_reference.core.trace import RecordedTrace, RemovalRecord, StepRecord, TraceArrays
from ekf_reference.filters.compressed import CompressedState, LocalAreas
from tests.ekf_reference.numerics import relative_error
from tests.ekf_reference.replay import Gaussian, eigenvalue_range, replay
from tests.ekf_reference.worlds import (
    LOOP_S,
    PRIOR_COVARIANCE,
    PRIOR_POSE,
    Circuit,
    build,
    circuit,
    follow,
)

SMALL = LocalAreas(half_m=8.0, reach_m=12.0)


class Run(NamedTuple):
    """pose: (K, 3) after every scan. final: pose, landmarks. landmark_index: of measurements."""

    pose: Array
    final: Gaussian
    landmark_index: Index
    trace: TraceArrays


def run(
    drive: Circuit, state: KalmanState | CompressedState, association: Association | None = None
) -> Run:
    """Follow a drive with a filter that has this state."""
    trace = RecordedTrace()
    ekf = build(trace=trace, association=association)
    ekf.state = state
    pose = np.array([ekf.state.pose for _, ekf in follow(drive, ekf)])
    arrays = trace.arrays()
    used = [
        (r.number, r.landmark_index)
        for r in (arrays.measurements[POINT], arrays.initialisations[POINT])
    ]
    landmark_index = np.full(sum(len(scan.z) for scan in drive.scan), -1)
    for measurement, which in used:
        landmark_index[measurement] = which
    return Run(
        pose, Gaussian(ekf.state.mean.copy(), ekf.state.covariance.copy()), landmark_index, arrays
    )


def full() -> KalmanState:
    return KalmanState(PRIOR_POSE, PRIOR_COVARIANCE)


def compressed(
    areas: LocalAreas = SMALL, kind: Callable[..., CompressedState] = CompressedState
) -> CompressedState:
    return kind(PRIOR_POSE, PRIOR_COVARIANCE, areas)


def assert_equal(first: Run, second: Run) -> None:
    """Means to 1e-9 of their size and covariances to 1e-9 of theirs, entry by entry in sigmas."""
    assert np.array_equal(first.landmark_index, second.landmark_index)
    p, q = first.final.covariance, second.final.covariance
    sigma = np.sqrt(np.diag(q))
    assert np.max(np.abs(p - q) / np.outer(sigma, sigma)) < 1e-9
    assert relative_error(first.final.mean, second.final.mean) < 1e-9
    assert relative_error(first.pose, second.pose) < 1e-9


@pytest.mark.parametrize("association", [None, NearestNeighbour()], ids=["known", "nn"])
def test_equals_the_full_filter_in_simulation(association: Association | None) -> None:
    drive = circuit(seed=1, duration_s=2 * LOOP_S)
    found = run(drive, compressed(), association)
    assert (found.landmark_index >= 0).mean() > 0.9
    assert_equal(found, run(drive, full(), association))


@pytest.mark.parametrize("limit", ["WHOLE", "FOLDED"])
def test_what_long_logs_need_equals_the_full_filter(
    limit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Global updates in strips, and rows of psi folded at every update."""
    monkeypatch.setattr(machine, limit, 0)
    drive = circuit(seed=1)
    assert_equal(run(drive, compressed()), run(drive, full()))


def test_records_stacked_in_parts_are_those_stacked_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drive = circuit(seed=1, duration_s=20.0)
    whole = run(drive, full()).trace
    monkeypatch.setattr(machine, "STACKED", 7)
    parts = run(drive, full()).trace
    assert len(whole.departed) > 70
    for name in ("departed", "arrived", "f", "q"):
        assert np.array_equal(getattr(whole, name), getattr(parts, name)), name
    for name in ("measurements", "initialisations"):
        one, other = (vars(getattr(trace, name)[POINT]) for trace in (whole, parts))
        assert len(one["landmark_index"]) > 14
        for field, value in one.items():
            assert np.array_equal(value, other[field]), f"{name}: {field}"


def test_areas_are_left_and_landmarks_added_inside() -> None:
    state = compressed()
    run(circuit(seed=1), state)
    assert len(state.updates) > 10
    assert max(u.passive for u in state.updates) > 80
    assert max(u.active for u in state.updates) < 60
    assert all(u.spared == 0 for u in state.updates)


def test_reading_the_state_midway_changes_nothing() -> None:
    drive = circuit(seed=2, duration_s=40.0)

    class Watched(CompressedState):
        def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
            super().predict(pose, jacobian_pose, noise)
            assert np.all(np.isfinite(self.mean))
            assert np.array_equal(self.mean[:3], self.pose)

    assert_equal(run(drive, compressed(kind=Watched)), run(drive, compressed()))


class NoTheta(CompressedState):
    """Broken: the passive means' correction is forgotten."""

    def _psi_root(self) -> Array:
        root = super()._psi_root()
        root[:, -1] = 0.0
        return root


class NoPsi(CompressedState):
    """Broken: the passive covariance's correction is forgotten."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        done = super().update(columns, jacobian, innovation, noise)
        self._learnt.clear()
        return done


class OldPhi(CompressedState):
    """Broken: phi follows predictions only."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        kept = self._phi.copy()
        done = super().update(columns, jacobian, innovation, noise)
        self._phi = kept
        return done


@pytest.mark.parametrize("broken", [NoPsi, OldPhi, NoTheta])
def test_the_equality_rejects_a_broken_recursion(broken: type[CompressedState]) -> None:
    """Forgetting psi, theta, or the update of phi is seen."""
    drive = circuit(seed=1)
    with pytest.raises(AssertionError):
        assert_equal(run(drive, compressed(kind=broken)), run(drive, full()))


def optimism(found: Run) -> float:
    """How far the covariance is below the exact solution's in some direction, as a share of it."""
    return 1.0 - eigenvalue_range(found.final.covariance, replay(found.trace).covariance)[0]


class SquaredPsi(CompressedState):
    """Broken: psi itself is kept, in place of its square root."""

    def _psi_root(self) -> Array:
        root = super()._psi_root()
        values, vectors = np.linalg.eigh(root[:, :-1].T @ root[:, :-1])
        learnt = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        shift = np.linalg.lstsq(learnt.T, root[:, :-1].T @ root[:, -1])[0]
        return np.column_stack((learnt, shift))


@pytest.mark.parametrize(("kind", "holds"), [(CompressedState, True), (SquaredPsi, False)])
def test_a_large_common_uncertainty_costs_no_digits(
    kind: type[CompressedState], holds: bool
) -> None:
    """All landmarks may be 100 m away together, and are known to centimetres to each other."""
    drive, wide = circuit(seed=1), PRIOR_COVARIANCE + np.diag((1e4, 1e4, 0.0))
    exact, found = (
        run(drive, state).final.covariance
        for state in (KalmanState(PRIOR_POSE, wide), kind(PRIOR_POSE, wide, SMALL))
    )
    lacking = np.abs(np.array(eigenvalue_range(found, exact)) - 1.0).max()
    assert (lacking < 1e-6) == holds, lacking


def test_removals_know_the_steps_before_them_once_these_are_stacked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(machine, "STACKED", 2)
    trace = RecordedTrace()
    for number in range(5):
        trace.step(StepRecord(np.zeros(3), np.zeros(3), np.eye(3), np.eye(3)))
        trace.removal(RemovalRecord(np.array([number]), POINT, np.arange(2)))
    assert trace.arrays().removals.step.tolist() == [1, 2, 3, 4, 5]


@pytest.mark.slow
@pytest.mark.parametrize("c1", [1e-4, 1e-2])
def test_suboptimal_update_is_conservative_and_nearly_free(c1: float) -> None:
    """P* - P is positive semidefinite (Guivant 2002, eq. 23), and small for the paper's c1.

    P is that of the same linear equations solved exactly, from the filter's own trace. What the
    exact compressed filter lacks of it is rounding.
    """
    drive, state = circuit(seed=3, duration_s=2 * LOOP_S), compressed(LocalAreas(8.0, 12.0, c1))
    spared, rounding = run(drive, state), optimism(run(drive, compressed()))
    exact = replay(spared.trace)
    assert sum(u.spared for u in state.updates) > 0
    assert max(u.saved for u in state.updates) > 0.1
    assert rounding < 1e-6
    assert optimism(spared) < 2.0 * rounding
    # It is an approximation indeed.
    assert eigenvalue_range(spared.final.covariance, exact.covariance)[1] > 1.0 + 1e-6
    if c1 == 1e-4:
        sigma = np.sqrt(np.diag(exact.covariance))
        assert np.max(np.diag(spared.final.covariance) / sigma**2) < 1.01
        assert farthest(spared.final, exact) < 0.05


def farthest(estimate: Gaussian, exact: Gaussian) -> float:
    """The largest difference of means in standard deviations."""
    sigma = np.sqrt(np.diag(exact.covariance))
    return float(np.max(np.abs(estimate.mean - exact.mean) / sigma))


def test_a_mean_that_is_forgotten_is_no_conservatism() -> None:
    """The suboptimal filter may spare covariance, not the correction of the mean (theta)."""
    drive, areas = circuit(seed=3, duration_s=2 * LOOP_S), LocalAreas(8.0, 12.0, 1e-4)
    broken = run(drive, compressed(areas, NoTheta))
    assert farthest(broken.final, replay(broken.trace)) > 0.5


class CrossSpared(CompressedState):
    """Broken: the spared entries' covariance with the changed ones is left alone, too."""

    def merge(
        self,
        columns: Index,
        local: KalmanState,
        transition: Array,
        root: Array,
        shift: Array,
        spared: Index,
    ) -> None:
        n = self._layout.size
        before = self._covariance[:n, :n].copy()
        super().merge(columns, local, transition, root, shift, spared)
        changed = np.setdiff1d(np.setdiff1d(np.arange(n), spared), columns)
        block = before[np.ix_(spared, changed)]
        self._covariance[np.ix_(spared, changed)] = block
        self._covariance[np.ix_(changed, spared)] = block.T


def test_sparing_the_cross_covariance_too_is_not_conservative() -> None:
    """Guivant 2002: P12 and P21 have to be updated; the eigenvalues tell when they are not."""
    state = CrossSpared(PRIOR_POSE, PRIOR_COVARIANCE, LocalAreas(8.0, 12.0, 1e-4))
    assert optimism(run(circuit(seed=3, duration_s=2 * LOOP_S), state)) > 1e-4


def without(changed: Index, covariance: Array, root: Array) -> Array:
    """P - Delta P* of eq. 23 in one product: the rows and columns `changed` only."""
    delta, expected = root @ root.T, covariance.copy()
    expected[changed] -= delta[changed]
    expected[:, changed] = expected[changed].T
    return expected


def assert_only_changed(
    change: Callable[[Array, Array, Index, Index], None], share: float, seed: int
) -> None:
    """On more states than some strips hold, spared ones scattered: equal to one product."""
    rng, n = np.random.default_rng(seed), 3 * STRIP + 41
    root = rng.standard_normal((n, 20))
    covariance = np.asarray(root @ root.T) + np.eye(n)
    spared = np.flatnonzero(rng.random(n) < share)
    changed = np.setdiff1d(np.arange(n), spared)
    p = np.zeros((n + 7, n + 7))
    p[:n, :n] = covariance
    change(p, 0.5 * root, changed, spared)
    expected = without(changed, covariance, 0.5 * root)
    assert np.max(np.abs(p[:n, :n] - expected)) < 1e-12 * np.abs(covariance).max()
    assert np.array_equal(p[np.ix_(spared, spared)], covariance[np.ix_(spared, spared)])
    assert np.all(p[n:] == 0.0)


@pytest.mark.parametrize("share", [0.01, 0.5, 0.95])
def test_strips_change_what_is_not_spared(share: float) -> None:
    for seed in range(3):
        assert_only_changed(subtract, share, seed)


def no_left(p: Array, root: Array, changed: Index, spared: Index) -> None:
    """Broken: a strip goes rightward only, so that spared entries to its left keep P12."""
    after = p.copy()
    subtract(after, root, changed, spared)
    for first in range(0, len(changed), STRIP):
        rows = changed[first : first + STRIP]
        before = spared[spared < rows[0]]
        after[np.ix_(rows, before)] = p[np.ix_(rows, before)]
    p[:] = after


def twice(p: Array, root: Array, changed: Index, spared: Index) -> None:
    """Broken: a strip changes all of its rows, the pairs with earlier strips a second time."""
    n = len(root)
    for first in range(0, len(changed), STRIP):
        rows = changed[first : first + STRIP]
        p[rows, :n] -= root[rows] @ root.T
        p[:n, rows] = p[rows, :n].T


@pytest.mark.parametrize("broken", [no_left, twice])
def test_broken_strips_are_seen(broken: Callable[[Array, Array, Index, Index], None]) -> None:
    with pytest.raises(AssertionError):
        assert_only_changed(broken, 0.5, 0)


def passive_map(landmarks: int, c1: float) -> CompressedState:
    """Far landmarks correlated through the vehicle, and an area that learnt of 10 near ones."""
    rng = np.random.default_rng(1)
    state = CompressedState(PRIOR_POSE, np.eye(3), LocalAreas(8.0, 12.0, c1))
    for place, count in ((0.0, 10), (1000.0, landmarks)):
        point = place + rng.uniform(-5.0, 5.0, (count, 2))
        by_pose = np.tile(np.eye(2, 3), (count, 1, 1))
        weak = rng.uniform(0.1, 40.0, (count, 1, 1)) * np.eye(2)
        state.augment(NewLandmarks(point, by_pose, np.tile(np.eye(2), (count, 1, 1))), weak)
    state.leave()
    columns = state.layout.columns(np.arange(10))
    h = rng.standard_normal((6, len(columns)))
    state.update(columns, h, 0.1 * rng.standard_normal(6), 0.01 * np.eye(6))
    return state


def test_where_little_is_spared_the_update_is_the_exact_one() -> None:
    """Of the two ways the cheaper: exact to the bit where few states gain less than c1."""
    exact = passive_map(150, 0.0)
    before = exact.part(np.arange(323)).covariance.diagonal()[23:]  # as the last update left them
    gained = 1.0 - exact.covariance.diagonal()[23:] / before
    for share, count in ((0.3, 0), (0.8, 240)):
        state = passive_map(150, float(np.quantile(gained, share)))
        assert np.array_equal(state.mean, exact.mean)
        assert state.updates[-1].spared == count
        assert np.array_equal(state.covariance, exact.covariance) == (count == 0)
