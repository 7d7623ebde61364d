"""Do the residuals of an optimum have the noise that is stated, everywhere?

A chi-square in its band is not enough to say that a problem fits: a sigma that is raised takes any
misfit into the band. So the residuals are compared with their own expectation over sensors,
landmarks and time, one by one, in the mean, and from each to the next. Residuals r = W e of errors
e with unit variance have the covariance W = I - J (J^T J)^-1 J^T, whose diagonal is each row's
share of the degrees of freedom.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, erfc, gammainc, gammaincc

from graphslam.arrays import Array, Index
from graphslam.graph_builder import COMPONENTS, build_graph, last_poses, row_components
from graphslam.optimisers import levenberg_marquardt
from graphslam.optimum import EXTREME, ChiSquareTest, chi_square_test
from graphslam.problem import SlamProblem
from graphslam.sparse_system import column_lengths, normal_factors, scaled_columns, sparse_system

Mask = NDArray[np.bool_]

LEVEL = 0.01
"""Share of right problems with a part outside; half of it for single residuals."""
_STRETCHES = 5
"""Of equally many rows, into which the time is divided."""
_FEWEST_PAIRS = 20
_LEAST_SHARE = 1e-3
"""Of a degree of freedom; a row with less is fitted, whatever it says."""
_LEAST_DOF = 1.0
_MOST_ROWS = 8192
"""Of more, every so many runs of a block's length are judged: each row costs a solution."""
_BLOCK = 256
"""Rows that are solved for at a time."""
_TOLERANCE = 1e-6
"""Of an optimum's error, relative."""
_HEIGHTS = 3, 2, 2, 2, 3, 3, 3
"""Rows of a factor: increment, measurement, position, surveyed landmark, pose landmark, closure,
merge."""


class ResidualRows(NamedTuple):
    """Where the scalar rows (m,) of `build_graph` come from, once it is linearised.

    component: of COMPONENTS, -1 for what is known beforehand. entry: within its factor. pose: the
    last that it touches. landmark: its point landmark, -1 without one.
    """

    component: Index
    entry: Index
    pose: Index
    landmark: Index


class ResidualGroup(NamedTuple):
    """Residuals that are judged together.

    p_value: chance that a right problem's are as far out. component: of COMPONENTS, or empty for
    several. landmark: -1 for all. first, last: poses. value, expected: chi-square and its degrees
    of freedom, or a residual in its own sigma and 0. how: `size`, `single`, `mean` or `order`; or
    `first`, of a size, whose first pose is that of its first residual outside.
    """

    p_value: float
    how: str
    component: str
    landmark: int
    first: int
    last: int
    value: float
    expected: float

    @property
    def excess(self) -> float:
        """Chi-square above its expectation, in the sigma of chi-square."""
        return (self.value - self.expected) / math.sqrt(2.0 * max(self.expected, 1.0))


def rescaled(goodness: Goodness, component: str, factor: float) -> Goodness:
    """Return the optimum with another noise of one sensor.

    Args:
        goodness: The optimum as the noise is stated.
        component: Of COMPONENTS.
        factor: Of its standard deviations.

    Returns:
        The optimum next to that one.
    """
    p, variance = goodness.problem, factor**2
    seen, closed = p.pose_landmarks, p.loop_closures
    entry = {"bearing": (1.0, factor), "range": (factor, 1.0)}.get(component, (1.0, 1.0))

    def of(name: str) -> float:
        return variance if component == name else 1.0

    problem = replace(
        p,
        increment_covariance=of("odometry") * p.increment_covariance,
        sigma=p.sigma * entry,
        position_covariance=of("position") * p.position_covariance,
        pose_landmarks=replace(seen, covariance=of("pose landmark") * seen.covariance),
        loop_closures=replace(closed, covariance=of("loop closure") * closed.covariance),
    )
    graph = build_graph(problem)
    return Goodness(problem, graph, levenberg_marquardt(graph, goodness.values, _TOLERANCE)[0])


def far_less(test: ChiSquareTest, other: ChiSquareTest) -> bool:
    """Return whether no chance makes one optimum so much lower than another of the same weights.

    Args:
        test: Of the lower one.
        other: Of the higher one, with as many degrees of freedom.

    Returns:
        By the F distribution, whatever the common size of the noise is.
    """
    if not test.chi2 < other.chi2:
        return False
    half = 0.5 * other.dof
    return bool(betainc(half, half, test.chi2 / (test.chi2 + other.chi2)) <= EXTREME)


