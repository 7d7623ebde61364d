"""Whether the smoother's optimum is a reference for the filter."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from comparisons.checks.check import Check
from comparisons.checks.finding import OfFilter
from comparisons.figures import rounded
from comparisons.words import Cause
from graphslam.optimum import DISTANCE_LIMIT, ChiSquareTest, Optimality

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


class CheckOptimum(Check):
    """Is the smoother's optimum verified, and told by double precision?"""

    name = "optimum"
    needs = "the smoother"
    errs = "of 72 logs with many minima no wrong optimum is verified; of 48 right optima 47 are"

    def find(self, known: Known) -> OfFilter[Optimality]:
        """Return the evidence for S."""
        optimality, records, causes = known.result.optimality, known.kept, []
        if records is not None and records.untold:
            hint = "narrow the prior, end the log before its longest gap, or move the origin nearer"
            causes = [Cause("oracle", records.precision, hint)]  # rounding hides the verdict
        elif not optimality.verified:
            causes = [unverified(optimality)]
        remarks = misfit_remarks(optimality)
        remarks += _on_robust(known.result.options.robust, beside=known.run is not None)
        return OfFilter(optimality, causes, remarks)


def unverified(optimality: Optimality) -> Cause:
    """The optimum is not verified, and what the check lacks."""
    if optimality.distance_sigma > DISTANCE_LIMIT:
        hint = "use the batch smoother, or a longer lag"
    elif optimality.chi_square.reading == "too high":
        hint = "check the log where its residuals depart: `slamcheck logs LOG` names the place"
    else:
        hint = "check the stated noise and the association: the smoother may be in a local minimum"
    return Cause("oracle", optimality.lacks, hint)


def doubted_association(against: int, variants: int) -> Cause:
    """Neither the smoother's nor the reference filter's association without labels is certain."""
    return Cause(
        "oracle",
        f"the log has no labels, and {against} of {variants} other ways to associate its "
        "measurements contradict the smoother's, so that smoother and reference filter may be the "
        "ones that are wrong",
        "label the measurements, or give the filter's own association in a trace",
    )


def lacking(optimality: Optimality) -> list[str]:
    """Return what an optimum lacks, with the meaning of a chi-square that is too high."""
    if optimality.lacks.startswith("chi-square"):
        return misfit_remarks(optimality)
    return [optimality.lacks] if optimality.lacks else []


def overstated(test: ChiSquareTest) -> bool:
    """Whether no chance makes a chi-square so low."""
    return test.reading == "too low" and test.extreme


def misfit_remarks(optimality: Optimality) -> list[str]:
    """Return what a chi-square outside its band means, and whether it was accepted."""
    test = optimality.chi_square
    if test.reading == "plausible":
        return []
    meaning = {
        "too high": "the noise is larger than stated, or the models or the association are wrong",
        "too low": "the actual noise is smaller than stated",
    }[test.reading]
    if test.reading == "too high" and optimality.accept_misfit:
        meaning += "; --accept-misfit accepts it"
    if overstated(test):
        times = rounded((test.dof / test.chi2) ** 0.5 if test.chi2 else math.inf)
        meaning = f"the stated sigmas are about {times} times too large, and so are the estimate's"
    chi2, lower, upper = map(rounded, (test.chi2, test.lower, test.upper))
    return [
        f"chi-square {chi2} for {test.dof} degrees of freedom is {test.reading} "
        f"(band {lower} to {upper}): {meaning}"
    ]


def _on_robust(robust: str, *, beside: bool) -> list[str]:
    """beside: a filter is compared with the smoother."""
    if robust in ("huber", "cauchy"):
        return [
            f"the smoother's {robust} kernel reduces the weight of measurements that fit badly: "
            "its covariances are those of the weighted problem, and chi-square is not tested"
        ]
    if robust == "gnc" and beside:
        return ["the smoother excluded outliers; the filter did not exclude them"]
    return []
