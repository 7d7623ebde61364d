"""What the pages of several jobs have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from comparisons.config import JobConfig
from comparisons.report.html.map import MapContent
from comparisons.report.html.page import PageContent, page_of
from comparisons.report.marks import Panel
from comparisons.report.models import JobResult
from comparisons.report.panels import known_panels
from comparisons.report.settings import SettingLine, setting_lines
from comparisons.report.terminal import Summary

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


def job_page(
    result: JobResult,
    summary: Summary,
    job: str,
    drawn: MapContent,
    curves: tuple[str, Sequence[Panel]],
    settings: Sequence[SettingLine],
) -> PageContent:
    """Return the page of a job on a log: what it prints, a map, curves, settings and times.

    curves: what they show, in words, and their panels.
    """
    reported, panels = curves
    return replace(
        page_of(summary, result.log.name),
        job=job,
        about=result.log.words,
        map=drawn,
        reported=reported,
        panels=panels,
        settings=settings,
        seconds=result.seconds,
        cpu_s=result.cpu_s or {},
        versions=result.versions,
    )


def known_page(
    result: JobResult,
    summary: Summary,
    job: str,
    drawn: MapContent,
    config: JobConfig,
    known: Known,
) -> PageContent:
    """Return the page of a job with the curves of what it knows."""
    settings = setting_lines(config, result.settings)
    return job_page(result, summary, job, drawn, known_panels(known), settings)
