"""Draws of the smoother's exact posterior, and whether chains converged."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import graphslam.sampling as module
from graphslam.arrays import Array
from graphslam.chain_diagnostics import (
    chain_evidence,
    effective_sample_size,
    monte_carlo_error,
    split_r_hat,
)
from graphslam.graph_builder import build_graph, to_values
from graphslam.marginals import SingularProblemError
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.sampling import (
    ChainPotential,
    Chains,
    NotConvergedError,
    PosteriorDraws,
    Potential,
    SamplingOptions,
    SlamPotential,
    WhitenedPotential,
    laplace_root,
    sample_chains,
    sample_posterior,
    trajectory,
)
from graphslam.smoother import SmootherEvidence, smooth
from tests.graphslam.worlds import loop

FEW = SamplingOptions(draws=20, warm_up=60)
BOUND = 5.0
"""Standard errors, of 31 degrees of freedom: a false alarm in 50,000 figures."""


def everything() -> SlamProblem:
    """A short drive with every factor that can be sampled."""
    problem = loop(3, 12).problem
    rng = np.random.default_rng(8)
    root = rng.standard_normal((2, 3, 3)) * 0.1 + 0.3 * np.eye(3)
    spread = root @ root.transpose(0, 2, 1)
    return replace(
        problem,
        position_pose=np.array([2, 7]),
        position=rng.standard_normal((2, 2)) + (45.0, 3.0),
        position_covariance=spread[:, :2, :2],
        lever_m=(0.7, -0.4),
        surveyed=rng.standard_normal((2, 2)) + (44.0, 10.0),
        surveyed_covariance=spread[:, 1:, 1:],
        loop_closures=LoopClosures(
            np.array([1, 9]), np.array([8, 2]), rng.standard_normal((2, 3)), spread
        ),
    )


def states(problem: SlamProblem, count: int, spread: float) -> Array:
    """Random states (n, count) around the true drive."""
    rng = np.random.default_rng(5)
    world = loop(3, 12)
    true = np.concatenate((world.poses.ravel(), world.landmarks.ravel()))
    return true[:, None] + spread * rng.standard_normal((problem.state_dimension, count))


def gtsam_error(problem: SlamProblem, state: Array) -> float:
    poses, points = np.split(state, [3 * problem.pose_count])
    seen = np.arange(problem.landmark_count)
    values = to_values(poses.reshape(-1, 3), points.reshape(-1, 2), seen)
    return float(build_graph(problem).error(values))


def by_differences(potential: Potential, state: Array, step: float = 1e-6) -> Array:
    moved = np.hstack((state + step * np.eye(len(state)), state - step * np.eye(len(state))))
    energy = potential(moved)[0]
    return np.asarray((energy[: len(state)] - energy[len(state) :]) / (2.0 * step))


def flipped(potential: Potential) -> Potential:
    """Gradient of the wrong sign."""

    def wrong(state: Array) -> tuple[Array, Array]:
        energy, gradient = potential(state)
        return energy, -gradient

    return wrong


class AcceptsAll:
    """A generator for chains without the Metropolis correction: every chance is taken."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def standard_normal(self, size: tuple[int, int]) -> Array:
        return self._rng.standard_normal(size)

    def uniform(self, low: float = 0.0, high: float = 1.0, size: int = 0) -> float | Array:
        return -np.ones(size) if size else self._rng.uniform(low, high)


def linear(covariance: Array) -> Potential:
    """A Gaussian with mean zero."""
    weight = np.linalg.inv(covariance)

    def potential(state: Array) -> tuple[Array, Array]:
        return 0.5 * np.sum(state * (weight @ state), axis=0), weight @ state

    return potential


def far_bearing(**changes: float) -> SlamProblem:
    """One pose, one point 10 m ahead of it, with heading and bearing that are badly known."""
    sigma = {"heading": 0.5, "range": 0.5, "bearing": 0.3} | changes
    return SlamProblem(
        prior_pose=np.array([1.0, -2.0, 0.4]),
        prior_covariance=np.diag((0.1, 0.1, sigma["heading"])) ** 2,
        increment=np.zeros((0, 3)),
        increment_covariance=np.zeros((0, 3, 3)),
        measurement_pose=np.zeros(1, dtype=np.intp),
        measurement_landmark=np.zeros(1, dtype=np.intp),
        z=np.array([[10.0, 0.3]]),
        sigma=np.array([[sigma["range"], sigma["bearing"]]]),
        landmark_count=1,
    )


