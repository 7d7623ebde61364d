"""Optima of mended pose graphs: fitted numbers of a change, and likelihoods that compare them.

`edges` asks; every number is fitted by Gauss and Newton's method with all unknowns eliminated.
"""

from __future__ import annotations

import gtsam
import numpy as np

from comparisons.arrays import Array
from comparisons.explain.loops import loop_distances
from comparisons.faults.edges import (
    CLOSURES,
    LANDMARKS,
    ODOMETRY,
    POSITIONS,
    EdgeFault,
    EdgeSlot,
    columns,
    with_columns,
)
from graphslam.goodness_of_fit import Goodness, row_origins
from graphslam.graph_builder import COMPONENTS, build_graph, from_values, row_components
from graphslam.optimisers import levenberg_marquardt, optimise, polish
from graphslam.optimum import chi_square_test
from graphslam.problem import SlamProblem
from graphslam.restricted_likelihood import restricted_deviance
from graphslam.search import relaxed_values
from graphslam.sparse_system import column_lengths, normal_factors, scaled_columns, sparse_system
from graphslam.variance_components import Component, estimate_components

_ROUNDS, _ROUGH_ROUNDS = 6, 8
_SETTLED = 0.98
"""A step is the last that leaves more than so much of the median."""
_HOPELESS = {0: np.inf, 1: 1e4, 10: 3.0}
"""After so many iterations more a graph is given up that is so many times above its band."""
_COMPONENTS = {
    ODOMETRY: ("odometry",),
    CLOSURES: ("loop closure",),
    LANDMARKS: ("range", "bearing"),
    POSITIONS: ("position",),
}
"""What rows of a graph are called, by kind of edges."""
_HEADING_ROUNDS = 2
"""Optima whose headings tell what edges mean in the axes of the map."""
_MOST_WHITENED = 300
"""Edges of a kind whose entries are compared."""
_WHITE = 4.0
"""Sigmas that sums of products of residuals may be from what is expected."""
_NOISE_ROUNDS = 3
_NOISE_SETTLED = 0.02
"""Natural logarithm of the last change of a noise's factor."""
_NOISE_TOLERANCE = 1e-6
"""Of an optimum's error, relative."""
_LARGEST = 1e4
"""Number that no fit goes beyond."""


def likelihood(goodness: Goodness, log_volume: float = 0.0, *, any_size: bool = False) -> float:
    """Return -2 log likelihood of what was read, poses and landmarks marginalised.

    All changes are compared by it, whether they are of what edges measure or of their information.

    Args:
        goodness: The optimum of a graph as it may be meant.
        log_volume: Logarithm of the volume of the numbers that are meant over that of those read.
        any_size: The noise may have any size, one for all edges; its likeliest is taken.

    Returns:
        Chi-square and the logarithms of the covariances' and the normal matrix's determinants, but
        for a constant of the graph's shape, places being as likely anywhere in a map whose size is
        that of its steps, and headings in a range that is that of its turns; infinite where the
        equations are singular.
    """
    p, test = goodness.problem, goodness.test
    try:
        deviance = restricted_deviance(p, goodness.graph, goodness.values)
    except RuntimeError:
        return np.inf
    if any_size:
        deviance += test.dof * (1.0 + float(np.log(max(test.chi2, 1e-300) / test.dof))) - test.chi2
    steps = p.increment[p.steps] if len(p.steps) else p.loop_closures.motion
    places = 4.0 * (p.pose_count + p.landmark_count) * _log_size(steps[:, :2])
    places += 2.0 * p.pose_count * _log_size(steps[:, 2])
    by_x_and_y = 2.0 * float(np.log(p.z[:, 0]).sum())
    return deviance + by_x_and_y - 2.0 * log_volume + places


def _log_size(numbers: Array) -> float:
    """Logarithm of the root of the mean square; 0 where all are."""
    squared = float(np.mean(numbers**2)) if numbers.size else 0.0
    return 0.5 * float(np.log(squared)) if squared > 0.0 else 0.0


