"""Scan odometry: KISS-ICP aligns every scan to its local map, the surfaces there refine and judge.

KISS-ICP itself says neither how good a result is nor how sure one may be of it, and carries on
whatever it is given. Here every input is checked before it, every result after it, and a scan that
fails neither enters the map nor gives an increment.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from graphslam.arrays import Array
from graphslam.scan import kiss, planar
from graphslam.scan.points import above_ground, usable
from graphslam.scan.refinement import RefinementOptions, refine
from graphslam.scan.registration import Registration, ScanError
from graphslam.scan.surfaces import SurfaceMap

if TYPE_CHECKING:
    from kiss_icp.mapping import VoxelHashMap


_FINE_M, _COARSE_M = 0.03, 0.15
"""Range noise of a good laser, and of one whose walls are a cloud of points."""
_FURTHEST = 1e4
"""No guess between two scans goes further, in metres or radians; KISS-ICP aborts on some."""
_STANDING_M = 0.05
"""Clouds seen within such a way of the last one kept are not kept, or standing fills the memory."""
_RENEWAL = 0.25
"""The map is made anew after this share of its memory."""


@dataclass(frozen=True, kw_only=True)
class KissIcpOptions:
    """Settings of KISS-ICP and of what is believed of it.

    voxel_m, points_per_voxel: KISS-ICP's local map. threshold_m, blind_threshold_m: the scale of
    its kernel with and without a guess; pairs reach three times as far. least_range_m,
    most_range_m: points outside are left out. radius_m, cloud_radius_m, neighbours: a piece of
    surface is made of so many map points at most, not further than that from its middle, in planar
    maps and in clouds, whose rings lie apart; enough to tell a pole from a piece of a dense wall.
    memory_m, blind_memory_m: the local map forgets what was seen longer ago than this way, a radian
    counting as a metre; where the vehicle comes back, the increments stay odometry, and closing the
    loop is left to loop closure. whole_points: clouds with more points are thinned before they are
    aligned. ground_m: of a cloud, what lies lower than this over its lowest points is left out: a
    flat ground says nothing of planar motion, and its rings move with the vehicle. most_jump_m,
    blind_jump_m, most_jump_rad: how far the result may lie from the guess, and from constant
    velocity without one. patience: so many failed scans in a row, and a new map is initialised.
    refinement: its calibration is that of planar scans; cloud_calibration comes on top of it for
    clouds, in which the points of one firing share their errors. Both were found on simulated
    drives. Kernel and memory without a guess were chosen on the car park: with 0.4 m and 40 m its
    path is 3.0 m from GPS (median, aligned) and 7 scans are lost, now 0.1 m and one; with
    KISS-ICP's adaptive threshold 10.5 m and 7.
    """

    voxel_m: float = 0.5
    points_per_voxel: int = 20
    threshold_m: float = 0.1
    blind_threshold_m: float = 0.2
    least_range_m: float = 1.0
    most_range_m: float = 75.0
    radius_m: float = 0.5
    cloud_radius_m: float = 0.8
    neighbours: int = 12
    memory_m: float = 40.0
    blind_memory_m: float = 80.0
    whole_points: int = 1000
    ground_m: float = 0.3
    most_jump_m: float = 1.0
    blind_jump_m: float = 3.0
    most_jump_rad: float = 0.35
    patience: int = 5
    refinement: RefinementOptions = field(
        default_factory=lambda: RefinementOptions(iterations=2, least_overlap=0.2, calibration=0.95)
    )
    cloud_calibration: float = 3.6

    @classmethod
    def for_noise(cls, sigma_m: float) -> KissIcpOptions:
        """For planar scans with so much noise in place of the defaults' few centimetres.

        A piece of wall must be much longer than its noise makes it thick, and the map need not be
        finer. The calibration was found on simulated drives with beams 0.1 and 1 degree off.
        """
        coarse = float(np.clip((sigma_m - _FINE_M) / (_COARSE_M - _FINE_M), 0.0, 1.0))
        return cls(
            voxel_m=float(np.clip(5.0 * sigma_m, 0.5, 1.5)),
            threshold_m=float(np.clip(1.6 * sigma_m, 0.1, 0.5)),
            radius_m=float(np.clip(13.0 * sigma_m, 0.5, 3.0)),
            neighbours=12 + round(88 * coarse),
            refinement=RefinementOptions(
                reach_m=float(np.clip(5.0 * sigma_m, 0.3, 1.5)),
                iterations=2 + round(coarse),
                least_overlap=0.2,
                calibration=0.95 + 0.4 * coarse,
            ),
        )

    def prepared(self, points: Array) -> Array:
        """(M, 3) what of a scan is aligned: above the ground, within range. Raises ScanError."""
        standing = above_ground(points, self.ground_m)
        return usable(standing, self.least_range_m, self.most_range_m)


@dataclass(frozen=True)
class Increment:
    """The motion since the last scan that was used.

    motion: (3,) in that scan's frame. covariance: (3, 3) of the right perturbation, in this scan's
    frame; wide along directions that the surroundings do not fix. since: number of scans back that
    the last used one is, 1 unless some failed. match: evidence, its pose being in the map's frame.
    """

    motion: Array
    covariance: Array
    since: int
    match: Registration


class ScanOdometry:
    """Feeds scans to KISS-ICP one by one. The same scans give the same bits in every process."""

    def __init__(self, options: KissIcpOptions | None = None) -> None:
        """An empty map with the vehicle at the origin."""
        self.options = options or KissIcpOptions()
        self._kiss = kiss.registration(500, 1e-4)
        self.pose, self._motion = np.zeros(3), np.zeros(3)
        self._begin()

    def _begin(self) -> None:
        self._map = self._new_map()
        self._recent: deque[tuple[float, Array]] = deque()
        self._way, self._renewed = 0.0, 0.0
        self._pending = np.zeros(3)
        self._spread = np.zeros((3, 3))
        self._failed, self._empty = 0, True

    def _new_map(self) -> VoxelHashMap:
        o = self.options
        return kiss.voxel_map(o.voxel_m, o.most_range_m, o.points_per_voxel)

    def register(self, points: Array, guess: Array | None = None) -> Increment | None:
        """Align a scan (N, 3), given what is guessed of the motion (3,) since the one before.

        Without a guess the vehicle is taken to move on as it did. Returns None for a scan that
        begins a map: the first, or the first good one after `patience` failures. Raises ScanError
        for a scan that cannot be used; the next one is then aligned to the last that could.
        """
        wrong = guess is not None and not _is_motion(guess)
        usual = self._motion if guess is None or wrong else guess
        self._pending = planar.compose(self._pending, usual)
        self._failed += 1
        if self._failed > self.options.patience and not self._empty:
            self.pose = planar.compose(self.pose, self._pending)
            self._begin()
            self._failed = 1
        if wrong:
            raise ScanError(f"the guess is {guess}, expected three numbers, {_FURTHEST:g} at most")
        o = self.options
        cloud = _in_order_of_azimuth(o.prepared(points))
        kept = source = cloud
        if len(cloud) > o.whole_points:
            kept = kiss.thinned(cloud, 0.5 * o.voxel_m)
            source = kiss.thinned(kept, 1.5 * o.voxel_m)
        if self._empty:
            self.pose = planar.compose(self.pose, self._pending)
            self._accept(kept, np.zeros(3), blind=guess is None)
            return None
        expected = planar.compose(self.pose, self._pending)
        match = self._align(source, expected, blind=guess is None)
        motion = planar.between(self.pose, match.motion)
        covariance = match.covariance + planar.carried(self._spread, motion)
        increment = Increment(motion, covariance, self._failed, match)
        self.pose, self._spread = match.motion, match.covariance
        self._motion = motion if self._failed == 1 else planar.share(motion, self._failed)
        self._accept(kept, motion, blind=guess is None)
        return increment

    def map_points(self) -> Array:
        """(M, 3) KISS-ICP's local map."""
        return np.asarray(self._map.point_cloud())

    def _accept(self, cloud: Array, motion: Array, *, blind: bool) -> None:
        self._way += float(np.hypot(motion[0], motion[1])) + abs(float(motion[2]))
        self._map.update(cloud, planar.matrix(self.pose))
        memory_m = self.options.blind_memory_m if blind else self.options.memory_m
        self._remember(planar.moved(self.pose, cloud), memory_m)
        self._pending, self._failed, self._empty = np.zeros(3), 0, False

    def _remember(self, cloud: Array, memory_m: float) -> None:
        """Keep the recent clouds; make the map of them anew when much of it is old."""
        if self._recent and self._way - self._recent[-1][0] < _STANDING_M:
            return
        self._recent.append((self._way, cloud))
        oldest = self._way - memory_m
        if self._way - self._renewed < _RENEWAL * memory_m or self._recent[0][0] > oldest:
            return
        while self._recent[0][0] < oldest:
            self._recent.popleft()
        self._map, self._renewed = self._new_map(), self._way
        for _, points in self._recent:
            self._map.add_points(points)

    def _align(self, source: Array, guess: Array, *, blind: bool) -> Registration:
        o = self.options
        threshold_m = o.blind_threshold_m if blind else o.threshold_m
        most_jump_m = o.blind_jump_m if blind else o.most_jump_m
        found = self._kiss.align_points_to_map(
            source, self._map, planar.matrix(guess), 3.0 * threshold_m, threshold_m
        )
        if not np.isfinite(found).all():
            raise ScanError("KISS-ICP found no alignment")
        start = planar.from_matrix(found)
        points = self.map_points()
        radius_m = o.cloud_radius_m if points[:, 2].any() else o.radius_m
        target = SurfaceMap(points, o.neighbours, radius_m, lone=True)
        believed = o.refinement
        if target.dimension == 3:
            believed = replace(believed, calibration=believed.calibration * o.cloud_calibration)
        match = refine(source[:, : target.dimension], target, start, believed)
        jump = planar.wrapped(match.motion - guess)
        distance, turn = float(np.hypot(jump[0], jump[1])), abs(float(jump[2]))
        if distance > most_jump_m or turn > o.most_jump_rad:
            raise ScanError(
                f"aligned {distance:.2f} m and {turn:.2f} rad from the guess, expected "
                f"{most_jump_m:g} m and {o.most_jump_rad:g} rad at most"
            )
        return replace(match, motion=guess + jump)


def _is_motion(guess: Array) -> bool:
    return np.shape(guess) == (3,) and bool((np.abs(guess) <= _FURTHEST).all())


def _in_order_of_azimuth(cloud: Array) -> Array:
    """The points in an order that depends on them alone, as a voxel keeps those that come first.

    That of a turning laser. Sorted by place, a voxel would keep the lowest of its points, on
    whichever side of a wall noise has put it.
    """
    x, y, z = cloud.T
    azimuth = np.arctan2(y, x)
    if (azimuth[1:] > azimuth[:-1]).all():
        return cloud
    return np.ascontiguousarray(cloud[np.lexsort((z, np.hypot(x, y), azimuth))])
