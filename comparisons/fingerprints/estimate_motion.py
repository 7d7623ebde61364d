"""How an external filter integrates its odometry, for the references to do the same."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from typing import get_args

import numpy as np

from comparisons.adapters.motion import motion_samples
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array, Index
from comparisons.checks.grade import LIKE_SIGMA, Likeness, likeness
from comparisons.config import SolveConfig
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.reference import Reference
from comparisons.fingerprints.companion import Companion, EstimateLeftError, part_of_step
from comparisons.logs.log import Log
from comparisons.logs.odometry import Integration, Named, RelativePoses, own_integration
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.references import ORDERS, filter_named
from ekf_reference.core.geometry import wrap_angle

_WORDS: dict[Integration, str] = {
    "euler": "along the heading at their start",
    "middle": "along the heading in their middle",
    "arc": "along the arc of constant speed and turn",
}
_MOST_STEPS = 1000
"""More Euler steps a sample than these are an arc."""
_LEAST_TURN = 1e-3
"""Of the median turn: of smaller ones rounding hides in how many steps they were made."""
_NEARER = 0.01
"""Share of a trace's distance from our integration that another may leave: a fault leaves more."""
_HALF = 0.5
"""Share that it may leave of the distance from the nearest filter, where there is no trace."""


def integrations_of(
    given: ExternalEstimate,
    prepared: Prepared[SolveConfig],
    nearest: Likeness | None,
    filters: Iterable[str] = ORDERS,
) -> tuple[Integration, ...]:
    """Return which integrations explain an estimate better than the log's own, the nearest first.

    None, one, or those that explain it as well. given: its poses at the reference's times, and no
    others. nearest: what it is most like, by our integration; it is not equal. filters: names of
    those that it may be of, beside the nearest.
    """
    log = prepared.log
    if isinstance(log.odometry, RelativePoses):
        return ()
    ours = log.integration or own_integration(log.odometry)
    others: list[Integration] = [choice for choice in get_args(Named) if choice != ours]
    by_steps = integrations_by_steps(given, prepared)
    if by_steps is not None:
        return by_steps
    if nearest is None or nearest.reference.smoothed:
        return ()
    far = {ours: nearest.farthest}
    for integration, name in product(others, dict.fromkeys((nearest.reference.name, *filters))):
        other = replace(prepared, log=replace(log, integration=integration))
        between = part_of_step(other.log)
        beside = Companion(given, nearest, _HALF, LIKE_SIGMA, between)
        again = _kept(name, other, given, beside)
        if again is not None:
            apart_sigma = likeness(given, again, labelled=prepared.labelled).farthest
            far[integration] = min(apart_sigma, far.get(integration, apart_sigma))
    return _nearer(far, ours, _HALF)


def integrations_by_steps(
    given: ExternalEstimate, prepared: Prepared[SolveConfig]
) -> tuple[Integration, ...] | None:
    """Return which integrations the steps of an estimate have, none where it is the log's own.

    given: as of integrations_of. None where it has no such steps, or none fits.
    """
    log = prepared.log
    if isinstance(log.odometry, RelativePoses):
        return None
    steps, ours = _steps_of(given, prepared.timeline), log.integration
    if not len(steps.row):
        return None
    ours = ours or own_integration(log.odometry)
    others = (
        integration
        for integration in (*get_args(Named), *steps.several(log))
        if integration != ours
    )
    apart = {integration: steps.apart(log, integration) for integration in (ours, *others)}
    nearest = _nearer(apart, ours, _NEARER)
    can_tell = given.trace is not None or apart[ours] < _NEARER * max(apart.values())
    return nearest or (() if can_tell else None)


def distance_by_steps(given: ExternalEstimate, prepared: Prepared[SolveConfig]) -> float | None:
    """Return how far [m] an estimate's steps are from those of the nearest integration.

    given: as of integrations_of. None where it has no steps with nothing fused.
    """
    log = prepared.log
    if isinstance(log.odometry, RelativePoses):
        return None
    steps = _steps_of(given, prepared.timeline)
    if not len(steps.row):
        return None
    return min(
        steps.apart(log, integration) for integration in (*get_args(Named), *steps.several(log))
    )


def _kept(
    name: str, prepared: Prepared[SolveConfig], given: ExternalEstimate, beside: Companion
) -> Reference | None:
    """A filter's estimate; None where it breaks down or leaves the one that was given."""
    try:
        return filter_named(name, prepared, given.time_s, lambda ekf: beside)
    except EstimateLeftError:
        return None


