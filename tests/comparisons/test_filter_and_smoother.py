"""The filter's models and estimates beside the smoother's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.smoother_input import build_problem
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig
from comparisons.logs.bundled import open_log
from comparisons.pipeline.solve import solve
from ekf_reference.models.motion import (
    AckermannModel,
    IntegratedModel,
    Integration,
    MotionModel,
    UnicycleModel,
)
from graphslam.graph_builder import build_graph, to_tangent, to_values
from graphslam.increments import compose
from graphslam.initialisation import track
from graphslam.optimisers import optimise
from graphslam.smoother import smooth
from tests.graphslam.motions import GEOMETRY, controls, samples
from tests.graphslam.numerics import product
from tests.helpers import relative_error, simulated


@pytest.mark.parametrize("integration", ["euler", "middle", "arc", 10, 0.015])
@pytest.mark.parametrize("kind", ["ackermann", "unicycle"])
def test_increment_carries_what_the_filter_predicts(kind: str, integration: Integration) -> None:
    """Composed by this package, or stepped through by the EKF's models: the same Gaussian."""
    model: MotionModel = AckermannModel(*GEOMETRY) if kind == "ackermann" else UnicycleModel()
    own: Integration = "euler" if kind == "ackermann" else "middle"
    model = IntegratedModel(model, own, integration)
    u, w, dt = controls(40, 3)
    start = np.array((4.0, -7.0, 2.1))
    pose, covariance = start, np.zeros((3, 3))
    for i in range(40):
        step = model.step(pose, np.array((u[i], w[i])), float(dt[i]))
        b = step.jacobian_control
        noise = b @ np.diag((0.04, 0.0025)) @ b.T + dt[i] * np.diag((1e-5, 1e-5, 1e-7))
        covariance = step.jacobian_pose @ covariance @ step.jacobian_pose.T + noise
        pose = step.pose
    whole = compose(samples(kind, u, w, dt, integration), np.zeros(40, dtype=np.intp), 1)
    assert np.allclose(product(start, whole.displacement[0]), pose, rtol=0, atol=1e-12)
    turn = to_tangent(pose[2:])[0].T
    assert relative_error(turn @ whole.covariance[0] @ turn.T, covariance) < 1e-12


@pytest.mark.parametrize(("duration_s", "steps"), [(0.14, 7), (0.28, 14), (0.15, 8)])
def test_a_duration_of_whole_steps_has_no_step_more(duration_s: float, steps: int) -> None:
    """In both packages; 0.14 s by 0.02 s are a little more than 7 in floating point."""
    u, w, dt = np.array([2.0]), np.array([0.5]), np.array([duration_s])
    ours, expected = (samples("unicycle", u, w, dt, one).displacement for one in (0.02, steps))
    assert np.array_equal(ours, expected)
    model, control = UnicycleModel(), np.concatenate((u, w))
    own, other = (
        IntegratedModel(model, "middle", one).step(np.zeros(3), control, duration_s).pose
        for one in (0.02, steps)
    )
    assert np.array_equal(own, other)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_filter_at_k_agrees_with_the_smoother_up_to_k(seed: int) -> None:
    """Like with like: neither has seen the future; both are given the same prefix."""
    log = simulated(seed, loop_s=40.0)
    timeline = build_timeline(log)
    problem = solve(log).result.problem
    stops = [problem.pose_count // 4, problem.pose_count // 2, problem.pose_count - 1]
    for stop in stops:
        part = problem.prefix(stop + 1)
        seen, landmark = np.unique(part.measurement_landmark, return_inverse=True)
        part = replace(part, measurement_landmark=landmark, landmark_count=len(seen))
        mean, covariance = smooth(part, {}).marginal()
        run = run_ekf(log, timeline.prefix(stop + 1), settle(EkfConfig(), log))
        assert len(run.estimate.landmark) == len(seen)
        apart = run.estimate.joint_mean - mean
        sigma = np.sqrt(covariance.diagonal())
        assert np.max(np.abs(apart) / sigma) < 0.5
        ratio = run.estimate.joint_covariance.diagonal() / covariance.diagonal()
        assert ratio.min() > 0.5
        assert ratio.max() < 2.0


@pytest.mark.slow
def test_tracking_solves_the_raw_detections(shared_data: Path) -> None:
    """Growing prefixes ended at twice the error here."""
    log = open_log(str(shared_data / "victoria_park"))
    run = run_ekf(log, build_timeline(log), settle(EkfConfig(filter="compressed"), log))
    given = build_problem(log, run)
    graph = build_graph(given)
    seen = np.unique(given.measurement_landmark)
    errors = [
        graph.error(optimise(graph, start)[0])
        for start in (track(given, graph)[0], to_values(run.departed, run.estimate.landmark, seen))
    ]
    assert abs(errors[0] - errors[1]) < 1e-3