def row_origins(problem: SlamProblem) -> ResidualRows:
    """Return where each scalar row of a problem's graph comes from.

    Args:
        problem: The graph's.

    Returns:
        As many rows as `row_components`.
    """
    p = problem
    counts = (
        len(p.steps), len(p.z), len(p.position), len(p.surveyed), len(p.pose_landmarks.measured),
        len(p.loop_closures.motion), len(p.pose_landmarks.merges.measured),
    )  # fmt: skip
    height = np.concatenate(([3], np.repeat(_HEIGHTS, counts)))
    landmark = np.full(len(height), -1)
    begin = 1 + len(p.steps)
    landmark[begin : begin + len(p.z)] = p.measurement_landmark
    entry = np.concatenate([np.arange(one) for one in height])
    pose, mapped = np.repeat(last_poses(p), height), np.repeat(landmark, height)
    return ResidualRows(row_components(p), entry, pose, mapped)


@dataclass(frozen=True)
class Goodness:
    """An optimum with its residuals.

    Attributes:
        problem: What was solved.
        graph: Its graph, without a robust kernel.
        values: The optimum.
    """

    problem: SlamProblem
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values

    @cached_property
    def test(self) -> ChiSquareTest:
        """Chi-square of the whole, with its band."""
        dof = self.problem.residual_dimension - self.problem.state_dimension
        return chi_square_test(float(self.graph.error(self.values)), dof)

    @property
    def rows(self) -> int:
        """Scalar rows of the graph."""
        return len(row_components(self.problem))

    @cached_property
    def worst(self) -> ResidualGroup | None:
        """The part that is farthest outside its band; None where all parts are inside."""
        return min(self._outside, key=lambda part: part.p_value, default=None)

    @property
    def sound(self) -> bool:
        """Chi-square lies in its band, and so does every part."""
        return self.test.reading == "plausible" and self.test.dof > 0 and self.worst is None

    @property
    def within(self) -> bool:
        """No part has more than the stated noise; it may have less."""
        more = (part.value > part.expected for part in self._outside if part.how != "order")
        return self.test.reading != "too high" and not any(more)

    @cached_property
    def departure(self) -> ResidualGroup | None:
        """Where most is left beyond the stated noise: a sensor, one in a stretch, of a landmark.

        Its `first` is the pose of the first of its residuals outside their band, if there is one.
        None where all parts are inside.
        """
        sizes = [one for one in self._outside if one.how == "size" and one.expected < one.value]
        most = max(sizes, key=lambda part: part.excess, default=self.worst)
        if most is None or most.how == "single":
            return most
        singles = [
            part.first
            for part in self._outside
            if part.how == "single"
            and part.component == most.component
            and most.landmark in (-1, part.landmark)
            and most.first <= part.first <= most.last
        ]
        return most._replace(first=min(singles), how="first") if singles else most

    @cached_property
    def _outside(self) -> list[ResidualGroup]:
        """Parts outside their bands, such that LEVEL of right problems has any."""
        parts = list(_parts(self.problem, self.graph, self.values))
        limit = _limit(sum(part.how != "single" for part in parts))
        return [part for part in parts if part.how == "single" or part.p_value < limit]


