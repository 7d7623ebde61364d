"""Nieto 2005, section 6.1.3: high level landmarks, Figs. 6.4 to 6.6."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.checks.accuracy import rigid_motion
from comparisons.config import EkfConfig, MapConfig
from comparisons.extensions.dense_maps.accuracy import distance_to_segments, near_share
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.figure import DENSE_COLOUR, draw_surfaces
from comparisons.extensions.dense_maps.job import map_log
from comparisons.extensions.high_level.figure import HIGH_LEVEL_COLOUR, draw_high_level
from comparisons.extensions.high_level.source import (
    SEARCHED,
    HighLevelOptions,
    HighLevelRun,
    HighLevelSource,
)
from comparisons.extensions.scan_landmarks.figure import place_covariances
from comparisons.logs.log import Log
from comparisons.logs.simulate.scan_drive import ScanExperiment, occupancy, simulate
from comparisons.logs.simulate.scan_worlds import with_landmarks
from comparisons.report.figures.style import draw_trajectory
from comparisons.report.marks import EKF_COLOUR, TRUTH_COLOUR, ellipses
from ekf_reference.core.geometry import to_world
from ekf_reference.dense.layers.layer import Samples
from ekf_reference.scan_landmarks.high_level import Around, Search, SearchOptions, search
from ekf_reference.scan_landmarks.high_level import within as inside_of
from ekf_reference.scan_landmarks.high_level_lifecycle import SHARE
from ekf_reference.scan_matching.sog import SumOfGaussians
from research.documents.claims import Claims, at_least, at_most, elsewhere, ours
from research.documents.drawing import (
    TRUE_PATH_COLOUR,
    closed,
    draw_lines,
    frame,
    plan,
)
from research.documents.drives import Drives, true_surroundings, truth_in_order
from research.documents.interface import Experiment, Figure, Sources
from research.documents.measures import searched_at_end
from research.documents.nieto_dense import MORE, enclosed

EVERY_S, LOOPS = 60.0, 2
FIRST, LATER = 1, 4
"""Landmarks accepted by the first search, and after the loop, in Fig. 6.5."""
CANDIDATES = 3
LEAST = SearchOptions().least
_PATH = ((0, 0), (14, -3), (28, 2), (33, 14), (26, 26), (11, 29), (-3, 24), (-8, 11))
_OBJECTS = (("box", 13.0, 12.0, 10.0, 7.0, 20.0), ("box", 41.0, 14.0, 0.8, 3.0, 0.0))
_SEARCHED = DenseMapsConfig(layers=SEARCHED)
_BEHIND = np.array(((48.0, 8.0), (48.0, 20.0)))
"""Landmarks beyond the small object, so that it is within a region."""
_PART = 0.45
"""Of the loop that is driven: two sides of the building have been seen."""


@dataclass(frozen=True, kw_only=True)
class Searched:
    """A search and what it read. time_s: of it. pose: (3,) the vehicle's. landmark: (L, 2).

    point: (N, 2) Gaussians of the map then. cells: its occupancy layer.
    """

    time_s: float
    pose: Array
    landmark: Array
    point: Array
    cells: Samples
    search: Search

    @classmethod
    def of(cls, time_s: float, around: Around, found: Search) -> Searched:
        """A copy, as the map goes on."""
        point = around.gaussians.ellipses(
            around.placed, np.arange(len(around.placed.triangle))
        ).mean
        return cls(
            time_s=time_s,
            pose=around.pose.copy(),
            landmark=around.landmark.copy(),
            point=point,
            cells=around.occupancy.samples(around.placed),
            search=found,
        )

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """(n,) of the candidates."""
        enough: NDArray[np.bool_] = self.search.gaussians >= LEAST
        return enough

    @property
    def template(self) -> SumOfGaussians:
        """Of the landmark that was accepted first, in the world."""
        one = self.search.found[0]
        return one.template.shape.transformed(one.place)

    @property
    def cells_of_it(self) -> Samples:
        """Cells within its rectangle, as the template without those at point landmarks."""
        c, area = self.cells, self.search.candidate[self.accepted][0]
        clear = cKDTree(self.landmark).query(c.point)[0] >= SearchOptions().clear_m
        kept = inside_of(area, c.point) & clear
        return c.chosen(kept)


@dataclass(frozen=True)
class Pairs(Drives[Searched]):
    """One search per drive by a building and something small.

    true: (L, 2) landmarks of every drive in its filter's order. segment: (S, 4) true surfaces.
    """

    true: tuple[Array, ...]
    segment: Array


@dataclass(frozen=True, kw_only=True)
class HighLevelDrive:
    """A drive with high level landmarks.

    searches: all. run: what became of them; templates: (K,) points (N, 2) in their axes. sigma:
    (Q, 2, 2) [m^2] places of those in the state, by landmark index. path, true_path: (K, 2), (T,
    2).
    landmark, true: (L, 2) point landmarks. error_m, without_m: root mean square of the vehicle's
    position after the first loop, with them and without.
    """

    searches: tuple[Searched, ...]
    run: HighLevelRun
    templates: tuple[Array, ...]
    sigma: Array
    path: Array
    true_path: Array
    landmark: Array
    true: Array
    segment: Array
    error_m: float
    without_m: float

    @property
    def placed(self) -> tuple[Array, ...]:
        """Points (N, 2) [m] of the templates of those that are in the state, by landmark index."""
        order = [
            int(np.flatnonzero(self.run.landmark_index == s)[0]) for s in range(len(self.sigma))
        ]
        return tuple(to_world(self.run.place[k], self.templates[k]) for k in order)


@cache
def _by_a_building() -> ScanExperiment:
    """Part of a loop past a building and something small, with the sensors of Table 4.1."""
    world, usual = with_landmarks(_PATH, _OBJECTS), occupancy()
    pole = np.column_stack((_BEHIND, np.full(len(_BEHIND), world.pole[0, 2])))
    world = replace(
        world,
        landmark=np.vstack((world.landmark, _BEHIND)),
        pole=np.vstack((world.pole, pole)),
        pole_height_m=np.resize(world.pole_height_m, len(world.pole) + len(pole)),
    )
    part_s = _PART * world.loop_m / usual.drive.speed_mps
    drive = replace(usual.drive, loop_s=part_s, extra_s=0.0)
    return replace(usual, name="two pairs of corners", world=world, drive=drive)


def corner_pairs(sources: Sources) -> Pairs:
    """A search at the end of each drive, seeds from 0."""
    each, true = list[Searched](), list[Array]()
    for seed in range(sources.drives):
        log = simulate(np.random.default_rng(seed), _by_a_building())
        true.append(truth_in_order(log)[1])
        mapping = map_log(log, MapConfig(extensions={"dense_maps": _SEARCHED}))
        around = searched_at_end(mapping)
        each.append(Searched.of(log.duration_s, around, search(around, np.empty((0, 4, 2)))))
    reported = f"{len(each)} simulated drives past a building and something small, from seed 0"
    return Pairs(reported, tuple(each), tuple(true), _by_a_building().world.segment)


def high_level_drives(sources: Sources) -> Drives[HighLevelDrive]:
    """Section 6.1.3: chapter 4's environment, a search every minute, seeds from 0."""
    experiment, drives = enclosed(occupancy(LOOPS)), sources.drives
    logs = (simulate(np.random.default_rng(seed), experiment) for seed in range(drives))
    reported = f"{experiment.name} --loops {LOOPS} with {MORE}, {drives} drives from seed 0"
    return Drives(reported, tuple(of_log(log) for log in logs))


