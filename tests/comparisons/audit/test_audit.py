"""The audit of a small filter: sound, and with errors of every kind."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.audit.audit import FALSE_ALARMS, Audit, audit
from comparisons.checks.of_events import ask_events
from comparisons.report.audit import AuditReport
from comparisons.trace.recorder import Recorder
from tests.comparisons.audit.toy_filter import GATE, SENSORS, Alter, F, Q, Toy
from tests.helpers import present

PARTS = {
    "position": slice(0, 2),
    "velocity": slice(2, 4),
    "bias": slice(4, 6),
    "clone": slice(6, 8),
}


def audited(tmp_path: Path, toy: Toy) -> Audit:
    path = tmp_path / "toy.trace"
    path.unlink(missing_ok=True)
    toy.record(path)
    return audit(path)


def once(what: str, after: int, change: Callable[[Array, Array], Array]) -> tuple[Alter, list[int]]:
    """Change P at the first event of a kind after a number of events; the list gets its number."""
    done: list[int] = []

    def alter(toy: Toy, number: int, now: str, before: Array) -> Array:
        if now == what and number >= after and not done:
            done.append(number)
            return change(toy.covariance.copy(), before)
        return toy.covariance

    return alter, done


def swapped(p: Array, a: str, b: str, value: Array | float) -> Array:
    """P with the covariance of two blocks replaced."""
    p[PARTS[a], PARTS[b]] = value
    p[PARTS[b], PARTS[a]] = value.T if isinstance(value, np.ndarray) else value
    return p


def stays(a: str, b: str) -> Callable[[Array, Array], Array]:
    return lambda p, before: swapped(p, a, b, before[PARTS[a], PARTS[b]])


def without_noise(p: Array, before: Array) -> Array:
    p[:6, :6] -= Q
    return p


def wrong_removal(p: Array, before: Array) -> Array:
    own, across = before[6:, 6:], before[:6, 6:]
    return before[:6, :6] - across @ np.linalg.solve(own, across.T)


def other_noise(sensor: str, factor: float) -> Callable[[Array, Array], Array]:
    def change(p: Array, before: Array) -> Array:
        blocks, h, r = SENSORS[sensor]
        whole = np.zeros((2, len(before)))
        whole[:, PARTS[blocks[0]]] = h
        k = before @ whole.T @ np.linalg.inv(whole @ before @ whole.T + factor * r)
        return before - k @ whole @ before

    return change


def gained(before: Array, sensor: str, added: Array | float) -> tuple[Array, Array, Array]:
    """H, S and Kalman's gain of a sensor for P less what was added."""
    blocks, h, r = SENSORS[sensor]
    whole = np.zeros((len(h), len(before)))
    whole[:, PARTS[blocks[0]]] = h
    p = before.copy()
    p[:6, :6] -= added
    s = whole @ p @ whole.T + r
    return whole, s, p @ whole.T @ np.linalg.inv(s)


def without_r(p: Array, before: Array) -> Array:
    h, _, k = gained(before, "gps", 0.0)
    return before - k @ h @ before @ h.T @ k.T


def not_redrawn(p: Array, before: Array) -> Array:
    _, s, k = gained(before, "doppler", Q)
    return before - k @ s @ k.T


def other_f(change: Callable[[Array], Array]) -> Callable[[Array, Array], Array]:
    """Of the prediction's F, on all but clones."""

    def other(p: Array, before: Array) -> Array:
        f = np.eye(len(before))
        f[:6, :6] = change(F)
        found = f @ before @ f.T
        found[:6, :6] += Q
        return found

    return other


def inverse(f: Array) -> Array:
    return np.asarray(np.linalg.inv(f), dtype=np.float64)


def without_bias(f: Array) -> Array:
    found = f.copy()
    found[2:4, 4:6] = 0.0
    return found


def other_q(q: Array) -> Callable[[Array, Array], Array]:
    def other(p: Array, before: Array) -> Array:
        p[:6, :6] += q - Q
        return p

    return other


def scaled_gain(factor: float, *, short: bool = False) -> Callable[[Array, Array], Array]:
    def other(p: Array, before: Array) -> Array:
        _, s, k = gained(before, "gps", 0.0)
        less = factor if short else 2.0 * factor - factor**2
        return before - less * k @ s @ k.T

    return other


