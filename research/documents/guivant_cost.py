"""Guivant, Masson and Nebot 2002, sections 4 and 4.1: what the compressed filter costs.

"The computation complexity is independent of the size of the global map" while the vehicle stays
in a local area; "still a full update is required when the vehicle leaves". A vehicle goes round in
the middle of fields of 200 to 4,000 landmarks, all of which are in the map, under both filters.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Canvas

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.filter_loop import run_filter_loop
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.config import EkfConfig
from comparisons.covariances import entry_differences
from comparisons.logs.log import LandmarkMeasurements, Log
from comparisons.logs.simulate.drive import point_measurements, simulate
from comparisons.logs.simulate.worlds import LandmarkWorld
from comparisons.report.marks import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.trace import Trace
from ekf_reference.filters.compressed import CompressedEkf
from research.documents.claims import Claims, at_least, at_most
from research.documents.drawing import chart
from research.documents.interface import DocumentFigure, Experiment, Sources
from research.fields import SPACING_M, field_drive

SIZES = (200, 500, 1000, 2000, 4000)
"""Landmarks in the map."""
MOST_FULL = 2000
"""Larger maps are left to the compressed filter."""
RADIUS_M = 10.0
"""Of the circle that is driven, inside one local area."""
START_SIGMA = np.array((1.0, 1.0, 0.05))
"""Of the first pose [m, m, rad], which all landmarks have in common: none is independent."""
_COLUMNS = ("time_s", "range_m", "bearing_rad", "sigma_range_m", "sigma_bearing_rad", "landmark")
STEPS = 60
"""Scans, five a second: half a round."""
_WARM = 5
_SURE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What a filter's steps take with a map, in milliseconds of the processor.

    step_ms: median over the scans, each with its two predictions. leaving_ms: of the global update
    at the end; 0 for the full filter. active: landmarks in the local area.
    """

    landmarks: int
    step_ms: float
    leaving_ms: float
    active: int


@dataclass(frozen=True)
class Costs:
    """log: in words. full, compressed: by ascending size of the map.

    gap: largest difference of the two filters' estimates at the end, in standard deviations.
    """

    log: str
    full: tuple[Cost, ...]
    compressed: tuple[Cost, ...]
    gap: float

    def local_growth(self) -> float:
        """Time of a local step with the largest map over that with the smallest."""
        return self.compressed[-1].step_ms / self.compressed[0].step_ms

    def gain(self) -> float:
        """Time of a full step over that of a local one, with the largest map that both have."""
        local = {cost.landmarks: cost.step_ms for cost in self.compressed}
        return self.full[-1].step_ms / local[self.full[-1].landmarks]

    def order(self, costs: tuple[Cost, ...], field: str) -> float:
        """The power of the map's size with which a time grows over its two largest sizes."""
        (less, small), (more, large) = ((c.landmarks, getattr(c, field)) for c in costs[-2:])
        return math.log(large / small) / math.log(more / less)


def field_log(landmarks: int) -> Log:
    """A round in the middle of a field of so many landmarks, all of which the first scan sees."""
    rng = np.random.default_rng(landmarks)
    side = math.ceil(math.sqrt(landmarks))
    line = np.arange(side) - 0.5 * (side - 1)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    # The nearest to the middle, wherever the grid is cut.
    nearest = np.argsort(np.hypot(*grid.T), kind="stable")[:landmarks]
    places = SPACING_M * (grid[nearest] + rng.uniform(-0.3, 0.3, (landmarks, 2)))
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    path = RADIUS_M * np.column_stack((np.cos(angle), np.sin(angle)))
    drive = field_drive(STEPS)
    log = simulate(rng, drive, LandmarkWorld(path, places))
    assert log.truth.poses is not None
    all_round = replace(drive, max_range_m=math.inf, field_of_view_rad=2.0 * math.pi)
    start = log.truth.poses.pose[:1]
    survey = point_measurements(rng, all_round, places, log.truth.poses.time_s[:1], start)
    columns: dict[str, Any] = {
        name: np.concatenate((getattr(survey, name), getattr(log.measurements, name)))
        for name in _COLUMNS
    }
    seen = LandmarkMeasurements(**columns)
    prior = replace(log.prior, covariance=np.diag(START_SIGMA**2))
    return replace(log, name=f"field-{landmarks}", prior=prior, measurements=seen)


