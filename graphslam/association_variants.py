"""Own associations of one problem by other ways: backwards, other borders, other settings.

An association that is right does not depend on how it was found. These ways share the measurements
and the rule, but not the order of decisions, nor the thresholds near which a decision tips.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from graphslam.arrays import Array
from graphslam.association import AssociationResult, associate
from graphslam.problem import LoopClosures, PoseLandmarkMeasurements, SlamProblem
from graphslam.relocalisation import Options


@dataclass(frozen=True)
class Variant:
    """A way to associate. backwards: from the last pose to the first."""

    name: str
    options: Options = field(default_factory=Options)
    backwards: bool = False


def variants(options: Options | None = None) -> tuple[Variant, ...]:
    """Return the four ways that an association with these options is compared with."""
    o = options or Options()
    return (
        Variant("reversed time", o, backwards=True),
        Variant("shifted borders", replace(o, first_piece=max(1, o.piece // 2))),
        Variant(
            "looser settings",
            replace(
                o,
                gate=1.16 * o.gate,
                odds=o.odds / 3.0,
                measurements=max(1, o.measurements - 1),
                resolution_m=1.27 * o.resolution_m,
            ),
        ),
        Variant(
            "stricter settings",
            replace(
                o,
                gate=0.8 * o.gate,
                odds=4.2 * o.odds,
                measurements=o.measurements + 2,
                resolution_m=0.8 * o.resolution_m,
            ),
        ),
    )


def associate_by(problem: SlamProblem, variant: Variant, last_pose: Array) -> AssociationResult:
    """Return the association that a variant finds; poses in the order and frame of the problem.

    last_pose: (3,) where a backwards variant begins. Without positions it only says in which frame
    it works; with them it is believed to a metre and a tenth of a radian.
    """
    if not variant.backwards:
        return associate(problem, variant.options)
    known = problem.prior_covariance
    if len(problem.position):
        known = np.diag((1.0, 1.0, 0.1)) ** 2
    found = associate(reversed_problem(problem, last_pose, known), variant.options)
    poses, landmarks = _moved(found.poses[::-1], found.landmarks, problem.prior_pose)
    return replace(found, poses=poses, landmarks=landmarks)


def _moved(poses: Array, landmarks: Array, first: Array) -> tuple[Array, Array]:
    """Poses (K, 3) and landmarks (L, 2) moved rigidly, so that the first pose is the one given."""
    turn = first[2] - poses[0, 2]
    cos, sin = np.cos(turn), np.sin(turn)
    rotation, origin = np.array(((cos, -sin), (sin, cos))), poses[0, :2]
    places = (poses[:, :2] - origin) @ rotation.T + first[:2]
    there = np.column_stack((places, poses[:, 2] + turn))
    return there, (landmarks - origin) @ rotation.T + first[:2]


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