def added_khp(p: Array, before: Array) -> Array:
    h, _, k = gained(before, "gps", 0.0)
    return before + k @ h @ before


def uncorrelated_clone(p: Array, before: Array) -> Array:
    p[:6, 6:] = p[6:, :6] = 0.0
    return p


def nothing_done(p: Array, before: Array) -> Array:
    return before


ALL = "position velocity bias"
FAULTS: list[tuple[str, Callable[[Array, Array], Array], str, str]] = [
    ("gps", stays("position", "bias"), "position bias", "position with bias is as before"),
    ("doppler", stays("bias", "bias"), "bias", "the row block of bias in K is zero"),
    ("gps", nothing_done, "position", "was not updated"),
    ("gps", other_noise("gps", 0.25), "position", "R is 0.25 times"),
    ("gps", other_noise("gps", 0.5), "position", "updated twice"),
    ("gps", without_r, "position", "R is zero, in the form P - K S K^T"),
    ("doppler", not_redrawn, "velocity", "sigma points that were not drawn anew"),
    ("predict", without_noise, ALL, "Q is zero"),
    ("predict", nothing_done, ALL, "was not predicted"),
    ("predict", other_f(inverse), ALL, "F is inverted"),
    ("predict", other_f(without_bias), "velocity bias", "leads from bias to velocity is zero"),
    ("predict", other_q(np.sqrt(Q)), ALL, "Q contains sigma instead of sigma squared"),
    ("predict", other_q(0.3 * Q), ALL, "Q is 0.3 times the correct value"),
    ("gps", scaled_gain(0.5), "position", "K is 0.5 times the correct value, in Joseph's form"),
    ("gps", scaled_gain(0.5, short=True), "position", "K is 0.5 times the correct value"),
    ("gps", added_khp, "position", "K has the opposite sign"),
    ("gps", lambda p, before: 1.02 * p, "position", "is 1.02 times"),
    ("clone", uncorrelated_clone, "clone position", "covariance with the others is zero"),
    ("remove", wrong_removal, "clone", "not marginalised"),
]
"""At which event, what becomes of P, the blocks that are named, and the words."""


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 4, 23])
def test_a_sound_filter_is_sound(tmp_path: Path, every: int) -> None:
    found = audited(tmp_path, Toy(seed=1, every=every))
    assert found.sound, found.findings
    assert found.findings == ()
    assert max(present(found.largest_gap).sigma, present(found.largest_gap).covariance) < 1e-9
    assert found.oracle_agreement < 1e-10
    assert found.gains_compared > 100
    assert {one.sensor for one in found.sensors} == {"doppler", "gps", "way"}


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 6])
@pytest.mark.parametrize(("what", "change", "blocks", "text"), FAULTS)
def test_a_fault_is_found_with_event_and_block(
    tmp_path: Path,
    what: str,
    change: Callable[[Array, Array], Array],
    blocks: str,
    text: str,
    every: int,
) -> None:
    alter, done = once(what, 80, change)
    found = audited(tmp_path, Toy(seed=2, every=every, alter=alter))
    first = found.findings[0]
    assert (first.fault, first.check, first.event) == (True, "algebra", done[0]), first
    assert first.blocks == tuple(blocks.split())
    assert text in first.text
    assert first.sensor == (what if what in SENSORS else None)
    assert present(found.first_open).event > done[0]


def test_what_happens_at_every_update_is_one_finding(tmp_path: Path) -> None:
    def alter(toy: Toy, number: int, what: str, before: Array) -> Array:
        change = stays("position", "velocity")
        return change(toy.covariance.copy(), before) if what == "gps" else toy.covariance

    found = audited(tmp_path, Toy(seed=2, every=2, alter=alter))
    faults = [one for one in found.findings if one.check == "algebra"]
    assert len(faults) == 1
    assert "more" in faults[0].text


def test_an_unknown_error_is_told_by_what_differs(tmp_path: Path) -> None:
    alter, done = once("gps", 80, lambda p, before: swapped(p, "velocity", "bias", 1e-3))
    found = audited(tmp_path, Toy(seed=2, alter=alter))
    first = found.findings[0]
    assert (first.event, first.blocks) == (done[0], ("velocity", "bias"))
    assert "off by" in first.text


