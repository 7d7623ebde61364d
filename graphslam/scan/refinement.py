"""Planar alignment of a cloud to surfaces, and how well the surfaces fix it.

Gauss-Newton on distances to the surfaces near each point, least squares with Cauchy weights. What
the shape does not fix stays as guessed and gets a wide variance instead of an invented one
(Zhang, Kaess and Singh 2016, solution remapping).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphslam.arrays import Array
from graphslam.scan import planar
from graphslam.scan.registration import Registration, ScanError
from graphslam.scan.surfaces import SurfaceMap

_CONVERGED = 3e-4
"""Steps below this, in metres and radians, are well inside any laser's noise."""


@dataclass(frozen=True, kw_only=True)
class RefinementOptions:
    """How to align and what to believe.

    reach_m: pairs further apart are no pairs. iterations: at most; 0 only judges the guess.
    least_pairs: fewer make a match worthless. least_overlap: share of the points that must have
    a pair. least_stiffness: a direction fixed by fewer pairs counts as not fixed at all, and gets
    free_sigma_m. floor_m: the residual is never believed to be smaller. calibration: factor on
    the variance, 1 for the plain Hessian's.
    """

    reach_m: float = 0.3
    iterations: int = 5
    least_pairs: int = 10
    least_overlap: float = 0.3
    least_stiffness: float = 3.0
    free_sigma_m: float = 1.0
    floor_m: float = 0.005
    calibration: float = 1.0


def refine(
    source: Array, target: SurfaceMap, guess: Array, options: RefinementOptions | None = None
) -> Registration:
    """Lay source (N, 2 or 3 as the target) onto the target from a guess (3,), and judge it.

    Raises ScanError when too few points have a surface near them.
    """
    options = options or RefinementOptions()
    motion = guess.astype(float)
    system = _linearise(source, target, motion, options)
    for _ in range(options.iterations):
        step = system.step()
        motion = motion + step
        if np.abs(step).max() < _CONVERGED:
            break
        system = _linearise(source, target, motion, options)
    if system.overlap < options.least_overlap:
        raise ScanError(
            f"only {system.overlap:.0%} of the points have a surface near, expected "
            f"{options.least_overlap:.0%} at least"
        )
    return Registration(
        motion=motion,
        covariance=system.covariance(motion[2]),
        inliers=system.pairs,
        overlap=system.overlap,
        residual_m=math.sqrt(system.variance),
        stiffness=system.stiffness,
        open_directions=3 - int(np.count_nonzero(system.fixed)),
    )


class _System:
    """The normal equations at one pose, in axes scaled so that heading, too, is in metres."""

    def __init__(
        self, jacobian: Array, error: Array, pairs: int, total: int, options: RefinementOptions
    ) -> None:
        self.pairs, self.overlap, self._options = pairs, pairs / total, options
        scale = max(1.4826 * float(np.median(np.abs(error))), options.floor_m)
        weight = 1.0 / (1.0 + (error / (2.385 * scale)) ** 2)
        lever = math.sqrt(float(np.mean(jacobian[:, 2] ** 2))) or 1.0
        self._scale = np.array((1.0, 1.0, 1.0 / max(lever, 0.1)))
        scaled = jacobian * self._scale
        weighted = scaled * weight[:, None]
        self.stiffness, self._axes = np.linalg.eigh(weighted.T @ scaled)
        self._gradient = self._axes.T @ (weighted.T @ error)
        freedom = max(float(weight.sum()) - 3.0, 1.0)
        variance = float(weight @ error**2) / freedom
        self.variance = max(variance, options.floor_m**2)

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """(3,) which principal directions enough pairs fix."""
        return self.stiffness >= self._options.least_stiffness

    def step(self) -> Array:
        """(3,) the Gauss-Newton step along the directions that are fixed."""
        along = np.where(self.fixed, self._gradient / np.maximum(self.stiffness, 1e-12), 0.0)
        step: Array = self._scale * (self._axes @ along)
        return step

    def covariance(self, heading: float) -> Array:
        """(3, 3) of the right perturbation."""
        variance = np.where(
            self.fixed,
            self._options.calibration * self.variance / np.maximum(self.stiffness, 1e-12),
            self._options.free_sigma_m**2,
        )
        root = self._scale[:, None] * self._axes * np.sqrt(variance)
        own = planar.rotation(heading).T @ root
        covariance: Array = own @ own.T
        return covariance


def _linearise(
    source: Array, target: SurfaceMap, motion: Array, options: RefinementOptions
) -> _System:
    """Pair points with surfaces: along the normal of a surface, along both axes of a clump."""
    place = planar.moved(motion, source)
    patch = target.patches(place)
    offset = patch.centre - place[:, :2]
    across = np.einsum("ni,ni->n", offset, patch.normal)
    flat = patch.flat & (np.abs(across) < options.reach_m)
    clump = ~patch.flat & patch.filled & (np.hypot(*offset.T) < options.reach_m)
    pairs = int(np.count_nonzero(flat) + np.count_nonzero(clump))
    if pairs < options.least_pairs:
        raise ScanError(
            f"only {pairs} of {len(source)} points have a surface near, expected "
            f"{options.least_pairs} at least"
        )
    swing = place[:, :2] - motion[:2]
    normal, arm = patch.normal[flat], swing[flat]
    lever, x, y = swing[clump], np.zeros((len(swing[clump]), 3)), np.zeros((len(swing[clump]), 3))
    x[:, 0], x[:, 2] = 1.0, -lever[:, 1]
    y[:, 1], y[:, 2] = 1.0, lever[:, 0]
    turn = normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]
    return _System(
        np.vstack((np.column_stack((normal, turn)), x, y)),
        np.concatenate((across[flat], offset[clump, 0], offset[clump, 1])),
        pairs,
        len(source),
        options,
    )
