"""Alignments of two matchers, on the page."""

from __future__ import annotations

from html import escape

import numpy as np

from comparisons.extensions.own_matching.check import OwnMatchingCheck
from comparisons.report.html.shell import number, sortable


def matching_differences(own: OwnMatchingCheck) -> str:
    """Return a table of how the two matchers' alignments differ, by scan landmark."""
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
                number(one.distance_sigma),
                f"{one.shift_m[0]:.3f}",
                f"{one.shift_m[1]:.3f}",
                f"{np.degrees(one.shift_rad):.2f}",
                f"{one.worst_time_s:.3f}",
                number(one.worst_sigma),
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
        f"{sortable('matching', head, rows)}"
    )
