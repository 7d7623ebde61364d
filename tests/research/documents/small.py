"""Every experiment of the catalogue in a small version: few drives, or made up."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.extensions.dense_maps.accuracy import surface_error
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.simulate.dynamic_worlds import leaving_cars
from comparisons.logs.simulate.waypoints import WaypointRun
from comparisons.logs.simulate.waypoints import simulate as simulate_waypoints
from ekf_reference.dense.layers.layer import Samples
from research.documents import (
    guivant,
    misono,
    nieto_car_park,
    nieto_car_park_scans,
    nieto_dense,
    nieto_fastslam,
    nieto_high_level,
    nieto_known_poses,
    nieto_motion,
    nieto_next_path,
    nieto_people,
    nieto_regions,
    nieto_scan_maps,
    nieto_scan_slam,
    nieto_scans,
    nieto_slam,
)
from research.documents.drives import Drives
from research.documents.interface import Sources
from research.documents.nieto_motion import DynamicScore
from tests.helpers import first_seconds

SHARED = Path(__file__).resolve().parents[4] / "shared" / "data"
WALL = np.array([(0.0, 0.0, 20.0, 0.0)])
CORNERS = np.array([(0.0, -5.0), (20.0, -5.0), (10.0, 8.0)])


@cache
def data(name: str) -> Any:
    """What the experiment of this name leaves."""
    return SMALL[name]()


def samples(*height: float) -> Samples:
    """Occupied cells beside the wall, in rows."""
    east = np.arange(0.1, 20.0, 0.2)
    point = np.vstack([np.column_stack((east, np.full(len(east), h))) for h in height])
    return Samples(point, np.full(len(point), 0.95), np.zeros(len(point), dtype=np.intp))


def round_of(number: int, classic: Samples, dense: Samples) -> nieto_dense.Round:
    return nieto_dense.Round(
        number=number,
        classic=classic,
        dense=dense,
        classic_m2=0.04 * len(classic.point),
        dense_m2=0.04 * len(dense.point),
        landmark=CORNERS,
        true=CORNERS,
        classic_error=surface_error(classic, WALL),
        dense_error=surface_error(dense, WALL),
    )


def splits() -> Drives[guivant.SplitLog]:
    """Each finer splitting is a little better."""
    runs = {
        name: guivant.SplitRun(gap=0.5 - 0.1 * k, optimism=0.5 + 0.1 * k)
        for k, name in enumerate(guivant.SPLITS)
    }
    each = tuple(guivant.SplitLog(name, runs) for name in ("a loop", "another"))
    return Drives("made up", each)


def final_map() -> nieto_fastslam.FinalMap:
    """The same of EKF-SLAM."""
    found = nieto_fastslam.final_map(
        simulate_waypoints(np.random.default_rng(2), WaypointRun(most_s=30.0))
    )
    used = np.resize(found.used, 100 * len(found.landmark))
    return replace(found, median_m=1.5, used=used)


def clouds() -> nieto_fastslam.Clouds:
    """Of a simulated drive with positions; what is claimed of Victoria Park is made up."""
    log = simulate_waypoints(np.random.default_rng(2), WaypointRun(most_s=30.0))
    found = nieto_fastslam.clouds(log, (5, 20))
    most = found.runs[-1]
    trees = np.resize(most.landmark, (nieto_fastslam.TREES, 2))
    right = replace(most, median_m=1.5, landmark=trees, distinct=np.full_like(most.distinct, 2))
    return replace(found, runs=(found.runs[0], right))


def rounds() -> nieto_dense.Rounds:
    """A wall that one grid draws again beside the first, and a dense map does not."""
    good = samples(0.0, 0.2)
    each = [round_of(n, samples(0.0, *(0.7,) * (n > 1), 0.9), good) for n in nieto_dense.ROUNDS]
    return nieto_dense.Rounds(
        log="made up", each=tuple(each), segment=WALL, particles=good, points=good
    )


def coarsened() -> nieto_dense.Coarsened:
    held = samples(0.0)
    triangle, error = CORNERS[None], surface_error(held, WALL)
    return nieto_dense.Coarsened(
        log="made up",
        triangle=np.repeat(triangle, 2, axis=0),
        cell_m=np.array((0.5, 0.2)),
        coarse=held,
        cells=80,
        cells_even=100,
        emptiest=0.995,
        error=error,
        error_even=error,
        segment=WALL,
    )


def covered() -> guivant.Covered:
    """A path into a wood, where GPS ends."""
    path = np.column_stack((np.linspace(0.0, 200.0, 201), np.zeros(201)))
    trees = np.column_stack((np.linspace(120.0, 200.0, 30), np.full(30, 5.0)))
    around = np.array([np.sum(np.abs(trees[:, 0] - x) < 20.0) for x in path[:, 0]])
    return guivant.Covered("made up", path, trees, path[:, 0] < 110.0, around)


def motions(true: Array) -> nieto_motion.Motions:
    """Places that are found where they are, but for a little."""
    held, found = samples(0.0), np.where(np.isfinite(true), true, 0.0) + 0.1
    score = DynamicScore(0.95, 0.93, found)
    one = nieto_motion.Motion(
        score=score,
        dynamic=found,
        occupied=held,
        landmark=CORNERS,
        segment=WALL,
        triangle=CORNERS[None],
    )
    return nieto_motion.Motions("made up", (one,), true)


def parked_cars() -> Drives[nieto_motion.ParkedCars]:
    """All three cars are found, and two landmarks stand on them; another is as good as before."""
    first, second, third = leaving_cars()
    between = np.linspace(first.mean(axis=0), second.mean(axis=0), 12)
    found = np.vstack((between, third.mean(axis=0)))
    one = nieto_motion.ParkedCars(
        first=found,
        last=CORNERS,
        freed=found,
        dynamic=found,
        template=(between[:3], third, CORNERS),
        rectangle=np.array([WALL.reshape(2, 2)[[0, 1, 1, 0]] + k for k in range(3)]),
        in_state=np.array([True, False, True]),
        removed=np.array([True, True, False]),
        landmark=CORNERS,
        points_removed=0,
        segment=WALL,
    )
    return Drives("made up", (one,))


def scan_drives() -> nieto_scan_slam.ScanDrives:
    """Landmarks on a wall at the left top, which a closing puts back where they are."""
    wall = np.array([(-60.0, 100.0, -40.0, 100.0)])
    points = np.column_stack((np.arange(-2.0, 2.1, 0.25), np.zeros(17)))
    true = np.column_stack((np.linspace(-58.0, -42.0, 5), np.full(5, 100.0), np.zeros(5)))
    covariance = np.repeat(np.eye(2)[None], 5, axis=0)
    before, after = (
        nieto_scan_slam.ScanMap(
            np.arange(5), true + (aside, aside, 0.0), aside**2 * covariance, true, (points,) * 5
        )
        for aside in (2.0, 0.1)
    )
    path = true[:, :2] + (0.0, -8.0)
    one = nieto_scan_slam.ScanDrive(
        seed=0,
        templates="made up",
        path=path,
        true_path=path,
        closing_s=5.0,
        before=before,
        path_before=path[:3],
        after=after,
        ate_m=0.5,
        wheels_m=5.0,
        end_m=0.1,
        again=3,
        segment=wall,
    )
    return nieto_scan_slam.ScanDrives("made up", (one,), (one,))


def high_level_drives() -> Drives[nieto_high_level.HighLevelDrive]:
    log = open_log("occupancy-loop", choices=SimulationChoices(1, 2))
    drive = nieto_high_level.of_log(first_seconds(log, 100.0))
    return Drives("the beginning of a drive", (drive,))


def scan_maps() -> nieto_scan_maps.ScanMaps:
    """The first seconds of a drive; what closes there is not a loop."""
    log = first_seconds(open_log("scan-slam-maps"), 18.0)
    return nieto_scan_maps.of_logs([log], "the beginning of a drive")


def next_path() -> nieto_next_path.NextPath:
    """Two ways past the wall, which both estimators judge alike."""
    left = tuple(nieto_next_path.Left(-60.0 - gain, 9.0 - gain) for gain in (1.0, 2.0))
    found = nieto_next_path.Prediction(nieto_next_path.Left(-60.0, 9.0), left)
    around = np.array([(5.0, 3.0), (-2.0, 3.0), (-2.0, -3.0), (5.0, -3.0)])
    return nieto_next_path.NextPath(
        log="made up",
        way=(around, around[:2]),
        by_filter=found,
        by_smoother=found,
        driven=around[:1] + np.array([(2.0, 0.0), (0.0, 0.0)]),
        landmark=CORNERS,
        held=samples(0.0),
        segment=WALL,
    )


def car_park() -> nieto_car_park.CarPark:
    if not SHARED.is_dir():
        pytest.skip("the real logs (../shared/data) are not on this machine")
    return nieto_car_park.car_park(Sources(SHARED).log(nieto_car_park.FOLDER))


def car_park_scans() -> nieto_car_park_scans.CarParkScans:
    """The first seconds of the drive."""
    if not SHARED.is_dir():
        pytest.skip("the real logs (../shared/data) are not on this machine")
    log = Sources(SHARED).log(nieto_car_park.FOLDER)
    return nieto_car_park_scans.car_park_scans(first_seconds(log, 25.0))


SMALL: dict[str, Callable[[], Any]] = {
    "section 2.9": lambda: nieto_slam.loops(Sources(drives=2)),
    "section 2.8.2, Victoria Park": final_map,
    "sections 2.8.1, 4.2 and 4.3.1, known poses": lambda: nieto_known_poses.known_poses(Sources()),
    "section 2.10, FastSLAM": clouds,
    "section 2.9 with positions": lambda: nieto_slam.fixed(Sources()),
    "Examples 3.1 and 3.2": lambda: nieto_regions.examples(Sources(drives=2)),
    "Misono's Fig. 5": lambda: misono.drives(Sources(drives=1)),
    "Misono's Fig. 6": lambda: misono.journeys(Sources(drives=1)),
    "Guivant's Figs. 8 and 9": lambda: guivant.aided(Sources()),
    "Guivant's Fig. 7": covered,
    "Guivant's updates in parts": splits,
    "section 3.9": lambda: nieto_dense.raw_maps(Sources(drives=1)),
    "chapter 4": lambda: nieto_dense.layered_maps(Sources(drives=1)),
    "section 4.1.3, ten rounds": rounds,
    "section 4.1.3, two sizes of cells": coarsened,
    "section 5.3.1, two scans": lambda: nieto_scans.scans(Sources(drives=1)),
    "section 5.6": scan_drives,
    "section 6.1.3, two pairs of corners": lambda: nieto_high_level.corner_pairs(Sources(drives=1)),
    "section 6.1.3": high_level_drives,
    "section 6.2.1": scan_maps,
    "the car park, dense maps": car_park,
    "the car park, Scan-SLAM": car_park_scans,
    "section 6.3.3, fast motion": lambda: motions(np.array([(np.nan, 5.0), (np.nan, -5.0)])),
    "section 6.5, cars that leave": parked_cars,
    "section 3.7.1": lambda: nieto_people.people_drives(Sources()),
    "section 7.2.4": next_path,
    "section 6.3.3, slow motion": lambda: motions(np.array([(0.0, 0.0), (9.0, 0.0), (4.0, 8.0)])),
}
