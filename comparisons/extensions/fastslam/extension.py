"""FastSLAM beside the filter and the smoother."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.accuracy import Accuracy, accuracy_rows, assess
from comparisons.checks.finding import Finding
from comparisons.config import Configured
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.fastslam.check import LEVEL, CloudCheck, check_clouds
from comparisons.extensions.fastslam.config import FastSlamConfig
from comparisons.extensions.fastslam.drive import Cloud, Sampling, build_fastslam, run_fastslam
from comparisons.extensions.fastslam.stretches import LEAST_ANCESTORS, StretchComparison
from comparisons.figures import LeftOut, Less, More
from comparisons.logs.transforms.known_landmarks import surveyed
from comparisons.pipeline.extension import Extension
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepared import Prepared
from comparisons.plane import pose_difference, rms
from comparisons.words import Row
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.layout import Layout
from ekf_reference.fastslam.filter import Proposal

if TYPE_CHECKING:
    from matplotlib.axes import Axes


MOST_OF_A_CLOUD = 0.5
"""Landmarks are those that particles of so much weight have."""


@dataclass(frozen=True, kw_only=True)
class FastSlamResult(CloudCheck):
    """Entry `fastslam`: clouds of particles compared with the smoother.

    See comparisons.extensions.fastslam.check.

    Attributes:
        particles: particles of each cloud.
        length_s: mean length of the stretches.
        level: largest p of a disagreement.
        verdict: whether the clouds agree, in words.
        path_m: whole log: distance of one cloud's mean positions from the smoother's (root mean
            square over the epochs).
        difference_m: whole log, last pose: distance of one cloud's mean from the smoother's.
        difference_rad: the same of the heading.
        effective: mean effective sample size of the whole log's cloud.
        first: particles of its first epoch that have descendants.
        middle: particles of its middle epoch that have descendants.
        accuracy: errors of its estimate.
    """

    particles: int
    length_s: LeftOut[float]
    level: LeftOut[float]
    verdict: str
    path_m: Less[float]
    difference_m: Less[float]
    difference_rad: Less[float]
    effective: More[float]
    first: int
    middle: int
    accuracy: Accuracy | None


class FastSlamExtension(Extension):
    """What does FastSLAM make of the same log?

    Runs FastSLAM on what the estimators were given, once whole and often in stretches.
    """

    name = "fastslam"
    needs = "measurements of landmarks, none surveyed"
    errs = "not at all: what it finds changes no verdict"
    figures = (("fastslam", FastSlamResult),)
    settings: FastSlamConfig

    def __init__(self, settings: FastSlamConfig, config: Configured) -> None:
        """settings: how to sample."""
        super().__init__(settings, config)
        proposal: Proposal = "motion" if settings.proposal == "1.0" else "measurement"
        self.sampling = Sampling(settings.particles, proposal, settings.seed, settings.association)

    def prepare(self, prepared: Prepared[Any]) -> Prepared[Any]:
        """Refuse surveyed landmarks, which FastSLAM would estimate anew. Raises InputError."""
        if surveyed(prepared.log)[0]:
            raise InputError(f"{prepared.log.name}: --third fastslam takes no surveyed landmarks")
        return prepared

    def find(self, known: Known) -> FastSlamFinding:
        """Run the clouds, and compare them with the smoother."""
        prepared = known.prepared
        with prepared.clock.stage("fastslam"):
            prepared.progress("fastslam", 0, 0)
            cloud = self.cloud(prepared, len(known.ekf.estimate.time_s))
            stretches = StretchComparison(known.gaps, prepared.log, self.sampling)
            progress = prepared.stage_progress("fastslam, stretches")
            check = check_clouds(stretches.run(self.settings.clouds, progress))
        return FastSlamFinding(known, self.settings, cloud, check)

    def cloud(self, prepared: Prepared[Any], epochs: int | None = None) -> Cloud:
        """Run one cloud through the whole log, or through its first epochs."""
        log, timeline = prepared.log, prepared.timeline
        slam = build_fastslam(log, self.sampling, known=prepared.labelled)
        return run_fastslam(slam, log, timeline if epochs is None else timeline.prefix(epochs))


_AGREES = {True: "agree", False: "disagree", None: "no verdict: too few particles"}


class FastSlamFinding(Finding):
    """Clouds against the smoother. accuracy: of the cloud of the whole log."""

    def __init__(
        self, known: Known, settings: FastSlamConfig, cloud: Cloud, check: CloudCheck
    ) -> None:
        """Report in remarks: a witness changes no verdict."""
        smoothed, prepared = known.gaps.smoothed, known.prepared
        self.check = check
        estimate = cloud_estimate(cloud, known.ekf.estimate.time_s)
        self.accuracy: Accuracy | None = assess(
            estimate, prepared.judged, labelled=prepared.labelled
        )
        self.estimates = {"fastslam": estimate}
        self.titles = {"fastslam": "FastSLAM"}
        apart = pose_difference(cloud.mean, smoothed.pose)
        distinct = cloud.slam.history.distinct()
        self.result = FastSlamResult(
            **vars(check),
            particles=settings.particles,
            length_s=float(
                np.mean([stretch.end_s - stretch.begin_s for stretch in check.stretches])
            ),
            level=LEVEL,
            verdict=_AGREES[check.agrees],
            path_m=rms(apart[:, :2]),
            difference_m=float(np.hypot(*apart[-1, :2])),
            difference_rad=float(abs(apart[-1, 2])),
            effective=float(np.mean(cloud.slam.history.effective)),
            first=int(distinct[0]),
            middle=int(distinct[len(distinct) // 2]),
            accuracy=self.accuracy,
        )
        self.entries = {"fastslam": self.result}
        self.remarks = _remarks(check, self.result)
        self.lines = [("FastSLAM", _line(self.result))]

    def rows(self) -> Sequence[Row]:
        """Return how the clouds compare with the smoother, and how depleted the whole log's is."""
        result, row = self.result, partial(Row, "FastSLAM")

        def chance(of: str, p: float) -> Row:
            return row(f"stretches: p of the {of}", f"{p:.4f}", f"above {LEVEL:g}", p > LEVEL)

        exact = []
        if result.exact is not None and result.exact.stretches:
            exact.append(chance("clouds against the exact posterior", result.exact.clouds))
            exact.append(chance("Gaussian against the exact posterior", result.exact.gaussian))
        counts = f"{result.particles:,}, {result.clouds:,}, {len(result.stretches):,}"
        most, known = f"at most {result.largest_shift:.2f}", result.independent
        like, turned = f"{known:.2g}", f"{np.degrees(result.difference_rad):.2f} deg"
        return [
            row("clouds against the smoother", result.verdict),
            row("particles of a cloud, clouds, stretches", counts),
            row("stretches: mean length", f"{result.length_s:.1f} s"),
            row("stretches: independent particles of a cloud", like, "at least 1", known >= 1.0),
            chance("energy distance", result.p),
            *exact,
            row("stretches: energy distance (1 expected)", f"{result.energy:.2f}"),
            row("stretches: squared shift (1 expected)", f"{result.squared_shift:.2f}", most),
            row("stretches: variance (1 expected)", f"{result.spread:.2f}"),
            row("whole log: path from the smoother's (RMS)", f"{result.path_m:.3f} m"),
            row(
                "whole log: last pose from the smoother's", f"{result.difference_m:.3f} m, {turned}"
            ),
            row("whole log: mean effective sample size", f"{result.effective:.0f}"),
            row(
                "whole log: ancestors in first and middle epoch", f"{result.first}, {result.middle}"
            ),
            *accuracy_rows("FastSLAM", result.accuracy),
        ]

    def draw(self, axis: Axes) -> None:
        """Draw FastSLAM's trajectory and map."""
        from comparisons.report.figures.style import draw_estimate

        draw_estimate(axis, "FastSLAM", self.estimates["fastslam"])


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
    entry = Layout.packed(3, len(number)).first[POINT][:, None] + np.arange(POINT.width)
    joint[entry[:, :, None], entry[:, None]] += np.einsum("n,nlij->lij", weight, own)
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


