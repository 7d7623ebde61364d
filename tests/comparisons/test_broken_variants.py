"""Planted defects: each turns the right gap red and leaves the other green."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from comparisons.checks.attribution import ROUNDING
from comparisons.compare import compare_estimators
from comparisons.logs.log import Log
from ekf_reference.full_ekf import FullEkf
from ekf_reference.kalman import Array, Correction, Index, KalmanState
from ekf_reference.motion import MotionModel, MotionStep
from ekf_reference.observation import PredictedSightings, RangeBearing
from tests.helpers import simulated


class NoCrossAtAugmentation(KalmanState):
    """New landmarks know the vehicle but not the map."""

    def augment(
        self, point: Array, jacobian_pose: Array, jacobian_sighting: Array, noise: Array
    ) -> None:
        n = self._size
        super().augment(point, jacobian_pose, jacobian_sighting, noise)
        self._covariance[3:n, n : self._size] = 0.0
        self._covariance[n : self._size, 3:n] = 0.0


class NoCrossAtPrediction(KalmanState):
    """The vehicle moves, its covariance with the map does not."""

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        n = self._size
        cross = self._covariance[:3, 3:n].copy()
        super().predict(pose, jacobian_pose, noise)
        self._covariance[:3, 3:n] = cross
        self._covariance[3:n, :3] = cross.T


class GainNotTransposed(KalmanState):
    """Joseph's form with (I - W H) where its transpose belongs."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        n = self._size
        p = self._covariance[:n, :n].copy()
        h = np.zeros((len(jacobian), n))
        np.add.at(h.T, columns, jacobian.T)
        w = p @ h.T @ np.linalg.inv(h @ p @ h.T + noise)
        keep = np.eye(n) - w @ h
        done = super().update(columns, jacobian, innovation, noise)
        broken = keep @ p @ keep + w @ noise @ w.T
        self._covariance[:n, :n] = 0.5 * (broken + broken.T)
        return done


class PrintedBearingRow(RangeBearing):
    """N 2.42 as printed."""

    def predict(self, pose: Array, landmarks: Array) -> PredictedSightings:
        z, jacobian_pose, jacobian_landmark = super().predict(pose, landmarks)
        jacobian_pose[:, 1, :2] *= -1.0
        jacobian_landmark[:, 1] *= -1.0
        return PredictedSightings(z, jacobian_pose, jacobian_landmark)


class UnwrappedInnovation(RangeBearing):
    """z - z_hat as numbers."""

    def innovation(self, z: Array, predicted: Array) -> Array:
        return z - predicted


class SigmaSquaredTwice(RangeBearing):
    """R from variances that were squared again."""

    def noise(self, sigma: Array) -> Array:
        return super().noise(sigma**2)


@dataclass(frozen=True)
class SteeringSign:
    """Steering positive to the right."""

    model: MotionModel

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        step = self.model.step(pose, control * (1.0, -1.0), duration_s)
        return MotionStep(step.pose, step.jacobian_pose, step.jacobian_control * (1.0, -1.0))


def with_state(state: type[KalmanState]) -> Callable[[FullEkf], None]:
    def modify(ekf: FullEkf) -> None:
        ekf.state = state(ekf.state.pose, np.array(ekf.state.covariance))

    return modify


def with_observation(observation: RangeBearing) -> Callable[[FullEkf], None]:
    def modify(ekf: FullEkf) -> None:
        ekf.observation = observation

    return modify


def turn_steering(ekf: FullEkf) -> None:
    ekf.motion = SteeringSign(ekf.motion)


class NoHeadingColumn(RangeBearing):
    """The bearing's Jacobian forgets that the vehicle turns."""

    def predict(self, pose: Array, landmarks: Array) -> PredictedSightings:
        z, jacobian_pose, jacobian_landmark = super().predict(pose, landmarks)
        jacobian_pose[:, :, 2] = 0.0
        return PredictedSightings(z, jacobian_pose, jacobian_landmark)


DEFECTS: dict[str, tuple[str, Callable[[FullEkf], None]]] = {
    "cross-covariance dropped at augmentation": ("algebra", with_state(NoCrossAtAugmentation)),
    "cross-covariance dropped at prediction": ("algebra", with_state(NoCrossAtPrediction)),
    "gain not transposed": ("algebra", with_state(GainNotTransposed)),
    "bearing Jacobian as printed": ("model", with_observation(PrintedBearingRow())),
    "innovation not wrapped": ("model", with_observation(UnwrappedInnovation())),
    "sigma squared twice": ("model", with_observation(SigmaSquaredTwice())),
    "steering sign": ("model", turn_steering),
    "no heading column": ("model", with_observation(NoHeadingColumn())),
}
NAMED_FIRST = {
    "bearing Jacobian as printed": ("the innovation", "uses of sightings"),
    "innovation not wrapped": ("the innovation", "uses of sightings"),
    "sigma squared twice": ("the noise covariance", "uses of sightings"),
    "steering sign": ("the predicted pose", "steps"),
    "no heading column": ("the Jacobian by heading", "uses of sightings"),
}


@pytest.fixture(scope="module")
def log() -> Log:
    """Long enough for the heading to pass pi, so that an unwrapped innovation shows."""
    return simulated(seed=4, loop_s=60.0)


def test_the_sound_filter_is_green(log: Log) -> None:
    comparison = compare_estimators(log)
    assert comparison.verdict.outcome == "agree"
    assert comparison.agreement.algebra.within(1e-8)
    assert comparison.agreement.model.within(1e-8)


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_turns_its_gap_red_and_only_that(name: str, log: Log) -> None:
    gap, modify = DEFECTS[name]
    comparison = compare_estimators(log, modify=modify)
    agreement = comparison.agreement
    red, green = (
        (agreement.algebra, agreement.model)
        if gap == "algebra"
        else (agreement.model, agreement.algebra)
    )
    assert max(red.sigma, red.covariance) > 1e3 * ROUNDING
    assert green.within(ROUNDING), f"{green}"
    assert comparison.verdict.outcome == "disagree"
    assert [cause.gap for cause in comparison.verdict.causes] == [gap]
    if gap == "model":
        quantity, relation = NAMED_FIRST[name]
        first = comparison.verdict.causes[0].evidence.split("; ")[1]
        how = "is missing" if name == "no heading column" else "differs"
        assert first.startswith(f"{quantity} {how}")
        assert first.endswith(relation)