def mended_graph(
    fault: EdgeFault,
    problem: SlamProblem,
    numbers: Array | None = None,
    heading: Array | None = None,
) -> SlamProblem | None:
    """Return the graph as a fault has it meant; None where it means none.

    Args:
        fault: What is changed.
        problem: As it was read.
        numbers: (n,) of the change, if it has any.
        heading: (K,) of all poses [rad]; None for the odometry's.
    """
    try:
        with np.errstate(all="ignore"):
            mended = fault.mended(problem, numbers, heading)
    except np.linalg.LinAlgError:
        return None
    return mended if _is_graph(mended) and _turns_less(mended, problem) else None


def _turns_less(problem: SlamProblem, before: SlamProblem) -> bool:
    """Whether no edge turns by more than all the way round, or than one did before."""
    every = EdgeSlot("", (ODOMETRY, CLOSURES))
    turns, others = (
        np.abs(columns(slam_problem, every).z[:, 2]) for slam_problem in (problem, before)
    )
    most = max(2.0 * np.pi, float(np.max(others, initial=0.0)))
    return bool(np.max(turns, initial=0.0) <= most)


def _is_graph(problem: SlamProblem) -> bool:
    """Whether numbers are finite, covariances definite, and labels those of poses."""
    p, closed = problem, problem.loop_closures
    ends = np.concatenate((closed.first, closed.second))
    if len(ends) and not (ends.min() >= 0 and ends.max() < p.pose_count):
        return False
    if (closed.first == closed.second).any():
        return False
    numbers = (p.increment, closed.motion, p.z, p.sigma, p.position)
    spreads = (p.increment_covariance[p.steps], closed.covariance, p.position_covariance)
    if not all(np.isfinite(array).all() for array in (*numbers, *spreads)):
        return False
    return all(_definite(covariance) for covariance in spreads if len(covariance))


def _definite(covariance: Array) -> bool:
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 1e-300))
    values = np.linalg.eigvalsh(covariance / (scale[:, :, None] * scale[:, None, :]))
    return bool((values[:, 0] > 1e-12).all())


def optimum_of(
    problem: SlamProblem, low: float | None = None, *, any_size: bool = False
) -> Goodness | None:
    """Return an optimum whose chi-square lies in its band; None where there is none.

    Args:
        problem: A graph; one that is far above its band after some iterations is given up.
        low: The band's lower end, if another.
        any_size: Whatever its chi-square is.
    """
    dof = problem.residual_dimension - problem.state_dimension
    if dof <= 0:
        return None
    band = chi_square_test(0.0, dof)
    lower = band.lower if low is None else low
    try:
        graph = build_graph(problem)
        values = relaxed_values(problem)
        for iterations, factor in _HOPELESS.items():
            values = levenberg_marquardt(graph, values, 1e-2, iterations)[0]
            chi2 = 2.0 * graph.error(values)
            if not any_size and not lower <= chi2 <= factor * band.upper:
                return None
        values = polish(graph, optimise(graph, values)[0])[0]
    except (RuntimeError, ValueError):
        return None
    goodness = Goodness(problem, graph, values)
    if any_size or lower <= goodness.test.chi2 <= band.upper:
        return goodness
    return None


def optimum_with(fault: EdgeFault, problem: SlamProblem) -> Goodness | None:
    """Return the optimum with what mends a fault without numbers; None where it is too high.

    Args:
        fault: What is changed.
        problem: As it was read.
    """
    mended = mended_graph(fault, problem)
    for _ in range(_HEADING_ROUNDS if fault.change.by_heading else 0):
        goodness = None if mended is None else optimum_of(mended, any_size=True)
        if goodness is None:
            return None
        heading = from_values(goodness.values, goodness.problem)[0][:, 2]
        mended = mended_graph(fault, problem, heading=heading)
    return None if mended is None else optimum_of(mended, low=0.0)


def openness(fault: EdgeFault, problem: SlamProblem, numbers: Array) -> float:
    """Return the median of squared residuals of loops with a change's numbers.

    Args:
        fault: Its change has numbers.
        problem: As it was read.
        numbers: (n,) of the change.

    Returns:
        Of the loops that the slot's edges close; infinite where there are none.
    """
    mended = mended_graph(fault, problem, numbers)
    if mended is None:
        return np.inf
    residual = loop_distances(mended, fault.slot.kinds)
    return float(np.median(np.sum(residual**2, axis=1))) if len(residual) else np.inf


