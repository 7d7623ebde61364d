"""Segments of a scan, and whether they would make good landmarks (Nieto 2005, 5.2.2 and 5.7)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.scan import ScanSensor
from ekf_reference.scan_matching.alignment_covariance import CovarianceOptions, scan_align
from ekf_reference.scan_matching.problem import AlignmentOptions
from ekf_reference.scan_matching.sog import SumOfGaussians

_TIE = 1e-6
"""Metres or radians; far above rounding. Recorded ranges and bearings are multiples of a step, so
gaps are often as large as a bound exactly; those always separate."""


@dataclass(frozen=True, kw_only=True)
class SegmentationOptions:
    """How a scan is segmented and segments are tried (Nieto 2005, section 5.7).

    range_m, bearing_rad: bounds of the gap between two neighbours. least_points: of a segment; the
    thesis has 100 on its car park. displacement_m, displacement_rad: standard deviations of the
    random motions of copies. trials: copies. residual: greatest error of an alignment over its
    displacement; the thesis has a tenth. ambiguous: greatest second maximum over the best.
    open_directions: most of x, y and heading that a segment may leave open. interleaved: every
    second return is copied and aligned with the others, else all with all, as in the thesis: with
    noise as large as the spacing of returns, half of a segment does not show its corners.
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


@dataclass(frozen=True, kw_only=True)
class Quality:
    """How well a segment aligns with noisy copies of itself.

    All of the worst trial. residual: greatest error over its displacement, in metres at the lever's
    end. saliency: inverse of the trace of the covariance of the alignment [1/m^2], the object
    saliency score of section 5.2.2; headings as metres at the lever's end. runner_up: greatest
    second maximum over the best. open_directions: most that the shape did not fix. accepted:
    whether it may become a landmark. covariance: (3, 3) mean over the trials, of the segment's
    frame at its centroid; the copies' noise is that of the scan, so it is the error of the
    segment's returns about the true surface.
    """

    residual: float = math.inf
    saliency: float = 0.0
    runner_up: float = 0.0
    open_directions: int = 3
    accepted: bool = False
    covariance: Array = field(default_factory=lambda: np.full((3, 3), np.inf))


def segments(scan: SumOfGaussians, options: SegmentationOptions | None = None) -> list[Index]:
    """Return the rows of a scan's returns by segment; none for a scan without returns.

    scan: in the scanner's frame, returns in order of bearing, as `of_scan` makes it.
    """
    o = options or SegmentationOptions()
    if not len(scan):
        return []
    bearing, way = np.arctan2(scan.mean[:, 1], scan.mean[:, 0]), np.hypot(*scan.mean.T)
    apart_m, apart_rad = np.abs(np.diff(way)), np.abs(np.diff(bearing))
    cut = (apart_m >= o.range_m - _TIE) | (apart_rad >= o.bearing_rad - _TIE)
    runs = np.split(np.arange(len(scan)), np.flatnonzero(cut) + 1)
    return [run for run in runs if len(run) >= o.least_points]


def quality(
    segment: SumOfGaussians,
    sensor: ScanSensor,
    rng: np.random.Generator,
    options: SegmentationOptions | None = None,
    alignment: AlignmentOptions | None = None,
    belief: CovarianceOptions | None = None,
) -> Quality:
    """Align noisy, displaced copies of a segment with it (Nieto 2005, sections 5.2.2 and 5.7).

    segment: some returns of a scan in the scanner's frame. Two things would fix a copy of a wall
    along it, unlike a second scan: the view's ends, which its boundaries exclude, and the noise
    that copies share with the segment unless they are interleaved.
    """
    o = options or SegmentationOptions()
    if len(segment) < 3 or segment.lever_m < 0.01:
        return Quality()
    centre, lever = segment.centroid, segment.lever_m
    spread = np.array((o.displacement_m, o.displacement_m, o.displacement_rad))
    unit = np.array((1.0, 1.0, 1.0 / lever))
    halves = [segment, segment]
    if o.interleaved:
        wide = replace(segment, covariance=_twice_as_long(segment, sensor))
        halves = [wide.take(np.arange(k, len(wide), 2)) for k in (0, 1)]
    covariance, tried = np.zeros((3, 3)), []
    for trial in range(o.trials):
        kept, copied = halves[trial % 2], halves[1 - trial % 2]
        kept = replace(kept, mean=kept.mean - centre)
        copy = replace(copied, mean=_seen_again(copied, sensor, rng) - centre)
        displaced = spread * rng.standard_normal(3)
        found = scan_align(copy, kept, displaced, np.diag(spread**2), alignment, belief)
        scaled = found.covariance / np.outer(unit, unit)
        size, axes = np.linalg.eigh(scaled)
        fixed = 3 - found.open_directions if o.open_directions else 3
        reported = axes[:, :fixed].T @ (found.pose / unit)
        residual = np.linalg.norm(reported) / np.linalg.norm(displaced / unit)
        kept_size = np.minimum(size, o.displacement_m**2)
        covariance += (axes * kept_size) @ axes.T * np.outer(unit, unit) / o.trials
        runner_up = found.alignment.runner_up
        tried.append((float(residual), float(np.trace(scaled)), runner_up, found.open_directions))
    residual, trace, runner_up, free = np.max(tried, axis=0).tolist()
    good = residual < o.residual and free <= o.open_directions and runner_up <= o.ambiguous
    return Quality(
        residual=residual,
        saliency=1.0 / trace,
        runner_up=runner_up,
        open_directions=int(free),
        accepted=good,
        covariance=covariance,
    )


def _twice_as_long(segment: SumOfGaussians, sensor: ScanSensor) -> Array:
    """(N, 2, 2) covariances for pieces of surface twice as long, noise as it was."""
    noise = sensor.covariance(segment.mean, np.hypot(*segment.mean.T))
    return noise + 4.0 * (segment.covariance - noise)


def _seen_again(segment: SumOfGaussians, sensor: ScanSensor, rng: np.random.Generator) -> Array:
    """(N, 2) the returns with noise added to ranges and bearings."""
    count = len(segment)
    way = np.hypot(*segment.mean.T) + sensor.sigma_range_m * rng.standard_normal(count)
    aside = sensor.sigma_bearing_rad * rng.standard_normal(count)
    bearing = np.arctan2(segment.mean[:, 1], segment.mean[:, 0]) + aside
    point: Array = way[:, None] * np.stack((np.cos(bearing), np.sin(bearing)), axis=1)
    return point
