"""Every experiment of the catalogue in a small version: few drives, or made up."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.simulate.dynamic_worlds import leaving_cars
from comparisons.logs.simulate.waypoints import WaypointRun
from comparisons.logs.simulate.waypoints import simulate as simulate_waypoints
from ekf_reference.dense.layers.layer import LayerSamples
from research.documents import (
    guivant,
    guivant_cost,
    misono,
    nieto_car_park,
    nieto_car_park_scans,
    nieto_dense,
    nieto_fastslam,
    nieto_high_level,
    nieto_motion,
    nieto_regions,
    nieto_scan_maps,
    nieto_scan_slam,
)
from research.documents.drives import Drives
from research.documents.interface import Sources
from tests.helpers import first_seconds

SHARED = Path(__file__).resolve().parents[4] / "shared" / "data"
WALL = np.array([(0.0, 0.0, 20.0, 0.0)])
CORNERS = np.array([(0.0, -5.0), (20.0, -5.0), (10.0, 8.0)])


@cache
def data(name: str) -> Any:
    """What the experiment of this name leaves."""
    return SMALL[name]()


def samples(*height: float) -> LayerSamples:
    """Occupied cells beside the wall, in rows."""
    east = np.arange(0.1, 20.0, 0.2)
    point = np.vstack([np.column_stack((east, np.full(len(east), h))) for h in height])
    return LayerSamples(point, np.full(len(point), 0.95), np.zeros(len(point), dtype=np.intp))


def splits() -> Drives[guivant.SplitLog]:
    """Each finer splitting is a little better."""
    runs = {
        name: guivant.SplitRun(gap=0.5 - 0.1 * k, optimism=0.5 + 0.1 * k)
        for k, name in enumerate(guivant.SPLITS)
    }
    each = tuple(guivant.SplitLog(name, runs) for name in ("a loop", "another"))
    return Drives("made up", each)


def clouds() -> nieto_fastslam.ParticleClouds:
    """Of a simulated drive with positions; what is claimed of Victoria Park is made up."""
    log = simulate_waypoints(np.random.default_rng(2), WaypointRun(most_s=30.0))
    found = nieto_fastslam.clouds(log, (5, 20))
    most = found.runs[-1]
    trees = np.resize(most.landmark, (nieto_fastslam.TREES, 2))
    right = replace(most, median_m=1.5, landmark=trees, distinct=np.full_like(most.distinct, 2))
    return replace(found, runs=(found.runs[0], right))


def covered() -> guivant.Covered:
    """A path into a wood, where GPS ends."""
    path = np.column_stack((np.linspace(0.0, 200.0, 201), np.zeros(201)))
    trees = np.column_stack((np.linspace(120.0, 200.0, 30), np.full(30, 5.0)))
    around = np.array([np.sum(np.abs(trees[:, 0] - x) < 20.0) for x in path[:, 0]])
    return guivant.Covered("made up", path, trees, path[:, 0] < 110.0, around)


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


def scan_maps() -> Drives[nieto_scan_maps.DenseScanMap]:
    """The first seconds of a drive; what closes there is not a loop."""
    log = first_seconds(open_log("scan-slam-maps"), 18.0)
    return nieto_scan_maps.of_logs([log], "the beginning of a drive")


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
    "section 2.10, FastSLAM": clouds,
    "Examples 3.1 and 3.2": lambda: nieto_regions.examples(Sources(drives=2)),
    "Misono's Fig. 5": lambda: misono.drives(Sources(drives=1)),
    "Misono's Fig. 6": lambda: misono.journeys(Sources(drives=1)),
    "Guivant's Figs. 8 and 9": lambda: guivant.aided(Sources()),
    "Guivant's Fig. 7": covered,
    "Guivant's cost": lambda: guivant_cost.measured(Sources(), (250, 300), 300),
    "Guivant's updates in parts": splits,
    "chapter 4": lambda: nieto_dense.layered_maps(Sources(drives=1)),
    "section 5.6": scan_drives,
    "section 6.1.3": high_level_drives,
    "section 6.2.1": scan_maps,
    "the car park, dense maps": car_park,
    "the car park, Scan-SLAM": car_park_scans,
    "section 6.5, cars that leave": parked_cars,
}
