"""What a check is: one question about a job.

A check reads what the job knows. It returns a `Finding`, or says why there is none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from comparisons.checks.finding import Absent, Finding

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


class Check:
    """One question about a job, which is the first line of a check's docstring."""

    name = ""
    """Its key in a result, and what `slamcheck explain` calls it."""
    needs = ""
    """What a job must have for an answer."""
    errs = ""
    """How often it says something wrong of what is sound, as far as that is measured."""
    figures: tuple[tuple[str, type], ...] = ()
    """What it adds to the result: keys, and the class, of a list that of its rows, that describes
    every field."""

    def find(self, known: Known) -> Finding | Absent | None:
        """Return the answer, or why there is none; None where nothing was asked."""
        raise NotImplementedError

    def ask(self, known: Known) -> None:
        """Keep what is found among what the job knows, or why there is nothing.

        Raises InputError.
        """
        found = self.find(known)
        if isinstance(found, Absent):
            known.absent[self.name] = found.why
        elif found is not None:
            known.findings[self.name] = found
