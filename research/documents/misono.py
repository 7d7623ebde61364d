"""Misono et al. 2007, section 4: a robot among waypoints, Figs. 5 and 6.

Fig. 6 is of a real robot; what stands for it is the simulated one, steered by what it believes.
The claims are about the filter as published; the text beside them has ours, and labels and GPS.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import NO_GATE, fused_positions
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.config import EkfConfig
from comparisons.logs.log import Log
from comparisons.logs.simulate.waypoints import WaypointRun, simulate
from comparisons.report.figures.style import draw_trajectory
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR
from ekf_reference.association.known import KnownAssociation
from ekf_reference.association.nearest_neighbour import EuclideanNeighbour
from ekf_reference.core.state import FilterDivergedError
from ekf_reference.filters.misono import DirectionCosineEkf, DirectionCosineOptions
from ekf_reference.models.motion import RelativePoseModel
from graphslam.increments import dead_reckoned
from research.documents.claims import Claims, at_least, at_most, theirs
from research.documents.drawing import TRUE_PATH_COLOUR, plan
from research.documents.drives import Drives, truth_in_order
from research.documents.interface import DocumentFigure, Experiment, Sources
from research.documents.measures import rms


class FilterSetting(NamedTuple):
    """A filter, none for dead reckoning, and whether it is given labels and positions."""

    filter: str
    aided: bool


ESTIMATORS = {
    "dead reckoning": FilterSetting("", aided=False),
    "misono": FilterSetting("misono", aided=False),
    "misono-full": FilterSetting("misono-full", aided=False),
    "misono, aided": FilterSetting("misono", aided=True),
    "misono-full, aided": FilterSetting("misono-full", aided=True),
}
"""misono is what the paper prints: measurements one after the other, landmarks by eq. 17, no gate,
and no position, as dead reckoning has none. aided: ours, with labels and GPS at every goal."""
_COLOURS = {"dead reckoning": "#999999", "misono": EKF_COLOUR, "misono-full": SMOOTHER_COLOUR}
DRAWN = tuple(_COLOURS)
_PARTS = 5
_HEADING = (
    "the filter as published leaves the heading out of its Jacobian; with it (misono-full) the "
    "same number is {:.2f} m, with labels and GPS {:.2f} m, as published with these {:.2f} m"
)
_BESIDE = ("misono-full", "misono-full, aided", "misono, aided")


@dataclass(frozen=True)
class WaypointDrive:
    """One drive along the waypoints, steered by the truth.

    true: (N, 3). estimates: (N, 3) each.
    """

    true: Array
    estimates: dict[str, Array]

    def error_m(self, name: str) -> Array:
        """(N,) distances from the truth."""
        error: Array = np.linalg.norm((self.estimates[name] - self.true)[:, :2], axis=1)
        return error

    def rms_m(self, name: str) -> float:
        """Root mean square of them."""
        return rms(self.error_m(name))


@dataclass(frozen=True)
class Journeys:
    """True paths (N, 3) by the estimator that steered; None where the filter broke down."""

    log: str
    each: dict[str, tuple[Array | None, ...]]

    def ends_m(self, name: str) -> Array:
        """Distances from the base in the end, infinite where the filter broke down."""
        return np.array([np.inf if p is None else np.hypot(*p[-1, :2]) for p in self.each[name]])


def estimated(seed: int) -> WaypointDrive:
    """One drive that the truth steers, and what is estimated of it."""
    log = simulate(np.random.default_rng(seed), WaypointRun())
    found = {name: _estimate(log, *given) for name, given in ESTIMATORS.items()}
    return WaypointDrive(truth_in_order(log)[0].pose, found)


def _estimate(log: Log, filter_name: str, aided: bool) -> Array:
    choices = EkfConfig(
        filter=filter_name or "full",
        association="known" if aided else "euclidean",
        gps="on" if aided else "off",
    )
    positions = fused_positions(log, choices)
    timeline = build_timeline(log, positions)
    if not filter_name:
        return dead_reckoned(log.prior.pose, timeline.control)
    return run_ekf(log, timeline, choices, positions).estimate.pose


class FilterNavigator:
    """Misono's filter from the base on, as Navigator of the waypoint run.

    It takes in measurements and positions as far as it is given them, and without any it is dead
    reckoning.
    """

    def __init__(self, given: FilterSetting) -> None:
        """The filter as published has no gate."""
        self.given, complete = given, given.filter == "misono-full"
        self.ekf = DirectionCosineEkf(
            RelativePoseModel(),
            KnownAssociation() if given.aided else EuclideanNeighbour(),
            np.zeros(3),
            1e-10 * np.eye(3),
            options=DirectionCosineOptions(
                full_jacobian=complete, renormalise=complete, stacked=complete
            ),
        )
        if not complete:
            self.ekf.fixes = replace(self.ekf.fixes, gate=NO_GATE)

    def departed(self, displacement: Array, covariance: Array, true_pose: Array) -> None:
        """Predict; the truth stays unread."""
        self.ekf.predict(displacement, covariance, 0.0)

    def saw(self, z: Array, sigma: Array, landmark: NDArray[np.int64]) -> None:
        """Associate and update."""
        if self.given.filter and len(z):
            self.ekf.observe(z, sigma, landmark)

    def fixed(self, position: Array, covariance: Array) -> None:
        """Fuse the position."""
        if self.given.filter and self.given.aided:
            self.ekf.fix_position(position, covariance)

    def pose(self) -> Array:
        """(3,) the filter's estimate."""
        return self.ekf.read_pose().pose


