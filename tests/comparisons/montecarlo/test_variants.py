"""The filters of many runs: against the reference filter, and one run at a time."""

from typing import Any

import numpy as np
import pytest

from comparisons.adapters.filter_variants import FirstEstimatesEkf, InvariantEkf
from comparisons.experiments.montecarlo.runs import FILTERS, run_filter
from comparisons.experiments.scenarios.world import ScenarioWorld, WorldMeasurements, measure
from comparisons.experiments.variants.batch_ekf import BatchEkf
from comparisons.experiments.variants.batch_models import BatchSensor, RelativePosition
from comparisons.experiments.variants.batch_state import BatchInvariantState, BatchState, measured
from comparisons.experiments.variants.linearisation import AtTruth
from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import (
    POINT,
    LandmarkKind,
    NewLandmarks,
    PredictedMeasurements,
)
from ekf_reference.core.linearisation import (
    FirstEstimates,
    Linearisation,
    MeanState,
    ObservabilityConstrained,
    Points,
)
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.range_bearing import RangeBearing
from tests.comparisons.montecarlo.worlds import short_world
from tests.helpers import Array, central_difference, random_covariance

SENSORS = ("circle", "circle-range-bearing")


class RelativeObservation(RangeBearing):
    """Relative positions for the reference filter, written out by hand."""

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        back = np.array([[cos, sin], [-sin, cos]])
        offset = landmarks - pose[:2]
        by_pose = np.zeros((len(offset), 2, 3))
        by_pose[:, :, :2] = -back
        by_pose[:, 0, 2] = -sin * offset[:, 0] + cos * offset[:, 1]
        by_pose[:, 1, 2] = -cos * offset[:, 0] - sin * offset[:, 1]
        return PredictedMeasurements(
            offset @ back.T, by_pose, np.broadcast_to(back, (len(offset), 2, 2))
        )

    def innovation(self, z: Array, predicted: Array) -> Array:
        return z - predicted

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        turn = np.array([[cos, -sin], [sin, cos]])
        offset = z @ turn.T
        by_pose = np.zeros((len(z), 2, 3))
        by_pose[:, 0, 0] = by_pose[:, 1, 1] = 1.0
        by_pose[:, 0, 2], by_pose[:, 1, 2] = -offset[:, 1], offset[:, 0]
        return NewLandmarks(pose[:2] + offset, by_pose, np.broadcast_to(turn, (len(z), 2, 2)))


def drive(filter_: Any, world: ScenarioWorld, data: WorldMeasurements, steps: int) -> None:
    for k in range(steps):
        filter_.predict(data.control[:, k])
        if len(world.seen[k]):
            filter_.observe(data.z[k], world.sigma[k], world.seen[k])


@pytest.mark.parametrize(
    ("name", "kind"), [("ekf", Ekf), ("fej", FirstEstimatesEkf), ("riekf", InvariantEkf)]
)
@pytest.mark.parametrize("scenario", [*SENSORS, "bailey-loop"])
def test_filters_are_the_references_run_by_run(scenario: str, name: str, kind: type[Ekf]) -> None:
    world = short_world(scenario, 400)
    data = measure(world, range(3))
    batch = FILTERS[name](world, 3)
    drive(batch, world, data, 400)
    for run in range(3):
        reference = kind(
            UnicycleModel(), KnownAssociation(), world.robot.pose, world.robot.covariance
        )
        if isinstance(world.robot.sensor, RelativePosition):
            reference.models[POINT] = RelativeObservation()
        q = np.diag(world.robot.sigma_odometry**2)
        for k in range(400):
            reference.predict(data.control[run, k], q, world.robot.step_s)
            if len(world.seen[k]):
                reference.observe(data.z[k][run], world.sigma[k], world.seen[k].astype(np.int64))
        assert reference.state.landmark_count == len(batch.label) > 7
        sigma = np.sqrt(np.diag(reference.state.covariance))
        assert np.abs((batch.state.mean[run] - reference.state.mean) / sigma).max() < 1e-8
        own = batch.state.covariance[run]
        if name == "riekf":  # of the invariant error
            turn, place = np.eye(len(own)), reference.state.mean.copy()
            east, north = np.delete(place, 2).reshape(-1, 2).T
            turn[np.delete(np.arange(len(own)), 2), 2] = np.column_stack((-north, east)).ravel()
            own = turn @ own @ turn.T
        difference = own - reference.state.covariance
        assert np.abs(difference / np.outer(sigma, sigma)).max() < 1e-8


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("scenario", SENSORS)
def test_a_batch_is_its_runs_one_by_one(name: str, scenario: str) -> None:
    world = short_world(scenario, 120)
    together = run_filter(name, world, measure(world, range(4)))
    for run in range(4):
        alone = run_filter(name, world, measure(world, range(run, run + 1)))
        for batch, single in zip(together, alone, strict=True):
            assert np.allclose(batch[run], single[0], rtol=1e-6, atol=1e-12, equal_nan=True)


