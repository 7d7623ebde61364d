"""What a document claims, with the number that was measured here and the limit it must keep."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, SupportsFloat

import numpy as np
from numpy.typing import NDArray

from comparisons.figures import finite

Relation = Literal["at most", "at least", "within"]
Cause = Literal["the document's", "not testable here", "ours"]


@dataclass(frozen=True)
class Why:
    """Why a claim does not hold, as far as known, and whose the cause is."""

    cause: Cause
    text: str


theirs = partial(Why, "the document's")
"""The claim is not true of the document's own method and terms."""
elsewhere = partial(Why, "not testable here")
"""The document's log, or its world where it is not stated, is another than ours."""
ours = partial(Why, "ours")
"""Our method, world or yardstick differs from the document's."""


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A claim of a document and what was measured.

    Attributes:
        text: the claim, and of what the figure is.
        measured: the figure; null where it is not finite.
        relation: how the figure must stand to the limit.
        limit: the limit.
        least: lower end of what is asked, where that is a band that the limit ends.
        own: whether the limit is ours, because the document has no number.
        unit: unit of figure and limit.
        asked: relation, limits and unit in words.
        holds: whether the claim holds; without a figure it does not.
        cause: whose it is that the claim does not hold, where that is known.
        why: what is different here, where the claim does not hold and the reason is known.
        drives_least: the least of what each drive gives; null of a claim on all drives together.
        drives_most: the largest.
    """

    text: str
    measured: float | None
    relation: Relation
    limit: float
    least: float | None
    own: bool
    unit: str
    asked: str
    holds: bool
    cause: Cause | None
    why: str | None
    drives_least: float | None = None
    drives_most: float | None = None

    def over(self, drives: Sequence[SupportsFloat] | NDArray[Any]) -> Claim:
        """The claim with the spread of what each drive gives."""
        each = np.asarray(drives, dtype=float)
        return replace(
            self, drives_least=finite(float(each.min())), drives_most=finite(float(each.max()))
        )

    def explained(self, why: Why | None) -> Claim:
        """The claim with this cause, none where it holds."""
        known = None if self.holds else why
        cause, text = (None, None) if known is None else (known.cause, known.text)
        return replace(self, cause=cause, why=text)


def in_words(measured: float | None, unit: str, spread: tuple[float | None, float | None]) -> str:
    """Return a figure with its unit, and its spread over the drives where it has one."""
    least, most = spread
    text = "none" if measured is None else f"{measured:.3g} {unit}".rstrip()
    return text if least is None or most is None else f"{text} ({least:.3g} to {most:.3g} by drive)"


Claims = Iterator[Claim]


def at_most(
    text: str,
    measured: SupportsFloat,
    limit: float,
    unit: str = "",
    why: Why | None = None,
    *,
    own: bool = False,
) -> Claim:
    """A claim whose number must not exceed the limit. own: the document has no number."""
    return _claim(text, float(measured), (-math.inf, limit), unit, own).explained(why)


def at_least(
    text: str,
    measured: SupportsFloat,
    limit: float,
    unit: str = "",
    why: Why | None = None,
    *,
    own: bool = False,
) -> Claim:
    """A claim whose number must reach the limit. own: the document has no number."""
    return _claim(text, float(measured), (limit, math.inf), unit, own).explained(why)


def within(
    text: str,
    measured: SupportsFloat,
    band: tuple[float, float],
    why: Why | None = None,
    *,
    own: bool = False,
) -> Claim:
    """A claim whose number must lie in a band. own: the document has no number."""
    return _claim(text, float(measured), band, "", own).explained(why)


def _claim(text: str, measured: float, band: tuple[float, float], unit: str, own: bool) -> Claim:
    low, high = band
    relation: Relation = (
        "at most" if low == -math.inf else "at least" if high == math.inf else "within"
    )
    words = {"at most": f"at most {high:.3g}", "at least": f"at least {low:.3g}",
             "within": f"{low:.3g} to {high:.3g}"}  # fmt: skip
    return Claim(
        text=text,
        measured=finite(measured),
        relation=relation,
        limit=low if relation == "at least" else high,
        least=low if relation == "within" else None,
        own=own,
        unit=unit,
        asked=f"{words[relation]} {unit}".rstrip() + " (ours)" * own,
        holds=math.isfinite(measured) and low <= measured <= high,
        cause=None,
        why=None,
    )
