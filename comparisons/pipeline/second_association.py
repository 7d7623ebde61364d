"""The smoother's own association, which a run asks for by itself where nothing else could tell.

It is asked where its work is bounded: by a count, so that a run repeats on every machine.
"""

from __future__ import annotations

from comparisons.adapters.ekf_run import EkfRun
from comparisons.config import RunConfig
from comparisons.extensions.interface import Extension
from comparisons.extensions.registry import config_class
from comparisons.pipeline.prepare import Prepared

NAME = "own_association"
MOST_PAIRS = 5_000_000
"""Pairs of measurement and landmark up to which a run makes the second association unasked."""


def own_association(prepared: Prepared[RunConfig], run: EkfRun) -> tuple[Extension | None, str]:
    """Return the check by the smoother's own association, or why it is not made.

    Neither where the configuration asks for it.
    """
    if NAME in prepared.config.extensions:
        if any(one.asked for one in prepared.extensions if one.name == NAME):
            return None, ""
        return None, "the association is unchecked, as --smoother-association ekf asks"
    pairs = len(run.landmark_index) * len(run.estimate.landmark)
    if pairs > MOST_PAIRS:
        return None, (
            f"the association is unchecked: {pairs / 1e6:.1f} million pairs of measurement and "
            f"landmark, more than {MOST_PAIRS / 1e6:.0f} million, are many for the smoother's own; "
            "ask for it with --smoother-association own"
        )
    return config_class(NAME).of().build(prepared.config), ""
