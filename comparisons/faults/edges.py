"""Faults of the edges of a pose graph: a slot (which edges) x a change (of what stands there).

A change is told as what mends it: it makes of an edge's numbers, as they were read, those that were
meant. `explain.edges` tries the mended graphs. Motions are x, y, heading of the second pose in the
first's frame, with the covariance of the right perturbation; landmarks and positions are points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index, rotations
from comparisons.plane import in_own_axes, turned
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.scan import planar
from graphslam.sensor_frame import in_words

ODOMETRY, CLOSURES, LANDMARKS, POSITIONS = "odometry", "closures", "landmarks", "positions"
_STATED = "what stands for their information"
_TRIANGLES = {
    "": ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)),
    " (lower triangle)": ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)),
    " (diagonal first)": ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)),
    " (TORO)": ((0, 0), (0, 1), (1, 1), (2, 2), (0, 2), (1, 2)),
}
"""Orders in which programs write the entries of a symmetric matrix."""
_UNKNOWN = 1e6
"""Times its covariance where nothing is known of an edge's numbers."""
_SHORT = {"x": "x", "y": "y", "heading": "h"}


class EdgeColumns(NamedTuple):
    """N edges of one shape.

    Attributes:
        first: (N,) the pose that sees.
        second: (N,) pose or landmark that is seen; of positions the pose again.
        z: (N, d) what was measured, d is 3 for motions and 2 for points.
        covariance: (N, d, d).
        heading: (N,) of the first pose, as the odometry has it [rad].
        turn: (N,) from there to the second pose, 0 of points [rad].
    """

    first: Index
    second: Index
    z: Array
    covariance: Array
    heading: Array
    turn: Array


class EdgeSlot(NamedTuple):
    """Which edges.

    Attributes:
        words: What sentences call them, before "fit" or "fits".
        kinds: Of ODOMETRY, CLOSURES, LANDMARKS, POSITIONS; motions may stand together.
        rows: (n,) of these edges alone; None for all.
    """

    words: str
    kinds: tuple[str, ...]
    rows: Index | None = None

    @property
    def is_motion(self) -> bool:
        """Whether poses are at both ends."""
        return self.kinds[0] in (ODOMETRY, CLOSURES)


Mend = Callable[[EdgeColumns, Array], EdgeColumns]


class EdgeChange(NamedTuple):
    """What mends edges.

    Attributes:
        name: Of the change.
        words: What to say after "fit" or "fits", of the numbers in their words.
        mend: Makes of edges as read, and of the numbers, edges as meant.
        neutral: The numbers where nothing is changed; empty where there are none.
        say: Makes words of numbers (n,) and half the width of their intervals (n,).
        keeps_weights: The informations stay as they are.
        log_volume: Logarithm of the volume of an edge's mended numbers over that of those read, of
            points by x and y.
        scaled: How many components are divided by the first number.
        by_heading: What is meant depends on the heading of the pose that sees.
        starts: Numbers from which a fit begins, beside the neutral ones.
    """

    name: str
    words: str
    mend: Mend
    neutral: tuple[float, ...] = ()
    say: Callable[[Array, Array], str] = lambda _, __: ""
    keeps_weights: bool = True
    starts: tuple[tuple[float, ...], ...] = ()
    log_volume: float = 0.0
    scaled: int = 0
    by_heading: bool = False

    def log_volume_of(self, numbers: Array | None) -> float:
        """Return the logarithm of the volume with numbers (n,), if there are any."""
        if not self.scaled or numbers is None:
            return self.log_volume
        return self.log_volume - self.scaled * float(np.log(np.abs(numbers[0])))


