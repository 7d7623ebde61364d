"""S': the smoother with its own association beside S, which has the filter's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import Accuracy
from comparisons.checks.agreement import BlockAgreement, Gaussian, block_agreement
from comparisons.checks.association import (
    AssociationScore,
    compare_partitions,
    counterparts,
    differing_measurements,
)
from comparisons.checks.causes import Cause
from comparisons.checks.misfit import squared_misfit
from comparisons.estimates.estimate import Estimate
from comparisons.figures import Aside
from comparisons.logs.log import LandmarkMeasurements
from graphslam.optimum import Optimality


@dataclass(frozen=True, kw_only=True)
class OwnAssociationCheck:
    """Entry `own_association`: the smoother with its own association, the gap S - S'.

    Attributes:
        landmarks: landmarks of the smoother's association.
        agreement: share of the pairs of measurements of either that both put together.
        pairs_both: pairs that both put together.
        pairs_filter: pairs that the filter puts together.
        pairs_smoother: pairs that the smoother puts together.
        splits: landmarks of the filter that the smoother splits.
        merges: landmarks of the filter that the smoother merges.
        pose_difference_m: distance of the last poses with either association.
        pose_distance_sigma: the same, in sigma.
        landmark_rms_m: root mean square distance of landmarks that share most of their
            measurements; None without any.
        verified: whether the optimum with the smoother's association is verified.
        accuracy: errors with the smoother's association.
        association: the smoother's association compared with the log's labels.
        landmark_index: (M,) the smoother's own landmarks of the measurements, negative for unused.
        matched: (L,) the filter's counterpart of each of its landmarks, -1 for none.
        differing: the measurements that the two do not give to counterparts.
        cost: (D, 2) squared misfit of each of these, in units of its noise, at S with the filter's
            landmark and at S' with its own, NaN where it is unused.
        pose: S against S' in the last pose.
        estimate: of S'.
    """

    landmarks: int
    agreement: float
    pairs_both: int
    pairs_filter: int
    pairs_smoother: int
    splits: int
    merges: int
    pose_difference_m: float
    pose_distance_sigma: float
    landmark_rms_m: float | None
    verified: bool
    accuracy: Accuracy | None = None
    association: AssociationScore | None = None
    landmark_index: Aside[Index]
    matched: Aside[Index]
    differing: Aside[Index]
    cost: Aside[Array]
    pose: Aside[BlockAgreement]
    estimate: Aside[Estimate]


def check_own_association(
    seen: LandmarkMeasurements,
    epoch: Index,
    landmark_indices: tuple[Index, Index],
    smoothed: Estimate,
    estimate: Estimate,
    optimality: Optimality,
) -> OwnAssociationCheck:
    """Compare. seen, epoch: the measurements, of which the first M are compared, and their epochs.

    landmark_indices: (M,) landmarks of each by the filter, and by the smoother. smoothed: S.
    estimate, optimality: of S'.
    """
    filters, own = landmark_indices
    first, second = counterparts(filters, own)
    apart = smoothed.landmark[first] - estimate.landmark[second]
    poses = [Gaussian.of_pose(e.pose[-1], e.joint_covariance[:3, :3]) for e in (smoothed, estimate)]
    matched = np.full(len(estimate.landmark), -1, dtype=np.intp)
    matched[second] = first
    differing = differing_measurements(filters, own, matched)
    cost = np.full((len(differing), 2), np.nan)
    for column, (landmark_index, e) in enumerate(((filters, smoothed), (own, estimate))):
        used = np.flatnonzero(landmark_index[differing] >= 0)
        rows = differing[used]
        cost[used, column] = squared_misfit(
            seen, rows, e.pose[epoch[rows]], e.landmark[landmark_index[rows]]
        )
    partition, pose = compare_partitions(filters, own), block_agreement(*poses)
    return OwnAssociationCheck(
        landmarks=len(estimate.landmark),
        agreement=partition.agreement,
        pairs_both=partition.pairs_both,
        pairs_filter=partition.pairs_first,
        pairs_smoother=partition.pairs_second,
        splits=partition.splits,
        merges=partition.merges,
        pose_difference_m=pose.difference_m,
        pose_distance_sigma=pose.distance_sigma,
        landmark_rms_m=float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) if len(apart) else None,
        verified=optimality.verified,
        landmark_index=own,
        matched=matched,
        differing=differing,
        cost=cost,
        pose=pose,
        estimate=estimate,
    )


def association_cause(own: OwnAssociationCheck, run: EkfRun) -> Cause:
    """S against S', whose optimum is verified: it stands where S misfits by this association."""
    return Cause(
        "association",
        f"the smoother's own association moves its last pose by {own.pose_difference_m:.2f} m "
        f"({own.pose_distance_sigma:.1f} sigma); the two associations share "
        f"{100.0 * own.agreement:.0f} % of their pairs of measurements, the smoother splits "
        f"{own.splits} landmarks of the filter and merges others into {own.merges}"
        + _costliest(own, run),
        "check the measurements whose association differs: for a wrong loop closure, and for "
        "landmarks too close to distinguish",
        alone=True,
    )


def _costliest(own: OwnAssociationCheck, run: EkfRun) -> str:
    """The measurement that fits the filter's landmark the least, of those that differ."""
    with_both = np.flatnonzero(np.isfinite(own.cost).all(axis=1))
    if not len(with_both):
        return ""
    worst = with_both[np.argmax(own.cost[with_both, 0])]
    row = own.differing[worst]
    t = run.estimate.time_s[run.timeline.measurement_epoch[row]]
    theirs, ours = own.cost[worst]
    return (
        f"; the residual of measurement {row} at {t:.1f} s is {theirs**0.5:.1f} sigma with the "
        f"filter's landmark {run.estimate.landmark_id[run.landmark_index[row]]} and "
        f"{ours**0.5:.1f} sigma "
        "with the smoother's own"
    )
