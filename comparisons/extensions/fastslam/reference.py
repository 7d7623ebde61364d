"""The smoother's posterior of a stretch: a Gaussian, and draws of the exact one."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.extensions.fastslam.drive import Start
from ekf_reference.core.geometry import wrap_angle
from graphslam.problem import SlamProblem
from graphslam.sampling import SamplingOptions, sample_posterior
from graphslam.smoother import SmootherResult, smooth

EXACT_DRAWS = 96
"""Draws that are kept of the chains, so far from each other that they are all but independent."""


class Reference(NamedTuple):
    """The smoother's posterior of the last pose and the D landmarks of a stretch, d = 3 + 2 D.

    result: of the stretch's problem. landmarks: (D,) indices in the whole log. mean: (d,). root:
    (d, d), the Cholesky factor of the covariance.
    """

    result: SmootherResult
    landmarks: Index
    mean: Array
    root: Array

    def whitened(self, states: Array) -> Array:
        """Return states (M, d) as errors, in the axes of the root's columns."""
        apart = states - self.mean
        apart[:, 2] = wrap_angle(apart[:, 2])
        return np.asarray(np.linalg.solve(self.root, apart.T).T)

    def exact_draws(self, generator: np.random.Generator) -> Array | None:
        """Draw from the exact posterior, not from its Gaussian.

        Returns:
            (EXACT_DRAWS, d), whitened by the Gaussian; None where the stretch has more unknowns
            than can be sampled, or the chains did not converge.
        """
        result, options = self.result, SamplingOptions()
        try:
            found = sample_posterior(
                result.problem, result.poses, result.landmarks, generator, options
            )
        except ValueError:
            return None
        if not found.converged:
            return None
        of_chain = EXACT_DRAWS // options.chains
        rows = np.linspace(0, options.draws - 1, of_chain).astype(int)
        return self.whitened(found.draws[:, rows].reshape(EXACT_DRAWS, -1))


def reference_of(
    problem: SlamProblem, whole: SmootherResult, epochs: tuple[int, int], start: Start
) -> Reference:
    """Smooth a stretch.

    Args:
        problem: Of the whole log.
        whole: Its optimum, from which the search begins.
        epochs: First and last of the stretch, both included.
        start: What is known at the first.
    """
    first, last = epochs
    part, landmarks = between(problem, epochs, start)
    guess = whole.poses[first : last + 1], whole.landmarks[landmarks]
    result = smooth(part, {"whole log": guess})
    mean, covariance = result.marginal()
    root = np.asarray(np.linalg.cholesky(covariance), dtype=float)
    return Reference(result, landmarks, mean, root)


def between(
    problem: SlamProblem, epochs: tuple[int, int], start: Start
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
