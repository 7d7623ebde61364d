"""S'': the smoother with alignments of its own matcher beside S, which has the filter's.

Both align the same template with the same scan, so what the noise does to the scan it does to
both, and alignments differ by much less than the sum of their covariances. A landmark's are held
against that sum. A shift that all have in common is held against how much they scatter about it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2, f

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import Accuracy, aligned
from comparisons.checks.agreement import BlockAgreement, Gaussian, block_agreement
from comparisons.checks.causes import Cause
from comparisons.checks.map_agreement import Pair
from comparisons.estimates.estimate import Estimate
from ekf_reference.core.geometry import wrap_angle
from graphslam.graph_builder import to_tangent
from graphslam.optimum import Optimality
from graphslam.problem import PoseLandmarkMeasurements

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

    landmark_index: of the landmark. common: scans that both aligned it with. squared: mean squared
    distance by the sum of both covariances, 3 if they were independent. shift: (3,) the weighted
    mean difference, in the vehicle's frame. worst_epoch: of the scan where they are farthest apart;
    worst: the difference (3,) there, and worst_squared its squared distance. Of differences only
    what the shape fixes is compared.
    """

    landmark_index: int
    common: int
    squared: float
    shift: Array
    worst_epoch: int
    worst: Array
    worst_squared: float

    @property
    def contradicts(self) -> bool:
        """Whether they are farther apart than both covariances allow."""
        return self.common >= LEAST_SEEN and self.squared > GATE


@dataclass(frozen=True, kw_only=True)
class OwnMatchingCheck:
    """The matching gap, S - S''.

    measurements: alignments, initialised landmarks left out: the filter's, the smoother's own, and
    those of one landmark in one scan that both made. squared: (C,) squared distances of these by
    the sum of both covariances. landmarks: farthest apart first. shift: (3,) what all differences
    have in common, few landmarks that contradict left out; shift_squared: its squared distance, 0
    for fewer than three landmarks; shift_freedom: degrees of freedom of the scatter that this is
    by.
    ekf, smoother: each of the two against S'', all scan landmarks that
    they share. pose: S against S'' in the last pose, by the sum of both covariances. path_rms_m:
    between the paths of the EKF and S'', and of S and S''. estimate, optimality, accuracy: of S''.
    alignments: the own ones, as the matcher made them. reasons: what became of the own matches.
    """

    measurements: tuple[int, int, int]
    squared: Array
    landmarks: tuple[LandmarkMatching, ...]
    shift: Array
    shift_squared: float
    shift_freedom: int
    ekf: Pair
    smoother: Pair
    pose: BlockAgreement
    path_rms_m: tuple[float, float]
    estimate: Estimate
    optimality: Optimality
    alignments: PoseLandmarkMeasurements
    accuracy: Accuracy | None = None
    reasons: Counter[str] = field(default_factory=Counter)

    @property
    def contradicting(self) -> tuple[LandmarkMatching, ...]:
        """Landmarks whose alignments contradict."""
        return tuple(one for one in self.landmarks if one.contradicts)

    @property
    def shifted(self) -> bool:
        """Whether all alignments are shifted together: F, for the scatter is measured, too."""
        freedom = self.shift_freedom
        return freedom > 0 and self.shift_squared > 3.0 * float(f.ppf(_SHIFTED, 3, freedom))

    @property
    def estimates_agree(self) -> bool:
        """Whether S and S'' agree, as far as both are sure."""
        return self.smoother.agrees and self.pose.distance**2 * 3.0 <= GATE

    @property
    def agrees(self) -> bool:
        """Whether nothing speaks against the filter's matcher."""
        return self.estimates_agree and not self.shifted and not self.contradicting


