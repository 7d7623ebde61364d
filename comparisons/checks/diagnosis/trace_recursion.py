"""A trace's own equations, filtered again: the state that they lead to, event by event."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.checks.agreement import Gaussian
from comparisons.estimates.planar_trace import records_of
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.layout import Layout
from ekf_reference.core.trace import MeasurementRecords, TraceArrays


@dataclass(frozen=True)
class LinearReplay:
    """A trace's linear equations, filtered again.

    pose: (K, 3) at each epoch, with covariance (K, 3, 3). last: the joint one at the end.
    """

    pose: Array
    covariance: Array
    last: Gaussian


def replay(trace: TraceArrays, until: Index, landmarks: int, dtype: type) -> LinearReplay:
    """Filter the recorded equations in a precision. until: (K,) steps made at each epoch."""
    recursion = TraceRecursion(trace, landmarks, dtype)
    poses, spreads = [], []
    for end in until.tolist():
        recursion.run_to(end)
        poses.append(recursion.mean[:3].astype(np.float64))
        spreads.append(recursion.covariance[:3, :3].astype(np.float64))
    mean, covariance = (part.astype(np.float64) for part in (recursion.mean, recursion.covariance))
    return LinearReplay(
        np.array(poses), np.array(spreads), Gaussian(mean, covariance, recursion.layout)
    )


def turned_as_corrected(trace: TraceArrays, landmarks: int) -> tuple[TraceArrays, Array]:
    """Return a trace whose headings lie on the turn that its own corrections lead to.

    Args:
        trace: Headings of its points are right but for whole turns.
        landmarks: How many points it has.

    Returns:
        The same with these turns, and the last pose (3,) by its own equations.
    """
    recursion = _Turning(trace, landmarks, np.float64)
    recursion.run_to(len(trace.f))
    return recursion.turned, recursion.mean[:3].copy()


class TraceRecursion:
    """A filter of recorded equations. mean: (n,). covariance: (n, n)."""

    def __init__(self, trace: TraceArrays, landmarks: int, dtype: type = np.float64) -> None:
        """Start at the prior. landmarks: how many points the trace has."""
        self.trace, self.layout = trace, Layout.packed(3, landmarks)
        n = self.layout.size
        self.mean: Array = np.zeros(n, dtype)
        self.covariance: Array = np.zeros((n, n), dtype)
        self.mean[:3], self.covariance[:3, :3] = trace.prior_pose, trace.prior_covariance
        self._uses = _in_order(trace)
        self._next_use, self._step, self._dtype = 0, 0, dtype

    def run_to(self, end: int) -> None:
        """Go on until so many steps are made, and all that is used then is."""
        while self._step < end:
            self._use()
            self._move(self._step)
            self._step += 1
        self._use()

    def _move(self, step: int) -> None:
        x, p, dtype = self.mean, self.covariance, self._dtype
        f, q = self.trace.f[step].astype(dtype), self.trace.q[step].astype(dtype)
        apart = x[:3] - self.trace.departed[step].astype(dtype)
        x[:3] = self.trace.arrived[step].astype(dtype) + f @ apart
        p[:3] = f @ p[:3]
        p[:, :3] = p[:, :3] @ f.T
        p[:3, :3] += q

    def _use(self) -> None:
        """Use all records of the instant that is reached."""
        while self._next_use < len(self._uses) and self._uses[self._next_use].step <= self._step:
            self._use_row(self._uses[self._next_use])
            self._next_use += 1

    def _use_row(self, use: _RowUse) -> None:
        index = use.records.landmark_index[use.row : use.row + 1]
        columns = self.layout.columns(index[index >= 0])
        apply = _augmented if use.initialises else _updated
        self.mean, self.covariance = apply(
            self.mean, self.covariance, use.records, use.row, columns
        )


class _RowUse(NamedTuple):
    """A row of records that is used, in its place. initialises: it is of a new landmark."""

    step: int
    order: int
    row: int
    records: MeasurementRecords
    initialises: bool


def _in_order(trace: TraceArrays) -> list[_RowUse]:
    """Return all rows of a trace's records in the order in which its filter used them."""
    measured, initialised, positions = records_of(trace)
    uses = [
        _RowUse(step, order, row, records, records is initialised)
        for records in (measured, initialised, positions)
        for row, (step, order) in enumerate(
            zip(records.step.tolist(), records.order.tolist(), strict=True)
        )
    ]
    return sorted(uses, key=lambda use: (use.step, use.order))


class _Turning(TraceRecursion):
    """The same, which turns each recorded heading by whole turns to its own mean."""

    def __init__(self, trace: TraceArrays, landmarks: int, dtype: type) -> None:
        records, new = trace.measurements[POINT], trace.initialisations[POINT]
        self.turned = replace(
            trace,
            departed=trace.departed.copy(),
            arrived=trace.arrived.copy(),
            measurements={**trace.measurements, POINT: replace(records, pose=records.pose.copy())},
            initialisations={**trace.initialisations, POINT: replace(new, pose=new.pose.copy())},
            positions=replace(trace.positions, pose=trace.positions.pose.copy()),
        )
        super().__init__(self.turned, landmarks, dtype)
        self._last_pose, self._last_turns = np.zeros(0), 0.0

    def _turns(self, heading: float) -> float:
        return float(2.0 * np.pi * np.round((self.mean[2] - heading) / (2.0 * np.pi)))

    def _move(self, step: int) -> None:
        turns = self._turns(self.trace.departed[step, 2])
        self.trace.departed[step, 2] += turns
        self.trace.arrived[step, 2] += turns
        super()._move(step)

    def _use_row(self, use: _RowUse) -> None:
        pose = use.records.pose[use.row].copy()
        if not np.array_equal(pose, self._last_pose):  # what is fused together has one point
            self._last_pose, self._last_turns = pose, self._turns(pose[2])
        use.records.pose[use.row, 2] += self._last_turns
        super()._use_row(use)


def _updated(
    x: Array, p: Array, r: MeasurementRecords, row: int, columns: Index
) -> tuple[Array, Array]:
    point = np.concatenate((r.pose[row], r.landmark[row])).astype(x.dtype)
    h = np.concatenate((r.jacobian_pose[row], r.jacobian_other[row]), axis=1).astype(x.dtype)
    nu = r.innovation[row].astype(x.dtype) - h @ (x[columns] - point)
    ph = p[:, columns] @ h.T
    s = h @ ph[columns] + r.noise[row].astype(x.dtype)
    w = np.linalg.solve(s, ph.T).T
    return x + w @ nu, p - w @ ph.T


def _augmented(
    x: Array, p: Array, r: MeasurementRecords, row: int, columns: Index
) -> tuple[Array, Array]:
    new = slice(columns[3], columns[-1] + 1)
    g_x, g_z, noise = (
        array[row].astype(x.dtype) for array in (r.jacobian_pose, r.jacobian_other, r.noise)
    )
    x[new] = r.landmark[row] + g_x @ (x[:3] - r.pose[row].astype(x.dtype))
    p[new] = g_x @ p[:3]
    p[:, new] = p[new].T
    p[new, new] = g_x @ p[:3, :3] @ g_x.T + g_z @ noise @ g_z.T
    return x, p
