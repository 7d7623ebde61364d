"""The smoother with the log's labels, which an association made without them has not used."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.smoother_input import assemble, position_rows
from comparisons.arrays import Array
from comparisons.checks.accuracy import assess_trajectory, match_landmarks
from comparisons.checks.association import AssociationScore
from comparisons.checks.association_variants import poses_apart
from comparisons.checks.consistency.nees import limit
from comparisons.checks.qualifiers import Distance, TruthGap, measurement_scale
from comparisons.logs.transforms.known_landmarks import indices_by_label
from comparisons.plane import rms
from graphslam.graph_builder import build_graph, from_values
from graphslam.initialisation import track
from graphslam.optimisers import optimise
from graphslam.optimum import ChiSquareTest, chi_square_test
from graphslam.problem import SlamProblem
from graphslam.smoother import smooth

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


def with_labels(known: Known, gap: TruthGap) -> TruthGap:
    """Return a gap with the errors that the smoother has with the log's labels beside S's.

    A robust kernel keeps misread labels from spoiling it; where it has no solution, the gap stays.
    """
    problem, ids = _labelled(known)
    found = _tracked_optimum(problem, "cauchy")
    if found is None:
        return gap
    poses, places, _ = found
    judged, table = known.prepared.judged, known.prepared.log.truth.landmarks
    reached = assess_trajectory(known.timeline.epoch_time_s, poses, judged)
    errors = {"poses": None if reached is None else reached.ate_m}
    if table is not None:
        true = (table.id, table.position_m)
        ours, theirs = match_landmarks((ids, places), true, labelled=True)
        apart = places[ours] - table.position_m[theirs]
        if len(apart):
            errors["landmarks"] = rms(apart)
    distances = tuple(replace(d, labels_m=errors.get(d.what)) for d in gap.distances)
    return replace(gap, distances=distances)


def labels_gap(known: Known, association: AssociationScore | None) -> TruthGap | None:
    """Return how far S is from the smoother with the log's labels, which stand for the truth.

    None where that smoother is not verified, or its chi-square says that the labels do not fit.
    association: the filter's, by these labels.
    """
    options, (problem, _) = known.result.options, _labelled(known)
    if options.robust == "none":  # else chi-square is of what the kernel leaves
        found = _tracked_optimum(problem, "none")
        if found is None or found[2].reading == "too high":
            return None  # before a search for the lowest minimum of what does not fit
    labelled = smooth(problem, {}, options=options)
    test = labelled.optimality.chi_square
    if not labelled.optimality.verified or test.reading == "too high":
        return None
    sigma, metres = poses_apart(known.smoothed.pose, labelled.poses, labelled.pose_covariances())
    return TruthGap(
        distances=(Distance("poses", sigma, limit(3), metres),),
        measurement_m=measurement_scale(known.prepared.log.measurements, np.zeros((0, 2, 2))),
        association=association,
        reference="the smoother with the log's labels",
    )


def _labelled(known: Known) -> tuple[SlamProblem, NDArray[np.int64]]:
    """Return S's observations with the log's labels, and the landmarks' ids (L,)."""
    log, timeline = known.prepared.log, known.timeline
    landmark_index, ids = indices_by_label(log)
    rows = position_rows(timeline, known.positions)
    seen = landmark_index[: len(timeline.measurement_epoch)]
    problem = assemble(log, timeline, seen, len(ids), rows)
    return replace(problem, pose_landmarks=known.result.problem.pose_landmarks), ids


def _tracked_optimum(
    problem: SlamProblem, kernel: str
) -> tuple[Array, Array, ChiSquareTest] | None:
    """Return poses, landmarks and chi-square where tracking leads, no other minimum searched.

    Chi-square is not tested with a kernel. None where the problem has no solution.
    """
    graph = build_graph(problem, kernel)
    try:
        values = optimise(graph, track(problem, graph)[0])[0]
    except RuntimeError:  # gtsam's indeterminate linear system
        return None
    dof = problem.residual_dimension - problem.state_dimension
    return *from_values(values, problem), chi_square_test(float(graph.error(values)), dof)
