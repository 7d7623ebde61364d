"""How far from the truth scan matchers may begin (Nieto 2005, section 7.2.3), and their time.

    python -m research.matchers [--pairs 20]

The thesis asks for a comparison of scan matching algorithms, "in particular, their sensitivity to
initial pose error". Every pair of scans is matched from guesses wrong by so much, in a direction
drawn at random; a match is a success within 5 cm and 0.5 degrees of the truth. Pairs are
simulated; what the scans hold fixes every direction. False are results that are neither refused
nor near the truth, as their own covariance has it (0.999 of a chi-square with three degrees of
freedom). NEES is the median of all successes over what it should be, 2.37: below 1 the covariance
is too wide. The correlations are also told how wide a guess may be wrong, and search so far.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from comparisons.logs.simulate.ray_casting import cast
from comparisons.logs.simulate.scan_worlds import dense_slam_world, occupancy_world, scan_slam_world
from ekf_reference.dense.scan import Scan, Sensor
from ekf_reference.scan_matching.alignment import align
from ekf_reference.scan_matching.alignment_covariance import scan_align
from ekf_reference.scan_matching.grid_correlation import correlate
from ekf_reference.scan_matching.scan_shape import of_scan
from graphslam.scan import planar
from graphslam.scan.matchers import MATCHERS, MatchOptions, SurfaceMatcher
from graphslam.scan.points import planar_points
from graphslam.scan.registration import Matcher, Registration, ScanError
from research.timing import timed

Array = NDArray[np.float64]
Pair = tuple[Array, Array, Array]
"""Source, target and the true motion (3,)."""

SHIFTS_M = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0)
TURNS_DEG = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0)
WITHIN_M, WITHIN_RAD = 0.05, np.deg2rad(0.5)
FIXED = 6.0
FALSE = 16.27
ANGLES = np.deg2rad(np.linspace(-90.0, 90.0, 361))
REACH_M, SIGMA_M, SIGMA_BEAM = 40.0, 0.02, np.deg2rad(0.1)
MEDIAN_NEES = 2.366
"""Of a chi-square with three degrees of freedom."""
LASER = Sensor(SIGMA_M, SIGMA_BEAM, np.deg2rad(0.5), np.deg2rad(5.0))
SEARCHED = np.diag((1.5, 1.5, np.deg2rad(20.0))) ** 2
"""Covariance of the guess that the correlations are given."""
USUAL = np.diag((0.5, 0.5, 0.05)) ** 2
"""Of a guess by a filter."""


class SumsOfGaussians:
    """Nieto 2005, eq. 5.13, behind the matchers' interface."""

    def match(self, source: Array, target: Array, guess: Array) -> Registration:
        """See Matcher."""
        one, other = (of_scan(*beams(points), LASER) for points in (source, target))
        found = scan_align(one, other, guess, SEARCHED)
        seen = found.alignment
        if seen.overlap < 0.5 or seen.runner_up > 0.8:
            raise ScanError(f"overlap {seen.overlap:.2f}, another place {seen.runner_up:.2f}")
        return registration(found.pose, found.covariance, seen.overlap, found.open_directions)


class OccupancyGrids:
    """Correlation with an occupancy grid; its covariance is that of a cell."""

    cell_m = 0.2

    def match(self, source: Array, target: Array, guess: Array) -> Registration:
        """See Matcher."""
        scan = Scan.of_ranges(np.zeros(3), *beams(target), LASER)
        found = correlate(source[:, :2], scan, guess, SEARCHED, self.cell_m)
        if found.score < 0.3:
            raise ScanError(f"mean occupancy {found.score:.2f}")
        lever = float(np.hypot(*source.T[:2]).mean())
        unit = self.cell_m / np.sqrt(12.0) * np.array((1.0, 1.0, 1.0 / lever))
        return registration(found.pose, np.diag(unit**2), found.score, 0)


COMPARED = {**MATCHERS, "sog": SumsOfGaussians, "occupancy": OccupancyGrids}


def beams(points: Array) -> tuple[Array, Array]:
    """Bearings and ranges (N,) of points about the scanner."""
    return np.arctan2(points[:, 1], points[:, 0]), np.hypot(points[:, 0], points[:, 1])


def registration(pose: Array, added: Array, overlap: float, free: int) -> Registration:
    """Of a pose and the covariance of the error added to it; what was not measured is NaN."""
    turn = planar.rotation(pose[2])
    nothing = np.full(3, np.nan)
    return Registration(
        motion=pose,
        covariance=turn.T @ added @ turn,
        inliers=0,
        overlap=overlap,
        residual_m=np.nan,
        stiffness=nothing,
        open_directions=free,
    )


def simulated_pairs(rng: np.random.Generator, count: int) -> list[Pair]:
    """A laser of half a circle, a metre on and up to 17 degrees turned, in the thesis's worlds."""
    worlds = (dense_slam_world(), occupancy_world(), scan_slam_world())
    pairs: list[Pair] = []
    while len(pairs) < count:
        world = worlds[len(pairs) % len(worlds)]
        row = int(rng.integers(len(world.path)))
        tangent = world.path[(row + 1) % len(world.path)] - world.path[row]
        first = np.append(world.path[row], np.arctan2(tangent[1], tangent[0]))
        motion = np.array((1.0, 0.0, 0.0)) + rng.uniform(-0.3, 0.3, 3)
        scans = []
        for pose in (planar.compose(first, motion), first):
            aside = SIGMA_BEAM * rng.standard_normal(len(ANGLES))
            way = cast(ANGLES + aside, pose, world.solids())
            way = np.where(way < REACH_M, way, np.nan) + SIGMA_M * rng.standard_normal(len(way))
            scans.append(planar_points(ANGLES, way, np.zeros(3)))
        source, target = scans
        if min(map(len, scans)) > 100 and is_fixed(source, target, motion):
            pairs.append((source, target, motion))
    return pairs


