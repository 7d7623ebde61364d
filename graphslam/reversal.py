"""A problem with its time reversed: the same measurements, read from the last pose to the first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graphslam.arrays import Array
from graphslam.problem import LoopClosures, PoseLandmarkMeasurements, SlamProblem


def reversed_problem(problem: SlamProblem, last: Array, covariance: Array) -> SlamProblem:
    """Return the problem whose pose k is pose K - 1 - k of the one given.

    last: (3,) the last pose, which becomes the prior, with covariance: (3, 3) of its additive
    global error. Measurements and positions keep their rows, so that an association of them stays
    comparable. An increment T with perturbation xi on its right is undone by T^-1 with
    perturbation -Ad(T) xi. Closures and pose landmarks are left out.
    """
    end = problem.pose_count - 1
    x, y, turn = problem.increment[::-1].T
    cos, sin = np.cos(turn), np.sin(turn)
    undone = np.column_stack((-cos * x - sin * y, sin * x - cos * y, -turn))
    adjoint = np.zeros((len(turn), 3, 3))
    adjoint[:, 0, 0] = adjoint[:, 1, 1] = cos
    adjoint[:, 0, 1], adjoint[:, 1, 0] = -sin, sin
    adjoint[:, 0, 2], adjoint[:, 1, 2] = y, -x
    adjoint[:, 2, 2] = 1.0
    spread = adjoint @ problem.increment_covariance[::-1] @ adjoint.transpose(0, 2, 1)
    return replace(
        problem,
        prior_pose=last,
        prior_covariance=covariance,
        increment=undone,
        increment_covariance=0.5 * (spread + spread.transpose(0, 2, 1)),
        measurement_pose=end - problem.measurement_pose,
        position_pose=end - problem.position_pose,
        pose_landmarks=PoseLandmarkMeasurements(),
        loop_closures=LoopClosures(),
    )
