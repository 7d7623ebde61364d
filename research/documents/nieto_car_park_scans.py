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
from scipy.spatial import cKDTree

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array
from comparisons.config import EkfConfig, RunConfig
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.figure import draw_cloud
from comparisons.extensions.scan_landmarks.result import in_words, template_rule
from comparisons.extensions.scan_landmarks.source import LogScans, ScanSlamSource
from comparisons.jobs.run import run_filter
from comparisons.logs.log import Log, Poses
from comparisons.logs.transforms.published_sigmas import SensorSigmas, with_published_sigmas
from comparisons.pipeline.prepare import prepare
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR, ellipses
from comparisons.settings import configure, run_options
from graphslam.scan import planar
from research.documents.claims import Claim, Claims, at_least, at_most, elsewhere
from research.documents.drawing import chart, draw_lines, frame, plan
from research.documents.interface import Experiment, Figure
from research.documents.measures import (
    SHARE_WITHIN_3_SIGMA,
    mean,
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
    axes_at,
    first_measurements,
    scan_map,
)

LANDMARKS = 6
"""That the thesis' run incorporated."""
TURN_S = 90.0
"""In the turn that begins here the steering reads 0.60 rad, its end: both paths leave GPS by metres
from here on, until 110 s feature SLAM does not."""
_JOINED = "with joined segments (ours)"


@dataclass(frozen=True)
class Aligned:
    """A landmark seen again, in the vehicle's frame. template: (P, 2), scan: (R, 2) [m].

    away_m: (P,) distances of the template's points to the nearest return.
    """

    template: Array
    scan: Array
    away_m: Array

    @property
    def off_m(self) -> float:
        """Their median."""
        return float(np.median(self.away_m))


