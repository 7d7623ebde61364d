"""Dense maps: time per scan, cost against the size of the map, errors on drives that close loops.

    python benchmarks/dense_maps.py [--only layers size drives rules] [--scans 200]
                                    [--sizes 10 30 100 300 1000] [--seeds 5] [--loops 3]

layers: scans of 361 returns in a room, 40 regions in view, the map saturated by several passes.
size: one patch of regions around the vehicle, all others out of reach; the same scans for all
sizes. Times are of the processor, not of the wall: what else runs here is left out. drives:
`occupancy-loop` (Nieto 2005, section 4.1.3), all seeds together. rules: the documents' settings
beside those that runs use, and each of them alone, on the drives of docs/results.md.
"""

from __future__ import annotations

import argparse
import math
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from comparisons.checks.accuracy import match_by_distance, rigid_motion
from comparisons.config import MapConfig
from comparisons.experiments.reproduction.nieto_dense import SURFACES
from comparisons.extensions.dense_maps.accuracy import OCCUPIED, distance_to_segments
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.source import build_map
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.simulate.ray_casting import Solids, cast
from comparisons.pipeline.dense_map import DenseMapping, map_log
from ekf_reference.dense.dense_map import DenseMap
from ekf_reference.dense.layers.layer import Hits, Layer, Samples
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan, Sensor
from ekf_reference.dense.view import FilterView

Array = NDArray[np.float64]

CONFIG = DenseMapsConfig(layers=SURFACES)
FIRST_LOOPS = {"scan-loop": 6, "occupancy-loop": 8}
"""Drives of one loop, from seed 0."""
ALONE: Mapping[str, Mapping[str, Any]] = {
    "known_apart_m=0": {"known_apart_m": 0.0},
    "longest_edge_m=inf": {"longest_edge_m": math.inf},
    "flip_test=ellipses": {"flip_test": "ellipses"},
    "delayed=false": {"delayed": False},
    "virtual_landmarks=false": {"virtual_landmarks": False},
    "p_occupied=0.9, p_free=0.3": {"p_occupied": 0.9, "p_free": 0.3},
}
"""Settings of the documents, each alone."""
SENSOR = Sensor(0.05, math.radians(0.25), math.radians(1.0))
BEARING = np.linspace(-math.pi, math.pi, 361, endpoint=False)
MRPT = "MRPT's C++, one scan into a grid, no regions, on another machine: 0.041 (widened 0.113)"
LANDMARK_SIGMA_M = 0.01
"""Of landmarks against each other."""
COMMON_SIGMA_M = 0.3
"""Of the whole map."""
APART_M = 110.0
"""Between two patches: farther than any landmark or return is looked for."""
FAR = 0.5
"""Metres off the surface from which on a wall is drawn a second time."""
CELLS = 2.0


def rectangle(west: float, south: float, east: float, north: float) -> Array:
    """Its sides (4, 4)."""
    corner = np.array(((west, south), (east, south), (east, north), (west, north)))
    return np.hstack((corner, np.roll(corner, -1, axis=0)))


def seen(rng: np.random.Generator, wall: Array, pose: Array) -> Scan:
    """A scan of walls (S, 4) that end all beams."""
    solids = Solids(wall, np.zeros(len(wall), dtype=np.intp), np.ones(1), np.empty((0, 3)))
    distance = cast(BEARING, pose, solids)
    noise = SENSOR.sigma_range_m * rng.standard_normal(len(distance))
    return Scan.of_ranges(pose, BEARING, distance + noise, SENSOR)


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


def circling(count: int, radius_m: float) -> Iterator[Array]:
    """Poses (3,) along a circle around the origin, 16 to a turn."""
    for angle in np.arange(count) * (math.pi / 8.0):
        yield np.array((radius_m * math.cos(angle), radius_m * math.sin(angle), angle))


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

    def fuse(self, layer: Layer) -> float:
        """Milliseconds that a layer takes for it, the scan's own look-ups included."""
        scan = replace(self.scan)  # without what others have looked up
        start = time.thread_time()
        layer.fuse(self.hits, self.placed, scan, self.near)
        return 1e3 * (time.thread_time() - start)

    def fuse_all(self, layers: Sequence[Layer]) -> float:
        """Milliseconds of all layers, which share the scan."""
        scan = replace(self.scan)
        start = time.thread_time()
        for layer in layers:
            layer.fuse(self.hits, self.placed, scan, self.near)
        return 1e3 * (time.thread_time() - start)


