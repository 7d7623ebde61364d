"""The smoother a second time, with its own association."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from comparisons.adapters.ekf_run import UNUSED, EkfRun
from comparisons.adapters.smoother_association import OwnAssociator
from comparisons.adapters.smoother_input import position_rows, smoothed_estimate
from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import Accuracy, accuracy_rows, assess
from comparisons.checks.agreement import BlockAgreement, Gaussian, block_agreement
from comparisons.checks.association import (
    AssociationScore,
    compare_partitions,
    counterparts,
    differing_measurements,
    score_association,
)
from comparisons.checks.finding import Finding
from comparisons.checks.misfit import squared_misfit
from comparisons.config import Configured
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.own_association.config import OwnAssociationConfig
from comparisons.figures import METRES, Aside, Less, More, Named, in_sigma, percent, rows_of
from comparisons.logs.log import LandmarkMeasurements
from comparisons.pipeline.beside import ASSOCIATION_PAYS_FROM, BackgroundCall
from comparisons.pipeline.extension import Extension
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepared import Prepared
from comparisons.plane import rms
from comparisons.report.html.drawing import MOST_LINES, Drawing, association_lines
from comparisons.report.html.shell import number, sortable
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR
from comparisons.words import Cause, Row
from ekf_reference.core.measurements import DYNAMIC
from graphslam.optimum import Optimality
from graphslam.problem import PoseLandmarkMeasurements
from graphslam.smoother import SmootherOptions, smooth


@dataclass(frozen=True, kw_only=True)
class OwnAssociationCheck:
    """Entry `own_association`: the smoother with its own association, the gap S - S'.

    Attributes:
        landmarks: landmarks of the smoother's association.
        agreement: share of the pairs of measurements of either that both put together.
        pairs_both: pairs that both put together.
        pairs_filter: pairs that the filter puts together.
        pairs_smoother: pairs that the smoother puts together.
        splits: landmarks of the filter that the smoother splits.
        merges: landmarks of the filter that the smoother merges.
        pose_difference_m: distance of the last poses with either association.
        pose_distance_sigma: the same, in sigma.
        landmark_rms_m: root mean square distance of landmarks that share most of their
            measurements; None without any.
        verified: whether the optimum with the smoother's association is verified.
        accuracy: errors with the smoother's association.
        association: the smoother's association compared with the log's labels.
        landmark_index: (M,) the smoother's own landmarks of the measurements, negative for unused.
        matched: (L,) the filter's counterpart of each of its landmarks, -1 for none.
        differing: the measurements that the two do not give to counterparts.
        cost: (D, 2) squared misfit of each of these, in units of its noise, at S with the filter's
            landmark and at S' with its own, NaN where it is unused.
        pose: S against S' in the last pose.
        estimate: of S'.
    """

    landmarks: Annotated[int, Named("landmarks")]
    agreement: Annotated[More[float], Named("pairs of measurements as the filter's", percent)]
    pairs_both: int
    pairs_filter: int
    pairs_smoother: int
    splits: Annotated[Less[int], Named("landmarks of the filter that it splits", "{}")]
    merges: Annotated[Less[int], Named("landmarks of the filter that it merges", "{}")]
    pose_difference_m: Annotated[Less[float], Named("last pose: difference of positions", METRES)]
    pose_distance_sigma: Annotated[
        Less[float], Named("last pose: difference of the means", in_sigma)
    ]
    landmark_rms_m: Less[float | None]
    verified: bool
    accuracy: Accuracy | None = None
    association: AssociationScore | None = None
    landmark_index: Aside[Index]
    matched: Aside[Index]
    differing: Aside[Index]
    cost: Aside[Array]
    pose: Aside[BlockAgreement]
    estimate: Aside[Estimate]


def check_own_association(
    measurements: LandmarkMeasurements,
    epoch: Index,
    landmark_indices: tuple[Index, Index],
    smoothed: Estimate,
    estimate: Estimate,
    optimality: Optimality,
) -> OwnAssociationCheck:
    """Compare. seen, epoch: the measurements, of which the first M are compared, and their epochs.

    landmark_indices: (M,) landmarks of each by the filter, and by the smoother. smoothed: S.
    estimate, optimality: of S'.
    """
    filters, own = landmark_indices
    first, second = counterparts(filters, own)
    apart = smoothed.landmark[first] - estimate.landmark[second]
    poses = [Gaussian.of_pose(e.pose[-1], e.joint_covariance[:3, :3]) for e in (smoothed, estimate)]
    matched = np.full(len(estimate.landmark), -1, dtype=np.intp)
    matched[second] = first
    differing = differing_measurements(filters, own, matched)
    cost = np.full((len(differing), 2), np.nan)
    for column, (landmark_index, e) in enumerate(((filters, smoothed), (own, estimate))):
        used = np.flatnonzero(landmark_index[differing] >= 0)
        rows = differing[used]
        cost[used, column] = squared_misfit(
            measurements, rows, e.pose[epoch[rows]], e.landmark[landmark_index[rows]]
        )
    partition, pose = compare_partitions(filters, own), block_agreement(*poses)
    return OwnAssociationCheck(
        landmarks=len(estimate.landmark),
        agreement=partition.agreement,
        pairs_both=partition.pairs_both,
        pairs_filter=partition.pairs_first,
        pairs_smoother=partition.pairs_second,
        splits=partition.splits,
        merges=partition.merges,
        pose_difference_m=pose.difference_m,
        pose_distance_sigma=pose.distance_sigma,
        landmark_rms_m=rms(apart) if len(apart) else None,
        verified=optimality.verified,
        landmark_index=own,
        matched=matched,
        differing=differing,
        cost=cost,
        pose=pose,
        estimate=estimate,
    )


def association_cause(check: OwnAssociationCheck, run: EkfRun) -> Cause:
    """S against S', whose optimum is verified: it stands where S misfits by this association."""
    return Cause(
        "association",
        f"the smoother's own association moves its last pose by {check.pose_difference_m:.2f} m "
        f"({check.pose_distance_sigma:.1f} sigma); the two associations share "
        f"{100.0 * check.agreement:.0f} % of their pairs of measurements, the smoother splits "
        f"{check.splits} landmarks of the filter and merges others into {check.merges}"
        + _costliest(check, run),
        "check the measurements whose association differs: for a wrong loop closure, and for "
        "landmarks too close to distinguish",
    )