class EdgeFault(NamedTuple):
    """A slot with a change."""

    slot: EdgeSlot
    change: EdgeChange

    @property
    def kind(self) -> str:
        """Its words without numbers."""
        return f"{self.slot.words} {self.change.words}"

    def mended(
        self, problem: SlamProblem, numbers: Array | None = None, heading: Array | None = None
    ) -> SlamProblem:
        """Return the graph as it was meant.

        Args:
            problem: As it was read.
            numbers: (n,) of the change; None for neutral ones.
            heading: (K,) of all poses [rad]; None for the odometry's.

        Returns:
            A problem with other edges.
        """
        edges = columns(problem, self.slot)
        if heading is not None:
            edges = edges._replace(heading=heading[edges.first])
        at = np.array(self.change.neutral) if numbers is None else numbers
        changed = self.change.mend(edges, at)
        if self.slot.rows is not None:
            changed = _in_rows(edges, changed, self.slot.rows)
        return with_columns(problem, self.slot, changed)

    def said(self, numbers: Array | None = None, widths: Array | None = None) -> str:
        """Return what mends it, in words after "fit"."""
        if numbers is None or widths is None or not len(numbers):
            return self.change.words
        return self.change.words.format(self.change.say(numbers, widths))


SLOTS = (
    EdgeSlot("the loop closures", (CLOSURES,)),
    EdgeSlot("the odometry's edges", (ODOMETRY,)),
    EdgeSlot("all edges between poses", (ODOMETRY, CLOSURES)),
    EdgeSlot("the measurements of landmarks", (LANDMARKS,)),
    EdgeSlot("the positions", (POSITIONS,)),
)


def slots(problem: SlamProblem) -> Iterator[EdgeSlot]:
    """Yield the slots of a graph's edges that there are."""
    counts = {
        ODOMETRY: len(problem.steps),
        CLOSURES: len(problem.loop_closures.first),
        LANDMARKS: len(problem.z),
        POSITIONS: len(problem.position),
    }
    both = counts[ODOMETRY] and counts[CLOSURES]
    for slot in SLOTS:
        alone = slot.kinds in ((ODOMETRY,), (CLOSURES,))  # then all edges are these
        if any(counts[kind] for kind in slot.kinds) and (both or not alone):
            yield slot


def columns(problem: SlamProblem, slot: EdgeSlot) -> EdgeColumns:
    """Return the edges of a slot, whatever its rows."""
    p, closed = problem, problem.loop_closures
    heading = p.prior_pose[2] + np.concatenate(([0.0], np.cumsum(p.increment[:, 2])))
    if slot.kinds[0] == LANDMARKS:
        point = p.z[:, :1] * np.column_stack((np.cos(p.z[:, 1]), np.sin(p.z[:, 1])))
        size = p.sigma * np.column_stack((np.ones(len(p.z)), p.z[:, 0]))
        spread = _across(p.z[:, 1], size)
        at = p.measurement_pose
        return EdgeColumns(
            at, p.measurement_landmark, point, spread, heading[at], np.zeros(len(at))
        )
    if slot.kinds[0] == POSITIONS:
        at = p.position_pose
        return EdgeColumns(
            at, at, p.position, p.position_covariance, heading[at], np.zeros(len(at))
        )
    steps = p.steps if ODOMETRY in slot.kinds else p.steps[:0]
    few = closed if CLOSURES in slot.kinds else LoopClosures()
    first = np.concatenate((steps, few.first))
    second = np.concatenate((steps + 1, few.second))
    return EdgeColumns(
        first,
        second,
        np.concatenate((p.increment[steps], few.motion)),
        np.concatenate((p.increment_covariance[steps], few.covariance)),
        heading[first],
        heading[second] - heading[first],
    )


def with_columns(problem: SlamProblem, slot: EdgeSlot, edges: EdgeColumns) -> SlamProblem:
    """Return a problem with other edges of a slot. Their order stays, the last may be fewer."""
    p, z, spread = problem, edges.z, edges.covariance
    if slot.kinds[0] == LANDMARKS:
        return _with_points(p, edges)
    if slot.kinds[0] == POSITIONS:
        return replace(p, position=z, position_covariance=spread, position_pose=edges.first)
    count = len(p.steps) if ODOMETRY in slot.kinds else 0
    if count:
        motion, covariance = p.increment.copy(), p.increment_covariance.copy()
        motion[p.steps], covariance[p.steps] = z[:count], spread[:count]
        backward = edges.first[:count] != p.steps  # a step is from its earlier pose
        for row in np.flatnonzero(backward).tolist():
            motion[p.steps[row]] = inverse(z[row : row + 1])[0]
        p = replace(p, increment=motion, increment_covariance=covariance)
    if CLOSURES in slot.kinds:
        closed = replace(
            problem.loop_closures,
            first=edges.first[count:],
            second=edges.second[count:],
            motion=z[count:],
            covariance=spread[count:],
        )
        p = replace(p, loop_closures=closed)
    return p


