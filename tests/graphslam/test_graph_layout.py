"""Where poses and landmarks lie: graphs put them in the same order."""

from __future__ import annotations

import numpy as np

from graphslam.graph_builder import build_graph, to_values
from graphslam.layout import Layout
from tests.graphslam import worlds


def test_entries_are_those_of_the_kinds() -> None:
    layout = Layout(2, 3, 2)
    assert layout.size == 18
    assert layout.point.tolist() == [6, 8, 10]
    assert layout.frame.tolist() == [0, 3, 12, 15]
    assert Layout(1, pose_landmarks=1).frame.tolist() == [0, 3]


def test_a_problem_has_as_many_unknowns_as_its_graph() -> None:
    world = worlds.loop(1)
    seen = np.unique(world.problem.measurement_landmark)
    values = to_values(world.poses, world.landmarks, seen)
    assert values.dim() == world.problem.state_dimension
    assert build_graph(world.problem).linearize(values).jacobian()[0].shape[1] == values.dim()
