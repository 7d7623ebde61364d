"""`result.json` and `solution.json`, for machines. The models are the files' documentation."""

from __future__ import annotations

from typing import Literal

from comparisons.extensions.dense_maps.models import DenseResult, HighLevelResult
from comparisons.extensions.own_matching.models import LandmarkMatchingResult
from comparisons.report.consistency_models import ConsistencyResult
from comparisons.report.model import Model


class LogResult(Model):
    """What was read. sha256: of all streams that an estimator may be given."""

    name: str
    format: str
    records: dict[str, int]
    duration_s: float
    sha256: str
    provenance: dict[str, str]


class EkfResult(Model):
    """The filter.

    rejected, ambiguous, candidate: sightings that association did not use. dynamic: sightings that
    were discarded since something moves there; retired: landmarks that are used no more, since they
    stand in such a place. global_updates: of a compressed filter, and the share of the passive
    covariance that they left alone (set I). attributes: whether diameters and intensities entered
    association.
    """

    filter: str
    association: str
    landmarks: int
    rejected: int
    ambiguous: int
    candidate: int
    dynamic: int = 0
    retired: int = 0
    attributes: str = "off"
    gps: str
    fixes_fused: int
    fixes_rejected: int
    global_updates: int
    global_update_spared: float


class StartResult(Model):
    """One start of the smoother; error is None where it broke down."""

    name: str
    error: float | None
    iterations: int
    converged: bool


class SmootherResult(Model):
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


class BlockResult(Model):
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


class AgreementResult(Model):
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


class AccuracyResult(Model):
    """Against truth or GPS; None where the log has no such reference."""

    ate_m: float | None
    ate_aligned_m: float | None
    landmark_rmse_m: float | None
    landmark_rmse_aligned_m: float | None
    landmarks_found: int | None
    landmarks_true: int | None
    gps_median_m: float | None
    gps_median_aligned_m: float | None
    gps_rms_aligned_m: float | None
    coverage: float | None


class Accuracies(Model):
    """One entry per estimator, and what the odometry alone reaches."""

    ekf: AccuracyResult
    smoother: AccuracyResult
    dead_reckoning: AccuracyResult | None


class PartitionResult(Model):
    """Pairs of sightings put together, against those that belong together."""

    precision: float
    recall: float


class AssociationResult(Model):
    """An association made without labels against the log's. See comparisons.checks.association."""

    landmarks: PartitionResult
    clusters: PartitionResult | None


class OwnAssociationResult(Model):
    """The smoother with its own association. See comparisons.extensions.own_association.check.

    agreement: share of the pairs of sightings put together by either that both put together.
    pose_distance_sigma: between the last poses with the one and the other association.
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
    proven: bool
    accuracy: AccuracyResult | None
    association: AssociationResult | None


class MapPairResult(Model):
    """Two maps of the same landmarks. See comparisons.extensions.scan_motion.three_way.Pair."""

    rms_m: float
    rms_aligned_m: float
    distance_sigma_median: float | None
    outside: int
    landmarks: int
    agrees: bool


class ThreeWayResult(Model):
    """EKF and smoother on wheels, each against the smoother on scans.

    chi2: with closures under their robust kernel, which only lowers it.
    """

    ekf: MapPairResult
    smoother: MapPairResult
    loops: int
    proven: bool
    chi2: float
    dof: int
    accuracy: AccuracyResult | None
    culprit: str
    evidence: str


class ScanOdometryResult(Model):
    """Scan odometry. failures: scans without an increment, by reason; breaks: new beginnings.

    weak: increments that leave a direction open. overlap, residual_m: medians over the matches.
    """

    guess: str
    scans: int
    used: int
    failures: dict[str, int]
    breaks: int
    weak: int
    overlap: float | None
    residual_m: float | None
    scans_per_second: float


class IncrementResult(Model):
    """Errors of the increments. See extensions.scan_motion.increments."""

    against: str
    nees: float
    dof: int
    band: tuple[float, float]
    factor: float
    reference_factor: float | None
    median: float | None


class ScanLandmarkResult(LandmarkResult):
    """The same of a scan landmark. sightings: used of it. points: of its template."""

    ekf_heading_rad: float
    smoother_heading_rad: float
    sightings: int
    points: int


class ScanSlamResult(Model):
    """Scan-SLAM. scans: looked at. rejected: segments that failed their trial.

    dynamic: returns left out since something moves there.
    pieces: whether all segments of a scan are one landmark, or each its own. fused: landmarks
    found to be others. enriched: alignments that began where what stands around fits. sightings:
    how often a landmark near the scanner was used, or why not.
    """

    scans: int
    landmarks: list[ScanLandmarkResult]
    rejected: int
    dynamic: int = 0
    fused: int = 0
    enriched: int = 0
    pieces: str = "single"
    sightings: dict[str, int]


class OwnMatchingResult(Model):
    """The smoother with its own matcher. See comparisons.extensions.own_matching.check.

    filter, own, common: alignments, begun landmarks left out. shift_sigma: of what all differences
    have in common, None for too few. ekf, smoother: scan landmarks of each against those of this
    smoother. pose_distance_sigma: by the sum of both covariances.
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
    ekf: MapPairResult
    smoother: MapPairResult
    pose_difference_m: float
    pose_distance_sigma: float | None
    path_ekf_m: float
    path_smoother_m: float
    agrees: bool
    proven: bool
    chi2: float
    dof: int
    reasons: dict[str, int]
    accuracy: AccuracyResult | None


class CauseResult(Model):
    """One reason for the verdict."""

    gap: str
    evidence: str
    hint: str


class Result(Model):
    """The whole file."""

    log: LogResult
    ekf: EkfResult
    smoother: SmootherResult
    agreement: AgreementResult
    consistency: ConsistencyResult
    accuracy: Accuracies | None
    association: AssociationResult | None
    own_association: OwnAssociationResult | None
    own_matching: OwnMatchingResult | None = None
    three_way: ThreeWayResult | None
    scan_odometry: ScanOdometryResult | None
    increments: IncrementResult | None
    dense: DenseResult | None
    scan_slam: ScanSlamResult | None = None
    high_level: HighLevelResult | None = None
    verdict: Literal["agree", "disagree", "unproven"]
    causes: list[CauseResult]
    remarks: list[str]
    seconds: dict[str, float]
    versions: dict[str, str]


class SolutionResult(Model):
    """`solution.json`: the smoother alone. sightings_used: of the log's."""

    log: LogResult
    association_by: str
    landmarks: int
    sightings_used: int
    gps: str
    smoother: SmootherResult
    accuracy: AccuracyResult | None
    dead_reckoning: AccuracyResult | None
    association: AssociationResult | None
    verdict: Literal["proven", "unproven"]
    remarks: list[str]
    seconds: dict[str, float]
    versions: dict[str, str]


class LoopResult(Model):
    """Loop closure: pairs of poses tried, closed, and the reasons against the others."""

    tried: int
    closed: int
    reasons: dict[str, int]


class FrontEndResult(Model):
    """`odometry.json`: the scan front end alone."""

    log: LogResult
    odometry: ScanOdometryResult
    loops: LoopResult
    graph: SmootherResult
    landmarks: int
    gps: str
    increments: IncrementResult | None
    wheels: AccuracyResult | None
    scan_odometry: AccuracyResult | None
    scan_graph: AccuracyResult | None
    verdict: Literal["proven", "unproven"]
    remarks: list[str]
    seconds: dict[str, float]
    versions: dict[str, str]
