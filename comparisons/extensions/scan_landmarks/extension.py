"""Scan-SLAM: the log's scans, one by one, as measurements of landmarks made of scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from comparisons.adapters.filter_setup import FilterSetup
from comparisons.checks.finding import Finding
from comparisons.config import Configured
from comparisons.errors import InputError
from comparisons.extensions.scan_landmarks.config import ScanLandmarksConfig
from comparisons.extensions.scan_landmarks.result import (
    ScanLandmark,
    ScanSlamResult,
    published_rule,
    scan_slam_result,
    scan_slam_rows,
)
from comparisons.extensions.scan_landmarks.source import (
    LANDMARKS,
    LogScans,
    ScanSlamSource,
    scan_slam_options,
)
from comparisons.pipeline.extension import Extension
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepared import Prepared
from comparisons.report.html.drawing import Drawing
from comparisons.words import Row
from ekf_reference.scan_landmarks.merging import FusingOptions


class ScanLandmarksExtension(Extension):
    """Where are landmarks that are pieces of scans?

    options: of scan landmarks, which may be replaced before the first run.
    """

    name = "scan_landmarks"
    needs = "scans"
    errs = "not at all: it gives the estimators landmarks"
    figures = (("scan_slam", ScanSlamResult),)

    def __init__(self, settings: ScanLandmarksConfig, config: Configured) -> None:
        """Settings also say whether a dense map is anchored to the landmarks."""
        super().__init__(settings, config)
        self.options = scan_slam_options(settings, mapped="dense_maps" in config.extensions)
        self.brings_landmarks = settings.landmarks == "scans"
        self._scans: LogScans | None = None

    def prepare(self, prepared: Prepared[Any]) -> Prepared[Any]:
        """Let the filter stop at the scans; leave out what they take the place of."""
        log = prepared.log
        self._scans = LogScans(log)
        if self.brings_landmarks:
            none = log.measurements.chosen(np.zeros(len(log.measurements.time_s), dtype=bool))
            log = replace(log, measurements=none)
        return replace(prepared, log=log, epochs=self._scans.time_s)

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        """Put a source beside the filter that has seen no landmark yet."""
        if self._scans is None:
            raise InputError("scan landmarks: the log was not prepared")
        setup.kinds = LANDMARKS[self.settings.landmarks]
        fusing = FusingOptions() if self.settings.merge_landmarks else None
        setup.source = ScanSlamSource(self._scans, self.options, fusing)
        setup.offers.append(setup.source)

    def find(self, known: Known) -> ScanLandmarksFinding | None:
        """Report what the scans gave."""
        source = known.setup.find(ScanSlamSource)
        return None if source is None else ScanLandmarksFinding(known, source)


class ScanLandmarksFinding(Finding):
    """source: with the templates, and what became of their measurements."""

    def __init__(self, known: Known, source: ScanSlamSource) -> None:
        """No causes: whether the landmarks agree is part of the agreement."""
        self.source, self._known = source, known
        self.result = scan_slam_result(source, known.ekf.estimate, known.gaps)
        self.entries = {"scan_slam": self.result}

    def rows(self) -> Sequence[Row]:
        """Return how many agree, and what became of the measurements."""
        thesis = published_rule(self._known.prepared.log.format)
        return scan_slam_rows(self.result, thesis)

    def landmarks(self) -> Sequence[ScanLandmark]:
        """Return each with how it agrees."""
        return self.result.landmarks

    def draw(self, axis: Axes) -> None:
        """Draw templates, and both estimates' axes and ellipses."""
        from comparisons.extensions.scan_landmarks.figure import draw_scan_landmarks

        draw_scan_landmarks(axis, self._known, self.source.found)

    def layers(self, drawing: Drawing) -> None:
        """Add templates, ellipses and axes."""
        from comparisons.extensions.scan_landmarks.figure import scan_landmark_layers

        scan_landmark_layers(drawing, self._known, self.source.found)
