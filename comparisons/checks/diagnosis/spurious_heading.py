"""What a filter has learnt of its global heading from measurements that cannot tell it.

The measure is the information of its recorded linear equations (F1) about a turn of the whole map
about the start, without prior, positions and surveyed landmarks. It is zero where every relation
is linearised at the truth, or at first estimates; see graphslam.spurious.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array
from ekf_reference.core.landmark_types import POINT, POSE
from ekf_reference.core.trace import TraceArrays
from graphslam.arrays import conditional_covariance
from graphslam.linear_problem import LinearProblem, LinearRelations
from graphslam.marginals import SingularProblemError
from graphslam.spurious import information_about_start

_MATTERS = 10.0
"""Times the heading's largest sigma: what is learnt less surely than that changes nothing."""
_ROUNDING = 1e-9
"""Information [1/rad^2] of a single measurement, which is named only for more."""


@dataclass(frozen=True)
class LargestShare:
    """The measurement with which the information [1/rad^2] grew most, while it grew most.

    seen: the landmark in words; empty for a motion step.
    """

    time_s: float
    seen: str
    information: float


@dataclass(frozen=True)
class SpuriousHeading:
    """Information about the global heading [1/rad^2] as it grew.

    time_s: (C + 1,) from the first pose. information: (C + 1,) gathered until then, from zero.
    heading_sigma_rad: the largest of the filter's poses, NaN where none is known.
    """

    time_s: Array
    information: Array
    largest: LargestShare | None
    heading_sigma_rad: float

    @property
    def total(self) -> float:
        """At the end."""
        return float(self.information[-1])

    @property
    def sigma_rad(self) -> Array:
        """(C + 1,) with which the heading seems to be known; infinite without information."""
        with np.errstate(divide="ignore"):
            sigma: Array = 1.0 / np.sqrt(self.information)
        return sigma

    @property
    def fastest(self) -> tuple[float, float, float]:
        """The stretch in which it grew most: begin, end, and what it gained there."""
        gained = np.diff(self.information)
        row = int(gained.argmax())
        return float(self.time_s[row]), float(self.time_s[row + 1]), float(gained[row])

    @property
    def matters(self) -> bool:
        """Whether the filter's own sigma of the heading is not far smaller."""
        return bool(self.sigma_rad[-1] <= _MATTERS * self.heading_sigma_rad)


def spurious_heading(problem: LinearProblem, run: EkfRun) -> SpuriousHeading | None:
    """Return what F1 of a run holds about the heading at the start.

    None where the log has surveyed landmarks, which tell it, or where the relations without prior
    do not fix every state.
    """
    trace = run.trace
    if (trace.initialisations[POINT].number < 0).any():
        return None
    direction, rest = _start(trace)
    merged = trace.merges.step
    merge_epoch = np.searchsorted(run.timeline.steps_until(), merged)
    try:
        found = information_about_start(_measured(problem, trace), direction, rest, merge_epoch)
    except SingularProblemError:
        return None
    time_s, variance = run.estimate.time_s, run.estimate.pose_covariance[:, 2, 2]
    variance = variance[variance >= 0.0]
    largest = None
    if (most := found.largest) is not None and most.information > _ROUNDING:
        largest = LargestShare(
            float(time_s[most.epoch]),
            _landmark(run, most.landmark_index, most.kind),
            most.information,
        )
    return SpuriousHeading(
        np.concatenate((time_s[:1], time_s[found.epoch])),
        np.concatenate(([0.0], np.cumsum(found.gained))),
        largest,
        float(np.sqrt(variance.max())) if len(variance) else np.nan,
    )


def _landmark(run: EkfRun, landmark_index: int, kind: str) -> str:
    if kind == POINT.name:
        return f"landmark {run.estimate.landmark_id[landmark_index]}"
    return f"scan landmark {landmark_index}" if kind == POSE.name else ""


def _start(trace: TraceArrays) -> tuple[Array, Array]:
    """Return how the start turns (p,), and the covariance (p, p) of what no motion of it moves."""
    planar = np.eye(3)
    if len(trace.prior_pose) > len(planar):
        from ekf_reference.filters.misono import along_circle

        planar = along_circle(trace.prior_pose)
    return planar[:, 2], conditional_covariance(trace.prior_covariance, planar)


def _measured(problem: LinearProblem, trace: TraceArrays) -> LinearProblem:
    """Leave out what holds of landmarks before they are measured: the last relations of F1."""
    measurements = {}
    initialised = {kind.name: records for kind, records in trace.initialisations.items()}
    for kind, seen in problem.measurements.items():
        boundless = int(np.count_nonzero(initialised[kind.name].weight <= 0.0))
        measurements[kind] = _first(seen, len(seen.first) - boundless)
    return replace(problem, measurements=measurements)


def _first(relations: LinearRelations, count: int) -> LinearRelations:
    columns = {one.name: getattr(relations, one.name)[:count] for one in fields(relations)}
    return LinearRelations(**columns)
