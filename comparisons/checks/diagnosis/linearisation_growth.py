"""Where linearising cost something: the filter's linear equations against the true ones, at S.

A relation that the filter linearised says a dx = b + noise around its point. At the optimum S its
residual b - a dx should be the nonlinear one; what it is off by, in units of the relation's noise,
is its linearisation error. F2 minus S is what all of these, put through the normal equations,
amount to (with the Jacobians' own change).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.estimates.estimate import Estimate
from ekf_reference.core.geometry import wrap_angle
from graphslam.layout import POINT, POSE_LANDMARK
from graphslam.linear_problem import LinearProblem, LinearRelations, times


@dataclass(frozen=True)
class LinearisationError:
    """Per relation of one kind: its epoch (M,), landmark index (M,) or -1, and error (M,) [sigma].

    The error is the length of the whitened vector.
    """

    kind: str
    epoch: Index
    landmark_index: Index
    sigma: Array


@dataclass(frozen=True)
class LinearisationGrowth:
    """Over the epochs (K,): squared errors of all relations there, summed [sigma^2].

    kind, epoch, landmark index, sigma: of the worst relation. landmark_index: -1 where it sees no
    landmark.
    """

    squared: Array
    kind: str
    epoch: int
    landmark_index: int
    sigma: float

    @property
    def total(self) -> float:
        """Sum over the whole log [sigma^2]."""
        return float(self.squared.sum())

    def reached(self, share: float) -> int:
        """The epoch by which this share of the total has come together."""
        gathered = np.cumsum(self.squared)
        return int(np.searchsorted(gathered, share * gathered[-1]))


def linearisation_growth(
    frozen: LinearProblem, optimum: LinearProblem, smoothed: Estimate
) -> LinearisationGrowth:
    """Of one problem's relations, linearised by the filter and at the optimum.

    frozen: F2. optimum: the same relations, in the same order, linearised at S, smoothed,
    which has all landmarks by landmark index. That two are one belongs to no instant, and is left
    out.
    """
    poses = smoothed.pose
    steps = _relations("a prediction", frozen.motion, optimum.motion, poses, poses)
    none = np.full(len(steps.epoch), -1)
    every = [replace(steps, epoch=frozen.motion.second, landmark_index=none)]
    for kind, name, landmarks in (
        (POINT, "a measurement", smoothed.landmark),
        (POSE_LANDMARK, "a template alignment", smoothed.pose_landmarks),
    ):
        if kind in frozen.measurements:
            seen = frozen.measurements[kind], optimum.measurements[kind]
            every.append(_relations(name, *seen, poses, landmarks))
    every.append(_positions(frozen, optimum, poses))
    squared = np.zeros(len(poses))
    for error in every:
        np.add.at(squared, error.epoch, error.sigma**2)
    worst = max(every, key=lambda one: one.sigma.max(initial=0.0))
    if not len(worst.sigma):
        return LinearisationGrowth(squared, "nothing", 0, -1, 0.0)
    row = int(np.argmax(worst.sigma))
    at = int(worst.epoch[row]), int(worst.landmark_index[row])
    return LinearisationGrowth(squared, worst.kind, *at, float(worst.sigma[row]))


def _relations(
    kind: str, f: LinearRelations, at: LinearRelations, first: Array, second: Array
) -> LinearisationError:
    """Of relations between states (n, p) and (m, w)."""
    said = f.b - times(f.a, _from(f.first_point, first[f.first]))
    said -= times(f.c, _from(f.second_point, second[f.second]))
    return LinearisationError(kind, f.first, f.second, np.linalg.norm(said - at.b, axis=1))


def _positions(frozen: LinearProblem, optimum: LinearProblem, poses: Array) -> LinearisationError:
    f = frozen.positions
    said = f.b - times(f.a, _from(f.pose, poses[f.node]))
    sigma = np.linalg.norm(said - optimum.positions.b, axis=1)
    return LinearisationError("a position", f.node, np.full(len(f.node), -1), sigma)


def _from(point: Array, place: Array) -> Array:
    """Places (N, 2) or (N, 3) seen from points of linearisation, headings the short way round."""
    apart = place - point
    apart[:, 2:] = wrap_angle(apart[:, 2:])
    return apart
