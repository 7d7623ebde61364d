from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest

from graphslam import elimination, marginals
from graphslam.arrays import conditional_covariance
from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, build_graph, to_tangent, to_values
from graphslam.layout import POINT, Layout
from graphslam.linear_problem import solve
from graphslam.marginals import SingularProblemError, last_pose_and_landmarks, to_global
from graphslam.optimum import (
    Exploration,
    Minimum,
    Optimality,
    Stationarity,
    chi_square_test,
    stationarity,
)
from graphslam.problem import SlamProblem
from graphslam.recorded_system import (
    RecordedPositions,
    RecordedPrior,
    RecordedRelations,
    RecordedSteps,
    recorded_motion,
    recorded_system,
)
from graphslam.smoother import smooth
from tests.graphslam import worlds
from tests.graphslam.numerics import Array, angle, random_covariance, relative_error


@pytest.fixture(scope="module")
def problem() -> SlamProblem:
    return worlds.loop(1, poses=100).problem


def residuals(problem: SlamProblem, poses: Array, landmarks: Array) -> Array:
    """All whitened residuals, written out without gtsam."""
    parts = [
        np.linalg.solve(np.linalg.cholesky(problem.prior_covariance), poses[0] - problem.prior_pose)
    ]
    for k, (d, c) in enumerate(zip(problem.increment, problem.increment_covariance, strict=True)):
        a, b = poses[k], poses[k + 1]
        local = to_tangent(a[2:])[0] @ (b - a)
        error = local - d
        w = angle(error[2])
        shift = to_tangent(d[2:])[0][:2, :2] @ error[:2]
        s, q = (np.sin(w) / w, (1 - np.cos(w)) / w) if abs(w) > 1e-12 else (1.0, 0.0)
        v = np.linalg.solve(np.array(((s, -q), (q, s))), shift)
        parts.append(np.linalg.solve(np.linalg.cholesky(c), np.array((*v, w))))
    offset = landmarks[problem.measurement_landmark] - poses[problem.measurement_pose, :2]
    r = np.hypot(*offset.T) - problem.z[:, 0]
    bearing = np.arctan2(offset[:, 1], offset[:, 0]) - poses[problem.measurement_pose, 2]
    beta = angle(bearing - problem.z[:, 1])
    parts.append((np.column_stack((r, beta)) / problem.sigma).ravel())
    return np.concatenate(parts)


def test_error_is_half_the_squared_norm_of_the_residuals(problem: SlamProblem) -> None:
    result = smooth(problem, {})
    own = residuals(problem, result.poses, result.landmarks)
    assert np.isclose(result.error, 0.5 * own @ own, rtol=1e-9)
    assert len(own) == problem.residual_dimension


def test_every_start_reaches_the_same_optimum(problem: SlamProblem) -> None:
    rng = np.random.default_rng(0)
    truth = smooth(problem, {})
    shaken = (
        truth.poses + 0.05 * rng.standard_normal(truth.poses.shape),
        truth.landmarks + rng.standard_normal(truth.landmarks.shape),
    )
    result = smooth(problem, {"shaken": shaken})
    assert result.optimality.agreeing == ("shaken", "relaxed")
    assert result.optimality.verified
    assert result.optimality.chi_square.reading == "plausible"
    assert np.allclose(result.poses, truth.poses, atol=1e-5)


def test_entries_are_those_of_the_kinds() -> None:
    layout = Layout(2, 3, 2)
    assert layout.size == 18
    assert layout.point.tolist() == [6, 8, 10]
    assert layout.frame.tolist() == [0, 3, 12, 15]
    assert Layout(1, pose_landmarks=1).frame.tolist() == [0, 3]


def test_a_problem_has_as_many_unknowns_as_its_graph() -> None:
    world = worlds.loop(1)
    seen = np.unique(world.problem.measurement_landmark)
    values = to_values(world.poses, world.landmarks, seen)
    assert values.dim() == world.problem.state_dimension
    assert build_graph(world.problem).linearize(values).jacobian()[0].shape[1] == values.dim()


def test_problems_are_the_same_number_for_number(problem: SlamProblem) -> None:
    gap = problem.increment_covariance.copy()
    gap[0] = np.nan
    gapped = replace(problem, increment_covariance=gap)
    again = replace(gapped, increment_covariance=gap.copy(), z=problem.z.copy())
    assert gapped.same_as(again)
    closures = replace(problem.loop_closures, kernel="cauchy")
    for other in (
        problem,
        replace(gapped, sigma=gapped.sigma * (1.0 + 1e-15)),
        replace(gapped, measurement_landmark=gapped.measurement_landmark[::-1]),
        gapped.prefix(problem.pose_count - 1),
        replace(gapped, loop_closures=closures),
    ):
        assert not gapped.same_as(other)