def _with_points(problem: SlamProblem, edges: EdgeColumns) -> SlamProblem:
    x, y = edges.z.T
    r = np.maximum(np.hypot(x, y), 1e-9)
    cos, sin = x / r, y / r
    into = np.stack((cos, sin, -sin / r, cos / r), axis=-1).reshape(-1, 2, 2)
    variance = np.einsum("nij,njk,nik->ni", into, edges.covariance, into)
    return replace(
        problem,
        measurement_pose=edges.first,
        z=np.column_stack((r, np.arctan2(y, x))),
        sigma=np.sqrt(np.maximum(variance, 1e-300)),
    )


def _across(angle: Array, sigma: Array) -> Array:
    """(N, 2, 2) covariances with sigmas (N, 2) along and across an angle (N,)."""
    turn = rotations(angle)
    return np.asarray(turn * sigma[:, None] ** 2 @ turn.mT)


def _in_rows(edges: EdgeColumns, changed: EdgeColumns, rows: Index) -> EdgeColumns:
    chosen = np.zeros(len(edges.first), dtype=bool)
    chosen[rows] = True
    if len(changed.first) != len(chosen):
        return edges
    return EdgeColumns(
        *(
            np.where(chosen.reshape(-1, *[1] * (old.ndim - 1)), new, old)
            for old, new in zip(edges, changed, strict=True)
        )
    )


def faults_of(slot: EdgeSlot) -> Iterator[EdgeFault]:
    """Yield the faults of a slot, those without a number first."""
    some = changes_of_motion() if slot.is_motion else changes_of_point(slot.kinds[0])
    for change in some:
        yield EdgeFault(slot, change)
    if slot.kinds == (CLOSURES,):
        for change in _of_ends():
            yield EdgeFault(slot, change)
    for change in changes_of_information(3 if slot.is_motion else 2):
        yield EdgeFault(slot, change)
    for change in numbered_changes(slot):
        yield EdgeFault(slot, change)


def changes_of_motion() -> Iterator[EdgeChange]:
    """Yield changes of what edges between poses measure, without a number."""
    yield EdgeChange("inverse", "when inverted", lambda e, _: e._replace(z=inverse(e.z)))
    yield EdgeChange(
        "inverse", "when inverted", lambda e, _: e._replace(first=e.second, second=e.first)
    )
    yield from _reordered(("x", "y", "heading"))
    degree = np.radians(1.0)
    for factor, words in (
        (degree, "when their headings are in degrees"),
        (1.0 / degree, "when their headings were converted to radians twice"),
    ):
        scale = np.array((1.0, 1.0, factor))
        yield from _linear("unit", words, np.diag(scale))
    for times, words in (
        (1.0, "when x and y are in the axes of the second pose"),
        (-1.0, "when x and y were turned by the edge's heading"),
        (2.0, "when x and y were turned back by twice the edge's heading"),
    ):
        yield EdgeChange("axes", words, partial(_turned_by_itself, times))
    yield from _of_axes_and_order()


def changes_of_point(kind: str) -> Iterator[EdgeChange]:
    """Yield changes of measured points, without a number. kind: LANDMARKS or POSITIONS."""
    yield from _reordered(("x", "y"))
    if kind == LANDMARKS:
        yield from _of_axes_and_order()
    else:
        yield from _shifted()


def _of_axes_and_order() -> Iterator[EdgeChange]:
    words = "when x and y are in the axes of the map"
    yield EdgeChange("axes", words, lambda e, _: _with_turned(e, -e.heading), by_heading=True)
    yield from _shifted()


def _shifted() -> Iterator[EdgeChange]:
    for by, words in ((-1, "before"), (1, "after")):
        yield EdgeChange(
            "order",
            f"when each holds what the edge {words} it measured",
            partial(_moved_on, by),
        )


