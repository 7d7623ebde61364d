"""Drives that record raw scans, odometry, measurements and exact truth (Nieto 2005, chs. 3-5)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.logs.log import Log, Poses, Truth
from comparisons.logs.scans import Clouds, Scans
from comparisons.logs.simulate.drive import (
    Drive,
    exact_landmarks,
    known_start,
    point_measurements,
    true_drive,
    wheel_odometry,
)
from comparisons.logs.simulate.dynamic_worlds import lanes_world, parked_world, places_world
from comparisons.logs.simulate.ray_casting import cast
from comparisons.logs.simulate.scan_worlds import (
    MORE_LANDMARKS,
    ScanWorld,
    dense_scan_slam_world,
    dense_slam_world,
    occupancy_world,
    scan_slam_world,
    with_landmarks_among,
)
from comparisons.logs.simulate.scanners import Planar, Rings

_OVERLAP_M = 30.0
"""After the last loop the start is passed once more by so much."""


@dataclass(frozen=True)
class ScanExperiment:
    """Everything that a simulated log of scans depends on but the seed.

    drive: vehicle, sampling times and measurements. Scans are taken at the same instants as
    measurements; those whose sweep would outlast the log are left out.
    """

    name: str
    source: str
    world: ScanWorld
    drive: Drive
    scanner: Planar | Rings


def simulate(rng: np.random.Generator, experiment: ScanExperiment) -> Log:
    """One simulated log with truth: poses at every odometry sample, landmarks, surfaces.

    Landmarks that are carried about are seen but are not among the truth's. The same generator
    state gives the same log. Between two samples the vehicle goes straight
    and turns evenly, which is what the motion model's Euler step says (N, eq. A.4).
    """
    world, drive, scanner = experiment.world, experiment.drive, experiment.scanner
    time, control, pose = true_drive(drive, world)
    odometry = wheel_odometry(rng, drive, time, control)
    samples = drive.scan_samples(len(control))
    landmark = world.landmarks_at(time[samples])
    hidden = _hidden(world, drive, pose[samples], landmark)
    measurements = point_measurements(rng, drive, landmark, time[samples], pose[samples], hidden)

    def pose_at(instant: Array) -> Array:
        return np.column_stack([np.interp(instant, time, column) for column in pose.T])

    start = time[samples]
    start = start[start + scanner.sweep_s <= time[-1]]
    record = scanner.record(rng, world, start, pose_at, drive.added_scale)
    return Log(
        name=experiment.name,
        format="simulated",
        prior=known_start(pose, drive.noise_scale),
        odometry=odometry,
        measurements=measurements,
        scans=record if isinstance(record, Scans) else None,
        clouds=record if isinstance(record, Clouds) else None,
        truth=Truth(
            Poses(time, pose),
            exact_landmarks(world.landmark) if len(world.landmark) else None,
            world.surfaces(),
        ),
        provenance={
            "source": experiment.source,
            "loops": str(drive.loops),
            "noise_scale": f"{drive.noise_scale:g}",
        },
    )


def dense_slam(loops: int = 1, noise_scale: float = 1.0) -> ScanExperiment:
    """Nieto 2005, section 3.9, Fig. 3.17, Table 3.1, with sigmas of measurements and of beams."""
    world = dense_slam_world()
    table = _Table(every=14, steering_deg=3.0, range_m=0.15, bearing_deg=1.5, reach_m=25.0)
    drive = _drive(world, loops, noise_scale, table)
    return _experiment("scan-loop", "section 3.9, Fig. 3.17, Table 3.1", world, drive)


def dense_slam_fine(loops: int = 1, noise_scale: float = 1.0) -> ScanExperiment:
    """The same drive with our laser, as exact as a Sick's; measurements as in the table.

    With the same generator state odometry and measurements are those of `dense_slam` to the bit.
    """
    table = dense_slam(loops, noise_scale)
    source = f"{table.source}, and so is a laser as exact as a Sick's"
    scanner = Planar(
        max_range_m=table.drive.max_range_m, sigma_range_m=0.02, sigma_beam_rad=math.radians(0.1)
    )
    return replace(table, name="scan-loop-fine", source=source, scanner=scanner)


def dense_slam_in_space(loops: int = 1, noise_scale: float = 1.0) -> ScanExperiment:
    """The same drive with a spinning laser of 16 rings, which is ours."""
    flat = dense_slam(loops, noise_scale)
    source = f"{flat.source}, and so is the scanner of 16 rings"
    return replace(flat, name="scan-loop-3d", source=source, scanner=Rings())


def occupancy(loops: int = 1, noise_scale: float = 1.0) -> ScanExperiment:
    """Nieto 2005, section 4.1.3, Fig. 4.2, Table 4.1."""
    world = occupancy_world()
    table = _Table(every=14, steering_deg=5.0, range_m=0.10, bearing_deg=1.0, reach_m=25.0)
    drive = _drive(world, loops, noise_scale, table)
    return _experiment("occupancy-loop", "section 4.1.3, Fig. 4.2, Table 4.1", world, drive)


def scan_slam(loops: int = 1, noise_scale: float = 1.0) -> ScanExperiment:
    """Nieto 2005, section 5.6, Fig. 5.8, Table 5.1.

    The text gives 30 m of reach and 1.5 degrees of bearing sigma, the table 35 m and 1 degree:
    the table holds here.
    """
    world = scan_slam_world()
    table = _Table(every=8, steering_deg=5.0, range_m=0.10, bearing_deg=1.0, reach_m=35.0)
    drive = _drive(world, loops, noise_scale, table)
    return _experiment("scan-slam", "section 5.6, Fig. 5.8, Table 5.1", world, drive)


def scan_slam_with_maps(loops: int = 1, noise_scale: float = 1.0) -> ScanExperiment:
    """Nieto 2005, section 6.2.1, Fig. 6.7; of vehicle and scanner nothing new is said there."""
    drive = scan_slam(loops, noise_scale).drive
    world = dense_scan_slam_world()
    drive = replace(drive, loop_s=world.loop_m / drive.speed_mps)
    return _experiment("scan-slam-maps", "section 6.2.1, Fig. 6.7, Table 5.1", world, drive)


def dynamic_lanes(
    loops: int = 1, noise_scale: float = 1.0, *, carried: bool = False
) -> ScanExperiment:
    """Nieto 2005, section 6.3.3, Fig. 6.9: a sensor stands by two lanes, ten scans a second.

    Its sigmas are the section's; how well standing still is known is ours. A loop is 30 s.
    carried: a vehicle carries a landmark.
    """
    world = lanes_world(carried=carried)
    drive = Drive(
        loops=loops,
        speed_mps=0.0,
        loop_s=30.0,
        scan_every=4,
        sigma_speed_mps=0.1,
        sigma_range_m=0.15,
        sigma_bearing_rad=math.radians(1.0),
        max_range_m=25.0,
        noise_scale=noise_scale,
    )
    return _experiment("dynamic-lanes", "section 6.3.3, Fig. 6.9", world, drive)


def dynamic_places(
    loops: int = 1, noise_scale: float = 1.0, *, carried: bool = False
) -> ScanExperiment:
    """Nieto 2005, section 6.3.3, Fig. 6.10: places that change between two passes.

    Of the sensor the thesis says nothing more than for Fig. 6.9, so it is the same, at the rate of
    Table 4.1. One more loop is driven, since it takes two for anything to have changed.
    carried: what is taken away takes a landmark along.
    """
    world = places_world(carried=carried)
    table = _Table(every=14, steering_deg=3.0, range_m=0.15, bearing_deg=1.0, reach_m=25.0)
    drive = replace(_drive(world, loops + 1, noise_scale, table), extra_s=0.0)
    return _experiment("dynamic-places", "section 6.3.3, Fig. 6.10", world, drive)


def enclosed(experiment: ScanExperiment) -> ScanExperiment:
    """The same drive in its world with landmarks among and behind the objects.

    The thesis' regions are triangles of landmarks that enclose what is scanned (Nieto 2005,
    sections 3.4 and 3.5); where these stand it shows in pictures alone.
    """
    source = f"{experiment.source}, and so are {MORE_LANDMARKS} landmarks among the objects"
    world = with_landmarks_among(experiment.world)
    return replace(experiment, name=f"{experiment.name}-enclosed", source=source, world=world)


def parked_cars() -> ScanExperiment:
    """Nieto 2005, section 6.5, Figs. 6.19 and 6.20: three cars leave between two laps.

    The range's sigma is Table 4.1's. The bearing's, half of that, is ours, since that of the
    section's laser is not stated: by a whole degree small areas at poles and walls are found, too.
    """
    world = parked_world()
    drive = replace(
        dynamic_places().drive,
        loop_s=world.loop_m / dynamic_places().drive.speed_mps,
        sigma_range_m=0.10,
        sigma_bearing_rad=math.radians(0.5),
    )
    ours = "the places and the bearing's sigma"
    return _experiment("parked-cars", "section 6.5, Fig. 6.19", world, drive, ours)


class _Table(NamedTuple):
    """What Tables 3.1, 4.1 and 5.1 say of the sensors, each otherwise."""

    every: int
    steering_deg: float
    range_m: float
    bearing_deg: float
    reach_m: float


def _drive(world: ScanWorld, loops: int, noise_scale: float, table: _Table) -> Drive:
    """A drive with what the tables have in common, too."""
    speed = 3.0
    return Drive(
        loops=loops,
        speed_mps=speed,
        sample_s=0.025,
        scan_every=table.every,
        sigma_speed_mps=0.5,
        sigma_steering_rad=math.radians(table.steering_deg),
        sigma_range_m=table.range_m,
        sigma_bearing_rad=math.radians(table.bearing_deg),
        max_range_m=table.reach_m,
        loop_s=world.loop_m / speed,
        extra_s=_OVERLAP_M / speed,
        noise_scale=noise_scale,
    )


def _experiment(
    name: str, where: str, world: ScanWorld, drive: Drive, ours: str = "the places"
) -> ScanExperiment:
    """A drive with a laser of the tables' range and bearing sigmas, every beam for itself."""
    scanner = Planar(
        max_range_m=drive.max_range_m,
        sigma_range_m=drive.sigma_range_m,
        sigma_beam_rad=drive.sigma_bearing_rad,
    )
    return ScanExperiment(name, f"Nieto 2005, {where}; {ours} are ours", world, drive, scanner)


def _hidden(world: ScanWorld, drive: Drive, pose: Array, landmark: Array) -> NDArray[np.bool_]:
    """(N, L) landmarks (N, L, 2) behind an object, seen from poses (N, 3). Poles hide nothing."""
    offset = landmark - pose[:, None, :2]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    hidden = np.zeros(distance.shape, dtype=bool)
    near = np.nonzero(distance <= drive.max_range_m)
    at = pose[near[0]]
    bearing = np.arctan2(offset[..., 1], offset[..., 0])[near] - at[:, 2]
    walls = replace(world.solids(), disc=np.zeros((0, 3)))
    hidden[near] = cast(bearing, at, walls) < distance[near]
    return hidden
