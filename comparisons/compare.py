"""The main job: one log through both estimators and all checks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from comparisons.checks.accuracy import Accuracy, assess, assess_trajectory
from comparisons.checks.agreement import Agreement, Gaussian, compare
from comparisons.checks.association import AssociationScore, score_association
from comparisons.checks.attribution import ROUNDING, Verdict, judge
from comparisons.checks.model_differences import model_differences
from comparisons.checks.own_association import OwnAssociationCheck, check_own_association
from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.runs.ekf_build import EkfChoices, fused_positions, judging_positions
from comparisons.runs.ekf_run import EkfRun, run_ekf
from comparisons.runs.estimate import Array, Estimate
from comparisons.runs.known_landmarks import join_known_sightings
from comparisons.runs.own_association import associate_own
from comparisons.runs.smoother_run import (
    build_problem,
    linear_own,
    linear_recorded,
    position_rows,
    run_smoother,
    smoothed_estimate,
    solve_own,
    solve_recorded,
)
from comparisons.runs.timeline import build_timeline
from ekf_reference.full_ekf import FullEkf
from graphslam.increments import dead_reckoned
from graphslam.smoother import SmootherOptions, SmootherResult, smooth

Progress = Callable[[str, int, int], None]
"""Called with the stage, what is done and what there is to do (0 when not known)."""


@dataclass(frozen=True)
class Comparison:
    """Everything one run found out.

    dead_reckoned: (K, 3) where the odometry alone leads. association: how it compares with the
    log's labels, when it was made without them. own_association: the smoother with its own, when
    asked for. seconds: by stage.
    """

    log: Log
    choices: EkfChoices
    ekf: EkfRun
    smoother: SmootherResult
    smoothed: Estimate
    dead_reckoned: Array
    agreement: Agreement
    accuracy_ekf: Accuracy | None
    accuracy_smoother: Accuracy | None
    accuracy_dead_reckoned: Accuracy | None
    association: AssociationScore | None
    own_association: OwnAssociationCheck | None
    verdict: Verdict
    seconds: dict[str, float]


def compare_estimators(
    log: Log,
    choices: EkfChoices | None = None,
    options: SmootherOptions | None = None,
    progress: Progress = lambda stage, done, total: None,
    modify: Callable[[FullEkf], None] = lambda ekf: None,
    smoother_association: str = "ekf",
) -> Comparison:
    """Run both estimators over a log and judge them.

    choices: filter and association; what is left open is chosen by the log. options: of the
    smoother. modify: see run_ekf. smoother_association: `ekf`, or `own` to solve for a second time
    with the smoother's own.
    Raises InputError when the log cannot be used, and graphslam.marginals.SingularProblemError
    when the smoother has no solution.
    """
    chosen = (choices or EkfChoices()).settle(log)
    log = join_known_sightings(log)
    clock = _Clock()
    positions = fused_positions(log, chosen)
    timeline = build_timeline(log, positions)
    with clock.stage("ekf"):
        run = run_ekf(log, timeline, chosen, positions, lambda k, n: progress("EKF", k, n), modify)
    if not len(run.estimate.landmark):
        raise InputError(f"{log.name}: no sighting could be used, so there is no map to compare")
    problem = build_problem(log, run)
    with clock.stage("frozen"):
        progress("frozen smoothers", 0, 0)
        said, meant = linear_recorded(run), linear_own(problem, run)
        recorded, own = solve_recorded(said, run), solve_own(meant, run)
    with clock.stage("smoother"):
        result = run_smoother(
            problem, run, options or SmootherOptions(), lambda stage: progress(stage, 0, 0)
        )
    with clock.stage("marginals"):
        progress("marginals", 0, 0)
        ids = run.estimate.landmark_id
        smoothed = smoothed_estimate(result, run.timeline.epoch_time_s, ids, "the EKF's")
    judged = replace(log, positions=judging_positions(log, chosen))
    second = None
    if smoother_association == "own":
        with clock.stage("own association"):
            progress("own association", 0, 0)
            second = _with_own_association(log, judged, run, smoothed, result.options)
    with clock.stage("checks"):
        progress("checks", 0, 0)
        agreement = compare(
            _gaussian(run.estimate), Gaussian(*recorded), Gaussian(*own), _gaussian(smoothed)
        )
        labelled = chosen.association == "known"
        reckoned = dead_reckoned(problem.prior_pose, problem.increment)
        return Comparison(
            log,
            chosen,
            run,
            result,
            smoothed,
            reckoned,
            agreement,
            assess(run.estimate, judged, labelled=labelled),
            assess(smoothed, judged, labelled=labelled),
            assess_trajectory(run.timeline.epoch_time_s, reckoned, judged),
            None if labelled else score_association(run.slot, run.estimate.landmark, log),
            second,
            judge(
                agreement,
                result.proof,
                run,
                lambda: model_differences(said, meant, ROUNDING),
                conservative=chosen.conservative,
                robust=result.options.robust,
                own=second,
            ),
            clock.seconds,
        )


def _with_own_association(
    log: Log, judged: Log, run: EkfRun, smoothed: Estimate, options: SmootherOptions
) -> OwnAssociationCheck:
    """Associate without the filter, solve, assess, and compare with what its association gave."""
    found = associate_own(log, run.timeline, position_rows(run.timeline, run.positions))
    if not found.problem.landmark_count:
        raise InputError(f"{log.name}: the smoother's own association found no landmark")
    result = smooth(found.problem, {"association": (found.poses, found.landmarks)}, options=options)
    ids = np.arange(found.problem.landmark_count)
    estimate = smoothed_estimate(result, run.timeline.epoch_time_s, ids, "its own")
    return check_own_association(
        run.slot,
        found.slot,
        smoothed,
        estimate,
        result.proof,
        assess(estimate, judged, labelled=False),
        score_association(found.slot, result.landmarks, log),
    )


def _gaussian(estimate: Estimate) -> Gaussian:
    return Gaussian(estimate.joint_mean, estimate.joint_covariance)


class _Clock:
    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = time.perf_counter() - start
