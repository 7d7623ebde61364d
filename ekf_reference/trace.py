"""What a filter linearised where: the record that lets another solver replay it exactly.

A trace holds the numbers the filter used, not the ones it should have used; a solver given the
same linear equations must reach the same estimate, or the filter's algebra is wrong.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ekf_reference.layout import ORIENTED
from ekf_reference.trace_records import (
    Array,
    SightingRecords,
    TraceArrays,
    fusion_records,
    position_records,
    removal_records,
    sighting_records,
    stacked,
)
from ekf_reference.trace_uses import (
    Beginning,
    FusionUse,
    PositionUse,
    Prediction,
    Removal,
    SightingUse,
)

__all__ = [
    "Array",
    "Beginning",
    "FusionUse",
    "NullTrace",
    "PositionUse",
    "Prediction",
    "RecordedTrace",
    "Removal",
    "SightingRecords",
    "SightingUse",
    "Trace",
    "TraceArrays",
]


class Trace(Protocol):
    """Receives every linearisation of a filter, in order.

    Poses have p entries: three (x, y, heading), or more where a filter's state has more.
    """

    def prior(self, start: Beginning) -> None:
        """Where the filter starts."""
        ...

    def prediction(self, step: Prediction) -> None:
        """One step of the vehicle."""
        ...

    def update(self, use: SightingUse) -> None:
        """Sightings of mapped landmarks."""
        ...

    def augmentation(self, use: SightingUse) -> None:
        """New landmarks."""
        ...

    def position(self, use: PositionUse) -> None:
        """An absolute position."""
        ...

    def oriented_update(self, use: SightingUse) -> None:
        """Sightings of mapped landmarks with a direction."""
        ...

    def oriented_augmentation(self, use: SightingUse) -> None:
        """New landmarks with a direction."""
        ...

    def fusion(self, use: FusionUse) -> None:
        """Two landmarks with a direction that are one."""
        ...

    def removal(self, gone: Removal) -> None:
        """Landmarks that are in the state no longer."""
        ...


class NullTrace:
    """Keeps nothing."""

    def prior(self, start: Beginning) -> None:
        """Discard."""

    def prediction(self, step: Prediction) -> None:
        """Discard."""

    def update(self, use: SightingUse) -> None:
        """Discard."""

    def augmentation(self, use: SightingUse) -> None:
        """Discard."""

    def position(self, use: PositionUse) -> None:
        """Discard."""

    def oriented_update(self, use: SightingUse) -> None:
        """Discard."""

    def oriented_augmentation(self, use: SightingUse) -> None:
        """Discard."""

    def fusion(self, use: FusionUse) -> None:
        """Discard."""

    def removal(self, gone: Removal) -> None:
        """Discard."""


class RecordedTrace:
    """Keeps everything, in memory."""

    def __init__(self) -> None:
        """Start empty."""
        self._prior = Beginning(np.zeros(3), np.eye(3))
        self._steps: list[Prediction] = []
        self._updates: list[tuple[int, SightingUse]] = []
        self._augmentations: list[tuple[int, SightingUse]] = []
        self._positions: list[tuple[int, PositionUse]] = []
        self._oriented_updates: list[tuple[int, SightingUse]] = []
        self._oriented_augmentations: list[tuple[int, SightingUse]] = []
        self._fusions: list[tuple[int, FusionUse]] = []
        self._removals: list[tuple[int, Removal]] = []

    def prior(self, start: Beginning) -> None:
        """Keep the prior."""
        self._prior = start

    def prediction(self, step: Prediction) -> None:
        """Keep one step."""
        self._steps.append(step)

    def update(self, use: SightingUse) -> None:
        """Keep one stacked update."""
        self._updates.append((len(self._steps), use))

    def augmentation(self, use: SightingUse) -> None:
        """Keep one augmentation."""
        self._augmentations.append((len(self._steps), use))

    def position(self, use: PositionUse) -> None:
        """Keep one fix or a part of it."""
        self._positions.append((len(self._steps), use))

    def oriented_update(self, use: SightingUse) -> None:
        """Keep one stacked update."""
        self._oriented_updates.append((len(self._steps), use))

    def oriented_augmentation(self, use: SightingUse) -> None:
        """Keep one augmentation."""
        self._oriented_augmentations.append((len(self._steps), use))

    def fusion(self, use: FusionUse) -> None:
        """Keep one fusion or a part of it."""
        self._fusions.append((len(self._steps), use))

    def removal(self, gone: Removal) -> None:
        """Keep which landmarks went."""
        self._removals.append((len(self._steps), gone))

    def arrays(self) -> TraceArrays:
        """Everything so far, stacked."""
        p = len(self._prior.pose)
        departed, arrived, f, q = stacked(self._steps, ((p,), (p,), (p, p), (p, p)))
        return TraceArrays(
            prior_pose=self._prior.pose,
            prior_covariance=self._prior.covariance,
            departed=departed,
            arrived=arrived,
            f=f,
            q=q,
            updates=sighting_records(self._updates, p),
            augmentations=sighting_records(self._augmentations, p),
            positions=position_records(self._positions, p),
            oriented_updates=sighting_records(self._oriented_updates, p, ORIENTED),
            oriented_augmentations=sighting_records(self._oriented_augmentations, p, ORIENTED),
            fusions=fusion_records(self._fusions),
            removals=removal_records(self._removals),
        )
