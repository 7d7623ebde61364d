"""The matching gap, in words: which alignments of two matchers differ, and by how much."""

from __future__ import annotations

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.checks.causes import Cause
from comparisons.extensions.own_matching.check import LandmarkMatching, OwnMatchingCheck

_NAMED = 3
"""So many landmarks are named."""


def matching(own: OwnMatchingCheck, run: EkfRun) -> Cause:
    """S against S''."""
    parts, hint = [], "look at sightings that only one of both made: loops, places that look alike"
    if own.shifted:
        x, y, turn = own.shift
        parts.append(
            f"all alignments of the filter are shifted by {x:.3f} m ahead, {y:.3f} m to the left "
            f"and {np.degrees(turn):.2f} degrees from the smoother's own "
            f"({np.sqrt(own.shift_squared / 3.0):.1f} sigma)"
        )
        hint = "look at the alignment: its heading's sign and zero, the scanner's mount"
    if own.contradicting:
        parts += [_apart_for(one, run) for one in own.contradicting[:_NAMED]]
        if len(own.contradicting) > _NAMED:
            parts.append(f"{len(own.contradicting) - _NAMED} more such landmarks")
        if not own.shifted:
            hint = (
                "look at the alignments of these landmarks: the template's axis, R, or another "
                "place that looks alike"
            )
    if not own.estimates_agree:
        pair, (theirs, ours, both) = own.smoother, own.sightings
        if own.landmarks and not (own.contradicting or own.shifted):
            parts.append(f"the farthest apart: {_apart_for(own.landmarks[0], run)}")
        parts.append(
            f"with its own matcher the smoother's last pose is {own.pose.difference_m:.2f} m "
            f"({own.pose.distance:.1f} sigma) elsewhere, its path {own.path_rms_m[1]:.2f} m (RMS), "
            f"{pair.outside} of {len(pair.distance_sigma)} scan landmarks lie beyond their 99 % "
            f"region; of {theirs:,} alignments of the filter and {ours:,} of the smoother {both:,} "
            "are of the same landmark and scan"
        )
    return Cause("matching", "; ".join(parts), hint)


def _apart_for(one: LandmarkMatching, run: EkfRun) -> str:
    """How two matchers differ on a landmark, and in which scan the most."""
    place, worst = np.hypot(*one.shift[:2]), np.hypot(*one.worst[:2])
    return (
        f"the filter's alignments of scan landmark {one.slot} are {place:.2f} m and "
        f"{np.degrees(one.shift[2]):.1f} degrees from the smoother's own "
        f"({np.sqrt(one.squared / 3.0):.1f} sigma over {one.common} scans; in the scan at "
        f"{run.estimate.time_s[one.worst_epoch]:.1f} s {worst:.2f} m and "
        f"{np.degrees(one.worst[2]):.1f} degrees, {np.sqrt(one.worst_squared / 3.0):.1f} sigma)"
    )
