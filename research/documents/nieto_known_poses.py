"""Nieto 2005, sections 2.8.1, 4.2 and 4.3.1: a grid, samples and Gaussians from known poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure as Canvas
from matplotlib.image import AxesImage
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree

from comparisons.adapters.planar_scans import PlanarScans
from comparisons.arrays import Array
from comparisons.extensions.dense_maps.accuracy import distance_to_segments, near_share
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.figure import draw_surfaces
from comparisons.extensions.dense_maps.source import grid_model
from comparisons.logs.simulate.polygons import sides
from comparisons.logs.simulate.scan_drive import occupancy, simulate
from comparisons.report.figures.style import draw_trajectory
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR
from ekf_reference.dense.box_tree import BoxTree, boxes
from ekf_reference.dense.layers.association import Associated, associate
from ekf_reference.dense.layers.classic_grid import ClassicGrid
from ekf_reference.dense.layers.layer import Hits, Samples
from ekf_reference.dense.layers.particles import Particles
from ekf_reference.dense.layers.quadtree import Quadtree, quadtree
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan, Sensor
from ekf_reference.dense.sensor_model import InverseSensorModel, probability
from ekf_reference.scan_matching.sog import SumOfGaussians
from research.documents.claims import Claims, at_least, at_most, theirs, within
from research.documents.drawing import chart, draw_lines, frame, plan
from research.documents.drives import truth_in_order
from research.documents.interface import Experiment, Figure, Sources
from research.documents.measures import occupied

SAMPLES, D_MIN_M = 1000, 0.2
"""Samples of a return in Figs. 4.7 and 4.8; distance of Fig. 4.9."""
RANGE_M, SIGMA_M = 20.0, float(np.sqrt(0.8))
PLACE_M, PLACE_RAD, IN_PLANE = 6.0, float(np.deg2rad(10.0)), (0.1, float(np.deg2rad(1.0)))
"""Returns of Fig. 4.1 (a) and (b); the sigmas of the second are those of Table 4.1."""
_BEFORE, _SHOWN = 10, 40
"""Scans that the a priori map of Fig. 4.9 is of; the scan of Fig. 4.11."""
_BEAM = np.array((0.0, 0.0, 7.0, 2.0))
_FINE_M, _CELL_M, _NEAR_M = 0.02, 0.2, 0.4
_UNKNOWN = 0.5
_ALIKE = 0.1
"""Difference of occupancies up to which four squares of a quadtree are one."""
_TREE_M = 15.0
_GREEN = "#2a9d3a"
_SQUARE = np.array(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)))


@dataclass(frozen=True, kw_only=True)
class KnownPoses:
    """From true poses: one drive, with some of its scans, and single returns before a scanner.

    grid: of all scans, tree: the same as a quadtree. old, new, pair: a map of particles, samples
    of the next scan, and how they meet. point: (N, 2) of a scan in its own frame, peak: (N,)
    heights of its Gaussians, height: (I, J) of their sum [1/m^2] in cells of `box`, west, south,
    east, north. line, curves: samples of a range sensor; (3, R) ranges, with occupancy and the
    sensor's density over its peak. plane, level, surface: samples of range and bearing; (I, J)
    occupancy, NaN where the return says nothing, and what is interpolated from the samples, NaN
    beyond them.
    """

    log: str
    grid: Samples
    tree: Quadtree
    old: Samples
    new: Samples
    pair: Associated
    point: Array
    peak: Array
    height: Array
    box: Array
    line: Samples
    curves: Array
    plane: Samples
    level: Array
    surface: Array


def known_poses(sources: Sources) -> KnownPoses:
    """The drive of section 4.1.3, seed 0, as if its poses were known, and two returns."""
    log, settings = simulate(np.random.default_rng(0), occupancy()), DenseMapsConfig()
    planar, model = PlanarScans(log), grid_model(settings)
    pose = truth_in_order(log)[0].at(planar.time_s)
    scans = [planar.scan(number, each) for number, each in enumerate(pose)]
    grid, placed = ClassicGrid(settings.resolution_m, model), _around()
    for scan in scans:
        grid.fuse(scan)
    whole = grid.samples()
    layer = Particles(np.random.default_rng(0), d_min_m=D_MIN_M, model=model)
    for scan in scans[:_BEFORE]:
        layer.fuse(_hits(scan, placed), placed, scan, np.arange(1))
    old, new = layer.samples(placed), _drawn(layer, scans[_BEFORE])
    shown = planar.scan(_SHOWN, np.zeros(3))
    g = SumOfGaussians.of_equal_height(shown.point, shown.covariance)
    box = _CELL_M * np.round(shown.box(2.0) / _CELL_M)
    usual, by_both = InverseSensorModel(), InverseSensorModel(with_bearing=True)
    at_m = np.linspace(RANGE_M - 10.0, RANGE_M + 10.0, 401)
    off, beam = (RANGE_M - at_m) / SIGMA_M, _cells(_BEAM, _FINE_M)
    scan = _seen(PLACE_M, PLACE_RAD, Sensor(*IN_PLANE, 6.0 * IN_PLANE[1]))
    met = scan.beams(beam.reshape(-1, 2))
    level = by_both.probability(met.ahead_m, met.off_rad, *IN_PLANE)
    plane = _drawn(Particles(np.random.default_rng(0), SAMPLES, model=by_both), scan)
    line = _seen(RANGE_M, 0.0, Sensor(SIGMA_M, 1e-6, 1e-6))
    return KnownPoses(
        log=f"occupancy-loop, seed 0, by true poses; one return, {SAMPLES} samples",
        grid=whole,
        tree=quadtree(whole.point, whole.occupancy, settings.resolution_m, _ALIKE),
        old=old,
        new=new,
        pair=associate(old.point, new.point, D_MIN_M),
        point=g.mean,
        peak=g.weight / (2.0 * np.pi * np.sqrt(np.linalg.det(g.covariance))),  # 4.13, 4.14
        height=np.stack([g.value(row) for row in _cells(box, _CELL_M)]),
        box=box,
        line=_drawn(Particles(np.random.default_rng(0), SAMPLES, model=usual), line),
        curves=np.stack((at_m, usual.probability(off, 0.0 * off, 1.0, 1.0), np.exp(-0.5 * off**2))),
        plane=plane,
        level=np.where(met.seen, level, np.nan).reshape(beam.shape[:2]),
        surface=LinearNDInterpolator(plane.point, plane.occupancy)(beam),
    )


def _seen(range_m: float, bearing_rad: float, sensor: Sensor) -> Scan:
    return Scan.of_ranges(np.zeros(3), np.array([bearing_rad]), np.array([range_m]), sensor)


def _around() -> RegionsAtMap:
    """One region around all."""
    triangle = 1e3 * np.array([[(-1.0, -1.0), (0.0, 2.0), (1.0, -1.0)]])
    return RegionsAtMap(triangle, BoxTree.pack(boxes(triangle), np.zeros(1, dtype=np.intp)))


def _hits(scan: Scan, placed: RegionsAtMap) -> Hits:
    at = placed.locate(scan.point)
    return Hits(region=at.region, local=at.local, point=scan.point, covariance=scan.covariance)


def _drawn(layer: Particles, scan: Scan) -> Samples:
    point, odds = layer.sampled(_hits(scan, _around()), scan)
    return Samples(point, probability(odds), np.zeros(len(point), dtype=np.intp))


def _cells(box: Array, size_m: float) -> Array:
    """(I, J, 2) middles, a row for each north."""
    first, last = np.round(box / size_m).astype(int).reshape(2, 2)
    axes = [size_m * (np.arange(a, b) + 0.5) for a, b in zip(first, last, strict=True)]
    return np.stack(np.meshgrid(*axes), axis=-1)


KNOWN = Experiment("sections 2.8.1, 4.2 and 4.3.1, known poses", known_poses)


def _claims_2_5(found: KnownPoses) -> Claims:
    held, world = found.grid.point[found.grid.occupancy > _UNKNOWN], occupancy().world
    shown = [distance_to_segments(held, sides(o)).min() <= _NEAR_M for o in world.outline]
    text = f"every one of {len(shown)} objects is represented (share with cells above 0.5 at it)"
    yield at_least(text, np.mean(shown), 1.0)
    text = f"and every one of {len(world.landmark)} landmarks (share)"
    yield at_least(text, near_share(world.landmark, held, _NEAR_M), 1.0)
    text = "black is what stands there (share of cells above 0.8 within two cells of a surface)"
    off_m = distance_to_segments(occupied(found.grid), world.surfaces().segment)
    yield at_least(text, np.mean(off_m <= _NEAR_M), 0.9, own=True)


def _claims_4_1_3(found: KnownPoses) -> Claims:
    cells, tree = found.grid.occupancy, found.tree
    fine = tree.side_m < 1.5 * tree.side_m.min()
    share = fine.sum() / len(cells)
    text = "as a quadtree the grid has other resolutions in other areas (leaves over cells)"
    yield at_most(text, len(tree.side_m) / len(cells), 0.5, own=True)
    kept = np.sum(tree.occupancy[fine] > _UNKNOWN) / np.sum(cells > _UNKNOWN)
    text = (
        "the finest where something stands (share of cells above 0.5 that stay, over that of all)"
    )
    yield at_least(text, kept / share, 2.0, own=True)


def _claims_4_7(found: KnownPoses) -> Claims:
    high, off_m = found.line.occupancy > _UNKNOWN, np.hypot(*found.line.point.T) - RANGE_M
    text = "most samples are in the region with high probability of being occupied (share)"
    yield at_least(text, np.mean(high), 0.5)
    why = theirs("by 4.4 both begin 1.18 sigmas from the return, and 24 % of a Gaussian lie beyond")
    text = "almost none are in free and unknown space (share)"
    yield at_most(text, np.mean(~high), 0.05, why=why, own=True)
    text = "almost none are where the distribution is level (share beyond 3 sigmas)"
    yield at_most(text, np.mean(np.abs(off_m) > 3.0 * SIGMA_M), 0.01, own=True)


def _claims_4_8(found: KnownPoses) -> Claims:
    high, free = found.level > _UNKNOWN, found.level < _UNKNOWN
    inside = np.mean(found.plane.occupancy > _UNKNOWN)
    denser = inside / high.sum() / ((1.0 - inside) / np.sum(found.level <= _UNKNOWN))
    text = (
        "most samples are where the probability is the highest (samples per area where it is above "
        "0.5, over the rest of the beam; by number half, as of any Gaussian in the plane)"
    )
    yield at_least(text, denser, 2.0, own=True)
    text = "free space is not represented (share of its cells that the interpolated surface has)"
    yield at_most(text, np.mean(np.isfinite(found.surface[free])), 0.1, own=True)
    text = "elsewhere the surface is the grid's (95 % of the differences)"
    off = np.nanpercentile(np.abs(found.surface - found.level), 95.0)
    yield at_most(text, off, 0.05, own=True)


def _claims_4_9(found: KnownPoses) -> Claims:
    served = np.bincount(found.pair.new)
    text = "several a priori samples are associated with the same new one (most)"
    yield at_least(text, served.max(initial=0), 2)
    text = "it is no exception (share of the associated new samples that serve several)"
    yield at_least(text, np.sum(served > 1) / np.sum(served > 0), 0.1, own=True)


def _claims_4_11(found: KnownPoses) -> Claims:
    high = _cells(found.box, _CELL_M)[found.height > 0.5 * found.peak.max()]
    text = "the Gaussians are of equal height (highest over lowest)"
    yield at_most(text, found.peak.max() / found.peak.min(), 1.0 + 1e-9)
    text = "their sum is normalised (its integral over the plane)"
    yield within(text, found.height.sum() * _CELL_M**2, (0.99, 1.01), own=True)
    text = "it shows the scan (95 % of the distances to a return of what is above half a peak)"
    off_m = cKDTree(found.point).query(high)[0]
    yield at_most(text, np.percentile(off_m, 95.0), _NEAR_M, "m", own=True)


def _draw_2_5(canvas: Canvas, found: KnownPoses) -> None:
    axis, world, (east, north) = canvas.add_subplot(), occupancy().world, found.grid.point.T
    axis.set_facecolor("0.5")
    axis.scatter(east, north, s=2.0, marker="s", linewidths=0, c=found.grid.occupancy,
                 cmap="gray_r", vmin=0.0, vmax=1.0, rasterized=True)  # fmt: skip
    draw_surfaces(axis, world.segment)
    draw_trajectory(axis, world.path, SMOOTHER_COLOUR, "path", "--")
    plan(axis, "occupancy grid (black 1, white 0) and true objects (red)", legend="lower right")
    axis.grid(visible=False)
    frame(axis, world.segment.reshape(-1, 2), 3.0)


def _draw_4_1_3(canvas: Canvas, found: KnownPoses) -> None:
    axis, tree = canvas.add_subplot(), found.tree
    square = tree.corner[:, None] + tree.side_m[:, None, None] * _SQUARE
    leaves = PolyCollection(square, edgecolors="#999999", linewidths=0.2, cmap="gray_r")
    leaves.set(array=tree.occupancy, clim=(0.0, 1.0), rasterized=True)
    axis.add_collection(leaves)
    draw_surfaces(axis, occupancy().world.segment)
    plan(axis, f"leaves of a quadtree, alike within {_ALIKE:g}; true objects (red)", legend=None)
    axis.grid(visible=False)
    frame(axis, occupancy().world.outline[0].mean(axis=0)[None], _TREE_M)


def _draw_4_7(canvas: Canvas, found: KnownPoses) -> None:
    axis, (at_m, level, density) = canvas.add_subplot(), found.curves
    axis.plot(at_m, level, "-", color=SMOOTHER_COLOUR, label="occupancy distribution")
    axis.plot(at_m, density, "--", color=_GREEN, label="sensor model over its peak")
    drawn = np.hypot(*found.line.point.T)
    axis.plot(drawn, 0.0 * drawn - 0.03, "|", color=EKF_COLOUR, alpha=0.3, label="samples drawn")
    axis.plot(drawn, found.line.occupancy, ".", color=EKF_COLOUR, markersize=3, label="propagated")
    chart(axis, f"{SAMPLES} samples of a range of {RANGE_M:g} m", "range [m]", "probability")


def _draw_4_8(canvas: Canvas, found: KnownPoses) -> None:
    axes, samples = canvas.subplots(1, 3, sharex=True, sharey=True), found.plane.point.T
    drawn = axes[0].scatter(*samples, s=4.0, c=found.plane.occupancy, vmin=0.3, vmax=0.9)
    _scanned(axes[0], "(a) samples")
    _heights(axes[1], "(b) interpolated from them", _BEAM, found.surface, (0.3, 0.9))
    _heights(axes[2], "(c) grid, and the samples", _BEAM, found.level, (0.3, 0.9))
    axes[2].plot(*samples, ".", color=EKF_COLOUR, markersize=0.8)
    axes[0].set(xlim=(5.0, 6.6), ylim=(0.5, 1.6))
    canvas.colorbar(drawn, ax=list(axes), label="probability of being occupied", shrink=0.8)


def _draw_4_9(canvas: Canvas, found: KnownPoses) -> None:
    axis, old, new, pair = canvas.add_subplot(), found.old.point, found.new.point, found.pair
    draw_lines(axis, np.stack((old[pair.old], new[pair.new]), axis=1), EKF_COLOUR, "associations")
    axis.plot(*old.T, ".", color=_GREEN, markersize=8, label="a priori map")
    axis.plot(*new.T, "+", color=SMOOTHER_COLOUR, markersize=8, label="new samples")
    plan(axis, f"nearest neighbours, d_min {D_MIN_M:g} m", legend="best")
    frame(axis, new[np.bincount(pair.new).argmax()][None], 1.5)


def _draw_4_11(canvas: Canvas, found: KnownPoses) -> None:
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    left.plot(*found.point.T, ".", color=SMOOTHER_COLOUR, markersize=4)
    left.plot(0.0, 0.0, "^", color=EKF_COLOUR)
    _scanned(left, "returns, and the scanner (red)")
    height, title = found.height / found.peak.max(), "sum of Gaussians of equal height"
    drawn = _heights(right, title, found.box, height, (0.0, 2.0))
    canvas.colorbar(drawn, ax=right, label="sum of Gaussians of peak 1", shrink=0.8)


def _heights(
    axis: Axes, title: str, box: Array, value: Array, limits: tuple[float, float]
) -> AxesImage:
    west, south, east, north = box.tolist()
    extent, (low, high) = (west, east, south, north), limits
    drawn = axis.imshow(value, extent=extent, origin="lower", vmin=low, vmax=high)
    _scanned(axis, title)
    return drawn


def _scanned(axis: Axes, title: str) -> None:
    axis.set_aspect("equal")
    chart(axis, title, "ahead [m]", "left [m]", legend=None)
    axis.grid(visible=False)


FIGURES = (
    Figure(
        name="N2.5", title="An occupancy grid by known poses",
        says="Every object is represented in the grid, whatever its geometry.",
        experiment=KNOWN, draw=_draw_2_5, claims=_claims_2_5, size=(8.5, 7.0),
    ),
    Figure(
        name="N4.1.3", title="An occupancy grid as a quadtree", place="section 4.1.3",
        says="A classic grid has one resolution everywhere, unless it is a quadtree.",
        experiment=KNOWN, draw=_draw_4_1_3, claims=_claims_4_1_3, size=(8.0, 7.0),
    ),
    Figure(
        name="N4.7", title="Samples of a range sensor's occupancy distribution",
        says="Most samples of the sensor model have a high probability of being occupied, almost "
        "none are in free and unknown space.",
        experiment=KNOWN, draw=_draw_4_7, claims=_claims_4_7, size=(8.0, 4.6),
    ),
    Figure(
        name="N4.8", title="Samples of a range and bearing sensor's occupancy distribution",
        says="Most samples are where the probability of being occupied is the highest.",
        experiment=KNOWN, draw=_draw_4_8, claims=_claims_4_8, size=(13.0, 3.8),
    ),
    Figure(
        name="N4.9", title="Nearest neighbours of particles",
        says="One new sample may update several samples of the a priori map.",
        experiment=KNOWN, draw=_draw_4_9, claims=_claims_4_9, size=(7.0, 6.4),
    ),
    Figure(
        name="N4.11", title="A scan as a sum of Gaussians",
        says="The points of a scan are a sum of Gaussians, here of equal height.",
        experiment=KNOWN, draw=_draw_4_11, claims=_claims_4_11, size=(12.0, 6.0),
    ),
)  # fmt: skip
