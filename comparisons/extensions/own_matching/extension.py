"""The smoother a second time, with its own matcher of scan landmarks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from comparisons.adapters.beam_noise import sensor_of
from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.scan_source import CloudsAt, ScanSource
from comparisons.adapters.smoother_input import build_problem, smoothed_estimate
from comparisons.checks.accuracy import accuracy_rows, assess
from comparisons.checks.finding import Finding
from comparisons.extensions.own_matching.check import (
    OwnMatchingCheck,
    check_own_matching,
    matching_cause,
)
from comparisons.extensions.scan_landmarks.source import ScanSlamSource
from comparisons.figures import in_sigma, rows_of
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.stamps import resolved
from comparisons.pipeline.extension import Extension
from comparisons.pipeline.known import Known
from comparisons.report.html.shell import number, sortable
from comparisons.words import Explanation, Row
from ekf_reference.scan_landmarks.templates import Template as FiltersTemplate
from graphslam.problem import SlamProblem
from graphslam.scan import planar
from graphslam.scan.open3d_matchers import GeneralisedMatcher
from graphslam.scan.template_matchers import Template, TemplateMatchers
from graphslam.scan.template_measurements import (
    TemplateMeasurements,
    TemplateOptions,
    measure_templates,
)
from graphslam.smoother import smooth


class OwnMatching(Extension):
    """Does the verdict hold with another matcher of scans?

    Sees how much the verdict owes to the filter's matcher, whose alignments S shares.
    """

    name = "own_matching"
    needs = "scan landmarks"
    errs = "not measured"
    explains: ClassVar = {
        "matching": Explanation(
            "Two scan matchers disagree",
            "The smoother aligned the scans with a matcher of its own, and its optimum differs "
            "from the filter's. At least one of the two matchers returns wrong alignments.",
            "Check the alignments of the scan landmarks that the evidence names: the axes of the "
            "template, the covariance R, and places that look alike.",
        )
    }
    figures = (("own_matching", OwnMatchingCheck),)

    def find(self, known: Known) -> OwnMatchingFinding | None:
        """See the scan landmarks anew, solve, assess, and compare the alignments."""
        slam = known.setup.find(ScanSlamSource)
        if slam is None:
            return None
        with known.prepared.clock.stage("own matcher"):
            return OwnMatchingFinding(solve_with_own_matching(known, slam))


class OwnMatchingFinding(Finding):
    """S against S''. own: the check."""

    def __init__(self, check: OwnMatchingCheck) -> None:
        """Heard in the verdict when its optimum is verified."""
        self.own = check
        self.entries = {"own_matching": check}
        self.estimates = {"own-matcher": check.estimate}
        self.titles = {"own-matcher": "smoother, own matcher"}
        if not check.verified:
            self.remarks = [
                "the optimum of the smoother with its own matcher is not verified, so the "
                "verdict ignores it"
            ]
        elif not check.agrees:
            self.causes = [matching_cause(check)]

    def rows(self) -> Sequence[Row]:
        """Return how the alignments compare, and how good the smoother is with its own."""
        check = self.own
        group = "Smoother with its own matcher"
        shift = float(np.hypot(*check.shift_m))
        turn = f"{np.degrees(check.shift_rad):.2f} deg"
        rows = [
            *rows_of(group, check, ["matcher", "own", "filter", "common"]),
            Row(group, "difference of the alignments (rms)", in_sigma(check.distance_sigma)),
            Row(group, "common shift of the alignments", f"{shift:.3f} m"),
            Row(group, "common turn of the alignments", turn),
            Row(group, "common shift and turn of the alignments", in_sigma(check.shift_sigma)),
            *(
                Row(group, f"alignments by its own matcher: {reason}", f"{count:,}")
                for reason, count in check.reasons.items()
                if count
            ),
        ]
        for name, pair, path in (
            ("EKF", check.ekf, check.path_ekf_m),
            ("smoother", check.smoother, check.path_smoother_m),
        ):
            other = f"{name} and smoother with its own matcher"
            agrees = "yes" if pair.agrees else "no"
            far = f"{pair.outside} of {pair.landmarks}"
            rows += [
                Row(other, "maps agree", agrees, "yes", pair.agrees),
                Row(other, "scan landmarks beyond the 99 % region", far),
                Row(other, "difference of the paths (rms)", f"{path:.3f} m"),
            ]
        return [*rows, *accuracy_rows("the smoother with its own matcher", check.accuracy)]

    def sections(self) -> Sequence[str]:
        """Return the table of alignments by landmark."""
        return [matching_differences(self.own)]


def solve_with_own_matching(known: Known, slam: ScanSlamSource) -> OwnMatchingCheck:
    """Return S'' and how it compares with S.

    Its measurements take the place of the filter's, so that no scan counts twice.
    """
    prepared, run, gaps = known.prepared, known.ekf, known.gaps
    progress = prepared.stage_progress("own matcher")
    problem, measurements = own_measurements(prepared.log, run, slam.found.initialised, progress)
    result = smooth(problem, {}, options=gaps.result.options)
    ids = run.estimate.landmark_id
    estimate = smoothed_estimate(result, run.timeline.epoch_time_s, ids, "the EKF's")
    check = check_own_matching(
        (run.pose_landmarks, measurements.alignments),
        run.estimate,
        gaps.smoothed,
        estimate,
        result.optimality,
    )
    accuracy = assess(estimate, prepared.judged, labelled=False)
    return replace(check, accuracy=accuracy, reasons=dict(measurements.reasons))


def matching_differences(check: OwnMatchingCheck) -> str:
    """Return a table of how the two matchers' alignments differ, by scan landmark."""
    head = (
        *("landmark", "scans", "sigma", "ahead [m]", "left [m]", "turn [deg]"),
        *("worst [s]", "its sigma", ""),
    )
    rows = [
        (
            f'data-key="s{landmark.id}" tabindex="0" '
            f'class="{"bad" if landmark.contradicts else ""}"',
            (
                f"scan {landmark.id}",
                str(landmark.common),
                number(landmark.distance_sigma),
                f"{landmark.shift_m[0]:.3f}",
                f"{landmark.shift_m[1]:.3f}",
                f"{np.degrees(landmark.shift_rad):.2f}",
                f"{landmark.worst_time_s:.3f}",
                number(landmark.worst_sigma),
                "contradicts" if landmark.contradicts else "agrees",
            ),
        )
        for landmark in check.landmarks
    ]
    return (
        f'<h2>Alignments of two matchers</h2><p class="note">The filter\'s minus those of '
        f"{escape(check.matcher)}, made from the smoother's own estimate, over the scans that both "
        "aligned a landmark with; the worst of these by its time. Sigmas are of the sum of both "
        "covariances; directions that a shape leaves open count next to nothing.</p>"
        f"{sortable('matching', head, rows)}"
    )


