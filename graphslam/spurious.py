"""Information that a filter's linear equations hold about what its sensors cannot tell.

Measured from the vehicle, a map is the same whatever the start's heading: with an ideal
linearisation the recorded equations hold no information about it. Those of an EKF do, for each is
linearised at another estimate (Huang, Mourikis and Roumeliotis 2010).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from graphslam.arrays import Array, Index
from graphslam.graph_builder import POSE_KEY
from graphslam.linear_problem import LinearProblem, LinearRelations
from graphslam.marginals import SingularProblemError

MOST_PARTS = 100
PARTS_WORK = 5e10
"""Columns cubed, of all parts: with a larger map there are fewer."""
_LEAST_SPLIT, _MOST_SPLIT = 8, 128
"""Parts into which the one that gained most is divided, again and again, by the states in it."""
_SPLIT_WORK = 1e9
"""Columns cubed, of these parts."""
_RANK = 1e-12
"""Of a covariance scaled to unit variances: below it a direction has no variance."""
ALPHA_KEY = gtsam.symbol("a", 0)


class LargestGain(NamedTuple):
    """The relation with which the information grew most, sought where it grew most.

    In the part of the log that gained most, in the part of that which gained most, and so on.

    epoch: of the pose that has the relation. landmark_index, kind: of the landmark, its kind by
    name; -1 and empty for a motion step.
    """

    information: float
    epoch: int
    landmark_index: int
    kind: str


class StartInformation(NamedTuple):
    """How the information about the start grew, in the inverse square of its unit.

    epoch: (C,) last pose of each part of the log, ascending. gained: (C,) with its relations.
    largest: None where the map is too large to look for it.
    """

    epoch: Index
    gained: Array
    largest: LargestGain | None

    @property
    def total(self) -> float:
        """All of it."""
        return float(self.gained.sum())


def information_about_start(
    problem: LinearProblem, direction: Array, rest: Array, merge_epoch: Index
) -> StartInformation:
    """Return the information about alpha, where the first pose's error is N alpha + c.

    It is the least cost of alpha = 1 in the homogeneous problem. Relation by relation in the order
    of time, QR decomposition leaves a row without variables; its square is what the information
    has grown by, as the innovations of a Kalman filter would tell. Positions, surveyed landmarks
    and the prior of alpha are left out.

    Args:
        problem: All relations; their right sides (b) play no part.
        direction: (p,) N.
        rest: (p, p) covariance of c.
        merge_epoch: (M,) of all merges, in their order: the pose at whose time each was made.

    Returns:
        How it grew.

    Raises:
        SingularProblemError: The relations do not fix all poses and landmarks.
    """
    ordered = _ordered_relations(problem, _Start(direction, _root(rest)), merge_epoch)
    try:
        return _Growth(ordered).over_time()
    except RuntimeError as error:
        raise SingularProblemError("the measurements do not fix every state") from error


class _Start(NamedTuple):
    """The first pose's error: direction (p,) + rest (p, r) w, w ~ N(0, I)."""

    direction: Array
    rest: Array


class _Ordered(NamedTuple):
    """Relations in the order of time, and the prior of w, if there is one, before them.

    epoch, landmark_index, kind: (M,) as of LargestGain. first, last: relation where each key is
    used first and last.
    """

    factors: list[gtsam.JacobianFactor]
    epoch: Index
    landmark_index: Index
    kind: NDArray[np.str_]
    first: dict[int, int]
    last: dict[int, int]


def _root(covariance: Array) -> Array:
    """Return L (p, r) of L L^T, without the columns that are zero."""
    variance, axes = np.linalg.eigh(covariance)
    some = variance > _RANK * max(variance.max(initial=0.0), 0.0)
    root: Array = axes[:, some] * np.sqrt(variance[some])
    return root


