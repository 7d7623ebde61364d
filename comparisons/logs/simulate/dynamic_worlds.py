"""Worlds in which something moves (Nieto 2005, sections 6.3.3 and 6.5, Figs. 6.9, 6.10 and 6.19).

The thesis shows both in figures only: what they hold follows it, where each thing stands is ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from comparisons.arrays import Array
from comparisons.logs.readers.victoria_park import UTE
from comparisons.logs.simulate.polygons import along_sides
from comparisons.logs.simulate.scan_worlds import (
    Mover,
    Moving,
    PlacedShape,
    ScanWorld,
    placed_shapes,
    with_landmarks,
    with_poles,
)

LANES_M = (5.0, -5.0)
"""North of the two lanes; the first leads east (Nieto 2005, section 6.3.3)."""
CHANGE_S = 40.0
"""When the three places of `places_world` change: between two passes."""

CARS_LEAVE_S = 31.5
"""When the three cars of `parked_world` leave: as its first lap ends."""

_LANE_M = 66.0


@dataclass(frozen=True)
class Displaced:
    """A disc that stands in one place until `change_s` and in another from then on.

    before, after: (2,) [m], None for nowhere: what is brought, or taken away.
    """

    before: tuple[float, float] | None
    after: tuple[float, float] | None
    change_s: float
    diameter_m: float = 1.6
    height_m: float = 1.7

    def place(self, time_s: Array) -> Array:
        """(N, 2) at times (N,), NaN while it is nowhere."""
        nowhere = (np.nan, np.nan)
        places = np.array((self.before or nowhere, self.after or nowhere))
        where: Array = places[(time_s >= self.change_s).astype(int)]
        return where


def lanes_world(*, carried: bool = False) -> ScanWorld:
    """A standing sensor at the origin, looking east along two lanes of traffic (Fig. 6.9).

    Vehicles turn a slanting side to the sensor, 6 m long and 3 m deep, made of discs, so that all
    of a lane is seen to be driven on; they begin and end out of reach.
    carried: a landmark stands on the vehicle that passes first on the first lane.
    """
    a, b = UTE.sensor_forward_m, UTE.sensor_left_m
    path = np.column_stack((0.125 * np.arange(200.0) - a, np.full(200, -b)))
    place = np.array(
        [
            (2.0, 2.2), (8.0, -2.0), (15.0, 2.3), (16.0, -2.2), (1.0, -2.4),
            (1.0, 9.0), (9.0, 8.0), (17.0, 8.6),
            (1.5, -8.5), (10.0, -8.2), (18.0, -8.4),
        ]
    )  # fmt: skip
    objects: tuple[PlacedShape, ...] = (
        ("box", 12, 0, 3, 1.5, 20), ("box", 20, 0.2, 2, 2, 0), ("box", 12, 12, 10, 3, 4),
        ("ell", 24, 12, 6, 5, 180), ("box", 8, -12, 12, 3, -3), ("hexagon", 20, -12, 6, 5, 0),
    )  # fmt: skip
    movers = tuple(
        _driving(north, towards, vehicle, part / (_DISCS - 1.0))
        for north, towards in zip(LANES_M, (1.0, -1.0), strict=True)
        for vehicle in range(_VEHICLES)
        for part in range(_DISCS)
    )
    outline, height_m = placed_shapes(objects)
    world = ScanWorld(
        path=path,
        landmark=place,
        outline=outline,
        outline_height_m=height_m,
        movers=movers,
        carrier=(2 * _DISCS + _DISCS // 2,) if carried else (),
    )
    return with_poles(world, place)


_VEHICLES, _DISCS = 4, 19
_LENGTH_M, _BREADTH_M, _DISC_M = 6.0, 2.8, 0.4
_SPEED_MPS = 2.0


def _driving(north: float, towards: float, vehicle: int, part: float) -> Mover:
    """One disc of a vehicle's side, part being 0 at its near end and 1 at its far one."""
    y = north + np.sign(north) * _BREADTH_M * (part - 0.5)
    lead_m = vehicle * _LANE_M / _VEHICLES - towards * _LENGTH_M * part
    start, end = (-0.5 * towards * _LANE_M, y), (0.5 * towards * _LANE_M, y)
    return Mover(
        start=start,
        end=end,
        speed_mps=_SPEED_MPS,
        diameter_m=_DISC_M,
        lead_s=lead_m / _SPEED_MPS,
        back=False,
    )


