"""Errors against truth or GPS, with the coverage on which they were computed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index
from comparisons.checks.check import Check
from comparisons.checks.finding import Absent, Of
from comparisons.estimates.estimate import Estimate
from comparisons.figures import METRES, Aside, Count, Less, More, Named, percent, rows_of
from comparisons.logs.log import Landmarks, Log
from comparisons.plane import in_own_axes, rms
from comparisons.words import Row
from ekf_reference.core.geometry import wrap_angle

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known

RPE_M = 10.0
"""Way between the two poses whose relative pose is judged, along the true path."""
_RPE_SHARE = 0.1
"""The way to the pose nearest to that may differ by such a share."""
MATCH_M = 1.0
"""Unlabelled landmarks match true ones within this distance."""
_NEARER, _FAR_M = 3.0, 0.5
"""Another is so many times nearer than a landmark's own, which is farther than so much."""
_FEWEST_LABELS = 4
"""Landmarks of which a frame leaves those that are exchanged."""
SHORT_NAMES = {"odometry": "dead reckoning", "scans": "scan odometry"}
_KEYS = {"odometry": "dead_reckoning", "scans": "scan_odometry", "wheels": "wheels"}
"""What rows and results call what a line calls shortly."""
_COMPLEX = np.array([1.0, 1.0j])
"""Takes points to complex numbers."""
_ALIGNED = "distance to GPS, aligned"
Error = Less[float | None]
"""None where the log has no such reference."""


def _turn(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.2f} deg"


class TruthErrors(NamedTuple):
    """Errors of a trajectory at the instants (N,) of the true poses within its time.

    Attributes:
        time_s: (N,).
        distance_m: (N,) of its positions from the true ones, in the log's frame.
        heading_rad: (N,) turn between the headings, from 0 to pi.
    """

    time_s: Array
    distance_m: Array
    heading_rad: Array


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Errors of one estimate against truth or GPS; None where the log has no such reference.

    Aligned is after the rigid motion (no scale) that fits best: in least squares, but in least
    distances for the median to GPS, which holds outliers.

    Attributes:
        ate_m: root mean square error of the positions, in the log's frame.
        ate_aligned_m: the same after the best rigid alignment.
        rpe_10m_m: root mean square error of the relative position over 10 m of path.
        rpe_10m_rad: root mean square error of the relative heading over 10 m of path.
        landmark_rmse_m: root mean square error of the landmarks.
        landmark_rmse_aligned_m: the same after the trajectory's alignment.
        landmarks_found: true landmarks that the map has.
        landmarks_true: true landmarks that could be found.
        gps_median_m: median distance from GPS.
        gps_median_aligned_m: the same after the best rigid alignment.
        gps_rms_aligned_m: root mean square distance from GPS after that alignment.
        coverage: share of the reference's instants within the estimate's time.
        errors: errors of which ate_m is the root mean square; no part of a result file.
    """

    ate_m: Annotated[Error, Named("path (ATE)", METRES)] = None
    ate_aligned_m: Annotated[Error, Named("path, aligned (ATE)", METRES)] = None
    rpe_10m_m: Annotated[Error, Named("motion over 10 m (RPE)", METRES)] = None
    landmark_rmse_m: Annotated[Error, Named("landmarks (rms)", METRES)] = None
    landmark_rmse_aligned_m: Annotated[Error, Named("landmarks, aligned (rms)", METRES)] = None
    gps_median_m: Annotated[Error, Named("distance to GPS (median)", METRES)] = None
    gps_median_aligned_m: Annotated[Error, Named(f"{_ALIGNED} (median)", METRES)] = None
    gps_rms_aligned_m: Annotated[Error, Named(f"{_ALIGNED} (rms)", METRES)] = None
    rpe_10m_rad: Annotated[Error, Named("turn over 10 m (RPE)", _turn)] = None
    landmarks_found: Annotated[
        More[int | None], Named("true landmarks found", "{} of {.landmarks_true}")
    ] = None
    landmarks_true: Count[int | None] = None
    coverage: Annotated[More[float | None], Named("coverage of the log's time", percent)] = None
    errors: Aside[TruthErrors | None] = field(default=None, repr=False, compare=False)


@dataclass(frozen=True)
class Accuracies:
    """Accuracy of each estimate.

    Attributes:
        ekf: the filter.
        smoother: the smoother.
        dead_reckoning: the odometry alone.
    """

    ekf: Accuracy
    smoother: Accuracy
    dead_reckoning: Accuracy | None


class AccuracyFinding(Of[Mapping[str, Accuracy | None]]):
    """Errors of a job's estimates."""

    def __init__(
        self,
        each: Mapping[str, Accuracy | None],
        entries: Mapping[str, Any],
        held_out: Sequence[Row] = (),
    ) -> None:
        """each: by the name of the estimate. entries: as the job's result has them.

        held_out: rows on the positions that no estimator was given on purpose.
        """
        super().__init__(each, entries=entries)
        self.lines = accuracy_lines(each)
        self.held_out = held_out

    def rows(self) -> Sequence[Row]:
        """Return the rows of each, after those on what they are measured against."""
        return [*self.held_out] + [
            row
            for name, accuracy in self.value.items()
            for row in accuracy_rows(SHORT_NAMES.get(name, f"the {name}"), accuracy)
        ]


