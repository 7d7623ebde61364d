"""g2o graphs with everything that the format holds, and what may be wrong with them."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from graphslam.arrays import Array, Index
from graphslam.g2o import G2oContents, read_g2o, write_g2o
from graphslam.increments import dead_reckoned
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.scan import planar
from graphslam.smoother import smooth
from tests.graphslam import worlds

CLOSED_ELSEWHERE = (
    "EDGE_SE2 30 10 -1.5 0.5 -3.0 4 0 0 5 0 100\n"
    "VERTEX_SE2 10 0 0 0\nVERTEX_SE2 30 2 0 3.0\nVERTEX_SE2 20 1 0 1.5\n"
    "EDGE_SE2 20 30 1 0 1.5 1 0 0 1 0 1\n"
    "EDGE_SE2 10 20 1 0 1.5 2 0.5 0 2 0 2\n"
    "EDGE_SE2 10 20 1.1 0 1.4 3 0 0 3 0 3\n"
)
"""Of another program: gaps in the numbers, edges in any order, the later pose first, no #."""

FAULTS = [
    (("VERTEX_SE2 3 ", "VERTEX_SE3:QUAT 3 "), "VERTEX_SE3:QUAT: 3D is not supported yet"),
    (("VERTEX_SE2 3 ", "EDGE_SE2_OFFSET 3 "), "unknown tag 'EDGE_SE2_OFFSET'"),
    (("VERTEX_SE2 3 ", "VERTEX_SE2 3.5 "), "names 3.5, expected a whole number"),
    (("VERTEX_SE2 3 ", "VERTEX_SE2 2 "), "VERTEX_SE2 2 is defined twice"),
    (("VERTEX_SE2 3 ", "FIX 3\nVERTEX_SE2 3 "), "FIX, expected one only, of the first pose"),
    (
        ("EDGE_SE2 3 4 ", "EDGE_SE2 3 4 1 0 0 4 0 2 4 0 1\nEDGE_SE2 3 4 "),
        "EDGE_SE2: the information is singular or not positive definite",
    ),
    (
        ("EDGE_SE2 3 4 ", "EDGE_SE2 3 4 1 0 0 4 0 0 4 0 -1\nEDGE_SE2 3 4 "),
        "EDGE_SE2: the information is singular or not positive definite",
    ),
    (("EDGE_SE2 3 4 ", "EDGE_SE2 4 4 "), "from pose 4 to itself"),
    (("EDGE_SE2 3 4 ", "EDGE_SE2 3 4000 "), "names 4000, which is not a pose"),
    (("EDGE_SE2 3 4 ", "EDGE_SE2 3 4 1.0 "), "has 12 numbers, expected 11"),
    (("VERTEX_SE2 3 ", "VERTEX_SE2 x "), "contains a word that is not a number"),
    (("EDGE_PRIOR_SE2 0 1.0", "EDGE_PRIOR_SE2 0 nan"), "not finite"),
    (("EDGE_PRIOR_SE2 0 ", "EDGE_PRIOR_SE2 1 "), "expected one only, of the first pose"),
]
"""Changes, from and to, to a file of `everything`, and the complaint."""


def everything() -> G2oContents:
    """A solved drive with positions and surveyed landmarks, moved away from the origin."""
    problem = worlds.loop(2, poses=150).problem
    result = smooth(problem, {})
    rng = np.random.default_rng(0)
    a = rng.standard_normal((4, 2, 2))
    spread = a @ a.transpose(0, 2, 1) + np.eye(2)
    spread = 0.5 * (spread + spread.transpose(0, 2, 1))
    problem = replace(
        problem,
        prior_pose=np.array([1.0, 2.0, 0.7]),
        prior_covariance=np.array([[0.2, 0.05, 0.0], [0.05, 0.1, 0.01], [0.0, 0.01, 0.02]]),
        position_pose=np.array([0, 5, 9, 20]),
        position=rng.standard_normal((4, 2)),
        position_covariance=spread,
        surveyed=result.landmarks[:3],
        surveyed_covariance=spread[:3],
    )
    return G2oContents(problem, result.poses, result.landmarks)


def assert_survives(contents: G2oContents, path: Path) -> None:
    """Bit for bit; of pose landmarks there are none in g2o."""
    write_g2o(path, contents)
    again = read_g2o(path)
    assert np.array_equal(again.poses, contents.poses)
    assert np.array_equal(again.landmarks, contents.landmarks)
    for kept in (contents.problem, contents.problem.loop_closures):
        now = again.problem if kept is contents.problem else again.problem.loop_closures
        for field in fields(kept):
            if field.name not in ("pose_landmarks", "loop_closures"):
                one, other = getattr(kept, field.name), getattr(now, field.name)
                assert np.array_equal(one, other), field.name


def loosened(problem: SlamProblem, factor: float) -> SlamProblem:
    """The same with so many times the covariance of every motion."""
    closed = problem.loop_closures
    return replace(
        problem,
        increment_covariance=factor * problem.increment_covariance,
        loop_closures=replace(closed, covariance=factor * closed.covariance),
    )


def rounds(turns: int = 4) -> SlamProblem:
    """Round a circle of twelve poses a few times, with closures over fifteen steps."""
    rng = np.random.default_rng(3)
    sigma, steps = np.array((0.05, 0.03, 0.01)), 12 * turns
    truth = dead_reckoned(np.zeros(3), np.tile((1.0, 0.1, 2.0 * np.pi / 12), (steps, 1)))
    first = np.arange(steps - 14)

    def measured(i: Index, j: Index) -> Array:
        noise = sigma * rng.standard_normal((len(i), 3))
        moved = [
            planar.wrapped(planar.between(*pair)) for pair in zip(truth[i], truth[j], strict=True)
        ]
        return np.array(moved) + noise

    def spread(count: int) -> Array:
        return np.tile(np.diag(sigma**2), (count, 1, 1))

    return SlamProblem(
        prior_pose=np.zeros(3),
        prior_covariance=1e-12 * np.eye(3),
        increment=measured(np.arange(steps), np.arange(1, steps + 1)),
        increment_covariance=spread(steps),
        measurement_pose=np.zeros(0, dtype=np.intp),
        measurement_landmark=np.zeros(0, dtype=np.intp),
        z=np.zeros((0, 2)),
        sigma=np.zeros((0, 2)),
        landmark_count=0,
        loop_closures=LoopClosures(
            first, first + 15, measured(first, first + 15), spread(len(first))
        ),
    )
