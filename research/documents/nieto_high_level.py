"""Nieto 2005, section 6.1.3: high level landmarks, Fig. 6.5."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.config import EkfConfig
from comparisons.extensions.dense_maps.figure import DENSE_COLOUR, draw_surfaces
from comparisons.extensions.high_level.figure import HIGH_LEVEL_COLOUR, draw_high_level
from comparisons.extensions.high_level.source import (
    HighLevelOptions,
    HighLevelRun,
    HighLevelSource,
)
from comparisons.extensions.scan_landmarks.figure import place_covariances
from comparisons.logs.log import Log
from comparisons.logs.simulate.scan_drive import enclosed, occupancy, simulate
from comparisons.report.figures.style import draw_trajectory
from comparisons.report.marks import EKF_COLOUR, TRUTH_COLOUR, ellipses
from ekf_reference.scan_landmarks.high_level import Around, Search, SearchOptions
from ekf_reference.scan_landmarks.high_level_lifecycle import SHARE
from research.documents.claims import Claims, at_least, ours
from research.documents.drawing import (
    TRUE_PATH_COLOUR,
    closed,
    draw_lines,
    plan,
)
from research.documents.drives import Drives, true_surroundings
from research.documents.interface import DocumentFigure, Experiment, Sources
from research.documents.nieto_dense import MORE

EVERY_S, LOOPS = 60.0, 2
FIRST, LATER = 1, 4
"""Landmarks accepted by the first search, and after the loop, in Fig. 6.5."""
CANDIDATES = 3
LEAST = SearchOptions().least


@dataclass(frozen=True, kw_only=True)
class Searched:
    """A search and what it read. time_s: of it. pose: (3,) the vehicle's. landmark: (L, 2).

    point: (N, 2) Gaussians of the map then.
    """

    time_s: float
    pose: Array
    landmark: Array
    point: Array
    search: Search

    @classmethod
    def of(cls, time_s: float, around: Around, found: Search) -> Searched:
        """A copy, as the map goes on."""
        point = around.gaussians.ellipses(
            around.placed, np.arange(len(around.placed.triangle))
        ).mean
        return cls(
            time_s=time_s,
            pose=around.pose.copy(),
            landmark=around.landmark.copy(),
            point=point,
            search=found,
        )

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """(n,) of the candidates."""
        enough: NDArray[np.bool_] = self.search.gaussians >= LEAST
        return enough


@dataclass(frozen=True, kw_only=True)
class HighLevelDrive:
    """A drive with high level landmarks.

    searches: all. run: what became of them. sigma: (Q, 2, 2) [m^2] places of those in the state,
    by landmark index. path, true_path: (K, 2), (T, 2). landmark: (L, 2) point landmarks.
    """

    searches: tuple[Searched, ...]
    run: HighLevelRun
    sigma: Array
    path: Array
    true_path: Array
    landmark: Array
    segment: Array


def high_level_drives(sources: Sources) -> Drives[HighLevelDrive]:
    """Section 6.1.3: chapter 4's environment, a search every minute, seeds from 0."""
    experiment, drives = enclosed(occupancy(LOOPS)), sources.drives
    logs = (simulate(np.random.default_rng(seed), experiment) for seed in range(drives))
    reported = f"{experiment.name} --loops {LOOPS} with {MORE}, {drives} drives from seed 0"
    return Drives(reported, tuple(of_log(log) for log in logs))


def of_log(log: Log) -> HighLevelDrive:
    """A log with scans and truth, driven with high level landmarks."""
    poses, segment = true_surroundings(log)
    searches = list[Searched]()

    def searched(time_s: float, around: Around, found: Search) -> None:
        searches.append(Searched.of(time_s, around, found))

    source = HighLevelSource(log, HighLevelOptions(every_s=EVERY_S), searched=searched)
    choices, timeline = settle(EkfConfig(), log), build_timeline(log)
    run = run_ekf(log, timeline, choices, setup=FilterSetup(source=source))

    return HighLevelDrive(
        searches=tuple(searches),
        run=source.run(),
        sigma=place_covariances(run.estimate),
        path=run.estimate.pose[:, :2],
        true_path=poses.pose[:, :2],
        landmark=run.estimate.landmark,
        segment=segment,
    )


