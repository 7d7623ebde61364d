"""What a smoother alone has solved for: a map of landmarks, a graph with loop closures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from comparisons.checks.check import About
from comparisons.checks.finding import Basis
from comparisons.figures import Model, Named, rows_of
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


class MapFinding(Basis[dict[str, Any]]):
    """The landmarks that were solved for."""

    def __init__(self, known: Known) -> None:
        """known: of the job."""
        used = int(np.count_nonzero(known.landmark_index >= 0))
        counts = {
            "association_by": "known" if known.prepared.labelled else "own",
            "landmarks": len(known.smoothed.landmark),
            "measurements_used": used,
            "gps": known.prepared.ekf.gps,
        }
        super().__init__(counts, entries=counts)
        self.used = f"{used:,} of {known.log.records['measurements']:,}"

    def rows(self) -> Sequence[Row]:
        """Return rows of the table."""
        return [
            Row("Map", "landmarks", f"{self.value['landmarks']:,}"),
            Row("Map", "measurements used for the map", self.used),
            Row("Map", "association", self.value["association_by"]),
        ]


class AboutMap(About):
    """Which landmarks were solved for, from which measurements?"""

    name = "map"
    needs = "the smoother"

    def find(self, known: Known) -> MapFinding:
        """Return how many, and who associated."""
        return MapFinding(known)


class PoseGraphResult(Model):
    """A log with loop closures.

    Attributes:
        loop_closures: number of closures.
        unmeasured: pairs of successive poses that no odometry connects.
        initial_chi2: chi-square where odometry alone leads, and guesses where there is none.
    """

    loop_closures: Annotated[int, Named("loop closures")]
    unmeasured: Annotated[int, Named("steps without odometry")]
    initial_chi2: Annotated[float, Named("chi-square of dead reckoning", "{:.6g}")]


class PoseGraphFinding(Basis[PoseGraphResult]):
    """The graph, and what its optimum makes of its chi-square."""

    def __init__(self, graph: PoseGraphResult, chi2: float) -> None:
        """chi2: at the optimum."""
        super().__init__(graph, entries={"pose_graph": graph})
        self._optimum = Row("Pose graph", "chi-square at the optimum", f"{chi2:.6g}")

    def rows(self) -> Sequence[Row]:
        """Return rows of the table."""
        return [*rows_of("Pose graph", self.value), self._optimum]


class AboutPoseGraph(About):
    """Which loops does the log close?"""

    name = "pose_graph"
    needs = "a log with loop closures"
    figures = (("pose_graph", PoseGraphResult),)

    def find(self, known: Known) -> PoseGraphFinding | None:
        """Return the graph; None of a log without closures."""
        if known.log.loop_closures is None:
            return None
        result = known.result
        graph = PoseGraphResult(
            loop_closures=len(result.problem.loop_closures.first),
            unmeasured=result.problem.pose_count - 1 - len(result.problem.steps),
            initial_chi2=2.0 * result.initial_error(),
        )
        return PoseGraphFinding(graph, result.optimality.chi_square.chi2)
