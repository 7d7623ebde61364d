"""Misono's filter: as published, and as the filter on x, y, heading that it could be."""

from __future__ import annotations

import numpy as np
import pytest
from ekf_reference.filters.direction_cosine import (
    OwnAxesObservation,
    along_circle,
    from_heading,
)

from comparisons.checks.agreement import ROUNDING
from comparisons.experiments.defects.defect import with_state
from comparisons.logs.log import Log
from comparisons.logs.simulate.waypoints import WaypointRun, simulate
from comparisons.pipeline.compare import Comparison, Modified
from ekf_reference.association.nearest_neighbour import KnownAssociation
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.state import Correction, FilterDivergedError, KalmanState
from ekf_reference.core.trace import RecordedTrace
from ekf_reference.filters.misono import DirectionCosineEkf, DirectionCosineOptions
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.range_bearing import NewLandmarks, PredictedMeasurements
from tests.helpers import compared, relative_error, simulated


@pytest.fixture(scope="module")
def log() -> Log:
    return simulated(seed=3, loop_s=60.0)


@pytest.fixture(scope="module")
def published(log: Log) -> Comparison:
    return compared(log, filter="misono")


class OwnAxesOfHeading(OwnAxesObservation):
    """The same sightings for a pose x, y, heading."""

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        own = from_heading(pose)
        z, by_pose, by_landmark = super().predict(own, landmarks)
        return PredictedMeasurements(z, by_pose @ along_circle(own), by_landmark)

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        own = from_heading(pose)
        point, by_pose, by_sighting = super().invert(own, z)
        return NewLandmarks(point, by_pose @ along_circle(own), by_sighting)


def drive(ekf: Ekf, rng: np.random.Generator) -> None:
    """Some steps, sightings and positions."""
    landmarks = rng.uniform(-8.0, 8.0, (6, 2))
    for k in range(60):
        ekf.predict(np.array([1.0, 0.4]), np.diag((0.05, 0.03)), 0.2)
        pose = ekf.read_pose().pose
        offset = landmarks - pose[:2] + rng.normal(0.0, 0.2, (6, 2))
        z = np.column_stack((np.hypot(*offset.T), np.arctan2(offset[:, 1], offset[:, 0]) - pose[2]))
        ekf.observe(z, np.tile((0.2, 0.05), (6, 1)), np.arange(6))
        if k % 10 == 5:
            ekf.fix_position(pose[:2] + rng.normal(0.0, 0.3, 2), 0.09 * np.eye(2))


def on_circle(trace: RecordedTrace | None = None) -> DirectionCosineEkf:
    return DirectionCosineEkf(
        UnicycleModel(),
        KnownAssociation(),
        np.array([1.0, 2.0, 3.0]),
        np.diag((0.1, 0.2, 0.05)),
        trace=trace,
        options=DirectionCosineOptions(full_jacobian=True, renormalise=True),
    )


def test_renormalised_equals_the_filter_on_the_heading() -> None:
    """Mean, covariance and trace, to rounding; headings pass pi unwrapped."""
    traces = RecordedTrace(), RecordedTrace()
    pair = on_circle(traces[0])
    heading = Ekf(
        UnicycleModel(),
        KnownAssociation(),
        np.array([1.0, 2.0, 3.0]),
        np.diag((0.1, 0.2, 0.05)),
        trace=traces[1],
    )
    heading.observation = OwnAxesOfHeading()
    for ekf in (pair, heading):
        drive(ekf, np.random.default_rng(0))
    read = pair.read_pose()
    assert heading.read_pose().pose[2] > 3.0 + np.pi
    assert relative_error(read.pose, heading.state.pose) < 1e-12
    assert relative_error(pair.state.landmarks, heading.state.landmarks) < 1e-12
    lift = np.zeros((15, 16))
    lift[:3, :4], lift[3:, 4:] = read.jacobian, np.eye(12)
    assert relative_error(lift @ pair.state.covariance @ lift.T, heading.state.covariance) < 1e-11
    ours, theirs = (trace.arrays() for trace in traces)
    for records, others in ((ours, theirs), (ours.updates, theirs.updates)):
        for name, column in vars(records).items():
            if isinstance(column, np.ndarray) and column.dtype == float:
                assert relative_error(column, getattr(others, name)) < 1e-10, name


