"""How an external filter integrates its odometry, for the references to do the same."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from typing import get_args

import numpy as np

from comparisons.adapters.motion import motion_samples
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array
from comparisons.checks.grade import LIKE_SIGMA, Likeness, Reference, likeness
from comparisons.config import SolveConfig
from comparisons.estimates.external import ExternalEstimate
from comparisons.fingerprints.companion import Companion, Left
from comparisons.logs.log import Log
from comparisons.logs.odometry import Integration, Named, RelativePoses, own_integration
from comparisons.pipeline.prepare import Prepared
from comparisons.pipeline.references import ORDERS, filter_named

_WORDS: dict[Integration, str] = {
    "euler": "along the heading at their start",
    "middle": "along the heading in their middle",
    "arc": "along the arc of constant speed and turn",
}
_MOST_STEPS = 1000
"""More Euler steps a sample than these are an arc."""
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
    others: list[Integration] = [one for one in get_args(Named) if one != ours]
    if given.trace is not None:
        arrays, timeline = given.trace.trace, prepared.timeline
        count = len(arrays.departed)
        if count and count <= len(timeline.control):
            moved = _moved(arrays.departed, arrays.arrived)
            others += _euler_steps(log, timeline, moved)
            apart = {one: _apart(log, timeline, moved, one) for one in (ours, *others)}
            return _nearer(apart, ours, _NEARER)
    if nearest is None or nearest.reference.smoothed:
        return ()
    found = {ours: nearest.farthest}
    for one, name in product(others, dict.fromkeys((nearest.reference.name, *filters))):
        other = replace(prepared, log=replace(log, integration=one))
        again = _kept(name, other, given, Companion(given, nearest, _HALF, LIKE_SIGMA))
        if again is not None:
            far = likeness(given, again, labelled=prepared.labelled).farthest
            found[one] = min(far, found.get(one, far))
    return _nearer(found, ours, _HALF)


def _kept(
    name: str, prepared: Prepared[SolveConfig], given: ExternalEstimate, beside: Companion
) -> Reference | None:
    """A filter's estimate; None where it breaks down or leaves the one that was given."""
    try:
        return filter_named(name, prepared, given.time_s, lambda ekf: beside)
    except Left:
        return None


def _nearer(
    far: dict[Integration, float], ours: Integration, share: float
) -> tuple[Integration, ...]:
    """Those that leave less than a share of what ours leaves, and no more than the least twice."""
    ranked = sorted((one for one in far if one != ours), key=far.__getitem__)
    return tuple(
        one for one in ranked if far[one] < share * far[ours] and far[one] <= 2.0 * far[ranked[0]]
    )


def _moved(departed: Array, arrived: Array) -> Array:
    """(N, 3) displacements in the departing frame."""
    way = (arrived - departed)[:, :2] @ (1.0, 1j) * np.exp(-1j * departed[:, 2])
    return np.column_stack((way.real, way.imag, arrived[:, 2] - departed[:, 2]))


def in_words(integration: Integration) -> str:
    """Return how steps are integrated, after `the estimate's steps lead`."""
    if isinstance(integration, int):
        return f"in {integration} steps each, along the heading at the start of each"
    return _WORDS[integration]


def _euler_steps(log: Log, timeline: Timeline, moved: Array) -> list[Integration]:
    """Return in how many Euler steps a sample was moved on (N, 3), if the turns tell.

    n of them lead along the heading after (n - 1) / 2 n of the turn.
    """
    start = motion_samples(replace(log, integration="euler"), timeline).displacement[: len(moved)]
    turns = np.abs(start[:, 2]) >= np.median(np.abs(start[:, 2]))
    way, ours = ((one[turns, :2] @ (1.0, 1j)) for one in (moved, start))
    turn = start[turns, 2]
    known = (np.abs(ours) > 0.0) & (turn != 0.0)
    if not known.any():
        return []
    share = float(np.median(np.angle(way[known] / ours[known]) / turn[known]))
    left = 1.0 - 2.0 * share
    if not 1.0 / _MOST_STEPS < left < 0.75:
        return []
    return [round(1.0 / left)]


def _apart(log: Log, timeline: Timeline, moved: Array, integration: Integration) -> float:
    """The median distance [m] of steps (N, 3) from those of an integration, where they turn."""
    samples = motion_samples(replace(log, integration=integration), timeline)
    expected = samples.displacement[: len(moved)]
    turns = np.abs(expected[:, 2]) >= np.median(np.abs(expected[:, 2]))
    distance = np.linalg.norm((moved - expected)[turns, :2], axis=1)
    return float(np.median(distance))
