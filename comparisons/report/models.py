"""`result.json` and `solution.json`, for machines. The models are the files' documentation."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import ConfigDict, Field

from comparisons.report.model import Model
from comparisons.report.settings import SettingsResult


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

    rejected, ambiguous, candidate: measurements that association did not use. dynamic: measurements
    that were discarded since something moves there; deactivated: landmarks that are used no more,
    since they stand in such a place. cut_off: scans in which joint compatibility visited its most
    nodes and took the best set so far. global_updates: of a compressed filter, and the share of the
    passive covariance that they left alone (set I). attributes: whether diameters and intensities
    entered association. fixes_in_streaks: rejected positions that are one of five or more in a row;
    longest_streak: of rejected positions; fixes_rejected_by_smoother: of the rejected ones, those
    that the same gate rejects at the smoother's optimum.
    """

    filter: str
    association: str
    landmarks: int
    rejected: int
    ambiguous: int
    candidate: int
    dynamic: int = 0
    deactivated: int = 0
    cut_off: int = 0
    attributes: str = "off"
    gps: str
    fixes_fused: int
    fixes_rejected: int
    fixes_in_streaks: int = 0
    longest_streak: int = 0
    fixes_rejected_by_smoother: int = 0
    global_updates: int
    global_update_spared: float


class StartResult(Model):
    """One start of the smoother; error is None where it broke down."""

    name: str
    error: float | None
    iterations: int
    converged: bool


class MinimumResult(Model):
    """A minimum, how many attempts ended there, and where it differs most from the lowest one.

    time_s: of the pose that is farthest off. landmark: the id of the landmark that is; None where
    the log has no landmarks.
    """

    error: float
    starts: int
    time_s: float
    pose_m: float
    landmark: int | None
    landmark_m: float


class SmootherResult(Model):
    """The smoother and the evidence for its optimum. See graphslam.optimum.

    distance_sigma: of an incremental estimate from the optimum. rejected: outlier measurements and
    positions that were left out. rank: unknowns that the measurements determine. lacks: why the
    optimum is not verified; empty where it is. minima: the distinct ones found, lowest first.
    hops, random_starts: how many were tried. chance_missed: that the random starts miss a basin as
    wide as the lowest one's.
    """

    method: str
    optimiser: str
    robust: str
    rejected_measurements: int
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
    verified: bool
    lacks: str
    agreeing_starts: list[str]
    starts: list[StartResult]
    minima: list[MinimumResult]
    hops: int
    random_starts: int
    chance_missed: float


class BlockResult(Model):
    """An estimate against the smoother's in one block of the state.

    See comparisons.checks.agreement.BlockAgreement; of `slamcheck check`, external_agreement.Block.
    """

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
    """Against truth or GPS; None where the log has no such reference. See checks.accuracy."""

    ate_m: float | None
    ate_aligned_m: float | None
    rpe_10m_m: float | None = None
    rpe_10m_rad: float | None = None
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
    """Pairs of measurements put together, against those that belong together."""

    precision: float
    recall: float


class AssociationResult(Model):
    """An association made without labels against the log's. See comparisons.checks.association.

    used: landmarks that have measurements, for as many as are labelled.
    """

    landmarks: PartitionResult
    clusters: PartitionResult | None
    used: int | None = None
    labelled: int | None = None


class TruthDistanceResult(Model):
    """The smoother's poses or landmarks against truth. See comparisons.checks.qualifiers.Distance.

    sigma: root of the mean NEES over its degrees of freedom, of which limit is the most that a
    sound run reaches. error_m: root mean square; labels_m: the same with the log's labels, where
    the run has not used them and they could tell.
    """

    what: str
    sigma: float | None
    limit: float
    error_m: float
    labels_m: float | None


class TruthGapResult(Model):
    """The smoother against truth, or against labels. See comparisons.checks.qualifiers.TruthGap.

    stands: it is far, by its covariance or by what labels reach, and by more than measurement_m,
    what one measurement errs by; or it is lost: no landmark is near a true one. reference: where it
    should be, in words.
    """

    stands: bool
    distances: list[TruthDistanceResult]
    measurement_m: float
    lost: bool
    reference: str


class AssociationVariantResult(Model):
    """An association made in another way. See comparisons.checks.association_variants.

    agreement: share of the pairs of measurements put together by either that both put together.
    apart: root mean square distance of the poses at the two optima. excess: how much worse it
    explains the measurements, as squared misfit. disputed: measurements not given to counterparts.
    """

    name: str
    agreement: float
    pairs_both: int
    pairs_association: int
    pairs_variant: int
    apart_sigma: float | None
    apart_m: float
    excess: float | None
    disputed: int
    elsewhere: bool
    against: bool


class DisputeResult(Model):
    """Measurements of one landmark, -1 for none, that a variant gives to others."""

    variant: str
    landmark: int
    measurements: int
    begin_s: float
    end_s: float


class AssociationCheckResult(Model):
    """Whether an association depends on how it was made. disputes: the largest first."""

    verified: bool
    variants: list[AssociationVariantResult]
    disputes: list[DisputeResult]


class MapPairResult(Model):
    """Two maps of the same landmarks. See comparisons.extensions.scan_motion.three_way.Pair."""

    rms_m: float
    rms_aligned_m: float
    distance_sigma_median: float | None
    outside: int
    landmarks: int
    agrees: bool


