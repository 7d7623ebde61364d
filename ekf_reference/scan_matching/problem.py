"""The alignment problem: two sums of Gaussians, a prior, and which pairs count."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from ekf_reference.core.geometry import Array, Mask, rotation
from ekf_reference.scan_matching.correlation import CorrespondenceSearch, Pairs, laid, plane
from ekf_reference.scan_matching.sog import SumOfGaussians

_SHORTEST_M = 0.1
"""Least lever of a sum that is all in one place."""
SLACK = 0.25
"""Pairs are looked up again after a motion by so many typical sigmas."""


@dataclass(frozen=True, kw_only=True)
class AlignmentOptions:
    """How maxima are sought.

    inflation_m: sigmas by which all covariances are inflated, in stages; the last must be 0, the
    correlation itself. spacing_m: of the starts; the first inflation must bridge it. starts: most
    that are followed; finished: most that are followed to the end. neighbours: most Gaussians of
    the second sum that one of the first is paired with, neighbours_inflated: in stages that only
    prepare another; reach: within so many sigmas. iterations: most
    per stage. converged_m: a step so small, at the lever's end, is the last.
    """

    inflation_m: tuple[float, ...] = (0.6, 0.2, 0.0)
    spacing_m: float = 0.8
    starts: int = 4
    finished: int = 2
    neighbours: int = 32
    neighbours_inflated: int = 12
    reach: float = 3.5
    iterations: int = 30
    converged_m: float = 1e-6

    def __post_init__(self) -> None:
        """Check the stages."""
        if not self.inflation_m or self.inflation_m[-1] != 0.0:
            raise ValueError(f"inflations {self.inflation_m} m, expected the last to be 0")


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Two sums to align. first is about its centroid, so that turns and shifts are nearly apart.

    guess: (3,) and covariance: (3, 3) of the centred sum's pose. unit: (3,) in which the three
    directions weigh alike, metres at the lever's end.
    """

    first: SumOfGaussians
    second: SumOfGaussians
    centre: Array
    guess: Array
    covariance: Array
    unit: Array
    options: AlignmentOptions

    @classmethod
    def of(
        cls,
        first: SumOfGaussians,
        second: SumOfGaussians,
        guess: Array,
        covariance: Array,
        options: AlignmentOptions | None = None,
    ) -> Self:
        """Raises ValueError for a guess (3,) or a covariance (3, 3) that cannot be used."""
        guess, covariance = np.asarray(guess, dtype=float), np.asarray(covariance, dtype=float)
        if guess.shape != (3,) or not np.isfinite(guess).all():
            raise ValueError(f"the guess is {guess}, expected three finite numbers")
        if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
            raise ValueError("the guess's covariance must be three by three, and finite")
        if np.linalg.eigvalsh(covariance)[0] < 0.0:
            raise ValueError("the guess's covariance has a negative eigenvalue")
        centre = first.centroid
        jacobian = carried(guess, centre)
        return cls(
            first=SumOfGaussians(
                first.mean - centre, first.covariance, first.weight, first.boundary
            ),
            second=second,
            centre=centre,
            guess=moved(guess, centre),
            covariance=jacobian @ covariance @ jacobian.T,
            unit=np.array((1.0, 1.0, 1.0 / max(first.lever_m, _SHORTEST_M))),
            options=options or AlignmentOptions(),
        )

    @property
    def covariance_scaled(self) -> Array:
        """(3, 3) the guess's, in units."""
        return self.covariance / np.outer(self.unit, self.unit)

    def pairs(self, pose: Array, inflation_m: float = 0.0, counted: Mask | None = None) -> Pairs:
        """Neighbours at poses (K, 3). counted: (K, N) which of the first sum, by default all."""
        o = self.options
        most = o.neighbours_inflated if inflation_m > 0.0 else o.neighbours
        far = o.reach * math.sqrt(
            self.first.typical_variance + self.second.typical_variance + inflation_m**2
        )
        wanted = CorrespondenceSearch(
            most, far, o.reach, inflation_m, SLACK * self.size_m(inflation_m)
        )
        return Pairs.near(self.first, self.second, pose, wanted, counted)

    def size_m(self, inflation_m: float = 0.0) -> float:
        """Sigma of a typical Gaussian of the first sum: the scale of what Lambda feels."""
        return math.sqrt(self.first.typical_variance + inflation_m**2)

    def each(self, pairs: Pairs, pose: Array) -> Array:
        """(K, N) what each of the first sum adds to Lambda at poses (K, 3), by their pairs."""
        size = len(self.first)
        added = np.bincount(
            pairs.at * size + pairs.row, pairs.terms(pose), minlength=len(pose) * size
        )
        return added.astype(float).reshape(-1, size)


def moved(pose: Array, shift: Array) -> Array:
    """(3,) the pose of a point (2,) of a body at a pose (3,), heading as the body's."""
    return np.append(pose[:2] + rotation(float(pose[2])) @ shift, pose[2])


def carried(pose: Array, shift: Array) -> Array:
    """(3, 3) derivative of `moved` by the pose."""
    jacobian = np.eye(3)
    x, y = rotation(float(pose[2])) @ shift
    jacobian[:2, 2] = -y, x
    return jacobian


def on_no_boundary(problem: Problem, pose: Array, across_sigmas: float = math.inf) -> Mask:
    """(K, N) which of the first sum lie nearest to something of the second that is on no boundary.

    pose: (K, 3). Those farther off the surface at the boundary than so many sigmas count, too.
    The others must not: two views of one wall would correlate best where their ends meet, which
    only says where the sensors were. (Turk and Levoy 1994 leave out such pairs of meshes.)
    """
    second = problem.second
    if not second.boundary.any():
        return np.ones((len(pose), len(problem.first)), dtype=bool)
    place = plane(laid(problem.first.point, pose))
    near = second.tree.query(place)[1]
    inside: Mask = ~second.boundary[near]
    lost = np.flatnonzero(~inside)
    if math.isfinite(across_sigmas) and len(lost):
        size, axes = np.linalg.eigh(second.covariance[near[lost]])
        apart = second.mean[near[lost]] - place[lost]
        across = np.square(np.einsum("ni,ni->n", apart, axes[:, :, 0]))
        inside[lost] = across > across_sigmas**2 * size[:, 0]
    return inside.reshape(len(pose), -1)
