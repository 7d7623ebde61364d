"""Draws of the smoother's exact posterior: the judge of every Gaussian, the smoother's included.

The density is exp(-1/2 squared norm of the whitened residuals) of the factors of graph_builder,
with respect to dx dy dheading of poses and dx dy of points. Hamiltonian Monte Carlo draws from it,
with the Gaussian part integrated exactly and only the rest by steps (Beskos, Pinski, Sanz-Serna,
Stuart 2011, "Hybrid Monte Carlo on Hilbert spaces"; Shahbaba, Lan, Johnson, Neal 2014, "Split
Hamiltonian Monte Carlo"): where the posterior is gtsam's Gaussian, every proposal is accepted and
forgets the last draw, in any dimension.

The coordinates are those along the path: each pose in the frame of the one before, each point in
the frame of the pose that measured it first. The change has Jacobian 1, as rigid motions have. What
swings with an uncertain heading is curved in the world, and straight there.

One density may have several separate modes; chains find the one that they start in. The smoother's
search for other minima is the evidence that there is one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import gtsam
import numpy as np
from scipy.linalg import cholesky, eigh, solve_triangular
from scipy.sparse import csr_array
from scipy.special import gammaincinv

from graphslam.arrays import Array, Index, wrap_angle
from graphslam.chain_diagnostics import (
    ChainEvidence,
    SampledFigure,
    chain_evidence,
    estimated,
    half_chains,
    monte_carlo_error,
)
from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, build_graph, to_tangent, to_values
from graphslam.marginals import SingularProblemError
from graphslam.problem import SlamProblem

LARGEST_DIMENSION = 1000
"""Unknowns up to which a log is short enough to be sampled."""
LARGEST_R_HAT = 1.01
LEAST_SAMPLE_SIZE = 400.0
"""Vehtari et al. 2021, section 4: of every number, bulk and tails."""
LEAST_ACCEPTANCE = 0.5
TARGET_ACCEPTANCE = 0.95
"""High, for the step that serves the middle of a curved density is too long in its tails."""
MOST_STEPS = 64
"""Steps of one proposal."""
_ANGLE = (0.2 * np.pi, 0.8 * np.pi)
"""Of a proposal's rotation [rad]: a quarter turn forgets the last draw; random, as a fixed one can
return to it."""
_FIRST_STEP, _LEAST_STEP = 0.25 * np.pi, 1e-3
_START_SPREAD = 1.5
"""Standard deviations that the chains start at, in those of gtsam's Gaussian."""
_SMALL_TURN = 1e-4
"""[rad] below which the logarithm of a turn is a series."""

Potential = Callable[[Array], tuple[Array, Array]]
"""Takes states (n, C); returns negative log densities (C,) and their gradients (n, C)."""
Progress = Callable[[int, int], None]


class NotConvergedError(ArithmeticError):
    """The chains do not say what the posterior is."""


@dataclass(frozen=True)
class SamplingOptions:
    """How much is drawn.

    draws: of each chain, after warm_up that are thrown away. chains: run at once.
    """

    draws: int = 500
    warm_up: int = 200
    chains: int = 16

    def __post_init__(self) -> None:
        """Check the choices. Raises ValueError."""
        for name, least in (("draws", 8), ("warm_up", 1), ("chains", 4)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} is {getattr(self, name)}, expected at least {least}")


class Chains(NamedTuple):
    """Draws (C, N, n), their energies (C, N), the mean acceptance, and the step [rad] used."""

    draws: Array
    energy: Array
    acceptance: float
    step: float


@dataclass(frozen=True)
class PosteriorComparison:
    """A Gaussian against the exact posterior, for some numbers of the state.

    Where all variance ratios are equal, chance may put least above largest.

    Attributes:
        coverage: share of the posterior in the Gaussian's 95 % ellipsoid.
        least: least variance ratio, Gaussian to posterior, over all directions; below 1 is
            optimistic.
        largest: largest variance ratio.
    """

    coverage: SampledFigure
    least: SampledFigure
    largest: SampledFigure


