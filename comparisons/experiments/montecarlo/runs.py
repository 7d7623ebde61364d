"""A chunk of runs through one filter: errors and NEES along the way."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.experiments.scenarios.world import ScenarioWorld, WorldMeasurements
from comparisons.experiments.variants.batch_ekf import BatchEkf, BatchFilter, BatchInvariantEkf
from comparisons.experiments.variants.linearisation import AtTruth
from comparisons.statistics import squared_distance
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.linearisation import (
    FirstEstimates,
    Linearisation,
    ObservabilityConstrained,
)

_MOST_RECORDS = 500

FILTERS: dict[str, Callable[[ScenarioWorld, int], BatchFilter]] = {
    "ekf": lambda w, runs: BatchEkf(w.robot, Linearisation(), runs, len(w.landmark)),
    "fej": lambda w, runs: BatchEkf(w.robot, FirstEstimates(), runs, len(w.landmark)),
    "oc": lambda w, runs: BatchEkf(w.robot, ObservabilityConstrained(), runs, len(w.landmark)),
    "riekf": lambda w, runs: BatchInvariantEkf(w.robot, runs, len(w.landmark)),
    "ideal": lambda w, runs: BatchEkf(
        w.robot, AtTruth(w.pose, w.control, w.landmark[w.first_seen]), runs, len(w.landmark)
    ),
}


class RunRecords(NamedTuple):
    """Runs (B) by recorded steps (T). NaN from where a run was lost.

    NEES of the pose is in the filter's own error coordinates; the others are of additive errors.
    landmarks: NEES and squared error, each the mean over the landmarks mapped so far.
    """

    pose_nees: Array
    position_nees: Array
    heading_nees: Array
    landmark_nees: Array
    position_square: Array
    heading_square: Array
    landmark_square: Array


def recorded_steps(steps: int) -> list[int]:
    """Steps (from 1) after which errors are recorded: at most 500, evenly, the last among them."""
    stride = -(-steps // _MOST_RECORDS)
    return list(range(steps, 0, -stride))[::-1]


def run_filter(name: str, world: ScenarioWorld, data: WorldMeasurements) -> RunRecords:
    """One filter over the measurements of some runs."""
    runs, steps = data.control.shape[:2]
    filter_ = FILTERS[name](world, runs)
    wanted = {step: column for column, step in enumerate(recorded_steps(steps))}
    records = RunRecords(*(np.full((runs, len(wanted)), np.nan) for _ in RunRecords._fields))
    for k in range(steps):
        filter_.predict(data.control[:, k])
        if len(world.seen[k]):
            filter_.observe(data.z[k], world.sigma[k], world.seen[k])
        if (column := wanted.get(k + 1)) is not None:
            for figure, values in zip(records, _errors(filter_, world, k + 1), strict=True):
                figure[:, column] = np.where(filter_.state.lost, np.nan, values)
    return records


def _errors(filter_: BatchFilter, world: ScenarioWorld, step: int) -> RunRecords:
    state, truth = filter_.state, world.pose[step]
    error, covariance = state.pose_error(truth)
    covariance[state.lost] = np.eye(3)
    pose_nees = squared_distance(error, covariance)
    additive = state.pose_covariance()
    additive[state.lost] = np.eye(3)
    position = truth[:2] - state.pose[:, :2]
    heading = wrap_angle(truth[2] - state.pose[:, 2])
    runs = len(heading)
    landmark_nees = landmark_square = np.full(runs, np.nan)
    if len(filter_.label):
        missed = world.landmark[filter_.label] - state.landmarks
        own = state.landmark_covariance()
        own[state.lost] = np.eye(2)
        each = squared_distance(missed.reshape(-1, 2), own.reshape(-1, 2, 2))
        landmark_nees = each.reshape(runs, -1).mean(axis=1)
        landmark_square = (missed**2).sum(axis=2).mean(axis=1)
    return RunRecords(
        pose_nees,
        squared_distance(position, additive[:, :2, :2]),
        heading**2 / additive[:, 2, 2],
        landmark_nees,
        (position**2).sum(axis=1),
        heading**2,
        landmark_square,
    )
