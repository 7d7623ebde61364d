"""g2o files as logs."""

from __future__ import annotations

from pathlib import Path

import pytest

from comparisons.errors import InputError
from comparisons.logs.bundled import open_log
from comparisons.pipeline.solve import solve
from graphslam.g2o import G2oContents, write_g2o
from tests.graphslam.g2o_files import CLOSED_ELSEWHERE, FAULTS, everything
from tests.helpers import compared, simulated


@pytest.fixture(scope="module")
def contents() -> G2oContents:
    return everything()


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


@pytest.mark.parametrize(("change", "complaint"), FAULTS)
def test_faults_are_input_errors(
    contents: G2oContents, tmp_path: Path, change: tuple[str, str], complaint: str
) -> None:
    path = tmp_path / "graph.g2o"
    write_g2o(path, contents)
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change, 1))
    with pytest.raises(InputError, match=complaint):
        open_log(str(path), "g2o")


def test_a_log_has_no_closures(tmp_path: Path) -> None:
    """With a measurement of a landmark, which a log needs; without the closures it is read."""
    lines = [*CLOSED_ELSEWHERE.splitlines(), "VERTEX_XY 40 1 1", "EDGE_SE2_XY 10 40 1 1 9 0 9"]
    closed, sound = tmp_path / "closed.g2o", tmp_path / "sound.g2o"
    closed.write_text("\n".join(lines))
    closures = ("EDGE_SE2 30 10", "EDGE_SE2 10 20 1.1")
    sound.write_text("\n".join(line for line in lines if not line.startswith(closures)))
    assert open_log(str(sound), "g2o").records["odometry"] == 2
    with pytest.raises(InputError, match="do not follow each other") as caught:
        open_log(str(closed), "g2o")
    assert "\n" not in str(caught.value)
