from collections.abc import Callable

import numpy as np
import pytest

from ekf_reference.association.consensus import ConsensusAssociation
from ekf_reference.association.joint_compatibility import JointCompatibility
from ekf_reference.association.known import KnownAssociation
from ekf_reference.association.nearest_neighbour import EuclideanNeighbour, NearestNeighbour
from ekf_reference.core.ekf import Control, Ekf, Stabilisation
from ekf_reference.core.landmark_types import POINT, POSE, diagonal_noise
from ekf_reference.core.measurements import Association, Measurements
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


RULES = (
    KnownAssociation,
    NearestNeighbour,
    EuclideanNeighbour,
    JointCompatibility,
    ConsensusAssociation,
)


@pytest.mark.parametrize("rule", RULES)
def test_a_step_is_predict_associate_update_augment(rule: Callable[[], Association]) -> None:
    """Also without measurements, before the first landmark and after it."""
    whole, parts = build(), build()
    whole.association, parts.association = rule(), rule()
    control = Control(np.array((1.0, 0.2)), np.diag((0.01, 0.001)), 0.1)
    nothing = Measurements(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0, dtype=np.int64))
    z, r = np.array([[8.0, 0.5], [6.0, -0.4]]), diagonal_noise(np.repeat(SIGMA, 2, axis=0))
    for seen in (nothing, Measurements(z, r, np.array((11, 12))), nothing):
        landmark_indices = whole.step(control, seen)
        assert landmark_indices.tolist() == list(range(len(seen)))
        parts.predict(*control)
        if len(seen):
            parts.observe(z, np.repeat(SIGMA, 2, axis=0), np.array((11, 12)))
    assert np.array_equal(whole.state.mean, parts.state.mean)
    assert np.array_equal(whole.state.covariance, parts.state.covariance)


def test_rules_are_for_points() -> None:
    frame = Measurements(np.zeros((1, 3)), np.eye(3)[None], np.array([7]), kind=POSE)
    with pytest.raises(ValueError, match="measurements of pose landmarks, expected points"):
        build().associate(frame)


def test_the_trace_changes_nothing() -> None:
    """The estimate is bit-identical with and without a trace."""
    traced, plain = build(RecordedTrace()), build()
    drive(traced)
    drive(plain)
    assert np.array_equal(traced.state.mean, plain.state.mean)
    assert np.array_equal(traced.state.covariance, plain.state.covariance)


def test_trace_counts_every_step_and_measurement_once() -> None:
    trace = RecordedTrace()
    drive(build(trace))
    arrays = trace.arrays()
    assert len(arrays.f) == 6
    used, new = arrays.measurements[POINT], arrays.initialisations[POINT]
    order = np.concatenate((used.number, new.number))
    assert sorted(order.tolist()) == list(range(12))
    assert new.step.tolist() == [1, 1]
    assert used.step.tolist() == [s for s in range(2, 7) for _ in range(2)]


def test_second_measurement_of_a_new_landmark_is_fused_too() -> None:
    """In one scan: the first adds the landmark, the second updates it, as two scans would."""
    together, apart = build(), build()
    z = np.array(((8.0, 0.5), (8.2, 0.51)))
    landmark_indices = together.observe(z, np.repeat(SIGMA, 2, axis=0), np.array((3, 3)))
    assert landmark_indices.tolist() == [0, 0]
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
