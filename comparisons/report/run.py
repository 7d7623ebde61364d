"""What `slamcheck run` reports: result.json, what is printed, and its folder with a page."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from comparisons.arrays import Index
from comparisons.checks.accuracy import landmark_errors
from comparisons.checks.agreement import BlockAgreement, PlacedAgreement
from comparisons.jobs.run import Comparison
from comparisons.logs.bundled import NAMED
from comparisons.pipeline.clock import Clock
from comparisons.report.html.heat_map import heat_maps
from comparisons.report.html.map import (
    MapContent,
    all_landmarks,
    associations,
    estimate_track,
    farthest,
)
from comparisons.report.html.page import PageContent
from comparisons.report.html.tables import LandmarkRow, landmarks_note
from comparisons.report.job_report import JobReport, judged_entries
from comparisons.report.ladder import LadderStep, ladder
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, Panel
from comparisons.report.models import SCHEMA, Result
from comparisons.report.panels import ConsistencyPanels, consistency_panels, further_estimates
from comparisons.report.settings import setting_lines
from ekf_reference.core.state import correlation_coefficients

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WORDS = {
    "agree": "EKF and smoother agree: the last pose, every landmark and the whole map differ from "
    "the smoother's optimum by less than the limits.",
    "disagree": "EKF and smoother disagree. The causes, the most important first:",
    "unverified": "There is no verdict: the smoother's optimum is not verified, so the EKF cannot "
    "be compared with it.",
}


class RunReport(JobReport[Comparison, Result]):
    """Report of `slamcheck run`: both estimators on one log."""

    file = "result"

    @staticmethod
    def build(comparison: Comparison, read: Clock | None = None) -> Result:
        """Return the findings of a run, read being the time that reading the log took."""
        verdict = comparison.verdict
        return Result(
            schema_version=SCHEMA,
            summary=verdict.summary,
            failed_on=list(verdict.failed_on),
            **judged_entries(comparison.known, verdict, Result, read),
        )

    @cached_property
    def panels(self) -> ConsistencyPanels:
        """Curves over time."""
        return consistency_panels(self.found)

    @property
    def outcome(self) -> str:
        """Return the word that decides the command's exit code."""
        return "disagree" if self.result.failed_on else self.result.verdict

    @property
    def headline(self) -> str:
        """The outcome with its figures, and on what the run fails."""
        result = self.result
        failed = f" (fails on {', '.join(result.failed_on)})" if result.failed_on else ""
        return f"verdict: {result.summary.partition(' (')[0] or result.headline}{failed}"

    @property
    def lines(self) -> Sequence[tuple[str, str]]:
        """What is known of the log, where that explains the outcome."""
        return _known_example(self.result)

    @property
    def steps(self) -> Sequence[LadderStep]:
        """The gaps from the EKF down to the truth."""
        return ladder(self.result)

    @property
    def curves(self) -> tuple[str, Sequence[Panel]]:
        """Errors, NEES, distances and innovations over time."""
        return self.panels.reported, self.panels.every

    @property
    def facts(self) -> Sequence[tuple[str, str]]:
        """What the verdict rests on."""
        return _facts(self.result, [*self.result.agreement.landmarks, *self._scan_landmarks])

    @property
    def _scan_landmarks(self) -> list[PlacedAgreement]:
        return [row for finding in self.found.findings.values() for row in finding.landmarks()]

    @cached_property
    def _marked(self) -> Index:
        """Rows of the landmarks that the map and its table have."""
        blocks = self.found.agreement.landmarks
        return farthest(np.array([block.distance_sigma for block in blocks]))

    def drawn(self) -> MapContent:
        """Return what the page's map shows: both estimates and those of the extensions."""
        return run_map(self.found, self._marked)

    def page(self, pictures: Sequence[Path] = ()) -> PageContent:
        """Return what stands on the page. pictures: files of those that have been drawn."""
        result, c, content = self.result, self.found, super().page(pictures)
        ekf, a, marked = c.ekf.estimate, result.agreement.landmarks, self._marked
        labelled = c.prepared.labelled
        errors = landmark_errors(ekf.landmark_id, ekf.landmark, c.log, labelled=labelled)
        names = ekf.names
        rows = [LandmarkRow(str(a[i].id), names[i], a[i], errors[i]) for i in marked.tolist()]
        rows += [LandmarkRow(f"s{r.id}", f"scan {r.id}", r) for r in self._scan_landmarks]
        correlations = {
            name: correlation_coefficients(estimate.joint_covariance)
            for name, estimate in (("EKF", ekf), ("smoother", c.smoothed))
        }
        return replace(
            content,
            headline=result.headline,
            words=_WORDS[result.verdict],
            curves_file="consistency.png" if self.formats else "",
            sections=[heat_maps("Correlation coefficients", correlations), *content.sections],
            landmarks=rows,
            landmarks_note=landmarks_note(len(marked), len(a), "result.json", "the filter's"),
            settings=setting_lines(c.prepared.config, result.settings, c.prepared.ekf),
        )

    @property
    def formats(self) -> Collection[str]:
        """In which the pictures are asked for."""
        return self.found.prepared.config.report.figures

    def figures(self) -> Mapping[str, Figure]:
        """Return as pictures what the page draws in any case, where pictures are asked for."""
        if not self.formats:
            return {}
        from comparisons.report.figures.run import (
            consistency_figure,
            correlation_figure,
            map_figure,
        )

        return {
            "map": map_figure(self.found),
            "correlation": correlation_figure(self.found),
            "consistency": consistency_figure(self.found, self.panels),
        }

    def files(self) -> Mapping[str, Callable[[Path], object]]:
        """Return the filter's trace, where that is asked for."""
        if not self.found.prepared.config.report.trace:
            return {}
        from comparisons.audit.own_filter import write_run
        from comparisons.estimates.planar_trace import TRACE

        return {f"ekf/{TRACE}": lambda path: write_run(self.found.ekf, path)}


