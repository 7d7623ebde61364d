"""Nieto 2005, Figs. 3.17, 3.18, 4.2 to 4.6, 4.10, 4.12 and 4.16: what they claim.

Where the thesis gives no number, "much" and "large" are taken as a factor of two. Claims about
dense maps are made twice, the second time of the same drives by the thesis' settings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.accuracy import rigid_motion
from comparisons.checks.consistency.nees import map_errors
from comparisons.experiments.reproduction.interface import Claim, at_least, at_most
from comparisons.experiments.reproduction.nieto_dense import Coarsened, Maps, Rounds
from comparisons.experiments.reproduction.watched_run import truth_in_order
from comparisons.extensions.dense_maps.accuracy import (
    OCCUPIED,
    distance_to_segments,
    error_of_points,
    near_share,
)
from comparisons.logs.log import Log
from comparisons.statistics import mean_band
from ekf_reference.dense.layers.layer import Samples

LITERALLY = "by the thesis' settings: "
"""How the text of a claim begins that is of the thesis' settings (--preset as-published)."""
_FEW = (
    "by correlation alone regions come late or never: landmarks near a well known vehicle are well "
    "known against each other but correlate little; and returns do not wait for their region"
)
_FEW_CELLS = "few returns find a region, so few cells are compared (N3.17)"
_FAR_M = 0.5
_CELLS = 2.0
"""Layers cover the same surfaces when so many cells apart or fewer."""
_LEAST = 0.5
_THIRD = 3
_COARSE_M = 0.25


class _Twice(Protocol):
    """What an experiment leaves, with the same by the thesis' settings."""

    @property
    def literal(self) -> _Twice | None: ...


D = TypeVar("D", bound=_Twice)


def _also_literally(
    why: Mapping[int, str],
) -> Callable[[Callable[[D], list[Claim]]], Callable[[D], list[Claim]]]:
    """Make claims a second time by the thesis' settings. why: by number, where another one."""

    def twice(claims: Callable[[D], list[Claim]]) -> Callable[[D], list[Claim]]:
        def both(found: D) -> list[Claim]:
            ours = claims(found)
            if found.literal is None:
                return ours
            theirs = claims(found.literal)  # type: ignore[arg-type]
            return ours + [
                replace(claim, text=LITERALLY + claim.text, why=why.get(number, claim.why))
                for number, claim in enumerate(theirs)
            ]

        both.__doc__ = claims.__doc__
        return both

    return twice


def _mean(values: Array | list[float]) -> float:
    """NaN of none."""
    return float(np.mean(values)) if len(values) else float("nan")


def _median(values: Array | list[float]) -> float:
    """NaN of none."""
    return float(np.median(values)) if len(values) else float("nan")


def _occupied(samples: Samples) -> Array:
    return samples.point[samples.occupancy > OCCUPIED]


@_also_literally({2: _FEW})
def claims_3_17(maps: Maps) -> list[Claim]:
    """The map errs most on the left, and closing the loop corrects all of it."""
    then = np.array([m.error_before("points").p95_m for m in maps.closed])
    now = np.array([m.mapping.errors["points"].p95_m for m in maps.closed])
    tallies = [m.dense.dense.tally for m in maps.all_drives]
    left, right = [], []
    for m in maps.closed:
        point = _occupied(m.before.layers["points"])
        distance = distance_to_segments(point, m.segment)
        west, east = m.thirds(point[:, 0])
        left.append(_mean(distance[west]))
        right.append(_mean(distance[east]))
    return [
        at_least(
            "before the closing the dense map errs most at the left (mean distance to the "
            "surfaces, left third over right third)",
            _mean(left) / _mean(right),
            1.0,
        ),
        at_most(
            "closing the loop corrects the whole dense map by a large part (95 % of the distances "
            "to the surfaces, after over before, median of drives)",
            _median(now / then),
            0.5,
            why="raw returns keep their own error, with Table 3.1's 1.5 degrees 0.65 m at 25 m "
            "(with the exact beams of scan-loop-fine: 0.55); the rest is the landmarks' error "
            "itself, most of it one rotation",
        ),
        at_least(
            "regions cover the area (share of the returns that found a region, at once or late, "
            "all drives)",
            sum(t.fused + t.late for t in tallies) / sum(t.returns for t in tallies),
            0.5,
        ),
    ]