def of_log(log: Log) -> HighLevelDrive:
    """A log with scans and truth, driven with high level landmarks and without."""
    (poses, segment), loop_s = true_surroundings(log), occupancy().drive.loop_s
    searches = list[Searched]()

    def searched(time_s: float, around: Around, found: Search) -> None:
        searches.append(Searched.of(time_s, around, found))

    source = HighLevelSource(log, HighLevelOptions(every_s=EVERY_S), searched=searched)
    choices, timeline = settle(EkfConfig(), log), build_timeline(log)
    without = run_ekf(log, timeline, choices)
    run = run_ekf(log, timeline, choices, setup=FilterSetup(source=source))

    def error_m(one: EkfRun) -> float:
        later = one.estimate.time_s > loop_s
        true = poses.at(one.estimate.time_s[later])
        return float(np.sqrt(np.square(one.departed[later, :2] - true[:, :2]).sum(axis=1).mean()))

    return HighLevelDrive(
        searches=tuple(searches),
        run=source.run(),
        templates=tuple(one.template.shape.mean for one in source.landmarks.landmark),
        sigma=place_covariances(run.estimate),
        path=run.estimate.pose[:, :2],
        true_path=poses.pose[:, :2],
        landmark=run.estimate.landmark,
        true=truth_in_order(log)[1],
        segment=segment,
        error_m=error_m(run),
        without_m=error_m(without),
    )


