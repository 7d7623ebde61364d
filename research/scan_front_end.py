"""The scan front end: speed, what is spent on what, drift, and honesty of its covariances.

    python -m research.scan_front_end [--seeds 50] [--seeds-3d 12] [--log path/to/acfr_car_park]

Simulated drives come with the package (`scan-loop-fine`, `scan-loop` with the
beams of Nieto's Table 3.1, `scan-loop-3d`). NEES has three degrees of
freedom; the band is that of an average over as many runs as there are seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.motion import motion_between
from comparisons.adapters.scan_odometry import ScanMotion, run_scan_odometry
from comparisons.adapters.scan_source import ScanSource
from comparisons.extensions.scan_motion.increments import check_increments, normalised_errors
from comparisons.extensions.scan_motion.job import run_front_end
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.logs.readers import read_log
from comparisons.statistics import mean_band
from graphslam.scan import planar
from graphslam.scan.libraries import kiss_icp
from graphslam.scan.odometry import ScanOdometry
from graphslam.scan.refinement import refine
from graphslam.scan.registration import ScanError
from graphslam.scan.surfaces import SurfaceMap
from research.script import options, present
from research.timing import timed

Array = NDArray[np.float64]
VoxelHashMap = kiss_icp().mapping.VoxelHashMap

PLANAR = ("scan-loop-fine", "scan-loop")


class Stopwatch:
    """Processor time of functions that it has wrapped; not of calls that raise."""

    def __init__(self) -> None:
        """Nothing spent yet."""
        self.seconds = 0.0

    def timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, its time counted."""

        def call(*arguments: Any, **options: Any) -> Any:
            result, cpu_s = timed(function, *arguments, **options)
            self.seconds += cpu_s
            return result

        # A plain function, so that it stays a method where it replaces one.
        return call


def registered(odometry: ScanOdometry, clouds: Sequence[Array], guesses: Array) -> None:
    """Register all clouds; those that are refused are left out."""
    for cloud, guess in zip(clouds, guesses, strict=True):
        with suppress(ScanError):
            odometry.register(cloud, guess)


def speed(log: Log, repeats: int = 3) -> None:
    """Time of the whole, of KISS-ICP's own calls in it, and of refinement and evidence."""
    source = ScanSource(log)
    clouds = [source.points(i) for i in range(len(source.row))]
    guesses = motion_between(log, source.time_s).displacement
    guesses[0] = 0.0
    best = (np.inf, np.inf, np.inf)
    for _ in range(repeats):
        kiss, judge = Stopwatch(), Stopwatch()
        with (
            mock.patch("graphslam.scan.odometry.refine", judge.timed(refine)),
            mock.patch("graphslam.scan.odometry.SurfaceMap", judge.timed(SurfaceMap)),
            mock.patch.multiple(
                VoxelHashMap,
                update=kiss.timed(VoxelHashMap.update),
                add_points=kiss.timed(VoxelHashMap.add_points),
                point_cloud=kiss.timed(VoxelHashMap.point_cloud),
            ),
        ):
            odometry = ScanOdometry()
            aligned: Any = SimpleNamespace()
            aligned.align_points_to_map = kiss.timed(odometry._kiss.align_points_to_map)
            odometry._kiss = aligned
            _, cpu_s = timed(registered, odometry, clouds, guesses)
            best = min(best, (cpu_s, kiss.seconds, judge.seconds))
    total, own, judged = (1e3 * seconds / len(clouds) for seconds in best)
    print(f"{log.name}: {1e3 / total:.0f} scans/s; ms a scan: {total:.3f} in all, of these")
    rest = total - own - judged
    print(f"  {own:.3f} KISS-ICP and its map, {judged:.3f} refinement, evidence and covariance,")
    print(f"  {rest:.3f} the wrapper's rest, {100.0 * rest / own:.0f} % of KISS-ICP's")


def honesty(name: str, seeds: int) -> None:
    """Increments' NEES and drift over simulated drives."""
    runs, drifts, failed = [], [], 0
    for seed in range(seeds):
        log = open_log(name, choices=SimulationChoices(seed))
        motion = run_scan_odometry(log)
        failed += len(motion.failures)
        squared = normalised_errors(motion, present(log.truth.poses))
        runs.append(float(squared.mean()))
        drifts.append(drift(log, motion))
    low, high = mean_band(seeds, 3)
    print(
        f"{name}, {seeds} seeds: NEES {np.mean(runs):.2f} (runs {min(runs):.2f} to "
        f"{max(runs):.2f}; band {low:.2f} to {high:.2f}); drift {100 * np.mean(drifts):.2f} % of "
        f"the way, at most {100 * max(drifts):.2f} %; {failed} scans failed"
    )


def drift(log: Log, motion: ScanMotion) -> float:
    """Distance of the last pose from the truth, over the way, both seen from the first pose."""
    true = present(log.truth.poses).at(motion.time_s)
    way = np.hypot(*np.diff(true[:, :2], axis=0).T).sum()
    miss = motion.pose[-1, :2] - planar.between(true[0], true[-1])[:2]
    return float(np.hypot(*miss) / way)


def front_end(log: Log) -> None:
    """Figures of the whole front end on a log."""
    f = run_front_end(log)
    spent_s = f.prepared.clock.seconds["loops"]
    print(f"{log.name}: {len(f.closed.loop_closures.first)} loops closed in {spent_s:.1f} s")
    for key, name in (
        ("wheels", "wheels"), ("scans", "scan odometry"), ("scan graph", "scan graph"),
    ):  # fmt: skip
        if (accuracy := f.accuracy.get(key)) is not None:
            figure = accuracy.gps_rms_aligned_m or accuracy.ate_aligned_m
            print(f"  {name}: RMS after alignment {figure:.3f} m")
    check = check_increments(f.motion, log)
    if check is not None:
        print(
            f"  increments' sigmas by {check.against}: {check.factor:.2f} times as large would fit"
        )


def main() -> None:
    """Run all and print."""
    asked = options(__doc__, seeds=50, seeds_3d=12, log=Path)
    logs = [open_log(name) for name in PLANAR]
    if asked.log is not None:
        logs.append(read_log(asked.log))
    for log in logs:
        speed(log)
    for name in PLANAR:
        honesty(name, asked.seeds)
    if asked.seeds_3d:
        honesty("scan-loop-3d", asked.seeds_3d)
    for log in logs:
        front_end(log)


if __name__ == "__main__":
    main()
