"""The smoother with its own matcher in `result.json`, on the terminal and on the page."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.accuracy import Accuracy, accuracy_rows
from comparisons.checks.map_agreement import Pair
from comparisons.extensions.own_matching.check import LandmarkMatching, OwnMatchingCheck
from comparisons.figures import Model, finite, in_sigma
from comparisons.words import Row

MATCHER = "Open3D, generalised ICP"


def own_matching_result(own: OwnMatchingCheck, time_s: Array) -> OwnMatchingResult:
    """Return how it compares with the filter's alignments. time_s: (K,) of the epochs."""
    test, several = own.optimality.chi_square, own.shift_squared > 0.0
    return OwnMatchingResult(
        matcher=MATCHER,
        filter=own.measurements[0],
        own=own.measurements[1],
        common=own.measurements[2],
        distance_sigma=_sigma(own.squared.mean()) if len(own.squared) else None,
        shift_m=_place(own.shift),
        shift_rad=float(own.shift[2]),
        shift_sigma=_sigma(own.shift_squared) if several else None,
        landmarks=[_landmark(one, time_s) for one in own.landmarks],
        ekf=own.ekf,
        smoother=own.smoother,
        pose_difference_m=own.pose.difference_m,
        pose_distance_sigma=finite(own.pose.distance),
        path_ekf_m=own.path_rms_m[0],
        path_smoother_m=own.path_rms_m[1],
        agrees=own.agrees,
        verified=own.optimality.verified,
        chi2=test.chi2,
        dof=test.dof,
        reasons=dict(own.reasons),
        accuracy=own.accuracy,
    )


def own_matching_rows(result: OwnMatchingResult) -> list[Row]:
    """Return how the alignments compare, how the estimates do, and the accuracy."""
    group = "Smoother with its own matcher"
    shift = float(np.hypot(*result.shift_m))
    turn = f"{np.degrees(result.shift_rad):.2f} deg"
    rows = [
        Row(group, "matcher", result.matcher),
        Row(group, "alignments by its own matcher", f"{result.own:,}"),
        Row(group, "alignments by the filter's matcher", f"{result.filter:,}"),
        Row(group, "alignments by both", f"{result.common:,}"),
        Row(group, "difference of the alignments (rms)", in_sigma(result.distance_sigma)),
        Row(group, "common shift of the alignments", f"{shift:.3f} m"),
        Row(group, "common turn of the alignments", turn),
        Row(group, "common shift and turn of the alignments", in_sigma(result.shift_sigma)),
        *(
            Row(group, f"alignments by its own matcher: {reason}", f"{count:,}")
            for reason, count in result.reasons.items()
            if count
        ),
    ]
    for name, pair, path in (
        ("EKF", result.ekf, result.path_ekf_m),
        ("smoother", result.smoother, result.path_smoother_m),
    ):
        other, agrees = f"{name} and smoother with its own matcher", "yes" if pair.agrees else "no"
        far = f"{pair.outside} of {pair.landmarks}"
        rows += [
            Row(other, "maps agree", agrees, "yes", pair.agrees),
            Row(other, "scan landmarks beyond the 99 % region", far),
            Row(other, "difference of the paths (rms)", f"{path:.3f} m"),
        ]
    return [*rows, *accuracy_rows("the smoother with its own matcher", result.accuracy)]


def _landmark(one: LandmarkMatching, time_s: Array) -> LandmarkMatchingResult:
    return LandmarkMatchingResult(
        id=one.landmark_index,
        common=one.common,
        distance_sigma=_sigma(one.squared),
        shift_m=_place(one.shift),
        shift_rad=float(one.shift[2]),
        worst_time_s=float(time_s[one.worst_epoch]),
        worst_m=_place(one.worst),
        worst_rad=float(one.worst[2]),
        worst_sigma=_sigma(one.worst_squared),
        contradicts=one.contradicts,
    )


def _place(difference: Array) -> tuple[float, float]:
    return float(difference[0]), float(difference[1])


def _sigma(squared: float) -> float | None:
    """Root of a squared distance over its three degrees of freedom."""
    return finite(float(np.sqrt(squared / 3.0)))


class LandmarkMatchingResult(Model):
    """The filter's alignments of one scan landmark compared with the smoother's own.

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
        contradicts: whether the smoother's matcher contradicts the filter's.
    """

    id: int
    common: int
    distance_sigma: float | None
    shift_m: tuple[float, float]
    shift_rad: float
    worst_time_s: float
    worst_m: tuple[float, float]
    worst_rad: float
    worst_sigma: float | None
    contradicts: bool


class OwnMatchingResult(Model):
    """Entry `own_matching`: the smoother with its own matcher.

    See comparisons.extensions.own_matching.check.

    Attributes:
        matcher: name of the matcher.
        filter: alignments of the filter, initialised landmarks left out.
        own: alignments of the smoother.
        common: alignments of both.
        distance_sigma: root mean square distance of the common ones, in sigma.
        shift_m: what all differences have in common, x and y.
        shift_rad: the same in heading.
        shift_sigma: the same in sigma; None for too few alignments.
        landmarks: each landmark.
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
    """

    matcher: str
    filter: int
    own: int
    common: int
    distance_sigma: float | None
    shift_m: tuple[float, float]
    shift_rad: float
    shift_sigma: float | None
    landmarks: list[LandmarkMatchingResult]
    ekf: Pair
    smoother: Pair
    pose_difference_m: float
    pose_distance_sigma: float | None
    path_ekf_m: float
    path_smoother_m: float
    agrees: bool
    verified: bool
    chi2: float
    dof: int
    reasons: dict[str, int]
    accuracy: Accuracy | None
