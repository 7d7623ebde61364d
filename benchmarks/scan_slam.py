"""Scan-SLAM on Nieto's environment (Nieto 2005, section 5.6, Table 5.1): drives without a landmark.

    python benchmarks/scan_slam.py [--seeds 10] [--first 0] [--seconds 176] [--fuse]

Per drive: errors of filter, smoother and odometry alone; distances of the templates' points to the
true surfaces before the scan that moved the map the most, a loop's closing, and in the end; NEES of
the pose over 3; the gaps; processor time. With --fuse landmarks that turn out to be one are fused.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.extensions.dense_maps.accuracy import error_of_points
from comparisons.extensions.scan_landmarks.extension import ScanLandmarksFinding
from comparisons.extensions.scan_landmarks.figure import template_points
from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.simulate.scan_drive import scan_slam, simulate
from comparisons.pipeline.compare import Comparison, compare
from comparisons.settings import run_config


@dataclass(frozen=True)
class Row:
    """One drive. Errors [m]: at all times, of the map before closing and at last, at the end."""

    landmarks: int
    fused: int
    used: int
    ekf_m: float
    smoother_m: float
    wheels_m: float
    end_m: float
    before_m: float
    last_m: float
    nees: float
    algebra: float
    model: float
    linearisation: float
    cpu_s: float


def main() -> None:
    """Run all, print a table and the medians."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=math.inf)
    parser.add_argument("--fuse", action="store_true")
    choices = parser.parse_args()
    names = list(Row.__dataclass_fields__)
    print("seed ", *(f"{name:>13}" for name in names), "  verdict")
    rows = []
    for seed in range(choices.first, choices.first + choices.seeds):
        row, verdict = measured(seed, choices.seconds, fuse=choices.fuse)
        rows.append(row)
        shown = (f"{value:13.3g}" for value in vars(row).values())
        print(f"{seed:4} ", *shown, f"  {verdict}", flush=True)
    medians = (float(np.median([vars(row)[name] for row in rows])) for name in names)
    print("median", *(f"{value:13.3g}" for value in medians))


def measured(seed: int, seconds: float, *, fuse: bool = False) -> tuple[Row, str]:
    """One drive, and the verdict."""
    log = simulate(np.random.default_rng(seed), scan_slam())
    start = time.process_time()
    config = run_config(landmarks="scans", merge_landmarks=fuse)
    c = compare(_until(log, seconds), config)
    cpu_s = time.process_time() - start
    found = c.assessment
    ates = [a.ate_m for a in (found.ekf, found.smoother, found.dead_reckoned) if a]
    error = _pose_error(c)
    spread = c.ekf.estimate.pose_covariance[1:]
    nees = np.einsum("ki,kij,kj->k", error[1:], np.linalg.inv(spread), error[1:]) / 3.0
    a = c.agreement
    gaps = (max(g.sigma, g.covariance) for g in (a.algebra, a.model))
    figures = (
        *(float(ate or 0.0) for ate in ates),
        float(np.hypot(*error[-1, :2])),
        *_map_errors(c),
        float(nees.mean()),
        *gaps,
        a.linearisation.sigma,
        cpu_s,
    )
    seen = c.ekf.pose_landmarks
    row = Row(
        len(c.ekf.estimate.pose_landmarks), len(seen.merges.first), len(seen.measured), *figures
    )
    return row, c.verdict.outcome


def _pose_error(c: Comparison) -> NDArray[np.float64]:
    truth = c.log.truth.poses
    if truth is None:
        raise ValueError("the log has no true poses")
    error = c.ekf.estimate.pose - truth.at(c.ekf.estimate.time_s)
    error[:, 2] = np.mod(error[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    return np.asarray(error)


def _map_errors(c: Comparison) -> Iterator[float]:
    """Medians of the templates' distances before the closing and at the end."""
    source = c.find(ScanLandmarksFinding).source
    closing, found = source.closing, source.found
    if closing is None or c.log.truth.surfaces is None:
        raise ValueError("no scan moved a landmark, or there are no true surfaces")
    # Templates of landmarks that were fused later are other landmarks' by now.
    kept = np.isin(closing.landmark_index, c.ekf.estimate.pose_landmark_id)
    landmark_indices = closing.landmark_index[kept]
    for place in (closing.before[kept], c.ekf.pose_landmark_places[landmark_indices]):
        points = template_points(found, landmark_indices, place)
        yield error_of_points(points, c.log.truth.surfaces.segment).median_m


def _until(log: Log, seconds: float) -> Log:
    """The beginning of a drive; scans without odometry are not looked at."""
    odometry = log.odometry
    if not isinstance(odometry, SteeringOdometry):
        raise TypeError("expected a drive with steering")
    count = int(np.searchsorted(odometry.time_s, seconds))
    columns = ("time_s", "speed_mps", "steering_rad")
    short = {name: getattr(odometry, name)[:count] for name in columns}
    return replace(log, odometry=replace(odometry, **short))


if __name__ == "__main__":
    main()
