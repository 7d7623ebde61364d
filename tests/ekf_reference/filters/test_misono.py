"""Misono's filter: as published, and as the filter on x, y, heading that it could be."""

import numpy as np
import pytest

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.chart import Chart
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT, NewLandmarks, PredictedMeasurements
from ekf_reference.core.measurements import Measurements
from ekf_reference.core.state import FilterDivergedError, KalmanState
from ekf_reference.core.trace import RecordedTrace, RemovalRecord
from ekf_reference.filters.misono import (
    DirectionCosineEkf,
    DirectionCosineOptions,
    OwnAxesObservation,
    UnitCircle,
    along_circle,
    from_heading,
)
from ekf_reference.models.motion import UnicycleModel
from tests.ekf_reference.numerics import relative_error
from tests.ekf_reference.worlds import build, circuit, follow


class OwnAxesOfHeading(OwnAxesObservation):
    """The same measurements for a pose x, y, heading."""

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        own = from_heading(pose)
        z, by_pose, by_landmark = super().predict(own, landmarks)
        return PredictedMeasurements(z, by_pose @ along_circle(own), by_landmark)

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        own = from_heading(pose)
        point, by_pose, by_measurement = super().invert(own, z)
        return NewLandmarks(point, by_pose @ along_circle(own), by_measurement)


def drive(ekf: Ekf, rng: np.random.Generator) -> None:
    """Some steps, measurements and positions."""
    landmarks = rng.uniform(-8.0, 8.0, (6, 2))
    for k in range(60):
        ekf.predict(np.array([1.0, 0.4]), np.diag((0.05, 0.03)), 0.2)
        pose = ekf.read_pose().pose
        offset = landmarks - pose[:2] + rng.normal(0.0, 0.2, (6, 2))
        z = np.column_stack((np.hypot(*offset.T), np.arctan2(offset[:, 1], offset[:, 0]) - pose[2]))
        ekf.observe(z, np.tile((0.2, 0.05), (6, 1)), np.arange(6))
        if k % 10 == 5:
            ekf.fix_position(pose[:2] + rng.normal(0.0, 0.3, 2), 0.09 * np.eye(2))


def start() -> tuple[UnicycleModel, KnownAssociation, Array, Array]:
    """What all filters here begin with."""
    pose, covariance = np.array([1.0, 2.0, 3.0]), np.diag((0.1, 0.2, 0.05))
    return UnicycleModel(), KnownAssociation(), pose, covariance


def on_circle(trace: RecordedTrace | None = None) -> DirectionCosineEkf:
    complete = DirectionCosineOptions(full_jacobian=True, renormalise=True, stacked=True)
    return DirectionCosineEkf(*start(), trace=trace, options=complete)


def on_heading(trace: RecordedTrace | None = None) -> Ekf:
    ekf = Ekf(*start(), trace=trace)
    ekf.models[POINT] = OwnAxesOfHeading()
    return ekf


def distance(pair: DirectionCosineEkf, heading: Ekf) -> tuple[float, float]:
    """Relative errors of the mean and of the covariance, the pair read as x, y, heading."""
    read = pair.read_pose()
    lift = np.zeros((15, 16))
    lift[:3, :4], lift[3:, 4:] = read.jacobian, np.eye(12)
    return (
        max(
            relative_error(read.pose, heading.state.pose),
            relative_error(pair.state.landmarks, heading.state.landmarks),
        ),
        relative_error(lift @ pair.state.covariance @ lift.T, heading.state.covariance),
    )


def test_renormalised_equals_the_filter_on_the_heading() -> None:
    """Mean, covariance and trace, to rounding; headings pass pi unwrapped."""
    traces = RecordedTrace(), RecordedTrace()
    pair, heading = on_circle(traces[0]), on_heading(traces[1])
    for ekf in (pair, heading):
        drive(ekf, np.random.default_rng(0))
    assert heading.read_pose().pose[2] > 3.0 + np.pi
    of_mean, of_covariance = distance(pair, heading)
    assert of_mean < 1e-12
    assert of_covariance < 1e-11
    ours, theirs = (trace.arrays() for trace in traces)
    for records, others in ((ours, theirs), (ours.measurements[POINT], theirs.measurements[POINT])):
        for name, column in vars(records).items():
            if isinstance(column, np.ndarray) and column.dtype == float:
                assert relative_error(column, getattr(others, name)) < 1e-10, name


class Removed(RecordedTrace):
    """Which entries of the state were removed last."""

    entries: Index

    def removal(self, gone: RemovalRecord) -> None:
        self.entries = gone.entries


def test_entries_removed_are_those_of_a_state_with_a_heading() -> None:
    traces = Removed(), Removed()
    for ekf in (on_circle(traces[0]), on_heading(traces[1])):
        drive(ekf, np.random.default_rng(0))
        ekf.remove(np.array([1, 4]))
    assert traces[0].entries.tolist() == traces[1].entries.tolist() == [5, 6, 11, 12]


