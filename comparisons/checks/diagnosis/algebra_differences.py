"""Which of a filter's operations is wrong: each repeated alone, from the state it began with."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from comparisons.arrays import Array, Index
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import POINT, LandmarkKind, NewLandmarks
from ekf_reference.core.state import Correction, KalmanState
from ekf_reference.filters.compressed import CompressedState


@dataclass(frozen=True, kw_only=True)
class AlgebraDifference:
    """One block that one operation gets wrong.

    count: of operations in which it differs, of `total`. largest: difference, in sigma or products
    of sigmas. note: the kind of mistake that leads there, if it was found.
    """

    operation: str
    block: str
    count: int
    total: int
    largest: float
    note: str = ""

    def __str__(self) -> str:
        """For people to read."""
        text = (
            f"{self.operation} computes {self.block} wrongly in {self.count} of {self.total} cases"
        )
        size = f"by up to {self.largest:.2g} (relative)" if self.largest > 0.0 else "not finite"
        return f"{text}, {size}" + (f" ({self.note})" if self.note else "")


class WatchedState:
    """A state whose every operation is repeated on a sound copy of what it began with."""

    def __init__(self, state: KalmanState, tolerance: float) -> None:
        """Stand in for a state; differences up to the tolerance are rounding."""
        self._state, self._tolerance = state, tolerance
        self._total: dict[str, int] = defaultdict(int)
        self._found: dict[tuple[str, str], list[float]] = defaultdict(list)
        self._transposed: list[bool] = []
        self._skew = False

    def __getattr__(self, name: str) -> Any:
        """Whatever only reads."""
        return getattr(self._state, name)

    def starts(self, sound: KalmanState) -> None:
        """Compare what it starts from."""
        self._compare("the initialisation", sound, len(sound.pose), len(sound.pose))

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        """Move the vehicle, twice."""
        sound, other = self._copy(), self._copy()
        n, v = len(self._state.mean), len(pose)
        sound.predict(pose, jacobian_pose, noise)
        other.predict(pose, jacobian_pose.T, noise)
        self._state.predict(pose, jacobian_pose, noise)
        if self._compare("the prediction", sound, v, n):
            with np.errstate(invalid="ignore", divide="ignore"):
                sigma = np.sqrt(np.diag(other.covariance))
                reached = np.abs(self._state.covariance - other.covariance)
                reached /= np.outer(sigma, sigma)
            self._transposed.append(bool(reached.max() <= self._tolerance))

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Fuse an observation, twice."""
        sound = self._copy()
        v, n = len(sound.pose), len(sound.mean)
        sound.update(columns, jacobian, innovation, noise)
        done = self._state.update(columns, jacobian, innovation, noise)
        self._compare("the update", sound, v, n)
        return done

    def augment(self, new: NewLandmarks, noise: Array, kind: LandmarkKind = POINT) -> None:
        """Append landmarks, twice."""
        sound = self._copy()
        v, n = len(sound.pose), len(sound.mean)
        sound.augment(new, noise, kind)
        self._state.augment(new, noise, kind)
        self._compare("the landmark initialisation", sound, v, n)

    def remove(self, landmark_index: Index, kind: LandmarkKind = POINT) -> None:
        """Marginalise landmarks out, and compare with the marginal."""
        v, gone = len(self._state.pose), self._state.layout.columns(landmark_index, kind)
        kept = np.setdiff1d(np.arange(len(self._state.mean)), gone[v:])
        sound = self._state.part(kept)
        self._state.remove(landmark_index, kind)
        self._compare("the removal", sound, v, len(kept))

    def differences(self) -> tuple[AlgebraDifference, ...]:
        """What differed, the largest first."""
        note = ""
        if self._skew:
            note = "the covariance is not symmetric"
        elif self._transposed and all(self._transposed):
            note = "F is transposed"
        return tuple(
            sorted(
                (
                    AlgebraDifference(
                        operation=operation,
                        block=block,
                        count=len(sizes),
                        total=self._total[operation],
                        largest=max(sizes),
                        note=note if self._skew or operation == "the prediction" else "",
                    )
                    for (operation, block), sizes in self._found.items()
                ),
                key=lambda d: -d.largest,
            )
        )

    def _copy(self) -> KalmanState:
        """Plain, whatever the state's own class does."""
        return self._state.part(np.arange(len(self._state.mean)))

    def _compare(self, operation: str, sound: KalmanState, v: int, n: int) -> bool:
        """Note which blocks differ from the sound ones; n: entries before the operation."""
        self._total[operation] += 1
        with np.errstate(invalid="ignore", divide="ignore"):
            scale = np.sqrt(np.diag(sound.covariance))
            apart = np.abs(self._state.covariance - sound.covariance) / np.outer(scale, scale)
            mean = np.abs(self._state.mean - sound.mean) / scale
        vehicle, old, new = slice(0, v), slice(v, n), slice(n, len(scale))
        blocks = {
            "the mean": mean,
            "the vehicle's covariance": apart[vehicle, vehicle],
            "the cross-covariance of vehicle and map": _both(apart, vehicle, old),
            "the map's covariance": apart[old, old],
            "the cross-covariance of new landmarks and vehicle": _both(apart, vehicle, new),
            "the cross-covariance of new landmarks and map": _both(apart, old, new),
            "the new landmarks' covariance": apart[new, new],
        }
        off = False
        for name, block in blocks.items():
            largest = float(np.max(block[np.isfinite(block)], initial=0.0))
            if largest > self._tolerance or not np.isfinite(block).all():
                self._found[operation, name].append(largest)
                off = True
        if off:
            own = self._state.covariance
            skew = np.abs(own - own.T)[np.isfinite(own)]
            largest = float(np.abs(own[np.isfinite(own)]).max(initial=0.0))
            self._skew |= bool(skew.max(initial=0.0) > self._tolerance * largest)
        return off


def watch(ekf: Ekf, tolerance: float, pose: Array, covariance: Array) -> WatchedState | None:
    """Put a watched state into a filter that has not started.

    pose: (p,). covariance: (p, p), the recorded prior, that it should start from. None for states
    that do not lie open, or keep the pose in other figures than the trace and do more than this.
    """
    if isinstance(ekf.state, CompressedState) or len(ekf.state.pose) != len(pose):
        return None
    watched = WatchedState(ekf.state, tolerance)
    watched.starts(KalmanState(pose, covariance))
    ekf.state = cast(KalmanState, watched)  # it is one, by delegation
    return watched


def _both(apart: Array, rows: slice, columns: slice) -> Array:
    return np.maximum(apart[rows, columns], apart[columns, rows].T)
