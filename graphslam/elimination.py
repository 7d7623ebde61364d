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
from scipy.linalg import qr

from graphslam.arrays import Array
from graphslam.graph_builder import POSE_KEY

POSES = 1000
"""Poses of a part."""
MOST_ROWS = 1.5
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
    left: list[tuple[int, _Left]] = []  # with the joins behind it; few are as wide as the map
    while parts or len(left) > 1:
        if parts and not (len(left) > 1 and left[-1][0] == left[-2][0]):
            left.append((0, _eliminated(parts.pop(0), place, uses)))
            continue
        (joins, second), (_, first) = left.pop(), left.pop()
        left.append((joins + 1, _joined([first, second], place, uses)))
    keys, _, rows = left[0][1]
    if keys != tuple(kept):
        raise ValueError("a variable that is kept has no factor")
    return rows[:, :-1], rows[:, -1]


def _parts(graph: gtsam.GaussianFactorGraph) -> list[gtsam.GaussianFactorGraph]:
    """Return the factors by the last pose that they touch; those of no pose are in the first."""
    last = POSE_KEY + (1 << 48)
    found = defaultdict[int, gtsam.GaussianFactorGraph](gtsam.GaussianFactorGraph)
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


def _joined(both: list[_Left], place: dict[int, int], uses: Counter[int]) -> _Left:
    """Eliminate what no third part touches; uses counts both as one from then on.

    both: emptied as it goes, for the memory.
    """
    width = {k: w for one in both for k, w in zip(one.keys, one.widths, strict=True)}
    for key in set(both[0].keys) & set(both[1].keys):
        uses[key] -= 1
    gone = [key for key in width if key not in place and uses[key] == 1]
    kept = _ordered([key for key in width if key not in set(gone)], place)
    ends = np.cumsum([0, *(width[key] for key in (*gone, *kept))]).tolist()
    first, size = dict(zip((*gone, *kept), ends, strict=False)), ends[-1]
    done, columns, touched = sum(width[key] for key in gone), [], []
    for one in both:
        own = [first[key] + i for key in one.keys for i in range(width[key])]
        columns.append(np.array([*own, size]))
        touched.append(one.rows[:, columns[-1] < done].any(axis=1))
    few = np.zeros((sum(int(rows.sum()) for rows in touched), size + 1))
    top = 0
    for one, entries, rows in zip(both, columns, touched, strict=True):
        few[top : top + int(rows.sum()), entries] = one.rows[rows]
        top += int(rows.sum())
    root = _root(few)
    if len(root) < done or not np.abs(np.diag(root[:done, :done])).all():
        raise RuntimeError("a variable that is eliminated has no information")
    root = root[done:, done:]
    top, count = len(root), len(root) + sum(int((~rows).sum()) for rows in touched)
    rest = np.zeros((count, size + 1 - done), order="F")
    rest[:top] = root
    for entries, rows in zip(columns, touched, strict=True):
        stay = entries >= done
        added = both.pop(0).rows[~rows][:, stay]
        rest[top : top + len(added), entries[stay] - done] = added
        top += len(added)
    if len(rest) > MOST_ROWS * rest.shape[1]:
        rest = _root(rest)
    return _Left(kept, tuple(width[key] for key in kept), rest)


def _root(rows: Array) -> Array:
    """Return R (k, n + 1), k at most n + 1, of rows (m, n + 1), which are overwritten."""
    if not len(rows):
        return rows
    root: Array = qr(rows, overwrite_a=True, mode="r", check_finite=False)[0]
    return root[: rows.shape[1]].copy()


def _ordered(keys: list[int], place: dict[int, int]) -> tuple[int, ...]:
    """Return those that are not kept first, then those kept in their order."""
    return tuple(sorted(keys, key=lambda key: (key in place, place.get(key, key))))


def _widths(graph: gtsam.GaussianFactorGraph, keys: Sequence[int]) -> tuple[int, ...]:
    """Return of how many numbers each variable is."""
    zero = graph.gradientAtZero()
    return tuple(len(zero.at(key)) for key in keys)
