"""Scan landmarks in `result.json`, on the terminal, and their templates on the map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from comparisons.checks.agreement import PlacedAgreement, Together
from comparisons.config import setting_default
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.scan_landmarks.config import ScanLandmarksConfig
from comparisons.extensions.scan_landmarks.source import ScanSlamSource, scan_slam_options
from comparisons.figures import LeftOut, Model, Named, rows_of
from comparisons.pipeline.gaps import Gaps
from comparisons.words import Row
from ekf_reference.scan_landmarks.scan_slam import ScanSlamOptions
from ekf_reference.scan_landmarks.template_extraction import SingleSegments

_EXTRACTION = {"joined": "whole-scan", "single": "per-segment"}
"""Choices of the setting template_extraction by what results keep."""
_NOISE = {
    ("sandwich", True): "shared returns counted once",
    ("sandwich", False): "independent alignments",
    ("curvature", True): "covariance by curvature",
    ("curvature", False): "covariance by curvature",
}
"""R of an alignment, by its covariance and by whether shared noise is counted once."""
_PLACE = "Nieto 2005, sections 5.4 to 5.7"


def scan_slam_result(source: ScanSlamSource, ekf: Estimate, gaps: Gaps) -> ScanSlamResult:
    """Return what the scans gave as landmarks."""
    landmarks, smoothed = source.found, gaps.smoothed
    return ScanSlamResult(
        scans=landmarks.scans,
        landmarks=[
            ScanLandmark(
                **vars(landmark),
                ekf_heading_rad=float(ekf.pose_landmarks[i, 2]),
                smoother_heading_rad=float(smoothed.pose_landmarks[i, 2]),
                measurements=landmarks.measurements[landmark.id],
                points=len(landmarks.template[landmark.id].shape),
            )
            for i, landmark in enumerate(gaps.agreement.pose_landmarks)
        ],
        rejected=landmarks.rejected,
        dynamic=landmarks.dynamic,
        deactivated=len(landmarks.moving),
        fused=source.merged,
        pieces=source.options.extraction.name,
        rule=template_rule(source.options),
        measurements=dict(landmarks.reasons),
    )


def template_rule(options: ScanSlamOptions) -> TemplateRule:
    """Return the rule by which templates were made and observed."""
    extraction = options.extraction
    trial = extraction.segmentation
    return TemplateRule(
        pieces=extraction.name,
        least_returns=extraction.least_returns,
        in_view=extraction.share,
        residual=trial.residual,
        open_directions=trial.open_directions,
        trials=trial.trials,
        tried=extraction.tried if isinstance(extraction, SingleSegments) else 1,
        every=extraction.every,
        aligned=options.aligned,
        gate=options.gate,
        shared_noise=options.shared_noise,
        alignment_covariance=options.belief.form,
    )


def published_rule(log_format: str | None = None) -> TemplateRule:
    """Return the thesis' rule for logs of a format, as `--preset nieto-2005` has it."""
    from comparisons.documented.preset import published

    asked = {"log": {"format": log_format}, "extensions": {"scan_landmarks": {}}}
    given = published("nieto-2005", asked, (), setting_default)["extensions"]["scan_landmarks"]
    return template_rule(scan_slam_options(ScanLandmarksConfig.of(**given), mapped=False))


def scan_slam_rows(result: ScanSlamResult, thesis: TemplateRule) -> list[Row]:
    """Return how many agree, how templates were made, and what became of the measurements.

    thesis: the published rule for the log.
    """
    group, count = "Scan landmarks", sum(row.agrees for row in result.landmarks)
    agreeing = f"{count} of {len(result.landmarks)}"
    further = [one for one in ("fused", "dynamic", "deactivated") if getattr(result, one)]
    rows = [
        Row(group, "landmarks that agree", agreeing, "all", count == len(result.landmarks)),
        *rows_of(group, result, ["scans", "pieces", "rejected", *further]),
    ]
    if result.rule:
        rows.append(Row(group, "rule of the templates", rule_text(result.rule, thesis)))
    counts = result.measurements.items()
    return rows + [Row(group, f"measurements {reason}", f"{n:,}") for reason, n in counts if n]


