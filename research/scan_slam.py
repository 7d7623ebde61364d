"""Scan-SLAM on Nieto's environment (Nieto 2005, section 5.6, Table 5.1): drives without a landmark.

    python -m research.scan_slam [--seeds 30] [--first 100] [--laser table|2cm] [--seconds 176]
                                   [--processes 2]

A row a drive; below, means over the drives with the 95 % interval of the mean, and for NEES the
two-sided 95 % band of a mean of so many independent drives. NEES are over their degrees of freedom:
of the pose at the last instant before the map is moved the most (the loop's closing) and at the
end; of the landmarks' places in the end; of the distances of those seen in one scan. A landmark's
true axis is where its template fits the noise-free surfaces best.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from itertools import combinations

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from comparisons.checks.accuracy import aligned
from comparisons.extensions.dense_maps.accuracy import error_of_points
from comparisons.extensions.scan_landmarks.extension import ScanLandmarksFinding
from comparisons.extensions.scan_landmarks.figure import template_points
from comparisons.extensions.scan_landmarks.source import LogScans
from comparisons.jobs.run import Comparison, compare
from comparisons.logs.simulate.ray_casting import cast
from comparisons.logs.simulate.scan_drive import ScanExperiment, scan_slam, simulate
from comparisons.logs.simulate.scanners import Planar
from comparisons.settings import run_config
from comparisons.statistics import mean_band
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.scan_matching.alignment_covariance import scan_align
from ekf_reference.scan_matching.scan_shape import of_scan
from graphslam.scan import planar
from research.script import options, present
from research.timing import timed

Array = NDArray[np.float64]

NEES = {"nees_closing": 3, "nees_end": 3, "nees_places": 2, "nees_distances": 1}
"""Degrees of freedom of a drive's independent part."""
LOOK = np.diag((0.3, 0.3, 0.03)) ** 2
"""Within which a template's true axis is sought."""


@dataclass(frozen=True, kw_only=True)
class ScanSlamDrive:
    """One drive. Lengths [m]: ATE; map before the closing, in the end, and the smoother's.

    shape: RMS distance of the landmarks from their true axes after a rigid alignment, which takes
    away what no closing can correct: the error of the first heading. scans_per_s: of one core, with
    both estimators and all checks.
    """

    verdict: str
    landmarks: int
    used: int
    ekf_m: float
    smoother_m: float
    wheels_m: float
    ratio: float
    before_m: float
    last_m: float
    smoothed_m: float
    shape_before_m: float
    shape_last_m: float
    nees_closing: float
    nees_end: float
    nees_places: float
    nees_distances: float
    algebra: float
    model: float
    linearisation: float
    scans_per_s: float


def experiment(laser: str) -> ScanExperiment:
    """Table 5.1, or the same drive with a laser as exact as a Sick's."""
    table = scan_slam()
    if laser == "table":
        return table
    assert laser == "2cm"
    exact = Planar(
        max_range_m=table.drive.max_range_m, sigma_range_m=0.02, sigma_beam_rad=math.radians(0.1)
    )
    return replace(table, name="scan-slam-2cm", scanner=exact)


def main() -> None:
    """Run all, print a table and the means."""
    asked = options(__doc__, seeds=30, first=100, laser="table", seconds=math.inf, processes=2)
    seeds = range(asked.first, asked.first + asked.seeds)
    names = [f.name for f in fields(ScanSlamDrive)]
    print("seed", *(f"{name:>14}" for name in names))
    rows: list[ScanSlamDrive] = []
    work = (delayed(measured)(seed, asked.laser, asked.seconds) for seed in seeds)
    drives = Parallel(n_jobs=asked.processes, return_as="generator")(work)
    for seed, row in zip(seeds, drives, strict=True):
        rows.append(row)
        figures = (f"{vars(row)[name]:14.3g}" for name in names[1:])
        print(f"{seed:4}", f"{row.verdict:>14}", *figures, flush=True)
    summary(rows)


