"""What is drawn of consistency: errors with their bands, NEES, NIS and whiteness.

The picture and the page draw these panels, each in its way; nothing is computed by either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.spurious import HEADING
from comparisons.checks.consistency.filter_smoother import LEAST_RATIO, FilterAgainstSmoother
from comparisons.checks.consistency.finding import ConsistencyFinding
from comparisons.checks.consistency.nees import PoseErrors
from comparisons.checks.pair_of_estimates import EstimateComparison
from comparisons.checks.spurious import SpuriousFinding
from comparisons.estimates.estimate import Estimate
from comparisons.innovations import SensorInnovations
from comparisons.jobs.run import Comparison
from comparisons.pipeline.known import Known
from comparisons.report.marks import (
    DEPARTURE_COLOUR,
    EKF_COLOUR,
    SCANS_COLOUR,
    SMOOTHER_COLOUR,
    TIME,
    Curve,
    FilledBand,
    Moment,
    Panel,
    nis_panel,
)
from comparisons.statistics import mean_band
from comparisons.words import DEPARTURE

if TYPE_CHECKING:
    from comparisons.checks.consistency.consistency import Consistency, ExternalConsistency
    from comparisons.estimates.reference import Reference
    from comparisons.jobs.external_check import ExternalCheck

REFERENCE_COLOUR = "#5c6f2b"
REFERENCE_COLOURS = (REFERENCE_COLOUR, "#b05f9e", "#8f5d2b")
"""Of the filters that an external estimate is compared with, in turn."""
_FURTHER = (SCANS_COLOUR, "#6a3d9a", REFERENCE_COLOUR)
_NO_COVARIANCES = "there are no covariances of poses"
COMPONENTS = {"east": ("east [m]", 1.0), "north": ("north [m]", 1.0),
              "heading": ("heading [deg]", 180.0 / np.pi)}  # fmt: skip
"""Of a pose: what a panel calls each, and how much of its unit an SI unit is."""
_COLOURS = (EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, REFERENCE_COLOUR)


@dataclass(frozen=True, kw_only=True)
class ConsistencyPanels:
    """errors: east, north, heading. squared: NEES. nis: by sensor. reported: whose error, by what.

    apart: where there are more than two estimates, the distance of each from the smoother's.
    learnt: the heading's sigma that the filter took from measurements that cannot tell it.
    """

    reported: str
    errors: tuple[Panel, ...]
    squared: Panel | None
    nis: tuple[Panel, ...]
    whiteness: Panel | None
    apart: Panel | None = None
    learnt: Panel | None = None

    @property
    def every(self) -> tuple[Panel, ...]:
        """All panels there are, those over time first."""
        panels = (*self.errors, self.squared, self.apart, self.learnt, *self.nis, self.whiteness)
        return tuple(panel for panel in panels if panel is not None)


def consistency_panels(comparison: Comparison) -> ConsistencyPanels:
    """The pose's error by truth, or else by the smoother, and the filter's innovations."""
    c = comparison.consistency
    reported, errors, squared = _poses(comparison)
    apart = None
    if more := further_estimates(comparison):
        estimates = [("EKF", EKF_COLOUR, comparison.ekf.estimate), *more]
        paths = [(name, colour, e.time_s, e.pose) for name, colour, e in estimates]
        apart = distance_panel(paths, comparison.smoothed.time_s, comparison.smoothed.pose)
    return ConsistencyPanels(
        reported=reported,
        errors=errors,
        squared=squared,
        nis=_nis(c.sensors),
        whiteness=_whiteness(c.sensors),
        apart=apart,
        learnt=_learnt(comparison.known, "EKF's own"),
    )


def known_panels(known: Known) -> tuple[str, tuple[Panel, ...]]:
    """Return whose error, by what, and panels of what a job knows that compares no estimates.

    The error of its filter, or of its smoother without one, where the log has true poses.
    """
    c = known.value(ConsistencyFinding)
    if c is None:
        return "", ()
    reported, errors, squared = _against_truth(known, c)
    of_filter = _learnt(known, "EKF's own"), *_nis(c.sensors), _whiteness(c.sensors)
    return reported, tuple(filter(None, (*errors, squared, *of_filter)))


def _against_truth(known: Known, c: Consistency) -> tuple[str, tuple[Panel, ...], Panel | None]:
    """Error of the filter, or of the smoother without one, and NEES of both; none without truth."""
    both = (("EKF", EKF_COLOUR, c.ekf), (known.called, SMOOTHER_COLOUR, c.smoother))
    curves = [(name, colour, t.poses) for name, colour, t in both if t is not None and t.poses]
    for name, colour, p in curves[:1]:
        errors = _errors(p.time_s, p.error, p.sigma, f"{name} - truth", colour=colour)
        return f"the {name}'s pose against truth", errors, _nees(curves)
    return "", (), None


def _nis(sensors: tuple[SensorInnovations, ...]) -> tuple[Panel, ...]:
    return tuple(
        nis_panel(sensor, colour, sensor.windows.time_s, "time [s]")
        for sensor, colour in zip(sensors, _COLOURS, strict=False)
    )


def _learnt(known: Known, name: str) -> Panel | None:
    """How well the heading seems to be known, from half a turn down, and the filter's own sigma."""
    spurious = known.value(SpuriousFinding)
    if spurious is None or spurious.of(HEADING).sigma > 180.0:
        return None
    unit, ekf = 180.0 / np.pi, known.ekf.estimate
    time_s, information = spurious.curve(HEADING)
    sigma = unit / np.sqrt(np.where(information >= np.pi**-2, information, np.nan))
    variance = ekf.pose_covariance[:, 2, 2]
    own = unit * np.sqrt(np.where(variance >= 0.0, variance, np.nan))
    return Panel(
        title="spurious knowledge of the heading, sigma [deg]",
        x_label=TIME,
        curves=(
            Curve("spurious", SCANS_COLOUR, time_s, sigma),
            Curve(name, EKF_COLOUR, ekf.time_s, own),
        ),
        bands=(),
        logarithmic=True,
    )


