"""The log that a job has read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from comparisons.checks.check import About
from comparisons.checks.finding import JobPart
from comparisons.figures import Model
from comparisons.logs.hashing import log_hash
from comparisons.logs.log import Log
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


class LogFigures(Model):
    """The log that was read.

    Attributes:
        name: name of the log.
        format: format in which it was read, as `slamcheck logs` names it.
        records: number of records of each stream.
        duration_s: time from the first record to the last.
        sha256: hash of all streams that an estimator may be given.
        provenance: what the log says about its origin.
    """

    name: str
    format: str
    records: dict[str, int]
    duration_s: float
    sha256: str
    provenance: dict[str, str]

    @classmethod
    def of(cls, log: Log) -> LogFigures:
        """Return those of a log."""
        return cls(
            name=log.name,
            format=log.format,
            records=log.records,
            duration_s=log.duration_s,
            sha256=log_hash(log),
            provenance=log.provenance,
        )

    def rows(self) -> list[Row]:
        """Return rows of the table."""
        times = self.provenance.get("times")
        return [
            Row("Log", "name", self.name),
            Row("Log", "format", self.format),
            Row("Log", "duration", f"{self.duration_s:.0f} s"),
            *([Row("Log", "time stamps", times)] if times else ()),
            *(Row("Log", name, f"{n:,}") for name, n in self.records.items()),
        ]

    @property
    def words(self) -> str:
        """Format and duration, and what stands in place of seconds, if anything does."""
        times = self.provenance.get("times", "")
        said = f"; {times}" if "in place of seconds" in times else ""
        return f"{self.format}, {self.duration_s:,.0f} s{said}"


class AboutLog(About):
    """Which log was read?"""

    name = "log"
    needs = "a log"
    figures = (("log", LogFigures),)

    def find(self, known: Known) -> JobPart[LogFigures]:
        """Return its streams, and where they come from."""
        return JobPart("log", LogFigures.of(known.log))
