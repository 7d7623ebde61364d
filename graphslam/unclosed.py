"""A place that a pose graph passes twice, and where no edge tells that it is one.

The optimum of such a graph may be found beyond doubt, and the map still have the place twice.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graphslam.arrays import Array
from graphslam.scan import planar
from graphslam.smoother import SmootherEvidence

_LOOSE = 10.0
"""Poses are loosely tied whose distance is known so many times worse than closures tell it.

And worse than the median step is long: a place that is nearer is none of its own."""
_APART = 5.0
"""A place is passed again after a way of so many of its sigmas."""
_TRIED, _SOLVED = 200, 6
"""Poses whose neighbours are looked for, and pairs of which the covariance is computed."""


class Unclosed(NamedTuple):
    """Two poses, their distance, and what the graph knows of the second in the first's frame."""

    first: int
    second: int
    apart_m: float
    sigma_m: float
    sigma_rad: float


def unclosed_passage(result: SmootherEvidence, covariance: Array) -> Unclosed | None:
    """Return two poses that lie nearer to each other than the graph can tell.

    Sigmas are smaller than stated where chi-square is lower than expected.

    Args:
        result: Of a graph with loop closures.
        covariance: (K, 3, 3) of the poses, additive global error.

    Returns:
        The loosest pair of those that are looked at; None where closures tie all.
    """
    closed = result.problem.loop_closures
    if not len(closed.first):
        return None
    test = result.optimality.chi_square
    scale = float(np.sqrt(min(1.0, test.chi2 / test.dof))) if test.dof > 0 else 1.0
    told = np.einsum("nii->ni", closed.covariance)[:, :2].sum(axis=1)
    step = float(np.median(np.hypot(*np.diff(result.poses[:, :2], axis=0).T)))
    least = max(_LOOSE * scale * float(np.sqrt(0.5 * np.median(told))), step)
    pairs = _near(result.poses, scale * _sigmas(covariance), least)
    found = _tied(result, pairs, scale)
    loose = [one for one in found if one.sigma_m > max(least, one.apart_m)]
    return max(loose, key=lambda one: one.sigma_m, default=None)


def _sigmas(covariance: Array) -> Array:
    """(K,) standard deviation of each place, along the direction that is known worst."""
    largest = np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
    return np.asarray(np.sqrt(np.maximum(largest, 0.0)), dtype=np.float64)


def _near(poses: Array, sigma: Array, least: float) -> list[tuple[int, int]]:
    """Pairs of poses that one passed long after the other, some along the drive."""
    from scipy.spatial import cKDTree  # takes long to load

    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))
    loose = np.flatnonzero(sigma > least)
    rows = loose[:: max(1, len(loose) // _TRIED)]
    tree, found = cKDTree(poses[:, :2]), list[tuple[int, int]]()
    for second in rows.tolist():
        reach = float(sigma[second])
        others = np.array(tree.query_ball_point(poses[second, :2], reach), dtype=np.intp)
        others = others[way[second] - way[others] > _APART * reach]
        if len(others):
            apart = np.hypot(*(poses[others, :2] - poses[second, :2]).T)
            found.append((int(others[np.argmin(apart)]), second))
    return found[:: -max(1, -(-len(found) // _SOLVED))]


def _tied(result: SmootherEvidence, pairs: list[tuple[int, int]], scale: float) -> list[Unclosed]:
    """Return what the graph knows of each second pose in the first's frame. scale: of sigmas."""
    if not pairs:
        return []
    poses, at = np.unique(pairs, return_inverse=True)
    joint = result.joint(poses.tolist(), ()).reshape(len(poses), 3, len(poses), 3)
    found = []
    for (first, second), rows in zip(pairs, at.reshape(-1, 2), strict=True):
        both = joint[rows][:, :, rows].reshape(6, 6)
        motion, spread = planar.relative(result.poses[first], result.poses[second], scale**2 * both)
        sigma = float(np.sqrt(np.linalg.eigvalsh(spread[:2, :2])[-1]))
        apart = float(np.hypot(*motion[:2]))
        found.append(Unclosed(first, second, apart, sigma, float(np.sqrt(spread[2, 2]))))
    return found
