"""Contract of all linearisations: Jacobians by differences; what cannot be observed stays so."""

from collections.abc import Callable

import numpy as np
import pytest

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import KINDS, POINT, POSE, LandmarkKind
from ekf_reference.core.linearisation import (
    FirstEstimates,
    Linearisation,
    MeanState,
    ObservabilityConstrained,
    Points,
    RightInvariant,
    Robocentric,
)
from ekf_reference.core.trace import MeasurementRecord, StepRecord, Trace
from ekf_reference.models.motion import UnicycleModel
from tests.ekf_reference.numerics import central_difference

EVERY = (Linearisation, FirstEstimates, ObservabilityConstrained, RightInvariant, Robocentric)
CONTROL, STEP_S = np.array((1.0, 0.4)), 0.5
POINTS = np.array(((5.0, 1.0), (3.0, 4.0), (-2.0, 3.0), (1.0, 6.0), (4.0, 3.0)))
POSES = np.array(((2.0, 5.0, 1.0), (5.0, 3.0, -2.0)))
SIGMAS = {POINT: np.array((0.1, 0.05)), POSE: np.array((0.1, 0.1, 0.05))}


class Records(Trace):
    """Keeps all that is recorded, in order."""

    def __init__(self) -> None:
        self.events: list[StepRecord | MeasurementRecord] = []
        self.new: list[MeasurementRecord] = []

    def step(self, step: StepRecord) -> None:
        self.events.append(step)

    def measurement(self, used: MeasurementRecord) -> None:
        self.events.append(used)

    def initialisation(self, new: MeasurementRecord) -> None:
        self.new.append(new)


def drive(
    linearisation: Linearisation, steps: int, scale: float = 1.0, seed: int = 0, gone: int = -1
) -> tuple[Ekf, Records, Array]:
    """A filter with landmarks of both kinds, its records, and the true pose at the end.

    scale: of the errors of prior, control and measurements. gone: after so many steps the first
    point is removed.
    """
    rng, records, model = np.random.default_rng(seed), Records(), UnicycleModel()
    true, prior, q = np.zeros(3), np.diag((0.01, 0.01, 0.004)), np.diag((0.01, 0.004))
    start = true + scale * rng.multivariate_normal(np.zeros(3), prior)
    ekf = Ekf(model, KnownAssociation(), start, prior, None, records, linearisation)
    places = {POINT: POINTS, POSE: POSES}
    seen: dict[LandmarkKind, Index] = {kind: np.zeros(0, dtype=np.intp) for kind in KINDS}
    for k in range(steps):
        true = model.step(true, CONTROL, STEP_S).pose
        noise = scale * rng.multivariate_normal(np.zeros(2), q)
        ekf.predict(CONTROL + noise, q, STEP_S)
        if k == gone:
            ekf.remove(np.array([0]))
        for kind, place in places.items():
            index = seen[kind] if len(seen[kind]) else np.full(len(place), -1)
            rows = np.arange(int(kind == POINT and 0 <= gone <= k), len(place))
            exact = ekf.models[kind].predict(true, place[rows]).z
            z = exact + scale * SIGMAS[kind] * rng.normal(size=exact.shape)
            r = np.tile(np.diag(SIGMAS[kind] ** 2), (len(rows), 1, 1))
            used = ekf.observe_known(z, r, index[rows], kind)
            seen[kind] = seen[kind] if len(seen[kind]) else used
    return ekf, records, true


@pytest.mark.parametrize("kind", EVERY)
def test_without_noise_jacobians_are_those_of_the_models_by_differences(
    kind: type[Linearisation],
) -> None:
    """At the truth all linearise at one place."""
    ekf, records, true = drive(kind(), 12, scale=0.0)
    assert np.abs(ekf.state.pose - true).max() < 1e-9
    assert np.abs(ekf.state.places(POINT) - POINTS).max() < 1e-9
    for event in records.events:
        if isinstance(event, StepRecord):
            by_pose = central_difference(moved, event.departed)
            assert np.abs(event.f - by_pose).max() < 1e-7
        else:
            assert largest_error(ekf, event) < 1e-6
    assert len(records.new) == 2
    for new in records.new:
        assert new.kind is not None
        inverse, model = np.linalg.inv(new.jacobian_other), ekf.models[new.kind]
        expected = model.predict(new.pose, new.landmark)
        assert np.abs(inverse - expected.jacobian_landmark).max() < 1e-9
        assert np.abs(inverse @ new.jacobian_pose + expected.jacobian_pose).max() < 1e-9


