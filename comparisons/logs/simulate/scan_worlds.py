"""Environments for raw scans: objects with outlines, round poles, a path among them.

Nieto 2005 shows these environments in figures only. Their extent, what they hold and how they
are driven follow the thesis; where each object stands, and all heights, are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from comparisons.arrays import Array
from comparisons.logs.log import Surfaces
from comparisons.logs.simulate.polygons import sides
from comparisons.logs.simulate.ray_casting import Solids
from comparisons.logs.simulate.worlds import LandmarkWorld

MORE_LANDMARKS = 80
"""So many are added among and behind the objects; the number is ours."""
_POLE_SIDES = 32
_PATH_STEP_M = 0.125
_FROM_PATH_M, _FROM_OBJECTS_M, _APART_M = 4.0, 1.5, 2.0
"""Least distances of landmarks: from the path, from objects, of one that is added from others."""


class Moving(Protocol):
    """An upright round thing whose place is a matter of time."""

    @property
    def diameter_m(self) -> float:
        """Across."""

    @property
    def height_m(self) -> float:
        """Over the ground."""

    def place(self, time_s: Array) -> Array:
        """(N, 2) at times (N,), NaN while it is nowhere."""


@dataclass(frozen=True, kw_only=True)
class Mover:
    """A disc that goes from start to end (2,) [m] and back, for ever, at constant speed.

    lead_s: how long it has been on its way when the log begins. back: False for one that, at the
    end, is at the start again at once, as traffic on a lane is.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    speed_mps: float
    diameter_m: float = 0.5
    height_m: float = 1.7
    lead_s: float = 0.0
    back: bool = True

    def place(self, time_s: Array) -> Array:
        """(N, 2) at times (N,)."""
        start, way = np.array(self.start), np.array(self.end) - self.start
        length = float(np.hypot(*way))
        period = 2.0 * length if self.back else length
        gone = np.mod(self.speed_mps * (time_s + self.lead_s), period)
        part = np.minimum(gone, 2.0 * length - gone) / length
        return start + part[:, None] * way


@dataclass(frozen=True, kw_only=True)
class ScanWorld(LandmarkWorld):
    """A closed path (P, 2) among things that a scanner sees, and landmarks (L, 2), maybe none.

    outline: closed polygons (K, 2), the first corner not repeated, and their heights (O,).
    pole: (M, 3) x, y, diameter [m], and their heights (M,). movers: what does not stand still.
    carrier: numbers of the movers that a landmark stands on, in the middle.
    """

    outline: tuple[Array, ...] = ()
    outline_height_m: Array = field(default_factory=lambda: np.zeros(0))
    pole: Array = field(default_factory=lambda: np.zeros((0, 3)))
    pole_height_m: Array = field(default_factory=lambda: np.zeros(0))
    movers: tuple[Moving, ...] = ()
    carrier: tuple[int, ...] = ()

    def landmarks_at(self, time_s: Array) -> Array:
        """(N, L + C, 2) at times (N,): those that stand, then those carried; NaN nowhere."""
        still = np.broadcast_to(self.landmark, (len(time_s), *self.landmark.shape))
        carried = [self.movers[k].place(time_s)[:, None] for k in self.carrier]
        return np.concatenate((still, *carried), axis=1)

    @property
    def loop_m(self) -> float:
        """Length of the path."""
        return float(np.linalg.norm(np.roll(self.path, -1, axis=0) - self.path, axis=1).sum())

    @property
    def segment(self) -> Array:
        """(S, 4) the sides of all outlines."""
        return np.vstack([np.zeros((0, 4)), *(sides(corner) for corner in self.outline)])

    def solids(self) -> Solids:
        """All that stands still."""
        count = [len(corner) for corner in self.outline]
        return Solids(
            self.segment,
            np.repeat(np.arange(len(count)), count),
            self.outline_height_m,
            self.pole,
            self.pole_height_m,
        )

    def is_free(self, place: Array, solids: Solids) -> bool:
        """No object is at a place (2,) [m] or near it. solids: this world's."""
        inside = any(_encloses(corner, place) for corner in self.outline)
        return not inside and not len(solids.within(place, _FROM_OBJECTS_M).segment)

    def surfaces(self) -> Surfaces:
        """The outlines exactly, the poles as polygons of equal area: within 0.5 % of the radius."""
        turn = 2.0 * np.pi / _POLE_SIDES * np.arange(_POLE_SIDES)
        corner = np.sqrt(turn[1] / np.sin(turn[1])) * np.column_stack((np.cos(turn), np.sin(turn)))
        poles = [sides(pole[:2] + 0.5 * pole[2] * corner) for pole in self.pole]
        return Surfaces(np.vstack((self.segment, *poles)))


