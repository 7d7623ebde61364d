"""On which clock an estimate counts, and with which digits of a file's stamps its filter worked.

Stamps since 1970 are exact in a file; float64 has a quarter of a microsecond of them. A filter that
subtracts whole nanoseconds moves by other intervals than one that reads floats, and its poses
differ by more than rounding. `check` asks for both facts before it runs a reference.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from decimal import Decimal

import numpy as np

from comparisons.adapters.filter_loop import FilterObservers
from comparisons.adapters.motion import CLOCK_S
from comparisons.arrays import Array
from comparisons.checks.diagnosis.departure import departed_s
from comparisons.config import SolveConfig
from comparisons.estimates.external import ExternalEstimate, with_poses
from comparisons.estimates.reference import Reference
from comparisons.fingerprints.companion import EstimateLeftError
from comparisons.fingerprints.estimate_motion import distance_by_steps
from comparisons.logs.log import Log
from comparisons.logs.stamps import after_ns, as_floats_tell, at_instants, since_origin
from comparisons.logs.transforms.clock import file_start
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.references import EKF, filter_named
from ekf_reference.core.ekf import Ekf

_FIRST, _MOST, _GROWTH = 16, 4096, 8
"""Poses that are compared at first, at most, and from one comparison to the next."""
_LAST_DIGIT_NS = 100
"""Of the shortest decimals that read back to a float64 of seconds since 1970."""
_NEARER = 0.01
"""Share of the distance from the steps by one clock that those by the other may leave."""


def counts_as_file(time_s: Array, log: Log) -> bool:
    """Return whether times (K,), in order, count as the log's file does, and not as the log's."""
    start_s = float(file_start(log))
    begin_s, end_s = log.prior.time_s - CLOCK_S, log.end_s + CLOCK_S
    first_s, last_s = time_s[[0, -1]] - start_s
    return start_s > end_s and first_s <= end_s and last_s >= begin_s


def on_file_clock(time_s: Array, log: Log, instants_s: Array) -> Array:
    """Return a log's instants as times (K,) in order count."""
    return instants_s + float(file_start(log)) * counts_as_file(time_s, log)


def on_log_clock(given: ExternalEstimate, log: Log, instants_s: Array) -> ExternalEstimate:
    """Return an estimate whose times count as the log's, if they count as the log's file does.

    The start of the file's clock is subtracted from the digits that the estimate's file has, or
    from floats where it was handed in so. Trajectory and trace may count differently: each is
    seen by its own times. instants_s: of the log.
    """
    start, time_s, trace = file_start(log), given.time_s, given.trace
    if counts_as_file(time_s, log):
        if given.time_ns is not None:
            exact_s = at_instants(after_ns(given.time_ns, start), instants_s)
            time_s = as_floats_tell(exact_s, float(start), instants_s)
        else:
            exact_s = at_instants(time_s, on_file_clock(time_s, log, instants_s))
            time_s = since_origin(exact_s, float(start), instants_s)
    if trace is not None and counts_as_file(trace.step_time_s, log):
        step_s = since_origin(trace.step_time_s, float(start), instants_s)
        trace = replace(trace, step_time_s=step_s)
    return replace(given, time_s=time_s, trace=trace, time_ns=None)


def works_with_floats(
    given: ExternalEstimate, exact: Prepared[SolveConfig], floats: Prepared[SolveConfig]
) -> bool | None:
    """Return whether the intervals of an estimate are those of stamps read as float64.

    By its steps with nothing fused, else by which of two runs of the reference EKF it equals for
    longer. exact, floats: what the estimators read, by the one and the other. None where neither
    tells.
    """
    placed = [_inside(given, prepared) for prepared in (exact, floats)]
    if any(not len(estimate.time_s) for estimate in placed):
        return None
    both = tuple(zip(placed, (exact, floats), strict=True))
    far_exact, far_floats = (distance_by_steps(estimate, prepared) for estimate, prepared in both)
    if far_exact is not None and far_floats is not None:
        least, most = sorted((far_exact, far_floats))
        if least < _NEARER * most:
            return far_floats < far_exact
    count = _FIRST
    while True:
        equal = [_equal_poses(estimate, prepared, count) for estimate, prepared in both]
        if min(equal) < count or count >= min(_MOST, len(placed[0].time_s)):
            return None if equal[0] == equal[1] else equal[1] > equal[0]
        count *= _GROWTH


def written_from_floats(given: ExternalEstimate) -> bool:
    """Return whether a float64 of seconds may have written every time of an estimate's file.

    Not so where a digit says more than float64 does: whoever wrote it had the exact stamp.
    """
    if given.time_ns is None:
        return True
    by_float = [round(Decimal(instant_s) * 10**9) for instant_s in given.time_s.tolist()]
    few_digits = given.time_ns % _LAST_DIGIT_NS == 0
    return bool((few_digits | (given.time_ns == np.array(by_float, dtype=np.int64))).all())


def _inside(given: ExternalEstimate, prepared: Prepared[SolveConfig]) -> ExternalEstimate:
    """The poses within a log's time, at its instants."""
    instants_s = prepared.timeline.instants_s()
    placed = on_log_clock(given, prepared.log, instants_s)
    placed = replace(placed, time_s=at_instants(placed.time_s, instants_s))
    return with_poses(placed, (placed.time_s >= instants_s[0]) & (placed.time_s <= instants_s[-1]))


def _equal_poses(given: ExternalEstimate, prepared: Prepared[SolveConfig], count: int) -> int:
    """How many of the first poses are those of the reference EKF, to rounding."""
    first = with_poses(given, np.arange(len(given.time_s)) < count)
    beside = _Beginning(first.time_s)
    with contextlib.suppress(EstimateLeftError):
        filter_named(EKF, prepared, first.time_s, lambda ekf: beside)
    reference = beside.reference()
    left_s = departed_s(with_poses(first, np.isin(first.time_s, reference.time_s)), reference)
    if left_s is None:
        return count
    return int(np.searchsorted(first.time_s, left_s))


class _Beginning(FilterObservers):
    """Notes a filter's poses at some times, then gives the run up."""

    def __init__(self, time_s: Array) -> None:
        self._wanted, self._last_s = set(time_s.tolist()), float(time_s[-1])
        self._noted: dict[float, tuple[Array, Array]] = {}

    def before_predict(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """All that was seen until this time is fused."""
        if time_s in self._wanted:
            self._noted[time_s] = ekf.state.pose, ekf.state.pose_covariance
        if time_s >= self._last_s:
            raise EstimateLeftError

    def reference(self) -> Reference:
        """Return what was noted; no map."""
        count = len(self._noted)
        pose = np.array([pose for pose, _ in self._noted.values()]).reshape(-1, 3)
        covariance = np.array([p for _, p in self._noted.values()]).reshape(-1, 3, 3)
        times = list(self._noted)
        return Reference(
            name=EKF,
            time_s=np.array(times),
            known=np.ones(count, dtype=bool),
            pose=pose,
            pose_covariance=covariance,
            landmark_id=np.zeros(0, dtype=np.int64),
            landmark=np.zeros((0, 2)),
            joint_covariance=np.zeros((3, 3)),
            joint_s=times[-1] if times else 0.0,
            span_s=(0.0, 0.0),
        )
