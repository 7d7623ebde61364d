"""Tables of results as pandas data frames; pandas is imported when one is asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.checks.agreement import BlockAgreement, LandmarkAgreement
from comparisons.checks.consistency.nees import TruthConsistency
from comparisons.checks.pair_of_estimates import EstimateComparison
from comparisons.config import JobConfig
from comparisons.errors import InputError, quoted
from comparisons.estimates.estimate import Estimate
from comparisons.figures import stored
from comparisons.innovations import SensorInnovations
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log
from comparisons.logs.schema import LANDMARKS, POSES, RELATIVE
from comparisons.pipeline.solve import Solution
from comparisons.report.check import CheckReport, check_ladder
from comparisons.report.destination import leaves
from comparisons.report.ladder import ladder
from comparisons.report.run import RunReport
from comparisons.words import Cause

if TYPE_CHECKING:
    from pandas import DataFrame

Columns = Mapping[str, Any] | Sequence[Mapping[str, Any]]
"""Columns by name, or rows."""
Tables = Mapping[str, Callable[[], Columns]]
"""What builds each table, by its name."""


def data_frame(tables: Tables, table: str) -> DataFrame:
    """Return one of several tables as a data frame. Raises InputError."""
    if table not in tables:
        raise InputError(f"table {quoted(table)} is unknown, expected one of {', '.join(tables)}")
    try:
        from pandas import DataFrame
    except ImportError:
        raise InputError("to_pandas() needs pandas: pip install pandas") from None
    return DataFrame(tables[table]())


@singledispatch
def tables(result: object) -> Tables:
    """Return what `to_pandas` of a result offers."""
    raise TypeError(f"a {type(result).__name__} has no tables")


def frame(result: object, table: str) -> DataFrame:
    """Return one of a result's tables as a data frame. Raises InputError."""
    return data_frame(tables(result), table)


def pose_columns(time_s: Array, pose: Array, covariance: Array | None = None) -> dict[str, Any]:
    """Return columns of poses (K, 3), with standard deviations of covariances (K, 3, 3)."""
    found: dict[str, Any] = {"time_s": time_s}
    found |= dict(zip(POSES.values, pose.T, strict=True))
    if covariance is not None:
        names = ("sigma_x_m", "sigma_y_m", "sigma_heading_rad")
        found |= dict(zip(names, _sigmas(covariance).T, strict=True))
    return found


def landmark_columns(ids: Index, position: Array, covariance: Array | None) -> dict[str, Any]:
    """Return columns of landmarks (L, 2), with what covariances (L, 2, 2) say."""
    found: dict[str, Any] = dict(zip(LANDMARKS.needed, (ids, *position.T), strict=True))
    if covariance is not None:
        sigma = _sigmas(covariance)
        found |= {"sigma_x_m": sigma[:, 0], "sigma_y_m": sigma[:, 1]}
        found["cov_xy_m2"] = covariance[:, 0, 1]
    return found


def _sigmas(covariance: Array) -> Array:
    """(N, d) roots of the diagonals of (N, d, d), NaN where one is negative."""
    variance = np.einsum("nii->ni", covariance)
    result: Array = np.sqrt(np.where(variance >= 0.0, variance, np.nan))
    return result


@tables.register
def estimate_tables(e: Estimate) -> Tables:
    """Return what `Estimate.to_pandas` offers."""

    def landmarks() -> Columns:
        covariance = e.landmark_covariances()
        known = len(covariance) == len(e.landmark)  # not of an external estimate without any
        found = landmark_columns(e.landmark_id, e.landmark, covariance if known else None)
        if e.labels:
            found |= {"label": np.array(e.names, dtype=object)}
        if not len(e.pose_landmarks):
            return found
        own = e.pose_landmark_covariances()[:, :2, :2]
        more = landmark_columns(e.pose_landmark_id, e.pose_landmarks[:, :2], own)
        more |= {"label": np.full(len(own), "", dtype=object)} if e.labels else {}
        both = {name: np.concatenate((found[name], more[name])) for name in found}
        heading = np.full(len(e.landmark), np.nan)
        return {**both, "heading_rad": np.concatenate((heading, e.pose_landmarks[:, 2]))}

    return {
        "poses": lambda: pose_columns(e.time_s, e.pose, e.pose_covariance),
        "landmarks": landmarks,
    }


@tables.register
def pair_tables(pair: EstimateComparison) -> Tables:
    """Return what `EstimateComparison.to_pandas` offers."""

    def columns(first: dict[str, Any], difference: Array, nees: Array) -> Columns:
        components = dict(zip(RELATIVE.values, difference.T, strict=False))
        return {**first, **components, "nees": nees}

    return {
        "poses": lambda: columns({"time_s": pair.time_s}, pair.difference, pair.nees),
        "landmarks": lambda: columns(
            {"label": list(pair.landmark)}, pair.landmark_difference, pair.landmark_nees
        ),
    }