def sample_chains(
    potential: Potential,
    dimension: int,
    rng: np.random.Generator,
    options: SamplingOptions | None = None,
    progress: Progress = lambda done, total: None,
) -> Chains:
    """Draw from a density that is about a standard normal one.

    Args:
        potential: Its negative logarithm.
        dimension: Numbers n of a state.
        rng: Equal generators give equal draws, to the bit.
        options: How many.
        progress: Called with the iterations done, and all.

    Returns:
        The draws after the warm-up, in which the step is set so that TARGET_ACCEPTANCE of the
        proposals are accepted; a step of at least the rotation's angle is a single one.
    """
    options = options or SamplingOptions()
    state = _START_SPREAD * rng.standard_normal((dimension, options.chains))
    at = _Point(state, *potential(state))
    log_step, settled = np.log(_FIRST_STEP), []
    total = options.warm_up + options.draws
    for i in range(options.warm_up):
        progress(i, total)
        at, chance = _proposed(potential, at, float(np.exp(log_step)), rng)
        log_step += 1.5 * (i + 1.0) ** -0.6 * (float(chance.mean()) - TARGET_ACCEPTANCE)
        log_step = float(np.clip(log_step, np.log(_LEAST_STEP), np.log(_ANGLE[1])))
        if 2 * i >= options.warm_up:
            settled.append(log_step)
    step = float(np.exp(np.mean(settled or [log_step])))
    draws = np.empty((options.draws, dimension, options.chains))
    energy, chances = np.empty((options.draws, options.chains)), np.empty(options.draws)
    for i in range(options.draws):
        progress(options.warm_up + i, total)
        at, chance = _proposed(potential, at, step, rng)
        draws[i], energy[i], chances[i] = at.state, at.energy, chance.mean()
    ordered = np.ascontiguousarray(draws.transpose(2, 0, 1))
    return Chains(ordered, energy.T, float(chances.mean()), step)


class _Point(NamedTuple):
    """States (n, C) with energies (C,) and gradients (n, C)."""

    state: Array
    energy: Array
    gradient: Array


def _proposed(
    potential: Potential, at: _Point, step: float, rng: np.random.Generator
) -> tuple[_Point, Array]:
    """One Metropolis step of all chains; the chance (C,) that each had to move."""
    angle = rng.uniform(*_ANGLE)
    count = min(MOST_STEPS, int(np.ceil(angle / step)))
    velocity = rng.standard_normal(at.state.shape)
    with np.errstate(over="ignore", invalid="ignore"):
        end, after = trajectory(potential, at, velocity, min(step, angle / count), count)
        rise = end.energy - at.energy + 0.5 * np.sum(after**2 - velocity**2, axis=0)
        chance = np.where(np.isfinite(rise), np.exp(-np.maximum(rise, 0.0)), 0.0)
    moved = rng.uniform(size=len(chance)) < chance
    return _Point(*(np.where(moved, new, old) for new, old in zip(end, at, strict=True))), chance


def trajectory(
    potential: Potential, at: _Point, velocity: Array, angle: float, count: int
) -> tuple[_Point, Array]:
    """Follow Hamilton's equations: kicks by the non-Gaussian force, rotations by the Gaussian one.

    Args:
        potential: The negative log density.
        at: Where the chains are.
        velocity: (n, C) at the start.
        angle: Of each rotation [rad].
        count: Number of rotations.

    Returns:
        Where it ends, and the velocity there. Every part preserves volume and is undone by running
        it from the end with the velocity turned around, so that a Metropolis step on the sum of
        both energies keeps the density.
    """
    cos, sin = np.cos(angle), np.sin(angle)
    point = at
    for _ in range(count):
        velocity = velocity - 0.5 * angle * (point.gradient - point.state)
        state = cos * point.state + sin * velocity
        velocity = cos * velocity - sin * point.state
        point = _Point(state, *potential(state))
        velocity = velocity - 0.5 * angle * (point.gradient - point.state)
    return point, velocity