@pytest.mark.parametrize(
    ("gain", "text"),
    [
        (lambda n, sensor, k: 0.5 * k if sensor == "gps" else k, "0.5 times Kalman's gain"),
        (
            lambda n, sensor, k: np.vstack((k[:4], 0 * k[4:6], k[6:])),
            "does not correct bias (Schmidt)",
        ),
    ],
)
def test_another_gain_is_named_not_condemned(
    tmp_path: Path, gain: Callable[[int, str, Array], Array], text: str
) -> None:
    found = audited(tmp_path, Toy(seed=4, gain=gain))
    assert found.sound, found.findings
    assert any(text in one.text and not one.fault for one in found.findings)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda c: np.concatenate((c[:4], 0 * c[4:])), "does not correct the estimate of bias"),
        (lambda c: np.concatenate((c[:4], -c[4:])), "wrong sign"),
        (lambda c: np.concatenate((c[:4], 2 * c[4:])), "twice"),
        (lambda c: np.concatenate((c[:4], c[4:] + 0.1)), "that is not gain x residual"),
    ],
)
def test_a_correction_that_is_not_gain_times_residual(
    tmp_path: Path, change: Callable[[Array], Array], text: str
) -> None:
    done: list[int] = []

    def correction(number: int, sensor: str, c: Array) -> Array:
        if number < 100 or done:
            return c
        done.append(number)
        return change(c)

    found = audited(tmp_path, Toy(seed=4, clones=False, every=3, correction=correction))
    first = found.findings[0]
    assert (first.check, first.event, first.blocks) == ("correction", done[0], ("bias",))
    assert text in first.text
    assert present(found.first_open).sigma > 1e-6


@pytest.mark.slow
def test_a_sensor_that_fails_has_a_time(tmp_path: Path) -> None:
    def bias(number: int, sensor: str) -> float:
        return 6.0 if sensor == "gps" and number > 900 else 0.0

    found = audited(tmp_path, Toy(seed=5, steps=400, bias=bias))
    first = found.findings[0]
    assert (first.check, first.sensor) == ("innovations", "gps")
    assert "rejects" in first.text
    assert 900 < (first.event or 0) < 930


@pytest.mark.slow
def test_asymmetry_and_indefiniteness_are_found(tmp_path: Path) -> None:
    def skew(p: Array, before: Array) -> Array:
        p[0, 3] += 0.01
        return p

    def negative(p: Array, before: Array) -> Array:
        p[0, 0] = -p[0, 0]
        return p

    for change, text in ((skew, "asymmetric"), (negative, "not positive semidefinite")):
        alter, done = once("gps", 80, change)
        found = audited(tmp_path, Toy(seed=2, alter=alter))
        assert text in found.findings[0].text
        assert found.findings[0].event == done[0]


def test_one_block_in_snapshots_is_enough_to_see_that_something_is_wrong(tmp_path: Path) -> None:
    path, p = tmp_path / "part.trace", np.diag([4.0, 4.0, 1.0, 1.0, 0.01, 0.01])
    with Recorder(path, gates=GATE) as record:
        record.prior({"position": 2, "velocity": 2, "bias": 2}, p)
        for step in range(30):
            record.predict(F, Q)
            p = F @ p @ F.T + (2.0 if step == 20 else 1.0) * Q
            record.snapshot(p[:2, :2], ["position"])
    found = audit(path)
    assert not found.sound
    first = found.findings[0]
    assert first.check == "algebra"
    assert first.event in (41, 43)  # what reaches the position a step later