def navigated(seed: int, name: str) -> Array | None:
    """True poses (N, 3) of a drive that an estimate steers; None when the filter broke down."""
    pilot = FilterNavigator(ESTIMATORS[name])
    try:
        log = simulate(np.random.default_rng(seed), WaypointRun(), pilot)
    except FilterDivergedError:
        return None
    return truth_in_order(log)[0].pose


def drives(sources: Sources) -> Drives[WaypointDrive]:
    """Seeds from 0."""
    name = f"waypoint-run, {sources.drives} drives from seed 0"
    return Drives(name, tuple(estimated(seed) for seed in range(sources.drives)))


def journeys(sources: Sources) -> Journeys:
    """Seeds from 0, each steered by every estimator."""
    name = f"waypoint-run steered by its estimate, {sources.drives} drives from seed 0"
    return Journeys(
        name, {e: tuple(navigated(seed, e) for seed in range(sources.drives)) for e in ESTIMATORS}
    )


def _claims_5(found: Drives[WaypointDrive]) -> Claims:
    def median(name: str) -> float:
        return float(np.median([one.rms_m(name) for one in found.each]))

    def growth(name: str) -> float:
        parts = [np.array_split(one.error_m(name), _PARTS) for one in found.each]
        return float(np.median([p[-1].mean() / p[0].mean() for p in parts]))

    text = "by dead reckoning errors accumulate (last fifth of the run over the first, median)"
    yield at_least(text, growth("dead reckoning"), 1.0)
    text = "SLAM cancels them (its error over dead reckoning's, medians of RMS)"
    yield at_most(text, median("misono") / median("dead reckoning"), 1.0)
    why = theirs(_HEADING.format(*map(median, _BESIDE)))
    text = (
        "and tells exactly where the robot is (median RMS error; limit: the distance within "
        "which a waypoint counts as reached)"
    )
    each = [one.rms_m("misono") for one in found.each]
    yield at_most(text, np.median(each), WaypointRun().reached_m, "m", why=why, own=True).over(each)


def _claims_6(found: Journeys) -> Claims:
    slam, blind = (found.ends_m(name) for name in ("misono", "dead reckoning"))
    text = (
        "by SLAM the robot ends nearer to its starting point than by dead reckoning (median ratio)"
    )
    yield at_most(text, np.median(slam / blind), 1.0).over(slam / blind)
    why = theirs(_HEADING.format(*(found.ends_m(name).max() for name in _BESIDE)))
    text = (
        "it returns to it (worst drive; limit: twice the distance within which a "
        "waypoint counts as reached)"
    )
    yield at_most(text, slam.max(), 2.0 * WaypointRun().reached_m, "m", why=why, own=True).over(
        slam
    )


def _draw_5(canvas: Canvas, found: Drives[WaypointDrive]) -> None:
    one, (left, right) = found.each[0], canvas.subplots(1, 2, sharex=True, sharey=True)
    _draw_estimates(left, one, DRAWN[1:], "(a) estimated by SLAM")
    _draw_estimates(right, one, ("dead reckoning",), "(b) by dead reckoning")


def _draw_6(canvas: Canvas, found: Journeys) -> None:
    axis = canvas.add_subplot()
    for name, colour in _COLOURS.items():
        path = found.each[name][0]
        if path is not None:
            draw_trajectory(axis, path, colour, f"steered by {name}")
    _course(axis, "where the robot truly goes")


def _draw_estimates(axis: Axes, one: WaypointDrive, names: tuple[str, ...], title: str) -> None:
    axis.plot(*one.true[:, :2].T, color=TRUE_PATH_COLOUR, linewidth=3.0, label="true path")
    for name in names:
        draw_trajectory(axis, one.estimates[name], _COLOURS[name], name)
    _course(axis, title)


def _course(axis: Axes, title: str) -> None:
    axis.plot(*WaypointRun().waypoint.T, "*", color="#444444", label="waypoints")
    axis.plot(0.0, 0.0, "s", color="#444444", label="base")
    plan(axis, title, legend="best")


FIGURES = (
    DocumentFigure(
        name="M5", title="Waypoints: estimated by SLAM and by dead reckoning",
        says="Dead reckoning accumulates errors along the waypoints; SLAM cancels them and tells "
        "exactly where the robot is.",
        experiment=Experiment("Misono's Fig. 5", drives), draw=_draw_5, claims=_claims_5,
        size=(10.0, 4.8),
    ),
    DocumentFigure(
        name="M6", title="Waypoints: where the robot goes by its estimate",
        says="Steered by SLAM the robot returns to its starting point; dead reckoning would not "
        "bring it there.",
        experiment=Experiment("Misono's Fig. 6", journeys), draw=_draw_6, claims=_claims_6,
        size=(6.5, 6.0), place="Fig. 6 (there a real robot, here the simulated one)",
    ),
)  # fmt: skip
