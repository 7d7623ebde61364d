"""The main job: one log through both estimators and all checks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.audit.own_filter import watch
from comparisons.checks.accuracy import Accuracies, AccuracyFinding
from comparisons.checks.agreement import Agreement
from comparisons.checks.check import Answers
from comparisons.checks.consistency.consistency import Consistency
from comparisons.checks.consistency.finding import ConsistencyFinding
from comparisons.checks.diagnosis.data_usage import odometry_remarks
from comparisons.checks.finding import Finding
from comparisons.checks.gaps import GapsFinding
from comparisons.checks.qualifiers import TruthGapFinding, qualified
from comparisons.checks.registry import BASIS, CHECKS, EXPLAINING, OF_RUN
from comparisons.checks.unused_positions import UnusedPositionsFinding
from comparisons.checks.verdict import Verdict, judge
from comparisons.config import RunConfig, config_class
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log
from comparisons.pipeline.clock import Progress, no_progress
from comparisons.pipeline.extension import Extension
from comparisons.pipeline.gaps import compute_gaps, optimum_of
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepare import Required, check_memory, prepare
from comparisons.pipeline.prepared import Preparation, Prepared
from comparisons.pipeline.records import FilterRecords
from comparisons.pipeline.size import announce_time
from comparisons.shown import Shown, render
from ekf_reference.core.ekf import Ekf
from graphslam.smoother import SmootherEvidence, SmootherOptions

if TYPE_CHECKING:
    from pandas import DataFrame

    from comparisons.trace.events import Event

F = TypeVar("F", bound=Finding)

MOST_PAIRS = 5_000_000
"""Pairs of measurement and landmark up to which a run makes a second association unasked."""
REQUIRED = Required(
    measurements="try --features trees, --landmarks scans, or slamcheck odometry for its scans",
    odometry="use --motion scan",
)


@dataclass(frozen=True, kw_only=True)
class Comparison(Shown):
    """Hold everything that one run of both estimators found.

    Attributes:
        known: What the checks have read, and found.
        verdict: Outcome, causes (the most important first) and remarks.
    """

    known: Known
    verdict: Verdict

    def __repr__(self) -> str:
        """Return log and verdict in one line."""
        return f"<Comparison of {self.log.name}: {self.verdict.summary}>"

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
        found: DataFrame = render("frame", self, table)
        return found

    @property
    def prepared(self) -> Prepared[RunConfig]:
        """The log as the estimators read it, and the configuration."""
        return self.known.prepared

    @property
    def ekf(self) -> EkfRun:
        """The EKF's estimate (`ekf.estimate`) and trace."""
        return self.known.ekf

    @property
    def log(self) -> Log:
        """The log as the estimators read it."""
        return self.prepared.log

    @property
    def smoother(self) -> SmootherEvidence:
        """The smoother, with the evidence for its optimum."""
        return self.known.result

    @property
    def smoothed(self) -> Estimate:
        """The smoother's estimate."""
        return self.known.smoothed

    @property
    def agreement(self) -> Agreement:
        """The gaps between the estimates."""
        return self.find(GapsFinding).value

    @property
    def findings(self) -> Mapping[str, Finding]:
        """Of the checks, those of extensions among them, by name."""
        return self.known.findings

    @property
    def consistency(self) -> Consistency:
        """NEES, NIS, whiteness, filter against smoother; it has no say in the verdict."""
        return self.find(ConsistencyFinding).value

    @property
    def accuracy(self) -> Accuracies:
        """Errors of each estimate. Raises LookupError where the log has no reference."""
        accuracies: Accuracies = self.find(AccuracyFinding).entries["accuracy"]
        return accuracies

    def find(self, kind: type[F]) -> F:
        """Return the finding of a check.

        Args:
            kind: The class of the finding.

        Returns:
            The first finding of that class.

        Raises:
            LookupError: No check that was asked has such a finding.
        """
        for finding in self.findings.values():
            if isinstance(finding, kind):
                return finding
        raise LookupError(f"the run has no {kind.__name__}")


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
    announce_time(prepared)
    options = SmootherOptions(**prepared.config.smoother.model_dump())
    with clock.stage("ekf"):
        run, setup = run_filter(prepared)
    second, unchecked = _second_association(prepared, run)
    extensions = _extensions(prepared)
    asked = extensions if second is None else (*extensions, second)
    with ExitStack() as stack:  # what extensions start beside the smoother ends with the block
        started = {
            extension.name: stack.enter_context(work)
            for extension in asked
            if (work := extension.start(prepared, run)) is not None
        }
        optimum = optimum_of(run, options, clock, progress)
        gaps = compute_gaps(log, run, optimum, clock, progress)
        own = Known(
            prepared=prepared,
            solved=(gaps.result, gaps.smoothed),
            landmark_index=run.landmark_index,
            timeline=run.timeline,
            positions=run.positions,
            run=run,
            kept=OwnRecords(gaps, prepared),
            beside=setup,
            started=started,
        )
        for extension in extensions:
            extension.ask(own)
        if second is not None:  # which nobody named
            try:
                second.ask(own)
            except InputError as error:
                unchecked = f"the association is unchecked: {error}"
    progress("checks", 0, 0)
    known = Answers(own, (*BASIS, *OF_RUN, *CHECKS, *EXPLAINING)).known
    with clock.stage("checks"):
        return _judged(known, unchecked)