def test_the_pair_stays_on_the_circle() -> None:
    ekf = on_circle()
    drive(ekf, np.random.default_rng(1))
    assert abs(float(np.hypot(*ekf.state.pose[2:])) - 1.0) < 1e-12
    across = np.concatenate((np.zeros(2), ekf.state.pose[2:], np.zeros(12)))
    assert across @ ekf.state.covariance @ across < 1e-15


def test_the_published_pair_leaves_the_circle(published: Comparison) -> None:
    length = np.hypot(*published.ekf.trace.departed[:, 2:].T)
    assert np.abs(length - 1.0).max() > 1e-3


@pytest.mark.parametrize("seed", [0, 1])
def test_the_full_jacobian_has_no_gap(seed: int) -> None:
    comparison = compared(simulated(seed, loop_s=40.0), filter="misono-full")
    assert comparison.agreement.algebra.within(1e-8)
    assert comparison.agreement.model.within(1e-8)
    assert comparison.verdict.outcome == "agree"


def test_the_report_names_the_missing_columns(published: Comparison) -> None:
    """As published: right algebra, and a model whose Jacobian knows no heading."""
    assert published.agreement.algebra.within(ROUNDING)
    assert published.agreement.model.sigma > 0.1
    [cause] = published.verdict.causes
    assert cause.gap == "model"
    assert "the Jacobian by heading is missing in" in cause.evidence
    assert "uses of sightings" in cause.evidence
    assert "the Jacobian by heading" in cause.hint


def test_a_waypoint_run_with_positions_has_no_gap() -> None:
    log = simulate(np.random.default_rng(2), WaypointRun(most_s=60.0))
    for name in ("misono-full", "misono"):
        comparison = compared(log, filter=name, gps="on")
        assert len(comparison.ekf.fix_number) > 3
        assert comparison.agreement.algebra.within(ROUNDING)
        assert comparison.agreement.model.within(ROUNDING) is (name == "misono-full")


class DividedByLength(KalmanState):
    """Renormalised as one would at first: the turn becomes the arctangent of the correction."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        before = self.pose
        done = super().update(columns, jacobian, innovation, noise)
        after = self.pose
        after[2:] /= np.hypot(after[2], after[3])
        self.predict(after, along_circle(after) @ along_circle(before).T, np.zeros((4, 4)))
        return done


class CovarianceLeftBehind(KalmanState):
    """The mean goes back to the circle, the covariance does not."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        done = super().update(columns, jacobian, innovation, noise)
        after = self.pose
        after[2:] /= np.hypot(after[2], after[3])
        self.predict(after, np.eye(4), np.zeros((4, 4)))
        return done


@pytest.mark.parametrize("state", [DividedByLength, CovarianceLeftBehind])
def test_other_ways_back_to_the_circle_are_rejected(log: Log, state: type[KalmanState]) -> None:
    comparison = compared(log, Modified(with_state(state)), filter="misono-full")
    assert not comparison.agreement.algebra.within(ROUNDING)


def test_a_pair_without_length_stops_the_filter() -> None:
    ekf = DirectionCosineEkf(UnicycleModel(), KnownAssociation(), np.zeros(3), 0.01 * np.eye(3))
    seen = np.array([[5.0, 0.1]]), np.array([[0.1, 0.01]]), np.array([0])
    ekf.observe(*seen)
    ekf.state.predict(np.array([0.0, 0.0, 0.05, 0.0]), np.eye(4), np.zeros((4, 4)))
    before = np.array(ekf.state.covariance)
    with pytest.raises(FilterDivergedError, match=r"length 0\.05 in place of 1"):
        ekf.observe(*seen)
    assert np.array_equal(ekf.state.covariance, before)