def driven(log: Log, name: str) -> tuple[Cost, Ekf]:
    """Drive a filter through a log and measure its steps; it is returned as it is in the end."""
    ekf = build_ekf(log, settle(EkfConfig(filter=name), log), Trace())
    step_s, began = [], time.process_time()
    for epoch in run_filter_loop(ekf, log, build_timeline(log, None)):
        step_s.append(time.process_time() - began)
        if isinstance(ekf, CompressedEkf) and epoch.time_s == log.prior.time_s:
            ekf.state.leave()  # the map is new: of what is far, no more is active
        began = time.process_time()
    active, leaving_s = ekf.state.landmark_count, 0.0
    if isinstance(ekf, CompressedEkf):
        began = time.process_time()
        ekf.state.leave()
        leaving_s, active = time.process_time() - began, (ekf.state.updates[-1].active - 3) // 2
    cost = Cost(
        landmarks=ekf.state.landmark_count,
        step_ms=1e3 * float(np.median(step_s[_WARM:])),
        leaving_ms=1e3 * leaving_s,
        active=active,
    )
    return cost, ekf


def measured(_: Sources, sizes: Sequence[int] = SIZES, most_full: int = MOST_FULL) -> Costs:
    """All sizes under both filters, one after the other; those above most_full under one."""
    full, compressed, gaps = list[Cost](), list[Cost](), list[float]()
    for size in sizes:
        log = field_log(size)
        cost, local = driven(log, "compressed")
        compressed.append(cost)
        if size > most_full:
            continue
        cost, whole = driven(log, "full")
        full.append(cost)
        gaps.append(gap(whole, local))
    return Costs("fields of landmarks, all in the map", tuple(full), tuple(compressed), max(gaps))


def gap(whole: Ekf, local: Ekf) -> float:
    """The largest difference of two filters' means and covariances, in sigmas of the first."""
    sigma = np.sqrt(whole.state.covariance.diagonal())
    off: Array = np.abs(whole.state.mean - local.state.mean) / sigma
    spread = np.abs(entry_differences(local.state.covariance, whole.state.covariance))
    return float(max(off.max(), spread.max()))


def _claims(found: Costs) -> Claims:
    least, most = found.compressed[0].landmarks, found.compressed[-1].landmarks
    text = f"in a local area the cost is independent of the map's size (a step with {most:,} "
    text += f"landmarks over one with {least:,})"
    yield at_most(text, found.local_growth(), 1.25, own=True)
    both = found.full[-1].landmarks
    text = f"the full filter's is not (a step over the local one, {both:,} landmarks)"
    yield at_least(text, found.gain(), 1.0)
    text = "it is of the order of the square of the map's size (the power, its largest two sizes)"
    yield at_least(text, found.order(found.full, "step_ms"), 1.5, own=True)
    text = "and so is the update that is required when the vehicle leaves (the power)"
    yield at_least(text, found.order(found.compressed, "leaving_ms"), 1.5, own=True)
    text = "what was learnt is transferred without loss (largest difference from the full filter)"
    yield at_most(text, found.gap, _SURE, "sigma", own=True)


def _draw(canvas: Canvas, found: Costs) -> None:
    axis = canvas.add_subplot()
    rows: Mapping[str, tuple[tuple[Cost, ...], str, str]] = {
        "full filter, a step": (found.full, "step_ms", SMOOTHER_COLOUR),
        "compressed filter, a step in its area": (found.compressed, "step_ms", EKF_COLOUR),
        "compressed filter, on leaving its area": (found.compressed, "leaving_ms", SCANS_COLOUR),
    }
    for label, (costs, field, colour) in rows.items():
        size, value = [c.landmarks for c in costs], [getattr(c, field) for c in costs]
        axis.plot(size, value, "o-", color=colour, label=label)
    axis.set_xscale("log")
    axis.set_yscale("log")
    sizes = [cost.landmarks for cost in found.compressed]
    axis.set_xticks(sizes, [f"{size:,}" for size in sizes])
    axis.minorticks_off()
    active = found.compressed[-1].active
    title = f"time of the processor, {active} landmarks in the local area"
    chart(axis, title, "landmarks in the map", "time [ms]")


FIGURES = (
    DocumentFigure(
        name="G4.1", title="What a step costs, by the size of the map", place="section 4.1",
        says="While the vehicle stays in a local area the cost does not depend on the size of the "
        "global map; a full update is required when it leaves.",
        experiment=Experiment("Guivant's cost", measured), draw=_draw, claims=_claims,
        size=(7.0, 4.6),
    ),
)  # fmt: skip
