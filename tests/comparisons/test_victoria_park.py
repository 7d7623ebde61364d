"""The smoother's oracle on gtsam's real log, without any help from the EKF."""

from dataclasses import replace

import gtsam
import pytest

from comparisons.adapters.smoother_input import build_problem
from comparisons.jobs.run import Comparison
from graphslam.graph_builder import build_graph
from graphslam.initialisation import extension
from graphslam.optimisers import levenberg_marquardt
from graphslam.optimum import Optimality, Stationarity, chi_square_test, stationarity
from graphslam.problem import SlamProblem
from graphslam.smoother import smooth


@pytest.fixture(scope="module")
def problem(victoria_park: Comparison) -> SlamProblem:
    return build_problem(victoria_park.log, victoria_park.ekf)


@pytest.mark.slow
def test_both_starts_reach_the_optimum_from_nothing(problem: SlamProblem) -> None:
    result = smooth(problem, {})
    assert [start.name for start in result.starts] == ["relaxed", "tracked"]
    assert all(abs(start.error - 3173.49) < 0.01 for start in result.starts)
    assert result.optimality.verified


@pytest.mark.slow
def test_where_dead_reckoning_leads_is_not_believed(problem: SlamProblem) -> None:
    """The trap that gtsam's users fall into: a start by dead reckoning ends in a false minimum."""
    graph = build_graph(problem)
    values = extension(problem, gtsam.Values(), 0, problem.pose_count)
    end, _, _ = levenberg_marquardt(graph, values, 1e-5, limit=60)
    error = graph.error(end)
    dof = problem.residual_dimension - problem.state_dimension
    assert dof == 6978
    assert error > 10 * 3173.49
    optimality = Optimality(
        stationarity=stationarity(graph, end),
        chi_square=chi_square_test(error, dof),
        agreeing=("dead-reckoning",),
        agreed=False,
    )
    assert not optimality.verified
    # Even were it a strict local minimum that others reach, its chi-square would give it away.
    local = replace(optimality, stationarity=Stationarity(0.0, definite=True), agreed=True)
    assert not local.verified
    assert local.chi_square.reading == "too high"