@_also_literally({})
def claims_3_18(maps: Maps) -> list[Claim]:
    """Objects have the error of the landmarks around them."""
    ratios = []
    for m in maps.closed:
        point = _occupied(m.before.layers["points"])
        mine = m.thirds(m.true[: len(m.before.landmark), 0])[0]
        there = point[m.thirds(point[:, 0])[0]]
        move = rigid_motion(m.before.landmark[mine], m.true[: len(mine)][mine])
        raw, moved = (error_of_points(p, m.segment).median_m for p in (there, move(there)))
        ratios.append(moved / raw)
    return [
        at_most(
            "at the left, objects and landmarks share one shift and rotation (median distance to "
            "the surfaces once the landmarks are moved onto the true ones, over that before; "
            "median of drives)",
            _median(ratios),
            0.5,
        )
    ]


def claims_4_2(maps: Maps) -> list[Claim]:
    """Large noise, and still a map that is as good as it says."""
    squared, rms = [], []
    for mapping in maps.all_drives:
        e, true = mapping.ekf.estimate, truth_in_order(mapping.log)[1]
        mean = np.concatenate((e.pose[-1], true.ravel()))
        errors = map_errors(e.joint_mean, e.joint_covariance, mean, 0.0 * e.joint_covariance,
                            with_pose=False)  # fmt: skip
        far = int(np.argmax(np.linalg.norm(true - e.pose[0, :2], axis=1)))
        squared.append(errors.landmarks.squared[far])
        rms.append(np.sqrt(np.mean(np.sum(np.square(e.landmark - true), axis=1))))
    return [
        at_most(
            "the landmarks' errors are as large as stated (mean NEES of the farthest landmark over "
            "drives; limit: upper end of its 95 % band)",
            float(np.mean(squared)),
            mean_band(len(squared), 2).high,
        ),
        at_most(
            "with the loop closed the landmarks' error is small (median of the drives' RMS)",
            float(np.median(rms)),
            0.5,
            "m",
        ),
    ]


@_also_literally({0: _FEW_CELLS})
def claims_4_3(maps: Maps) -> list[Claim]:
    """One grid keeps its errors, a dense map is corrected along with the landmarks."""
    dense = np.array([m.errors["occupancy"].p95_m for m in maps.all_drives])
    classic = np.array([m.errors["classic"].p95_m for m in maps.all_drives])
    then = np.array([m.error_before("occupancy").p95_m for m in maps.closed])
    now = np.array([m.mapping.errors["occupancy"].p95_m for m in maps.closed])
    shape = []
    for m in maps.all_drives:
        move = rigid_motion(m.dense.landmark, truth_in_order(m.log)[1])
        inside = m.placed.locate(m.classic.point).region >= 0
        c = m.classic
        usual = Samples(c.point[inside], c.occupancy[inside], c.region[inside])
        shape.append([_off(move(_occupied(s)), m.log) for s in (m.layers["occupancy"], usual)])
    own, other = np.array(shape).T
    return [
        at_most(
            "DenseSLAM's grid is more accurate than one grid on every drive (95 % of the distances "
            "to the surfaces, largest ratio)",
            float(np.max(dense / classic)),
            1.0,
            why="where the filter ends with a map that is turned as a whole, both are off by that",
        ),
        at_most(
            "it fits the landmark map, where one grid is misshapen (the same once the landmarks "
            "are moved onto the true ones, median ratio)",
            float(np.median(own / other)),
            0.5,
        ),
        at_most(
            "because the closing corrects it (95 %, after over before, median of drives)",
            _median(now / then),
            0.5,
            why="what is left is the error of the landmarks themselves",
        ),
        at_most(
            "it is much more accurate on the whole (95 % of the distances, median ratio)",
            float(np.median(dense / classic)),
            0.5,
            why="both carry the error of the landmarks themselves",
        ),
    ]


def _off(point: Array, log: Log) -> float:
    surfaces = log.truth.surfaces
    segment = np.empty((0, 4)) if surfaces is None else surfaces.segment
    return error_of_points(point, segment).p95_m


@_also_literally({})
def claims_4_4(found: Rounds) -> list[Claim]:
    """Walls in one grid are wider, and shapes are lost."""
    last = found.each[-1]
    move = rigid_motion(last.landmark, last.true)
    far = [
        float(np.mean(distance_to_segments(move(_occupied(s)), found.segment) > _FAR_M))
        for s in (last.classic, last.dense)
    ]
    return [
        at_least(
            "walls are wider in one grid (occupied cells, over DenseSLAM's)",
            last.classic_error.occupied / last.dense_error.occupied,
            1.0,
            why="DenseSLAM's cells lie along two axes of a triangle and cover less than a square; "
            "and our one grid, too, frees cells that later scans see through",
        ),
        at_most(
            f"DenseSLAM's objects keep their shape (share of occupied cells more than {_FAR_M} m "
            "from any surface, landmarks moved onto the true ones, over one grid's)",
            far[1] / far[0] if far[0] > 0.0 else np.nan,
            0.5,
            why="after so many rounds with corrected poses one grid has been drawn over; after the "
            "first round the difference is that of N4.3",
        ),
    ]


