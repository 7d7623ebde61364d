"""Scan-SLAM on the real car park, as recorded and with its inputs moved by 1e-12.

    python -m research.scan_car_park DATA/acfr_car_park [--runs 20] [--processes 2] [--end 125]

Per run: verdict, landmarks, and of filter and smoother the root mean square and median distance to
GPS after a rigid alignment, and how far the beacons are off that no estimator saw: each beacon's
detections are placed from the estimated poses, averaged, aligned to the surveyed places with the
others, and compared. Below: what differs between the runs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed

from comparisons.adapters.time_window import cut_log
from comparisons.arrays import Array
from comparisons.checks.accuracy import aligned, rigid_motion
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.scan_landmarks.extension import ScanLandmarksFinding
from comparisons.jobs.run import compare
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.logs.odometry import poses_at
from comparisons.logs.transforms.calibration import controlled
from comparisons.settings import run_config
from research.script import options, present
from research.timing import timed

SIZE = 1e-12
"""Standard deviation of the factors by which inputs are multiplied, about 1."""
BEACON_M = 1.5
"""A detection farther from every surveyed beacon is of something else."""
LEAST = 5
"""Detections of a beacon that counts."""


class Errors(NamedTuple):
    """Of one estimate [m]: RMS and median from GPS; beacons: how many, their RMS, the farthest."""

    rms: float
    median: float
    beacons: int
    beacon_rms: float
    beacon_most: float


class ScanCarParkDrive(NamedTuple):
    """verdict, landmarks, used: decided. ekf, smoother, wheels. scans_per_s of a core."""

    verdict: str
    landmarks: int
    used: int
    ekf: Errors
    smoother: Errors
    wheels_rms: float
    scans_per_s: float


def main() -> None:
    """Run all and print a line each."""
    asked = options(__doc__, "log", runs=20, processes=2, end=float)
    work = (delayed(one)(asked.log, number, asked.end) for number in range(asked.runs + 1))
    runs: list[ScanCarParkDrive] = []
    for number, run in enumerate(Parallel(n_jobs=asked.processes, return_as="generator")(work)):
        runs.append(run)
        print(
            f"{number:3} {run.verdict:10} {run.landmarks} landmarks, {run.used} used, "
            f"{run.scans_per_s:.1f} scans/s; wheels {run.wheels_rms:.3f} m",
            *(
                f"\n    {name:8} {_words(e)}"
                for name, e in (("EKF", run.ekf), ("smoother", run.smoother))
            ),
            flush=True,
        )
    first, others = runs[0], runs[1:]
    same = sum(run[:3] == first[:3] for run in others)
    print(f"verdict, landmarks and measurements as unmoved: {same} of {len(others)}")
    for name in ("ekf", "smoother"):
        apart = [
            np.abs(np.subtract(getattr(run, name), getattr(first, name))).max() for run in others
        ]
        print(f"{name}: figures differ by at most {max(apart, default=0.0):.1e} m")


def one(path: str, number: int, end_s: float | None) -> ScanCarParkDrive:
    """Run `number`, 0 with the inputs as they are."""
    log = cut_log(open_log(path), end_s=end_s)
    if number:
        log = perturbed(log, np.random.default_rng(number))
    c, spent = timed(compare, log, run_config(landmarks="scans"))
    return ScanCarParkDrive(
        c.verdict.outcome,
        len(c.ekf.estimate.pose_landmarks),
        len(c.ekf.pose_landmarks.measured),
        errors(log, c.ekf.estimate),
        errors(log, c.known.gaps.smoothed),
        present(present(c.accuracy.dead_reckoning).gps_rms_aligned_m),
        c.find(ScanLandmarksFinding).source.found.scans / spent,
    )


def perturbed(log: Log, rng: np.random.Generator) -> Log:
    """Return a log with its inputs multiplied by 1 + SIZE times a standard normal, each its own.

    Ranges and bearings of scans, odometry, the prior's pose and positions; times, noise and truth
    stay.
    """

    def moved(values: Array) -> Array:
        return np.asarray(values * (1.0 + SIZE * rng.standard_normal(np.shape(values))))

    scans, positions = log.scans, log.positions
    if scans is not None:
        scans = replace(scans, range_m=moved(scans.range_m), angle_rad=moved(scans.angle_rad))
    if positions is not None:
        positions = replace(positions, position_m=moved(positions.position_m))
    log = controlled(replace(log, scans=scans, positions=positions), moved, moved)
    return replace(log, prior=replace(log.prior, pose=moved(log.prior.pose)))


def errors(log: Log, estimate: Estimate) -> Errors:
    """Compare an estimate with GPS and with the surveyed beacons."""
    positions = present(log.positions)
    at = poses_at(positions.time_s, estimate.time_s, estimate.pose)[:, :2]
    away = np.hypot(*(aligned(at, positions.position_m) - positions.position_m).T)
    robust = np.hypot(*(aligned(at, positions.position_m, robust=True) - positions.position_m).T)
    found, true = beacons(log, estimate)
    off = np.hypot(*(aligned(found, true) - true).T)
    return Errors(
        float(np.sqrt(np.square(away).mean())),
        float(np.median(robust)),
        len(off),
        float(np.sqrt(np.square(off).mean())),
        float(off.max()),
    )


def beacons(log: Log, estimate: Estimate) -> tuple[Array, Array]:
    """(B, 2) mean places of the beacons' detections from estimated poses, and the surveyed ones."""
    seen, table, positions = log.measurements, present(log.truth.landmarks), present(log.positions)
    pose = poses_at(seen.time_s, estimate.time_s, estimate.pose)
    bearing = pose[:, 2] + seen.bearing_rad
    place = pose[:, :2] + seen.range_m[:, None] * np.column_stack(
        (np.cos(bearing), np.sin(bearing))
    )
    at = poses_at(positions.time_s, estimate.time_s, estimate.pose)[:, :2]
    moved = rigid_motion(at, positions.position_m)(place)
    apart = np.linalg.norm(moved[:, None] - table.position_m, axis=2)
    nearest, near = apart.argmin(axis=1), apart.min(axis=1) < BEACON_M
    counted = [k for k in range(len(table.position_m)) if (near & (nearest == k)).sum() >= LEAST]
    found = np.array([place[near & (nearest == k)].mean(axis=0) for k in counted])
    return found.reshape(-1, 2), table.position_m[counted]


def _words(e: Errors) -> str:
    return (
        f"GPS rms {e.rms:.3f}, median {e.median:.3f} m; {e.beacons} beacons, "
        f"rms {e.beacon_rms:.3f}, farthest {e.beacon_most:.3f} m"
    )


if __name__ == "__main__":
    main()