class SlamPotential:
    """Half the squared norm of a problem's whitened residuals, for many states at once.

    A state has n = 3 K + 2 L numbers: poses x, y, heading in order, then points x, y.
    """

    def __init__(self, problem: SlamProblem) -> None:
        """Precompute the information matrices of the factors.

        Args:
            problem: Its landmarks are points.

        Raises:
            ValueError: It has pose landmarks, loop closures under a robust kernel, or a landmark
                that nothing is known of.
        """
        if problem.pose_landmarks.count:
            raise ValueError("pose landmarks cannot be sampled, only points")
        if len(problem.loop_closures.first) and problem.loop_closures.kernel != "none":
            raise ValueError("loop closures under a robust kernel are not of a Gaussian model")
        if len(problem.seen_landmarks) < problem.landmark_count:
            raise ValueError("a landmark that was never measured cannot be sampled")
        self.problem = problem
        self._poses, self._points = problem.pose_count, problem.landmark_count
        steps, closed = problem.steps, problem.loop_closures
        zero, world = np.zeros(1, dtype=np.intp), np.array([self._poses])
        # The prior is a motion from the world's origin, a pose that is fixed, to the first pose.
        self._first = np.concatenate((world, steps, closed.first))
        self._second = np.concatenate((zero, steps + 1, closed.second))
        self._motion = np.vstack((problem.prior_pose, problem.increment[steps], closed.motion))
        turn = to_tangent(problem.prior_pose[2:3])
        prior = turn @ problem.prior_covariance @ turn.transpose(0, 2, 1)
        every = (prior, problem.increment_covariance[steps], closed.covariance)
        self._motion_weight = np.linalg.inv(np.concatenate(every))
        self._position_weight = np.linalg.inv(problem.position_covariance)
        self._survey_weight = np.linalg.inv(problem.surveyed_covariance)
        surveyed = np.arange(len(problem.surveyed), dtype=np.intp)
        touched = self._first, self._second, problem.measurement_pose, problem.position_pose
        self._to_poses = _sums(np.concatenate(touched), self._poses + 1)
        self._to_points = _sums(
            np.concatenate((problem.measurement_landmark, surveyed)), self._points
        )

    @property
    def dimension(self) -> int:
        """Numbers of a state."""
        return 3 * self._poses + 2 * self._points

    def split(self, state: Array) -> tuple[Array, Array]:
        """Return the poses and points of states.

        Args:
            state: (n, C), or gradients by states.

        Returns:
            Poses (K, 3, C) and points (L, 2, C), views of the state.
        """
        columns, end = state.shape[1], 3 * self._poses
        return state[:end].reshape(-1, 3, columns), state[end:].reshape(-1, 2, columns)

    def __call__(self, state: Array) -> tuple[Array, Array]:
        """Return energies (C,) and gradients (n, C) of states (n, C)."""
        poses, points = self.split(state)
        columns = state.shape[1]
        moved, by_first, by_second = self._motions(np.vstack((poses, np.zeros((1, 3, columns)))))
        seen, by_pose, by_point = self._measurements(poses, points)
        fixed, by_fixed = self._positions(poses)
        known, by_known = self._survey(points)
        pose_terms = np.concatenate((by_first, by_second, by_pose, by_fixed))
        point_terms = np.concatenate((by_point, by_known))
        gradient = np.vstack(
            (
                (self._to_poses @ pose_terms.reshape(len(pose_terms), -1))[:-1].reshape(
                    -1, columns
                ),
                (self._to_points @ point_terms.reshape(len(point_terms), -1)).reshape(-1, columns),
            )
        )
        return moved + seen + fixed + known, gradient

    def _motions(self, poses: Array) -> tuple[Array, Array, Array]:
        """Prior, increments, closures: energies (C,), gradients (B, 3, C) of first and second.

        The residual is Log(m^-1 first^-1 second), the translation being V(turn)^-1 t.
        """
        first, second, m = poses[self._first], poses[self._second], self._motion[:, :, None]
        heading = first[:, 2] + m[:, 2]  # of the frame m^-1 first^-1 turns into
        cos, sin = np.cos(heading), np.sin(heading)
        apart = second[:, :2] - first[:, :2]
        along, left = cos * apart[:, 0] + sin * apart[:, 1], cos * apart[:, 1] - sin * apart[:, 0]
        cos_m, sin_m = np.cos(m[:, 2]), np.sin(m[:, 2])
        t_x = along - (cos_m * m[:, 0] + sin_m * m[:, 1])
        t_y = left - (cos_m * m[:, 1] - sin_m * m[:, 0])
        turn = wrap_angle(second[:, 2] - heading)
        a, slope = _half_cotangent(turn)
        residual = np.stack((a * t_x + 0.5 * turn * t_y, a * t_y - 0.5 * turn * t_x, turn), axis=1)
        weighed = self._motion_weight @ residual
        w_x, w_y = weighed[:, 0], weighed[:, 1]
        g_x, g_y = a * w_x - 0.5 * turn * w_y, a * w_y + 0.5 * turn * w_x
        g_turn = weighed[:, 2] + w_x * (slope * t_x + 0.5 * t_y) + w_y * (slope * t_y - 0.5 * t_x)
        by_second = np.stack((cos * g_x - sin * g_y, sin * g_x + cos * g_y, g_turn), axis=1)
        by_first = -by_second
        by_first[:, 2] += g_x * left - g_y * along
        return 0.5 * np.sum(residual * weighed, axis=(0, 1)), by_first, by_second

    def _measurements(self, poses: Array, points: Array) -> tuple[Array, Array, Array]:
        """Ranges and bearings: energies (C,), gradients (M, 3, C) and (M, 2, C)."""
        p = self.problem
        pose, point = poses[p.measurement_pose], points[p.measurement_landmark]
        apart = point - pose[:, :2]
        distance = np.hypot(apart[:, 0], apart[:, 1])
        bearing = np.arctan2(apart[:, 1], apart[:, 0]) - pose[:, 2]
        off = (distance - p.z[:, :1]) / p.sigma[:, :1]
        turned = wrap_angle(bearing - p.z[:, 1:]) / p.sigma[:, 1:]
        by_range, by_bearing = off / p.sigma[:, :1], turned / p.sigma[:, 1:]
        u_x, u_y = apart[:, 0] / distance, apart[:, 1] / distance
        across = by_bearing / distance
        by_point = np.stack((by_range * u_x - across * u_y, by_range * u_y + across * u_x), axis=1)
        by_pose = np.concatenate((-by_point, -by_bearing[:, None]), axis=1)
        return 0.5 * np.sum(off**2 + turned**2, axis=0), by_pose, by_point

    def _positions(self, poses: Array) -> tuple[Array, Array]:
        """Fixes of the antenna: energies (C,), gradients (G, 3, C)."""
        p = self.problem
        pose = poses[p.position_pose]
        cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        forward, left = p.lever_m
        arm = np.stack((cos * forward - sin * left, sin * forward + cos * left), axis=1)
        residual = pose[:, :2] + arm - p.position[:, :, None]
        weighed = self._position_weight @ residual
        swing = arm[:, 0] * weighed[:, 1] - arm[:, 1] * weighed[:, 0]
        gradient = np.concatenate((weighed, swing[:, None]), axis=1)
        return 0.5 * np.sum(residual * weighed, axis=(0, 1)), gradient

    def _survey(self, points: Array) -> tuple[Array, Array]:
        """Points known beforehand: energies (C,), gradients (S, 2, C)."""
        p = self.problem
        residual = points[: len(p.surveyed)] - p.surveyed[:, :, None]
        weighed = self._survey_weight @ residual
        return 0.5 * np.sum(residual * weighed, axis=(0, 1)), weighed