def solved(problem: SlamProblem) -> SmootherEvidence:
    return smooth(problem, {})


def drawn(problem: SlamProblem) -> PosteriorDraws:
    s = solved(problem)
    options = SamplingOptions(draws=1000)
    return sample_posterior(problem, s.poses, s.landmarks, np.random.default_rng(0), options)


def exact_point(problem: SlamProblem) -> tuple[Array, Array]:
    """Mean (2,) and covariance (2, 2) of far_bearing's point by quadrature.

    In polar coordinates the density is r exp(-range^2 / 2) times those of the two angles; that of
    the heading has the factor det V = 2 (1 - cos) / turn^2, which the translation leaves.
    """
    angle = np.linspace(-np.pi, np.pi, 200_001)[1:]
    safe = np.where(np.abs(angle) < 1e-9, 1e-9, angle)
    heading = np.exp(-0.5 * angle**2 / problem.prior_covariance[2, 2])
    heading *= 4.0 * np.sin(0.5 * safe) ** 2 / safe**2
    bearing = np.exp(-0.5 * (angle / problem.sigma[0, 1]) ** 2)

    def harmonic(k: int) -> complex:
        turn = problem.prior_pose[2] + problem.z[0, 1]
        waves = (np.sum(d * np.cos(k * angle)) / np.sum(d) for d in (heading, bearing))
        return complex(np.prod(list(waves)) * np.exp(1j * k * turn))

    r = problem.z[0, 0] + problem.sigma[0, 0] * np.linspace(-8.0, 8.0, 20_001)
    weight = r * np.exp(-0.5 * ((r - problem.z[0, 0]) / problem.sigma[0, 0]) ** 2)
    first, second = (np.sum(weight * r**k) / np.sum(weight) for k in (1, 2))
    one, two = harmonic(1), harmonic(2)
    apart = first * np.array((one.real, one.imag))
    squares = 0.5 * second * np.array(((1.0 + two.real, two.imag), (two.imag, 1.0 - two.real)))
    # the position's own scatter about zero, given the turn: V S V^T, with S isotropic here
    share = np.sum(heading * 4.0 * np.sin(0.5 * safe) ** 2 / safe**2) / np.sum(heading)
    own = problem.prior_covariance[0, 0] * share * np.eye(2)
    return problem.prior_pose[:2] + apart, squares - np.outer(apart, apart) + own


def test_energy_is_that_of_the_smoothers_graph() -> None:
    """Also where the turns are large."""
    problem = everything()
    at = states(problem, 4, 0.3)
    for turns in (1.0, np.array([2.0, -1.0, 5.0, 0.0])):
        at[2 : 3 * problem.pose_count : 3] *= turns
        expected = [gtsam_error(problem, column) for column in at.T]
        np.testing.assert_allclose(SlamPotential(problem)(at)[0], expected, rtol=1e-10)


def test_a_bearing_that_is_not_wrapped_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = replace(far_bearing(bearing=0.05), z=np.array([[10.0, 3.1]]))
    at = np.array([[1.0, -2.0, 0.4, -9.0, -3.0]]).T
    expected = gtsam_error(problem, at[:, 0])
    assert SlamPotential(problem)(at)[0][0] == pytest.approx(expected, rel=1e-10)
    monkeypatch.setattr(module, "wrap_angle", lambda angle: angle)
    assert SlamPotential(problem)(at)[0][0] != pytest.approx(expected, rel=0.5)


