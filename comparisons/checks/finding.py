"""What a check finds, which every report renders.

A report asks a finding for entries of the result file, rows, a line, pictures and sections, and
knows no check by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

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
    line: tuple[str, str] | None = None
    """Its line of what the command prints: a name of at most 12 letters, and words."""
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


class OfFilter(Of[V]):
    """What is found of a filter by itself, and first decides about it; its remarks come first."""


class Absent(NamedTuple):
    """No finding. why: what the job lacks for it, as `the log has no truth`."""

    why: str


class LackingError(Exception):
    """What a check asks for is not known in a job, for a reason in words."""
