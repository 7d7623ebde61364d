"""The page's tables: figures, landmarks, associations that differ, the time of each stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from comparisons.extensions.dense_maps.result import high_level_text
from comparisons.extensions.own_matching.result import own_matching_rows
from comparisons.extensions.scan_landmarks.result import scan_slam_rows
from comparisons.pipeline.compare import Comparison
from comparisons.report.consistency_result import consistency_rows
from comparisons.report.models import AccuracyResult, LandmarkResult, Result
from ekf_reference.association import AMBIGUOUS, CANDIDATE, DYNAMIC, REJECTED

_MOST_ROWS = 200
_UNUSED = {
    REJECTED: "rejected",
    AMBIGUOUS: "ambiguous",
    CANDIDATE: "candidate",
    DYNAMIC: "dynamic",
}


def figures(result: Result) -> list[tuple[str, str]]:
    """What was found, as rows."""
    gaps, ekf, smoother = result.agreement, result.ekf, result.smoother
    rows = [
        ("records", ", ".join(f"{n:,} {name}" for name, n in result.log.records.items())),
        ("EKF", f"{ekf.filter}, {ekf.landmarks} landmarks, association {ekf.association}"),
        (
            "smoother",
            f"error {smoother.error:.2f}, chi-square {smoother.chi2:.0f} for {smoother.dof} "
            f"degrees of freedom, optimum {'proven' if smoother.proven else 'not proven'}",
        ),
    ]
    for name, sigma, covariance in (
        ("algebra gap", gaps.algebra_gap_sigma, gaps.algebra_gap_covariance),
        ("model gap", gaps.model_gap_sigma, gaps.model_gap_covariance),
        ("linearisation gap", gaps.linearisation_gap_sigma, gaps.linearisation_gap_covariance),
    ):
        rows.append((name, f"{_number(sigma)} sigma, {_number(covariance)} in covariance"))
    rows.append(("optimism", _number(gaps.optimism)))
    rows.append(("landmarks apart (RMS)", f"{gaps.landmark_difference_rms_m:.3f} m"))
    if result.scan_slam is not None:
        rows += scan_slam_rows(result.scan_slam)
    if result.own_matching is not None:
        rows += own_matching_rows(result.own_matching)
    rows += consistency_rows(result.consistency)
    if result.high_level is not None:
        rows.append(("high level landmarks", high_level_text(result.high_level)))
    if result.accuracy is not None:
        rows.append(("EKF's accuracy", _accuracy(result.accuracy.ekf)))
        rows.append(("smoother's accuracy", _accuracy(result.accuracy.smoother)))
    return rows


def landmarks(result: Result) -> str:
    """A table to sort; its rows' keys are those of the map's marks."""
    head = ("landmark", "apart [m]", "sigma", "least variance", "largest variance", "")
    rows = [
        (
            f'data-key="{key}" tabindex="0" class="{"" if row.agrees else "bad"}"',
            (
                name,
                f"{row.difference_m:.3f}",
                f"{row.distance_sigma:.2f}",
                _number(row.variance_ratio_least),
                _number(row.variance_ratio_largest),
                "agrees" if row.agrees else "disagrees",
            ),
        )
        for key, name, row in _rows(result)
    ]
    return (
        '<h2>Landmarks</h2><p class="note">A row finds its landmark on the map, and the other way '
        "round. Variances are the filter's over the smoother's.</p>"
        f"{_sortable('landmarks', head, rows)}"
    )


def _rows(result: Result) -> list[tuple[str, str, LandmarkResult]]:
    """Every landmark with its key on the map and its name."""
    points = [(str(row.id), str(row.id), row) for row in result.agreement.landmarks]
    slam = result.scan_slam
    scans = [] if slam is None else slam.landmarks
    return points + [(f"s{row.id}", f"scan {row.id}", row) for row in scans]


def association_differences(c: Comparison) -> str:
    """The sightings that filter and smoother give to different landmarks; empty if not asked."""
    own = c.own_association
    if own is None:
        return ""
    slot, ids = c.ekf.slot, c.ekf.estimate.landmark_id
    time_s = c.ekf.timeline.epoch_time_s[c.ekf.timeline.sighting_epoch]
    rows = []
    listed = zip(own.differing[:_MOST_ROWS].tolist(), own.cost.tolist(), strict=False)
    for row, cost in listed:
        theirs, counterpart = int(own.slot[row]), -1
        if theirs >= 0:
            counterpart = int(own.matched[theirs])
        meant = f" (the filter's {ids[counterpart]})" if counterpart >= 0 else ""
        used = slot[row] >= 0
        filters = str(ids[slot[row]]) if used else _UNUSED.get(int(slot[row]), "unused")
        key = f'data-key="{ids[slot[row]]}" tabindex="0"' if used else ""
        smoothers = f"{theirs}{meant}" if theirs >= 0 else "unused"
        misses = (_number(squared**0.5) for squared in cost)
        rows.append((key, (str(row), f"{time_s[row]:.3f}", filters, smoothers, *misses)))
    count, more = len(own.differing), len(own.differing) - len(rows)
    told = f"{count:,} of {len(own.slot):,} sightings differ"
    told += f"; the first {len(rows):,} are listed, {more:,} more are not." if more else "."
    head = (
        "sighting",
        "time [s]",
        "filter's landmark",
        "smoother's own",
        "misses the filter's [sigma]",
        "misses the smoother's [sigma]",
    )
    return (
        f'<h2>Associations that differ</h2><p class="note">{told}</p>'
        f"{_sortable('association', head, rows) if rows else ''}"
    )


def matching_differences(result: Result) -> str:
    """How the two matchers' alignments differ, by scan landmark; empty if not asked."""
    own = result.own_matching
    if own is None:
        return ""
    head = (
        "landmark",
        "scans",
        "sigma",
        "ahead [m]",
        "left [m]",
        "turn [deg]",
        "worst [s]",
        "its sigma",
        "",
    )
    rows = [
        (
            f'data-key="s{one.id}" tabindex="0" class="{"bad" if one.contradicts else ""}"',
            (
                f"scan {one.id}",
                str(one.common),
                _number(one.distance_sigma),
                f"{one.shift_m[0]:.3f}",
                f"{one.shift_m[1]:.3f}",
                f"{np.degrees(one.shift_rad):.2f}",
                f"{one.worst_time_s:.3f}",
                _number(one.worst_sigma),
                "contradicts" if one.contradicts else "agrees",
            ),
        )
        for one in own.landmarks
    ]
    return (
        f'<h2>Alignments of two matchers</h2><p class="note">The filter\'s minus those of '
        f"{escape(own.matcher)}, made from the smoother's own estimate, over the scans that both "
        "aligned a landmark with; the worst of these by its time. Sigmas are of the sum of both "
        "covariances; directions that a shape leaves open count next to nothing.</p>"
        f"{_sortable('matching', head, rows)}"
    )


