"""Scanners: exact without noise, and with noise as uncertain as they say."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chi2

from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.scans import Mount
from comparisons.logs.simulate.scan_drive import (
    ScanExperiment,
    dense_slam,
    dense_slam_in_space,
    occupancy,
    scan_slam,
    simulate,
)
from comparisons.logs.simulate.scan_worlds import Mover, ScanWorld
from comparisons.logs.simulate.scanners import Planar, Rings
from tests.helpers import present

Array = NDArray[np.float64]

PLANAR = {"scan-loop": dense_slam, "occupancy-loop": occupancy, "scan-slam": scan_slam}
MOUNT = Mount(0.4, -0.2, 0.1)
SWEEP_S = 0.1


def short(experiment: ScanExperiment, seconds: float = 12.0, **drive: float) -> ScanExperiment:
    """Its beginning."""
    return replace(
        experiment,
        drive=replace(experiment.drive, loop_s=seconds, extra_s=0.0, **drive),  # type: ignore[arg-type]
    )


def exact(experiment: ScanExperiment) -> ScanExperiment:
    """The same with nothing added."""
    return replace(experiment, drive=replace(experiment.drive, exact=True))


def log_of(experiment: ScanExperiment, seed: int = 0) -> Log:
    return simulate(np.random.default_rng(seed), experiment)


def poses_at(log: Log, time: Array) -> Array:
    """The truth at times of any shape, between two samples along the straight line."""
    assert log.truth.poses is not None
    columns = log.truth.poses.pose.T
    return np.stack([np.interp(time, log.truth.poses.time_s, c) for c in columns], axis=-1)


def placed(pose: Array, point: Array) -> Array:
    """Points (..., 2) of vehicles at poses (..., 3), in the world."""
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x = pose[..., 0] + cos * point[..., 0] - sin * point[..., 1]
    y = pose[..., 1] + sin * point[..., 0] + cos * point[..., 1]
    return np.stack((x, y), axis=-1)


def points_of(log: Log, late: bool = True) -> tuple[Array, Array]:
    """Returns (P, 2) in the world and their times (P,); not late: all from the scan's start."""
    scans = present(log.scans)
    time = scans.time_s[:, None] + scans.beam_s * np.arange(len(scans.angle_rad))
    start = np.broadcast_to(scans.time_s[:, None], time.shape)
    angle, mount = scans.mount.heading_rad + scans.angle_rad, scans.mount
    offset = scans.range_m[..., None] * np.column_stack((np.cos(angle), np.sin(angle)))
    offset = offset + (mount.forward_m, mount.left_m)
    point = placed(poses_at(log, time if late else start), offset)
    seen = np.isfinite(scans.range_m)
    return point[seen], time[seen]


def from_walls(point: Array, world: ScanWorld) -> Array:
    """(P,) distances to the nearest side of an outline, or circle of a pole."""
    start, way = world.segment[:, :2], world.segment[:, 2:] - world.segment[:, :2]
    best = np.full(len(point), np.inf)
    for corner, side in zip(start, way, strict=True):
        part = np.clip((point - corner) @ side / (side @ side), 0.0, 1.0)
        best = np.minimum(best, np.hypot(*(point - corner - part[:, None] * side).T))
    for x, y, diameter in world.pole:
        away = np.abs(np.hypot(point[:, 0] - x, point[:, 1] - y) - 0.5 * diameter)
        best = np.minimum(best, away)
    return best


@pytest.mark.parametrize("name", PLANAR)
def test_without_noise_every_return_lies_on_a_surface(name: str) -> None:
    experiment = short(exact(PLANAR[name]()))
    assert isinstance(experiment.scanner, Planar)
    log = log_of(experiment)
    point, _ = points_of(log)
    assert len(point) > 1000
    assert from_walls(point, experiment.world).max() < 1e-9
    assert log.scans is not None
    ranges = log.scans.range_m[np.isfinite(log.scans.range_m)]
    assert ranges.min() >= experiment.scanner.min_range_m
    assert ranges.max() <= experiment.scanner.max_range_m
    assert ranges.max() > experiment.scanner.max_range_m - 1.0


