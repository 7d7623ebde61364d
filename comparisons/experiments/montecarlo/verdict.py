"""What a study says of its filters: where their mean NEES lie, as words and as a verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING

from comparisons.experiments.montecarlo.statistics import FilterFigures
from comparisons.statistics import LEVEL

if TYPE_CHECKING:
    from comparisons.experiments.montecarlo.study import StudyOutcome

_BAND = f"the {100 * LEVEL:.0f} % band"
_PLACES = {
    "above": f"above {_BAND}, too certain",
    "inside": f"inside {_BAND}",
    "below": f"below {_BAND}, too cautious",
    "not given": "no covariances",
}


def study_verdict(outcome: StudyOutcome) -> tuple[str, str]:
    """Return where the filters' NEES lie, in words, and the outcome that this is.

    The outcome is that of the user's filters if there are any: `agree` where all of NEES lies
    inside its band, `disagree` where some lies outside, `unverified` where it is unknown or a run
    failed.
    """
    alike: dict[str, list[str]] = {}
    for name, figures in outcome.filters.items():
        alike.setdefault(_places(figures), []).append(name)
    words = "; ".join(f"{', '.join(names)} {place}" for place, names in alike.items())
    judged = list(outcome.failures) or list(outcome.filters)
    places = {one.place for name in judged for one in outcome.filters[name].consistency.values()}
    if places & {"above", "below"}:
        return f"NEES: {words}", "disagree"
    if "not given" in places or any(outcome.failures.values()):
        return f"NEES: {words}", "unverified"
    return f"NEES: {words}", "agree"


def _places(figures: FilterFigures) -> str:
    """Where a filter's average NEES lie: what is not inside its band, else that all are."""
    by: dict[str, list[str]] = {}
    for quantity, nees in figures.consistency.items():
        by.setdefault(nees.place, []).append(quantity)
    if len(by) == 1:
        return _PLACES[next(iter(by))]
    by.pop("inside", None)
    return ", ".join(f"{_PLACES[place]}: {' and '.join(names)}" for place, names in by.items())
