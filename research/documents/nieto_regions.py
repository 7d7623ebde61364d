"""Nieto 2005, Examples 3.1 and 3.2: one point of a region, Figs. 3.5 and 3.12."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.report.figures.style import draw_reference
from comparisons.report.marks import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.layout import Layout
from ekf_reference.core.state import correlation_coefficients
from ekf_reference.dense.triangles import contains, is_degenerate, to_local
from research.documents.claims import Claims, at_least, at_most, elsewhere
from research.documents.decorrelation import (
    Correlations,
    Displacements,
    correlations,
    displacements,
)
from research.documents.drawing import chart, frame, plan
from research.documents.drives import Drives, truth_in_order, watched_run
from research.documents.interface import DocumentFigure, Experiment, Sources

EXTRA_S = 10.0
"""How long these examples go on after the loop."""
_SETTLING_S = 2.0
_AWAY_S = 30.0


@dataclass(frozen=True)
class ScanInstant:
    """The filter after a scan. landmark, true: (L, 2). covariance: (3 + 2 L, 3 + 2 L)."""

    time_s: float
    landmark: Array
    true: Array
    covariance: Array

    @classmethod
    def of(cls, time_s: float, ekf: Ekf, true: Array) -> ScanInstant:
        """true: (K, 2) of all landmarks, in the filter's order, K at least its number."""
        place = ekf.state.landmarks.copy()
        return cls(time_s, place, true[: len(place)], ekf.state.covariance.copy())

    def among(self, *landmark_index: int) -> Array:
        """(2 k, 2 k) covariance of k landmarks, in this order."""
        layout = Layout.packed(3, len(self.landmark))
        columns = layout.columns(np.array(landmark_index))[3:]
        return self.covariance[np.ix_(columns, columns)]


def closing_s(log: Log) -> float:
    """When the first scan's landmarks are seen again after a while."""
    seen = log.measurements
    early = seen.landmark[seen.time_s <= seen.time_s[0]]
    time = seen.time_s[np.isin(seen.landmark, early)]
    return float(time[1:][np.diff(time) > _AWAY_S][0])


@dataclass(frozen=True, kw_only=True)
class DecorrelationExample:
    """The figures' data after each of T scans, from when the point is fused.

    triangle: (T, 3, 2), point: (T, 2) and distant: (T, 2) [m]. with_base: (T, 3, 2) correlation
    coefficients of the point with the base landmarks, in east and north. correlations: arrays
    (T, 2, 2) and (T, 2) of the distant landmark with the point. moved: (T,) since the first scan.
    landmark: (L, 2) all of the map at the first scan. true_point: (2,) [m].
    """

    time_s: Array
    triangle: Array
    point: Array
    distant: Array
    with_base: Array
    correlations: Correlations
    moved: Displacements
    landmark: Array
    true_point: Array


@dataclass(frozen=True)
class Examples(Drives[DecorrelationExample]):
    """closing_s: when each drive sees its start again."""

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


def _claims_3_5(found: Examples) -> Claims:
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
    why = elsewhere(f"until the loop closes it is {until(with_base).min():.2f}; {closed}")
    text = "the point's correlation with its region's landmarks is high (least)"
    least = [w.min() for w in with_base]
    yield at_least(text, min(least), 0.9, why=why, own=True).over(least)
    why = elsewhere(f"that is in east; in north it is {until([w[:, 1] for w in world]).min():.2f}")
    text = "with a distant landmark it is almost one in the world (least until the loop closes)"
    least = [w[early].min() for w, early in zip(world, before, strict=True)]
    yield at_least(text, min(least), 0.95, why=why, own=True).over(least)
    why = elsewhere(f"until the loop closes it is {until(local).max():.2f}; {closed}")
    text = "and almost zero in the region (largest)"
    most = [c.max() for c in local]
    yield at_most(text, max(most), 0.1, why=why, own=True).over(most)
    why = elsewhere(f"until the loop closes it is {until(ratio).max():.2f}; {closed}")
    text = "its deviation is smaller in the region than in the world (largest ratio)"
    most = [r.max() for r in ratio]
    yield at_most(text, max(most), 1.0, why=why).over(most)


def _claims_3_12(found: Examples) -> Claims:
    world = np.array([e.moved.world_m.max() for e in found.each])
    local = np.array([e.moved.local_m.max() for e in found.each])
    unsettled = [
        float(np.ptp(e.moved.local_m[e.time_s >= closing + _SETTLING_S]))
        for e, closing in zip(found.each, found.closing_s, strict=True)
    ]
    why = elsewhere(
        "the thesis shows one drive; how far a closing moves a map is luck: here "
        f"{world.min():.2f} to {world.max():.2f} m"
    )
    text = "in the world the point moves by more than half a metre (median of drives)"
    yield at_least(text, np.median(world), 0.5, "m", why=why).over(world)
    why = elsewhere(
        f"the thesis shows one drive; here it is {local.min():.2f} to {local.max():.2f} m, "
        f"in the median {np.median(local):.2f} m"
    )
    text = "in its region it moves by about 0.1 m (largest of all drives)"
    yield at_most(text, local.max(), 0.1, "m", why=why).over(local)
    text = "which is a fifth of its motion in the world (median ratio)"
    yield at_most(text, np.median(local / world), 0.2).over(local / world)
    why = elsewhere(
        "the thesis shows one drive; so it does in "
        f"{sum(u <= 0.02 for u in unsettled)} of {len(unsettled)} drives"
    )
    text = f"{_SETTLING_S:.0f} s after the closing it stays where it is (largest range)"
    yield at_most(text, max(unsettled), 0.02, "m", why=why, own=True).over(unsettled)


