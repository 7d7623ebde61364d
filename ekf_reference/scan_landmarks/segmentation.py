"""Segments of a scan, and whether they would make good landmarks (Nieto 2005, 5.2.2 and 5.7)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.scan import Sensor
from ekf_reference.scan_matching.alignment_covariance import CovarianceOptions, scan_align
from ekf_reference.scan_matching.problem import AlignmentOptions
from ekf_reference.scan_matching.sog import SumOfGaussians


@dataclass(frozen=True, kw_only=True)
class SegmentationOptions:
    """Which returns hang together (Nieto 2005, section 5.7), and how segments are tried.

    range_m, bearing_rad: less than so much lies between two neighbours. least_points: of a
    segment; the thesis has 100 on its car park. displacement_m, displacement_rad: standard
    deviations of the random motions that copies are given. trials: copies. residual: share of the
    displacement below which an alignment's error must stay; the thesis has a tenth. ambiguous:
    greatest second maximum over the best. open_directions: most of x, y and heading that a segment
    may leave open. interleaved: every second return is copied and registered
    with the others; else all are, with all, as the thesis has it. Where noise is as large as the
    spacing of returns a copy shares little with what it is laid onto, and half of a segment does
    not show its corners.
    """

    range_m: float = 5.0
    bearing_rad: float = math.radians(3.0)
    least_points: int = 30
    displacement_m: float = 0.5
    displacement_rad: float = math.radians(10.0)
    trials: int = 4
    residual: float = 0.1
    ambiguous: float = 0.8
    interleaved: bool = True
    open_directions: int = 0

    def __post_init__(self) -> None:
        """Check the counts."""
        if self.least_points < 1 or self.trials < 1:
            raise ValueError(
                f"least points {self.least_points} and trials {self.trials} must be above zero"
            )


@dataclass(frozen=True, kw_only=True)
class Quality:
    """How well a segment lays itself onto itself.

    All of the worst trial. residual: greatest error over its displacement, in metres at the lever's
    end. saliency: inverse of the trace of the covariance of the alignment [1/m^2], the object
    saliency score of section 5.2.2; headings as metres at the lever's end. runner_up: greatest
    second maximum over the best. open_directions: most that the shape did not fix. accepted:
    whether it may become a landmark. covariance: (3, 3) mean of the trials', of the
    segment's frame at its centroid: as the noise that is added to a copy is that of the segment's
    own scan, it says how well the segment's returns tell where the surface is.
    """

    residual: float
    saliency: float
    runner_up: float
    open_directions: int
    accepted: bool
    covariance: Array


def segments(scan: SumOfGaussians, options: SegmentationOptions | None = None) -> list[Index]:
    """Rows of a scan's returns that hang together, by bearing; none for a scan without returns.

    scan: in the scanner's frame, returns in order of bearing, as `of_scan` makes it.
    """
    o = options or SegmentationOptions()
    if not len(scan):
        return []
    bearing, way = np.arctan2(scan.mean[:, 1], scan.mean[:, 0]), np.hypot(*scan.mean.T)
    cut = (np.abs(np.diff(way)) >= o.range_m) | (np.abs(np.diff(bearing)) >= o.bearing_rad)
    runs = np.split(np.arange(len(scan)), np.flatnonzero(cut) + 1)
    return [run for run in runs if len(run) >= o.least_points]


def quality(
    segment: SumOfGaussians,
    sensor: Sensor,
    rng: np.random.Generator,
    options: SegmentationOptions | None = None,
    alignment: AlignmentOptions | None = None,
    belief: CovarianceOptions | None = None,
) -> Quality:
    """Register noisy, displaced copies of a segment with it (Nieto 2005, sections 5.2.2 and 5.7).

    segment: some returns of a scan in the scanner's frame, so that noise can be added to ranges
    and bearings. A copy of a wall finds its place along it, which no second look at the wall
    does, by two things: the wall ends where the view does, which the segment's seams tell; and
    copies share the segment's own noise, unless they are interleaved.
    """
    o = options or SegmentationOptions()
    if len(segment) < 3 or segment.lever_m < 0.01:
        nothing = np.full((3, 3), np.inf)
        return Quality(
            residual=math.inf,
            saliency=0.0,
            runner_up=0.0,
            open_directions=3,
            accepted=False,
            covariance=nothing,
        )
    centre, lever = segment.centroid, segment.lever_m
    spread = np.array((o.displacement_m, o.displacement_m, o.displacement_rad))
    unit = np.array((1.0, 1.0, 1.0 / lever))
    halves = [segment, segment]
    if o.interleaved:
        wide = replace(segment, covariance=_twice_as_long(segment, sensor))
        halves = [wide.take(np.arange(k, len(wide), 2)) for k in (0, 1)]
    covariance = np.zeros((3, 3))
    residual, trace, runner_up, free = 0.0, 0.0, 0.0, 0
    for trial in range(o.trials):
        kept, copied = halves[trial % 2], halves[1 - trial % 2]
        kept = replace(kept, mean=kept.mean - centre)
        copy = replace(copied, mean=_seen_again(copied, sensor, rng) - centre)
        displaced = spread * rng.standard_normal(3)
        found = scan_align(copy, kept, displaced, np.diag(spread**2), alignment, belief)
        scaled = found.covariance / np.outer(unit, unit)
        size, axes = np.linalg.eigh(scaled)
        fixed = 3 - found.open_directions if o.open_directions else 3
        told = axes[:, :fixed].T @ (found.pose / unit)
        error = np.linalg.norm(told) / np.linalg.norm(displaced / unit)
        kept_size = np.minimum(size, o.displacement_m**2)
        covariance += (axes * kept_size) @ axes.T * np.outer(unit, unit) / o.trials
        residual = max(residual, float(error))
        trace = max(trace, float(np.trace(scaled)))
        runner_up = max(runner_up, found.alignment.runner_up)
        free = max(free, found.open_directions)
    good = residual < o.residual and free <= o.open_directions and runner_up <= o.ambiguous
    return Quality(
        residual=residual,
        saliency=1.0 / trace,
        runner_up=runner_up,
        open_directions=free,
        accepted=good,
        covariance=covariance,
    )


def _twice_as_long(segment: SumOfGaussians, sensor: Sensor) -> Array:
    """(N, 2, 2) covariances for pieces of surface twice as long, noise as it was."""
    noise = sensor.covariance(segment.mean, np.hypot(*segment.mean.T))
    longer: Array = noise + 4.0 * (segment.covariance - noise)
    return longer


def _seen_again(segment: SumOfGaussians, sensor: Sensor, rng: np.random.Generator) -> Array:
    """(N, 2) the returns with noise added to ranges and bearings."""
    count = len(segment)
    way = np.hypot(*segment.mean.T) + sensor.sigma_range_m * rng.standard_normal(count)
    aside = sensor.sigma_bearing_rad * rng.standard_normal(count)
    bearing = np.arctan2(segment.mean[:, 1], segment.mean[:, 0]) + aside
    point: Array = way[:, None] * np.stack((np.cos(bearing), np.sin(bearing)), axis=1)
    return point
