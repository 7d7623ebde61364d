"""A scan into an occupancy grid: MRPT's C++ against our global grid and our layer in regions.

    python -m research.peers --only grid

MRPT's `mrpt-performance` puts its example scan into a grid of 40 by 40 m with cells of 5 cm, 3,000
times from poses within a metre of the origin: 361 beams over half a circle, cut at 15 m, once as
lines of single cells, once as beams that widen. Ours is a scan made alike, of a corridor: as many
beams, and a little more ground in view (35 m^2 against 32). Our grids fill the ground between
beams, as widened beams do, with the thesis' Gaussian around each return.

`global grid` is the same work, no more. `regions` is the occupancy layer, whose cells lie along
the axes of the regions between landmarks, here 10 m apart; `with all around` is what a dense map
does with a scan: returns into regions, the layer, the errors of what is left out.

MRPT's time is the processor time of its program less that of its start.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.source import build_map
from ekf_reference.dense.dense_map import DenseMap
from ekf_reference.dense.layers.classic_grid import ClassicGrid
from ekf_reference.dense.layers.layer import Hits
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan, ScanSensor
from ekf_reference.dense.view import FilterView
from research.timing import (
    MissingError,
    Side,
    Spent,
    TimedPair,
    here,
    median,
    run,
)

Array = NDArray[np.float64]

PROGRAM = "mrpt-performance"
INSTALL = "MRPT not installed: sudo apt-get install mrpt-apps"
TESTS = {"widened beams": "2D: insert scan with", "beams of one cell": "2D: insert scan w/o"}
NONE = "no test has this name"
SCANS = 3000
"""Of each of MRPT's tests."""
WITHIN = 5
"""Runs of MRPT within a repetition, of which the median counts: its start takes as long."""
BATCH = 250
"""Scans of ours that are kept in memory at a time."""
CELL_M, MOST_M = 0.05, 15.0
SENSOR = ScanSensor(0.02, math.radians(0.1), math.radians(0.5), math.radians(5.0))
"""Of the project's reproductions with a Sick."""
BEARING = np.radians(0.5 * np.arange(361) - 90.0)
AXIS_RAD = math.radians(8.5)
"""Of the corridor, left of ahead."""
WALL = np.array(
    (
        (-1.0, -0.87, 5.6, -0.87), (5.6, -0.87, 5.6, -1.4), (5.6, -1.4, 9.5, -1.4),
        (9.5, -1.4, 9.5, -0.5), (9.5, -0.5, 20.0, -0.5), (20.0, -3.0, 20.0, 3.0),
        (20.0, 1.3, 8.3, 1.3), (8.3, 1.3, 8.3, 1.7), (8.3, 1.7, 4.6, 1.7), (4.6, 1.7, 3.5, 2.0),
        (3.5, 2.0, 0.15, 2.25), (0.15, 2.25, 0.15, 1.1), (0.15, 1.1, -2.0, 1.1),
    )
)  # fmt: skip
"""(S, 4) of the corridor, in its own axes [m]."""

LANDMARK_SIGMA_M = 0.01
"""Of landmarks against each other."""
COMMON_SIGMA_M = 0.3
"""Of the whole map."""


