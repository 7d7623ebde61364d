"""The report of a job on a log, made from what its checks have found.

`JobReport` serves every job that has a `Known`: result, table, lines, page and folder. A job's own
report adds what only it has, and a job without one is reported as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from comparisons.checks.check import Answers
from comparisons.checks.qualifiers import TruthGapFinding, against_optimum
from comparisons.checks.unused_positions import UnusedPositionsFinding
from comparisons.figures import package_versions, stored
from comparisons.pipeline.clock import Clock
from comparisons.pipeline.known import Known
from comparisons.report.folder import JobFolder
from comparisons.report.html.map import MapContent, estimate_map
from comparisons.report.html.page import PageContent, facts_of, page_of, write_page
from comparisons.report.job import Report
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, Panel
from comparisons.report.models import CheckedResult, JobResult
from comparisons.report.panels import known_panels
from comparisons.report.rows import gap_rows, seconds_rows
from comparisons.report.settings import setting_lines
from comparisons.report.terminal import Summary
from comparisons.report.track_errors import track_errors
from comparisons.words import Row, cause_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from comparisons.checks.verdict import Verdict
    from comparisons.estimates.estimate import Estimate
    from comparisons.report.ladder import LadderStep


class Informed(Protocol):
    """What a job on a log returns."""

    @property
    def known(self) -> Known:
        """What the job knows, with what its checks have found."""


F = TypeVar("F", bound=Informed)
R = TypeVar("R", bound=JobResult)


class JobReport(Report[F, R]):
    """Report of a job on a log."""

    file = ""
    """Name of the result's file without suffix, where it is not the job's."""
    judged = "filter"
    """What the job judges, in words."""

    @property
    def known(self) -> Known:
        """What the job knows, with what its checks have found."""
        return self.found.known

    @property
    def headline(self) -> str:
        """The outcome in words, printed first."""
        result = self.result
        if isinstance(result, CheckedResult):
            return f"verdict: {result.headline}"
        return f"{self.known.job}: {result.log.name}"

    @property
    def lines(self) -> Sequence[tuple[str, str]]:
        """Lines of what is printed that are of no finding; they come first."""
        return ()

    @property
    def steps(self) -> Sequence[LadderStep]:
        """The gaps between the estimates, from one to the next."""
        return ()

    @property
    def job_rows(self) -> Sequence[Row]:
        """Rows that are of no finding; they stand below those of what the gaps are of."""
        return gap_rows(self.steps)

    def summary(self) -> Summary:
        """Return what the command prints."""
        result, known = self.result, self.known
        return Summary(
            headline=self.headline,
            look=getattr(result, "look", ""),
            causes=getattr(result, "causes", ()),
            reasons=getattr(result, "reasons", ()),
            remarks=result.remarks,
            steps=self.steps,
            lines=[*self.lines, *known.lines],
            rows=[*known.rows(self.job_rows), *seconds_rows(result.seconds, result.cpu_s)],
        )

    def drawn(self) -> MapContent:
        """Return what the page's map shows: the filter, or else the smoother."""
        (name, estimate), *_ = self.known.estimates.items()
        colour = SMOOTHER_COLOUR if self.known.run is None else EKF_COLOUR
        return estimate_map(self.known.log, name, colour, estimate)

    @property
    def curves(self) -> tuple[str, Sequence[Panel]]:
        """What the page's curves show, in words, and their panels."""
        return known_panels(self.known)

    @property
    def facts(self) -> Sequence[tuple[str, str]]:
        """Figures of the page in the place of the line of agreement."""
        return ()

    def page(self, pictures: Sequence[Path] = ()) -> PageContent:
        """Return what stands on the page. pictures: files of those that have been drawn."""
        result, known, (reported, panels) = self.result, self.known, self.curves
        off = "; ".join(getattr(result, "inconsistent", None) or ())
        elsewhere = {"agreement", "consistency"} if off else {"agreement"}
        return replace(
            page_of(self.summary(), result.log.name),
            job=known.job,
            about=result.log.words,
            notes=[f"The {self.judged} is inconsistent: {off}."] if off else (),
            facts=[*facts_of(self.lines), *self.facts, *facts_of(known.lines, elsewhere)],
            map=replace(self.drawn(), errors=track_errors(known)),
            reported=reported,
            panels=panels,
            pictures=pictures,
            sections=[part for finding in known.findings.values() for part in finding.sections()],
            settings=setting_lines(known.prepared.config, result.settings),
            seconds=result.seconds,
            cpu_s=result.cpu_s or {},
            versions=result.versions,
        )

    @property
    def estimates(self) -> Mapping[str, Estimate]:
        """Estimates that are written, by folder."""
        return {name.lower(): estimate for name, estimate in self.known.estimates.items()}

    @property
    def formats(self) -> Collection[str]:
        """In which the pictures are written besides."""
        return ()

    def figures(self) -> Mapping[str, Figure]:
        """Return pictures, by file name without suffix, besides those of findings."""
        return {}

    def files(self) -> Mapping[str, Callable[[Path], object]]:
        """Return files besides, by name, each written by a function that is given its path."""
        return {}

    def folder(self) -> JobFolder:
        """Return what is to be written; in the page stand the pictures of findings."""
        known = self.known
        found = known.findings.values()
        pictures = {name: figure for f in found for name, figure in f.figures().items()}
        estimates = {name: estimate for f in found for name, estimate in f.estimates.items()}

        def write(path: Path) -> None:
            write_page(self.page([path.with_name(f"{name}.png") for name in pictures]), path)

        return JobFolder(
            name=self.file or known.job,
            result=self.result,
            config=None if known.name else known.prepared.config,
            estimates={**self.estimates, **estimates},
            formats=self.formats,
            figures={**self.figures(), **pictures},
            files={"report.html": write, **self.files()},
        )


