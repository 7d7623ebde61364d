"""The grade of somebody else's estimate, and the figures that it rests on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from comparisons.checks.agreement import BlockAgreement, LandmarkAgreement, Together
from comparisons.checks.diagnosis.departure import Departure
from comparisons.checks.finding import Basis
from comparisons.checks.gaps import agreeing, block_rows, pose_words
from comparisons.checks.grade import Likeness
from comparisons.figures import (
    METRES,
    Count,
    LeftOut,
    Less,
    Model,
    More,
    Named,
    Nominal,
    band,
    finite,
    in_sigma,
    percent,
    rows_of,
    shown,
)
from comparisons.words import DEPARTURE, Row

if TYPE_CHECKING:
    from comparisons.jobs.external_check import ExternalCheck

NOT_STATED = "not stated"
"""In place of what an estimate's poses know of the log."""


class NearestResult(Model):
    """The reference that the estimate is nearest to.

    See comparisons.checks.grade.Likeness.

    Attributes:
        name: name of the reference.
        largest_sigma: largest difference of any mean, in sigma.
        variance_ratio_least: least variance over the reference's, of all poses, landmarks and
            directions; None without covariances.
        variance_ratio_largest: largest such ratio; None without covariances.
        parts: parts of the estimate that were compared.
        missing: parts that the estimate does not have.
    """

    name: Annotated[str, Named("nearest reference", "{}")]
    largest_sigma: Less[float | None]
    variance_ratio_least: Nominal[float | None]
    variance_ratio_largest: Nominal[float | None]
    parts: list[str]
    missing: list[str]

    @classmethod
    def of(cls, likeness: Likeness) -> NearestResult:
        """Return it of an estimate beside a reference."""
        low, high = likeness.variances or (None, None)
        return cls(
            name=likeness.reference.name,
            largest_sigma=finite(likeness.sigma),
            variance_ratio_least=low,
            variance_ratio_largest=None if high is None else finite(high),
            parts=[part.name for part in likeness.parts],
            missing=[*likeness.missing, *likeness.unmapped],
        )

    def rows(self) -> list[Row]:
        """Return rows of the table."""
        far = "largest difference of a mean from the nearest reference"
        rows = [*rows_of("Estimate", self), Row("Estimate", far, in_sigma(self.largest_sigma))]
        if self.variance_ratio_least is not None:
            ends = (self.variance_ratio_least, self.variance_ratio_largest)
            ratios = band(*(shown(value, ".4g") for value in ends))
            rows.append(Row("Estimate", "variances, estimate over nearest reference", ratios))
        return rows


def _turned(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.3g} deg"


