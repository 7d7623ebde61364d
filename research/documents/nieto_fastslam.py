"""Nieto 2005, sections 2.8.2 and 2.10: EKF-SLAM and FastSLAM on Victoria Park; 2.2.1: depletion.

Every particle associates the raw detections for itself. GPS judges the trajectory and is not used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import assess_trajectory, rigid_motion
from comparisons.errors import InputError
from comparisons.extensions.fastslam.drive import Sampling, build_fastslam, run_fastslam
from comparisons.logs.log import Log
from comparisons.report.figures.style import draw_reference, draw_trajectory
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR
from research.documents.claims import Claims, at_most, within
from research.documents.drawing import chart, plan
from research.documents.interface import DocumentFigure, Experiment
from research.documents.measures import at_gps

PARTICLES = (10, 30, 100)
"""The last is drawn. The thesis does not say how many it takes."""
TREES = 300
"""Landmarks of `slamcheck run victoria_park --filter compressed`."""
_KNOWN = 0.5
"""Share of the cloud's weight that has a landmark, of those that are drawn."""
_STARS = "#2a9d3a"
_PARK = "victoria_park"


@dataclass(frozen=True, kw_only=True)
class CloudRun:
    """One number of particles.

    median_m: of the distances from GPS, after the rigid motion that fits best. distinct: (S,)
    particles of each sampled epoch that have descendants at the end. path: (K, 2), weighted means.
    landmark: (L, 2), averages of the Gaussian means; both moved onto the GPS.
    """

    particles: int
    median_m: float
    distinct: Index
    path: Array
    landmark: Array

    @property
    def left_of_the_first_tenth(self) -> int:
        """Particles at a tenth of the log that have descendants at its end."""
        return int(self.distinct[len(self.distinct) // 10])


@dataclass(frozen=True)
class ParticleClouds:
    """All numbers of particles, ascending. gps: (G, 2)."""

    log: str
    runs: tuple[CloudRun, ...]
    gps: Array


def _off_gps_m(log: Log, time_s: Array, pose: Array) -> float:
    found = assess_trajectory(time_s, pose, log)
    median = None if found is None else found.gps_median_aligned_m
    return np.nan if median is None else median


def clouds(log: Log, particles: tuple[int, ...] = PARTICLES) -> ParticleClouds:
    """Run FastSLAM 2.0 on the detections of a log with positions, which judge it."""
    positions = log.positions
    if positions is None:
        raise InputError(f"{log.name}: holds no positions, which are to judge the trajectory")
    runs = tuple(_run(log, number) for number in particles)
    reported = f"{log.name}, FastSLAM 2.0, seed 0"
    return ParticleClouds(reported, runs, positions.position_m)


def _run(log: Log, particles: int) -> CloudRun:
    timeline = build_timeline(log)
    slam = build_fastslam(log, Sampling(particles), known=log.measurements.labelled)
    cloud = run_fastslam(slam, log, timeline)
    time_s = timeline.epoch_time_s
    move = rigid_motion(*at_gps(log, time_s, cloud.mean))
    mixture = slam.mixture_map()
    return CloudRun(
        particles=particles,
        median_m=_off_gps_m(log, time_s, cloud.mean),
        distinct=slam.history.distinct(),
        path=move(cloud.mean[:, :2]),
        landmark=move(mixture.mean[mixture.share > _KNOWN]),
    )


def _claims_2_13(found: ParticleClouds) -> Claims:
    most = found.runs[-1]
    text = (
        f"the mean trajectory of {most.particles} particles follows the vehicle's (median "
        "distance from GPS after alignment; the figure gives no number)"
    )
    yield at_most(text, most.median_m, 2.0, "m", own=True)
    text = (
        "the landmarks' estimates are the park's trees (number that most of the weight has; "
        f"limits: a factor of 2 either way from the {TREES} of EKF-SLAM on the same detections)"
    )
    yield within(text, len(most.landmark), (0.5 * TREES, 2.0 * TREES), own=True)
    text = (
        "part of the history is lost with every resampling (share of the particles at a tenth "
        "of the log that have descendants at its end)"
    )
    yield at_most(text, most.left_of_the_first_tenth / most.particles, 1.0 - 1.0 / most.particles)


def _draw_2_13(canvas: Canvas, found: ParticleClouds) -> None:
    grid = canvas.add_gridspec(1, 2, width_ratios=(1.5, 1.0))
    axis, most = canvas.add_subplot(grid[0]), found.runs[-1]
    draw_reference(axis, found.gps, ".", "GPS")
    draw_trajectory(axis, most.path, EKF_COLOUR, "mean of the particles")
    axis.plot(
        *most.landmark.T, "*", color=_STARS, markersize=4, linestyle="none", label="landmarks"
    )
    title = f"FastSLAM 2.0, {most.particles} particles: {most.median_m:.2f} m from GPS"
    plan(axis, title, legend="best")
    _draw_depletion(canvas.add_subplot(grid[1]), found)


def _draw_depletion(axis: Axes, found: ParticleClouds) -> None:
    colours = (SMOOTHER_COLOUR, _STARS, EKF_COLOUR)
    for run, colour in zip(found.runs, colours, strict=False):
        share = np.linspace(0.0, 1.0, len(run.distinct))
        label = f"{run.particles} particles, {run.median_m:.2f} m"
        axis.plot(share, run.distinct, color=colour, linewidth=0.9, label=label)
    axis.set_yscale("log")
    chart(axis, "depletion", "share of the log", "particles with descendants at its end")


FIGURES = (
    DocumentFigure(
        name="N2.13", title="FastSLAM on Victoria Park",
        says="FastSLAM maps the trees of Victoria Park; the trajectory is the particles' mean, a "
        "landmark the average of the Gaussian means. Resampling loses particles, and with them "
        "part of the map's history.",
        experiment=Experiment(
            "section 2.10, FastSLAM", lambda given: clouds(given.log(_PARK)), _PARK
        ),
        draw=_draw_2_13, claims=_claims_2_13, size=(12.0, 5.5), place="Fig. 2.13 and section 2.2.1",
    ),
)  # fmt: skip
