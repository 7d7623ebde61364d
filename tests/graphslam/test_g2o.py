"""g2o files: bit-exact round trips, files of others, and what is wrong with bad ones."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from graphslam.g2o import G2oContents, inverses, read_g2o, write_g2o
from graphslam.marginals import SingularProblemError
from graphslam.smoother import SmootherOptions, smooth
from tests.graphslam.g2o_files import FAULTS, assert_survives, everything
from tests.graphslam.numerics import relative_error


@pytest.fixture(scope="module")
def contents() -> G2oContents:
    return everything()


def test_round_trip_is_exact(contents: G2oContents, tmp_path: Path) -> None:
    assert_survives(contents, tmp_path / "graph.g2o")


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
    found = inverses((correlation * np.outer(sigma, sigma))[None])[0][0] * np.outer(sigma, sigma)
    assert relative_error(found, np.linalg.inv(correlation)) < 1e-14


PUBLIC = [
    ("noisyToyGraph.txt", "G2O"),
    ("optimizedNoisyToyGraph.txt", "G2O"),
    ("orientationsNoisyToyGraph.txt", "G2O"),
    ("pose2example.txt", "G2O"),
    ("w100_30.g2o", "G2O"),
    ("w100.graph", "TORO"),
    ("example.graph", "TORO"),
]
"""Files that come with gtsam, and the order of their informations."""


def optimum_of_gtsam(path: str, order: str) -> float:
    """Error of gtsam's own graph, its first pose held, from the file's vertices."""
    kind = getattr(gtsam.NoiseFormat, f"NoiseFormat{order}")
    graph, values = gtsam.load2D(path, noiseFormat=kind, smart=False)
    first = min(values.keys())
    held = gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
    graph.push_back(gtsam.PriorFactorPose2(first, values.atPose2(first), held))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setRelativeErrorTol(1e-15)
    settings.setAbsoluteErrorTol(1e-15)
    end = gtsam.LevenbergMarquardtOptimizer(graph, values, settings).optimize()
    return float(graph.error(end))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "order"), PUBLIC)
def test_public_files_have_the_optimum_of_gtsam(name: str, order: str) -> None:
    path = str(Path(gtsam.__file__).parent / "Data" / name)
    theirs = optimum_of_gtsam(path, order)
    result = smooth(read_g2o(Path(path)).problem, {})
    assert abs(result.error - theirs) < 1e-9 * theirs


SQUARE = """VERTEX2 7 1 2 0.1
VERTEX2 3 0 0 0
VERTEX2 9 2 2 1.4
VERTEX2 4 1 0 0.2
EDGE2 4 3 -1.1 0.2 -0.3 {}
EDGE2 7 4 0.3 -2.1 0.2 {}
EDGE2 7 9 1.1 0.1 1.2 {}
EDGE2 3 9 2.2 2.1 1.3 {}
"""
"""Ids with gaps and in any order, and no edge forward from 3 to 4 and from 4 to 7."""
TORO, ROWS = "20 1 5 9 1 3", "20 1 1 5 3 9"
"""One information: xx, xy, yy, hh, xh, yh, and its upper triangle by rows."""


def square(path: Path, information: str, rename: Callable[[str], str] = str) -> G2oContents:
    path.write_text(rename(SQUARE.format(*[information] * 4)))
    return read_g2o(path)


def as_g2o(text: str) -> str:
    return text.replace("VERTEX2", "VERTEX_SE2").replace("EDGE2", "EDGE_SE2")


def test_toro_has_its_own_order(tmp_path: Path) -> None:
    toro = square(tmp_path / "a.graph", TORO)
    rows = square(tmp_path / "b.g2o", ROWS, as_g2o)
    assert np.array_equal(
        toro.problem.loop_closures.covariance, rows.problem.loop_closures.covariance
    )
    assert "TORO" in toro.notes["edges"]
    assert "edges" not in rows.notes
    theirs = optimum_of_gtsam(str(tmp_path / "a.graph"), "TORO")
    assert abs(smooth(toro.problem, {}).error - theirs) < 1e-9 * theirs
    mistaken = square(tmp_path / "c.g2o", TORO, as_g2o)  # a reader that knows one order only
    assert abs(smooth(mistaken.problem, {}).error - theirs) > 1e-2 * theirs


def test_isam_has_square_roots(tmp_path: Path) -> None:
    """Its upper triangles would be singular in TORO's order."""
    contents = square(tmp_path / "a.txt", "2 0.5 0 3 0 5")
    root = np.array(((2.0, 0.5, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 5.0)))
    information = np.linalg.inv(contents.problem.loop_closures.covariance[0])
    assert relative_error(information, root.T @ root) < 1e-12
    assert "iSAM" in contents.notes["edges"]


