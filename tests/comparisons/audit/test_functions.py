"""The matrices of a filter beside the derivatives of its own functions."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from comparisons.audit.algebra import AuditFinding
from comparisons.audit.audit import Audit, audit
from comparisons.checks.of_events import audit_trace
from comparisons.trace.events import Evaluation
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import Recorder
from examples.audit import inertial, pointing, turning
from slamcheck import record
from tests.commands import slamcheck
from tests.helpers import Array

Change = Callable[[str, Array, Array], Array]
FILTERS = {"turning": turning.track, "inertial": inertial.fly, "pointing": pointing.point}


def derivatives(found: Audit) -> list[AuditFinding]:
    return [finding for finding in found.findings if finding.check == "derivatives"]


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("seed", [0, 1])
def test_sound_filters_are_not_accused(tmp_path: Path, name: str, seed: int) -> None:
    FILTERS[name](tmp_path / "run.trace", seed=seed)
    found = audit_trace(tmp_path / "run.trace", 1e-6)
    assert found.verdict == "sound"
    assert derivatives(found) == []
    assert all(slot.events > 50 and not slot.differing for slot in found.functions)
    assert "derivatives" not in found.not_checked


def changed(of: str, rows: slice, columns: slice, by: Callable[[Array, Array], Array]) -> Change:
    """A change of a part of F or H. by: of the part, and the state."""

    def change(name: str, matrix: Array, x: Array) -> Array:
        if name == of:
            matrix[rows, columns] = by(matrix[rows, columns], x)
        return matrix

    return change


ALL, ATTITUDE, VELOCITY, POSITION = slice(None), slice(0, 3), slice(3, 6), slice(6, 9)
GYRO, ACCELEROMETER = slice(9, 12), slice(12, 15)


def rotation(x: Array) -> Array:
    return x[:9].reshape(3, 3)


FAULTS: dict[str, tuple[str, Change, str]] = {
    "sign of a term": (
        "turning",
        changed("F", slice(0, 1), slice(2, 3), lambda part, x: -part),
        "the heading term of the position[0] row of F has the opposite sign",
    ),
    "degrees": (
        "turning",
        changed("H", slice(1, 2), ALL, lambda part, x: np.degrees(part)),
        "sensor `radar`: the row block of bearing in H is 57.2958 times the correct value (degrees "
        "instead of radians)",
    ),
    "exchanged columns": (
        "turning",
        changed("H", ALL, slice(0, 2), lambda part, x: part[:, ::-1]),
        "sensor `radar`: the columns of position[0] and position[1] in H are exchanged",
    ),
    "whole transposed": (
        "turning",
        lambda name, matrix, x: matrix.T if name == "F" else matrix,
        "F is transposed",
    ),
    "no lever arm": (
        "inertial",
        inertial.without_lever,
        "sensor `gnss`: the column block of attitude in H is zero",
    ),
    "the other side of the attitude's error": (
        "inertial",
        changed("F", VELOCITY, ATTITUDE, lambda part, x: part @ rotation(x).T),
        "the part of F that leads from attitude to velocity is by errors in the world's axes "
        "(times the attitude's inverse from the right)",
    ),
    "acceleration in the body's axes": (
        "inertial",
        changed("F", VELOCITY, ACCELEROMETER, lambda part, x: rotation(x).T @ part),
        "the part of F that leads from accelerometer bias to velocity is in the body's axes by its "
        "rows (times the attitude's inverse from the left)",
    ),
    "rotation transposed": (
        "inertial",
        changed("F", ATTITUDE, ATTITUDE, lambda part, x: part.T),
        "the part of F that leads from attitude to attitude is transposed",
    ),
    "sign of the gyro's bias": (
        "pointing",
        changed("F", slice(0, 3), slice(3, 6), lambda part, x: -part),
        "the part of F that leads from bias to attitude has the opposite sign",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_wrong_jacobian_is_named(tmp_path: Path, name: str) -> None:
    """First of all, with how much it matters, and where."""
    of, change, said = FAULTS[name]
    FILTERS[of](tmp_path / "run.trace", change)
    found = audit(tmp_path / "run.trace")
    assert found.verdict == "faulty"
    first = found.findings[0]
    assert first.check == "derivatives"
    assert first.text.startswith(f"{said}: not the derivative of its function, by up to ")
    assert first.event is not None
    assert first.event <= 50


def test_what_no_change_explains_is_shown_by_entry(tmp_path: Path) -> None:
    """Gravity is in the acceleration, where the specific force belongs."""

    def total(part: Array, x: Array) -> Array:
        turned = rotation(x)
        return part - turned @ inertial.skew(turned.T @ inertial.GRAVITY) * inertial.DT

    change = changed("F", VELOCITY, ATTITUDE, total)
    inertial.fly(tmp_path / "run.trace", change)
    first = audit(tmp_path / "run.trace").findings[0]
    assert first.fault
    assert first.text.startswith("F is not the derivative of its function (velocity[")
    assert "170 of 170" in first.text


def test_a_first_order_transition_is_a_note(tmp_path: Path) -> None:
    """I + A dt beside the exact one: no fault, and said with what it matters."""

    def first_order(name: str, matrix: Array, x: Array) -> Array:
        if name == "F":
            matrix[ATTITUDE, GYRO] = -inertial.DT * np.eye(3)
            matrix[POSITION, ATTITUDE] = matrix[POSITION, ACCELEROMETER] = 0.0
        return matrix

    inertial.fly(tmp_path / "run.trace", first_order)
    found = audit(tmp_path / "run.trace")
    assert found.verdict == "sound"
    (note,) = derivatives(found)
    assert "but for terms of second order in the step" in note.text


def test_a_large_step_hides_no_fault_in_its_square(tmp_path: Path) -> None:
    """What F lacks is less than the square of F - I, and matters."""
    p = np.eye(1)
    with Recorder(tmp_path / "run.trace") as recorder:
        recorder.prior({"a": 1}, p)
        for _ in range(5):
            recorder.predict(0.7, 0.01, point=[1.0], after=[0.5], function=lambda x: 0.5 * x)
            p = 0.49 * p + 0.01
            recorder.snapshot(p)
    (fault,) = derivatives(audit(tmp_path / "run.trace"))
    assert fault.fault
    assert fault.text.startswith("F is 1.4 times the correct value: not the derivative of its")


def test_a_fault_that_begins_has_its_event(tmp_path: Path) -> None:
    count = 0

    def later(name: str, matrix: Array, x: Array) -> Array:
        nonlocal count
        count += name == "F"
        if name == "F" and count > 50:
            matrix[2, 4] = 0.0
        return matrix

    turning.track(tmp_path / "run.trace", later)
    first = audit(tmp_path / "run.trace").findings[0]
    assert "the part of F that leads from turn to heading is zero" in first.text
    assert f"from event {first.event} on" in first.text
    assert first.event is not None
    assert 120 < first.event < 250


def scalar(path: Path, residual: Callable[[float, float], float], step: float = 1.0) -> Audit:
    """A filter of one number, which it doubles, with another residual, or another step."""
    rng, x, p = np.random.default_rng(2), np.array([3.0]), np.eye(1)
    with Recorder(path) as recorder:
        recorder.prior({"a": 1}, p, point=x)
        for _ in range(40):
            after = x + step * 0.1 * x
            recorder.predict(1.1, 0.01, point=x, after=after, function=lambda number: 1.1 * number)
            x, p = after, 1.21 * p + 0.01
            z = float(x[0] + rng.normal())
            off = residual(z, float(x[0]))
            gain = p / (p + 1.0)
            recorder.update(
                "x", off, 1.0, 1.0, point=x, gain=gain, function=lambda number: number, measured=z
            )
            x, p = x + gain[0] * off, p - gain * p
            recorder.snapshot(p)
    return audit(path)


def test_a_residual_of_the_other_sign_is_named(tmp_path: Path) -> None:
    assert derivatives(scalar(tmp_path / "right.trace", lambda z, h: z - h)) == []
    (fault,) = derivatives(scalar(tmp_path / "run.trace", lambda z, h: h - z))
    assert fault.text.startswith("the residual of `x` has the opposite sign, in ")


def test_a_step_that_is_not_the_functions_is_named(tmp_path: Path) -> None:
    (fault,) = derivatives(scalar(tmp_path / "run.trace", lambda z, h: z - h, step=2.0))
    assert fault.text.startswith(
        "the step of the estimate is 2 times the correct value, in 40 of 40"
    )


class Doubling:
    """A filter of one's own, with f and h beside F and H. factor: of F, where f has 2."""

    def __init__(self, factor: float) -> None:
        self.x, self.P, self.factor = np.array([1.0]), np.eye(1), factor

    def f(self, x: Array, dt: float) -> Array:
        return x * (1.0 + dt)

    def F(self, dt: float) -> Array:  # noqa: N802 - as the field calls it
        return np.array([[1.0 + self.factor * dt]])

    def Q(self, dt: float) -> Array:  # noqa: N802
        return np.array([[dt]])

    def h(self, x: Array, z: Array) -> Array:
        return np.asarray(x**2)

    def H(self, z: Array) -> Array:  # noqa: N802
        return np.array([[2.0 * self.x[0]]])

    def R(self, z: Array) -> Array:  # noqa: N802
        return np.eye(1)

    def residual(self, z: Array) -> Array:
        return np.asarray(z - self.x**2)

    def predict(self, dt: float) -> None:
        by_state = self.F(dt)
        self.x, self.P = self.f(self.x, dt), by_state @ self.P @ by_state.T + self.Q(dt)

    def update(self, z: Array) -> None:
        h = self.H(z)
        gain = self.P @ h.T @ np.linalg.inv(h @ self.P @ h.T + 1.0)
        self.x = self.x + gain @ self.residual(z)
        self.P = self.P - gain @ h @ self.P


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_a_class_of_ones_own_hands_its_functions_over(tmp_path: Path, factor: float) -> None:
    mine = Doubling(factor)
    with record(mine, tmp_path / "run.trace"):
        for _ in range(20):
            mine.predict(0.01)
            mine.update(mine.x**2 + 0.1)
    found = audit(tmp_path / "run.trace")
    assert {slot.slot for slot in found.functions} == {"F", "H of `measurement`"}
    named = [finding.text.partition(":")[0] for finding in derivatives(found)]
    assert named == ([] if factor == 1.0 else ["F is 1.0198 times the correct value"])


def test_the_command_says_it_first(tmp_path: Path) -> None:
    turning.track(tmp_path / "run.trace", turning.without_turn)
    done = slamcheck("audit", str(tmp_path / "run.trace"), cwd=tmp_path)
    assert done.returncode == 1
    said = " ".join(done.stdout.split())
    assert "the part of F that leads from turn to heading is zero: not the derivative" in said
    assert "derivatives: equal: F in 0 of 115, H of `radar` in 101 of 101" in said


def test_events_lead_where_they_lead_without_evaluations(tmp_path: Path) -> None:
    """An audit of all else is the same to the bit."""
    turning.track(tmp_path / "run.trace")
    with Recorder(tmp_path / "without.trace", components={"radar": ("range", "bearing")}) as copy:
        for event in TraceReader(tmp_path / "run.trace"):
            if not isinstance(event, Evaluation):
                copy.event(event)
    found, without = audit(tmp_path / "run.trace"), audit(tmp_path / "without.trace")
    assert without.functions == ()
    assert [sensor.nis for sensor in found.sensors] == [sensor.nis for sensor in without.sensors]
    assert found.largest_gap is not None
    assert without.largest_gap is not None
    assert found.largest_gap.covariance == without.largest_gap.covariance