def _claims_6_5(found: Drives[HighLevelDrive]) -> Claims:
    first = [d.searches[0] for d in found.each]
    shown = [len(one.search.candidate) for one in first]
    taken = [int(one.accepted.sum()) for one in first]
    later = [len(d.run.landmark_index) - n for d, n in zip(found.each, taken, strict=True)]
    kept = [int(np.count_nonzero(d.run.landmark_index >= 0)) for d in found.each]
    looks = Counter[str]()
    for d in found.each:
        looks.update(d.run.looks)
    text = "the first search has three candidates (median of the drives)"
    yield at_least(text, np.median(shown), CANDIDATES).over(shown)
    yield at_least("at least one of them is accepted (the same)", np.median(taken), FIRST).over(
        taken
    )
    text = "and two are rejected for too few Gaussians (the same)"
    rejected = [n - k for n, k in zip(shown, taken, strict=True)]
    yield at_least(text, np.median(rejected), CANDIDATES - FIRST).over(rejected)
    text = "once the loop is closed four more have been detected (the same)"
    yield at_least(text, np.median(later), LATER).over(later)
    why = ours(
        "44 s are left after the search that finds four of them, and a landmark is used from "
        f"the first scan that has {SHARE:.0%} of its template in view and fixes its heading: "
        f"of {looks.total()} looks at those within reach {looks['out of view']} were out of "
        f"view, and {looks['a direction is open']} left a direction open. With 10 % and any "
        "direction open 3 are used in each of 3 drives"
    )
    text = "in the end five are in the state, seen again and used (the same)"
    yield at_least(text, np.median(kept), FIRST + LATER, why=why).over(kept)


HIGH_LEVEL = Experiment("section 6.1.3", high_level_drives)


def _draw_6_5(canvas: Canvas, found: Drives[HighLevelDrive]) -> None:
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    d = found.each[0]
    first = d.searches[0]
    draw_surfaces(left, d.segment)
    _draw_search(left, first)
    left.plot(*first.landmark.T, "+", color=TRUTH_COLOUR, markersize=5, label="point landmarks")
    left.plot(*first.pose[:2], ">", color=EKF_COLOUR, markersize=7, label="vehicle")
    plan(left, f"(a) the first search, {first.time_s:.0f} s", legend="lower right")
    _draw_end(right, d)
    right.plot(*d.landmark.T, "+", color=TRUTH_COLOUR, markersize=5, label="point landmarks")
    known = d.run.landmark_index >= 0
    places = d.run.place[known][np.argsort(d.run.landmark_index[known]), :2]
    draw_lines(right, ellipses(places, d.sigma, 1.0), EKF_COLOUR, "1 sigma")
    plan(right, "(b) after the loop, in the end", legend="lower right")


def _draw_search(axis: Axes, one: Searched) -> None:
    """Gaussians, corners, and rectangles, solid where accepted, with the number of Gaussians."""
    axis.plot(*one.point.T, ".", color=DENSE_COLOUR, markersize=1.5, label="Gaussians", zorder=3)
    corner = one.search.corner
    axis.plot(
        *corner.T, "o", color=EKF_COLOUR, markersize=8, markerfacecolor="none", label="corners",
        zorder=4,
    )  # fmt: skip
    for style, name, chosen in (
        ("solid", "accepted", one.accepted),
        ("dashed", "rejected", ~one.accepted),
    ):
        if chosen.any():
            outline = closed(one.search.candidate[chosen])
            draw_lines(axis, outline, HIGH_LEVEL_COLOUR, name, 1.2, style=style)
    for area, count in zip(one.search.candidate, one.search.gaussians.tolist(), strict=True):
        top = area[area[:, 1].argmax()]
        axis.annotate(f"{count}", top, xytext=(0, 3), textcoords="offset points", fontsize=9,
                      ha="center", color=HIGH_LEVEL_COLOUR)  # fmt: skip


def _draw_end(axis: Axes, d: HighLevelDrive) -> None:
    draw_surfaces(axis, d.segment)
    draw_trajectory(axis, d.true_path, TRUE_PATH_COLOUR, "true path")
    draw_trajectory(axis, d.path, EKF_COLOUR, "estimated path", "--")
    draw_high_level(axis, d.run)


FIGURES = (
    DocumentFigure(
        name="N6.5", title="The first search for high level landmarks, and the map after the loop",
        says="Of three candidates that the first search finds one is accepted; once the loop is "
        "closed four more have been found and are in the state.",
        experiment=HIGH_LEVEL, draw=_draw_6_5, claims=_claims_6_5, size=(13.0, 6.2),
    ),
)  # fmt: skip
