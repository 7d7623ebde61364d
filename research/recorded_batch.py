"""What a batch of filters does, as events of an audit: of some of its runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.experiments.variants.batch_ekf import BatchEkf, BatchInvariantEkf
from comparisons.experiments.variants.batch_models import turned
from comparisons.experiments.variants.batch_state import BatchInvariantState, BatchState, measured
from comparisons.trace.events import Augment, Blocks, Directions, Event, Predict, TracePrior, Update

SENSOR = "landmarks"
_POSE, _NAMES = 3, ("east", "north", "heading")
Sinks = Mapping[int, Callable[[Event], None]]
"""Takes the events of a run, by its number in the batch."""


def record(filter_: BatchEkf | BatchInvariantEkf, capacity: int, sinks: Sinks) -> None:
    """Let a filter at its start send what it does from now on.

    At the start the state is the pose alone, all of which is what the landmarks cannot tell.

    Args:
        filter_: Before its first step.
        capacity: The most landmarks there may be.
        sinks: What takes the events.
    """
    recorder = _Recorder(filter_.state, sinks)
    kind = _RecordedInvariant if isinstance(filter_, BatchInvariantEkf) else _RecordedState
    filter_.state = kind(filter_.state, capacity, recorder)


class _Recorder:
    """Makes events of what all runs do; an event has the same number in each."""

    def __init__(self, state: BatchState, sinks: Sinks) -> None:
        self._sinks = sinks
        self._number, self._step = -1, 0
        self._blocks: Blocks = ("pose",)
        at = self._next()
        self._send(
            lambda run: TracePrior(*at, self._blocks, (_POSE,), state.covariance[run].copy())
        )
        at = self._next()
        self._send(lambda run: Directions(*at, self._blocks, np.eye(_POSE), _NAMES, (SENSOR,)))

    def _next(self) -> tuple[int, float]:
        """Number of the next event, and the step as its time."""
        self._number += 1
        return self._number, float(self._step)

    def _send(self, of_run: Callable[[int], Event]) -> None:
        for run, sink in self._sinks.items():
            sink(of_run(run))

    def predicted(self, blocks: Blocks | None, jacobian: Array, noise: Array) -> None:
        """Send a prediction of some blocks, or of all: (B, n, n) each."""
        self._step += 1
        at, moved = self._next(), blocks or self._blocks
        self._send(lambda run: Predict(*at, moved, jacobian[run], noise[run].copy()))

    def updated(self, h: Array, innovation: Array, noise: Array) -> None:
        """Send an update: h (B, m, n), innovation (B, m), noise (m,) variances."""
        at, blocks, r = self._next(), self._blocks, np.diag(noise)
        self._send(
            lambda run: Update(*at, SENSOR, blocks, innovation[run], h[run], r, True, None, None)
        )

    def augmented(self, jacobian: Array, spread: Array) -> None:
        """Send new landmarks: jacobian (B, k, 2, 3) by the pose, spread (B, k, 2, 2)."""
        for i in range(jacobian.shape[1]):
            at, name = self._next(), f"landmark {len(self._blocks) - 1}"
            self._send(partial(self._new, at, name, jacobian[:, i], spread[:, i]))
            self._blocks = (*self._blocks, name)

    @staticmethod
    def _new(at: tuple[int, float], name: str, jacobian: Array, spread: Array, run: int) -> Augment:
        return Augment(*at, name, ("pose",), jacobian[run], np.eye(2), spread[run])


class _RecordedState(BatchState):
    """Says what is done to it."""

    def __init__(self, state: BatchState, capacity: int, recorder: _Recorder) -> None:
        runs = len(state.mean)
        super().__init__(state.pose[0], state.covariance[0], runs, capacity)
        self._recorder = recorder

    def predict(self, pose: Array, travel: Array, noise: Array) -> None:
        """Move, and say so."""
        jacobian = np.tile(np.eye(3), (len(pose), 1, 1))
        jacobian[:, :2, 2] = turned(travel)
        self._recorder.predicted(("pose",), jacobian, noise)
        super().predict(pose, travel, noise)

    def update(
        self,
        landmark_index: Index,
        matrix: Array,
        lever: Array | None,
        innovation: Array,
        noise: Array,
    ) -> None:
        """Fuse, and say so."""
        h = _jacobian(self, landmark_index, matrix, lever)
        self._recorder.updated(h, innovation.reshape(len(h), -1), noise.ravel())
        super().update(landmark_index, matrix, lever, innovation, noise)

    def augment(self, point: Array, lever: Array, spread: Array) -> None:
        """Append landmarks, and say so."""
        self._recorder.augmented(_by_pose(lever), spread)
        super().augment(point, lever, spread)


class _RecordedInvariant(_RecordedState, BatchInvariantState):
    """Of right-invariant errors: a heading that is wrong turns all points about the origin."""

    def predict_invariant(self, pose: Array, gamma: Array, control_noise: Array) -> None:
        """Move, and say so."""
        whole = np.broadcast_to(np.eye(gamma.shape[1]), (len(gamma), *[gamma.shape[1]] * 2))
        noise = (gamma * control_noise) @ gamma.transpose(0, 2, 1)
        self._recorder.predicted(None, whole, noise)
        super().predict_invariant(pose, gamma, control_noise)


def _jacobian(
    state: BatchState, landmark_index: Index, matrix: Array, lever: Array | None
) -> Array:
    """H (B, m, n), as of `measured`."""
    runs, size = state.mean.shape
    whole = np.broadcast_to(np.eye(size), (runs, size, size))
    return measured(matrix, lever, landmark_index, whole)


def _by_pose(lever: Array) -> Array:
    """[I, J lever] of levers (B, k, 2): (B, k, 2, 3)."""
    jacobian = np.zeros((*lever.shape[:2], 2, 3))
    jacobian[..., :2] = np.eye(2)
    jacobian[..., 2] = turned(lever)
    return jacobian