@tables.register
def log_tables(log: Log) -> Tables:
    """Return what `Log.to_pandas` offers."""

    def true_poses() -> Columns:
        poses = log.truth.poses
        return {} if poses is None else pose_columns(poses.time_s, poses.pose)

    def true_landmarks() -> Columns:
        true = log.truth.landmarks
        return {} if true is None else landmark_columns(true.id, true.position_m, true.covariance)

    return {
        "odometry": lambda: _columns(log.odometry),
        "measurements": lambda: _columns(log.measurements),
        "positions": lambda: {} if log.positions is None else _columns(log.positions),
        "truth": true_poses,
        "truth_landmarks": true_landmarks,
    }


def _columns(stream: object) -> dict[str, Any]:
    """The arrays (N, ...) of a stream as columns; an array's further indices are in its name."""
    found: dict[str, Any] = {}
    for name, value in vars(stream).items():
        if isinstance(value, np.ndarray):
            for index in np.ndindex(value.shape[1:]):
                column = "_".join((name, "".join(map(str, index)))) if index else name
                found[column] = value[(slice(None), *index)]
    return found


@tables.register
def comparison_tables(c: Comparison) -> Tables:
    """Return what `Comparison.to_pandas` offers."""

    def landmarks() -> Columns:
        return [_landmark(block) for block in c.agreement.landmarks]

    return {
        "gaps": lambda: [asdict(step) for step in ladder(RunReport.build(c))],
        "landmarks": landmarks,
        "nees": lambda: _nees({"ekf": c.consistency.ekf, "smoother": c.consistency.smoother}),
        "nis": lambda: _nis(c.consistency.sensors),
        "causes": lambda: _causes(c.verdict.causes),
        "settings": lambda: _settings(c.prepared.config),
    }


@tables.register
def check_tables(c: ExternalCheck) -> Tables:
    """Return what `ExternalCheck.to_pandas` offers."""
    given, agreement = c.given, c.agreement

    def landmarks() -> Columns:
        return [_landmark(block) for block in agreement.landmarks]

    return {
        "gaps": lambda: [asdict(step) for step in check_ladder(CheckReport.build(c))],
        "poses": lambda: pose_columns(given.time_s, given.pose, given.pose_covariance),
        "landmarks": landmarks,
        "nees": lambda: _nees({"estimate": c.consistency.ekf, "smoother": c.consistency.smoother}),
        "causes": lambda: _causes(c.causes),
        "settings": lambda: _settings(c.solution.prepared.config),
    }


@tables.register
def solution_tables(s: Solution) -> Tables:
    """Return what `Solution.to_pandas` offers."""
    return {
        **estimate_tables(s.estimate),
        "settings": lambda: _settings(s.prepared.config),
    }


def _nees(estimates: Mapping[str, TruthConsistency | None]) -> Columns:
    """NEES of the poses by instant, with the 95 % band of one value."""
    rows = []
    for name, consistency in estimates.items():
        if consistency is None or consistency.poses is None:
            continue
        p = consistency.poses
        band = p.pose.single_band
        at = p.time_s[p.pose.row].tolist()
        rows += [
            {"estimate": name, "time_s": t, "nees": nees, "low": band.low, "high": band.high}
            for t, nees in zip(at, p.pose.squared.tolist(), strict=True)
        ]
    return rows


def _nis(sensors: Sequence[SensorInnovations]) -> Columns:
    """Mean NIS over stretches of the run, by sensor, each with its 95 % band."""
    return [
        {"sensor": sensor.sensor, "time_s": t, "nis": mean, "low": low, "high": high}
        for sensor in sensors
        for t, mean, low, high in np.column_stack(
            (sensor.windows.time_s, sensor.windows.mean, sensor.windows.low, sensor.windows.high)
        ).tolist()
    ]


def _landmark(block: LandmarkAgreement) -> Mapping[str, Any]:
    return {"id": block.id, **stored(block, BlockAgreement)}


def _causes(causes: Sequence[Cause]) -> Columns:
    return {name: [getattr(c, name) for c in causes] for name in ("gap", "evidence", "hint")}


def _settings(config: JobConfig) -> Columns:
    """Every setting with its value and its default."""
    usual = dict(leaves(type(config).of().model_dump()))
    return [
        {"setting": name, "value": value, "default": usual.get(name)}
        for name, value in leaves(config.model_dump())
    ]
