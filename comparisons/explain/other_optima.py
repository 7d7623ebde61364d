"""Which other edges have a given estimate as their optimum: what the optimiser of a pose graph did.

At an optimum the derivative of the sum of squares vanishes, whoever found it. Each fault of the
edges is asked for the step of Gauss and Newton's method that leads from the estimate to the optimum
beside it; the one is named that leaves none, where the edges as they stand ask for a large one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from comparisons.arrays import Array, Index, rotations
from comparisons.explain.edge_fits import mended_graph
from comparisons.faults.edges import (
    CLOSURES,
    ODOMETRY,
    EdgeChange,
    EdgeColumns,
    EdgeFault,
    EdgeSlot,
    columns,
    faults_of,
    slots,
)
from comparisons.plane import in_own_axes, turned
from ekf_reference.core.geometry import wrap_angle
from graphslam.problem import SlamProblem
from graphslam.sparse_system import column_lengths, normal_factors, scaled_columns

_EVERY = EdgeSlot("all edges between poses", (ODOMETRY, CLOSURES))
_ROUNDING = 0.01
"""Sigmas, and share of the step that the edges as they stand ask for, that are rounding."""
_PROMISING = 12
"""Faults that are solved for, those with the smallest derivatives."""
_MOST_NAMED = 3
_NOTHING = 1e-12
"""Times an information that tells nothing beside others."""

Chart = Callable[[Array], tuple[Array, Array]]
"""Makes errors (N, 3) and their derivatives (N, 3, 3) of x, y, heading by which motions differ."""


class OtherOptimum(NamedTuple):
    """Edges whose optimum an estimate is.

    Attributes:
        words: What they are, of several that come to the same all.
        sigma: Largest step from the estimate to their optimum, in sigmas of a number where all
            others are known.
        sound: That to the optimum of the edges as they stand.
    """

    words: str
    sigma: float
    sound: float

    def __str__(self) -> str:
        """Return what the optimiser did."""
        return (
            f"the estimate is the optimum of {self.words}, to {self.sigma:.1g} sigma; from that of "
            f"the graph as it stands it is {self.sound:.2g} sigma"
        )


def other_optimum(problem: SlamProblem, poses: Array) -> OtherOptimum | None:
    """Return the edges whose optimum some poses (K, 3) are; None where none are known.

    Args:
        problem: A graph of motions between poses alone.
        poses: All of an estimate, in any frame.
    """
    if len(problem.z) or len(problem.position) or problem.pose_count != len(poses):
        return None
    edges = columns(problem, _EVERY)
    sound, unit = min((_step(edges, poses, chart) for chart in CHARTS), key=lambda pair: pair[0])
    enough = _ROUNDING * min(1.0, sound)
    least = _ROUNDING * _derivative(edges, poses, CHARTS[0], unit)[1]
    tried = []
    for words, other in _others(problem):
        for chart in CHARTS:
            length, most = _derivative(other, poses, chart, unit)
            tried.append((length / max(most, least), words, other, chart))
    tried.sort(key=lambda candidate: candidate[0])
    named: dict[str, float] = {}
    for _, words, other, chart in tried[:_PROMISING]:
        left = _step(other, poses, chart, unit)[0]
        if left <= min(enough, named.get(words, np.inf)):
            named[words] = left
    if not named:
        return None
    said = ", or of ".join(list(named)[:_MOST_NAMED])
    return OtherOptimum(said, min(named.values()), sound)


def _others(problem: SlamProblem) -> Iterator[tuple[str, EdgeColumns]]:
    """Yield other edges of a graph, and what they are."""
    for slot in slots(problem):
        faults: Iterable[EdgeFault] = faults_of(slot)
        if slot.kinds != _EVERY.kinds:
            faults = [*faults, EdgeFault(slot, _LEFT_OUT)]
        for fault in faults:
            if fault.change.neutral or fault.change.by_heading:
                continue
            mended = mended_graph(fault, problem)
            if mended is not None:
                words = f"{slot.words} {fault.change.words}"
                yield words, columns(mended, _EVERY)


_LEFT_OUT = EdgeChange(
    "zero", "left out", lambda e, _: e._replace(covariance=e.covariance / _NOTHING)
)


def _step(
    edges: EdgeColumns, poses: Array, chart: Chart, unit: Array | None = None
) -> tuple[float, Array]:
    """The largest step to the optimum, in units (n,) or by these edges' own; and these, inverse."""
    jacobian, residual = linearised(edges, poses, chart)
    lengths = np.maximum(column_lengths(jacobian), 1e-300)
    scaled = scaled_columns(jacobian, lengths)
    try:
        step = normal_factors(scaled).solve(scaled.T @ residual) / lengths
    except RuntimeError:
        return np.inf, lengths
    return float(np.abs(step * (lengths if unit is None else unit)).max()), lengths