def test_whole_turns_between_poses_are_counted(problem: SlamProblem) -> None:
    """A robot that spins once between two measurements keeps a continuous heading."""
    spun = problem.increment.copy()
    spun[10, 2] += 2.0 * np.pi
    plain, turned = smooth(problem, {}), smooth(replace(problem, increment=spun), {})
    difference = turned.poses[:, 2] - plain.poses[:, 2]
    assert np.allclose(difference[:11], 0.0, atol=1e-6)
    assert np.allclose(difference[11:], 2.0 * np.pi, atol=1e-6)


def test_marginal_equals_the_dense_inverse(problem: SlamProblem) -> None:
    """Elimination against inverting the whole information matrix."""
    result = smooth(problem, {})
    keys = [POSE_KEY + k for k in range(problem.pose_count)]
    keys += [LANDMARK_KEY + j for j in range(problem.landmark_count)]
    information, _ = result.graph.linearize(result.values).hessian(gtsam.Ordering(keys))
    last = 3 * (problem.pose_count - 1)
    inverse: Array = np.linalg.inv(information).astype(np.float64)
    dense = to_global(inverse[last:, last:], result.poses[-1, 2])
    marginal = result.marginal()
    assert relative_error(marginal.covariance, dense) < 1e-6
    assert np.array_equal(marginal.mean[:3], result.poses[-1])
    assert relative_error(marginal.covariance[:3, :3], result.pose_covariances()[-1]) < 1e-8


def test_global_covariance_is_that_of_the_additive_error() -> None:
    """A tangent-frame covariance turned by the heading: forward noise shows up along it."""
    turned = to_global(np.diag((4.0, 1.0, 0.5, 9.0, 9.0)), np.pi / 2)
    assert np.allclose(turned, np.diag((1.0, 4.0, 0.5, 9.0, 9.0)))


@pytest.mark.parametrize("most_rows", [0.0, 1.5, np.inf])
def test_elimination_in_parts_is_that_at_once(
    problem: SlamProblem, monkeypatch: pytest.MonkeyPatch, most_rows: float
) -> None:
    result = smooth(problem, {})
    linear = result.graph.linearize(result.values)
    arguments = linear, problem.pose_count, problem.landmark_count
    whole = last_pose_and_landmarks(*arguments)
    monkeypatch.setattr(marginals, "PARTS_BEYOND", 0)
    monkeypatch.setattr(elimination, "POSES", 17)
    monkeypatch.setattr(elimination, "MOST_ROWS", most_rows)
    parts = last_pose_and_landmarks(*arguments)
    assert relative_error(parts.covariance, whole.covariance) < 1e-10
    assert np.abs(parts.mean - whole.mean).max() < 1e-9
    # A row too many or too few is seen.
    root = elimination._root
    monkeypatch.setattr(elimination, "_root", lambda rows: np.delete(root(rows), -2, axis=0))
    with pytest.raises((AssertionError, SingularProblemError)):
        assert relative_error(last_pose_and_landmarks(*arguments)[1], whole.covariance) < 1e-3