def _moved_on(by: int, edges: EdgeColumns, _: Array) -> EdgeColumns:
    """What the next edge holds, or the one before; the one that is left holds nothing known."""
    spread, left = edges.covariance.copy(), -1 if by < 0 else 0
    spread[left] *= _UNKNOWN
    return edges._replace(z=np.roll(edges.z, by, axis=0), covariance=spread)


def _of_ends() -> Iterator[EdgeChange]:
    """Yield changes of the poses that closures join."""
    for end, by in product(("first", "second", "both"), (-1, 1)):
        which = "both poses are" if end == "both" else f"the {end} pose is"
        words = f"when {which} the one {'before' if by < 0 else 'after'}"
        yield EdgeChange("label", words, partial(_other_ends, end, by))
    yield EdgeChange("twice", "when used once: they stand there twice", lambda e, _: _once(e))


def _other_ends(end: str, by: int, edges: EdgeColumns, _: Array) -> EdgeColumns:
    first = edges.first + by * (end != "second")
    second = edges.second + by * (end != "first")
    return edges._replace(first=first, second=second)


def _once(edges: EdgeColumns) -> EdgeColumns:
    rows = np.column_stack((edges.first, edges.second, edges.z))
    kept = np.sort(np.unique(rows, axis=0, return_index=True)[1])
    return EdgeColumns(
        edges.first[kept],
        edges.second[kept],
        edges.z[kept],
        edges.covariance[kept],
        edges.heading[kept],
        edges.turn[kept],
    )


def _reordered(names: tuple[str, ...]) -> Iterator[EdgeChange]:
    """Yield signs, orders, and both at once, the fewest changes first."""
    size = len(names)
    whole = tuple(range(size))
    every = list(product(permutations(whole), product((1.0, -1.0), repeat=size)))
    every.sort(key=lambda pair: (pair[0] != whole) + pair[1].count(-1.0))
    for order, signs in every[1:]:
        matrix = np.zeros((size, size))
        # What was meant as component order[k] stands at k, with the sign of what was meant.
        matrix[list(order), whole] = [signs[k] for k in order]
        listed = [f"in the order {', '.join(names[k] for k in order)}"] if order != whole else []
        minus = [name for name, sign in zip(names, signs, strict=True) if sign < 0.0]
        listed += [f"with the opposite sign of {_listed(minus)}"] if minus else []
        stand = "when they stand " if order != whole else ""
        yield from _linear("components", f"{stand}{' and '.join(listed)}", matrix)


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _linear(name: str, words: str, matrix: Array) -> Iterator[EdgeChange]:
    """Yield a change of components, the information being right or changed with them."""
    volume = float(np.linalg.slogdet(matrix)[1])
    yield EdgeChange(name, words, lambda e, _: e._replace(z=e.z @ matrix.T), log_volume=volume)
    if not np.allclose(np.abs(matrix), np.eye(len(matrix))):
        yield EdgeChange(
            name, words,
            lambda e, _: e._replace(z=e.z @ matrix.T, covariance=matrix @ e.covariance @ matrix.T),
            log_volume=volume,
        )  # fmt: skip


def changes_of_information(size: int) -> Iterator[EdgeChange]:
    """Yield other meanings of what stands for an information (size, size)."""
    readings: list[tuple[str, Callable[[Array], Array]]] = [
        ("the covariance", _inverted),
        ("a square root of it", lambda c: _inverted(_squared(_upper_root(c)))),
        ("a square root of it", lambda c: c @ c),
        ("the covariance's root", lambda c: _squared(_upper_root(c))),
        ("the covariance's root", lambda c: _inverted(c @ c)),
        ("its square", _power(0.5)),
        ("the covariance's square", _power(-0.5)),
        ("L^T L, not L L^T, of its Cholesky factor L", _other_factor),
        ("L L^T, not L^T L, of the factor L that it is made of", _factor_of_other),
    ]
    for how, read in readings:
        yield EdgeChange("information", f"when {_STATED} is {how}", _of_covariance(read),
                         keeps_weights=False)  # fmt: skip
    names = ("x", "y", "heading")[:size]
    whole = tuple(range(size))
    for order, (style, triangle) in product(permutations(whole), _TRIANGLES.items()):
        pairs = [(i, j) for i, j in triangle if max(i, j) < size]
        if order == whole and pairs == [(i, j) for i in whole for j in whole[i:]]:
            continue
        letters = [_SHORT[names[order[i]]] + _SHORT[names[order[j]]] for i, j in pairs]
        words = f"when their information stands in the order {' '.join(letters)}{style}"
        yield EdgeChange(
            "information's order", words,
            _of_covariance(partial(_from_entries, order, pairs)),
            keeps_weights=False,
        )  # fmt: skip