def rule_text(rule: TemplateRule, thesis: TemplateRule) -> str:
    """Return the rule in words, and the thesis' where that is another."""
    if rule == thesis:
        return f"{in_words(rule)} ({_PLACE})"
    if (words := in_words(thesis)) == in_words(rule):
        return f"{words} ({_PLACE}; in part by other settings)"
    return f"{in_words(rule)} ({_PLACE}: {words})"


def in_words(rule: TemplateRule) -> str:
    """Return a rule in words."""
    aligned = f"{rule.aligned} aligned a scan" if rule.aligned else "all aligned"
    return (
        f"{'one segment' if rule.pieces == 'single' else 'whole scan'}, "
        f"{rule.least_returns} returns, trial within {rule.residual:.0%} with "
        f"{rule.open_directions or 'no'} direction{'s' if rule.open_directions > 1 else ''} open, "
        f"{rule.in_view:.0%} in view, {aligned}, gate {rule.gate:g}, "
        f"{_NOISE[rule.alignment_covariance, rule.shared_noise]}"
    )


@dataclass(frozen=True, kw_only=True)
class ScanLandmark(PlacedAgreement):
    """One scan landmark, compared.

    Attributes:
        ekf_heading_rad: heading by the EKF.
        smoother_heading_rad: heading by the smoother.
        measurements: measurements of it that were used.
        points: points of its template.
    """

    ekf_heading_rad: float
    smoother_heading_rad: float
    measurements: int
    points: int


class TemplateRule(Model):
    """How templates are made and observed (Nieto 2005, sections 5.5 and 5.7).

    Attributes:
        pieces: `joined`: all segments of a scan are one template; `single`: each is its own.
        least_returns: least returns of a template.
        in_view: least share of a template that must be in view.
        residual: largest error of a trial over its displacement.
        open_directions: directions that a trial may leave open.
        trials: displaced copies of a trial.
        tried: most candidates of a scan; 0 for all.
        every: scans from one that may initialise landmarks to the next.
        aligned: most templates that are aligned with a scan; 0 for all in view.
        gate: gate of an alignment, chi-square.
        shared_noise: returns that several alignments share are counted once.
        alignment_covariance: `sandwich`: of the error of an alignment; `curvature`: of the
            correlation's own shape (eqs. 5.16 and 5.17).
    """

    pieces: str
    least_returns: int
    in_view: float
    residual: float
    open_directions: int
    trials: int
    tried: int
    every: int
    aligned: int
    gate: float
    shared_noise: bool = False
    alignment_covariance: str = "sandwich"


class ScanSlamResult(Model):
    """Entry `scan_slam`: Scan-SLAM.

    Attributes:
        scans: scans that were searched.
        landmarks: each landmark.
        rejected: segments that failed their trial.
        dynamic: returns that were left out since something moves there.
        deactivated: landmarks that are no longer matched, since their template is where something
            moves.
        fused: landmarks that turned out to be another one.
        pieces: as in `rule`.
        rule: how templates are made and observed.
        measurements: how often a landmark near the scanner was measured, or why not.
    """

    scans: Annotated[int, Named("scans")]
    landmarks: Together[list[ScanLandmark]]
    rejected: Annotated[int, Named("segments that failed their trial alignment")]
    dynamic: Annotated[int, Named("returns of moving objects, left out")] = 0
    deactivated: Annotated[int, Named("landmarks deactivated on moving objects")] = 0
    fused: Annotated[int, Named("landmarks merged with duplicates")] = 0
    pieces: Annotated[str, Named("template extraction", _EXTRACTION.__getitem__)] = "single"
    rule: LeftOut[TemplateRule | None] = None
    measurements: dict[str, int]
