"""The smoother's oracle on gtsam's real log, without any help from the EKF."""

from __future__ import annotations

import numpy as np
import pytest

from comparisons.compare import Comparison
from comparisons.runs.smoother_run import build_problem
from graphslam.graph_builder import SlamProblem, build_graph, to_values
from graphslam.optimum import Proof, chi_square_test, stationarity
from graphslam.smoother import smooth


@pytest.fixture(scope="module")
def problem(victoria_park: Comparison) -> SlamProblem:
    return build_problem(victoria_park.log, victoria_park.ekf)


def test_growing_prefixes_reach_the_optimum_from_nothing(problem: SlamProblem) -> None:
    result = smooth(problem, {})
    assert [start.name for start in result.starts] == ["incremental"]
    assert abs(result.error - 3173.49) < 0.01
    assert result.proof.proven


def test_a_local_minimum_is_not_believed(problem: SlamProblem) -> None:
    """Chi-square of the minimum that dead reckoning leads to is far above its band."""
    result = smooth(problem, {})
    values = to_values(result.poses, result.landmarks, np.unique(problem.sighting_landmark))
    conditions = stationarity(build_graph(problem), values)
    dof = problem.residual_dimension - problem.state_dimension
    assert dof == 6978
    false_minimum = Proof(conditions, chi_square_test(254_667.0, dof), ("dead-reckoning",))
    assert conditions.holds
    assert not false_minimum.proven