def dense_slam_world() -> ScanWorld:
    """Nieto 2005, section 3.9 and Fig. 3.17: 100 m x 80 m, point landmarks and objects.

    Driven counter-clockwise from the origin, so that the left is reached last. The landmarks
    are thin poles, which the scanner sees as well.
    """
    objects: tuple[PlacedShape, ...] = (
        ("bay", 4, 27, 22, 14, 10), ("ell", -17, 24, 14, 14, 80), ("cross", 27, 26, 12, 12, 20),
        ("box", -13, 45, 9, 5, -15), ("wedge", 6, 45, 10, 8, 5), ("hexagon", 24, 42, 9, 8, 0),
        ("wedge", -27, -5, 16, 10, 20), ("box", 8, -9, 14, 3, 3), ("drum", 34, -5, 6, 6, 0),
        ("box", 52, 20, 3, 20, -5), ("ell", 46, 52, 10, 12, 200), ("trapezoid", 16, 66, 14, 6, 4),
        ("box", -10, 66, 16, 4, -3), ("hexagon", -40, 58, 10, 9, 15), ("box", -45, 26, 3, 18, 6),
    )  # fmt: skip
    return with_landmarks(_PATH_OF_100_BY_80, objects)


def occupancy_world() -> ScanWorld:
    """Nieto 2005, section 4.1.3 and Fig. 4.2: like Fig. 3.17, with other objects.

    Three objects stand at the top of the middle. The one at the bottom left is seen from one
    side at the start and from the other at the end.
    """
    objects: tuple[PlacedShape, ...] = (
        ("box", -14, 43, 10, 7, 0), ("drum", 5, 45, 8, 8, 0), ("wedge", 24, 42, 10, 9, 180),
        ("bay", -17, 14, 14, 12, 20), ("cross", 8, 20, 13, 13, 0), ("ell", 31, 20, 11, 13, 90),
        ("hexagon", 30, -6, 7, 7, 0), ("box", 2, -9, 18, 3, 0), ("wedge", -33, -8, 10, 8, 140),
        ("trapezoid", 52, 28, 16, 5, 90), ("box", 44, 55, 12, 8, -40), ("ell", 4, 66, 12, 7, 180),
        ("hexagon", -30, 63, 10, 8, 0), ("box", -46, 34, 4, 22, 0),
    )  # fmt: skip
    return with_landmarks(_PATH_OF_100_BY_80, objects)


def dense_scan_slam_world() -> ScanWorld:
    """Nieto 2005, section 6.2.1 and Fig. 6.7: 120 m x 100 m, objects alone.

    The path and most objects are those of Fig. 4.2.
    """
    return with_poles(occupancy_world(), np.zeros((0, 2)))