def ranges() -> Array:
    """Return the scan's ranges (361,) [m], to the wall or to where beams are cut."""
    turn = BEARING - AXIS_RAD
    ray = np.column_stack((np.cos(turn), np.sin(turn)))
    start, along = WALL[:, :2], WALL[:, 2:] - WALL[:, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = ray[:, :1] * along[:, 1] - ray[:, 1:] * along[:, 0]
        distance = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / turned
        share = (start[:, 0] * ray[:, 1:] - start[:, 1] * ray[:, :1]) / turned
    met = np.where((distance > 0.0) & (share >= 0.0) & (share <= 1.0), distance, np.inf)
    cut: Array = np.minimum(met.min(axis=1), MOST_M)
    return cut


def scans(rng: np.random.Generator, count: int) -> list[Scan]:
    """Return the scan from poses within a metre of the origin, in any direction."""
    distance, side = ranges(), (1.0, 1.0, math.pi)
    poses = rng.uniform(np.negative(side), side, (count, 3))
    return [Scan.of_ranges(pose, BEARING, distance, SENSOR) for pose in poses]


def grid_of_landmarks(east: int, north: int, step_m: float) -> Array:
    """(east x north, 2) [m] around the origin."""
    i, j = np.meshgrid(np.arange(east), np.arange(north), indexing="ij")
    middle = 0.5 * np.array((east - 1, north - 1))
    places: Array = step_m * (np.stack((i, j), axis=-1).reshape(-1, 2) - middle)
    return places


def view_of(pose: Array, landmark: Array, landmark_index: NDArray[np.intp]) -> FilterView:
    """A filter that knows landmarks well against each other and the vehicle, less in the world."""
    m = len(landmark_index)
    common = np.zeros((3 + 2 * m, 2))
    common[:2], common[3:] = np.eye(2), np.tile(np.eye(2), (m, 1))
    own = np.full(3 + 2 * m, LANDMARK_SIGMA_M**2)
    own[2] = 1e-6
    covariance = COMMON_SIGMA_M**2 * common @ common.T + np.diag(own)
    return FilterView(pose, landmark, landmark_index, covariance)


@dataclass(frozen=True)
class Reported:
    """What a dense map tells its layers of a scan."""

    hits: Hits
    placed: RegionsAtMap
    scan: Scan
    near: NDArray[np.intp]

    @classmethod
    def of(cls, placed: RegionsAtMap, scan: Scan) -> Reported:
        """Of a scan."""
        found = placed.locate(scan.point)
        inside = np.flatnonzero(found.region >= 0)
        hits = Hits(
            region=found.region[inside],
            local=found.local[inside],
            point=scan.point[inside],
            covariance=scan.covariance[inside],
        )
        return cls(hits, placed, scan, np.sort(placed.tree.meeting(scan.box()[None]).item))


Work = Callable[[], None]


def _do(works: Sequence[Work]) -> None:
    for work in works:
        work()


class Ours:
    """Our grids with SCANS scans; they stay between the repetitions, as a long drive's would."""

    def __init__(self, batches: int) -> None:
        """batches: of scans; each side goes through them until it has taken SCANS."""
        self._batches, self._rng = batches, np.random.default_rng(333)
        self._grid = ClassicGrid(CELL_M)
        self._view, self._layer = _mapped()
        self._around = _mapped()[1]
        self._region = self._layer.layers["occupancy"]

    def global_grid(self) -> Spent:
        """The scans' look-ups included."""
        return self._spent(lambda taken: [partial(self._grid.fuse, scan) for scan in taken])

    def regions(self) -> Spent:
        """The layer alone, with returns that are in their regions already."""
        placed = self._layer.place(self._view)

        def fuses(taken: Sequence[Scan]) -> list[Work]:
            known = [Reported.of(placed, scan) for scan in taken]
            return [partial(self._region.fuse, r.hits, placed, r.scan, r.near) for r in known]

        return self._spent(fuses)

    def all_around(self) -> Spent:
        """All that a dense map does with a scan."""
        return self._spent(
            lambda taken: [partial(self._around.insert, self._view, scan) for scan in taken]
        )

    def _spent(self, works: Callable[[Sequence[Scan]], list[Work]]) -> Spent:
        spent = []
        for _ in range(self._batches):
            prepared = works(scans(self._rng, BATCH))
            spent.append(here(partial(_do, prepared))())
        share = SCANS / (BATCH * self._batches)
        return Spent(share * sum(s.cpu_s for s in spent), share * sum(s.wall_s for s in spent))


def _mapped() -> tuple[FilterView, DenseMap]:
    """A map of regions around the origin, with the layer of occupancy alone."""
    landmark = grid_of_landmarks(5, 5, 10.0)
    view = view_of(np.zeros(3), landmark, np.arange(len(landmark)))
    dense = build_map(DenseMapsConfig(layers=("occupancy",), resolution_m=CELL_M, coarsening=None))
    dense.updated(view)
    return view, dense


def _theirs(test: str) -> Side:
    def side() -> Spent:
        with tempfile.TemporaryDirectory() as folder:
            words = ("sh", "-c", 'cd "$1" && exec "$2" -c "$3"', "sh", folder, PROGRAM)
            spent = [(run((*words, test)).spent, run((*words, NONE)).spent) for _ in range(WITHIN)]
        return median([tested for tested, _ in spent]) - median([start for _, start in spent])

    return side


def rows(*, quick: bool) -> list[TimedPair]:
    """Return the pairs; `quick` takes fewer of ours. Raises MissingError."""
    if shutil.which(PROGRAM) is None:
        raise MissingError(INSTALL)
    ours = Ours(1 if quick else SCANS // BATCH)
    kinds: tuple[tuple[str, Side, float | None], ...] = (
        ("global grid", ours.global_grid, 10.0),
        ("regions", ours.regions, 10.0),
        ("with all around", ours.all_around, None),
    )
    return [
        TimedPair(
            name=f"MRPT grid, {name}: {kind}",
            work="361 beams into cells of 5 cm",
            ours=side,
            theirs=_theirs(test),
            goal=goal,
            parts=(SCANS, "scan"),
        )
        for name, test in TESTS.items()
        for kind, side, goal in kinds
    ]
