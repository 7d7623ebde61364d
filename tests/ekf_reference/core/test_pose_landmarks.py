"""Landmarks with a direction in the full and the compressed filter, beside points."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from ekf_reference.core.blocks import stack
from ekf_reference.core.ekf import NEW, Ekf
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import (
    POINT,
    POSE,
    LandmarkKind,
    NewLandmarks,
    PredictedMeasurements,
)
from ekf_reference.core.state import FilterDivergedError, KalmanState
from ekf_reference.core.trace import RecordedTrace
from ekf_reference.filters.compressed import CompressedState
from ekf_reference.filters.misono import DirectionCosineEkf, DirectionCosineOptions
from ekf_reference.models.relative_pose import RelativePose
from ekf_reference.scan_landmarks.merging import merge_landmarks
from ekf_reference.scan_matching.frames import moved_gaussians
from tests.ekf_reference.both_kinds import (
    AREAS,
    DUPLICATES,
    FRAMES,
    PRIOR,
    Flipped,
    NoRows,
    Script,
    Unwrapped,
    build,
    drive,
    error,
    relative,
)
from tests.ekf_reference.numerics import random_covariance, relative_error

ORDERS = ("points first", "frames first", "in turn", "frames only")


def assert_equal(first: Ekf, second: Ekf) -> None:
    p, q = first.state.covariance, second.state.covariance
    sigma = np.sqrt(np.diag(q))
    assert np.abs((p - q) / np.outer(sigma, sigma)).max() < 1e-9
    assert np.abs((first.state.mean - second.state.mean) / sigma).max() < 1e-9
    assert np.array_equal(first.state.layout.first[POINT], second.state.layout.first[POINT])
    assert np.array_equal(first.state.layout.first[POSE], second.state.layout.first[POSE])


@pytest.mark.parametrize("order", ORDERS)
def test_compressed_equals_full(order: str) -> None:
    """Two laps, areas left and entered again, two landmarks fused, some removed."""
    script = Script(order=order, fuse_at=60, remove_at=75)
    full, compressed = build(), build("compressed")
    drive(full, 1, script)
    drive(compressed, 1, script)
    assert isinstance(compressed.state, CompressedState)
    updates = compressed.state.updates
    assert len(updates) > 8
    assert max(u.passive for u in updates) > 10
    assert_equal(compressed, full)


class AtTheOldPlace(CompressedState):
    """Broken: after a removal the entries behind it are taken for where they were."""

    def remove(self, landmark_index: Index, kind: LandmarkKind = POINT) -> None:
        before = self._entry
        super().remove(landmark_index, kind)
        self._entry = np.minimum(before[: len(self._entry)], self._local.layout.size - 1)


@pytest.mark.parametrize("broken", [NoRows, AtTheOldPlace])
def test_the_equality_rejects_a_broken_compression(broken: type[CompressedState]) -> None:
    script = Script(remove_at=75)
    full, compressed = build(), build("compressed")
    compressed.state = broken(compressed.state.pose, PRIOR, AREAS)
    drive(full, 1, script)
    try:
        drive(compressed, 1, script)
    except FilterDivergedError:
        return
    with pytest.raises(AssertionError):
        assert_equal(compressed, full)


def test_reading_a_compressed_filter_midway_changes_nothing_but_rounding() -> None:
    quiet, read = build("compressed"), build("compressed")
    drive(quiet, 3)

    class Reading(RelativePose):
        def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
            assert np.isfinite(read.state.snapshot(POINT).place).all()
            assert len(read.state.places(POSE)) == len(read.state.layout.first[POSE])
            return super().predict(pose, landmarks)

    read.models[POSE] = Reading()
    drive(read, 3)
    assert_equal(read, quiet)


def test_the_filter_on_the_circle_equals_the_one_on_the_heading() -> None:
    traces = RecordedTrace(), RecordedTrace()
    script = Script(order="frames only", fuse_at=60, remove_at=75)
    heading = build(trace=traces[0])
    complete = DirectionCosineOptions(full_jacobian=True, renormalise=True, stacked=True)
    pair = build(make=lambda *a: DirectionCosineEkf(*a, options=complete), trace=traces[1])
    for ekf in (heading, pair):
        drive(ekf, 2, script)
    assert relative_error(pair.read_pose().pose, heading.state.pose) < 1e-9
    there = heading.state.layout.present(POSE)
    assert relative_error(pair.state.places(POSE)[there], heading.state.places(POSE)[there]) < 1e-9
    ours, theirs = (trace.arrays() for trace in traces)
    for one, other in (
        (ours.measurements[POSE], theirs.measurements[POSE]),
        (ours.initialisations[POSE], theirs.initialisations[POSE]),
        (ours.merges, theirs.merges),
    ):
        assert len(other.step)
        for name, column in vars(other).items():
            scale = np.abs(column).max(initial=1e-300)
            assert np.abs(column - vars(one)[name]).max(initial=0.0) <= 1e-8 * scale, name
    gone, other_gone = (one.removals for one in (ours, theirs))
    assert gone.kind == other_gone.kind == (POSE,) * len(gone.step) != ()
    assert gone.step.tolist() == other_gone.step.tolist()
    assert gone.landmark_index.tolist() == other_gone.landmark_index.tolist()


@pytest.mark.parametrize("kind", ["full", "compressed"])
@pytest.mark.parametrize("order", ORDERS)
def test_without_noise_there_is_no_error(kind: str, order: str) -> None:
    """Headings go round twice: innovations that are not wrapped would throw the filter off."""
    ekf = build(kind)
    made = drive(ekf, 0, Script(order=order, noise=0.0, fuse_at=60, remove_at=75))
    assert ekf.state.pose[2] > 3.0 * np.pi
    assert np.abs(error(ekf, made)).max() < 1e-11


class NoLever(RelativePose):
    """New landmarks as if the vehicle's heading did not move them."""

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        new = super().invert(pose, z)
        by_pose = new.jacobian_pose.copy()
        by_pose[:, :2, 2] = 0.0
        return new._replace(jacobian_pose=by_pose)