WORLD_COLOUR, LOCAL_COLOUR = EKF_COLOUR, SMOOTHER_COLOUR
_CORNER_COLOURS = (SMOOTHER_COLOUR, SCANS_COLOUR, TRUTH_COLOUR)
_AROUND_M = 12.0


def draw_3_5(canvas: Canvas, found: Examples) -> None:
    """Example 3.1: solid in east or along axis a, dashed in north or along axis b."""
    axes, one = canvas.subplots(2, 2).ravel(), found.each[0]
    _draw_region(axes[0], one)
    for corner, colour in enumerate(_CORNER_COLOURS):
        _along_both(axes[1], one.time_s, one.with_base[:, corner], colour, f"L{corner + 1}")
    chart(axes[1], "", "time [s]", "correlation, base and point")
    c = one.correlations
    world, local = (np.diagonal(of, axis1=1, axis2=2) for of in (c.world, c.local))
    for axis, of, in_world, in_region in (
        (axes[2], "correlation, $j$ and point", world, local),
        (axes[3], "standard deviation [m]", c.sigma_world_m, c.sigma_local_m),
    ):
        _along_both(axis, one.time_s, in_world, WORLD_COLOUR, "in the world")
        _along_both(axis, one.time_s, in_region, LOCAL_COLOUR, "in its region")
        chart(axis, "", "time [s]", of)
    axes[2].set_ylim(-0.02, 1.02)
    axes[3].set_ylim(bottom=0.0)


def _draw_region(axis: Axes, example: DecorrelationExample) -> None:
    """The region's axes, the point in it and the distant landmark (Nieto 2005, Fig. 3.5 a)."""
    first, second, third = example.triangle[0]
    point, distant = example.point[0], example.distant[0]
    axis.plot(*example.landmark.T, "*", color=TRUTH_COLOUR, markersize=5, label="landmarks")
    for end in (second, third):
        axis.plot(*np.stack((first, end)).T, color=LOCAL_COLOUR, linewidth=1.6)
    axis.plot(*np.stack((first, point)).T, ":", color=WORLD_COLOUR, label="point $i$ in its region")
    axis.plot(*np.stack((point, distant)).T, "--", color=SCANS_COLOUR, label="to landmark $j$")
    axis.plot(*point, "o", color=WORLD_COLOUR, markersize=5)
    frame(axis, np.concatenate((example.triangle[0], point[None], distant[None])), _AROUND_M)
    plan(axis, "", legend="best")


def _along_both(axis: Axes, time_s: Array, value: Array, colour: str, name: str) -> None:
    """(T, 2) over time (T,): solid the first, dashed the second."""
    axis.plot(time_s, value[:, 0], "-", color=colour, label=name)
    axis.plot(time_s, value[:, 1], "--", color=colour)


def draw_3_12(canvas: Canvas, found: Examples) -> None:
    """Example 3.2: how far the point has moved, and its estimates in the world."""
    (left, right), one = canvas.subplots(1, 2), found.each[0]
    left.plot(one.time_s, one.moved.world_m, "-", color=WORLD_COLOUR, label="in the world")
    left.plot(one.time_s, one.moved.local_m, "--", color=LOCAL_COLOUR, label="in its region")
    chart(left, "", "time [s]", "change of place [m]")
    first = one.point[0]
    right.plot(*one.point.T, ".", color=WORLD_COLOUR, markersize=4, label="estimates")
    right.plot(*first, "o", color=WORLD_COLOUR, markerfacecolor="none", label="the first")
    draw_reference(right, one.true_point[None], "*", "truth")
    right.set_aspect("equal", adjustable="datalim")
    chart(right, "", "east [m]", "north [m]")


DISTANT_M = 15.0
"""How far away the distant landmark is, as near as there is one; the thesis gives no number."""


class Cast(NamedTuple):
    """Landmarks by order of incorporation. fused_s: when the point is last seen."""

    point: int
    base: tuple[int, int, int]
    distant: int
    fused_s: float