def _costliest(check: OwnAssociationCheck, run: EkfRun) -> str:
    """The measurement that fits the filter's landmark the least, of those that differ."""
    with_both = np.flatnonzero(np.isfinite(check.cost).all(axis=1))
    if not len(with_both):
        return ""
    worst = with_both[np.argmax(check.cost[with_both, 0])]
    row = check.differing[worst]
    t = run.estimate.time_s[run.timeline.measurement_epoch[row]]
    theirs, ours = check.cost[worst]
    return (
        f"; the residual of measurement {row} at {t:.1f} s is {theirs**0.5:.1f} sigma with the "
        f"filter's landmark {run.estimate.names[run.landmark_index[row]]} and "
        f"{ours**0.5:.1f} sigma with the smoother's own"
    )


class OwnAssociation(Extension):
    """Does the verdict hold with an association that the smoother makes?

    Sees how much the verdict owes to the filter's association, which S shares.
    """

    name = "own_association"
    needs = "measurements of landmarks"
    errs = "not measured"
    figures = (("own_association", OwnAssociationCheck),)

    def __init__(self, settings: OwnAssociationConfig, config: Configured) -> None:
        """Of `when` never, it does nothing."""
        super().__init__(settings, config)
        self.asked = settings.when != "never"

    def start(self, prepared: Prepared[Any], run: EkfRun) -> BackgroundCall[OwnSolution] | None:
        """Associate and solve beside the smoother; neither needs the other's result."""
        if not self.asked:
            return None
        log = replace(prepared.log, scans=None, clouds=None)
        rows = position_rows(run.timeline, run.positions)
        left_out = np.flatnonzero(run.landmark_index == DYNAMIC)
        size = len(run.timeline.epoch_time_s), len(run.landmark_index), len(run.estimate.landmark)
        return BackgroundCall(
            solve_with_own_association,
            log.name,
            OwnAssociator(log, run.timeline, rows, left_out),
            run.pose_landmarks,
            SmootherOptions(**prepared.config.smoother.model_dump()),
            size=size,
            pays_from=ASSOCIATION_PAYS_FROM,
        )

    def find(self, known: Known) -> OwnAssociationFinding | None:
        """Associate without the filter, solve, assess, and compare. Raises InputError."""
        if not self.asked:
            return None
        prepared, work = known.prepared, known.started[self.name]
        with prepared.clock.stage("own association"):
            prepared.progress("own association", 0, 0)
            found = work.result()
            log, run, estimate = prepared.log, known.ekf, found.estimate
            check = replace(
                check_own_association(
                    log.measurements,
                    run.timeline.measurement_epoch,
                    (run.landmark_index, found.landmark_index),
                    known.gaps.smoothed,
                    estimate,
                    found.optimality,
                ),
                accuracy=assess(estimate, prepared.judged, labelled=False),
                association=score_association(found.landmark_index, estimate.landmark, log),
            )
        prepared.clock.add_cpu("own association", work.cpu_s)
        return OwnAssociationFinding(known, check)