def test_poses_in_a_row_need_no_edge(tmp_path: Path) -> None:
    """Edges backwards stay as they are; increments that nothing measured are guesses."""
    problem = square(tmp_path / "a.graph", TORO).problem
    assert problem.steps.tolist() == [2]
    assert np.array_equal(problem.increment[2], (1.1, 0.1, 1.2))
    assert np.isnan(problem.increment_covariance[:2]).all()
    assert problem.loop_closures.first.tolist() == [1, 2, 0]
    assert problem.loop_closures.second.tolist() == [0, 1, 3]
    assert problem.residual_dimension == 3 * 5
    result = smooth(problem, {})
    assert result.optimality.chi_square.dof == 3
    write_g2o(tmp_path / "b.g2o", G2oContents(problem, result.poses, np.zeros((0, 2))))
    again = read_g2o(tmp_path / "b.g2o").problem
    for name in ("motion", "covariance", "first", "second"):
        assert np.array_equal(
            getattr(again.loop_closures, name), getattr(problem.loop_closures, name)
        )
    assert smooth(again, {}).error == result.error
    late = replace(problem.loop_closures, first=np.array([3, 2, 0]), second=np.array([1, 0, 3]))
    isam2 = SmootherOptions(method="isam2")
    with pytest.raises(ValueError, match="expected batch: nothing connects pose 1 "):
        smooth(replace(problem, loop_closures=late), {}, options=isam2)


def test_gnc_does_not_pass_over_closures(tmp_path: Path) -> None:
    problem = square(tmp_path / "a.graph", TORO).problem
    with pytest.raises(ValueError, match="gnc, which does not support loop closures"):
        smooth(problem, {}, options=SmootherOptions(robust="gnc"))


def test_iSAM2_takes_what_is_connected_along_the_way(tmp_path: Path) -> None:  # noqa: N802
    problem = square(tmp_path / "a.graph", TORO).problem
    batch, followed = (
        smooth(problem, {}, options=SmootherOptions(method=m)) for m in ("batch", "isam2")
    )
    assert np.allclose(followed.poses, batch.poses, atol=1e-5)


def test_vertices_may_be_missing(tmp_path: Path) -> None:
    """Without any, the poses are those that edges name, led on along a tree of edges."""
    with_them = square(tmp_path / "a.graph", TORO)
    bare = square(
        tmp_path / "b.graph",
        TORO,
        lambda text: "\n".join(line for line in text.splitlines() if "VERTEX" not in line),
    )
    assert bare.problem.pose_count == 4
    assert np.array_equal(bare.poses[0], np.zeros(3))
    assert np.allclose(bare.poses[3], (2.2, 2.1, 1.3))
    errors = [smooth(c.problem, {}).error for c in (with_them, bare)]
    assert abs(errors[0] - errors[1]) < 1e-9 * errors[0]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (("EDGE2 7 4 0.3", "EDGE2 7 9 0.3"), "no edges between poses connect pose 7 with pose 3"),
        (("EDGE2 7 4 ", "EDGE2 7 7 "), r":6: EDGE2 from pose 7 to itself"),
        (("EDGE2 7 4 ", "EDGE2 7 5 "), r":6: EDGE2 names 5, which is not a pose"),
        (("EDGE2 7 4 0.3", "FIX 4\nEDGE2 7 4 0.3"), r":6: FIX, expected one only"),
    ],
)
def test_faults_of_pose_graphs(tmp_path: Path, change: tuple[str, str], complaint: str) -> None:
    text = SQUARE if "connect" not in complaint else SQUARE.replace("EDGE2 3 9", "EDGE2 3 4")
    path = tmp_path / "a.graph"
    path.write_text(text.format(*[TORO] * 4).replace(*change))
    with pytest.raises(ValueError, match=complaint):
        read_g2o(path)


def test_what_says_nothing_of_the_graph_is_passed_over(tmp_path: Path) -> None:
    more = "PARAMS_SE2OFFSET 0 0 0 0\nFIX 3\nEQUIV 3 9\n"
    contents = square(tmp_path / "a.graph", TORO, lambda text: more + text)
    plain = square(tmp_path / "b.graph", TORO)
    assert np.array_equal(contents.problem.prior_covariance, plain.problem.prior_covariance)
    assert contents.notes["passed over"] == "EQUIV on 1 lines"


