"""Nieto 2005, section 6.2.1: DenseSLAM between the landmarks of Scan-SLAM, Figs. 6.7 and 6.8."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array
from comparisons.config import MapConfig
from comparisons.errors import InputError
from comparisons.experiments.reproduction.basin import ConvergenceBasin, Seen, basin
from comparisons.experiments.reproduction.interface import Experiment, Sources
from comparisons.extensions.dense_maps.accuracy import SurfaceError, near_share, surface_error
from comparisons.extensions.dense_maps.config import DenseMapsConfig, Layer
from comparisons.extensions.dense_maps.source import BeforeClosing
from comparisons.extensions.scan_landmarks.config import ScanLandmarksConfig
from comparisons.extensions.scan_landmarks.figure import template_points
from comparisons.extensions.scan_landmarks.source import LogScans, ScanSlamSource
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.pipeline.dense_map import DenseMapping, map_log
from ekf_reference.models.relative_pose import RelativePose
from ekf_reference.scan_landmarks.local_context import LocalContext
from ekf_reference.scan_landmarks.scan_slam import ScanLandmarks
from ekf_reference.scan_landmarks.templates import share_in_view
from ekf_reference.scan_matching.sog import SumOfGaussians

LAYERS: tuple[Layer, ...] = ("occupancy", "sog")
_MOST_DRIVES = 2
"""So many drives: each takes the better part of a minute."""
ERRORS_M = (0.25, 1.0, 2.0, 3.0, 4.0)
_DRAWS = 2
_SCANS = 2
_APART_M = 6.0
"""Least way between the scan of a template and one that it is aligned with."""
_MEASURED = RelativePose()
_NEAR_M = 0.5
_MARK_M = 0.5


@dataclass(frozen=True)
class ScanMap:
    """A dense map between scan landmarks, whose loop was closed. found: the landmarks."""

    mapping: DenseMapping
    found: ScanLandmarks
    before: BeforeClosing
    segment: Array

    def error_before(self, layer: str) -> SurfaceError:
        """Of a layer, before the closing."""
        return surface_error(self.before.layers[layer], self.segment)

    @property
    def template_point(self) -> Array:
        """(P, 2) of all templates, where their landmarks lie in the end."""
        estimate = self.mapping.ekf.estimate
        return template_points(self.found, estimate.pose_landmark_id, estimate.pose_landmarks)

    def covered(self, point: Array) -> float:
        """Share of the true surfaces that some of the points (N, 2) lie beside."""
        return near_share(_marks(self.segment), point, _NEAR_M)


@dataclass(frozen=True)
class Surrounded:
    """One landmark, all in its axis: template, around: (N, 2) means, rectangle (4, 2), segment."""

    template: Array
    around: Array
    rectangle: Array
    segment: Array


@dataclass(frozen=True)
class ScanMaps:
    """Of some drives; the first is drawn. shown: the landmark with most around it."""

    log: str
    each: tuple[ScanMap, ...]
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
    held = basin(cases, ERRORS_M, _DRAWS, np.random.default_rng(0))
    return ScanMaps(reported, each, held, _shown(each[0]))


def _mapped(log: Log) -> ScanMap:
    between = ScanLandmarksConfig(landmarks="scans")
    extensions = {"scan_landmarks": between, "dense_maps": DenseMapsConfig(layers=LAYERS)}
    mapping = map_log(log, MapConfig(extensions=extensions))
    source, before, surfaces = (
        mapping.setup.find(ScanSlamSource),
        mapping.dense.before,
        log.truth.surfaces,
    )
    if source is None or before is None or surfaces is None:
        raise InputError(f"{log.name}: no loop was closed, or there are no true surfaces")
    return ScanMap(mapping, source.found, before, surfaces.segment)


def cases_of(one: ScanMap) -> list[Seen]:
    """Every landmark with surroundings, in a few scans from elsewhere that have it in view."""
    log, cases = one.mapping.log, list[Seen]()
    scans, truth = LogScans(log), log.truth.poses
    if truth is None:
        raise InputError(f"{log.name}: true poses are needed")
    vehicle = truth.at(scans.time_s)
    scanner = _composed(vehicle, scans.mount)
    for landmark_index, true in enumerate(_true_places(one)):
        template, around = one.found.template[landmark_index], _around(one, landmark_index)
        if around is None:
            continue
        away = np.linalg.norm(vehicle[:, :2] - _born_at(one, landmark_index)[:2], axis=1)
        reach = np.linalg.norm(scanner[:, :2] - true[:2], axis=1) <= scans.view.reach_m
        seen = []
        for number in np.flatnonzero((away > _APART_M) & reach)[::5].tolist():
            z = _MEASURED.predict(scanner[number], true[None]).z[0]
            scan = scans.shape(number)
            if len(scan) and share_in_view(template, scan, z, scans.view) >= scans.view.share:
                seen.append(Seen(template, around, scan, z))
        cases += seen[:: max(1, len(seen) // _SCANS)][:_SCANS]
    return cases


def _around(one: ScanMap, landmark_index: int) -> SumOfGaussians | None:
    place = one.mapping.ekf.pose_landmark_places[landmark_index]
    return LocalContext(one.mapping.dense.dense).around(one.found.template[landmark_index], place)


def _first_measurement(one: ScanMap, landmark_index: int) -> int:
    return int(np.flatnonzero(one.mapping.ekf.pose_landmarks.landmark == landmark_index)[0])


def _born_at(one: ScanMap, landmark_index: int) -> Array:
    """(3,) the vehicle's true pose when the template was taken."""
    run, truth = one.mapping.ekf, one.mapping.log.truth.poses
    if truth is None:
        raise InputError(f"{one.mapping.log.name}: true poses are needed")
    epoch = run.pose_landmarks.pose[_first_measurement(one, landmark_index)]
    pose: Array = truth.at(run.estimate.time_s[[epoch]])[0]
    return pose


def _true_places(one: ScanMap) -> list[Array]:
    """(3,) of each landmark's axis: where the true vehicle saw its template."""
    measured = one.mapping.ekf.pose_landmarks.measured
    return [
        _MEASURED.invert(
            _born_at(one, landmark_index), measured[[_first_measurement(one, landmark_index)]]
        ).landmark[0]
        for landmark_index in range(one.mapping.ekf.pose_landmarks.count)
    ]


def _composed(vehicle: Array, mount: Array) -> Array:
    """(N, 3) of a scanner on vehicles (N, 3)."""
    return np.array([_MEASURED.invert(pose, mount[None]).landmark[0] for pose in vehicle])


def _shown(one: ScanMap) -> Surrounded:
    landmark_indices = range(one.mapping.ekf.pose_landmarks.count)
    held = {
        landmark_index: there
        for landmark_index in landmark_indices
        if (there := _around(one, landmark_index)) is not None
    }
    if not held:
        raise InputError(f"{one.mapping.log.name}: the map holds nothing around its landmarks")
    best = max(held, key=lambda landmark_index: len(held[landmark_index]))
    template, true = one.found.template[best], _true_places(one)[best]
    ends = _MEASURED.predict(true, _with_heading(one.segment.reshape(-1, 2))).z[:, :2]
    return Surrounded(
        template.shape.mean,
        held[best].mean,
        LocalContext(one.mapping.dense.dense).rectangle(template),
        ends.reshape(-1, 4),
    )


def _with_heading(point: Array) -> Array:
    return np.column_stack((point, np.zeros(len(point))))


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