def _of_covariance(read: Callable[[Array], Array]) -> Mend:
    return lambda e, _: e._replace(covariance=_symmetric(read(e.covariance)))


def _inverted(covariance: Array) -> Array:
    return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.mT))


def _upper_root(covariance: Array) -> Array:
    """(N, n, n) the upper triangles that were read."""
    return np.asarray(np.triu(np.linalg.inv(covariance)))


def _squared(root: Array) -> Array:
    return np.asarray(root.mT @ root)


def _power(exponent: float) -> Callable[[Array], Array]:
    def powered(covariance: Array) -> Array:
        values, axes = np.linalg.eigh(covariance)
        return np.asarray(axes * np.maximum(values, 1e-300)[:, None] ** exponent @ axes.mT)

    return powered


def _other_factor(covariance: Array) -> Array:
    """(N, n, n) covariances where L^T L was read, L being the information's Cholesky factor."""
    root = np.linalg.cholesky(np.linalg.inv(covariance)[:, ::-1, ::-1])[:, ::-1, ::-1]  # L^T
    return np.asarray(np.linalg.inv(root.mT @ root))


def _factor_of_other(covariance: Array) -> Array:
    """(N, n, n) covariances where L L^T was read, and L^T L was meant, L being lower triangular."""
    root = np.linalg.cholesky(np.linalg.inv(covariance))
    return np.asarray(np.linalg.inv(root.mT @ root))


def _from_entries(order: tuple[int, ...], pairs: list[tuple[int, int]], covariance: Array) -> Array:
    """(N, n, n) covariances where the entries that were read are of other pairs."""
    size = len(order)
    read = np.linalg.inv(covariance)[:, *np.triu_indices(size)]
    meant = np.zeros_like(covariance)
    for number, (i, j) in enumerate(pairs):
        a, b = order[i], order[j]
        meant[:, a, b] = meant[:, b, a] = read[:, number]
    return np.asarray(np.linalg.inv(meant))


def numbered_changes(slot: EdgeSlot) -> Iterator[EdgeChange]:
    """Yield changes with numbers, which are to be fitted."""
    yield from _scales(slot)
    quarters = [(0.0, 0.0, turn) for turn in (np.pi, 0.5 * np.pi, -0.5 * np.pi)]
    if not slot.is_motion:
        where = "the map" if slot.kinds[0] == POSITIONS else "the vehicle"
        words = f"as points of a frame {{}} on {where}"
        for carried in (True, False):
            yield EdgeChange(
                "frame", words, partial(_placed, carried),
                (0.0, 0.0, 0.0), _said_frame, starts=tuple(quarters),
            )  # fmt: skip
        return
    for words, mend in (
        ("as motions of a frame {}", _of_vehicle),
        ("with a fixed motion ({}) before each taken away", _without_before),
        ("with a fixed motion ({}) after each taken away", _without_after),
    ):
        say = _said_frame if mend is _of_vehicle else _said_motion
        for carried in (True, False):
            if mend is _without_before and carried:
                continue
            yield EdgeChange(
                "frame", words, partial(mend, carried),
                (0.0, 0.0, 0.0), say, starts=tuple(quarters),
            )  # fmt: skip


def _scales(slot: EdgeSlot) -> Iterator[EdgeChange]:
    length = {LANDMARKS: "ranges", POSITIONS: "coordinates"}.get(slot.kinds[0], "translations")
    for name, axes in ((length, (0, 1)), ("headings", (2,)))[: 1 + slot.is_motion]:
        for carried in (True, False):
            yield EdgeChange(
                f"size of {name}",
                f"when their {name} are {{}} times the true ones",
                _divided(axes, carried=carried),
                (1.0,),
                _said_factor,
                starts=((0.5,), (2.0,)),
                scaled=len(axes),
            )


