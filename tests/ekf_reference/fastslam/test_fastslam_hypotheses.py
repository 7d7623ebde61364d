"""Sampled associations against the exact posterior, all assignments enumerated."""

import math
from itertools import product
from typing import NamedTuple, get_args

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, chisquare

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.measurements import Measurements
from ekf_reference.fastslam import association
from ekf_reference.fastslam.association import (
    Choice,
    ExpectedDetection,
    PerParticleLikelihood,
    sampled_pairs,
)
from ekf_reference.fastslam.filter import FastSlam, FastSlamOptions, Proposal
from tests.ekf_reference.fastslam.linear_sensor import PlaceDifference, standing

LANDMARKS = np.array([[5.0, 0.0], [5.0, 1.0], [12.0, -4.0]])
NEW_DENSITY = 0.01
LEVEL = 1e-4
"""Of chi-square tests; the seeds are fixed."""
Hypothesis = tuple[tuple[int, ...], ...]
"""Of each scan after the first, the landmark of each measurement; -1 for none."""


class Scan(NamedTuple):
    """z: (m, 2) [m]. noise: its variance. step: variance of the motion before it; [m^2]."""

    z: Array
    noise: float
    step: float


class World(NamedTuple):
    """Variance with which the landmarks are mapped at first [m^2], and what follows."""

    mapped: float
    scans: tuple[Scan, ...]


KNOWN_POSES = World(
    0.2,
    (
        Scan(np.array([[5.0, 0.45]]), 0.1, 0.0),
        Scan(np.array([[5.0, -0.5], [5.0, 0.7]]), 0.005, 0.0),
    ),
)
"""The ambiguous measurement was of the second landmark, as two precise ones show later."""
UNCERTAIN_MOTION = World(
    0.02, (Scan(np.array([[5.0, 0.4]]), 0.05, 0.6), Scan(np.array([[12.0, -4.6]]), 0.02, 0.0))
)
"""The vehicle went 0.6 m to the left, as a landmark shows later that stands alone."""
CROWDED = World(
    0.2,
    (Scan(np.array([[5.0, 0.3], [5.2, 0.9]]), 0.15, 0.3), Scan(np.array([[5.0, 0.6]]), 0.15, 0.3)),
)


class Branch(NamedTuple):
    """A hypothesis with its Kalman filter: x, y of the vehicle and of the three landmarks."""

    log_joint: float
    mean: Array
    covariance: Array


def assignments(measurements: int) -> list[tuple[int, ...]]:
    every = product(range(-1, len(LANDMARKS)), repeat=measurements)
    return [a for a in every if len({i for i in a if i >= 0}) == sum(i >= 0 for i in a)]


def log_prior(assignment: tuple[int, ...]) -> float:
    """Of the landmarks not taken yet alike, against none; with the density of those of none."""
    total, free = 0.0, len(LANDMARKS)
    for i in assignment:
        total += math.log(NEW_DENSITY) if i < 0 else -math.log(free)
        free -= i >= 0
    return total


def fused(branch: Branch, assignment: tuple[int, ...], scan: Scan) -> Branch:
    rows = [j for j, i in enumerate(assignment) if i >= 0]
    log_joint, mean, p = branch
    p = p + np.diag([scan.step] * 2 + [0.0] * 6)
    log_joint += log_prior(assignment)
    if rows:
        h = np.zeros((2 * len(rows), len(mean)))
        for k, j in enumerate(rows):
            h[2 * k : 2 * k + 2, :2] = -np.eye(2)
            h[2 * k : 2 * k + 2, 2 + 2 * assignment[j] : 4 + 2 * assignment[j]] = np.eye(2)
        s, nu = h @ p @ h.T + scan.noise * np.eye(len(h)), scan.z[rows].ravel() - h @ mean
        log_joint -= 0.5 * float(
            nu @ np.linalg.solve(s, nu) + np.linalg.slogdet(2 * math.pi * s)[1]
        )
        gain = p @ h.T @ np.linalg.inv(s)
        mean, p = mean + gain @ nu, p - gain @ h @ p
    return Branch(log_joint, mean, p)