class NoCross(KalmanState):
    """New pose landmarks know nothing of the vehicle."""

    def augment(self, new: NewLandmarks, noise: Array, kind: LandmarkKind = POINT) -> None:
        n = self._layout.size
        super().augment(new, noise, kind)
        if kind == POSE:
            self._covariance[:n, n : self._layout.size] = 0.0
            self._covariance[n : self._layout.size, :n] = 0.0


def nees(seeds: int, modify: Callable[[Ekf], None] = lambda ekf: None) -> tuple[float, int]:
    """The sum over drives, and its degrees of freedom."""
    total, dof = 0.0, 0
    for seed in range(seeds):
        ekf = build()
        modify(ekf)
        made = drive(ekf, seed, Script(steps=100, order="in turn", fuse_at=60, remove_at=75))
        off = error(ekf, made)
        total += float(off @ np.linalg.solve(ekf.state.covariance, off))
        dof += len(off)
    return total, dof


@pytest.mark.slow
def test_errors_are_as_large_as_the_covariance_says() -> None:
    total, dof = nees(30)
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], dof)
    assert low < total < high


def _observe(model: type[RelativePose]) -> Callable[[Ekf], None]:
    def plant(ekf: Ekf) -> None:
        ekf.models[POSE] = model()

    return plant


def _keep(ekf: Ekf) -> None:
    ekf.state = NoCross(ekf.state.pose, PRIOR)


@pytest.mark.slow
@pytest.mark.parametrize(
    "modify", [_observe(Unwrapped), _observe(Flipped), _observe(NoLever), _keep]
)
def test_the_bound_rejects_broken_filters(modify: Callable[[Ekf], None]) -> None:
    total, dof = nees(8, modify)
    assert not chi2.ppf(1e-3, dof) < total < chi2.ppf(1.0 - 1e-3, dof)


def test_a_landmark_seen_twice_at_once_counts_twice() -> None:
    r = np.diag((0.01, 0.02, 0.003)) ** 2
    z = np.array([[3.0, 1.0, 0.4]])
    once, twice = build(), build()
    for ekf in (once, twice):
        ekf.observe_known(z, r[None], np.array([NEW]), POSE)
    once.observe_known(z, 0.5 * r[None], np.array([0]), POSE)
    twice.observe_known(np.repeat(z, 2, axis=0), np.array((r, r)), np.array([0, 0]), POSE)
    assert relative_error(twice.state.covariance, once.state.covariance) < 1e-12
    assert relative_error(twice.state.mean, once.state.mean) < 1e-14