def _line(result: FastSlamResult) -> str:
    count = "1 stretch" if len(result.stretches) == 1 else f"{len(result.stretches)} stretches"
    over = f"over {count} of {result.length_s:.1f} s"
    if result.agrees is None:
        return f"no verdict {over}: too few particles"
    if result.agrees and result.exact is not None:
        return f"agrees with the exact posterior, not with its Gaussian ({count})"
    return f"{result.verdict}s with the smoother {over} (p {result.p:.4f})"


def _remarks(check: CloudCheck, result: FastSlamResult) -> list[str]:
    depleted = []
    if result.middle < LEAST_ANCESTORS * result.particles:
        depleted = [
            f"over the whole log FastSLAM is depleted: {result.middle} of {result.particles} "
            "particles at its middle epoch have descendants; so the difference of its trajectory "
            f"from the smoother's, {result.path_m:.2f} m (RMS), is evidence against neither"
        ]
    if check.agrees is None:
        return [
            f"FastSLAM gives no verdict: of clouds of {result.particles} particles, "
            f"{check.independent:.2g} are independent after stretches of {result.length_s:.1f} s; "
            "take more particles",
            *depleted,
        ]
    found, worst = [], check.worst
    where = f"from {worst.begin_s:.1f} to {worst.end_s:.1f} s"
    if not check.agrees:
        found.append(
            f"FastSLAM disagrees with the smoother over stretches of the log (p {check.p:.4f}, "
            f"level {LEVEL:g}), most {where}: the last pose is {worst.shift:.1f} sigma off, "
            f"variances are {worst.spread:.2f} times the smoother's"
        )
    exact = check.exact
    if exact is not None and exact.gaussian <= LEVEL:
        found.append(
            f"the posterior is not Gaussian, least of all {where}: draws of the smoother's exact "
            f"posterior differ from its Gaussian (p {exact.gaussian:.4f}), and "
            + ("not " if exact.explains else "")
            + f"from FastSLAM's clouds (p {exact.clouds:.4f})"
        )
    if check.shape:
        found.append(f"FastSLAM's posterior is not Gaussian: {'; '.join(check.shape)}")
    return found + depleted