def _sums(row: Index, count: int) -> csr_array:
    """(count, N): adds terms (N, ...) into the rows (N,) that they belong to."""
    return csr_array((np.ones(len(row)), (row, np.arange(len(row)))), shape=(count, len(row)))


def _half_cotangent(turn: Array) -> tuple[Array, Array]:
    """Half the turn times its cotangent, and the derivative of that in the turn."""
    near = np.abs(turn) < _SMALL_TURN
    safe = np.where(near, 1.0, turn)
    half = 0.5 * safe
    cotangent = 1.0 / np.tan(half)
    value = np.where(near, 1.0 - turn**2 / 12.0, half * cotangent)
    slope = np.where(near, -turn / 6.0, 0.5 * cotangent - 0.5 * half / np.sin(half) ** 2)
    return value, slope


class ChainPotential:
    """The same density in coordinates along the path.

    q (n, C): every pose in the frame of the one before, the first in the world; every point in the
    frame of the pose that measured it first.
    """

    def __init__(self, potential: SlamPotential) -> None:
        """Find the pose that measured each point first; the first pose where none did.

        Args:
            potential: Of states in the world.
        """
        self._world = potential
        problem = potential.problem
        count = problem.pose_count
        anchor = np.full(problem.landmark_count, count, dtype=np.intp)
        np.minimum.at(anchor, problem.measurement_landmark, problem.measurement_pose)
        self._anchor: Index = np.where(anchor < count, anchor, 0)
        self._to_anchor = _sums(self._anchor, count)

    def to_world(self, q: Array) -> Array:
        """Return the states in the world.

        Args:
            q: (n, C) coordinates along the path.

        Returns:
            (n, C), headings as sums of the turns, without wrapping.
        """
        state = np.empty_like(q)
        (steps, local), (poses, points) = self._world.split(q), self._world.split(state)
        poses[:, 2] = np.cumsum(steps[:, 2], axis=0)
        poses[:, :2] = np.cumsum(_turned(steps, _before(poses[:, 2])), axis=0)
        here = poses[self._anchor]
        points[:] = here[:, :2] + _turned(local, here[:, 2])
        return state

    def to_chain(self, state: Array) -> Array:
        """Return the coordinates along the path.

        Args:
            state: (n, C) in the world.

        Returns:
            (n, C), turns as differences of headings, without wrapping.
        """
        q = np.empty_like(state)
        (steps, local), (poses, points) = self._world.split(q), self._world.split(state)
        steps[:] = np.diff(poses, axis=0, prepend=0.0)
        steps[:, :2] = _turned(steps, -_before(poses[:, 2]))
        here = poses[self._anchor]
        local[:] = _turned(points - here[:, :2], -here[:, 2])
        return q

    def __call__(self, q: Array) -> tuple[Array, Array]:
        """Return energies (C,) and gradients (n, C) of coordinates (n, C)."""
        state = self.to_world(q)
        energy, gradient = self._world(state)
        return energy, self.pulled_back(state, gradient)

    def pulled_back(self, state: Array, gradient: Array) -> Array:
        """Return the gradients in the coordinates along the path, by the chain rule.

        As of forces on a chain of rigid bodies: a step moves, and its turn swings, all that comes
        after it.

        Args:
            state: (n, C) in the world, where the gradients are taken.
            gradient: (n, C) in the world.

        Returns:
            (n, C) in the coordinates.
        """
        found, columns = np.empty_like(gradient), gradient.shape[1]
        (poses, points), (by_pose, by_point) = self._world.split(state), self._world.split(gradient)
        steps, local = self._world.split(found)
        carried = self._to_anchor @ by_point.reshape(len(by_point), -1)
        force = _after(by_pose[:, :2] + carried.reshape(-1, 2, columns))
        torque = by_pose[:, 2] + _cross(poses, by_pose)
        torque = _after(torque + self._to_anchor @ _cross(points, by_point))
        steps[:, :2] = _turned(force, -_before(poses[:, 2]))
        steps[:, 2] = torque - _cross(poses, force)
        local[:] = _turned(by_point, -poses[self._anchor, 2])
        return found


