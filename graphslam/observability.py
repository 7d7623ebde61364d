"""Which poses or landmarks a singular problem leaves undetermined, by name."""

from __future__ import annotations

import gtsam
import numpy as np
from scipy.sparse import identity
from scipy.sparse.linalg import splu

from graphslam.arrays import Array
from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, POSE_LANDMARK_KEY
from graphslam.layout import POINT, POSE_LANDMARK
from graphslam.sparse_system import column_lengths, scaled_columns, sparse_system

_FREE = 1e-10
"""A direction is free when what the measurements say of it is this small against its columns."""
_POSE, _POINT = gtsam.symbolChr(POSE_KEY), gtsam.symbolChr(LANDMARK_KEY)
_NAMED = 3


def explain_singularity(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> str:
    """What is not determined around `values`, in one sentence; empty when everything is.

    The columns of the whitened Jacobian are scaled to length one; inverse iteration finds the
    direction in which they cancel.
    """
    keys = sorted(values.keys())
    touched = set(graph.keyVector())
    never = [key for key in keys if key not in touched]
    if never:
        return f"no measurement constrains {_listed(never)}"
    points = np.array([gtsam.symbolChr(key) == _POINT for key in keys])
    width = np.where(points, POINT.width, POSE_LANDMARK.width)
    first = np.concatenate(([0], np.cumsum(width)))
    jacobian, _ = sparse_system(graph, values)
    length = column_lengths(jacobian)
    nothing = np.flatnonzero(length == 0.0)
    if len(nothing):
        which = np.unique(np.searchsorted(first, nothing, side="right") - 1)
        return f"no measurement constrains {_listed([keys[i] for i in which])}"
    scaled = scaled_columns(jacobian, length)
    direction = _weakest(scaled)
    if float(np.linalg.norm(scaled @ direction) ** 2) > _FREE:
        return ""
    share = np.add.reduceat(direction**2, first[:-1])
    moving = np.flatnonzero(share > 0.05 * share.max())
    if len(moving) > 0.5 * len(keys):
        return "the whole map can move: no prior, position or known landmark fixes the frame"
    weakest = [keys[i] for i in moving[np.argsort(-share[moving])]]
    count = sum(weakest[0] in graph.at(i).keys() for i in range(graph.size()))  # noqa: SIM118
    said = "one measurement leaves" if count == 1 else f"{count} measurements leave"
    return (
        f"{_listed(weakest)} can move freely: {said} one direction of {_name(weakest[0])} "
        "undetermined"
    )


def _weakest(scaled: Array) -> Array:
    """(n,) unit vector of about the smallest singular value of a sparse matrix (m, n)."""
    size = scaled.shape[1]
    factor = splu((scaled.T @ scaled + 1e-14 * identity(size)).tocsc())
    direction = np.random.default_rng(0).standard_normal((size, 1))
    for _ in range(8):
        direction = factor.solve(direction)
        direction /= np.linalg.norm(direction)
    return direction[:, 0]


def _listed(keys: list[int]) -> str:
    """The first few by name."""
    names = ", ".join(_name(key) for key in keys[:_NAMED])
    more = len(keys) - _NAMED
    return names + (f" and {more} more" if more > 0 else "")


def _name(key: int) -> str:
    if gtsam.symbolChr(key) == _POSE:
        return f"pose {key - POSE_KEY}"
    if gtsam.symbolChr(key) == _POINT:
        return f"landmark {key - LANDMARK_KEY}"
    return f"pose landmark {key - POSE_LANDMARK_KEY}"
