"""One planar scan, placed in the world, as the layers of a dense map read it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array, Index, Mask, rotation
from ekf_reference.dense.triangles import turned

Single = NDArray[np.float32]
"""For many cells near the scanner, where single precision is some micrometres."""

_DIRECTIONS = 7200
"""Directions of the compass for which the nearest beam is looked up once a scan."""
_TURN = 2.0 * np.pi
_DIRECTION = (np.arange(_DIRECTIONS + 1, dtype=float) + 0.5) * (_TURN / _DIRECTIONS) - np.pi
"""(D + 1,) bearings [rad] in the middle of each direction; the last is the first again."""
_SECTORS = 450
"""Parts of the circle for which the farthest return is looked up once a scan."""
_LEVEL = np.ceil(np.log2(2.0 * np.arange(_SECTORS // 2 + 1) + 1.0)).astype(np.int32)
"""(S / 2 + 1,) a window of 2^l sectors holds one sector and so many to either side."""
NEXT = 1.5
"""Two returns are neighbours when so many beams or fewer apart."""
_NOISY = 3.0
"""Standard deviations by which ranges on one surface may differ beside its slope."""


@dataclass(frozen=True)
class ScanSensor:
    """A range and bearing sensor. sigma_range_m, sigma_bearing_rad: of every return.

    beam_rad: angle between two beams; nothing was measured in a direction that is farther than half
    of that, and than a sigma, from every return. grazing_rad: least angle to a surface at which
    neighbouring returns may lie on one, with the range between them known; 0 for never.
    """

    sigma_range_m: float
    sigma_bearing_rad: float
    beam_rad: float
    grazing_rad: float = 0.0

    def joins(self, first_m: Array, second_m: Array, turn_rad: Array) -> Mask:
        """(N,) whether two returns at ranges (N,), an angle (N,) apart, lie on one surface.

        They do when they are next to each other and the surface between them is met at no less
        than the grazing angle, give or take the noise.
        """
        if not self.grazing_rad > 0.0:
            return np.zeros(len(turn_rad), dtype=bool)
        steepest = np.minimum(first_m, second_m) * turn_rad / np.tan(self.grazing_rad)
        noise = _NOISY * np.sqrt(2.0) * self.sigma_range_m
        near = turn_rad <= NEXT * self.beam_rad
        on_one: Mask = near & (np.abs(second_m - first_m) <= steepest + noise)
        return on_one

    def covariance(self, point: Array, range_m: Array) -> Array:
        """(N, 2, 2) [m^2] of returns (N, 2) in the scanner's frame (Nieto 2005, eq. 4.16)."""
        ray = point / range_m[:, None]
        along = self.sigma_range_m**2 * ray[:, :, None] * ray[:, None, :]
        side = turned(ray)
        across = (range_m * self.sigma_bearing_rad) ** 2
        return along + across[:, None, None] * side[:, :, None] * side[:, None, :]

    @property
    def reach_rad(self) -> float:
        """How far to its sides a return speaks; without the last term gaps would open midway."""
        return max(0.5 * self.beam_rad, self.sigma_bearing_rad) + _TURN / _DIRECTIONS


@dataclass(frozen=True)
class Beams:
    """The returns of a scan met by some points. All (N,).

    ahead_m: how far the point's range falls short of the return nearest in bearing, or of the
    surface between that and the next; negative beyond. off_rad: bearing off that beam. seen:
    whether a return speaks about it.
    """

    ahead_m: Array
    off_rad: Array
    seen: Mask