def speed_of_layers(scans: int) -> None:
    """Layers alone, together, and with everything around them."""
    rng = np.random.default_rng(0)
    wall = rectangle(-19.0, -15.0, 19.0, 15.0)
    landmark = grid_of_landmarks(6, 5, 8.0)
    view = view_of(np.zeros(3), landmark, np.arange(len(landmark)))
    taken = [seen(rng, wall, pose) for pose in circling(2 * scans, 2.0)]
    dense = build_map(CONFIG)
    dense.updated(view)
    placed = dense.place(view)
    reported = [Reported.of(placed, scan) for scan in taken]
    rows: dict[str, list[float]] = {}
    for name in SURFACES:
        layer = build_map(CONFIG).layers[name]
        rows[name] = [one.fuse(layer) for one in reported]
    layers = list(build_map(CONFIG).layers.values())
    rows["all four"] = [one.fuse_all(layers) for one in reported]
    rows["all four, with DenseMap.insert"] = [timed(dense, view, scan)[1] for scan in taken]
    in_view = np.median([len(one.near) for one in reported])
    print(
        f"{len(BEARING)} returns, {in_view:.0f} regions in view; ms per scan, {scans} scans after"
    )
    print(f"as many passed. {MRPT}")
    print(f"{'':32} median    95 %")
    for title, spent in rows.items():
        last = spent[scans:]
        print(f"{title:32} {np.median(last):6.2f}  {np.percentile(last, 95.0):6.2f}")


def timed(dense: DenseMap, view: FilterView, scan: Scan) -> tuple[float, float]:
    """Milliseconds of `updated` and of `insert`."""
    dense.predicted(view)
    start = time.thread_time()
    dense.updated(view)
    middle = time.thread_time()
    dense.insert(view, scan)
    return 1e3 * (middle - start), 1e3 * (time.thread_time() - middle)