def is_fixed(source: Array, target: Array, truth: Array) -> bool:
    """The shape fixes all three directions by some pairs of points; elsewhere no start helps."""
    unmoved = SurfaceMatcher(MatchOptions(reaches_m=()))
    try:
        return bool(unmoved.match(source, target, truth).stiffness[0] >= FIXED)
    except ScanError:
        return False


def is_near(found: Array, truth: Array) -> bool:
    """Within the criterion."""
    off = planar.wrapped(planar.between(truth, found))
    return bool(np.hypot(off[0], off[1]) < WITHIN_M and abs(off[2]) < WITHIN_RAD)


@dataclass
class ConvergenceBasin:
    """success: share by [turn, shift]. false: share of all matches. milliseconds: of each.

    nees: of each success.
    """

    success: Array = field(
        default_factory=lambda: np.zeros((len(TURNS_DEG), len(SHIFTS_M)), dtype=float)
    )
    false: float = 0.0
    milliseconds: float = 0.0
    nees: list[float] = field(default_factory=list)

    @property
    def calibration(self) -> float:
        """Median NEES of the successes over what it should be."""
        return float(np.median(self.nees)) / MEDIAN_NEES if self.nees else np.nan


def matched(matcher: Matcher, source: Array, target: Array, guess: Array) -> Registration | None:
    """What a matcher finds; None where it refuses."""
    with suppress(ScanError):
        return matcher.match(source, target, guess)
    return None


def basin(matcher: Matcher, pairs: list[Pair]) -> ConvergenceBasin:
    """Match every pair from every error, the same ones for every matcher."""
    rng = np.random.default_rng(1)
    result = ConvergenceBasin()
    tries = len(pairs) * result.success.size
    for source, target, truth in pairs:
        for row, turn in enumerate(TURNS_DEG):
            for column, shift in enumerate(SHIFTS_M):
                way, sign = rng.uniform(0.0, 2.0 * np.pi), rng.choice((-1.0, 1.0))
                error = (shift * np.cos(way), shift * np.sin(way), sign * np.deg2rad(turn))
                guess = planar.compose(truth, np.array(error))
                found, cpu_s = timed(matched, matcher, source, target, guess)
                if found is not None:
                    off = planar.wrapped(planar.between(found.motion, truth))
                    nees = float(off @ np.linalg.solve(found.covariance, off))
                    wrong, near = nees > FALSE, is_near(found.motion, truth)
                    result.nees += [nees] if near else []
                    result.success[row, column] += float(near) / len(pairs)
                    result.false += float(wrong and not near) / tries
                result.milliseconds += 1e3 * cpu_s / tries
    return result


def table(kind: str, basins: dict[str, ConvergenceBasin]) -> Iterable[str]:
    """Shares in percent: over all errors, and along each alone."""
    shifts, turns = SHIFTS_M[1:], TURNS_DEG[1:]
    yield (
        f"{'':29}{'':>6} {'metres off, heading right':^{5 * len(shifts)}} "
        f"{'degrees off, place right':^{5 * len(turns)}}"
    )
    yield (
        f"{'pairs':14}{'matcher':15}{'all':>6} {''.join(f'{m:5g}' for m in shifts)} "
        f"{''.join(f'{d:5g}' for d in turns)} {'false':>6} {'NEES':>6} {'ms':>6}"
    )
    for name, found in basins.items():
        percent = 100.0 * found.success
        yield (
            f"{kind:14}{name:15}{percent.mean():6.0f} "
            f"{''.join(f'{p:5.0f}' for p in percent[0, 1:])} "
            f"{''.join(f'{p:5.0f}' for p in percent[1:, 0])} "
            f"{100.0 * found.false:6.0f} {found.calibration:6.2f} {found.milliseconds:6.1f}"
        )


def usual_times(pairs: list[Pair]) -> str:
    """Processor time where the guess is as good as a filter's, sums made beforehand: medians."""
    rng, taken = np.random.default_rng(2), dict[str, list[float]]()
    for source, target, truth in pairs:
        wrong = np.sqrt(USUAL.diagonal()) * rng.standard_normal(3)
        one, other = (of_scan(*beams(points), LASER) for points in (source, target))
        sums = one, other, truth + wrong, USUAL
        tried: dict[str, Callable[[], object]] = {
            "sums of Gaussians": partial(align, *sums),
            "with covariance": partial(scan_align, *sums),
            "KISS-ICP": partial(matched, MATCHERS["kiss"](), source, target, truth + wrong),
        }
        for name, match in tried.items():
            taken.setdefault(name, []).append(1e3 * timed(match)[1])
    reported = ", ".join(f"{name} {np.median(row):.1f} ms" for name, row in taken.items())
    return f"guess wrong by {USUAL[0, 0] ** 0.5:g} m, medians of processor time: {reported}"


def main() -> None:
    """Run all, print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=20)
    choices = parser.parse_args()
    pairs = simulated_pairs(np.random.default_rng(0), choices.pairs)
    basins = {name: basin(make(), pairs) for name, make in COMPARED.items()}
    print("\n".join(table(f"{len(pairs)} simulated", basins)))
    print(usual_times(pairs))


if __name__ == "__main__":
    main()
