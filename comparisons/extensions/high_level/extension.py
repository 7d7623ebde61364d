"""High level landmarks beside the filter: found in a dense map, seen in the scans."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes

from comparisons.adapters.filter_setup import FilterSetup
from comparisons.checks.finding import Finding
from comparisons.config import Configured
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.source import DenseWatcher
from comparisons.extensions.high_level.config import HighLevelConfig
from comparisons.extensions.high_level.source import (
    SEARCHED,
    HighLevelOptions,
    HighLevelRun,
    HighLevelSource,
)
from comparisons.figures import rows_of
from comparisons.pipeline.extension import Extension
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepared import Prepared
from comparisons.report.html.drawing import Drawing
from comparisons.words import Row


class HighLevel(Extension):
    """Which corners of the dense map are landmarks?

    Puts a source beside the filter; a dense map of the same cells serves both.
    """

    name = "high_level"
    needs = "scans"
    errs = "not at all: it gives the estimators landmarks"
    figures = (("high_level", HighLevelRun),)

    def __init__(self, settings: HighLevelConfig, config: Configured) -> None:
        """Of a dense map the options are those of the preset."""
        super().__init__(settings, config)
        dense = DenseMapsConfig.of(**config.settings_of("dense_maps").model_dump())
        self.options = HighLevelOptions.of(settings, dense)

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        """Search the map that is there, if it is alike, else one of its own."""
        shared = setup.find(DenseWatcher)
        if shared is not None and self.options.served_by(shared.options):
            shared.keep_also(SEARCHED)
        else:
            shared = None
        setup.source = HighLevelSource(prepared.log, self.options, shared)
        setup.offers.append(setup.source)

    def find(self, known: Known) -> HighLevelFinding | None:
        """Report what became of the search."""
        source = known.setup.find(HighLevelSource)
        return None if source is None else HighLevelFinding(source.run())


class HighLevelFinding(Finding):
    """made: what became of the search."""

    def __init__(self, made: HighLevelRun) -> None:
        """No causes: whether the landmarks agree is part of the agreement."""
        self.made = made
        self.entries = {"high_level": made}

    def rows(self) -> Sequence[Row]:
        """Return what was searched, found and kept, and how often it was measured."""
        made, group = self.made, "High level landmarks"
        counts = {"measurements": made.looks.get("seen", 0)}
        counts |= {f"no measurement: {why}": n for why, n in made.looks.items() if why != "seen"}
        return [*rows_of(group, made), *(Row(group, name, f"{n:,}") for name, n in counts.items())]

    def draw(self, axis: Axes) -> None:
        """Draw rectangles and axes."""
        from comparisons.extensions.high_level.figure import draw_high_level

        draw_high_level(axis, self.made)

    def layers(self, drawing: Drawing) -> None:
        """Add rectangles and axes."""
        from comparisons.extensions.high_level.figure import high_level_layers

        high_level_layers(drawing, self.made)