def _known_example(result: Result) -> list[tuple[str, str]]:
    """A line for a bundled log on which an EKF is known to be inconsistent, if this one is."""
    log = NAMED.get(str(result.config["log"]["source"]))
    if log is None or not log.inconsistent or not result.causes:
        return []
    return [("log", log.inconsistent)] if result.causes[0].gap == "linearisation" else []


def _facts(result: Result, landmarks: Sequence[BlockAgreement]) -> list[tuple[str, str]]:
    """What the verdict rests on, beside the lines of findings. landmarks: that both have."""
    gaps = result.agreement
    agreeing = sum(row.agrees for row in landmarks)
    return [
        ("Smoother's optimum", result.smoother.optimum),
        (
            "Last pose",
            f"{gaps.pose.difference_m:.3f} m apart, {gaps.pose.distance_sigma:.2g} sigma",
        ),
        (
            "Landmarks",
            f"{agreeing:,} of {len(landmarks):,} agree; "
            f"{gaps.landmark_difference_rms_m:.3f} m apart (RMS)"
            if landmarks
            else "none",
        ),
    ]


def run_map(c: Comparison, marked: Index) -> MapContent:
    """Both estimates and those of the extensions. marked: (m,) landmarks."""
    ekf, smoothed = c.ekf.estimate, c.smoothed
    ids = ekf.landmark_id[marked]
    blocks = [c.agreement.landmarks[i] for i in marked.tolist()]
    more = further_estimates(c)
    return MapContent(
        log=c.log,
        tracks=[
            estimate_track("smoother", SMOOTHER_COLOUR, smoothed, ids),
            estimate_track("EKF", EKF_COLOUR, ekf, ids, "5 3"),
            *(
                estimate_track(name, colour, estimate, ids, "2 2")
                for name, colour, estimate in more
            ),
        ],
        keys=ids.tolist(),
        labels=[
            f"landmark {ekf.names[i]}: {b.difference_m:.3f} m apart, {b.distance_sigma:.2g} sigma"
            for i, b in zip(marked.tolist(), blocks, strict=True)
        ],
        ratio=np.array([b.variance_ratio_least for b in blocks]),
        view=[
            place
            for one in (ekf, smoothed, *(estimate for _, _, estimate in more))
            for place in (one.pose[:, :2], one.landmark, one.pose_landmarks[:, :2])
        ],
        beneath=[
            associations(ekf, c.ekf.timeline.measurement_epoch, c.ekf.landmark_index),
            *all_landmarks("all landmarks", ekf.landmark, marked),
        ],
        above=[finding.layers for finding in c.findings.values()],
    )