def further_estimates(comparison: Comparison) -> list[tuple[str, str, Estimate]]:
    """Name, colour and estimate of each that extensions found."""
    found = [
        (finding.titles.get(folder, folder), estimate)
        for finding in comparison.findings.values()
        for folder, estimate in finding.estimates.items()
    ]
    return [
        (name, _FURTHER[i % len(_FURTHER)], estimate) for i, (name, estimate) in enumerate(found)
    ]


def distance_panel(
    paths: Sequence[tuple[str, str, Array, Array]], time_s: Array, smoothed: Array
) -> Panel:
    """How far paths, of name, colour, times (K,) and poses (K, 3), are from the smoother's.

    Over the instants that both have, so that nothing is interpolated.
    """
    curves = []
    for name, colour, at, pose in paths:
        common, ours, theirs = np.intersect1d(
            np.round(at, 4), np.round(time_s, 4), return_indices=True
        )
        apart = np.linalg.norm(pose[ours, :2] - smoothed[theirs, :2], axis=1)
        curves.append(Curve(name, colour, common, apart))
    return Panel(
        title="distance from the smoother [m]",
        x_label=TIME,
        curves=tuple(curves),
        bands=(),
        level=0.0,
    )


def external_panels(check: ExternalCheck) -> tuple[str, tuple[Panel, ...]]:
    """Errors of an external trajectory by truth and by the smoother; what they show, in words."""
    c, reported = check.consistency, []
    errors, squared = _by_truth(c)
    panels = [*errors, *([] if squared is None else [squared])]
    if not errors:
        reported.append(
            "The log has no true poses in the estimate's time: no errors against truth."
        )
    if squared is not None:
        reported.append("Against truth: 3 sigma of the covariances of the estimate.")
    if check.given.pose_covariance is None:
        reported.append("The estimate has no pose covariances: no bands, and no NEES.")
    errors, squared = _by_smoother(c)
    panels += [*errors, *([] if squared is None else [squared])]
    if c.smoothed is None:
        if check.given.pose_covariance is not None:
            reported.append(f"Against the smoother there is no band: {c.unjudged}.")
    else:
        overconfident = (
            ", but where the estimate's covariance is the smaller one"
            if len(c.smoothed.overconfident)
            else ""
        )
        reported.append(
            "Against the smoother: 3 sigma of P_estimate - P_smoother, the covariance of the "
            f"difference of a filter from a smoother, which knows later data{overconfident}."
        )
    paths = [(r.name, colour, r.time_s, r.pose) for r, colour in filters_compared(check)]
    if paths:
        paths.append(("estimate", EKF_COLOUR, c.time_s, check.optimum.pose + c.difference))
        panels.append(distance_panel(paths, check.optimum.time_s, check.optimum.pose))
    panels += filter(None, (_learnt(check.known, "filter's own"), *_nis(c.sensors)))
    left = check.departure
    if left is not None:
        mark = Moment(DEPARTURE, DEPARTURE_COLOUR, left.time_s)
        panels = [replace(panel, moments=(mark,)) for panel in panels]
    panels += filter(None, (_whiteness(c.sensors),))
    return " ".join(reported), tuple(panels)