def own_measurements(
    log: Log,
    run: EkfRun,
    templates: Mapping[int, FiltersTemplate],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[SlamProblem, TemplateMeasurements]:
    """What the smoother is to solve, its scan landmarks measured by Open3D's generalised ICP.

    Of the filter it takes which returns of which scan a template was made of, and where its axis
    was put; none of its alignments, no pose, and not which landmarks it fused. templates: by
    landmark index, as they were initialised. Raises ValueError for a log without planar scans, and
    graphslam.scan.libraries.MissingLibraryError.
    """
    if log.scans is None:
        raise ValueError("the log has no planar scans")
    source, problem = ScanSource(log), build_problem(log, run)
    settings = source.suited_options()
    scan_of = _scan_of_epoch(log, source, run)
    taken = {}
    for landmark_index, template in templates.items():
        epoch = int(
            problem.pose_landmarks.pose[problem.pose_landmarks.landmark == landmark_index].min()
        )
        place = planar.compose(log.scans.mount.pose, template.pose)
        returns = source.points(scan_of[epoch])
        shape = np.column_stack((template.shape.mean, np.zeros(len(template.shape))))
        row = cKDTree(returns).query(planar.moved(place, shape))[1]
        own = planar.moved(planar.between(place, np.zeros(3)), returns[row])
        taken[landmark_index] = Template(epoch, place, own)
    measurements = measure_templates(
        problem,
        taken,
        CloudsAt(source, scan_of, settings),
        TemplateMatchers(settings, GeneralisedMatcher),
        TemplateOptions.suited(settings, sensor_of(log.scans).sigma_range_m),
        progress,
    )
    return replace(problem, pose_landmarks=measurements.factors), measurements


def _scan_of_epoch(log: Log, source: ScanSource, run: EkfRun) -> dict[int, int]:
    """Numbers of scans by the epochs that they were taken at."""
    epochs = run.timeline.epoch_time_s
    time_s = source.time_s if isinstance(log.odometry, RelativePoses) else resolved(source.time_s)
    at = np.minimum(np.searchsorted(epochs, time_s), len(epochs) - 1)
    scans = np.flatnonzero(epochs[at] == time_s)
    return dict(zip(at[scans].tolist(), scans.tolist(), strict=True))
