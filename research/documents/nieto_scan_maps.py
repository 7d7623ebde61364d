"""Nieto 2005, section 6.2.1: DenseSLAM between the landmarks of Scan-SLAM, Figs. 6.7 and 6.8."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Polygon

from comparisons.arrays import Array
from comparisons.config import MapConfig
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.accuracy import near_share, surface_error
from comparisons.extensions.dense_maps.config import DenseMapsConfig, Layer
from comparisons.extensions.dense_maps.figure import (
    DENSE_COLOUR,
    draw_occupied,
    draw_regions,
    draw_surfaces,
)
from comparisons.extensions.dense_maps.job import DenseMapping, map_log
from comparisons.extensions.dense_maps.source import BeforeClosing
from comparisons.extensions.scan_landmarks.config import ScanLandmarksConfig
from comparisons.extensions.scan_landmarks.figure import axes_of, place_covariances, template_points
from comparisons.extensions.scan_landmarks.source import LogScans, ScanSlamSource
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, ellipses
from ekf_reference.core.geometry import rotation, wrap_angle
from ekf_reference.scan_landmarks.local_context import LocalContext
from ekf_reference.scan_landmarks.map_aided_matching import enriched, observe_enriched
from ekf_reference.scan_landmarks.scan_slam import ScanLandmarks, ScanSlamOptions
from ekf_reference.scan_landmarks.templates import (
    Observation,
    Template,
    TemplateMatching,
    View,
    observe,
    share_in_view,
)
from ekf_reference.scan_matching.alignment import align
from ekf_reference.scan_matching.sog import SumOfGaussians
from graphslam.scan import planar
from research.documents.claims import Claims, at_least, at_most, ours
from research.documents.drawing import (
    SIGMAS,
    TRUE_PATH_COLOUR,
    chart,
    frame,
    plan,
)
from research.documents.drives import Drives, true_surroundings
from research.documents.interface import Experiment, Figure, Sources
from research.documents.measures import occupied
from research.documents.nieto_scan_slam import first_measurements, true_axes

LAYERS: tuple[Layer, ...] = ("occupancy", "sog")
_MOST_DRIVES = 2
"""So many drives: each takes the better part of a minute."""
ERRORS_M = (0.25, 1.0, 2.0, 3.0, 4.0)
_DRAWS = 2
_SCANS = 2
_APART_M = 6.0
"""Least way between the scan of a template and one that it is aligned with."""
_NEAR_M = 0.5
_MARK_M = 0.5


@dataclass(frozen=True, kw_only=True)
class ScanMap:
    """A dense map between scan landmarks, whose loop was closed. found: the landmarks.

    segment: (S, 4) true surfaces. born: (Q, 3) the vehicle's true pose when each template was
    taken. true: (Q, 3) where the landmarks' axes are, as seen from there.
    """

    mapping: DenseMapping
    found: ScanLandmarks
    before: BeforeClosing
    segment: Array
    born: Array
    true: Array

    @property
    def template_point(self) -> Array:
        """(P, 2) of all templates, where their landmarks lie in the end."""
        estimate = self.mapping.ekf.estimate
        return template_points(self.found, estimate.pose_landmark_id, estimate.pose_landmarks)

    def covered(self, point: Array) -> float:
        """Share of the true surfaces that some of the points (N, 2) lie beside."""
        return near_share(_marks(self.segment), point, _NEAR_M)

    def around(self, landmark_index: int) -> SumOfGaussians | None:
        """What the map holds around a landmark, in its axis."""
        place = self.mapping.ekf.pose_landmark_places[landmark_index]
        template = self.found.template[landmark_index]
        return LocalContext(self.mapping.dense.dense).around(template, place)


@dataclass(frozen=True)
class Surrounded:
    """One landmark, all in its axis: template, around: (N, 2) means, rectangle (4, 2), segment."""

    template: Array
    around: Array
    rectangle: Array
    segment: Array


@dataclass(frozen=True)
class ScanMaps(Drives[ScanMap]):
    """shown: the landmark of the first drive with most around it."""

    basin: ConvergenceBasin
    shown: Surrounded


def scan_maps(sources: Sources) -> ScanMaps:
    """Drives from seed 0, and alignments with the landmarks of all."""
    drives = min(sources.drives, _MOST_DRIVES)
    logs = [open_log("scan-slam-maps", choices=SimulationChoices(seed)) for seed in range(drives)]
    return of_logs(logs, f"scan-slam-maps, {drives} drives from seed 0")


def of_logs(logs: list[Log], reported: str) -> ScanMaps:
    """The same of any drives with truth. Raises InputError."""
    each = tuple(_mapped(log) for log in logs)
    cases = [case for one in each for case in cases_of(one)]
    return ScanMaps(reported, each, basin(cases, np.random.default_rng(0)), _shown(each[0]))


def _mapped(log: Log) -> ScanMap:
    between = ScanLandmarksConfig(landmarks="scans")
    extensions = {"scan_landmarks": between, "dense_maps": DenseMapsConfig(layers=LAYERS)}
    mapping = map_log(log, MapConfig(extensions=extensions))
    source, before, run = mapping.setup.find(ScanSlamSource), mapping.dense.before, mapping.ekf
    if source is None or before is None:
        raise InputError(f"{log.name}: no loop was closed")
    poses, segment = true_surroundings(log)
    first = first_measurements(run)
    born = poses.at(run.estimate.time_s[run.pose_landmarks.pose[first]])
    true = true_axes(born, run.pose_landmarks.measured[first])
    return ScanMap(
        mapping=mapping, found=source.found, before=before, segment=segment, born=born, true=true
    )


def cases_of(one: ScanMap) -> list[Seen]:
    """Every landmark with surroundings, in a few scans from elsewhere that have it in view."""
    log, cases = one.mapping.log, list[Seen]()
    scans = LogScans(log)
    vehicle = true_surroundings(log)[0].at(scans.time_s)
    scanner = np.array([planar.compose(pose, scans.mount) for pose in vehicle])
    for landmark_index, (born, true) in enumerate(zip(one.born, one.true, strict=True)):
        template, around = one.found.template[landmark_index], one.around(landmark_index)
        if around is None:
            continue
        away = np.linalg.norm(vehicle[:, :2] - born[:2], axis=1)
        reach = np.linalg.norm(scanner[:, :2] - true[:2], axis=1) <= scans.view.reach_m
        seen = []
        for number in np.flatnonzero((away > _APART_M) & reach)[::5].tolist():
            z = planar.between(scanner[number], true)
            scan = scans.shape(number)
            if len(scan) and share_in_view(template, scan, z, scans.view) >= scans.view.share:
                seen.append(Seen(template, around, scan, z))
        cases += seen[:: max(1, len(seen) // _SCANS)][:_SCANS]
    return cases


def _shown(one: ScanMap) -> Surrounded:
    held = {k: there for k in range(len(one.true)) if (there := one.around(k)) is not None}
    if not held:
        raise InputError(f"{one.mapping.log.name}: the map holds nothing around its landmarks")
    best = max(held, key=lambda landmark_index: len(held[landmark_index]))
    template, (x, y, heading) = one.found.template[best], one.true[best]
    ends = (one.segment.reshape(-1, 2) - (x, y)) @ rotation(heading)
    return Surrounded(
        template.shape.mean,
        held[best].mean,
        LocalContext(one.mapping.dense.dense).rectangle(template),
        ends.reshape(-1, 4),
    )


def _marks(segment: Array) -> Array:
    """(M, 2) evenly along segments (S, 4)."""
    start, way = segment[:, :2], segment[:, 2:] - segment[:, :2]
    count = np.ceil(np.linalg.norm(way, axis=1) / _MARK_M).astype(int)
    parts = [
        a + w * ((np.arange(n) + 0.5) / n)[:, None]
        for a, w, n in zip(start, way, count.tolist(), strict=True)
    ]
    return np.concatenate(parts)


SCAN_MAPS = Experiment("section 6.2.1", scan_maps)


_AXIS_COLOUR = "#17a2b8"
_BESIDE_M = 3.0
_KINDS = ((EKF_COLOUR, "template"), (SMOOTHER_COLOUR, "with map"))


def _claims_6_7(found: ScanMaps) -> Claims:
    each, layers = found.each, LAYERS
    after = [one.mapping.errors[name].median_m for one in each for name in layers]
    before = [
        surface_error(one.before.layers[name], one.segment).median_m
        for one in each
        for name in layers
    ]
    more = [
        one.covered(occupied(one.mapping.layers[name])) / one.covered(one.template_point)
        for one in each
        for name in layers
    ]
    text = (
        "after the loop both layers lie near the true surfaces (median distance of what is "
        "occupied, the worst of the layers and drives)"
    )
    yield at_most(text, max(after), 0.4, "m", own=True)
    text = (
        "closing the loop brings them there (median distance over the one before, the worst "
        "of the layers and drives)"
    )
    yield at_most(text, max(a / b for a, b in zip(after, before, strict=True)), 1.0)
    why = ours(
        "no map can hold so much: all returns of a drive, placed by its true poses, lie beside "
        "66 % of the surface, the templates beside 35 % of it (seed 0); and scan landmarks "
        "stand 20 m apart and on the surfaces, where regions end: 38 % of the returns find none"
    )
    text = (
        "the maps hold much more than the landmarks' templates by themselves (surface that lies "
        "within 0.5 m of the one over that of the other, the least of the layers and drives)"
    )
    yield at_least(text, min(more), 2.0, why=why, own=True)


def _claims_6_8(found: ScanMaps) -> Claims:
    basin = found.basin
    far = basin.error_m >= 1.0
    failed = 1.0 - basin.converged[far].mean(axis=0)
    wrong = basin.wrong[far].mean(axis=0)
    text = (
        "with the dense map around it a template is less often laid into a local maximum "
        f"(failures over those of the template alone, one start 1 m to {basin.error_m[-1]:g} m "
        f"off, {basin.cases} pairs of a landmark and a scan)"
    )
    yield at_most(text, failed[1] / failed[0], 1.0)
    text = (
        "nor is it when a prior of that sigma is searched (wrong results over those of the "
        "template alone)"
    )
    yield at_most(text, wrong[1] / wrong[0], 1.0)


def _draw_6_7(canvas: Canvas, found: ScanMaps) -> None:
    one = found.each[0]
    axes = canvas.subplots(2, 2, sharex=True, sharey=True)
    _paths(axes[0, 0], one)
    _landmarks(axes[0, 1], one)
    for axis, name, title in (
        (axes[1, 0], "occupancy", "(c) occupancy grid, cells above 0.8"),
        (axes[1, 1], "sog", "(d) sum of Gaussians, means"),
    ):
        draw_surfaces(axis, one.segment)
        draw_regions(axis, one.mapping.placed.triangle)
        draw_occupied(axis, one.mapping.layers[name])
        plan(axis, title)
    frame(axes[0, 0], one.segment.reshape(-1, 2), _BESIDE_M)


def _paths(axis: Axes, one: ScanMap) -> None:
    draw_surfaces(axis, one.segment)
    true, path = true_surroundings(one.mapping.log)[0].pose, one.mapping.ekf.estimate.pose[:, :2]
    axis.plot(*true[:, :2].T, "-", color=TRUE_PATH_COLOUR, label="true path")
    axis.plot(*path.T, "--", color=EKF_COLOUR, linewidth=0.9, label="estimated path")
    plan(axis, "(a) objects alone, no point landmark", legend="best")


def _landmarks(axis: Axes, one: ScanMap) -> None:
    estimate = one.mapping.ekf.estimate
    axis.plot(*one.template_point.T, ".", color=DENSE_COLOUR, markersize=2)
    for ends in axes_of(estimate):
        axis.plot(*ends.T, "-", color=_AXIS_COLOUR, linewidth=1.2)
    for outline in ellipses(estimate.pose_landmarks[:, :2], place_covariances(estimate), SIGMAS):
        axis.plot(*outline.T, "-", color=EKF_COLOUR, linewidth=0.7)
    plan(axis, "(b) scan landmarks, axes and 3 sigma")


def _draw_6_8(canvas: Canvas, found: ScanMaps) -> None:
    left, middle, right = canvas.subplots(1, 3)
    _template(left, found.shown, with_map=False)
    _template(middle, found.shown, with_map=True)
    basin = found.basin
    for column, (colour, name) in enumerate(_KINDS):
        home, wrong = 100.0 * basin.converged[:, column], 100.0 * basin.wrong[:, column]
        right.plot(basin.error_m, home, "o-", color=colour, label=f"{name}: found from one start")
        right.plot(basin.error_m, wrong, "x:", color=colour, label=f"{name}: searched, wrong")
    right.set_ylim(0.0, 105.0)
    title = f"(c) {basin.cases} pairs of a landmark and a scan"
    chart(right, title, "initial error [m], and 10 degrees a metre", "alignments [%]")


def _template(axis: Axes, one: Surrounded, *, with_map: bool) -> None:
    """In the landmark's axis."""
    draw_surfaces(axis, one.segment)
    if with_map:
        axis.plot(*one.around.T, ".", color="#2b6cb0", markersize=2.5, label="dense map")
        axis.add_patch(Polygon(one.rectangle, fill=False, edgecolor="#777777", linewidth=0.8))
    axis.plot(*one.template.T, ".", color=EKF_COLOUR, markersize=3, label="template")
    axis.plot((3.0, 0.0, 0.0), (0.0, 0.0, 3.0), "-", color=_AXIS_COLOUR, linewidth=1.5)
    frame(axis, one.rectangle, _BESIDE_M)
    axis.set_aspect("equal")
    title = "(b) with the dense map around it" if with_map else "(a) a landmark's template"
    chart(axis, title, "ahead [m]", "left [m]")