def test_the_pair_stays_on_the_circle() -> None:
    ekf = on_circle()
    drive(ekf, np.random.default_rng(1))
    assert abs(float(np.hypot(*ekf.state.pose[2:])) - 1.0) < 1e-12
    across = np.concatenate((np.zeros(2), ekf.state.pose[2:], np.zeros(12)))
    assert across @ ekf.state.covariance @ across < 1e-15


def test_the_published_pair_leaves_the_circle() -> None:
    length = [
        float(np.hypot(*ekf.state.pose[2:]))
        for _, ekf in follow(circuit(seed=3, duration_s=60.0), build(DirectionCosineEkf))
    ]
    assert np.abs(np.array(length) - 1.0).max() > 1e-3


class DividedByLength(UnitCircle):
    """Renormalised as one would at first: the turn becomes the arctangent of the correction."""

    def plus(self, pose: Array, step: Array) -> Array:
        after = pose + step
        after[2:] /= np.hypot(after[2], after[3])
        return after


class CovarianceLeftBehind(DividedByLength):
    """The mean goes back to the circle, the covariance does not."""

    def reset(self, pose: Array, step: Array) -> Array:
        return np.eye(4)


@pytest.mark.parametrize("chart", [DividedByLength(), CovarianceLeftBehind()])
def test_other_ways_back_to_the_circle_are_rejected(chart: Chart) -> None:
    """They differ from the filter on the heading."""
    other, heading = on_circle(), on_heading()
    other.state = KalmanState(other.state.pose, np.array(other.state.covariance), chart)
    for ekf in (other, heading):
        drive(ekf, np.random.default_rng(0))
    assert max(distance(other, heading)) > 1e-6


def test_a_pair_without_length_stops_the_filter() -> None:
    ekf = DirectionCosineEkf(UnicycleModel(), KnownAssociation(), np.zeros(3), 0.01 * np.eye(3))
    seen = np.array([[5.0, 0.1]]), np.array([[0.1, 0.01]]), np.array([0])
    ekf.observe(*seen)
    ekf.state.predict(np.array([0.0, 0.0, 0.05, 0.0]), np.eye(4), np.zeros((4, 4)))
    before = np.array(ekf.state.covariance)
    with pytest.raises(FilterDivergedError, match=r"length 0\.05 in place of 1"):
        ekf.observe(*seen)
    assert np.array_equal(ekf.state.covariance, before)


class FixedAxes(OwnAxesObservation):
    """Landmarks in axes that do not turn with the vehicle: a linear measurement."""

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        return super().predict(np.concatenate((pose[:2], (0.6, 0.8))), landmarks)

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        new = super().invert(np.concatenate((pose[:2], (0.6, 0.8))), z)
        by_pose = np.array(new.jacobian_pose)
        by_pose[:, :, 2:] = 0.0
        return new._replace(jacobian_pose=by_pose)


class PredictedOnce(DirectionCosineEkf):
    """Every measurement of an instant predicted from x(k|k-1), as eq. 12 reads without `repeated`.

    The covariance goes on, the innovation does not.
    """

    def _fuse(self, seen: Measurements, landmark_indices: Index, rows: Index) -> None:
        model, found = self.models[seen.kind], []
        for row in rows:
            local = self.state.map_of(landmark_indices[[row]])
            z, by_pose, by_landmark = model.predict(local.pose, local.landmark)
            jacobian = np.concatenate((by_pose[0], by_landmark[0]), axis=1)
            found.append((local.columns, jacobian, (seen.z[row] - z[0]), seen.noise[row]))
        for columns, jacobian, innovation, noise in found:
            self.state.update(columns, jacobian, innovation, noise)


def driven(
    axes: OwnAxesObservation, make: type[DirectionCosineEkf] = DirectionCosineEkf, **options: bool
) -> KalmanState:
    """The state after a drive by which all measurements are fused as points in some axes."""
    ekf = make(*start(), options=DirectionCosineOptions(**options))
    ekf.models[POINT] = axes
    drive(ekf, np.random.default_rng(0))
    return ekf.state


def apart(first: KalmanState, second: KalmanState) -> float:
    return max(
        relative_error(first.mean, second.mean), relative_error(first.covariance, second.covariance)
    )


def test_one_after_the_other_equals_together_where_the_measurement_is_linear() -> None:
    """Steps 2 and 3, repeated M times (Misono 2007, section 3.3), against one stacked update."""
    assert apart(driven(FixedAxes(full_jacobian=False)), driven(FixedAxes(False), stacked=True)) < (
        1e-10
    )


def test_predictions_that_do_not_go_on_are_rejected() -> None:
    once = driven(FixedAxes(full_jacobian=False), PredictedOnce)
    assert apart(once, driven(FixedAxes(full_jacobian=False), stacked=True)) > 1e-3


def test_published_is_one_after_the_other() -> None:
    """Eq. 9 turns with the pair, so the order of fusing shows."""
    axes = OwnAxesObservation(full_jacobian=False)
    assert apart(driven(axes), driven(axes, stacked=True)) > 1e-3
