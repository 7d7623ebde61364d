"""What a job found, as a report: its JSON, what is printed, its page and its folder."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

from comparisons.report.folder import JobFolder, write_job_folder
from comparisons.report.terminal import Summary

if TYPE_CHECKING:
    from comparisons.pipeline.clock import Clock
    from comparisons.report.html.page import PageContent

F = TypeVar("F")
R = TypeVar("R")

REPORTS = {
    "Answers": "comparisons.report.job_report:AnswersReport",
    "Audit": "comparisons.report.audit:AuditReport",
    "Comparison": "comparisons.report.run:RunReport",
    "DenseMapping": "comparisons.extensions.dense_maps.report:MapReport",
    "ExternalCheck": "comparisons.report.check:CheckReport",
    "FrontEnd": "comparisons.extensions.scan_motion.report:FrontEndReport",
    "Solution": "comparisons.report.solution:SolutionReport",
}
"""By the class of what was found; imported when it is asked for."""


@dataclass(frozen=True)
class Report(ABC, Generic[F, R]):
    """found: what a job found. result: the same as its JSON file has it."""

    found: F
    result: R

    @classmethod
    def of(cls, found: F, read: Clock | None = None) -> Self:
        """Return the report. read: the time that reading the log took."""
        return cls(found, cls.build(found, read))

    @staticmethod
    @abstractmethod
    def build(found: F, read: Clock | None = None) -> R:
        """Return what the JSON file has."""

    @abstractmethod
    def summary(self) -> Summary:
        """Return what the command prints."""

    @abstractmethod
    def page(self) -> PageContent:
        """Return what stands on the page."""

    @abstractmethod
    def folder(self) -> JobFolder:
        """Return what is to be written."""

    @property
    def outcome(self) -> str:
        """The word that decides the command's exit code."""
        return str(getattr(self.result, "verdict", "agree"))

    def write(self, folder: Path) -> Path:
        """Write the folder and return its JSON file. Raises InputError."""
        content = self.folder()
        write_job_folder(content, folder)
        return folder / f"{content.name}.json"


def report_of(found: object, read: Clock | None = None) -> Report[Any, Any]:
    """Return the report of what any job found. read: see Report.of."""
    place = REPORTS.get(type(found).__name__)
    if place is None:
        raise TypeError(f"a {type(found).__name__} has no report")
    kind: type[Report[Any, Any]] = resolve_name(place)
    return kind.of(found, read)