def check_own_matching(
    measurements: tuple[PoseLandmarkMeasurements, PoseLandmarkMeasurements],
    ekf: Estimate,
    smoothed: Estimate,
    estimate: Estimate,
    optimality: Optimality,
) -> OwnMatchingCheck:
    """Compare. measurements: what S and what S'' were given. estimate, optimality: of S''."""
    filters, own = measurements
    used = (_later(filters), _later(own))
    common = sorted(used[0].keys() & used[1].keys())
    rows = [np.array([one[pair] for pair in common], dtype=np.intp) for one in used]
    difference = filters.measured[rows[0]] - own.measured[rows[1]]
    difference[:, 2] = wrap_angle(difference[:, 2])
    spread = _in_poses_frame(filters, rows[0]) + _in_poses_frame(own, rows[1])
    information = np.linalg.inv(spread).astype(np.float64)
    squared = np.einsum("ni,nij,nj->n", difference, information, difference)
    epoch, landmark_index = np.array(common, dtype=np.intp).reshape(-1, 2).T
    landmarks = [
        _of_landmark(
            s, np.flatnonzero(landmark_index == s), epoch, difference, information, squared
        )
        for s in np.unique(landmark_index).tolist()
    ]
    wrong = [one.landmark_index for one in landmarks if one.contradicts]
    # Of a shift that all share, all speak; a few that contradict are no part of it.
    sound = ~np.isin(landmark_index, wrong if 2 * len(wrong) < len(landmarks) else [])
    initialised = tuple(ones.count for ones in (filters, own))
    path = [e.pose[:, :2] - estimate.pose[:, :2] for e in (ekf, smoothed)]
    last = [Gaussian.of_pose(e.pose[-1], e.joint_covariance[:3, :3]) for e in (smoothed, estimate)]
    both = replace(last[1], covariance=last[0].covariance + last[1].covariance)
    shift, squared_shift, freedom = common_shift(
        landmark_index[sound], difference[sound], information[sound]
    )
    return OwnMatchingCheck(
        measurements=(
            len(filters.measured) - initialised[0],
            len(own.measured) - initialised[1],
            len(common),
        ),
        squared=squared,
        landmarks=tuple(sorted(landmarks, key=lambda one: -one.squared)),
        shift=shift,
        shift_squared=squared_shift,
        shift_freedom=freedom,
        ekf=compare_frames(ekf, estimate),
        smoother=compare_frames(smoothed, estimate),
        pose=block_agreement(last[0], both),
        path_rms_m=(_rms(path[0]), _rms(path[1])),
        estimate=estimate,
        optimality=optimality,
        alignments=own,
    )


def common_shift(
    landmark_index: Index, difference: Array, information: Array
) -> tuple[Array, float, int]:
    """What differences (C, 3) have in common, (3,), its squared distance, the scatter's freedom.

    landmark_index: (C,) whose they are. information: (C, 3, 3) of each. A template's differences
    count as
    one, and the scatter about the shift is measured: it is less than stated, as the noise of scan
    and template is shared. Fewer than three landmarks have nothing in common: 0, 0.
    """
    landmark_indices, which, count = np.unique(
        landmark_index, return_inverse=True, return_counts=True
    )
    if len(landmark_indices) < LEAST_SEEN:
        return np.zeros(3), 0.0, 0
    weight = information / count[which][:, None, None]
    total = weight.sum(axis=0)
    shift = np.linalg.solve(total, np.einsum("nij,nj->i", weight, difference))
    rest = difference - shift
    freedom = 3 * (len(landmark_indices) - 1)
    scatter = float(np.einsum("ni,nij,nj->", rest, weight, rest)) / freedom
    return shift, float(shift @ total @ shift) / max(scatter, np.finfo(float).tiny), freedom


def compare_frames(first: Estimate, second: Estimate) -> Pair:
    """Scan landmarks that both have, x, y and heading, by the sum of both covariances."""
    _, i, j = np.intersect1d(
        first.pose_landmark_id, second.pose_landmark_id, assume_unique=True, return_indices=True
    )
    if not len(i):
        return Pair.of(0.0, 0.0, np.zeros(0), 3, 0)
    a, b = first.pose_landmarks[i], second.pose_landmarks[j]
    apart = a - b
    apart[:, 2] = wrap_angle(apart[:, 2])
    total = first.pose_landmark_covariances()[i] + second.pose_landmark_covariances()[j]
    squared = np.einsum("ni,ni->n", apart, np.linalg.solve(total, apart[:, :, None])[:, :, 0])
    return Pair.of(
        _rms(apart[:, :2]),
        _rms(aligned(a[:, :2], b[:, :2]) - b[:, :2]),
        squared,
        3,
        int(np.count_nonzero(~(squared <= GATE))),  # what is no number lies nowhere
    )


