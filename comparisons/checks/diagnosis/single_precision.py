"""What rounding explains: of computing in double precision, of storing in single precision.

Rounding changes every record in its last place. What this does to the solution is measured: the
records are moved within what the precision left open, and solved again. A filter that computes in
single precision rounds its covariance at every operation: its gap to its own equations grows along
the run, as that of a replay of these equations in single precision does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.checks.agreement import Allowed, Gap, Gaussian, gap
from comparisons.estimates.stored_precision import SINGLE, restored
from comparisons.plane import pose_difference
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.layout import Layout
from ekf_reference.core.trace import MeasurementRecords, TraceArrays
from graphslam.marginals import SingularProblemError

_DRAWS = 5
FACTOR = 3.0
"""What storing did may be so many times the largest of what the draws did."""
OPERATIONS = 4.0
"""A formula computed in single precision is off by so many times what storing its result does."""
_FAR = 30.0
"""A gap of more times what one draw did is not explained by the largest of several."""
_ALIKE = 10.0
"""A gap is that of a computation in single precision up to so many times a replay's."""
_ROUNDED = ("pose", "landmark", "innovation", "jacobian_pose", "jacobian_other", "noise")
_STEPS = ("prior_pose", "prior_covariance", "departed", "arrived", "f", "q")
_BATCHES: tuple[Callable[[TraceArrays], MeasurementRecords], ...] = (
    lambda trace: trace.measurements[POINT],
    lambda trace: trace.initialisations[POINT],
    lambda trace: trace.positions,
)


def _restored(
    trace: TraceArrays, rng: np.random.Generator, precision: type = np.float32
) -> TraceArrays:
    batches = [records(trace) for records in _BATCHES]
    arrays = [getattr(trace, name) for name in _STEPS]
    arrays += [getattr(records, name) for records in batches for name in _ROUNDED]
    moved = iter(restored(arrays, rng, precision))
    steps: dict[str, Any] = {name: next(moved) for name in _STEPS}
    seen, initialised, fixes = (replace(records, **_named(moved)) for records in batches)
    return replace(
        trace,
        **steps,
        measurements={**trace.measurements, POINT: seen},
        initialisations={**trace.initialisations, POINT: initialised},
        positions=fixes,
    )


def restored_traces(trace: TraceArrays, precision: type = np.float32) -> Iterator[TraceArrays]:
    """Yield traces as this one may have been before it was stored in a precision."""
    rng = np.random.default_rng(0)
    for _ in range(_DRAWS):
        yield _restored(trace, rng, precision)


def allowed_gap(
    solve: Callable[[TraceArrays], Gaussian], trace: TraceArrays, sigma: Array
) -> Allowed:
    """Return what storing a trace in single precision explains of a gap to a solution of it.

    solve: F1 or F2 of a trace. sigma: (n,) units of the means, S's.
    """
    stored = solve(trace)
    return _widest([gap(solve(other), stored, sigma) for other in restored_traces(trace)])


def rounding_gap(
    solve: Callable[[TraceArrays], Gaussian],
    stored: Gaussian,
    trace: TraceArrays,
    sigma: Array,
    least: Gap,
) -> Allowed:
    """Return what computing in double precision explains of a gap to a solution of a trace.

    Its numbers are moved within their last places, and solved again. Where this has no solution,
    any gap is explained. solve: F1 or F2 of a trace. stored: the solution of this one. sigma: (n,)
    units of the means, S's. least: a gap; where one draw shows that rounding is far from it, no
    other is made.
    """
    gaps = list[Gap]()
    for other in restored_traces(trace, np.float64):
        try:
            gaps.append(gap(solve(other), stored, sigma))
        except (SingularProblemError, np.linalg.LinAlgError):
            return Allowed(np.inf, np.inf)
        found = _widest(gaps).times(OPERATIONS)
        if not least.explained_by(found.times(_FAR)):
            break
    return found


def _named(moved: Iterator[Array]) -> dict[str, Any]:
    return {name: next(moved) for name in _ROUNDED}


def allowed_of_estimate(ekf: Gaussian, sigma: Array, *, covariance: bool) -> Allowed:
    """Return what storing an estimate in single precision explains; its covariance, too, if so."""
    rng, mean = np.random.default_rng(1), float(np.max(SINGLE * np.abs(ekf.mean) / sigma))
    if not covariance:
        return Allowed(sigma=mean, covariance=0.0)
    others = [replace(ekf, covariance=restored([ekf.covariance], rng)[0]) for _ in range(_DRAWS)]
    found = _widest([gap(other, ekf, sigma) for other in others])
    return replace(found, sigma=mean)


def _widest(gaps: list[Gap]) -> Allowed:
    return Allowed(
        sigma=FACTOR * max(one.sigma for one in gaps),
        covariance=FACTOR * max(one.covariance for one in gaps),
    )


