"""From findings to the models of `result.json`."""

from __future__ import annotations

import hashlib
import platform
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from comparisons.adapters.ekf_factory import EkfChoices
from comparisons.adapters.ekf_run import EkfRun
from comparisons.checks.accuracy import Accuracy
from comparisons.checks.association import AssociationScore
from comparisons.extensions.dense_maps.result import dense_result, high_level_result
from comparisons.extensions.own_association.check import OwnAssociationCheck
from comparisons.extensions.own_matching.result import map_pair_result, own_matching_result
from comparisons.extensions.scan_landmarks.result import block_fields, scan_slam_result
from comparisons.extensions.scan_motion.result import (
    increment_remarks,
    increment_result,
    scan_odometry_result,
)
from comparisons.extensions.scan_motion.three_way import ThreeWay
from comparisons.logs.log import Log, Sightings
from comparisons.pipeline.compare import Comparison
from comparisons.report.consistency_result import consistency_result
from comparisons.report.finite import finite
from comparisons.report.models import (
    Accuracies,
    AccuracyResult,
    AgreementResult,
    AssociationResult,
    BlockResult,
    CauseResult,
    EkfResult,
    LandmarkResult,
    LogResult,
    OwnAssociationResult,
    PartitionResult,
    Result,
    SmootherResult,
    StartResult,
    ThreeWayResult,
)
from graphslam import smoother


def build_result(comparison: Comparison, read_s: float) -> Result:
    """The findings of a run, read_s being the seconds that reading the log took."""
    c = comparison
    return Result(
        log=log_result(c.log),
        ekf=ekf_result(c.ekf, c.choices),
        smoother=smoother_result(c.smoother),
        agreement=_agreement(c),
        consistency=consistency_result(c.consistency),
        accuracy=_accuracies(c),
        association=association_result(c.association),
        own_association=_own_association(c.own_association),
        own_matching=own_matching_result(c),
        three_way=_three_way(c.three_way),
        scan_odometry=None
        if c.scan_motion is None
        else scan_odometry_result(c.scan_motion, guess=True, seconds=c.seconds["scan odometry"]),
        increments=increment_result(c.increments),
        dense=dense_result(c.dense_check),
        scan_slam=scan_slam_result(c),
        high_level=high_level_result(c.high_level),
        verdict=c.verdict.outcome,
        causes=[CauseResult(**vars(cause)) for cause in c.verdict.causes],
        remarks=[*c.verdict.remarks, *increment_remarks(c.increments)],
        seconds={"read": read_s, **c.seconds},
        versions=package_versions(),
    )


def ekf_result(run: EkfRun, choices: EkfChoices) -> EkfResult:
    """The filter and what it used."""
    return EkfResult(
        filter=choices.filter,
        association=str(choices.association),
        attributes=choices.attributes,
        landmarks=len(run.estimate.landmark),
        **run.unused,
        retired=len(run.retired),
        gps=choices.gps,
        fixes_fused=len(run.fix_number),
        fixes_rejected=run.rejected_fixes,
        global_updates=run.spared[0],
        global_update_spared=run.spared[1],
    )


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


def smoother_result(result: smoother.SmootherResult) -> SmootherResult:
    """The smoother and its evidence."""
    options, proof = result.options, result.proof
    return SmootherResult(
        method=options.method,
        optimiser=options.optimiser,
        robust=options.robust,
        rejected_sightings=len(result.rejected.sightings),
        rejected_positions=len(result.rejected.positions),
        distance_sigma=finite(proof.distance_sigma),
        rank=result.rank,
        poses=len(result.poses),
        error=result.error,
        chi2=proof.chi_square.chi2,
        dof=proof.chi_square.dof,
        chi2_band=(proof.chi_square.lower, proof.chi_square.upper),
        newton_decrement=proof.stationarity.decrement,
        iterations=result.iterations,
        converged=result.converged,
        proven=proof.proven,
        agreeing_starts=list(proof.agreeing),
        starts=[
            StartResult(
                name=s.name,
                error=finite(s.error),
                iterations=s.iterations,
                converged=s.converged,
            )
            for s in result.starts
        ],
    )


