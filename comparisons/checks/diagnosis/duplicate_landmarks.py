"""Landmarks that an estimate has twice: two of one place, of which the optimum has only one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array
from comparisons.checks.diagnosis.trace_recursion import TraceRecursion
from comparisons.checks.grade import Likeness
from comparisons.estimates.external import ExternalEstimate
from comparisons.logs.log import Log
from comparisons.statistics import chi2_quantile
from comparisons.words import Cause
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.layout import Layout
from ekf_reference.core.trace import MeasurementRecords
from ekf_reference.models.range_bearing import RangeBearing

_NEAR_SIGMA = 5.0
"""A landmark that the reference does not have, no farther from another by the covariance of their
difference, is that one: each of the two has a part of the measurements, and errs on its own."""
_FITS = float(chi2_quantile(0.999, 2))
_NAMED = 4
"""Pairs that a sentence names."""


@dataclass(frozen=True)
class Beginning:
    """The measurement that began a landmark, beside one that was in the map by then.

    number: in the log. bearing_rad: measured. turns: by how many whole turns it differs from the
    expected one before it is wrapped.
    """

    number: int
    bearing_rad: float
    turns: int


@dataclass(frozen=True)
class Duplicate:
    """Two landmarks at one place.

    first, second: their ids, the older one first. sigma: between them, by their covariance.
    distance_m: likewise. beginning: of the second, where it fits the first; None where it does
    not, or no trace shows it.
    """

    first: int
    second: int
    sigma: float
    distance_m: float
    beginning: Beginning | None = None

    def __str__(self) -> str:
        """Return it as evidence."""
        said = (
            f"landmark {self.second} lies at landmark {self.first} ({self.distance_m:.2g} m, "
            f"{self.sigma:.2g} sigma)"
        )
        if self.beginning is None:
            return said
        began = (
            f"{said}; measurement {self.beginning.number}, which began it, fits landmark "
            f"{self.first}"
        )
        if not self.beginning.turns:
            return began
        degrees = np.degrees(self.beginning.bearing_rad)
        return f"{began} once the difference of bearings is wrapped (bearing {degrees:.1f} degrees)"


def duplicate_cause(found: list[Duplicate]) -> Cause:
    """Return the cause that names landmarks which are in the map twice."""
    listed = "; ".join(str(duplicate) for duplicate in found[:_NAMED])
    several = f"{len(found)} landmarks are" if len(found) > 1 else "1 landmark is"
    wrapped = any(
        duplicate.beginning is not None and duplicate.beginning.turns for duplicate in found
    )
    hint = (
        "check the association, which begins a landmark that is in the map already"
        if not wrapped
        else "wrap the difference of bearings where measurements are associated"
    )
    return Cause("association", f"{several} in the map twice: {listed}", hint)


def duplicates(
    given: ExternalEstimate, near: Likeness, log: Log, run: EkfRun | None
) -> list[Duplicate]:
    """Return landmarks which the reference does not have, and that lie at others.

    Args:
        given: The estimate.
        near: It beside a reference whose map is right.
        log: Whose measurements it used.
        run: What its trace shows; None without one.
    """
    if given.landmark is None or given.landmark_id is None or given.landmark_covariance is None:
        return []
    pairs: list[tuple[int, int, float]] = []
    for more in np.setdiff1d(np.arange(len(given.landmark)), near.ours).tolist():
        other, sigma = _nearest(given, given.landmark, more)
        if other != more:
            pairs.append((*_in_order(run, more, other), sigma))
    beginnings = {} if run is None else _beginnings(log, run, pairs)
    return [
        Duplicate(
            first=int(given.landmark_id[first]),
            second=int(given.landmark_id[second]),
            sigma=sigma,
            distance_m=float(np.linalg.norm(given.landmark[first] - given.landmark[second])),
            beginning=beginnings.get((first, second)),
        )
        for first, second, sigma in pairs
        if sigma <= _NEAR_SIGMA or (first, second) in beginnings
    ]


def _nearest(given: ExternalEstimate, landmark: Array, row: int) -> tuple[int, float]:
    """The landmark (L, 2) that lies nearest to one, by the covariance of their difference."""
    best, least = row, np.inf
    for other in range(len(landmark)):
        difference = landmark[other] - landmark[row]
        if other == row:
            continue
        try:
            squared = float(difference @ np.linalg.solve(_between(given, row, other), difference))
        except np.linalg.LinAlgError:
            continue
        if 0.0 <= squared < least:
            best, least = other, squared
    return best, float(np.sqrt(least))


def _between(given: ExternalEstimate, row: int, other: int) -> Array:
    """(2, 2) covariance of the difference of two landmarks."""
    own = given.landmark_covariance
    total: Array = np.zeros((2, 2)) if own is None else own[row] + own[other]
    joint = given.joint_covariance
    if joint is None or given.landmark is None:
        return total
    layout = Layout.packed(3, len(given.landmark))
    i, j = (layout.columns(np.array([one]))[3:] for one in (row, other))
    cross = joint[np.ix_(i, j)]
    return total - cross - cross.T


def _in_order(run: EkfRun | None, one: int, other: int) -> tuple[int, int]:
    """Two landmarks by when they began; by their place in the map without a trace."""
    if run is None:
        return min(one, other), max(one, other)
    new = run.trace.initialisations[POINT]
    order = dict(zip(new.landmark_index.tolist(), range(len(new.step)), strict=True))
    return (one, other) if order[one] < order[other] else (other, one)


def _beginnings(
    log: Log, run: EkfRun, pairs: Iterable[tuple[int, int, float]]
) -> dict[tuple[int, int], Beginning]:
    """Return how the second of two landmarks began, of those whose measurement fits the first."""
    new = run.trace.initialisations[POINT]
    state = TraceRecursion(run.trace, len(run.estimate.landmark))
    beginnings = {}
    for first, second in sorted(
        {pair[:2] for pair in pairs}, key=lambda pair: int(new.step[_row(new, pair[1])])
    ):
        beginning = _beginning(log, run, state, (first, second))
        if beginning is not None:
            beginnings[first, second] = beginning
    return beginnings


def _row(new: MeasurementRecords, landmark: int) -> int:
    """The record of a landmark's initialisation."""
    return int(np.flatnonzero(new.landmark_index == landmark)[0])


