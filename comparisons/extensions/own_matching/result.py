"""The smoother with its own matcher in `result.json`, on the terminal and on the page."""

from __future__ import annotations

import numpy as np

from comparisons.estimates.estimate import Array
from comparisons.extensions.own_matching.check import LandmarkMatching
from comparisons.extensions.own_matching.models import LandmarkMatchingResult
from comparisons.extensions.scan_motion.three_way import Pair
from comparisons.pipeline.compare import Comparison
from comparisons.report.finite import finite
from comparisons.report.models import AccuracyResult, MapPairResult, OwnMatchingResult

MATCHER = "Open3D, generalised ICP"


def own_matching_result(c: Comparison) -> OwnMatchingResult | None:
    """How it compares with the filter's alignments; None when it was not asked for."""
    own = c.own_matching
    if own is None:
        return None
    test, several = own.proof.chi_square, own.shift_squared > 0.0
    return OwnMatchingResult(
        matcher=MATCHER,
        filter=own.sightings[0],
        own=own.sightings[1],
        common=own.sightings[2],
        distance_sigma=_sigma(own.squared.mean()) if len(own.squared) else None,
        shift_m=_place(own.shift),
        shift_rad=float(own.shift[2]),
        shift_sigma=_sigma(own.shift_squared) if several else None,
        landmarks=[_landmark(one, c.ekf.estimate.time_s) for one in own.landmarks],
        ekf=map_pair_result(own.ekf),
        smoother=map_pair_result(own.smoother),
        pose_difference_m=own.pose.difference_m,
        pose_distance_sigma=finite(own.pose.distance),
        path_ekf_m=own.path_rms_m[0],
        path_smoother_m=own.path_rms_m[1],
        agrees=own.agrees,
        proven=own.proof.proven,
        chi2=test.chi2,
        dof=test.dof,
        reasons=dict(own.reasons),
        accuracy=None if own.accuracy is None else AccuracyResult(**vars(own.accuracy)),
    )


def map_pair_result(p: Pair) -> MapPairResult:
    """Two maps of the same landmarks."""
    return MapPairResult(
        rms_m=p.rms_m,
        rms_aligned_m=p.rms_aligned_m,
        distance_sigma_median=_median(p.distance_sigma),
        outside=p.outside,
        landmarks=len(p.distance_sigma),
        agrees=p.agrees,
    )


def own_matching_rows(result: OwnMatchingResult) -> list[tuple[str, str]]:
    """Rows of a run's summary."""
    shift = np.hypot(*result.shift_m)
    told = (f"{count:,} {reason}" for reason, count in result.reasons.items() if count)
    return [
        (
            "own matcher",
            f"{result.matcher}: {result.own:,} alignments, {result.common:,} of them where the "
            f"filter has one of {result.filter:,}; these are {_shown(result.distance_sigma)} sigma "
            f"apart (rms), together {shift:.3f} m and {np.degrees(result.shift_rad):.2f} degrees "
            f"({_shown(result.shift_sigma)} sigma)",
        ),
        ("its matches", ", ".join(told) or "none"),
        *(
            (
                "with it",
                f"{name} {'agrees' if pair.agrees else 'disagrees'}: {pair.outside} of "
                f"{pair.landmarks} scan landmarks beyond 99 %, paths {path:.3f} m apart (rms)",
            )
            for name, pair, path in (
                ("EKF", result.ekf, result.path_ekf_m),
                ("smoother", result.smoother, result.path_smoother_m),
            )
        ),
    ]


def _landmark(one: LandmarkMatching, time_s: Array) -> LandmarkMatchingResult:
    return LandmarkMatchingResult(
        id=one.slot,
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


def _median(values: Array) -> float | None:
    return finite(float(np.median(values))) if len(values) else None


def _sigma(squared: float) -> float | None:
    """Root of a squared distance over its three degrees of freedom."""
    return finite(float(np.sqrt(squared / 3.0)))


def _shown(value: float | None) -> str:
    return "none" if value is None else f"{value:.2g}"