@dataclass(frozen=True, kw_only=True)
class Scan:
    """The returns of one scan. pose: (3,) of the scanner in the world.

    bearing_rad: (B,) ascending, in [-pi, pi), from the scanner's ahead. range_m: (B,) finite,
    above zero.
    """

    pose: Array
    bearing_rad: Array
    range_m: Array
    sensor: ScanSensor

    @classmethod
    def of_ranges(cls, pose: Array, bearing_rad: Array, range_m: Array, sensor: ScanSensor) -> Self:
        """From beams in any order (B,). What is not finite or not above zero is no return.

        A beam without a return says nothing: it may have met no surface, or one that absorbs.
        """
        returned = np.flatnonzero(
            np.isfinite(range_m) & np.isfinite(bearing_rad) & (np.nan_to_num(range_m) > 0.0)
        )
        bearing = np.mod(bearing_rad[returned] + np.pi, _TURN) - np.pi
        order = np.argsort(bearing, kind="stable")
        return cls(
            pose=pose,
            bearing_rad=bearing[order],
            range_m=range_m[returned][order],
            sensor=sensor,
        )

    @property
    def origin(self) -> Array:
        """(2,) of the scanner [m]."""
        return self.pose[:2]

    @cached_property
    def point(self) -> Array:
        """(B, 2) where the returns come from, in the world [m] (Nieto 2005, eq. 4.15)."""
        direction = self.pose[2] + self.bearing_rad
        ray = np.stack((np.cos(direction), np.sin(direction)), axis=1)
        where: Array = self.origin + self.range_m[:, None] * ray
        return where

    @cached_property
    def covariance(self) -> Array:
        """(B, 2, 2) of these points for a known pose [m^2] (Nieto 2005, eq. 4.16)."""
        return self.sensor.covariance(self.point - self.origin, self.range_m)

    def box(self, margin_m: float = 0.0) -> Array:
        """(4,) west, south, east, north of the scanner and all returns."""
        least = self.point.min(axis=0, initial=np.inf)
        most = self.point.max(axis=0, initial=-np.inf)
        west_south = np.minimum(least, self.origin) - margin_m
        return np.concatenate((west_south, np.maximum(most, self.origin) + margin_m))

    def beams(self, point: Array) -> Beams:
        """The returns that speak about points (N, 2) of the world [m]."""
        return self.beams_ahead(*((point - self.origin) @ self.axes).T)

    @property
    def axes(self) -> Array:
        """(2, 2) columns are ahead and left of the scanner, in the world."""
        return rotation(float(self.pose[2]))

    def beams_ahead(self, ahead_m: Array, left_m: Array) -> Beams:
        """The same for points ahead and left (N,) of the scanner."""
        distance = np.sqrt(ahead_m * ahead_m + left_m * left_m)
        if not len(self.range_m):
            none = np.zeros(len(distance))
            return Beams(none, none, none > 0.0)
        bearing = np.arctan2(left_m, ahead_m)
        beam = self._nearest[((bearing + np.pi) * (_DIRECTIONS / _TURN)).astype(np.intp)]
        off, reach, seen = self._towards(bearing, beam)
        return Beams(reach - distance, off, seen)

    def short_of(self, ahead_m: Single, left_m: Single) -> Single:
        """(N,) `ahead_m` of `beams_ahead`, -inf where unseen; fast, directions to 0.05 degrees."""
        bearing = np.arctan2(left_m, ahead_m)
        direction = ((bearing + np.float32(np.pi)) * np.float32(_DIRECTIONS / _TURN)).astype(
            np.intp
        )
        short: Single = self._speaking.take(direction) - np.sqrt(ahead_m**2 + left_m**2)
        return short

    def farthest(self, ahead_m: Single, left_m: Single, radius_m: float | Single) -> Single:
        """(N,) bound on the range [m] of returns that speak about discs, -inf where none does.

        ahead_m, left_m: (N,) of their middles. No less than any range that `short_of` takes for a
        point of the disc.
        """
        distance = np.sqrt(ahead_m * ahead_m + left_m * left_m)
        half = 0.5 * np.pi * radius_m / np.maximum(distance, radius_m)  # its arcsine is less
        reach = (half * np.float32(_SECTORS / _TURN)).astype(np.int32) + 1
        reach[distance <= radius_m] = _SECTORS // 2
        bearing = np.arctan2(left_m, ahead_m) + np.float32(np.pi)
        first = (bearing * np.float32(_SECTORS / _TURN)).astype(np.int32) - reach
        bound: Single = self._windows.take(_LEVEL.take(reach) * _SECTORS + first % _SECTORS)
        return bound

    @cached_property
    def _windows(self) -> Single:
        """Row l: greatest range of 2^l sectors (S,) from each one on; the last, of all."""
        row = self._speaking[:-1]
        while len(row) > _SECTORS:
            row = np.maximum(row[::2], row[1::2])
        rows = [row]
        for level in range(int(_LEVEL[-1])):
            ahead = 2**level
            row = np.maximum(row, np.concatenate((row[ahead:], row[:ahead])))
            rows.append(row)
        return np.stack(rows)

    @cached_property
    def _speaking(self) -> Single:
        """(D + 1,) range [m] of the return that speaks about each direction, -inf for none."""
        _, reach, speaks = self._towards(_DIRECTION, self._nearest)
        return np.where(speaks, reach, -np.inf).astype(np.float32)

    def _towards(self, bearing: Array, beam: Index) -> tuple[Array, Array, Mask]:
        """Bearings (N,) with their nearest returns: off those, range there, and whether known."""
        off = bearing - self.bearing_rad.take(beam)
        off -= _TURN * np.round(off / _TURN)
        reach = self.range_m.take(beam)
        seen = np.abs(off) <= self.sensor.reach_rad
        first, second, turn, joined = self._gaps
        if joined.any():
            gap = np.where(off >= 0.0, beam, beam - 1)
            row = np.flatnonzero(joined[gap])
            gap, along = gap[row], off[row]
            opening = turn[gap]
            along = np.where(along >= 0.0, along, opening + along)
            line = np.sin(opening - along) / first[gap] + np.sin(along) / second[gap]
            reach[row] = np.sin(turn)[gap] / line
            seen[row] = True
        return np.abs(off), reach, seen

    @cached_property
    def _gaps(self) -> tuple[Array, Array, Array, Mask]:
        """From each return to the next: both ranges, the angle, and whether on one surface."""
        first, second = self.range_m, np.roll(self.range_m, -1)
        turn = np.mod(np.roll(self.bearing_rad, -1) - self.bearing_rad, _TURN)
        return first, second, turn, self.sensor.joins(first, second, turn) & (turn > 0.0)

    @cached_property
    def _nearest(self) -> Index:
        """(D + 1,) nearest return in each direction."""
        around = np.concatenate(
            (self.bearing_rad[-1:] - _TURN, self.bearing_rad, self.bearing_rad[:1] + _TURN)
        )
        halfway = 0.5 * (around[1:] + around[:-1])
        first = np.searchsorted(_DIRECTION, halfway, side="right")  # direction beyond each
        return np.repeat(
            np.arange(-1, len(halfway)) % len(self.bearing_rad),
            np.diff(first, prepend=0, append=len(_DIRECTION)),
        )