def _of_landmark(
    landmark_index: int,
    rows: Index,
    epoch: Index,
    difference: Array,
    information: Array,
    squared: Array,
) -> LandmarkMatching:
    weight, worst = information[rows], int(rows[np.argmax(squared[rows])])
    mean = np.einsum("nij,nj->i", weight, difference[rows]) / len(rows)
    shift = np.linalg.solve(weight.mean(axis=0) + _NOTHING, mean)
    there = information[worst]
    return LandmarkMatching(
        landmark_index=landmark_index,
        common=len(rows),
        squared=float(squared[rows].mean()),
        shift=shift,
        worst_epoch=int(epoch[worst]),
        worst=np.linalg.solve(there + _NOTHING, there @ difference[worst]),
        worst_squared=float(squared[worst]),
    )


def _later(seen: PoseLandmarkMeasurements) -> dict[tuple[int, int], int]:
    """Rows of measurements by pose and landmark, but for those in which a landmark begins."""
    rows: dict[tuple[int, int], int] = {}
    initialised: set[int] = set()
    for row in np.argsort(seen.pose, kind="stable").tolist():
        landmark_index = int(seen.landmark[row])
        if landmark_index in initialised:
            rows[int(seen.pose[row]), landmark_index] = row
        initialised.add(landmark_index)
    return rows


def _in_poses_frame(seen: PoseLandmarkMeasurements, rows: Index) -> Array:
    """(C, 3, 3) covariances in the frame of the pose that sees, not of the landmark."""
    turn = to_tangent(seen.measured[rows, 2])
    turned: Array = turn.transpose(0, 2, 1) @ seen.covariance[rows] @ turn
    return turned


def _rms(apart: Array) -> float:
    """Root mean square length of rows (N, 2); 0 without any."""
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) if len(apart) else 0.0


_NAMED = 3
"""So many landmarks are named."""


def matching_cause(own: OwnMatchingCheck, run: EkfRun) -> Cause:
    """S against S''."""
    parts, hint = (
        [],
        "check the alignments that only one of the two made: at loops, and where places look alike",
    )
    if own.shifted:
        x, y, turn = own.shift
        parts.append(
            f"all alignments of the filter are shifted by {x:.3f} m forward, {y:.3f} m left "
            f"and {np.degrees(turn):.2f} degrees from the smoother's own "
            f"({np.sqrt(own.shift_squared / 3.0):.1f} sigma)"
        )
        hint = "check the sign and zero of the alignment's heading, and the mount of the scanner"
    if own.contradicting:
        parts += [_apart_for(one, run) for one in own.contradicting[:_NAMED]]
        if len(own.contradicting) > _NAMED:
            parts.append(f"{len(own.contradicting) - _NAMED} more landmarks differ like this")
        if not own.shifted:
            hint = (
                "check the alignments of these landmarks: the axes of the template, R, and another "
                "place that looks alike"
            )
    if not own.estimates_agree:
        pair, (theirs, ours, both) = own.smoother, own.measurements
        if own.landmarks and not (own.contradicting or own.shifted):
            parts.append(f"the largest difference: {_apart_for(own.landmarks[0], run)}")
        parts.append(
            f"the smoother's own matcher moves its last pose by {own.pose.difference_m:.2f} m "
            f"({own.pose.distance:.1f} sigma) and its path by {own.path_rms_m[1]:.2f} m (RMS), and "
            f"{pair.outside} of {pair.landmarks} scan landmarks lie outside their 99 % "
            f"region; the filter has {theirs:,} alignments and the smoother {ours:,}, of which "
            f"{both:,} have the same landmark and scan"
        )
    return Cause("matching", "; ".join(parts), hint)


def _apart_for(one: LandmarkMatching, run: EkfRun) -> str:
    """How two matchers differ on a landmark, and in which scan the most."""
    place, worst = np.hypot(*one.shift[:2]), np.hypot(*one.worst[:2])
    return (
        f"the filter's alignments of scan landmark {one.landmark_index} differ by {place:.2f} m "
        "and "
        f"{np.degrees(one.shift[2]):.1f} degrees from the smoother's own "
        f"({np.sqrt(one.squared / 3.0):.1f} sigma over {one.common} scans; in the scan at "
        f"{run.estimate.time_s[one.worst_epoch]:.1f} s {worst:.2f} m and "
        f"{np.degrees(one.worst[2]):.1f} degrees, {np.sqrt(one.worst_squared / 3.0):.1f} sigma)"
    )
