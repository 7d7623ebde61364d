"""FastSLAM beside the filter and the smoother."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.accuracy import Accuracy, assess
from comparisons.checks.agreement import Gaussian
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.fastslam.check import (
    LEVEL,
    CloudCheck,
    check_clouds,
    standardised_moments,
)
from comparisons.extensions.fastslam.config import FastSlamConfig
from comparisons.extensions.fastslam.drive import Cloud, Sampling, build_fastslam, run_fastslam
from comparisons.extensions.interface import Extension, Finding, Row
from comparisons.logs.log import Log
from comparisons.logs.transforms.known_landmarks import surveyed
from comparisons.pipeline.gaps import Compared
from comparisons.pipeline.prepare import Prepared
from comparisons.report.model import Model
from comparisons.report.models import AccuracyResult
from comparisons.report.rows import accuracy_rows
from comparisons.report.sections import accuracy_result
from ekf_reference.fastslam.filter import Proposal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_OF_A_CLOUD = 0.5
"""Landmarks are those that particles of so much weight have."""
_AGREES = {True: "agree", False: "disagree", None: "no verdict: the clouds are too small"}


class FastSlamExtension(Extension):
    """Runs independent FastSLAMs on what the estimators were given."""

    name = "fastslam"

    def __init__(self, settings: FastSlamConfig) -> None:
        """settings: how to sample."""
        self._settings = settings

    def prepare(self, prepared: Prepared[Any]) -> Prepared[Any]:
        """Refuse surveyed landmarks, which FastSLAM would estimate anew. Raises InputError."""
        if surveyed(prepared.log)[0]:
            raise InputError(f"{prepared.log.name}: --third fastslam takes no surveyed landmarks")
        return prepared

    def check(self, compared: Compared) -> FastSlamFinding:
        """Run the clouds, and compare them with the smoother."""
        prepared = compared.prepared
        with prepared.clock.stage("fastslam"):
            clouds = []
            for k in range(self._settings.clouds):
                prepared.progress("fastslam", k, self._settings.clouds)
                clouds.append(self.cloud(prepared, prepared.log, k))
        return FastSlamFinding(compared, clouds)

    def cloud(self, prepared: Prepared[Any], log: Log, number: int) -> Cloud:
        """Run one of the independent clouds, on a log with the prepared one's instants."""
        own = self._settings
        proposal: Proposal = "motion" if own.proposal == "1.0" else "measurement"
        seed = own.seed * 1000 + number
        sampling = Sampling(own.particles, proposal, seed)
        slam = build_fastslam(log, sampling, known=prepared.labelled)
        return run_fastslam(slam, log, prepared.timeline)


@dataclass(frozen=True, kw_only=True)
class Depletion:
    """How small the first cloud is.

    effective: mean effective sample size over the epochs. first, middle: particles of the first and
    of the middle epoch that have descendants in the last cloud.
    """

    effective: float
    first: int
    middle: int


class FastSlamFinding(Finding):
    """Clouds against the smoother. check: how they compare. accuracy: of the first cloud."""

    def __init__(self, compared: Compared, clouds: Sequence[Cloud]) -> None:
        """Its disagreement is a remark: depletion is FastSLAM's own weakness."""
        smoothed, prepared = compared.gaps.smoothed, compared.prepared
        self.check, self.depletion = compare_clouds(clouds, smoothed), depletion(clouds[0])
        estimate = cloud_estimate(clouds[0], compared.ekf.estimate.time_s)
        self.accuracy: Accuracy | None = assess(
            estimate, prepared.judged, labelled=prepared.labelled
        )
        self.estimates = {"fastslam": estimate}
        self.titles = {"fastslam": "FastSLAM"}
        self.result = _result(self.check, self.depletion, clouds, self.accuracy)
        self.entries = {"fastslam": self.result}
        self.remarks = _remarks(self.check, self.depletion, self.result)

    def rows(self) -> Sequence[Row]:
        """Return how the clouds compare with the smoother, and how depleted they are."""
        own, group = self.result, "FastSLAM"
        return [
            Row(group, "particles of each cloud, clouds", f"{own.particles:,}, {own.clouds:,}"),
            Row(group, "last pose: difference from the smoother", f"{own.difference_m:.3f} m"),
            Row(
                group,
                "last pose: clouds against the smoother",
                f"{own.statistic:.1f}",
                f"at most {own.limit:.1f}",
                own.agrees,
            ),
            Row(group, "independent particles of the posterior", f"{own.independent:.2g}"),
            Row(group, "effective sample size, mean", f"{own.effective:.0f}"),
            Row(group, "ancestors of the cloud: first, middle", f"{own.first}, {own.middle}"),
            *accuracy_rows("FastSLAM", own.accuracy),
        ]

    def draw(self, axis: Axes) -> None:
        """Draw FastSLAM's trajectory and map."""
        from comparisons.report.figures.style import draw_estimate

        draw_estimate(axis, "FastSLAM", self.estimates["fastslam"])


