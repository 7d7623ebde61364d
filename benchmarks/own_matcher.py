"""Two matchers of scan landmarks on Nieto's environment (Nieto 2005, section 5.6, Table 5.1).

    python benchmarks/own_matcher.py [--seeds 1,3]

Per drive: errors of the filter, of the smoother on its alignments, and of the smoother on its own;
NEES over 3 of the poses of both smoothers, and of z of both matchers, where a landmark's true axis
is where its template was taken, so that its noise counts; how far the two are apart; seconds.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.estimates.estimate import Estimate
from comparisons.extensions.own_matching.extension import OwnMatchingFinding
from comparisons.logs.simulate.scan_drive import scan_slam, simulate
from comparisons.pipeline.compare import Comparison, compare
from comparisons.settings import run_config
from graphslam.graph_builder import to_tangent
from graphslam.problem import PoseLandmarkMeasurements
from graphslam.scan import planar

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """One drive. Errors [m] at all times; NEES over 3, of poses and of z."""

    ekf_m: float
    shared_m: float
    own_m: float
    shared_nees: float
    own_nees: float
    z_filter: float
    z_own: float
    used_filter: int
    used_own: int
    apart: float
    filter_s: float
    own_s: float


def main() -> None:
    """Run all and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="1,3")
    choices = parser.parse_args()
    print("seed ", *(f"{name:>11}" for name in Row.__dataclass_fields__), "  verdict")
    for seed in map(int, choices.seeds.split(",")):
        log = simulate(np.random.default_rng(seed), scan_slam())
        c = compare(log, run_config(landmarks="scans", smoother_matcher="generalised-icp"))
        shown = (f"{value:11.3g}" for value in vars(measured(c)).values())
        print(f"{seed:4} ", *shown, f"  {c.verdict.outcome}", flush=True)


def measured(c: Comparison) -> Row:
    """The figures of one run."""
    own, poses = c.find(OwnMatchingFinding).own, c.log.truth.poses
    if poses is None:
        raise ValueError("the log has no true poses")
    truth = poses.at(c.ekf.estimate.time_s)
    ekf, shared, alone = (
        float(a.ate_m or 0.0) if a else 0.0
        for a in (c.accuracy.ekf, c.accuracy.smoother, own.accuracy)
    )
    return Row(
        ekf,
        shared,
        alone,
        pose_nees(c.smoothed, truth),
        pose_nees(own.estimate, truth),
        measurement_nees(c.ekf.pose_landmarks, own.alignments, truth),
        measurement_nees(own.alignments, own.alignments, truth),
        own.measurements[0],
        own.measurements[1],
        math.sqrt(float(own.squared.mean()) / 3.0),
        c.seconds["ekf"],
        c.seconds["own matcher"],
    )


def pose_nees(estimate: Estimate, truth: Array) -> float:
    """Mean over 3 of all poses but the first."""
    error = estimate.pose[1:] - truth[1:]
    error[:, 2] = np.mod(error[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    inverse = np.linalg.inv(estimate.pose_covariance[1:])
    return float(np.einsum("ki,kij,kj->k", error, inverse, error).mean() / 3.0)


def measurement_nees(
    seen: PoseLandmarkMeasurements, initialised: PoseLandmarkMeasurements, truth: Array
) -> float:
    """Mean over 3 of all measurements but each landmark's first, which `initialised` holds."""
    axis: dict[int, Array] = {}
    for pose, landmark_index, z in zip(
        initialised.pose.tolist(), initialised.landmark.tolist(), initialised.measured, strict=True
    ):
        axis.setdefault(landmark_index, planar.compose(truth[pose], z))
    later = np.setdiff1d(np.arange(len(seen.pose)), np.unique(seen.landmark, return_index=True)[1])
    true = [planar.between(truth[seen.pose[i]], axis[int(seen.landmark[i])]) for i in later]
    error = np.array(
        [planar.wrapped(seen.measured[i] - at) for i, at in zip(later, true, strict=True)]
    )
    turn = to_tangent(seen.measured[later, 2])
    inverse = np.linalg.inv(turn.transpose(0, 2, 1) @ seen.covariance[later] @ turn)
    return float(np.einsum("ni,nij,nj->n", error, inverse, error).mean() / 3.0)


if __name__ == "__main__":
    main()
