"""`result.json` and `solution.json`, for machines. The models are the files' documentation."""

from __future__ import annotations

from functools import partial
from itertools import chain
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from comparisons.checks.accuracy import Accuracies, Accuracy
from comparisons.checks.agreement import Agreement
from comparisons.checks.association import AssociationScore
from comparisons.checks.association_variants import AssociationCheck
from comparisons.checks.consistency.finding import ConsistencyResult
from comparisons.checks.qualifiers import TruthGap
from comparisons.checks.spurious import SpuriousHeadingResult
from comparisons.extension_names import EXTENSIONS
from comparisons.figures import (
    Count,
    Exact,
    LeftOut,
    Less,
    Model,
    Named,
    Number,
    Same,
    numbers,
    percent,
)
from comparisons.report.settings import SettingsResult
from comparisons.words import Cause

_WHOLE = partial(percent, digits=0)


class LogResult(Model):
    """The log that was read.

    Attributes:
        name: name of the log.
        format: format in which it was read, as `slamcheck logs` names it.
        records: number of records of each stream.
        duration_s: time from the first record to the last.
        sha256: hash of all streams that an estimator may be given.
        provenance: what the log says about its origin.
    """

    name: str
    format: str
    records: dict[str, int]
    duration_s: float
    sha256: str
    provenance: dict[str, str]


class JobResult(Model):
    """What every job on a log says; each check that found something adds its entries.

    Attributes:
        config: all settings.
        settings: settings that differ from the documents'.
        log: the log.
        remarks: sentences that change no verdict.
        seconds: wall time, by stage.
        cpu_s: processor time, by stage.
        versions: versions of the packages.
        files: files of the folder.
        not_checked: checks without an answer, and what the job lacks for it.
    """

    model_config = ConfigDict(extra="allow")

    config: LeftOut[dict[str, Any]] = Field(default_factory=dict)
    settings: LeftOut[SettingsResult] = SettingsResult(preset="", differing=[])
    log: LeftOut[LogResult]
    remarks: list[str]
    seconds: LeftOut[dict[str, float]]
    cpu_s: LeftOut[dict[str, float] | None] = None
    versions: dict[str, str]
    files: tuple[str, ...] = ()
    not_checked: dict[str, str] = Field(default_factory=dict)


class CheckedResult(JobResult):
    """What every job says that has a verdict.

    Attributes:
        verdict: the verdict.
        qualifiers: reservations beside the verdict, such as `truth gap`.
    """

    verdict: str
    qualifiers: list[str] = Field(default_factory=list)

    @property
    def headline(self) -> str:
        """The verdict with its qualifiers."""
        return ", ".join((self.verdict, *self.qualifiers))

    @property
    def look(self) -> str:
        """The verdict whose colours it is shown in: what is right with reservations is open."""
        reserved = self.verdict in ("agree", "verified") and self.qualifiers
        return "unverified" if reserved else self.verdict


class VerdictResult(CheckedResult):
    """What a job says that judges a filter.

    Attributes:
        inconsistent: what of the filter's consistency is outside its band; None where nothing can
            tell.
        causes: reasons for the verdict, the first one first.
    """

    verdict: Literal["agree", "disagree", "unverified"]
    inconsistent: list[str] | None = None
    causes: list[Cause]


