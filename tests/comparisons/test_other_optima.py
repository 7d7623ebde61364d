"""Which other edges an estimate is the optimum of: named for any change, none of a right one."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from comparisons.arrays import Array
from comparisons.explain.edge_fits import mended_graph
from comparisons.explain.other_optima import (
    CHARTS,
    Chart,
    OtherOptimum,
    linearised,
    other_optimum,
)
from comparisons.faults.edges import (
    CLOSURES,
    ODOMETRY,
    EdgeColumns,
    EdgeFault,
    EdgeSlot,
    columns,
    composed,
    faults_of,
    inverse,
    slots,
)
from graphslam.increments import dead_reckoned
from graphslam.problem import LoopClosures, SlamProblem

EVERY = EdgeSlot("", (ODOMETRY, CLOSURES))
SIGMA = np.array((0.06, 0.03, 0.012))


def covariances(rng: np.random.Generator, count: int) -> Array:
    """(N, 3, 3) that differ from edge to edge, correlated."""
    root = np.tril(0.4 * rng.standard_normal((count, 3, 3)), -1) + np.eye(3)
    spread = root @ root.mT * np.outer(SIGMA, SIGMA)
    return np.asarray(spread * rng.uniform(0.5, 2.0, (count, 1, 1)))


def graph(seed: int = 0) -> SlamProblem:
    """Twice round a square of 6 poses a lap, with closures of the second lap to the first."""
    rng = np.random.default_rng(seed)
    steps = np.column_stack((np.ones(12), 0.1 * rng.standard_normal(12), np.full(12, np.pi / 3.0)))
    truth = dead_reckoned(np.zeros(3), steps)
    first = np.array((0, 1, 2, 3, 4, 5, 1))
    second = first + np.array((6, 6, 6, 7, 6, 5, 8))
    motion = composed(inverse(truth[first]), truth[second])
    motion[:, 2] = np.angle(np.exp(1j * motion[:, 2]))

    def measured(sound: Array, spread: Array) -> Array:
        noise = np.linalg.cholesky(spread) @ rng.standard_normal((len(sound), 3, 1))
        return np.asarray(sound + noise[:, :, 0])

    of_steps, of_closures = covariances(rng, 12), covariances(rng, 7)
    nothing = np.zeros((0, 2))
    return SlamProblem(
        prior_pose=np.zeros(3),
        prior_covariance=1e-6 * np.eye(3),
        increment=measured(steps, of_steps),
        increment_covariance=of_steps,
        measurement_pose=np.zeros(0, dtype=np.intp),
        measurement_landmark=np.zeros(0, dtype=np.intp),
        z=nothing,
        sigma=nothing,
        landmark_count=0,
        loop_closures=LoopClosures(
            first=first,
            second=second,
            motion=measured(motion, of_closures),
            covariance=of_closures,
        ),
    )


def whitened(edges: EdgeColumns, poses: Array) -> Array:
    """Residuals (3 N,) by x, y and heading, of an optimiser's own."""
    off = composed(inverse(edges.z), composed(inverse(poses[edges.first]), poses[edges.second]))
    off[:, 2] = np.angle(np.exp(1j * off[:, 2]))
    root = np.linalg.cholesky(np.linalg.inv(edges.covariance)).mT
    return np.asarray((root @ off[:, :, None]).ravel())


def optimised(edges: EdgeColumns, problem: SlamProblem) -> Array:
    """(K, 3) where somebody's optimiser ends; the first pose is held."""
    begin = dead_reckoned(problem.prior_pose, problem.increment)

    def residuals(numbers: Array) -> Array:
        return whitened(edges, np.vstack((begin[:1], numbers.reshape(-1, 3))))

    ended = least_squares(residuals, begin[1:].ravel(), xtol=1e-15, ftol=1e-15, gtol=1e-12)
    return np.vstack((begin[:1], ended.x.reshape(-1, 3)))


def drawn(rng: np.random.Generator, problem: SlamProblem) -> tuple[EdgeFault, SlamProblem]:
    """A fault without a number, and the graph with it."""
    while True:
        every = list(slots(problem))
        faults = list(faults_of(every[int(rng.integers(len(every)))]))
        fault = faults[int(rng.integers(len(faults)))]
        if fault.change.neutral or fault.change.by_heading:
            continue
        mended = mended_graph(fault, problem)
        if mended is not None:
            return fault, mended


@pytest.mark.parametrize("seed", range(12))
def test_what_an_optimiser_did_is_named(seed: int) -> None:
    """Of any slot and change; what comes to the same stands beside it."""
    rng = np.random.default_rng(seed)
    problem = graph(seed)
    fault, mended = drawn(rng, problem)
    poses = optimised(columns(mended, EVERY), problem)
    optimum = other_optimum(problem, poses)
    if optimum is None:  # its least squares have ended elsewhere, or nowhere, or it changes nothing
        sound = optimised(columns(problem, EVERY), problem)
        jacobian, residual = linearised(columns(mended, EVERY), poses, CHARTS[0])
        ended = np.abs(jacobian.T @ residual).max() < 1e-6 * np.abs(jacobian.T).sum(axis=1).max()
        assert not ended or np.abs(poses - sound).max() < 1e-6
        return
    assert fault.kind in optimum.words or alike(optimum, problem, poses), optimum


def alike(optimum: OtherOptimum, problem: SlamProblem, poses: Array) -> bool:
    """Whether what is named has its optimum there as well."""
    first = optimum.words.split(", or of ")[0]
    for slot in slots(problem):
        for fault in faults_of(slot):
            if fault.kind == first and not fault.change.neutral:
                mended = mended_graph(fault, problem)
                if mended is not None:
                    again = optimised(columns(mended, EVERY), problem)
                    if np.abs(again - poses).max() < 1e-3:
                        return True
    return False


def test_edges_that_are_left_out_are_named() -> None:
    problem = graph()
    optimum = other_optimum(problem, dead_reckoned(problem.prior_pose, problem.increment))
    assert optimum is not None
    assert optimum.words.startswith("the loop closures left out")
    assert optimum.sigma < 1e-3 < 1.0 < optimum.sound


@pytest.mark.parametrize("seed", range(4))
def test_a_right_optimum_is_none_of_another_graph(seed: int) -> None:
    """In any frame, however its errors are written; nor are poses that are the optimum of none."""
    problem = graph(seed)
    poses = optimised(columns(problem, EVERY), problem)
    assert other_optimum(problem, poses) is None
    assert other_optimum(problem, composed(np.array((3.0, -2.0, 0.7)), poses)) is None
    noise = np.random.default_rng(seed).standard_normal(poses.shape)
    assert other_optimum(problem, poses + 0.1 * SIGMA * noise) is None


@pytest.mark.parametrize("chart", CHARTS)
def test_jacobians_are_central_differences(chart: Chart) -> None:
    problem, rng = graph(1), np.random.default_rng(1)
    edges = columns(problem, EVERY)
    poses = dead_reckoned(problem.prior_pose, problem.increment) + 0.1 * rng.standard_normal(
        (problem.pose_count, 3)
    )
    jacobian, right = linearised(edges, poses, chart)
    step = rng.standard_normal(poses.shape)
    step[0] = 0.0
    change = [linearised(edges, poses + h * step, chart)[1] for h in (1e-6, -1e-6)]
    by_differences = (change[1] - change[0]) / 2e-6
    assert np.allclose(jacobian @ step[1:].ravel(), by_differences, rtol=1e-6, atol=1e-6)
    if chart is CHARTS[0]:
        assert np.allclose(-right, whitened(edges, poses), rtol=1e-9, atol=1e-12)
