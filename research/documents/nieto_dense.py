"""Nieto 2005, sections 4.1.3 to 4.3: dense maps in simulation.

Every experiment is run twice on the same logs: by the settings that runs use, and by the thesis'
(`literal`, `--preset nieto-2005`). The worlds are those of the named logs with landmarks among and
behind the objects: the thesis' regions are triangles of landmarks that enclose objects, and between
landmarks that line the path there is hardly any (research/dense_maps.py --correlation --among 0).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from comparisons.arrays import Array
from comparisons.checks.accuracy import rigid_motion
from comparisons.config import MapConfig
from comparisons.documented.row import Preset
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.accuracy import (
    SurfaceError,
    error_of_points,
    surface_error,
)
from comparisons.extensions.dense_maps.config import Layer
from comparisons.extensions.dense_maps.figure import (
    draw_occupied,
    draw_regions,
    draw_surfaces,
)
from comparisons.extensions.dense_maps.job import DenseMapping, map_log
from comparisons.extensions.dense_maps.source import BeforeClosing
from comparisons.logs.log import Log
from comparisons.logs.simulate.scan_drive import ScanExperiment, enclosed, occupancy, simulate
from comparisons.logs.simulate.scan_worlds import MORE_LANDMARKS
from comparisons.report.marks import SMOOTHER_COLOUR, TRUTH_COLOUR
from ekf_reference.dense.layers.layer import LayerSamples
from research.documents.claims import Claims, Why, at_least, at_most, ours
from research.documents.drawing import plan
from research.documents.drives import true_surroundings, truth_in_order
from research.documents.interface import DocumentFigure, Experiment, Sources
from research.documents.measures import median, near_share, occupied

SURFACES: tuple[Layer, ...] = ("points", "occupancy", "particles", "sog")
"""Layers of where surfaces are."""
SHORT_SIGHT_M = 15.0
"""So short that one grid fails in every drive. With the 25 m of Table 4.1 the vehicle's error grows
to some 0.3 m until our world's loop closes; where the thesis' landmarks stand it shows in pictures
alone, and there it grows until objects are misshapen."""
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


@dataclass(frozen=True)
class Maps:
    """Of several drives. all_drives: also those whose loop closed gently; the first is drawn.

    literal: the same drives by the thesis' settings. short: drives with SHORT_SIGHT_M of sight.
    """

    log: str
    closed: tuple[ClosedMap, ...]
    all_drives: tuple[DenseMapping, ...]
    literal: Maps | None = None
    short: Maps | None = None


MORE = f"{MORE_LANDMARKS} landmarks more among and behind the objects"


def _maps(
    experiment: ScanExperiment, layers: tuple[Layer, ...], sources: Sources, called: str = ""
) -> Maps:
    name, experiment = experiment.name, enclosed(experiment)
    logs, ours = list[Log](), list[DenseMapping]()
    while len(ours) < sources.drives or not _closed(ours):
        if len(ours) == sources.drives + _MORE:
            raise InputError(f"{name}: no drive's loop is closed by a shift of {_CLOSING_M} m")
        logs.append(simulate(np.random.default_rng(len(logs)), experiment))
        ours.append(map_log(logs[-1], _config(name, "recommended", layers=layers)))
    literal = [map_log(log, _config(name, "nieto-2005", layers=layers)) for log in logs]
    reported = f"{name} with {MORE}{called}, {len(ours)} drives from seed 0"
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


def layered_maps(sources: Sources) -> Maps:
    """Chapter 4: all layers; and one grid beside DenseSLAM's where the sight is short."""
    drive = replace(occupancy().drive, max_range_m=SHORT_SIGHT_M)
    scanner = replace(occupancy().scanner, max_range_m=SHORT_SIGHT_M)
    called = f", {SHORT_SIGHT_M:.0f} m of sight"
    experiment = replace(occupancy(), drive=drive, scanner=scanner)
    short = _maps(experiment, ("occupancy",), sources, called)
    return replace(_maps(occupancy(), SURFACES, sources), short=short)


LAYERED = Experiment("chapter 4", layered_maps)


LITERALLY = "by the thesis' settings: "
"""How the text of a claim begins that is of the thesis' settings (--preset nieto-2005)."""
SHORT_SIGHTED = f"with {SHORT_SIGHT_M:.0f} m of sight: "
"""How the text of a claim begins that is of the drives with a short sight."""
_FEW_CELLS = ours("few returns find a region, so few cells are compared")
_CELLS = 2.0
"""Layers cover the same surfaces when so many cells apart or fewer."""
_LEAST = 0.5


