"""High level landmarks in `result.json`, and as a row of the table."""

from __future__ import annotations

import numpy as np

from comparisons.extensions.high_level.source import HighLevelRun
from comparisons.report.model import Model


def high_level_result(run: HighLevelRun) -> HighLevelResult:
    """Return what became of them."""
    return HighLevelResult(
        searches=run.searches,
        corners=run.corners,
        pairs=run.pairs,
        candidates=run.candidates,
        poor=run.poor,
        found=len(run.landmark_index),
        kept=int(np.count_nonzero(run.landmark_index >= 0)),
        deactivated=run.moving,
        looks=dict(sorted(run.looks.items())),
    )


def high_level_text(made: HighLevelResult) -> str:
    """Found, kept, seen, in a line."""
    rest = ", ".join(f"{n} {name}" for name, n in made.looks.items() if name != "seen")
    return (
        f"{made.found} landmarks found in {made.searches} searches ({made.corners} corners, "
        f"{made.pairs} pairs, {made.poor} with too few Gaussians), {made.kept} kept"
        + (f", {made.deactivated} deactivated where something moves" if made.deactivated else "")
        + "; "
        + f"{made.looks.get('seen', 0)} measurements"
        + (f" ({rest})" if rest else "")
    )


class HighLevelResult(Model):
    """High level landmarks. See comparisons.extensions.high_level.source.HighLevelRun.

    corners, pairs: of all searches, None in results of before they were counted. found: accepted by
    one. kept: seen again, and since then in the state. deactivated: used no more, since their
    template lies where something moves. looks: at those within reach, by outcome, `seen` among
    them.
    """

    searches: int
    corners: int | None = None
    pairs: int | None = None
    candidates: int
    poor: int
    found: int
    kept: int
    deactivated: int = 0
    looks: dict[str, int]