class EkfResult(Model):
    """The filter: its settings, and what it used and rejected.

    Attributes:
        filter: value of `--filter`.
        association: value of `--association`.
        landmarks: landmarks in the map at the end.
        rejected: measurements that no landmark explains within the gate.
        ambiguous: measurements that several landmarks explain.
        candidate: measurements of landmarks that are not reliable enough for the map yet.
        dynamic: measurements that were discarded since something moves there.
        deactivated: landmarks that are no longer used, since something moves where they stand.
        cut_off: scans in which joint compatibility reached its limit of nodes and took the best set
            so far.
        attributes: whether diameters and intensities entered the association.
        gps: value of `--gps`.
        fixes_fused: absolute positions that were used.
        fixes_rejected: absolute positions that the gate rejected.
        fixes_outside_stretches: absolute positions left out, as they are in no stretch that agrees
            with itself and with SLAM; None where the settings ask for all.
        fixes_in_streaks: rejected positions that are one of five or more in a row.
        longest_streak: most rejected positions in a row.
        fixes_rejected_by_smoother: rejected positions that the same gate also rejects at the
            smoother's optimum.
        updates: updates by measurements of a compressed filter.
        updates_with_passive: those that left landmarks outside the local area passive; in the
            others it is the full filter.
        active_share: share of all states that was active, mean over the updates.
        global_updates: global updates of a compressed filter.
        global_update_spared: share of the passive covariance that they left unchanged (set I): less
            is exact, more is quick.
    """

    filter: Annotated[str, Named("filter", "{}")]
    association: Annotated[str, Named("association", "{}")]
    landmarks: Annotated[Exact[int], Named("point landmarks")]
    rejected: Annotated[int, Named("measurements rejected by the gate")]
    ambiguous: Annotated[int, Named("ambiguous measurements, not used")]
    candidate: Annotated[int, Named("measurements of landmark candidates")]
    dynamic: Annotated[int, Named("measurements of moving objects, left out")] = 0
    deactivated: Annotated[int, Named("landmarks on moving objects, deactivated")] = 0
    cut_off: int = 0
    attributes: Annotated[str, Named("landmark attributes in the association", "{}")] = "off"
    gps: str
    fixes_fused: Annotated[int, Named("GPS positions fused")]
    fixes_rejected: Annotated[int, Named("GPS positions rejected")]
    fixes_outside_stretches: Annotated[
        int | None, Named("GPS positions left out, in no stretch of good ones")
    ] = None
    fixes_in_streaks: Annotated[int, Named("GPS positions rejected five or more in a row")] = 0
    longest_streak: Annotated[int, Named("most GPS positions rejected in a row")] = 0
    fixes_rejected_by_smoother: Annotated[
        int, Named("GPS positions rejected that the smoother's optimum rejects as well")
    ] = 0
    updates: Annotated[int | None, Named("updates")] = None
    updates_with_passive: Annotated[int | None, Named("updates with passive landmarks")] = None
    active_share: Annotated[Same[float | None], Named("share of the state, active", _WHOLE)] = None
    global_updates: Annotated[int, Named("global updates")]
    global_update_spared: Annotated[
        Same[float],
        Named("passive covariance that a global update leaves unchanged", _WHOLE),
    ]


class StartResult(Model):
    """One start of the smoother.

    Attributes:
        name: how the initial values were made.
        error: error that it converged to; None where it broke down.
        iterations: iterations of the optimiser.
        converged: whether the optimiser converged.
    """

    name: str
    error: float | None
    iterations: int
    converged: bool


class MinimumResult(Model):
    """A minimum, and where it differs most from the lowest one.

    Attributes:
        error: half the sum of squared whitened residuals.
        starts: attempts that ended there.
        time_s: time of the pose that differs most.
        pose_m: how far that pose is from the lowest minimum's.
        landmark: id of the landmark that differs most; None where the log has no landmarks.
        landmark_m: how far that landmark is from the lowest minimum's.
    """

    error: float
    starts: int
    time_s: float
    pose_m: float
    landmark: int | None
    landmark_m: float


class SmootherResult(Model):
    """The smoother, and the evidence for its optimum.

    See graphslam.optimum.

    Attributes:
        method: value of `--smoother`.
        optimiser: value of `--optimiser`.
        robust: value of `--robust`.
        rejected_measurements: outlying measurements of landmarks that were left out.
        rejected_positions: outlying absolute positions that were left out.
        distance_sigma: distance of an incremental estimate from the optimum, in sigma; None of a
            batch.
        rank: unknowns that the measurements determine.
        poses: poses of the problem.
        error: half the sum of squared whitened residuals at the optimum, of which a log has one.
        chi2: twice the error.
        dof: degrees of freedom: residuals minus unknowns.
        chi2_band: two-sided 99.8 % band of chi2.
        newton_decrement: what a full Gauss-Newton step promises to take off the error.
        iterations: iterations of the optimiser.
        converged: whether the optimiser converged.
        verified: whether all evidence for the global optimum is there.
        lacks: the first condition that does not hold, in words; empty where it is verified.
        agreeing_starts: starts that reached the lowest error.
        starts: all starts.
        minima: the distinct minima that were found, lowest first.
        hops: alternatives that were tried.
        random_starts: random starts that were tried.
        chance_missed: chance that the random starts miss a basin as wide as the lowest one's.
    """

    method: str
    optimiser: str
    robust: Annotated[str, Named("robust kernel", "{}")]
    rejected_measurements: Annotated[int, Named("measurements left out")]
    rejected_positions: Annotated[int, Named("positions left out")]
    distance_sigma: LeftOut[float | None]
    rank: LeftOut[int]
    poses: Annotated[Exact[int], Named("poses")]
    error: Annotated[Same[float], Named("error (half the chi-square)", "{:.2f}")]
    chi2: Same[float]
    dof: int
    chi2_band: tuple[float, float]
    newton_decrement: Less[float]
    iterations: LeftOut[int]
    converged: bool
    verified: bool
    lacks: str
    agreeing_starts: list[str]
    starts: list[StartResult]
    minima: list[MinimumResult]
    hops: Annotated[LeftOut[int], Named("alternatives tried")]
    random_starts: Annotated[LeftOut[int], Named("random starts")]
    chance_missed: Annotated[
        Less[float],
        Named("chance that the random starts miss a basin as wide as the lowest", "{:.1%}"),
    ]