def _judged(known: Known, unchecked: str) -> Comparison:
    """The verdict over all findings. unchecked: why nobody has checked the association."""
    prepared, verdict = known.prepared, judge(known)
    remarks = (*odometry_remarks(prepared.log), *verdict.remarks)
    return Comparison(
        known=known,
        verdict=qualified(
            replace(verdict, remarks=remarks),
            known.value(TruthGapFinding),
            unchecked=unchecked,
            consistency=known.value(ConsistencyFinding),
            unused=known.value(UnusedPositionsFinding),
            fail_on=prepared.config.fail_on,
        ),
    )


def _second_association(prepared: Prepared[RunConfig], run: EkfRun) -> tuple[Extension | None, str]:
    """Return the smoother's own where no other check is possible, or else why it is not made.

    Neither where the configuration asks for it. It is made where its work is bounded: by a count,
    so that a run repeats on every machine.
    """
    log, name = prepared.log, "own_association"
    reported = (
        log.measurements.labelled or log.truth.poses is not None or log.truth.landmarks is not None
    )
    if prepared.labelled or reported or not len(log.measurements.time_s):
        return None, ""
    if name in prepared.config.extensions:
        if any(extension.asked for extension in _extensions(prepared) if extension.name == name):
            return None, ""
        return None, "the association is unchecked, as --smoother-association ekf asks"
    pairs = len(run.landmark_index) * len(run.estimate.landmark)
    if pairs > MOST_PAIRS:
        return None, (
            f"the association is unchecked: {pairs / 1e6:.1f} million pairs of measurement and "
            f"landmark, more than {MOST_PAIRS / 1e6:.0f} million, are not tried "
            "by default; --smoother-association own does"
        )
    return config_class(name).of().build(prepared.config), ""


def _extensions(prepared: Prepared[Any]) -> tuple[Extension, ...]:
    """Return those that find something, of all that take part."""
    return tuple(extension for extension in prepared.extensions if isinstance(extension, Extension))


class Modified(Preparation):
    """Replaces parts of the filter before it starts, which is how defects are planted."""

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


def repeat_filter(prepared: Prepared[Any], run: EkfRun, take: Callable[[Event], object]) -> None:
    """Run the filter once more.

    run: what it did. take: is given its events, each with the state that follows.
    """
    # Last, for it is to see the filter with everything that others have planted.
    extensions = (*prepared.extensions, Modified(lambda ekf: watch(ekf, run, take)))
    run_filter(replace(prepared, progress=no_progress, extensions=extensions))


@dataclass(frozen=True, repr=False)
class OwnRecords(FilterRecords):
    """Those of our own filter, which can be run once more."""

    prepared: Prepared[Any]

    def operations(self) -> tuple[str, ...]:
        """Return which events make the filter's algebra wrong, and how."""
        from comparisons.audit.algebra import AlgebraCheck

        check = AlgebraCheck(self.algebra.covariance)
        repeat_filter(self.prepared, self.gaps.run, check.take)
        return check.faults()

    def left_out(self) -> list[str]:
        """Return why the filter did not use all measurements, in sentences."""
        run, found = self.gaps.run, []
        unused = {reason: count for reason, count in run.unused.items() if count}
        if unused:
            found.append(
                f"{sum(unused.values())} of {len(run.landmark_index)} measurements were not used: "
                + ", ".join(f"{count} {reason}" for reason, count in unused.items())
            )
        if run.cut_off:
            from ekf_reference.association.joint_compatibility import JointCompatibility

            found.append(
                f"joint compatibility reached its limit of {JointCompatibility.most_nodes:,} nodes "
                f"in {run.cut_off:,} scans and used the best association found until then"
            )
        if len(run.deactivated):
            names = ", ".join(str(i) for i in run.estimate.landmark_id[run.deactivated].tolist())
            if len(run.deactivated) == len(run.estimate.landmark):
                found.append(
                    "every landmark is deactivated: at the end the filter uses odometry alone"
                )
            found.append(
                f"landmarks {names} are deactivated because something moves at their position: "
                "their estimates no longer change, and no measurement is associated with them"
            )
        return found
