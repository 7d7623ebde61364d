"""Nieto 2005, Examples 3.1 and 3.2: one point of a region, Figs. 3.5 and 3.12."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from comparisons.arrays import Array
from comparisons.experiments.reproduction.decorrelation_example import (
    DecorrelationExample,
    decorrelation_example,
)
from comparisons.experiments.reproduction.drawing import chart, frame, plan
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
from comparisons.report.figures.style import draw_reference
from comparisons.report.marks import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR

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


WORLD_COLOUR, LOCAL_COLOUR = EKF_COLOUR, SMOOTHER_COLOUR
_CORNER_COLOURS = (SMOOTHER_COLOUR, SCANS_COLOUR, TRUTH_COLOUR)
_AROUND_M = 12.0


def draw_region(axis: Axes, example: DecorrelationExample) -> None:
    """The region's axes, the point in it and the distant landmark (Nieto 2005, Fig. 3.5 a)."""
    first, second, third = example.triangle[0]
    point, distant = example.point[0], example.distant[0]
    axis.plot(*example.landmark.T, "*", color=TRUTH_COLOUR, markersize=5, label="landmarks")
    for end in (second, third):
        axis.plot(*np.stack((first, end)).T, color=LOCAL_COLOUR, linewidth=1.6)
    axis.plot(*np.stack((first, point)).T, ":", color=WORLD_COLOUR, label="point $i$ in its region")
    axis.plot(*np.stack((point, distant)).T, "--", color=SCANS_COLOUR, label="to landmark $j$")
    axis.plot(*point, "o", color=WORLD_COLOUR, markersize=5)
    shown = np.concatenate((example.triangle[0], point[None], distant[None]))
    frame(axis, shown, _AROUND_M)
    plan(axis, "", legend="best")


def draw_base_correlation(axis: Axes, time_s: Array, coefficients: Array) -> None:
    """Of the point with its base landmarks, (T, 3, 2) in east and north (Fig. 3.5 b)."""
    for corner, colour in enumerate(_CORNER_COLOURS):
        axis.plot(time_s, coefficients[:, corner, 0], "-", color=colour, label=f"L{corner + 1}")
        axis.plot(time_s, coefficients[:, corner, 1], "--", color=colour)
    chart(axis, "", "time [s]", "correlation, base and point")


def draw_decorrelation(axis: Axes, time_s: Array, world: Array, local: Array) -> None:
    """Coefficients (T, 2, 2) of a distant landmark with the point (Fig. 3.5 c)."""
    ours = (np.diagonal(of, axis1=1, axis2=2) for of in (world, local))
    _draw_both(axis, time_s, *ours)
    axis.set_ylim(-0.02, 1.02)
    chart(axis, "", "time [s]", "correlation, $j$ and point")


def draw_sigma(axis: Axes, time_s: Array, world_m: Array, local_m: Array) -> None:
    """Standard deviations (T, 2) of the point (Fig. 3.5 d)."""
    _draw_both(axis, time_s, world_m, local_m)
    axis.set_ylim(bottom=0.0)
    chart(axis, "", "time [s]", "standard deviation [m]")


def _draw_both(axis: Axes, time_s: Array, world: Array, local: Array) -> None:
    """(T, 2) each: solid in east or along axis a, dashed in north or along axis b."""
    for value, colour, name in (
        (world, WORLD_COLOUR, "in the world"),
        (local, LOCAL_COLOUR, "in its region"),
    ):
        axis.plot(time_s, value[:, 0], "-", color=colour, label=name)
        axis.plot(time_s, value[:, 1], "--", color=colour)


def draw_displacement(axis: Axes, time_s: Array, world_m: Array, local_m: Array) -> None:
    """How far the point has moved, (T,) each (Nieto 2005, Fig. 3.12 a)."""
    axis.plot(time_s, world_m, "-", color=WORLD_COLOUR, label="in the world")
    axis.plot(time_s, local_m, "--", color=LOCAL_COLOUR, label="in its region")
    chart(axis, "", "time [s]", "change of place [m]")


def draw_wandering(axis: Axes, point: Array, true_point: Array | None) -> None:
    """The point (T, 2) in the world as time goes on, and where it is (Fig. 3.12 b)."""
    axis.plot(*point.T, ".", color=WORLD_COLOUR, markersize=4, label="estimates")
    axis.plot(*point[0], "o", color=WORLD_COLOUR, markerfacecolor="none", label="the first")
    if true_point is not None:
        draw_reference(axis, true_point[None], "*", "truth")
    axis.set_aspect("equal", adjustable="datalim")
    chart(axis, "", "east [m]", "north [m]")


def draw_example_3_1(figure: Canvas, example: DecorrelationExample) -> None:
    """Nieto 2005, Fig. 3.5: solid in east or along axis a, dashed in north or along axis b."""
    axes, found, time = figure.subplots(2, 2).ravel(), example.correlations, example.time_s
    draw_region(axes[0], example)
    draw_base_correlation(axes[1], time, example.with_base)
    draw_decorrelation(axes[2], time, found.world, found.local)
    draw_sigma(axes[3], time, found.sigma_world_m, found.sigma_local_m)


def draw_example_3_2(figure: Canvas, example: DecorrelationExample) -> None:
    """Nieto 2005, Fig. 3.12."""
    left, right = figure.subplots(1, 2)
    draw_displacement(left, example.time_s, example.moved.world_m, example.moved.local_m)
    draw_wandering(right, example.point, example.true_point)


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
