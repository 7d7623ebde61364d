"""What a check is: one question about a job.

A check reads what the job knows. It returns a `Finding`, or says why there is none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar

from comparisons.checks.finding import Absent, Finding, Findings, LackingError
from comparisons.shown import Brief
from comparisons.words import Explanation

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


T = TypeVar("T")
K = TypeVar("K", bound=Findings)
EVENTS = "a filter with the events that it went through"
"""What checks of a filter need."""


class Question(Generic[K]):
    """One question about a job, which is the first line of a check's docstring."""

    name = ""
    """Its key in a result, and what `slamcheck explain` calls it."""
    needs = ""
    """What a job must have for an answer."""
    errs = ""
    """How often it says something wrong of what is sound, as far as that is measured."""
    of = "a check"
    """What `slamcheck explain` calls its kind."""
    explains: ClassVar[Mapping[str, Explanation]] = {}
    """The kinds of cause that it alone finds, by the name that each has in a result."""
    figures: tuple[tuple[str, type], ...] = ()
    """What it adds to the result: keys, and the class, of a list that of its rows, that describes
    every field."""

    def find(self, known: K) -> Finding | Absent | None:
        """Return the answer, or why there is none; None where nothing was asked.

        Raises LackingError for what the job does not know.
        """
        raise NotImplementedError

    def ask(self, known: K) -> None:
        """Keep what is found among what the job knows, or why there is nothing; once.

        Raises InputError.
        """
        if self.name in {*known.findings, *known.absent}:
            return
        try:
            found = self.find(known)
        except LackingError as reason:
            found = Absent(str(reason))
        if isinstance(found, Absent):
            known.absent[self.name] = found.why
        elif found is not None:
            known.findings[self.name] = found


class Check(Question["Known"]):
    """One question about a job on a log."""


class About(Question["Known"]):
    """What the gaps of a job are of: it judges nothing, and finds a `Basis` in every such job."""

    of = "a part of a job"
    errs = "not at all: it judges nothing"


class FromJob(Question["Known"]):
    """What a job has found itself, in the place of a check."""

    of = "a part of a job"

    def __init__(self, name: str, finding: Finding) -> None:
        """name: as of a check. finding: which reports show as those of checks."""
        self.name, self._finding = name, finding

    def find(self, known: Known) -> Finding:
        """Return it."""
        return self._finding


@dataclass(frozen=True, repr=False)
class Answers(Brief):
    """What checks find, once somebody wants to know it.

    before: what is known without them. checks: in the order in which one reads another's finding.
    """

    before: Known
    checks: Sequence[Question[Known]]

    @cached_property
    def known(self) -> Known:
        """The same with the findings; what others have found before comes last."""
        before = self.before
        found = replace(before, findings=dict(before.findings), absent=dict(before.absent))
        with found.prepared.clock.stage("checks"):
            for check in self.checks:
                check.ask(found)
        order = [*(one.name for one in self.checks), *before.findings, *before.absent]
        _sort(found.findings, order)
        _sort(found.absent, order)
        return found


def _sort(found: dict[str, T], order: Iterable[str]) -> None:
    for name in dict.fromkeys(order):
        if name in found:
            found[name] = found.pop(name)