def moved(pose: Array) -> Array:
    return UnicycleModel().step(pose, CONTROL, STEP_S).pose


def largest_error(ekf: Ekf, event: MeasurementRecord) -> float:
    """Of the Jacobians of a record, by central differences at its pose and landmarks."""
    assert event.kind is not None
    model, most = ekf.models[event.kind], 0.0
    for row in range(len(event.landmark)):

        def predicted(x: Array) -> Array:
            z: Array = model.predict(x[:3], x[None, 3:]).z[0]
            return z

        h = central_difference(predicted, np.concatenate((event.pose, event.landmark[row])))
        have = np.hstack((event.jacobian_pose[row], event.jacobian_other[row]))
        most = max(most, float(np.abs(h - have).max()))
    return most


class NewestLandmarks(FirstEstimates):
    """Broken: the Jacobian by a landmark is taken at its newest estimate."""

    def measurement(
        self, state: MeanState, landmark_index: Index, kind: LandmarkKind
    ) -> Points | None:
        return self.predicted, state.places(kind)[..., landmark_index, :]


class UpdatedPose(FirstEstimates):
    """Broken: F leads from the updated pose."""

    def step(self, state: MeanState, arrived: Array) -> Array | None:
        super().step(state, arrived)
        return None


def nullity(records: Records, first: int) -> int:
    """Of the local observability matrix of all records from the first one on."""
    n = 3 + POINTS.size + POSES.size
    column = {POINT: 3, POSE: 3 + POINTS.size}
    phi, rows = np.eye(n), list[Array]()
    for event in records.events[first:]:
        if isinstance(event, StepRecord):
            phi[:3] = event.f @ phi[:3]
            continue
        assert event.kind is not None
        width = event.kind.width
        parts = zip(event.landmark_index, event.jacobian_pose, event.jacobian_other, strict=True)
        for landmark, by_pose, by_landmark in parts:
            h = np.zeros((len(by_pose), n))
            h[:, :3] = by_pose
            start = column[event.kind] + width * int(landmark)
            h[:, start : start + width] = by_landmark
            rows.append(h @ phi)
    values = np.linalg.svd(np.concatenate(rows), compute_uv=False)
    return int((values < 1e-9 * values[0]).sum())


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (Linearisation, 2),
        (FirstEstimates, 3),
        (ObservabilityConstrained, 3),
        (NewestLandmarks, 2),
        (UpdatedPose, 2),
    ],
)
def test_the_frame_of_the_map_stays_unobservable(kind: type[Linearisation], expected: int) -> None:
    """East, north and the turn of all; the standard EKF learns its heading, as broken ones do."""
    _, records, _ = drive(kind(), 15)
    assert nullity(records, 6) == expected


@pytest.mark.parametrize("kind", EVERY)
def test_all_are_consistent(kind: type[Linearisation]) -> None:
    """NEES of the pose over drives; the EKF's is within, too, where noises are small."""
    squared = []
    for seed in range(40):
        ekf, _, true = drive(kind(), 8, 0.3, seed)
        error = true - ekf.state.pose
        squared.append(error @ np.linalg.solve(0.09 * ekf.state.pose_covariance, error))
    assert 2.0 < np.mean(squared) < 4.2


def test_landmarks_that_are_removed_move_nothing() -> None:
    """The shift is of what is in the state."""
    linearisation = ObservabilityConstrained()
    ekf, _, _ = drive(linearisation, 10, gone=5)
    assert np.isnan(ekf.state.places(POINT)[0]).all()
    assert np.isfinite(linearisation.anchor).all()
    assert np.isfinite(ekf.state.mean).all()


@pytest.mark.parametrize("kind", [FirstEstimates, ObservabilityConstrained])
def test_what_is_surveyed_has_a_first_estimate(kind: Callable[[], Linearisation]) -> None:
    linearisation = kind()
    ekf = Ekf(
        UnicycleModel(),
        KnownAssociation(),
        np.zeros(3),
        0.01 * np.eye(3),
        None,
        None,
        linearisation,
    )
    ekf.insert_surveyed(POINTS, np.tile(1e-4 * np.eye(2), (len(POINTS), 1, 1)))
    ekf.predict(CONTROL, np.diag((0.01, 0.004)), STEP_S)
    points = linearisation.measurement(ekf.state, np.array([1, 3]), POINT)
    assert points is not None
    offset = points[1] - points[0][:2]
    assert np.allclose(offset, POINTS[[1, 3]] - ekf.state.pose[:2])
