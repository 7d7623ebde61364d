"""Scan matchers without Open3D, and what all matchers share: checked clouds, one judge.

An aligner lays one cloud onto another and says nothing of the result. Here every aligner's motion
goes through the same judge, `refine` without a step, so that evidence and covariance of all
matchers mean the same and can be compared.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np

from graphslam.arrays import Array
from graphslam.scan import kiss, planar
from graphslam.scan.odometry import KissIcpOptions
from graphslam.scan.points import LEAST_POINTS, usable
from graphslam.scan.refinement import RefinementOptions, refine
from graphslam.scan.registration import Matcher, Registration, ScanError
from graphslam.scan.surfaces import SurfaceMap

COARSE_M = 1.0
"""So far off a match may begin."""
_FAR_M = 1e4
_UNKNOWN_M = 1e4
"""A sigma so wide that the covariance's axes are those of what is not fixed, to rounding."""


@dataclass(frozen=True, kw_only=True)
class MatchOptions:
    """How far to look and what to believe.

    reaches_m: greatest distance of a pair, in stages, each beginning where the last one ended.
    iterations: most per stage. converged: relative or absolute change, as the aligner has it, at
    which a stage ends. judge: what is believed of the motion found, its calibration being on top of
    the matcher's own. It looks for surfaces in the target thinned to cells of cell_m, among so
    many neighbours within radius_m. least_points: of a source.
    """

    reaches_m: tuple[float, ...] = (2.0, 0.5)
    iterations: int = 60
    converged: float = 1e-7
    judge: RefinementOptions = field(default_factory=RefinementOptions)
    cell_m: float = 0.1
    neighbours: int = 24
    radius_m: float = 0.5
    least_points: int = LEAST_POINTS

    @classmethod
    def suited(cls, settings: KissIcpOptions, judge: RefinementOptions) -> Self:
        """For scans that suit these settings of scan odometry, from a metre off."""
        reach_m = settings.refinement.reach_m
        return cls(
            reaches_m=(max(COARSE_M, 2.0 * reach_m), reach_m),
            judge=replace(judge, reach_m=reach_m),
            cell_m=0.2 * settings.voxel_m,
            neighbours=max(24, settings.neighbours // 2),
            radius_m=settings.radius_m,
        )


class JudgedMatcher:
    """A matcher made of an aligner, stage by stage, and the judge.

    calibration: factor on the judge's variance, found by simulated scans of three rooms, 360 beams
    with 2 cm of range noise each. The judge takes pairs as independent, while neighbours share a
    patch of the target and its noise; and what points laid onto points are wrong by goes with
    the beams' spacing, so those matchers' factors hold for such scans only.
    """

    calibration: ClassVar[float] = 1.0

    def __init__(self, options: MatchOptions | None = None) -> None:
        """Without options the defaults hold."""
        self.options = options or MatchOptions()
        judge = self.options.judge
        self._judge = replace(judge, iterations=0, calibration=judge.calibration * self.calibration)

    def match(self, source: Array, target: Array, guess: Array) -> Registration:
        """Align source (N, 3) to target (M, 3) from a guess (3,), in the plane; see Matcher.

        What the shape does not fix stays as guessed. A target with all heights 0 is planar and
        needs a planar source; a planar source may be laid into a target in space. The order of
        the points does not matter. Raises ScanError.
        """
        start = np.asarray(guess, dtype=float)
        if start.shape != (3,) or not np.isfinite(start).all():
            raise ScanError(f"the guess is {guess}, expected three finite numbers")
        source = checked(source, "source", self.options.least_points)
        target = checked(target, "target")
        if source[:, 2].any() and not target[:, 2].any():
            raise ScanError("the target is planar and the source is not")
        found = start
        for motion in self.align(source, target, start):
            found = planar.from_matrix(motion) if motion.shape == (4, 4) else motion
            if not np.isfinite(found).all():
                raise ScanError("the alignment ended without finite numbers")
        return self._judged(source, target, start, found)

    def align(self, source: Array, target: Array, start: Array) -> Iterator[Array]:
        """The motions (3,) or (4, 4) that the stages end with, the last being the result."""
        raise NotImplementedError

    def surfaces(self, target: Array, radius_m: float) -> SurfaceMap:
        """The target, thinned, to look for surfaces within a radius."""
        o = self.options
        return SurfaceMap(thinned(target, o.cell_m), o.neighbours, radius_m, lone=True)

    def _judged(self, source: Array, target: Array, start: Array, found: Array) -> Registration:
        surfaces = self.surfaces(target, self.options.radius_m)
        seen = source[:, : surfaces.dimension]
        found = start + planar.wrapped(found - start)
        first = refine(seen, surfaces, found, replace(self._judge, free_sigma_m=_UNKNOWN_M))
        if not first.open_directions:
            return first
        lever = np.array((1.0, 1.0, 1.0 / float(np.hypot(*source.T[:2]).mean())))
        scaled = first.covariance / np.outer(lever, lever)
        axes = lever[:, None] * np.linalg.eigh(scaled)[1][:, 3 - first.open_directions :]
        axes = planar.rotation(found[2]) @ axes
        beside = (axes / lever[:, None]).T @ ((found - start) / lever)
        return refine(seen, surfaces, found - axes @ beside, self._judge)


class SurfaceMatcher(JudgedMatcher):
    """Points to the target's surfaces by the robust Gauss-Newton of `refine`.

    neighbours: fewer than the judge's, as patches that reach round corners cost accuracy.
    """

    calibration = 1.63
    neighbours: ClassVar[int] = 8

    def align(self, source: Array, target: Array, start: Array) -> Iterator[Array]:
        """See JudgedMatcher."""
        motion, near = start, thinned(target, 0.5 * self.options.cell_m)
        for reach_m in self.options.reaches_m:
            surfaces = SurfaceMap(near, self.neighbours, reach_m, lone=True)
            options = RefinementOptions(reach_m=reach_m, iterations=self.options.iterations)
            motion = refine(source[:, : surfaces.dimension], surfaces, motion, options).motion
            yield motion


class KissMatcher(JudgedMatcher):
    """KISS-ICP's registration, points to points with a Geman-McClure kernel.

    The target becomes its voxel map. Clouds of more than whole_points are thinned, as KISS-ICP's
    pipeline does it; voxels as large as the reach see every pair within it.
    """

    calibration = 23.4
    whole_points: ClassVar[int] = 2000
    spacing_m: ClassVar[float] = 0.02

    def align(self, source: Array, target: Array, start: Array) -> Iterator[Array]:
        """See JudgedMatcher."""
        o = self.options
        aligner = kiss.registration(10 * o.iterations, o.converged)
        if len(source) > self.whole_points:
            source = kiss.thinned(source, 0.5)
        if len(target) > self.whole_points:
            target = kiss.thinned(target, 0.15)
        motion = planar.matrix(start)
        for reach_m in o.reaches_m:
            per_voxel = math.ceil((reach_m / self.spacing_m) ** 2)
            voxels = kiss.voxel_map(reach_m, 2.0 * _FAR_M, per_voxel)
            voxels.add_points(target)
            motion = np.asarray(
                aligner.align_points_to_map(source, voxels, motion, reach_m, reach_m / 3.0)
            )
            # The next stage, too, is of planar motions.
            motion = planar.matrix(planar.from_matrix(motion))
            yield motion


def checked(points: Array, name: str, least: int = LEAST_POINTS) -> Array:
    """(N, 3) those points that are numbers, in an order that depends on the points alone.

    Raises ScanError, naming the cloud, where they are too few or in one place.
    """
    try:
        cloud = usable(points, 0.0, _FAR_M, least)
    except ScanError as error:
        raise ScanError(f"{name}: {error}") from None
    return np.ascontiguousarray(cloud[np.lexsort(cloud.T)])


def thinned(points: Array, cell_m: float) -> Array:
    """(K, 3) the means of the points (N, 3) in every cell of a grid that holds any.

    So that a given number of neighbours always spans much more than the scanner's noise.
    """
    cell = np.floor(points / cell_m).astype(np.int64)
    _, row, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    total = [np.bincount(row.ravel(), weights=column) for column in points.T]
    return np.column_stack(total) / count[:, None]


def _in_open3d(name: str) -> Matcher:
    from graphslam.scan import open3d_matchers

    matcher: Matcher = getattr(open3d_matchers, name)()
    return matcher


MATCHERS: dict[str, Callable[[], Matcher]] = {
    "surface": SurfaceMatcher,
    "kiss": KissMatcher,
    "point-to-point": lambda: _in_open3d("PointToPointMatcher"),
    "point-to-plane": lambda: _in_open3d("PointToPlaneMatcher"),
    "generalised": lambda: _in_open3d("GeneralisedMatcher"),
}
"""A matcher with its defaults, by the name that the command line uses.

The last three raise MissingLibraryError where Open3D cannot be loaded.
"""
