"""Runs of a filter beside an estimate, given up where they leave it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from comparisons.adapters.ekf_factory import motion_model
from comparisons.adapters.filter_loop import FilterObserver, FilterObservers
from comparisons.adapters.motion import CLOCK_S
from comparisons.arrays import Array
from comparisons.checks.grade import Likeness
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.plane import pose_difference
from ekf_reference.core.ekf import Ekf

EXPLAINED = 0.99
"""Least share of the difference from a sound filter that a fault must explain."""
NEAR = 1e-5
"""So far, in sigma or as the logarithm of a variance, a run may always leave the estimate; whether
it is equal to rounding is judged in the end."""
_LEAVES = 1e-3
_ROUNDING = 1e-10
_BOUND = 1e100
"""A difference so large is no number: its square overflows."""
PartOfStep = Callable[[Array, Array, float, float], Array]
"""Moves a pose (3,) by a control for some of a step's duration."""


class EstimateLeftError(Exception):  # no error: the run is given up
    """The run has left the estimate."""


class RunDeparture(NamedTuple):
    """Where a run left an estimate. row: of its poses. distance: how far it is off there."""

    row: int
    distance: float


def part_of_step(log: Log) -> PartOfStep:
    """Return what moves a pose by a part of a step of a log, as references between instants do."""
    model, shared = motion_model(log), isinstance(log.odometry, RelativePoses)

    def moved(pose: Array, control: Array, late_s: float, duration_s: float) -> Array:
        part = late_s / duration_s * control if shared else control
        return model.step(pose, part, late_s).pose

    return moved


