"""Where in a filter's state the pose and the landmarks lie.

Landmarks are numbered by kind, each number being a slot: points apart from those that have a
direction, too. In the state they follow the pose in the order of their arrival. A slot is for
good; a landmark that is removed leaves it empty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ekf_reference.core.geometry import Index

POINT = 2
"""Entries of a landmark that is a point: x, y. The width of a landmark tells its kind."""
POSE = 3
"""Entries of a landmark with a direction: x, y, heading."""
ABSENT = -1
"""First entry of a landmark that was removed."""


@dataclass(frozen=True)
class Layout:
    """The entries of a state.

    pose_size: of the pose, which comes first. size: of all. point: (L,) and oriented: (Q,) first
    entry of each landmark by slot, ABSENT where it was removed.
    """

    pose_size: int
    size: int
    point: Index
    oriented: Index

    @classmethod
    def of_pose(cls, pose_size: int) -> Layout:
        """A pose alone."""
        nothing = np.zeros(0, dtype=np.intp)
        return cls(pose_size, pose_size, nothing, nothing)

    @property
    def plain(self) -> bool:
        """Only points, none of which was removed: place 2 slot behind the pose."""
        return not len(self.oriented) and self.size == self.pose_size + POINT * len(self.point)

    def first(self, width: int) -> Index:
        """(L,) or (Q,) first entries of all landmarks of a kind. Raises ValueError."""
        if width not in (POINT, POSE):
            raise ValueError(f"landmarks of {width} entries, expected {POINT} or {POSE}")
        return self.point if width == POINT else self.oriented

    def present(self, width: int = POINT) -> Index:
        """Index of a kind that have not been removed, ascending."""
        return np.flatnonzero(self.first(width) != ABSENT)

    def columns(self, slot: Index, width: int = POINT) -> Index:
        """State entries (p + w m,) of the pose and some landmarks (m,) of a kind.

        Raises ValueError for a landmark that was removed.
        """
        p, first = self.pose_size, self.first(width)[slot]
        if first.min(initial=0) < 0:
            gone = np.asarray(slot)[first == ABSENT].tolist()
            raise ValueError(f"landmarks {gone} of {width} entries were removed from the state")
        columns = np.empty(p + width * len(first), dtype=np.intp)
        columns[:p] = np.arange(p)
        for i in range(width):
            columns[p + i :: width] = first + i
        return columns

    def packed(self) -> Index:
        """The entries of the pose, the points, then the landmarks with a direction, by slot."""
        p, oriented = self.pose_size, self.present(POSE)
        points = self.columns(self.present(POINT), POINT)
        return np.concatenate((points, self.columns(oriented, POSE)[p:]))

    def numbered(self, kinds: tuple[int, ...]) -> tuple[Index, Index]:
        """Numbers (m,), ascending, and first entries (m,) of the landmarks there are of some kinds.

        Landmark `slot` of the k-th of n kinds has the number n slot + k, for good: with one kind
        numbers are slots.
        """
        slots = [self.present(width) for width in kinds]
        number = np.concatenate([len(kinds) * s + k for k, s in enumerate(slots)])
        each = zip(kinds, slots, strict=True)
        first = np.concatenate([self.first(width)[s] for width, s in each])
        order = np.argsort(number)
        return number[order], first[order]

    def blocks(self) -> list[slice]:
        """The entries of every landmark, in their order in the state."""
        kinds = ((self.point, POINT), (self.oriented, POSE))
        spans = sorted((at, width) for first, width in kinds for at in first.tolist())
        return [slice(at, at + width) for at, width in spans if at != ABSENT]

    def slots_in(self, columns: Index, width: int) -> Index:
        """Index of a kind, ascending, whose entries are among some (c,)."""
        first = self.first(width)
        return np.flatnonzero((first != ABSENT) & np.isin(first, columns))

    def appended(self, count: int, width: int) -> Layout:
        """With `count` more landmarks of a kind."""
        new = self.size + width * np.arange(count)
        grown = np.concatenate((self.first(width), new))
        size = self.size + width * count
        if width == POINT:
            return Layout(self.pose_size, size, grown, self.oriented)
        return Layout(self.pose_size, size, self.point, grown)

    def continued(self, other: Layout, start: int) -> Layout:
        """With those landmarks of another layout that lie at its entry `start` and beyond."""
        shift = self.size - start
        kinds = (
            np.concatenate((own, first[first >= start] + shift))
            for own, first in ((self.point, other.point), (self.oriented, other.oriented))
        )
        return Layout(self.pose_size, other.size + shift, *kinds)

    def without(self, slot: Index, width: int) -> Layout:
        """With the slots (m,) of a kind empty and what lies behind them moved up."""
        gone = np.zeros(self.size + 1, dtype=np.intp)
        gone[self.columns(slot, width)[self.pose_size :]] = 1
        before = np.cumsum(gone) - gone  # removed entries in front of each
        marked = replace(self, size=self.size - int(gone.sum()))
        kinds = []
        for kind in (POINT, POSE):
            first = self.first(kind).copy()
            there = first != ABSENT
            first[there] -= before[first[there]]
            if kind == width:
                first[slot] = ABSENT
            kinds.append(first)
        return replace(marked, point=kinds[0], oriented=kinds[1])

    def part(self, columns: Index) -> Layout:
        """Of a state that has only some entries (c,), the pose's first; slots count anew."""
        place = np.full(self.size, ABSENT)
        place[columns] = np.arange(len(columns))
        kinds = (place[first[first != ABSENT]] for first in (self.point, self.oriented))
        return Layout(self.pose_size, len(columns), *(at[at != ABSENT] for at in kinds))
