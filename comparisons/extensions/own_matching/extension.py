"""The smoother a second time, with its own matcher of scan landmarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from comparisons.adapters.smoother_input import smoothed_estimate
from comparisons.checks.accuracy import accuracy_rows, assess
from comparisons.checks.check import Finding
from comparisons.extensions.interface import Extension
from comparisons.extensions.own_matching.check import (
    OwnMatchingCheck,
    check_own_matching,
    matching_cause,
)
from comparisons.extensions.own_matching.source import own_measurements
from comparisons.extensions.scan_landmarks.source import ScanSlamSource
from comparisons.figures import in_sigma
from comparisons.pipeline.gaps import Known
from comparisons.words import Row
from graphslam.smoother import smooth


class OwnMatching(Extension):
    """Sees how much the verdict owes to the filter's matcher, whose alignments S shares."""

    name = "own_matching"

    def find(self, known: Known) -> OwnMatchingFinding | None:
        """See the scan landmarks anew, solve, assess, and compare the alignments."""
        slam = known.setup.find(ScanSlamSource)
        if slam is None:
            return None
        with known.prepared.clock.stage("own matcher"):
            return OwnMatchingFinding(solve_with_own_matching(known, slam))


class OwnMatchingFinding(Finding):
    """S against S''. own: the check."""

    def __init__(self, own: OwnMatchingCheck) -> None:
        """Heard in the verdict when its optimum is verified."""
        self.own = own
        self.entries = {"own_matching": own}
        self.estimates = {"own-matcher": own.estimate}
        self.titles = {"own-matcher": "smoother, own matcher"}
        if not own.verified:
            self.remarks = [
                "the optimum of the smoother with its own matcher is not verified, so the "
                "verdict ignores it"
            ]
        elif not own.agrees:
            self.causes = [matching_cause(own)]

    def rows(self) -> Sequence[Row]:
        """Return how the alignments compare, and how good the smoother is with its own."""
        own = self.own
        group = "Smoother with its own matcher"
        shift = float(np.hypot(*own.shift_m))
        turn = f"{np.degrees(own.shift_rad):.2f} deg"
        rows = [
            Row(group, "matcher", own.matcher),
            Row(group, "alignments by its own matcher", f"{own.own:,}"),
            Row(group, "alignments by the filter's matcher", f"{own.filter:,}"),
            Row(group, "alignments by both", f"{own.common:,}"),
            Row(group, "difference of the alignments (rms)", in_sigma(own.distance_sigma)),
            Row(group, "common shift of the alignments", f"{shift:.3f} m"),
            Row(group, "common turn of the alignments", turn),
            Row(group, "common shift and turn of the alignments", in_sigma(own.shift_sigma)),
            *(
                Row(group, f"alignments by its own matcher: {reason}", f"{count:,}")
                for reason, count in own.reasons.items()
                if count
            ),
        ]
        for name, pair, path in (
            ("EKF", own.ekf, own.path_ekf_m),
            ("smoother", own.smoother, own.path_smoother_m),
        ):
            other = f"{name} and smoother with its own matcher"
            agrees = "yes" if pair.agrees else "no"
            far = f"{pair.outside} of {pair.landmarks}"
            rows += [
                Row(other, "maps agree", agrees, "yes", pair.agrees),
                Row(other, "scan landmarks beyond the 99 % region", far),
                Row(other, "difference of the paths (rms)", f"{path:.3f} m"),
            ]
        return [*rows, *accuracy_rows("the smoother with its own matcher", own.accuracy)]

    def sections(self) -> Sequence[str]:
        """Return the table of alignments by landmark."""
        from comparisons.extensions.own_matching.page import matching_differences

        return [matching_differences(self.own)]


def solve_with_own_matching(known: Known, slam: ScanSlamSource) -> OwnMatchingCheck:
    """Return S'' and how it compares with S.

    Its measurements take the place of the filter's, so that no scan counts twice.
    """
    prepared, run, gaps = known.prepared, known.ekf, known.gaps
    progress = prepared.stage_progress("own matcher")
    problem, found = own_measurements(prepared.log, run, slam.found.initialised, progress)
    result = smooth(problem, {}, options=gaps.result.options)
    ids = run.estimate.landmark_id
    estimate = smoothed_estimate(result, run.timeline.epoch_time_s, ids, "the EKF's")
    own = check_own_matching(
        (run.pose_landmarks, found.alignments),
        run.estimate,
        gaps.smoothed,
        estimate,
        result.optimality,
    )
    accuracy = assess(estimate, prepared.judged, labelled=False)
    return replace(own, accuracy=accuracy, reasons=dict(found.reasons))
