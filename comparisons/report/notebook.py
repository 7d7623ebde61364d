"""Results as HTML for a notebook: small, without script, in the notebook's own colours.

Nothing has an id, and the style names only classes of ours, so that any number of results stands in
one notebook. Texts of a log or a user are escaped.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import singledispatch
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.causes import Cause
from comparisons.checks.grade import match_map
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log
from comparisons.pipeline.check import ExternalCheck
from comparisons.pipeline.compare import Comparison
from comparisons.pipeline.solve import Solution
from comparisons.report.check import build_check_result, check_map
from comparisons.report.html.drawing import Drawing
from comparisons.report.html.map import Track, farthest
from comparisons.report.html.shell import number, table
from comparisons.report.ladder import Step, check_ladder, ladder
from comparisons.report.marks import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, ellipses
from comparisons.report.result import build_result
from comparisons.report.run import run_map
from comparisons.words import cause_name

if TYPE_CHECKING:
    from comparisons.pipeline.dense_map import DenseMapping
    from comparisons.pipeline.odometry import FrontEnd

MOST_POINTS = 500
"""Points of a path."""
MOST_DOTS = 1500
"""Points of a cloud, and landmarks without an ellipse."""
MOST_ELLIPSES = 240
"""Ellipses of all estimates together."""
_KNOWN = "#8c8c8c"
_STYLE = (
    "<style>.slamcheck-view{max-width:50rem}.slamcheck-view h4{margin:.2em 0}"
    ".slamcheck-view svg{display:block;width:100%;max-height:26rem;border:1px solid #8888;"
    "margin:.5em 0 .2em}.slamcheck-view polyline,.slamcheck-view polygon,.slamcheck-view path"
    "{fill:none;stroke-width:1.4;vector-effect:non-scaling-stroke}.slamcheck-view .dots"
    "{stroke-width:3;stroke-linecap:round}.slamcheck-view circle{stroke:none}"
    ".slamcheck-view b.agree,.slamcheck-view b.verified{color:#2e8b57}"
    ".slamcheck-view b.disagree,.slamcheck-view .bad{color:#e0533d}"
    ".slamcheck-view b.unverified{color:#c98a1b}.slamcheck-view .swatch{display:inline-block;"
    "width:.8em;height:.8em;border-radius:50%;margin:0 .3em 0 .9em}"
    ".slamcheck-view .hint{opacity:.8}.slamcheck-view table{margin:.4em 0}"
    ".slamcheck-view th,.slamcheck-view td{padding:.15em .6em;text-align:left}</style>"
)


@singledispatch
def html(result: object) -> str:
    """Return what a notebook shows of a result."""
    raise TypeError(f"a {type(result).__name__} is shown by nobody")


@html.register
def comparison_html(c: Comparison) -> str:
    """Return verdict, causes, gaps and map of a run."""
    count = len(c.agreement.landmarks)
    marked = farthest(np.array([block.distance_sigma for block in c.agreement.landmarks]))
    content = run_map(c, marked)
    return view(
        c.log.name,
        c.verdict.outcome,
        c.verdict.summary,
        _causes(c.verdict.causes),
        ladder_html(ladder(build_result(c))),
        _map(c.log, content.tracks, content.view),
        f"{count:,} landmarks compared; 3 sigma ellipses." if count else "",
    )


@html.register
def check_html(c: ExternalCheck) -> str:
    """Return grade, causes, gaps and map of an external estimate's check."""
    by = c.grade.by
    grade = f"grade {c.grade.value or 'none'} (required: {c.grade.required})"
    nearest = f", nearest to {by.reference.name}: {number(by.sigma)} sigma" if by else ""
    labelled = c.solution.prepared.labelled
    content, _ = check_map(c, *match_map(c.given, c.optimum, labelled=labelled))
    return view(
        c.solution.log.name,
        c.outcome,
        f"{c.outcome}, {grade}{nearest}",
        _causes(c.causes),
        ladder_html(check_ladder(build_check_result(c))),
        _map(c.solution.log, content.tracks, content.view),
    )


