"""A dense map beside the filter, compared with the same scans placed by the smoother."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from comparisons.adapters.filter_setup import FilterSetup
from comparisons.checks.check import Finding
from comparisons.extensions.dense_maps.check import DenseAgreement, compare_dense, dense_cause
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.memory import Demand
from comparisons.extensions.dense_maps.source import DenseRun, DenseWatcher
from comparisons.extensions.interface import Extension
from comparisons.logs.log import Log
from comparisons.pipeline.gaps import Known
from comparisons.pipeline.prepare import Prepared
from comparisons.report.html.drawing import Drawing
from comparisons.words import Row
from ekf_reference.core.landmark_types import POINT


class DenseMaps(Extension):
    """Puts a watcher beside the filter, which others may use."""

    name = "dense_maps"
    settings: DenseMapsConfig

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        """Start an empty map, anchored to the landmarks that the filter will have.

        Raises InputError where it may need more memory than is allowed.
        """
        mapped = prepared.config.job == "map"
        demand = Demand(prepared.log, self.settings, points=POINT in setup.kinds, mapped=mapped)
        demand.check(prepared.log.name)
        watcher = DenseWatcher(prepared.log, self.settings, setup.kinds)
        setup.observers.append(watcher)
        setup.offers.append(watcher)

    def find(self, known: Known) -> DenseMapsFinding | None:
        """Compare the layers that were asked for with the smoother's."""
        watcher = known.setup.find(DenseWatcher)
        if watcher is None or not self.settings.layers:
            return None
        prepared = known.prepared
        with prepared.clock.stage("dense check"):
            prepared.progress("dense check", 0, 0)
            dense = watcher.run()
            found = compare_dense(prepared.log, dense, known.gaps.smoothed)
        return DenseMapsFinding(prepared.log, dense, found)


class DenseMapsFinding(Finding):
    """dense: the filter's map. agreement: with the smoother's, None with nothing in a region."""

    def __init__(self, log: Log, dense: DenseRun, agreement: DenseAgreement | None) -> None:
        """Maps that are apart are a reason to disagree."""
        self.dense, self.agreement, self._log = dense, agreement, log
        if agreement is None:
            count, rule = len(dense.dense.regions.base), dense.options.first_condition
            self.remarks = [
                f"no return fell into one of {count} regions ({rule}), so no dense maps could be "
                "compared"
            ]
            return
        self.entries = {"dense": agreement}
        if not agreement.agrees:
            self.causes = [dense_cause(agreement)]

    def rows(self) -> Sequence[Row]:
        """Return how far the maps are apart."""
        return [] if self.agreement is None else self.agreement.rows()

    def figures(self) -> Mapping[str, Figure]:
        """Return every layer over the smoother's returns."""
        from comparisons.extensions.dense_maps.figure import dense_check_figure

        if self.agreement is None:
            return {}
        return {"dense": dense_check_figure(self.dense, self.agreement, self._log)}

    def layers(self, drawing: Drawing) -> None:
        """Add what every layer holds occupied."""
        if self.agreement is not None:
            for name, layer in self.agreement.layers.items():
                drawing.dots(f"dense {name}", "#5b7c8d", layer.point)