def rightmost(log: Log) -> Cast:
    """Choose region, point and time by geometry alone. Raises InputError where there are none.

    Example 3.1 takes three landmarks as a region, and one in it, in the rightmost part of the
    environment, after "a few observations", and names neither the landmarks nor the time. So the
    point is the easternmost landmark that lies within a triangle of three others and is in view
    together with them in some scan; of such triangles the one with the smallest perimeter, since
    correlation is high where landmarks are close. The point is last seen in the last scan that
    shows all four. The rule reads true places and which landmarks each scan shows. It reads no
    estimate, so all drives through one world have the same cast. The distant landmark is the one
    nearest to DISTANT_M away from the point, of those seen until then.
    """
    true, measurements = truth_in_order(log)[1], log.measurements
    order = measurements.labels_in_order
    time_s, scan = np.unique(measurements.time_s, return_inverse=True)
    view = np.zeros((len(time_s), len(order)), dtype=bool)
    rank = np.argsort(order)
    view[scan, rank[np.searchsorted(order[rank], measurements.landmark)]] = True
    for point in np.argsort(-true[:, 0]).tolist():
        base = _around(point, true, view)
        if base is None:
            continue
        last = np.flatnonzero(view[:, [point, *base]].all(axis=1))[-1]
        seen = np.setdiff1d(np.flatnonzero(view[: last + 1].any(axis=0)), (point, *base))
        if len(seen):
            off = np.abs(np.linalg.norm(true[seen] - true[point], axis=1) - DISTANT_M)
            distant = int(seen[np.argmin(off)])
            return Cast(point, base, distant, float(time_s[last]))
    raise InputError(f"{log.name}: no landmark is seen within three others")


def _around(point: int, true: Array, view: NDArray[np.bool_]) -> tuple[int, int, int] | None:
    """The smallest triangle around a landmark that some scan (N, L) shows with it."""
    shown = view[view[:, point]]
    others = np.setdiff1d(np.flatnonzero(shown.any(axis=0)), point).tolist()
    base = np.array(list(combinations(others, 3)), dtype=np.intp).reshape(-1, 3)
    base = base[shown[:, base].all(axis=2).any(axis=0) & ~is_degenerate(true[base])]
    base = base[contains(to_local(true[base], true[point]))]
    if not len(base):
        return None
    edges = np.linalg.norm(true[base] - np.roll(true[base], 1, axis=1), axis=2)
    first, second, third = base[np.argmin(edges.sum(axis=1))].tolist()
    return first, second, third


def decorrelation_example(log: Log) -> DecorrelationExample:
    """Drive a labelled log and follow its cast. Raises InputError where there is none."""
    cast, true = rightmost(log), truth_in_order(log)[1]
    seen = list(fused_until(log, cast))
    triangle = np.stack([now.landmark[list(cast.base)] for now in seen])
    point = np.stack([now.landmark[cast.point] for now in seen])
    found, with_base = [], []
    for now, corners, at in zip(seen, triangle, point, strict=True):
        joint = now.among(cast.distant, *cast.base, cast.point)
        found.append(correlations(corners, at, joint))
        rho = correlation_coefficients(joint)
        with_base.append([rho[[2 * i, 2 * i + 1], [8, 9]] for i in (1, 2, 3)])
    return DecorrelationExample(
        time_s=np.array([now.time_s for now in seen]),
        triangle=triangle,
        point=point,
        distant=np.stack([now.landmark[cast.distant] for now in seen]),
        with_base=np.array(with_base),
        correlations=Correlations(*(np.stack(column) for column in zip(*found, strict=True))),
        moved=displacements(triangle[0], point[0], triangle, point),
        landmark=seen[0].landmark,
        true_point=true[cast.point],
    )


def fused_until(log: Log, cast: Cast) -> Iterator[ScanInstant]:
    """The filter from when the point, like a dense one, has got its last look."""
    measurements, true = log.measurements, truth_in_order(log)[1]
    label = measurements.labels_in_order[cast.point]
    keep = (measurements.landmark != label) | (measurements.time_s <= cast.fused_s)
    for time_s, ekf in watched_run(replace(log, measurements=measurements.chosen(keep))):
        if time_s >= cast.fused_s:
            yield ScanInstant.of(time_s, ekf, true)


EXPERIMENT = Experiment("Examples 3.1 and 3.2", examples)

FIGURES = (
    DocumentFigure(
        name="N3.5", title="Decorrelation of a point within its region",
        says="A point close to three landmarks is highly correlated with them; expressed in their "
        "frame it is almost uncorrelated with the rest of the map, and far better known.",
        experiment=EXPERIMENT, draw=draw_3_5, claims=_claims_3_5, size=(9.0, 7.5),
    ),
    DocumentFigure(
        name="N3.12", title="Change of the same point's place, in the world and in its region",
        says="Where the point would move by more than half a metre in the world, it moves by about "
        "a tenth of a metre in its region, and soon not at all: that is what a dense map neglects.",
        experiment=EXPERIMENT, draw=draw_3_12, claims=_claims_3_12, size=(9.0, 4.2),
    ),
)  # fmt: skip
