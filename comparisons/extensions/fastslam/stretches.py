"""Stretches of a log that are short enough for FastSLAM, and the clouds at their ends.

Resampling loses ancestors: after a loop most particles descend from one, and the cloud is no sample
of the posterior any more. So a log is cut where few of the stretch's first particles have
descendants. Each stretch starts with an empty map at a known pose, the smoother's: the prior of the
whole log only moves all of it. Of each stretch the smoother finds the posterior from the same
measurements, with the same association.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.extensions.fastslam.drive import DriveStart, Inputs, Sampling, start_fastslam
from comparisons.logs.log import Log
from comparisons.pipeline.gaps import Gaps
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.fastslam.association import KnownIdentities
from ekf_reference.fastslam.filter import FastSlam
from graphslam.problem import SlamProblem
from graphslam.sampling import SamplingOptions, sample_posterior
from graphslam.smoother import SmootherEvidence, smooth

LEAST_ANCESTORS = 0.05
"""Share of a cloud: a stretch ends before its effective ancestors are fewer."""
PILOT = 4
"""Times the particles, in the cloud that finds the stretches: one measurement that is far off may
leave five of a hundred particles, and by chance ten."""
MOST_STRETCHES = 12
"""Stretches that are compared, evenly chosen from all of the log."""
LEAST_CLOUDS = 8
"""Of a stretch."""
KNOWN_SIGMA = np.array([1e-3, 1e-3, 1e-4])
"""Of a known pose: x, y [m], heading [rad]; exact but for a covariance that can be inverted."""


class EpochStretch(NamedTuple):
    """Epochs first to last, both included.

    depleted: already its first measurements leave fewer than LEAST_ANCESTORS.
    """

    first: int
    last: int
    depleted: bool = False


@dataclass(frozen=True, kw_only=True)
class StretchClouds:
    """Independent clouds at the end of a stretch, in sigma of the smoother's posterior.

    All errors are whitened by the Cholesky factor of the smoother's covariance of the last pose and
    the D landmarks of the stretch, d = 3 + 2 D.

    begin_s, end_s: of the stretch. depleted: of the stretch. draw: (M, d) one particle of each
    cloud, drawn by weight, with a map drawn from its Gaussians; where the posteriors are one,
    independent standard normal. mean: (M, d) weighted means of the clouds. moments: (M, 2, 3)
    skewness and excess kurtosis of x, y and heading. exact: draws (M', d) of the smoother's exact
    posterior, or None where there are none to be had.
    """

    begin_s: float
    end_s: float
    depleted: bool
    draw: Array
    mean: Array
    moments: Array
    exact: Callable[[np.random.Generator], Array | None]


class StretchComparison:
    """FastSLAM and the smoother on stretches of one log."""

    def __init__(self, gaps: Gaps, log: Log, sampling: Sampling) -> None:
        """Take the measurements and the association that both estimators had.

        log: which FastSLAM believes; its instants are those of the estimators' log. sampling: its
        seed is that of all clouds.
        """
        run = gaps.run
        self._log, self._sampling = log, sampling
        self._problem, self._whole = gaps.problem, gaps.result
        self._time_s = run.timeline.epoch_time_s
        self._inputs = Inputs(log, run.timeline, np.asarray(run.landmark_index, dtype=np.int64))
        self._last = self._inputs.epochs - 1

    def run(
        self, clouds: int, progress: Callable[[int, int], None] = lambda done, total: None
    ) -> list[StretchClouds]:
        """Run so many clouds, divided among the stretches. progress: called before each stretch."""
        chosen = self.stretches(min(MOST_STRETCHES, clouds // LEAST_CLOUDS))
        found = []
        for k, stretch in enumerate(chosen):
            progress(k, len(chosen))
            found.append(self.clouds(stretch, k, clouds // len(chosen)))
        return found

    def stretches(self, most: int) -> list[EpochStretch]:
        """Return the stretches to compare, by one cloud that starts anew in each."""
        epoch_stretches: list[EpochStretch] = []
        first = 0
        while first < self._last or not epoch_stretches:
            epoch_stretches.append(self._stretch(first, len(epoch_stretches)))
            first = epoch_stretches[-1].last
        few = np.linspace(0, len(epoch_stretches) - 1, min(len(epoch_stretches), most))
        return [epoch_stretches[k] for k in few.round().astype(int)]

    def _stretch(self, first: int, number: int) -> EpochStretch:
        """Drive until too few ancestors are left, or to the end of the log."""
        particles = PILOT * self._sampling.particles
        slam = self._slam(first, (number,), particles)
        enough = first
        for k in range(first, self._last + 1):
            if not self._advance(slam, k, first):
                continue
            if slam.history.effective_ancestors(slam.weight) < LEAST_ANCESTORS * len(slam.pose):
                if enough > first:
                    return EpochStretch(first, enough)
                return EpochStretch(first, min(max(k, first + 1), self._last), depleted=True)
            enough = k
        return EpochStretch(first, self._last)

    def clouds(self, stretch: EpochStretch, number: int, count: int) -> StretchClouds:
        """Run M independent clouds through a stretch, and the smoother. number: for the seeds."""
        first, last, depleted = stretch
        reference = reference_of(self._problem, self._whole, (first, last), self._known(first))
        draws, means, moments = [], [], []
        for k in range(count):
            slam = self._driven(stretch, (number, k))
            columns = slam.maps.columns_of(reference.landmarks)
            draws.append(draw_particle(slam, columns))
            places = np.einsum("n,nli->li", slam.weight, slam.maps.mean[:, columns])
            means.append(np.concatenate((slam.mean_pose(), places.ravel())))
            moments.append(standardised_moments(slam.pose, slam.weight))
        return StretchClouds(
            begin_s=float(self._time_s[first]),
            end_s=float(self._time_s[last]),
            depleted=depleted,
            draw=reference.whitened(np.array(draws)),
            mean=reference.whitened(np.array(means)),
            moments=np.array(moments),
            exact=reference.exact_draws,
        )

    def _driven(self, stretch: EpochStretch, number: tuple[int, ...]) -> FastSlam:
        """Return a cloud at the end of a stretch, all of its motion sampled."""
        slam = self._slam(stretch.first, number, self._sampling.particles)
        for epoch in range(stretch.first, stretch.last + 1):
            self._advance(slam, epoch, stretch.first)
        if slam.motion.covariance.any():
            slam.sample_motion()
        return slam

    def _slam(self, first: int, number: tuple[int, ...], particles: int) -> FastSlam:
        """Return a cloud at the known pose of an epoch.

        number: of the stretch, or of the stretch and the cloud; their random numbers are apart.
        """
        sampling = self._sampling._replace(particles=particles, stream=(len(number), *number))
        return start_fastslam(self._log, sampling, KnownIdentities(), self._known(first))

    def _known(self, epoch: int) -> DriveStart:
        """Return the smoother's pose, taken for known."""
        return DriveStart(self._whole.poses[epoch], np.diag(KNOWN_SIGMA**2))

    def _advance(self, slam: FastSlam, epoch: int, first: int) -> bool:
        """Move to an epoch, unless it is the first, and observe; return whether that was done."""
        if epoch > first:
            self._inputs.predict(slam, epoch)
        measurements = self._inputs.seen(epoch)
        measurements = measurements.take(np.flatnonzero(measurements.identity >= 0))
        if len(measurements):
            slam.observe(measurements)
        return len(measurements) > 0


def draw_particle(slam: FastSlam, columns: Index) -> Array:
    """Return one particle's pose and a draw of its map, (3 + 2 D,), by weight.

    columns: (D,) of landmarks that all particles have.
    """
    generator, maps = slam.generator, slam.maps
    i = int(generator.choice(len(slam.pose), p=slam.weight))
    root = np.linalg.cholesky(maps.covariance[i, columns])
    error = root @ generator.standard_normal((len(columns), 2, 1))
    return np.concatenate((slam.pose[i], (maps.mean[i, columns] + error[..., 0]).ravel()))


def standardised_moments(pose: Array, weight: Array) -> Array:
    """Return skewness and excess kurtosis (2, 3) of weighted poses (N, 3).

    A cloud that is a single point has the moments of a Gaussian.
    """
    apart = pose - weight @ pose
    variance = weight @ apart**2
    if not (variance > 0.0).all():
        return np.zeros((2, 3))
    return np.stack(((weight @ apart**3) / variance**1.5, (weight @ apart**4) / variance**2 - 3.0))


EXACT_DRAWS = 96
"""Draws that are kept of the chains, so far from each other that they are all but independent."""


class StretchPosterior(NamedTuple):
    """The smoother's posterior of the last pose and the D landmarks of a stretch, d = 3 + 2 D.

    result: of the stretch's problem. landmarks: (D,) indices in the whole log. mean: (d,). root:
    (d, d), the Cholesky factor of the covariance.
    """

    result: SmootherEvidence
    landmarks: Index
    mean: Array
    root: Array

    def whitened(self, states: Array) -> Array:
        """Return states (M, d) as errors, in the axes of the root's columns."""
        apart = states - self.mean
        apart[:, 2] = wrap_angle(apart[:, 2])
        return np.asarray(np.linalg.solve(self.root, apart.T).T)

    def exact_draws(self, generator: np.random.Generator) -> Array | None:
        """Draw (EXACT_DRAWS, d) from the exact posterior, whitened by its Gaussian.

        None where the stretch has more unknowns than can be sampled, or the chains did not
        converge.
        """
        result, options = self.result, SamplingOptions()
        try:
            draws = sample_posterior(
                result.problem, result.poses, result.landmarks, generator, options
            )
        except ValueError:
            return None
        if not draws.converged:
            return None
        of_chain = EXACT_DRAWS // options.chains
        rows = np.linspace(0, options.draws - 1, of_chain).astype(int)
        return self.whitened(draws.draws[:, rows].reshape(EXACT_DRAWS, -1))


def reference_of(
    problem: SlamProblem, whole: SmootherEvidence, epochs: tuple[int, int], start: DriveStart
) -> StretchPosterior:
    """Smooth a stretch of a problem, from the whole log's optimum on.

    epochs: first and last, both included. start: what is known at the first.
    """
    first, last = epochs
    part, landmarks = between(problem, epochs, start)
    guess = whole.poses[first : last + 1], whole.landmarks[landmarks]
    result = smooth(part, {"whole log": guess})
    mean, covariance = result.marginal()
    root = np.asarray(np.linalg.cholesky(covariance), dtype=float)
    return StretchPosterior(result, landmarks, mean, root)


def between(
    problem: SlamProblem, epochs: tuple[int, int], start: DriveStart
) -> tuple[SlamProblem, Index]:
    """Return the motion and the measurements of a stretch, and the landmarks (D,) that it has."""
    first, last = epochs
    pose = problem.measurement_pose
    rows = np.flatnonzero((pose >= first) & (pose <= last))
    landmarks, index = np.unique(problem.measurement_landmark[rows], return_inverse=True)
    part = replace(
        problem,
        prior_pose=start.pose,
        prior_covariance=start.covariance,
        increment=problem.increment[first:last],
        increment_covariance=problem.increment_covariance[first:last],
        measurement_pose=pose[rows] - first,
        measurement_landmark=index,
        z=problem.z[rows],
        sigma=problem.sigma[rows],
        landmark_count=len(landmarks),
    )
    return part, landmarks
