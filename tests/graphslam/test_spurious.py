"""Information about the start's heading in linear equations that cannot tell it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

import graphslam.spurious as module
from graphslam.arrays import Array, conditional_covariance
from graphslam.layout import POINT, POSE_LANDMARK
from graphslam.linear_problem import (
    LinearPositions,
    LinearPrior,
    LinearProblem,
    LinearRelations,
    LinearSurvey,
)
from graphslam.marginals import SingularProblemError
from graphslam.spurious import information_about_start

J = np.array([[0.0, -1.0], [1.0, 0.0]])
TURN = np.array([0.0, 0.0, 1.0])
NO_MERGES = np.zeros(0, dtype=np.intp)
NOTHING = np.zeros((3, 3))
POSES = np.column_stack((np.arange(12.0), np.zeros(12), np.zeros(12)))
LANDMARKS = np.array([[2.0, 3.0], [5.0, -4.0], [9.0, 6.0], [11.0, -2.0]])


def relations(first: ArrayLike, second: ArrayLike, a: Array, c: Array) -> LinearRelations:
    return LinearRelations(
        first=np.asarray(first, dtype=np.intp),
        second=np.asarray(second, dtype=np.intp),
        first_point=np.zeros((len(a), a.shape[2])),
        second_point=np.zeros((len(c), c.shape[2])),
        a=a,
        c=c,
        b=np.zeros(a.shape[:2]),
    )


def problem(
    poses: Array,
    seen: list[tuple[int, int]],
    landmarks: Array,
    *,
    off: dict[int, Array] | None = None,
    noise: tuple[float, float, float] = (0.1, 0.1, 0.01),
) -> LinearProblem:
    """Drive and measure landmarks in the world's axes, each linearised where it is.

    off: by measurement, how far from the landmark that one is linearised. noise: sigmas of a
    measurement, and of a motion step's position and heading.
    """
    count = len(poses)
    forward, back = np.zeros((count - 1, 3, 3)), np.zeros((count - 1, 3, 3))
    weight = np.diag((1.0 / noise[1], 1.0 / noise[1], 1.0 / noise[2]))
    for k, travel in enumerate(np.diff(poses[:, :2], axis=0)):
        f = np.eye(3)
        f[:2, 2] = J @ travel
        back[k], forward[k] = -weight @ f, weight
    a, c = np.zeros((len(seen), 2, 3)), np.zeros((len(seen), 2, 2))
    for row, (k, i) in enumerate(seen):
        offset = landmarks[i] + (off or {}).get(row, 0.0) - poses[k, :2]
        a[row] = np.column_stack((-np.eye(2), -J @ offset)) / noise[0]
        c[row] = np.eye(2) / noise[0]
    pose, landmark = np.array(seen).T
    return LinearProblem(
        prior=LinearPrior(poses[0], 1e6 * np.eye(3)),
        motion=relations(np.arange(count - 1), np.arange(1, count), back, forward),
        measurements={POINT: relations(pose, landmark, a, c)},
        merges={},
        positions=LinearPositions(
            np.array([3]), np.zeros((1, 3)), 1e3 * np.ones((1, 2, 3)), np.ones((1, 2))
        ),
        survey=LinearSurvey(np.zeros((0, 2)), np.zeros((0, 2, 2))),
    )


def world(*, every: int = 1, seed: int | None = None) -> LinearProblem:
    """A drive along LANDMARKS; with a seed, each measurement is linearised somewhere else."""
    seen = [(k, i) for k in range(0, len(POSES), every) for i in range(len(LANDMARKS))]
    off = None
    if seed is not None:
        moved = np.random.default_rng(seed).normal(scale=0.3, size=(len(seen), 2))
        off = dict(enumerate(moved))
    return problem(POSES, seen, LANDMARKS, off=off)


def least_squares(linear: LinearProblem, direction: Array, root: Array) -> float:
    """Least cost of alpha = 1, from one dense matrix; the first pose's error is N + root w."""
    k, n = len(linear.motion.first) + 1, int(linear.measurements[POINT].second.max()) + 1
    p = len(direction)
    rows = [np.hstack((np.eye(p), np.zeros((p, p * (k - 1) + 2 * n + 1))))]
    blocks = ((linear.motion, 0, p, True), (linear.measurements[POINT], p * k, 2, False))
    for r, base, width, _ in blocks:
        for i, j, a, c in zip(r.first, r.second, r.a, r.c, strict=True):
            row = np.zeros((len(c), p * k + 2 * n + 1))
            if i:
                row[:, p * i : p * i + p] = a
            else:
                row[:, :p], row[:, -1] = a @ root, a @ direction
            row[:, base + width * j : base + width * (j + 1)] += c
            rows.append(row)
    whole = np.vstack(rows)
    used = np.flatnonzero(np.abs(whole[:, :-1]).any(axis=0))
    left = whole[:, -1] - whole[:, used] @ np.linalg.lstsq(whole[:, used], whole[:, -1])[0]
    return float(left @ left)


