"""The compressed filter is the full filter; its suboptimal form is conservative."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.measurements import Association
from ekf_reference.core.state import Correction, KalmanState
from ekf_reference.core.trace import RecordedTrace, TraceArrays
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
    """pose: (K, 3) after every scan. final: pose and landmarks. slot: of every measurement."""

    pose: Array
    final: Gaussian
    slot: Index
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
    used = [(r.number, r.slot) for r in (arrays.measurements[POINT], arrays.initialisations[POINT])]
    slot = np.full(sum(len(scan.z) for scan in drive.scan), -1)
    for sighting, which in used:
        slot[sighting] = which
    return Run(pose, Gaussian(ekf.state.mean.copy(), ekf.state.covariance.copy()), slot, arrays)


def full() -> KalmanState:
    return KalmanState(PRIOR_POSE, PRIOR_COVARIANCE)


def compressed(
    areas: LocalAreas = SMALL, kind: Callable[..., CompressedState] = CompressedState
) -> CompressedState:
    return kind(PRIOR_POSE, PRIOR_COVARIANCE, areas)


def assert_equal(first: Run, second: Run) -> None:
    """Means to 1e-9 of their size and covariances to 1e-9 of theirs, entry by entry in sigmas."""
    assert np.array_equal(first.slot, second.slot)
    p, q = first.final.covariance, second.final.covariance
    sigma = np.sqrt(np.diag(q))
    assert np.max(np.abs(p - q) / np.outer(sigma, sigma)) < 1e-9
    assert relative_error(first.final.mean, second.final.mean) < 1e-9
    assert relative_error(first.pose, second.pose) < 1e-9


@pytest.mark.parametrize("association", [None, NearestNeighbour()], ids=["known", "nn"])
def test_equals_the_full_filter_in_simulation(association: Association | None) -> None:
    drive = circuit(seed=1, duration_s=2 * LOOP_S)
    found = run(drive, compressed(), association)
    assert (found.slot >= 0).mean() > 0.9
    assert_equal(found, run(drive, full(), association))


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

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        done = super().update(columns, jacobian, innovation, noise)
        self._theta[:] = 0.0
        return done


class NoPsi(CompressedState):
    """Broken: the passive covariance's correction is forgotten."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        done = super().update(columns, jacobian, innovation, noise)
        self._psi[:] = 0.0
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
