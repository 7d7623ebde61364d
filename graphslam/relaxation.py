"""A start without a guess: the problem relaxed until it is linear.

Headings become complex numbers of any length, so that every measurement is a linear equation of
headings, places and landmarks (the chordal relaxation of pose graphs, Carlone et al. 2015, with
landmarks). One sparse solution gives headings, which are brought back to length one; a second one
gives places and landmarks under these. No step depends on a value that was guessed.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from graphslam.arrays import Array, Index
from graphslam.problem import SlamProblem
from graphslam.sparse_system import factorised

Complex = NDArray[np.complex128]
Term = tuple[Index, Complex | complex]


@dataclass(frozen=True)
class RelaxedStart:
    """poses: (K, 3), headings wrapped. landmarks: (L, 2), NaN where nobody saw one.

    frames: (Q, 3) pose landmarks.
    """

    poses: Array
    landmarks: Array
    frames: Array


@dataclass
class _Equations:
    """Rows of a sparse complex system: weight (sum of coefficient times unknown - value) = 0."""

    row: list[Index] = field(default_factory=list)
    column: list[Index] = field(default_factory=list)
    entry: list[Complex] = field(default_factory=list)
    value: list[Complex] = field(default_factory=list)
    count: int = 0

    def add(self, weight: Array, terms: list[Term], value: Complex) -> None:
        """N equations. weight, value: (N,). terms: columns (N,) and coefficients (N,) or one."""
        rows = self.count + np.arange(len(value))
        for column, coefficient in terms:
            self.row.append(rows)
            self.column.append(column)
            self.entry.append(np.asarray(weight * coefficient, dtype=complex))
        self.value.append(weight * value)
        self.count += len(value)

    def solve(self, unknowns: int) -> Complex:
        """Least squares by the normal equations. Raises RuntimeError where they are singular."""
        shape = (self.count, unknowns)
        entry = np.concatenate(self.entry)
        system = csc_matrix((entry, (np.concatenate(self.row), np.concatenate(self.column))), shape)
        adjoint = system.conj().T.tocsc()
        solution: Complex = factorised(adjoint @ system).solve(adjoint @ np.concatenate(self.value))
        if not np.isfinite(solution).all():
            raise RuntimeError("the relaxed problem is singular")
        return solution


def relax(problem: SlamProblem) -> RelaxedStart:
    """Solve the relaxed problem. Raises RuntimeError where its equations do not fix it."""
    k, q = problem.pose_count, problem.pose_landmarks.count
    nodes = k + q
    unit = problem.prior_pose[2] + np.concatenate(([0.0], np.cumsum(problem.increment[:, 2])))
    headings = _Equations()
    _relative(headings, problem, turned=None)
    _absolute(headings, problem, turned=None)
    landmarks = problem.seen_landmarks
    free = headings.solve(2 * nodes + len(landmarks))[:nodes]
    length = np.abs(free)
    # A heading that no measurement observes keeps the odometry's.
    fallback = np.concatenate((np.exp(1j * unit), np.ones(q)))
    turned = np.where(length > 1e-9, free / np.maximum(length, 1e-300), fallback)
    places = _Equations()
    _relative(places, problem, turned)
    _absolute(places, problem, turned)
    found = places.solve(nodes + len(landmarks))
    pose = np.column_stack((found[:nodes].real, found[:nodes].imag, np.angle(turned)))
    place = np.full((problem.landmark_count, 2), np.nan)
    place[landmarks] = np.column_stack((found[nodes:].real, found[nodes:].imag))
    return RelaxedStart(pose[:k], place, pose[k:])


def _relative(equations: _Equations, problem: SlamProblem, turned: Complex | None) -> None:
    """Motions, pose landmarks and point measurements.

    Unknowns: headings of poses and pose landmarks, unless they are given as `turned` (K + Q,)
    complex; then their places; then landmarks.
    """
    k, seen, closed = problem.pose_count, problem.pose_landmarks, problem.loop_closures
    merged = seen.merges
    step = problem.steps
    first = np.concatenate((step, closed.first, seen.pose, k + merged.first))
    second = np.concatenate((step + 1, closed.second, k + seen.landmark, k + merged.second))
    motion = np.concatenate(
        (problem.increment[step], closed.motion, seen.measured, merged.measured)
    )
    spread = np.concatenate(
        (problem.increment_covariance[step], closed.covariance, seen.covariance, merged.covariance)
    )
    turn_weight = spread[:, 2, 2] ** -0.5
    weight = (0.5 * (spread[:, 0, 0] + spread[:, 1, 1])) ** -0.5
    moved = motion[:, 0] + 1j * motion[:, 1]
    offset = problem.z[:, 0] * np.exp(1j * problem.z[:, 1])
    sigma = np.hypot(problem.sigma[:, 0], problem.z[:, 0] * np.minimum(problem.sigma[:, 1], 1.0))
    nodes = k + seen.count
    pose = problem.measurement_pose
    landmark = np.searchsorted(problem.seen_landmarks, problem.measurement_landmark)
    if turned is None:
        zero = np.zeros(len(first), dtype=complex)
        turn = np.exp(1j * motion[:, 2])
        equations.add(turn_weight, [(second, 1.0), (first, -turn)], zero)
        equations.add(weight, [(nodes + second, 1.0), (nodes + first, -1.0), (first, -moved)], zero)
        terms = [(2 * nodes + landmark, 1.0), (nodes + pose, -1.0), (pose, -offset)]
        equations.add(1.0 / sigma, terms, np.zeros(len(pose), dtype=complex))
        return
    equations.add(weight, [(second, 1.0), (first, -1.0)], turned[first] * moved)
    terms = [(nodes + landmark, 1.0), (pose, -1.0)]
    equations.add(1.0 / sigma, terms, turned[pose] * offset)


def _absolute(equations: _Equations, problem: SlamProblem, turned: Complex | None) -> None:
    """The prior, absolute positions and surveyed landmarks; unknowns as in _relative."""
    nodes = problem.pose_count + problem.pose_landmarks.count
    shift = nodes if turned is None else 0
    x, y, heading = problem.prior_pose
    spread = problem.prior_covariance
    zero = np.zeros(1, dtype=np.intp)
    if turned is None:
        equations.add(spread[2:, 2] ** -0.5, [(zero, 1.0)], np.exp(1j * np.array([heading])))
    weight = np.array([(0.5 * (spread[0, 0] + spread[1, 1])) ** -0.5])
    equations.add(weight, [(shift + zero, 1.0)], np.array([x + 1j * y]))
    lever = complex(*problem.lever_m)
    pose = problem.position_pose
    place = problem.position[:, 0] + 1j * problem.position[:, 1]
    weight = _isotropic(problem.position_covariance)
    if turned is None:
        equations.add(weight, [(shift + pose, 1.0), (pose, lever)], place)
    else:
        equations.add(weight, [(pose, 1.0)], place - turned[pose] * lever)
    known = problem.surveyed[:, 0] + 1j * problem.surveyed[:, 1]
    landmark_index = shift + nodes + np.arange(len(known))
    equations.add(_isotropic(problem.surveyed_covariance), [(landmark_index, 1.0)], known)


def _isotropic(covariance: Array) -> Array:
    """(N,) weights from covariances (N, 2, 2)."""
    return (0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1])) ** -0.5