class OwnAssociationFinding(Finding):
    """S against S'. own: the check."""

    def __init__(self, known: Known, check: OwnAssociationCheck) -> None:
        """Heard in the verdict when its optimum is verified."""
        self.own, self._known = check, known
        self.entries = {"own_association": check}
        if check.verified and not check.pose.agrees:
            self.causes = [association_cause(check, known.ekf)]

    def rows(self) -> Sequence[Row]:
        """Return how the associations compare, and how good the smoother is with its own."""
        check, group = self.own, "Smoother with its own association"
        return [
            *rows_of(group, check),
            *accuracy_rows("the smoother with its own association", check.accuracy),
            *(check.association.rows("the smoother") if check.association else ()),
        ]

    def layers(self, drawing: Drawing) -> None:
        """Add a line from the pose to the landmark for each measurement that differs."""
        differing_lines(drawing, self.own, self._known.ekf)

    def sections(self) -> Sequence[str]:
        """Return the table of measurements that differ."""
        return [association_differences(self.own, self._known.ekf)]


@dataclass(frozen=True)
class OwnSolution:
    """S': the landmark of each measurement (M,), and the estimate with the evidence for it."""

    landmark_index: Index
    estimate: Estimate
    optimality: Optimality


def solve_with_own_association(
    name: str,
    associator: OwnAssociator,
    pose_landmarks: PoseLandmarkMeasurements,
    options: SmootherOptions,
) -> OwnSolution:
    """Return S'. Only points are associated anew: measurements of pose landmarks stay as they are.

    name: of the log. Raises InputError.
    """
    association = associator.associate()
    if not association.problem.landmark_count:
        raise InputError(f"{name}: the smoother's own association found no landmark")
    problem = replace(association.problem, pose_landmarks=pose_landmarks)
    guesses = {"association": (association.poses, association.landmarks)}
    result = smooth(problem, guesses, options=options)
    ids = np.arange(association.problem.landmark_count)
    estimate = smoothed_estimate(result, associator.epoch_time_s, ids, "its own")
    return OwnSolution(association.landmark_index, estimate, result.optimality)


_MOST_ROWS = 200


def differing_lines(drawing: Drawing, check: OwnAssociationCheck, run: EkfRun) -> None:
    """Add lines from poses to the landmarks that filter and smoother assigned measurements to."""
    row, epoch = check.differing[:MOST_LINES], run.timeline.measurement_epoch
    for name, colour, estimate, landmark_indices in (
        ("associations that differ: EKF", EKF_COLOUR, run.estimate, run.landmark_index),
        (
            "associations that differ: smoother",
            SMOOTHER_COLOUR,
            check.estimate,
            check.landmark_index,
        ),
    ):
        used = row[landmark_indices[row] >= 0]
        association_lines(drawing, (name, colour), estimate, epoch[used], landmark_indices[used])


def association_differences(check: OwnAssociationCheck, run: EkfRun) -> str:
    """Return a table of the measurements that filter and smoother give to different landmarks."""
    landmark_index, ids = run.landmark_index, run.estimate.landmark_id
    time_s = run.timeline.epoch_time_s[run.timeline.measurement_epoch]
    rows = []
    for row, cost in zip(check.differing[:_MOST_ROWS].tolist(), check.cost.tolist(), strict=False):
        ours, theirs = int(landmark_index[row]), int(check.landmark_index[row])
        filters, key = UNUSED.get(ours, "unused"), ""
        if ours >= 0:
            filters, key = str(ids[ours]), f'data-key="{ids[ours]}" tabindex="0"'
        smoothers = f"{theirs}" if theirs >= 0 else "unused"
        if theirs >= 0 and (counterpart := int(check.matched[theirs])) >= 0:
            smoothers += f" (the filter's {ids[counterpart]})"
        misses = (number(squared**0.5) for squared in cost)
        rows.append((key, (str(row), f"{time_s[row]:.3f}", filters, smoothers, *misses)))
    count, more = len(check.differing), len(check.differing) - len(rows)
    reported = f"{count:,} of {len(check.landmark_index):,} measurements differ"
    reported += f"; the first {len(rows):,} are listed, {more:,} more are not." if more else "."
    head = (
        *("measurement", "time [s]", "filter's landmark", "smoother's own"),
        *("misses the filter's [sigma]", "misses the smoother's [sigma]"),
    )
    return (
        f'<h2>Associations that differ</h2><p class="note">{reported}</p>'
        f"{sortable('association', head, rows) if rows else ''}"
    )