def enumerated(world: World, scans: int) -> dict[Hypothesis, Branch]:
    """All hypotheses of the first scans, and their joint density with the measurements."""
    p = np.zeros((8, 8))
    p[2:, 2:] = world.mapped * np.eye(6)
    found: dict[Hypothesis, Branch] = {}
    first = 3.0 * math.log(NEW_DENSITY)  # all landmarks are new in the first scan
    found[()] = Branch(first, np.concatenate((np.zeros(2), LANDMARKS.ravel())), p)
    for scan in world.scans[:scans]:
        before, found = found, {}
        for past, branch in before.items():
            for a in assignments(len(scan.z)):
                found[(*past, a)] = fused(branch, a, scan)
    return found


class Exact(NamedTuple):
    """The posterior: share of each hypothesis, ln of the evidence, mean place (2,)."""

    share: dict[Hypothesis, float]
    log_evidence: float
    mean: Array


def exact(world: World, scans: int) -> Exact:
    branches = enumerated(world, scans)
    joint = np.array([b.log_joint for b in branches.values()])
    log_evidence = float(np.logaddexp.reduce(joint))
    share = np.exp(joint - log_evidence)
    mean = share @ np.array([b.mean[:2] for b in branches.values()])
    return Exact(dict(zip(branches, share.tolist(), strict=True)), log_evidence, mean)


class Ran(NamedTuple):
    """A cloud after some scans, and which landmark (N, m) it took each measurement of each for."""

    slam: FastSlam
    taken: list[NDArray[np.int64]]

    def holds(self, hypothesis: Hypothesis) -> NDArray[np.bool_]:
        """Which particles descend by this hypothesis."""
        found = np.ones(len(self.slam.pose), dtype=bool)
        ancestors = self.slam.history.ancestors()[1:]
        for own, taken, ancestor in zip(hypothesis, self.taken, ancestors, strict=True):
            found &= (taken[ancestor] == own).all(axis=1)
        return found


def run(world: World, scans: int, options: FastSlamOptions, seed: int = 0) -> Ran:
    slam = standing(options, seed)
    none = np.full(3, -1, dtype=np.int64)
    slam.observe(Measurements(LANDMARKS, np.tile(world.mapped * np.eye(2), (3, 1, 1)), none))
    taken = []
    for z, noise, step in world.scans[:scans]:
        slam.predict(np.zeros(3), np.diag((step, step, 0.0)), 1.0)
        variance = np.tile(noise * np.eye(2), (len(z), 1, 1))
        taken.append(slam.observe(Measurements(z, variance, none[: len(z)])))
    return Ran(slam, taken)


def options_of(
    particles: int,
    choice: Choice = "sampled",
    proposal: Proposal = "measurement",
    resample_share: float = 0.0,
) -> FastSlamOptions:
    """All landmarks are in the gate, and none is new after the first scan."""
    rule = PerParticleLikelihood(
        view=ExpectedDetection(0.1), choice=choice, gate=1e6, new_gate=1e6, new_density=NEW_DENSITY
    )
    return FastSlamOptions(
        particles=particles,
        proposal=proposal,
        association=rule,
        resample_share=resample_share,
        sensor=PlaceDifference(),
    )


def uncorrected(
    score: Array, log_unmatched: float, generator: np.random.Generator
) -> tuple[Index, Array]:
    pair, log_ratio = sampled_pairs(score, log_unmatched, generator)
    return pair, 0.0 * log_ratio