def _before(heading: Array) -> Array:
    """Of headings (K, C), that of the pose before; zero before the first."""
    return np.concatenate((np.zeros((1, heading.shape[1])), heading[:-1]))


def _after(terms: Array) -> Array:
    """Sums of terms (K, ...) from each row to the last."""
    return np.cumsum(terms[::-1], axis=0)[::-1]


def _cross(places: Array, forces: Array) -> Array:
    """Moments (N, C) about the origin of forces at places, (N, w, C) each."""
    return places[:, 0] * forces[:, 1] - places[:, 1] * forces[:, 0]


def _turned(places: Array, heading_rad: Array) -> Array:
    """Rotate x, y of (N, w, C) by headings (N, C); returns (N, 2, C)."""
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    x, y = places[:, 0], places[:, 1]
    return np.stack((cos * x - sin * y, sin * x + cos * y), axis=1)


def laplace_root(potential: ChainPotential, problem: SlamProblem, state: Array) -> Array:
    """Return a root of gtsam's covariance at an optimum, in coordinates along the path.

    Args:
        potential: Of the problem.
        problem: What was solved.
        state: (n,) the optimum.

    Returns:
        (n, n) upper triangular; root @ root.T is the covariance of all unknowns.

    Raises:
        SingularProblemError: Some direction is left without information.
    """
    count, poses = problem.pose_count, state[: 3 * problem.pose_count].reshape(-1, 3)
    points = state[3 * count :].reshape(-1, 2)
    values = to_values(poses, points, np.arange(len(points)))
    keys = [*range(POSE_KEY, POSE_KEY + count), *range(LANDMARK_KEY, LANDMARK_KEY + len(points))]
    rows, _ = build_graph(problem).linearize(values).jacobian(gtsam.Ordering(keys))
    turn = to_tangent(poses[:, 2])
    by_state = rows.copy()
    of_poses = rows[:, : 3 * count].reshape(len(rows), count, 3)
    by_state[:, : 3 * count] = np.einsum("rki,kij->rkj", of_poses, turn).reshape(len(rows), -1)
    columns = np.repeat(state[:, None], len(rows), axis=1)
    r = np.linalg.qr(potential.pulled_back(columns, by_state.T).T, mode="r")
    diagonal = np.abs(np.diag(r))
    if len(r) < len(state) or (diagonal <= 1e-13 * np.linalg.norm(r, axis=0)).any():
        raise SingularProblemError("the measurements do not fix every pose and landmark")
    root: Array = solve_triangular(r, np.eye(len(state)))
    return root