@dataclass
class Patches:
    """A map of patches alike, each out of reach of all others; the vehicle is in the first.

    Every patch is a hall with regions all over; the first one's door is open, and what is seen
    through it lies in no region of three landmarks.
    """

    dense: DenseMap
    landmark: Array
    patch: NDArray[np.intp]
    hall = rectangle(-24.5, -4.5, 24.5, 4.5)
    open_hall = np.vstack(
        (
            hall[[0, 1, 3]],
            ((24.5, 4.5, 5.0, 4.5), (-5.0, 4.5, -24.5, 4.5), (5.0, 4.5, 5.0, 9.0)),
            ((5.0, 9.0, -5.0, 9.0), (-5.0, 9.0, -5.0, 4.5)),
        )
    )

    @classmethod
    def built(cls, count: int) -> Patches:
        """All are visited, in rows, as a vehicle finds them."""
        rng = np.random.default_rng(0)
        one, side = grid_of_landmarks(6, 2, 10.0), math.ceil(math.sqrt(count))
        made = cls(build_map(CONFIG), np.empty((0, 2)), np.arange(len(one)))
        for number in range(count):
            corner = APART_M * np.array((number % side, number // side), dtype=float)
            made.landmark = np.vstack((made.landmark, corner + one))
            landmark_index = len(one) * number + made.patch
            for pose in (np.zeros(3), np.array((12.0, 0.0, 1.0)), np.array((-12.0, 0.0, 2.0))):
                there = pose + (*corner, 0.0)
                view = view_of(there, made.landmark, landmark_index)
                timed(made.dense, view, replace(seen(rng, cls.hall, pose), pose=there))
        return made

    def take(self, rng: np.random.Generator, number: int) -> tuple[float, float]:
        """One scan on the way to and fro in the first hall; milliseconds as of `timed`."""
        pose = np.array((15.0 * math.sin(0.1 * number), 0.0, 0.1 * number))
        moved = self.landmark + 0.002 * math.sin(0.3 * number)
        return timed(self.dense, view_of(pose, moved, self.patch), seen(rng, self.open_hall, pose))


def cost_against_size(sizes: Sequence[int], scans: int) -> None:
    """The same scans for maps of all sizes, in turn."""
    maps = [Patches.built(max(1, round(size / 10))) for size in sizes]
    spent = np.empty((len(maps), 2 * scans, 2))
    block = 10
    for first in range(0, 2 * scans, block):
        for row, patches in enumerate(maps):
            for number in range(first, min(first + block, 2 * scans)):
                spent[row, number] = patches.take(np.random.default_rng(number), number)
    print("ms per scan; the mean has in it that regions are sought every few scans only")
    print("                     updated       insert        both          to the first")
    print("regions  landmarks   median  mean  median  mean  median  mean  median  mean")
    both = spent[:, scans:].sum(axis=2)
    columns = np.concatenate((spent[:, scans:], both[:, :, None]), axis=2)
    found = np.stack((np.median(columns, axis=1), columns.mean(axis=1)), axis=2)
    for patches, row in zip(maps, found, strict=True):
        figures = np.concatenate((row.ravel(), row[2] / found[0, 2])).reshape(-1, 2)
        print(
            f"{len(patches.dense.regions.base):7d}  {len(patches.landmark):9d}   "
            + "  ".join(f"{median:6.2f}  {mean:4.2f}" for median, mean in figures)
        )


def errors_of_drives(seeds: int, loops: int) -> None:
    """What the layers hold after whole drives, against what is there."""
    mapped = []
    for seed in range(seeds):
        log = open_log("occupancy-loop", None, 1, SimulationChoices(seed, loops, 1.0))
        mapped.append(map_log(log, MapConfig(extensions={"dense_maps": CONFIG})))
    print(f"occupancy-loop, {seeds} drives of {loops} loops")
    print("distance to the surfaces [m]     as it is               after the landmarks' motion")
    columns = f"median   95 %  >{FAR} m"
    print(f"of what is above {OCCUPIED}      number  {columns}   {columns}")
    for name in (*SURFACES, "classic"):
        pairs = [distances(one, name) for one in mapped]
        raw, still = (np.concatenate(part) for part in zip(*pairs, strict=True))
        print(f"{name:20} {len(raw):10d}  {spread(raw)}   {spread(still)}")
    weight = np.concatenate([one.layers["particles"].occupancy for one in mapped])
    shares = (weight > 0.8).mean(), (weight < 0.5).mean()
    print(
        f"particles above 0.8, 0.5 to 0.8, below 0.5: {shares[0]:.1%}, "
        f"{1.0 - sum(shares):.1%}, {shares[1]:.1%} (thesis: 87, 11, 2 %)"
    )
    for least in (OCCUPIED, 0.5):
        near = [nearest_shares(one, least) for one in mapped]
        share = [np.concatenate(part).mean() for part in zip(*near, strict=True)]
        print(
            f"within {CELLS:g} cells: {share[0]:.1%} of the Gaussians of a cell above {least:g}, "
            f"{share[1]:.1%} of these cells of a Gaussian (asked: 95 %)"
        )
    tallies = [one.dense.dense.tally for one in mapped]
    total = sum(t.returns for t in tallies)
    at_once, late = sum(t.fused for t in tallies) / total, sum(t.late for t in tallies) / total
    print(
        f"returns: {at_once:.1%} found a region at once, {late:.1%} late, "
        f"{1.0 - at_once - late:.1%} never"
    )


def errors_by_rule(seeds: int | None, rules: Sequence[str] | None = None) -> None:
    """What each of the documents' settings does to the occupancy layer, after the first loop."""
    print("means over drives of one loop; distances of occupied cells to the surfaces [m], median")
    print("/ 95 %; aligned: after the landmarks' motion onto the true ones; regions: when made")
    for name, table in FIRST_LOOPS.items():
        drives = seeds or table
        print(f"{name}, {drives} drives")
        print(f"{'':30} {RULE_COLUMNS}")
        logs = [open_log(name, None, 1, SimulationChoices(seed)) for seed in range(drives)]
        for title, preset, fields in (
            ("recommended", "recommended", {}),
            ("as-published", "as-published", {}),
            ("as-published, correlation 0.5", "as-published", {"least_correlation": 0.5}),
            *((title, "recommended", fields) for title, fields in ALONE.items()),
        ):
            if rules and title not in rules:
                continue
            config = MapConfig.of(
                preset=preset,
                log={"source": name},
                extensions={"dense_maps": {"layers": ("occupancy",), **fields}},
            )
            print(f"{title:30} {rule_row([map_log(log, config) for log in logs])}", flush=True)


RULE_COLUMNS = (
    "dense map    aligned      one grid     aligned      regions  correlated  at once  late  never"
)


def rule_row(mapped: Sequence[DenseMapping]) -> str:
    """Figures of drives, in the order of RULE_COLUMNS."""
    reported = []
    for layer in ("occupancy", "classic"):
        for which in range(2):
            each = [inside_regions(one, layer)[which] for one in mapped]
            quantiles = [np.percentile(d, (50.0, 95.0)) for d in each if len(d)]
            median, most = np.mean(quantiles, axis=0) if quantiles else (math.nan, math.nan)
            reported.append(f"{median:5.3f} / {most:4.2f}")
    regions = [one.dense.dense.regions for one in mapped]
    tallies = [one.dense.dense.tally for one in mapped]
    total = sum(t.returns for t in tallies)
    at_once, late = sum(t.fused for t in tallies) / total, sum(t.late for t in tallies) / total
    correlated = sum(int(r.by_correlation.sum()) for r in regions)
    return (
        f"{' '.join(reported)} {sum(len(r.base) for r in regions):8d} {correlated:11d} "
        f"{at_once:8.1%} {late:5.1%} {1.0 - at_once - late:6.1%}"
    )


def inside_regions(one: DenseMapping, layer: str) -> tuple[Array, Array]:
    """As `distances`, of what lies in a region of the dense map; (N,) and (N,)."""
    if layer != "classic":
        return distances(one, layer)
    held = one.classic
    kept = np.flatnonzero(one.placed.locate(held.point).region >= 0)
    there = Samples(held.point[kept], held.occupancy[kept], held.region[kept])
    return distances(replace(one, classic=there), layer)


def distances(one: DenseMapping, name: str) -> tuple[Array, Array]:
    """(N,) of occupied samples to the surfaces: as they are, and landmarks on the true ones."""
    samples = one.classic if name == "classic" else one.layers[name]
    point = samples.point[samples.occupancy > OCCUPIED]
    truth = one.log.truth
    assert truth.surfaces is not None
    assert truth.landmarks is not None
    segment, true = truth.surfaces.segment, truth.landmarks.position_m
    move = motion_onto(one.dense.landmark, true)
    return distance_to_segments(point, segment), distance_to_segments(move(point), segment)


def motion_onto(landmark: Array, true: Array) -> Callable[[Array], Array]:
    """The rigid motion that takes landmarks (L, 2) onto the true ones they belong to."""
    ours, theirs = match_by_distance(landmark, true)
    return rigid_motion(landmark[ours], true[theirs])


def spread(distance: Array) -> str:
    """Median, 95 % and share that is far."""
    if not len(distance):
        return "   nan    nan     nan"
    median, most = np.percentile(distance, (50.0, 95.0))
    return f"{median:6.3f}  {most:5.2f}  {(distance > FAR).mean():6.1%}"


def nearest_shares(one: DenseMapping, least: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which Gaussians have a cell near that is occupied at least so much, and the converse."""
    cells = one.layers["occupancy"]
    cell, gaussian = cells.point[cells.occupancy > least], one.layers["sog"].point
    reach = CELLS * one.dense.options.resolution_m
    return (
        cKDTree(cell).query(gaussian)[0] <= reach,
        cKDTree(gaussian).query(cell)[0] <= reach,
    )


def main() -> None:
    """Measure and print."""
    parts = ("layers", "size", "drives", "rules")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--only", nargs="+", choices=parts, default=parts)
    parser.add_argument("--scans", type=int, default=200, help="timed, after as many untimed ones")
    parser.add_argument("--sizes", type=int, nargs="+", default=[10, 30, 100, 300, 1000])
    parser.add_argument("--seeds", type=int, help="5; of rules, those of docs/results.md")
    parser.add_argument("--loops", type=int, default=3)
    parser.add_argument("--rules", nargs="+", help="rows of rules; all if left out")
    choices = parser.parse_args()
    if "layers" in choices.only:
        speed_of_layers(choices.scans)
    if "size" in choices.only:
        cost_against_size(choices.sizes, choices.scans)
    if "drives" in choices.only:
        errors_of_drives(choices.seeds or 5, choices.loops)
    if "rules" in choices.only:
        errors_by_rule(choices.seeds, choices.rules)


if __name__ == "__main__":
    main()