def errors_and_nees(
    result: Comparison | ExternalCheck | EstimateComparison,
) -> tuple[tuple[Panel, ...], Panel | None]:
    """Errors of the pose, by component, and their squares: by truth, or else by the smoother.

    Of two estimates, what they differ by.
    """
    if isinstance(result, Comparison):
        return _poses(result)[1:]
    if isinstance(result, EstimateComparison):
        return _of_pair(result)
    errors, squared = _by_truth(result.consistency)
    return (errors, squared) if errors else _by_smoother(result.consistency)


def _of_pair(pair: EstimateComparison) -> tuple[tuple[Panel, ...], Panel | None]:
    """Differences of two estimates with 3 sigma, and NEES where both have covariances."""
    name, at = "first - second", pair.time_s
    errors = _errors(at, pair.difference, pair.sigma, name)
    if not np.isfinite(pair.nees).any():
        return errors, None
    return errors, _squared([Curve(name, EKF_COLOUR, at, pair.nees)], mean_band(1, 3))


def _by_truth(c: ExternalConsistency) -> tuple[tuple[Panel, ...], Panel | None]:
    """Errors of an external estimate, and NEES where it has covariances; none without truth."""
    poses = None if c.ekf is None else c.ekf.poses
    if poses is None:
        return (), None
    curves = [("estimate", EKF_COLOUR, poses)]
    if c.smoother is not None and c.smoother.poses is not None:
        curves.append(("smoother", SMOOTHER_COLOUR, c.smoother.poses))
    squared = _nees(curves) if len(poses.pose.squared) else None
    return _errors(poses.time_s, poses.error, poses.sigma, "estimate - truth"), squared


def _by_smoother(c: ExternalConsistency) -> tuple[tuple[Panel, ...], Panel | None]:
    """Differences of an external estimate, with bands and squares where they are justified."""
    if c.smoothed is not None:
        return _against_smoother(c.smoothed, "estimate")
    unknown = np.full_like(c.difference, np.nan)
    lack = c.unjudged or _NO_COVARIANCES
    return _errors(c.time_s, c.difference, unknown, "estimate - smoother", lack), None


def filters_compared(check: ExternalCheck) -> list[tuple[Reference, str]]:
    """Reference filters that the estimate was compared with, and colours: EKF, nearer variant."""
    nearest = [] if check.grade.by is None else [check.grade.by.reference]
    found = {
        reference.name: reference
        for reference in (*check.peers, *nearest)
        if not reference.smoothed
    }
    return list(zip(found.values(), cycle(REFERENCE_COLOURS)))


def _poses(comparison: Comparison) -> tuple[str, tuple[Panel, ...], Panel | None]:
    c, f = comparison.consistency, comparison.consistency.smoothed
    reported, errors, squared = _against_truth(comparison.known, c)
    if errors:
        return reported, errors, squared
    if f is None:
        return "no truth, and no smoother on the same data", (), None
    reported = "the EKF's pose against the smoother's, 3 sigma of P_EKF - P_smoother"
    return reported, *_against_smoother(f, "EKF")


