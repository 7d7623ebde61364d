"""Right estimates of a log for an external one to be compared with, at its own times."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from comparisons.adapters.filter_loop import FilterObserver
from comparisons.adapters.filter_variants import (
    BackwardEkf,
    ByLabelBackwardEkf,
    ByLabelEkf,
    FarthestFirstEkf,
    FirstEstimatesEkf,
    InvariantEkf,
    IteratedEkf,
    NearestFirstEkf,
    NewFirstEkf,
    NewFirstSequentialEkf,
    RobocentricEkf,
    SequentialEkf,
    UnknownFirstSequentialEkf,
    UnscentedEkf,
    WideUnscentedEkf,
)
from comparisons.adapters.motion import poses_at
from comparisons.adapters.reference_filter import FilterRun, run_reference
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array
from comparisons.checks.grade import SMOOTHER
from comparisons.config import SolveConfig
from comparisons.estimates.reference import Reference
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.solve import Solution
from ekf_reference.core.ekf import Ekf

EKF = "the reference EKF"
ONE_BY_ONE = "an EKF with sequential (one landmark at a time) updates"
VARIANTS: dict[str, type[Ekf]] = {
    "an iterated EKF": IteratedEkf,
    ONE_BY_ONE: SequentialEkf,
    f"{ONE_BY_ONE}, last first": BackwardEkf,
    f"{ONE_BY_ONE}, by label": ByLabelEkf,
    f"{ONE_BY_ONE}, by label, largest first": ByLabelBackwardEkf,
    f"{ONE_BY_ONE}, nearest first": NearestFirstEkf,
    f"{ONE_BY_ONE}, farthest first": FarthestFirstEkf,
    "an EKF that initialises new landmarks before it updates": NewFirstEkf,
    f"{ONE_BY_ONE}, new landmarks initialised first": NewFirstSequentialEkf,
    f"{ONE_BY_ONE}, new landmarks initialised with a vast covariance": UnknownFirstSequentialEkf,
    "a first-estimates EKF": FirstEstimatesEkf,
    "a right-invariant EKF": InvariantEkf,
    "a robocentric EKF": RobocentricEkf,
    "an unscented Kalman filter": UnscentedEkf,
    "an unscented Kalman filter with wide sigma points": WideUnscentedEkf,
}
FILTERS = (EKF, *VARIANTS)
ORDERS = {EKF: ""} | {
    name: name.replace("an EKF with", "it has")
    for name, kind in VARIANTS.items()
    if kind in (SequentialEkf, BackwardEkf)
}
"""The same filter but for the order of updates, and that in words."""
APART = tuple(
    name for name, kind in VARIANTS.items() if issubclass(kind, RobocentricEkf | NewFirstEkf)
)
"""Sound, but farther from the others than most faults are."""
KINDS = tuple(
    name
    for name, kind in VARIANTS.items()
    if issubclass(kind, IteratedEkf | FirstEstimatesEkf | InvariantEkf | UnscentedEkf)
)
"""Of these, filters of other equations that strangers write."""


def reference_ekf(
    prepared: Prepared[SolveConfig], time_s: Array
) -> tuple[Reference, tuple[Array, Array]] | None:
    """The reference EKF at times (K,), and its poses and covariances before each instant's updates.

    None where it breaks down.
    """
    run = _run(prepared, Ekf, time_s)
    if run is None:
        return None
    return _of_run(EKF, run, time_s, prepared.log.labels), run.before_updates().at(time_s)


class SoundFilters:
    """The reference EKF and the other sound filters on one log, each run once for the same times.

    Estimates that are read in several ways are compared with the same ones.
    """

    def __init__(self, prepared: Prepared[SolveConfig]) -> None:
        """prepared: the log, and how the filters are set."""
        self._prepared = prepared
        self._ekf: dict[bytes, tuple[Reference, tuple[Array, Array]] | None] = {}
        self._others: dict[tuple[str, bytes], Reference | None] = {}

    def ekf(self, time_s: Array) -> tuple[Reference, tuple[Array, Array]] | None:
        """Return the reference EKF at times (K,), as `reference_ekf` does."""
        times = time_s.tobytes()
        if times not in self._ekf:
            self._ekf[times] = reference_ekf(self._prepared, time_s)
        return self._ekf[times]

    def named(
        self,
        name: str,
        time_s: Array,
        started: Callable[[Ekf], FilterObserver] | None = None,
    ) -> Reference | None:
        """Return the filter of a name at times (K,); None where it breaks down.

        started: as of `run_reference`. What it raises ends the run, of which nothing is kept.
        """
        key = name, time_s.tobytes()
        if key not in self._others:
            self._others[key] = filter_named(name, self._prepared, time_s, started)
        return self._others[key]

    def variants(self, time_s: Array) -> tuple[Reference, ...]:
        """Return all others than the reference EKF at times (K,) that do not break down."""
        filters = (self.named(name, time_s) for name in VARIANTS)
        return tuple(reference for reference in filters if reference is not None)


def smoother(solution: Solution, time_s: Array) -> Reference:
    """The smoother's poses (K, 3) at times (K,); known are those at its own instants."""
    estimate = solution.estimate
    row = np.minimum(np.searchsorted(estimate.time_s, time_s), len(estimate.time_s) - 1)
    known = estimate.time_s[row] == time_s
    return Reference(
        name=SMOOTHER,
        time_s=time_s,
        known=known,
        pose=poses_at(solution.log, estimate, time_s),
        pose_covariance=np.where(known[:, None, None], estimate.pose_covariance[row], np.nan),
        landmark_id=estimate.landmark_id,
        landmark=estimate.landmark,
        joint_covariance=estimate.joint_covariance,
        joint_s=float(estimate.time_s[-1]),
        span_s=_span(solution.prepared.timeline),
        smoothed=True,
        labels=estimate.labels,
    )


