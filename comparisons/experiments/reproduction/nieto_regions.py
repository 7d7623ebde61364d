"""Nieto 2005, Examples 3.1 and 3.2: one point of a region, Figs. 3.5 and 3.12."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure as Canvas

from comparisons.arrays import Array
from comparisons.experiments.reproduction.decorrelation_example import (
    DecorrelationExample,
    decorrelation_example,
)
from comparisons.experiments.reproduction.dense_figures import draw_example_3_1, draw_example_3_2
from comparisons.experiments.reproduction.interface import (
    AnyFigure,
    Claims,
    Experiment,
    Figure,
    Sources,
    at_least,
    at_most,
)
from comparisons.experiments.reproduction.nieto_slam import closing_s
from comparisons.logs.simulate.drive import Drive, simulate

EXTRA_S = 10.0
"""How long these examples go on after the loop."""
_SETTLING_S = 2.0


@dataclass(frozen=True)
class Examples:
    """One per drive; the first is drawn. closing_s: when each sees its start again."""

    log: str
    each: tuple[DecorrelationExample, ...]
    closing_s: tuple[float, ...]


def examples(sources: Sources) -> Examples:
    """The point of the same region on several drives, seeds from 0."""
    settings = Drive(extra_s=EXTRA_S)
    logs = [simulate(np.random.default_rng(seed), settings) for seed in range(sources.drives)]
    return Examples(
        f"simulated-loop and {EXTRA_S:.0f} s more, {len(logs)} drives from seed 0",
        tuple(decorrelation_example(log) for log in logs),
        tuple(closing_s(log) for log in logs),
    )


def claims_3_5(found: Examples) -> Claims:
    """In its region a point is correlated with nothing else."""
    before = [e.time_s < t - 1e-6 for e, t in zip(found.each, found.closing_s, strict=True)]

    def until(values: list[Array]) -> Array:
        """Until each drive's loop closes."""
        return np.concatenate([v[early].ravel() for v, early in zip(values, before, strict=True)])

    each = [e.correlations for e in found.each]
    with_base, local = [e.with_base for e in found.each], [c.local for c in each]
    world = [np.diagonal(c.world, axis1=1, axis2=2) for c in each]
    ratio = [c.sigma_local_m / c.sigma_world_m for c in each]
    known = [float(np.median([c.sigma_world_m[row].max() for c in each])) for row in (0, -1)]
    closed = (
        f"once the loop is closed the point is known well in the world, too (sigma {known[1]:.2f} "
        f"m instead of {known[0]:.2f})"
    )
    yield at_least(
        "the point's correlation with its region's landmarks is high (least)",
        min(w.min() for w in with_base),
        0.9,
        why=f"until the loop closes it is {until(with_base).min():.2f}; {closed}",
    )
    yield at_least(
        "with a distant landmark it is almost one in the world (least until the loop closes)",
        until(world).min(),
        0.95,
        why=f"that is in east; in north it is {until([w[:, 1] for w in world]).min():.2f}",
    )
    yield at_most(
        "and almost zero in the region (largest)",
        max(c.max() for c in local),
        0.1,
        why=f"until the loop closes it is {until(local).max():.2f}; {closed}",
    )
    yield at_most(
        "its deviation is much smaller in the region than in the world (largest ratio)",
        max(r.max() for r in ratio),
        0.2,
        why=f"until the loop closes it is {until(ratio).max():.2f}; {closed}",
    )


def claims_3_12(found: Examples) -> Claims:
    """What later scans would move in the world hardly moves in the region."""
    world = np.array([e.moved.world_m.max() for e in found.each])
    local = np.array([e.moved.local_m.max() for e in found.each])
    unsettled = [
        float(np.ptp(e.moved.local_m[e.time_s >= closing + _SETTLING_S]))
        for e, closing in zip(found.each, found.closing_s, strict=True)
    ]
    yield at_least(
        "in the world the point moves by more than half a metre (median of drives)",
        np.median(world),
        0.5,
        "m",
        why="the thesis shows one drive; how far a closing moves a map is luck: here "
        f"{world.min():.2f} to {world.max():.2f} m",
    )
    yield at_most(
        "in its region it moves by about 0.1 m (largest of all drives)",
        local.max(),
        0.1,
        "m",
        why=f"the thesis shows one drive; here it is {local.min():.2f} to {local.max():.2f} m, "
        f"in the median {np.median(local):.2f} m",
    )
    yield at_most(
        "which is a fifth of its motion in the world (median ratio)",
        np.median(local / world),
        0.2,
    )
    yield at_most(
        f"{_SETTLING_S:.0f} s after the closing it stays where it is (largest range)",
        max(unsettled),
        0.02,
        "m",
        why="the thesis shows one drive; so it does in "
        f"{sum(u <= 0.02 for u in unsettled)} of {len(unsettled)} drives",
    )


def draw_3_5(canvas: Canvas, found: Examples) -> None:
    """Example 3.1."""
    draw_example_3_1(canvas, found.each[0])


def draw_3_12(canvas: Canvas, found: Examples) -> None:
    """Example 3.2."""
    draw_example_3_2(canvas, found.each[0])


EXPERIMENT = Experiment("Examples 3.1 and 3.2", examples)

FIGURES: tuple[AnyFigure, ...] = (
    Figure(
        name="N3.5", title="Decorrelation of a point within its region",
        says="A point close to three landmarks is highly correlated with them; expressed in their "
        "frame it is almost uncorrelated with the rest of the map, and far better known.",
        experiment=EXPERIMENT, draw=draw_3_5, claims=claims_3_5, size=(9.0, 7.5),
    ),
    Figure(
        name="N3.12", title="Change of the same point's place, in the world and in its region",
        says="Where the point would move by more than half a metre in the world, it moves by about "
        "a tenth of a metre in its region, and soon not at all: that is what a dense map neglects.",
        experiment=EXPERIMENT, draw=draw_3_12, claims=claims_3_12, size=(9.0, 4.2),
    ),
)  # fmt: skip
