"""What the filter learnt of its global heading, which nothing measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from comparisons.audit.own_filter import run_events
from comparisons.audit.spurious import HEADING, Learnt, learnt
from comparisons.checks.check import Check
from comparisons.checks.finding import Absent, Of
from comparisons.figures import LeftOut, Less, Model, finite
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known

_NO_HEADING_DEG = 180.0
"""A heading that is known with a larger standard deviation is not known."""


class SpuriousShareResult(Model):
    """The update with which spurious information grew most.

    Attributes:
        time_s: its time.
        landmark: the landmark of it that added most, in words; both of a merge.
        information: what it added [1/rad^2].
    """

    time_s: LeftOut[float]
    landmark: str
    information: Less[float]


class SpuriousHeadingResult(Model):
    """What the filter's own equations hold about its global heading, which nothing measured.

    Prior, absolute positions and the right sides of the equations play no part. With an ideal
    linearisation all of it is zero, as is what rounding explains. See comparisons.audit.spurious.

    Attributes:
        information: in total [1/rad^2].
        sigma_deg: standard deviation of the heading by this information; None without any.
        fastest_s: stretch of time, of a hundredth of the updates, in which it grew most.
        fastest: what it gained there [1/rad^2].
        largest: the update with which it grew most; None without any.
        time_s: ends of the stretches, from the start.
        growth: information gathered until then [1/rad^2].
    """

    information: Less[float]
    sigma_deg: LeftOut[float | None]
    fastest_s: tuple[float, float]
    fastest: Less[float]
    largest: LeftOut[SpuriousShareResult | None]
    time_s: list[float]
    growth: list[float]


class SpuriousFinding(Of[Learnt]):
    """What was learnt of directions that no sensor can tell."""

    def __init__(self, information: Learnt) -> None:
        """found: of all directions."""
        self.result = spurious_heading_result(information)
        super().__init__(information, entries={"spurious_heading": self.result})

    def rows(self) -> Sequence[Row]:
        """Return what was learnt of the heading."""
        return spurious_rows(self.result)


class CheckSpurious(Check):
    """Did the filter learn its global heading from measurements that cannot tell it?"""

    name = "spurious_heading"
    needs = "landmarks that are not surveyed"
    errs = "not at all: it explains a linearisation gap and makes none"
    figures = (("spurious_heading", SpuriousHeadingResult),)

    def find(self, known: Known) -> SpuriousFinding | Absent:
        """Return what it learnt, with or without positions and prior."""
        information = learnt(run_events(known.ekf))
        if information is None:
            return Absent("landmarks are surveyed, so that measurements observe the heading")
        return SpuriousFinding(information)


def spurious_heading_result(found: Learnt) -> SpuriousHeadingResult:
    """Return what the filter learnt of its heading from what cannot tell it."""
    heading, (begin_s, end_s, gained) = found.of(HEADING), found.fastest(HEADING)
    time_s, information = found.curve(HEADING)
    largest = None
    if (most := heading.largest) is not None and most.time_s is not None:
        largest = SpuriousShareResult(
            time_s=most.time_s, landmark=most.seen, information=most.information
        )
    return SpuriousHeadingResult(
        information=heading.information,
        sigma_deg=finite(heading.sigma),
        fastest_s=(begin_s, end_s),
        fastest=gained,
        largest=largest,
        time_s=time_s.tolist(),
        growth=information.tolist(),
    )


def spurious_rows(result: SpuriousHeadingResult) -> list[Row]:
    """Return what the filter learnt of its heading without measuring it."""
    group = "Absolute heading that no measurement observes"
    if result.sigma_deg is None or result.sigma_deg > _NO_HEADING_DEG:
        return [Row(group, "standard deviation", "none claimed")]
    rows = [Row(group, "standard deviation", f"{result.sigma_deg:.3g} deg")]
    if result.largest is not None:
        begin_s, end_s = result.fastest_s
        share = 100.0 * result.fastest / result.information
        fastest = f"{begin_s:.1f} to {end_s:.1f} s ({share:.0f} % of it)"
        rows.append(Row(group, "gained fastest", fastest))
        most = result.largest
        rows.append(
            Row(group, "largest gain by one update", f"{most.landmark} at {most.time_s:.1f} s")
        )
    return rows
