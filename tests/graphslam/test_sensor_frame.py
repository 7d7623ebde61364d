"""The frame on the vehicle whose motions edges are."""

from pathlib import Path

import numpy as np
import pytest

from graphslam.arrays import Array, Index
from graphslam.g2o import read_g2o
from graphslam.scan import planar
from graphslam.sensor_frame import other_frame

COUNT = 30
SIGMA = np.array((0.02, 0.02, 0.01))
FRAME = np.array((0.4, -0.2, np.pi - 0.1))


def driven() -> Array:
    """Poses (30, 3) along a bent way."""
    draw = np.random.default_rng(3)
    heading = np.cumsum(draw.normal(0.0, 0.4, COUNT))
    steps = np.column_stack((np.cos(heading), np.sin(heading)))
    return np.column_stack((np.cumsum(steps, axis=0), heading))


def edges(frame: Array) -> tuple[Index, Index, Array, Array]:
    """First, second, motion and covariance of edges between all poses and the next two."""
    poses, draw = driven(), np.random.default_rng(4)
    pairs = [(i, i + k) for i in range(COUNT) for k in (1, 2) if i + k < COUNT]
    first, second = np.array(pairs).T
    seen = [planar.compose(pose, frame) for pose in poses]
    motion = np.array([planar.between(seen[i], seen[j]) for i, j in pairs])
    motion += SIGMA * draw.standard_normal(motion.shape)
    return first, second, motion, np.tile(np.diag(SIGMA**2), (len(pairs), 1, 1))


def test_the_frame_of_edges_is_found_beside_poses_of_another() -> None:
    found = other_frame(*edges(FRAME), driven())
    assert found is not None
    assert found == pytest.approx(FRAME, abs=0.02)


@pytest.mark.parametrize("kind", ["own", "none", "few"])
def test_no_frame_is_invented(kind: str) -> None:
    """Edges of the poses' own frame, edges that nothing explains, and too few of them."""
    first, second, motion, covariance = edges(np.zeros(3) if kind == "own" else FRAME)
    if kind == "none":
        motion = np.random.default_rng(5).permutation(motion)
    rows = slice(0, 6 if kind == "few" else None)
    assert other_frame(first[rows], second[rows], motion[rows], covariance[rows], driven()) is None


@pytest.mark.parametrize("other", [False, True])
def test_a_file_whose_vertices_are_of_another_frame_says_so(tmp_path: Path, other: bool) -> None:
    first, second, motion, _ = edges(FRAME if other else np.zeros(3))
    lines = [f"VERTEX_SE2 {k} {x:.9g} {y:.9g} {h:.9g}" for k, (x, y, h) in enumerate(driven())]
    information = " ".join(f"{one:.9g}" for one in np.diag(SIGMA**-2.0)[np.triu_indices(3)])
    for i, j, (x, y, h) in zip(first, second, motion, strict=True):
        lines.append(f"EDGE_SE2 {i} {j} {x:.9g} {y:.9g} {h:.9g} {information}")
    path = tmp_path / "graph.g2o"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    said = read_g2o(path).notes.get("vertices")
    if other:
        assert said is not None
        assert said.startswith("the edges fit the vertices as motions of a frame 0.4")
    else:
        assert said is None