@pytest.mark.parametrize(
    ("factor", "short", "text"),
    [
        (0.5, False, "K is 0.5 times the correct value, in Joseph's form"),
        (0.5, True, "K is 0.5 times the correct value"),
        (0.5371, False, "the covariance of block position is off by"),
    ],
)
def test_of_numbers_that_fit_alike_the_plain_one_is_said(
    tmp_path: Path, factor: float, short: bool, text: str
) -> None:
    """A scalar measurement's other gain is that of some other R, too, in either form."""
    path, h, r = tmp_path / "scalar.trace", np.array([[1.0, 0.0]]), np.array([[0.3]])
    p, f, q = np.array([[4.0, 0.7], [0.7, 1.0]]), np.array([[1.0, 0.5], [0.0, 1.0]]), 0.01
    with Recorder(path) as record:
        record.prior({"position": 1, "velocity": 1}, p)
        for step in range(6):
            p = f @ p @ f.T + q * np.eye(2)
            record.predict(f, q * np.eye(2))
            record.snapshot(p)
            k = p @ h.T / (h @ p @ h.T + r) * (factor if step == 4 else 1.0)
            a = np.eye(2) - k @ h
            p = a @ p if short else a @ p @ a.T + k @ r @ k.T
            record.update("range", [0.1], h, r)
            record.snapshot(p)
    first = audit(path).findings[0]
    assert (first.check, first.event) == ("algebra", 19)
    assert first.text.split(": ")[1].startswith(text)
    assert "in Joseph's form" in text or "form" not in first.text


def other_r(p: Array, before: Array, h: Array, r: Array) -> Array:
    return np.asarray(p @ h.T @ np.linalg.inv(h @ p @ h.T + r @ r))


def unpredicted(p: Array, before: Array, h: Array, r: Array) -> Array:
    return np.asarray(before @ h.T @ np.linalg.inv(h @ before @ h.T + r))


def without_inverse(p: Array, before: Array, h: Array, r: Array) -> Array:
    return p @ h.T


def by_components(p: Array, before: Array, h: Array, r: Array) -> Array:
    return p @ h.T / np.diag(h @ p @ h.T + r)


def rounded(p: Array, before: Array, h: Array, r: Array) -> Array:
    return 1.001 * by_components(p, before, h, r)


@pytest.mark.parametrize(
    ("gain", "text"),
    [
        (other_r, "uses the gain of an update where R is multiplied by itself"),
        (unpredicted, "uses the gain of an update where P is that before the event before"),
        (without_inverse, "uses the gain of an update where K is P H^T, not P H^T S^-1"),
        (by_components, "uses the gain of an update where S lacks its covariances"),
        (rounded, "has a gain that is not Kalman's on position, velocity (by"),
    ],
)
@pytest.mark.parametrize("every", [1, 3])
def test_a_gain_of_another_matrix_is_named(
    tmp_path: Path, gain: Callable[[Array, Array, Array, Array], Array], text: str, every: int
) -> None:
    found = audited_line(tmp_path, every, gain=lambda *given: gain(*given[:4]))
    assert found.sound, found.findings
    number = 11 if every == 1 else 9
    assert found.findings[0].text.startswith(f"event {number} (update of sensor `range`) {text}")


@pytest.mark.parametrize(
    ("correction", "text"),
    [
        (
            lambda k, s, z, last: k @ s @ z,
            "estimate by residual times the gain where K is P H^T, not P H^T S^-1",
        ),
        (lambda k, s, z, last: 2.0 * k @ z, "estimate of position, velocity twice"),
        (
            lambda k, s, z, last: k @ last[0],
            "estimate by gain times the residual of the update before",
        ),
        (
            lambda k, s, z, last: last[1] @ z,
            "estimate by the gain of the update before times residual",
        ),
        (
            lambda k, s, z, last: last[1] @ last[0],
            "estimate by the correction of the update before",
        ),
        (
            lambda k, s, z, last: 1.01 * k @ last[0],
            "applies a correction of position, velocity that is not gain",
        ),
    ],
)
@pytest.mark.parametrize("every", [1, 3])
def test_a_correction_by_another_events_numbers_is_named(
    tmp_path: Path, correction: Callable[..., Array], text: str, every: int
) -> None:
    found = audited_line(tmp_path, every, correction=correction)
    first = found.findings[0]
    assert (first.check, first.fault) == ("correction", True)
    assert text in first.text