def scan_slam_world() -> ScanWorld:
    """Nieto 2005, section 5.6 and Fig. 5.8: 180 m x 160 m, objects of many shapes, no landmarks."""
    objects: tuple[PlacedShape, ...] = (
        ("box", 18, -9, 16, 4, 5), ("ell", 20, 14, 12, 14, 10), ("wedge", 46, -8, 10, 7, 0),
        ("hexagon", 46, 14, 9, 9, 0), ("trapezoid", 72, -4, 14, 8, 25),
        ("box", 68, 28, 12, 7, 60), ("bay", 95, 30, 14, 7, 80), ("cross", 70, 52, 12, 12, 30),
        ("box", 95, 58, 4, 18, -4), ("wedge", 74, 78, 12, 11, 100), ("drum", 96, 84, 7, 7, 0),
        ("ell", 94, 112, 10, 14, 200), ("box", 74, 98, 9, 6, -20),
        ("trapezoid", 84, 130, 16, 6, -50), ("cross", 56, 112, 11, 11, 0),
        ("box", 58, 141, 18, 5, -8), ("hexagon", 34, 112, 10, 8, 20),
        ("wedge", 32, 140, 12, 8, 0), ("bay", 10, 119, 14, 9, 185), ("box", 8, 146, 16, 4, 4),
        ("drum", -14, 120, 8, 8, 0), ("ell", -20, 145, 14, 8, 180), ("box", -38, 118, 11, 8, 40),
        ("hexagon", -50, 140, 12, 9, 30), ("cross", -46, 96, 10, 10, 15),
        ("trapezoid", -77, 118, 16, 5, 80), ("wedge", -48, 76, 9, 9, 60),
        ("box", -78, 84, 4, 16, 4), ("drum", -64, 56, 7, 7, 0), ("bay", -38, 46, 12, 10, 100),
        ("ell", -73, 34, 10, 13, 30), ("box", -48, 26, 9, 10, -20), ("hexagon", -64, 3, 9, 8, 0),
        ("wedge", -32, -8, 14, 7, 10), ("trapezoid", -22, 16, 14, 9, 15),
        ("drum", -6, -9, 6, 6, 0),
    )  # fmt: skip
    corners = (
        (0, 0), (35, 1), (66, 8), (84, 30), (83, 60), (86, 90), (72, 118), (44, 127), (14, 133),
        (-16, 133), (-46, 128), (-65, 106), (-66, 80), (-53, 58), (-62, 38), (-58, 17), (-32, 2),
    )  # fmt: skip
    return _without_landmarks(_path(corners), objects)


_PATH_OF_100_BY_80 = (
    (0, 0), (20, 0), (37, 6), (45, 22), (40, 41), (25, 54), (5, 57), (-16, 56), (-32, 46),
    (-37, 26), (-32, 9), (-17, 1),
)  # fmt: skip
"""Through these the loop is driven, in order."""

_ARM = 1.0 / 6.0
_SHAPES = {
    "box": ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)),
    "wedge": ((-0.5, -0.5), (0.5, -0.5), (-0.1, 0.5)),
    "trapezoid": ((-0.5, -0.5), (0.5, -0.5), (0.25, 0.5), (-0.3, 0.5)),
    "ell": ((-0.5, -0.5), (0.5, -0.5), (0.5, -0.1), (-0.1, -0.1), (-0.1, 0.5), (-0.5, 0.5)),
    "bay": (
        (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (0.25, 0.5), (0.25, -0.15), (-0.25, -0.15),
        (-0.25, 0.5), (-0.5, 0.5),
    ),
    "cross": (
        (-_ARM, -0.5), (_ARM, -0.5), (_ARM, -_ARM), (0.5, -_ARM), (0.5, _ARM), (_ARM, _ARM),
        (_ARM, 0.5), (-_ARM, 0.5), (-_ARM, _ARM), (-0.5, _ARM), (-0.5, -_ARM), (-_ARM, -_ARM),
    ),
    "hexagon": tuple((0.5 * np.cos(t), 0.5 * np.sin(t)) for t in np.pi / 3 * np.arange(6)),
    "drum": tuple((0.5 * np.cos(t), 0.5 * np.sin(t)) for t in np.pi / 10 * np.arange(20)),
}  # fmt: skip
"""Outlines within a unit square about the origin, counter-clockwise."""

_HEIGHTS_M = (6.0, 1.2, 3.0, 8.0, 1.5, 4.0)
_POLE_M = 0.3
_POLE_HEIGHT_M = 4.0

PlacedShape = tuple[str, float, float, float, float, float]
"""Shape, x, y of its middle, length and width [m], turn [deg]."""