class CheckAccuracy(Check):
    """How far are the estimates from truth, or from the positions that were held back?"""

    name = "accuracy"
    needs = "true poses or landmarks, or absolute positions that no estimator has used"
    errs = "not at all: errors are reported and change no verdict"
    figures = (("accuracy", Accuracies),)

    def find(self, known: Known) -> AccuracyFinding | Absent:
        """Return the errors of each estimate, and of odometry alone beside our own."""
        judged, labelled = known.prepared.judged, known.prepared.labelled
        each = {
            name: assess(estimate, judged, labelled=labelled)
            for name, estimate in known.estimates.items()
        }
        if None in each.values():
            return Absent("the log has neither truth nor positions that no estimator has used")
        held_out = _held_out(known)
        if known.solved is None:
            return AccuracyFinding(each, {"accuracy": each["EKF"]}, held_out)
        optimum = each[known.called]
        if known.given is not None:
            both = {"accuracy": each["estimate"], "smoother_accuracy": optimum}
            return AccuracyFinding(each, both, held_out)
        ways = {"odometry": known.dead_reckoned} if known.ways is None else known.ways
        epochs_s = known.timeline.epoch_time_s
        beside = {name: assess_trajectory(epochs_s, pose, judged) for name, pose in ways.items()}
        entries: dict[str, object] = {
            "accuracy": optimum,
            **{_KEYS[name]: accuracy for name, accuracy in beside.items()},
        }
        if known.run is not None:
            compared = (each["EKF"], optimum, beside["odometry"])
            entries = {"accuracy": Accuracies(*compared)}  # type: ignore[arg-type]
        return AccuracyFinding(each | beside, entries, held_out)


def _held_out(known: Known) -> list[Row]:
    """What is said of the positions that are held out."""
    judging, positions = known.prepared.judged.positions, known.prepared.log.positions
    if known.prepared.ekf.gps != "half" or judging is None or positions is None:
        return []
    count, total = len(judging.time_s), len(positions.time_s)
    breaks = np.flatnonzero(np.diff(np.searchsorted(positions.time_s, judging.time_s)) > 1)
    words = f"{count:,} of {total:,}, in {len(breaks) + 1} blocks"
    return [Row("Accuracy", "positions held out", words)]


def accuracy_lines(each: Mapping[str, Accuracy | None]) -> list[tuple[str, str]]:
    """Return a line with an error of each estimate, by the best reference that all have."""
    for name, error in (
        ("ATE", "ate_m"),
        ("to GPS (median)", "gps_median_m"),
        ("landmarks, aligned (rms)", "landmark_rmse_aligned_m"),  # of what has no true poses
    ):
        found = {whose: getattr(a, error) for whose, a in each.items() if a is not None}
        known = [f"{whose} {value:.3g} m" for whose, value in found.items() if value is not None]
        if known:
            return [("accuracy", f"{name}: {', '.join(known)}")]
    return []


def accuracy_rows(of: str, accuracy: Accuracy | None) -> list[Row]:
    """Return the rows of errors, where there are any. of: whose, as `the EKF`."""
    return [] if accuracy is None else rows_of(f"Accuracy of {of}", accuracy)


def assess(estimate: Estimate, log: Log, *, labelled: bool) -> Accuracy | None:
    """Errors of an estimate against everything the log knows, or None when it knows nothing.

    labelled: landmark ids are the log's own, so that true landmarks are found by id; otherwise
    they are matched one to one by distance, in the log's frame.
    """
    figures = _of_trajectory(estimate.time_s, estimate.pose, log)
    if log.truth.landmarks is not None:
        table = log.truth.landmarks
        ours, theirs = match_truth(estimate, table, labelled=labelled)
        found, true = estimate.landmark[ours], table.position_m[theirs]
        figures["landmarks_found"], figures["landmarks_true"] = len(found), len(table.id)
        if len(found):
            figures["landmark_rmse_m"] = rms(found - true)
            figures["landmark_rmse_aligned_m"] = rms(aligned(found, true) - true)
    return Accuracy(**figures) if figures else None