def _nees(poses: Sequence[tuple[str, str, PoseErrors]]) -> Panel:
    """NEES of estimates of name and colour, with the band of one value of the first's."""
    curves = [
        Curve(name, colour, p.time_s[p.pose.row], p.pose.squared) for name, colour, p in poses
    ]
    return _squared(curves, poses[0][2].pose.single_band)


def _squared(curves: Sequence[Curve], single: tuple[float, float]) -> Panel:
    """NEES of poses, with the band of a single value."""
    low, high = np.broadcast_to(np.array(single)[:, None], (2, len(curves[0].x)))
    return Panel(
        title="NEES of the pose (3 dof)",
        x_label=TIME,
        curves=tuple(curves),
        bands=(FilledBand(name="95 % band", colour="#999999", x=curves[0].x, low=low, high=high),),
        logarithmic=True,
    )


def _against_smoother(
    f: FilterAgainstSmoother, name: str
) -> tuple[tuple[Panel, ...], Panel | None]:
    """Differences, and their squares where a direction is clear.

    No band where the filter is clearly more certain than the smoother: P_filter - P_smoother is
    none.
    """
    justified = np.where(f.ratio >= LEAST_RATIO, 1.0, np.nan)[:, None]
    whose, name = name, f"{name} - smoother"
    lack = f"the {whose} claims less variance than the smoother"
    panels = _errors(f.time_s, f.error, justified * f.sigma, name, lack)
    if not (f.dof > 0).any():
        return panels, None
    none = (np.nan, np.nan)
    low, high = np.array([none, *(mean_band(1, dof) for dof in (1, 2, 3))])[f.dof].T
    squares = np.where(f.dof > 0, f.squared, np.nan)
    squared = Panel(
        title="pose's difference, squared",
        x_label=TIME,
        curves=(Curve(name, EKF_COLOUR, f.time_s, squares),),
        bands=(
            FilledBand(
                name="95 % band", colour="#999999", x=f.time_s, low=low, high=high, lack=lack
            ),
        ),
        logarithmic=True,
    )
    return panels, squared


def _errors(
    time_s: Array,
    error: Array,
    sigma: Array,
    name: str,
    lack: str = _NO_COVARIANCES,
    colour: str = EKF_COLOUR,
) -> tuple[Panel, ...]:
    """Of errors (n, 3) and sigmas (n, 3); no band where none of these is a number.

    lack: why sigmas are no numbers, if some are none.
    """
    panels = []
    for i, (label, unit) in enumerate(COMPONENTS.values()):
        spread = 3.0 * unit * sigma[:, i]
        curve = Curve(name, colour, time_s, unit * error[:, i])
        bands: tuple[FilledBand, ...] = ()
        lacks: tuple[str, ...] = (f"no 3 sigma: {lack}",)
        if np.isfinite(spread).any():
            lacks = ()
            bands = (
                FilledBand(
                    name="3 sigma", colour=colour, x=time_s, low=-spread, high=spread, lack=lack
                ),
            )
        panels.append(
            Panel(title=label, x_label=TIME, curves=(curve,), bands=bands, level=0.0, lacks=lacks)
        )
    return tuple(panels)


def _whiteness(sensors: tuple[SensorInnovations, ...]) -> Panel | None:
    """Autocorrelations by lag, with the widest of their 95 % bands."""
    series = [w for sensor in sensors for w in sensor.whiteness]
    if not series:
        return None
    curves = []
    for i, whiteness in enumerate(series):
        lag = np.arange(1.0, len(whiteness.autocorrelation) + 1.0)
        name = f"{whiteness.component}, by {whiteness.order}"
        curves.append(
            Curve(name, _COLOURS[i % len(_COLOURS)], lag, np.array(whiteness.autocorrelation))
        )
    lags = np.array((1.0, max(curve.x[-1] for curve in curves)))
    widest = np.full(2, max(max(one.band) for one in series))
    band = FilledBand(name="95 % band", colour="#999999", x=lags, low=-widest, high=widest)
    return Panel(
        title="autocorrelation of innovations, by lag",
        x_label="lag",
        curves=tuple(curves),
        bands=(band,),
        level=0.0,
    )