def summary(rows: list[ScanSlamDrive]) -> None:
    """Print means with their 95 % intervals, and bands."""
    count = len(rows)
    print(f"{'':18} {'mean':>9} {'interval of the mean':>22} {'band':>16} {'largest':>9}")
    for name in (f.name for f in fields(ScanSlamDrive) if f.name != "verdict"):
        value = np.array([vars(row)[name] for row in rows])
        half = 1.96 * value.std(ddof=1) / math.sqrt(count) if count > 1 else math.nan
        interval, band = f"{value.mean() - half:.3g} to {value.mean() + half:.3g}", ""
        if name in NEES:
            dof = NEES[name] * count
            low, high = mean_band(dof, 1)
            band = f"{low:.2f} to {high:.2f}"
        print(f"{name:18} {value.mean():9.3g} {interval:>22} {band:>16} {value.max():9.3g}")
    below = sum(row.ratio < 0.1 for row in rows)
    better = sum(row.last_m < row.before_m for row in rows)
    print(f"below a tenth of dead reckoning's ATE: {below} of {count}")
    best = sum(row.smoothed_m < row.before_m for row in rows)
    print(f"map better after the closing than before: {better} of {count}, smoother's {best}")
    shape = sum(row.shape_last_m < row.shape_before_m for row in rows)
    print(f"its shape better, that is after a rigid alignment: {shape} of {count}")
    for outcome in sorted({row.verdict for row in rows}):
        print(f"{outcome}: {sum(row.verdict == outcome for row in rows)} of {count}")


def measured(seed: int, laser: str, seconds: float) -> ScanSlamDrive:
    """One drive, or its beginning; scans without odometry are not looked at."""
    drive = experiment(laser)
    log = simulate(np.random.default_rng(seed), drive)
    log = replace(log, odometry=log.odometry.chosen(log.odometry.time_s < seconds))
    c, cpu_s = timed(compare, log, run_config(landmarks="scans"))
    source, gaps, estimate = c.find(ScanLandmarksFinding).source, c.agreement, c.ekf.estimate
    ekf_m, smoother_m, wheels_m = (
        float(present(one).ate_m or 0.0)
        for one in (c.accuracy.ekf, c.accuracy.smoother, c.accuracy.dead_reckoning)
    )
    error = estimate.pose - present(log.truth.poses).at(estimate.time_s)
    error[:, 2] = wrap_angle(error[:, 2])
    closing = int(np.searchsorted(estimate.time_s, present(source.closing).time_s)) - 1
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(estimate.pose_covariance + 1e-12), error)
    true = true_axes(c, drive)
    places, distances = landmark_nees(c, true)
    before, last, smoothed, shape_before, shape_last = map_errors(c, true)
    return ScanSlamDrive(
        verdict=c.verdict.outcome,
        landmarks=len(estimate.pose_landmarks),
        used=len(c.ekf.pose_landmarks.measured),
        ekf_m=ekf_m,
        smoother_m=smoother_m,
        wheels_m=wheels_m,
        ratio=ekf_m / (wheels_m or 1.0),
        before_m=before,
        last_m=last,
        smoothed_m=smoothed,
        shape_before_m=shape_before,
        shape_last_m=shape_last,
        nees_closing=float(nees[closing]) / 3.0,
        nees_end=float(nees[-1]) / 3.0,
        nees_places=places,
        nees_distances=distances,
        algebra=max(gaps.algebra.sigma, gaps.algebra.covariance),
        model=max(gaps.model.sigma, gaps.model.covariance),
        linearisation=gaps.linearisation.sigma,
        scans_per_s=source.found.scans / cpu_s,
    )