def test_landmark_indices_that_are_not_in_the_map_are_named() -> None:
    ekf, z, r = build(), np.ones((1, 3)), np.eye(3)[None]
    with pytest.raises(ValueError, match=r"landmark indices \[0\], expected -1 or less than 0"):
        ekf.observe_known(z, r, np.array([0]), POSE)
    with pytest.raises(ValueError, match=r"landmark indices \[-1, 0\], expected -1 or less than 0"):
        ekf.observe_known(np.ones((2, 3)), np.tile(r, (2, 1, 1)), np.array([NEW, 0]), POSE)
    assert ekf.observe_known(z, r, np.array([NEW]), POSE).tolist() == [0]
    ekf.remove(np.array([0]), POSE)
    with pytest.raises(ValueError, match="removed"):
        ekf.observe_known(z, r, np.array([0]), POSE)
    with pytest.raises(ValueError, match="one already"):
        merge_landmarks(ekf, 0, 0, z[0], r[0])
    assert ekf.observe_known(z, r, np.array([NEW]), POSE).tolist() == [1]


def test_a_removed_point_is_not_taken_for_one_that_is_there() -> None:
    ekf = build()
    z, sigma = np.array([[3.0, 0.2], [4.0, -0.5]]), np.full((2, 2), 0.1)
    ekf.observe(z, sigma, np.array([7, 8]))
    ekf.remove(np.array([0]))
    before = ekf.state.mean.copy()
    assert ekf.observe(z[:1], sigma[:1], np.array([7])).tolist() == [-1]
    assert np.array_equal(ekf.state.mean, before)
    assert ekf.observe(z, sigma, np.array([9, 8])).tolist() == [2, 1]


def test_fusing_two_that_are_one_helps_and_says_how_their_frames_lie() -> None:
    """The first gains what the second knew; a template's points move to where they were."""
    ekf = build()
    made = drive(ekf, 5, Script(steps=60))
    first, second = (made.known[i] for i in DUPLICATES)
    at = ekf.state.layout.first[POSE][first] + np.arange(3)
    before = ekf.state.covariance[np.ix_(at, at)].copy()
    z = relative(FRAMES[DUPLICATES[0]], FRAMES[DUPLICATES[1]])
    known = merge_landmarks(ekf, first, second, z, 1e-8 * np.eye(3))
    at = ekf.state.layout.first[POSE][first] + np.arange(3)
    after = ekf.state.covariance[np.ix_(at, at)]
    assert np.linalg.eigvalsh(before - after)[0] > -1e-9 * np.linalg.norm(before)
    assert np.linalg.det(after) < 0.95 * np.linalg.det(before)
    assert ekf.state.layout.present(POSE).tolist() == [
        s for s in range(len(ekf.state.layout.first[POSE])) if s != second
    ]
    assert np.abs(relative(*known.landmark) - z).max() < 1e-3
    joint = known.covariance[3:, 3:]
    frames = known.landmark[0], known.landmark[1]
    point, spread = moved_gaussians(*frames, joint, np.zeros((1, 2)), np.zeros((1, 2, 2)))
    assert np.abs(point[0] - z[:2]).max() < 1e-3
    assert np.sqrt(spread[0].diagonal().max()) < 2e-4  # the frames lie fixed to each other


def test_a_fusion_in_many_parts_is_the_same_where_all_is_linear() -> None:
    def fused(parts: bool) -> Ekf:
        ekf = build()
        made = drive(ekf, 6, Script(steps=50))
        if parts:
            ekf.splitter = replace(ekf.splitter, largest_move_m=1e-7, most=8)
        first, second = (made.known[i] for i in DUPLICATES)
        z = relative(ekf.state.places(POSE)[first], ekf.state.places(POSE)[second])
        z[:2] += 1e-5
        merge_landmarks(ekf, first, second, z, 1e-6 * np.eye(3))
        return ekf

    whole, split = fused(parts=False), fused(parts=True)
    assert relative_error(split.state.covariance, whole.state.covariance) < 1e-4
    assert relative_error(split.state.mean, whole.state.mean) < 1e-8


def test_the_correction_is_what_a_full_product_gives() -> None:
    rng = np.random.default_rng(7)
    ekf = build()
    drive(ekf, 7, Script(steps=20))
    state, z = ekf.state, rng.uniform(-1.0, 1.0, 3)
    local = state.map_of(np.array([0]), POSE)
    at = ekf.models[POSE].predict(state.pose, local.landmark)
    h = np.zeros((3, len(state.mean)))
    np.add.at(h.T, local.columns, stack(at.jacobian_pose, at.jacobian_landmark).T)
    r = 1e-3 * random_covariance(rng, 3)
    p, x = state.covariance.copy(), state.mean.copy()
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
    nu = ekf.models[POSE].innovation(z[None], at.z)[0]
    ekf.observe_known(z[None], r[None], np.array([0]), POSE)
    assert relative_error(state.covariance, p - gain @ h @ p) < 1e-9
    assert relative_error(state.mean, x + gain @ nu) < 1e-12