_UNKNOWN, _CELLS_M = 0.5, 0.4


def _claims_6_2(found: Pairs) -> Claims:
    shares, off = list[float](), list[float]()
    for one, true in zip(found.each, found.true, strict=True):
        if one.search.found:
            cells, mean = one.cells_of_it, one.template.mean
            held = cells.point[cells.occupancy > _UNKNOWN]
            moved = rigid_motion(one.landmark, true[: len(one.landmark)])(mean)
            shares.append(near_share(held, mean, _CELLS_M))
            off.append(float(np.median(distance_to_segments(moved, found.segment))))
    text = "the Gaussians have what the grid has (share of its cells above 0.5 within two, least)"
    yield at_least(text, min(shares, default=np.nan), 0.9, own=True)
    text = (
        "they show the object (median distance from a surface, once point landmarks are moved onto "
        "the true ones, largest of the drives)"
    )
    yield at_most(text, max(off, default=np.nan), _CELLS_M, "m", own=True)


def _claims_6_4(found: Pairs) -> Claims:
    corners = [len(one.search.corner) for one in found.each]
    shown = [len(one.search.candidate) for one in found.each]
    right = [n == 2 and one.accepted.sum() == 1 for n, one in zip(shown, found.each, strict=True)]
    rich = [one.search.gaussians[one.accepted] for one in found.each]
    poor = [one.search.gaussians[~one.accepted] for one in found.each]
    yield at_least("four corners are detected (fewest of the drives)", min(corners), 4)
    text = "two pairs become candidates, and one is accepted (share of drives)"
    yield at_least(text, np.mean(right), 1.0)
    text = f"the accepted one has the {LEAST} Gaussians that are asked for (fewest)"
    yield at_least(text, min(np.concatenate(rich), default=np.nan), LEAST)
    text = "the other has not enough (most of the drives; limit: one less than asked for)"
    yield at_most(text, max(np.concatenate(poor), default=np.nan), LEAST - 1)


def _claims_6_5(found: Drives[HighLevelDrive]) -> Claims:
    first = [d.searches[0] for d in found.each]
    shown = [len(one.search.candidate) for one in first]
    taken = [int(one.accepted.sum()) for one in first]
    later = [len(d.run.landmark_index) - n for d, n in zip(found.each, taken, strict=True)]
    kept = [int(np.count_nonzero(d.run.landmark_index >= 0)) for d in found.each]
    looks = Counter[str]()
    for d in found.each:
        looks.update(d.run.looks)
    text = "the first search has three candidates (median of the drives)"
    yield at_least(text, np.median(shown), CANDIDATES)
    yield at_least("at least one of them is accepted (the same)", np.median(taken), FIRST)
    text = "and two are rejected for too few Gaussians (the same)"
    rejected = [n - k for n, k in zip(shown, taken, strict=True)]
    yield at_least(text, np.median(rejected), CANDIDATES - FIRST)
    text = "once the loop is closed four more have been detected (the same)"
    yield at_least(text, np.median(later), LATER)
    why = ours(
        "44 s are left after the search that finds four of them, and a landmark is used from "
        f"the first scan that has {SHARE:.0%} of its template in view and fixes its heading: "
        f"of {looks.total()} looks at those within reach {looks['out of view']} were out of "
        f"view, and {looks['a direction is open']} left a direction open. With 10 % and any "
        "direction open 3 are used in each of 3 drives"
    )
    text = "in the end five are in the state, seen again and used (the same)"
    yield at_least(text, np.median(kept), FIRST + LATER, why=why)