@dataclass(frozen=True, kw_only=True)
class CarParkRun:
    """One form of Scan-SLAM.

    templates: the rule, in words. path: (K, 2). path_gps: (G',) distances to GPS at its times.
    held: the map at the end. first_s: (Q,) when each of its landmarks was seen first. aligned: all
    measurements used but each landmark's first.
    """

    templates: str
    path: Array
    path_gps: Array
    held: ScanMap
    first_s: Array
    aligned: tuple[Aligned, ...]

    @property
    def shown(self) -> Aligned:
        """The alignment that is as good as half of them are."""
        order = sorted(self.aligned, key=lambda one: one.off_m)
        if not order:
            raise InputError("no landmark was seen again")
        return order[len(order) // 2]


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
    published, joined = (_scan_slam(log, reference, scans, o) for o in (_PUBLISHED, {}))
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


def _scan_slam(
    log: Log, reference: Poses, scans: LogScans, options: Mapping[str, str]
) -> CarParkRun:
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
    first = first_measurements(run)[held.landmark_index]
    return CarParkRun(
        templates=in_words(template_rule(source.options)),
        path=estimate.pose[:, :2],
        path_gps=off_gps(log, estimate.time_s, estimate.pose),
        held=held,
        first_s=estimate.time_s[run.pose_landmarks.pose[first]],
        aligned=_aligned(run, scans, source),
    )


def _aligned(run: EkfRun, scans: LogScans, source: ScanSlamSource) -> tuple[Aligned, ...]:
    seen, found = run.pose_landmarks, []
    number = np.searchsorted(scans.time_s, run.estimate.time_s[seen.pose])
    for row in np.setdiff1d(np.arange(len(seen.landmark)), first_measurements(run)).tolist():
        points = source.found.template[int(seen.landmark[row])].shape.mean
        template = planar.moved(seen.measured[row], points)
        scan = scans.scan(int(number[row]), np.zeros(3)).point
        found.append(Aligned(template, scan, cKDTree(scan).query(template)[0]))
    return tuple(found)


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
    yield at_least(text, thesis / feature, 1.0, why=why)
    text = f"so they are not {_JOINED} (the same)"
    yield at_least(text, ours / feature, 1.0, why=why)
    text = (
        "more information in the templates improves them (the same distance, joined segments, "
        "ours, over the thesis' form)"
    )
    yield at_most(text, ours / thesis, 1.0, why=why)


def _claims_5_11(found: CarParkScans) -> Claims:
    yield _consistent("the landmark covariances are consistent with the errors", found.published)
    yield _consistent(f"so they are {_JOINED}", found.joined)


def _consistent(text: str, run: CarParkRun) -> Claim:
    held, early = run.held, run.first_s < TURN_S
    share = mean(held.within)
    sigma = np.sqrt(np.trace(held.covariance, axis1=1, axis2=2) / 2.0)
    why = elsewhere(
        f"{OTHER_PART}: {np.count_nonzero(held.within)} of {len(held.landmark_index)} "
        "landmarks, off by "
        f"{held.rms_m:.2f} m (RMS) with a sigma of {np.sqrt(np.mean(sigma**2)):.2f} m; of "
        f"those first seen before {TURN_S:.0f} s, when a turn begins in which the steering "
        f"reading saturates, {np.count_nonzero(held.within[early])} of {early.sum()}"
    )
    text = f"{text} (share of landmarks within 3 sigma of where SLAM with GPS saw them first)"
    return at_least(text, share, SHARE_WITHIN_3_SIGMA, why=why)


def _claims_5_12(found: CarParkScans) -> Claims:
    yield _on_the_scan("the alignment lays the template on the scan", found.published)
    yield _on_the_scan(
        f"so it does {_JOINED}", found.joined, "; half of a joined template need be in view"
    )


def _on_the_scan(text: str, run: CarParkRun, besides: str = "") -> Claim:
    off, limit_m = [one.off_m for one in run.aligned], SensorSigmas().range_m
    near = np.median([np.mean(one.away_m <= limit_m) for one in run.aligned])
    why = elsewhere(
        f"{OTHER_PART}: {len(off)} measurements, {near:.0%} of the points have a return within "
        f"the limit (median){besides}"
    )
    text = (
        f"{text} (median distance of its points to the nearest return, median of all "
        "measurements used; limit: Table A.1's sigma of range)"
    )
    return at_most(text, median(off), limit_m, "m", why=why, own=True)


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


def _draw_5_11(canvas: Canvas, found: CarParkScans) -> None:
    for axis, run, form in _both(canvas, found):
        _templates(axis, run)
        draw_lines(axis, axes_at(run.held.place, 3.0), EKF_COLOUR, "axes", 1.0, 4)
        plan(axis, f"{form}: {len(run.held.landmark_index)} landmarks")
    canvas.axes[0].legend(fontsize=8, loc="lower left")


def _draw_5_12(canvas: Canvas, found: CarParkScans) -> None:
    left, right = canvas.subplots(1, 2)
    for axis, run, form in zip((left, right), (found.published, found.joined), _FORMS, strict=True):
        one = run.shown
        axis.plot(*one.scan.T, ".", color=SMOOTHER_COLOUR, markersize=4, label="scan")
        axis.plot(*one.template.T, "o", color=EKF_COLOUR, markersize=4, markerfacecolor="none",
                  markeredgewidth=0.7, label="template")  # fmt: skip
        axis.set_aspect("equal")
        title = f"{form}: {one.off_m:.2f} m from the nearest returns (median)"
        chart(axis, title, "ahead [m]", "left [m]")


FIGURES = (
    Figure(
        name="N5.10", title="Car park, Scan-SLAM: path, templates and laser image",
        says="Six landmarks were incorporated. The results are not as accurate as those of feature "
        "SLAM, since segments sometimes tell too little; templates with more information would "
        "improve them." + OTHER_LOG,
        experiment=EXPERIMENT, draw=_draw_5_10, claims=_claims_5_10, size=(13.0, 7.0),
    ),
    Figure(
        name="N5.11", title="Car park, Scan-SLAM: map of the landmarks",
        says="The landmark covariances are consistent with the errors, so uncertainty "
        "remains." + OTHER_LOG,
        experiment=EXPERIMENT, draw=_draw_5_11, claims=_claims_5_11, size=(13.0, 7.0),
    ),
    Figure(
        name="N5.12", title="Car park, Scan-SLAM: alignment of a template with a scan",
        says="Scan matching lays the landmark's template on the whole new scan." + OTHER_LOG,
        experiment=EXPERIMENT, draw=_draw_5_12, claims=_claims_5_12, size=(13.0, 7.0),
    ),
)  # fmt: skip