def audited_line(
    tmp_path: Path,
    every: int,
    gain: Callable[..., Array] | None = None,
    correction: Callable[..., Array] | None = None,
) -> Audit:
    """Audit a position and a velocity, measured together; the fourth update is another."""
    rng, path = np.random.default_rng(1), tmp_path / "line.trace"
    h, r = np.array([[1.0, 0.0], [0.5, 1.0]]), np.array([[0.3, 0.1], [0.1, 0.2]])
    p, f, q = np.array([[4.0, 0.7], [0.7, 1.0]]), np.array([[1.0, 0.5], [0.0, 1.0]]), np.eye(2)
    last: tuple[Array, Array] = np.zeros(2), np.zeros((2, 2))
    with Recorder(path) as record:
        record.prior({"position": 1, "velocity": 1}, p)
        for step in range(6):
            before, p = p, f @ p @ f.T + 0.01 * q
            record.predict(f, 0.01 * q)
            s = h @ p @ h.T + r
            z, kalman = np.linalg.cholesky(s) @ rng.standard_normal(2), p @ h.T @ np.linalg.inv(s)
            k = gain(p, before, h, r) if gain and step == 3 else kalman
            used = correction(k, s, z, last) if correction and step == 3 else k @ z
            record.update("range", z, h, r, gain=k, correction=used)
            a, last = np.eye(2) - k @ h, (z, k)
            p = a @ p @ a.T + k @ r @ k.T
            if step % every == 0:
                record.snapshot(p)
    return audit(path)


@pytest.mark.parametrize(
    ("correction", "turned", "told"), [(0.2, 0.0, 1), (1e-3, 0.0, 0), (0.2, 0.1, 0)]
)
def test_resets_that_are_all_the_identity_are_noted(
    tmp_path: Path, correction: float, turned: float, told: int
) -> None:
    j, path = np.array([[1.0, turned], [0.0, 1.0]]), tmp_path / "resets.trace"
    with Recorder(path) as record:
        record.prior({"attitude": 2}, np.eye(2))
        for _ in range(3):
            record.update(
                "tilt", [2.0 * correction] * 2, np.eye(2), np.eye(2), correction=[correction] * 2
            )
            record.reset(j)
    notes = [one for one in audit(path).findings if "resets are the identity" in one.text]
    assert [(one.fault, one.event) for one in notes] == [(False, 2)] * told
    assert all("0.2 is corrected before them: is the Jacobian made" in one.text for one in notes)


CLOSE = np.array([[1.0, 0.999], [0.999, 1.0]])
"""A covariance that is certain of the difference of its two numbers, to 0.045."""


def walked(tmp_path: Path, alter: Callable[[int, Array], Array]) -> Audit:
    """Audit two numbers that walk. alter: what P becomes after the prediction of a step."""
    p, q, h = CLOSE, 1e-5 * np.eye(2), np.array([[0.6, 0.5]])
    path = tmp_path / "walk.trace"
    path.unlink(missing_ok=True)
    rng = np.random.default_rng(3)
    with Recorder(path) as record:
        record.prior({"left": 1, "right": 1}, p)
        for step in range(10):
            p = alter(step, p + q)
            record.predict(np.eye(2), q)
            record.snapshot(p)
            s = h @ p @ h.T + 1.0
            record.update("sum", np.sqrt(s[0]) * rng.standard_normal(1), h, np.eye(1))
            p = p - p @ h.T @ h @ p / s
            record.snapshot(p)
    return audit(path)


def test_what_only_a_certain_direction_shows_is_found_where_it_happens(tmp_path: Path) -> None:
    """By entries it is below the tolerance; the events after it are not blamed."""
    off = 2e-8 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    found = walked(tmp_path, lambda step, p: p + off if step == 4 else p)
    assert np.abs(off).max() < found.tolerance
    first = found.findings[0]
    assert (first.check, first.event, present(found.first_open).event) == ("algebra", 17, 18)
    assert "by 3.8e-05 along the direction that it is most certain of" in first.text
    assert [one.check for one in found.findings] == ["algebra"]
    assert "more" not in first.text
    assert walked(tmp_path, lambda step, p: p).sound


def test_what_each_event_may_leave_open_is_not_summed(tmp_path: Path) -> None:
    """One event is judged from the snapshot before it; a step of more than that is found."""
    assert walked(tmp_path, lambda step, p: p * (1.0 + 0.9e-6)).sound
    assert not walked(tmp_path, lambda step, p: p * (1.0 + 1.1e-6)).sound