def _parts(
    problem: SlamProblem, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> Iterator[ResidualGroup]:
    """All that is judged of a problem's residuals."""
    rows = row_origins(problem)
    jacobian, right = sparse_system(graph, values, len(rows.component))
    jacobian = scaled_columns(jacobian, column_lengths(jacobian))
    solver = normal_factors(jacobian)
    skipped = max(1, -(-len(rows.component) // _MOST_ROWS))
    number = np.arange(len(rows.component)) // _BLOCK
    known = (rows.component >= 0) & (number % skipped == 0)
    order = np.lexsort((np.arange(len(known)), rows.landmark, rows.entry, rows.component))
    following = np.full(len(known), -1)
    alike = [np.diff(column[order]) == 0 for column in (rows.component, rows.entry, rows.landmark)]
    pairs = np.flatnonzero(np.logical_and.reduce(alike))
    following[order[pairs]] = order[pairs + 1]
    share, beside = np.ones(len(known)), np.zeros(len(known))
    for begin in range(0, len(known), _BLOCK * skipped):
        block = np.arange(begin, min(begin + _BLOCK, len(known)))
        fitted = jacobian @ solver.solve(jacobian[block].T.toarray())
        share[block] = 1.0 - fitted[block, block - begin]
        beside[block] = -fitted[following[block], block - begin]
    known &= share > _LEAST_SHARE
    for selected in _groups(rows, known):
        yield from _sizes(rows, right, share, np.flatnonzero(selected))
    yield from _singles(rows, right, share, np.flatnonzero(known))
    for component, entry in np.unique(np.column_stack((rows.component, rows.entry)), axis=0):
        selected = known & (rows.component == component) & (rows.entry == entry)
        if not selected.any():
            continue
        ones = selected.astype(float)
        left = ones - jacobian @ solver.solve(jacobian.T @ ones)
        yield from _means(rows, right, float(ones @ left), np.flatnonzero(selected))
        paired = np.flatnonzero(selected & (following >= 0))
        paired = paired[known[following[paired]]]
        yield from _orders(rows, right, (share, beside, following), paired)


def _groups(rows: ResidualRows, known: Mask) -> Iterator[Mask]:
    """Masks (m,): sensors, these over time, and by landmark."""
    poses = np.quantile(rows.pose[known], np.linspace(0.0, 1.0, _STRETCHES + 1)[1:-1])
    stretch = np.searchsorted(poses, rows.pose)
    for component in np.unique(rows.component[known]):
        sensor = known & (rows.component == component)
        yield sensor
        for number in range(_STRETCHES):
            yield sensor & (stretch == number)
        for landmark in np.unique(rows.landmark[sensor]):
            if landmark >= 0:
                yield sensor & (rows.landmark == landmark)


def _singles(
    rows: ResidualRows, right: Array, share: Array, selected: Index
) -> Iterator[ResidualGroup]:
    """Single residuals outside their band, which is that of all of them together."""
    size = np.abs(right[selected]) / np.sqrt(share[selected])
    p_value = erfc(size / np.sqrt(2.0))
    for number in np.flatnonzero(p_value < _limit(len(selected))).tolist():
        figures = float(p_value[number]), float(size[number]), 0.0
        yield _part("single", rows, selected[number : number + 1], figures)


def _limit(count: int) -> float:
    """Of p-values, such that half of LEVEL of right problems has one of so many below."""
    return 0.5 * LEVEL / max(count, 1)


def _sizes(
    rows: ResidualRows, right: Array, share: Array, selected: Index
) -> Iterator[ResidualGroup]:
    """Chi-square of some rows: its variance is at most twice its expectation."""
    dof = float(share[selected].sum())
    if dof < _LEAST_DOF:
        return
    chi2 = float(right[selected] @ right[selected])
    tails = gammainc(0.5 * dof, 0.5 * chi2), gammaincc(0.5 * dof, 0.5 * chi2)
    yield _part("size", rows, selected, (2.0 * float(min(tails)), chi2, dof))


def _means(
    rows: ResidualRows, right: Array, variance: float, selected: Index
) -> Iterator[ResidualGroup]:
    """The sum of rows of one kind."""
    if variance < _LEAST_DOF:
        return
    size = abs(float(right[selected].sum())) / np.sqrt(variance)
    yield _part("mean", rows, selected, (float(erfc(size / np.sqrt(2.0))), size, 0.0))


def _orders(
    rows: ResidualRows, right: Array, covariances: tuple[Array, Array, Index], paired: Index
) -> Iterator[ResidualGroup]:
    """Products of rows of one kind and the next of theirs."""
    if len(paired) < _FEWEST_PAIRS:
        return
    share, beside, following = covariances
    products = right[paired] * right[following[paired]] - beside[paired]
    variance = share[paired] * share[following[paired]] + beside[paired] ** 2
    size = abs(float(products.sum())) / np.sqrt(float(variance.sum()))
    yield _part("order", rows, paired, (float(erfc(size / np.sqrt(2.0))), size, 0.0))


def _part(
    how: str, rows: ResidualRows, selected: Index, figures: tuple[float, float, float]
) -> ResidualGroup:
    """A part by its rows. figures: p-value, value and expectation."""
    components, landmarks = (np.unique(one[selected]) for one in (rows.component, rows.landmark))
    return ResidualGroup(
        p_value=figures[0],
        how=how,
        component=COMPONENTS[components[0]] if len(components) == 1 else "",
        landmark=int(landmarks[0]) if len(landmarks) == 1 else -1,
        first=int(rows.pose[selected].min()),
        last=int(rows.pose[selected].max()),
        value=figures[1],
        expected=figures[2],
    )