def _ordered_relations(problem: LinearProblem, start: _Start, merge_epoch: Index) -> _Ordered:
    """Of an instant the motion step comes first, then measurements, then merges."""
    motion = problem.motion
    none = np.full(len(motion.first), -1)
    factors = list(_from_poses(motion, POSE_KEY, start))
    columns = [(motion.second, none, np.full(len(none), ""))]
    for kind, seen in problem.measurements.items():
        factors += _from_poses(seen, kind.key, start)
        columns.append((seen.first, seen.second, np.full(len(seen.first), kind.name)))
    made = 0
    for kind, merged in problem.merges.items():
        factors += _between(merged, kind.key)
        at = merge_epoch[made : made + len(merged.first)]
        columns.append((at, merged.second, np.full(len(at), kind.name)))
        made += len(at)
    if size := start.rest.shape[1]:
        factors.append(gtsam.JacobianFactor(POSE_KEY, np.eye(size), np.zeros(size), _unit(size)))
        columns.append((np.array([-1]), np.array([-1]), np.array([""])))
    epoch, landmark_index, kinds = (np.concatenate(c) for c in zip(*columns, strict=True))
    order = np.argsort(epoch, kind="stable")
    factors = [factors[i] for i in order.tolist()]
    first, last = dict[int, int](), dict[int, int]()
    for i, factor in enumerate(factors):
        for key in factor.keys():  # noqa: SIM118
            first.setdefault(key, i)
            last[key] = i
    return _Ordered(factors, epoch[order], landmark_index[order], kinds[order], first, last)


def _from_poses(
    relations: LinearRelations, second_key: int, start: _Start
) -> Iterator[gtsam.JacobianFactor]:
    """Homogeneous relations from poses; from the first one by alpha and w."""
    r = relations
    none, unit = np.zeros(r.c.shape[1]), _unit(r.c.shape[1])
    keys = (POSE_KEY + r.first).tolist(), (second_key + r.second).tolist()
    for i, j, a, c in zip(*keys, r.a, r.c, strict=True):
        if i != POSE_KEY:
            yield gtsam.JacobianFactor(i, a, j, c, none, unit)
            continue
        by_alpha = (a @ start.direction)[:, None]
        if start.rest.shape[1]:
            by_rest = a @ start.rest
            yield gtsam.JacobianFactor(i, by_rest, j, c, ALPHA_KEY, by_alpha, none, unit)
        else:
            yield gtsam.JacobianFactor(j, c, ALPHA_KEY, by_alpha, none, unit)


def _between(relations: LinearRelations, key: int) -> Iterator[gtsam.JacobianFactor]:
    """Homogeneous relations between two landmarks of a kind."""
    r = relations
    none, unit = np.zeros(r.c.shape[1]), _unit(r.c.shape[1])
    keys = (key + r.first).tolist(), (key + r.second).tolist()
    for i, j, a, c in zip(*keys, r.a, r.c, strict=True):
        yield gtsam.JacobianFactor(i, a, j, c, none, unit)


def _unit(size: int) -> gtsam.noiseModel.Unit:
    return gtsam.noiseModel.Unit.Create(size)


class _Front(NamedTuple):
    """What the relations so far leave of states that are used again: rows (m, n + 1), alpha last.

    dims: of these states, by their keys in the columns' order.
    """

    dims: dict[int, int]
    rows: Array


_EMPTY = _Front({}, np.zeros((0, 1)))


