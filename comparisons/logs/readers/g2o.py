"""g2o graphs of poses and of landmarks, as graphslam.g2o reads them.

There are no times, so pose k gets k seconds; landmarks keep their numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from comparisons.errors import InputError
from comparisons.logs.log import LandmarkMeasurements, Log, LoopClosures, Positions, Prior
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.table import first_words, reading, stem
from comparisons.logs.validation import LARGEST
from graphslam.g2o import read_g2o
from graphslam.g2o import recognises as knows
from graphslam.problem import SlamProblem


def recognises(path: Path) -> bool:
    """A text file whose first record starts with one of g2o's tags, be it of a kind not read."""
    return any(knows(word) for word in first_words(path)[:1])


def read(path: Path) -> Log:
    """Read the file. Raises InputError naming the line at fault."""
    with reading(path):
        try:
            problem, _, _, notes, ids = read_g2o(path)
        except (ValueError, ArithmeticError) as error:
            raise InputError(str(error)) from None
    closed = problem.loop_closures
    if not len(problem.increment):
        raise InputError(f"{path}: expected EDGE_SE2 lines")
    if len(problem.surveyed):
        raise InputError(f"{path}: EDGE_PRIOR_XY lines can be solved, but not read as a log")
    _bounded(path, problem, notes)
    order = np.argsort(problem.measurement_pose, kind="stable")
    fixes = np.argsort(problem.position_pose, kind="stable")
    positions = closures = None
    if len(fixes):
        time_s = problem.position_pose[fixes].astype(float)
        covariance = problem.position_covariance[fixes]
        positions = Positions(time_s, problem.position[fixes], covariance)
    if len(closed.first) or not len(problem.z):  # a graph of poses, which may close no loop
        ends = closed.first.astype(float), closed.second.astype(float)
        closures = LoopClosures(*ends, closed.motion, closed.covariance)
    return Log(
        name=stem(path),
        format="g2o",
        prior=Prior(0.0, problem.prior_pose, problem.prior_covariance),
        odometry=RelativePoses(
            np.arange(1.0, problem.pose_count), problem.increment, problem.increment_covariance
        ),
        measurements=LandmarkMeasurements.of(
            problem.measurement_pose[order].astype(float),
            problem.z[order],
            problem.sigma[order],
            ids[problem.measurement_landmark[order]],
        ),
        positions=positions,
        loop_closures=closures,
        provenance={"times": "pose numbers in place of seconds", **notes},
    )


def _bounded(path: Path, problem: SlamProblem, notes: Mapping[str, str]) -> None:
    """Refuse edges whose information says nothing, by their lines where they are few."""
    largest = max(
        float(np.max(one, initial=0.0, where=np.isfinite(one)))
        for one in (problem.increment_covariance, problem.loop_closures.covariance)
    )
    if largest > LARGEST and "extreme" in notes:
        raise InputError(
            f"{path}: {notes['extreme']}; a variance of {largest:.2g} says nothing, expected at "
            f"most {LARGEST:g}; correct the information, or remove the lines"
        )
