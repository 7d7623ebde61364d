"""Motions between poses that do not follow each other, in problems, graphs and g2o files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from graphslam.g2o import G2oContents, read_g2o
from graphslam.graph_builder import build_graph, last_poses, to_tangent
from graphslam.increments import dead_reckoned
from graphslam.marginals import pose_covariances
from graphslam.optimisers import OPTIMISERS
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.smoother import SmootherOptions, smooth
from tests.graphslam.g2o_files import CLOSED_ELSEWHERE, assert_survives
from tests.graphslam.numerics import Array, random_covariance, relative_error
from tests.graphslam.worlds import chain


def circle(loop_closures: LoopClosures, seed: int = 0) -> SlamProblem:
    """Twelve noisy increments round a circle."""
    rng = np.random.default_rng(seed)
    spread = np.array([1e-3 * random_covariance(rng, 3) for _ in range(12)])
    noise = np.array([rng.multivariate_normal(np.zeros(3), c) for c in spread])
    moves = np.tile((1.0, 0.2, 2.0 * np.pi / 12), (12, 1)) + noise
    return chain(
        moves,
        spread,
        prior_pose=np.array((1.0, 2.0, 0.7)),
        prior_covariance=1e-2 * random_covariance(rng, 3),
        loop_closures=loop_closures,
    )


def loop_closures(kernel: str = "none") -> LoopClosures:
    """Back to the start, one the other way round in time, and one beside an increment."""
    rng = np.random.default_rng(7)
    step = (1.0, 0.2, 2.0 * np.pi / 12)
    even = dead_reckoned(np.zeros(3), np.tile(step, (12, 1)))
    first, second = np.array((0, 9, 4)), np.array((12, 2, 5))
    motion = []
    for i, j in zip(first, second, strict=True):
        local = to_tangent(even[i, 2:])[0] @ (even[j] - even[i])
        motion.append(local + 0.02 * rng.standard_normal(3))
    spread = np.array([4e-4 * random_covariance(rng, 3) for _ in range(3)])
    return LoopClosures(first, second, np.array(motion), spread, kernel)


def whitened(start: Array, end: Array, motion: Array, covariance: Array) -> Array:
    """(3,) how a motion between two poses misses a measured one, as a right perturbation."""
    local = to_tangent(start[2:])[0] @ (end - start)
    off = local - motion
    turn = (off[2] + np.pi) % (2.0 * np.pi) - np.pi
    way = to_tangent(motion[2:])[0][:2, :2] @ off[:2]
    s, q = (np.sin(turn) / turn, (1.0 - np.cos(turn)) / turn) if turn else (1.0, 0.0)
    twist = np.append(np.linalg.solve(np.array(((s, -q), (q, s))), way), turn)
    result: Array = np.linalg.solve(np.linalg.cholesky(covariance), twist)
    return result


def oracle(problem: SlamProblem) -> tuple[Array, Array, float]:
    """Poses, covariances (K, 3, 3) and error of the optimum, by dense least squares."""
    turn = to_tangent(problem.prior_pose[2:])[0]
    closed = problem.loop_closures
    own = range(len(problem.increment))

    def residuals(state: Array) -> Array:
        x = state.reshape(-1, 3)
        parts = [whitened(np.zeros(3), x[0], problem.prior_pose, turn @ problem.prior_covariance
                          @ turn.T)]  # fmt: skip
        for i, j, d, c in (
            *zip(own, own, problem.increment, problem.increment_covariance, strict=True),
            *zip(closed.first, closed.second - 1, closed.motion, closed.covariance, strict=True),
        ):
            parts.append(whitened(x[i], x[j + 1], d, c))
        return np.concatenate(parts)

    start = dead_reckoned(problem.prior_pose, problem.increment).ravel()
    end = least_squares(residuals, start, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-12)
    inverse = np.linalg.inv(end.jac.T @ end.jac).reshape(len(start) // 3, 3, -1, 3)
    k = np.arange(problem.pose_count)
    return end.x.reshape(-1, 3), inverse[k, :, k], float(end.cost)


def test_dimensions_count_closures() -> None:
    without, with_them = circle(LoopClosures()), circle(loop_closures())
    assert without.residual_dimension == 3 * 13
    assert with_them.residual_dimension == 3 * 16
    assert without.state_dimension == with_them.state_dimension == 3 * 13
    assert build_graph(with_them).size() == 16
    assert last_poses(with_them)[-3:].tolist() == [12, 9, 5]


@pytest.mark.parametrize(("poses", "left"), [(13, [0, 1, 2]), (12, [1, 2]), (10, [1, 2]), (9, [2]),
                                             (6, [2]), (5, []), (1, [])])  # fmt: skip
def test_a_prefix_keeps_what_its_poses_close(poses: int, left: list[int]) -> None:
    whole = circle(loop_closures("cauchy"))
    part = whole.prefix(poses)
    assert part.pose_count == poses
    assert part.loop_closures.kernel == "cauchy"
    for name in ("first", "second", "motion", "covariance"):
        kept = getattr(whole.loop_closures, name)[left]
        assert np.array_equal(getattr(part.loop_closures, name), kept)
    assert part.loop_closures.last.max(initial=0) < poses
    assert build_graph(part).size() == poses + len(left)


@pytest.mark.slow
@pytest.mark.parametrize("optimiser", OPTIMISERS)
def test_the_optimum_is_that_of_dense_least_squares(optimiser: str) -> None:
    problem = circle(loop_closures())
    result = smooth(problem, {}, options=SmootherOptions(optimiser=optimiser))
    poses, covariance, error = oracle(problem)
    assert relative_error(result.poses, poses) < 1e-6
    assert abs(result.error - error) < 1e-6 * error
    assert result.optimality.verified
    assert relative_error(result.pose_covariances(), covariance) < 1e-5
    # Taken the wrong way round, with the covariance's frame along, it is another problem.
    one = problem.loop_closures
    turned = replace(one, first=one.second, second=one.first)
    other = smooth(replace(problem, loop_closures=turned), {})
    assert np.abs(other.poses - poses).max() > 0.1


def test_closures_must_lie_within_a_fixed_lag() -> None:
    problem = circle(loop_closures())
    held = smooth(problem, {}, options=SmootherOptions("fixed-lag", lag=12))
    assert held.optimality.distance_sigma is not None
    assert held.optimality.distance_sigma < 0.1
    with pytest.raises(ValueError, match="lag is 11, expected at least 12"):
        smooth(problem, {}, options=SmootherOptions("fixed-lag", lag=11))


def test_closures_make_every_pose_surer() -> None:
    """Linearised at the same place."""
    problem = circle(loop_closures())
    result = smooth(problem, {})
    opened = build_graph(replace(problem, loop_closures=LoopClosures()))
    before = pose_covariances(opened, result.values, result.poses[:, 2])
    after = result.pose_covariances()
    least = np.linalg.eigvalsh(before - after)[:, 0]
    assert (least > -1e-9 * np.linalg.eigvalsh(before)[:, 2]).all()
    assert np.trace(after[-1]) < 0.5 * np.trace(before[-1])


def test_a_wild_closure_under_a_kernel_does_little_harm() -> None:
    sound = loop_closures()
    wild = replace(
        sound,
        first=np.append(sound.first, 1),
        second=np.append(sound.second, 7),
        motion=np.vstack((sound.motion, (9.0, -9.0, 1.0))),
        covariance=np.concatenate((sound.covariance, sound.covariance[:1])),
    )
    good = smooth(circle(sound), {}).poses
    harm = {
        kernel: np.abs(smooth(circle(replace(wild, kernel=kernel)), {}).poses - good).max()
        for kernel in ("none", "cauchy")
    }
    assert harm["cauchy"] < 0.05 * harm["none"]
    assert harm["none"] > 1.0


def test_a_kernel_says_nothing_against_sound_closures() -> None:
    plain, robust = (smooth(circle(loop_closures(kernel)), {}) for kernel in ("none", "cauchy"))
    off = (robust.poses - plain.poses) / np.sqrt(np.einsum("kii->ki", plain.pose_covariances()))
    assert np.abs(off).max() < 1.0
    assert plain.optimality.chi_square.dof == 9
    assert robust.optimality.chi_square.dof == 0


def solved(problem: SlamProblem) -> G2oContents:
    return G2oContents(problem, smooth(problem, {}).poses, np.zeros((0, 2)))


def test_closures_survive_g2o_bit_for_bit(tmp_path: Path) -> None:
    assert_survives(solved(circle(loop_closures())), tmp_path / "closed.g2o")


def test_closures_of_another_program_are_read(tmp_path: Path) -> None:
    path = tmp_path / "other.g2o"
    path.write_text(CLOSED_ELSEWHERE)
    problem = read_g2o(path).problem
    closed = problem.loop_closures
    assert problem.pose_count == 3
    assert np.array_equal(problem.increment, ((1.0, 0.0, 1.5), (1.0, 0.0, 1.5)))
    assert closed.first.tolist() == [2, 0]
    assert closed.second.tolist() == [0, 1]
    assert np.array_equal(closed.motion, ((-1.5, 0.5, -3.0), (1.1, 0.0, 1.4)))
    assert relative_error(closed.covariance[0], np.diag((0.25, 0.2, 0.01))) < 1e-12
    assert closed.kernel == "none"
