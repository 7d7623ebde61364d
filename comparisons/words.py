"""Words of reports that every floor may use."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, NamedTuple

GAPS = ("algebra", "model", "linearisation", "association", "matching", "truth")
"""Causes that are gaps between the estimates; other causes explain one, or stand beside."""
_NAMES = {"oracle": "optimum not verified"}
"""Of causes whose key in a result a reader would not understand."""
_FACT = re.compile(r"; (?![^(]*\))")
"""Between the facts of a cause's evidence; not within brackets."""
DEPARTURE = "first difference"
"""Of an estimate from a sound filter."""
SETTINGS = "Settings"
SPENT = ("Wall time", "Processor time")
"""Groups of rows that a page leaves out, for it has tables of its own for them."""


class Row(NamedTuple):
    """One figure of the table of figures, on the terminal and on the page.

    group: what the figure is of. quantity: what it measures, with the expected value if it has
    one. value: with its unit. band: where the value should lie. inside: whether it lies there;
    None where nothing says where it should lie.
    """

    group: str
    quantity: str
    value: str
    band: str = ""
    inside: bool | None = None


@dataclass(frozen=True)
class Cause:
    """One reason for the verdict.

    Attributes:
        gap: gap or check that found it, a kind that has an Explanation.
        evidence: what was found, with figures.
        hint: where to look, or what to do.
    """

    gap: str
    evidence: str
    hint: str


Decides = Literal["filter", "always", "open", "verified", "grade", "qualifies", "never"]
"""What a kind of cause makes of an outcome; the first of these that a job has counts."""
DECIDES: dict[Decides, str] = {
    "filter": "`disagree`; nothing is compared with the optimum",
    "always": "`disagree`, whether the optimum is verified or not",
    "open": "`unverified`",
    "verified": "`disagree`, if the optimum is verified",
    "grade": "the grade of `slamcheck check` decides; the cause explains it",
    "qualifies": "a qualifier beside the outcome",
    "never": "nothing; it explains another cause",
}
"""The same in words, for docs/verdicts.md."""


@dataclass(frozen=True)
class Explanation:
    """What a kind of cause is called, what it means, and what to check. Plain sentences.

    decides: what it makes of an outcome.
    """

    title: str
    meaning: str
    check: str
    decides: Decides = "verified"


def facts(evidence: str) -> list[str]:
    """Return the facts of a cause's evidence, one by one."""
    return _FACT.split(evidence)


def cause_name(key: str) -> str:
    """Return the name of a cause as reports have it. key: of the result, as `truth`."""
    return f"{key} gap" if key in GAPS else _NAMES.get(key, key)
