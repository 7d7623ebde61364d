"""What `slamcheck run` reports: result.json, what is printed, and its folder with a page."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from comparisons.arrays import Index
from comparisons.checks.accuracy import landmark_errors
from comparisons.checks.agreement import BlockAgreement
from comparisons.jobs.run import Comparison
from comparisons.logs.bundled import NAMED
from comparisons.pipeline.clock import Clock
from comparisons.report.folder import JobFolder
from comparisons.report.html.heat_map import heat_maps
from comparisons.report.html.map import (
    MapContent,
    all_landmarks,
    associations,
    estimate_track,
    farthest,
)
from comparisons.report.html.page import PageContent, facts_of, write_page
from comparisons.report.html.tables import LandmarkRow, landmarks_note
from comparisons.report.job_report import JobReport, job_entries
from comparisons.report.ladder import LadderStep, ladder
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR
from comparisons.report.models import SCHEMA, Result
from comparisons.report.panels import ConsistencyPanels, consistency_panels, further_estimates
from comparisons.report.sections import job_page
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

    @staticmethod
    def build(comparison: Comparison, read: Clock | None = None) -> Result:
        """Return the findings of a run, read being the time that reading the log took."""
        verdict = comparison.verdict
        return Result(
            schema_version=SCHEMA,
            verdict=verdict.outcome,
            summary=verdict.summary,
            qualifiers=list(verdict.qualifiers),
            inconsistent=None if verdict.inconsistent is None else list(verdict.inconsistent),
            failed_on=list(verdict.failed_on),
            causes=verdict.causes,
            remarks=list(verdict.remarks),
            **job_entries(comparison.known, Result, read),
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

    def page(self, pictures: Sequence[Path] = ()) -> PageContent:
        """Return what stands on the page. pictures: files of those that have been drawn."""
        result, panels = self.result, self.panels
        c, a = self.found, result.agreement.landmarks
        ekf, view = c.ekf.estimate, c.findings.values()
        marked = farthest(np.array([block.distance_sigma for block in c.agreement.landmarks]))
        labelled = c.prepared.labelled
        errors = landmark_errors(ekf.landmark_id, ekf.landmark, c.log, labelled=labelled)
        names = ekf.names
        rows = [LandmarkRow(str(a[i].id), names[i], a[i], errors[i]) for i in marked.tolist()]
        scan = [row for finding in view for row in finding.landmarks()]
        rows += [LandmarkRow(f"s{row.id}", f"scan {row.id}", row) for row in scan]
        inconsistent = "; ".join(result.inconsistent or ())
        curves = panels.reported, panels.every
        settings = setting_lines(c.prepared.config, result.settings, c.prepared.ekf)
        return replace(
            job_page(result, self.summary(), "run", run_map(c, marked), curves, settings),
            headline=result.headline,
            words=_WORDS[result.verdict],
            facts=[
                *facts_of(self.lines),
                *_facts(result, [*a, *scan]),
                *facts_of(c.known.lines, leave={"agreement", *_noted(inconsistent)}),
            ],
            notes=[f"The filter is inconsistent: {inconsistent}."] if inconsistent else (),
            curves_file="consistency.png" if c.prepared.config.report.figures else "",
            pictures=pictures,
            sections=[
                heat_maps(
                    "Correlation coefficients",
                    {
                        name: correlation_coefficients(estimate.joint_covariance)
                        for name, estimate in (("EKF", ekf), ("smoother", c.smoothed))
                    },
                ),
                *(section for finding in view for section in finding.sections()),
            ],
            landmarks=rows,
            landmarks_note=landmarks_note(len(marked), len(a), "result.json", "the filter's"),
        )

    def folder(self) -> JobFolder:
        """Return what is to be written."""
        c, config = self.found, self.found.prepared.config
        view = c.findings.values()
        own = {name: figure for finding in view for name, figure in finding.figures().items()}

        def write(path: Path) -> None:
            pictures = [path.with_name(f"{name}.png") for name in own]
            write_page(self.page(pictures), path)

        files: dict[str, Callable[[Path], object]] = {"report.html": write}
        if config.report.trace:
            from comparisons.audit.run_trace import write_run
            from comparisons.estimates.trace_file import TRACE

            files[f"ekf/{TRACE}"] = lambda path: write_run(c.ekf, path)
        return JobFolder(
            name="result",
            result=self.result,
            config=config,
            estimates={
                "ekf": c.ekf.estimate,
                "smoother": c.smoothed,
                **{
                    name: estimate
                    for finding in view
                    for name, estimate in finding.estimates.items()
                },
            },
            formats=config.report.figures,
            figures={**(_figures(c, self.panels) if config.report.figures else {}), **own},
            files=files,
        )


def _figures(comparison: Comparison, panels: ConsistencyPanels) -> dict[str, Figure]:
    """Return as figures what the page draws in any case, by name."""
    from comparisons.report.figures.run import consistency_figure, correlation_figure, map_figure

    return {
        "map": map_figure(comparison),
        "correlation": correlation_figure(comparison),
        "consistency": consistency_figure(comparison, panels),
    }


def _noted(inconsistent: str) -> Collection[str]:
    """The line that a note says in full, where there is one."""
    return ("consistency",) if inconsistent else ()


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
