"""The smoother's own association of a log's sightings to landmarks, without the filter's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from comparisons.adapters.smoother_input import PositionRows, assemble
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array, Index
from comparisons.logs.log import Log
from comparisons.logs.transforms.known_landmarks import surveyed
from graphslam.association import associate
from graphslam.problem import SlamProblem


@dataclass(frozen=True)
class OwnAssociation:
    """slot: (M,) landmark of each sighting, negative where unused; surveyed ones take the first.

    problem: what is to be smoothed. poses: (K, 3) and landmarks: (L, 2), a start for that.
    """

    slot: Index
    problem: SlamProblem
    poses: Array
    landmarks: Array


def associate_own(
    log: Log, timeline: Timeline, rows: PositionRows, left_out: Index | None = None
) -> OwnAssociation:
    """Decide who was seen, by position alone; sightings of surveyed landmarks go by their ids.

    left_out: sightings that are not to be used.
    """
    slot_of, places, _ = surveyed(log)
    label = log.sightings.landmark[: len(timeline.sighting_epoch)]
    slot = np.array([slot_of.get(key, -1) for key in label.tolist()], dtype=np.intp)
    free = slot < 0
    if left_out is not None:
        slot[left_out], free[left_out] = -1, False
    open_rows = np.flatnonzero(free)
    nobody = np.full(len(label), -1, dtype=np.intp)
    nobody[open_rows] = 0
    everything = assemble(log, timeline, nobody, 1, rows)
    nothing = np.zeros((0, 2)), np.zeros((0, 2, 2))
    found = associate(replace(everything, surveyed=nothing[0], surveyed_covariance=nothing[1]))
    slot[open_rows] = np.where(found.slot >= 0, found.slot + len(slot_of), -1)
    count = len(slot_of) + found.landmark_count
    problem = assemble(log, timeline, slot, count, rows)
    return OwnAssociation(slot, problem, found.poses, np.vstack((places, found.landmarks)))
