"""What the check of someone else's estimate found, for reports and whoever asks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, cast

from comparisons.checks.accuracy import Accuracy, AccuracyFinding
from comparisons.checks.check import Answers, FromJob
from comparisons.checks.consistency.consistency import ExternalConsistency
from comparisons.checks.consistency.finding import ConsistencyFinding
from comparisons.checks.diagnosis.departure import Departure
from comparisons.checks.diagnosis.estimate_facts import UndoneMotion
from comparisons.checks.external_agreement import ExternalAgreement, TimeCoverage, within_log
from comparisons.checks.grade import Graded, Likeness
from comparisons.checks.registry import BASIS, CHECKS
from comparisons.checks.smoother import AboutSmoother
from comparisons.checks.verdict import Verdict
from comparisons.estimates.external import ExternalEstimate, with_poses
from comparisons.estimates.reference import Reference
from comparisons.jobs.external_trace import TraceCheck
from comparisons.jobs.grade import GradeFinding
from comparisons.pipeline.known import Known
from comparisons.pipeline.solve import Solution
from comparisons.shown import Shown, render

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True)
class ExternalCheck(Shown, Verdict):
    """Hold what the check of an external estimate found, which is a verdict.

    Attributes:
        given: The estimate that was checked.
        solution: The smoother's, of the same log.
        optimum: The smoother at the given times.
        peers: Correct estimates of the kinds that the given one may be.
        by_peer: The given one beside each of these.
        motion: Of all of it, without which it equals one of these; None where there is none.
        variants: Other sound filters that it may be like; none where it equals a peer.
        agreement: The estimate against the smoother.
        coverage: Share of the log's time that it covers.
        trace: The filter's own gaps, where it handed in a trace.
        consequences: Kinds of causes that the first one explains, as was computed: the reference
            filter with this fault equals the estimate.
        departure: Where it first leaves the filter that it equals the longest, or its trace the
            models; None where it is equal, or no filter is of its kind.
        reproduced: A filter with the fault that is the first cause equals all of it, so that its
            other figures follow from that.
        grade: `equal`, `like`, `plausible` or `wrong`, with what it was compared with.
        outcome: `agree`, `disagree` or `unverified`.
        causes: Why the grade is not higher, the most important first.
        remarks: What narrows the verdict.
        before: What is known of log and estimate before the checks are asked.
        qualifiers: What a reader of the outcome must know as well.
        inconsistent: What of its consistency is outside its band, None where nothing shows it.
        failed_on: What of `--fail-on` the check fails on.
    """

    given: ExternalEstimate
    solution: Solution
    optimum: Reference
    peers: tuple[Reference, ...]
    by_peer: tuple[Likeness, ...]
    motion: UndoneMotion | None
    variants: tuple[Reference, ...]
    agreement: ExternalAgreement
    coverage: TimeCoverage
    trace: TraceCheck | None
    grade: Graded
    before: Known
    departure: Departure | None = None
    consequences: tuple[str, ...] = ()
    reproduced: bool = False

    def __repr__(self) -> str:
        """Return log, outcome, grade and the causes' names in one line."""
        gaps = ", ".join(cause.gap for cause in self.causes)
        name, grade = self.solution.log.name, self.grade.value or "none"
        return f"<ExternalCheck of {name}: {self.outcome}, grade {grade}{gaps and f' ({gaps})'}>"

    @cached_property
    def known(self) -> Known:
        """What is known of log and estimate, with the grade and what the checks find."""
        grade = FromJob("grade", GradeFinding(self))
        return Answers(self.before, (*BASIS, AboutSmoother(), grade, *CHECKS)).known

    @property
    def grade_words(self) -> str:
        """The grade, and what it is like; why there is none."""
        return GradeFinding(self).words

    @property
    def is_short(self) -> bool:
        """Whether it has no grade since too little of the log is covered."""
        return self.outcome == "disagree" and any(one.gap == "coverage" for one in self.causes)

    @property
    def consistency(self) -> ExternalConsistency:
        """Its errors, and whether its covariances match them."""
        return cast("ExternalConsistency", self.known.value(ConsistencyFinding))

    @property
    def accuracy(self) -> Accuracy | None:
        """Its errors, where the log has truth or positions that no estimator has used."""
        return (self.known.value(AccuracyFinding) or {}).get("estimate")

    @property
    def inside(self) -> ExternalEstimate:
        """What was given within the log's time."""
        return with_poses(self.given, within_log(self.given, self.solution.estimate))

    @property
    def exact(self) -> bool:
        """Whether it is equal to a reference, and its trace to the models."""
        return self.grade.value == "equal" and not (self.trace and self.trace.verdict.causes)

    def to_pandas(
        self, table: Literal["causes", "gaps", "poses", "landmarks", "nees", "settings"] = "causes"
    ) -> DataFrame:
        """Return a table as a pandas data frame.

        Args:
            table: `causes` of the verdict; `gaps`: those of the filter's trace, where it was handed
                in; `poses` as they were handed in; `landmarks`: the estimate against the smoother,
                by landmark; `nees`: of the estimate and the smoother against truth, by instant,
                with the 95 % band of one value; `settings`: value and default of each.

        Returns:
            The table, one row for each of what it lists; no rows where there is none.

        Raises:
            InputError: pandas is not installed, or there is no such table.
        """
        found: DataFrame = render("frame", self, table)
        return found