def test_without_noise_every_filter_is_exact() -> None:
    world = short_world("circle", 300)
    offset = [world.landmark[w] - p[:2] for w, p in zip(world.seen, world.pose[1:], strict=True)]
    exact = WorldMeasurements(
        world.control[None],
        tuple(
            world.robot.sensor.predict(np.full(len(o), p[2]), o)[None]
            for o, p in zip(offset, world.pose[1:], strict=True)
        ),
    )
    for name in FILTERS:
        filter_ = FILTERS[name](world, 1)
        drive(filter_, world, exact, 300)
        truth = np.concatenate((world.pose[300], world.landmark[filter_.label].ravel()))
        assert np.abs(filter_.state.mean[0] - truth).max() < 1e-9, name


def sensor_of(scenario: str) -> BatchSensor:
    return short_world(scenario, 5).robot.sensor


@pytest.mark.parametrize("scenario", SENSORS)
def test_measurement_jacobian_by_central_differences(scenario: str) -> None:
    sensor, rng = sensor_of(scenario), np.random.default_rng(1)
    for _ in range(5):
        x, landmark_index = 4.0 * rng.standard_normal(9), np.array([2, 0])

        def predict(x: Array, landmark_index: Array = landmark_index) -> Array:
            return sensor.predict(x[2:3], x[3:].reshape(-1, 2)[landmark_index] - x[:2]).ravel()

        offset = x[3:].reshape(-1, 2)[landmark_index] - x[:2]
        matrix = sensor.by_offset(x[2:3], offset)
        h = measured(matrix[None], offset[None], landmark_index, np.eye(9)[None])[0]
        assert np.allclose(h, central_difference(predict, x), atol=1e-7)
        assert np.allclose(sensor.offset(x[2:3], sensor.predict(x[2:3], offset)), offset)
        flipped = measured(matrix[None], -offset[None], landmark_index, np.eye(9)[None])[0]
        assert not np.allclose(flipped, central_difference(predict, x), atol=1e-3)


@pytest.mark.parametrize("scenario", SENSORS)
def test_invariant_measurement_jacobian_by_central_differences(scenario: str) -> None:
    sensor, rng = sensor_of(scenario), np.random.default_rng(2)
    landmark_index = np.array([2, 0])
    for _ in range(5):
        x = 4.0 * rng.standard_normal(9)

        def predict(xi: Array, x: Array = x) -> Array:
            moved = invariant_state(x).moved(xi)
            offset = moved[3:].reshape(-1, 2)[landmark_index] - moved[:2]
            return sensor.predict(moved[2:3], offset).ravel()

        offset = x[3:].reshape(-1, 2)[landmark_index] - x[:2]
        h = measured(sensor.by_offset(x[2:3], offset)[None], None, landmark_index, np.eye(9)[None])[
            0
        ]
        assert np.allclose(h, central_difference(predict, np.zeros(9)), atol=1e-7)


class Moved(BatchInvariantState):
    """Lets a test move a state."""

    def moved(self, xi: Array) -> Array:
        self._move(xi[None])
        mean: Array = self.mean[0]
        return mean


