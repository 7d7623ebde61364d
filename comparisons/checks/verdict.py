"""From causes to a verdict: which count, in which order, and what they decide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from comparisons.checks import causes as cause
from comparisons.config import FailOn
from comparisons.words import Cause, Decides

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known

_SHOWN = 2
"""Figures outside their bands that a summary names."""

Outcome = Literal["agree", "disagree", "unverified"]
RULES: dict[Decides, Outcome] = {
    "filter": "disagree",
    "always": "disagree",
    "open": "unverified",
    "verified": "disagree",
}
"""What decides an outcome, the first one first; without any of these it is `agree`."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The outcome, its causes (worst kind first), and remarks that change nothing.

    qualifiers: what a reader of the outcome must know as well. inconsistent: what of the filter's
    consistency is outside its band, None where nothing shows it. failed_on: those of `--fail-on`
    that the run fails on, whatever the outcome. See checks.qualifiers.
    """

    outcome: Outcome
    causes: tuple[Cause, ...]
    remarks: tuple[str, ...]
    qualifiers: tuple[str, ...] = ()
    inconsistent: tuple[str, ...] | None = None
    failed_on: tuple[FailOn, ...] = ()

    @property
    def headline(self) -> str:
        """The outcome with its qualifiers."""
        return ", ".join((self.outcome, *self.qualifiers))

    @property
    def summary(self) -> str:
        """The outcome with its qualifiers, and whether the filter is consistent, with figures."""
        found = self.inconsistent
        if not found:
            return (
                f"{self.headline}; filter "
                f"{'consistent' if found == () else 'consistency not judged'}"
            )
        *others, last = (self.outcome, *self.qualifiers)
        more = len(found) - _SHOWN
        shown = "; ".join(found[:_SHOWN]) + (f"; {more} more" if more > 0 else "")
        return f"{', '.join(others)}; {last} ({shown})"


def decided(causes: Sequence[Cause]) -> Outcome:
    """Return the outcome by the kinds of the causes (words.DECIDES), the first rule that is met."""
    kinds = {cause.decides(one.gap) for one in causes}
    return next((outcome for kind, outcome in RULES.items() if kind in kinds), "agree")


def judge(known: Known) -> Verdict:
    """Return the verdict on a filter, by the causes that its checks have found.

    What is wrong with the filter itself is a disagreement whatever the smoother found, for it
    compares the filter with linear algebra. Otherwise an optimum that is not verified gives no
    verdict at all.
    """
    causes, remarks, stopped = counting(known), known.remarks, known.ekf.breakdown
    if stopped and not any(one.gap == "breakdown" for one in causes):
        remarks = [f"{stopped}; all comparisons end at that time", *remarks]
    return Verdict(outcome=decided(causes), causes=tuple(causes), remarks=tuple(remarks))


def faulty(known: Known) -> bool:
    """Whether the filter itself is wrong, or nobody can tell: then no optimum is asked."""
    return known.records.untold or any(one.gap in cause.FILTER_FAULTS for one in known.causes)


def to_explain(known: Known) -> bool:
    """Whether the optimum shows something that others may explain."""
    return not faulty(known) and bool(counting(known))


def counting(known: Known) -> list[Cause]:
    """Return those of the causes that count, in the order of the catalogue.

    What is wrong with the filter itself stands alone, for the rest follows from it. By an optimum
    that is not verified nothing is a cause. What only explains counts beside others.
    """
    if first := [one for one in known.causes if one.gap in cause.FILTER_FAULTS]:
        return first
    decide = {one: cause.decides(one.gap) for one in known.causes}
    if "open" in decide.values():
        least = ("open",) if known.records.untold else ("open", "always", "never")
        decide = {one: rule for one, rule in decide.items() if rule in least}
    if not any(rule in RULES for rule in decide.values()):
        return []
    return sorted(decide, key=lambda one: cause.rank(one.gap))
