"""The frozen smoother: all states of a log in one linear problem, linearised where the EKF was.

Grade F1 takes the matrices that a filter recorded, here; grade F2 takes this package's own
factors at the filter's points, in frozen_own. An EKF is the exact recursive solution of such a
problem, so F1 must equal the filter and F2 must equal F1, to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphslam.linear_problem import (
    LinearMotion,
    LinearPositions,
    LinearPrior,
    LinearProblem,
    LinearSightings,
    LinearSurvey,
    LinearTwins,
    no_oriented,
    no_twins,
    whiten,
)

Array = NDArray[np.float64]
Index = NDArray[np.intp]


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
class RecordedSightings:
    """M relations residual = jacobian_pose (x - pose) + jacobian_landmark (l - landmark) + v.

    node: (M,) pose and slot: (M,) landmark. pose: (M, p). landmark, residual: (M, w).
    jacobian_pose: (M, w, p). jacobian_landmark: (M, w, w). covariance: (M, w, w) of v. w is 2 for
    points and 3 for oriented landmarks.
    """

    node: Index
    slot: Index
    pose: Array
    landmark: Array
    residual: Array
    jacobian_pose: Array
    jacobian_landmark: Array
    covariance: Array


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


@dataclass(frozen=True, kw_only=True)
class RecordedTwins:
    """T relations residual = jacobian_first (l - first_place) + jacobian_second (l' - ...) + v.

    Of oriented landmarks that are one. first, second: (T,) slots. first_place, second_place,
    residual: (T, 3). jacobian_first, jacobian_second: (T, 3, 3). covariance: (T, 3, 3) of v.
    """

    first: Index
    second: Index
    first_place: Array
    second_place: Array
    residual: Array
    jacobian_first: Array
    jacobian_second: Array
    covariance: Array


def recorded_problem(
    prior: RecordedPrior,
    steps: RecordedSteps,
    until: Index,
    sightings: RecordedSightings,
    positions: RecordedPositions,
    oriented: RecordedSightings | None = None,
    twins: RecordedTwins | None = None,
) -> LinearProblem:
    """F1: what the filter's own recorded matrices say.

    until: (K,) steps made when each pose is reached, ascending from 0. oriented, twins: of
    landmarks with a direction, None where there are none.
    """
    chain = _compose(steps, until)
    p = len(prior.pose)
    identity = np.broadcast_to(np.eye(p), (len(chain.f) + 1, p, p))
    before, after = whiten(chain.q, -chain.f, identity[1:])
    return LinearProblem(
        prior=LinearPrior(prior.pose, whiten(prior.covariance[None], identity[:1])[0][0]),
        motion=LinearMotion(
            chain.departed,
            chain.arrived,
            before,
            after,
            np.zeros_like(chain.arrived),
        ),
        sightings=_recorded_sightings(sightings),
        positions=LinearPositions(
            positions.node,
            positions.pose,
            *whiten(positions.covariance, positions.jacobian_pose, positions.residual),
        ),
        survey=LinearSurvey(np.zeros((0, 2)), np.zeros((0, 2, 2))),
        oriented=no_oriented() if oriented is None else _recorded_sightings(oriented),
        twins=no_twins() if twins is None else _recorded_twins(twins),
    )


def _recorded_sightings(seen: RecordedSightings) -> LinearSightings:
    a, c, b = whiten(seen.covariance, seen.jacobian_pose, seen.jacobian_landmark, seen.residual)
    return LinearSightings(
        node=seen.node, slot=seen.slot, pose=seen.pose, landmark=seen.landmark, a=a, c=c, b=b
    )


def _recorded_twins(twins: RecordedTwins) -> LinearTwins:
    a, c, b = whiten(twins.covariance, twins.jacobian_first, twins.jacobian_second, twins.residual)
    return LinearTwins(
        first=twins.first,
        second=twins.second,
        first_place=twins.first_place,
        second_place=twins.second_place,
        a=a,
        c=c,
        b=b,
    )


def _compose(steps: RecordedSteps, until: Index) -> RecordedSteps:
    """Chain the steps between consecutive poses; exact, as nothing is observed in between."""
    count, p = len(until) - 1, steps.departed.shape[1]
    departed, arrived = np.empty((count, p)), np.empty((count, p))
    f, q = np.empty((count, p, p)), np.empty((count, p, p))
    for i in range(count):
        begin, end = int(until[i]), int(until[i + 1])
        total_f, total_q = steps.f[begin], steps.q[begin]
        offset = np.zeros(p)
        for k in range(begin + 1, end):
            step = steps.f[k]
            offset = step @ (offset + steps.arrived[k - 1] - steps.departed[k])
            total_f = step @ total_f
            total_q = step @ total_q @ step.T + steps.q[k]
        departed[i], arrived[i] = steps.departed[begin], steps.arrived[end - 1] + offset
        f[i], q[i] = total_f, total_q
    return RecordedSteps(departed, arrived, f, q)
