"""Corners for regions where no landmark can stand, such as inside buildings (Nieto 2005, 3.5.1).

The thesis augments the filter with them, which would change the rounding of its estimate. Here a
virtual landmark is a fixed linear function of its two real landmarks; it has no information of its
own.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.dense.triangles import turned

QUARTER_TURN = np.array([(0.0, -1.0), (1.0, 0.0)])


@dataclass(frozen=True)
class VirtualLandmarks:
    """The virtual landmarks of a map, oldest first.

    pair: (V, 2) places of L1, L2 in the map. depth: (V,) how far to the left of the way from L1
    to L2, as a share of their distance; negative to the right.
    """

    pair: Index = field(default_factory=lambda: np.empty((0, 2), dtype=np.intp))
    depth: Array = field(default_factory=lambda: np.empty(0))

    def point(self, landmark: Array) -> Array:
        """Where they are (V, 2) [m] with the map's landmarks (L, 2) where these are now.

        (L1 + L2) / 2 + depth R90 (L2 - L1), so NaN with either of them.
        """
        first, second = landmark[self.pair[:, 0]], landmark[self.pair[:, 1]]
        return 0.5 * (first + second) + self.depth[:, None] * turned(second - first)

    def jacobian(self) -> Array:
        """Their derivative (V, 2, 4) by L1x, L1y, L2x, L2y; exact, since they are linear."""
        aside = self.depth[:, None, None] * QUARTER_TURN
        return np.concatenate((0.5 * np.eye(2) - aside, 0.5 * np.eye(2) + aside), axis=2)

    def lift(self, base: Index) -> tuple[Index, Array]:
        """What the covariance of regions' corners follows from: lift P lift^T, P of the places.

        base: (k, 3) as of LocalRegions; a virtual corner's pair are the other two. Returns places
        in the map (k, 3), a virtual corner's being a repeated one, and the derivative
        (k, 6, 6) of the corners by the landmarks there.
        """
        place = np.where(base < 0, base.max(axis=1, keepdims=True), base)
        lift = np.tile(np.eye(6).reshape(3, 2, 3, 2), (len(base), 1, 1, 1, 1))
        region, corner = np.nonzero(base < 0)
        which = -1 - base[region, corner]
        lift[region, corner] = 0.0
        by_pair = self[which].jacobian().reshape(-1, 2, 2, 2)
        for end in range(2):
            column = (base[region] == self.pair[which, end, None]).argmax(axis=1)
            lift[region, corner, :, column] = by_pair[:, :, end]
        return place, lift.reshape(-1, 6, 6)

    def joined(self, other: VirtualLandmarks) -> VirtualLandmarks:
        """These, then others."""
        return VirtualLandmarks(
            np.concatenate((self.pair, other.pair)), np.concatenate((self.depth, other.depth))
        )

    def __getitem__(self, chosen: Index | Mask) -> VirtualLandmarks:
        """Some of them (k,)."""
        return VirtualLandmarks(self.pair[chosen], self.depth[chosen])


def behind(pair: Index, landmark: Array, position: Array, depth: float) -> VirtualLandmarks:
    """One virtual landmark for each pair, on the side away from a position (2,) [m].

    pair: (C, 2). landmark: (L, 2) [m]. Pairs on whose line the position lies are left out, since
    neither side is the far one; so are pairs that coincide.
    """
    first, second = landmark[pair[:, 0]], landmark[pair[:, 1]]
    normal = turned(second - first)
    side = ((position - first) * normal).sum(axis=1)
    spread = np.square(normal).sum(axis=1) + np.square(position - first).sum(axis=1)
    clear = np.abs(side) > 1e-9 * spread
    return VirtualLandmarks(pair, -np.copysign(depth, side))[clear]
