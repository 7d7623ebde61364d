"""The folder that the smoother alone leaves: solution.json, map, estimate, graph."""

from __future__ import annotations

from pathlib import Path

from comparisons.atomic import fresh_folder
from comparisons.estimates.folder import FILES as ESTIMATE_FILES
from comparisons.estimates.folder import write_estimate
from comparisons.pipeline.solve import Solution
from comparisons.report.models import SolutionResult
from comparisons.report.picture import save
from comparisons.report.plots import solution_figure
from graphslam.g2o import G2oContents, holds, write_g2o

SOLUTION_CONTENTS = frozenset(
    {"solution.json", "map.png", "graph.g2o", "graph.dot"}
    | {f"smoother/{name}" for name in ESTIMATE_FILES}
)
"""What a solution folder holds; a folder with nothing else may be replaced by the next."""
LARGEST_DRAWN = 150
"""Variables of the largest graph that is drawn as dot."""


def write_solution_folder(solution: Solution, result: SolutionResult, folder: Path) -> None:
    """Write everything; the folder appears whole or not at all. Raises InputError."""
    estimate = solution.estimate
    contents = G2oContents(solution.result.problem, estimate.pose, estimate.landmark)
    with fresh_folder(folder, SOLUTION_CONTENTS) as work:
        (work / "smoother").mkdir()
        write_estimate(estimate, work / "smoother")
        save(solution_figure(solution), work / "map.png")
        if holds(solution.result.problem):
            write_g2o(work / "graph.g2o", contents)
        if solution.result.values.size() <= LARGEST_DRAWN:
            solution.result.graph.saveGraph(str(work / "graph.dot"), solution.result.values)
        (work / "solution.json").write_text(
            result.model_dump_json(indent=2) + "\n", encoding="utf-8"
        )