def erring(tmp_path: Path, scale: Callable[[int], Array]) -> Audit:
    """Audit a filter of a place and a bias without sensors. scale: (3,) of its errors at a step."""
    rng, path = np.random.default_rng(7), tmp_path / "erring.trace"
    path.unlink(missing_ok=True)
    e, p = rng.standard_normal(3), np.eye(3)
    with Recorder(path) as record:
        record.prior({"place": 2, "bias": 1}, p)
        record.snapshot(p, error=e)
        for step in range(1000):
            record.at(0.1 * step)
            e = 0.5 * e + np.sqrt(0.75) * rng.standard_normal(3)
            record.predict(0.5 * np.eye(3), 0.75 * np.eye(3))
            record.snapshot(p, error=e * scale(step))
    return audit(path)


def test_nees_names_block_and_time(tmp_path: Path) -> None:
    found = erring(tmp_path, lambda step: np.array([1.0, 1.0, 5.0 if step >= 600 else 1.0]))
    (one,) = found.findings
    assert (one.check, one.fault) == ("nees", True)
    assert "NEES per degree of freedom is 4" in one.text
    assert "; of block `bias` 1" in one.text
    since = float(one.text.split(", from ")[1].removesuffix(" s on"))
    assert since == pytest.approx(60.0, abs=1.0)
    assert set(found.nees_by_block) == {"place", "bias"}
    assert found.nees_by_block["place"].p_value > 0.01


def test_nees_of_a_stretch_is_told_where_the_whole_run_hides_it(tmp_path: Path) -> None:
    worse = np.full(3, np.sqrt(1.7))
    found = erring(tmp_path, lambda step: worse if 300 <= step < 400 else np.ones(3))
    assert present(found.nees).p_value > 1e-3
    (one,) = found.findings
    assert "NEES per degree of freedom is 1.67 from 30 s to 39.9 s" in one.text
    assert erring(tmp_path, lambda step: np.ones(3)).findings == ()


@pytest.mark.parametrize("recorded", [True, False], ids=["truth", "measurements"])
@pytest.mark.parametrize(
    ("first", "told"),
    [
        (
            (0.1, 0.002, 0.3, 0.02),
            "probable: entry 0 of block `pose` and entry 2 of block `pose` (p",
        ),
        ((0.1, 0.5, 0.3, 0.02), "P0 is too small there, or its rows are in another order"),
        ((0.1, 0.002, 0.3, 0.002), ""),
    ],
    ids=["exchanged", "too small", "sound"],
)
def test_the_rows_of_p0_that_are_exchanged_are_named(
    tmp_path: Path, first: tuple[float, ...], told: str, *, recorded: bool
) -> None:
    """P0 has a sigma of 1 for x, and of 0.003 for the heading, as if their rows were each other's.

    One that is too small alone leaves the error of x as improbable there.
    """
    rng, e = np.random.default_rng(2), np.array(first)
    p = np.diag(np.square((0.2, 1.0, 1.0, 0.003)))
    h = np.eye(4)[1:] if recorded else np.eye(4)
    with Recorder(tmp_path / "run.trace") as record:
        record.prior({"bias": 1, "pose": 3}, p)
        if recorded:
            record.snapshot(p, error=e)
        for _ in range(30):
            record.predict(np.eye(4), 1e-8 * np.eye(4))
            p = p + 1e-8 * np.eye(4)
            z = h @ e + 1e-3 * rng.standard_normal(len(h))
            r = 1e-6 * np.eye(len(h))
            k = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
            record.update("pose", z, h, r, correction=k @ z)
            p, e = p - k @ h @ p, e - k @ z
            record.snapshot(p)
    found = [
        one.text for one in audit(tmp_path / "run.trace").findings if "first error" in one.text
    ]
    assert len(found) == bool(told)
    for text in found:
        assert text.startswith("the first error of entry 2 of block `pose` is 0.")
        assert ", its sigma in P0 is 0.003: P0 is too small there, or" in text
        assert told in text


