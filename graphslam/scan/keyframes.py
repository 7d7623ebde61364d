"""The poses whose scans stand for a drive, and what the graph believes of them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from graphslam.arrays import Array, Index
from graphslam.problem import SlamProblem
from graphslam.scan import planar
from graphslam.smoother import SmootherResult


def choose_keyframes(
    problem: SlamProblem, seen_from: Iterable[int], apart_m: float, apart_rad: float
) -> Index:
    """(F,) of the poses with scans, one at least every so many metres and radians of the drive."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*problem.increment[:, :2].T))))
    turn = np.concatenate(([0.0], np.cumsum(np.abs(problem.increment[:, 2]))))
    chosen: list[int] = []
    for k in sorted(seen_from):
        if (
            not chosen
            or way[k] - way[chosen[-1]] >= apart_m
            or turn[k] - turn[chosen[-1]] >= apart_rad
        ):
            chosen.append(k)
    return np.array(chosen, dtype=np.intp)


class KeyframeEstimate:
    """Poses of keyframes with their joint covariance, of the additive global error."""

    def __init__(self, result: SmootherResult, keyframes: Index) -> None:
        """keyframes: (F,) numbers of poses."""
        self.keyframes = keyframes
        self.pose = result.poses[keyframes]
        size = len(keyframes)
        joint = result.joint(keyframes.tolist(), [])
        self._joint = joint.reshape(size, 3, size, 3).transpose(0, 2, 1, 3)

    def position_spread(self, earlier: Index, later: int) -> Array:
        """(N, 2, 2) covariances of the places' differences."""
        own = np.arange(len(self.keyframes))
        spread = self._joint[own, own][:, :2, :2]
        cross = self._joint[earlier, later][:, :2, :2]
        result: Array = spread[earlier] + spread[later] - cross - cross.transpose(0, 2, 1)
        return result

    def relative(self, first: int, second: int) -> tuple[Array, Array]:
        """(3,) the second in the first's frame, with covariance (3, 3) in those axes."""
        block = np.block([[self._joint[i, j] for j in (first, second)] for i in (first, second)])
        return planar.relative(self.pose[first], self.pose[second], block)

    def misplacement(self, base: int, around: range, motion: Array) -> Array:
        """(3, 3) how far keyframes around a base, as placed by the graph, may lead a match astray.

        Of the right perturbation of a motion (3,) from the base. The match follows each in part;
        the mean of their covariances bounds that of their mean, however they are correlated.
        """
        total = np.zeros((3, 3))
        for k in around:
            place, spread = self.relative(base, k)
            own = planar.rotation(place[2]).T
            total += planar.carried(own @ spread @ own.T, planar.between(place, motion))
        mean: Array = total / len(around)
        return mean
