"""Which edges of a pose graph do not agree with the rest, and from which pose on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from comparisons.explain.edge_fits import optimum_of
from comparisons.faults.edges import CLOSURES, LANDMARKS, ODOMETRY, POSITIONS, EdgeSlot, slots
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.smoother import SmootherEvidence

MOST_EDGES = 20_000
"""Of a graph that is solved again and again."""


def disagreement(result: SmootherEvidence) -> str:
    """Return which edges do not agree with the rest, and since where; empty where all do.

    Args:
        result: The optimum of a graph of poses; one whose chi-square no chance makes so high.
    """
    problem, test = result.problem, result.optimality.chi_square
    if test.reading != "too high" or not test.extreme or result.reweighted:
        return ""
    edges = len(problem.steps) + len(problem.loop_closures.first) + len(problem.z)
    if edges > MOST_EDGES or problem.pose_landmarks.count:
        return ""
    kinds = [slot for slot in slots(problem) if len(slot.kinds) == 1]
    apart = [
        slot.words for slot in kinds if slot.kinds != (ODOMETRY,) and _fits(_without(problem, slot))
    ]
    since = _since(problem)
    if len(apart) == 1:
        return f"{apart[0]} do not agree with the rest, which fits without them{since}"
    names = [slot.words for slot in kinds] or ["the edges"]
    listed = " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
    return f"{listed} do not agree{since}"


def _fits(problem: SlamProblem) -> bool:
    goodness = optimum_of(problem)
    return goodness is not None and goodness.sound


def _since(problem: SlamProblem) -> str:
    """Say up to which pose a graph fits."""
    fits, fails = 1, problem.pose_count
    while fails - fits > 1:
        middle = (fits + fails) // 2
        part = problem.prefix(middle)
        dof = part.residual_dimension - part.state_dimension
        goodness = optimum_of(part) if dof > 0 else None
        if dof <= 0 or (goodness is not None and goodness.test.reading != "too high"):
            fits = middle
        else:
            fails = middle
    return f"; all fit up to pose {fits - 1:,}, and no longer with what touches pose {fails - 1:,}"


def _without(problem: SlamProblem, slot: EdgeSlot) -> SlamProblem:
    """Return the problem without a kind of edges, but for the odometry."""
    if CLOSURES in slot.kinds:
        return replace(problem, loop_closures=LoopClosures())
    measurements = np.full(len(problem.z), LANDMARKS not in slot.kinds)
    positions = np.full(len(problem.position), POSITIONS not in slot.kinds)
    rest = problem.keep(measurements, positions)
    if LANDMARKS not in slot.kinds:
        return rest
    return replace(
        rest,
        landmark_count=0,
        surveyed=np.zeros((0, 2)),
        surveyed_covariance=np.zeros((0, 2, 2)),
    )