def places_world(*, carried: bool = False) -> ScanWorld:
    """A small loop; at CHANGE_S one object is taken away and two are brought (Fig. 6.10).

    All that is moved is round. carried: a landmark stands on what is taken away.
    """
    objects: tuple[PlacedShape, ...] = (
        ("box", 8, 21, 9, 3, 4), ("wedge", 20, 16, 6, 5, 30), ("hexagon", -3, 16, 4, 4, 0),
        ("box", 9, -7, 14, 2, -2), ("ell", 31, 12, 5, 6, 90), ("box", -14, 12, 2, 12, 5),
        ("trapezoid", 8, 34, 12, 3, 180), ("box", 29, -4, 4, 3, 45), ("bay", -10, 30, 6, 5, 60),
    )  # fmt: skip
    corners = (
        (0, 0), (10, -1), (20, 2), (25, 10), (24, 19), (17, 26), (7, 28), (-3, 26), (-8, 18),
        (-8, 8),
    )  # fmt: skip
    world = with_landmarks(corners, objects)
    movers = (
        Displaced((11.0, 9.0), None, CHANGE_S),
        Displaced(None, (20.0, 7.5), CHANGE_S),
        Displaced(None, (2.0, 8.0), CHANGE_S),
    )
    return replace(world, movers=movers, carrier=(0,) if carried else ())


_CAR_M = (4.4, 1.8)
_LEAVING = ((10.8, -8.5, 90.0), (13.0, -8.5, 90.0), (15.0, 24.5, 2.0))
_STAYING = (
    (0.0, -8.7), (2.4, -8.5), (21.6, -8.3), (24.0, -8.5), (2.0, 8.5), (4.4, 8.5), (15.0, 8.7),
    (20.0, 8.4), (0.0, 26.0), (2.4, 26.2), (25.0, 26.0),
)  # fmt: skip


def parked_world() -> ScanWorld:
    """A car park between walls, driven around its middle row; at CARS_LEAVE_S three cars leave.

    Two of them are neighbours. Cars that leave are boxes made of discs (Fig. 6.19).
    """
    corners = ((-7, 8), (0, 0), (12, -1), (24, 0), (31, 8), (24, 17), (12, 18), (0, 17))
    walls: tuple[PlacedShape, ...] = (
        ("box", 38, 8, 3, 16, 3), ("box", -17, 8, 6, 12, 3), ("box", 10, -17, 44, 3, 0),
        ("box", 9, 34, 34, 3, 0),
    )  # fmt: skip
    lamp = np.array(
        [
            (-6, -13), (6.5, -12.5), (18, -12.5), (28, -13), (-4, -6.5), (6.5, -7), (17.5, -7),
            (28.5, -6.5), (-1.5, 8.5), (9.5, 7), (9.5, 10.5), (25, 8.5), (-4, 24), (7.5, 24.5),
            (20, 24), (30, 24.5), (-4, 30), (8, 30.5), (20, 30.5), (31, 30),
        ]
    )  # fmt: skip
    cars = tuple(("box", *place, *_CAR_M, 90.0) for place in _STAYING)
    movers = tuple(
        Displaced((x, y), None, CARS_LEAVE_S, _DISC_M)
        for corner in leaving_cars(_DISC_M)
        for x, y in along_sides(corner, 0.6 * _DISC_M).tolist()
    )
    return replace(with_poles(with_landmarks(corners, (*cars, *walls)), lamp), movers=movers)


def leaving_cars(less_m: float = 0.0) -> tuple[Array, ...]:
    """Outlines (4, 2) [m] of the cars that leave, counter-clockwise; so much shorter, narrower."""
    length, width = _CAR_M
    shapes = tuple(("box", x, y, length - less_m, width - less_m, t) for x, y, t in _LEAVING)
    return placed_shapes(shapes)[0]


def moved_over(movers: tuple[Moving, ...], point: Array, time_s: Array) -> NDArray[np.bool_]:
    """(N,) which points (N, 2) [m] a mover covers at some of the times (T,), and not at all."""
    count = np.zeros(len(point), dtype=int)
    for mover in movers:
        place = mover.place(time_s)
        place = place[np.isfinite(place).all(axis=1)]
        if len(place):
            tree = cKDTree(place)
            count += tree.query_ball_point(point, 0.5 * mover.diameter_m, return_length=True)
    return (count > 0) & (count < len(time_s))
