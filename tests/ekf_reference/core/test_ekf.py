from __future__ import annotations

import numpy as np

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf, Stabilisation
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.trace import RecordedTrace, Trace
from ekf_reference.models.motion import UnicycleModel

SIGMA = np.array([[0.1, 0.01]])


def build(trace: Trace | None = None) -> Ekf:
    return Ekf(
        UnicycleModel(),
        KnownAssociation(),
        np.array((1.0, 2.0, 0.3)),
        np.diag((0.01, 0.01, 0.001)),
        Stabilisation(1e-6, 1e-8),
        trace,
    )


def drive(ekf: Ekf) -> None:
    for k in range(6):
        ekf.predict(np.array((1.0, 0.2)), np.diag((0.01, 0.001)), 0.1)
        z = np.array(((8.0 + 0.1 * k, 0.5), (6.0, -0.4 - 0.02 * k)))
        ekf.observe(z, np.repeat(SIGMA, 2, axis=0), np.array((11, 12)))


def test_the_trace_changes_nothing() -> None:
    """The estimate is bit-identical with and without a trace."""
    traced, plain = build(RecordedTrace()), build()
    drive(traced)
    drive(plain)
    assert np.array_equal(traced.state.mean, plain.state.mean)
    assert np.array_equal(traced.state.covariance, plain.state.covariance)


def test_trace_counts_every_step_and_sighting_once() -> None:
    trace = RecordedTrace()
    drive(build(trace))
    arrays = trace.arrays()
    assert len(arrays.f) == 6
    used, new = arrays.measurements[POINT], arrays.initialisations[POINT]
    order = np.concatenate((used.number, new.number))
    assert sorted(order.tolist()) == list(range(12))
    assert new.step.tolist() == [1, 1]
    assert used.step.tolist() == [s for s in range(2, 7) for _ in range(2)]


def test_second_sighting_of_a_new_landmark_is_fused_too() -> None:
    """In one scan: the first adds the landmark, the second updates it, as two scans would."""
    together, apart = build(), build()
    z = np.array(((8.0, 0.5), (8.2, 0.51)))
    slots = together.observe(z, np.repeat(SIGMA, 2, axis=0), np.array((3, 3)))
    assert slots.tolist() == [0, 0]
    for i in range(2):
        apart.observe(z[i : i + 1], SIGMA, np.array([3]))
    assert np.array_equal(together.state.mean, apart.state.mean)
    assert np.array_equal(together.state.covariance, apart.state.covariance)


def test_stacked_update_equals_one_by_one_when_linear_enough() -> None:
    """With tiny noise in the state both orders linearise at one point."""

    def fresh() -> Ekf:
        ekf = Ekf(
            UnicycleModel(), KnownAssociation(), np.zeros(3), 1e-10 * np.eye(3), Stabilisation()
        )
        z = np.array(((8.0, 0.5), (6.0, -0.4)))
        ekf.observe(z, 1e-6 * np.ones((2, 2)), np.array((1, 2)))
        return ekf

    z = np.array(((8.0, 0.5), (6.0, -0.4))) + 1e-6
    stacked, single = fresh(), fresh()
    stacked.observe(z, 1e-6 * np.ones((2, 2)), np.array((1, 2)))
    for i in range(2):
        single.observe(z[i : i + 1], 1e-6 * np.ones((1, 2)), np.array([1 + i]))
    sigma = np.sqrt(np.diag(stacked.state.covariance))
    assert np.max(np.abs(stacked.state.mean - single.state.mean) / sigma) < 1e-4
