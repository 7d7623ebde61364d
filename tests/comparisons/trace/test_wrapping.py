"""A filter that is recorded in one line gives the trace that it would give by hand."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.audit.audit import Audit, audit
from comparisons.errors import InputError
from comparisons.trace.events import Predict, Update
from comparisons.trace.reader import TraceReader
from ekf_reference.core.geometry import wrap_angle
from slamcheck import record

F = np.eye(4)
F[:2, 2:] = 0.1 * np.eye(2)
Q, R = 0.01 * np.eye(4), 0.04 * np.eye(2)
BLOCKS = {"position": 2, "velocity": 2}
STEPS = 40


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.trace"


def faults(found: Audit) -> list[str]:
    """Of the algebra and the gains; these measurements are none of the filter's model."""
    checks = ("algebra", "covariance", "correction", "gain")
    return [one.text for one in found.findings if one.check in checks]


def polar(x: Array) -> Array:
    """Range and bearing."""
    return np.array([np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])])


def polar_jacobian(x: Array) -> Array:
    r = np.hypot(x[0], x[1])
    h = np.zeros((2, 4))
    h[:, :2] = [[x[0] / r, x[1] / r], [-x[1] / r**2, x[0] / r**2]]
    return h


def measurements(seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal([5.0, 4.0], 0.2, (STEPS, 2))


class Mine:
    """A filter of one's own. forget: P is not updated at this step."""

    def __init__(self, forget: int = -1) -> None:
        self.x, self.P = np.array([5.0, 4.0, 0.0, 0.0]), np.eye(4)
        self.step, self.forget = 0, forget

    def F(self, dt: float) -> Array:  # noqa: N802
        f = np.eye(4)
        f[:2, 2:] = dt * np.eye(2)
        return f

    def Q(self, dt: float) -> Array:  # noqa: N802
        return Q * dt

    def H(self, z: Array) -> Array:  # noqa: N802
        return np.eye(2, 4)

    def R(self, z: Array) -> Array:  # noqa: N802
        return R

    def residual(self, z: Array) -> Array:
        return np.asarray(z - self.x[:2])

    def predict(self, dt: float) -> None:
        f = self.F(dt)
        self.x, self.P = f @ self.x, f @ self.P @ f.T + self.Q(dt)

    def update(self, z: Array) -> str:
        h = self.H(z)
        k = self.P @ h.T @ np.linalg.inv(h @ self.P @ h.T + R)
        self.x = self.x + k @ self.residual(z)
        if self.step != self.forget:
            self.P = self.P - k @ h @ self.P
        self.step += 1
        return "done"


def drive(mine: Mine, path: Path) -> Audit:
    with record(mine, path, blocks=BLOCKS, sensor="gps") as trace:
        for k, z in enumerate(measurements()):
            trace.at(0.1 * k)
            mine.predict(dt=0.1)
            assert mine.update(z) == "done"
    return audit(path)


def test_a_filter_of_ones_own_is_recorded(path: Path) -> None:
    found = drive(Mine(), path)
    assert not faults(found)
    assert (found.events, found.updates, found.snapshots) == (
        1 + 1 + 4 * STEPS,
        STEPS,
        1 + 2 * STEPS,
    )
    assert [one.sensor for one in found.sensors] == ["gps"]
    assert found.gains_compared == STEPS
    events: list[Any] = list(TraceReader(path))
    prior, _, predict, _, update, *_ = events
    assert isinstance(update, Update)
    assert prior.blocks == ("position", "velocity")
    assert predict.after.tolist() == [5.0, 4.0, 0.0, 0.0]
    assert predict.noise.tolist() == (0.1 * Q).tolist()


def test_its_fault_is_found(path: Path) -> None:
    found = drive(Mine(forget=7), path)
    assert faults(found)
    assert "the covariance was not updated" in found.findings[0].text
    assert found.findings[0].event == 2 + 4 * 7 + 2


def test_a_linear_filter_of_filterpy_is_recorded(path: Path) -> None:
    kalman = pytest.importorskip("filterpy.kalman")
    kf = kalman.KalmanFilter(4, 2)
    kf.F, kf.Q, kf.H, kf.R = F, Q, np.eye(2, 4), R
    with record(kf, path):
        for k, z in enumerate(measurements()):
            kf.predict(*(() if k % 3 else (None, None, F @ F, 0.5)))
            kf.update(z if k % 7 else None)
            if k % 5 == 0:
                kf.update(z[:, None], R=2.0, H=np.eye(2, 4, 2))
    found = audit(path)
    assert not faults(found)
    assert found.updates == found.gains_compared == 34 + 8


def test_a_linear_filter_that_forgets_is_not(path: Path) -> None:
    """The fading memory is a part of F."""
    kalman = pytest.importorskip("filterpy.kalman")
    kf = kalman.KalmanFilter(4, 2)
    kf.F, kf.Q, kf.H, kf.R, kf.alpha = F, Q, np.eye(2, 4), R, 1.02
    with record(kf, path):
        for z in measurements():
            kf.predict()
            kf.update(z)
    assert not faults(audit(path))


def test_an_extended_filter_of_filterpy_is_recorded(path: Path) -> None:
    kalman = pytest.importorskip("filterpy.kalman")
    ekf = kalman.ExtendedKalmanFilter(4, 2)
    ekf.F, ekf.Q, ekf.R, ekf.x = F, Q, R, np.array([5.0, 4.0, 0.0, 0.0])
    with record(ekf, path, blocks=BLOCKS):
        for z in measurements():
            ekf.predict()
            ekf.update(polar(z), polar_jacobian, polar)
    found = audit(path)
    assert not faults(found)
    assert [one.sensor for one in found.sensors] == ["polar"]


def test_an_unscented_filter_of_filterpy_is_recorded(path: Path) -> None:
    kalman = pytest.importorskip("filterpy.kalman")
    points = kalman.MerweScaledSigmaPoints(4, 0.5, 2.0, 0.0)
    ukf = kalman.UnscentedKalmanFilter(4, 2, 0.1, polar, lambda x, dt: F @ x, points)
    ukf.Q, ukf.R, ukf.x = Q, R, np.array([5.0, 4.0, 0.0, 0.0])
    with record(ukf, path, blocks=BLOCKS):
        for z in measurements():
            ukf.predict()
            ukf.update(polar(z))
    assert not faults(audit(path))
    predicted = next(one for one in TraceReader(path) if isinstance(one, Predict))
    np.testing.assert_allclose(predicted.jacobian, F, atol=1e-9)
    np.testing.assert_allclose(predicted.noise, Q, atol=1e-9)


def test_an_angle_that_an_unscented_filter_wraps_is_corrected_by_little(path: Path) -> None:
    """From 3.1 rad across pi: by the filter's own difference, not by nearly a turn."""
    kalman = pytest.importorskip("filterpy.kalman")

    class Compass(kalman.UnscentedKalmanFilter):  # type: ignore[misc, name-defined]
        x: Any

        def update(self, z: Array) -> None:
            super().update(z)
            self.x = wrap_angle(self.x)

    def less(first: Array, second: Array) -> Array:
        return wrap_angle(first - second)

    points = kalman.MerweScaledSigmaPoints(1, 0.5, 2.0, 2.0)
    ukf = Compass(1, 1, 0.1, lambda x: x, lambda x, dt: x, points, residual_x=less, residual_z=less)
    ukf.x, ukf.P = np.array([3.1]), 0.01 * np.eye(1)
    ukf.Q, ukf.R = 1e-4 * np.eye(1), 0.01 * np.eye(1)
    with record(ukf, path, blocks={"heading": 1}):
        ukf.predict()
        ukf.update(np.array([3.2]))
    assert ukf.x[0] < -3.1
    update = next(one for one in TraceReader(path) if isinstance(one, Update))
    assert update.correction == pytest.approx([0.1 * 0.0101 / 0.0201], rel=1e-6)


@dataclass
class State:
    """As Stone Soup's GaussianState, GaussianStatePrediction and GaussianStateUpdate."""

    state_vector: Array
    covar: Array
    timestamp: datetime
    prior: State | None = None


class Linear:
    """As its linear models."""

    def __init__(self, matrix: Array, covar: Array) -> None:
        self._matrix, self._covar = matrix, covar

    def matrix(self, **_: Any) -> Array:
        return self._matrix

    def covar(self, **_: Any) -> Array:
        return self._covar


class Polar(Linear):
    """As its measurement models that are not linear."""

    def __init__(self) -> None:
        super().__init__(np.eye(2, 4), R)

    def jacobian(self, state: State, **_: Any) -> Array:
        return polar_jacobian(state.state_vector[:, 0])


@dataclass
class Detection:
    """As its Detection."""

    state_vector: Array
    measurement_model: Any = None


@dataclass
class Hypothesis:
    """As its SingleHypothesis."""

    prediction: State
    measurement: Detection
    measurement_prediction: Any = None


@dataclass
class Predictor:
    """As its KalmanPredictor."""

    transition_model: Linear = field(default_factory=lambda: Linear(F, Q))

    def predict(self, prior: State, timestamp: datetime) -> State:
        x, p = F @ prior.state_vector, F @ prior.covar @ F.T + Q
        return State(x, p, timestamp, prior)


@dataclass
class Updater:
    """As its ExtendedKalmanUpdater. double: R is taken twice."""

    measurement_model: Any = field(default_factory=Polar)
    double: bool = False

    def update(self, hypothesis: Hypothesis) -> State:
        seen = hypothesis.prediction
        h = self.measurement_model.jacobian(seen)
        predicted = polar(seen.state_vector[:, 0])[:, None]
        hypothesis.measurement_prediction = Detection(predicted)
        k = seen.covar @ h.T @ np.linalg.inv(h @ seen.covar @ h.T + (1.0 + self.double) * R)
        x = seen.state_vector + k @ (hypothesis.measurement.state_vector - predicted)
        return State(x, seen.covar - k @ h @ seen.covar, seen.timestamp)


def track(path: Path, updater: Updater) -> None:
    """Every third prediction is not updated; others lead nowhere."""
    predictor, start = Predictor(), datetime(2024, 1, 1)
    state = State(np.array([[5.0], [4.0], [0.0], [0.0]]), np.eye(4), start)
    with record((predictor, updater), path, blocks=BLOCKS):
        for k, z in enumerate(measurements(), 1):
            at = start + timedelta(seconds=0.1 * k)
            predictor.predict(state, at + timedelta(seconds=1.0))
            state = predictor.predict(state, at)
            if k % 3:
                state = updater.update(Hypothesis(state, Detection(polar(z)[:, None])))


def test_a_track_of_stone_soup_is_recorded(path: Path) -> None:
    track(path, Updater())
    found = audit(path)
    assert not faults(found)
    assert found.updates == 27
    assert [one.sensor for one in found.sensors] == ["Polar"]
    kinds = [type(event).__name__ for event in TraceReader(path)]
    assert kinds.count("Predict") == STEPS, "those that lead nowhere are left out"
    times = [event.time_s for event in TraceReader(path) if event.time_s is not None]
    assert times == sorted(times)


def test_a_faulty_updater_of_stone_soup_is_found(path: Path) -> None:
    track(path, Updater(double=True))
    assert faults(audit(path))


def test_another_track_is_refused(path: Path) -> None:
    predictor, updater, at = Predictor(), Updater(), datetime(2024, 1, 1)
    detected = Detection(polar(measurements()[0])[:, None])
    with record((predictor, updater), path):
        for number in range(2):
            begun = State(np.array([[5.0], [4.0], [0.0], [0.0]]), np.eye(4), at)
            hypothesis = Hypothesis(predictor.predict(begun, at), detected)
            if number:
                with pytest.raises(InputError, match="is not of the track that is recorded"):
                    updater.update(hypothesis)
            else:
                updater.update(hypothesis)


@pytest.mark.parametrize("thing", [object(), 7, (1, 2), np.eye(2), Updater()])
def test_what_is_no_filter_is_refused_before_a_file_is_made(thing: Any, path: Path) -> None:
    with pytest.raises(InputError, match="is no filter that can be recorded; expected a Kalman"):
        record(thing, path)
    assert not path.exists()


def test_a_recording_ends_with_the_process(path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; import slamcheck\n"
        "from tests.comparisons.trace.test_wrapping import Mine, measurements\n"
        "mine = Mine(); slamcheck.record(mine, sys.argv[1])\n"
        "mine.predict(0.1); mine.update(measurements()[0])\n"
    )
    subprocess.run((sys.executable, "-c", code, path), check=True)
    assert TraceReader(path).counts == (6, 1, 3)
