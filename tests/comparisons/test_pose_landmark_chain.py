"""Pose landmarks along the chain of estimates, and where these are compared, written and read."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.recorded import measurement_points, merge_points, recorded
from comparisons.checks.agreement import Gaussian, compare
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import read_external
from comparisons.estimates.folder import read_estimate, write_estimate
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import POINT, POSE, LandmarkKind, NewLandmarks
from ekf_reference.core.layout import Layout
from ekf_reference.core.state import KalmanState
from ekf_reference.core.trace import RecordedTrace, TraceArrays
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.relative_pose import RelativePose
from graphslam import layout as graph
from graphslam.arrays import Marginal
from graphslam.graph_builder import right_perturbation
from graphslam.linear_problem import LinearProblem, solve
from graphslam.model_system import LinearisationPoints, model_system
from graphslam.problem import Merges, PoseLandmarkMeasurements, SlamProblem
from tests.ekf_reference.both_kinds import (
    CONTROL,
    PRIOR,
    RADIUS_M,
    SIGMA,
    STEP_S,
    Flipped,
    Made,
    Q,
    Script,
    Unwrapped,
    build,
    drive,
)
from tests.helpers import Array, present, random_covariance

SCRIPT = Script(steps=120, order="in turn", fuse_at=60, remove_at=75)


@dataclass
class Chain:
    """A drive, and what is made of it."""

    ekf: Ekf
    made: Made
    trace: TraceArrays

    @property
    def expected(self) -> Marginal:
        """E, points before pose landmarks."""
        state = self.ekf.state
        packed = state.layout.by_kind()
        return Marginal(state.mean[packed], state.covariance[np.ix_(packed, packed)])

    def solve(self, linear: LinearProblem) -> Marginal:
        poses = np.vstack((self.trace.departed, self.ekf.state.pose))
        state = self.ekf.state
        places = {graph.POINT: state.landmarks, graph.POSE_LANDMARK: state.places(POSE)}
        return solve(linear, poses, places)

    def recorded(self) -> Marginal:
        """F1."""
        return self.solve(recorded(self.trace, np.arange(len(self.trace.f) + 1)))

    def own(self) -> Marginal:
        """F2."""
        return self.solve(model_system(problem_of(self.made), points_of(self.trace, self.ekf)))


def run(
    kind: str = "full",
    script: Script = SCRIPT,
    modify: Callable[[Ekf], None] = lambda ekf: None,
    seed: int = 0,
) -> Chain:
    trace = RecordedTrace()
    ekf = build(kind, trace)
    modify(ekf)
    made = drive(ekf, seed, script)
    return Chain(ekf, made, trace.arrays())


def problem_of(made: Made) -> SlamProblem:
    """What the drive measured, as the smoother is told."""
    at = UnicycleModel().step(np.zeros(3), CONTROL, STEP_S)
    drift = np.diag((1e-8, 1e-8, 1e-10)) * STEP_S
    spread = at.jacobian_control @ Q @ at.jacobian_control.T + drift
    steps = made.steps
    node, landmark_index, z = (np.array(c) for c in zip(*made.points_seen, strict=True))
    covariance = np.array([r for _, _, _, r in made.seen])
    measured = np.array([z for _, _, z, _ in made.seen])
    merges = Merges()
    if made.fused:
        epoch, first, second, where, r = (np.array(c) for c in zip(*made.fused, strict=True))
        merges = Merges(epoch, first, second, where, right_perturbation(where, r))
    pose_landmarks = PoseLandmarkMeasurements(
        np.array([k for k, _, _, _ in made.seen]),
        np.array([s for _, s, _, _ in made.seen]),
        measured,
        right_perturbation(measured, covariance),
        merges,
    )
    return SlamProblem(
        prior_pose=np.array([RADIUS_M, 0.0, 0.5 * np.pi]),
        prior_covariance=PRIOR,
        increment=np.tile(at.pose, (steps, 1)),
        increment_covariance=np.tile(
            right_perturbation(at.pose[None], spread[None]), (steps, 1, 1)
        ),
        measurement_pose=node,
        measurement_landmark=landmark_index,
        z=z,
        sigma=np.tile(SIGMA, (len(z), 1)),
        landmark_count=int(landmark_index.max()) + 1,
        pose_landmarks=pose_landmarks,
    )


def points_of(trace: TraceArrays, ekf: Ekf) -> LinearisationPoints:
    return LinearisationPoints(
        departed=np.vstack((trace.departed, ekf.state.pose)),
        arrived=np.vstack((trace.prior_pose, trace.arrived)),
        measurements=measurement_points(trace, lambda pose, step: pose),
        merges=merge_points(trace),
        position=np.zeros(0, dtype=np.intp),
        position_weight=np.zeros(0),
        position_pose=np.zeros((0, 3)),
    )


def gap(first: Marginal, second: Marginal) -> float:
    """Largest difference in sigmas, or of covariances in products of sigmas."""
    sigma = np.sqrt(np.diag(second.covariance))
    mean = np.abs((first.mean - second.mean) / sigma).max()
    spread = np.abs((first.covariance - second.covariance) / np.outer(sigma, sigma)).max()
    return float(max(mean, spread))


@pytest.mark.parametrize("kind", ["full", "compressed"])
@pytest.mark.parametrize("order", ["in turn", "frames first"])
def test_the_filter_equals_both_frozen_smoothers(kind: str, order: str) -> None:
    """Two laps with a fusion and removals; the compressed filter replays like the full one."""
    chain = run(kind, replace(SCRIPT, order=order))
    assert len(chain.trace.merges.step) == 1
    assert len(chain.trace.removals.landmark_index) == 3
    expected, f1 = chain.expected, chain.recorded()
    assert len(f1.mean) == len(expected.mean) == chain.ekf.state.layout.size
    assert gap(expected, f1) < 1e-9
    assert gap(f1, chain.own()) < 1e-9


def test_parts_of_an_update_are_replayed() -> None:
    def split(ekf: Ekf) -> None:
        ekf.splitter = replace(ekf.splitter, largest_move_m=0.01, most=8)

    chain = run(modify=split)
    assert (chain.trace.measurements[POSE].weight < 1.0).any()
    f1 = chain.recorded()
    assert gap(chain.expected, f1) < 1e-9
    assert gap(f1, chain.own()) < 1e-9


class NoCross(KalmanState):
    """New pose landmarks know the vehicle but not the map."""

    def augment(self, new: NewLandmarks, noise: Array, kind: LandmarkKind = POINT) -> None:
        n = self._layout.size
        super().augment(new, noise, kind)
        if kind == POSE:
            self._covariance[3:n, n : self._layout.size] = 0.0
            self._covariance[n : self._layout.size, 3:n] = 0.0


class Conditioned(KalmanState):
    """Removal as if the place of what is removed were known."""

    def remove(self, landmark_index: np.ndarray, kind: LandmarkKind = POINT) -> None:
        local = self.map_of(landmark_index, kind)
        own = local.columns[3:]
        rows = np.eye(len(local.columns))[3:]
        self.update(local.columns, rows, np.zeros(len(own)), 1e-8 * np.eye(len(own)))
        super().remove(landmark_index, kind)


@pytest.mark.parametrize("model", [Flipped, Unwrapped])
def test_a_wrong_model_shows_as_a_model_gap_alone(model: type[RelativePose]) -> None:
    def plant(ekf: Ekf) -> None:
        ekf.models[POSE] = model()

    chain = run(modify=plant, script=Script(steps=110, order="in turn"))
    f1 = chain.recorded()
    assert gap(chain.expected, f1) < 1e-7
    assert gap(f1, chain.own()) > 1e-2


@pytest.mark.parametrize(("state", "script"), [(NoCross, Script(steps=1)), (Conditioned, SCRIPT)])
def test_wrong_algebra_shows_as_an_algebra_gap_alone(
    state: type[KalmanState], script: Script
) -> None:
    def plant(ekf: Ekf) -> None:
        ekf.state = state(ekf.state.pose, PRIOR)

    chain = run(modify=plant, script=script)
    f1 = chain.recorded()
    assert gap(chain.expected, f1) > 1e-3
    assert gap(f1, chain.own()) < 1e-9


def estimate() -> Estimate:
    rng = np.random.default_rng(0)
    pose, covariance = rng.standard_normal((4, 3)), random_covariance(rng, 13)
    return Estimate(
        time_s=np.arange(4.0),
        pose=pose,
        pose_covariance=np.tile(covariance[:3, :3], (4, 1, 1)),
        landmark_id=np.array([7, 9]),
        landmark=rng.standard_normal((2, 2)),
        joint_covariance=covariance,
        information="filtered",
        provenance={},
        pose_landmark_id=np.array([3, 5]),
        pose_landmarks=rng.uniform(-10.0, 10.0, (2, 3)),
    )


def test_an_estimate_survives_its_folder(tmp_path: Path) -> None:
    before = estimate()
    write_estimate(before, tmp_path)
    assert (tmp_path / "scan_landmarks.csv").read_text().startswith("id,x_m,y_m,heading_rad\n3,")
    after = read_estimate(tmp_path)
    for name in (
        "landmark_id",
        "landmark",
        "pose_landmark_id",
        "pose_landmarks",
        "joint_covariance",
    ):
        assert np.array_equal(getattr(after, name), getattr(before, name)), name
    assert len(before.joint_mean) == len(before.joint_covariance)
    assert np.array_equal(after.landmark_covariances()[1], before.joint_covariance[5:7, 5:7])
    given = read_external(tmp_path)
    assert np.array_equal(present(given.joint_covariance), before.joint_covariance[:7, :7])


def test_without_scan_landmarks_there_is_no_such_file(tmp_path: Path) -> None:
    whole = estimate()
    plain = replace(
        whole,
        joint_covariance=whole.joint_covariance[:7, :7],
        pose_landmark_id=np.zeros(0, dtype=np.int64),
        pose_landmarks=np.zeros((0, 3)),
    )
    write_estimate(plain, tmp_path)
    assert not (tmp_path / "scan_landmarks.csv").exists()
    assert len(read_estimate(tmp_path).pose_landmarks) == 0


def test_a_file_without_its_covariance_is_told(tmp_path: Path) -> None:
    write_estimate(estimate(), tmp_path)
    (tmp_path / "scan_landmarks.csv").unlink()
    with pytest.raises(InputError, match=r"has shape \(13, 13\), expected \(7, 7\)"):
        read_estimate(tmp_path)
    with pytest.raises(InputError, match=r"expected \(7, 7\)"):
        read_external(tmp_path)


def test_landmarks_with_a_direction_are_blocks_of_three() -> None:
    rng = np.random.default_rng(1)
    covariance = random_covariance(rng, 13)
    e = Gaussian(rng.standard_normal(13), covariance, Layout.packed(3, 2, 2))
    turned = replace(e, mean=e.mean + 2.0 * np.pi * (np.eye(13)[9] - np.eye(13)[12]))
    same = compare(e, turned, e, turned)
    assert len(same.landmarks) == 2
    assert len(same.pose_landmarks) == 2
    assert max(g.sigma for g in (same.algebra, same.model, same.linearisation)) < 1e-12
    off = replace(e, mean=e.mean + 0.5 * np.eye(13)[12])
    found = compare(off, e, e, e)
    assert found.pose_landmarks[1].distance_sigma > 0.01
    assert found.pose_landmarks[1].difference_m == 0.0
    assert found.pose_landmarks[0].distance_sigma == 0.0
    assert max(block.distance_sigma for block in found.landmarks) == 0.0
    own = covariance[10:, 10:]
    d = np.array([0.0, 0.0, 0.5])
    assert found.pose_landmarks[1].distance_sigma == pytest.approx(
        np.sqrt(d @ np.linalg.solve(own, d) / 3.0)
    )
    shifted = compare(replace(e, mean=e.mean + 3.0 * np.eye(13)[7]), e, e, e)
    assert shifted.landmark_difference_rms_m == pytest.approx(1.5)


def test_different_kinds_are_not_compared() -> None:
    e = Gaussian(np.zeros(9), np.eye(9), Layout.packed(3, 3))
    with pytest.raises(ValueError, match="3 point landmarks compared with 0"):
        compare(e, e, e, replace(e, layout=Layout.packed(3, 0, 2)))
