"""The main job: one log through both estimators and all checks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.arrays import Array
from comparisons.audit.own_filter import run_events, watch
from comparisons.audit.spurious import Learnt, learnt
from comparisons.checks.accuracy import Accuracy, assess, assess_trajectory
from comparisons.checks.agreement import Agreement
from comparisons.checks.association import AssociationScore, score_association
from comparisons.checks.consistency.consistency import Consistency, check_consistency
from comparisons.checks.diagnosis.data_usage import data_faults, odometry_remarks
from comparisons.checks.qualifiers import TruthGap, measurement_scale, qualified, truth_gap
from comparisons.checks.verdict import Diagnosis, Verdict, judge
from comparisons.config import RunConfig
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.interface import Extension, Finding
from comparisons.logs.log import Log
from comparisons.pipeline.gaps import Compared, Gaps, compute_gaps
from comparisons.pipeline.prepare import (
    Prepared,
    Progress,
    Required,
    check_memory,
    no_progress,
    prepare,
)
from ekf_reference.core.ekf import Ekf
from graphslam.increments import dead_reckoned
from graphslam.smoother import SmootherOptions, SmootherResult

if TYPE_CHECKING:
    from pandas import DataFrame

    from comparisons.checks.diagnosis.dropouts import Dropouts
    from comparisons.checks.diagnosis.log_fit import LogFit
    from comparisons.checks.position_gate import RejectedFixes
    from comparisons.pipeline.beside import Beside
    from comparisons.trace.events import Event

F = TypeVar("F", bound=Finding)

REQUIRED = Required(
    measurements="try --features trees, --landmarks scans, or slamcheck odometry for its scans",
    odometry="use --motion scan",
)


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """Each estimate against truth or held-back positions; None where the log has no reference.

    association: how it compares with the log's labels, where it was made without them.
    truth_gap: the smoother against truth, or else against labels that it has not used. fixes: what
    the filter's gate rejected, None where no positions were given.
    """

    ekf: Accuracy | None
    smoother: Accuracy | None
    dead_reckoned: Accuracy | None
    association: AssociationScore | None
    truth_gap: TruthGap | None = None
    fixes: RejectedFixes | None = None


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Hold everything that one run of both estimators found.

    Attributes:
        prepared: The log as the estimators read it, and the configuration.
        ekf: The EKF's estimate (`ekf.estimate`) and trace.
        gaps: The chain of estimates from the EKF to the smoother.
        dead_reckoned: (K, 3) poses where the odometry alone leads.
        consistency: NEES, NIS, whiteness, filter against smoother; it has no say in the verdict.
        spurious: What the filter learnt of its global heading from measurements that cannot tell
            it; None where landmarks are surveyed.
        assessment: Errors of each estimate against truth, where the log has it.
        findings: Of the extensions that took part, by name.
        verdict: Outcome, causes (the most important first) and remarks.
    """

    prepared: Prepared[RunConfig]
    ekf: EkfRun
    gaps: Gaps
    dead_reckoned: Array
    consistency: Consistency
    spurious: Learnt | None
    assessment: Assessment
    findings: Mapping[str, Finding]
    verdict: Verdict

    def __repr__(self) -> str:
        """Return log and verdict in one line."""
        return f"<Comparison of {self.log.name}: {self.verdict.summary}>"

    def _repr_html_(self) -> str:
        from comparisons.report.notebook import comparison_html

        return comparison_html(self)

    def to_pandas(
        self, table: Literal["gaps", "landmarks", "nees", "nis", "causes", "settings"] = "gaps"
    ) -> DataFrame:
        """Return a table as a pandas data frame.

        Args:
            table: `gaps`: the gaps between EKF, both linear problems, smoother and truth;
                `landmarks`: EKF against smoother, by landmark; `nees`: of EKF and smoother against
                truth, by instant, with the 95 % band of one value; `nis`: of the innovations, mean
                over stretches of time with its 95 % band; `causes` of the verdict; `settings`:
                value and default of each.

        Returns:
            The table, one row for each of what it lists; no rows where there is none.

        Raises:
            InputError: pandas is not installed, or there is no such table.
        """
        from comparisons.report.tables import comparison_tables, data_frame

        return data_frame(comparison_tables(self), table)

    @property
    def log(self) -> Log:
        """The log as the estimators read it."""
        return self.prepared.log

    @property
    def smoother(self) -> SmootherResult:
        """The smoother, with the evidence for its optimum."""
        return self.gaps.result

    @property
    def smoothed(self) -> Estimate:
        """The smoother's estimate."""
        return self.gaps.smoothed

    @property
    def agreement(self) -> Agreement:
        """The gaps between the estimates."""
        return self.gaps.agreement

    def find(self, kind: type[F]) -> F:
        """Return the finding of an extension.

        Args:
            kind: The class of the finding.

        Returns:
            The first finding of that class.

        Raises:
            LookupError: No extension that ran has such a finding.
        """
        for found in self.findings.values():
            if isinstance(found, kind):
                return found
        raise LookupError(f"the run has no {kind.__name__}")

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time by stage."""
        return self.prepared.clock.seconds


def compare(
    log: Log, config: RunConfig | None = None, progress: Progress = no_progress
) -> Comparison:
    """Run both estimators over a log and judge them.

    Raises InputError when the log cannot be used as configured, and
    graphslam.marginals.SingularProblemError when the smoother has no solution.
    """
    return compare_prepared(
        prepare(log, config or RunConfig(), progress=progress, required=REQUIRED)
    )


def compare_prepared(prepared: Prepared[RunConfig]) -> Comparison:
    """Do the same with a log that is prepared. Raises as `compare` does."""
    log, clock, progress = prepared.log, prepared.clock, prepared.progress
    check_memory(prepared)
    options = SmootherOptions(**prepared.config.smoother.model_dump())
    with clock.stage("ekf"):
        run, setup = run_filter(prepared)
    second, unchecked = _second_association(prepared, run)
    asked = prepared.extensions if second is None else (*prepared.extensions, second)
    with _started(asked, prepared, run) as started:
        gaps = compute_gaps(log, run, options, clock, progress)
        compared = Compared(prepared=prepared, setup=setup, ekf=run, gaps=gaps, started=started)
        findings = {
            one.name: found
            for one in prepared.extensions
            if (found := one.check(compared)) is not None
        }
        if second is not None:
            unchecked = _ask(second, compared, findings)
    with clock.stage("checks"):
        progress("checks", 0, 0)
        labelled, smoothed = prepared.labelled, gaps.smoothed
        consistency = check_consistency(
            log, run, smoothed, labelled=labelled, robust=options.robust
        )
        spurious = learnt(run_events(run))
        fixes = _rejected_fixes(run, smoothed)
        verdict = judge(
            gaps.agreement,
            gaps.result,
            run,
            _diagnosis(compared, consistency, spurious),
            data_faults=data_faults(log, run, smoothed, labelled=labelled),
            causes=[
                *(() if fixes is None else fixes.causes),
                *(cause for found in findings.values() for cause in found.causes),
            ],
            conservative=prepared.ekf.conservative,
        )
        verdict = replace(verdict, remarks=(*odometry_remarks(log), *verdict.remarks))
        remarks = [remark for found in findings.values() for remark in found.remarks]
        reckoned = dead_reckoned(gaps.problem.prior_pose, gaps.problem.increment)
        assessment = replace(_assess(prepared, run, smoothed, reckoned), fixes=fixes)
        gap = _truth_gap(compared, assessment, consistency)
        if fixes is not None:
            remarks += fixes.remarks
        return Comparison(
            prepared=prepared,
            ekf=run,
            gaps=gaps,
            dead_reckoned=reckoned,
            consistency=consistency,
            spurious=spurious,
            assessment=replace(assessment, truth_gap=gap),
            findings=findings,
            verdict=qualified(
                replace(verdict, remarks=(*verdict.remarks, *consistency.remarks, *remarks)),
                gap,
                unchecked=unchecked,
                consistency=consistency,
                fail_on=prepared.config.fail_on,
            ),
        )


@contextmanager
def _started(
    extensions: Sequence[Extension], prepared: Prepared[Any], run: EkfRun
) -> Iterator[dict[str, Beside[Any]]]:
    """What extensions start beside the smoother, by name; ended at the latest with the block."""
    with ExitStack() as stack:
        started = {}
        for one in extensions:
            work = one.start(prepared, run)
            if work is not None:
                started[one.name] = stack.enter_context(work)
        yield started


def _second_association(prepared: Prepared[RunConfig], run: EkfRun) -> tuple[Extension | None, str]:
    """Return the smoother's own where no other check is possible, or else why it is not asked."""
    log = prepared.log
    reported = (
        log.measurements.labelled or log.truth.poses is not None or log.truth.landmarks is not None
    )
    if prepared.labelled or reported or not len(log.measurements.time_s):
        return None, ""
    from comparisons.pipeline.second_association import own_association

    return own_association(prepared, run)