def assess_trajectory(time_s: Array, pose: Array, log: Log) -> Accuracy | None:
    """The same of poses (K, 3) alone."""
    figures = _of_trajectory(time_s, pose, log)
    return Accuracy(**figures) if figures else None


def exchanged_labels(estimate: Estimate, log: Log, *, labelled: bool) -> str:
    """Say which landmarks lie at the true place of another label, in whatever frame; else nothing.

    labelled: as of `assess`; without labels there is none to exchange.
    """
    table = log.truth.landmarks
    if table is None or not labelled:
        return ""
    ours, theirs = match_truth(estimate, table, labelled=True)
    if len(ours) < _FEWEST_LABELS:
        return ""
    true, names = table.position_m[theirs], [estimate.names[i] for i in ours]
    found = at_others(aligned(estimate.landmark[ours], true, robust=True), true)
    if not found:
        return ""
    pairs = ", ".join(f"{names[i]} lies on {names[k]}" for i, k in found[:4])
    one = "1 landmark coincides with the truth of another label"
    some = f"{len(found)} landmarks coincide with the truth of other labels"
    return f"{one if len(found) == 1 else some}: {pairs}"


def at_others(points: Array, reference: Array) -> list[tuple[int, int]]:
    """Return points (N, 2) far from their own of a reference (N, 2), and the other that is near."""
    apart = np.linalg.norm(points[:, None] - reference[None], axis=2)
    own, nearest = np.diag(apart), apart.argmin(axis=1)
    other = np.flatnonzero(
        (nearest != np.arange(len(own))) & (_NEARER * apart.min(axis=1) < own) & (own > _FAR_M)
    )
    return list(zip(other.tolist(), nearest[other].tolist(), strict=True))


def landmark_errors(
    landmark_id: NDArray[np.int64], landmark: Array, log: Log, *, labelled: bool
) -> Array:
    """Distances (L,) [m] of landmarks (L, 2) from the true ones, NaN where none is matched."""
    found, table = np.full(len(landmark), np.nan), log.truth.landmarks
    if table is not None:
        ours, theirs = match_landmarks(
            (landmark_id, landmark), (table.id, table.position_m), labelled=labelled
        )
        found[ours] = np.linalg.norm(landmark[ours] - table.position_m[theirs], axis=1)
    return found


def _of_trajectory(time_s: Array, pose: Array, log: Log) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    truth, positions = log.truth, log.positions
    if positions is not None:
        at, fixes, figures["coverage"] = _at_times(
            time_s, pose, positions.time_s, positions.position_m, positions.antenna_m
        )
        if len(at):
            figures["gps_median_m"] = _median(at - fixes)
            figures["gps_median_aligned_m"] = _median(aligned(at, fixes, robust=True) - fixes)
            figures["gps_rms_aligned_m"] = rms(aligned(at, fixes) - fixes)
    if truth.poses is not None:
        at, true, figures["coverage"] = _at_times(
            time_s, pose, truth.poses.time_s, truth.poses.pose[:, :2]
        )
        if len(at):
            figures["ate_m"] = rms(at - true)
            figures["ate_aligned_m"] = rms(aligned(at, true) - true)
        inside = (truth.poses.time_s >= time_s[0]) & (truth.poses.time_s <= time_s[-1])
        clock, true_pose = truth.poses.time_s[inside], truth.poses.pose[inside]
        poses = np.column_stack([np.interp(clock, time_s, column) for column in pose.T])
        if len(at):
            turn = np.abs(wrap_angle(poses[:, 2] - true_pose[:, 2]))
            distance_m = np.linalg.norm(at - true, axis=1)
            figures["errors"] = TruthErrors(clock, distance_m, turn)
        apart, turned = relative_errors(poses, true_pose)
        if len(apart):
            figures["rpe_10m_m"] = rms(apart[:, None])
            figures["rpe_10m_rad"] = rms(turned[:, None])
    return figures


def relative_errors(pose: Array, true: Array, way_m: float = RPE_M) -> tuple[Array, Array]:
    """Errors (P,) [m] and (P,) [rad] of the relative poses between pairs of poses (N, 3).

    Of every pose and the one that lies way_m further along the true path (N, 3), or nearest to
    that, by at most a tenth of it: neither a frame nor an error before the pair enters. It is the
    RPE of evo over metres with all pairs, these taken from the reference.
    """
    first, second = _pairs(true[:, :2], way_m)
    moved = [in_own_axes(path[first], path[second]) for path in (pose, true)]
    error = moved[0] - moved[1]
    return np.hypot(error[:, 0], error[:, 1]), np.abs(wrap_angle(error[:, 2]))