@html.register
def solution_html(s: Solution) -> str:
    """Return the smoother's evidence and map."""
    word = "verified" if s.verified else "unverified"
    optimality, result = s.result.optimality, s.result
    lacks = f": {s.lacks[0]}" if s.lacks else ""
    test = optimality.chi_square
    rows = [
        ("error (half the chi-square)", f"{result.error:,.2f}"),
        ("chi-square", f"{test.chi2:,.1f} for {test.dof:,} degrees of freedom, {test.reading}"),
        ("starts", f"{len(result.starts)}; the best took {result.iterations} iterations"),
        ("map", f"{len(s.estimate.landmark):,} landmarks, {len(s.estimate.time_s):,} poses"),
    ]
    track = _track("smoother", SMOOTHER_COLOUR, s.estimate)
    drawn = _map(s.log, [track], [s.estimate.pose[:, :2], s.estimate.landmark])
    return view(s.log.name, word, f"{word}{lacks}", table(("", ""), rows), drawn)


@html.register
def log_html(log: Log) -> str:
    """Return a log's streams, and where it went as far as the log itself says."""
    rows = [(name, f"{count:,}") for name, count in log.records.items()]
    drawn = _map(log, (), ()) if _known(log) else ""
    reported = f"{log.format}, {log.duration_s:,.1f} s"
    return view(log.name, "", reported, table(("stream", "records"), rows), drawn)


@html.register
def estimate_html(estimate: Estimate) -> str:
    """Return an estimate's counts and map."""
    count = len(estimate.landmark) + len(estimate.pose_landmarks)
    reported = f"{len(estimate.time_s):,} {estimate.information} poses, {count:,} landmarks"
    track = _track("estimate", SMOOTHER_COLOUR, estimate)
    drawn = _map(None, [track], [estimate.pose[:, :2], estimate.landmark])
    return view("Estimate", "", reported, drawn)


def front_end_html(f: FrontEnd) -> str:
    """Return the scan front end's errors and map."""
    named = (("wheels", f.accuracy_wheels), ("scan odometry", f.accuracy_odometry),
             ("scan graph", f.accuracy_graph))  # fmt: skip
    rows = [
        (name, number(a.ate_m), number(a.rpe_10m_m), number(a.gps_median_m))
        for name, a in named
        if a is not None
    ]
    head = ("estimate", "ATE [m]", "RPE over 10 m [m]", "median distance from positions [m]")
    tracks = [
        Track(name="scan odometry", colour=EKF_COLOUR, dashes="5 3", time_s=f.time_s,
              pose=f.odometry),
        _track("scan graph", SMOOTHER_COLOUR, f.estimate),
    ]  # fmt: skip
    loops = len(f.graph.problem.loop_closures.first)
    reported = f"{len(f.motion.row):,} scans, {loops:,} loop closures"
    points = f.map_points()[:, :2]
    drawn = _map(f.log, tracks, [f.estimate.pose[:, :2], points], ("scans", SCANS_COLOUR, points))
    return view(f.log.name, "", reported, table(head, rows) if rows else "", drawn)


def dense_map_html(m: DenseMapping) -> str:
    """Return a dense map's layers, their errors, and what they hold."""
    rows = []
    for name, samples in m.layers.items():
        found = m.errors.get(name)
        errors = (number(found.median_m), number(found.p95_m)) if found else ("none", "none")
        rows.append((name, f"{len(samples.point):,}", *errors))
    head = ("layer", "samples", "median error [m]", "95 % of errors below [m]")
    name, samples = next(iter(m.layers.items()))
    points = samples.point[samples.occupancy > _OCCUPIED]
    track = _track("EKF", EKF_COLOUR, m.ekf.estimate)
    seen = [m.ekf.estimate.pose[:, :2], m.ekf.estimate.landmark, points]
    drawn = _map(m.log, [track], seen, (f"{name}: occupied", SCANS_COLOUR, points))
    reported = f"{len(m.placed.triangle):,} regions between {len(m.dense.landmark):,} landmarks"
    return view(m.log.name, "", reported, table(head, rows), drawn)


_OCCUPIED = 0.8


def ladder_html(steps: Sequence[Step]) -> str:
    """Return the gaps between neighbouring estimates as a table; nothing without any."""
    rows = [
        (
            f"{step.above} → {step.below}",
            step.gap,
            number(step.sigma) if step.sigma is not None else step.mean,
            "" if step.covariance is None else number(step.covariance),
            "" if step.error_m is None else f"{step.error_m:.3g}",
            step.state,
        )
        for step in steps
    ]
    head = ("between", "gap", "means [sigma]", "covariances", "error [m]", "outcome")
    bad = [k for k, step in enumerate(steps) if step.fails]
    return table(head, rows, bad) if rows else ""


