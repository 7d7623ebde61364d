"""S'': the smoother with alignments of its own matcher beside S, which has the filter's.

Both align the same template with the same scan, so what the noise does to the scan it does to
both, and alignments differ by much less than the sum of their covariances. A landmark's are held
against that sum. A shift that all have in common is held against how much they scatter about it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from scipy.stats import chi2, f

from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import Accuracy, aligned
from comparisons.checks.agreement import Gaussian, block_agreement
from comparisons.checks.map_agreement import MapPair
from comparisons.estimates.estimate import Estimate
from comparisons.figures import Aside, Figure, LeftOut, Less, Named, Same
from comparisons.plane import pose_difference, rms
from comparisons.statistics import squared_distance
from comparisons.words import Cause
from graphslam.graph_builder import to_tangent
from graphslam.optimum import Optimality
from graphslam.problem import PoseLandmarkMeasurements
from graphslam.sensor_frame import in_words

MATCHER = "Open3D, generalised ICP"
GATE = float(chi2.ppf(0.99, 3))
"""A landmark's alignments contradict when their mean squared distance is more: as the filter's own
gate, for alignments that differ as if nothing were shared."""
LEAST_SEEN = 3
"""Alignments of a landmark, or landmarks, fewer than which say nothing of what they share."""
_NOTHING = np.eye(3) / 2.0**2
"""Information that no difference is expected, to 2 m and rad: along what a shape leaves open both
alignments stay where they were initialised, and their difference there is not known."""
_SHIFTED = 0.999
"""Certainty at which all alignments are shifted."""


@dataclass(frozen=True, kw_only=True)
class LandmarkMatching:
    """How the alignments of one template differ, the filter's minus the smoother's own.

    Of differences only what the shape fixes is compared.

    Attributes:
        id: id of the landmark.
        common: scans that both aligned with it.
        distance_sigma: root of the mean squared distance over 3, by the sum of both covariances.
        shift_m: weighted mean difference in x and y, in the vehicle's frame.
        shift_rad: weighted mean difference in heading.
        worst_time_s: time of the alignment that differs most.
        worst_m: its difference in x and y.
        worst_rad: its difference in heading.
        worst_sigma: its distance, in sigma.
        contradicts: whether they are farther apart than both covariances allow.
    """

    id: int
    common: int
    distance_sigma: Figure
    shift_m: tuple[float, float]
    shift_rad: float
    worst_time_s: float
    worst_m: tuple[float, float]
    worst_rad: float
    worst_sigma: Figure
    contradicts: bool


@dataclass(frozen=True, kw_only=True)
class OwnMatchingCheck:
    """Entry `own_matching`: the smoother with its own matcher, the gap S - S''.

    Attributes:
        matcher: name of the matcher.
        filter: alignments of the filter, initialised landmarks left out.
        own: alignments of the smoother.
        common: alignments of both.
        distance_sigma: root mean square distance of the common ones, in sigma; None without any.
        shift_m: what all differences have in common, x and y; few landmarks that contradict are
            left out.
        shift_rad: the same in heading.
        shift_sigma: the same in sigma; None for too few alignments.
        landmarks: each landmark, farthest apart first.
        ekf: the EKF's scan landmarks and those of this smoother.
        smoother: the first smoother's scan landmarks and those of this smoother.
        pose_difference_m: distance of the last poses.
        pose_distance_sigma: the same, by the sum of both covariances.
        path_ekf_m: root mean square distance of the EKF's path from this smoother's path.
        path_smoother_m: root mean square distance of the first smoother's path from this
            smoother's.
        agrees: whether the two matchers agree.
        verified: whether the optimum of this smoother is verified.
        chi2: its chi-square.
        dof: its degrees of freedom.
        reasons: scans without an alignment of its own, by reason.
        accuracy: errors of this smoother.
        shifted: whether all alignments are shifted together.
        estimates_agree: whether S and S'' agree, as far as both are sure.
        squared: (C,) squared distances of the common ones by the sum of both covariances.
        estimate: of this smoother.
        alignments: the own ones, as the matcher made them.
    """

    matcher: Annotated[str, Named("matcher", "{}")] = MATCHER
    filter: Annotated[int, Named("alignments by the filter's matcher")]
    own: Annotated[int, Named("alignments by its own matcher")]
    common: Annotated[int, Named("alignments by both")]
    distance_sigma: Less[Figure | None]
    shift_m: tuple[float, float]
    shift_rad: LeftOut[float]
    shift_sigma: Less[Figure | None]
    landmarks: tuple[LandmarkMatching, ...]
    ekf: MapPair
    smoother: MapPair
    pose_difference_m: Less[float]
    pose_distance_sigma: Less[Figure]
    path_ekf_m: Less[float]
    path_smoother_m: Less[float]
    agrees: bool
    verified: bool
    chi2: Same[float]
    dof: int
    reasons: dict[str, int] = field(default_factory=dict)
    accuracy: Accuracy | None = None
    shifted: Aside[bool]
    estimates_agree: Aside[bool]
    squared: Aside[Array]
    estimate: Aside[Estimate]
    alignments: Aside[PoseLandmarkMeasurements]

    @property
    def contradicting(self) -> tuple[LandmarkMatching, ...]:
        """Landmarks whose alignments contradict."""
        return tuple(landmark for landmark in self.landmarks if landmark.contradicts)


def check_own_matching(
    measurements: tuple[PoseLandmarkMeasurements, PoseLandmarkMeasurements],
    ekf: Estimate,
    smoothed: Estimate,
    estimate: Estimate,
    optimality: Optimality,
) -> OwnMatchingCheck:
    """Compare. measurements: what S and what S'' were given. estimate, optimality: of S''."""
    filters, pose_landmark_measurements = measurements
    used = (_later(filters), _later(pose_landmark_measurements))
    common = sorted(used[0].keys() & used[1].keys())
    rows = [np.array([one[pair] for pair in common], dtype=np.intp) for one in used]
    difference = pose_difference(
        filters.measured[rows[0]], pose_landmark_measurements.measured[rows[1]]
    )
    spread = _in_poses_frame(filters, rows[0]) + _in_poses_frame(
        pose_landmark_measurements, rows[1]
    )
    information = np.linalg.inv(spread).astype(np.float64)
    squared = np.einsum("ni,nij,nj->n", difference, information, difference)
    epoch, landmark_index = np.array(common, dtype=np.intp).reshape(-1, 2).T
    at_s, which = ekf.time_s[epoch], np.unique(landmark_index).tolist()
    landmarks = [
        _of_landmark(s, np.flatnonzero(landmark_index == s), at_s, difference, information, squared)
        for s in which
    ]
    wrong = [landmark.id for landmark in landmarks if landmark.contradicts]
    # Of a shift that all share, all speak; a few that contradict are no part of it.
    sound = ~np.isin(landmark_index, wrong if 2 * len(wrong) < len(landmarks) else [])
    initialised = tuple(ones.count for ones in (filters, pose_landmark_measurements))
    path = [e.pose[:, :2] - estimate.pose[:, :2] for e in (ekf, smoothed)]
    last = [Gaussian.of_pose(e.pose[-1], e.joint_covariance[:3, :3]) for e in (smoothed, estimate)]
    both = replace(last[1], covariance=last[0].covariance + last[1].covariance)
    shift, squared_shift, freedom = common_shift(
        landmark_index[sound], difference[sound], information[sound]
    )
    pose, frames = block_agreement(last[0], both), compare_frames(smoothed, estimate)
    # F, for the scatter is measured, too.
    shifted = freedom > 0 and squared_shift > 3.0 * float(f.ppf(_SHIFTED, 3, freedom))
    agree = frames.agrees and pose.distance_sigma**2 * 3.0 <= GATE
    return OwnMatchingCheck(
        filter=len(filters.measured) - initialised[0],
        own=len(pose_landmark_measurements.measured) - initialised[1],
        common=len(common),
        distance_sigma=_sigma(squared.mean()) if len(squared) else None,
        shift_m=_place(shift),
        shift_rad=float(shift[2]),
        shift_sigma=_sigma(squared_shift) if squared_shift > 0.0 else None,
        landmarks=tuple(sorted(landmarks, key=lambda landmark: -landmark.distance_sigma)),
        ekf=compare_frames(ekf, estimate),
        smoother=frames,
        pose_difference_m=pose.difference_m,
        pose_distance_sigma=pose.distance_sigma,
        path_ekf_m=rms(path[0]),
        path_smoother_m=rms(path[1]),
        agrees=agree and not shifted and not any(landmark.contradicts for landmark in landmarks),
        verified=optimality.verified,
        chi2=optimality.chi_square.chi2,
        dof=optimality.chi_square.dof,
        shifted=shifted,
        estimates_agree=agree,
        squared=squared,
        estimate=estimate,
        alignments=pose_landmark_measurements,
    )


def common_shift(
    landmark_index: Index, difference: Array, information: Array
) -> tuple[Array, float, int]:
    """What differences (C, 3) have in common, (3,), its squared distance, the scatter's freedom.

    landmark_index: (C,) whose they are. information: (C, 3, 3) of each. A template's differences
    count as one, and the scatter about the shift is measured: it is less than stated, as the noise
    of scan and template is shared. Fewer than three landmarks have nothing in common: 0, 0.
    """
    _, which, count = np.unique(landmark_index, return_inverse=True, return_counts=True)
    if len(count) < LEAST_SEEN:
        return np.zeros(3), 0.0, 0
    weight = information / count[which][:, None, None]
    total = weight.sum(axis=0)
    shift = np.linalg.solve(total, np.einsum("nij,nj->i", weight, difference))
    rest = difference - shift
    freedom = 3 * (len(count) - 1)
    scatter = float(np.einsum("ni,nij,nj->", rest, weight, rest)) / freedom
    return shift, float(shift @ total @ shift) / max(scatter, np.finfo(float).tiny), freedom


def compare_frames(first: Estimate, second: Estimate) -> MapPair:
    """Scan landmarks that both have, x, y and heading, by the sum of both covariances."""
    _, i, j = np.intersect1d(
        first.pose_landmark_id, second.pose_landmark_id, assume_unique=True, return_indices=True
    )
    if not len(i):
        return MapPair.of(0.0, 0.0, np.zeros(0), 3, 0)
    a, b = first.pose_landmarks[i], second.pose_landmarks[j]
    apart = pose_difference(a, b)
    total = first.pose_landmark_covariances()[i] + second.pose_landmark_covariances()[j]
    squared = squared_distance(apart, total)
    return MapPair.of(
        rms(apart[:, :2]),
        rms(aligned(a[:, :2], b[:, :2]) - b[:, :2]),
        squared,
        3,
        int(np.count_nonzero(~(squared <= GATE))),  # what is no number lies nowhere
    )


def _of_landmark(
    landmark_index: int,
    rows: Index,
    time_s: Array,
    difference: Array,
    information: Array,
    squared: Array,
) -> LandmarkMatching:
    weight, worst = information[rows], int(rows[np.argmax(squared[rows])])
    mean = np.einsum("nij,nj->i", weight, difference[rows]) / len(rows)
    shift = np.linalg.solve(weight.mean(axis=0) + _NOTHING, mean)
    there, mean_squared = information[worst], float(squared[rows].mean())
    apart = np.linalg.solve(there + _NOTHING, there @ difference[worst])
    return LandmarkMatching(
        id=landmark_index,
        common=len(rows),
        distance_sigma=_sigma(mean_squared),
        shift_m=_place(shift),
        shift_rad=float(shift[2]),
        worst_time_s=float(time_s[worst]),
        worst_m=_place(apart),
        worst_rad=float(apart[2]),
        worst_sigma=_sigma(float(squared[worst])),
        contradicts=len(rows) >= LEAST_SEEN and mean_squared > GATE,
    )


def _place(difference: Array) -> tuple[float, float]:
    return float(difference[0]), float(difference[1])


def _sigma(squared: float) -> float:
    """Root of a squared distance over its three degrees of freedom."""
    return float(np.sqrt(squared / 3.0))


def _later(measurements: PoseLandmarkMeasurements) -> dict[tuple[int, int], int]:
    """Rows of measurements by pose and landmark, but for those in which a landmark begins."""
    rows: dict[tuple[int, int], int] = {}
    initialised: set[int] = set()
    for row in np.argsort(measurements.pose, kind="stable").tolist():
        landmark_index = int(measurements.landmark[row])
        if landmark_index in initialised:
            rows[int(measurements.pose[row]), landmark_index] = row
        initialised.add(landmark_index)
    return rows


def _in_poses_frame(measurements: PoseLandmarkMeasurements, rows: Index) -> Array:
    """(C, 3, 3) covariances in the frame of the pose that sees, not of the landmark."""
    turn = to_tangent(measurements.measured[rows, 2])
    return turn.transpose(0, 2, 1) @ measurements.covariance[rows] @ turn


_NAMED = 3
"""So many landmarks are named."""


def matching_cause(check: OwnMatchingCheck) -> Cause:
    """S against S''."""
    parts = []
    hint = (
        "check the alignments that only one of the two made: at loops, and where places look alike"
    )
    if check.shifted:
        (x, y), turn = check.shift_m, check.shift_rad
        parts.append(
            f"all alignments of the filter are shifted by {in_words(x, y, digits=3)} "
            f"and {np.degrees(turn):.2f} degrees from the smoother's own "
            f"({check.shift_sigma:.1f} sigma)"
        )
        hint = "check the sign and zero of the alignment's heading, and the mount of the scanner"
    if check.contradicting:
        parts += [_apart_for(matching) for matching in check.contradicting[:_NAMED]]
        if len(check.contradicting) > _NAMED:
            parts.append(f"{len(check.contradicting) - _NAMED} more landmarks differ like this")
        if not check.shifted:
            hint = (
                "check the alignments of these landmarks: the axes of the template, R, and another "
                "place that looks alike"
            )
    if not check.estimates_agree:
        pair = check.smoother
        if check.landmarks and not (check.contradicting or check.shifted):
            parts.append(f"the largest difference: {_apart_for(check.landmarks[0])}")
        parts.append(
            "the smoother's own matcher moves its last pose by "
            f"{check.pose_difference_m:.2f} m ({check.pose_distance_sigma:.1f} sigma) and its path "
            f"by {check.path_smoother_m:.2f} m (RMS), and {pair.outside} of {pair.landmarks} scan "
            f"landmarks lie outside their 99 % region; the filter has {check.filter:,} alignments "
            f"and the smoother {check.own:,}, of which {check.common:,} have the same landmark and "
            "scan"
        )
    return Cause("matching", "; ".join(parts), hint)


def _apart_for(matching: LandmarkMatching) -> str:
    """How two matchers differ on a landmark, and in which scan the most."""
    place, worst = np.hypot(*matching.shift_m), np.hypot(*matching.worst_m)
    return (
        f"the filter's alignments of scan landmark {matching.id} differ by {place:.2f} m and "
        f"{np.degrees(matching.shift_rad):.1f} degrees from the smoother's own "
        f"({matching.distance_sigma:.1f} sigma over {matching.common} scans; in the scan at "
        f"{matching.worst_time_s:.1f} s {worst:.2f} m and "
        f"{np.degrees(matching.worst_rad):.1f} degrees, {matching.worst_sigma:.1f} sigma)"
    )