def log_hash(log: Log) -> str:
    """SHA-256 of everything that an estimator may be given: all streams but truth."""
    digest = hashlib.sha256()
    records: tuple[object, ...] = (
        log.prior,
        log.odometry,
        log.sightings,
        log.positions,
        log.known_landmarks,
        log.known_sightings,
    )
    for record in records + tuple(s for s in (log.scans, log.clouds) if s is not None):
        if record is None:
            digest.update(b"absent")
            continue
        for name, value in sorted(vars(record).items()):
            if name == "intensity" and isinstance(record, Sightings) and np.isnan(value).all():
                continue  # as if there were no such column, so that logs without keep their hash
            digest.update(name.encode())
            digest.update(
                np.ascontiguousarray(value).tobytes()
                if isinstance(value, np.ndarray | float)
                else repr(value).encode()  # records of plain numbers
            )
    return digest.hexdigest()


def _agreement(c: Comparison) -> AgreementResult:
    a, ekf = c.agreement, c.ekf.estimate
    return AgreementResult(
        algebra_gap_sigma=finite(a.algebra.sigma),
        algebra_gap_covariance=finite(a.algebra.covariance),
        model_gap_sigma=finite(a.model.sigma),
        model_gap_covariance=finite(a.model.covariance),
        linearisation_gap_sigma=finite(a.linearisation.sigma),
        linearisation_gap_covariance=finite(a.linearisation.covariance),
        optimism=finite(a.whole.least),
        pessimism=finite(a.whole.largest),
        landmark_difference_rms_m=a.landmark_difference_rms_m,
        pose=BlockResult(**block_fields(a.pose)),  # type: ignore[arg-type]
        map=BlockResult(**block_fields(a.whole)),  # type: ignore[arg-type]
        landmarks=[
            LandmarkResult(
                id=int(ekf.landmark_id[i]),
                ekf_m=tuple(ekf.landmark[i].tolist()),
                smoother_m=tuple(c.smoothed.landmark[i].tolist()),
                **block_fields(b),  # type: ignore[arg-type]
            )
            for i, b in enumerate(a.landmarks)
        ],
    )


def _accuracies(c: Comparison) -> Accuracies | None:
    if c.accuracy_ekf is None or c.accuracy_smoother is None:
        return None
    return Accuracies(
        ekf=AccuracyResult(**vars(c.accuracy_ekf)),
        smoother=AccuracyResult(**vars(c.accuracy_smoother)),
        dead_reckoning=accuracy_result(c.accuracy_dead_reckoned),
    )


def _own_association(own: OwnAssociationCheck | None) -> OwnAssociationResult | None:
    if own is None:
        return None
    p = own.partition
    return OwnAssociationResult(
        landmarks=len(own.estimate.landmark),
        agreement=p.agreement,
        pairs_both=p.pairs_both,
        pairs_filter=p.pairs_first,
        pairs_smoother=p.pairs_second,
        splits=p.splits,
        merges=p.merges,
        pose_difference_m=own.pose.difference_m,
        pose_distance_sigma=own.pose.distance,
        landmark_rms_m=own.landmark_rms_m,
        proven=own.proof.proven,
        accuracy=accuracy_result(own.accuracy),
        association=association_result(own.score),
    )


def _three_way(three: ThreeWay | None) -> ThreeWayResult | None:
    if three is None:
        return None

    return ThreeWayResult(
        ekf=map_pair_result(three.ekf),
        smoother=map_pair_result(three.smoother),
        loops=three.loops,
        proven=three.proof.proven,
        chi2=three.chi_square.chi2,
        dof=three.chi_square.dof,
        accuracy=accuracy_result(three.accuracy),
        culprit=three.culprit,
        evidence=three.evidence,
    )


def association_result(score: AssociationScore | None) -> AssociationResult | None:
    """Precision and recall, of landmarks and of clusters."""
    if score is None:
        return None
    clusters = None if score.clusters is None else PartitionResult(**vars(score.clusters))
    return AssociationResult(landmarks=PartitionResult(**vars(score.landmarks)), clusters=clusters)


def accuracy_result(accuracy: Accuracy | None) -> AccuracyResult | None:
    """The figures, where there are any."""
    return None if accuracy is None else AccuracyResult(**vars(accuracy))


def package_versions() -> dict[str, str]:
    """Of Python and of what the results depend on."""
    versions = {"python": platform.python_version()}
    for package in ("slamcheck", "gtsam", "numpy", "scipy"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return versions
