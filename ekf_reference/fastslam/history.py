"""What a cloud of particles was at every epoch, and which of them have descendants."""

from __future__ import annotations

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.fastslam.resampling import effective_sample_size


class CloudHistory:
    """Poses and parents of every epoch, so that a surviving particle's path can be traced back.

    Of an epoch all is recorded before resampling. N * 24 bytes an epoch, and N * 8 for each
    resampling.

    pose: list of (N, 3). parents: list of (N,), None where nothing was resampled after. mean: list
    of (3,) weighted means. effective: list of effective sample sizes. origin: (N,) particle of the
    first epoch from which each present one descends; None before the first resampling.
    """

    def __init__(self) -> None:
        """Start without epochs."""
        self.pose: list[Array] = []
        self.parents: list[Index | None] = []
        self.mean: list[Array] = []
        self.effective: list[float] = []
        self.origin: Index | None = None

    def add(self, pose: Array, weight: Array) -> None:
        """Append an epoch.

        Args:
            pose: (N, 3) x, y [m], heading [rad], unwrapped; kept, not copied.
            weight: (N,) that sum to one.
        """
        self.pose.append(pose)
        self.mean.append(weight @ pose)
        self.effective.append(effective_sample_size(weight))
        self.parents.append(None)

    def inherit(self, parents: Index) -> None:
        """Record the parents of the generation that follows the last epoch.

        Args:
            parents: (N,) particle of the last epoch that each new one is a copy of.
        """
        self.parents[-1] = parents
        self.origin = parents if self.origin is None else self.origin[parents]

    def effective_ancestors(self, weight: Array) -> float:
        """Return 1 / sum w^2 over the particles of the first epoch.

        Args:
            weight: (N,) of the present particles, which sum to one.

        Returns:
            The effective sample size where a particle has the weight of all its descendants.
        """
        if self.origin is None:
            return effective_sample_size(weight)
        of_origin: Array = np.bincount(self.origin, weight).astype(float)
        return effective_sample_size(of_origin)

    def ancestors(self) -> Index:
        """Return the particle (K, N) from which each particle of the last cloud descends."""
        if not self.pose:
            return np.zeros((0, 0), dtype=np.intp)
        found = np.empty((len(self.pose), len(self.pose[0])), dtype=np.intp)
        index: Index = np.arange(found.shape[1])
        for k in range(len(found) - 1, -1, -1):
            parents = self.parents[k]
            index = index if parents is None else parents[index]
            found[k] = index
        return found

    def distinct(self) -> Index:
        """Return how many particles (K,) of each epoch have descendants in the last cloud."""
        ordered = np.sort(self.ancestors(), axis=1)
        found: Index = 1 + np.count_nonzero(np.diff(ordered, axis=1), axis=1)
        return found
