"""What `slamcheck solve` reports: solution.json, what is printed, and its folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from comparisons.checks.optimum import overstated
from comparisons.figures import rounded
from comparisons.pipeline.clock import Clock
from comparisons.pipeline.solve import Solution
from comparisons.report.figures.run import map_figure
from comparisons.report.html.map import MapContent, Track, estimate_map
from comparisons.report.job_report import JobReport, optimum_entries
from comparisons.report.marks import SMOOTHER_COLOUR, TRUTH_COLOUR
from comparisons.report.models import SolutionResult
from graphslam.g2o import G2oContents, holds, write_g2o
from graphslam.optimum import ChiSquareTest

FRAME = "only the absolute positions fix the frame of the graph, so they are used"
LARGEST_DRAWN = 150
"""Variables of the largest graph that is drawn as dot."""


class SolutionReport(JobReport[Solution, SolutionResult]):
    """Report of `slamcheck solve`."""

    file = "solution"

    @staticmethod
    def build(solution: Solution, read: Clock | None = None) -> SolutionResult:
        """Return the findings, read being the time that reading the log took."""
        s = solution
        remarks = [*([FRAME] if s.log.prior.open else []), *s.notes, *s.open_loops]
        if not s.is_misread:
            remarks += [remark for remark in s.known.remarks if remark not in s.lacks]
        return SolutionResult(
            verdict="verified" if s.verified else "unverified",
            reasons=s.lacks,
            **optimum_entries(s.known, SolutionResult, remarks, read),
        )

    @property
    def headline(self) -> str:
        """The outcome, and whether sigmas are stated too large."""
        smoother = self.result.smoother
        test = ChiSquareTest(smoother.chi2, smoother.dof, *smoother.chi2_band)
        is_large = overstated(test) and not self.found.is_misread
        return super().headline + (", sigmas too large" if is_large else "")

    @property
    def lines(self) -> Sequence[tuple[str, str]]:
        """The map, and the optimum's chi-square."""
        result, smoother = self.result, self.result.smoother
        tested = f"chi-square {rounded(smoother.chi2)}"
        if smoother.dof:
            low, high = smoother.chi2_band
            tested += f" (expected {smoother.dof}, band {rounded(low)} to {rounded(high)})"
        return [
            (
                "map",
                f"{result.landmarks:,} landmarks from {result.measurements_used:,} of "
                f"{result.log.records['measurements']:,} measurements "
                f"(association: {result.association_by})",
            ),
            ("optimum", f"{tested}, {smoother.poses:,} poses"),
        ]

    def drawn(self) -> MapContent:
        """Return what the page's map shows: the smoother, and where odometry alone leads."""
        s = self.found
        reckoned = Track(
            name="dead reckoning",
            colour=TRUTH_COLOUR,
            dashes="2 2",
            time_s=s.estimate.time_s,
            pose=s.dead_reckoned,
            against_time=False,
        )
        return estimate_map(s.log, "smoother", SMOOTHER_COLOUR, s.estimate, reckoned)

    def figures(self) -> Mapping[str, Figure]:
        """Return the map."""
        return {"map": map_figure(self.found)}

    def files(self) -> Mapping[str, Callable[[Path], object]]:
        """Return the graph for other programs, and a small one as dot."""
        estimate, smoothed = self.found.estimate, self.found.result
        contents = G2oContents(
            smoothed.problem, estimate.pose, estimate.landmark, landmark_ids=estimate.landmark_id
        )
        files: dict[str, Callable[[Path], object]] = {}
        if holds(smoothed.problem):
            files["graph.g2o"] = lambda path: write_g2o(path, contents)
        if smoothed.values.size() <= LARGEST_DRAWN:
            files["graph.dot"] = lambda path: smoothed.graph.saveGraph(str(path), smoothed.values)
        return files
