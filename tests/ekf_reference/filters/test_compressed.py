"""The compressed filter is the full filter; its suboptimal form is conservative."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.smoother_input import recorded_system_of, solve_recorded
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.agreement import eigenvalue_range
from comparisons.config import EkfConfig
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.pipeline.compare import Modified
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.state import Correction, KalmanState
from ekf_reference.core.trace import NullTrace
from ekf_reference.filters.compressed import CompressedEkf, CompressedState, LocalAreas
from tests.helpers import compared, relative_error, simulated

SMALL = LocalAreas(half_m=8.0, reach_m=12.0)


def run(log: Log, areas: LocalAreas | None, association: str | None = None) -> EkfRun:
    """The full filter for None, else the compressed one with these areas."""
    choices = settle(EkfConfig(filter="full", association=association), log)
    if areas is None:
        return run_ekf(log, build_timeline(log), choices)

    def compress(ekf: Ekf) -> None:
        ekf.state = CompressedState(log.prior.pose, log.prior.covariance, areas)

    return run_ekf(log, build_timeline(log), choices, setup=FilterSetup(modify=[compress]))


def assert_equal(first: EkfRun, second: EkfRun) -> None:
    """Means to 1e-9 of their size and covariances to 1e-9 of theirs, entry by entry in sigmas."""
    assert np.array_equal(first.slot, second.slot)
    p, q = first.estimate.joint_covariance, second.estimate.joint_covariance
    sigma = np.sqrt(np.diag(q))
    assert np.max(np.abs(p - q) / np.outer(sigma, sigma)) < 1e-9
    assert relative_error(first.estimate.joint_mean, second.estimate.joint_mean) < 1e-9
    assert relative_error(first.estimate.pose, second.estimate.pose) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("association", ["known", "nn"])
def test_equals_the_full_filter_in_simulation(association: str) -> None:
    log = simulated(seed=1, loops=2)
    compressed = run(log, SMALL, association)
    assert_equal(compressed, run(log, None, association))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["acfr_car_park", "mrclam/MRCLAM_Dataset6"])
def test_equals_the_full_filter_on_real_logs(name: str, shared_data: Path) -> None:
    log = open_log(str(shared_data / name))
    assert_equal(run(log, LocalAreas(2.0, 4.0)), run(log, None))


@pytest.mark.slow
def test_equals_the_full_filter_on_victoria_park() -> None:
    log = open_log("victoria-park")
    assert_equal(run(log, SMALL), run(log, None))


def test_areas_are_left_and_landmarks_added_inside() -> None:
    log = simulated(seed=1)
    ekf = build_ekf(log, EkfConfig(filter="compressed", association="known"), NullTrace())
    assert isinstance(ekf, CompressedEkf)
    assert isinstance(ekf.state, CompressedState)
    states: list[CompressedState] = []

    def compress(filter_: Ekf) -> None:
        states.append(CompressedState(log.prior.pose, log.prior.covariance, SMALL))
        filter_.state = states[0]

    run_ekf(
        log,
        build_timeline(log),
        EkfConfig(filter="full", association="known"),
        setup=FilterSetup(modify=[compress]),
    )
    updates = states[0].updates
    assert len(updates) > 10
    assert max(u.passive for u in updates) > 80
    assert max(u.active for u in updates) < 60
    assert all(u.spared == 0 for u in updates)


def test_reading_the_state_midway_changes_nothing() -> None:
    log = simulated(seed=2, loop_s=40.0)
    quiet = run(log, SMALL, "known")

    def watched(ekf: Ekf) -> None:
        class Watched(CompressedState):
            def predict(
                self, pose: np.ndarray, jacobian_pose: np.ndarray, noise: np.ndarray
            ) -> None:
                super().predict(pose, jacobian_pose, noise)
                assert np.all(np.isfinite(self.mean))
                assert np.array_equal(self.mean[:3], self.pose)

        ekf.state = Watched(log.prior.pose, log.prior.covariance, SMALL)

    read = run_ekf(
        log,
        build_timeline(log),
        EkfConfig(filter="full", association="known"),
        setup=FilterSetup(modify=[watched]),
    )
    assert_equal(read, quiet)


@pytest.mark.parametrize("defect", ["psi", "phi", "theta"])
def test_the_equality_rejects_a_broken_recursion(defect: str) -> None:
    """Forgetting psi, theta, or the update of phi is seen."""
    log = simulated(seed=1)

    class Broken(CompressedState):
        def update(
            self, columns: Index, jacobian: Array, innovation: Array, noise: Array
        ) -> Correction:
            kept = self._phi.copy()
            done = super().update(columns, jacobian, innovation, noise)
            if defect == "psi":
                self._psi[:] = 0.0
            elif defect == "theta":
                self._theta[:] = 0.0
            else:
                self._phi = kept
            return done

    def plant(ekf: Ekf) -> None:
        ekf.state = Broken(log.prior.pose, log.prior.covariance, SMALL)

    broken = run_ekf(
        log,
        build_timeline(log),
        EkfConfig(filter="full", association="known"),
        setup=FilterSetup(modify=[plant]),
    )
    with pytest.raises(AssertionError):
        assert_equal(broken, run(log, None, "known"))


@pytest.mark.parametrize("c1", [1e-4, 1e-2])
def test_suboptimal_update_is_conservative_and_nearly_free(c1: float) -> None:
    """P* - P is positive semidefinite (Guivant 2002, eq. 23), and small for the paper's c1.

    P is that of the same linear equations solved exactly, from the filter's own trace.
    """
    log = simulated(seed=3, loops=2)
    states: list[CompressedState] = []

    def plant(ekf: Ekf) -> None:
        areas = LocalAreas(8.0, 12.0, c1)
        states.append(CompressedState(log.prior.pose, log.prior.covariance, areas))
        ekf.state = states[0]

    spared = run_ekf(
        log,
        build_timeline(log),
        EkfConfig(filter="full", association="known"),
        setup=FilterSetup(modify=[plant]),
    )
    exact = solve_recorded(recorded_system_of(spared), spared)
    low, high = eigenvalue_range(spared.estimate.joint_covariance, exact.covariance)
    assert sum(u.spared for u in states[0].updates) > 0
    assert max(u.saved for u in states[0].updates) > 0.1
    assert low > 1.0 - 1e-8
    assert high > 1.0 + 1e-6  # it is an approximation indeed
    if c1 == 1e-4:
        sigma = np.sqrt(np.diag(exact.covariance))
        assert np.max(np.diag(spared.estimate.joint_covariance) / sigma**2) < 1.01
        assert np.max(np.abs(spared.estimate.joint_mean - exact.mean) / sigma) < 0.05


class CrossSpared(KalmanState):
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
        n = self._size
        before = self._covariance[:n, :n].copy()
        super().merge(columns, local, transition, root, shift, spared)
        changed = np.setdiff1d(np.setdiff1d(np.arange(n), spared), columns)
        block = before[np.ix_(spared, changed)]
        self._covariance[np.ix_(spared, changed)] = block
        self._covariance[np.ix_(changed, spared)] = block.T


def test_sparing_the_cross_covariance_too_is_not_conservative() -> None:
    """Guivant 2002: P12 and P21 have to be updated; the eigenvalues tell when they are not."""
    log = simulated(seed=3, loops=2)

    def plant(ekf: Ekf) -> None:
        state = CompressedState(log.prior.pose, log.prior.covariance, LocalAreas(8.0, 12.0, 1e-2))
        state._whole = CrossSpared(log.prior.pose, np.array(log.prior.covariance))
        ekf.state = state

    run_ = run_ekf(
        log,
        build_timeline(log),
        EkfConfig(filter="full", association="known"),
        setup=FilterSetup(modify=[plant]),
    )
    exact = solve_recorded(recorded_system_of(run_), run_)
    assert eigenvalue_range(run_.estimate.joint_covariance, exact.covariance)[0] < 1.0 - 1e-4


@pytest.mark.slow
def test_a_mean_that_is_forgotten_is_no_conservatism() -> None:
    """The suboptimal filter may spare covariance, not the correction of the mean (theta)."""

    class NoTheta(CompressedState):
        def update(
            self, columns: Index, jacobian: Array, innovation: Array, noise: Array
        ) -> Correction:
            done = super().update(columns, jacobian, innovation, noise)
            self._theta[:] = 0.0
            return done

    log = simulated(seed=3, loops=2)

    def plant(ekf: Ekf) -> None:
        ekf.state = NoTheta(log.prior.pose, log.prior.covariance, LocalAreas(8.0, 12.0, 1e-4))

    choices = EkfConfig(filter="compressed-suboptimal", association="known")
    assert compared(log, ekf=choices).verdict.outcome == "agree"
    broken = compared(log, Modified(plant), ekf=choices)
    assert [cause.gap for cause in broken.verdict.causes] == ["algebra"]
