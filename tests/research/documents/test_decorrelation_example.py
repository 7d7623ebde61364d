"""Examples 3.1 and 3.2 of the thesis in our simulation of its section 2.9."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.simulate.drive import Drive, true_drive
from comparisons.logs.simulate.worlds import nieto_loop
from ekf_reference.dense.conditions import Conditions
from ekf_reference.dense.triangles import contains, to_local
from research.documents.nieto_regions import (
    Cast,
    DecorrelationExample,
    closing_s,
    decorrelation_example,
    fused_until,
    rightmost,
)
from tests.helpers import present, simulated

NORTH = 1
SCAN_S = 0.2


@cache
def driven(seed: int) -> Log:
    return simulated(seed, extra_s=10.0)


@cache
def example(seed: int) -> DecorrelationExample:
    return decorrelation_example(driven(seed))


@pytest.mark.parametrize("seed", range(6))
def test_example_3_1_correlation_falls_from_above_095_to_below_01(seed: int) -> None:
    """From when the point is fused until the loop closes, as in Fig. 3.5 (b) and (c).

    In east, and in (d), the thesis' figures are not met: N3.5 has these claims.
    """
    shown, log = example(seed), driven(seed)
    before, found = shown.time_s < closing_s(log) - 1e-6, shown.correlations
    until_closing = (closing_s(log) - rightmost(log).fused_s) / SCAN_S
    assert before.sum() == round(until_closing)
    assert found.world[before, NORTH, NORTH].min() > 0.95
    assert found.local[before].max() < 0.1
    assert shown.with_base[before].min() > 0.9


def test_example_3_2_local_change_is_a_fifth_of_the_global_one() -> None:
    """At the closing of the loop, in the median; the thesis shows 0.1 m against 0.5 m."""
    moved = [example(seed).moved for seed in range(6)]
    assert np.median([m.local_m.max() / m.world_m.max() for m in moved]) < 0.2
    assert min(m.world_m.max() for m in moved) > 0.2


@cache
def by_hand() -> tuple[int, set[int], float]:
    """Labels of point and base, and the time, from the drive's geometry, one by one."""
    drive, world = Drive(extra_s=10.0), nieto_loop()
    time, _, pose = true_drive(drive, world)
    views = []
    for k in range(drive.scan_every, len(time), drive.scan_every):
        x, y = (world.landmark - pose[k, :2]).T
        ahead = x * np.cos(pose[k, 2]) + y * np.sin(pose[k, 2]) >= 0.0
        views.append((time[k], set(np.flatnonzero(ahead & (np.hypot(x, y) <= 20.0)).tolist())))
    best: tuple[float, float, int, set[int], float] | None = None
    for when, seen in views:
        for point in seen:
            east = float(world.landmark[point, 0])
            if best is not None and east < -best[0]:
                continue
            for base in combinations(seen - {point}, 3):
                a, b, c = world.landmark[list(base)]
                if all_left(world.landmark[point], a, b, c):
                    around = sum(np.linalg.norm(p - q) for p, q in ((a, b), (b, c), (c, a)))
                    one = (-east, round(float(around), 6), point, set(base), when)
                    if best is None or one[:2] <= best[:2]:
                        best = one
    assert best is not None
    return best[2], best[3], best[4]


def all_left(point: Array, *corner: Array) -> bool:
    """Inside: on one side of all three edges."""
    sides = [
        np.sign((q[0] - p[0]) * (point[1] - p[1]) - (q[1] - p[1]) * (point[0] - p[0]))
        for p, q in zip(corner, corner[1:] + corner[:1], strict=True)
    ]
    return bool(np.ptp(sides) == 0)


def labels(log: Log, cast: Cast) -> tuple[int, set[int], float]:
    order = log.measurements.labels_in_order
    return int(order[cast.point]), set(order[list(cast.base)].tolist()), cast.fused_s


def test_the_cast_is_what_the_geometry_gives_in_every_drive() -> None:
    for seed in range(3):
        point, base, fused_s = labels(driven(seed), rightmost(driven(seed)))
        assert (point, base) == by_hand()[:2]
        assert fused_s == pytest.approx(by_hand()[2])


def test_another_view_or_another_world_gives_another_cast() -> None:
    log = driven(0)
    point, base, _ = by_hand()
    hidden = replace(
        log, measurements=log.measurements.chosen(log.measurements.landmark != min(base))
    )
    assert labels(hidden, rightmost(hidden))[1] != base
    true = present(log.truth.landmarks)
    moved = true.position_m.copy()
    moved[true.id == point] -= (30.0, 0.0)
    other = replace(log, truth=replace(log.truth, landmarks=replace(true, position_m=moved)))
    assert labels(other, rightmost(other))[0] != point


def test_the_example_is_of_a_point_within_its_triangle_that_is_never_seen_again() -> None:
    shown = example(0)
    triangle = shown.triangle[0]
    assert contains(to_local(triangle, shown.point[0]))
    cast = rightmost(driven(0))
    joint = next(fused_until(driven(0), cast)).among(*cast.base)
    assert Conditions().pairs(triangle, joint)[np.triu_indices(3, 1)].all()
    assert Conditions().well_conditioned(triangle[None], joint[None]).all()
    assert np.linalg.norm(shown.distant[0] - shown.point[0]) > 10.0
    assert np.linalg.norm(shown.point - shown.true_point, axis=1).max() < 1.5
    with pytest.raises(InputError, match="within three others"):
        decorrelation_example(simulated(0, loop_s=0.4))
