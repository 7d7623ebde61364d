"""What the dense map finds to be moving is ignored by the filter."""

from __future__ import annotations

from typing import Any

from comparisons.adapters.filter_setup import FilterSetup
from comparisons.checks.finding import Finding
from comparisons.extensions.dense_maps.source import DenseWatcher
from comparisons.extensions.dynamic.config import DynamicConfig
from comparisons.pipeline.extension import Extension
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepared import Prepared
from ekf_reference.dense.dynamic import Differencing, places


class Dynamic(Extension):
    """Where does something move?

    Makes the dense map the filter's guard.
    """

    name = "dynamic"
    needs = "a dense map"
    errs = "not at all: what it finds changes no verdict"
    settings: DynamicConfig

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        """The map, which comes before, knows where things move."""
        watcher = setup.find(DenseWatcher)
        if watcher is not None:
            watcher.difference_by(Differencing(**self.settings.model_dump()))
        setup.guard = watcher

    def find(self, known: Known) -> DynamicFinding | None:
        """Report what was found, and whether most of it could be looked at."""
        watcher = known.setup.find(DenseWatcher)
        return None if watcher is None else DynamicFinding(watcher)


class DynamicFinding(Finding):
    """Where something moves. What the filter left out is counted with the filter's figures."""

    def __init__(self, watcher: DenseWatcher) -> None:
        """watcher: with the layer of what moves."""
        layer = watcher.dense.dynamic
        if layer is None:
            return
        placed = watcher.dense.regions.placed(watcher.dense.landmark)
        count = int(places(layer.points(placed)).max(initial=-1)) + 1
        area = f"{layer.area_m2(placed):.1f} m^2"
        found = f"something moves in {count} places, with a total area of {area}"
        self.remarks = [found if count else "no motion was detected"]
        moves = layer.counters
        if moves.compared > moves.deformed:
            return
        why = "no region had two maps to compare; a region needs three landmarks"
        if pairs := moves.compared + moves.deformed:
            why = (
                f"{moves.deformed} of {pairs} pairs of maps could not be compared, since the shape "
                "of their region changed; a region needs three static landmarks"
            )
        self.remarks.append(f"motion could hardly be detected: {why}")
