"""Runs of a filter beside an estimate, given up where they leave it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from comparisons.adapters.filter_loop import FilterObserver, FilterObservers
from comparisons.arrays import Array
from comparisons.checks.grade import Likeness, in_sigma
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.plane import pose_difference
from ekf_reference.core.ekf import Ekf

EXPLAINED = 0.99
"""Least share of the difference from a sound filter that a fault must explain."""
NEAR = 1e-5
"""So far, in sigma or as the logarithm of a variance, a run may always leave the estimate; whether
it is equal to rounding is judged in the end."""
_LEAVES = 1e-3


class EstimateLeftError(Exception):  # no error: the run is given up
    """The run has left the estimate."""


class Companion(FilterObservers):
    """Gives a run up where it is farther from the estimate than a share of a sound filter's.

    poses: so many were equal to rounding, before any that was not. last_s: when the last of them
    was. farthest, sound: the largest difference until then, of the run and of the sound filter.
    """

    def __init__(
        self,
        given: ExternalEstimate,
        sound: Likeness,
        share: float = 1.0 - EXPLAINED,
        least: float = NEAR,
    ) -> None:
        """share: of the sound filter's difference. least: that may be left in any case."""
        self._share, self._least = share, least
        reference = sound.reference
        self._row = {time: row for row, time in enumerate(given.time_s.tolist())}
        self._pose, self._variance = given.pose, np.diagonal(reference.pose_covariance, 0, 1, 2)
        apart = in_sigma(pose_difference(given.pose, reference.pose), reference.pose_covariance)
        self._own = None
        if given.pose_covariance is not None:
            self._own = np.maximum(np.diagonal(given.pose_covariance, 0, 1, 2), 1e-300)
            apart = np.fmax(apart, np.abs(np.log(self._own / self._variance)).max(axis=1))
        self._sound = np.maximum.accumulate(np.nan_to_num(apart))
        self._exact, self.last_s, self.poses = True, float(given.time_s[0]), 0
        self.farthest = self.sound = 0.0

    def before_predict(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """All that was seen until this time is fused."""
        apart = self.apart(ekf, time_s)
        if apart is None:
            return
        far, sound = float(np.abs(apart).max()), float(self._sound[self._row[time_s]])
        if not far <= max(self._least, self._share * sound):
            raise EstimateLeftError
        self._exact = self._exact and far <= self._least
        if self._exact:
            self.poses += 1
            self.last_s, self.farthest, self.sound = time_s, max(self.farthest, far), sound

    def apart(self, ekf: Ekf, time_s: float) -> Array | None:
        """(3,) or (6,): in sigma, and logarithms of variances; None where nothing was handed in."""
        row = self._row.get(time_s)
        if row is None:
            return None
        apart = pose_difference(self._pose[row : row + 1], ekf.state.pose[None])[0]
        found: Array = apart / np.sqrt(self._variance[row])
        if self._own is not None:
            variance = np.maximum(np.diag(ekf.state.pose_covariance), 1e-300)
            found = np.concatenate((found, np.log(self._own[row] / variance)))
        return found

    def first(self, count: int) -> int:
        """Poses until the sound filter has left the estimate, and so many more."""
        return min(int(np.searchsorted(self._sound, _LEAVES)) + count, len(self._sound))

    def sound_at(self, time_s: float) -> float:
        """How far the sound filter has been off by a time of the estimate's."""
        return float(self._sound[self._row[time_s]])

    def sound_until(self, count: int) -> float:
        """How far the sound filter is off within the first poses."""
        return float(self._sound[count - 1])


def remainder(
    beside: Companion, count: int, run: Callable[[FilterObserver], object]
) -> Array | None:
    """Return what a run leaves of the first poses, as a companion says of each, in one array.

    beside: compares. count: so many poses. run: runs a filter that has an observer. None where the
    filter does not reach them all, or not with finite numbers.
    """
    seen = _First(beside, count)
    try:
        run(seen)
    except EstimateLeftError:
        pass
    except (InputError, np.linalg.LinAlgError):
        return None
    if len(seen.left) < count:
        return None
    left = np.concatenate(seen.left)
    return left if np.isfinite(left).all() else None


class _First(FilterObservers):
    """Compares the first poses, then gives the run up. left: what a companion says of each."""

    def __init__(self, beside: Companion, count: int) -> None:
        self._beside, self._count = beside, count
        self.left: list[Array] = []

    def before_predict(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """All that was seen until this time is fused."""
        apart = self._beside.apart(ekf, time_s)
        if apart is not None:
            self.left.append(apart)
            if len(self.left) >= self._count:
                raise EstimateLeftError