def test_parts_are_joined_two_by_two(problem: SlamProblem, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a knockout: few wait at a time, and none is joined again and again."""
    result, joined, eliminated = smooth(problem, {}), elimination._joined, elimination._eliminated
    waiting: list[tuple[object, int]] = []  # with the joins behind each
    most = [0, 0]

    def eliminate(*arguments: Any) -> Any:
        waiting.append((eliminated(*arguments), 0))
        most[0] = max(most[0], len(waiting))
        return waiting[-1][0]

    def join(both: list[Any], *arguments: Any) -> Any:
        behind = []
        for one in both:
            place = next(i for i, (left, _) in enumerate(waiting) if left is one)
            behind.append(waiting.pop(place)[1])
        waiting.append((joined(both, *arguments), max(behind) + 1))
        most[1] = max(most[1], waiting[-1][1])
        return waiting[-1][0]

    monkeypatch.setattr(elimination, "POSES", 7)
    monkeypatch.setattr(elimination, "_eliminated", eliminate)
    monkeypatch.setattr(elimination, "_joined", join)
    kept = [POSE_KEY + problem.pose_count - 1]
    elimination.remaining_rows(result.graph.linearize(result.values), kept)
    parts = -(-problem.pose_count // 7)
    assert parts == 15
    assert most == [4, 4]  # the logarithm of the parts to the base of two, rounded up


@pytest.mark.parametrize("beyond", [0, marginals.PARTS_BEYOND], ids=["in parts", "at once"])
def test_missing_information_is_reported(
    problem: SlamProblem, beyond: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(marginals, "PARTS_BEYOND", beyond)
    monkeypatch.setattr(elimination, "POSES", 17)
    graph = build_graph(problem)
    result = smooth(problem, {})
    linear = graph.linearize(result.values)
    with pytest.raises(SingularProblemError, match="do not fix"):
        last_pose_and_landmarks(linear, problem.pose_count, problem.landmark_count + 1)
    graph.remove(0)  # the prior, which fixes the frame
    linear = graph.linearize(result.values)
    with pytest.raises(SingularProblemError, match="do not fix"):
        last_pose_and_landmarks(linear, problem.pose_count, problem.landmark_count)


@pytest.mark.parametrize("beyond", [0, marginals.PARTS_BEYOND], ids=["large", "small"])
@pytest.mark.parametrize("heading_variance", [0.01, 0.0], ids=["unsure", "exact"])
def test_frozen_smoother_on_one_step_equals_the_kalman_filter(
    heading_variance: float, beyond: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By hand: prior, one step, one measurement of a landmark that a first measurement placed."""
    monkeypatch.setattr(marginals, "PARTS_BEYOND", beyond)
    monkeypatch.setattr(elimination, "POSES", 1)
    rng = np.random.default_rng(2)
    p0 = np.diag((0.1, 0.2, heading_variance))
    q = np.diag((0.05, 0.04, 0.2 * heading_variance))
    r = np.diag((0.01, 0.02))
    f, gx = np.eye(3) + 0.1 * rng.standard_normal((3, 3)), rng.standard_normal((2, 3))
    hv, hl = rng.standard_normal((2, 3)), rng.standard_normal((2, 2)) + 2 * np.eye(2)
    x0, x1, l0 = rng.standard_normal(3), rng.standard_normal(3), rng.standard_normal(2)
    nu = rng.standard_normal(2)
    full = np.zeros((5, 5))
    full[:3, :3], full[:3, 3:], full[3:, :3] = p0, p0 @ gx.T, gx @ p0
    full[3:, 3:] = gx @ p0 @ gx.T + r
    step = np.eye(5)
    step[:3, :3] = f
    predicted = step @ full @ step.T
    predicted[:3, :3] += q
    h = np.hstack((hv, hl))
    gain = predicted @ h.T @ np.linalg.inv(h @ predicted @ h.T + r)
    mean = np.concatenate((x1, l0)) + gain @ nu
    covariance = predicted - gain @ h @ predicted
    measurements = RecordedRelations(
        first=np.array((0, 1)),
        second=np.array((0, 0)),
        first_point=np.array((x0, x1)),
        second_point=np.array((l0, l0)),
        residual=np.array((np.zeros(2), nu)),
        jacobian_first=np.array((-gx, hv)),
        jacobian_second=np.array((np.eye(2), hl)),
        covariance=np.array((r, r)),
    )
    motion = RecordedSteps(x0[None], x1[None], f[None], q[None])
    nothing = RecordedPositions(
        np.zeros(0, dtype=np.intp),
        np.zeros((0, 3)),
        np.zeros((0, 2)),
        np.zeros((0, 2, 3)),
        np.zeros((0, 2, 2)),
    )
    linear = recorded_system(
        RecordedPrior(x0, p0), motion, np.array((0, 1)), {POINT: measurements}, {}, nothing
    )
    frozen = solve(linear, np.array((x0, x1)), {POINT: l0[None]})
    assert relative_error(frozen.mean, mean) < 1e-10
    assert relative_error(frozen.covariance, covariance) < 1e-10


@pytest.mark.parametrize("unit", [(1.0, 1.0, 1.0), (1e4, 1.0, 1e-8)])
def test_units_do_not_say_what_is_without_noise(unit: tuple[float, float, float]) -> None:
    """A step whose noise has two directions of three, and one with all, in any units."""
    rng, scale = np.random.default_rng(4), np.diag(unit)
    flat = rng.standard_normal((3, 2))
    noise = np.array([scale @ one @ scale for one in (flat @ flat.T, random_covariance(rng, 3))])
    nowhere, still = np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1))
    steps = RecordedSteps(nowhere, nowhere, still, noise)
    sigma = recorded_motion(steps, np.arange(3)).sigma
    assert sigma is not None
    assert np.sort(sigma, axis=1).tolist() == [[0.0, 1.0, 1.0], [1.0, 1.0, 1.0]]


