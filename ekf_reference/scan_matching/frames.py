"""Points and Gaussians of one landmark's frame in another's, for merging two templates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, rotation


class PointsInFrame(NamedTuple):
    """Points in the first frame. point: (k, 2) [m].

    by_point: (2, 2), the same of all. by_first, by_second: (k, 2, 3) by the frames' poses.
    """

    point: Array
    by_point: Array
    by_first: Array
    by_second: Array


def moved(first: Array, second: Array, point: Array) -> PointsInFrame:
    """Points (k, 2) of the second frame (3,) in the first (3,), and the Jacobians.

    Source: Nieto 2005, eqs. 5.6, 5.7 and 5.9 to 5.11. Erratum: 5.8 prints T = x_L2 - x_L1; turned
    into the axes of the first, R(-phi_L1) (x_L2 - x_L1), it holds.
    """
    r, into = rotation(float(second[2] - first[2])), rotation(-float(first[2]))
    turned = point @ r.T
    shift = into @ (second[:2] - first[:2])
    result = turned + shift
    by_first, by_second = np.empty((len(point), 2, 3)), np.empty((len(point), 2, 3))
    by_first[:, :, :2], by_second[:, :, :2] = -into, into
    by_first[:, 0, 2], by_first[:, 1, 2] = result[:, 1], -result[:, 0]
    by_second[:, 0, 2], by_second[:, 1, 2] = -turned[:, 1], turned[:, 0]
    return PointsInFrame(result, r, by_first, by_second)


def moved_gaussians(
    first: Array, second: Array, joint: Array, mean: Array, covariance: Array
) -> tuple[Array, Array]:
    """Gaussians (k, 2) and (k, 2, 2) of the second frame, in the first.

    first, second: (3,). joint: (6, 6) covariance of both, the first's before the second's.

    Source: Nieto 2005, eq. 5.12. Erratum: the cross terms are printed with a minus; they are
    added, for their signs are in the Jacobians.
    """
    at = moved(first, second, mean)
    by_frames = np.concatenate((at.by_first, at.by_second), axis=2)
    spread = at.by_point @ covariance @ at.by_point.T
    spread = spread + by_frames @ joint @ by_frames.transpose(0, 2, 1)
    return at.point, 0.5 * (spread + spread.transpose(0, 2, 1))