def placed_shapes(objects: tuple[PlacedShape, ...]) -> tuple[tuple[Array, ...], Array]:
    """Outlines and heights: what has one shape differs in height, some lower than a vehicle."""
    outline = []
    for shape, x, y, length, width, turn_deg in objects:
        cos, sin = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
        corner = np.array(_SHAPES[shape]) * (length, width)
        outline.append(corner @ np.array([[cos, sin], [-sin, cos]]) + (x, y))
    height = np.resize(_HEIGHTS_M, len(outline)).astype(float)
    return tuple(outline), height


def _without_landmarks(path: Array, objects: tuple[PlacedShape, ...]) -> ScanWorld:
    outline, height_m = placed_shapes(objects)
    nowhere = np.zeros((0, 2))
    return ScanWorld(path=path, landmark=nowhere, outline=outline, outline_height_m=height_m)


def _path(corners: tuple[tuple[float, float], ...]) -> Array:
    """(P, 2) evenly along the smooth closed curve through points."""
    closed = np.array((*corners, corners[0]), dtype=float)
    knot = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
    curve = CubicSpline(knot, closed, bc_type="periodic")
    fine = curve(np.linspace(0.0, knot[-1], 20 * round(knot[-1] / _PATH_STEP_M)))
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1)))
    even = np.linspace(0.0, way[-1], round(way[-1] / _PATH_STEP_M), endpoint=False)
    return np.column_stack([np.interp(even, way, column) for column in fine.T])


def with_landmarks(
    corners: tuple[tuple[float, float], ...], objects: tuple[PlacedShape, ...]
) -> ScanWorld:
    """Landmarks every few metres, now left, now right of the path, where no object is near."""
    path = _path(corners)
    world = _without_landmarks(path, objects)
    solids = world.solids()
    tangent = np.roll(path, -1, axis=0) - path
    left = np.column_stack((-tangent[:, 1], tangent[:, 0])) / _PATH_STEP_M
    every = round(5.0 / _PATH_STEP_M)
    landmark = []
    for i, at in enumerate(range(0, len(path) - every, every)):
        beside = (5.0 + 4.0 * np.modf(0.618 * i)[0]) * (-1.0) ** i
        candidate = path[at] + beside * left[at]
        clear = np.linalg.norm(path - candidate, axis=1).min() > _FROM_PATH_M
        if clear and world.is_free(candidate, solids):
            landmark.append(candidate)
    return with_poles(world, np.array(landmark))


def with_landmarks_among(world: ScanWorld, more: int = MORE_LANDMARKS) -> ScanWorld:
    """So many landmarks more among and behind the objects, within the world's extent.

    The same world has them at the same places. The thesis' regions are triangles of landmarks that
    enclose objects (Nieto 2005, sections 3.4 and 3.5); those of `with_landmarks` line the path.
    """
    rng, solids = np.random.default_rng(0), world.solids()
    everything = np.vstack((world.path, world.landmark, *world.outline))
    low, high = everything.min(axis=0), everything.max(axis=0)
    place = world.landmark
    while len(place) < len(world.landmark) + more:
        candidate = rng.uniform(low, high)
        clear = np.linalg.norm(world.path - candidate, axis=1).min() > _FROM_PATH_M
        alone = not len(place) or np.linalg.norm(place - candidate, axis=1).min() > _APART_M
        if clear and alone and world.is_free(candidate, solids):
            place = np.vstack((place, candidate))
    return with_poles(world, place)


def with_poles(world: ScanWorld, place: Array) -> ScanWorld:
    """The world with a thin pole at each of these landmarks (L, 2), and no other poles."""
    return replace(
        world,
        landmark=place,
        pole=np.column_stack((place, np.full(len(place), _POLE_M))),
        pole_height_m=np.full(len(place), _POLE_HEIGHT_M),
    )


def _encloses(corner: Array, point: Array) -> bool:
    """The point is inside the polygon: a ray to the right crosses an odd number of sides."""
    x1, y1, x2, y2 = (sides(corner) - np.tile(point, 2)).T
    crossed = (y1 < 0.0) != (y2 < 0.0)
    way = x1[crossed] - y1[crossed] * (x2 - x1)[crossed] / (y2 - y1)[crossed]
    return bool(np.count_nonzero(way > 0.0) % 2)