@dataclass(frozen=True)
class Replay:
    """A trace's linear equations, filtered again.

    pose: (K, 3) at each epoch, with covariance (K, 3, 3). last: the joint one at the end.
    """

    pose: Array
    covariance: Array
    last: Gaussian


def replay(trace: TraceArrays, until: Index, landmarks: int, dtype: type) -> Replay:
    """Filter the recorded equations in a precision. until: (K,) steps made at each epoch."""
    recursion = _Recursion(trace, landmarks, dtype)
    poses, spreads = [], []
    for end in until.tolist():
        recursion.run_to(end)
        poses.append(recursion.mean[:3].astype(np.float64))
        spreads.append(recursion.covariance[:3, :3].astype(np.float64))
    mean, covariance = (part.astype(np.float64) for part in (recursion.mean, recursion.covariance))
    return Replay(np.array(poses), np.array(spreads), Gaussian(mean, covariance, recursion.layout))


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


class _Recursion:
    """A filter of recorded equations. mean: (n,). covariance: (n, n)."""

    def __init__(self, trace: TraceArrays, landmarks: int, dtype: type) -> None:
        self.trace, self.layout = trace, Layout.packed(3, landmarks)
        n = self.layout.size
        self.mean: Array = np.zeros(n, dtype)
        self.covariance: Array = np.zeros((n, n), dtype)
        self.mean[:3], self.covariance[:3, :3] = trace.prior_pose, trace.prior_covariance
        self._batches = [records(trace) for records in _BATCHES]
        self._next_row, self._step, self._dtype = [0, 0, 0], 0, dtype

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
        for kind, records in enumerate(self._batches):
            last = int(np.searchsorted(records.step, self._step, side="right"))
            for row in range(self._next_row[kind], last):
                self._use_row(kind, records, row)
            self._next_row[kind] = last

    def _use_row(self, kind: int, records: MeasurementRecords, row: int) -> None:
        seen = records.landmark_index[row : row + 1]
        columns = self.layout.columns(seen[seen >= 0])
        use = _augmented if kind == 1 else _updated
        self.mean, self.covariance = use(self.mean, self.covariance, records, row, columns)


class _Turning(_Recursion):
    """The same, which turns each recorded heading by whole turns to its own mean."""

    def __init__(self, trace: TraceArrays, landmarks: int, dtype: type) -> None:
        seen, new = trace.measurements[POINT], trace.initialisations[POINT]
        self.turned = replace(
            trace,
            departed=trace.departed.copy(),
            arrived=trace.arrived.copy(),
            measurements={**trace.measurements, POINT: replace(seen, pose=seen.pose.copy())},
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

    def _use_row(self, kind: int, records: MeasurementRecords, row: int) -> None:
        pose = records.pose[row].copy()
        if not np.array_equal(pose, self._last_pose):  # what is fused together has one point
            self._last_pose, self._last_turns = pose, self._turns(pose[2])
        records.pose[row, 2] += self._last_turns
        super()._use_row(kind, records, row)


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


def computed_in_single(run: EkfRun, algebra: Gap, sigma: Array) -> str:
    """Return how a gap grows that a computation in single precision explains, "" where it is none.

    run: its records are all of single precision. algebra: its gap to the solution of its own
    equations. sigma: (n,) units of the means, S's.
    """
    trace, until, count = run.trace, run.timeline.steps_until(), len(run.estimate.landmark)
    exact, single = (replay(trace, until, count, dtype) for dtype in (np.float64, np.float32))
    like = gap(single.last, exact.last, sigma)
    if not algebra.explained_by(Allowed(_ALIKE * like.sigma, _ALIKE * like.covariance)):
        return ""
    first, last = _grown(run, exact)
    how = f"grows from {first:.2g} in the first tenth of the run to {last:.2g} in the last"
    if last <= first:
        how = f"stays near {max(first, last):.2g}"
    return (
        f"use double precision, since the filter computes in single precision: its gap of the pose "
        f"{how} (medians); the same equations, computed in single precision, give a gap of "
        f"{like.sigma:.2g} sigma in the mean and {like.covariance:.2g} in the covariance"
    )


def _grown(run: EkfRun, exact: Replay) -> tuple[float, float]:
    """The pose's gap, of mean in sigma or covariance, early and late."""
    sigma = np.sqrt(exact.covariance[:, (0, 1, 2), (0, 1, 2)])
    size = np.abs(pose_difference(run.departed, exact.pose) / sigma).max(axis=1)
    have = run.estimate.pose_covariance
    spread = np.abs(have - exact.covariance) / (sigma[:, :, None] * sigma[:, None, :])
    size = np.fmax(size, spread.max(axis=(1, 2)))
    part = max(1, len(size) // 10)
    return float(np.median(size[1 : 1 + part])), float(np.median(size[-part:]))