@pytest.mark.parametrize("world", [KNOWN_POSES, UNCERTAIN_MOTION])
def test_hypotheses_are_held_by_their_posterior_share_until_resolved(world: World) -> None:
    """Weights after one measurement are equal: the shares are counts, with no other error."""
    first, last = exact(world, 1), exact(world, 2)
    wrong, right = first.share[((0,),)], first.share[((1,),)]
    assert 0.2 < right < wrong
    ran = run(world, 1, options_of(10_000))
    assert ran.slam.log_evidence == pytest.approx(first.log_evidence, abs=1e-9)
    assert np.ptp(ran.slam.log_weight) < 1e-9
    held = [int(ran.holds(((i,),)).sum()) for i in (0, 1, -1)]
    share = np.array([wrong, right, first.share[((-1,),)]])
    assert sum(held) == 10_000
    assert chisquare(held, 10_000 * share / share.sum()).pvalue > LEVEL

    ran = run(world, 2, options_of(10_000))
    share_right, share_wrong = (
        sum(p for h, p in last.share.items() if h[0] == (i,)) for i in (1, 0)
    )
    assert share_right > 0.85 > 0.1 > share_wrong
    held_right, weight = ran.taken[0][:, 0] == 1, ran.slam.weight
    error = weight * (held_right - share_right)
    assert chi2.sf(error.sum() ** 2 / (error @ error), 1) > LEVEL
    z = np.exp(ran.slam.log_weight - last.log_evidence)
    assert chi2.sf((z.mean() - 1.0) ** 2 / (z.var() / len(z)), 1) > LEVEL


@pytest.mark.parametrize("world", [KNOWN_POSES, UNCERTAIN_MOTION])
def test_the_likeliest_alone_holds_the_wrong_hypothesis_only(world: World) -> None:
    ran = run(world, 2, options_of(500, "likeliest"))
    assert (ran.taken[0] == 0).all()


class Runs(NamedTuple):
    """Errors (S, d) of the clouds' shares and mean places, and z (S,), evidence over the exact."""

    error: Array
    z: Array


def runs(options: FastSlamOptions, seeds: int) -> Runs:
    truth = exact(CROWDED, 2)
    frequent = [h for h, p in truth.share.items() if p > 0.03]
    error, z = [], []
    for seed in range(seeds):
        ran = run(CROWDED, 2, options, seed + 1)
        weight = ran.slam.weight
        share = [float(weight @ ran.holds(h)) - truth.share[h] for h in frequent]
        error.append([*share, *(weight @ ran.slam.pose[:, :2] - truth.mean)])
        z.append(math.exp(ran.slam.log_evidence - truth.log_evidence))
    return Runs(np.array(error), np.array(z))


def p_value(found: Runs) -> float:
    """Least p-value of errors and evidence, both expected to vanish.

    Runs weighted by their evidence make one cloud without bias, however few particles each has.
    """
    error, z = found
    centre = z @ error / z.sum()
    scatter = z[:, None] * (error - centre) / z.sum()
    t2 = float(centre @ np.linalg.solve(scatter.T @ scatter, centre))
    of_z = float(chi2.sf((z.mean() - 1.0) ** 2 / (z.var() / len(z)), 1))
    return min(float(chi2.sf(t2, error.shape[1])), of_z)


@pytest.mark.parametrize("seeds", [80, pytest.param(400, marks=pytest.mark.slow)])
@pytest.mark.parametrize("proposal", ["motion", "measurement"])
@pytest.mark.parametrize("resample_share", [0.0, 1.0])
def test_joint_posterior_of_path_and_associations(
    proposal: Proposal, resample_share: float, seeds: int
) -> None:
    options = options_of(100, proposal=proposal, resample_share=resample_share)
    assert p_value(runs(options, seeds)) > LEVEL