def roughly(fault: EdgeFault, problem: SlamProblem, start: Array) -> tuple[Array, float]:
    """Return numbers that make loops close, by robust least squares.

    Args:
        fault: Its change has numbers.
        problem: As it was read.
        start: (n,) where to begin.

    Returns:
        (n,) numbers, and the median of squared residuals of loops with them.
    """
    numbers, best = start.astype(float), (np.inf, start.astype(float))
    for _ in range(_ROUGH_ROUNDS):
        mended = mended_graph(fault, problem, numbers)
        if mended is None:
            break
        residual = loop_distances(mended, fault.slot.kinds)
        squared = np.sum(residual**2, axis=1)
        if not len(residual):
            break
        score = float(np.median(squared))
        if not score < _SETTLED * best[0]:
            return (numbers, score) if score < best[0] else (best[1], best[0])
        best = score, numbers
        weight = 1.0 / (1.0 + squared / max(9.0, score))
        slope = np.zeros((len(numbers), *residual.shape))
        for k in range(len(numbers)):
            more = numbers.copy()
            more[k] += 1e-5
            beside = mended_graph(fault, problem, more)
            if beside is None:
                return best[1], best[0]
            slope[k] = (loop_distances(beside, fault.slot.kinds) - residual) / 1e-5
        flat = (slope * np.sqrt(weight)[:, None]).reshape(len(numbers), -1)
        right = (residual * np.sqrt(weight)[:, None]).ravel()
        normal = flat @ flat.T
        ridge = 1e-9 * np.trace(normal) * np.eye(len(numbers)) + 1e-12 * np.eye(len(numbers))
        step = np.linalg.solve(normal + ridge, flat @ right)
        limit = np.array([1.0, 1.0, 0.5])[: len(numbers)] if len(numbers) > 1 else np.array([0.5])
        numbers = numbers - np.clip(step, -4.0 * limit, 4.0 * limit)
    return best[1], best[0]


def fitted(
    fault: EdgeFault, problem: SlamProblem, numbers: Array
) -> tuple[Array, Array, Goodness] | None:
    """Return numbers at the least chi-square, their sigmas, and the optimum with them.

    Args:
        fault: Its change has numbers.
        problem: As it was read.
        numbers: (n,) where to begin.

    Returns:
        None where there is no optimum.
    """
    mended = mended_graph(fault, problem, numbers)
    start = None if mended is None else optimum_of(mended, any_size=True)
    if mended is None or start is None:
        return None
    values, sigma = start.values, np.full(len(numbers), np.nan)
    try:
        for _ in range(_ROUNDS):
            step, sigma, values = newton_step(fault, problem, numbers, values)
            numbers = numbers + step
            if np.abs(numbers).max() > _LARGEST:
                return None
            if (np.abs(step) < 1e-2 * sigma).all():
                break
        mended = mended_graph(fault, problem, numbers)
        if mended is None:
            return None
        graph = build_graph(mended)
        values = polish(graph, optimise(graph, values)[0])[0]
    except (RuntimeError, ValueError, np.linalg.LinAlgError):
        return None
    return numbers, sigma, Goodness(mended, graph, values)


