"""What a check finds, which every report renders.

A report asks a finding for entries of the result file, rows, lines, pictures and sections, and
knows no check by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, TypeVar

from comparisons.words import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from comparisons.checks.agreement import PlacedAgreement
    from comparisons.estimates.estimate import Estimate
    from comparisons.report.html.drawing import Drawing
    from comparisons.words import Cause

V = TypeVar("V")


class Finding:
    """What a check found. This one is empty; a check's own overrides what it needs."""

    entries: Mapping[str, Any] = {}
    """Entries of `result.json`, by key: dataclasses that describe every field that is kept."""
    causes: Sequence[Cause] = ()
    """Reasons to disagree. They count where the algebra and the models agree, and the smoother's
    optimum was verified."""
    remarks: Sequence[str] = ()
    """Sentences that change no verdict."""
    lines: Sequence[tuple[str, str]] = ()
    """Its lines of what the command prints: a name of at most 12 letters, and words."""
    estimates: Mapping[str, Estimate] = {}
    """Further estimates, by the folder that they are written to; the page draws each."""
    titles: Mapping[str, str] = {}
    """What the page calls them, where the folder's name does not say it."""

    def rows(self) -> Sequence[Row]:
        """Return rows of the table."""
        return ()

    def draw(self, axis: Axes) -> None:
        """Draw on the map."""

    def figures(self) -> Mapping[str, Figure]:
        """Return pictures of its own, by file name without suffix."""
        return {}

    def layers(self, drawing: Drawing) -> None:
        """Add layers to the page's map."""

    def landmarks(self) -> Sequence[PlacedAgreement]:
        """Return rows of the page's table of landmarks, of those that have a direction."""
        return ()

    def sections(self) -> Sequence[str]:
        """Return sections of the page, as HTML."""
        return ()


class Of(Finding, Generic[V]):
    """A finding of a value, which other checks and `Comparison` may read."""

    def __init__(
        self,
        value: V,
        causes: Sequence[Cause] = (),
        remarks: Sequence[str] = (),
        entries: Mapping[str, Any] | None = None,
    ) -> None:
        """value: what was looked at. The rest is as of `Finding`."""
        self.value, self.causes, self.remarks, self.entries = value, causes, remarks, entries or {}


class Basis(Of[V]):
    """What a job has, of which its gaps are; in every table its rows come first."""


class Tabled(Protocol):
    """Figures that say how tables have them."""

    def rows(self) -> list[Row]:
        """Return rows of the table."""


B = TypeVar("B", bound=Tabled)


class JobPart(Basis[B]):
    """Figures that are an entry of the result, with the rows that they say."""

    def __init__(self, key: str, value: B, *lines: tuple[str, str]) -> None:
        """key: of the entry. lines: as of `Finding`."""
        super().__init__(value, entries={key: value})
        self.lines = lines

    def rows(self) -> Sequence[Row]:
        """Return rows of the table."""
        return self.value.rows()


class OfFilter(Of[V]):
    """What is found of a filter by itself, and first decides about it; its remarks come first."""


class Absent(NamedTuple):
    """No finding. why: what the job lacks for it, as `the log has no truth`."""

    why: str


class LackingError(Exception):
    """What a check asks for is not known in a job, for a reason in words."""


class Findings:
    """What the checks of a job have found, as reports read it.

    findings: of each, by its name. absent: why others have none, by name.
    """

    findings: dict[str, Finding]
    absent: dict[str, str]

    @property
    def causes(self) -> list[Cause]:
        """The causes of the findings."""
        return [cause for finding in self.findings.values() for cause in finding.causes]

    @property
    def remarks(self) -> list[str]:
        """What the findings remark, those of the filter itself first."""
        findings = sorted(
            self.findings.values(), key=lambda finding: not isinstance(finding, OfFilter)
        )
        return [remark for finding in findings for remark in finding.remarks]

    def rows(self, between: Sequence[Row] = ()) -> list[Row]:
        """Return the rows of all findings, and which other checks have none, by the reason.

        between: rows that stand below those of log and estimates, and above those of checks.
        """
        first = [f for f in self.findings.values() if isinstance(f, Basis)]
        others = [f for f in self.findings.values() if not isinstance(f, Basis)]
        basis, found = ([row for f in part for row in f.rows()] for part in (first, others))
        missing: dict[str, list[str]] = {}
        for key, why in self.absent.items():
            missing.setdefault(why, []).append(key.replace("_", " "))
        unchecked = [Row("Not checked", ", ".join(n), why) for why, n in missing.items()]
        return [*basis, *between, *found, *unchecked]

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Return the lines of a summary that findings have, a name and words each."""
        return [line for finding in self.findings.values() for line in finding.lines]

    @property
    def entries(self) -> dict[str, Any]:
        """Return the entries of a result file."""
        return {
            key: entry
            for finding in self.findings.values()
            for key, entry in finding.entries.items()
        }

    def value(self, kind: type[Of[V]]) -> V | None:
        """Return the value of a finding of a kind, None where no check has it."""
        found = self.findings.values()
        return next((finding.value for finding in found if isinstance(finding, kind)), None)
