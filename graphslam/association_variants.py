"""Own associations of one problem by other ways: backwards, other borders, other settings.

An association that is right does not depend on how it was found. These ways share the measurements
and the rule, but not the order of decisions, nor the thresholds near which a decision tips.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from graphslam.arrays import Array
from graphslam.association import AssociationResult, associate
from graphslam.problem import SlamProblem
from graphslam.relocalisation import Options
from graphslam.reversal import reversed_problem


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