class GradeFigures(Model):
    """An estimate beside the smoother and the reference that it is nearest to.

    Attributes:
        information: what a pose of the estimate knows: filtered or smoothed.
        estimator: kind of estimator, as the estimate says.
        absent: parts that were not handed in.
        poses: poses that were judged.
        coverage: share of the log's time that the estimate covers.
        uncovered_s: intervals that it does not cover.
        rms_m: root mean square distance of the positions from the smoother's.
        rms_heading_rad: root mean square difference of the headings.
        outside: share of the poses beyond the 99.9 % region of their own covariance; None without
            covariances.
        last_pose: the last pose, compared with the smoother's.
        landmarks: each landmark, compared with the smoother's.
        estimate_sha256: hashes of the files that were judged, by name; empty where none were read.
        grade: how near to a reference EKF or to the optimum; None where it is not like any
            reference and the optimum is not verified.
        required: the lowest grade that agrees.
        nearest: the nearest reference.
        departure: where the estimate, or its trace, first leaves a sound filter; None where not.
    """

    information: Annotated[str, Named("kind of poses (filtered, smoothed)", "{}")]
    estimator: str
    absent: list[str]
    poses: Annotated[Count[int], Named("poses")]
    coverage: Annotated[More[float], Named("coverage of the log's time", percent)]
    uncovered_s: list[tuple[float, float]]
    rms_m: Annotated[Less[float], Named("difference of the positions (rms)", METRES)]
    rms_heading_rad: Annotated[Less[float], Named("difference of the headings (rms)", _turned)]
    outside: Annotated[
        Less[float | None], Named("poses beyond the 99.9 % region of their own covariance", percent)
    ] = None
    last_pose: BlockAgreement | None = None
    landmarks: Together[tuple[LandmarkAgreement, ...]]
    estimate_sha256: dict[str, str]
    grade: Literal["equal", "like", "plausible", "wrong"] | None = None
    required: Literal["equal", "like", "plausible"]
    nearest: NearestResult | None = None
    departure: LeftOut[Departure | None] = None

    @classmethod
    def of(cls, check: ExternalCheck) -> GradeFigures:
        """Return those of an estimate that is checked."""
        agreement, given, grade = check.agreement, check.given, check.grade
        return cls(
            information=given.information or NOT_STATED,
            estimator=given.estimator,
            absent=given.absent,
            poses=len(agreement.time_s),
            coverage=check.coverage.share,
            uncovered_s=check.coverage.holes_s.tolist(),
            rms_m=agreement.rms_m,
            rms_heading_rad=agreement.rms_heading_rad,
            outside=agreement.outside,
            last_pose=agreement.last,
            landmarks=agreement.landmarks,
            estimate_sha256=dict(given.sha256),
            grade=grade.value,
            required=grade.required,
            nearest=None if grade.by is None else NearestResult.of(grade.by),
            departure=check.departure,
        )


class GradeFinding(Basis[GradeFigures]):
    """The grade of an estimate. words: the grade, or why there is none."""

    def __init__(self, check: ExternalCheck) -> None:
        """check: of the estimate."""
        figures = GradeFigures.of(check)
        found = {name: getattr(figures, name) for name in GradeFigures.model_fields}
        entries = {name: value for name, value in found.items() if value is not None}
        super().__init__(figures, entries=entries)
        self._outcome, name = check.outcome, figures.nearest.name if figures.nearest else ""
        self.words = {
            "equal": f"equal to {name}",
            "like": f"like {name}",
            "plausible": "plausible",
            "wrong": "wrong",
            None: "none: too little of the log is covered"
            if check.is_short
            else "none: optimum not verified",
        }[figures.grade]
        self.lines = [("agreement", "; ".join(_agreeing(figures)))]

    def rows(self) -> Sequence[Row]:
        """Return rows of the table."""
        figures, is_good = self.value, None
        if self._outcome != "unverified":
            is_good = self._outcome == "agree"
        rows = [
            Row("Estimate", "grade", self.words, f">= {figures.required}", is_good),
            *rows_of("Estimate", figures, ["poses", "information", "coverage"]),
        ]
        if figures.nearest is not None:
            rows += figures.nearest.rows()
        if (left := figures.departure) is not None:
            where = f"from {left.what}, at {left.time_s:.9g} s, {left.event}"
            rows.append(Row("Estimate", DEPARTURE, where))
        path = ["rms_m", "rms_heading_rad", "outside"]
        rows += rows_of("Path, estimate and smoother", figures, path)
        if figures.last_pose is not None:
            rows += block_rows("Last pose", "estimate", figures.last_pose)
        return [*rows, *agreeing(figures.landmarks, "estimate")]


def _agreeing(figures: GradeFigures) -> list[str]:
    """What agrees with the smoother, in words."""
    agree = []
    if figures.landmarks:
        count = sum(row.agrees for row in figures.landmarks)
        agree.append(f"{count} of {len(figures.landmarks)} landmarks")
    if figures.last_pose is not None:
        agree.append(pose_words(figures.last_pose))
    if len(agree) < 2:
        agree.append(f"path {figures.rms_m:.3f} m rms from smoother")
    return agree
