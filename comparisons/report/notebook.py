"""Results in a notebook: the page that their folder has, in a frame of its own.

Nothing of the page reaches the notebook, so that any number of results stands in one. Texts of a
log or a user are escaped.
"""

from __future__ import annotations

from dataclasses import replace
from functools import singledispatch
from html import escape

from comparisons.checks.log import LogFigures
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log
from comparisons.report.html.map import MapContent, estimate_map, known_points
from comparisons.report.html.page import PageContent, page
from comparisons.report.job import report_of
from comparisons.report.marks import SMOOTHER_COLOUR


def html(result: object) -> str:
    """Return what a notebook shows of a result."""
    return framed(page(replace(content_of(result), job="")))  # no folder is beside it


def framed(document: str) -> str:
    """Return a page in a frame that reaches nothing outside of it."""
    return (
        f'<iframe sandbox="allow-scripts" srcdoc="{escape(document)}" '
        'style="width:100%;height:42rem;border:1px solid #8888"></iframe>'
    )


@singledispatch
def content_of(result: object) -> PageContent:
    """Return what stands on a result's page."""
    return report_of(result).page()


@content_of.register
def _(log: Log) -> PageContent:
    """Where it went stands on the map as far as the log itself says."""
    known = known_points(log)
    return PageContent(
        name=log.name,
        headline=f"{log.format}, {log.duration_s:,.1f} s",
        map=MapContent(log=log, tracks=(), view=known) if known else None,
        rows=LogFigures.of(log).rows(),
    )


@content_of.register
def _(estimate: Estimate) -> PageContent:
    count = len(estimate.landmark) + len(estimate.pose_landmarks)
    return PageContent(
        name="Estimate",
        headline=f"{len(estimate.time_s):,} {estimate.information} poses, {count:,} landmarks",
        map=estimate_map(None, "estimate", SMOOTHER_COLOUR, estimate),
    )