@pytest.mark.parametrize("chained", [False, True])
def test_gradient_is_that_of_central_differences(chained: bool) -> None:
    problem = everything()
    potential: Potential = SlamPotential(problem)
    at = states(problem, 1, 0.2)
    at[0] += 1.0  # the residuals are large
    if chained:
        potential = chain = ChainPotential(SlamPotential(problem))
        at = chain.to_chain(at)
    gradient, expected = potential(at)[1][:, 0], by_differences(potential, at)
    scale = 1e-6 * np.abs(expected).max()
    np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=scale)
    assert np.abs(flipped(potential)(at)[1][:, 0] - expected).max() > 1e5 * scale


def test_gradient_of_a_motion_without_turn_is_that_of_central_differences() -> None:
    problem = loop(3, 12).problem
    potential = SlamPotential(problem)
    at = states(problem, 1, 0.0)
    at[2] = problem.prior_pose[2] + 3e-5
    gradient, expected = potential(at)[1][:, 0], by_differences(potential, at)
    np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


def test_coordinates_along_the_path_keep_volume_and_lead_back() -> None:
    problem = everything()
    chained = ChainPotential(SlamPotential(problem))
    at = states(problem, 3, 0.3)
    q = chained.to_chain(at)
    np.testing.assert_allclose(chained.to_world(q), at, atol=1e-12)
    moved, step = q[:, :1], 1e-6
    ahead = chained.to_world(moved + step * np.eye(len(q)))
    behind = chained.to_world(moved - step * np.eye(len(q)))
    sign, logarithm = np.linalg.slogdet((ahead - behind) / (2.0 * step))
    assert sign == 1.0
    assert logarithm == pytest.approx(0.0, abs=1e-6)


def test_laplace_root_is_the_smoothers_joint_marginal() -> None:
    problem = everything()
    s = solved(problem)
    optimum = np.concatenate((s.poses.ravel(), s.landmarks.ravel()))
    chained = ChainPotential(SlamPotential(problem))
    root = laplace_root(chained, problem, optimum)
    centre, step = chained.to_chain(optimum[:, None]), 1e-6
    to_world = chained.to_world(centre + step * root) - chained.to_world(centre - step * root)
    to_world /= 2.0 * step
    expected = s.joint(range(problem.pose_count), range(problem.landmark_count))
    scale = np.sqrt(np.diag(expected))
    apart = (to_world @ to_world.T - expected) / np.outer(scale, scale)
    assert np.abs(apart).max() < 1e-6


def test_trajectory_leads_back_and_keeps_volume() -> None:
    """With the Metropolis step on the energy this is detailed balance."""
    problem = far_bearing()
    s = solved(problem)
    potential = WhitenedPotential(problem, s.poses, s.landmarks)

    def end(both: Array) -> Array:
        w, v = np.split(both, 2)
        point, after = trajectory(potential, module._Point(w, *potential(w)), v, 0.4, 3)
        return np.vstack((point.state, after))

    rng, step = np.random.default_rng(0), 1e-6
    both = rng.standard_normal((10, 1))
    there = end(both)
    back = end(np.vstack((there[:5], -there[5:])))
    np.testing.assert_allclose(np.vstack((back[:5], -back[5:])), both, atol=1e-9)
    jacobian = (end(both + step * np.eye(10)) - end(both - step * np.eye(10))) / (2.0 * step)
    assert np.linalg.slogdet(jacobian)[1] == pytest.approx(0.0, abs=1e-5)


def linear_covariance() -> Array:
    """Up to 3 times wider and narrower than the standard one that the chains assume."""
    rng = np.random.default_rng(4)
    axes, _ = np.linalg.qr(rng.standard_normal((6, 6)))
    return np.asarray(axes @ np.diag((0.3, 0.5, 0.8, 1.0, 2.0, 3.0)) @ axes.T)


def linear_misfit(chains: Chains, covariance: Array) -> float:
    """Largest deviation of mean and variances along the axes, in Monte Carlo standard errors."""
    _, axes = np.linalg.eigh(covariance)
    along = chains.draws @ axes
    variance = np.diag(axes.T @ covariance @ axes)
    means = along.mean(axis=(0, 1)) / monte_carlo_error(along)
    squares = along**2
    spread = (squares.mean(axis=(0, 1)) - variance) / monte_carlo_error(squares)
    return float(np.abs(np.concatenate((means, spread))).max())