def swept(**scanner: float) -> ScanExperiment:
    experiment = short(exact(dense_slam()))
    assert isinstance(experiment.scanner, Planar)
    laser = replace(experiment.scanner, mount=MOUNT, **scanner)  # type: ignore[arg-type]
    return replace(experiment, scanner=laser)


@pytest.mark.parametrize("beam_s", [SWEEP_S / 360, -SWEEP_S / 360])
def test_each_beam_is_cast_from_where_the_scanner_is_by_then(beam_s: float) -> None:
    experiment = swept(beam_s=beam_s)
    log = log_of(experiment)
    assert log.scans is not None
    assert log.scans.mount == MOUNT
    assert from_walls(points_of(log)[0], experiment.world).max() < 1e-9
    assert from_walls(points_of(log, late=False)[0], experiment.world).max() > 0.1
    unmounted = replace(log, scans=replace(log.scans, mount=Mount()))
    assert from_walls(points_of(unmounted)[0], experiment.world).max() > 0.1


def test_movers_are_seen_where_they_are() -> None:
    movers = (
        Mover(start=(6, 5), end=(14, 5), speed_mps=1.5, diameter_m=0.8),
        Mover(start=(20, -4), end=(26, -3), speed_mps=4.0, diameter_m=1.0, lead_s=3.0),
    )
    experiment = swept(beam_s=SWEEP_S / 360)
    experiment = replace(experiment, world=replace(experiment.world, movers=movers))
    log = log_of(experiment)
    point, time = points_of(log)
    off = from_walls(point, experiment.world) > 1e-9
    apart = [
        np.abs(np.hypot(*(point[off] - mover.place(time[off])).T) - 0.5 * mover.diameter_m)
        for mover in movers
    ]
    assert np.min(apart, axis=0).max() < 1e-9
    for distance in apart:
        hit = distance < 1e-9
        assert np.count_nonzero(hit) > 50
        assert np.ptp(point[off][hit], axis=0).max() > 2.0  # it was seen in different places
    still = [
        np.abs(np.hypot(*(point[off] - mover.start).T) - 0.5 * mover.diameter_m) for mover in movers
    ]
    assert np.min(still, axis=0).max() > 1.0


def spun(*, noisy: bool = False, sweep_s: float = 0.0, **rings: float) -> ScanExperiment:
    experiment = short(dense_slam_in_space())
    experiment = experiment if noisy else exact(experiment)
    scanner = Rings(sweep_s=sweep_s, mount=MOUNT, **rings)  # type: ignore[arg-type]
    world = replace(
        experiment.world, movers=(Mover(start=(6, 5), end=(14, 5), speed_mps=1.5, diameter_m=0.8),)
    )
    return replace(experiment, scanner=scanner, world=world)


@pytest.mark.slow
@pytest.mark.parametrize("sweep_s", [0.0, 0.1])
def test_without_noise_every_point_lies_on_something(sweep_s: float) -> None:
    """A wall, a pole or the mover at most as high as they are; a top; or the ground."""
    experiment = spun(sweep_s=sweep_s)
    world, log = experiment.world, log_of(experiment)
    clouds = present(log.clouds)
    time = np.repeat(clouds.time_s, np.diff(clouds.first)) + clouds.point_s
    seen = np.isfinite(clouds.point_m[:, 0])
    assert np.isclose(clouds.point_s.max(), sweep_s)
    up = clouds.point_m[seen, 2]
    point = placed(poses_at(log, time[seen]), clouds.point_m[seen, :2])
    ground = np.abs(up) < 1e-9
    top = np.isin(up.round(9), [*world.outline_height_m, 1.7]) & ~ground
    wall = from_walls(point, world) < 1e-9
    mover = world.movers[0]
    away = np.hypot(*(point - mover.place(time[seen])).T)
    moving = (np.abs(away - 0.5 * mover.diameter_m) < 1e-9) & (up <= mover.height_m + 1e-9)
    assert (ground | top | wall | moving).all()
    for kind in (ground, top, wall & ~ground & ~top, moving):
        assert np.count_nonzero(kind) > 20
    assert up.min() > -1e-9
    assert up.max() <= world.outline_height_m.max()
    if sweep_s:
        frozen = placed(poses_at(log, (time - clouds.point_s)[seen]), clouds.point_m[seen, :2])
        assert from_walls(frozen[wall], world).max() > 0.1