def invariant_state(x: Array) -> Moved:
    state = Moved(x[:3], np.eye(3), 1, (len(x) - 3) // 2)
    points = x[3:].reshape(1, -1, 2)
    nothing = np.zeros((1, points.shape[1], 2, 2))
    state.augment(points, np.zeros_like(points), nothing)
    return state


def test_invariant_error_is_what_moves_the_estimate_to_the_truth() -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        x, xi = 3.0 * rng.standard_normal(7), rng.uniform(-2.0, 2.0, 7)
        truth = invariant_state(x).moved(xi)
        assert np.allclose(invariant_state(x).pose_error(truth[:3])[0][0], xi[:3])


@pytest.mark.parametrize("name", ["ekf", "fej", "oc", "riekf", "ideal"])
@pytest.mark.parametrize("scenario", SENSORS)
def test_prediction_and_beginning_by_central_differences(name: str, scenario: str) -> None:
    """From the truth all filters linearise at one place: P' = F P F^T + G Q G^T, numerically."""
    world = short_world(scenario, 60)
    filter_ = FILTERS[name](world, 1)
    for k in range(12):
        filter_.predict(world.control[None, k])
        if len(world.seen[k]):
            z = world.robot.sensor.predict(
                np.full(len(world.seen[k]), world.pose[k + 1, 2]),
                world.landmark[world.seen[k]] - world.pose[k + 1, :2],
            )
            filter_.observe(z[None], world.sigma[k], world.seen[k])
    before_mean = filter_.state.mean[0].copy()
    before = additive(filter_.state)
    n, dt = len(before_mean), world.robot.step_s
    k = 12
    filter_.predict(world.control[None, k])

    def step(v: Array) -> Array:
        pose = UnicycleModel().step(v[:3], v[n:], dt).pose
        return np.concatenate((pose, v[3:n]))

    f = central_difference(step, np.concatenate((before_mean, world.control[k])))
    q = np.diag(world.robot.sigma_odometry**2)
    expected = f[:, :n] @ before @ f[:, :n].T + f[:, n:] @ q @ f[:, n:].T
    assert np.allclose(additive(filter_.state), expected, rtol=1e-6, atol=1e-10)

    new = np.array([max(filter_.label) + 1])
    sensor, mean = world.robot.sensor, filter_.state.mean[0].copy()
    offset = world.landmark[new] - mean[:2]
    z = sensor.predict(mean[2:3], offset)
    sigma = np.array([[0.3, 0.2]])
    held = additive(filter_.state)
    filter_.observe(z[None], sigma, new)

    def begin(v: Array) -> Array:
        point = v[:2] + sensor.offset(v[2:3], v[None, n:])[0]
        return np.concatenate((v[:n], point))

    f = central_difference(begin, np.concatenate((mean, z[0])))
    expected = f[:, :n] @ held @ f[:, :n].T + f[:, n:] @ np.diag(sigma[0] ** 2) @ f[:, n:].T
    assert np.allclose(additive(filter_.state), expected, rtol=1e-6, atol=1e-9)


def additive(state: BatchState) -> Array:
    """Covariance (n, n) of the first run's additive error."""
    covariance = state.covariance[0].copy()
    if not isinstance(state, BatchInvariantState):
        return np.array(covariance)
    turn = np.eye(len(covariance))
    points = np.concatenate((state.pose[:, None, :2], state.landmarks), axis=1)[0]
    rows = np.array([0, *range(3, len(covariance), 2)])
    turn[rows, 2], turn[rows + 1, 2] = -points[:, 1], points[:, 0]
    blocks = turn @ covariance @ turn.T
    own = state.landmark_covariance()[0]
    for i, block in enumerate(own):
        at = slice(3 + 2 * i, 5 + 2 * i)
        assert np.allclose(blocks[at, at], block)
    assert np.allclose(blocks[:3, :3], state.pose_covariance()[0])
    result: Array = blocks
    return result


class Noted(Linearisation):
    """Remembers where another linearises."""

    def __init__(self, inner: Linearisation) -> None:
        self.inner = inner
        self.events: list[tuple[Any, Any]] = []

    def start(self, pose: Array) -> None:
        self.inner.start(pose)

    def control(self, state: MeanState, control: Array) -> Points | None:
        return self.inner.control(state, control)

    def step(self, state: MeanState, arrived: Array) -> Array | None:
        travel = self.inner.step(state, arrived)
        way = arrived[:, :2] - state.pose[:, :2] if travel is None else travel
        self.events.append((None, way[0].copy()))
        return travel

    def measurement(self, state: MeanState, landmark_index: Any, kind: LandmarkKind) -> Points:
        points = self.inner.measurement(state, landmark_index, kind)
        pose, place = points or (state.pose, state.places(kind)[:, landmark_index])
        self.events.append((landmark_index, (pose[:, 2].copy(), place - pose[:, None, :2])))
        return pose, place

    def initialisation(self, state: MeanState, place: Array, kind: LandmarkKind) -> Points | None:
        return self.inner.initialisation(state, place, kind)

    def append(self, state: MeanState, place: Array, kind: LandmarkKind) -> None:
        self.inner.append(state, place, kind)


@pytest.mark.parametrize(("name", "nullity"), [("ekf", 2), ("fej", 3), ("oc", 3), ("ideal", 3)])
@pytest.mark.parametrize("scenario", SENSORS)
def test_the_frame_of_the_map_is_unobservable(name: str, nullity: int, scenario: str) -> None:
    """Rank of the local observability matrix, over the second loop; the standard EKF fails it."""
    world = short_world(scenario, 420)
    inner: dict[str, Linearisation] = {
        "ekf": Linearisation(),
        "fej": FirstEstimates(),
        "oc": ObservabilityConstrained(),
        "ideal": AtTruth(world.pose, world.control, world.landmark[world.first_seen]),
    }
    noted = Noted(inner[name])
    filter_ = BatchEkf(world.robot, noted, 1, len(world.landmark))
    data = measure(world, range(7, 8))
    drive(filter_, world, data, 300)
    n = filter_.state.mean.shape[1]
    noted.events.clear()
    for k in range(300, 420):
        filter_.predict(data.control[:, k])
        if len(world.seen[k]):
            filter_.observe(data.z[k], world.sigma[k], world.seen[k])
    assert filter_.state.mean.shape[1] == n
    phi, rows = np.eye(n), []
    for landmark_index, points in noted.events:
        if landmark_index is None:
            phi[:2] += np.array((-points[1], points[0]))[:, None] * phi[2]
        else:
            heading, offset = points
            matrix = world.robot.sensor.by_offset(heading[:, None], offset)
            rows.append(measured(matrix, offset, landmark_index, phi[None])[0])
    seen = np.unique(np.concatenate([s for s, _ in noted.events if s is not None]))
    columns = np.concatenate((np.arange(3), *((3 + 2 * s, 4 + 2 * s) for s in seen)))
    values = np.linalg.svd(np.concatenate(rows)[:, columns], compute_uv=False)
    assert int((values < 1e-9 * values[0]).sum()) == nullity


def test_a_dropped_correlation_is_seen() -> None:
    """The oracle rejects a filter that forgets how landmarks hang on the heading."""
    world = short_world("circle", 60)
    data = measure(world, range(1))
    right, wrong = FILTERS["ekf"](world, 1), FILTERS["ekf"](world, 1)
    for k in range(60):
        for filter_ in (right, wrong):
            filter_.predict(data.control[:, k])
            filter_.observe(data.z[k], world.sigma[k], world.seen[k])
        wrong.state.covariance[:, 2, 3:] = wrong.state.covariance[:, 3:, 2] = 0.0
    assert np.abs(right.state.mean - wrong.state.mean).max() > 1e-4


def test_a_lost_run_leaves_the_others_alone() -> None:
    rng = np.random.default_rng(5)
    state = BatchState(np.zeros(3), random_covariance(rng, 3), 2, 1)
    nothing = np.zeros((2, 1, 2))
    state.augment(nothing + 1.0, nothing + 1.0, np.tile(np.eye(2), (2, 1, 1, 1)))
    state.covariance[1] *= -1.0
    matrix = np.tile(np.eye(2), (2, 1, 1, 1))
    state.update(np.array([0]), matrix, nothing + 1.0, nothing + 0.1, np.full((1, 2), 0.01))
    assert state.lost.tolist() == [False, True]
    assert np.isfinite(state.mean[0]).all()
