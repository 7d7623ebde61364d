"""Which landmark a measurement is of: by label, or decided by every particle for itself.

Source: Montemerlo and Thrun 2003; Nieto 2005, section 2.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import Measurements
from ekf_reference.fastslam.particle_maps import FREE, ParticleMaps

NEW = -1
"""The measurement is of a landmark that the particle does not have yet."""
UNUSED = -2
"""The measurement is not used by the particle."""
Choice = Literal["likeliest", "sampled"]
"""How a particle decides: for the likeliest pairs, or by chance in proportion to the likelihood, so
that particles at the same pose hold different hypotheses and resampling decides between them."""
LOG_TWO_PI = math.log(2.0 * math.pi)
_UPPER = (0, 0), (0, 1), (1, 1)


class Sight(NamedTuple):
    """Where the particles stand and how they measure.

    pose: (N, 3). root: (3, 3) of the motion that is not sampled yet, in their own frames. sensor:
    of points.
    """

    pose: Array
    root: Array
    sensor: MeasurementModel


class Assignment(NamedTuple):
    """What the measurements of a scan are of, in every particle.

    column: (N, m) of the landmark, NEW or UNUSED; distinct in each row where not negative.
    log_correction: (N,) ln of prior over proposal, by which the weight of a particle that sampled
    its assignment is multiplied; zero where nothing was sampled.
    """

    column: Index
    log_correction: Array


class ParticleAssociation(Protocol):
    """Contract of the association rules of a particle filter."""

    @property
    def log_unmatched(self) -> float:
        """Log density of a measurement that is of no landmark in the map."""

    @property
    def gate(self) -> float:
        """Normalised innovation squared beyond which a measurement is not used."""

    def rounds(self, seen: Measurements) -> Sequence[Index]:
        """Return the measurements in parts, each of which holds a landmark at most once.

        Args:
            seen: m measurements of points of one instant.

        Returns:
            Rows of each part, in the order in which the parts are fused; every row in one part.
        """

    def numbers(self, seen: Measurements, serial: int) -> NDArray[np.int64]:
        """Return the numbers that columns of new landmarks get.

        Args:
            seen: m measurements, each of a landmark that is new to some particle.
            serial: The next free serial number.

        Returns:
            (m,) labels or serial numbers.
        """

    def assign(
        self,
        maps: ParticleMaps,
        sight: Sight,
        seen: Measurements,
        generator: np.random.Generator,
    ) -> Assignment:
        """Assign the measurements to landmarks, in every particle.

        Args:
            maps: Of all particles.
            sight: Poses, motion not sampled yet, and sensor.
            seen: m measurements of points, one part of `rounds`.
            generator: Gives all random numbers.

        Returns:
            Columns (N, m), and corrections (N,) of the log weights.
        """

    def review(self, maps: ParticleMaps, pose: Array, columns: Index) -> None:
        """Change the evidence for landmarks.

        Args:
            maps: Of all particles.
            pose: (N, 3) as sampled.
            columns: (N, m) of the landmarks that were measured, negative for none.
        """


@dataclass(frozen=True)
class KnownIdentities:
    """Measurements name their landmark; those without a label are not used.

    gate: nis beyond which a label is taken for a misread: it is not fused, and counts as likely as
    a measurement at the gate.
    """

    gate: float = math.inf
    log_unmatched: float = 0.0

    def rounds(self, seen: Measurements) -> Sequence[Index]:
        """Return the first measurements of every label, then the second ones, and so on."""
        _, group = np.unique(seen.identity, return_inverse=True)
        before = np.tril(np.equal.outer(group, group), -1).sum(axis=1)
        before[seen.identity < 0] = 0
        return [np.flatnonzero(before == k) for k in range(int(before.max(initial=0)) + 1)]

    def numbers(self, seen: Measurements, serial: int) -> NDArray[np.int64]:
        """Return the labels."""
        return seen.identity

    def assign(
        self,
        maps: ParticleMaps,
        sight: Sight,
        seen: Measurements,
        generator: np.random.Generator,
    ) -> Assignment:
        """Look the labels up."""
        column = maps.columns_of(seen.identity)
        column = np.where(column == FREE, NEW, column)
        column[seen.identity < 0] = UNUSED
        n = len(sight.pose)
        return Assignment(np.tile(column, (n, 1)), np.zeros(n))

    def review(self, maps: ParticleMaps, pose: Array, columns: Index) -> None:
        """Keep everything: a label proves that its landmark exists."""


@dataclass(frozen=True)
class ExpectedDetection:
    """Where a landmark that exists should be detected: range [m], bearing either way [rad]."""

    range_m: float
    half_angle_rad: float = math.pi


@dataclass(frozen=True, kw_only=True)
class PerParticleLikelihood:
    """Every particle takes the likeliest pairs, or samples them, each landmark once in a scan.

    A pair is possible within `gate` (nis, Nieto 2005, eq. 2.58). A measurement without a pair has
    the density `new_density` [1 / (m rad)]; it starts a landmark where its nis exceeds `new_gate`
    for every other, and is not used otherwise. choice: "likeliest" takes the likeliest pair first,
    then the next, as long as they are likelier than `new_density`. "sampled" draws them by
    `sampled_pairs`, which states the prior: the weighted particles then are of the joint posterior
    of path and associations.
    Evidence for a landmark, in log odds: `gain` for each measurement, `loss` where it lies within
    `view` and is not measured, at most `most_evidence`; below zero it is removed (Montemerlo and
    Thrun 2003). margin_m: how uncertain motion and landmarks may be, when landmarks near a
    measurement are sought.
    """

    view: ExpectedDetection
    choice: Choice = "likeliest"
    gate: float = 13.82
    new_gate: float = 25.0
    new_density: float = 1e-3
    gain: float = 1.0
    loss: float = 0.3
    most_evidence: float = 20.0
    margin_m: float = 5.0

    @property
    def log_unmatched(self) -> float:
        """Log density of new landmarks."""
        return math.log(self.new_density)

    def rounds(self, seen: Measurements) -> Sequence[Index]:
        """Return all measurements at once: a landmark is taken once in a scan."""
        return [np.arange(len(seen))]

    def numbers(self, seen: Measurements, serial: int) -> NDArray[np.int64]:
        """Return serial numbers."""
        return serial + np.arange(len(seen), dtype=np.int64)

    def assign(
        self,
        maps: ParticleMaps,
        sight: Sight,
        seen: Measurements,
        generator: np.random.Generator,
    ) -> Assignment:
        """Assign by likelihood, every particle for itself."""
        measured = sight.sensor.invert(np.zeros(3), seen.z)
        spread = measured.jacobian_z @ seen.noise @ measured.jacobian_z.swapaxes(1, 2)
        reach_m = self.margin_m + np.sqrt(self.new_gate * np.trace(spread, axis1=1, axis2=2))
        columns = maps.around(sight.pose, measured.landmark, reach_m)
        n, m = len(sight.pose), len(seen)
        if not len(columns):
            return Assignment(np.full((n, m), NEW, dtype=np.intp), np.zeros(n))
        at = maps.expected(sight.pose, columns, sight.sensor)
        by_motion = at.by_pose @ sight.root
        own = at.spread + by_motion @ by_motion.swapaxes(-1, -2)
        a, b, d = (own[:, None, :, i, j] + seen.noise[:, None, i, j] for i, j in _UPPER)
        determinant = a * d - b * b
        nu = sight.sensor.innovation(seen.z[None, :, None], at.z[:, None])
        x, y = nu[..., 0], nu[..., 1]
        nis = (x * (d * x - 2.0 * b * y) + a * y * y) / determinant
        nis = np.where(maps.has(columns)[:, None], nis, np.inf)
        likelihood = -0.5 * (nis + np.log(determinant)) - LOG_TWO_PI
        score = np.where(nis <= self.gate, likelihood, -np.inf)
        if self.choice == "sampled":
            pair, log_correction = sampled_pairs(score, self.log_unmatched, generator)
        else:
            pair = best_pairs(np.where(score > self.log_unmatched, score, -np.inf))
            log_correction = np.zeros(n)
        far = nis.min(axis=2) > self.new_gate
        column = np.where(pair >= 0, columns[pair], np.where(far, NEW, UNUSED))
        return Assignment(column, log_correction)

    def review(self, maps: ParticleMaps, pose: Array, columns: Index) -> None:
        """Add to the evidence of what was measured; lessen that of what should have been."""
        n, j = np.nonzero(columns >= 0)
        measured = np.zeros(maps.evidence.shape, dtype=bool)
        measured[n, columns[n, j]] = True
        near = maps.near(pose, self.view.range_m)
        near = np.union1d(near, np.unique(columns[n, j]))
        away = maps.mean[:, near] - pose[:, None, :2]
        bearing = np.arctan2(away[..., 1], away[..., 0]) - pose[:, 2, None]
        ahead = np.cos(bearing) >= math.cos(self.view.half_angle_rad)
        visible = ahead & (np.hypot(away[..., 0], away[..., 1]) <= self.view.range_m)
        change = np.where(measured[:, near], self.gain, np.where(visible, -self.loss, 0.0))
        held = maps.evidence[:, near]
        changed = np.minimum(held + change, self.most_evidence)
        maps.evidence[:, near] = np.where((held > 0.0) | measured[:, near], changed, held)
        maps.remove(near)


def best_pairs(score: Array) -> Index:
    """Give every measurement a landmark, in every particle the best pair first, none twice.

    Args:
        score: (N, m, K), -inf where a pair is not possible.

    Returns:
        (N, m) the landmark, -1 for none.
    """
    n, m, k = score.shape
    score, choice = score.copy(), np.full((n, m), -1, dtype=np.intp)
    rows: Index = np.flatnonzero(_finite(score))
    for _ in range(min(m, k)):
        if not len(rows):
            break
        best = score[rows].reshape(len(rows), -1).argmax(axis=1)
        measurement, landmark = np.divmod(best, k)
        choice[rows, measurement] = landmark
        score[rows, measurement, :] = -np.inf
        score[rows, :, landmark] = -np.inf
        rows = rows[_finite(score[rows])]
    return choice


def sampled_pairs(
    score: Array, log_unmatched: float, generator: np.random.Generator
) -> tuple[Index, Array]:
    """Draw a landmark for every measurement, in every particle, none twice.

    Measurement after measurement takes one of the K landmarks that are possible for it and not
    taken yet, or none. Prior: equal odds of the landmarks, 1 / K each, against 1 for none.
    Proposal: prior times density of this measurement alone, normalised. The scan's densities are
    not independent where the pose is uncertain, and what is taken excludes others later: the ratio
    returned makes the weight right for that too.

    Args:
        score: (N, m, K) log densities, -inf where a pair is not possible.
        log_unmatched: Log density of a measurement of no landmark.
        generator: Gives N m uniform numbers.

    Returns:
        (N, m) the landmark, -1 for none; (N,) ln of prior over proposal of what was drawn.

    Source: Montemerlo and Thrun 2003.
    """
    n, m, k = score.shape
    row, uniform = np.arange(n), generator.random((m, n, 1))
    drawn, log_ratio = np.full((n, m), -1, dtype=np.intp), np.zeros(n)
    free = np.ones((n, k), dtype=bool)
    for j in range(m):
        own = np.where(free, score[:, j], -np.inf)
        log_prior = -np.log(np.maximum(np.isfinite(own).sum(axis=1, keepdims=True), 1))
        own = np.column_stack((own + log_prior, np.full(n, log_unmatched)))
        most = own.max(axis=1)
        bounds = np.cumsum(np.exp(own - most[:, None]), axis=1)
        pick = (bounds <= uniform[j] * bounds[:, -1:]).sum(axis=1)
        paired = np.flatnonzero(pick < k)
        log_ratio += most + np.log(bounds[:, -1]) - own[row, pick]
        log_ratio[paired] += log_prior[paired, 0]
        drawn[paired, j] = pick[paired]
        free[paired, pick[paired]] = False
    return drawn, log_ratio


def _finite(score: Array) -> Mask:
    found: Mask = np.any(np.isfinite(score), axis=(1, 2))
    return found
