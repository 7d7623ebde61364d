"""FastSLAM 1.0 and 2.0 (Nieto 2005, section 2.2.1; Montemerlo et al. 2002 and 2003)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.ekf import Stabilisation, StepNoise
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT, MeasurementModel
from ekf_reference.core.measurements import Measurements
from ekf_reference.fastslam.accumulated_motion import AccumulatedMotion, moved
from ekf_reference.fastslam.association import (
    LOG_TWO_PI,
    NEW,
    KnownIdentities,
    ParticleAssociation,
    Sight,
)
from ekf_reference.fastslam.history import CloudHistory
from ekf_reference.fastslam.particle_maps import FREE, ParticleMaps, inverse_2x2
from ekf_reference.fastslam.resampling import (
    effective_sample_size,
    log_mean_exp,
    normalised,
    systematic_parents,
)
from ekf_reference.models.motion import MotionModel
from ekf_reference.models.range_bearing import RangeBearing

Proposal = Literal["motion", "measurement"]
"""From what a pose is sampled: the motion (FastSLAM 1.0), or the motion conditioned on the scan's
measurements (FastSLAM 2.0)."""
_FIRST_EVIDENCE = 1e-9


@dataclass(frozen=True, kw_only=True)
class FastSlamOptions:
    """How a FastSLAM samples.

    particles: N. proposal: see Proposal. resample_share: resample where the effective sample size
    falls below this share of N. association: of measurements. sensor: of points.
    largest_heading_sigma_rad: the motion is sampled when its heading is more uncertain, with or
    without a measurement, since a Gaussian is no longer its distribution.
    """

    particles: int = 100
    proposal: Proposal = "measurement"
    resample_share: float = 0.5
    association: ParticleAssociation = field(default_factory=KnownIdentities)
    sensor: MeasurementModel = field(default_factory=RangeBearing)
    largest_heading_sigma_rad: float = 0.1

    def __post_init__(self) -> None:
        """Raise ValueError for numbers that make no filter."""
        if self.particles < 1:
            raise ValueError(f"particles is {self.particles}, expected 1 or more")
        if not 0.0 <= self.resample_share <= 1.0:
            raise ValueError(f"resample_share is {self.resample_share}, expected 0 to 1")
        if self.largest_heading_sigma_rad <= 0.0:
            raise ValueError(
                f"largest_heading_sigma_rad is {self.largest_heading_sigma_rad}, expected above 0"
            )


class MixtureMap(NamedTuple):
    """The map of the whole cloud, a landmark a row.

    number: (L,) labels, or serial numbers where particles associate. mean: (L, 2), average of the
    Gaussian means over the particles that have the landmark (Nieto 2005, Fig. 2.13). covariance:
    (L, 2, 2), of the mixture. share: (L,) weight of the particles that have it.
    """

    number: NDArray[np.int64]
    mean: Array
    covariance: Array
    share: Array


class FastSlam:
    """Particles over the path, an EKF per landmark and particle (Nieto 2005, eqs. 2.18 to 2.20).

    Call `predict` for every control and `observe` for every scan. pose: (N, 3) as sampled last,
    headings unwrapped. log_weight: (N,), up to a constant. log_evidence: ln of the estimated
    density of all measurements given the models; of those of new landmarks it has
    `association.log_unmatched`. maps, motion, history: see their classes.
    """

    def __init__(
        self,
        model: MotionModel,
        prior_pose: Array,
        prior_covariance: Array,
        generator: np.random.Generator,
        options: FastSlamOptions | None = None,
        stabilisation: StepNoise | None = None,
    ) -> None:
        """Draw the particles from the prior, with empty maps.

        Args:
            model: The vehicle model, SE(2)-equivariant.
            prior_pose: (3,) x, y [m], heading [rad].
            prior_covariance: (3, 3), positive semidefinite, of the additive global error.
            generator: All random numbers; the filter advances it.
            options: How to sample.
            stabilisation: Noise that every step adds, the same in all frames; none by default.

        Raises:
            ValueError: The prior is not of x, y and heading, or not finite.
        """
        if np.shape(prior_pose) != (3,) or np.shape(prior_covariance) != (3, 3):
            raise ValueError(
                f"prior of shapes {np.shape(prior_pose)} and {np.shape(prior_covariance)}, "
                "expected (3,) and (3, 3)"
            )
        if not (np.isfinite(prior_pose).all() and np.isfinite(prior_covariance).all()):
            raise ValueError("the prior is not finite")
        self.options = options or FastSlamOptions()
        self.model, self.generator = model, generator
        self.stabilisation: StepNoise = stabilisation or Stabilisation()
        n = self.options.particles
        value, vector = np.linalg.eigh(prior_covariance)
        root = vector * np.sqrt(np.maximum(value, 0.0))
        self.pose: Array = prior_pose + generator.standard_normal((n, 3)) @ root.T
        self.log_weight: Array = np.zeros(n)
        self.log_evidence = 0.0
        self.maps, self.motion, self.history = ParticleMaps(n), AccumulatedMotion(), CloudHistory()
        self._serial = 0

    @property
    def weight(self) -> Array:
        """(N,) weights, which sum to one."""
        return normalised(self.log_weight)

    def predict(self, control: Array, covariance: Array, duration_s: float) -> None:
        """Move the vehicle.

        Args:
            control: (m,) in the motion model's units, constant during the step.
            covariance: (m, m) of the control's error.
            duration_s: The step's [s].
        """
        self.motion.add(self.model, control, covariance, duration_s, self.stabilisation)
        if self.motion.covariance[2, 2] > self.options.largest_heading_sigma_rad**2:
            self.sample_motion()

    def predicted_pose(self) -> Array:
        """Return the particles (N, 3) moved by the mean of the motion that is not sampled yet."""
        return moved(self.pose, self.motion.mean)

    def mean_pose(self) -> Array:
        """Return the weighted mean (3,) of the predicted particles, its heading unwrapped."""
        return self.weight @ self.predicted_pose()

    def sample_motion(self) -> None:
        """Sample the motion since the last sampled pose, without a measurement (eq. 2.9)."""
        noise = self.generator.standard_normal(self.pose.shape)
        self.pose = moved(self.predicted_pose(), noise @ self.motion.root_at_arrival().T)
        self.motion = AccumulatedMotion()

    def observe(self, seen: Measurements) -> Index:
        """Resample where the last epoch asks for it, sample poses, weigh them, update the maps.

        Args:
            seen: Measurements of points of one instant; none are allowed.

        Returns:
            (N, m) number of the landmark that each particle took each measurement for; negative
            where it did not use it.

        Raises:
            ValueError: The measurements are not of points, or not finite.
        """
        if seen.kind != POINT or not np.isfinite(seen.z).all():
            raise ValueError("measurements are not of points, or not finite")
        self._resample()
        if self.options.proposal == "motion" or not len(seen):
            self.sample_motion()
        numbers = np.full((len(self.pose), len(seen)), FREE, dtype=np.int64)
        columns = np.full(numbers.shape, FREE, dtype=np.intp)
        before = log_mean_exp(self.log_weight)
        rule = self.options.association
        for rows in rule.rounds(seen) if len(seen) else ():
            columns[:, rows] = self._fuse(seen.take(rows))
            used = columns[:, rows] >= 0
            numbers[:, rows] = np.where(used, self.maps.number[columns[:, rows]], FREE)
        self.log_evidence += log_mean_exp(self.log_weight) - before
        if len(seen):
            rule.review(self.maps, self.pose, columns)
        self.history.add(self.pose, self.weight)
        return numbers

    def _fuse(self, seen: Measurements) -> Index:
        """Sample, weigh (eq. 2.10) and map with measurements of distinct landmarks.

        Without motion left to sample, the same lines are FastSLAM 1.0. Returns columns (N, m).
        """
        options, maps = self.options, self.maps
        sensor, rule = options.sensor, options.association
        sight = Sight(self.predicted_pose(), self.motion.root_at_arrival(), sensor)
        columns, log_correction = rule.assign(maps, sight, seen, self.generator)
        matched = columns >= 0
        at = maps.expected(sight.pose, columns, sensor)
        nu = sensor.innovation(seen.z[None], at.z)[..., None]
        by_motion = at.by_pose @ sight.root  # H_x of u, where error = root u, u ~ N(0, I)
        q = at.spread + seen.noise  # Q = H_m C H_m^T + R
        inverse, determinant = inverse_2x2(q)
        s_inverse, s_determinant = inverse_2x2(q + by_motion @ by_motion.swapaxes(-1, -2))
        nis = (nu.swapaxes(-1, -2) @ s_inverse @ nu)[..., 0, 0]
        used = matched & (nis <= rule.gate)
        inverse = np.where(used[..., None, None], inverse, 0.0)
        weighted = by_motion.swapaxes(-1, -2) @ inverse
        information = np.eye(3) + (weighted @ by_motion).sum(axis=1)  # I + H^T Q^-1 H
        vector = (weighted @ nu).sum(axis=1)  # H^T Q^-1 nu
        root = np.linalg.cholesky(information)
        half = np.linalg.solve(root, vector)
        # ln N(nu; 0, S), S = H_x P H_x^T + Q of all measurements together, by the lemmas of
        # Woodbury and of the determinant: the weight of FastSLAM 2.0.
        misfit = (nu.swapaxes(-1, -2) @ inverse @ nu)[..., 0, 0].sum(axis=1)
        misfit -= (half * half).sum(axis=(1, 2))
        size = 2.0 * np.log(root.diagonal(axis1=1, axis2=2)).sum(axis=1)
        size += np.where(used, np.log(determinant), 0.0).sum(axis=1)
        self.log_weight = self.log_weight - 0.5 * (misfit + size) - LOG_TWO_PI * used.sum(axis=1)
        beyond = np.where(matched & ~used, -0.5 * (rule.gate + np.log(s_determinant)), 0.0)
        beyond = np.where(matched & ~used, beyond - LOG_TWO_PI, 0.0)
        self.log_weight += beyond.sum(axis=1) + rule.log_unmatched * (~matched).sum(axis=1)
        self.log_weight += log_correction
        # The sample of N(A^-1 b, A^-1), A the information: the proposal of FastSLAM 2.0.
        noise = self.generator.standard_normal(half.shape)
        u = np.linalg.solve(root.swapaxes(-1, -2), half + noise)[..., 0]
        self.pose = moved(sight.pose, u @ sight.root.T)
        self.motion = AccumulatedMotion()
        self._map(seen, columns, used)
        return self._initialise(seen, columns)

    def _map(self, seen: Measurements, columns: Index, used: NDArray[np.bool_]) -> None:
        """Update landmarks at the sampled poses."""
        at = self.maps.expected(self.pose, columns, self.options.sensor)
        innovation = self.options.sensor.innovation(seen.z[None], at.z)
        self.maps.update(columns, used, at, innovation, seen.noise)

    def _initialise(self, seen: Measurements, columns: Index) -> Index:
        """Initialise new landmarks at the sampled poses; return columns (N, m) with theirs."""
        new, maps = columns == NEW, self.maps
        rows = np.flatnonzero(new.any(axis=0))
        if not len(rows):
            return columns
        rule, place = self.options.association, np.full(len(seen), FREE, dtype=np.intp)
        place[rows] = maps.allocate(rule.numbers(seen.take(rows), self._serial))
        self._serial += len(rows)
        maps.evidence[:, place[rows]] = np.where(new[:, rows], _FIRST_EVIDENCE, 0.0)
        maps.initialise(self.pose, place, new, (seen.z, seen.noise), self.options.sensor)
        return np.where(new, place, columns)

    def _resample(self) -> None:
        """Draw a new generation where the effective sample size is too small.

        It waits for the next epoch, since the weighted cloud estimates better than its children.
        """
        weight, n = self.weight, len(self.pose)
        enough = effective_sample_size(weight) >= self.options.resample_share * n
        if enough or not self.history.pose:
            return
        parents = systematic_parents(weight, self.generator)
        self.history.inherit(parents)
        self.log_weight = np.zeros(n)
        self.pose = self.pose[parents]
        self.maps.inherit(parents)

    def mixture_map(self) -> MixtureMap:
        """Return the map of all particles together."""
        maps, weight = self.maps, self.weight
        held = maps.evidence > 0.0
        column = np.flatnonzero((maps.number != FREE) & held.any(axis=0))
        part = weight[:, None] * held[:, column]
        share = part.sum(axis=0)
        present = share > 0.0
        column, share = column[present], share[present]
        part = part[:, present] / share
        mean = np.einsum("nl,nli->li", part, maps.mean[:, column])
        apart = maps.mean[:, column] - mean
        covariance = np.einsum("nl,nlij->lij", part, maps.covariance[:, column])
        covariance += np.einsum("nl,nli,nlj->lij", part, apart, apart)
        return MixtureMap(maps.number[column], mean, covariance, share)
