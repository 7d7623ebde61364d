"""Parts of result files that several jobs and extensions share, from findings to models."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array
from comparisons.audit.spurious import HEADING, Learnt
from comparisons.checks.accuracy import Accuracy
from comparisons.checks.agreement import BlockAgreement, block_agrees
from comparisons.checks.association import AssociationScore
from comparisons.checks.causes import Cause
from comparisons.config import EkfConfig
from comparisons.estimates.estimate import Estimate
from comparisons.logs.hashing import log_hash
from comparisons.logs.log import Log
from comparisons.report.model import finite
from comparisons.report.models import (
    AccuracyResult,
    AssociationCheckResult,
    AssociationResult,
    AssociationVariantResult,
    CauseResult,
    DisputeResult,
    EkfResult,
    LogResult,
    MapPairResult,
    MinimumResult,
    PartitionResult,
    SmootherResult,
    SpuriousHeadingResult,
    SpuriousShareResult,
    StartResult,
    TruthDistanceResult,
    TruthGapResult,
)
from graphslam import smoother

if TYPE_CHECKING:
    from comparisons.checks.association_variants import AssociationCheck
    from comparisons.checks.map_agreement import Pair
    from comparisons.checks.position_gate import RejectedFixes
    from comparisons.checks.qualifiers import TruthGap


def log_result(log: Log) -> LogResult:
    """What was read."""
    return LogResult(
        name=log.name,
        format=log.format,
        records=log.records,
        duration_s=log.duration_s,
        sha256=log_hash(log),
        provenance=log.provenance,
    )


def ekf_result(run: EkfRun, config: EkfConfig, fixes: RejectedFixes | None = None) -> EkfResult:
    """The filter and what it used. fixes: what its gate rejected, where a smoother judged it."""
    streaks = {}
    if fixes is not None:
        streaks = {
            "fixes_in_streaks": fixes.in_streaks,
            "longest_streak": fixes.longest,
            "fixes_rejected_by_smoother": fixes.unfit_count,
        }
    return EkfResult(
        filter=config.filter,
        association=str(config.association),
        attributes=config.attributes,
        landmarks=len(run.estimate.landmark),
        **run.unused,
        deactivated=len(run.deactivated),
        cut_off=run.cut_off,
        gps=config.gps,
        fixes_fused=len(run.fix_number),
        fixes_rejected=run.rejected_fixes,
        **streaks,
        global_updates=run.spared[0],
        global_update_spared=run.spared[1],
    )


def smoother_result(result: smoother.SmootherResult, estimate: Estimate) -> SmootherResult:
    """The smoother and its evidence. estimate: its own, for times and names of landmarks."""
    options, optimality = result.options, result.optimality
    explored = optimality.exploration
    return SmootherResult(
        method=options.method,
        optimiser=options.optimiser,
        robust=options.robust,
        rejected_measurements=len(result.rejected.measurements),
        rejected_positions=len(result.rejected.positions),
        distance_sigma=finite(optimality.distance_sigma),
        rank=result.rank,
        poses=len(result.poses),
        error=result.error,
        chi2=optimality.chi_square.chi2,
        dof=optimality.chi_square.dof,
        chi2_band=(optimality.chi_square.lower, optimality.chi_square.upper),
        newton_decrement=optimality.stationarity.decrement,
        iterations=result.iterations,
        converged=result.converged,
        verified=optimality.verified,
        lacks=optimality.lacks,
        agreeing_starts=list(optimality.agreeing),
        starts=[
            StartResult(
                name=s.name,
                error=finite(s.error),
                iterations=s.iterations,
                converged=s.converged,
            )
            for s in result.starts
        ],
        minima=[
            MinimumResult(
                error=m.error,
                starts=m.starts,
                time_s=float(estimate.time_s[m.pose]),
                pose_m=m.pose_m,
                landmark=None if m.landmark < 0 else int(estimate.landmark_id[m.landmark]),
                landmark_m=m.landmark_m,
            )
            for m in explored.minima
        ],
        hops=explored.hops,
        random_starts=explored.draws,
        chance_missed=explored.missed,
    )


def cause_result(cause: Cause) -> CauseResult:
    """What a report says of a cause."""
    return CauseResult(gap=cause.gap, evidence=cause.evidence, hint=cause.hint)


def spurious_heading_result(found: Learnt | None) -> SpuriousHeadingResult | None:
    """Return what the filter learnt of its heading from what cannot tell it, if it was asked."""
    if found is None:
        return None
    heading, (begin_s, end_s, gained) = found.of(HEADING), found.fastest(HEADING)
    time_s, information = found.curve(HEADING)
    largest = None
    if (most := heading.largest) is not None and most.time_s is not None:
        largest = SpuriousShareResult(
            time_s=most.time_s, landmark=most.seen, information=most.information
        )
    return SpuriousHeadingResult(
        information=heading.information,
        sigma_deg=finite(heading.sigma),
        fastest_s=(begin_s, end_s),
        fastest=gained,
        largest=largest,
        time_s=time_s.tolist(),
        growth=information.tolist(),
    )


def accuracy_result(accuracy: Accuracy | None) -> AccuracyResult | None:
    """The figures, where there are any."""
    return None if accuracy is None else AccuracyResult(**vars(accuracy))


def association_result(score: AssociationScore | None) -> AssociationResult | None:
    """Precision and recall, of landmarks and of clusters."""
    if score is None:
        return None
    clusters = None if score.clusters is None else PartitionResult(**vars(score.clusters))
    return AssociationResult(
        landmarks=PartitionResult(**vars(score.landmarks)),
        clusters=clusters,
        used=score.used,
        labelled=score.labelled,
    )


def truth_gap_result(gap: TruthGap | None) -> TruthGapResult | None:
    """S against truth."""
    if gap is None:
        return None
    return TruthGapResult(
        stands=gap.stands,
        distances=[
            TruthDistanceResult(
                what=d.what,
                sigma=finite(d.sigma),
                limit=d.limit,
                error_m=d.error_m,
                labels_m=d.labels_m,
            )
            for d in gap.distances
        ],
        measurement_m=gap.measurement_m,
        lost=gap.lost,
        reference=gap.reference,
    )


def association_check_result(check: AssociationCheck | None) -> AssociationCheckResult | None:
    """An association and the others it is compared with."""
    if check is None:
        return None
    against = check.against
    return AssociationCheckResult(
        verified=check.verified,
        variants=[
            AssociationVariantResult(
                name=one.name,
                agreement=one.partition.agreement,
                pairs_both=one.partition.pairs_both,
                pairs_association=one.partition.pairs_first,
                pairs_variant=one.partition.pairs_second,
                apart_sigma=finite(one.apart_sigma),
                apart_m=one.apart_m,
                excess=finite(one.excess),
                disputed=len(one.disputed),
                elsewhere=one.elsewhere,
                against=one in against,
            )
            for one in check.variants
        ],
        disputes=[
            DisputeResult(
                variant=d.variant,
                landmark=d.landmark,
                measurements=d.count,
                begin_s=d.begin_s,
                end_s=d.end_s,
            )
            for d in check.disputes
        ],
    )


def block_fields(b: BlockAgreement) -> dict[str, float | bool | None]:
    """How a block of two estimates agrees, by the names of BlockResult."""
    return {
        "difference_m": b.difference_m,
        "distance_sigma": b.distance,
        "variance_ratio_least": finite(b.least),
        "variance_ratio_largest": finite(b.largest),
        "agrees": block_agrees(b),
    }


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


def _median(values: Array) -> float | None:
    return finite(float(np.median(values))) if len(values) else None
