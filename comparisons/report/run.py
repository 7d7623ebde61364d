"""The folder that a run leaves: result.json, the page, all estimates, and figures on request."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from comparisons.arrays import Index
from comparisons.checks.accuracy import landmark_errors
from comparisons.checks.agreement import BlockAgreement
from comparisons.pipeline.compare import Comparison
from comparisons.report.folder import JobFolder
from comparisons.report.html.heat_map import heat_maps
from comparisons.report.html.map import (
    MapContent,
    all_landmarks,
    associations,
    estimate_track,
    farthest,
)
from comparisons.report.html.page import PageContent, write_page
from comparisons.report.html.tables import LandmarkRow, landmarks_note
from comparisons.report.ladder import ladder
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR
from comparisons.report.models import Result
from comparisons.report.panels import (
    ConsistencyPanels,
    consistency_panels,
    further_estimates,
)
from comparisons.report.result import finding_lines, run_rows
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


def run_folder(comparison: Comparison, result: Result) -> JobFolder:
    """Return what is to be written."""
    c, config, panels = comparison, comparison.prepared.config, consistency_panels(comparison)
    found = c.findings.values()
    own = {name: figure for one in found for name, figure in one.figures().items()}

    def write(path: Path) -> None:
        pictures = [path.with_name(f"{name}.png") for name in own]
        write_page(run_page(comparison, panels, result, pictures), path)

    files: dict[str, Callable[[Path], object]] = {"report.html": write}
    if config.report.trace:
        from comparisons.audit.run_trace import write_run
        from comparisons.estimates.trace_file import TRACE

        files[f"ekf/{TRACE}"] = lambda path: write_run(comparison.ekf, path)
    return JobFolder(
        name="result",
        result=result,
        config=config,
        estimates={
            "ekf": c.ekf.estimate,
            "smoother": c.smoothed,
            **{name: estimate for one in found for name, estimate in one.estimates.items()},
        },
        figures={**(_figures(comparison, panels) if config.report.figures else {}), **own},
        files=files,
    )


def _figures(comparison: Comparison, panels: ConsistencyPanels) -> dict[str, Figure]:
    """Return as figures what the page draws in any case, by name."""
    from comparisons.report.consistency_figure import consistency_figure
    from comparisons.report.figures.run import correlation_figure, map_figure

    return {
        "map": map_figure(comparison),
        "correlation": correlation_figure(comparison),
        "consistency": consistency_figure(comparison, panels),
    }


def run_page(
    comparison: Comparison, panels: ConsistencyPanels, result: Result, pictures: Sequence[Path]
) -> PageContent:
    """Return what stands on the page. pictures: files of those that have been drawn."""
    c, a = comparison, result.agreement.landmarks
    ekf, found = c.ekf.estimate, c.findings.values()
    marked = farthest(np.array([block.distance_sigma for block in c.agreement.landmarks]))
    labelled = c.prepared.labelled
    errors = landmark_errors(ekf.landmark_id, ekf.landmark, c.log, labelled=labelled)
    names = ekf.names
    rows = [LandmarkRow(str(a[i].id), names[i], a[i], errors[i]) for i in marked.tolist()]
    scan = [row for one in found for row in one.landmarks()]
    rows += [LandmarkRow(f"s{row.id}", f"scan {row.id}", row) for row in scan]
    inconsistent = "; ".join(result.inconsistent or ())
    qualified = result.verdict == "agree" and result.qualifiers
    return PageContent(
        job="run",
        name=result.log.name,
        headline=result.headline,
        colour="unverified" if qualified else result.verdict,
        words=_WORDS[result.verdict],
        facts=[
            *_facts(result, [*a, *scan]),
            *(
                (name[:1].upper() + name[1:], words)
                for name, words in finding_lines(c)
                if not (inconsistent and name == "consistency")  # a note says it
            ),
        ],
        about=f"{result.log.format}, {result.log.duration_s:,.0f} s",
        notes=[f"The filter is inconsistent: {inconsistent}."] if inconsistent else (),
        causes=result.causes,
        remarks=result.remarks,
        steps=ladder(result),
        map=run_map(comparison, marked),
        reported=panels.reported,
        panels=panels.every,
        curves_file="consistency.png" if c.prepared.config.report.figures else "",
        rows=run_rows(comparison, result),
        pictures=pictures,
        sections=[
            heat_maps(
                "Correlation coefficients",
                {
                    name: correlation_coefficients(estimate.joint_covariance)
                    for name, estimate in (("EKF", ekf), ("smoother", c.smoothed))
                },
            ),
            *(section for one in found for section in one.sections()),
        ],
        landmarks=rows,
        landmarks_note=landmarks_note(len(marked), len(a), "result.json", "the filter's"),
        settings=setting_lines(c.prepared.config, result.settings, c.prepared.ekf),
        seconds=result.seconds,
        cpu_s=result.cpu_s or {},
        versions=result.versions,
    )


def _facts(result: Result, landmarks: Sequence[BlockAgreement]) -> list[tuple[str, str]]:
    """What the verdict rests on, beside the lines of findings. landmarks: that both have."""
    gaps, smoother = result.agreement, result.smoother
    agreeing = sum(row.agrees for row in landmarks)
    optimum = "verified" if smoother.verified else f"not verified: {smoother.lacks}"
    if smoother.dof:
        optimum += f"; chi-square {smoother.chi2:,.0f} for {smoother.dof:,} degrees of freedom"
    return [
        ("Smoother's optimum", optimum),
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
            *(estimate_track(name, colour, one, ids, "2 2") for name, colour, one in more),
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
        above=[one.layers for one in c.findings.values()],
    )
