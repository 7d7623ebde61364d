"""The restricted likelihood is greatest at the noise that the errors have; chi-square never is."""

from dataclasses import replace

import numpy as np
import pytest

from graphslam.graph_builder import build_graph, to_values
from graphslam.optimisers import levenberg_marquardt
from graphslam.problem import SlamProblem
from graphslam.restricted_likelihood import restricted_deviance

STATED, TRUE = 0.1, 0.3
POSES, FACTORS = 300, np.geomspace(1.0, 10.0, 61)


def walk() -> SlamProblem:
    """Motions of 1 m with their noise, and positions with three times theirs."""
    rng = np.random.default_rng(0)
    motion = np.array((0.02, 0.02, 0.01))
    still = np.arange(POSES, dtype=float)
    place = np.column_stack((still, np.zeros(POSES))) + rng.normal(0.0, TRUE, (POSES, 2))
    none = np.zeros(0, dtype=np.intp)
    return SlamProblem(
        prior_pose=np.zeros(3),
        prior_covariance=1e-4 * np.eye(3),
        increment=np.array((1.0, 0.0, 0.0)) + rng.normal(0.0, motion, (POSES - 1, 3)),
        increment_covariance=np.tile(np.diag(motion**2), (POSES - 1, 1, 1)),
        measurement_pose=none,
        measurement_landmark=none,
        z=np.zeros((0, 2)),
        sigma=np.zeros((0, 2)),
        landmark_count=0,
        position_pose=np.arange(POSES),
        position=place,
        position_covariance=np.tile(STATED**2 * np.eye(2), (POSES, 1, 1)),
    )


@pytest.fixture(scope="module")
def profile() -> tuple[np.ndarray, np.ndarray]:
    """Deviances and chi-squares by factor of the positions' sigma."""
    problem = walk()
    start = np.column_stack((np.arange(POSES, dtype=float), np.zeros((POSES, 2))))
    figures = []
    for factor in FACTORS:
        other = replace(problem, position_covariance=factor**2 * problem.position_covariance)
        graph = build_graph(other)
        values = levenberg_marquardt(
            graph, to_values(start, np.zeros((0, 2)), other.measurement_pose), 1e-9
        )[0]
        figures.append((restricted_deviance(other, graph, values), graph.error(values)))
    deviance, error = np.array(figures).T
    return deviance, error


def test_it_is_greatest_at_the_noise_of_the_errors(
    profile: tuple[np.ndarray, np.ndarray],
) -> None:
    deviance, error = profile
    assert FACTORS[np.argmin(deviance)] == pytest.approx(TRUE / STATED, rel=0.15)
    assert np.argmin(error) == len(FACTORS) - 1, "chi-square is least for the largest noise"
