"""What a filter has learnt of directions that its sensors cannot tell: the result.

comparisons.audit.spurious computes it, for runs, checks and audits alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.trace.events import Blocks

VEHICLE = "pose"
"""The vehicle's block in traces of planar filters."""
HEADING = "heading"
"""The direction of planar SLAM that linearisation errors tell of."""
PARTS = 100
"""Into which the updates are divided to find where most was learnt."""


class LargestShare(NamedTuple):
    """The update with which the information about a direction grew most.

    blocks: of its measurement that told most, given those before it in the update.
    """

    event: int
    time_s: float | None
    sensor: str
    information: float
    blocks: Blocks

    @property
    def seen(self) -> str:
        """What was measured, in words: the blocks but the vehicle."""
        return " and ".join(name for name in self.blocks if name != VEHICLE)


class LearntDirection(NamedTuple):
    """One direction. information: of it alone, the others unknown; zero where all is rounding.

    by_sensor: shares in the information with the others known. largest: None where there is none.
    unit: of sigma, by the direction's name; empty where that says nothing.
    """

    name: str
    unit: str
    information: float
    by_sensor: dict[str, float]
    largest: LargestShare | None

    @property
    def sigma(self) -> float:
        """With which the direction seems to be known, in its unit; infinite without information."""
        if self.information <= 0.0:
            return float("inf")
        return float((180.0 / np.pi if self.unit == "deg" else 1.0) / np.sqrt(self.information))


class Learnt(NamedTuple):
    """What was learnt of all d directions.

    information: (d, d). event: (C + 1,) of the curve, from the one that records the directions.
    time_s: (C + 1,), NaN where unknown. growth: (C + 1, d) information about each direction, the
    others unknown, gathered until then, from zero.
    """

    directions: tuple[LearntDirection, ...]
    information: Array
    event: Index
    time_s: Array
    growth: Array

    def of(self, name: str) -> LearntDirection:
        """Return a direction by its name."""
        return self.directions[self._place(name)]

    def curve(self, name: str) -> tuple[Array, Array]:
        """Return time_s (P + 1,) and information (P + 1,), after each of at most PARTS parts."""
        rows = np.unique(np.linspace(0, len(self.event) - 1, PARTS + 1).astype(np.intp))
        return self.time_s[rows], self.growth[rows, self._place(name)]

    def fastest(self, name: str) -> tuple[float, float, float]:
        """Return begin and end of the part in which most was learnt, and how much that was."""
        time_s, information = self.curve(name)
        if len(time_s) < 2:
            return float(time_s[0]), float(time_s[0]), 0.0
        gained = np.diff(information)
        row = int(gained.argmax())
        return float(time_s[row]), float(time_s[row + 1]), float(gained[row])

    def _place(self, name: str) -> int:
        return [one.name for one in self.directions].index(name)