class WhitenedPotential:
    """A problem's density around its optimum, so that gtsam's Gaussian is the standard normal."""

    def __init__(self, problem: SlamProblem, poses: Array, landmarks: Array) -> None:
        """Find a root of gtsam's covariance at the optimum.

        Args:
            problem: What was solved.
            poses: (K, 3) of the optimum.
            landmarks: (L, 2) of the optimum.

        Raises:
            ValueError: There are more than LARGEST_DIMENSION unknowns, or there is what cannot be
                sampled (see SlamPotential).
            SingularProblemError: Some direction is left without information.
        """
        if problem.state_dimension > LARGEST_DIMENSION:
            raise ValueError(
                f"{problem.state_dimension} unknowns cannot be sampled, expected at most "
                f"{LARGEST_DIMENSION}"
            )
        self._chain = ChainPotential(SlamPotential(problem))
        self._optimum = np.concatenate((poses.ravel(), landmarks.ravel()))
        self._root = laplace_root(self._chain, problem, self._optimum)
        self._centre = self._chain.to_chain(self._optimum[:, None])
        self._headings = np.arange(2, 3 * problem.pose_count, 3)

    @property
    def dimension(self) -> int:
        """Numbers of a state."""
        return len(self._optimum)

    def __call__(self, whitened: Array) -> tuple[Array, Array]:
        """Return energies (C,) and gradients (n, C)."""
        energy, gradient = self._chain(self._centre + self._root @ whitened)
        return energy, self._root.T @ gradient

    def to_world(self, whitened: Array) -> Array:
        """Return the states in the world.

        Args:
            whitened: (n, C), standard normal where the posterior is gtsam's Gaussian.

        Returns:
            (n, C), headings within pi of the optimum's.
        """
        optimum = self._optimum[:, None]
        apart = self._chain.to_world(self._centre + self._root @ whitened) - optimum
        apart[self._headings] = wrap_angle(apart[self._headings])
        return apart + optimum