def test_an_error_of_many_sigmas_goes_before_a_sensor_that_is_too_good(tmp_path: Path) -> None:
    """Neither the kind nor the logarithm of a ratio decides, but how rare it is."""
    rng, p = np.random.default_rng(5), 1.0
    with Recorder(tmp_path / "run.trace") as record:
        record.prior({"state": 1}, p)
        for _ in range(300):
            p = 0.25 * p + 0.75
            record.predict(0.5, 0.75)
            record.update("clock", 1e-2 * rng.standard_normal(1), 1.0, 99.0)
            p -= p * p / (p + 99.0)
            record.snapshot(p, error=245.0 * rng.standard_normal(1))
    found = audit(tmp_path / "run.trace").findings
    assert [one.check for one in found[:2]] == ["nees", "innovations"]
    assert "NIS is too low" in found[1].text


def test_under_sound_nothing_is_said_to_be_out(tmp_path: Path) -> None:
    """Of a sound filter one figure in twenty leaves its band; of a faulty one it is marked."""
    marked = 0
    for seed in range(4):
        found = audited(tmp_path, Toy(seed=seed, steps=60))
        assert found.sound
        assert all(row.inside is not False for row in ask_events(found).rows())
        assert "gap opens" not in str(AuditReport.of(found).summary())
        faulty = replace(found, verdict="faulty")
        marked += sum(row.inside is False for row in ask_events(faulty).rows())
    assert marked


@pytest.mark.slow
@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_single_precision_is_recognised(tmp_path: Path, precision: type) -> None:
    def alter(toy: Toy, number: int, what: str, before: Array) -> Array:
        return toy.covariance.astype(precision).astype(float)

    found = audited(tmp_path, Toy(seed=2, alter=alter))
    proposed = [one for one in found.findings if "--tolerance 0.001" in one.text]
    assert bool(proposed) == (precision is np.float32)
    assert found.sound
    assert present(found.largest_gap).worst > found.tolerance or not proposed
    assert audit(found.trace, tolerance=1e-3).sound


def test_where_single_precision_is_taken_for_faults_the_tolerance_goes_first(
    tmp_path: Path,
) -> None:
    def lost(toy: Toy, number: int, what: str, before: Array) -> Array:
        other = 1.0001 if what == "gps" else 1.0
        return (other * toy.covariance).astype(np.float32).astype(float)

    found = audited(tmp_path, Toy(seed=2, steps=30, alter=lost))
    assert not found.sound
    first, second, *_ = AuditReport.of(found).summary().reasons
    assert first == "the filter is in single precision: audit it with --tolerance 0.001"
    assert "of sensor `gps`" in second


@pytest.mark.parametrize(("shared", "gate"), [(True, 0.99), (False, 0.99), (True, 0.9)])
def test_a_gate_of_each_measurement_in_a_batch_can_be_declared(
    tmp_path: Path, shared: bool, gate: float
) -> None:
    """Measurements of a batch are rejected together where they share the pose's error.

    Broken: one that lengthens what passed as if each had been gated given the others.
    """
    rng, q, h, r = np.random.default_rng(6), 4.0 * np.eye(2), np.eye(2), np.eye(2)
    q = q if shared else 1e-4 * q
    e, p, limit = np.zeros(2), 1e-4 * np.eye(2), -2.0 * np.log(1.0 - gate)
    with Recorder(
        tmp_path / "run.trace", gates={"scan": gate}, components={"scan": ["x", "y"]}
    ) as record:
        record.prior({"pose": 2}, p)
        for step in range(300):
            record.at(0.1 * step)
            e, p = e + np.sqrt(q[0, 0]) * rng.standard_normal(2), p + q
            record.predict(np.eye(2), q)
            seen = e + rng.standard_normal((10, 2))
            passed = np.einsum("ni,ij,nj->n", seen, np.linalg.inv(p + r), seen) <= limit
            for z in seen[~passed]:
                record.reject("scan", z, h, r)
            if passed.any():
                count, z = int(passed.sum()), seen[passed].ravel()
                whole = np.tile(h, (count, 1))
                k = p @ whole.T @ np.linalg.inv(whole @ p @ whole.T + np.eye(2 * count))
                record.update("scan", z, whole, np.eye(2 * count), correction=k @ z)
                e, p = e - k @ z, p - k @ whole @ p
            record.snapshot(p)
    found = audit(tmp_path / "run.trace")
    assert found.sound, found.findings
    (scan,) = found.sensors
    assert 0.7 < scan.least < 1.0
    assert scan.nis[0].mean < 2.05
    assert scan.gating.count > 15


