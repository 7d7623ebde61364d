"""Faults of mean and covariance: recorded matrices are right, what is done with them is not."""

from __future__ import annotations

from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.fault import Fault, Plant, StateChange, after, keeping
from comparisons.faults.planted_algebra import Entries, between_landmarks
from ekf_reference.core.geometry import Index
from ekf_reference.core.state import Correction, KalmanState


def _without_map(done: StateChange, *_: Any) -> None:
    n = len(done.before)
    done.p[3:n, n:] = done.p[n:, 3:n] = 0.0


def _without_vehicle(done: StateChange, *_: Any) -> None:
    n = len(done.before)
    done.p[:3, n:] = done.p[n:, :3] = 0.0


def _cross_as_before(done: StateChange, *_: Any) -> None:
    done.p[:3, 3:] = done.before[:3, 3:]
    done.p[3:, :3] = done.before[:3, 3:].T


def _lower_as_before(done: StateChange, *_: Any) -> None:
    done.p[3:, :3] = done.before[3:, :3]


def _independent_landmarks(done: StateChange, *_: Any) -> None:
    done.p[between_landmarks(Entries.of(done.layout))] = 0.0


def _gain(p: Array, columns: Index, jacobian: Array, noise: Array) -> tuple[Array, Array]:
    """W (n, m), and I - W H (n, n)."""
    h = np.zeros((len(jacobian), len(p)))
    np.add.at(h.T, columns, jacobian.T)
    w = p @ h.T @ np.linalg.inv(h @ p @ h.T + noise)
    return w, np.eye(len(p)) - w @ h


def _not_transposed(
    done: StateChange, columns: Index, jacobian: Array, innovation: Array, noise: Array
) -> None:
    w, keep = _gain(done.before, columns, jacobian, noise)
    broken = keep @ done.before @ keep + w @ noise @ w.T
    done.p[:] = 0.5 * (broken + broken.T)


def other_gain(factor: float) -> Plant:
    """W with another R, the covariance by Joseph's form."""

    def update(
        original: Any, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Any:
        state: KalmanState = original.__self__
        p, wide = state.covariance.copy(), factor * noise
        done = original(columns, jacobian, innovation, wide)
        w, keep = _gain(p, columns, jacobian, wide)
        state._covariance[: len(p), : len(p)] = keep @ p @ keep.T + w @ noise @ w.T
        return done

    return keeping(update=update)


def _only_seen(original: Any, columns: Index, *args: Array) -> Correction:
    state: KalmanState = original.__self__
    before = state.mean.copy()
    done: Correction = original(columns, *args)
    unseen = np.setdiff1d(np.arange(len(before)), columns)
    state._mean[unseen] = before[unseen]
    return done


FAULTS = {
    "cross-covariance dropped at augmentation": Fault(
        "P between a new landmark and the map is left zero", after("augment", _without_map)
    ),
    "vehicle dropped at augmentation": Fault(
        "P between a new landmark and the vehicle is left zero", after("augment", _without_vehicle)
    ),
    "cross-covariance dropped at prediction": Fault(
        "the cross-covariance of vehicle and map is not multiplied by F",
        after("predict", _cross_as_before),
    ),
    "F transposed": Fault(
        "F^T P F in the prediction",
        keeping(predict=lambda original, x, f, q: original(x, f.T, q)),
    ),
    "asymmetric covariance": Fault(
        "the prediction writes the upper cross-covariance only", after("predict", _lower_as_before)
    ),
    "gain not transposed": Fault(
        "Joseph's form with (I - W H) on both sides", after("update", _not_transposed)
    ),
    "cross-covariance dropped at update": Fault(
        "the update leaves P between vehicle and map as it was", after("update", _cross_as_before)
    ),
    "landmarks kept independent": Fault(
        "P between landmarks is set to zero after every update",
        after("update", _independent_landmarks),
    ),
    "only seen landmarks updated": Fault(
        "the gain is applied to the vehicle and the landmarks in view", keeping(update=_only_seen)
    ),
    "innovation subtracted": Fault(
        "x - W nu in the update",
        keeping(update=lambda original, columns, h, nu, r: original(columns, h, -nu, r)),
    ),
    "R left out of S": Fault(
        "S = H P H^T in the gain",
        keeping(update=lambda original, columns, h, nu, r: original(columns, h, nu, 1e-6 * r)),
    ),
}
