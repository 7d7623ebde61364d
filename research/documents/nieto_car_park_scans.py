"""Nieto 2005, section 5.7: Scan-SLAM on the car park, and what is claimed of it.

The log is that of `nieto_car_park`, another part of the drives than the thesis'. Beside the thesis'
form (`--landmarks scans --preset nieto-2005`, Table A.1 included) stands ours: all segments of a
scan joined in one template. Landmarks' errors are from where their axes are if the vehicle was
where feature SLAM with GPS has it when it first saw them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from comparisons.arrays import Array
from comparisons.config import EkfConfig, RunConfig
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.figure import draw_cloud
from comparisons.extensions.scan_landmarks.result import in_words, template_rule
from comparisons.extensions.scan_landmarks.source import LogScans, ScanSlamSource
from comparisons.jobs.run import run_filter
from comparisons.logs.log import Log, Poses
from comparisons.logs.transforms.published_sigmas import with_published_sigmas
from comparisons.pipeline.prepare import prepare
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR, ellipses
from comparisons.settings import configure, run_options
from research.documents.claims import Claims, at_least, at_most, elsewhere, within
from research.documents.drawing import draw_lines, frame, plan
from research.documents.interface import DocumentFigure, Experiment
from research.documents.measures import (
    median,
    off_gps,
)
from research.documents.nieto_car_park import (
    FOLDER,
    OTHER_LOG,
    OTHER_PART,
)
from research.documents.nieto_scan_slam import (
    ScanMap,
    scan_map,
)

LANDMARKS = 6
"""That the thesis' run incorporated."""
NOT_AS_ACCURATE = 1.0, 3.0
"""Of a distance from GPS over feature SLAM's: farther off, it is no estimate of the same path."""
_JOINED = "with joined segments (ours)"


@dataclass(frozen=True, kw_only=True)
class CarParkRun:
    """One form of Scan-SLAM.

    templates: the rule, in words. path: (K, 2). path_gps: (G',) distances to GPS at its times.
    held: the map at the end.
    """

    templates: str
    path: Array
    path_gps: Array
    held: ScanMap


@dataclass(frozen=True, kw_only=True)
class CarParkScans:
    """Both forms.

    feature_gps: (G',) of feature SLAM. reference: (N, 2) path by it and GPS at scans. image:
    (M, 2) laser image from there. gps: (G, 2).
    """

    log: str
    published: CarParkRun
    joined: CarParkRun
    feature_gps: Array
    reference: Array
    image: Array
    gps: Array


def car_park_scans(log: Log) -> CarParkScans:
    """Drive the log by reflectors, with GPS, and by both forms of Scan-SLAM. Raises InputError."""
    if log.positions is None:
        raise InputError(f"{log.name}: holds no positions")
    feature, aided = (
        run_filter(prepare(log, RunConfig(ekf=EkfConfig(gps=gps))))[0].estimate
        for gps in ("off", "on")
    )
    reference, scans = Poses(aided.time_s, aided.pose), LogScans(log)
    there = reference.at(scans.time_s)
    published, joined = (_scan_slam(log, reference, o) for o in (_PUBLISHED, {}))
    rules = f"the thesis': {published.templates}; ours: {joined.templates}"
    return CarParkScans(
        log=f"{log.name}, {log.duration_s:.0f} s, another part of the drives than the thesis'; "
        + rules,
        published=published,
        joined=joined,
        feature_gps=off_gps(log, feature.time_s, feature.pose),
        reference=there[:, :2],
        image=np.vstack([scans.scan(k, pose).point for k, pose in enumerate(there)]),
        gps=log.positions.position_m,
    )


_PUBLISHED = {"preset": "nieto-2005"}


