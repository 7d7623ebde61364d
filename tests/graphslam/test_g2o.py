"""g2o files: bit-exact round trips, files of others, and what is wrong with bad ones."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from graphslam.g2o import G2oContents, read_g2o, write_g2o
from graphslam.marginals import SingularProblemError, inverse
from graphslam.problem import SlamProblem
from graphslam.smoother import smooth
from tests.graphslam import worlds
from tests.graphslam.g2o_files import FAULTS, everything
from tests.graphslam.numerics import relative_error


@pytest.fixture(scope="module")
def contents() -> G2oContents:
    return everything()


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


def test_what_was_written_has_the_same_optimum(tmp_path: Path) -> None:
    problem = worlds.loop(3, poses=150).problem
    result = smooth(problem, {})
    path = tmp_path / "loop.g2o"
    write_g2o(path, G2oContents(problem, result.poses, result.landmarks))
    again = smooth(read_g2o(path).problem, {})
    assert abs(again.error - result.error) < 1e-6 * result.error
    assert relative_error(again.marginal().covariance, result.marginal().covariance) < 1e-6


def test_an_antenna_off_the_pose_is_refused(contents: G2oContents, tmp_path: Path) -> None:
    problem = replace(contents.problem, lever_m=(1.0, 0.0))
    with pytest.raises(ValueError, match="antenna"):
        write_g2o(tmp_path / "graph.g2o", contents._replace(problem=problem))


@pytest.mark.parametrize(("change", "complaint"), FAULTS)
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


@pytest.mark.parametrize("sigma", [(1e-3, 1e6), (1e6, 1e-4), (1e-7, 1e-7), (1e6, 1e6)])
def test_sigmas_far_apart_lose_no_digit(
    contents: G2oContents, tmp_path: Path, sigma: tuple[float, float]
) -> None:
    """The covariance of such a point is singular to rounding, its information is not."""
    problem = contents.problem
    path = tmp_path / "graph.g2o"
    unlike = replace(problem, sigma=np.tile(sigma, (len(problem.z), 1)))
    write_g2o(path, contents._replace(problem=unlike))
    lines = [line for line in path.read_text().splitlines() if line.startswith("EDGE_SE2_XY")]
    for line, (r, bearing) in zip(lines, problem.z, strict=True):
        xx, xy, yy = map(float, line.partition("#")[0].split()[-3:])
        ray = np.array((np.cos(bearing), np.sin(bearing)))
        size = max(1.0 / sigma[0], 1.0 / (r * sigma[1])) ** 2
        along = ray @ np.array([[xx, xy], [xy, yy]]) @ ray
        assert abs(along - sigma[0] ** -2) < 1e-12 * size


def test_an_edge_without_information_is_named(contents: G2oContents, tmp_path: Path) -> None:
    spread = contents.problem.increment_covariance.copy()
    spread[3] = 1.0
    singular = contents._replace(problem=replace(contents.problem, increment_covariance=spread))
    with pytest.raises(SingularProblemError, match=r"EDGE_SE2 3 4 .*raise the odometry's sigmas"):
        write_g2o(tmp_path / "graph.g2o", singular)


def test_units_far_apart_cost_no_digit() -> None:
    """The plain inverse, which this replaces, is wrong by far more."""
    correlation = np.array([[1.0, 0.5, -0.3], [0.5, 1.0, 0.2], [-0.3, 0.2, 1.0]])
    sigma = np.array([1e-12, 1e12, 3.0])
    found = inverse(correlation * np.outer(sigma, sigma)) * np.outer(sigma, sigma)
    assert relative_error(found, np.linalg.inv(correlation)) < 1e-14