def newton_step(
    fault: EdgeFault, problem: SlamProblem, numbers: Array, values: gtsam.Values
) -> tuple[Array, Array, gtsam.Values]:
    """Return a step of the numbers by Gauss and Newton, all poses and landmarks eliminated.

    Args:
        fault: Its change has numbers.
        problem: As it was read.
        numbers: (n,) where to begin.
        values: Poses and landmarks there, or nearly.

    Returns:
        The step (n,), sigmas (n,) of the numbers, and the optimum before the step.

    Raises:
        ValueError: The numbers make no graph.
        RuntimeError: The equations are singular.
        numpy.linalg.LinAlgError: The numbers cannot be told apart.
    """
    mended = mended_graph(fault, problem, numbers)
    if mended is None:
        raise ValueError("no graph")
    graph = build_graph(mended)
    values = levenberg_marquardt(graph, values, 1e-6)[0]
    height = len(row_origins(mended).component)
    jacobian, right = sparse_system(graph, values, height)
    jacobian = scaled_columns(jacobian, column_lengths(jacobian))
    solver = normal_factors(jacobian)
    slope = np.zeros((height, len(numbers)))
    for k in range(len(numbers)):
        more, size = numbers.copy(), 1e-5
        more[k] += size
        beside = mended_graph(fault, problem, more)
        if beside is None:
            raise ValueError("no graph")
        slope[:, k] = (sparse_system(build_graph(beside), values, height)[1] - right) / size
    left = slope - jacobian @ solver.solve(jacobian.T @ slope)
    normal = left.T @ left
    covariance = np.linalg.inv(normal)
    sigma = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    return -covariance @ (left.T @ right), sigma, values


def are_white(goodness: Goodness, slot: EdgeSlot) -> bool:
    """Return whether the informations of some edges are right entry by entry.

    Whitened residuals of one edge have unit variance in each entry and none between two, where the
    whole matrix is right; where only its size is, their sum of squares is in its band all the same.

    Args:
        goodness: An optimum.
        slot: Which edges; all of their kinds.
    """
    component = row_components(goodness.problem)
    jacobian, right = sparse_system(goodness.graph, goodness.values, len(component))
    jacobian = scaled_columns(jacobian, column_lengths(jacobian))
    solver = normal_factors(jacobian)
    size = 3 if slot.is_motion else 2
    for kind in slot.kinds:
        numbers = [COMPONENTS.index(name) for name in _COMPONENTS[kind]]
        rows = np.flatnonzero(np.isin(component, numbers))[: size * _MOST_WHITENED]
        if not len(rows):
            continue
        left = np.eye(len(rows)) - jacobian[rows] @ solver.solve(jacobian[rows].T.toarray())
        if not _white(right[rows].reshape(-1, size), left.reshape(-1, size, len(rows))):
            return False
    return True


def _white(residual: Array, covariance: Array) -> bool:
    """Whether products of entries are as expected: residuals (N, d), covariance (N, d, N d)."""
    count, size = residual.shape
    spread = covariance.reshape(count, size, count, size)
    for i in range(size):
        for j in range(i + 1):
            mixed = spread[:, i, :, j]
            variance = np.sum(spread[:, i, :, i] * spread[:, j, :, j] + mixed * mixed.T)
            apart = residual[:, i] @ residual[:, j] - np.trace(mixed)
            if abs(apart) > _WHITE * np.sqrt(variance):
                return False
    return True


def fitted_noise(slot: EdgeSlot, stated: Goodness) -> tuple[Component, Goodness] | None:
    """Return how the noise of a slot's edges compares with what is stated, all others as stated.

    Args:
        slot: Which edges; all of their kinds.
        stated: The optimum as the noise is stated.

    Returns:
        The factor of standard deviations with what is known of it, and the optimum with it; None
        where there is none.
    """
    problem, total, goodness = stated.problem, 1.0, stated
    component = row_components(problem)
    kinds = [COMPONENTS.index(name) for kind in slot.kinds for name in _COMPONENTS[kind]]
    asked = np.where(np.isin(component, kinds), kinds[0], -1)
    edges = columns(problem, slot)
    try:
        for _ in range(_NOISE_ROUNDS):
            system = sparse_system(goodness.graph, goodness.values, len(component))
            [noise] = estimate_components(*system, asked)
            total *= noise.factor
            mended = with_columns(
                problem, slot, edges._replace(covariance=total**2 * edges.covariance)
            )
            graph = build_graph(mended)
            values = levenberg_marquardt(graph, goodness.values, _NOISE_TOLERANCE)[0]
            goodness = Goodness(mended, graph, values)
            if abs(np.log(noise.factor)) < _NOISE_SETTLED:
                break
    except (RuntimeError, ValueError, np.linalg.LinAlgError):
        return None
    return noise._replace(factor=total), goodness
