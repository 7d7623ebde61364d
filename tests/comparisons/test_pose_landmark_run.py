"""A run with pose landmarks, from the log to the agreement of its estimates."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.pose_landmark_measurements import PoseLandmarkRecorder
from comparisons.adapters.smoother_input import (
    build_problem,
    model_system_at,
    model_system_of,
    recorded_system_of,
    run_smoother,
    smoothed_estimate,
    solve_model,
    solve_recorded,
)
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.agreement import Agreement, Gaussian, compare
from comparisons.checks.diagnosis.linearisation_growth import linearisation_growth
from comparisons.config import EkfConfig
from comparisons.errors import InputError
from comparisons.extensions.own_association.extension import OwnAssociationFinding
from comparisons.faults.fault import with_state
from comparisons.jobs.run import Modified
from ekf_reference.core.ekf import NEW, Ekf
from ekf_reference.core.landmark_types import POSE
from ekf_reference.core.state import KalmanState
from ekf_reference.filters.compressed import CompressedState, LocalAreas
from graphslam.smoother import SmootherOptions
from tests.comparisons.test_pose_landmark_chain import Conditioned, NoCross
from tests.ekf_reference.both_kinds import Flipped, relative
from tests.helpers import Array, Source, compared, present
from tests.scenarios import scenario

R = np.diag((0.05, 0.05, 0.01)) ** 2
FUSE_AT = 60


log = partial(scenario, "simulated-loop", seed=4, seconds=40.0)


class Frames:
    """Sees frames beside the way where they truly are, with noise; fuses the first two."""

    def __init__(self, *, by_ledger: bool = True) -> None:
        poses = present(log().truth.poses)
        self.poses, self.rng = poses, np.random.default_rng(0)
        self.frames = poses.at(np.linspace(poses.time_s[0] + 1.0, 38.0, 8)) + (1.0, 2.0, 2.0)
        self.landmark_index: dict[int, int] = {}
        self.gone: set[int] = set()
        self.by_ledger = by_ledger

    def measured(self, base: Array, frame: Array) -> Array:
        return relative(base, frame) + np.linalg.cholesky(R) @ self.rng.standard_normal(3)

    def look(self, ekf: Ekf, epoch: int, time_s: float, recorder: PoseLandmarkRecorder) -> None:
        truth = self.poses.at(np.array([time_s]))[0]
        away = np.hypot(*(self.frames[:, :2] - truth[:2]).T)
        which = [i for i in np.flatnonzero(away < 15.0).tolist() if i not in self.gone]
        if which:
            z = np.array([self.measured(truth, self.frames[i]) for i in which])
            landmark_index = np.array(
                [self.landmark_index.get(i, NEW) for i in which], dtype=np.intp
            )
            r = np.tile(R, (len(z), 1, 1))
            if self.by_ledger:
                landmark_index = recorder.observe(ekf, epoch, z, r, landmark_index)
            else:
                landmark_index = ekf.observe_known(z, r, landmark_index, POSE)
            self.landmark_index.update(zip(which, landmark_index.tolist(), strict=True))
        if epoch == FUSE_AT:
            z = self.measured(self.frames[0], self.frames[1])
            recorder.fuse(ekf, epoch, self.landmark_index[0], self.landmark_index[1], z, R)
            self.gone.add(1)


def chain(choices: EkfConfig, modify: Callable[[Ekf], None]) -> tuple[EkfRun, Agreement]:
    chosen = settle(choices, log())
    setup = FilterSetup(modify=[modify], source=Frames())
    run = run_ekf(log(), build_timeline(log()), chosen, setup=setup)
    problem = build_problem(log(), run)
    recorded = solve_recorded(recorded_system_of(run), run)
    own = solve_model(model_system_of(problem, run), run)
    result = run_smoother(problem, run, SmootherOptions())
    assert result.optimality.verified
    assert result.optimality.chi_square.reading == "plausible"
    ids = run.estimate.landmark_id
    smoothed = smoothed_estimate(result, run.timeline.epoch_time_s, ids, "the EKF's")
    assert np.array_equal(smoothed.pose_landmark_id, run.estimate.pose_landmark_id)
    ends = [Gaussian.of(one) for one in (run.estimate, smoothed)]
    f1, f2 = (Gaussian(*one, ends[0].layout) for one in (recorded, own))
    return run, compare(ends[0], f1, f2, ends[1])


def _compress(ekf: Ekf) -> None:
    ekf.state = CompressedState(log().prior.pose, log().prior.covariance, LocalAreas(8.0, 20.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("choices", "modify"),
    [
        (EkfConfig(filter="full", association="known"), lambda ekf: None),
        (EkfConfig(filter="full", association="known"), _compress),
        (EkfConfig(filter="misono-full", association="known"), lambda ekf: None),
    ],
)
def test_the_estimates_agree_along_the_chain(
    choices: EkfConfig, modify: Callable[[Ekf], None]
) -> None:
    run, found = chain(choices, modify)
    assert len(found.pose_landmarks) == run.pose_landmarks.count - 1 > 4
    assert found.algebra.within(1e-6)
    assert found.model.within(1e-6)
    assert max(block.distance_sigma for block in found.pose_landmarks) < 1.0


def test_a_flipped_jacobian_is_a_model_gap_and_named() -> None:
    def plant(ekf: Ekf) -> None:
        ekf.models[POSE] = Flipped()

    broken = compared(log(), Modified(plant), Source(Frames), filter="full", association="known")
    causes = broken.verdict.causes
    assert [cause.gap for cause in causes] == ["model"]
    assert "the Jacobian with respect to heading differs" in causes[0].evidence
    assert "measurements of scan landmarks" in causes[0].evidence


def test_the_whole_job_agrees() -> None:
    """Known, written and read: scan landmarks are in both estimates."""
    found = compared(log(), Source(Frames), filter="full", association="known")
    assert found.verdict.outcome == "agree"
    assert len(found.agreement.pose_landmarks) == len(found.smoothed.pose_landmarks) > 4


def test_where_linearising_cost_something_is_found_with_fused_landmarks() -> None:
    chosen = settle(EkfConfig(filter="full", association="known"), log())
    run = run_ekf(log(), build_timeline(log()), chosen, setup=FilterSetup(source=Frames()))
    problem = build_problem(log(), run)
    result = run_smoother(problem, run, SmootherOptions())
    ids = run.estimate.landmark_id
    smoothed = smoothed_estimate(result, run.timeline.epoch_time_s, ids, "the EKF's")
    whole = replace(smoothed, pose_landmarks=result.pose_landmarks())
    there = model_system_at(problem, run, whole)
    assert linearisation_growth(there, there, whole).total == 0.0
    meant = model_system_of(problem, run)
    found = linearisation_growth(meant, there, whole)
    assert found.squared.max() < 1.0
    # Broken: what is left of fused landmarks moves up into their landmark indices.
    moved = np.vstack((smoothed.pose_landmarks, smoothed.pose_landmarks[-1:]))
    shifted = replace(smoothed, pose_landmarks=moved)
    wrong = linearisation_growth(meant, model_system_at(problem, run, shifted), shifted)
    assert wrong.squared.max() > 1.0


def test_the_smoothers_own_association_is_told_of_frames_too() -> None:
    choices = EkfConfig(filter="full", association="nn")
    found = compared(log(), Source(Frames), ekf=choices, smoother_association="own")
    assert found.verdict.outcome == "agree"
    own = found.find(OwnAssociationFinding).own
    assert present(own.pose.variance_ratio_least) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("state", "words"),
    [
        (NoCross, ("augmentation", "scan landmark", "covariance with all but pose is zero")),
        (Conditioned, ("; event ", " (removal of ", "the covariance of block ", " is off by ")),
    ],
)
def test_a_wrong_event_of_scan_landmarks_is_named(
    state: type[KalmanState], words: tuple[str, ...]
) -> None:
    broken = compared(
        log(), Modified(with_state(state)), Source(Frames), filter="full", association="known"
    )
    said = broken.verdict.causes[0].evidence
    assert [word for word in words if word not in said] == []


def test_what_goes_by_the_ledger_is_told() -> None:
    chosen = settle(EkfConfig(filter="full", association="known"), log())
    setup = FilterSetup(source=Frames(by_ledger=False))
    with pytest.raises(InputError, match=r"measurements of pose landmarks, expected 0"):
        run_ekf(log(), build_timeline(log()), chosen, setup=setup)