def test_one_landmark_seen_twice_by_hand() -> None:
    """From the start at the landmark, then from where 1 m was driven 0.2 m further.

    The second measurement's residual per radian of the start is J (0.2, 0); its variance is that
    of two measurements and of the step, 2 0.1^2 + 0.1^2, for the heading's noise acts along the
    other axis only: the landmark lies sideways of the second pose.
    """
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    there = np.array([[1.0, 4.0]])
    off = {1: np.array([0.2, 0.0])}
    noise = (0.1, 0.1, 1e-9)
    linear = problem(poses, [(0, 0), (1, 0)], there, off=off, noise=noise)
    found = information_about_start(linear, TURN, NOTHING, NO_MERGES)
    assert np.isclose(found.total, 0.2**2 / (3 * 0.1**2), rtol=1e-9)
    assert found.largest is not None
    assert found.largest[1:] == (1, 0, "point")


@pytest.mark.parametrize("parts", [1, 3, 100])
def test_the_total_is_that_of_least_squares_however_it_is_divided(
    parts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_PARTS", parts)
    linear = world(seed=1)
    found = information_about_start(linear, TURN, NOTHING, NO_MERGES)
    assert np.isclose(found.total, least_squares(linear, TURN, np.zeros((3, 3))), rtol=1e-11)
    assert (found.largest is None) == (parts == 1)
    assert len(found.gained) == min(parts, len(POSES))


def until(linear: LinearProblem, k: int, count: int) -> LinearProblem:
    """The motion up to pose k, and the first measurements."""
    steps = {name: column[:k] for name, column in vars(linear.motion).items()}
    columns = {name: column[:count] for name, column in vars(linear.measurements[POINT]).items()}
    motion, seen = LinearRelations(**steps), LinearRelations(**columns)
    return replace(linear, motion=motion, measurements={POINT: seen})


def test_what_was_gained_until_a_pose_is_what_the_log_until_there_holds() -> None:
    linear = world(seed=2)
    gathered = np.cumsum(information_about_start(linear, TURN, NOTHING, NO_MERGES).gained)
    for k in (3, 7):
        short = until(linear, k, (k + 1) * len(LANDMARKS))
        assert np.isclose(gathered[k], least_squares(short, TURN, NOTHING), rtol=1e-10)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_largest_gain_is_that_of_its_measurement(seed: int) -> None:
    """By brute force: what the log holds with each measurement, less what it holds without it."""
    linear = world(seed=seed)
    found = information_about_start(linear, TURN, NOTHING, NO_MERGES)
    k = int(found.epoch[found.gained.argmax()])
    counts = range(k * len(LANDMARKS), (k + 1) * len(LANDMARKS) + 1)
    held = [least_squares(until(linear, k, count), TURN, NOTHING) for count in counts]
    gains = np.diff(held)
    assert found.largest is not None
    assert found.largest[1:] == (k, int(gains.argmax()), "point")
    assert np.isclose(found.largest.information, gains.max(), rtol=1e-8)


def test_at_the_truth_nothing_is_learnt_and_one_wrong_point_is_found() -> None:
    scale = least_squares(world(seed=1), TURN, NOTHING)
    at_truth = information_about_start(world(), TURN, NOTHING, NO_MERGES)
    assert at_truth.total < 1e-20 * scale
    seen = [(k, i) for k in range(len(POSES)) for i in range(len(LANDMARKS))]
    row = seen.index((7, 2))
    wrong = problem(POSES, seen, LANDMARKS, off={row: np.array([0.0, 1.0])})
    found = information_about_start(wrong, TURN, NOTHING, NO_MERGES)
    assert found.total > 1.0
    assert found.largest is not None
    assert found.largest[1:] == (7, 2, "point")
    assert found.gained[:7].sum() < 1e-15  # and nothing before it
    assert found.largest.information > 0.5 * found.total


def test_what_is_learnt_at_once_is_found_at_the_start() -> None:
    """Two measurements from the start, of one landmark taken for 0.3 m farther in the second."""
    seen = [(0, 0), (0, 0), (1, 0), (2, 0)]
    linear = problem(POSES[:3], seen, LANDMARKS, off={1: np.array([0.3, 0.0])})
    found = information_about_start(linear, TURN, NOTHING, NO_MERGES)
    assert found.largest is not None
    assert found.largest[1:] == (0, 0, "point")
    assert np.isclose(found.gained[0], 0.3**2 / (2 * 0.1**2), rtol=1e-9)


def test_neither_prior_nor_positions_count() -> None:
    """Nor does a common shift, whatever the points of linearisation."""
    assert world(seed=1).positions.a.any()
    east = information_about_start(world(seed=1), np.array([1.0, 0.0, 0.0]), NOTHING, NO_MERGES)
    assert east.total < 1e-20


def test_what_the_prior_says_beside_the_direction_counts() -> None:
    """A position at the start that is known to 0.5 m alone lets less be learnt."""
    linear = world(seed=1)
    rest = np.diag((0.25, 0.25, 0.0))
    found = information_about_start(linear, TURN, rest, NO_MERGES).total
    root = np.diag((0.5, 0.5, 0.0))
    assert np.isclose(found, least_squares(linear, TURN, root), rtol=1e-10)


def test_landmarks_that_are_one_tell_of_each_other() -> None:
    """Pose landmarks merged at where each is: nothing; at another place of one: something."""

    def merged(off: float) -> float:
        linear = problem(POSES[:3], [(0, 0)], LANDMARKS)
        places = np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 0.0]])
        a, c = np.zeros((2, 3, 3)), np.tile(np.eye(3), (2, 1, 1))
        for row, k in enumerate((0, 2)):
            a[row] = -np.eye(3)
            a[row, :2, 2] = -J @ (places[row, :2] - POSES[k, :2])
        same = np.eye(3)
        same[:2, 2] = J @ np.array([off, 0.0])
        linear = replace(
            linear,
            measurements={
                POINT: linear.measurements[POINT],
                POSE_LANDMARK: relations([0, 2], [0, 1], 10 * a, 10 * c),
            },
            merges={POSE_LANDMARK: relations([0], [1], -same[None], np.eye(3)[None])},
        )
        return information_about_start(linear, TURN, NOTHING, np.array([2])).total

    assert merged(0.0) < 1e-20
    assert merged(0.3) > 1e-3


def test_a_state_that_nothing_fixes_is_refused() -> None:
    linear = world()
    c = linear.measurements[POINT].c.copy()
    c[:, 1] = 0.0
    blind = replace(linear.measurements[POINT], c=c)
    with pytest.raises(SingularProblemError):
        information_about_start(
            replace(linear, measurements={POINT: blind}), TURN, NOTHING, NO_MERGES
        )


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