def _ask(second: Extension, compared: Compared, findings: dict[str, Finding]) -> str:
    """Add what an association that nobody asked for finds; return why it finds nothing."""
    try:
        found = second.check(compared)
    except InputError as error:
        return f"the association is unchecked: {error}"
    if found is not None:
        findings[second.name] = found
    return ""


def _truth_gap(
    compared: Compared, assessment: Assessment, consistency: Consistency
) -> TruthGap | None:
    """S against truth, or else against the log's labels, where S has not used them."""
    prepared, run, smoothed = compared.prepared, compared.ekf, compared.gaps.smoothed
    gap = truth_gap(
        assessment.smoother,
        consistency.smoother,
        assessment.association,
        measurement_scale(prepared.log.measurements, run.pose_landmarks.covariance[:, :2, :2]),
        len(smoothed.landmark),
    )
    if prepared.labelled or not prepared.log.measurements.labelled or (gap and gap.settled):
        return gap
    from comparisons.pipeline.second_association import labels_gap, with_labels

    if gap is None:
        return labels_gap(compared, assessment.association)
    return with_labels(compared, gap)


class Modified(Extension):
    """Replaces parts of the filter before it starts, which is how defects are planted."""

    name = "modified"

    def __init__(self, modify: Callable[[Ekf], None]) -> None:
        """modify: given the filter at its prior."""
        self._modify = modify

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        """Add it to what is done before the start."""
        setup.modify.append(self._modify)


