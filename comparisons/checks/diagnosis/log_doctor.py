"""What is wrong with a log before any filter sees it: units, signs, columns, clocks, sigmas.

Each suspicion is a change of the log that would mend it. The smoother solves a part of the log with
the log's labels as it is and with each change; a change is named where what is left is the stated
noise, as a whole and by sensor, landmark and time.
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
    LogFit,
    alike,
    fitted_numbers,
    promising,
    solve_by_run,
)
from comparisons.checks.diagnosis.other_noise import has_stated_noise
from comparisons.checks.diagnosis.solved_log import Solve, SolvedLog
from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses, SteeringOdometry
from comparisons.logs.transforms.calibration import controlled, driven, sensed
from comparisons.logs.transforms.known_landmarks import indices_by_label, join_known_measurements
from graphslam.goodness_of_fit import Goodness, far_less
from graphslam.graph_builder import build_graph
from graphslam.increments import dead_reckoned
from graphslam.optimisers import levenberg_marquardt
from graphslam.optimum import ChiSquareTest
from graphslam.search import relaxed_values
from graphslam.smoother import SmootherEvidence

_MOST_MEASUREMENTS = 600
"""Of the part that is solved first."""
_FEWEST = 20
"""Degrees of freedom; fewer tell nothing."""
_TOLERANCE = 1e-5
_DEGREE = np.pi / 180.0


class Examination(NamedTuple):
    """What is wrong with a log.

    test: of the log as it is, or of its first part. findings: changes with which all of it fits,
    the likeliest first. lacks: why none is tried. departure: where its residuals leave the stated
    noise, if no change makes it fit. part: what is tested, where that is not the whole.
    """

    test: ChiSquareTest
    findings: list[LogFit]
    lacks: str = ""
    departure: str = ""
    part: str = ""

    @property
    def words(self) -> str:
        """A sentence with the figures and what mends it, or where the log leaves its noise.

        Empty where nothing is wrong.
        """
        test = self.test
        if self.findings:
            what = ", or if ".join(f"{one.what} ({one.mend})" for one in self.findings)
            return (
                f"the log fits if {what}: the smoother's chi-square falls from {test.chi2:.4g} to "
                f"{self.findings[0].chi2:.4g} with this changed, for {test.dof} degrees of freedom"
            )
        if test.reading != "too high":
            return ""
        where = f"; {self.departure}" if self.departure else ""
        return (
            f"chi-square{self.part} is too high, {test.chi2:.4g} for {test.dof} degrees of "
            f"freedom, and none of the changes tried fits{where}"
        )


class _Suspicion(NamedTuple):
    """change: the log as it should be. keeps_size: of all residuals, as a sign does.

    sensors: whose sigmas it changes; their residuals have to tell the noise that is then stated.
    """

    what: str
    mend: str
    change: Callable[[Log], Log]
    keeps_size: bool = False
    unit: bool = False
    sensors: tuple[str, ...] = ()


class _Tested(NamedTuple):
    """A log, or its first part, and its optimum. solve: of it with a change."""

    log: Log
    solved: SolvedLog
    solve: Solve

    @property
    def test(self) -> ChiSquareTest:
        """Of the log as it is."""
        return self.solved.goodness.test


def examine(log: Log) -> Examination:
    """Return what is wrong with units, signs, columns, clocks or sigmas of a log with labels.

    Nothing for a log that fits. Of a long log a part is solved first; what makes that fit has to
    make all of it fit.
    """
    log = join_known_measurements(log)
    part = _part(log)
    tested, lacks = _tested(part)
    if tested is None:
        return Examination(ChiSquareTest(0.0, 0, 0.0, 0.0), [], lacks)
    whole = tested if part is log else None
    scope = "" if whole else f" of its first {len(part.measurements.time_s)} measurements"
    for changes in (_of_suspicions, _of_numbers, _of_variances):
        if not changes(tested):
            continue
        whole = whole or _tested(log)[0]
        if whole is not None and (fits := changes(whole)):
            return Examination(whole.test, fits)
    high = tested.test.reading == "too high"
    departure = tested.solved.departure if high else ""
    return Examination(tested.test, [], departure=departure, part=scope)


def examine_run(log: Log, run: EkfRun, result: SmootherEvidence, solved: SolvedLog) -> list[LogFit]:
    """Return what makes a log fit as a run used it, the likeliest first.

    log: as the estimators read it, with labels; else nothing. result: the smoother's, whose
    chi-square is too high, and which no number explains. solved: the same.
    """
    if not log.measurements.labelled or not len(log.odometry.time_s):
        return []
    part = _part(replace(log, positions=run.positions))
    whole = _Tested(log, solved, solve_by_run(run, result))
    tested = whole if len(part.measurements.time_s) == len(log.measurements.time_s) else None
    tested = tested or _tested(join_known_measurements(part))[0]
    for changes in (_of_suspicions, _of_variances):
        if tested is not None and changes(tested) and (fits := changes(whole)):
            return fits
    return []


def _of_suspicions(tested: _Tested) -> list[LogFit]:
    return _named(tested, list(_suspicions(tested.log)))


def _of_numbers(tested: _Tested) -> list[LogFit]:
    if tested.test.reading != "too high":
        return []
    return fitted_numbers(tested.log, tested.solve, tested.test)


def _of_variances(tested: _Tested) -> list[LogFit]:
    if tested.test.reading != "too high":
        return []
    return _named(tested, list(_as_variances(tested.log)))


def _named(tested: _Tested, suspicions: list[_Suspicion]) -> list[LogFit]:
    """Return the changes that leave the stated noise, or, of signs and columns, less than it."""
    test, fits = tested.test, []
    for one in suspicions:
        if test.reading != "too high" and not one.keeps_size:
            continue
        try:
            solved = tested.solve(one.change(tested.log), True)
        except (InputError, RuntimeError, ValueError):
            continue
        goodness = solved.goodness
        if promising(test, solved.chi2, len(suspicions)):
            fit = goodness.sound and has_stated_noise(goodness, one.sensors)
        else:
            fit = one.keeps_size and far_less(goodness.test, test) and goodness.within
        if fit:
            fits.append(LogFit(one.what, solved, one.change, one.mend, one.unit))
    return alike(fits)


def _tested(log: Log) -> tuple[_Tested | None, str]:
    """Return a log with its optimum, or why there is none."""
    if not log.measurements.labelled or not len(log.odometry.time_s):
        return None, "the log has no labelled measurements of landmarks"
    try:
        solved = _solved(log)
    except (InputError, RuntimeError, ValueError):
        solved = None
    if solved is None or not np.isfinite(solved.chi2) or solved.goodness.test.dof < _FEWEST:
        return None, "the smoother cannot solve a part of it"
    return _Tested(log, solved, _solved), ""


def _part(log: Log) -> Log:
    """The first measurements, and what goes with them."""
    time_s = np.sort(log.measurements.time_s)
    if len(time_s) <= _MOST_MEASUREMENTS:
        return log
    return cut_log(log, None, float(time_s[_MOST_MEASUREMENTS]) - log.prior.time_s)


def _solved(log: Log, _: bool = True) -> SolvedLog:
    """The smoother's optimum by the labels. Raises InputError, RuntimeError or ValueError."""
    timeline = build_timeline(log, log.positions)
    index, ids = indices_by_label(log)
    problem = assemble(log, timeline, index, len(ids), position_rows(timeline, log.positions))
    graph = build_graph(problem)
    values = levenberg_marquardt(graph, relaxed_values(problem), _TOLERANCE)[0]
    goodness = Goodness(problem, graph, values)
    return SolvedLog(goodness, timeline.epoch_time_s, ids.tolist(), log.labels)


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
                sensors=(what,),
            )
    if len(below_one) == 2:
        yield _Suspicion(
            "the sigmas of ranges and bearings are variances", "give their square roots",
            partial(_rooted, names=tuple(below_one)), sensors=("range", "bearing"),
        )  # fmt: skip
    sigma = float(np.median(seen.sigma_bearing_rad)) / _DEGREE
    yield _Suspicion(
        "the sigma of bearings is in radians and was taken for degrees",
        f"give --sigma-bearing {sigma:.4g}rad",
        lambda g: _with_sigmas(g, sigma_bearing_rad=g.measurements.sigma_bearing_rad / _DEGREE),
        sensors=("bearing",),
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
            sensors=("odometry",),
        )


def _rooted(log: Log, names: tuple[str, ...]) -> Log:
    """The log with the square roots of some sigmas."""
    seen = log.measurements
    return _with_sigmas(log, **{name: np.sqrt(getattr(seen, name)) for name in names})


def _with_sigmas(log: Log, **sigmas: Any) -> Log:
    return replace(log, measurements=replace(log.measurements, **sigmas))