SCHEMA = 4
"""Raised when a field of `result.json` changes its meaning. 1 had no `schema`."""


class Result(VerdictResult):
    """`result.json`: a whole run.

    Each extension that ran adds an entry of its name.

    Attributes:
        schema_version: version of the file, `schema`; raised when a field changes its meaning.
        ekf: the filter.
        smoother: the smoother.
        agreement: the gaps.
        consistency: consistency of filter and smoother.
        spurious_heading: what the filter learnt of its heading from measurements that cannot tell
            it; None where landmarks are surveyed.
        accuracy: errors against truth or GPS.
        association: the association compared with the log's labels.
        truth_gap: the smoother compared with truth.
        summary: verdict, qualifiers and the filter's consistency in one line.
        failed_on: findings that `--fail-on` names and that were made.
    """

    model_config = ConfigDict(serialize_by_alias=True, populate_by_name=True)

    schema_version: LeftOut[int] = Field(alias="schema", default=1)
    ekf: Count[EkfResult]
    smoother: Count[SmootherResult]
    agreement: Agreement
    consistency: ConsistencyResult
    spurious_heading: SpuriousHeadingResult | None = None
    accuracy: Accuracies | None = None
    association: AssociationScore | None = None
    truth_gap: TruthGap | None = None
    summary: str = ""
    failed_on: list[str] = Field(default_factory=list)


class PoseGraphResult(Model):
    """A log with loop closures.

    Attributes:
        loop_closures: number of closures.
        unmeasured: pairs of successive poses that no odometry connects.
        initial_chi2: chi-square where odometry alone leads, and guesses where there is none.
    """

    loop_closures: Annotated[int, Named("loop closures")]
    unmeasured: Annotated[int, Named("steps without odometry")]
    initial_chi2: Annotated[float, Named("chi-square of dead reckoning", "{:.6g}")]


class SolutionResult(CheckedResult):
    """`solution.json`: the smoother alone.

    Attributes:
        association_by: who associated: the log's labels, or the smoother.
        landmarks: landmarks of the solution.
        measurements_used: measurements of the log that were used.
        gps: value of `--gps`.
        smoother: the smoother.
        accuracy: errors of the smoother against truth or GPS.
        dead_reckoning: errors of the odometry alone.
        association: the association compared with the log's labels.
        association_check: whether the smoother's own association depends on how it was made; it
            must hold for `verified`, too.
        pose_graph: of a log with closures.
        verdict: whether the optimum is verified.
        reasons: what is lacking for `verified`, the gravest first.
    """

    association_by: str
    landmarks: int
    measurements_used: int
    gps: str
    smoother: Count[SmootherResult]
    accuracy: Accuracy | None = None
    dead_reckoning: Accuracy | None = None
    association: AssociationScore | None = None
    association_check: AssociationCheck | None = None
    pose_graph: PoseGraphResult | None = None
    verdict: Literal["verified", "unverified"]
    reasons: list[str]


def found_numbers(result: JobResult) -> dict[str, Number]:
    """Return the figures of a job by name, those of all checks and extensions as well."""
    from comparisons.report.explain import every_check

    asked = result.config.get("extensions")
    ran = [name for name in EXTENSIONS if isinstance(asked, dict) and name in asked]
    kinds = dict(entry for check in every_check(ran) for entry in check.figures)
    more = (result.model_extra or {}).items()
    entries = (numbers(one, kinds.get(key), key) for key, one in more)
    return dict(chain(numbers(result, type(result)), *entries))