@pytest.mark.parametrize(
    ("draws", "right"), [(np.random.default_rng(1), True), (AcceptsAll(1), False)]
)
def test_a_linear_problem_has_its_exact_mean_and_covariance(draws: Any, right: bool) -> None:
    """Without the Metropolis correction it has not."""
    covariance = linear_covariance()
    chains = sample_chains(linear(covariance), 6, draws)
    assert (linear_misfit(chains, covariance) < BOUND) is right
    assert chains.acceptance > 0.6


def test_a_gradient_of_the_wrong_sign_is_seen_in_the_step() -> None:
    covariance = linear_covariance()
    right = sample_chains(linear(covariance), 6, np.random.default_rng(1), FEW)
    wrong = sample_chains(flipped(linear(covariance)), 6, np.random.default_rng(1), FEW)
    assert wrong.step < 0.2 * right.step


def test_a_standard_normal_is_accepted_always_and_forgotten_at_once() -> None:
    chains = sample_chains(linear(np.eye(40)), 40, np.random.default_rng(1))
    assert chains.acceptance == pytest.approx(1.0, abs=1e-9)
    assert effective_sample_size(chains.draws).min() > 0.8 * 8000


@pytest.mark.slow
@pytest.mark.parametrize(("heading", "bearing"), [(0.02, 0.25), (0.3, 0.2)])
def test_a_curved_posterior_is_that_of_quadrature(heading: float, bearing: float) -> None:
    problem = far_bearing(heading=heading, bearing=bearing)
    mean, covariance = exact_point(problem)
    found = drawn(problem)
    assert found.converged, found.lacks
    m, m_error = found.mean()
    p, p_error = found.covariance()

    def misfit(of_mean: Array, of_covariance: Array) -> float:
        apart = (of_mean[3:] - mean) / m_error[3:]
        spread = (of_covariance[3:, 3:] - covariance) / p_error[3:, 3:]
        return float(max(np.abs(apart).max(), np.abs(spread).max()))

    assert misfit(m, p) < BOUND
    assert misfit(*solved(problem).marginal()) > 1.5 * BOUND  # where the chains start


