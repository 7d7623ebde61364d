"""What `slamcheck check` reports: check.json, what is printed, and its folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from comparisons.arrays import Index
from comparisons.checks.accuracy import Accuracy, landmark_errors
from comparisons.checks.agreement import (
    LARGEST_DISTANCE,
    largest_distance,
)
from comparisons.checks.causes import FILTER_FAULTS, SYMPTOMS
from comparisons.checks.consistency.finding import ExternalConsistencyResult
from comparisons.checks.diagnosis.departure import Departure
from comparisons.checks.grade import LIKE_SIGMA, match_map
from comparisons.checks.smoother import SmootherFigures
from comparisons.estimates.estimate import Estimate
from comparisons.figures import (
    Count,
)
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.external_trace import TraceCheck
from comparisons.jobs.grade import GradeFigures
from comparisons.pipeline.clock import Clock
from comparisons.report.figures.run import map_figure
from comparisons.report.html.drawing import Drawing
from comparisons.report.html.map import (
    MapContent,
    Track,
    all_landmarks,
    associations,
    estimate_track,
    farthest,
)
from comparisons.report.html.page import PageContent
from comparisons.report.html.tables import LandmarkRow, landmarks_note
from comparisons.report.job_report import JobReport, judged_entries
from comparisons.report.ladder import SMOOTHER, LadderStep, gap_steps
from comparisons.report.marks import DEPARTURE_COLOUR, EKF_COLOUR, SMOOTHER_COLOUR, Panel
from comparisons.report.models import VerdictResult
from comparisons.report.panels import external_panels, filters_compared
from comparisons.report.rows import gap_rows
from comparisons.report.terminal import Summary
from comparisons.words import DEPARTURE, Row, cause_name
from ekf_reference.core.landmark_types import POINT

EXTERNAL = "external estimate"


def _landmark_table(
    check: ExternalCheck, result: CheckResult, ours: Index, shown: Index
) -> tuple[list[LandmarkRow], str]:
    """Rows of those landmarks that both have and the map marks, and a note.

    ours: of all that both have. shown: rows (m,) of the smoother's.
    """
    given, optimum = check.given, check.optimum
    if given.landmark is None or given.landmark_id is None:
        return [], "The estimate has no landmarks, so none are compared."
    if not len(ours):
        return [], "None of the landmarks of the estimate is one of the smoother's."
    labelled = check.solution.prepared.labelled
    errors = landmark_errors(
        given.landmark_id, given.landmark, check.solution.log, labelled=labelled
    )
    shown_ids = set(optimum.landmark_id[shown].tolist())
    rows = [
        LandmarkRow(
            str(row.id),
            optimum.labels.get(row.id) or _both_names(row.id, int(given.landmark_id[i])),
            row,
            errors[i],
        )
        for row, i in zip(result.landmarks, ours.tolist(), strict=True)
        if row.id in shown_ids
    ]
    note = landmarks_note(len(rows), len(ours), "check.json", "the estimate's")
    if given.landmark_covariance is None:
        note += " The estimate has none, so there are no ratios."
    return rows, note


def _both_names(own: int, given: int) -> str:
    return str(own) if own == given else f"{own} ({given} in the estimate)"


def check_map(check: ExternalCheck, ours: Index, theirs: Index) -> tuple[MapContent, Index]:
    """The smoother's, the external estimate, and filters it was compared with.

    ours, theirs: rows of the landmarks that both have. The smoother's that are marked come second.
    """
    solution, given, blocks = check.solution, check.given, check.agreement.landmarks
    smoothed = solution.estimate
    count = len(smoothed.landmark)
    distance, ratio = np.full(count, np.nan), np.full(count, np.nan)
    distance[theirs] = [block.distance_sigma for block in blocks]
    ratio[theirs] = [block.ratios[0] if block.ratios else np.nan for block in blocks]
    marked = farthest(distance)
    ids = smoothed.landmark_id[marked]
    names = smoothed.names
    labels = {
        int(smoothed.landmark_id[row]): f"landmark {names[row]}: not in the estimate"
        for row in marked.tolist()
    }
    for row, block in zip(theirs.tolist(), blocks, strict=True):
        labels[int(smoothed.landmark_id[row])] = (
            f"landmark {names[row]}: {block.difference_m:.3f} m apart, "
            f"{block.distance_sigma:.2g} sigma"
        )
    beneath = [
        associations(
            smoothed, solution.prepared.timeline.measurement_epoch, solution.landmark_index
        ),
        *all_landmarks("all landmarks", smoothed.landmark, marked),
    ]
    track = Track(
        name="estimate",
        colour=EKF_COLOUR,
        dashes="5 3",
        time_s=given.time_s,
        pose=given.pose,
        pose_covariance=given.pose_covariance,
    )
    if given.landmark is not None:
        place, spread = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
        place[theirs] = given.landmark[ours]
        track = replace(track, landmark=place[marked])
        if given.landmark_covariance is not None:
            spread[theirs] = given.landmark_covariance[ours]
            track = replace(track, landmark_covariance=spread[marked])
        others = np.delete(given.landmark, ours, axis=0)
        beneath += all_landmarks("estimate landmarks without a counterpart", others, ours[:0])
    return MapContent(
        log=solution.log,
        tracks=[
            estimate_track("smoother", SMOOTHER_COLOUR, smoothed, ids),
            track,
            *(
                Track(
                    name=reference.name.removeprefix("the ").removeprefix("an "),
                    colour=colour,
                    dashes="2 2",
                    time_s=reference.time_s,
                    pose=reference.pose,
                    against_time=False,
                )
                for reference, colour in filters_compared(check)
            ),
        ],
        keys=ids.tolist(),
        labels=[labels[i] for i in ids.tolist()],
        ratio=ratio[marked],
        view=[smoothed.pose[:, :2], smoothed.landmark],
        beneath=beneath,
        above=() if check.departure is None else (partial(_mark, check.departure),),
    ), marked


def _mark(left: Departure, drawing: Drawing) -> None:
    """Mark the first departure on the map."""
    look, place = (DEPARTURE, DEPARTURE_COLOUR), np.array([left.place])
    drawing.marks(*look, place, [str(left)], [DEPARTURE], [DEPARTURE_COLOUR])


def _verdict_words(check: ExternalCheck, result: CheckResult) -> str:
    """The grade, and what was asked for, as sentences."""
    nearest = result.nearest.name if result.nearest else ""
    grade = {
        "equal": f"The estimate equals {nearest} to rounding.",
        "like": f"The estimate is like {nearest}: means and covariances differ by at most 5 %.",
        "plausible": "The estimate is within the optimum's own uncertainty.",
        "wrong": "The estimate is wrong: its trace shows a fault."
        if any(cause.gap in FILTER_FAULTS for cause in result.causes)
        else "The estimate is wrong: it is like no reference and far from the optimum.",
        None: "There is no grade: too little of the log is covered."
        if check.is_short
        else "There is no grade: the smoother's optimum or its association is not verified.",
    }[result.grade]
    causes = " The causes, the most important first:" if result.causes else ""
    return f"{grade} The required grade is {result.required}.{causes}"


def _facts(result: CheckResult) -> list[tuple[str, str]]:
    """What the grade rests on, in a few lines."""
    smoother = result.smoother
    optimum = "verified" if smoother.verified else f"not verified: {smoother.lacks}"
    facts = [
        ("Smoother's optimum", optimum),
        ("Poses", f"{result.poses:,}, {result.rms_m:.3f} m from the smoother's (RMS)"),
        ("Coverage", f"{100.0 * result.coverage:.1f} % of the log's time"),
    ]
    if result.landmarks:
        agreeing = sum(row.agrees for row in result.landmarks)
        facts.append(("Landmarks", f"{agreeing:,} of {len(result.landmarks):,} agree"))
    return facts


class CheckResult(GradeFigures, VerdictResult):
    """`check.json`: an external estimate compared with reference filters and with the smoother.

    Attributes:
        smoother: the smoother.
        association_by: who associated.
        consistency: consistency of the estimate's covariances.
        accuracy: errors of the estimate.
        smoother_accuracy: errors of the smoother.
        trace: what the recorded equations say; None without a trace.
    """

    smoother: Count[SmootherFigures]
    association_by: str
    consistency: ExternalConsistencyResult
    accuracy: Accuracy | None = None
    smoother_accuracy: Accuracy | None = None
    trace: Count[TraceCheck | None]


def check_ladder(result: CheckResult) -> list[LadderStep]:
    """Return the gaps of an external estimate.

    With a trace they are those of a run; a grade does not need the last one. Without a trace there
    are two: from the estimate to the nearest reference, and to the smoother.
    """
    failed = {cause.gap for cause in result.causes}
    verified = result.smoother.verified
    if result.trace is not None:
        *steps, last = gap_steps(result.trace, failed, verified=verified, first=EXTERNAL)
        near = last.sigma is not None and last.sigma <= LARGEST_DISTANCE
        return [*steps, replace(last, judged=last.judged and (near or last.fails))]
    blocks = [*result.landmarks, *([] if result.last_pose is None else [result.last_pose])]
    sigma = max((block.distance_sigma for block in blocks), default=None)
    limit = largest_distance(len(result.landmarks), POINT.width)
    near = sigma is None or sigma <= limit
    is_far = verified and not near and result.verdict == "disagree"  # whatever explains it
    to_smoother = LadderStep(
        gap="optimum",
        above=EXTERNAL,
        below=SMOOTHER,
        sigma=sigma,
        error_m=result.rms_m,
        fails="optimum" in failed or is_far,
        judged=verified and (near or result.grade == "plausible"),
        limit=limit,
    )
    return [*_reference_steps(result), to_smoother]


def _reference_steps(result: CheckResult) -> list[LadderStep]:
    """The estimate against the reference that it is nearest to, if that is not the smoother."""
    nearest = result.nearest
    if nearest is None or SMOOTHER in nearest.name:
        return []
    ratios = (nearest.variance_ratio_least, nearest.variance_ratio_largest)
    like = result.grade in ("equal", "like")
    return [
        LadderStep(
            gap="reference",
            above=EXTERNAL,
            below=nearest.name.removeprefix("the "),
            sigma=nearest.largest_sigma,
            covariance=max(
                (abs(ratio - 1.0) for ratio in ratios if ratio is not None), default=None
            ),
            fails=not like and result.verdict == "disagree",
            judged=like,
            limit=LIKE_SIGMA,
        )
    ]


class CheckReport(JobReport[ExternalCheck, CheckResult]):
    """Report of `slamcheck check`."""

    judged = "estimate"

    @staticmethod
    def build(check: ExternalCheck, read: Clock | None = None) -> CheckResult:
        """The findings, read being the time that reading log and estimate took."""
        return CheckResult(
            association_by=check.solution.association_by,
            trace=check.trace,
            **judged_entries(check.known, check, CheckResult, read),
        )

    @property
    def headline(self) -> str:
        """The outcome and the grade."""
        required = f" (required: {self.result.required})"
        return f"{super().headline}; grade: {self.found.grade_words}{required}"

    @property
    def steps(self) -> Sequence[LadderStep]:
        """The gaps of the estimate."""
        return check_ladder(self.result)

    @property
    def job_rows(self) -> Sequence[Row]:
        """Rows of its filter's gaps, where the estimate has a trace."""
        return gap_rows(self.steps) if self.result.trace else []

    def summary(self) -> Summary:
        """Return what the command prints; what the first cause explains stands behind it."""
        result, left = self.result, self.result.departure
        elsewhere = [] if left is None else [str(left), left.briefly]
        departure = elsewhere[:1]
        explained = [cause_name(gap) for gap in self.found.consequences]
        symptom = bool(result.causes) and result.causes[0].gap in SYMPTOMS
        return replace(
            super().summary(),
            explained=[DEPARTURE, *explained] if departure and explained else explained,
            reasons=departure if symptom else [],
            remarks=[
                remark
                for remark in result.remarks
                if not ((symptom or explained) and remark in elsewhere)
            ],
        )

    @property
    def curves(self) -> tuple[str, Sequence[Panel]]:
        """Errors by truth and by the smoother, and innovations over time."""
        return external_panels(self.found)

    @property
    def facts(self) -> Sequence[tuple[str, str]]:
        """What the grade rests on."""
        return _facts(self.result)

    @cached_property
    def _common(self) -> tuple[Index, Index]:
        """Rows of the landmarks that the estimate and the smoother have."""
        labelled = self.found.solution.prepared.labelled
        return match_map(self.found.given, self.found.optimum, labelled=labelled)

    @cached_property
    def _map(self) -> tuple[MapContent, Index]:
        return check_map(self.found, *self._common)

    def drawn(self) -> MapContent:
        """Return what the page's map shows: smoother, estimate, and filters beside it."""
        return self._map[0]

    def page(self, pictures: Sequence[Path] = ()) -> PageContent:
        """Return what stands on the page. pictures: files of those that have been drawn."""
        check, result, (ours, theirs) = self.found, self.result, self._common
        shown = theirs[np.isin(theirs, self._map[1])]
        rows, note = _landmark_table(check, result, ours, shown)
        grade = "no grade" if result.grade is None else check.grade_words
        source = Path(str(result.config.get("estimate") or "arrays")).name
        return replace(
            super().page(pictures),
            headline=f"{result.headline}, {grade}",
            words=_verdict_words(check, result),
            about=f"estimate: {source}; log: {result.log.words}",
            landmarks=rows,
            landmarks_note=note,
        )

    @property
    def estimates(self) -> Mapping[str, Estimate]:
        """The smoother's, for the other one was handed in."""
        return {"smoother": self.found.solution.estimate}

    def figures(self) -> Mapping[str, Figure]:
        """Return the map."""
        return {"map": map_figure(self.found)}