def _divided(axes: tuple[int, ...], *, carried: bool) -> Mend:
    """Divide some components by a number. carried: their sigmas, too."""

    def mend(edges: EdgeColumns, numbers: Array) -> EdgeColumns:
        scale = np.ones(edges.z.shape[1])
        scale[list(axes)] = 1.0 / numbers[0] if numbers[0] else np.inf
        spread = edges.covariance * np.outer(scale, scale) if carried else edges.covariance
        z = edges.z.copy()
        if axes == (2,):  # a heading that was multiplied may have been wrapped
            more = np.round((numbers[0] * edges.turn - z[:, 2]) / (2.0 * np.pi))
            z[:, 2] += 2.0 * np.pi * more
        return edges._replace(z=z * scale, covariance=spread)

    return mend


def _said_factor(numbers: Array, widths: Array) -> str:
    low, high = numbers[0] - widths[0], numbers[0] + widths[0]
    return f"{numbers[0]:.3g} ({low:.3g} to {high:.3g})"


def _said_frame(numbers: Array, widths: Array) -> str:
    turn, width = np.degrees((np.angle(np.exp(1j * numbers[2])), widths[2]))
    return (
        f"{in_words(*numbers[:2].tolist())} and turned by {turn:.1f} degrees "
        f"(+- {max(widths[:2]):.2g} m, {width:.2g} degrees)"
    )


def _said_motion(numbers: Array, widths: Array) -> str:
    turn, width = np.degrees((np.angle(np.exp(1j * numbers[2])), widths[2]))
    return (
        f"x {numbers[0]:.3g} +- {widths[0]:.2g} m, y {numbers[1]:.3g} +- {widths[1]:.2g} m, "
        f"heading {turn:.3g} +- {width:.2g} degrees"
    )


def composed(first: Array, second: Array) -> Array:
    """(N, 3) motions (N, 3) or (3,), the second in the frame that the first leads to."""
    first, second = np.broadcast_arrays(first, second)
    place = first[:, :2] + turned(second[:, :2], first[:, 2])
    return np.column_stack((place, first[:, 2] + second[:, 2]))


def inverse(motion: Array) -> Array:
    """(N, 3) the motions back."""
    return in_own_axes(motion, np.zeros(3))


def _turned_by_itself(times: float, edges: EdgeColumns, _: Array) -> EdgeColumns:
    return _with_turned(edges, times * edges.z[:, 2])


def _with_turned(edges: EdgeColumns, angle: Array) -> EdgeColumns:
    return edges._replace(z=np.column_stack((turned(edges.z[:, :2], angle), edges.z[:, 2:])))


def _of_vehicle(carried: bool, edges: EdgeColumns, frame: Array) -> EdgeColumns:
    """Motions of the vehicle, from those of a frame on it."""
    frames = np.atleast_2d(frame)
    z = composed(composed(frames, edges.z), inverse(frames))
    return edges._replace(z=z, covariance=_carried(edges.covariance, frames, carried))


def _without_before(_: bool, edges: EdgeColumns, frame: Array) -> EdgeColumns:
    return edges._replace(z=in_own_axes(np.atleast_2d(frame), edges.z))


def _without_after(carried: bool, edges: EdgeColumns, frame: Array) -> EdgeColumns:
    frames = np.atleast_2d(frame)
    z = composed(edges.z, inverse(frames))
    return edges._replace(z=z, covariance=_carried(edges.covariance, frames, carried))


def _carried(covariance: Array, motion: Array, carried: bool) -> Array:
    if not carried:
        return covariance
    return planar.carried(covariance, inverse(motion)[0])


def _placed(carried: bool, edges: EdgeColumns, frame: Array) -> EdgeColumns:
    """Points in the vehicle's frame or the map's, from those in another."""
    spread = edges.covariance
    if carried:
        [turn] = rotations(frame[2:])
        spread = turn @ spread @ turn.T
    return edges._replace(z=turned(edges.z, frame[2]) + frame[:2], covariance=spread)
