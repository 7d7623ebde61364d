"""The main job: one log through both estimators and all checks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from comparisons.adapters.ekf_factory import EkfChoices, fused_positions, judging_positions
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.oriented_sightings import NoOrientedSource, OrientedSource
from comparisons.adapters.scan_odometry import ScanMotion, run_scan_odometry
from comparisons.adapters.smoother_input import (
    build_problem,
    linear_optimum,
    linear_own,
    linear_recorded,
    run_smoother,
    smoothed_estimate,
    solve_own,
    solve_recorded,
)
from comparisons.adapters.timeline import Timeline, build_timeline
from comparisons.checks.accuracy import Accuracy, assess, assess_trajectory
from comparisons.checks.agreement import ROUNDING, Agreement, Gaussian, compare
from comparisons.checks.association import AssociationScore, score_association
from comparisons.checks.consistency.consistency import Consistency, check_consistency
from comparisons.checks.diagnosis.algebra_differences import AlgebraDifference, WatchedState, watch
from comparisons.checks.diagnosis.bookkeeping import misuses
from comparisons.checks.diagnosis.dropouts import find_dropouts
from comparisons.checks.diagnosis.explanations import explain
from comparisons.checks.diagnosis.linearisation_growth import linearisation_growth
from comparisons.checks.diagnosis.model_differences import model_differences
from comparisons.checks.extra_remarks import on_dense, on_motion, on_scans
from comparisons.checks.verdict import Verdict, judge
from comparisons.clock import Clock
from comparisons.errors import InputError
from comparisons.estimates.estimate import Array, Estimate
from comparisons.extensions.dense_maps.check import DenseAgreement, compare_dense
from comparisons.extensions.dense_maps.source import DenseOptions, DenseRun, DenseWatcher
from comparisons.extensions.high_level.source import HighLevelOptions, HighLevelRun, HighLevelSource
from comparisons.extensions.own_association.check import OwnAssociationCheck
from comparisons.extensions.own_matching.check import OwnMatchingCheck
from comparisons.extensions.scan_landmarks.source import (
    LANDMARKS,
    ScanSlamSource,
    ScanSlamSources,
    check_landmarks,
    usual_options,
)
from comparisons.extensions.scan_motion.increments import IncrementCheck, check_increments
from comparisons.extensions.scan_motion.three_way import ThreeWay
from comparisons.logs.log import Log
from comparisons.logs.transforms.known_landmarks import join_known_sightings
from comparisons.logs.transforms.scan_motion import with_scan_motion
from comparisons.pipeline.second_opinions import with_own_association, with_own_matching, with_scans
from ekf_reference.full_ekf import FullEkf
from ekf_reference.scan_landmarks.scan_slam import ScanSlamOptions
from ekf_reference.scan_landmarks.twins import FusingOptions
from graphslam.increments import dead_reckoned
from graphslam.smoother import SmootherOptions, SmootherResult

Progress = Callable[[str, int, int], None]
"""Called with the stage, what is done and what there is to do (0 when not known)."""

_DYNAMIC_ONLY = DenseOptions((), dynamic=True)
_VALUES_ONLY = DenseOptions(("values",))
MOTIONS = ("wheel", "scan", "both")


@dataclass(frozen=True)
class Comparison:
    """Everything one run found out.

    dead_reckoned: (K, 3) where the odometry alone leads. association: how it compares with the
    log's labels, when it was made without them. own_association: the smoother with its own, when
    asked for. own_matching: the smoother with its own matcher of scan landmarks, when asked for.
    three_way: the smoother on scans beside both, when asked for. consistency: whether
    the filter is as sure as it may be; it has remarks, and no say in the verdict. scan_motion,
    increments: what the scans gave and how honest it is, when they were asked. dense, dense_check:
    the dense map and how it compares with the smoother's, when asked for; no check where nothing
    fell into a region. scan_slam: what the scans gave as landmarks, when they were asked.
    high_level: what became of high level landmarks, when asked for. seconds: by stage.
    """

    log: Log
    choices: EkfChoices
    ekf: EkfRun
    smoother: SmootherResult
    smoothed: Estimate
    dead_reckoned: Array
    agreement: Agreement
    consistency: Consistency
    accuracy_ekf: Accuracy | None
    accuracy_smoother: Accuracy | None
    accuracy_dead_reckoned: Accuracy | None
    association: AssociationScore | None
    own_association: OwnAssociationCheck | None
    own_matching: OwnMatchingCheck | None
    three_way: ThreeWay | None
    scan_motion: ScanMotion | None
    increments: IncrementCheck | None
    dense: DenseRun | None
    dense_check: DenseAgreement | None
    scan_slam: ScanSlamSource | None
    high_level: HighLevelRun | None
    verdict: Verdict
    seconds: dict[str, float]


def compare_estimators(
    log: Log,
    choices: EkfChoices | None = None,
    options: SmootherOptions | None = None,
    progress: Progress = lambda stage, done, total: None,
    modify: Callable[[FullEkf], None] = lambda ekf: None,
    smoother_association: str = "ekf",
    motion: str = "wheel",
    dense: DenseOptions | None = None,
    source: Callable[[], OrientedSource] = NoOrientedSource,
    dynamic: bool = False,
    landmarks: str = "points",
    slam_options: ScanSlamOptions | None = None,
    high_level: HighLevelOptions | None = None,
    *,
    fuse_landmarks: bool = False,
    smoother_matcher: str = "ekf",
) -> Comparison:
    """Run both estimators over a log and judge them.

    choices: filter and association; what is left open is chosen by the log. options: of the
    smoother. modify: see run_ekf. smoother_association: `ekf`, or `own` to solve for a second time
    with the smoother's own. motion: of MOTIONS. dense: a dense map to keep and compare, if any.
    source: makes someone who sees landmarks with a direction, anew for every run of the filter.
    dynamic: look for what moves, and keep the filter from going by it. landmarks: of LANDMARKS;
    with `scans` or `both` the log's scans are the source, looked at as slam_options say, with
    high_level the dense map. fuse_landmarks: fuse scan landmarks that turn out to be one.
    smoother_matcher: `ekf`, or `own` for a smoother that sees the scan landmarks by itself, too.
    Raises InputError when the log cannot be used, and graphslam.marginals.SingularProblemError
    when the smoother has no solution.
    """
    if motion not in MOTIONS:
        raise InputError(f"motion '{motion}' is unknown, expected one of {', '.join(MOTIONS)}")
    check_landmarks(landmarks)
    clock = Clock()
    chosen = (choices or EkfChoices()).settle(log)
    log = join_known_sightings(log)
    if landmarks != "scans" and not len(log.sightings.time_s):
        raise InputError(
            f"{log.name}: holds no sightings of landmarks (try --features trees, "
            "--landmarks scans, or slamcheck odometry for its scans)"
        )
    if landmarks == "scans" and (motion == "both" or smoother_association == "own"):
        asked = "--motion both" if motion == "both" else "--smoother-association own"
        raise InputError(f"{asked} compares landmarks that are points; use --landmarks both")
    if smoother_matcher not in ("ekf", "own"):
        raise InputError(f"smoother matcher '{smoother_matcher}' is unknown, expected ekf or own")
    if smoother_matcher == "own" and landmarks == "points":
        raise InputError("--smoother-matcher own goes with --landmarks scans or both")
    if landmarks == "scans" and chosen.attributes != "off":
        raise InputError(
            f"--attributes {chosen.attributes} tells points apart; use --landmarks points or both"
        )
    if landmarks != "points" and high_level is not None:
        raise InputError("--high-level on goes with --landmarks points only")
    if landmarks == "points" and fuse_landmarks:
        raise InputError("--fuse-landmarks on goes with --landmarks scans or both")
    enriched = slam_options is not None and math.isfinite(slam_options.enrich_m)
    by_layer = chosen.attributes == "layer"
    watching = dense is not None or dynamic or by_layer
    if fuse_landmarks and (watching or enriched):
        # Regions that hang on a landmark that was fused would stay behind.
        raise InputError(
            "--fuse-landmarks on goes without --dense, --dynamic on, --attributes layer and "
            "--templates enriched: regions of a map hang on scan landmarks for good"
        )
    if motion != "scan" and not len(log.odometry.time_s):
        raise InputError(f"{log.name}: holds no odometry; use --motion scan")
    scanned = None
    if motion != "wheel":
        with clock.stage("scan odometry"):
            scanned = run_scan_odometry(log, progress=lambda k, n: progress("scan odometry", k, n))
    if motion == "scan" and scanned is not None:
        log = with_scan_motion(log, scanned, positions=chosen.gps != "off")
    fusing = FusingOptions() if fuse_landmarks else None
    looking = slam_options or usual_options(mapped=watching)
    slam = ScanSlamSources.of(log, landmarks, looking, fusing)
    if slam is not None:
        log, source = slam.log, slam
    positions = fused_positions(log, chosen)
    timeline = build_timeline(log, positions, None if slam is None else slam.scans.time_s)

    def watch_over() -> DenseWatcher | None:
        if not watching:
            return None
        kept = replace(dense or (_VALUES_ONLY if by_layer else _DYNAMIC_ONLY), dynamic=dynamic)
        also = _VALUES_ONLY.layers if by_layer else ()
        if high_level is not None:
            also += high_level.layers_in(kept)
        return DenseWatcher(log, kept, also=also, kinds=LANDMARKS[landmarks])

    watcher = watch_over()
    if high_level is not None:
        source = partial(HighLevelSource, log, high_level)
    shared = (
        watcher is not None and high_level is not None and high_level.layers_in(watcher.options)
    )
    seeing = HighLevelSource(log, high_level, watcher) if shared else source()
    with clock.stage("ekf"):
        run = run_ekf(
            log,
            timeline,
            chosen,
            positions,
            lambda k, n: progress("EKF", k, n),
            modify,
            watcher,
            seeing,
            watcher if dynamic else None,
            watcher if by_layer else None,
        )
    if not len(run.estimate.landmark) + len(run.estimate.oriented):
        raise InputError(
            f"{log.name}: no {'sighting' if slam is None else 'scan'} could be used, so there is "
            "no map to compare"
        )
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
            second = with_own_association(log, judged, run, smoothed, result.options)
    matching = None
    if smoother_matcher == "own" and slam is not None:
        with clock.stage("own matcher"):
            matching = with_own_matching(
                log, judged, run, slam.first, smoothed, result.options,
                lambda k, n: progress("own matcher", k, n),
            )  # fmt: skip
    three = None
    if motion == "both" and scanned is not None:
        with clock.stage("smoother on scans"):
            progress("smoother on scans", 0, 0)
            three = with_scans(log, judged, scanned, run, result, smoothed)
    mapped = None if dense is None or watcher is None else watcher.run()
    compared = None
    if mapped is not None:
        with clock.stage("dense check"):
            progress("dense check", 0, 0)
            compared = compare_dense(log, mapped, smoothed)
    with clock.stage("checks"):
        progress("checks", 0, 0)
        agreement = compare(
            _gaussian(run.estimate),
            Gaussian(*recorded, len(run.estimate.oriented)),
            Gaussian(*own, len(run.estimate.oriented)),
            _gaussian(smoothed),
        )
        labelled = chosen.association == "known"
        consistency = check_consistency(
            log, run, smoothed, labelled=labelled, robust=result.options.robust
        )
        begun = int(np.count_nonzero(run.trace.augmentations.weight > 0.0))
        whole = replace(smoothed, oriented=result.oriented())  # by slot, fused ones among them
        verdict = judge(
            agreement,
            result.proof,
            run,
            lambda: model_differences(said, meant, ROUNDING, begun),
            operations=lambda: _repeated(
                log,
                timeline,
                run,
                chosen,
                modify,
                source(),
                watch_over() if dynamic or by_layer else None,
                dynamic,
            ),
            explanations=lambda: explain(log, run),
            misuses=misuses(log, run, smoothed, labelled=labelled),
            conservative=chosen.conservative,
            robust=result.options.robust,
            own=second,
            matching=matching,
            three_way=three,
            dense=compared,
            growth=lambda: linearisation_growth(meant, linear_optimum(problem, run, whole), whole),
            dropouts=lambda: find_dropouts(run, smoothed),
            sensors=consistency.sensors,
        )
        reckoned = dead_reckoned(problem.prior_pose, problem.increment)
        return Comparison(
            log,
            chosen,
            run,
            result,
            smoothed,
            reckoned,
            agreement,
            consistency,
            assess(run.estimate, judged, labelled=labelled),
            assess(smoothed, judged, labelled=labelled),
            assess_trajectory(run.timeline.epoch_time_s, reckoned, judged),
            None if labelled else score_association(run.slot, run.estimate.landmark, log),
            second,
            matching,
            three,
            scanned,
            None if scanned is None else check_increments(scanned, log),
            mapped,
            compared,
            None if slam is None else slam.first,
            seeing.run() if isinstance(seeing, HighLevelSource) else None,
            replace(
                verdict,
                remarks=(
                    *verdict.remarks,
                    *consistency.remarks,
                    *on_scans(log, scanned),
                    *on_dense(mapped, compared),
                    *on_motion(watcher if dynamic else None),
                ),
            ),
            clock.seconds,
        )


def _repeated(
    log: Log,
    timeline: Timeline,
    run: EkfRun,
    choices: EkfChoices,
    modify: Callable[[FullEkf], None],
    source: OrientedSource,
    watcher: DenseWatcher | None,
    dynamic: bool,
) -> tuple[AlgebraDifference, ...]:
    """The filter once more, with every operation repeated on a sound copy of its state.

    watcher: who tells it what moves, or what is around its landmarks, if anybody does.
    """
    watched: list[WatchedState | None] = []

    def also(ekf: FullEkf) -> None:
        modify(ekf)
        watched.append(watch(ekf, ROUNDING, run.trace.prior_pose, run.trace.prior_covariance))

    run_ekf(
        log, timeline, choices, run.positions, modify=also, watcher=watcher, source=source,
        guard=watcher if dynamic else None, layer=watcher,
    )  # fmt: skip
    return watched[0].differences() if watched[0] is not None else ()


def _gaussian(estimate: Estimate) -> Gaussian:
    return Gaussian(estimate.joint_mean, estimate.joint_covariance, len(estimate.oriented))
