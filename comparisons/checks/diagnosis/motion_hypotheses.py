"""What a filter may have made of its odometry: steps, their Jacobian and their noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import motion_model
from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array, Index
from comparisons.explain.hypotheses import (
    EQUAL,
    Hypothesis,
    Quantity,
    best,
    instead,
    named,
    scaled,
)
from comparisons.explain.recorded import explained
from comparisons.faults.columns import read_columns, values_of
from comparisons.faults.grammar import B, F, Q, Text, Values, times
from comparisons.faults.misreadings import Misreading, joined_misreadings, misreadings
from comparisons.faults.streams import vehicle_changes
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses, SteeringOdometry, VelocityOdometry
from comparisons.logs.stamps import resolved
from comparisons.plane import in_own_axes, turned
from ekf_reference.models.motion import AckermannModel, MotionModel, MotionStep
from graphslam.graph_builder import to_tangent

_LAGS = (1, -1, *(sign * k for k in range(2, 11) for sign in (1, -1)))
Wheels = SteeringOdometry | VelocityOdometry
_SHIFTS_S = tuple(sign * 0.01 * k for k in range(1, 101) for sign in (1, -1))


@dataclass(frozen=True)
class _Drive:
    """N steps of a model: departing poses (N, 3), controls (N, m), intervals (N,)."""

    model: MotionModel
    departed: Array
    control: Array
    duration_s: Array

    def steps(self, rows: Index) -> tuple[Array, Array]:
        """Return moves (R, 3), ahead, left and turned, and B (R, 3, m) in the map."""
        each: list[MotionStep] = [
            self.model.step(self.departed[k], self.control[k], float(self.duration_s[k]))
            for k in rows
        ]
        by_control = np.array([step.jacobian_control for step in each])
        arrived = np.array([step.pose for step in each])
        return in_own_axes(self.departed[rows], arrived), by_control

    def by_interval(self, text: Text, change: Callable[..., Array], *start: float) -> _Mistake:
        """Return the mistake of other intervals (N,)."""
        return _Mistake(text, lambda *fit: replace(self, duration_s=change(*fit)), start)


class _Mistake(NamedTuple):
    """altered: of its numbers, the drive as it then goes. text, start: as of a hypothesis."""

    text: Text
    altered: Callable[..., _Drive]
    start: tuple[float, ...]

    @property
    def hypothesis(self) -> Hypothesis:
        """The moves are those of the drive as it then goes."""
        return Hypothesis(
            self.text, lambda rows, *figures: self.altered(*figures).steps(rows)[0], self.start
        )


def read_controls(log: Log, timeline: Timeline) -> tuple[Array, Index]:
    """Return values (S, m) of the odometry's samples, and whose each of N steps has, (N,).

    Where some step begins before the first sample, there is one more, of a vehicle that stands.
    """
    values = values_of(log, "odometry")
    if isinstance(log.odometry, RelativePoses):
        return values, np.arange(len(timeline.control))
    row = _samples_before(log.odometry, timeline.step_begin_s)
    if row.all():
        return values, row - 1
    return np.vstack((np.zeros(2), values)), row


def _samples_before(odometry: Wheels, time_s: Array) -> Index:
    """How many samples are at or before times (N,), to rounding."""
    late_s = time_s + np.maximum(1e-9, 2.0 * np.spacing(np.abs(time_s)))
    return np.searchsorted(resolved(odometry.time_s), late_s, side="right")


def motion_hints(log: Log, run: EkfRun, rounding: float) -> Iterator[str]:
    """Yield what was done to the odometry."""
    trace, timeline = run.trace, run.timeline
    if len(trace.departed) != len(timeline.control):
        yield (
            f"the trace has {len(trace.departed)} predictions, the log "
            f"{len(timeline.control)} intervals"
        )
        return
    drive = _Drive(motion_model(log), trace.departed, timeline.control, timeline.step_duration_s)
    every = np.arange(len(trace.departed))
    meant, by_control = drive.steps(every)
    moves = Quantity(
        have=in_own_axes(trace.departed, trace.arrived),
        meant=meant,
        tolerance=EQUAL * np.maximum(1e-6, np.abs(meant).max())
        + rounding * 8.0 * max(float(np.abs(trace.departed).max()), np.pi),
        records="predictions",
        features={
            "time [s]": timeline.step_begin_s,
            "interval [s]": timeline.step_duration_s,
            **{f"control {k + 1}": u for k, u in enumerate(timeline.control.T)},
        },
    )
    odometry = log.odometry
    lines, used = _moved(log, moves, drive, timeline)
    yield from lines
    yield from _jacobian(run, moves, timeline.step_duration_s)
    if not isinstance(odometry, RelativePoses):
        others = [] if used is None else [used, _at_the_speed(used, timeline.step_duration_s)]
        ways = [by_control, *(other.steps(every)[1] for other in others)]
        yield from _step_noise(odometry, run, ways, moves, rounding)
    else:
        yield from _displacement_noise(run, moves)


def _at_the_speed(drive: _Drive, duration_s: Array) -> _Drive:
    """The same way, by another speed in place of another interval."""
    control = drive.control.copy()
    control[:, 0] *= drive.duration_s / duration_s
    return replace(drive, control=control, duration_s=duration_s)


def _moved(
    log: Log, moves: Quantity, drive: _Drive, timeline: Timeline
) -> tuple[list[str], _Drive | None]:
    """What leads elsewhere, and the drive that goes there, if it is one."""
    if not moves.off().any():
        return [], None
    for mistake in _altered(log, moves, drive, timeline):
        fitted = best(moves, [mistake.hypothesis])
        if fitted is not None:
            used = _where(moves.off(), mistake.altered(*fitted[1]), drive)
            return [fitted[0].counted(fitted[1], moves)], used
    return named(moves, _bent(moves, drive)), None


def _where(off: NDArray[np.bool_], there: _Drive, elsewhere: _Drive) -> _Drive:
    """One drive in some steps, the other in the rest; the model cannot change in between."""
    if off.all() or there.model is not elsewhere.model:
        return there
    return replace(
        there,
        control=np.where(off[:, None], there.control, elsewhere.control),
        duration_s=np.where(off, there.duration_s, elsewhere.duration_s),
    )


def _altered(log: Log, moves: Quantity, drive: _Drive, timeline: Timeline) -> Iterator[_Mistake]:
    """Other controls, intervals and measures of the vehicle: those without a number first."""
    (values, row), columns = read_controls(log, timeline), read_columns(log, "odometry")

    def controlled(misread: Misreading) -> _Mistake:
        def altered(*numbers: float) -> _Drive:
            return replace(drive, control=misread.values(values, *numbers)[row])

        return _Mistake(misread.said, altered, misread.start)

    every = [controlled(misreading) for misreading in misreadings(columns, _LAGS)]
    pairs = [controlled(misreading) for misreading in joined_misreadings(columns)]
    if isinstance(log.odometry, RelativePoses):
        yield from (*every, *pairs)
        return
    single, numbered = _by_numbers(every)
    first, others = _by_numbers(list(_of_vehicle(log.odometry, drive)))
    yield from (*single, *_other_steps(drive), *first, *_longer(drive), *numbered)
    yield from (*_other_intervals(moves, drive), *others, *pairs)
    yield from _other_clock(log.odometry, drive, timeline)


def _by_numbers(mistakes: list[_Mistake]) -> tuple[list[_Mistake], list[_Mistake]]:
    """Those without a number, and the others."""
    return [mistake for mistake in mistakes if not mistake.start], [
        mistake for mistake in mistakes if mistake.start
    ]


def _other_steps(drive: _Drive) -> Iterator[_Mistake]:
    s, model = drive.duration_s, drive.model
    yield drive.by_interval(
        "a prediction uses the interval of the previous one", lambda: np.roll(s, 1)
    )
    yield _Mistake("the control is applied twice", lambda: replace(drive, model=_Twice(model)), ())


def _longer(drive: _Drive) -> Iterator[_Mistake]:
    """Longer intervals, or a faster vehicle: of a car, whose turn goes with it, the speed alone."""
    faster = times("the speed" if isinstance(drive.model, AckermannModel) else "the odometry",
                   "the log's")  # fmt: skip

    def text(factor: float) -> str:
        return f"{faster(factor)}, or every prediction lasts {factor:.4g} times its interval"

    yield drive.by_interval(text, lambda k: k * drive.duration_s, 1.0)


def _other_intervals(moves: Quantity, drive: _Drive) -> Iterator[_Mistake]:
    always_s = _always(moves, drive)
    yield drive.by_interval(
        f"the interval is always {always_s:.4g} s", lambda: 0.0 * drive.duration_s + always_s
    )


def _always(moves: Quantity, drive: _Drive) -> float:
    """The interval [s] by which the moves would be as long as they are, if it is one."""
    far, meant = (np.linalg.norm(m[:, :2], axis=1) for m in (moves.have, moves.meant))
    driven = meant > 1e-6
    if not driven.any():
        return 0.0
    return float(np.median((far[driven] / meant[driven]) * drive.duration_s[driven]))


def _of_vehicle(odometry: Wheels, drive: _Drive) -> Iterator[_Mistake]:
    """Other measures of a car."""
    model = drive.model
    if not isinstance(odometry, SteeringOdometry) or not isinstance(model, AckermannModel):
        return
    for change in vehicle_changes(odometry.vehicle):
        yield _Mistake(
            change.words,
            lambda *numbers, change=change: replace(
                drive, model=replace(model, **change.measures(*numbers))
            ),
            change.start,
        )


def _other_clock(odometry: Wheels, drive: _Drive, timeline: Timeline) -> Iterator[_Mistake]:
    """Controls of the samples of another time."""
    values = np.vstack((np.zeros(2), np.column_stack(odometry.controls)))
    for seconds in _SHIFTS_S:
        control = values[_samples_before(odometry, timeline.step_begin_s - seconds)]
        text = f"the odometry is used {abs(seconds):.4g} s {'late' if seconds > 0 else 'early'}"
        yield _Mistake(text, lambda control=control: replace(drive, control=control), ())


def _bent(moves: Quantity, drive: _Drive) -> Iterator[Hypothesis]:
    """Moves that no other control explains: another heading on the way, a slip."""
    meant, s = moves.meant, drive.duration_s
    turn = meant[:, 2]

    def added(text: str, column: int) -> Hypothesis:
        def predict(rows: Index, rate: float) -> Array:
            result = meant[rows].copy()
            result[:, column] += rate * s[rows]
            return result

        return Hypothesis(text, predict, (0.0,))

    def along(part: float, *, arc: bool = False) -> Array:
        shrunk = np.sinc(0.5 * turn / np.pi) if arc else np.ones(len(turn))
        ways = turned(meant[:, :2], part * turn) * shrunk[:, None]
        return np.column_stack((ways, turn))

    car = isinstance(drive.model, AckermannModel)
    yield added("the yaw rate has a bias of {0:.3g} rad/s", 2)
    yield scaled("the rotation of a step", meant, np.array((0.0, 0.0, 1.0)))
    if car:  # the model leads along the departing heading
        yield instead("the step follows the arc, not the heading at its start",
                      along(0.5, arc=True))  # fmt: skip
        yield instead("the step follows the heading at its middle", along(0.5))
        yield instead("the step follows the heading at its end", along(1.0))
    else:  # along the one in the middle
        yield instead("the step follows the heading at its start", along(-0.5))
        yield instead("the step follows the heading at its end", along(0.5))
        yield instead("the step has the length of the arc, not of the chord",
                      along(0.0, arc=True))  # fmt: skip
    yield added("the vehicle slips {0:+.4g} m/s to the left", 1)
    yield added("the vehicle slips {0:+.4g} m/s forward", 0)
    yield scaled("the translation of a step", meant, np.array((1.0, 1.0, 0.0)))

    def turned_by(rows: Index, angle: float) -> Array:
        ways = turned(meant[rows, :2], np.full(len(rows), angle))
        return np.column_stack((ways, meant[rows, 2]))

    yield Hypothesis("the direction of a step is rotated by {0:+.4g} rad", turned_by, (0.0,))


class _Twice:
    """Two steps in one."""

    def __init__(self, model: MotionModel) -> None:
        self._model = model

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        motion_step = self._model.step(pose, control, duration_s)
        return self._model.step(motion_step.pose, control, duration_s)


def _jacobian(run: EkfRun, moves: Quantity, duration_s: Array) -> list[str]:
    """F, of the moves that were made."""
    trace = run.trace
    move = trace.arrived - trace.departed
    turn = move[:, 2]

    def by_heading(east: Array, north: Array) -> Array:
        f = np.broadcast_to(np.eye(3), (len(move), 3, 3)).copy()
        f[:, 0, 2], f[:, 1, 2] = east, north
        return f

    def at(part: float) -> Array:
        return by_heading(*turned(np.column_stack((-move[:, 1], move[:, 0])), part * turn).T)

    want = by_heading(-move[:, 1], move[:, 0])
    values = Values(
        sound=want,
        factors={"the interval": duration_s},
        elsewhere={
            "linearised at the pose after the step": at(1.0),
            "linearised at the heading at the middle of the step": at(0.5),
            "linearised at the pose before the step, not at its middle": at(-0.5),
            "that of the previous step": np.roll(want, 1, axis=0),
        },
    )
    return explained(F, replace(moves, have=trace.f, meant=want), values)


def _step_noise(
    wheels: Wheels, run: EkfRun, used: list[Array], moves: Quantity, rounding: float
) -> list[str]:
    """Q is B S B^T and what every step adds. used: B (N, 3, 2) by any control it may be of."""
    noise, trace, s = wheels.noise, run.trace, run.timeline.step_duration_s[:, None, None]
    place = s * np.diag((noise.variance_rate_position,) * 2 + (0.0,))
    heading = s * np.diag((0.0, 0.0, noise.variance_rate_heading))
    tolerance = EQUAL + 32.0 * rounding * max(1.0, np.abs(trace.departed).max())
    by_each = []
    for b in used:
        full = _spread(b, run.timeline.control_covariance) + place + heading
        by_each.append((_of_noise(moves, trace.q, full, tolerance), b))
    quantity, b = min(by_each, key=lambda pair: np.count_nonzero(pair[0].off()))
    turn = "steering angle" if isinstance(wheels, SteeringOdometry) else "yaw rate"
    rates = place + heading
    full = _spread(b, run.timeline.control_covariance) + rates
    return named(quantity, _of_step_noise(run, b, (place, heading), turn)) or _composed_noise(
        quantity, run, b, (full, rates)
    )


def _composed_noise(
    quantity: Quantity, run: EkfRun, b: Array, noise: tuple[Array, Array]
) -> list[str]:
    """Q of another B (N, 3, 2), or itself another. noise: Q (N, 3, 3), and what each step adds."""
    (full, rates), stated = noise, run.timeline.control_covariance
    factors = {"the interval": run.timeline.step_duration_s}
    size, heading = _sizes(full), run.trace.departed[:, 2]

    def of_b(values: Array, rows: Index) -> Array:
        found: Array = (_spread(values, stated[rows]) + rates[rows]) / size[rows]
        return found

    def of_q(values: Array, rows: Index) -> Array:
        found: Array = values / size[rows]
        return found

    jacobian = Values(sound=b, factors=factors, heading=heading)
    whole = Values(
        sound=full,
        factors=factors,
        heading=heading,
        elsewhere={"that of the previous step": np.roll(full, 1, axis=0)},
    )
    return explained(B, quantity, jacobian, of_b) or explained(Q, quantity, whole, of_q)


def _of_noise(moves: Quantity, q: Array, meant: Array, tolerance: Array | float) -> Quantity:
    """Q (N, 3, 3), recorded and as it should be, over products of sigmas."""
    size = _sizes(meant)
    return replace(moves, have=q / size, meant=meant / size, tolerance=tolerance)


def _sizes(full: Array) -> Array:
    """(N, 3, 3) products of sigmas."""
    sigma = np.sqrt(full[:, (0, 1, 2), (0, 1, 2)])
    place = np.maximum(sigma[:, :1], sigma[:, 1:2])
    sigma = np.maximum(np.column_stack((place, place, sigma[:, 2])), 1e-30)
    size: Array = sigma[:, :, None] * sigma[:, None, :]
    return size


def _spread(b: Array, covariance: Array) -> Array:
    total: Array = b @ covariance @ b.transpose(0, 2, 1)
    return total


def _of_step_noise(
    run: EkfRun, b: Array, rates: tuple[Array, Array], turn: str
) -> Iterator[Hypothesis]:
    """rates: what every step adds (N, 3, 3), to the position and to the heading."""
    stated, (place, heading) = run.timeline.control_covariance, rates
    added, s = place + heading, run.timeline.step_duration_s[:, None, None]
    own = _spread(b, stated)
    full = own + added
    size = _sizes(full)

    def other(text: str, control: Array, rates: Array = added) -> Hypothesis:
        return instead(text, (control + rates) / size)

    yield other("the Jacobian of the control is not multiplied by the interval", own / s**2)
    yield other("the control part of Q grows with the interval, not with its square", own / s)
    yield other("the control part of Q is multiplied by the interval once too often", own * s)
    yield other("the stabilisation noise is not multiplied by the interval", own, added / s)
    yield other("the stabilisation noise is missing", own, 0.0 * added)
    yield other("Q contains the stabilisation noise alone, without the control noise", 0.0 * own)
    parts = [stated * np.diag(unit) for unit in np.eye(stated.shape[1])]
    yield from _sigmas(b, stated, parts, other, turn)
    yield from _frames(run, own, other)
    split = [_spread(b, part) / size for part in parts]
    names = ("speed", turn)
    whole = {
        "the control part of Q": (own, added),
        **{f"the {name} part of Q": (split[k] * size, full - split[k] * size)
           for k, name in enumerate(names)},
        "Q": (full, 0.0 * full),
        "the stabilisation noise": (added, own),
        "the stabilisation noise of the position": (place, full - place),
        "the stabilisation noise of the heading": (heading, full - heading),
    }  # fmt: skip
    for name, (varied, kept) in whole.items():
        yield _varied(name, varied / size, kept / size)
    rest = added / size
    yield Hypothesis(
        f"the speed part of Q is {{0:.4g}} times and the {turn} part {{1:.4g}} times the correct "
        "value",
        lambda rows, k, j: k * split[0][rows] + j * split[1][rows] + rest[rows],
        (1.0, 1.0),
    )
    middle = np.median(run.trace.q, axis=0)
    yield instead("Q is constant", np.broadcast_to(middle, full.shape) / size)
    at_rate = middle / float(np.median(s))
    yield instead("Q depends on the interval alone", at_rate * s / size)


def _varied(name: str, varied: Array, kept: Array) -> Hypothesis:
    """Part of a covariance (N, 3, 3) has a factor, and the rest has none."""
    return Hypothesis(times(name), lambda rows, k: k * varied[rows] + kept[rows], (1.0,))


def _sigmas(
    b: Array,
    stated: Array,
    parts: list[Array],
    other: Callable[[str, Array], Hypothesis],
    turn: str,
) -> Iterator[Hypothesis]:
    """Sigmas for variances, and variances squared, in all of the control or one of it."""
    yield other("Q contains sigma instead of sigma squared", _spread(b, np.sqrt(stated)))
    yield other("Q contains the square of the variances", _spread(b, stated**2))
    for k, name in enumerate(("speed", turn)):
        rest = stated - parts[k]
        for text, covariance in (
            ("sigma instead of sigma squared", np.sqrt(parts[k])),
            ("the square of the variance", parts[k] ** 2),
        ):
            yield other(f"the {name} part of Q contains {text}", _spread(b, covariance + rest))


def _frames(
    run: EkfRun, own: Array, other: Callable[[str, Array], Hypothesis]
) -> Iterator[Hypothesis]:
    """The control's noise (N, 3, 3), turned by something else than it should be."""
    departed, arrived = run.trace.departed[:, 2], run.trace.arrived[:, 2]
    for text, by in (
        ("Q is not rotated: it stays in the vehicle's frame", -departed),
        ("Q is rotated by the heading after the step", arrived - departed),
        ("Q is rotated by the heading at the middle of the step", 0.5 * (arrived - departed)),
        ("Q is rotated by the negative heading", -2.0 * departed),
    ):
        yield other(text, _spread(_rotations(by), own))