def _claims_6_6(found: Drives[HighLevelDrive]) -> Claims:
    off = [
        float(np.median(distance_to_segments(rigid_motion(d.landmark, d.true)(points), d.segment)))
        for d in found.each
        for points in d.placed
    ]
    ratio = [d.error_m / d.without_m for d in found.each]
    landmarks = len(found.each[0].landmark)
    text = (
        "the templates are pieces of the objects (median distance of a template's points from the "
        "surfaces, once the point landmarks are moved onto the true ones; median of all templates)"
    )
    yield at_most(text, np.median(off) if off else np.nan, 0.5, "m", own=True)
    why = elsewhere(f"few are seen again, among {landmarks} point landmarks")
    text = (
        "the vehicle is no farther from the truth with them (RMS position error after the "
        "first loop, over that without, mean of the drives)"
    )
    yield at_most(text, np.mean(ratio), 1.0, why=why)
    why = elsewhere(
        f"{landmarks} point landmarks are there as well, and fix the vehicle without them"
    )
    text = "localisation is much more robust with them (the same)"
    yield at_most(text, np.mean(ratio), 0.5, why=why, own=True)


CORNER_PAIRS = Experiment("section 6.1.3, two pairs of corners", corner_pairs)
HIGH_LEVEL = Experiment("section 6.1.3", high_level_drives)


_BESIDE_M = 3.0


def _draw_6_2(canvas: Canvas, found: Pairs) -> None:
    axes, one = canvas.subplots(1, 2, sharex=True, sharey=True), found.each[0]
    (east, north), height, g = one.cells_of_it.point.T, one.cells_of_it.occupancy, one.template
    drawn = axes[0].scatter(east, north, s=11.0, marker="s", linewidths=0, c=height, vmin=0, vmax=1)
    canvas.colorbar(drawn, ax=list(axes), label="occupancy", shrink=0.8)
    draw_lines(axes[1], ellipses(g.mean, g.covariance, 1.0, 16), DENSE_COLOUR, "1 sigma", 0.6)
    ends = to_world(one.search.found[0].place, 3.0 * np.array([(1, 0), (0, 0), (0, 1)]))
    for axis, title in zip(axes, ("(a) occupancy grid", "(b) sum of Gaussians"), strict=True):
        draw_surfaces(axis, found.segment)
        axis.plot(*ends.T, "-", color=HIGH_LEVEL_COLOUR, linewidth=2.0, label="local axes")
        plan(axis, title, legend="lower right")
    frame(axes[0], one.search.candidate[one.accepted][0], 0.5)


def _draw_6_4(canvas: Canvas, found: Pairs) -> None:
    axis, one = canvas.add_subplot(), found.each[0]
    draw_surfaces(axis, found.segment)
    _draw_search(axis, one)
    frame(axis, one.search.candidate.reshape(-1, 2), _BESIDE_M)
    title = "corners, rectangles around pairs, and the Gaussians in them"
    plan(axis, title, legend="lower center", columns=2)


