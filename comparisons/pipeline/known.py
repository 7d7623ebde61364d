"""What a job knows: what its checks read, and what they have found.

The jobs differ in what they put in: a run its own filter, a check somebody else's estimate and,
with a trace, the events of its filter, a solve neither.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array, Index
from comparisons.checks.finding import Finding, Findings, LackingError
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import ExternalEstimate, Information
from comparisons.estimates.reference import Reference
from comparisons.innovations import SensorInnovations
from comparisons.logs.log import Log, Positions
from comparisons.pipeline.beside import BackgroundCall
from comparisons.pipeline.gaps import Gaps, Optimum
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.records import FilterRecords
from comparisons.shown import Brief
from graphslam.increments import dead_reckoned
from graphslam.smoother import SmootherEvidence

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, repr=False)
class EstimateUnderCheck(Brief):
    """Somebody else's estimate.

    estimate: as it was handed in. inside: its poses within the log's time. optimum: the smoother at
    these. information: what its poses know of the log, None where nothing tells. sensors: the
    innovations of its filter, none without a trace.
    """

    estimate: ExternalEstimate
    inside: ExternalEstimate
    optimum: Reference
    information: Information | None
    sensors: tuple[SensorInnovations, ...] = ()


@dataclass(frozen=True, kw_only=True, repr=False)
class Known(Findings, Brief):
    """What a job knows, for its checks. What it has not raises LackingError with the reason.

    Attributes:
        prepared: The log as the estimators read it, and the configuration.
        name: Of the job, where its configuration is that of another.
        source: The log as it was read; None where the estimators read it so.
        landmark_index: (M,) the landmark of each measurement, negative for unused.
        timeline: Of the estimates.
        positions: Absolute positions that they fuse.
        solved: The smoother's optimum S with its evidence, and as an estimate.
        called: What reports call S.
        ways: (K, 3) poses without covariances at S's epochs, by what reports call them; None for
            where the odometry alone leads.
        without: Why there is no filter, or no S.
        run: A filter with the events that it went through.
        kept: What its records say, and the gaps between it and S.
        beside: What stood beside our filter, with what extensions offered.
        given: Somebody else's estimate that is judged.
        started: What extensions have started beside the smoother, by name.
        findings: Of the checks that came before, by name.
        absent: Why other checks have none, by name.
    """

    prepared: Prepared[Any]
    name: str = ""
    source: Log | None = None
    landmark_index: Index
    timeline: Timeline
    positions: Positions | None
    solved: Optimum | None = None
    called: str = "smoother"
    ways: Mapping[str, Array] | None = None
    without: str = "the job runs no filter"
    run: EkfRun | None = None
    kept: FilterRecords | None = None
    beside: FilterSetup | None = None
    given: EstimateUnderCheck | None = None
    started: Mapping[str, BackgroundCall[Any]] = field(default_factory=dict)
    findings: dict[str, Finding] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)

    @property
    def job(self) -> str:
        """The job's name, which its result's file and its page have."""
        return self.name or self.prepared.config.job

    @property
    def log(self) -> Log:
        """The log as it was read."""
        return self.source or self.prepared.log

    @property
    def ekf(self) -> EkfRun:
        """The filter that the events are of, ours or the one that left a trace."""
        return self._present(self.run)

    @property
    def gaps(self) -> Gaps:
        """The chain of estimates from that filter to the smoother."""
        return self.records.gaps

    @property
    def records(self) -> FilterRecords:
        """What the records of that filter say."""
        return self._present(self.kept)

    @property
    def setup(self) -> FilterSetup:
        """What stood beside our filter."""
        return self._present(self.beside)

    @property
    def result(self) -> SmootherEvidence:
        """S with its evidence."""
        return self._present(self.solved)[0]

    @property
    def smoothed(self) -> Estimate:
        """S as an estimate."""
        return self._present(self.solved)[1]

    def _present(self, one: T | None) -> T:
        if one is None:
            raise LackingError(self.without)
        return one

    @property
    def estimates(self) -> dict[str, Estimate]:
        """The estimates of the log, by what reports call them; the one that is judged first."""
        judged = {} if self.run is None else {"EKF": self.run.estimate}
        if self.given is not None:
            judged = {"estimate": self.given.estimate.padded()}
        return judged if self.solved is None else {**judged, self.called: self.smoothed}

    @cached_property
    def dead_reckoned(self) -> Array:
        """(K, 3) poses where the odometry alone leads."""
        problem = self.result.problem
        return dead_reckoned(problem.prior_pose, problem.increment)