class AnswersReport(JobReport[Answers, JobResult]):
    """Report of a job that has none of its own."""

    @staticmethod
    def build(answers: Answers, read: Clock | None = None) -> JobResult:
        """Return what the checks find. read: the time that reading the log took."""
        known = answers.known
        return JobResult(remarks=known.remarks, **job_entries(known, JobResult, read))


def job_entries(
    known: Known, result: type[JobResult], read: Clock | None = None, beside: Clock | None = None
) -> dict[str, Any]:
    """Return what the result of every job on a log has, as arguments of its model.

    read: the time that reading the log took. beside: a clock besides that of the log's estimators.
    """
    prepared = known.prepared
    entries = {
        key: entry if key in result.model_fields else stored(entry)
        for key, entry in known.entries.items()
    }
    return {
        **entries,
        "not_checked": dict(known.absent),
        "config": prepared.config.model_dump(mode="json"),
        "versions": package_versions(),
        **Clock().after(read, prepared.clock, beside),
    }


def judged_entries(
    known: Known,
    verdict: Verdict,
    result: type[JobResult],
    read: Clock | None = None,
) -> dict[str, Any]:
    """Return the same for a job that judges a filter, and its verdict."""
    inconsistent = verdict.inconsistent
    return {
        **job_entries(known, result, read),
        "verdict": verdict.outcome,
        "qualifiers": list(verdict.qualifiers),
        "inconsistent": None if inconsistent is None else list(inconsistent),
        "causes": verdict.causes,
        "remarks": list(verdict.remarks),
    }


def optimum_entries(
    known: Known, result: type[CheckedResult], remarks: Sequence[str], read: Clock | None = None
) -> dict[str, Any]:
    """Return the same for an optimum with which no filter is compared, and all remarks."""
    against = against_optimum(known.value(TruthGapFinding), known.value(UnusedPositionsFinding))
    said = [f"{cause_name(cause.gap)}: {cause.evidence}" for cause in against.values()]
    return {
        **job_entries(known, result, read),
        "qualifiers": list(against),
        "remarks": [*said, *remarks],
    }