def _draw_6_5(canvas: Canvas, found: Drives[HighLevelDrive]) -> None:
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    d = found.each[0]
    first = d.searches[0]
    draw_surfaces(left, d.segment)
    _draw_search(left, first)
    left.plot(*first.landmark.T, "+", color=TRUTH_COLOUR, markersize=5, label="point landmarks")
    left.plot(*first.pose[:2], ">", color=EKF_COLOUR, markersize=7, label="vehicle")
    plan(left, f"(a) the first search, {first.time_s:.0f} s", legend="lower right")
    _draw_end(right, d)
    right.plot(*d.landmark.T, "+", color=TRUTH_COLOUR, markersize=5, label="point landmarks")
    known = d.run.landmark_index >= 0
    places = d.run.place[known][np.argsort(d.run.landmark_index[known]), :2]
    draw_lines(right, ellipses(places, d.sigma, 1.0), EKF_COLOUR, "1 sigma")
    plan(right, "(b) after the loop, in the end", legend="lower right")


def _draw_6_6(canvas: Canvas, found: Drives[HighLevelDrive]) -> None:
    axis, d = canvas.add_subplot(), found.each[0]
    _draw_end(axis, d)
    for points in d.placed:
        label = "templates" if points is d.placed[0] else None
        axis.plot(*points.T, ".", color=DENSE_COLOUR, markersize=2.5, label=label, zorder=4)
    axis.plot(*d.landmark.T, "+", color=TRUTH_COLOUR, markersize=5, label="point landmarks")
    title = "templates of high level landmarks, their axes and rectangles"
    plan(axis, title, legend="lower right")


def _draw_search(axis: Axes, one: Searched) -> None:
    """Gaussians, corners, and rectangles, solid where accepted, with the number of Gaussians."""
    axis.plot(*one.point.T, ".", color=DENSE_COLOUR, markersize=1.5, label="Gaussians", zorder=3)
    corner = one.search.corner
    axis.plot(
        *corner.T, "o", color=EKF_COLOUR, markersize=8, markerfacecolor="none", label="corners",
        zorder=4,
    )  # fmt: skip
    for style, name, chosen in (
        ("solid", "accepted", one.accepted),
        ("dashed", "rejected", ~one.accepted),
    ):
        if chosen.any():
            outline = closed(one.search.candidate[chosen])
            draw_lines(axis, outline, HIGH_LEVEL_COLOUR, name, 1.2, style=style)
    for area, count in zip(one.search.candidate, one.search.gaussians.tolist(), strict=True):
        top = area[area[:, 1].argmax()]
        axis.annotate(f"{count}", top, xytext=(0, 3), textcoords="offset points", fontsize=9,
                      ha="center", color=HIGH_LEVEL_COLOUR)  # fmt: skip


def _draw_end(axis: Axes, d: HighLevelDrive) -> None:
    draw_surfaces(axis, d.segment)
    draw_trajectory(axis, d.true_path, TRUE_PATH_COLOUR, "true path")
    draw_trajectory(axis, d.path, EKF_COLOUR, "estimated path", "--")
    draw_high_level(axis, d.run)


FIGURES = (
    Figure(
        name="N6.2", title="A high level landmark in two layers",
        says="A landmark of the dense map, with local axes, may be a grid or a sum of Gaussians.",
        experiment=CORNER_PAIRS, draw=_draw_6_2, claims=_claims_6_2, size=(13.0, 5.6),
    ),
    Figure(
        name="N6.4", title="Two pairs of corners, one with too few Gaussians",
        says="Four corners make two candidates; the first has enough Gaussians under its "
        "rectangle, the second has not and is no landmark.",
        experiment=CORNER_PAIRS, draw=_draw_6_4, claims=_claims_6_4, size=(9.0, 6.0),
    ),
    Figure(
        name="N6.5", title="The first search for high level landmarks, and the map after the loop",
        says="Of three candidates that the first search finds one is accepted; once the loop is "
        "closed four more have been found and are in the state.",
        experiment=HIGH_LEVEL, draw=_draw_6_5, claims=_claims_6_5, size=(13.0, 6.2),
    ),
    Figure(
        name="N6.6", title="The final map of high level landmarks",
        says="The templates' dense information is used for navigation beside the point landmarks, "
        "which makes localisation much more robust.",
        experiment=HIGH_LEVEL, draw=_draw_6_6, claims=_claims_6_6, size=(8.0, 7.0),
    ),
)  # fmt: skip