def filter_named(
    name: str,
    prepared: Prepared[SolveConfig],
    time_s: Array,
    started: Callable[[Ekf], FilterObserver] | None = None,
) -> Reference | None:
    """The reference of a name, on what may be another log; None where it breaks down.

    started: as of run_reference.
    """
    return filter_of(name, VARIANTS.get(name, Ekf), prepared, time_s, started)


def filter_of(
    name: str,
    kind: type[Ekf],
    prepared: Prepared[SolveConfig],
    time_s: Array,
    started: Callable[[Ekf], FilterObserver] | None = None,
) -> Reference | None:
    """The reference of a filter; arguments as of `filter_named`."""
    run = _run(prepared, kind, time_s, started)
    return None if run is None else _of_run(name, run, time_s, prepared.log.labels)


def _run(
    prepared: Prepared[SolveConfig],
    kind: type[Ekf],
    time_s: Array,
    started: Callable[[Ekf], FilterObserver] | None = None,
) -> FilterRun | None:
    p, map_s = prepared, float(time_s[-1])
    return run_reference(
        p.log, p.filter_timeline, p.ekf, p.positions, kind=kind, map_s=map_s, started=started
    )


def _span(timeline: Timeline) -> tuple[float, float]:
    """Of what is observed: nothing else asks for poses."""
    observed_s = timeline.observed_s()
    return float(observed_s[0]), float(observed_s[-1])


def _of_run(name: str, run: FilterRun, time_s: Array, labels: Mapping[int, str]) -> Reference:
    pose, covariance = run.at(time_s)
    return Reference(
        name=name,
        time_s=time_s,
        known=np.ones(len(time_s), dtype=bool),
        pose=pose,
        pose_covariance=covariance,
        landmark_id=run.map.landmark_id,
        landmark=run.map.landmark,
        joint_covariance=run.map.joint_covariance,
        joint_s=run.map.time_s,
        span_s=_span(run.timeline),
        labels=labels,
    )