def _derivative(edges: EdgeColumns, poses: Array, chart: Chart, unit: Array) -> tuple[float, float]:
    """Length of the derivative by the poses, and how long the edges' residuals could make it."""
    jacobian, residual = linearised(edges, poses, chart)
    by_poses = np.linalg.norm((jacobian.T @ residual) / unit)
    most = np.linalg.norm((abs(jacobian).T @ np.abs(residual)) / unit)
    return float(by_poses), float(most)


def linearised(edges: EdgeColumns, poses: Array, chart: Chart) -> tuple[csr_matrix, Array]:
    """Return the least-squares equations of edges at an estimate.

    Args:
        edges: N of them.
        poses: (K, 3) of the estimate.
        chart: Of the errors.

    Returns:
        The whitened Jacobian (3 N, 3 K - 3) by all poses but the first, which is held, and the
        negative residuals (3 N,).
    """
    first, second = edges.first, edges.second
    moved = in_own_axes(poses[first], poses[second])
    off = in_own_axes(edges.z, moved)
    off[:, 2] = wrap_angle(off[:, 2])
    by_second = np.zeros((len(off), 3, 3))
    by_second[:, :2, :2] = rotations(-edges.z[:, 2] - poses[first, 2])
    by_second[:, 2, 2] = 1.0
    by_first = -by_second
    by_first[:, :2, 2] = turned(np.column_stack((moved[:, 1], -moved[:, 0])), -edges.z[:, 2])
    error, by_off = chart(off)
    root = np.linalg.cholesky(np.linalg.inv(edges.covariance)).mT
    white, residual = root @ by_off, root @ error[:, :, None]
    blocks = np.concatenate((white @ by_first, white @ by_second))
    return _sparse(blocks, np.concatenate((first, second)), len(poses)), -residual.ravel()


def _sparse(blocks: Array, pose: Index, count: int) -> csr_matrix:
    """(2 N, 3, 3) blocks of N edges' first and second poses, the first pose of all left out."""
    edges = len(blocks) // 2
    row = 3 * np.tile(np.arange(edges), 2)[:, None, None] + np.arange(3)[:, None]
    column = 3 * (pose - 1)[:, None, None] + np.arange(3)
    row, column = (
        np.broadcast_to(index, blocks.shape)[pose > 0].ravel() for index in (row, column)
    )
    values = blocks[pose > 0].ravel()
    return coo_matrix((values, (row, column)), shape=(3 * edges, 3 * count - 3)).tocsr()


def _as_numbers(off: Array) -> tuple[Array, Array]:
    """Errors by x, y and heading as they differ, as g2o has them."""
    return off, np.broadcast_to(np.eye(3), (len(off), 3, 3))


def _as_logarithm(off: Array) -> tuple[Array, Array]:
    """Errors by the motion's logarithm, as gtsam has them."""
    x, y, turn = off.T
    half = 0.5 * turn
    small = np.abs(half) < 1e-4
    safe = np.where(small, 1.0, half)
    along = np.where(small, 1.0 - half**2 / 3.0, safe / np.tan(safe))
    bend = np.where(small, -turn / 6.0, 0.5 / np.tan(safe) - 0.5 * safe / np.sin(safe) ** 2)
    error = np.column_stack((along * x + half * y, along * y - half * x, turn))
    by_off = np.zeros((len(off), 3, 3))
    by_off[:, 0, 0] = by_off[:, 1, 1] = along
    by_off[:, 0, 1], by_off[:, 1, 0] = half, -half
    by_off[:, 0, 2], by_off[:, 1, 2] = bend * x + 0.5 * y, bend * y - 0.5 * x
    by_off[:, 2, 2] = 1.0
    return error, by_off


CHARTS: tuple[Chart, ...] = (_as_numbers, _as_logarithm)
"""How optimisers write errors: the first as g2o does, the second as gtsam."""
