"""Landmarks told apart by a layer of the dense map (Nieto 2005, section 6.4)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.layer_values import COLOURS, SIGMA_COLOUR, coloured_poles
from comparisons.adapters.attributes import AROUND_M, BRIGHTNESS, measured_attributes
from comparisons.adapters.ekf_factory import build_association, settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.source import DenseWatcher
from comparisons.faults.fault import with_state
from comparisons.logs.log import Log
from comparisons.pipeline.compare import Modified
from comparisons.report.result import build_result
from ekf_reference.association.attributes import AttributeEstimates
from ekf_reference.association.joint_compatibility import JointCompatibility
from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core.landmark_types import POINT, POSE, NewLandmarks
from ekf_reference.core.measurements import MeasuredAttributes, Measurements
from ekf_reference.core.state import KalmanState
from ekf_reference.dense.layer_attributes import LayerAttributes
from ekf_reference.models.range_bearing import RangeBearing
from tests.helpers import Array, compared, present, simulated

LAYER = EkfConfig(association="nn", attributes="layer")
RULES = (NearestNeighbour, JointCompatibility)


@dataclass(frozen=True)
class Painted:
    """A layer that holds the same number of returns around every landmark (L,)."""

    mean: Array
    variance: Array
    count: float = 30.0

    def values_at(self, landmark_index: np.ndarray) -> tuple[Array, Array, Array]:
        return (
            self.mean[landmark_index],
            self.variance[landmark_index],
            np.full(len(landmark_index), self.count),
        )


class SureOfItself(Painted):
    """Wrong: what the layer says there has no scatter."""

    def values_at(self, landmark_index: np.ndarray) -> tuple[Array, Array, Array]:
        mean, _, count = super().values_at(landmark_index)
        return mean, np.zeros(len(landmark_index)), 1e12 * count


@cache
def drive() -> Log:
    return coloured_poles(0, 0.12)


def reported_by(layer: Painted) -> LayerAttributes:
    return LayerAttributes(AttributeEstimates(np.ones(2)), layer, BRIGHTNESS)


def two_poles_in_one_gate(value: float, nearer: int) -> tuple[KalmanState, Measurements]:
    """Nieto 2005, section 6.4: a measurement between two poles, a little nearer to one of them."""
    state = KalmanState(np.zeros(3), np.diag((0.3**2, 0.3**2, 0.02**2)))
    for y in (-0.3, 0.3):
        point = np.array(((10.0, y),))
        by_pose, by_point = np.zeros((1, 2, 3)), np.eye(2)[None]
        state.augment(NewLandmarks(point, by_pose, by_point), 1e-6 * np.eye(2)[None])
    z = np.array(((10.0, 0.01 * (nearer - 0.5)),))
    seen = MeasuredAttributes(np.array(((np.nan, value),)), np.full((1, 2), SIGMA_COLOUR**2))
    return state, Measurements(
        z, np.diag((0.05**2, 0.005**2))[None], np.array((-1,)), attributes=seen
    )


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("right", [0, 1])
def test_colour_decides_between_two_poles_in_one_gate(
    rule: type[NearestNeighbour | JointCompatibility], right: int
) -> None:
    """By position the nearer one wins, by colour the right one; colours exchanged, the other."""
    state, seen = two_poles_in_one_gate(COLOURS[right], nearer=1 - right)
    landmark_indices = []
    for colours in (COLOURS, COLOURS[::-1]):
        layer = Painted(np.array(colours), np.full(2, SIGMA_COLOUR**2))
        landmark_indices.append(
            rule(attributes=reported_by(layer)).assign(state, RangeBearing(), seen)[0]
        )
    assert landmark_indices == [right, 1 - right]
    assert rule().assign(state, RangeBearing(), seen)[0] != right


def test_a_landmark_that_the_layer_does_not_know_stands_with_the_others() -> None:
    layer = Painted(np.array((1.0, np.nan)), np.array((0.04, np.nan)))
    _, seen = two_poles_in_one_gate(1.0, 0)
    found = reported_by(layer).distances(np.arange(2), seen)
    assert found.dof.tolist() == [[1, 0]]
    assert found.nis.tolist() == [[0.0, 0.0]]
    assert np.isclose(found.n[0, 0], found.n[0, 1], rtol=1e-12)


@pytest.mark.parametrize(("kind", "holds"), [(Painted, True), (SureOfItself, False)])
def test_what_a_measurement_shows_scatters_as_it_is_said_to(
    kind: type[Painted], holds: bool
) -> None:
    """Colours of one pole differ from side to side, more than one return is noisy."""
    rng, side, trials = np.random.default_rng(2), 0.8, 2000
    reported = reported_by(kind(np.zeros(1), np.full(1, side**2)))
    value = np.column_stack((np.full(trials, np.nan), rng.normal(0.0, side, trials)))
    value[:, 1] += rng.normal(0.0, SIGMA_COLOUR, trials)
    seen = MeasuredAttributes(value, np.full((trials, 2), SIGMA_COLOUR**2))
    z, noise = np.zeros((trials, 2)), np.tile(np.eye(2), (trials, 1, 1))
    many = Measurements(z, noise, np.full(trials, -1), attributes=seen)
    total = float(reported.distances(np.zeros(1, dtype=np.intp), many).nis.sum())
    low, high = chi2.ppf((0.0005, 0.9995), trials)
    assert (low < total < high) == holds


def test_measurements_are_told_what_their_scan_shows_around_them() -> None:
    log = drive()
    reported = measured_attributes(log, "layer")
    value = reported.value[:, BRIGHTNESS]
    known = np.isfinite(value)
    assert known.mean() > 0.9
    assert 0.5 < np.sqrt(reported.variance[0, BRIGHTNESS]) / SIGMA_COLOUR < 2.0
    off = np.abs(value[known, None] - COLOURS).min(axis=1)
    assert (off < 3.0 * SIGMA_COLOUR).mean() > 0.95
    farther = replace(log.measurements, range_m=log.measurements.range_m + 3.0 * AROUND_M)
    beside = measured_attributes(replace(log, measurements=farther), "layer").value[:, BRIGHTNESS]
    assert np.isfinite(beside).mean() < 0.5


def test_the_layer_holds_the_poles_colours_while_the_filter_drives() -> None:
    log = drive()
    watcher = DenseWatcher(log, DenseMapsConfig(layers=("values",)))
    setup = FilterSetup(observers=[watcher], layer=watcher)
    run = run_ekf(log, build_timeline(log), settle(LAYER, log), setup=setup)
    held = watcher.values_at(np.arange(len(run.estimate.landmark)))
    seen = held.returns >= 10
    assert seen.sum() >= 5
    off = np.abs(held.mean[seen, None] - COLOURS).min(axis=1)
    assert np.median(off) < 0.5 * SIGMA_COLOUR
    blind = DenseWatcher(log, DenseMapsConfig(layers=("values",)))
    unled = FilterSetup(observers=[blind])
    off_run = run_ekf(log, build_timeline(log), EkfConfig(association="nn"), setup=unled)
    label = log.measurements.landmark
    wrong = [_wrong(one.landmark_index, label[: len(one.landmark_index)]) for one in (run, off_run)]
    assert wrong[0] <= wrong[1]


def _wrong(landmark_index: np.ndarray, label: np.ndarray) -> int:
    """Measurements that are unused, or not given to the landmark most of their label are."""
    wrong = int((landmark_index < 0).sum())
    for one in np.unique(label[landmark_index >= 0]):
        used = landmark_index[(label == one) & (landmark_index >= 0)]
        wrong += len(used) - int(np.bincount(used).max())
    return wrong


@pytest.mark.slow
def test_a_map_on_both_kinds_of_landmarks_tells_the_same_of_points() -> None:
    """Its landmarks have other numbers there than among points alone."""
    log, found = drive(), []
    for kinds in ((POINT,), (POINT, POSE)):
        watcher = DenseWatcher(log, DenseMapsConfig(layers=("values",)), kinds=kinds)
        setup = FilterSetup(observers=[watcher], layer=watcher)
        run = run_ekf(log, build_timeline(log), settle(LAYER, log), setup=setup)
        landmark_index = np.arange(len(run.estimate.landmark))
        found.append((run.landmark_index, *watcher.values_at(landmark_index)))
    assert np.isfinite(found[0][1]).sum() >= 5
    for alone, both in zip(*found, strict=True):
        np.testing.assert_array_equal(alone, both)


def test_both_estimators_follow_an_association_by_a_layer() -> None:
    result = build_result(compared(drive(), ekf=LAYER))
    assert result.ekf.attributes == "layer"
    gaps = result.agreement.algebra_gap_sigma, result.agreement.model_gap_sigma
    assert all(gap is not None and gap < 1e-6 for gap in gaps)
    assert "dense" not in (result.model_extra or {})


def test_what_cannot_be_had_is_said() -> None:
    bare = simulated(loop_s=5.0)
    with pytest.raises(InputError, match="holds no scans with intensities"):
        settle(LAYER, bare)
    log = drive()
    dark = replace(present(log.scans), intensity=np.zeros_like(present(log.scans).intensity))
    with pytest.raises(InputError, match="its scans have no intensities"):
        DenseWatcher(replace(log, scans=dark), DenseMapsConfig(layers=("values",)))
    with pytest.raises(ValueError, match="the map that keeps it"):
        build_association(log, LAYER)


class Doubled(KalmanState):
    """Wrong: the prediction adds its noise twice."""

    def predict(self, pose: Array, jacobian: Array, noise: Array) -> None:
        """See KalmanState.predict."""
        super().predict(pose, jacobian, 2.0 * noise)


@pytest.mark.slow
def test_an_algebra_gap_is_traced_with_the_layer_as_well() -> None:
    """The second run, operation by operation, goes by a map of its own."""
    found = compared(drive(), Modified(with_state(Doubled)), ekf=LAYER)
    causes = " ".join(cause.evidence for cause in found.verdict.causes)
    assert found.verdict.outcome == "disagree"
    assert ": the process noise was added 2 times (at " in causes
