"""High level landmarks in `result.json`, and as rows of figures."""

from __future__ import annotations

import numpy as np

from comparisons.extensions.high_level.source import HighLevelRun
from comparisons.figures import Model
from comparisons.words import Row


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


def high_level_rows(made: HighLevelResult) -> list[Row]:
    """Return what was searched, found and kept, and how often it was measured."""
    counts = {
        "searches of the dense map": made.searches,
        "corners found": made.corners,
        "pairs of corners tried": made.pairs,
        "candidates with too few Gaussians": made.poor,
        "landmarks found": made.found,
        "landmarks measured again and kept": made.kept,
        "landmarks deactivated where something moves": made.deactivated,
        "measurements": made.looks.get("seen", 0),
        **{f"no measurement: {why}": n for why, n in made.looks.items() if why != "seen"},
    }
    return [
        Row("High level landmarks", name, f"{count:,}")
        for name, count in counts.items()
        if count is not None
    ]


class HighLevelResult(Model):
    """Entry `high_level`: high level landmarks.

    See comparisons.extensions.high_level.source.HighLevelRun.

    Attributes:
        searches: searches of the dense map.
        corners: corners of all searches; None in results of before they were counted.
        pairs: pairs of corners of all searches; None as above.
        candidates: candidates for a landmark.
        poor: candidates with too few Gaussians.
        found: candidates that a search accepted.
        kept: landmarks that were seen again, and since then are in the state.
        deactivated: landmarks that are no longer used, since their template is where something
            moves.
        looks: attempts to measure a landmark within reach, by outcome, `seen` among them.
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
