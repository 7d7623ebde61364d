"""Scanners on a moving vehicle: what they measure of a world, with noise, holes and sweep time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.scans import Clouds, Mount, Scans
from comparisons.logs.simulate.ray_casting import Solids, cast, cast_rings
from comparisons.logs.simulate.scan_worlds import ScanWorld

PoseAt = Callable[[Array], Array]
"""Poses (N, 3) of the vehicle at times (N,)."""


def half_degrees() -> Array:
    """Angles (361,) of a laser that looks ahead over 180 degrees."""
    return np.deg2rad(np.linspace(-90.0, 90.0, 361))


@dataclass(frozen=True, kw_only=True)
class Planar:
    """A planar laser; the defaults are the angles of the Sick of Nieto 2005, Appendix A.

    angle_rad: (B,) from the scanner's ahead. What lies nearer than min_range_m or beyond
    max_range_m gives no return, nor does a beam with the probability `dropout`. Every beam looks
    sigma_beam_rad beside its stated angle, and its range is wrong by sigma_range_m. beam_s: from
    one beam to the next, each being cast from where the vehicle is by then.
    """

    max_range_m: float
    sigma_range_m: float
    sigma_beam_rad: float
    angle_rad: Array = field(default_factory=half_degrees)
    min_range_m: float = 0.5
    dropout: float = 0.0
    beam_s: float = 0.0
    mount: Mount = field(default_factory=Mount)

    def __post_init__(self) -> None:
        _check(self)

    @property
    def sweep_s(self) -> float:
        """From the first beam to the last."""
        return self.beam_s * (len(self.angle_rad) - 1)

    def record(
        self, rng: np.random.Generator, world: ScanWorld, time: Array, pose_at: PoseAt, scale: float
    ) -> Scans:
        """One scan at each time (N,); scale multiplies the noise."""
        late = self.beam_s * np.arange(len(self.angle_rad))
        still = world.solids()
        ranges = np.empty((len(time), len(late)))
        for k, start in enumerate(time.tolist()):
            pose = _mounted(pose_at(start + late), self.mount)
            solids = _standing(_near(still, pose, self.max_range_m), world, start + late)
            aside = scale * self.sigma_beam_rad * rng.standard_normal(len(late))
            ranges[k] = cast(self.angle_rad + aside, pose, solids)
            ranges[k] = _measured(rng, self, ranges[k], scale)
        return Scans(
            time_s=time,
            angle_rad=self.angle_rad,
            range_m=ranges,
            intensity=np.zeros_like(ranges),
            mount=self.mount,
            beam_s=self.beam_s,
        )


@dataclass(frozen=True, kw_only=True)
class Rings:
    """A spinning laser of R rings, level over a flat ground; as Planar, but for what follows.

    elevation_rad: (R,). azimuths: A firings per turn, each of all rings at once, so that they
    share what the azimuth is wrong by. height_m: over the ground, which is the height of the
    log's pose. sweep_s: from the first firing to the last. The sensor is ours, not Nieto's.
    """

    max_range_m: float = 40.0
    sigma_range_m: float = 0.03
    sigma_beam_rad: float = math.radians(0.1)
    elevation_rad: Array = field(default_factory=lambda: np.deg2rad(np.linspace(-15.0, 15.0, 16)))
    azimuths: int = 450
    height_m: float = 1.8
    min_range_m: float = 1.0
    dropout: float = 0.01
    sweep_s: float = 0.0
    mount: Mount = field(default_factory=Mount)

    def __post_init__(self) -> None:
        _check(self)

    def record(
        self, rng: np.random.Generator, world: ScanWorld, time: Array, pose_at: PoseAt, scale: float
    ) -> Clouds:
        """One scan at each time (N,), firing by firing, from behind and counter-clockwise.

        Points are in the frame of the log's pose at the time of their own firing.
        """
        count, rings = self.azimuths, len(self.elevation_rad)
        azimuth: Array = 2.0 * np.pi / count * np.arange(float(count)) - np.pi
        late = self.sweep_s / max(count - 1, 1) * np.arange(count)
        still = world.solids()
        points = np.empty((len(time), count, rings, 3))
        for k, start in enumerate(time.tolist()):
            pose = _mounted(pose_at(start + late), self.mount)
            solids = _standing(_near(still, pose, self.max_range_m), world, start + late)
            aside = scale * self.sigma_beam_rad * rng.standard_normal(count)
            way = cast_rings(azimuth + aside, self.elevation_rad, self.height_m, pose, solids)
            way = _measured(rng, self, way, scale)
            points[k] = self._points(azimuth, way)
        size = count * rings
        return Clouds(
            time,
            size * np.arange(len(time) + 1),
            points.reshape(-1, 3),
            np.tile(np.repeat(late, rings), len(time)),
        )

    def _points(self, azimuth: Array, way: Array) -> Array:
        """(A, R, 3) forward, left and up of the vehicle, from ranges (A, R)."""
        direction = self.mount.heading_rad + azimuth[:, None]
        level = way * np.cos(self.elevation_rad)
        ahead = self.mount.forward_m + level * np.cos(direction)
        left = self.mount.left_m + level * np.sin(direction)
        up = self.height_m + way * np.sin(self.elevation_rad)
        return np.stack((ahead, left, up), axis=-1)


def _check(sensor: Planar | Rings) -> None:
    for name, least, most in (
        ("min_range_m", 0.0, np.inf),
        ("max_range_m", sensor.min_range_m, np.inf),
        ("sigma_range_m", 0.0, np.inf),
        ("sigma_beam_rad", 0.0, np.inf),
        ("dropout", 0.0, 1.0),
    ):
        value = getattr(sensor, name)
        if not least <= value <= most:
            raise InputError(f"scanner: {name} is {value}, expected {least:g} to {most:g}")


def _measured(
    rng: np.random.Generator, sensor: Planar | Rings, ranges: Array, scale: float
) -> Array:
    """Ranges as reported, NaN for no return. The true range decides whether there is one."""
    noisy = ranges + scale * sensor.sigma_range_m * rng.standard_normal(ranges.shape)
    seen = (ranges >= sensor.min_range_m) & (ranges <= sensor.max_range_m) & (noisy > 0.0)
    seen &= rng.random(ranges.shape) >= sensor.dropout
    return np.where(seen, noisy, np.nan)


def _mounted(pose: Array, mount: Mount) -> Array:
    """Poses (B, 3) of a scanner on vehicles at poses (B, 3)."""
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x = pose[:, 0] + cos * mount.forward_m - sin * mount.left_m
    y = pose[:, 1] + sin * mount.forward_m + cos * mount.left_m
    return np.column_stack((x, y, pose[:, 2] + mount.heading_rad))


def _near(solids: Solids, pose: Array, reach_m: float) -> Solids:
    """What can be seen from any of the poses (B, 3)."""
    way = pose[:, :2] - pose[0, :2]
    return solids.within(pose[0, :2], reach_m + float(np.hypot(*way.T).max()))


def _standing(still: Solids, world: ScanWorld, time: Array) -> Solids:
    """The solids with the movers among them, as the beams at times (B,) find them."""
    if not world.movers:
        return still
    moving = np.stack(
        [
            np.column_stack((mover.place(time), np.full(len(time), mover.diameter_m)))
            for mover in world.movers
        ],
        axis=1,
    )
    disc = np.broadcast_to(still.disc, (len(time), *still.disc.shape))
    height = [mover.height_m for mover in world.movers]
    return replace(
        still,
        disc=np.concatenate((disc, moving), axis=1),
        disc_height_m=np.append(still.disc_height_m, height),
    )