@pytest.mark.slow
def test_sound_filters_are_rarely_called_faulty(tmp_path: Path) -> None:
    """Of 60 sound traces at most one; with a rate of 0.1 % that fails once in 600 runs."""
    faulty = [
        seed for seed in range(60) if not audited(tmp_path, Toy(seed=100 + seed, every=5)).sound
    ]
    assert FALSE_ALARMS == 1e-3
    assert len(faulty) <= 1


def unset(r: Array) -> Array:
    """An entry beside the diagonal that was never set."""
    wrong: Array = r + np.array([[0.0, 0.7], [0.0, 0.0]])
    return wrong


UNSOUND: dict[str, tuple[Callable[[Array], Array], list[str]]] = {
    "asymmetric": (
        unset,
        ["event 11 (update of sensor `gps`): noise (R) is not symmetric; and 2 more"],
    ),
    "negative": (
        lambda r: r - 2.0 * np.eye(2),
        ["event 11 (update of sensor `gps`): noise (R) has a negative eigenvalue; and 2 more"],
    ),
    "not a number": (
        lambda r: r * np.nan,
        [
            "event 11 (update of sensor `gps`): noise (R) is no numbers, or has one that is not "
            "finite or too large; and 2 more"
        ],
    ),
    "symmetric": (lambda r: unset(r) + unset(r).T, []),
}


@pytest.mark.parametrize("kind", UNSOUND)
def test_a_noise_that_is_no_covariance_comes_first_and_what_follows_from_it_is_no_finding(
    tmp_path: Path, kind: str
) -> None:
    """A later fault of the algebra is found all the same; of a sound R nothing is said."""
    change, said = UNSOUND[kind]
    p, right = np.diag([4.0, 1.0]), np.diag([1.0, 4.0])
    with Recorder(tmp_path / "run.trace") as record:
        record.prior({"place": 2}, p)
        for step in range(12):
            p = p + 0.1 * np.eye(2)
            record.predict(np.eye(2), 0.1 * np.eye(2))
            r = change(right) if step in (3, 4, 7) else right
            p = p - p @ np.linalg.inv(p + np.nan_to_num(r)) @ p
            p = 0.5 * (p + p.T) * (2.0 if step == 10 else 1.0)
            record.update("gps", [0.1, 0.2], np.eye(2), r)
            record.snapshot(p)
    found = audit(tmp_path / "run.trace")
    assert [one.text for one in found.findings if one.check == "noise"] == said
    own = [one for one in found.findings if one.check in ("noise", "algebra", "covariance")]
    assert [one.check for one in own] == ["noise"] * len(said) + ["algebra"]
    assert found.findings[: len(own)] == tuple(own)
    assert own[-1].event in (31, 32)
    assert (found.unsolved is None) == (not said)


@pytest.mark.parametrize(
    ("recorded", "cleared", "said"),
    [
        (True, True, None),
        (False, True, "between events"),
        (
            True,
            False,
            "event 4 (renewal of `bias`): the covariance of place with all others is as before",
        ),
    ],
)
def test_a_covariance_that_is_set_on_purpose_is_recorded(
    tmp_path: Path, recorded: bool, cleared: bool, said: str | None
) -> None:
    """Not where that is not said, nor where the filter keeps the block's other covariances."""
    p = np.array([[4.0, 0.5], [0.5, 1.0]])
    f, h, q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), 0.01 * np.eye(2)
    draw = np.random.default_rng(1)
    with Recorder(tmp_path / "run.trace") as record:
        record.prior({"place": 1, "bias": 1}, p)
        for step in range(8):
            p = f @ p @ f.T + q
            record.predict(f, q)
            spread = float(p[0, 0] + 1.0)
            p = p - p @ h.T @ h @ p / spread
            record.update("gps", np.sqrt(spread) * draw.standard_normal(), h, 1.0)
            record.snapshot(p)
            if step == 0:
                kept = 0.0 if cleared else p[0, 1]
                p = np.array([[p[0, 0], kept], [kept, 0.25]])
                if recorded:
                    record.renew("bias", 0.25)
    found = audit(tmp_path / "run.trace")
    assert found.sound is (said is None)
    if said is not None:
        assert said in found.findings[0].text