def _scan_slam(log: Log, reference: Poses, options: Mapping[str, str]) -> CarParkRun:
    config = configure(
        RunConfig,
        flags=run_options({"landmarks": "scans", **options}),
        over={"log": {"source": FOLDER, "format": log.format}},
    )
    read = with_published_sigmas(log) if config.log.sigmas == "published" else log
    run, setup = run_filter(prepare(read, config))
    source = setup.find(ScanSlamSource)
    if source is None or run.breakdown is not None:
        raise InputError(f"{log.name}: {run.breakdown or 'no scan was looked at'}")
    estimate = run.estimate
    held = scan_map(source.found, run, reference)
    return CarParkRun(
        templates=in_words(template_rule(source.options)),
        path=estimate.pose[:, :2],
        path_gps=off_gps(log, estimate.time_s, estimate.pose),
        held=held,
    )


def _claims_5_10(found: CarParkScans) -> Claims:
    count = len(found.published.held.landmark_index)
    away = found.published.path_gps, found.joined.path_gps, found.feature_gps
    thesis, ours, feature = map(median, away)
    why = elsewhere(
        f"{OTHER_PART}: from GPS {thesis:.2f} m, joined {ours:.2f} m, feature SLAM {feature:.2f} m"
    )
    text = "six landmarks are incorporated (difference from six)"
    other = elsewhere(f"{OTHER_PART}: {count} landmarks")
    yield at_most(text, abs(count - LANDMARKS), 0, why=other)
    text = (
        "the results are not as accurate as those of feature-based SLAM (median distance from "
        "GPS over that of feature SLAM)"
    )
    yield within(text, thesis / feature, NOT_AS_ACCURATE, why=why, own=True)
    text = f"so they are not {_JOINED} (the same)"
    yield at_least(text, ours / feature, 1.0, why=why)
    text = (
        "more information in the templates improves them (the same distance, joined segments, "
        "ours, over the thesis' form)"
    )
    yield at_most(text, ours / thesis, 1.0, why=why)


EXPERIMENT = Experiment(
    "the car park, Scan-SLAM", lambda given: car_park_scans(given.log(FOLDER)), FOLDER
)


_MARGIN_M = 15.0
_SIGMA = 1.0
_FORMS = ("the thesis' form", "joined segments (ours)")


def _both(canvas: Canvas, found: CarParkScans) -> tuple[tuple[Axes, CarParkRun, str], ...]:
    """Two plans of the same part of the park."""
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    frame(left, found.reference, _MARGIN_M)
    runs = (found.published, found.joined)
    return tuple(zip((left, right), runs, _FORMS, strict=True))


def _draw_5_10(canvas: Canvas, found: CarParkScans) -> None:
    for axis, run, form in _both(canvas, found):
        draw_cloud(axis, found.image)
        axis.plot(*found.gps.T, "-", color=TRUTH_COLOUR, linewidth=1.0, label="GPS")
        axis.plot(*run.path.T, "-", color=EKF_COLOUR, linewidth=1.0, label="Scan-SLAM")
        _templates(axis, run)
        outline = ellipses(run.held.place[:, :2], run.held.covariance, _SIGMA)
        draw_lines(axis, outline, SMOOTHER_COLOUR, "landmarks, 1 sigma", 1.0, 4)
        off = np.median(run.path_gps)
        plan(
            axis, f"{form}: {len(run.held.landmark_index)} landmarks, {off:.2f} m from GPS (median)"
        )
    canvas.axes[0].legend(fontsize=8, loc="lower left")


def _templates(axis: Axes, run: CarParkRun) -> None:
    axis.plot(*run.held.placed.T, ".", color="#111111", markersize=1.5, label="templates", zorder=3)


FIGURES = (
    DocumentFigure(
        name="N5.10", title="Car park, Scan-SLAM: path, templates and laser image",
        says="Six landmarks were incorporated. The results are not as accurate as those of feature "
        "SLAM, since segments sometimes tell too little; templates with more information would "
        "improve them." + OTHER_LOG,
        experiment=EXPERIMENT, draw=_draw_5_10, claims=_claims_5_10, size=(13.0, 7.0),
    ),
)  # fmt: skip