def test_draws_are_repeatable_to_the_bit() -> None:
    one, same, other = (
        sample_chains(linear(linear_covariance()), 6, np.random.default_rng(seed), FEW).draws
        for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


def gaussian_draws(covariance: Array, chains: int = 16, length: int = 500) -> PosteriorDraws:
    rng = np.random.default_rng(2)
    size = len(covariance)
    root = np.linalg.cholesky(covariance)
    draws = rng.standard_normal((chains, length, size)) @ root.T
    return PosteriorDraws(draws=draws, acceptance=1.0, step=1.0, evidence=chain_evidence(draws))


def test_a_gaussian_is_judged_by_its_coverage_and_optimism() -> None:
    covariance = np.diag((0.1, 0.2, 0.3, 1.0, 2.0)) ** 2
    found = gaussian_draws(covariance)
    given = covariance.copy()
    given[3, 3] *= 0.5
    given[4, 4] *= 1.5
    every = found.judge(np.zeros(5), given, np.arange(5))
    pose = found.judge(np.zeros(5), given, np.arange(3))
    point = found.judge(np.zeros(5), 0.5 * covariance, np.array([3, 4]))
    inside = 1.0 - np.exp(-0.25 * 5.991464547107979)  # of a 2D Gaussian at half the variance
    for value, expected in (
        (every.least, 0.5),
        (every.largest, 1.5),
        (pose.coverage, 0.95),
        (pose.least, 1.0),
        (pose.largest, 1.0),
        (point.coverage, inside),
    ):
        assert abs(value.value - expected) < BOUND * value.error
        assert value.error < 0.03 * expected


def test_an_exact_covariance_of_many_numbers_is_not_called_wrong() -> None:
    """The extremes of a sampled covariance would be 0.84 and 1.19 here."""
    size = 63
    found = gaussian_draws(np.eye(size))
    every = found.judge(np.zeros(size), np.eye(size), np.arange(size))
    for one in every.least, every.largest:
        assert abs(one.value - 1.0) < BOUND * one.error


def test_headings_are_compared_within_half_a_turn() -> None:
    found = gaussian_draws(0.01 * np.eye(3))
    mean = np.array([0.0, 0.0, 2.0 * np.pi])
    assert found.judge(mean, 0.01 * np.eye(3), np.arange(3)).coverage.value > 0.9


def test_what_has_not_converged_gives_no_judgement() -> None:
    found = gaussian_draws(np.eye(3))
    found.draws[0] += 2.0
    stuck = replace(found, evidence=chain_evidence(found.draws))
    assert "R-hat" in stuck.lacks
    for call in (
        stuck.mean,
        stuck.covariance,
        stuck.skewness,
        lambda: stuck.judge(np.zeros(3), np.eye(3), np.arange(3)),
    ):
        with pytest.raises(NotConvergedError, match="not converged: R-hat"):
            call()


@pytest.mark.parametrize("acceptance", [0.1, float("nan")])
def test_low_acceptance_is_not_converged(acceptance: float) -> None:
    assert "acceptance" in replace(gaussian_draws(np.eye(3)), acceptance=acceptance).lacks


def test_few_draws_are_not_converged() -> None:
    assert "effective sample size" in gaussian_draws(np.eye(3), 4, 90).lacks


def test_a_number_that_never_changes_is_not_converged() -> None:
    found = gaussian_draws(np.eye(3))
    found.draws[:, :, 1] = 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        assert replace(found, evidence=chain_evidence(found.draws)).lacks


def test_r_hat_flags_chains_that_do_not_mix() -> None:
    rng = np.random.default_rng(0)
    same = rng.standard_normal((4, 400, 1))
    apart, wide, drift = same.copy(), same.copy(), same.copy()
    apart[0] += 1.0
    wide[0] *= 3.0
    drift += np.linspace(-1.0, 1.0, 400)[:, None]
    assert chain_evidence(same).r_hat[0] < 1.01
    for wrong in (apart, wide, drift):
        assert chain_evidence(wrong).r_hat[0] > 1.03
    assert split_r_hat(wide)[0] < 1.01  # which is why the draws are folded, too


@pytest.mark.parametrize("memory", [-0.3, 0.0, 0.6, 0.9])
def test_effective_sample_size_of_an_autoregression(memory: float) -> None:
    rng = np.random.default_rng(0)
    draws = np.empty((8, 2000, 20))
    draws[:, 0] = rng.standard_normal((8, 20))
    noise = np.sqrt(1.0 - memory**2) * rng.standard_normal(draws.shape)
    for i in range(1, 2000):
        draws[:, i] = memory * draws[:, i - 1] + noise[:, i]
    expected = 16_000 * (1.0 - memory) / (1.0 + memory)
    np.testing.assert_allclose(effective_sample_size(draws), expected, rtol=0.3)
    squared = np.mean(monte_carlo_error(draws) ** 2)
    np.testing.assert_allclose(squared, 1.0 / expected, rtol=0.2)


def test_what_cannot_be_sampled_is_refused() -> None:
    long = loop(0, 350).problem
    poses, points = np.zeros((350, 3)), np.zeros((long.landmark_count, 2))
    with pytest.raises(ValueError, match="expected at most 1000"):
        sample_posterior(long, poses, points, np.random.default_rng(0))
    closed = replace(everything().loop_closures, kernel="huber")
    with pytest.raises(ValueError, match="robust kernel"):
        SlamPotential(replace(everything(), loop_closures=closed))
    with pytest.raises(ValueError, match="never measured"):
        SlamPotential(replace(far_bearing(), landmark_count=2))
    with pytest.raises(ValueError, match="draws is 2"):
        SamplingOptions(draws=2)


def test_a_point_of_unknown_bearing_is_singular() -> None:
    problem = replace(far_bearing(), sigma=np.array([[0.5, np.inf]]))
    at = np.array([[1.0, -2.0, 0.4]]), np.array([[9.0, 3.0]])
    with pytest.raises(SingularProblemError):
        sample_posterior(problem, *at, np.random.default_rng(0))
