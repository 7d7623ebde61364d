"""`result.json`: the run's findings for machines. The models are the file's documentation."""

from __future__ import annotations

import hashlib
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from comparisons.checks.agreement import BlockAgreement
from comparisons.checks.association import AssociationScore
from comparisons.checks.attribution import block_agrees
from comparisons.compare import Comparison
from comparisons.logs.log import Log


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class LogResult(_Model):
    """What was read. sha256: of all streams that an estimator may be given."""

    name: str
    format: str
    records: dict[str, int]
    duration_s: float
    sha256: str
    provenance: dict[str, str]


class EkfResult(_Model):
    """The filter.

    rejected, ambiguous, candidate: sightings that association did not use. global_updates: of a
    compressed filter, and the share of the passive covariance that they left alone (set I).
    """

    filter: str
    association: str
    landmarks: int
    rejected: int
    ambiguous: int
    candidate: int
    gps: str
    fixes_fused: int
    fixes_rejected: int
    global_updates: int
    global_update_spared: float


class StartResult(_Model):
    """One start of the smoother; error is None where it broke down."""

    name: str
    error: float | None
    iterations: int
    converged: bool


class SmootherResult(_Model):
    """The smoother and the evidence for its optimum. See graphslam.optimum.

    distance_sigma: of an incremental estimate from the optimum. rejected: wild sightings and
    positions that were left out. rank: unknowns that the measurements determine.
    """

    method: str
    optimiser: str
    robust: str
    rejected_sightings: int
    rejected_positions: int
    distance_sigma: float | None
    rank: int
    poses: int
    error: float
    chi2: float
    dof: int
    chi2_band: tuple[float, float]
    newton_decrement: float
    iterations: int
    converged: bool
    proven: bool
    agreeing_starts: list[str]
    starts: list[StartResult]


class BlockResult(_Model):
    """EKF against smoother in one block. See comparisons.checks.agreement.BlockAgreement."""

    difference_m: float
    distance_sigma: float
    variance_ratio_least: float | None
    variance_ratio_largest: float | None
    agrees: bool


class LandmarkResult(BlockResult):
    """One landmark's row; positions in metres."""

    id: int
    ekf_m: tuple[float, float]
    smoother_m: tuple[float, float]


class AgreementResult(_Model):
    """The gaps. Covariance gaps are None where a covariance is not positive definite."""

    algebra_gap_sigma: float | None
    algebra_gap_covariance: float | None
    model_gap_sigma: float | None
    model_gap_covariance: float | None
    linearisation_gap_sigma: float | None
    linearisation_gap_covariance: float | None
    optimism: float | None
    pessimism: float | None
    landmark_difference_rms_m: float
    pose: BlockResult
    map: BlockResult
    landmarks: list[LandmarkResult]


class AccuracyResult(_Model):
    """Against truth or GPS; None where the log has no such reference."""

    ate_m: float | None
    ate_aligned_m: float | None
    landmark_rmse_m: float | None
    landmark_rmse_aligned_m: float | None
    landmarks_found: int | None
    landmarks_true: int | None
    gps_median_m: float | None
    gps_median_aligned_m: float | None
    coverage: float | None


class Accuracies(_Model):
    """One entry per estimator, and what the odometry alone reaches."""

    ekf: AccuracyResult
    smoother: AccuracyResult
    dead_reckoning: AccuracyResult | None


class PartitionResult(_Model):
    """Pairs of sightings put together, against those that belong together."""

    precision: float
    recall: float


class AssociationResult(_Model):
    """An association made without labels against the log's. See comparisons.checks.association."""

    landmarks: PartitionResult
    clusters: PartitionResult | None


class CauseResult(_Model):
    """One reason for the verdict."""

    gap: str
    evidence: str
    hint: str


class Result(_Model):
    """The whole file."""

    log: LogResult
    ekf: EkfResult
    smoother: SmootherResult
    agreement: AgreementResult
    accuracy: Accuracies | None
    association: AssociationResult | None
    verdict: Literal["agree", "disagree", "unproven"]
    causes: list[CauseResult]
    remarks: list[str]
    seconds: dict[str, float]
    versions: dict[str, str]