def view(title: str, outcome: str, reported: str, *parts: str) -> str:
    """Return a result's HTML.

    title, reported: any text. outcome: `agree`, `disagree`, `verified`, `unverified` or empty.
    parts: HTML of ours.
    """
    return (
        f'<div class="slamcheck-view">{_STYLE}<h4>{escape(title)}</h4>'
        f'<div><b class="{outcome}">{escape(reported)}</b></div>{"".join(parts)}</div>'
    )


def _causes(causes: Iterable[Cause]) -> str:
    rows = "".join(
        f'<li><b class="bad">{escape(cause_name(c.gap))}</b>: {escape(c.evidence)}'
        f'<div class="hint">{escape(c.hint)}</div></li>'
        for c in causes
    )
    return f"<ul>{rows}</ul>" if rows else ""


def _track(name: str, colour: str, estimate: Estimate) -> Track:
    """An estimate with all its landmarks, and their covariances where it has them."""
    covariance = estimate.landmark_covariances()
    known = len(covariance) == len(estimate.landmark)
    return Track(
        name=name,
        colour=colour,
        time_s=estimate.time_s,
        pose=estimate.pose,
        landmark=estimate.landmark,
        landmark_covariance=covariance if known else None,
    )


def _some(count: int, most: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """At most so many rows, evenly spread, the first and the last among them."""
    return np.round(np.linspace(0, count - 1, min(count, most))).astype(np.intp)


def _map(
    log: Log | None,
    tracks: Sequence[Track],
    seen: Sequence[Array],
    cloud: tuple[str, str, Array] | None = None,
) -> str:
    """Tracks and what is known as an SVG with a legend; the second track lies on top.

    seen: points (N, 2) that must be on it. cloud: name, colour and points (N, 2) beneath.
    """
    known = [] if log is None else _known(log)
    drawing = Drawing.of(*seen, *(points for _, points, _ in known))
    legend = []
    if cloud is not None:
        name, colour, points = cloud
        drawing.dots(name, colour, points[_some(len(points), MOST_DOTS)])
        legend.append((name, colour))
    for name, points, dotted in known:
        if dotted:
            drawing.dots(name, _KNOWN, points[_some(len(points), MOST_DOTS)])
        else:
            drawing.path(name, _KNOWN, points[_some(len(points), MOST_POINTS)])
        legend.append((name, _KNOWN))
    for track in (*tracks[:1], *tracks[2:], *tracks[1:2]):
        _draw(drawing, track, MOST_ELLIPSES // len(tracks))
        legend.append((track.name, track.colour))
    width, height = (drawing.bounds[2:] - drawing.bounds[:2]).tolist()
    scale = 1000.0 / max(width, height)
    swatches = "".join(
        f'<span class="swatch" style="background:{colour}"></span>{escape(name)}'
        for name, colour in legend
    )
    return (
        f'<svg viewBox="0 0 {scale * width:.1f} {scale * height:.1f}" role="img" '
        f'aria-label="map, {width:,.0f} m by {height:,.0f} m">{"".join(drawing.layers)}</svg>'
        f"<div>{swatches} &nbsp;{width:,.0f} m by {height:,.0f} m, north is up</div>"
    )


def _known(log: Log) -> list[tuple[str, Array, bool]]:
    """Name and points (N, 2) of what the log knows without its sensors, and whether as dots."""
    found = []
    if log.truth.poses is not None:
        found.append(("truth", log.truth.poses.pose[:, :2], False))
    if log.truth.landmarks is not None:
        found.append(("true landmarks", log.truth.landmarks.position_m, True))
    if log.positions is not None:
        found.append(("positions", log.positions.position_m, True))
    return found


def _draw(drawing: Drawing, track: Track, most: int) -> None:
    """A path, and landmarks: at most so many with ellipses, evenly spread, all others as dots."""
    pose = track.pose[np.isfinite(track.pose).all(axis=1), :2]
    drawing.path(track.name, track.colour, pose[_some(len(pose), MOST_POINTS)], track.dashes)
    if track.landmark is None or not len(track.landmark):
        return
    shown = _some(len(track.landmark), MOST_DOTS)
    drawing.dots(f"{track.name} landmarks", track.colour, track.landmark[shown])
    if track.landmark_covariance is not None:
        rows = _some(len(track.landmark), most)
        outline = ellipses(track.landmark[rows], track.landmark_covariance[rows], 3.0, 24)
        labels = [track.name] * len(rows)
        drawing.outlines(f"{track.name} landmarks", track.colour, outline, labels)