class NeesResult(Model):
    """Normalised errors squared, each with `dof`. See checks.consistency.normalised.

    mean: `dof` is right. Over time, and over landmarks of one run, the values are correlated: no
    band holds for their average. single_band: 95 % of single values lie in it; inside: the share
    that do. last: the last value. unusable: errors without one, by reason.
    """

    dof: int
    count: int
    mean: float | None
    last: float | None
    single_band: tuple[float, float]
    inside: float | None
    unusable: dict[str, int]


class TruthConsistencyResult(Model):
    """NEES against truth, of errors in the log's frame, additive in x, y and wrapped heading.

    pose, position, heading: over the epochs. landmarks: each alone; map: jointly; whole: with the
    last pose. distance, distances: lengths of a spanning tree over landmarks and last pose, which
    no frame touches, each alone and jointly; too_short: those left out.
    """

    pose: NeesResult | None
    position: NeesResult | None
    heading: NeesResult | None
    landmarks: NeesResult | None
    map: NeesResult | None
    whole: NeesResult | None
    distance: NeesResult | None
    distances: NeesResult | None
    too_short: int


class NisResult(Model):
    """An average of normalised innovations squared, with its own 95 % band."""

    name: str
    dof: int
    count: int
    mean: float
    band: tuple[float, float]
    reading: str


class WhitenessResult(Model):
    """See comparisons.checks.consistency.innovations.Whiteness. band: half widths, lag by lag."""

    component: str
    order: str
    autocorrelation: list[float]
    band: list[float]
    p_value: float
    mean: float
    mean_band: float


class InnovationResult(Model):
    """One sensor's innovations. See comparisons.checks.consistency.innovations."""

    sensor: str
    nis: list[NisResult]
    whiteness: list[WhitenessResult]
    unusable: int


class FilterAgainstSmootherResult(Model):
    """Filtered poses against smoothed ones. See comparisons.checks.consistency.filter_smoother.

    squared_per_dof: 1 is right; band: 95 % of it, for correlated epochs; inside: share of the
    epochs in their single 95 % band. least_ratio: smallest variance of the filter over the
    smoother's, at least_ratio_s; overconfident_epochs: how many have one clearly below 1, from
    overconfident_since_s on.
    """

    epochs: int
    squared_per_dof: float | None
    band: tuple[float, float] | None = None
    inside: float | None
    least_ratio: float | None
    least_ratio_s: float | None
    overconfident_epochs: int
    overconfident_since_s: float | None
    unusable: dict[str, int]


class ConsistencyResult(Model):
    """By truth for both estimators, by the filter's innovations, by the smoother."""

    ekf: TruthConsistencyResult | None
    smoother: TruthConsistencyResult | None
    innovations: list[InnovationResult]
    filter_against_smoother: FilterAgainstSmootherResult | None


class ExternalConsistencyResult(Model):
    """Of an external estimate's covariances, by truth and by the smoother.

    unjudged: why filter_against_smoother is None.
    """

    truth: TruthConsistencyResult | None
    filter_against_smoother: FilterAgainstSmootherResult | None
    unjudged: str


class CauseResult(Model):
    """One reason for the verdict."""

    gap: str
    evidence: str
    hint: str


SCHEMA = 3
"""Raised when a field of `result.json` changes its meaning. 1 had no `schema` and no `config`."""


class Result(Model):
    """The whole file, and one entry for each extension that ran. config: of the run.

    summary: verdict, qualifiers and the filter's consistency in one line. inconsistent: what of
    the latter is outside its band; None where nothing tells.
    """

    model_config = ConfigDict(extra="allow", serialize_by_alias=True, populate_by_name=True)

    schema_version: int = Field(alias="schema", default=1)
    config: dict[str, Any] = Field(default_factory=dict)
    settings: SettingsResult | None = None
    log: LogResult
    ekf: EkfResult
    smoother: SmootherResult
    agreement: AgreementResult
    consistency: ConsistencyResult
    accuracy: Accuracies | None
    association: AssociationResult | None
    truth_gap: TruthGapResult | None = None
    verdict: Literal["agree", "disagree", "unverified"]
    summary: str = ""
    qualifiers: list[str] = Field(default_factory=list)
    inconsistent: list[str] | None = None
    failed_on: list[str] = Field(default_factory=list)
    causes: list[CauseResult]
    remarks: list[str]
    seconds: dict[str, float]
    cpu_s: dict[str, float] | None = None
    versions: dict[str, str]
    files: tuple[str, ...] = ()

    @property
    def headline(self) -> str:
        """The verdict with its qualifiers."""
        return ", ".join((self.verdict, *self.qualifiers))


class PoseGraphResult(Model):
    """A log with closures. unmeasured: pairs of poses in a row that no odometry connects.

    initial_chi2: where odometry alone leads, and guesses where there is none.
    """

    loop_closures: int
    unmeasured: int
    initial_chi2: float


class SolutionResult(Model):
    """`solution.json`: the smoother alone. measurements_used: of the log's.

    association_check: of the smoother's own, which must hold for `verified`, too. pose_graph: of a
    log with closures.
    """

    config: dict[str, Any]
    settings: SettingsResult
    log: LogResult
    association_by: str
    landmarks: int
    measurements_used: int
    gps: str
    smoother: SmootherResult
    accuracy: AccuracyResult | None
    dead_reckoning: AccuracyResult | None
    association: AssociationResult | None
    association_check: AssociationCheckResult | None = None
    pose_graph: PoseGraphResult | None = None
    verdict: Literal["verified", "unverified"]
    remarks: list[str]
    seconds: dict[str, float]
    cpu_s: dict[str, float] | None = None
    versions: dict[str, str]
    files: tuple[str, ...] = ()