def build_result(comparison: Comparison, read_s: float) -> Result:
    """The findings of a run, read_s being the seconds that reading the log took."""
    c, proof = comparison, comparison.smoother.proof
    return Result(
        log=LogResult(
            name=c.log.name,
            format=c.log.format,
            records=c.log.records,
            duration_s=c.log.duration_s,
            sha256=log_hash(c.log),
            provenance=c.log.provenance,
        ),
        ekf=EkfResult(
            filter=c.choices.filter,
            association=str(c.choices.association),
            landmarks=len(c.ekf.estimate.landmark),
            **c.ekf.unused,
            gps=c.choices.gps,
            fixes_fused=len(c.ekf.fix_number),
            fixes_rejected=c.ekf.rejected_fixes,
            global_updates=c.ekf.spared[0],
            global_update_spared=c.ekf.spared[1],
        ),
        smoother=SmootherResult(
            method=c.smoother.options.method,
            optimiser=c.smoother.options.optimiser,
            robust=c.smoother.options.robust,
            rejected_sightings=len(c.smoother.rejected.sightings),
            rejected_positions=len(c.smoother.rejected.positions),
            distance_sigma=_finite(proof.distance_sigma),
            rank=c.smoother.rank,
            poses=len(c.smoother.poses),
            error=c.smoother.error,
            chi2=proof.chi_square.chi2,
            dof=proof.chi_square.dof,
            chi2_band=(proof.chi_square.lower, proof.chi_square.upper),
            newton_decrement=proof.stationarity.decrement,
            iterations=c.smoother.iterations,
            converged=c.smoother.converged,
            proven=proof.proven,
            agreeing_starts=list(proof.agreeing),
            starts=[
                StartResult(
                    name=s.name,
                    error=_finite(s.error),
                    iterations=s.iterations,
                    converged=s.converged,
                )
                for s in c.smoother.starts
            ],
        ),
        agreement=_agreement(c),
        accuracy=_accuracies(c),
        association=_association(c.association),
        verdict=c.verdict.outcome,
        causes=[CauseResult(**vars(cause)) for cause in c.verdict.causes],
        remarks=list(c.verdict.remarks),
        seconds={"read": read_s, **c.seconds},
        versions=_versions(),
    )


def log_hash(log: Log) -> str:
    """SHA-256 of everything that an estimator may be given: all streams but scans and truth."""
    digest = hashlib.sha256()
    records = (
        log.prior,
        log.odometry,
        log.sightings,
        log.positions,
        log.known_landmarks,
        log.known_sightings,
    )
    for record in records:
        if record is None:
            digest.update(b"absent")
            continue
        for name, value in sorted(vars(record).items()):
            digest.update(name.encode())
            digest.update(
                np.ascontiguousarray(value).tobytes()
                if isinstance(value, np.ndarray | float)
                else repr(value).encode()  # records of plain numbers
            )
    return digest.hexdigest()


def _agreement(c: Comparison) -> AgreementResult:
    a, ekf = c.agreement, c.ekf.estimate

    def block(b: BlockAgreement) -> dict[str, float | bool | None]:
        return {
            "difference_m": b.difference_m,
            "distance_sigma": b.distance,
            "variance_ratio_least": _finite(b.least),
            "variance_ratio_largest": _finite(b.largest),
            "agrees": block_agrees(b),
        }

    return AgreementResult(
        algebra_gap_sigma=_finite(a.algebra.sigma),
        algebra_gap_covariance=_finite(a.algebra.covariance),
        model_gap_sigma=_finite(a.model.sigma),
        model_gap_covariance=_finite(a.model.covariance),
        linearisation_gap_sigma=_finite(a.linearisation.sigma),
        linearisation_gap_covariance=_finite(a.linearisation.covariance),
        optimism=_finite(a.whole.least),
        pessimism=_finite(a.whole.largest),
        landmark_difference_rms_m=a.landmark_difference_rms_m,
        pose=BlockResult(**block(a.pose)),  # type: ignore[arg-type]
        map=BlockResult(**block(a.whole)),  # type: ignore[arg-type]
        landmarks=[
            LandmarkResult(
                id=int(ekf.landmark_id[i]),
                ekf_m=tuple(ekf.landmark[i].tolist()),
                smoother_m=tuple(c.smoothed.landmark[i].tolist()),
                **block(b),  # type: ignore[arg-type]
            )
            for i, b in enumerate(a.landmarks)
        ],
    )


def _accuracies(c: Comparison) -> Accuracies | None:
    if c.accuracy_ekf is None or c.accuracy_smoother is None:
        return None
    alone = c.accuracy_dead_reckoned
    return Accuracies(
        ekf=AccuracyResult(**vars(c.accuracy_ekf)),
        smoother=AccuracyResult(**vars(c.accuracy_smoother)),
        dead_reckoning=None if alone is None else AccuracyResult(**vars(alone)),
    )


def _association(score: AssociationScore | None) -> AssociationResult | None:
    if score is None:
        return None
    clusters = None if score.clusters is None else PartitionResult(**vars(score.clusters))
    return AssociationResult(landmarks=PartitionResult(**vars(score.landmarks)), clusters=clusters)


def _finite(value: float) -> float | None:
    """JSON has no NaN or infinity: such a figure is absent, never passed on."""
    return value if np.isfinite(value) else None


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for package in ("slamcheck", "gtsam", "numpy", "scipy"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return versions
