"""The smoother of a job, and the evidence for its optimum."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from comparisons.checks.check import About
from comparisons.checks.finding import JobPart
from comparisons.figures import (
    Exact,
    LeftOut,
    Less,
    Model,
    Named,
    Same,
    band,
    finite,
    in_sigma,
    rounded,
    rows_of,
    shown,
)
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.estimates.estimate import Estimate
    from comparisons.pipeline.known import Known
    from graphslam.smoother import SmootherEvidence


class StartResult(Model):
    """One start of the smoother.

    Attributes:
        name: how the initial values were made.
        error: error that it converged to; None where it broke down.
        iterations: iterations of the optimiser.
        converged: whether the optimiser converged.
    """

    name: str
    error: float | None
    iterations: int
    converged: bool


class MinimumResult(Model):
    """A minimum, and where it differs most from the lowest one.

    Attributes:
        error: half the sum of squared whitened residuals.
        starts: attempts that ended there.
        time_s: time of the pose that differs most.
        pose_m: how far that pose is from the lowest minimum's.
        landmark: id of the landmark that differs most; None where the log has no landmarks.
        landmark_m: how far that landmark is from the lowest minimum's.
    """

    error: float
    starts: int
    time_s: float
    pose_m: float
    landmark: int | None
    landmark_m: float


class SmootherFigures(Model):
    """The smoother, and the evidence for its optimum.

    See graphslam.optimum.

    Attributes:
        method: value of `--smoother`.
        optimiser: value of `--optimiser`.
        robust: value of `--robust`.
        rejected_measurements: outlying measurements of landmarks that were left out.
        rejected_positions: outlying absolute positions that were left out.
        distance_sigma: distance of an incremental estimate from the optimum, in sigma; None of a
            batch.
        rank: unknowns that the measurements determine.
        poses: poses of the problem.
        error: half the sum of squared whitened residuals at the optimum, of which a log has one.
        chi2: twice the error.
        dof: degrees of freedom: residuals minus unknowns.
        chi2_band: two-sided 99.8 % band of chi2.
        newton_decrement: what a full Gauss-Newton step promises to take off the error.
        iterations: iterations of the optimiser.
        converged: whether the optimiser converged.
        verified: whether all evidence for the global optimum is there.
        lacks: the first condition that does not hold, in words; empty where it is verified.
        agreeing_starts: starts that reached the lowest error.
        starts: all starts.
        minima: the distinct minima that were found, lowest first.
        hops: alternatives that were tried.
        random_starts: random starts that were tried.
        chance_missed: chance that the random starts miss a basin as wide as the lowest one's.
    """

    method: str
    optimiser: str
    robust: Annotated[str, Named("robust kernel", "{}")]
    rejected_measurements: Annotated[int, Named("measurements left out")]
    rejected_positions: Annotated[int, Named("positions left out")]
    distance_sigma: LeftOut[float | None]
    rank: LeftOut[int]
    poses: Annotated[Exact[int], Named("poses")]
    error: Annotated[Same[float], Named("error (half the chi-square)", "{:.2f}")]
    chi2: Same[float]
    dof: int
    chi2_band: tuple[float, float]
    newton_decrement: Less[float]
    iterations: LeftOut[int]
    converged: bool
    verified: bool
    lacks: str
    agreeing_starts: list[str]
    starts: list[StartResult]
    minima: list[MinimumResult]
    hops: Annotated[LeftOut[int], Named("alternatives tried")]
    random_starts: Annotated[LeftOut[int], Named("random starts")]
    chance_missed: Annotated[
        Less[float],
        Named("chance that the random starts miss a basin as wide as the lowest", "{:.1%}"),
    ]

    @classmethod
    def of(cls, result: SmootherEvidence, estimate: Estimate) -> SmootherFigures:
        """Return those of a smoother. estimate: its own, for times and names of landmarks."""
        options, optimality = result.options, result.optimality
        explored = optimality.exploration
        return cls(
            method=options.method,
            optimiser=options.optimiser,
            robust=options.robust,
            rejected_measurements=len(result.rejected.measurements),
            rejected_positions=len(result.rejected.positions),
            distance_sigma=finite(optimality.distance_sigma),
            rank=result.rank,
            poses=len(result.poses),
            error=result.error,
            chi2=optimality.chi_square.chi2,
            dof=optimality.chi_square.dof,
            chi2_band=(optimality.chi_square.lower, optimality.chi_square.upper),
            newton_decrement=optimality.stationarity.decrement,
            iterations=result.iterations,
            converged=result.converged,
            verified=optimality.verified,
            lacks=optimality.lacks,
            agreeing_starts=list(optimality.agreeing),
            starts=[
                StartResult(
                    name=s.name,
                    error=finite(s.error),
                    iterations=s.iterations,
                    converged=s.converged,
                )
                for s in result.starts
            ],
            minima=[
                MinimumResult(
                    error=m.error,
                    starts=m.starts,
                    time_s=float(estimate.time_s[m.pose]),
                    pose_m=m.pose_m,
                    landmark=None if m.landmark < 0 else int(estimate.landmark_id[m.landmark]),
                    landmark_m=m.landmark_m,
                )
                for m in explored.minima
            ],
            hops=explored.hops,
            random_starts=explored.draws,
            chance_missed=explored.missed,
        )

    def rows(self) -> list[Row]:
        """Return rows of the table: the smoother, and the evidence for its optimum."""
        optimum = "verified" if self.verified else f"NOT verified: {self.lacks}"
        rows = [
            Row("Smoother", "optimum", optimum, "verified", self.verified),
            *rows_of("Smoother", self, ["poses", "error"]),
            _chi_square(self),
            *(
                Row(
                    "Smoother",
                    f"error reached from the start {start.name}",
                    shown(start.error, ".2f"),
                )
                for start in self.starts
                if not start.name.startswith("random")
            ),
        ]
        if self.random_starts:
            rows += rows_of("Smoother", self, ["random_starts", "chance_missed"])
        if self.hops:
            rows += rows_of("Smoother", self, ["hops"])
        rows += _second_minimum(self)
        if self.method != "batch":
            far = f"largest distance of the {self.method} estimate from the optimum"
            rows.append(Row("Smoother", far, in_sigma(self.distance_sigma)))
        if self.robust != "none":
            left_out = ["robust", "rejected_measurements", "rejected_positions"]
            rows += rows_of("Smoother", self, left_out)
        return rows

    @property
    def optimum(self) -> str:
        """Whether it is verified, in words, with chi-square where that is tested."""
        words = "verified" if self.verified else f"not verified: {self.lacks}"
        if self.dof:
            words += f"; chi-square {self.chi2:,.0f} for {self.dof:,} degrees of freedom"
        return words


class AboutSmoother(About):
    """What is the evidence for the smoother's optimum?"""

    name = "smoother"
    needs = "the smoother"
    figures = (("smoother", SmootherFigures),)

    def __init__(self, entry: str = "smoother") -> None:
        """entry: its key in the result."""
        self._entry = entry

    def find(self, known: Known) -> JobPart[SmootherFigures]:
        """Return its settings, its starts, and the minima that they found."""
        return JobPart(self._entry, SmootherFigures.of(known.result, known.smoothed))


def _chi_square(smoother: SmootherFigures) -> Row:
    """Return chi-square with its band; a robust kernel changes it, and leaves no band."""
    chi2 = rounded(smoother.chi2)
    if not smoother.dof:
        return Row("Smoother", "chi-square under the robust kernel (not tested)", chi2)
    low, high = smoother.chi2_band
    return Row(
        "Smoother",
        f"chi-square (expected {smoother.dof})",
        chi2,
        band(rounded(low), rounded(high)),
        low <= smoother.chi2 <= high,
    )


def _second_minimum(smoother: SmootherFigures) -> list[Row]:
    if len(smoother.minima) < 2:
        return []
    second = smoother.minima[1]
    place, far = f"the pose at {second.time_s:.1f} s", second.pose_m
    if second.landmark is not None and second.landmark_m > second.pose_m:
        place, far = f"landmark {second.landmark}", second.landmark_m
    return [
        Row("Smoother", "distinct minima found", f"{len(smoother.minima)}"),
        Row("Smoother", "error at the second lowest minimum", f"{second.error:.2f}"),
        Row("Smoother", f"shift of {place} to the second lowest minimum", f"{far:.3g} m"),
    ]