def compare_clouds(clouds: Sequence[Cloud], smoothed: Estimate) -> CloudCheck:
    """Return how clouds compare with the smoother in the last pose."""
    means = np.array([cloud.mean[-1] for cloud in clouds])
    moments = [standardised_moments(c.slam.predicted_pose(), c.slam.weight) for c in clouds]
    smoother = Gaussian(smoothed.pose[-1], smoothed.joint_covariance[:3, :3])
    return check_clouds(means, np.array(moments), smoother)


def depletion(cloud: Cloud) -> Depletion:
    """Return how depleted a cloud is."""
    distinct = cloud.slam.history.distinct()
    return Depletion(
        effective=float(np.mean(cloud.slam.history.effective)),
        first=int(distinct[0]),
        middle=int(distinct[len(distinct) // 2]),
    )


def cloud_estimate(cloud: Cloud, time_s: Array) -> Estimate:
    """Return a cloud's estimate: weighted means, and the mixture's covariance.

    A particle that lacks a landmark stands with the landmark's mean over the others.
    """
    slam = cloud.slam
    mixture = slam.mixture_map()
    held = np.flatnonzero(mixture.share >= MOST_OF_A_CLOUD)
    number, mean = mixture.number[held], mixture.mean[held]
    columns = slam.maps.columns_of(number)
    has = slam.maps.has(columns)[..., None]
    place = np.where(has, slam.maps.mean[:, columns], mean)
    weight, pose = slam.weight, slam.predicted_pose()
    own = np.where(has[..., None], slam.maps.covariance[:, columns], mixture.covariance[held])
    apart = np.hstack((pose - weight @ pose, (place - mean).reshape(len(pose), -1)))
    joint = np.einsum("n,ni,nj->ij", weight, apart, apart)
    for k, block in enumerate(np.einsum("n,nlij->lij", weight, own)):
        joint[3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k] += block
    return Estimate(
        time_s=time_s,
        pose=cloud.mean,
        pose_covariance=cloud.covariance,
        landmark_id=number,
        landmark=mean,
        joint_covariance=joint,
        information="filtered",
        provenance={"estimator": "FastSLAM", "particles": str(len(weight))},
    )


def _remarks(check: CloudCheck, depleted: Depletion, own: FastSlamResult) -> list[str]:
    found = []
    if check.agrees is None:
        found.append(
            f"FastSLAM gives no verdict: a cloud of {own.particles} particles knows the last pose "
            f"no better than {check.independent:.2g} independent particles would "
            f"(particles at the middle of the log that have descendants: {depleted.middle})"
        )
    if check.agrees is False:
        found.append(
            f"FastSLAM disagrees with the smoother in the last pose: {own.difference_m:.2f} m, "
            f"statistic {check.statistic:.1f}, at level {LEVEL:g} at most {check.limit:.1f}; "
            "depletion of particles may be the reason"
        )
    if check.agrees is not False and check.shape:
        found.append(f"FastSLAM's posterior is not Gaussian: {'; '.join(check.shape)}")
    return found


def _result(
    check: CloudCheck, depleted: Depletion, clouds: Sequence[Cloud], accuracy: Accuracy | None
) -> FastSlamResult:
    return FastSlamResult(
        particles=clouds[0].slam.options.particles,
        clouds=len(clouds),
        difference_m=float(np.hypot(*check.difference[:2])),
        difference_rad=float(abs(check.difference[2])),
        statistic=check.statistic,
        limit=check.limit,
        level=LEVEL,
        independent=check.independent,
        agrees=check.agrees,
        verdict=_AGREES[check.agrees],
        shape=list(check.shape),
        effective=depleted.effective,
        first=depleted.first,
        middle=depleted.middle,
        accuracy=accuracy_result(accuracy),
    )


class FastSlamResult(Model):
    """Entry `fastslam`: clouds of particles compared with the smoother in the last pose.

    See comparisons.extensions.fastslam.check.

    Attributes:
        particles: particles of each cloud.
        clouds: independent clouds.
        difference_m: distance of the clouds' mean position from the smoother's.
        difference_rad: the same of the heading.
        statistic: squared difference over the smoother's variance and the Monte Carlo error's.
        limit: largest statistic at the level.
        level: probability, at most, of a disagreement where there is none.
        independent: independent particles that know the last pose as well as one cloud.
        agrees: whether the clouds agree with the smoother; null where they are too small to tell.
        verdict: the same in words.
        shape: what of the clouds is not Gaussian.
        effective: mean effective sample size of the first cloud.
        first: particles of the first epoch that have descendants in the first cloud.
        middle: particles of the middle epoch that have descendants in the first cloud.
        accuracy: errors of the first cloud's estimate.
    """

    particles: int
    clouds: int
    difference_m: float
    difference_rad: float
    statistic: float
    limit: float
    level: float
    independent: float
    agrees: bool | None
    verdict: str
    shape: list[str]
    effective: float
    first: int
    middle: int
    accuracy: AccuracyResult | None
