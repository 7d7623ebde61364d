"""Nieto 2005, sections 3.9 and 4.1.3 to 4.3: dense maps in simulation.

Every experiment is run twice on the same logs: by the settings that runs use, and by the thesis'
(`literal`, `--preset nieto-2005`). The worlds are those of the named logs with landmarks among and
behind the objects: the thesis' regions are triangles of landmarks that enclose objects, and between
landmarks that line the path there is hardly any (research/dense_maps.py --correlation --among 0).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.filter_loop import Beside, run_filter_loop
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.checks.accuracy import rigid_motion
from comparisons.config import MapConfig
from comparisons.documented.row import Preset
from comparisons.errors import InputError
from comparisons.estimates.estimate import landmark_blocks
from comparisons.extensions.dense_maps.accuracy import (
    OCCUPIED,
    SurfaceError,
    distance_to_segments,
    error_of_points,
    near_share,
    surface_error,
)
from comparisons.extensions.dense_maps.config import DenseMapsConfig, Layer
from comparisons.extensions.dense_maps.figure import (
    draw_error_layer,
    draw_occupied,
    draw_regions,
    draw_surfaces,
)
from comparisons.extensions.dense_maps.job import DenseMapping, map_log
from comparisons.extensions.dense_maps.source import BeforeClosing, DenseWatcher, classic_grid
from comparisons.logs.log import Log
from comparisons.logs.simulate.polygons import sides
from comparisons.logs.simulate.scan_drive import ScanExperiment, dense_slam, occupancy, simulate
from comparisons.logs.simulate.scan_worlds import MORE_LANDMARKS, with_landmarks_among
from comparisons.report.marks import SMOOTHER_COLOUR, TRUTH_COLOUR, ellipses
from comparisons.statistics import mean_band, normalise
from ekf_reference.core.trace import Trace
from ekf_reference.dense.dense_map import DenseMap
from ekf_reference.dense.layers.classic_grid import ClassicGrid
from ekf_reference.dense.layers.layer import Samples
from ekf_reference.dense.layers.occupancy import Coarsening, OccupancyGrid
from ekf_reference.dense.sensor_model import log_odds
from ekf_reference.scan_matching.sog import SumOfGaussians
from research.documents.claims import Claims, Why, at_least, at_most, ours, within
from research.documents.drawing import draw_lines, draw_slam, frame, plan
from research.documents.drives import true_surroundings, truth_in_order
from research.documents.interface import Experiment, Figure, Sources
from research.documents.measures import ellipses_of, mean, median, occupied

SURFACES: tuple[Layer, ...] = ("points", "occupancy", "particles", "sog")
"""Layers of where surfaces are."""
ROUNDS = (1, 2, 3, 4, 5, 10)
"""Of Fig. 4.5."""
_COARSE_ROUNDS = 2
_MORE = 20
"""Drives that are added at the most until the loop of one is closed by a shift."""
_CLOSING_M = 0.3
"""Least shift of the landmarks (RMS) by the update that closes a loop."""


@dataclass(frozen=True)
class ClosedMap:
    """A dense map whose loop was closed by one strong update. true: (L, 2) as the filter's."""

    mapping: DenseMapping
    before: BeforeClosing
    true: Array

    @property
    def segment(self) -> Array:
        """(S, 4) true surfaces [m]."""
        return true_surroundings(self.mapping.log)[1]

    def error_before(self, layer: str) -> SurfaceError:
        """Of a layer, before the closing."""
        return surface_error(self.before.layers[layer], self.segment)

    def thirds(self, east: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which of (N,) lie in the left and in the right third of the true path."""
        low, high = np.quantile(truth_in_order(self.mapping.log)[0].pose[:, 0], (1 / 3, 2 / 3))
        return east <= low, east >= high


@dataclass(frozen=True)
class Maps:
    """Of several drives. all_drives: also those whose loop closed gently; the first is drawn.

    literal: the same drives by the thesis' settings.
    """

    log: str
    closed: tuple[ClosedMap, ...]
    all_drives: tuple[DenseMapping, ...]
    literal: Maps | None = None


@dataclass(frozen=True, kw_only=True)
class Round:
    """The map after some rounds. classic: one grid in the world. dense: the occupancy layer.

    classic_m2, dense_m2: areas of their occupied cells [m^2]. landmark, true: (L, 2).
    """

    number: int
    classic: Samples
    dense: Samples
    classic_m2: float
    dense_m2: float
    landmark: Array
    true: Array
    classic_error: SurfaceError
    dense_error: SurfaceError


@dataclass(frozen=True, kw_only=True)
class Rounds:
    """One long drive. segment: (S, 4) true surfaces. literal: by the thesis' settings.

    particles, points: of the dense map in the end.
    """

    log: str
    each: tuple[Round, ...]
    segment: Array
    particles: Samples
    points: Samples
    literal: Rounds | None = None


@dataclass(frozen=True, kw_only=True)
class Coarsened:
    """Occupancy grids with larger cells in almost empty regions, and with one size of cells.

    triangle: (R, 3, 2). cell_m: (R,) of each region, NaN where nothing was seen. cells, cells_even:
    how many. emptiest: largest share of a region's cells that is empty, by the rule's measure.
    literal: by the thesis' settings.
    """

    log: str
    triangle: Array
    cell_m: Array
    coarse: Samples
    cells: int
    cells_even: int
    emptiest: float
    error: SurfaceError
    error_even: SurfaceError
    segment: Array
    literal: Coarsened | None = None


def enclosed(experiment: ScanExperiment) -> ScanExperiment:
    """The same drive in its world with landmarks among and behind the objects."""
    return replace(experiment, world=with_landmarks_among(experiment.world))


MORE = f"{MORE_LANDMARKS} landmarks more among and behind the objects"


def _maps(experiment: ScanExperiment, layers: tuple[Layer, ...], sources: Sources) -> Maps:
    name, experiment = experiment.name, enclosed(experiment)
    logs, ours = list[Log](), list[DenseMapping]()
    while len(ours) < sources.drives or not _closed(ours):
        if len(ours) == sources.drives + _MORE:
            raise InputError(f"{name}: no drive's loop is closed by a shift of {_CLOSING_M} m")
        logs.append(simulate(np.random.default_rng(len(logs)), experiment))
        ours.append(map_log(logs[-1], _config(name, "recommended", layers=layers)))
    literal = [map_log(log, _config(name, "nieto-2005", layers=layers)) for log in logs]
    reported = f"{name} with {MORE}, {len(ours)} drives from seed 0"
    corrected = f"{len(_closed(ours))} of them corrected at once"
    thesis = Maps(reported, _closed(literal), tuple(literal))
    return Maps(f"{reported}, {corrected}", _closed(ours), tuple(ours), thesis)


def _closed(drives: list[DenseMapping]) -> tuple[ClosedMap, ...]:
    return tuple(
        ClosedMap(mapping, before, truth_in_order(mapping.log)[1])
        for mapping in drives
        if (before := mapping.dense.before) is not None and before.shift_m > _CLOSING_M
    )


def _config(name: str, preset: Preset, **fields: Any) -> MapConfig:
    """Settings of a named log by a preset, and of the dense map."""
    return MapConfig.of(preset=preset, log={"source": name}, extensions={"dense_maps": fields})


def raw_maps(sources: Sources) -> Maps:
    """Section 3.9: raw returns."""
    return _maps(dense_slam(), ("points",), sources)


def layered_maps(sources: Sources) -> Maps:
    """Chapter 4: all layers."""
    return _maps(occupancy(), SURFACES, sources)


def rounds(sources: Sources) -> Rounds:
    """Section 4.1.3: ten rounds, one grid beside the dense map."""
    log = simulate(np.random.default_rng(0), enclosed(occupancy(ROUNDS[-1])))
    return replace(_rounds(log, "recommended"), literal=_rounds(log, "nieto-2005"))


def _rounds(log: Log, preset: Preset) -> Rounds:
    segment, true = true_surroundings(log)[1], truth_in_order(log)[1]
    settings = _config(log.name, preset, layers=("occupancy", "particles", "points"))
    config = settings.extensions["dense_maps"]
    if not isinstance(config, DenseMapsConfig):
        raise TypeError(f"{type(config).__name__} is no DenseMapsConfig")
    classic = classic_grid(config)
    watcher = DenseWatcher(log, config)
    watcher.feed(classic)
    ekf = build_ekf(log, settle(settings.ekf, log), Trace())
    loop_s, due, each = occupancy().drive.loop_s, list(ROUNDS), list[Round]()
    for state in run_filter_loop(ekf, log, build_timeline(log), beside=Beside(watching=watcher)):
        if due and state.time_s >= due[0] * loop_s:
            each.append(_round(due.pop(0), watcher, classic, segment, true))
    named = f"occupancy-loop --loops {ROUNDS[-1]} with {MORE}, seed 0"
    run = watcher.run()
    placed, layers = run.dense.regions.placed(run.landmark), run.dense.layers
    particles, points = (layers[name].samples(placed) for name in ("particles", "points"))
    return Rounds(log=named, each=tuple(each), segment=segment, particles=particles, points=points)


def _round(
    number: int, watcher: DenseWatcher, classic: ClassicGrid, segment: Array, true: Array
) -> Round:
    run = watcher.run()
    placed, layer = run.dense.regions.placed(run.landmark), _grid(run.dense)
    dense, usual = layer.samples(placed), classic.samples()
    inside = np.flatnonzero(placed.locate(usual.point).region >= 0)
    there = usual.chosen(inside)
    return Round(
        number=number,
        classic=there,
        dense=dense,
        classic_m2=float(np.sum(there.occupancy > OCCUPIED)) * classic.update.resolution_m**2,
        dense_m2=float(layer.cell_area(placed)[dense.region[dense.occupancy > OCCUPIED]].sum()),
        landmark=run.landmark,
        true=true[: len(run.landmark)],
        classic_error=surface_error(there, segment),
        dense_error=surface_error(dense, segment),
    )


def coarsened(sources: Sources) -> Coarsened:
    """Section 4.1.3, Fig. 4.6: 0.2 m, and 0.5 m where a region is almost empty."""
    log = simulate(np.random.default_rng(0), enclosed(occupancy(_COARSE_ROUNDS)))
    return replace(_coarsened(log, "recommended"), literal=_coarsened(log, "nieto-2005"))


def _coarsened(log: Log, preset: Preset) -> Coarsened:
    segment = true_surroundings(log)[1]
    maps = [
        map_log(log, _config(log.name, preset, layers=("occupancy",), coarsening=rule))
        for rule in (Coarsening(), None)
    ]
    coarse, even = (_grid(m.dense.dense) for m in maps)
    cells, cells_even = (sum(len(g.odds) for g in layer.grids.values()) for layer in (coarse, even))
    triangle = maps[0].placed.triangle
    edge = np.linalg.norm(triangle[:, 1:] - triangle[:, :1], axis=2)
    cell_m = np.full(len(triangle), np.nan)
    for region, grid in coarse.grids.items():
        cell_m[region] = float(np.max(edge[region] / grid.cells))
    samples = [m.layers["occupancy"] for m in maps]
    return Coarsened(
        log=f"occupancy-loop --loops {_COARSE_ROUNDS} with {MORE}, seed 0",
        triangle=triangle,
        cell_m=cell_m,
        coarse=samples[0],
        cells=cells,
        cells_even=cells_even,
        emptiest=max(
            (float(np.mean(g.odds < log_odds(Coarsening().least))) for g in even.grids.values()),
            default=np.nan,
        ),
        error=surface_error(samples[0], segment),
        error_even=surface_error(samples[1], segment),
        segment=segment,
    )


def _grid(dense: DenseMap) -> OccupancyGrid:
    layer = dense.layers["occupancy"]
    if not isinstance(layer, OccupancyGrid):
        raise TypeError(f"{type(layer).__name__} is no OccupancyGrid")
    return layer


RAW = Experiment("section 3.9", raw_maps)
LAYERED = Experiment("chapter 4", layered_maps)
ROUNDED = Experiment("section 4.1.3, ten rounds", rounds)
COARSENED = Experiment("section 4.1.3, two sizes of cells", coarsened)


LITERALLY = "by the thesis' settings: "
"""How the text of a claim begins that is of the thesis' settings (--preset nieto-2005)."""
_FEW = ours(
    "by correlation alone regions come late or never: landmarks near a well known vehicle are well "
    "known against each other but correlate little; and returns do not wait for their region"
)
_FEW_CELLS = ours("few returns find a region, so few cells are compared (N3.17)")
_THINNED = ours(
    "to bound their number, particles that come to lie on a heavier one are dropped, which the "
    "thesis does not do; with all kept (dense_maps.thinned=false) 91 % of 51,902 weigh more than "
    "0.8 and 2.2 % less than 0.5 (research/dense_maps.py --particles)"
)
_TAILS = ours(
    "by eq. 4.4 a fourth of a return's samples begin below 0.5 (N4.7), and those that no later "
    "return comes near stay there; without those below 0.3 (dense_maps.least_weight) it is 94 and "
    "1.5 %"
)
_MERGED = ours(
    "to bound their number, Gaussians that come to lie on each other become one, so that those of "
    "stray returns weigh more in the median; with all kept (dense_maps.thinned=false) it is 1.07"
)
_FAR_M = 0.5
_CELLS = 2.0
"""Layers cover the same surfaces when so many cells apart or fewer."""
_LEAST = 0.5
_THIRD = 3
_COARSE_M = 0.25
THIN_M = 0.5
"""Cells in which Gaussians of Fig. 4.13 are merged."""
_OBJECT, _BESIDE_M, _STEP_M = 0, 1.0, 0.1


D = TypeVar("D", Maps, Rounds, Coarsened)


def _also_literally(
    why: Mapping[int, Why],
) -> Callable[[Callable[[D], Claims]], Callable[[D], Claims]]:
    """Make claims a second time by the thesis' settings. why: by number, where another one."""

    def twice(claims: Callable[[D], Claims]) -> Callable[[D], Claims]:
        @wraps(claims)
        def both(found: D) -> Claims:
            yield from claims(found)
            if found.literal is None:
                return
            for number, claim in enumerate(claims(found.literal)):
                again = replace(claim, text=LITERALLY + claim.text)
                yield again.explained(why[number]) if number in why else again

        return both

    return twice


def _p95_on_true_landmarks(m: DenseMapping, layer: str) -> float:
    """95 % of a layer's distances [m], of one grid's in regions, with landmarks on the true ones.

    What is left is the noise of the returns, and that landmarks are off one by one.
    """
    if layer == "classic":
        c, inside = m.classic, m.placed.locate(m.classic.point).region >= 0
        held = c.chosen(inside)
    else:
        held = m.layers[layer]
    move = rigid_motion(m.dense.landmark, truth_in_order(m.log)[1])
    return error_of_points(move(occupied(held)), true_surroundings(m.log)[1]).p95_m


def _corrected(text: str, maps: Maps, layer: str) -> Claims:
    """What a closing takes away of a layer's distances to the surfaces. text: of the claim."""
    then = np.array([m.error_before(layer).p95_m for m in maps.closed])
    now = np.array([m.mapping.errors[layer].p95_m for m in maps.closed])
    best = [_p95_on_true_landmarks(m.mapping, layer) for m in maps.closed]
    why = ours(
        f"{median(then):.2f} m before and {median(now):.2f} m after; with the landmarks moved "
        f"onto the true ones {median(best):.2f} m are left of it, the noise of the returns, which "
        "no closing corrects"
    )
    yield at_most(text, median(now / then), 0.5, why=why, own=True)


@_also_literally({2: _FEW})
def _claims_3_17(maps: Maps) -> Claims:
    tallies = [m.dense.dense.tally for m in maps.all_drives]
    left, right = [], []
    for m in maps.closed:
        point = occupied(m.before.layers["points"])
        distance = distance_to_segments(point, m.segment)
        west, east = m.thirds(point[:, 0])
        left.append(mean(distance[west]))
        right.append(mean(distance[east]))
    text = (
        "before the closing the dense map errs most at the left (mean distance to the "
        "surfaces, left third over right third)"
    )
    yield at_least(text, mean(left) / mean(right), 1.0)
    text = (
        "closing the loop corrects the whole dense map by a large part (95 % of the distances "
        "to the surfaces, after over before, median of drives)"
    )
    yield from _corrected(text, maps, "points")
    covered = sum(t.fused + t.late for t in tallies) / sum(t.returns for t in tallies)
    text = (
        "regions cover the area (share of the returns that found a region, at once or late, "
        "all drives)"
    )
    yield at_least(text, covered, 0.5, own=True)


@_also_literally({})
def _claims_3_18(maps: Maps) -> Claims:
    ratios = []
    for m in maps.closed:
        point = occupied(m.before.layers["points"])
        mine = m.thirds(m.true[: len(m.before.landmark), 0])[0]
        there = point[m.thirds(point[:, 0])[0]]
        move = rigid_motion(m.before.landmark[mine], m.true[: len(mine)][mine])
        raw, moved = (error_of_points(p, m.segment).median_m for p in (there, move(there)))
        ratios.append(moved / raw)
    text = (
        "at the left, objects and landmarks share one shift and rotation (median distance to "
        "the surfaces once the landmarks are moved onto the true ones, over that before; "
        "median of drives)"
    )
    yield at_most(text, median(ratios), 0.5, own=True)


def _claims_4_2(maps: Maps) -> Claims:
    squared, rms = [], []
    for mapping in maps.all_drives:
        e, true = mapping.ekf.estimate, truth_in_order(mapping.log)[1]
        mean = np.concatenate((e.pose[-1], true.ravel()))
        errors = normalise(
            (e.joint_mean - mean)[3:].reshape(-1, 2), landmark_blocks(e.joint_covariance)
        )
        far = int(np.argmax(np.linalg.norm(true - e.pose[0, :2], axis=1)))
        squared.append(errors.squared[far])
        rms.append(np.sqrt(np.mean(np.sum(np.square(e.landmark - true), axis=1))))
    text = (
        "the landmarks' errors are as large as stated (mean NEES of the farthest landmark over "
        "drives; limits: its 95 % band)"
    )
    yield within(text, np.mean(squared), mean_band(len(squared), 2))
    text = "with the loop closed the landmarks' error is small (median of the drives' RMS)"
    yield at_most(text, np.median(rms), 0.5, "m", own=True)


@_also_literally({0: _FEW_CELLS})
def _claims_4_3(maps: Maps) -> Claims:
    dense = np.array([m.errors["occupancy"].p95_m for m in maps.all_drives])
    classic = np.array([m.errors["classic"].p95_m for m in maps.all_drives])
    own, other = (
        np.array([_p95_on_true_landmarks(m, layer) for m in maps.all_drives])
        for layer in ("occupancy", "classic")
    )
    why = ours(
        f"so it is in {np.sum(dense <= classic)} of {len(dense)} drives; where the filter ends "
        "with a map that is turned as a whole, both are off by that"
    )
    text = (
        "DenseSLAM's grid is more accurate than one grid on every drive (95 % of the distances "
        "to the surfaces, largest ratio)"
    )
    yield at_most(text, np.max(dense / classic), 1.0, why=why)
    why = ours(
        f"{median(own):.2f} and {median(other):.2f} m; the noise of the returns alone is 1 "
        "degree, or 0.44 m at 25 m"
    )
    text = (
        "it fits the landmark map, where one grid is misshapen (the same once the landmarks "
        "are moved onto the true ones, median ratio)"
    )
    yield at_most(text, np.median(own / other), 0.5, why=why, own=True)
    text = "because the closing corrects it (95 %, after over before, median of drives)"
    yield from _corrected(text, maps, "occupancy")
    why = ours(
        f"both carry the error of the landmarks themselves: {median(dense):.2f} and "
        f"{median(classic):.2f} m, and {median(own):.2f} and {median(other):.2f} m once the "
        "landmarks are moved onto the true ones"
    )
    text = "it is much more accurate on the whole (95 % of the distances, median ratio)"
    yield at_most(text, np.median(dense / classic), 0.5, why=why, own=True)


@_also_literally({})
def _claims_4_4(found: Rounds) -> Claims:
    first, last = found.each[0], found.each[-1]
    at_first, in_the_end = (_misshapen(r, found.segment) for r in (first, last))
    why = ours(
        f"{last.classic_m2:.0f} and {last.dense_m2:.0f} m^2, after the first round "
        f"{first.classic_m2:.0f} and {first.dense_m2:.0f}: occupancy is bounded "
        "(dense_maps.confidence), so that later scans free what one grid has drawn wrongly; "
        "without a bound 281 and 275 m^2"
    )
    text = "walls are wider in one grid (area of the occupied cells, over DenseSLAM's)"
    yield at_least(text, last.classic_m2 / last.dense_m2, 1.0, why=why)
    why = ours(
        f"after the first round {at_first:.2f}; after so many with corrected poses one grid "
        "has been drawn over"
    )
    text = (
        f"DenseSLAM's objects keep their shape (share of occupied cells more than {_FAR_M} m "
        "from any surface, landmarks moved onto the true ones, over one grid's)"
    )
    yield at_most(text, in_the_end, 0.5, why=why, own=True)


def _misshapen(r: Round, segment: Array) -> float:
    """Shares of occupied cells far from any surface, landmarks on the true ones: dense over one."""
    move = rigid_motion(r.landmark, r.true)
    one, dense = (
        float(np.mean(distance_to_segments(move(occupied(s)), segment) > _FAR_M))
        for s in (r.classic, r.dense)
    )
    return dense / one if one > 0.0 else np.nan


@_also_literally({})
def _claims_4_5(found: Rounds) -> Claims:
    first, last = found.each[0], found.each[-1]
    third = next(r for r in found.each if r.number == _THIRD)
    why = ours(
        f"the filter's map is off as a whole: 95 % of DenseSLAM's cells are within "
        f"{last.dense_error.p95_m:.2f} m in the last round, of one grid's within "
        f"{last.classic_error.p95_m:.2f}, so the distances hardly tell what was corrected"
    )
    text = (
        f"one grid is not corrected in {last.number} rounds (95 % of the distances to the "
        "surfaces, last round over first)"
    )
    yield at_least(text, last.classic_error.p95_m / first.classic_error.p95_m, 1.0, why=why)
    text = "objects appear a second time in later rounds (occupied cells, third round over first)"
    yield at_least(text, third.classic_error.occupied / first.classic_error.occupied, 1.0)


@_also_literally({})
def _claims_4_6(found: Coarsened) -> Claims:
    coarse = int(np.count_nonzero(found.cell_m > _COARSE_M))
    why = ours(
        f"cells that nobody has seen are not empty; the emptiest region has {found.emptiest:.0%} "
        "of its cells below 0.2, and 99 % are asked for"
    )
    yield at_least("almost empty regions get cells of 0.5 m (number of them)", coarse, 1, why=why)
    text = "fewer cells are kept (over those of one size)"
    yield at_most(text, found.cells / found.cells_even if coarse else np.nan, 1.0, why=why)
    ratio = found.error.p95_m / found.error_even.p95_m if coarse else np.nan
    text = (
        "the map stays as accurate (95 % of the distances to the surfaces, over that with one size)"
    )
    yield at_most(text, ratio, 1.05, why=why, own=True)


@_also_literally({0: _TAILS, 1: _TAILS})
def _claims_4_10(found: Rounds) -> Claims:
    weight = found.particles.occupancy
    particles, points = (surface_error(s, found.segment) for s in (found.particles, found.points))
    text = "87 % of the particles weigh more than 0.8"
    yield at_least(text, (weight > OCCUPIED).mean(), 0.87, why=_THINNED)
    text = "2 % weigh less than 0.5"
    yield at_most(text, (weight < 0.5).mean(), 0.02, why=_THINNED)
    text = (
        "the result is much the same as with raw returns (median distance to the surfaces, "
        "over theirs)"
    )
    yield at_most(text, particles.median_m / points.median_m, 1.1, own=True)


@_also_literally({})
def _claims_4_12(maps: Maps) -> Claims:
    ratio = [m.errors["sog"].median_m / m.errors["points"].median_m for m in maps.all_drives]
    count = [m.errors["sog"].occupied / m.errors["points"].occupied for m in maps.all_drives]
    text = "Gaussians represent the surfaces (median distance, over that of raw returns)"
    yield at_most(text, np.median(ratio), 1.1, why=_MERGED, own=True)
    yield at_most("with fewer of them than of points kept (ratio)", float(np.median(count)), 1.0)


def of_one_object(mapping: DenseMapping) -> SumOfGaussians:
    """The Gaussians of one object of the world."""
    corner = occupancy().world.outline[_OBJECT]
    held, side = ellipses_of(mapping), sides(corner)
    near = distance_to_segments(held.mean, side) < _BESIDE_M
    return SumOfGaussians.of_equal_height(held.mean[near], held.covariance[near])


@_also_literally({})
def _claims_4_13(maps: Maps) -> Claims:
    corner, fewer, alike = occupancy().world.outline[_OBJECT], [], []
    box = zip(corner.min(axis=0) - _BESIDE_M, corner.max(axis=0) + _BESIDE_M, strict=True)
    place = np.stack(np.meshgrid(*(np.arange(a, b, _STEP_M) for a, b in box)), -1).reshape(-1, 2)
    for m in maps.all_drives:
        every = of_one_object(m)
        some, half = every.thinned(THIN_M), every.take(np.arange(0, len(every), 2))
        a, b, c = (g.value(place) for g in (every, some, half))
        fewer.append(len(some) / max(len(every), 1))
        alike.append([a @ x / np.sqrt((a @ a) * (x @ x)) for x in (b, c)])
    text = f"the sum can be subsampled (number in cells of {THIN_M:g} m, over all, median)"
    yield at_most(text, np.median(fewer), 0.5, own=True)
    text = "it is of similar quality (correlation of both surfaces, least of the drives)"
    yield at_least(text, np.min(alike, axis=0)[0], 0.9, own=True)
    text = "so it is where every second Gaussian is left out (the same)"
    yield at_least(text, np.min(alike, axis=0)[1], 0.9, own=True)


@_also_literally({})
def _claims_4_16(maps: Maps) -> Claims:
    reach = _CELLS * maps.all_drives[0].dense.options.resolution_m
    cells = [m.layers["occupancy"] for m in maps.all_drives]
    for name, key in (("particles", "particles"), ("Gaussians", "sog")):
        held = [m.layers[key] for m in maps.all_drives]
        shares = [
            near_share(s.point[s.occupancy > _LEAST], cell.point[cell.occupancy > _LEAST], reach)
            for s, cell in zip(held, cells, strict=True)
        ]
        text = (
            f"{name} and occupied cells are of the same surfaces (share of the former within "
            f"{_CELLS:g} cells of the latter, mean of drives)"
        )
        yield at_least(text, np.mean(shares), 0.9, own=True)


def _map(
    axis: Axes, m: ClosedMap, samples: Samples, triangle: Array, landmark: Array, title: str
) -> None:
    draw_regions(axis, triangle)
    draw_surfaces(axis, m.segment)
    draw_occupied(axis, samples)
    axis.plot(*landmark.T, "o", color=SMOOTHER_COLOUR, markersize=4, markerfacecolor="none")
    axis.plot(*m.true.T, "*", color=TRUTH_COLOUR, markersize=4)
    plan(axis, title)


def _draw_3_17(canvas: Canvas, maps: Maps) -> None:
    m = maps.closed[0]
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    b, now = m.before, m.mapping
    title = f"before the loop closes, {b.time_s:.0f} s"
    _map(left, m, b.layers["points"], b.triangle, b.landmark, title)
    _map(right, m, now.layers["points"], now.placed.triangle, now.dense.landmark, "after")


def _draw_3_18(canvas: Canvas, maps: Maps) -> None:
    """The left top before."""
    m = maps.closed[0]
    axis = canvas.add_subplot()
    b = m.before
    _map(axis, m, b.layers["points"], b.triangle, b.landmark, "left top, before the loop closes")
    west, north = m.true[:, 0].min(), m.true[:, 1].max()
    axis.set(xlim=(west - 10.0, west + 40.0), ylim=(north - 45.0, north + 8.0))


def _draw_4_2(canvas: Canvas, maps: Maps) -> None:
    mapping = maps.closed[0].mapping
    axis, e = canvas.add_subplot(), mapping.ekf.estimate
    poses, true = truth_in_order(mapping.log)
    draw_surfaces(axis, maps.closed[0].segment)
    blocks = landmark_blocks(e.joint_covariance)
    draw_slam(axis, poses.pose[:, :2], e.pose[:, :2], true, e.landmark, blocks)
    plan(axis, "after the loop", legend="best")


def _draw_4_3(canvas: Canvas, maps: Maps) -> None:
    m, (left, right) = maps.closed[0], canvas.subplots(1, 2, sharex=True, sharey=True)
    now = m.mapping
    none = np.empty((0, 3, 2))
    _map(left, m, now.classic, none, now.dense.landmark, "(a) one grid in the world")
    held = now.layers["occupancy"]
    _map(right, m, held, now.placed.triangle, now.dense.landmark, "(b) DenseSLAM")


def _draw_4_4(canvas: Canvas, found: Rounds) -> None:
    last = found.each[-1]
    axes = canvas.subplots(1, 2, sharex=True, sharey=True)
    for axis, held, title in (
        (axes[0], last.classic, "(a) one grid in the world"),
        (axes[1], last.dense, "(b) DenseSLAM"),
    ):
        order = np.argsort(held.occupancy, kind="stable")
        drawn = axis.scatter(
            *held.point[order].T, s=0.6, linewidths=0, c=held.occupancy[order], cmap="viridis",
            vmin=0.0, vmax=1.0, rasterized=True,
        )  # fmt: skip
        plan(axis, f"{title}, after {last.number} rounds")
    canvas.colorbar(drawn, ax=list(axes), label="occupancy", shrink=0.8)


def _draw_4_5(canvas: Canvas, found: Rounds) -> None:
    axes = canvas.subplots(2, 3, sharex=True, sharey=True).ravel()
    for axis, r in zip(axes, found.each, strict=True):
        draw_surfaces(axis, found.segment)
        draw_occupied(axis, r.classic)
        plan(axis, f"round {r.number}: 95 % within {r.classic_error.p95_m:.2f} m")


def _draw_4_6(canvas: Canvas, found: Coarsened) -> None:
    axis = canvas.add_subplot()
    drawn = draw_error_layer(axis, found.triangle, found.cell_m)
    drawn.set_clim(0.2, 0.5)
    draw_occupied(axis, found.coarse)
    draw_surfaces(axis, found.segment)
    canvas.colorbar(drawn, ax=axis, label="cell [m]", shrink=0.8)
    plan(axis, "size of cells")


def _draw_4_10(canvas: Canvas, found: Rounds) -> None:
    left, right = canvas.subplots(1, 2, width_ratios=(1.3, 1.0))
    draw_surfaces(left, found.segment)
    draw_occupied(left, found.particles)
    plan(left, "particles that weigh more than 0.8")
    right.hist(found.particles.occupancy, bins=50, range=(0.0, 1.0), color=SMOOTHER_COLOUR)
    right.set(xlabel="weight", ylabel="particles")
    right.set_title("weights of all", fontsize=10)


def _draw_4_12(canvas: Canvas, maps: Maps) -> None:
    m, axis = maps.closed[0], canvas.add_subplot()
    held = ellipses_of(m.mapping)
    draw_lines(axis, ellipses(held.mean, held.covariance, 1.0, 12), SMOOTHER_COLOUR, width=0.3)
    draw_surfaces(axis, m.segment)
    axis.autoscale_view()
    plan(axis, "Gaussians, 1 sigma")


def _draw_4_13(canvas: Canvas, maps: Maps) -> None:
    m, axes = maps.closed[0], canvas.subplots(1, 2, sharex=True, sharey=True)
    every = of_one_object(m.mapping)
    some = every.thinned(THIN_M)
    for axis, g, text in ((axes[0], every, "all"), (axes[1], some, f"in cells of {THIN_M:g} m")):
        draw_lines(axis, ellipses(g.mean, g.covariance, 1.0, 24), SMOOTHER_COLOUR, width=0.7)
        draw_surfaces(axis, m.segment)
        plan(axis, f"{len(g)} Gaussians, {text}, 1 sigma")
    frame(axes[0], every.mean, 1.0)


def _draw_4_16(canvas: Canvas, maps: Maps) -> None:
    m, axes = maps.closed[0], canvas.subplots(1, 3, sharex=True, sharey=True)
    for axis, name in zip(axes, ("occupancy", "particles", "sog"), strict=True):
        draw_regions(axis, m.mapping.placed.triangle)
        draw_occupied(axis, m.mapping.layers[name])
        plan(axis, name)


FIGURES = (
    Figure(
        name="N3.17", title="Raw returns in local regions, before and after a loop closes",
        says="The dense map errs most at the left, and is corrected together with the landmarks "
        "when the loop closes.",
        experiment=RAW, draw=_draw_3_17, claims=_claims_3_17, size=(12.0, 6.0),
    ),
    Figure(
        name="N3.18", title="Close-up: objects and landmarks err alike",
        says="Before the closing the objects carry the same rotation and shift as the landmarks "
        "around them: their errors are highly correlated.",
        experiment=RAW, draw=_draw_3_18, claims=_claims_3_18, size=(7.0, 7.0),
    ),
    Figure(
        name="N4.2", title="Feature SLAM under large noise",
        says="Although noise was set high, the landmark map is close to the truth once the loop is "
        "closed, and as good as its ellipses say.",
        experiment=LAYERED, draw=_draw_4_2, claims=_claims_4_2, size=(8.0, 7.0),
    ),
    Figure(
        name="N4.3", title="One occupancy grid, and DenseSLAM's",
        says="After the first loop objects are misshapen in one grid in the world's frame, while "
        "DenseSLAM's grids are corrected along with the landmarks.",
        experiment=LAYERED, draw=_draw_4_3, claims=_claims_4_3, size=(12.0, 6.0),
    ),
    Figure(
        name="N4.4", title="All cells of both, after ten rounds",
        says="One grid has wider walls and misshapen objects; DenseSLAM's keep their shape.",
        experiment=ROUNDED, draw=_draw_4_4, claims=_claims_4_4, size=(12.0, 6.0),
    ),
    Figure(
        name="N4.5", title="One occupancy grid, round after round",
        says="One grid is never corrected: later rounds draw the same objects in other places.",
        experiment=ROUNDED, draw=_draw_4_5, claims=_claims_4_5, size=(13.0, 8.5),
    ),
    Figure(
        name="N4.6", title="Larger cells in almost empty regions",
        says="Regions that hold hardly anything can be kept at a lower resolution.",
        experiment=COARSENED, draw=_draw_4_6, claims=_claims_4_6, size=(8.5, 7.0),
    ),
    Figure(
        name="N4.10", title="Particles and their weights",
        says="Most particles are likely occupied: 87 % weigh more than 0.8, 2 % less than 0.5; the "
        "map is much like that of raw returns. The thesis gives no number of rounds but around "
        "50,000 particles; with all kept ours has 22,000 after one round, 52,000 after ten. It "
        "does not say that particles which have become free are dropped: with those below 0.3 "
        "kept, too, 84 % weigh more than 0.8 and 12 % less than 0.5 by its settings.",
        experiment=ROUNDED, draw=_draw_4_10, claims=_claims_4_10, size=(12.0, 5.5),
    ),
    Figure(
        name="N4.12", title="A sum of Gaussians",
        says="Gaussians, fused with the nearest return, represent the objects' surfaces.",
        experiment=LAYERED, draw=_draw_4_12, claims=_claims_4_12, size=(8.0, 7.0),
    ),
    Figure(
        name="N4.13", title="Gaussians of one object",
        says="The sum could be subsampled and still be a representation of similar quality.",
        experiment=LAYERED, draw=_draw_4_13, claims=_claims_4_13, size=(12.0, 5.6),
    ),
    Figure(
        name="N4.16", title="Three layers of one run",
        says="Different layers of the same data are kept at the same time, each in its own way "
        "(there the car park, here the simulation).",
        experiment=LAYERED, draw=_draw_4_16, claims=_claims_4_16, size=(15.0, 5.4),
    ),
)  # fmt: skip
