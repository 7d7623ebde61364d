"""EKF on wheels, smoother on wheels, smoother on scans: do they agree on the landmarks?

The smoother on scans shares the sightings with the other two, but not what the vehicle's motion
rests on. A difference that the stated sigmas do not cover says that one of the two kinds of
motion is not what it says of itself; which one, its own chi-square or the truth tells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from comparisons.checks.accuracy import Accuracy, aligned
from comparisons.estimates.estimate import Estimate
from graphslam.optimum import ChiSquareTest, Proof, chi_square_test
from graphslam.smoother import SmootherResult

Array = NDArray[np.float64]

_CHI2_2_99 = float(chi2.ppf(0.99, 2))
_CLEARLY = 1.5
"""Of two errors, one so many times the other tells the worse motion."""
MOST_OUTSIDE = 0.05
"""Share of landmarks that may lie beyond their 99 % region before the maps disagree."""


@dataclass(frozen=True)
class Pair:
    """Two maps of the same landmarks.

    rms_m: of the differences, and after the rigid motion that fits best. distance_sigma: (L,) root
    of half the squared Mahalanobis distance of each, by the sum of both covariances, which is more
    than that of the difference where sightings are shared. outside: beyond the 99 % region.
    """

    rms_m: float
    rms_aligned_m: float
    distance_sigma: Array
    outside: int

    @property
    def agrees(self) -> bool:
        """As many landmarks lie inside as chance allows."""
        return self.outside <= max(1.0, MOST_OUTSIDE * len(self.distance_sigma))


@dataclass(frozen=True)
class ThreeWay:
    """The smoother on scans beside the two estimates on wheels.

    estimate, proof, accuracy: of the smoother on scans. chi_square: see readable. ekf, smoother:
    each of the two on wheels against it. loops: closures in its graph. culprit: `wheels`, `scans`,
    or neither where nothing tells or all agree; evidence: why.
    """

    estimate: Estimate
    proof: Proof
    chi_square: ChiSquareTest
    accuracy: Accuracy | None
    ekf: Pair
    smoother: Pair
    loops: int
    culprit: str
    evidence: str


def compare_maps(first: Estimate, second: Estimate) -> Pair:
    """Landmarks that both have, by id. Raises ValueError when they share none."""
    _, i, j = np.intersect1d(
        first.landmark_id, second.landmark_id, assume_unique=True, return_indices=True
    )
    if not len(i):
        raise ValueError("the maps share no landmark")
    a, b = first.landmark[i], second.landmark[j]
    total = first.landmark_covariances()[i] + second.landmark_covariances()[j]
    squared = np.einsum("ni,ni->n", a - b, np.linalg.solve(total, (a - b)[:, :, None])[:, :, 0])
    return Pair(
        float(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1)))),
        float(np.sqrt(np.mean(np.sum((aligned(a, b) - b) ** 2, axis=1)))),
        np.sqrt(squared / 2.0),
        int(np.count_nonzero(~(squared <= _CHI2_2_99))),  # what is no number lies nowhere
    )


def readable(result: SmootherResult) -> Proof:
    """The proof with a chi-square that counts its degrees of freedom, kernels or not.

    A robust kernel only lowers the error, so what is too high under it is so without it.
    """
    problem = result.problem
    dof = problem.residual_dimension - problem.state_dimension
    return replace(result.proof, chi_square=chi_square_test(result.error, dof))


def find_culprit(
    wheels: Proof,
    scans: Proof,
    accuracy_wheels: Accuracy | None,
    accuracy_scans: Accuracy | None,
) -> tuple[str, str]:
    """Whose motion is to blame for a disagreement, and the evidence; `` when nothing tells.

    wheels, scans: with a chi-square that can be read, see readable.
    """
    for name, proof in (("wheels", wheels), ("scans", scans)):
        other = scans if name == "wheels" else wheels
        if proof.chi_square.reading == "too high" and other.chi_square.reading != "too high":
            test = proof.chi_square
            return name, (
                f"with the {name}' motion chi-square is {test.chi2:.0f} for {test.dof} degrees of "
                "freedom, too high"
            )
    figures = ("ate_aligned_m", "gps_rms_aligned_m", "landmark_rmse_aligned_m")
    for figure in figures:
        w, s = (getattr(a, figure, None) for a in (accuracy_wheels, accuracy_scans))
        if w is not None and s is not None and max(w, s) > _CLEARLY * min(w, s):
            name = "wheels" if w > s else "scans"
            return name, f"{figure} is {w:.3f} on wheels and {s:.3f} on scans"
    return "", "neither chi-square nor a reference tells which"
