"""Associations that differ, on the page: lines on the map, and a table."""

from __future__ import annotations

from comparisons.adapters.ekf_run import EkfRun
from comparisons.extensions.own_association.check import OwnAssociationCheck
from comparisons.report.html.drawing import MOST_LINES, Drawing, association_lines
from comparisons.report.html.shell import number, sortable
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR
from ekf_reference.core.measurements import AMBIGUOUS, CANDIDATE, DYNAMIC, REJECTED

_MOST_ROWS = 200
_UNUSED = {
    REJECTED: "rejected",
    AMBIGUOUS: "ambiguous",
    CANDIDATE: "candidate",
    DYNAMIC: "dynamic",
}


def differing_lines(drawing: Drawing, own: OwnAssociationCheck, run: EkfRun) -> None:
    """Add lines from poses to the landmarks that filter and smoother assigned measurements to."""
    row, epoch = own.differing[:MOST_LINES], run.timeline.measurement_epoch
    for name, colour, estimate, landmark_indices in (
        ("associations that differ: EKF", EKF_COLOUR, run.estimate, run.landmark_index),
        ("associations that differ: smoother", SMOOTHER_COLOUR, own.estimate, own.landmark_index),
    ):
        used = row[landmark_indices[row] >= 0]
        association_lines(drawing, (name, colour), estimate, epoch[used], landmark_indices[used])


def association_differences(own: OwnAssociationCheck, run: EkfRun) -> str:
    """Return a table of the measurements that filter and smoother give to different landmarks."""
    landmark_index, ids = run.landmark_index, run.estimate.landmark_id
    time_s = run.timeline.epoch_time_s[run.timeline.measurement_epoch]
    rows = []
    listed = zip(own.differing[:_MOST_ROWS].tolist(), own.cost.tolist(), strict=False)
    for row, cost in listed:
        theirs, counterpart = int(own.landmark_index[row]), -1
        if theirs >= 0:
            counterpart = int(own.matched[theirs])
        meant = f" (the filter's {ids[counterpart]})" if counterpart >= 0 else ""
        used = landmark_index[row] >= 0
        filters = (
            str(ids[landmark_index[row]])
            if used
            else _UNUSED.get(int(landmark_index[row]), "unused")
        )
        key = f'data-key="{ids[landmark_index[row]]}" tabindex="0"' if used else ""
        smoothers = f"{theirs}{meant}" if theirs >= 0 else "unused"
        misses = (number(squared**0.5) for squared in cost)
        rows.append((key, (str(row), f"{time_s[row]:.3f}", filters, smoothers, *misses)))
    count, more = len(own.differing), len(own.differing) - len(rows)
    reported = f"{count:,} of {len(own.landmark_index):,} measurements differ"
    reported += f"; the first {len(rows):,} are listed, {more:,} more are not." if more else "."
    head = (
        "measurement",
        "time [s]",
        "filter's landmark",
        "smoother's own",
        "misses the filter's [sigma]",
        "misses the smoother's [sigma]",
    )
    return (
        f'<h2>Associations that differ</h2><p class="note">{reported}</p>'
        f"{sortable('association', head, rows) if rows else ''}"
    )