@dataclass(frozen=True, kw_only=True)
class PosteriorDraws:
    """Draws of the last pose and all points, with the evidence that they are the posterior's.

    draws: (C, N, m), m = 3 + 2 L, the heading within pi of the optimum's. acceptance: mean of all
    proposals. step: [rad] of a rotation; a quarter turn or more says that the posterior is nearly
    gtsam's Gaussian. evidence: of all n unknowns and of the energy, n + 1 numbers.
    """

    draws: Array
    acceptance: float
    step: float
    evidence: ChainEvidence

    @property
    def lacks(self) -> str:
        """The first limit that is not kept, in words; empty when all are."""
        r_hat, bulk, tail = self.evidence
        if not self.acceptance >= LEAST_ACCEPTANCE:
            return f"acceptance {self.acceptance:.2f} is below {LEAST_ACCEPTANCE}"
        if not r_hat.max() <= LARGEST_R_HAT:
            return f"R-hat {r_hat.max():.3f} is above {LARGEST_R_HAT}"
        for name, sizes in (("bulk", bulk), ("tail", tail)):
            if not sizes.min() >= LEAST_SAMPLE_SIZE:
                return (
                    f"effective sample size of the {name} {sizes.min():.0f} is below "
                    f"{LEAST_SAMPLE_SIZE:.0f}"
                )
        return ""

    @property
    def converged(self) -> bool:
        """Nothing is lacking."""
        return not self.lacks

    def mean(self) -> tuple[Array, Array]:
        """Return the posterior's mean (m,) and its Monte Carlo standard errors (m,).

        Raises:
            NotConvergedError: The draws are not the posterior's.
        """
        self._check()
        return self.draws.mean(axis=(0, 1)), monte_carlo_error(self.draws)

    def covariance(self) -> tuple[Array, Array]:
        """Return the posterior's covariance (m, m) and its Monte Carlo standard errors (m, m).

        Raises:
            NotConvergedError: The draws are not the posterior's.
        """
        self._check()
        apart = self.draws - self.draws.mean(axis=(0, 1))
        halves = half_chains(apart)
        squares = np.einsum("cni,cnj->cij", halves, halves) / halves.shape[1]
        flat = apart.reshape(-1, apart.shape[2])
        covariance: Array = flat.T @ flat / (len(flat) - 1.0)
        return covariance, squares.std(axis=0, ddof=1) / np.sqrt(len(squares))

    def skewness(self) -> tuple[Array, Array]:
        """Return the skewness of every number (m,) and its Monte Carlo standard errors (m,).

        Raises:
            NotConvergedError: The draws are not the posterior's.
        """
        self._check()
        scaled = (self.draws - self.draws.mean(axis=(0, 1))) / self.draws.std(axis=(0, 1))
        return (scaled**3).mean(axis=(0, 1)), monte_carlo_error(scaled**3)

    def judge(
        self, mean: Array, covariance: Array, numbers: Index, level: float = 0.95
    ) -> PosteriorComparison:
        """Compare a Gaussian with the posterior.

        The extreme directions are sought in one half of the chains and measured in the other, so
        that an exact covariance of many numbers is not called wrong for want of draws; a single
        direction that is found this way is not more extreme than the true one but by chance.

        Args:
            mean: (m,) of the Gaussian over the same numbers.
            covariance: (m, m) of the Gaussian.
            numbers: (b,) which of them are judged together: a block, or all.
            level: Probability of the Gaussian's ellipsoid.

        Returns:
            Coverage and generalised eigenvalues with their Monte Carlo errors.

        Raises:
            NotConvergedError: The draws are not the posterior's.
        """
        self._check()
        apart = self.draws - mean
        apart[:, :, 2] = wrap_angle(apart[:, :, 2])
        apart, given = apart[:, :, numbers], covariance[np.ix_(numbers, numbers)]
        root = cholesky(given, lower=True)
        flat = apart.reshape(-1, len(numbers))
        squared = np.sum(solve_triangular(root, flat.T, lower=True) ** 2, axis=0)
        bound = 2.0 * gammaincinv(0.5 * len(numbers), level)
        inside = (squared <= bound).reshape(apart.shape[:2]).astype(np.float64)
        halves = apart[::2], apart[1::2]
        crossed = [_extremes(given, *pair) for pair in (halves, halves[::-1])]
        least, largest = (_averaged(*pair) for pair in zip(*crossed, strict=True))
        return PosteriorComparison(estimated(inside), least, largest)

    def _check(self) -> None:
        if self.lacks:
            raise NotConvergedError(f"not converged: {self.lacks}")


