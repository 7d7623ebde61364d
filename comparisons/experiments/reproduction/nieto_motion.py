"""Nieto 2005, section 6.3.3: dynamic areas by fast and by slow motion, Figs. 6.9 and 6.10."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from comparisons.arrays import Array
from comparisons.config import MapConfig
from comparisons.experiments.reproduction.drawing import frame, plan
from comparisons.experiments.reproduction.interface import (
    AnyFigure,
    Claims,
    Experiment,
    Figure,
    Sources,
    at_least,
    at_most,
)
from comparisons.experiments.reproduction.measures import true_segments
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.figure import draw_occupied, draw_regions, draw_surfaces
from comparisons.extensions.dynamic.config import DynamicConfig
from comparisons.logs.simulate import dynamic_worlds
from comparisons.logs.simulate.dynamic_worlds import moved_over
from comparisons.logs.simulate.scan_drive import (
    ScanExperiment,
    dynamic_lanes,
    dynamic_places,
    simulate,
)
from comparisons.logs.simulate.scan_worlds import Moving
from comparisons.pipeline.dense_map import map_log
from comparisons.report.marks import TRUTH_COLOUR
from ekf_reference.dense.dynamic import DynamicLayer, places
from ekf_reference.dense.layers.layer import Samples
from ekf_reference.dense.regions_at_map import RegionsAtMap

_DYNAMIC_COLOUR = "#e08a1e"
_MOST_DRIVES = 3
"""So many drives per claim: the places are the same in all, only the noise is another."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What one drive found. dynamic: (N, 2) cells [m]. landmark: (L, 2). occupied: in the end.

    segment: (S, 4) what stands. triangle: (R, 3, 2).
    """

    score: DynamicScore
    dynamic: Array
    occupied: Samples
    landmark: Array
    segment: Array
    triangle: Array


@dataclass(frozen=True)
class Motions:
    """Of some drives; the first is drawn. true: (P, 2) [m] middles of the places that change."""

    log: str
    each: tuple[Motion, ...]
    true: Array


def _motion(experiment: ScanExperiment, seed: int) -> Motion:
    log = simulate(np.random.default_rng(seed), experiment)
    extensions = {"dense_maps": DenseMapsConfig(layers=("occupancy",)), "dynamic": DynamicConfig()}
    mapping = map_log(log, MapConfig(extensions=extensions))
    layer = mapping.dense.dense.dynamic
    if layer is None:
        raise TypeError("the map kept no dynamic layer")
    return Motion(
        score=score_dynamic(layer, mapping.placed, experiment.world.movers, log.duration_s),
        dynamic=layer.points(mapping.placed),
        occupied=mapping.layers["occupancy"],
        landmark=mapping.dense.landmark,
        segment=true_segments(log),
        triangle=mapping.placed.triangle,
    )


def _motions(experiment: ScanExperiment, true: Array, sources: Sources) -> Motions:
    drives = min(sources.drives, _MOST_DRIVES)
    reported = f"{experiment.name}, {drives} drives from seed 0"
    return Motions(reported, tuple(_motion(experiment, seed) for seed in range(drives)), true)


def lanes(sources: Sources) -> Motions:
    """Two lanes of traffic before a scanner that stands.

    Without the first pole, which hides a piece of a lane: the thesis' lanes are whole.
    """
    true = np.array([(np.nan, north) for north in dynamic_worlds.LANES_M])
    experiment = dynamic_lanes()
    w = experiment.world
    w = replace(w, landmark=w.landmark[1:], pole=w.pole[1:], pole_height_m=w.pole_height_m[1:])
    return _motions(replace(experiment, world=w), true, sources)


def changed_places(sources: Sources) -> Motions:
    """One object taken away and two brought between two passes."""
    experiment = dynamic_places()
    return _motions(experiment, dynamic_worlds.changed_places(experiment.world.movers), sources)


def claims_6_9(found: Motions) -> Claims:
    """Both lanes, and hardly anything else."""
    off = [_off(m.score.middle[:, 1:], found.true[:, 1:]) for m in found.each]
    yield at_most(
        "dynamic areas lie where the vehicles drive (largest distance of a lane's middle from "
        "its own area's, in all drives)",
        max(off),
        0.5,
        "m",
        own=True,
    )
    yield at_most(
        "and nowhere else: number of areas (most of the drives)",
        max(len(m.score.middle) for m in found.each),
        2,
    )
    yield at_least(
        "cells found are driven on (least precision of the drives)",
        min(m.score.precision for m in found.each),
        0.9,
        own=True,
    )
    yield at_least(
        "cells driven on are found (least recall of the drives)",
        min(m.score.recall for m in found.each),
        0.9,
        own=True,
    )


def claims_6_10(found: Motions) -> Claims:
    """The three places, and no other."""
    off = [_off(m.score.middle, found.true) for m in found.each]
    yield at_most(
        "areas are found where the objects stood or stand (largest distance of their middles, "
        "in all drives; only the sides that were seen are found)",
        max(off),
        1.3,
        "m",
        own=True,
    )
    yield at_most(
        "and nowhere else: number of areas (most of the drives)",
        max(len(m.score.middle) for m in found.each),
        3,
    )


def _off(middle: Array, true: Array) -> float:
    """Largest distance of true places (P, d) from their nearest; infinite where two share one."""
    if len(middle) < len(true):
        return float("inf")
    apart = np.linalg.norm(middle[:, None] - true[None], axis=2)
    if len(np.unique(apart.argmin(axis=0))) != len(true):
        return float("inf")
    return float(apart.min(axis=0).max())


def _draw(axis: Axes, found: Motions, title: str) -> None:
    motion = found.each[0]
    draw_regions(axis, motion.triangle)
    draw_surfaces(axis, motion.segment)
    draw_occupied(axis, motion.occupied)
    axis.plot(*motion.dynamic.T, ".", color=_DYNAMIC_COLOUR, markersize=2, zorder=4)
    axis.plot(*motion.landmark.T, "+", color=TRUTH_COLOUR, markersize=5)
    frame(axis, np.vstack((motion.dynamic, motion.landmark)), 3.0)
    plan(axis, title)


def draw_6_9(canvas: Canvas, found: Motions) -> None:
    """The dynamic cells over what is occupied in the end."""
    _draw(canvas.add_subplot(), found, "fast motion (orange), what is occupied, regions")


def draw_6_10(canvas: Canvas, found: Motions) -> None:
    """The same, with the places that changed."""
    axis = canvas.add_subplot()
    _draw(axis, found, "slow motion (orange), the changed places (circles)")
    axis.plot(*found.true.T, "o", markersize=16, markerfacecolor="none", color=TRUTH_COLOUR)


FIGURES: tuple[AnyFigure, ...] = (
    Figure(
        name="N6.9", title="Fast motion found by differencing occupancy",
        says="Maps a second apart, differenced, low-passed and thresholded, leave two areas, where "
        "the two objects move; the contours of what stands are filtered away.",
        experiment=Experiment("section 6.3.3, fast motion", lanes), draw=draw_6_9,
        claims=claims_6_9, size=(8.0, 7.0),
    ),
    Figure(
        name="N6.10", title="Slow motion found between two visits",
        says="Between two visits one object is taken away and two are brought; three areas are "
        "found, and these are the places.",
        experiment=Experiment("section 6.3.3, slow motion", changed_places), draw=draw_6_10,
        claims=claims_6_10, size=(8.0, 7.0),
    ),
)  # fmt: skip


_SAMPLE_S = 0.02


@dataclass(frozen=True)
class DynamicScore:
    """Cells that are dynamic and cells that something moved over, among those ever seen.

    precision, recall: NaN where there is nothing to divide by. middle: (P, 2) [m] of the connected
    places found.
    """

    precision: float
    recall: float
    middle: Array


def score_dynamic(
    layer: DynamicLayer, placed: RegionsAtMap, movers: Sequence[Moving], duration_s: float
) -> DynamicScore:
    """Of a layer at the end of a log that lasted so long."""
    seen = layer.grid.samples(placed).point
    truth = moved_over(tuple(movers), seen, np.arange(0.0, duration_s, _SAMPLE_S))
    found = layer.covers(seen, placed)
    right = float(np.count_nonzero(truth & found))
    with np.errstate(invalid="ignore"):
        shares = np.array((right, right)) / (np.count_nonzero(found), np.count_nonzero(truth))
    return DynamicScore(float(shares[0]), float(shares[1]), middles(layer.points(placed)))


def middles(point: Array) -> Array:
    """(P, 2) of the connected places that points (N, 2) make."""
    number = places(point)
    count = int(number.max(initial=-1)) + 1
    return np.array([point[number == k].mean(axis=0) for k in range(count)]).reshape(-1, 2)
