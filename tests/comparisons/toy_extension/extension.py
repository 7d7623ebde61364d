"""The docking station beside the filter, and what became of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import BaseModel

from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.pose_landmark_measurements import PoseLandmarkRecorder
from comparisons.checks.finding import Finding
from comparisons.errors import InputError
from comparisons.logs.log import Poses
from comparisons.pipeline.extension import Extension
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepared import Prepared
from comparisons.report.picture import blank
from comparisons.words import Row
from ekf_reference.core.ekf import NEW, Ekf
from tests.comparisons.toy_extension.config import DockingConfig

NOISE = np.diag((0.05, 0.05, 0.01)) ** 2


class DockingResult(BaseModel):
    """The entry of `result.json`."""

    measurements: int
    ekf_m: tuple[float, float]
    smoother_m: tuple[float, float]


class DockingSource:
    """Sees the station from where the vehicle truly is."""

    def __init__(self, config: DockingConfig, truth: Poses) -> None:
        self._config, self._truth = config, truth
        self._landmark_index = NEW
        self.measurements = 0

    def look(self, ekf: Ekf, epoch: int, time_s: float, recorder: PoseLandmarkRecorder) -> None:
        pose = self._truth.at(np.array([time_s]))[0]
        away = np.array((self._config.x_m, self._config.y_m)) - pose[:2]
        if np.hypot(*away) > self._config.reach_m:
            return
        c, s = np.cos(pose[2]), np.sin(pose[2])
        z = np.array((c * away[0] + s * away[1], c * away[1] - s * away[0], -pose[2]))
        z[0] += self._config.bias_m * (self.measurements % 2)
        found = recorder.observe(ekf, epoch, z[None], NOISE[None], np.array([self._landmark_index]))
        self._landmark_index, self.measurements = int(found[0]), self.measurements + 1


class Docking(Extension):
    """Puts the source beside the filter."""

    name = "docking"
    settings: DockingConfig

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        if prepared.log.truth.poses is None:
            raise InputError(f"{prepared.log.name}: holds no true poses, which docking needs")
        setup.source = DockingSource(self.settings, prepared.log.truth.poses)
        setup.offers.append(setup.source)

    def find(self, known: Known) -> DockingFinding | None:
        source = known.setup.find(DockingSource)
        return None if source is None or not source.measurements else DockingFinding(known, source)


class DockingFinding(Finding):
    """Where both estimators have the station."""

    def __init__(self, known: Known, source: DockingSource) -> None:
        ekf, smoother = (e.pose_landmarks[0, :2] for e in (known.ekf.estimate, known.gaps.smoothed))
        self.result = DockingResult(
            measurements=source.measurements, ekf_m=_pair(ekf), smoother_m=_pair(smoother)
        )
        self.entries = {"docking": self.result}
        self.remarks = [f"the station was seen {source.measurements} times"]

    def rows(self) -> Sequence[Row]:
        return [Row("Docking", "measurements", str(self.result.measurements))]

    def draw(self, axis: Axes) -> None:
        axis.plot(*self.result.ekf_m, "P", color="purple", label="docking station")

    def figures(self) -> Mapping[str, Figure]:
        figure = blank(3.0, 3.0)
        self.draw(figure.subplots())
        return {"docking": figure}


def _pair(place: NDArray[np.float64]) -> tuple[float, float]:
    return float(place[0]), float(place[1])