def _also_literally(
    why: Mapping[int, Why],
) -> Callable[[Callable[[Maps], Claims]], Callable[[Maps], Claims]]:
    """Make claims a second time by the thesis' settings. why: by number, where another one."""

    def twice(claims: Callable[[Maps], Claims]) -> Callable[[Maps], Claims]:
        @wraps(claims)
        def both(found: Maps) -> Claims:
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
    yield at_most(text, median(now / then), 1.0, why=why).over(now / then)


def _claims_4_3(maps: Maps) -> Claims:
    yield from _claims_of_grids(maps)
    if maps.short is not None:
        for claim in _claims_of_grids(maps.short):
            yield replace(claim, text=SHORT_SIGHTED + claim.text)


@_also_literally({0: _FEW_CELLS})
def _claims_of_grids(maps: Maps) -> Claims:
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
    yield at_most(text, np.max(dense / classic), 1.0, why=why).over(dense / classic)
    why = ours(
        f"{median(own):.2f} and {median(other):.2f} m; the noise of the returns alone is 1 "
        "degree, or 0.44 m at 25 m"
    )
    text = (
        "it fits the landmark map, where one grid is misshapen (the same once the landmarks "
        "are moved onto the true ones, median ratio)"
    )
    yield at_most(text, np.median(own / other), 1.0, why=why).over(own / other)
    text = "because the closing corrects it (95 %, after over before, median of drives)"
    yield from _corrected(text, maps, "occupancy")
    why = ours(
        f"both carry the error of the landmarks themselves: {median(dense):.2f} and "
        f"{median(classic):.2f} m, and {median(own):.2f} and {median(other):.2f} m once the "
        "landmarks are moved onto the true ones"
    )
    text = "it is more accurate on the whole (95 % of the distances, median ratio)"
    yield at_most(text, np.median(dense / classic), 1.0, why=why).over(dense / classic)


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
        yield at_least(text, np.mean(shares), 0.9, own=True).over(shares)


def _map(
    axis: Axes, m: ClosedMap, samples: LayerSamples, triangle: Array, landmark: Array, title: str
) -> None:
    draw_regions(axis, triangle)
    draw_surfaces(axis, m.segment)
    draw_occupied(axis, samples)
    axis.plot(*landmark.T, "o", color=SMOOTHER_COLOUR, markersize=4, markerfacecolor="none")
    axis.plot(*m.true.T, "*", color=TRUTH_COLOUR, markersize=4)
    plan(axis, title)


def _draw_4_3(canvas: Canvas, maps: Maps) -> None:
    maps = maps.short or maps
    m, (left, right) = maps.closed[0], canvas.subplots(1, 2, sharex=True, sharey=True)
    now = m.mapping
    none = np.empty((0, 3, 2))
    _map(left, m, now.classic, none, now.dense.landmark, "(a) one grid in the world")
    held = now.layers["occupancy"]
    _map(right, m, held, now.placed.triangle, now.dense.landmark, "(b) DenseSLAM")


def _draw_4_16(canvas: Canvas, maps: Maps) -> None:
    m, axes = maps.closed[0], canvas.subplots(1, 3, sharex=True, sharey=True)
    for axis, name in zip(axes, ("occupancy", "particles", "sog"), strict=True):
        draw_regions(axis, m.mapping.placed.triangle)
        draw_occupied(axis, m.mapping.layers[name])
        plan(axis, name)


FIGURES = (
    DocumentFigure(
        name="N4.3", title="One occupancy grid, and DenseSLAM's",
        says="After the first loop objects are misshapen in one grid in the world's frame, while "
        "DenseSLAM's grids are corrected along with the landmarks (drawn: "
        f"{SHORT_SIGHT_M:.0f} m of sight).",
        experiment=LAYERED, draw=_draw_4_3, claims=_claims_4_3, size=(12.0, 6.0),
    ),
    DocumentFigure(
        name="N4.16", title="Three layers of one run",
        says="Different layers of the same data are kept at the same time, each in its own way "
        "(there the car park, here the simulation).",
        experiment=LAYERED, draw=_draw_4_16, claims=_claims_4_16, size=(15.0, 5.4),
    ),
)  # fmt: skip