def in_bounds(square: float, count: int) -> bool:
    """A sum of squared normal numbers, two-sided, wrong once in 10,000 times."""
    low, high = chi2.interval(0.9999, count)
    return bool(low < square < high)


def residuals(kind: str) -> Array:
    """What noise adds to the data, over the sigma that is stated."""
    if kind in ("planar range", "rings range"):
        made = []
        for noisy in (True, False):
            if kind != "planar range":
                experiment = spun(noisy=noisy)
            else:
                experiment = short(dense_slam() if noisy else exact(dense_slam()))
            experiment = replace(experiment, scanner=replace(experiment.scanner, sigma_beam_rad=0))
            log = log_of(experiment)
            if log.scans is not None:
                made.append(log.scans.range_m.ravel())
            elif log.clouds is not None:
                scanner = (MOUNT.forward_m, MOUNT.left_m, Rings().height_m)
                made.append(np.linalg.norm(log.clouds.point_m - scanner, axis=1))
        error = (made[0] - made[1]) / experiment.scanner.sigma_range_m
        return error[np.isfinite(error)]
    # One wall 10 m ahead, seen at a slant: the range tells where a beam truly looked.
    corner = np.array([(10.0, -200.0), (12.0, -200.0), (12.0, 200.0), (10.0, 200.0)])
    world = ScanWorld(
        path=np.zeros((1, 2)),
        landmark=np.zeros((0, 2)),
        outline=(corner,),
        outline_height_m=np.array([50.0]),
    )
    angle = np.deg2rad(np.linspace(30.0, 60.0, 61))
    laser = Planar(
        max_range_m=100.0, sigma_range_m=0.0, sigma_beam_rad=np.deg2rad(1.0), angle_rad=angle
    )
    scans = laser.record(
        np.random.default_rng(1), world, np.arange(50.0), lambda t: np.zeros((len(t), 3)), 1.0
    )
    aside: Array = (np.arccos(10.0 / scans.range_m) - angle) / laser.sigma_beam_rad
    return aside.ravel()


@pytest.mark.parametrize("kind", ["planar range", "rings range", "beam"])
def test_noise_is_as_large_as_stated(kind: str) -> None:
    error = residuals(kind)
    count = len(error)
    assert count > 2000
    assert in_bounds(float(error @ error), count)
    assert abs(error.mean()) < 4.0 / np.sqrt(count)
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 4.0 / np.sqrt(count)
    for off in (0.8, 1.2):
        assert not in_bounds(float(error @ error) * off**2, count)


@pytest.mark.parametrize("dropout", [0.1, 0.3])
def test_returns_are_lost_as_often_as_stated(dropout: float) -> None:
    experiment = dense_slam()
    whole, holed = (
        log_of(replace(experiment, scanner=replace(experiment.scanner, dropout=p))).scans
        for p in (0.0, dropout)
    )
    assert holed is not None
    there = np.isfinite(present(whole).range_m)
    lost = int(np.count_nonzero(there & np.isnan(holed.range_m)))
    assert not np.isfinite(holed.range_m[~there]).any()
    low, high = binom.interval(0.9999, np.count_nonzero(there), dropout)
    assert low <= lost <= high
    low, high = binom.interval(0.9999, np.count_nonzero(there), 1.2 * dropout)
    assert lost < low


@pytest.mark.parametrize(
    "wrong", [{"max_range_m": 0.4}, {"dropout": 1.5}, {"sigma_range_m": -0.1}, {"min_range_m": -1}]
)
def test_impossible_scanners(wrong: dict[str, float]) -> None:
    for scanner in (Planar(max_range_m=25.0, sigma_range_m=0.1, sigma_beam_rad=0.01), Rings()):
        with pytest.raises(InputError, match=next(iter(wrong))):
            replace(scanner, **wrong)  # type: ignore[arg-type]
