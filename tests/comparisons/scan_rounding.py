"""Whether Scan-SLAM's results depend on rounding: what two runs decide, and how far they differ."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from comparisons.arrays import Array
from comparisons.extensions.scan_landmarks.extension import ScanLandmarksFinding
from comparisons.jobs.run import compare
from comparisons.logs.log import Log
from comparisons.settings import run_config
from ekf_reference.scan_landmarks.segmentation import Quality, quality
from ekf_reference.scan_landmarks.templates import Observation, observe


class Step(NamedTuple):
    """One alignment: what was decided, and z and R where they are used."""

    decided: tuple[Any, ...]
    z: Array | None = None
    covariance: Array | None = None


@dataclass(frozen=True)
class Outcome:
    """What a run came to.

    decided: verdict, landmarks' indices, counts of reasons and of merges. place: (1 + Q, 3) final
    pose and landmarks, with standard deviations sigma. steps: all alignments in their order.
    """

    decided: tuple[Any, ...]
    place: Array
    sigma: Array
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Difference:
    """Between two runs.

    stays: verdict, landmarks and counts. first: the first decision that differs, in words, empty
    where none does. z: greatest difference of z in sigmas, until then. result: of final pose and
    landmarks, in sigmas.
    """

    stays: bool
    first: str
    z: float
    result: float


def outcome(log: Log, **options: Any) -> Outcome:
    """Run Scan-SLAM and the smoother over a log. options: as run_config takes them."""
    with recorded() as steps:
        c = compare(log, run_config(landmarks="scans", **options))
    source, estimate = c.find(ScanLandmarksFinding).source, c.ekf.estimate
    return Outcome(
        decided=(
            c.verdict.outcome,
            tuple(np.asarray(estimate.pose_landmark_id).tolist()),
            tuple(sorted(source.found.reasons.items())),
            source.found.rejected,
            source.merged,
        ),
        place=np.vstack((estimate.pose[-1:], estimate.pose_landmarks)),
        sigma=np.sqrt(np.diag(estimate.joint_covariance)).reshape(-1, 3),
        steps=tuple(steps),
    )


@contextmanager
def recorded() -> Iterator[list[Step]]:
    """Record the alignments of Scan-SLAM that are made meanwhile."""
    steps = list[Step]()

    def observing(*args: Any) -> Observation:
        seen = observe(*args)
        if seen.alignment is None or not seen.usable:
            steps.append(Step(("observed", seen.reason)))
        else:
            found = seen.alignment
            steps.append(
                Step(("observed", found.open_directions, "open"), found.pose, found.covariance)
            )
        return seen

    def trying(*args: Any) -> Quality:
        found = quality(*args)
        kept = (np.zeros(3), found.covariance) if found.accepted else ()
        steps.append(Step(("tried", len(args[0]), "returns", "accepted" * found.accepted), *kept))
        return found

    with (
        patch("ekf_reference.scan_landmarks.scan_slam.observe", observing),
        patch("ekf_reference.scan_landmarks.scan_slam.quality", trying),
    ):
        yield steps


def difference(one: Outcome, other: Outcome) -> Difference:
    """Compare two runs."""
    moved, first = 0.0, ""
    for number, (a, b) in enumerate(zip(one.steps, other.steps, strict=False)):
        if a.decided != b.decided:
            first = f"alignment {number}: {a.decided}, {b.decided}"
            break
        if a.z is not None and b.z is not None and a.covariance is not None:
            moved = max(moved, _apart(a.z, b.z, np.sqrt(np.diag(a.covariance))))
    if not first and (one.decided, len(one.steps)) != (other.decided, len(other.steps)):
        first = f"{one.decided}, {other.decided}"
    result = np.inf
    if one.place.shape == other.place.shape:
        result = _apart(one.place, other.place, one.sigma)
    return Difference(one.decided == other.decided, first, moved, result)


def _apart(one: Array, other: Array, sigma: Array) -> float:
    """Greatest difference of poses (..., 3), in sigmas."""
    apart = other - one
    apart[..., 2] = np.mod(apart[..., 2] + np.pi, 2.0 * np.pi) - np.pi
    return float(np.max(np.abs(apart) / sigma))