def timing(seconds: Mapping[str, float]) -> str:
    """A bar per stage."""
    longest = max([*seconds.values(), 1e-9])
    rows = "".join(
        f'<tr><td>{escape(name)}</td><td class="number">{value:.2f} s</td><td class="wide">'
        f'<svg class="bar"><rect width="{100.0 * value / longest:.1f}%" height="100%"/></svg></td>'
        "</tr>"
        for name, value in seconds.items()
    )
    return f'<table id="timing"><tbody>{rows}</tbody></table>'


def _sortable(name: str, head: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    """Rows of an attribute text, ours, and cells, anybody's."""
    heads = "".join(f"<th><button>{escape(title)}</button></th>" for title in head)
    body = "".join(
        f"<tr {attributes}>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"
        for attributes, cells in rows
    )
    return (
        f'<div class="scroll"><table id="{name}" class="sortable"><thead><tr>{heads}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _accuracy(accuracy: AccuracyResult) -> str:
    shown = {k: v for k, v in accuracy.model_dump().items() if v is not None}
    return ", ".join(f"{name.replace('_', ' ')} {_number(v)}" for name, v in shown.items())


def _number(value: float | None) -> str:
    if value is None or not isinstance(value, int | float) or not np.isfinite(value):
        return "none"
    return f"{value:.3g}"
