"""Elimination of a long log's poses in parts, where thousands of landmarks are to be kept.

gtsam's tree then has hundreds of cliques that touch nearly all landmarks, gigabytes of them. Here
each part of the drive is eliminated with its own landmarks only, and two neighbours at a time are
joined by QR decomposition of what they leave, so that few matrices are as wide as the map.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import gtsam
import numpy as np

from graphslam.arrays import Array
from graphslam.graph_builder import POSE_KEY

POSES = 1000
"""Poses of a part."""
MOST_ROWS = 2.5
"""Rows for each column beyond which they are decomposed; it takes less time than at once."""


class _Left(NamedTuple):
    """What a part leaves: rows (m, n + 1) [J, b] over variables, their keys and widths."""

    keys: tuple[int, ...]
    widths: tuple[int, ...]
    rows: Array


def remaining_rows(graph: gtsam.GaussianFactorGraph, kept: Sequence[int]) -> tuple[Array, Array]:
    """Return J (m, n) and b (m,) of what remains of keys `kept`, in their order.

    Raises RuntimeError where a variable that is eliminated has no information, and ValueError where
    one of `kept` has no factor.
    """
    place = {key: i for i, key in enumerate(kept)}
    parts = _parts(graph)
    uses = Counter(key for part in parts for key in set(part.keyVector()))
    left = [_eliminated(parts.pop(0), place, uses) for _ in range(len(parts))]
    while len(left) > 1:
        left = [
            _joined(left[i], left[i + 1], place, uses) if i + 1 < len(left) else left[i]
            for i in range(0, len(left), 2)
        ]
    if left[0].keys != tuple(kept):
        raise ValueError("a variable that is kept has no factor")
    return left[0].rows[:, :-1], left[0].rows[:, -1]


def _parts(graph: gtsam.GaussianFactorGraph) -> list[gtsam.GaussianFactorGraph]:
    """Return the factors by the last pose that they touch; those of no pose come first."""
    last, found = (
        POSE_KEY + (1 << 48),
        defaultdict[int, gtsam.GaussianFactorGraph](gtsam.GaussianFactorGraph),
    )
    for i in range(graph.size()):
        factor = graph.at(i)
        if factor is None:
            continue
        keys = [key - POSE_KEY for key in factor.keys() if POSE_KEY <= key < last]  # noqa: SIM118
        pose = max(keys, default=0)
        found[pose // POSES].push_back(factor)
    return [found[number] for number in sorted(found)]


def _eliminated(
    part: gtsam.GaussianFactorGraph, place: dict[int, int], uses: Counter[int]
) -> _Left:
    """Eliminate what only this part touches; uses: parts that touch each key, not changed."""
    keys = list(part.keyVector())
    inner = [key for key in keys if key not in place and uses[key] == 1]
    outer = _ordered([key for key in keys if key in place or uses[key] > 1], place)
    if inner:
        _, part = part.eliminatePartialMultifrontal(inner, gtsam.EliminateQR)
    jacobian, b = part.jacobian(gtsam.Ordering(list(outer)))
    return _Left(outer, _widths(part, outer), _root(np.column_stack((jacobian, b))))


def _joined(one: _Left, other: _Left, place: dict[int, int], uses: Counter[int]) -> _Left:
    """Eliminate what no third part touches; uses counts both as one from then on."""
    width = dict(zip(one.keys + other.keys, one.widths + other.widths, strict=True))
    for key in set(one.keys) & set(other.keys):
        uses[key] -= 1
    gone = [key for key in width if key not in place and uses[key] == 1]
    keys = (*gone, *_ordered([key for key in width if key not in set(gone)], place))
    first = dict(zip(keys, np.cumsum([0, *(width[key] for key in keys)]).tolist(), strict=False))
    size = sum(width.values())
    rows = np.zeros((len(one.rows) + len(other.rows), size + 1))
    top = 0
    for left in (one, other):
        columns = [first[key] + i for key in left.keys for i in range(width[key])]
        rows[top : top + len(left.rows), [*columns, size]] = left.rows
        top += len(left.rows)
    done = sum(width[key] for key in gone)
    touched = rows[:, :done].any(axis=1)
    root = _root(rows[touched])
    if len(root) < done or not np.abs(np.diag(root[:done, :done])).all():
        raise RuntimeError("a variable that is eliminated has no information")
    rest = np.concatenate((root[done:, done:], rows[~touched, done:]))
    if len(rest) > MOST_ROWS * rest.shape[1]:
        rest = _root(rest)
    kept = keys[len(gone) :]
    return _Left(kept, tuple(width[key] for key in kept), rest)


def _root(rows: Array) -> Array:
    """Return R (k, n + 1), k at most n + 1, of rows (m, n + 1)."""
    root: Array = np.linalg.qr(rows, mode="r")
    return root


def _ordered(keys: list[int], place: dict[int, int]) -> tuple[int, ...]:
    """Return those that are not kept first, then those kept in their order."""
    return tuple(sorted(keys, key=lambda key: (key in place, place.get(key, key))))


def _widths(graph: gtsam.GaussianFactorGraph, keys: Sequence[int]) -> tuple[int, ...]:
    """Return the numbers that each variable has."""
    zero = graph.gradientAtZero()
    return tuple(len(zero.at(key)) for key in keys)
