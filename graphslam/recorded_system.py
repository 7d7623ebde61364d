"""Grade F1 of the frozen smoother: the matrices that the filter recorded.

A frozen smoother has all states of a log in one linear problem, linearised where the EKF was.
Grade F2 takes this package's own factors at the filter's points, in model_system. An EKF is the
exact recursive solution of such a problem, so F1 must equal the filter and F2 must equal F1, to
rounding.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from graphslam.arrays import Array, Index
from graphslam.layout import LandmarkKind
from graphslam.linear_problem import (
    LinearPositions,
    LinearPrior,
    LinearProblem,
    LinearRelations,
    LinearSurvey,
    divided,
    whiten,
)

_NOTHING = 1e-14
"""Share of the noise's own variances below which there is none, to rounding."""


@dataclass(frozen=True)
class RecordedPrior:
    """Where the filter began. pose: (p,). covariance: (p, p)."""

    pose: Array
    covariance: Array


@dataclass(frozen=True)
class RecordedSteps:
    """N predictions x' = arrived + f (x - departed) + w, w ~ N(0, q), one after the other.

    departed, arrived: (N, p). f, q: (N, p, p).
    """

    departed: Array
    arrived: Array
    f: Array
    q: Array


@dataclass(frozen=True, kw_only=True)
class RecordedRelations:
    """M times residual = jacobian_first (x - first_point) + jacobian_second (y - second_point) + v.

    States, indices and shapes are as in LinearRelations: residual: (M, w). jacobian_first:
    (M, w, p). jacobian_second: (M, w, w). covariance: (M, w, w) of v.
    """

    first: Index
    second: Index
    first_point: Array
    second_point: Array
    residual: Array
    jacobian_first: Array
    jacobian_second: Array
    covariance: Array

    def whitened(self) -> LinearRelations:
        """Return the same with noise of unit covariance, or none where there is none."""
        sigma, (a, c, b) = _whitened(
            self.covariance, self.jacobian_first, self.jacobian_second, self.residual
        )
        return LinearRelations(
            first=self.first,
            second=self.second,
            first_point=self.first_point,
            second_point=self.second_point,
            a=a,
            c=c,
            b=b,
            sigma=sigma,
        )


@dataclass(frozen=True)
class RecordedPositions:
    """G relations residual = jacobian_pose (x - pose) + v.

    node: (G,) pose. pose: (G, p). residual: (G, 2). jacobian_pose: (G, 2, p). covariance:
    (G, 2, 2) of v.
    """

    node: Index
    pose: Array
    residual: Array
    jacobian_pose: Array
    covariance: Array


def recorded_system(
    prior: RecordedPrior,
    steps: RecordedSteps,
    until: Index,
    measurements: Mapping[LandmarkKind, RecordedRelations],
    merges: Mapping[LandmarkKind, RecordedRelations],
    positions: RecordedPositions,
) -> LinearProblem:
    """Return F1: what the filter's own recorded matrices say.

    Args:
        prior: where the filter began.
        steps: its predictions.
        until: (K,) steps made when each pose is reached, ascending from 0.
        measurements: of landmarks from poses, by the landmarks' kind.
        merges: of two landmarks that are one, by their kind.
        positions: absolute fixes.

    Raises:
        numpy.linalg.LinAlgError: a recorded covariance is singular.
    """
    known, (start,) = _whitened(prior.covariance[None], np.eye(len(prior.pose))[None])
    return LinearProblem(
        prior=LinearPrior(prior.pose, start[0], None if known is None else known[0]),
        motion=recorded_motion(steps, until),
        measurements={kind: seen.whitened() for kind, seen in measurements.items()},
        merges={kind: merged.whitened() for kind, merged in merges.items()},
        positions=LinearPositions(
            positions.node,
            positions.pose,
            *whiten(positions.covariance, positions.jacobian_pose, positions.residual),
        ),
        survey=LinearSurvey(np.zeros((0, 2)), np.zeros((0, 2, 2))),
    )


def recorded_motion(every: RecordedSteps, until: Index) -> LinearRelations:
    """Return predictions as relations of each pose and the next.

    Args:
        every: the filter's predictions.
        until: (K,) steps made when each pose is reached, ascending from 0.

    Raises:
        numpy.linalg.LinAlgError: a recorded covariance is singular.
    """
    steps, pose = _compose(every, until), np.arange(len(until))
    return RecordedRelations(
        first=pose[:-1],
        second=pose[1:],
        first_point=steps.departed,
        second_point=steps.arrived,
        residual=np.zeros_like(steps.arrived),
        jacobian_first=-steps.f,
        jacobian_second=np.broadcast_to(np.eye(steps.f.shape[1]), steps.f.shape),
        covariance=steps.q,
    ).whitened()


def _whitened(covariance: Array, *arrays: Array) -> tuple[Array | None, tuple[Array, ...]]:
    """Whiten as `whiten` does, and say which rows have no noise.

    A direction without noise, as a start that is known exactly has and a step with fewer noises
    than states, gives a row that is only turned. Returns the sigma (n, d) of each row, one or zero,
    None where all are one, and the arrays.
    """
    size = np.sqrt(np.diagonal(covariance, 0, 1, 2))
    scale = np.where(size > 0.0, size, 1.0)
    variance, direction = np.linalg.eigh(covariance / (scale[:, :, None] * scale[:, None, :]))
    exact = variance <= _NOTHING
    free = exact.any(axis=1)
    if not free.any():
        return None, whiten(covariance, *arrays)
    sigma = np.where(exact, 0.0, 1.0)
    root = np.where(exact, 1.0, np.sqrt(np.maximum(variance, _NOTHING)))
    return sigma, divided(scale[:, :, None] * direction * root[:, None, :], *arrays)


def _compose(steps: RecordedSteps, until: Index) -> RecordedSteps:
    """Chain the steps between consecutive poses; exact, as nothing is observed in between.

    All poses advance together, each by its next step for as long as it has one.
    """
    last = until[1:] - 1
    at = until[:-1].copy()
    f, q = steps.f[at].copy(), steps.q[at].copy()
    offset = np.zeros((len(at), steps.departed.shape[1]))
    while len(left := np.flatnonzero(at < last)):
        at[left] += 1
        k = at[left]
        step, back = steps.f[k], steps.f[k].transpose(0, 2, 1)
        moved = offset[left] + steps.arrived[k - 1] - steps.departed[k]
        offset[left] = (step @ moved[:, :, None])[:, :, 0]
        f[left] = step @ f[left]
        q[left] = step @ q[left] @ back + steps.q[k]
    return RecordedSteps(steps.departed[until[:-1]], steps.arrived[last] + offset, f, q)