def _pairs(path: Array, way_m: float) -> tuple[Index, Index]:
    """Rows of a path (N, 2) and of what lies way_m further on; of a stop its first row."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    gone = np.concatenate(([0.0], np.cumsum(steps)))[: len(path)]
    beyond = np.minimum(np.searchsorted(gone, gone + way_m), len(gone) - 1)
    short = np.searchsorted(gone, gone[beyond - 1])
    nearer = np.abs(gone[short] - gone - way_m) <= np.abs(gone[beyond] - gone - way_m)
    second = np.where(nearer, short, beyond)
    found = np.abs(gone[second] - gone - way_m) <= _RPE_SHARE * way_m
    return np.flatnonzero(found), second[found]


def aligned(points: Array, reference: Array, *, robust: bool = False) -> Array:
    """Points (N, 2) moved rigidly, without scale, to fit the reference (N, 2) best.

    Least squares, or with `robust` least sum of distances (by reweighting), which outliers in the
    reference, such as GPS, do not pull.
    """
    weight = np.ones(len(points))
    moved = points
    for _ in range(30 if robust else 1):
        centre = np.average(points, axis=0, weights=weight)
        target = np.average(reference, axis=0, weights=weight)
        moving = (points - centre) @ _COMPLEX
        fixed = (reference - target) @ _COMPLEX
        turned = moving * np.exp(1j * np.angle(np.vdot(moving, weight * fixed)))
        moved = np.column_stack((turned.real, turned.imag)) + target
        weight = 1.0 / np.maximum(np.linalg.norm(moved - reference, axis=1), 1e-3)
    return moved


def rigid_motion(points: Array, reference: Array) -> Callable[[Array], Array]:
    """The motion of `aligned` (least squares), to be applied to other points (N, 2)."""
    centre, target = points.mean(axis=0), reference.mean(axis=0)
    moving, fixed = (points - centre) @ _COMPLEX, (reference - target) @ _COMPLEX
    turn = np.angle(np.vdot(moving, fixed))
    cos, sin = np.cos(turn), np.sin(turn)
    return lambda other: (other - centre) @ np.array(((cos, sin), (-sin, cos))) + target


def match_landmarks(
    ours: tuple[NDArray[np.int64], Array],
    theirs: tuple[NDArray[np.int64], Array],
    *,
    labelled: bool,
) -> tuple[Index, Index]:
    """Rows of the landmarks that both have, given as ids (L,) and places (L, 2).

    labelled: by id, else one to one by distance.
    """
    if labelled:
        return np.intersect1d(ours[0], theirs[0], return_indices=True)[1:]
    return match_by_distance(ours[1], theirs[1])


def match_truth(estimate: Estimate, table: Landmarks, *, labelled: bool) -> tuple[Index, Index]:
    """Rows of the landmarks that an estimate and the truth have, as of `match_landmarks`."""
    return match_landmarks(
        (estimate.landmark_id, estimate.landmark), (table.id, table.position_m), labelled=labelled
    )


def match_by_distance(points: Array, reference: Array) -> tuple[Index, Index]:
    """Indices of the one-to-one matches with least total distance, none beyond MATCH_M."""
    from scipy.optimize import linear_sum_assignment  # takes long to load

    distance = np.linalg.norm(points[:, None] - reference[None], axis=2)
    rows, columns = linear_sum_assignment(np.minimum(distance, MATCH_M))
    near = distance[rows, columns] < MATCH_M
    return rows[near], columns[near]


def _at_times(
    t: Array,
    pose: Array,
    time_s: Array,
    reference: Array,
    point_m: tuple[float, float] = (0.0, 0.0),
) -> tuple[Array, Array, float]:
    """Estimated places of a point on the vehicle (forward, left), their references, coverage.

    At the reference times within the estimate's span, between its poses by interpolation.
    """
    inside = (time_s >= t[0]) & (time_s <= t[-1])
    x, y, heading = (np.interp(time_s[inside], t, pose[:, i]) for i in range(3))
    forward, left = point_m
    cos, sin = np.cos(heading), np.sin(heading)
    at = np.column_stack((x + cos * forward - sin * left, y + sin * forward + cos * left))
    return at, reference[inside], float(np.mean(inside)) if len(inside) else 0.0


def _median(error: Array) -> float:
    return float(np.median(np.linalg.norm(error, axis=1)))
