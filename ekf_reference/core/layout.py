"""Where in a filter's state the pose and the landmarks lie.

A landmark has a landmark index among those of its kind, by order of incorporation. A landmark index
is for good: one whose landmark was removed, or is not in this part of the state, is ABSENT.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import KINDS, POINT, POSE, LandmarkKind

ABSENT = -1
"""First entry of a landmark that is not in the state."""


@dataclass(frozen=True)
class Layout:
    """The entries of a state: the pose, then the landmarks in order of incorporation.

    pose_size: entries of the pose. size: of all. first: (L,) first entry of each landmark by its
    landmark index, for each kind; ABSENT where there is none.
    """

    pose_size: int
    size: int
    first: Mapping[LandmarkKind, Index]

    @classmethod
    def of_pose(cls, pose_size: int) -> Layout:
        """Return the layout of a pose alone.

        Args:
            pose_size: p, entries of the pose.

        Returns:
            A layout without landmarks.
        """
        return cls(pose_size, pose_size, {kind: np.zeros(0, dtype=np.intp) for kind in KINDS})

    @classmethod
    def packed(cls, pose_size: int, *counts: int) -> Layout:
        """Return the layout of a pose and landmarks kind after kind, as estimates have them.

        Args:
            pose_size: p, entries of the pose.
            counts: Landmarks of each of KINDS; none of those left out.

        Returns:
            A layout of p + w L + ... entries.
        """
        layout = cls.of_pose(pose_size)
        for kind, count in zip(KINDS, counts, strict=False):
            layout = layout.appended(count, kind)
        return layout

    @property
    def angles(self) -> Index:
        """(a,) entries that are angles, those of a pose x, y, heading among them."""
        pose = POSE.angles if self.pose_size == POSE.width else ()
        each = [first[:, None] + np.array(kind.angles, int) for kind, first in self.first.items()]
        return np.concatenate((np.array(pose, int), *(entry.ravel() for entry in each)))

    def present(self, kind: LandmarkKind = POINT) -> Index:
        """Return the landmarks of a kind that are in the state.

        Args:
            kind: Of the landmarks.

        Returns:
            (m,) landmark indices, ascending.
        """
        return np.flatnonzero(self.first[kind] != ABSENT)

    def columns(self, landmark_index: Index, kind: LandmarkKind = POINT) -> Index:
        """Return the state entries of the pose and of some landmarks.

        Args:
            landmark_index: (m,) landmark indices, in any order, also repeated.
            kind: Of the landmarks.

        Returns:
            (p + w m,) entries: the pose's, then those of each landmark in the order asked for.

        Raises:
            ValueError: A landmark is not in the state.

        Source: Guivant 2002, eq. 4; Misono 2007, eq. 7; Nieto 2005, eqs. 2.2, 2.12, 2.25, 5.3, 6.1.
        """
        first = self.first[kind][landmark_index]
        if first.min(initial=0) < 0:
            gone = np.asarray(landmark_index)[first == ABSENT].tolist()
            raise ValueError(f"{kind.name} landmarks {gone} were removed from the state")
        entries = (first[:, None] + np.arange(kind.width)).ravel()
        return np.concatenate((np.arange(self.pose_size), entries))

    def blocks(self, covariance: Array, kind: LandmarkKind = POINT) -> Array:
        """Return the covariance of each landmark of a kind alone.

        Args:
            covariance: (n, n), of all entries.
            kind: Of the landmarks, all of them present.

        Returns:
            (L, w, w).
        """
        entry = self.first[kind][:, None] + np.arange(kind.width)
        own: Array = covariance[entry[:, :, None], entry[:, None]]
        return own

    def by_kind(self) -> Index:
        """Return all entries: the pose's, then those of each kind by landmark index."""
        p = self.pose_size
        entries = [self.columns(self.present(kind), kind)[p:] for kind in KINDS]
        return np.concatenate((np.arange(p), *entries))

    def appended(self, count: int, kind: LandmarkKind) -> Layout:
        """Return the layout with more landmarks behind the last entry.

        Args:
            count: How many.
            kind: Of them.

        Returns:
            The larger layout.
        """
        new = np.concatenate((self.first[kind], self.size + kind.width * np.arange(count)))
        return Layout(self.pose_size, self.size + kind.width * count, {**self.first, kind: new})

    def continued(self, part: Layout, start: int) -> Layout:
        """Return the layout with the landmarks that a part of it has beyond one of its entries.

        Args:
            part: Layout of some of this one's entries, grown by new landmarks.
            start: The part's first entry that is new.

        Returns:
            The larger layout, the new landmarks behind the last entry.
        """
        first, shift = dict(self.first), self.size - start
        for kind, own in self.first.items():
            first[kind] = np.concatenate((own, part.first[kind][len(own) :] + shift))
        return Layout(self.pose_size, part.size + shift, first)

    def part(self, columns: Index) -> Layout:
        """Return the layout of a state that has only some entries.

        Args:
            columns: (c,) entries, the pose's first; whole landmarks.

        Returns:
            The smaller layout; landmark indices are the same, ABSENT for what is left out.
        """
        place = np.full(self.size + 1, ABSENT)  # one more: what is ABSENT stays so
        place[columns] = np.arange(len(columns))
        first = {kind: place[entry] for kind, entry in self.first.items()}
        return Layout(self.pose_size, len(columns), first)