@pytest.mark.parametrize("fault", ["no correction", "likeliest"])
def test_broken_hypotheses_are_rejected(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By shares or places alone too, whatever the evidence."""
    if fault == "no correction":
        monkeypatch.setattr(association, "sampled_pairs", uncorrected)
        found = runs(options_of(100), 40)
    else:
        found = runs(options_of(100, "likeliest", "motion"), 40)
    assert p_value(found) < LEVEL
    t = math.sqrt(40) * found.error.mean(axis=0) / found.error.std(axis=0)
    assert np.abs(t).max() > 5.0


def test_sampled_pairs_equal_a_plain_loop_and_exclude_each_other() -> None:
    score = np.random.default_rng(0).normal(size=(80, 4, 5))
    score[score < -0.5] = -np.inf
    pair, log_ratio = sampled_pairs(score, -1.0, np.random.default_rng(1))
    uniform = np.random.default_rng(1).random((4, 80))
    apart = 0
    for n, own in enumerate(score):
        taken: list[int] = []
        expected = 0.0
        for j, row in enumerate(own):
            possible = [k for k in range(5) if np.isfinite(row[k]) and k not in taken]
            prior = [*(1.0 / len(possible) for _ in possible), 1.0]
            density = [p * math.exp(s) for p, s in zip(prior, [*row[possible], -1.0], strict=True)]
            at = int(np.searchsorted(np.cumsum(density), uniform[j, n] * sum(density), "right"))
            expected += math.log(prior[at] * sum(density) / density[at])
            drawn = [*possible, -1][at]
            assert pair[n, j] == drawn
            taken += [drawn] if drawn >= 0 else []
        assert log_ratio[n] == pytest.approx(expected, abs=1e-12)
        assert len(set(taken)) == len(taken)
        alone = [sampled_pairs(own[None, [j]], -1.0, np.random.default_rng(n))[0] for j in range(4)]
        held = [int(x[0, 0]) for x in alone if x[0, 0] >= 0]
        apart += len(set(held)) < len(held)
    assert apart > 20  # without exclusion


def test_measurements_that_are_not_ambiguous_change_no_weight() -> None:
    score = np.array([[[-1.0, -np.inf], [-np.inf, -np.inf]]])
    pair, log_ratio = sampled_pairs(score, -800.0, np.random.default_rng(0))
    np.testing.assert_array_equal(pair, [[0, -1]])
    np.testing.assert_array_equal(log_ratio, [0.0])


PAIRS = np.column_stack((np.repeat(6.0 * np.arange(4), 2) + np.tile((0.0, 1.0), 4), np.full(8, 3)))
"""Posts in pairs 1 m apart, along the way."""


def misplaced_m(choice: Choice, seed: int) -> float:
    """Error along the way after a slip of 0.8 m (1 sigma) and ten scans of one post each."""
    world, step = np.random.default_rng((seed, 1)), np.diag((0.64, 1e-4, 0.0))
    truth = world.normal(0.0, (0.8, 0.01))
    rule = PerParticleLikelihood(view=ExpectedDetection(0.1), choice=choice)
    options = FastSlamOptions(particles=30, association=rule, sensor=PlaceDifference())
    slam = standing(options, seed)
    noise, none = np.tile(0.01 * np.eye(2), (8, 1, 1)), np.full(8, -1, dtype=np.int64)
    slam.observe(Measurements(PAIRS, noise, none))
    slam.predict(np.zeros(3), step, 1.0)
    for post in world.integers(0, 8, 10):
        z = PAIRS[post] - truth + world.normal(0.0, 0.1, 2)
        slam.observe(Measurements(z[None], noise[:1], none[:1]))
        slam.predict(np.zeros(3), 1e-4 * np.diag((1.0, 1.0, 0.0)), 1.0)
    return abs(float(slam.mean_pose()[0] - truth[0]))


@pytest.mark.slow
def test_sampled_associations_recover_from_a_first_one_that_was_wrong() -> None:
    lost = {
        choice: sum(misplaced_m(choice, seed) > 0.5 for seed in range(40))
        for choice in get_args(Choice)
    }
    assert lost["likeliest"] >= 5
    assert lost["sampled"] <= 1
