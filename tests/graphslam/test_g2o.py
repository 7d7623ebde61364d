"""g2o files: bit-exact round trips, files of others, and what is wrong with bad ones."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.logs.bundled import open_log
from comparisons.pipeline.solve import solve
from graphslam.g2o import G2oContents, read_g2o, write_g2o
from graphslam.problem import SlamProblem
from tests.helpers import compared, relative_error, simulated


@pytest.fixture(scope="module")
def contents() -> G2oContents:
    """With positions and surveyed landmarks, which the log has none of."""
    result = solve(simulated(2, loop_s=30.0)).result
    rng = np.random.default_rng(0)
    a = rng.standard_normal((4, 2, 2))
    spread = a @ a.transpose(0, 2, 1) + np.eye(2)
    spread = 0.5 * (spread + spread.transpose(0, 2, 1))
    problem = replace(
        result.problem,
        prior_pose=np.array([1.0, 2.0, 0.7]),
        prior_covariance=np.array([[0.2, 0.05, 0.0], [0.05, 0.1, 0.01], [0.0, 0.01, 0.02]]),
        position_pose=np.array([0, 5, 9, 20]),
        position=rng.standard_normal((4, 2)),
        position_covariance=spread,
        surveyed=result.landmarks[:3],
        surveyed_covariance=spread[:3],
    )
    return G2oContents(problem, result.poses, result.landmarks)


def test_round_trip_is_exact(contents: G2oContents, tmp_path: Path) -> None:
    path = tmp_path / "graph.g2o"
    write_g2o(path, contents)
    again = read_g2o(path)
    assert np.array_equal(again.poses, contents.poses)
    assert np.array_equal(again.landmarks, contents.landmarks)
    for field in fields(SlamProblem):
        if field.name in ("oriented", "closures"):  # none in g2o, and in test_closures
            continue
        before, after = (getattr(c.problem, field.name) for c in (contents, again))
        assert np.array_equal(before, after), field.name


def test_what_others_write_is_read(contents: G2oContents, tmp_path: Path) -> None:
    """Without the figures behind the #, to rounding."""
    path = tmp_path / "graph.g2o"
    write_g2o(path, contents)
    bare = "\n".join(line.partition("#")[0] for line in path.read_text().splitlines())
    path.write_text(bare)
    again = read_g2o(path).problem
    for name in ("prior_covariance", "increment_covariance", "z", "sigma", "position_covariance"):
        before, after = getattr(contents.problem, name), getattr(again, name)
        assert relative_error(after, before) < 1e-9, name


def test_gtsam_reads_our_poses(contents: G2oContents, tmp_path: Path) -> None:
    path = tmp_path / "graph.g2o"
    write_g2o(path, contents)
    lines = [line for line in path.read_text().splitlines() if "_XY" not in line]
    path.write_text("\n".join(line for line in lines if "PRIOR" not in line) + "\n")
    graph, values = gtsam.readG2o(str(path), False)
    assert graph.size() == len(contents.problem.increment)
    assert np.allclose(
        [values.atPose2(7).x(), values.atPose2(7).y()], contents.poses[7, :2], atol=1e-12
    )
    between = graph.at(7)
    assert isinstance(between, gtsam.BetweenFactorPose2)
    noise = between.noiseModel()
    assert isinstance(noise, gtsam.noiseModel.Gaussian)
    covariance = noise.covariance()
    assert relative_error(covariance, contents.problem.increment_covariance[7]) < 1e-6


def test_as_a_log_it_gives_the_same_optimum(tmp_path: Path) -> None:
    solution = solve(simulated(3, loop_s=30.0))
    result = solution.result
    path = tmp_path / "loop.g2o"
    write_g2o(path, G2oContents(result.problem, result.poses, result.landmarks))
    log = open_log(str(path))
    assert log.format == "g2o"
    assert log.records["odometry"] == len(result.problem.increment)
    assert log.records["sightings"] == len(solution.slot)
    comparison = compared(log)
    assert abs(comparison.smoother.error - result.error) < 1e-6 * result.error
    assert comparison.verdict.outcome == "agree"


def test_an_antenna_off_the_pose_is_refused(contents: G2oContents, tmp_path: Path) -> None:
    problem = replace(contents.problem, lever_m=(1.0, 0.0))
    with pytest.raises(ValueError, match="antenna"):
        write_g2o(tmp_path / "graph.g2o", contents._replace(problem=problem))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (("VERTEX_SE2 3 ", "VERTEX_SE3:QUAT 3 "), "unknown tag 'VERTEX_SE3:QUAT'"),
        (("EDGE_SE2 3 4 ", "EDGE_SE2 4 4 "), "from pose 4 to itself"),
        (("EDGE_SE2 3 4 ", "EDGE_SE2 3 4000 "), "names 4000, which is no pose"),
        (("EDGE_SE2 3 4 ", "EDGE_SE2 3 4 1.0 "), "has 12 numbers, expected 11"),
        (("VERTEX_SE2 3 ", "VERTEX_SE2 x "), "holds what is no number"),
        (("EDGE_PRIOR_SE2 0 1.0", "EDGE_PRIOR_SE2 0 nan"), "not finite"),
        (("EDGE_PRIOR_SE2 0 ", "EDGE_PRIOR_SE2 1 "), "expected one only, of the first pose"),
    ],
)
def test_faults_are_named_with_their_line(
    contents: G2oContents, tmp_path: Path, change: tuple[str, str], complaint: str
) -> None:
    path = tmp_path / "graph.g2o"
    write_g2o(path, contents)
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change, 1))
    with pytest.raises(ValueError, match=complaint) as caught:
        read_g2o(path)
    line = 1 + text[: text.index(change[0])].count("\n")
    assert f"{path}:{line}:" in str(caught.value)
    with pytest.raises(InputError, match=complaint):
        open_log(str(path), "g2o")