def landmark_nees(c: Comparison, true: Array) -> tuple[float, float]:
    """Mean NEES of the landmarks' places over 2, and of distances of those seen in one scan.

    true: (Q, 3) axes.
    """
    estimate = c.ekf.estimate
    error = (estimate.pose_landmarks - true)[:, :2]
    own = estimate.pose_landmark_covariances()[:, :2, :2]
    places = np.einsum("qi,qij,qj->q", error, np.linalg.inv(own), error) / 2.0
    size = 3 * len(estimate.pose_landmarks)
    joint, found = estimate.joint_covariance[-size:, -size:], []
    for i, j in _seen_together(c):
        apart = estimate.pose_landmarks[j, :2] - estimate.pose_landmarks[i, :2]
        length = float(np.hypot(*apart))
        if length < 1.0:
            continue
        rows = np.r_[3 * i : 3 * i + 2, 3 * j : 3 * j + 2]
        by = np.concatenate((-apart, apart)) / length
        variance = by @ joint[np.ix_(rows, rows)] @ by
        off = length - float(np.hypot(*(true[j, :2] - true[i, :2])))
        found.append(off**2 / variance)
    return float(places.mean()), float(np.mean(found))


def true_axes(c: Comparison, drive: ScanExperiment) -> Array:
    """(Q, 3) where the templates fit the noise-free surfaces best."""
    poses, scans = present(c.log.truth.poses), LogScans(c.log)
    run, found = c.ekf, c.find(ScanLandmarksFinding).source.found
    solid = drive.world.solids()
    numbers, rows = np.unique(run.pose_landmarks.landmark, return_index=True)
    first = dict(zip(numbers.tolist(), rows.tolist(), strict=True))
    bearing = np.radians(np.arange(-90.0, 90.01, 0.5))
    axes = []
    for landmark in run.estimate.pose_landmark_id.tolist():
        epoch = run.pose_landmarks.pose[first[landmark]]
        vehicle = poses.at(run.estimate.time_s[epoch][None])[0]
        scanner = planar.compose(vehicle, scans.mount)
        way = cast(bearing, np.tile(scanner, (len(bearing), 1)), solid)
        way = np.where(way <= drive.drive.max_range_m, way, np.nan)
        template = found.template[landmark]
        exact = of_scan(bearing, way, scans.sensor)
        axes.append(
            planar.compose(scanner, scan_align(template.shape, exact, template.pose, LOOK).pose)
        )
    return np.array(axes)


def _seen_together(c: Comparison) -> list[tuple[int, int]]:
    """Pairs of landmarks, by their place in the estimate, that one scan measured."""
    place = {int(k): i for i, k in enumerate(c.ekf.estimate.pose_landmark_id)}
    seen = c.ekf.pose_landmarks
    found = set()
    for epoch in np.unique(seen.pose).tolist():
        here = sorted({place[k] for k in seen.landmark[seen.pose == epoch].tolist() if k in place})
        found |= set(combinations(here, 2))
    return sorted(found)


def map_errors(c: Comparison, true: Array) -> tuple[float, ...]:
    """How far the landmarks are off that there were before the closing, five figures [m].

    Medians of the templates' distances from the surfaces: before, at the end, smoothed. RMS from
    the true axes (Q, 3), aligned: before, at the end.
    """
    source, smoothed = c.find(ScanLandmarksFinding).source, c.known.gaps.smoothed
    closing, surfaces = present(source.closing), present(c.log.truth.surfaces)
    # Templates of landmarks that were merged later are other landmarks' by now.
    kept = np.isin(closing.landmark_index, smoothed.pose_landmark_id)
    index = closing.landmark_index[kept]
    row = np.searchsorted(smoothed.pose_landmark_id, index)
    before, last = closing.before[kept], c.ekf.pose_landmark_places[index]
    medians = (
        error_of_points(template_points(source.found, index, place), surfaces.segment).median_m
        for place in (before, last, smoothed.pose_landmarks[row])
    )
    axes = true[row, :2]
    shapes = (
        float(np.sqrt(np.square(aligned(place[:, :2], axes) - axes).sum(axis=1).mean()))
        for place in (before, last)
    )
    return *medians, *shapes


if __name__ == "__main__":
    main()