ISAM = """ODOMETRY 0 1 1 0 1.6 50 1 0 40 0 100
LANDMARK 1 0 2 0.5 10 1 8
ODOMETRY 1 2 1 0.1 1.5 50 1 0 40 0 100
ODOMETRY 0 2 1 1 3 20 0 0 20 0 30
LANDMARK 2 7 2 -0.5 10 0 10
LANDMARK 0 7 2 1 10 0 10
"""
"""Landmark 0 and pose 0 are two; all matrices are square roots of informations, by rows."""


def test_isam_numbers_landmarks_apart(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(ISAM)
    contents = read_g2o(tmp_path / "a.txt")
    problem = contents.problem
    assert contents.landmark_ids.tolist() == [0, 7]
    assert problem.pose_count == 3
    assert problem.loop_closures.first.tolist() == [0]
    root = np.array(((50.0, 1.0, 0.0), (0.0, 40.0, 0.0), (0.0, 0.0, 100.0)))
    information = np.linalg.inv(problem.increment_covariance[0])
    assert relative_error(information, root.T @ root) < 1e-12
    assert np.allclose(problem.sigma[1], (0.1, 0.1 / problem.z[1, 0]), rtol=1e-12)
    assert "ODOMETRY as iSAM writes it" in contents.notes["edges"]
    write_g2o(tmp_path / "b.g2o", contents._replace(landmarks=np.eye(2)))
    again = read_g2o(tmp_path / "b.g2o")
    assert again.landmark_ids.tolist() == [0, 7]
    assert np.array_equal(again.problem.increment_covariance, problem.increment_covariance)


UPPER = ("xx", "xy", "xh", "yy", "yh", "hh")
ORDERS = {
    "diagonal first": "xx yy hh xy xh yh",
    "lower triangle": "xx xy yy xh yh hh",
    "TORO": "xx xy yy hh xh yh",
}


def information(order: str, seed: int) -> str:
    """The entries of a definite matrix that fits no other order."""
    root = np.random.default_rng(seed).normal(size=(3, 3)) * (10.0, 10.0, 3.0)
    matrix = root @ root.T + np.diag((100.0, 100.0, 900.0))
    named = dict(zip(UPPER, matrix[np.triu_indices(3)].tolist(), strict=True))
    return " ".join(f"{named[name]:.6g}" for name in order.split())


@pytest.mark.parametrize("order", ORDERS)
def test_information_in_another_order_is_named_and_not_used(tmp_path: Path, order: str) -> None:
    """One whose matrix is definite in no order names none; lines that are right need no other."""
    edges = "".join(
        f"EDGE_SE2 {k} {k + 1} 1 0 0.1 {information(ORDERS[order], k)}\n" for k in range(9)
    )
    path = tmp_path / "graph.g2o"
    path.write_text(edges)
    with pytest.raises(ValueError, match=r"graph\.g2o:1: EDGE_SE2: the information is") as caught:
        read_g2o(path)
    said = str(caught.value)
    assert f"{ORDERS[order]} ({order})" in said
    assert "all 9 of these lines are positive definite" in said
    assert said.endswith("write the upper triangle by rows (xx xy xh yy yh hh)")
    path.write_text(edges.replace("EDGE_SE2 0 1 1 0 0.1", "EDGE_SE2 0 1 1 0 0.1 -1 0 0 1 0 1 #"))
    with pytest.raises(ValueError, match=r"not positive definite$"):
        read_g2o(path)
    path.write_text(edges.replace(information(ORDERS[order], 0), information(" ".join(UPPER), 0)))
    with pytest.raises(ValueError, match=r"graph\.g2o:[23]: ") as caught:
        read_g2o(path)
    assert f"{ORDERS[order]} ({order})" in str(caught.value)
    assert re.search(r"all \d of these lines that are not are positive definite", str(caught.value))


def test_the_diagonal_of_a_point_comes_first(tmp_path: Path) -> None:
    path = tmp_path / "graph.g2o"
    points = "".join(f"EDGE_SE2_XY 0 {k} 3 1 40 90 5\n" for k in range(1, 4))
    path.write_text(f"VERTEX_SE2 0 0 0 0\n{points}")
    with pytest.raises(ValueError, match=r"read as xx yy xy \(diagonal first\), all 3 of these"):
        read_g2o(path)