_ONE_START = np.diag((1e-6, 1e-6, 1e-8))
TURN = math.radians(10.0)
"""A start that is off by a metre is turned by so much."""
SAME_MAXIMUM = (1.0, math.radians(10.0))
"""An alignment that ends so near is at the right maximum, metres and radians: with the noise of
Table 5.1 those of templates lie 0.3 m (median) off the truth."""
_ANYWHERE = View(math.inf, -math.pi, math.pi, share=0.0)


@dataclass(frozen=True)
class Seen:
    """A landmark in a scan from elsewhere. around: as ScanSlam has it. true: (3,) in the scan."""

    template: Template
    around: SumOfGaussians
    scan: SumOfGaussians
    true: Array


@dataclass(frozen=True)
class ConvergenceBasin:
    """Shares by initial error (E,) [m]; columns are the template alone and with its surroundings.

    converged: (E, 2) from one start. wrong: (E, 2) with a prior of that sigma to search; the rest
    is right or says nothing. cases: landmarks in scans.
    """

    error_m: Array
    converged: Array
    wrong: Array
    cases: int


def _offsets(rng: np.random.Generator, error_m: float) -> Array:
    """(D, 3) of so many metres any way, and turned with them either way."""
    way = rng.uniform(0.0, 2.0 * np.pi, _DRAWS)
    side = rng.choice((-1.0, 1.0), _DRAWS)
    return error_m * np.column_stack((np.cos(way), np.sin(way), side * TURN))


