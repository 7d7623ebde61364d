"""What rounding explains: of computing in double precision, of storing in single precision.

Rounding changes every record in its last place. What this does to the solution is measured: the
records are moved within what the precision left open, and solved again. A filter that computes in
single precision rounds its covariance at every operation: its gap to its own equations grows along
the run, as that of a replay of these equations in single precision does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array
from comparisons.checks.agreement import Gap, Gaussian, gap
from comparisons.checks.diagnosis.trace_recursion import LinearReplay, replay
from comparisons.covariances import entry_differences
from comparisons.estimates.planar_trace import OF_RECORDS, OF_STEPS, figures_of, records_of
from comparisons.plane import pose_difference
from comparisons.rounding import FACTOR, OPERATIONS, SINGLE, Allowed, restored
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.trace import TraceArrays
from graphslam.marginals import SingularProblemError

_DRAWS = 5
_FAR = 30.0
"""A gap of more times what one draw did is not explained by the largest of several."""
_ALIKE = 10.0
"""A gap is that of a computation in single precision up to so many times a replay's."""


def _restored(
    trace: TraceArrays, rng: np.random.Generator, precision: type = np.float32
) -> TraceArrays:
    moved = iter(restored(figures_of(trace), rng, precision))
    steps = _named(moved, OF_STEPS)
    measurement_records, initialised, fixes = (
        replace(records, **_named(moved, OF_RECORDS)) for records in records_of(trace)
    )
    return replace(
        trace,
        **steps,
        measurements={**trace.measurements, POINT: measurement_records},
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
        tolerance = _widest(gaps).times(OPERATIONS)
        if not least.explained_by(tolerance.times(_FAR)):
            break
    return tolerance


def _named(moved: Iterator[Array], names: Sequence[str]) -> dict[str, Any]:
    return {name: next(moved) for name in names}


def allowed_of_estimate(ekf: Gaussian, sigma: Array, *, covariance: bool) -> Allowed:
    """Return what storing an estimate in single precision explains; its covariance, too, if so."""
    rng, mean = np.random.default_rng(1), float(np.max(SINGLE * np.abs(ekf.mean) / sigma))
    if not covariance:
        return Allowed(sigma=mean, covariance=0.0)
    others = [replace(ekf, covariance=restored([ekf.covariance], rng)[0]) for _ in range(_DRAWS)]
    tolerance = _widest([gap(other, ekf, sigma) for other in others])
    return replace(tolerance, sigma=mean)


def _widest(gaps: list[Gap]) -> Allowed:
    return Allowed(
        sigma=FACTOR * max(difference.sigma for difference in gaps),
        covariance=FACTOR * max(difference.covariance for difference in gaps),
    )


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


def _grown(run: EkfRun, exact: LinearReplay) -> tuple[float, float]:
    """The pose's gap, of mean in sigma or covariance, early and late."""
    sigma = np.sqrt(exact.covariance[:, (0, 1, 2), (0, 1, 2)])
    size = np.abs(pose_difference(run.departed, exact.pose) / sigma).max(axis=1)
    have = run.estimate.pose_covariance
    spread = np.abs(entry_differences(have, exact.covariance))
    size = np.fmax(size, spread.max(axis=(1, 2)))
    part = max(1, len(size) // 10)
    return float(np.median(size[1 : 1 + part])), float(np.median(size[-part:]))