def _extremes(given: Array, sought: Array, measured: Array) -> tuple[SampledFigure, SampledFigure]:
    """Least and largest ratio of variances in the extreme directions of some draws, in others."""
    flat = sought.reshape(-1, sought.shape[2])
    _, directions = eigh(given, np.atleast_2d(np.cov(flat.T)))
    found = []
    for direction in (directions[:, 0], directions[:, -1]):
        along = measured @ direction
        variance = estimated((along - along.mean()) ** 2)
        ratio = float(direction @ given @ direction) / variance.value
        found.append(SampledFigure(ratio, ratio * variance.error / variance.value))
    return found[0], found[1]


def _averaged(one: SampledFigure, other: SampledFigure) -> SampledFigure:
    """Mean of two independent figures."""
    return SampledFigure(
        0.5 * (one.value + other.value), 0.5 * float(np.hypot(one.error, other.error))
    )


def sample_posterior(
    problem: SlamProblem,
    poses: Array,
    landmarks: Array,
    rng: np.random.Generator,
    options: SamplingOptions | None = None,
    progress: Progress = lambda done, total: None,
) -> PosteriorDraws:
    """Draw from the smoother's posterior.

    Args:
        problem: What is known.
        poses: (K, 3) of the optimum.
        landmarks: (L, 2) of the optimum.
        rng: Equal generators give equal draws, to the bit.
        options: How many draws.
        progress: Called with the iterations done, and all.

    Returns:
        The draws with their evidence.

    Raises:
        ValueError: The log is too long, or has what cannot be sampled.
        SingularProblemError: Some direction is left without information.
    """
    density = WhitenedPotential(problem, poses, landmarks)
    chains = sample_chains(density, density.dimension, rng, options, progress)
    count, length, size = chains.draws.shape
    states = density.to_world(chains.draws.reshape(-1, size).T)
    every = np.vstack((states, chains.energy.reshape(1, -1)))
    return PosteriorDraws(
        draws=states[3 * problem.pose_count - 3 :].T.reshape(count, length, -1),
        acceptance=chains.acceptance,
        step=chains.step,
        evidence=chain_evidence(every.T.reshape(count, length, -1)),
    )
