"""What is wrong with a log before any filter sees it: units, signs, columns, clocks, sigmas.

Each suspicion is a change of the log that would mend it. The smoother solves a part of the log with
the log's labels as it is and with each change; a change is named where it makes the log fit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.smoother_input import assemble, position_rows
from comparisons.adapters.time_window import cut_log
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.checks.diagnosis.log_fit import (
    AS_WELL,
    LogFit,
    alike,
    chi2_by_run,
    explains,
    fitted_numbers,
)
from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses, SteeringOdometry
from comparisons.logs.transforms.calibration import controlled, driven, sensed
from comparisons.logs.transforms.known_landmarks import indices_by_label, join_known_measurements
from graphslam.graph_builder import build_graph
from graphslam.increments import dead_reckoned
from graphslam.optimisers import levenberg_marquardt
from graphslam.optimum import ChiSquareTest, chi_square_test
from graphslam.search import relaxed_values
from graphslam.smoother import SmootherResult

_MOST_MEASUREMENTS = 600
"""Of the part that is solved."""
_FEWEST = 20
"""Degrees of freedom; fewer tell nothing."""
_HALF = 0.5
"""A change of signs or columns that leaves less of chi-square is named where the log fits, too."""
_TOLERANCE = 1e-5
_DEGREE = np.pi / 180.0


class Examination(NamedTuple):
    """test: of the log as it is. findings: alike, the likeliest first. lacks: why none is tried."""

    test: ChiSquareTest
    findings: list[LogFit]
    lacks: str = ""

    @property
    def words(self) -> str:
        """A sentence with the figures and what mends it; empty where nothing is found."""
        if not self.findings:
            return ""
        what = ", or ".join(f"{one.what} ({one.mend})" for one in self.findings)
        return (
            f"{what}: the smoother's chi-square falls from {self.test.chi2:.4g} to "
            f"{self.findings[0].chi2:.4g} with this changed, for {self.test.dof} degrees of freedom"
        )


class _Suspicion(NamedTuple):
    """change: the log as it should be. keeps_size: of all residuals, as a sign does."""

    what: str
    mend: str
    change: Callable[[Log], Log]
    keeps_size: bool = False
    unit: bool = False


def examine(log: Log) -> Examination:
    """Return what is wrong with units, signs, columns, clocks or sigmas of a log with labels.

    Nothing for a log that fits, or that no single change makes fit.
    """
    return _examined(log, numbers=True)


def examine_run(log: Log, run: EkfRun, result: SmootherResult) -> Examination:
    """Return what makes not only a part of a log fit, but all that a run used of it.

    log: as the estimators read it. result: the smoother's, whose chi-square is too high, and which
    no number explains.
    """
    of_part, chi2_of = _examined(log, numbers=False), chi2_by_run(run, result)

    def fits(one: LogFit) -> bool:
        try:
            chi2 = chi2_of(one.change(log), True)
        except (InputError, RuntimeError):
            return False
        return explains(result.optimality.chi_square, chi2, len(of_part.findings))

    return of_part._replace(findings=[one for one in of_part.findings if fits(one)])


def _examined(log: Log, *, numbers: bool) -> Examination:
    """Return what makes a part of a log fit. numbers: fit those of the sensors as well."""
    part, test, lacks = _tested(log)
    if lacks:
        return Examination(test, [], lacks)
    found = _named(part, test, _suspicions(part))
    if numbers and _unexplained(test, found):
        found += fitted_numbers(part, lambda changed, _: _solved(changed)[0], test)
    if _unexplained(test, found):
        found += _named(part, test, _as_variances(part))
    return Examination(test, alike(found))


def _unexplained(test: ChiSquareTest, found: list[LogFit]) -> bool:
    """Whether chi-square is too high and stays so with every change that was found."""
    least = min((one.chi2 for one in found), default=np.inf)
    return test.reading == "too high" and least > AS_WELL * test.upper


def _tested(log: Log) -> tuple[Log, ChiSquareTest, str]:
    """Return the part that is solved, its test, and why there is none."""
    none = ChiSquareTest(0.0, 0, 0.0, 0.0)
    if not log.measurements.labelled or not len(log.odometry.time_s):
        return log, none, "the log has no labelled measurements of landmarks"
    part = _part(join_known_measurements(log))
    chi2, dof = _solved(part)
    if not np.isfinite(chi2) or dof < _FEWEST:
        return part, none, "the smoother cannot solve a part of it"
    return part, chi_square_test(0.5 * chi2, dof), ""


def _named(part: Log, test: ChiSquareTest, suspicions: Iterator[_Suspicion]) -> list[LogFit]:
    tried = [(one, _solved(part, one.change)[0]) for one in suspicions]
    return [
        LogFit(one.what, chi2, one.change, one.mend, one.unit)
        for one, chi2 in tried
        if (test.reading == "too high" and explains(test, chi2, len(tried)))
        or (one.keeps_size and chi2 < _HALF * test.chi2)
    ]


def _part(log: Log) -> Log:
    """The first measurements, and what goes with them."""
    time_s = np.sort(log.measurements.time_s)
    if len(time_s) <= _MOST_MEASUREMENTS:
        return log
    return cut_log(log, None, float(time_s[_MOST_MEASUREMENTS]) - log.prior.time_s)


def _solved(log: Log, change: Callable[[Log], Log] | None = None) -> tuple[float, int]:
    """Chi-square and degrees of freedom of the smoother, infinite where it cannot be solved."""
    try:
        log = log if change is None else change(log)
        timeline = build_timeline(log, log.positions)
        index, ids = indices_by_label(log)
        problem = assemble(log, timeline, index, len(ids), position_rows(timeline, log.positions))
        graph = build_graph(problem)
        values = levenberg_marquardt(graph, relaxed_values(problem), _TOLERANCE)[0]
        dof = problem.residual_dimension - problem.state_dimension
        return 2.0 * float(graph.error(values)), dof
    except (InputError, RuntimeError, ValueError):
        return np.inf, 0


def _suspicions(log: Log) -> Iterator[_Suspicion]:
    """Gross faults, of what the log has."""
    motions = isinstance(log.odometry, RelativePoses)
    turn, speed = ("heading", "x") if motions else ("yaw_rate", "speed")
    rate = "rad" if motions else "radps"
    if isinstance(log.odometry, SteeringOdometry):
        turn, rate = "steering", "rad"
    degrees = rate.replace("rad", "deg")
    yield _Suspicion(
        "bearings grow clockwise", "give --unit bearing=-rad (or -deg)",
        lambda g: sensed(g, bearing=(-1.0, 0.0)), True,
    )  # fmt: skip
    yield _Suspicion(
        f"{turn} grows clockwise", f"give --unit {turn}=-{rate} (or -{degrees})",
        lambda g: driven(g, turn=(-1.0, 0.0)), True,
    )  # fmt: skip
    yield _Suspicion(
        "bearings are from the left, not from straight ahead", "subtract 90 degrees from them",
        lambda g: sensed(g, bearing=(1.0, -np.pi / 2)), True,
    )  # fmt: skip
    yield _Suspicion(
        "ranges and bearings are exchanged", "exchange the names of these two columns",
        _exchanged_measurements, True,
    )  # fmt: skip
    yield from (one._replace(unit=True) for one in _scales(turn, speed, rate))
    if motions:
        yield from _frames()
    else:
        yield _Suspicion(
            "times are milliseconds", "name the columns time_ms, or give --unit time=ms",
            lambda g: driven(g, (1e-3, 0.0), (1e-3 if rate == "radps" else 1.0, 0.0)),
        )  # fmt: skip
        yield _Suspicion(
            f"speed and {turn} are exchanged", "exchange the names of these two columns",
            _exchanged_controls, True,
        )  # fmt: skip


def _scales(turn: str, speed: str, rate: str) -> Iterator[_Suspicion]:
    """Units."""
    degrees = rate.replace("rad", "deg")
    for taken, factor in (("deg", _DEGREE), ("rad", 1.0 / _DEGREE)):
        right = "degrees" if taken == "deg" else "radians"
        yield _Suspicion(
            f"bearings are {right}", f"give --unit bearing={taken}",
            partial(sensed, bearing=(factor, 0.0)),
        )  # fmt: skip
        yield _Suspicion(
            f"{turn} is in {right}",
            f"give --unit {turn}={degrees if taken == 'deg' else rate}",
            partial(driven, turn=(factor, 0.0)),
        )
    yield _Suspicion(
        f"bearings and {turn} are degrees", f"give --unit bearing=deg --unit {turn}={degrees}",
        lambda g: sensed(driven(g, turn=(_DEGREE, 0.0)), bearing=(_DEGREE, 0.0)),
    )  # fmt: skip
    for unit, factor in (("cm", 1e-2), ("mm", 1e-3)):
        yield _Suspicion(
            f"ranges are {unit}", f"give --unit range={unit}",
            partial(sensed, range_=(factor, 0.0)),
        )  # fmt: skip
        yield _Suspicion(
            f"{speed} is in {unit}" + ("/s" if speed == "speed" else ""),
            f"divide it by {1.0 / factor:.0f}", partial(driven, speed=(factor, 0.0)),
        )  # fmt: skip
    if speed == "speed":
        yield _Suspicion(
            "speeds are km/h", "give --unit speed=kmh", lambda g: driven(g, (1.0 / 3.6, 0.0))
        )


def _frames() -> Iterator[_Suspicion]:
    """Axes of poses."""
    for what, x, y, turned in (
        ("x and y of the poses are exchanged", "y", "x", 1.0),
        ("y of the poses grows to the right", "x", "-y", 1.0),
        ("the poses are in a frame whose y and heading go clockwise", "x", "-y", -1.0),
        ("the poses are north, east and clockwise headings from north", "y", "x", -1.0),
    ):
        yield _Suspicion(
            what, f"give the odometry as x = {x}, y = {y}" + (", -heading" if turned < 0 else ""),
            partial(other_frame, x=x, y=y, turned=turned), True,
        )  # fmt: skip


def other_frame(log: Log, x: str, y: str, turned: float) -> Log:
    """Return a log of motions whose poses, from the origin on, have other axes; its noise stays.

    x, y: which of `x`, `y` and `-y` of the poses these are. turned: 1, or -1 for headings that grow
    the other way.
    """
    moved = log.odometry
    if not isinstance(moved, RelativePoses):
        return log
    pose = dead_reckoned(np.zeros(3), moved.displacement)
    axes = {"x": pose[:, 0], "y": pose[:, 1], "-y": -pose[:, 1]}
    heading = turned * pose[:, 2]
    step = (np.diff(axes[x]) + 1j * np.diff(axes[y])) * np.exp(-1j * heading[:-1])
    displacement = np.column_stack((step.real, step.imag, np.diff(heading)))
    return replace(log, odometry=replace(moved, displacement=displacement))


def _exchanged_measurements(log: Log) -> Log:
    seen = log.measurements
    if seen.bearing_rad.min(initial=1.0) <= 0.0:  # those cannot be ranges
        raise InputError("bearings are negative")
    bearing = np.angle(np.exp(1j * seen.range_m))
    return replace(log, measurements=replace(seen, range_m=seen.bearing_rad, bearing_rad=bearing))


def _exchanged_controls(log: Log) -> Log:
    moved = log.odometry
    if isinstance(moved, RelativePoses):
        return log
    turn: Array = (
        moved.steering_rad if isinstance(moved, SteeringOdometry) else moved.yaw_rate_radps
    )
    speed = moved.speed_mps
    return controlled(log, lambda _: turn, lambda _: speed)


def _as_variances(log: Log) -> Iterator[_Suspicion]:
    """Stated sigmas that are variances, below 1, or of another unit; of two sensors, too."""
    seen = log.measurements
    below_one = []
    for name, what in (("sigma_range_m", "range"), ("sigma_bearing_rad", "bearing")):
        if (getattr(seen, name) < 1.0).all():
            below_one.append(name)
            sigma = float(np.median(getattr(seen, name)))
            yield _Suspicion(
                f"the sigma of {what}s, {sigma:.4g}, is a variance",
                f"give --sigma-{what} {np.sqrt(sigma):.4g}",
                partial(_rooted, names=(name,)),
            )
    if len(below_one) == 2:
        yield _Suspicion(
            "the sigmas of ranges and bearings are variances", "give their square roots",
            partial(_rooted, names=tuple(below_one)),
        )  # fmt: skip
    sigma = float(np.median(seen.sigma_bearing_rad)) / _DEGREE
    yield _Suspicion(
        "the sigma of bearings is in radians and was taken for degrees",
        f"give --sigma-bearing {sigma:.4g}rad",
        lambda g: _with_sigmas(g, sigma_bearing_rad=g.measurements.sigma_bearing_rad / _DEGREE),
    )
    moved = log.odometry
    if not isinstance(moved, RelativePoses):
        speed, turn = np.sqrt((moved.noise.sigma_speed_mps, moved.noise.sigma_turn)).tolist()
        noise = replace(moved.noise, sigma_speed_mps=speed, sigma_turn=turn)
        rooted = replace(moved, noise=noise)
        yield _Suspicion(
            "the sigmas of the odometry are variances",
            f"give --sigma-speed {speed:.4g} --sigma-turn {turn:.4g}",
            lambda g: replace(g, odometry=rooted),
        )


def _rooted(log: Log, names: tuple[str, ...]) -> Log:
    """The log with the square roots of some sigmas."""
    seen = log.measurements
    return _with_sigmas(log, **{name: np.sqrt(getattr(seen, name)) for name in names})


def _with_sigmas(log: Log, **sigmas: Any) -> Log:
    return replace(log, measurements=replace(log.measurements, **sigmas))
