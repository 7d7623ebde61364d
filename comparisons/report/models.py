"""`result.json` and `solution.json`, for machines. The models are the files' documentation."""

from __future__ import annotations

from itertools import chain
from typing import Any, Literal

from pydantic import ConfigDict, Field

from comparisons.checks.accuracy import Accuracies, Accuracy
from comparisons.checks.agreement import Agreement
from comparisons.checks.association import AssociationScore
from comparisons.checks.association_variants import AssociationCheck
from comparisons.checks.consistency.finding import ConsistencyResult
from comparisons.checks.filter import EkfFigures
from comparisons.checks.log import LogFigures
from comparisons.checks.qualifiers import TruthGap
from comparisons.checks.settings import SettingsResult
from comparisons.checks.smoother import SmootherFigures
from comparisons.checks.solution import PoseGraphResult
from comparisons.checks.spurious import SpuriousHeadingResult
from comparisons.extension_names import EXTENSIONS
from comparisons.figures import (
    Count,
    LeftOut,
    Model,
    Number,
    numbers,
)
from comparisons.words import Cause


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
    log: LeftOut[LogFigures]
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
    ekf: Count[EkfFigures]
    smoother: Count[SmootherFigures]
    agreement: Agreement
    consistency: ConsistencyResult
    spurious_heading: SpuriousHeadingResult | None = None
    accuracy: Accuracies | None = None
    association: AssociationScore | None = None
    truth_gap: TruthGap | None = None
    summary: str = ""
    failed_on: list[str] = Field(default_factory=list)


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
    smoother: Count[SmootherFigures]
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