def _beginning(
    log: Log, run: EkfRun, state: TraceRecursion, pair: tuple[int, int]
) -> Beginning | None:
    """Return how the second landmark of a pair began, if its measurement fits the first.

    state: of the trace, no later than that; it goes on until then.
    """
    (first, second), new = pair, run.trace.initialisations[POINT]
    row = _row(new, second)
    number, step, measurements = int(new.number[row]), int(new.step[row]), log.measurements
    state.run_to(step)
    columns = state.layout.columns(np.array([first]))
    mean, covariance = state.mean[columns], state.covariance[np.ix_(columns, columns)]
    predicted = RangeBearing().predict(mean[:3], mean[None, 3:])
    h = np.concatenate((predicted.jacobian_pose[0], predicted.jacobian_landmark[0]), axis=1)
    sigma = np.array((measurements.sigma_range_m[number], measurements.sigma_bearing_rad[number]))
    apart = (
        np.array((measurements.range_m[number], measurements.bearing_rad[number])) - predicted.z[0]
    )
    short = np.array((apart[0], float(wrap_angle(apart[1]))))
    spread = h @ covariance @ h.T + np.diag(sigma**2)
    if not float(short @ np.linalg.solve(spread, short)) <= _FITS:
        return None
    bearing_rad = float(measurements.bearing_rad[number])
    arrived = run.trace.arrived[step - 1] if step else run.trace.prior_pose
    turns = (
        _turns(bearing_rad, float(RangeBearing().predict(pose, mean[None, 3:]).z[0, 1]))
        for pose in (arrived, mean[:3])  # where it was associated, before or after an update
    )
    return Beginning(number, bearing_rad, next((whole for whole in turns if whole), 0))


def _turns(measured_rad: float, expected_rad: float) -> int:
    """By how many whole turns bearings in (-pi, pi] differ."""
    difference = np.array(measured_rad) - wrap_angle(np.array(expected_rad))
    return int(np.round((difference - wrap_angle(difference)) / (2.0 * np.pi)))