@_also_literally({})
def claims_4_5(found: Rounds) -> list[Claim]:
    """One grid is never corrected."""
    first, last = found.each[0], found.each[-1]
    third = next(r for r in found.each if r.number == _THIRD)
    return [
        at_least(
            f"one grid is not corrected in {last.number} rounds (95 % of the distances to the "
            "surfaces, last round over first)",
            last.classic_error.p95_m / first.classic_error.p95_m,
            1.0,
        ),
        at_least(
            "objects appear a second time in later rounds (occupied cells, third round over first)",
            third.classic_error.occupied / first.classic_error.occupied,
            1.0,
        ),
    ]


@_also_literally({})
def claims_4_6(found: Coarsened) -> list[Claim]:
    """Almost empty regions get larger cells at no loss."""
    coarse = int(np.count_nonzero(found.cell_m > _COARSE_M))
    why = (
        f"cells that nobody has seen are not empty; the emptiest region has {found.emptiest:.0%} "
        "of its cells below 0.2, and 99 % are asked for"
    )
    return [
        at_least("almost empty regions get cells of 0.5 m (number of them)", coarse, 1, why=why),
        at_most(
            "fewer cells are kept (over those of one size)",
            found.cells / found.cells_even if coarse else np.nan,
            1.0,
            why=why,
        ),
        at_most(
            "the map stays as accurate (95 % of the distances to the surfaces, over that with one "
            "size)",
            found.error.p95_m / found.error_even.p95_m if coarse else np.nan,
            1.05,
            why=why,
        ),
    ]


@_also_literally({})
def claims_4_10(maps: Maps) -> list[Claim]:
    """Most particles are likely occupied, and they are where the raw returns are."""
    weight = np.concatenate([m.layers["particles"].occupancy for m in maps.all_drives])
    ratio = [m.errors["particles"].median_m / m.errors["points"].median_m for m in maps.all_drives]
    why = (
        "most of the others weigh about one half: what a sample behind its return is given, and "
        "keeps until another return meets it"
    )
    return [
        at_least("87 % of the particles weigh more than 0.8", (weight > 0.8).mean(), 0.87, why=why),
        at_most("2 % weigh less than 0.5", (weight < 0.5).mean(), 0.02, why=why),
        at_most(
            "the result is much the same as with raw returns (median distance to the surfaces, "
            "over theirs)",
            float(np.median(ratio)),
            1.1,
        ),
    ]


@_also_literally({})
def claims_4_12(maps: Maps) -> list[Claim]:
    """A sum of Gaussians follows the surfaces as raw returns do."""
    ratio = [m.errors["sog"].median_m / m.errors["points"].median_m for m in maps.all_drives]
    count = [m.errors["sog"].occupied / m.errors["points"].occupied for m in maps.all_drives]
    return [
        at_most(
            "Gaussians represent the surfaces (median distance, over that of raw returns)",
            float(np.median(ratio)),
            1.1,
        ),
        at_most("with fewer of them than of points kept (ratio)", float(np.median(count)), 1.0),
    ]


@_also_literally({})
def claims_4_16(maps: Maps) -> list[Claim]:
    """Three layers of one run tell of the same surfaces."""
    reach = _CELLS * maps.all_drives[0].dense.options.resolution_m
    shares: dict[str, list[float]] = {"particles": [], "sog": []}
    for m in maps.all_drives:
        grid = m.layers["occupancy"]
        cell = grid.point[grid.occupancy > _LEAST]
        for name, found in shares.items():
            held = m.layers[name]
            found.append(near_share(held.point[held.occupancy > _LEAST], cell, reach))
    return [
        at_least(
            f"{name} and occupied cells are of the same surfaces (share of the former within "
            f"{_CELLS:g} cells of the latter, mean of drives)",
            float(np.mean(found)),
            0.9,
        )
        for name, found in (("particles", shares["particles"]), ("Gaussians", shares["sog"]))
    ]