class Companion(FilterObservers):
    """Gives a run up where it is farther from the estimate than a share of a sound filter's.

    poses: so many were equal to rounding, before any that was not. last_s: when the last of them
    was. farthest, sound: the largest difference until then, of the run and of the sound filter.
    departure: where the run was given up. sound_rows: (K, 3) or (K, 6) what `apart` says of the
    sound filter.
    """

    def __init__(
        self,
        given: ExternalEstimate,
        sound: Likeness,
        share: float = 0.0,
        least: float = NEAR,
        between: PartOfStep | None = None,
    ) -> None:
        """Set what is compared.

        share: of the sound filter's difference. least: that may be left in any case. between: moves
        a pose by a part of a step, by which poses between the filter's instants are compared, too.
        """
        self._share, self._least = share, least
        reference = sound.reference
        self._row = {time: row for row, time in enumerate(given.time_s.tolist())}
        self._pose, self._variance = given.pose, np.diagonal(reference.pose_covariance, 0, 1, 2)
        rows = pose_difference(given.pose, reference.pose) / np.sqrt(self._variance)
        self._own = None
        if given.pose_covariance is not None:
            self._own = np.maximum(np.diagonal(given.pose_covariance, 0, 1, 2), 1e-300)
            rows = np.hstack((rows, np.log(self._own / self._variance)))
        self.sound_rows: Array = np.nan_to_num(rows)
        self._sound = np.maximum.accumulate(np.abs(self.sound_rows).max(axis=1))
        self._exact, self.last_s, self.poses = True, float(given.time_s[0]), 0
        self.farthest = self.sound = 0.0
        self.departure: RunDeparture | None = None
        self._first_off = 0.0
        self._time_s, self._between = given.time_s, between

    def before_predict(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """All that was seen until this time is fused."""
        for row, apart in self.differences(ekf, time_s, control, duration_s):
            far, sound = float(np.abs(apart).max()), float(self._sound[row])
            if self._exact and far > self._least:
                self._first_off = far
            if not far <= max(self._least, self._share * sound):
                self.departure = RunDeparture(row, far)
                raise EstimateLeftError
            self._exact = self._exact and far <= self._least
            if self._exact:
                self.poses += 1
                self.last_s, self.sound = float(self._time_s[row]), sound
                self.farthest = max(self.farthest, far)

    def differences(
        self, ekf: Ekf, time_s: float, control: Array, duration_s: float
    ) -> Iterator[tuple[int, Array]]:
        """Yield rows of the estimate until the filter's next instant, and what `apart` says."""
        apart = self.apart(ekf, time_s)
        if apart is not None:
            yield self._row[time_s], apart
        if self._between is None or not duration_s:
            return
        first, end = np.searchsorted(
            self._time_s, (time_s, time_s + duration_s - CLOCK_S), side="right"
        )
        for row in range(int(first), int(end)):
            late_s = float(self._time_s[row]) - time_s
            pose = self._between(ekf.state.pose, control, late_s, duration_s)
            yield row, self._off(row, pose)

    def apart(self, ekf: Ekf, time_s: float) -> Array | None:
        """(3,) or (6,): in sigma, and logarithms of variances; None where nothing was handed in."""
        row = self._row.get(time_s)
        if row is None:
            return None
        apart = self._off(row, ekf.state.pose)
        if self._own is not None:
            variance = np.maximum(np.diag(ekf.state.pose_covariance), 1e-300)
            apart = np.concatenate((apart, np.log(self._own[row] / variance)))
        return apart

    def _off(self, row: int, pose: Array) -> Array:
        """(3,) how far a pose of the estimate is from another, in sigma."""
        off: Array = pose_difference(self._pose[row : row + 1], pose[None])[0]
        return np.asarray(off / np.sqrt(self._variance[row]))

    def first(self, count: int) -> int:
        """Poses until the sound filter has left the estimate, and so many more."""
        return min(int(np.searchsorted(self._sound, _LEAVES)) + count, len(self._sound))

    def jumps(self, times: float) -> bool:
        """Whether the first difference is so many times the largest before it, or rounding."""
        return self._first_off > times * max(self.farthest, _ROUNDING)

    def sound_at(self, time_s: float) -> float:
        """How far the sound filter has been off by a time of the estimate's."""
        return float(self._sound[self._row[time_s]])

    def sound_until(self, count: int) -> float:
        """How far the sound filter is off within the first poses."""
        return float(self._sound[count - 1])


def in_both(first: Array, second: Array) -> tuple[Array, Array]:
    """Return of two rows what both have: the pose's, and the variances' at filters' instants."""
    width = min(len(first), len(second))
    return first[:width], second[:width]


def remainder(
    beside: Companion, count: int, run: Callable[[FilterObserver], object]
) -> Array | None:
    """Return what a run leaves of the first poses, as a companion says of each, in one array.

    beside: compares. count: so many poses. run: runs a filter that has an observer. None where the
    filter does not reach them all, or not with finite numbers.
    """
    rows = remainders(beside, count, run)
    return np.concatenate(rows) if len(rows) == count else None


def remainders(
    beside: Companion,
    count: int,
    run: Callable[[FilterObserver], object],
    most: Sequence[Array] = (),
) -> list[Array]:
    """Return the same of each pose that a filter reaches with finite numbers.

    most: what it may leave in each entry of the very first, with which it is not given up.
    """
    first = _First(beside, count, most)
    try:
        run(first)
    except EstimateLeftError:
        pass
    except (InputError, np.linalg.LinAlgError):
        return []
    bounded = [bool((np.abs(difference) < _BOUND).all()) for difference in first.left]
    return first.left[: bounded.index(False)] if False in bounded else first.left


class _First(FilterObservers):
    """Compares the first poses, then gives the run up. left: what a companion says of each."""

    def __init__(self, beside: Companion, count: int, most: Sequence[Array]) -> None:
        self._beside, self._count, self._most = beside, count, most
        self.left: list[Array] = []

    def before_predict(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """All that was seen until this time is fused."""
        for _, apart in self._beside.differences(ekf, time_s, control, duration_s):
            self.left.append(apart)
            row = len(self.left) - 1
            if row < len(self._most):
                rest, most = in_both(apart, self._most[row])
                if not (np.abs(rest) <= most).all():
                    del self.left[row]
                    raise EstimateLeftError
            if len(self.left) >= self._count:
                raise EstimateLeftError