def run_filter(prepared: Prepared[Any]) -> tuple[EkfRun, FilterSetup]:
    """Run the filter once, with everything that extensions put beside it. Raises InputError."""
    beside = prepared.beside_filter()
    run = run_ekf(
        prepared.log,
        prepared.timeline,
        prepared.ekf,
        prepared.positions,
        beside,
        prepared.stage_progress("EKF"),
    )
    if not len(run.estimate.landmark) + len(run.estimate.pose_landmarks):
        raise InputError(
            f"{prepared.log.name}: nothing that was observed could be used, so there is no map to "
            "compare"
        )
    return run, beside


def _diagnosis(compared: Compared, consistency: Consistency, spurious: Learnt | None) -> Diagnosis:
    """What is imported and done only where there is something to explain."""
    log, run, gaps = compared.prepared.log, compared.ekf, compared.gaps

    def known_model_errors() -> Sequence[str]:
        from comparisons.checks.diagnosis.known_model_errors import explain

        return explain(log, run)

    def dropouts() -> Dropouts | None:
        from comparisons.checks.diagnosis.dropouts import find_dropouts

        return find_dropouts(run, gaps.smoothed)

    def fits() -> Sequence[LogFit]:
        from comparisons.checks.diagnosis.log_fit import log_fits

        compared.prepared.progress("the log's own numbers", 0, 0)
        return log_fits(log, run, gaps.result)

    return Diagnosis(
        differences=gaps.model_differences,
        operations=lambda: _event_faults(compared.prepared, run, gaps.rounding.covariance),
        known_model_errors=known_model_errors,
        growth=gaps.linearisation_growth,
        spurious=lambda: spurious,
        dropouts=dropouts,
        consistency=consistency,
        log_fits=fits,
        algebra=gaps.rounding,
        model=gaps.rounding,
    )


def _event_faults(prepared: Prepared[Any], run: EkfRun, tolerance: float) -> tuple[str, ...]:
    """Return which events of the filter's algebra are wrong, and how."""
    from comparisons.audit.algebra import AlgebraCheck

    check = AlgebraCheck(tolerance)
    repeat_filter(prepared, run, check.take)
    return check.faults()


def repeat_filter(prepared: Prepared[Any], run: EkfRun, take: Callable[[Event], object]) -> None:
    """Run the filter once more.

    run: what it did. take: is given its events, each with the state that follows.
    """
    # Last, for it is to see the filter with everything that others have planted.
    extensions = (*prepared.extensions, Modified(lambda ekf: watch(ekf, run, take)))
    run_filter(replace(prepared, progress=no_progress, extensions=extensions))


def _assess(
    prepared: Prepared[Any], run: EkfRun, smoothed: Estimate, reckoned: Array
) -> Assessment:
    judged, labelled = prepared.judged, prepared.labelled
    score = None
    if not labelled:
        score = score_association(run.landmark_index, run.estimate.landmark, prepared.log)
    return Assessment(
        ekf=assess(run.estimate, judged, labelled=labelled),
        smoother=assess(smoothed, judged, labelled=labelled),
        dead_reckoned=assess_trajectory(run.timeline.epoch_time_s, reckoned, judged),
        association=score,
    )


def _rejected_fixes(run: EkfRun, smoothed: Estimate) -> RejectedFixes | None:
    if run.positions is None:
        return None
    from comparisons.checks.position_gate import rejected_fixes

    return rejected_fixes(run, smoothed)