def basin(cases: Sequence[Seen], rng: np.random.Generator) -> ConvergenceBasin:
    """All cases from some starts per initial error."""
    converged, wrong = np.zeros((2, len(ERRORS_M), 2))
    for row, error in enumerate(ERRORS_M):
        for case in cases:
            shapes = case.template.shape, enriched(case.template, case.around)
            for off in _offsets(rng, error):
                for column, shape in enumerate(shapes):
                    found = align(shape, case.scan, case.true + off, _ONE_START)
                    converged[row, column] += _is_close(found.pose, case.true)
                for column, what in enumerate(_searched(case, off, error)):
                    if what.usable and what.alignment is not None:
                        wrong[row, column] += not _is_close(what.alignment.pose, case.true)
    tried = max(_DRAWS * len(cases), 1)
    return ConvergenceBasin(np.array(ERRORS_M), converged / tried, wrong / tried, len(cases))


def _searched(case: Seen, off: Array, error_m: float) -> tuple[Observation, Observation]:
    """What Scan-SLAM makes of it, without and with the surroundings."""
    o = ScanSlamOptions()
    prior = np.diag((error_m, error_m, error_m * TURN)) ** 2
    matching = TemplateMatching(_ANYWHERE, o.observation, o.alignment, o.belief)
    how = case.scan, case.true + off, prior, matching
    return observe(case.template, *how), observe_enriched(case.template, case.around, *how)


def _is_close(pose: Array, true: Array) -> bool:
    away = pose - true
    turned = abs(float(wrap_angle(away[2])))
    return bool(np.hypot(*away[:2]) <= SAME_MAXIMUM[0] and turned <= SAME_MAXIMUM[1])


FIGURES = (
    Figure(
        name="N6.7", title="DenseSLAM between the landmarks of Scan-SLAM",
        says="Without a point landmark the local regions are anchored to scan landmarks, and the "
        "dense maps between them hold much more than the templates by themselves.",
        experiment=SCAN_MAPS, draw=_draw_6_7, claims=_claims_6_7, size=(11.0, 9.6),
    ),
    Figure(
        name="N6.8", title="A scan landmark with the dense map around it",
        says="A template augmented with the dense map around it makes convergence to a local "
        "maximum less probable.",
        experiment=SCAN_MAPS, draw=_draw_6_8, claims=_claims_6_8, size=(14.0, 4.8),
    ),
)  # fmt: skip
