"""What a scan matcher is, and what it says of its result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from graphslam.arrays import Array
from graphslam.scan import planar


class ScanError(ValueError):
    """A scan that cannot be used, or a match that cannot be trusted. The message says why."""


@dataclass(frozen=True, kw_only=True)
class Registration:
    """How a source cloud lies in a target's frame, with evidence.

    motion: (3,) x, y [m], heading [rad]. covariance: (3, 3) of the right perturbation, in the
    source's frame. inliers: pairs used at the end. overlap: their share of the source's points.
    residual_m: root mean square distance of the pairs along the target's normals.
    stiffness: (3,) how many pairs fix each principal direction, least first, with heading scaled to
    metres; a direction that the shape does not fix has next to none. open_directions: how many of
    the three count as not fixed.
    """

    motion: Array
    covariance: Array
    inliers: int
    overlap: float
    residual_m: float
    stiffness: Array
    open_directions: int = 0


def squared_distance(match: Registration, expected: Array, spread: Array) -> float:
    """How far a match is from where it was expected (3,), by both covariances; chi-square of 3.

    spread: (3, 3) of the expectation, in the target's axes.
    """
    difference = planar.wrapped(match.motion - expected)
    turn = planar.rotation(match.motion[2])
    total = spread + turn @ match.covariance @ turn.T
    return float(difference @ np.linalg.solve(total, difference))


class Matcher(Protocol):
    """Finds the planar motion that lays one cloud onto another."""

    def match(self, source: Array, target: Array, guess: Array) -> Registration:
        """Align source (N, 3) to target (M, 3), forward, left, up in metres, from a guess (3,).

        Raises ScanError where nothing can be aligned or the result cannot be trusted.
        """