class _Growth:
    """Follows the front of states through the relations."""

    def __init__(self, ordered: _Ordered) -> None:
        self._relations = ordered

    def over_time(self) -> StartInformation:
        """Go through all relations, part by part."""
        epoch = self._relations.epoch
        parts = self._parts()
        ends = np.searchsorted(epoch, np.linspace(0, epoch[-1] + 1, parts + 1)[1:])
        ends = np.unique(ends[ends > 0])
        front, worst, gained = _EMPTY, (0.0, _EMPTY, 0, 0), []
        for begin, end in zip([0, *ends[:-1].tolist()], ends.tolist(), strict=True):
            before = front
            front, gain = self._advance(front, begin, end)
            gained.append(gain)
            if gain > worst[0]:
                worst = gain, before, begin, end
        largest = self._largest(*worst[1:]) if parts > 1 and worst[0] > 0.0 else None
        return StartInformation(epoch[ends - 1], np.array(gained), largest)

    def _parts(self) -> int:
        """Return how many the log is divided into, by the most states that are used again."""
        change = np.zeros(len(self._relations.factors) + 1)
        for key, first in self._relations.first.items():
            change[first] += 1.0
            change[self._relations.last[key]] -= 1.0
        columns = 2.0 * float(np.cumsum(change).max())
        return int(np.clip(PARTS_WORK / max(columns, 1.0) ** 3, 1, MOST_PARTS))

    def _largest(self, front: _Front, begin: int, end: int) -> LargestGain:
        """Divide the relations begin to end, which follow a front, down to one."""
        front, gain = self._marginal(front, begin, end), 0.0
        touched = max(front.rows.shape[1], 1)
        split = int(np.clip(_SPLIT_WORK / touched**3, _LEAST_SPLIT, _MOST_SPLIT))
        while end - begin > 1:
            found = []
            bounds = np.unique(np.linspace(begin, end, split + 1, dtype=np.intp))
            for low, high in np.column_stack((bounds[:-1], bounds[1:])).tolist():
                after, gain = self._advance(front, low, high)
                found.append((gain, front, low, high))
                front = after
            gain, front, begin, end = max(found, key=lambda one: one[0])
        r = self._relations
        at = int(r.epoch[begin]), int(r.landmark_index[begin]), str(r.kind[begin])
        return LargestGain(gain, *at)

    def _marginal(self, front: _Front, begin: int, end: int) -> _Front:
        """Return the front of those states alone that the relations begin to end touch."""
        if not front.dims:
            return front
        touched: set[int] = set()
        for factor in self._relations.factors[begin:end]:
            touched.update(factor.keys())
        dims = {key: dim for key, dim in front.dims.items() if key in touched}
        keys = np.repeat(list(front.dims), list(front.dims.values()))
        stays = np.append(np.isin(keys, list(dims)), True)
        order = np.concatenate((np.flatnonzero(~stays), np.flatnonzero(stays)))
        root: Array = qr(front.rows[:, order], mode="r", check_finite=False)[0]
        others = int(np.count_nonzero(~stays))
        return _Front(dims, root[others : len(stays) - 1, others:])

    def _advance(self, front: _Front, begin: int, end: int) -> tuple[_Front, float]:
        """Return the front after relations begin to end, and what they gained."""
        dims, rows = self._outer(begin, end)
        every = {**front.dims, **dims}
        dead = [key for key in every if self._relations.last[key] < end]
        kept = {key: dim for key, dim in every.items() if self._relations.last[key] >= end}
        order = [*dead, *kept]
        offsets = np.cumsum([0, *(every[key] for key in order)])
        first = dict(zip(order, offsets.tolist(), strict=False))
        size, done = int(offsets[-1]), int(offsets[len(dead)])
        stacked = np.zeros((len(front.rows) + len(rows), size + 1))
        top = 0
        for own, block in ((front.dims, front.rows), (dims, rows)):
            columns = [first[key] + i for key, dim in own.items() for i in range(dim)]
            stacked[top : top + len(block), [*columns, size]] = block
            top += len(block)
        root: Array = qr(stacked, overwrite_a=True, mode="r", check_finite=False)[0]
        fixed = np.abs(np.diag(root[:done, :done]))
        if len(fixed) < done or not fixed.all():
            raise RuntimeError("a state is not fixed")
        gain = float(root[size, size] ** 2) if len(root) > size else 0.0
        return _Front(kept, root[done:size, done:].copy()), gain

    def _outer(self, begin: int, end: int) -> tuple[dict[int, int], Array]:
        """Return dims and rows of states that these relations share with others."""
        r, graph = self._relations, gtsam.GaussianFactorGraph()
        for factor in r.factors[begin:end]:
            graph.push_back(factor)
        keys = [key for key in graph.keyVector() if key != ALPHA_KEY]
        inner = [key for key in keys if r.first[key] >= begin and r.last[key] < end]
        if inner:
            _, graph = graph.eliminatePartialMultifrontal(inner, gtsam.EliminateQR)
        gone = set(inner)
        outer = [key for key in keys if key not in gone]
        zero = graph.gradientAtZero()
        dims = {key: len(zero.at(key)) for key in outer}
        by_alpha = ALPHA_KEY in set(graph.keyVector())
        columns = gtsam.Ordering([*outer, ALPHA_KEY] if by_alpha else outer)
        rows: Array = graph.jacobian(columns)[0]
        return dims, rows if by_alpha else np.column_stack((rows, np.zeros(len(rows))))