def _nearer(
    far: dict[Integration, float], ours: Integration, share: float
) -> tuple[Integration, ...]:
    """Those that leave less than a share of what ours leaves, and no more than the least twice."""
    ranked = sorted(
        (integration for integration in far if integration != ours), key=far.__getitem__
    )
    return tuple(
        integration
        for integration in ranked
        if far[integration] < share * far[ours] and far[integration] <= 2.0 * far[ranked[0]]
    )


def in_words(integration: Integration) -> str:
    """Return how steps are integrated, after `the estimate's steps lead`."""
    if isinstance(integration, int):
        return f"in {integration} steps each, along the heading at the start of each"
    if isinstance(integration, float):
        return f"in steps of at most {integration:.3g} s, along the heading at the start of each"
    return _WORDS[integration]


@dataclass(frozen=True)
class _Steps:
    """Steps of a timeline, rows (n,), and how an estimate moves in them (n, 3), seen from there."""

    timeline: Timeline
    row: Index
    moved: Array

    @classmethod
    def between(cls, timeline: Timeline, row: Index, departed: Array, arrived: Array) -> _Steps:
        """Return displacements from poses (n, 3) to others."""
        way = (arrived - departed)[:, :2] @ (1.0, 1j) * np.exp(-1j * departed[:, 2])
        turn = wrap_angle(arrived[:, 2] - departed[:, 2])
        return cls(timeline, row, np.column_stack((way.real, way.imag, turn)))

    def expected(self, log: Log, integration: Integration) -> Array:
        """Return the displacements (n, 3) of an integration."""
        other = replace(log, integration=integration)
        return motion_samples(other, self.timeline).displacement[self.row]

    def apart(self, log: Log, integration: Integration) -> float:
        """The median distance [m] from steps of an integration, where they turn."""
        expected = self.expected(log, integration)
        turns = np.abs(expected[:, 2]) >= np.median(np.abs(expected[:, 2]))
        distance = np.linalg.norm((self.moved - expected)[turns, :2], axis=1)
        return float(np.median(distance))

    def several(self, log: Log) -> list[Integration]:
        """Return how long Euler steps are, and how many a sample has, if the turns tell.

        n of them lead along the heading after (n - 1) / 2 n of the turn. Of the lengths that
        explain the numbers of all samples that of the roundest rate.
        """
        start = self.expected(log, "euler")
        way, ours = ((path[:, :2] @ (1.0, 1j)) for path in (self.moved, start))
        turn, usual = np.abs(start[:, 2]), np.median(np.abs(start[:, 2]))
        known = (np.abs(ours) > 0.0) & (turn > _LEAST_TURN * usual)
        if not (known & (turn >= usual)).any():
            return []
        left = 1.0 - 2.0 * np.angle(way[known] / ours[known]) / start[known, 2]
        middle = float(np.median(left[turn[known] >= usual]))
        if not 1.0 / _MOST_STEPS < middle < 0.75:
            return []
        counts = np.round(1.0 / np.clip(left, 1.0 / _MOST_STEPS, 1.0))
        duration_s = self.timeline.step_duration_s[self.row][known]
        fastest = 1.0 / float((duration_s / counts).max())
        below = ((counts - 1.0) / duration_s).max()  # a rate that gives a step less
        unit = 10.0 ** np.arange(np.ceil(np.log10(fastest)), -4.0, -1.0)
        rates = np.floor(fastest / unit * (1.0 + 1e-9)) * unit
        rounded = rates[(rates > below) & (rates > 0.0)]
        return [1.0 / float(rounded[0]) if len(rounded) else 1.0 / fastest, round(1.0 / middle)]


def _steps_of(given: ExternalEstimate, timeline: Timeline) -> _Steps:
    """Return the steps that a trace has, or else those between poses with nothing fused."""
    if given.trace is not None:
        arrays = given.trace.trace
        count = len(arrays.departed)
        row = np.arange(count if count <= len(timeline.control) else 0)
        return _Steps.between(timeline, row, arrays.departed[row], arrays.arrived[row])
    begin_s, end_s = timeline.step_begin_s, timeline.step_end_s
    plain = np.isin(begin_s, given.time_s) & np.isin(end_s, given.time_s)
    row = np.flatnonzero(plain & ~np.isin(end_s, timeline.observed_s()))
    departed, arrived = (
        np.searchsorted(given.time_s, stamps_s[row]) for stamps_s in (begin_s, end_s)
    )
    return _Steps.between(timeline, row, given.pose[departed], given.pose[arrived])