def test_the_limit_on_the_decrement_is_tight(problem: SlamProblem) -> None:
    """A hundredth of a sigma beside the optimum already counts as not there."""
    result = smooth(problem, {})
    sigma = float(np.sqrt(result.pose_covariances()[-1, 0, 0]))
    poses = result.poses.copy()
    poses[-1, 0] += 1e-2 * sigma
    beside = to_values(poses, result.landmarks, np.unique(problem.measurement_landmark))
    found = stationarity(result.graph, beside)
    assert 1e-6 < found.decrement < 0.1
    assert not found.holds


def test_without_degrees_of_freedom_nothing_is_read_into_chi_square() -> None:
    assert chi_square_test(0.0, 0).reading == "plausible"


@pytest.mark.parametrize(
    ("error", "reading"), [(10.0, "too low"), (50.0, "plausible"), (100.0, "too high")]
)
def test_chi_square_has_two_sides(error: float, reading: str) -> None:
    test = chi_square_test(error, 100)
    assert test.reading == reading
    assert 50 < test.lower < 100 < test.upper < 160
    on_the_edge = replace(test, chi2=test.upper), replace(test, chi2=test.lower)
    assert [one.reading for one in on_the_edge] == ["plausible", "plausible"]


SOUND = Optimality(
    stationarity=Stationarity(0.0, definite=True),
    chi_square=chi_square_test(50.0, 100),
    agreeing=("ekf", "relaxed"),
    agreed=True,
)
LOWEST = Minimum(error=50.0, starts=3, pose=0, pose_m=0.0, landmark=0, landmark_m=0.0)
AS_LOW = replace(LOWEST, starts=1, pose=2, pose_m=1.5, landmark=4, landmark_m=3.0)


def test_an_optimum_with_all_evidence_is_verified() -> None:
    assert SOUND.verified
    assert SOUND.lacks == ""


@pytest.mark.parametrize(
    ("broken", "lacks"),
    [
        ({"stationarity": Stationarity(1.0, definite=True)}, "strict local minimum"),
        ({"stationarity": Stationarity(0.0, definite=False)}, "strict local minimum"),
        ({"chi_square": chi_square_test(450.0, 100)}, "chi-square 900 lies above"),
        ({"agreed": False, "agreeing": ("ekf",)}, "only the start ekf reached the lowest error"),
        ({"distance_sigma": 0.2}, "0.2 sigma from the optimum"),
        ({"exploration": Exploration(complete=False, hops=3)}, "by 3 hops"),
        (
            {"exploration": Exploration((LOWEST, AS_LOW))},
            "another minimum, 3 m away, has the same error",
        ),
    ],
)
def test_an_optimum_without_one_kind_of_evidence_is_not(broken: dict[str, Any], lacks: str) -> None:
    optimality = replace(SOUND, **broken)
    assert not optimality.verified
    assert lacks in optimality.lacks


def test_a_misfit_is_accepted_where_that_is_asked_for() -> None:
    misfit = replace(SOUND, chi_square=chi_square_test(450.0, 100))
    assert replace(misfit, accept_misfit=True).verified
    low = replace(SOUND, chi_square=chi_square_test(5.0, 100))
    assert low.chi_square.reading == "too low"
    assert low.verified


def test_the_conditional_covariance_is_the_limit_for_a_singular_one() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 6)) * np.array([1e-4, 1.0, 1e3, 1.0, 10.0, 0.1])[:, None]
    basis = rng.normal(size=(6, 2))
    regular = root @ root.T
    inside = np.linalg.inv(basis.T @ np.linalg.inv(regular) @ basis)
    found = conditional_covariance(regular, basis)
    scale = np.sqrt(np.diag(regular))
    expected = regular - basis @ inside @ basis.T
    assert np.allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-9)
    for singular in (root[:, :4] @ root[:, :4].T, np.zeros((6, 6)), np.diag((1.0, 0, 2, 0, 3, 0))):
        lifted = singular + 1e-9 * np.eye(6)
        limit = lifted - basis @ np.linalg.inv(basis.T @ np.linalg.inv(lifted) @ basis) @ basis.T
        found = conditional_covariance(singular, basis)
        assert np.allclose(found, limit, atol=1e-5 * max(1.0, np.abs(singular).max()))
    first = np.eye(6, 2)
    assert np.allclose(conditional_covariance(np.diag((4.0, 9.0, 1, 0, 0, 2)), first)[:2], 0.0)
