"""Simulation-based calibration of posterior draws, and what share of truths Gaussians cover.

    python -m research.posterior_sampling [--problems 100] [--cases NAME ...]

A problem is drawn from its own prior: first pose, motions, landmarks given their first measurement;
its later measurements from the model. The rank of the truth among independent draws of the
posterior is then uniform (Talts, Betancourt, Simpson, Vehtari, Gelman 2018). A chi-square test of
16 bins says so, its p-value from simulated multinomial counts, as there are too few problems for
its asymptotic law. The filter is ekf_reference's, run through comparisons on a log of the problem.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from comparisons.adapters.smoother_input import build_problem
from comparisons.config import RunConfig
from comparisons.jobs.run import run_filter
from comparisons.logs.log import LandmarkMeasurements, Log, Prior
from comparisons.logs.odometry import RelativePoses
from comparisons.pipeline.prepare import prepare
from graphslam.increments import dead_reckoned
from graphslam.sampling import PosteriorDraws, SamplingOptions, sample_posterior
from graphslam.smoother import smooth
from research.script import options
from research.timing import timed

Array = NDArray[np.float64]
LEVELS = (0.5, 0.9, 0.95)
BINS, THINNED = 16, 127
SIGNIFICANCE = 0.01
DRAWS = (500, 2000, 8000)
"""Of each chain, until they converge."""


class SamplingCase(NamedTuple):
    """What is driven and how well it is known.

    motion: (x, y, heading) of each of the steps. step_sigma: its standard deviations. heading: of
    the first pose. measured: of range [m] and bearing [rad]. places: (L, 2) about which landmarks
    are drawn. seen: (K, L) whether a landmark is measured from a pose.
    """

    motion: Array
    step_sigma: tuple[float, float, float]
    heading: float
    measured: tuple[float, float]
    places: Array
    seen: NDArray[np.bool_]


def straight(distance_m: float = 8.0, **changes: object) -> SamplingCase:
    """Four poses a metre apart that measure three landmarks ahead and beside, each time."""
    turn = np.array((-0.8, 0.1, 0.9))
    places = distance_m * np.column_stack((np.cos(turn), np.sin(turn)))
    case = SamplingCase(
        np.tile((1.0, 0.0, 0.1), (3, 1)),
        (0.1, 0.05, 0.02),
        0.05,
        (0.1, 0.02),
        places,
        np.ones((4, 3), dtype=np.bool_),
    )
    return case._replace(**changes)  # type: ignore[arg-type]


def circle(count: int = 16, heading_step: float = 0.1) -> SamplingCase:
    """Steps around a circle of 10 m; the landmark seen first closes the loop."""
    turn = 2.0 * np.pi / count
    about = np.exp(2j * np.pi * np.arange(4) / 4)
    places = 16.0j - 1j * 16.0 * about - 6.0j  # the circle's centre lies to the left of the start
    places = np.column_stack((places.real, places.imag))
    seen = np.zeros((count + 1, 4), dtype=np.bool_)
    for landmark in range(4):
        seen[(count // 4 * landmark + np.array((-1, 0, 1))) % count, landmark] = True
    seen[count - 1 :, 0] = True
    chord = 20.0 * np.sin(0.5 * turn)
    motion = np.tile((chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn), turn), (count, 1))
    return SamplingCase(motion, (0.2, 0.1, heading_step), 0.02, (0.2, 0.05), places, seen)


CASES: dict[str, Callable[[], SamplingCase]] = {
    "small noise": straight,
    "start's heading 0.3 rad": lambda: straight(heading=0.3),
    "bearing 0.2 rad": lambda: straight(measured=(0.1, 0.2)),
    "range 60 m, bearing 0.1 rad": lambda: straight(60.0, measured=(0.3, 0.1)),
    "loop, 0.1 rad a step": circle,
}


def drawn_motion(mean: Array, sigma: Array, rng: np.random.Generator) -> Array:
    """Draw a motion with density exp(-1/2 |Log(mean^-1 motion)|^2) in dx dy dheading.

    The logarithm changes volume by 2 (1 - cos) / turn^2, with which a normal draw is accepted.
    """
    while True:
        xi = sigma * rng.standard_normal(3)
        half = 0.5 * xi[2]
        if abs(xi[2]) < np.pi and rng.uniform() < np.sinc(half / np.pi) ** 2:
            break
    turn = 1j * xi[2]
    way = (xi[0] + 1j * xi[1]) * ((np.exp(turn) - 1.0) / turn if xi[2] else 1.0)
    way = mean[0] + 1j * mean[1] + way * np.exp(1j * mean[2])
    return np.array((way.real, way.imag, mean[2] + xi[2]))


class Drawn(NamedTuple):
    """A log, and the truth (m,) of its last pose and landmarks."""

    log: Log
    truth: Array


def draw_problem(case: SamplingCase, rng: np.random.Generator) -> Drawn:
    """Draw the truth from the prior, then what is measured of it.

    A landmark has no prior but its first measurement, which is the same in all problems: given it
    the range r has density r exp(-1/2 residual^2), as dx dy is r dr dbearing.
    """
    prior_sigma = np.array((0.1, 0.1, case.heading))
    step_sigma, count = np.array(case.step_sigma), len(case.motion)
    first = drawn_motion(np.zeros(3), prior_sigma, rng)
    taken = np.array([drawn_motion(m, step_sigma, rng) for m in case.motion])
    poses, nominal = dead_reckoned(first, taken), dead_reckoned(np.zeros(3), case.motion)
    pose, landmark = np.nonzero(case.seen)
    _, initial = np.unique(landmark, return_index=True)
    z = polar(nominal[pose], case.places[landmark])
    noise = measurement_noise(case.measured, len(pose), rng)
    landmarks = np.empty_like(case.places)
    for j, row in enumerate(initial):
        while (r := z[row, 0] + noise[row, 0]) < rng.uniform(0.0, z[row, 0] + 8 * case.measured[0]):
            noise[row] = measurement_noise(case.measured, 1, rng)[0]
        bearing = poses[pose[row], 2] + z[row, 1] + noise[row, 1]
        landmarks[j] = poses[pose[row], :2] + r * np.array((np.cos(bearing), np.sin(bearing)))
    later = np.setdiff1d(np.arange(len(pose)), initial)
    z[later] = polar(poses[pose], landmarks[landmark])[later] + noise[later]
    sigma = np.tile(case.measured, (len(pose), 1))
    log = Log(
        name="drawn",
        format="arrays",
        prior=Prior(0.0, np.zeros(3), np.diag(prior_sigma**2)),
        odometry=RelativePoses(
            np.arange(1.0, count + 1.0), case.motion, np.tile(np.diag(step_sigma**2), (count, 1, 1))
        ),
        measurements=LandmarkMeasurements(
            time_s=pose.astype(np.float64),
            range_m=z[:, 0],
            bearing_rad=np.angle(np.exp(1j * z[:, 1])),
            sigma_range_m=sigma[:, 0],
            sigma_bearing_rad=sigma[:, 1],
            landmark=landmark.astype(np.int64),
        ),
    )
    return Drawn(log, np.concatenate((poses[-1], landmarks.ravel())))


def polar(poses: Array, places: Array) -> Array:
    """Exact ranges and bearings (M, 2) of places (M, 2) from poses (M, 3)."""
    apart = places - poses[:, :2]
    return np.column_stack((np.hypot(*apart.T), np.arctan2(apart[:, 1], apart[:, 0]) - poses[:, 2]))


def measurement_noise(sigma: tuple[float, float], count: int, rng: np.random.Generator) -> Array:
    """Errors (count, 2) of range and bearing, those of bearing within half a turn."""
    noise = np.array(sigma) * rng.standard_normal((count, 2))
    while (wide := np.abs(noise[:, 1]) > np.pi).any():
        noise[wide, 1] = sigma[1] * rng.standard_normal(int(wide.sum()))
    return noise


class Solved(NamedTuple):
    """One problem: truth (m,), the filter's and the smoother's Gaussians, and draws."""

    truth: Array
    gaussians: dict[str, tuple[Array, Array]]
    draws: PosteriorDraws


def solve(drawn: Drawn, rng: np.random.Generator) -> Solved:
    """Run filter, smoother and chains."""
    prepared = prepare(drawn.log, RunConfig())
    run, _ = run_filter(prepared)
    problem = build_problem(prepared.log, run)
    assert len(problem.z) == len(drawn.log.measurements.time_s)  # in the order of the truth
    assert (np.diff(run.estimate.landmark_id) == 1).all()
    result = smooth(problem, {"ekf": (run.departed, run.estimate.landmark)})
    estimate = run.estimate
    mean = np.concatenate((estimate.pose[-1], estimate.landmark.ravel()))
    for count in DRAWS:
        options = SamplingOptions(draws=count)
        draws = sample_posterior(problem, result.poses, result.landmarks, rng, options)
        if draws.converged:
            break
    marginal = result.marginal()
    gaussians = {
        "EKF": (mean, estimate.joint_covariance),
        "smoother": (marginal.mean, marginal.covariance),
    }
    return Solved(drawn.truth, gaussians, draws)


def solve_all(case: SamplingCase, problems: int, rng: np.random.Generator) -> list[Solved]:
    """Draw and solve so many problems."""
    return [solve(draw_problem(case, rng), rng) for _ in range(problems)]


def wrapped(apart: Array) -> Array:
    """Deviations (..., m) with the pose's heading within half a turn."""
    apart[..., 2] = np.angle(np.exp(1j * apart[..., 2]))
    return apart