def _rotations(by: Array) -> Array:
    """(N, 3, 3) in the plane."""
    return np.ascontiguousarray(to_tangent(by).transpose(0, 2, 1))


def _displacement_noise(run: EkfRun, moves: Quantity) -> list[str]:
    """Q of measured displacements: their covariance, turned from the frame of arrival."""
    trace, stated = run.trace, run.timeline.control_covariance
    departed, arrived = trace.departed[:, 2], trace.arrived[:, 2]

    def seen_from(by: Array, covariance: Array = stated) -> Array:
        return _spread(_rotations(by), covariance)

    meant = seen_from(arrived)
    size = _sizes(meant)
    quantity = _of_noise(moves, trace.q, meant, EQUAL + moves.tolerance)
    diagonal = stated * np.eye(3)
    parts = {
        name: stated * np.diag(mask)
        for name, mask in (("position", (1.0, 1.0, 0.0)), ("heading", (0.0, 0.0, 1.0)))
    }
    return named(
        quantity,
        (
            instead("Q is not rotated: it stays in the frame after the step", stated / size),
            instead("Q is rotated by the heading before the step", seen_from(departed) / size),
            instead("Q is rotated by the negative heading", seen_from(-arrived) / size),
            instead(
                "Q contains sigma instead of sigma squared",
                seen_from(arrived, np.sqrt(diagonal)) / size,
            ),
            instead(
                "Q contains the square of the variances", seen_from(arrived, diagonal**2) / size
            ),
            scaled("Q", quantity.meant),
            *(
                _varied(
                    f"the {name} part of Q",
                    seen_from(arrived, part) / size,
                    seen_from(arrived, stated - part) / size,
                )
                for name, part in parts.items()
            ),
        ),
    )