def squared(apart: Array, covariance: Array) -> Array:
    """Squared Mahalanobis distances of deviations (..., b)."""
    found: Array = np.einsum("...i,...i->...", apart, np.linalg.solve(covariance, apart.T).T)
    return found


def probability(one: Solved, name: str, block: slice) -> float:
    """Probability of the smallest ellipsoid that has the truth in it, as an estimator says."""
    if name == "draws":
        flat = one.draws.draws.reshape(-1, len(one.truth))
        every = wrapped(np.vstack((flat, one.truth)) - flat.mean(axis=0))[:, block]
        distances = squared(every, np.cov(every[:-1].T))
        return float(np.mean(distances[:-1] < distances[-1]))
    mean, covariance = one.gaussians[name]
    apart = wrapped(one.truth - mean)[block]
    distance = float(squared(apart[None], covariance[block, block])[0])
    return next((p for p in LEVELS if distance <= 2.0 * gammaincinv(0.5 * len(apart), p)), 1.0)


def ranks(one: Solved, rng: np.random.Generator) -> dict[str, NDArray[np.integer]]:
    """Ranks (m,) of the truth among THINNED draws, and among as many of the smoother's Gaussian."""
    draws = one.draws.draws
    thinned = draws[:, :: draws.shape[1] // 8].reshape(-1, len(one.truth))[:THINNED]
    mean, covariance = one.gaussians["smoother"]
    gaussian = rng.multivariate_normal(mean, covariance, THINNED)
    return {
        "draws": np.sum(wrapped(thinned - one.truth) < 0.0, axis=0),
        "smoother": np.sum(wrapped(gaussian - one.truth) < 0.0, axis=0),
    }


def null_statistics(problems: int, rng: np.random.Generator) -> Array:
    """Sorted sums of squared counts of BINS under uniform ranks, 20,000 times."""
    counts = rng.multinomial(problems, np.full(BINS, 1.0 / BINS), 20_000)
    return np.sort(np.sum(counts.astype(np.float64) ** 2, axis=1))


def uniform_p(rank: NDArray[np.integer], null: Array) -> float:
    """p-value of uniform ranks 0 .. THINNED, exact but for the simulation of null_statistics."""
    counts = np.bincount(rank * BINS // (THINNED + 1), minlength=BINS)
    reached = len(null) - np.searchsorted(null, np.sum(counts**2), side="left")
    return float((1 + reached) / (1 + len(null)))


def report(name: str, solved: list[Solved], rng: np.random.Generator) -> Iterator[str]:
    """Lines on one case."""
    good = [one for one in solved if one.draws.converged]
    yield f"\n{name}: {len(solved)} problems, {len(solved) - len(good)} not converged"
    if not good:
        return
    found, null = [ranks(one, rng) for one in good], null_statistics(len(good), rng)
    size = len(good[0].truth)
    for which in ("draws", "smoother"):
        p = [uniform_p(np.array([one[which][i] for one in found]), null) for i in range(size)]
        least = min(1.0, size * min(p))
        verdict = "uniform" if least > SIGNIFICANCE else "NOT uniform"
        yield f"  ranks among {which:8s}: {verdict}, p {least:.4f} (Bonferroni, {size} numbers)"
    pose, every = slice(0, 3), slice(0, size)
    yield "  truths inside [%]    last pose 50   90   95     whole 50   90   95"
    for which in ("EKF", "smoother", "draws"):
        shares = [
            [np.mean([probability(one, which, block) <= level for one in good]) for level in LEVELS]
            for block in (pose, every)
        ]
        cells = ["".join(f"{100 * share:5.0f}" for share in row) for row in shares]
        yield f"  {which:20s}   {cells[0]}         {cells[1]}"
    yield "  exact posterior in the 95 % ellipsoid [%], least variance ratio: medians (worst)"
    for which in ("EKF", "smoother"):
        of_all = []
        for block in (pose, every):
            judged = [one.draws.judge(*one.gaussians[which], np.r_[block]) for one in good]
            inside = np.array([100.0 * j.coverage.value for j in judged])
            ratio = np.array([j.least.value for j in judged])
            of_all.append(
                f"{np.median(inside):5.1f} ({inside.min():5.1f})"
                f" {np.median(ratio):5.2f} ({ratio.min():5.2f})"
            )
        yield f"  {which:20s}   pose {of_all[0]}   whole {of_all[1]}"


def main() -> None:
    """Print every case."""
    given = options(__doc__, problems=100, cases=tuple(CASES))
    for number, (name, make) in enumerate(CASES.items()):
        if name not in given.cases:
            continue
        rng = np.random.default_rng([0, number])
        solved, cpu_s = timed(solve_all, make(), given.problems, rng)
        for line in report(name, solved, rng):
            print(line, flush=True)
        print(f"  {cpu_s:.0f} s of processor time")


if __name__ == "__main__":
    main()
