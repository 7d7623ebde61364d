"""Contradictions of a filter's use of its measurements, and gains with which it diverges."""

from pathlib import Path

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.audit.audit import Audit, audit
from comparisons.checks.of_events import ask_events
from comparisons.trace.recorder import Recorder

F = np.array([[1.0, 0.5], [0.0, 1.0]])
Q = np.diag([0.01, 0.04])
H, R = np.eye(2), np.diag([0.3, 0.5])
GATE = 0.99
LIMIT = 9.210340371976182


class Drive:
    """A filter of place and speed with two measured entries, and what it does wrong.

    times: how often each measurement is fused. parts: recorded as parts of it, R being as much
    larger. gain: what becomes of Kalman's.
    """

    def __init__(self, path: Path, steps: int = 60, seed: int = 2) -> None:
        self.path, self.steps, self.rng = path, steps, np.random.default_rng(seed)

    def record(
        self,
        times: int = 1,
        parts: bool = False,
        gated: bool = True,
        outliers: bool = False,
        overshoot: float = 1.0,
        gains: bool = True,
        before: bool = False,
    ) -> Audit:
        """before: what is fused first at an instant is another sensor's."""
        rng, p = self.rng, np.eye(2)
        error = rng.standard_normal(2)
        gates = {"gps": GATE}
        with Recorder(self.path, gates=gates, components={"gps": ["x", "v"]}) as record:
            record.prior({"place": 1, "speed": 1}, p)
            for step in range(self.steps):
                record.at(0.5 * step)
                error = F @ error + np.sqrt(np.diag(Q)) * rng.standard_normal(2)
                p = F @ p @ F.T + Q
                record.predict(F, Q)
                if before:
                    error, p = self._fuse(record, "wheel", error, p, error * 0.0, (R, 1.0, 1.0))
                noise = np.sqrt(np.diag(R)) * rng.standard_normal(2)
                if outliers and step % 10 == 5:
                    noise = np.array([5.0, 5.0])
                residual, s = error + noise, p + R
                if gated and residual @ np.linalg.solve(s, residual) > LIMIT:
                    record.reject("gps", residual, H, R)
                    continue
                for _ in range(times):
                    weight = 1.0 / times if parts else 1.0
                    r = R * times if parts else R
                    made = (r, weight, overshoot if gains else 1.0)
                    error, p = self._fuse(record, "gps", error, p, noise, made)
        return audit(self.path)

    def _fuse(
        self,
        record: Recorder,
        sensor: str,
        error: Array,
        p: Array,
        noise: Array,
        made: tuple[Array, float, float],
    ) -> tuple[Array, Array]:
        r, weight, factor = made
        residual = error + noise
        gain = factor * p @ np.linalg.inv(p + r)
        change = gain @ residual
        record.update(sensor, residual, H, r, gain=gain, correction=change, weight=weight)
        keep = np.eye(2) - gain
        p = keep @ p @ keep.T + gain @ r @ gain.T
        record.snapshot(p)
        return error - change, p


def said(found: Audit) -> list[str]:
    return [one.text for one in found.findings if one.fault]


def test_a_sound_filter_is_sound(tmp_path: Path) -> None:
    assert said(Drive(tmp_path / "a.trace").record()) == []


def test_a_measurement_that_is_fused_twice_is_named(tmp_path: Path) -> None:
    found = Drive(tmp_path / "a.trace").record(times=2)
    assert found.verdict == "faulty"
    (text,) = [one for one in said(found) if "again" in one]
    assert "fuses the measurement of event 2 again" in text
    assert "and 5" in text


def test_one_that_is_fused_in_parts_is_not(tmp_path: Path) -> None:
    assert said(Drive(tmp_path / "a.trace").record(times=2, parts=True)) == []


def test_another_at_the_same_instant_is_not(tmp_path: Path) -> None:
    """Of a second sensor, or of the same with noise of its own."""
    assert not any("again" in one for one in said(Drive(tmp_path / "a.trace").record(before=True)))


def test_one_that_is_used_beyond_the_declared_gate_is_a_contradiction(tmp_path: Path) -> None:
    found = Drive(tmp_path / "a.trace").record(gated=False, outliers=True)
    (text,) = [one for one in said(found) if "declared gate" in one]
    assert "is used, though it is beyond the declared gate of 99 %: its NIS is" in text
    assert "the gate's limit 9.21" in text


def test_what_a_gate_of_the_components_lets_pass_is_none(tmp_path: Path) -> None:
    """Beyond the ellipse of 99 %, within the box of 99 %."""
    path = tmp_path / "a.trace"
    with Recorder(path, gates={"gps": GATE}, components={"gps": ["x", "v"]}) as record:
        record.prior({"place": 1, "speed": 1}, np.eye(2))
        residual = 2.6 * np.sqrt(1.0 + np.diag(R))
        record.update("gps", residual, H, R)
        record.snapshot(np.linalg.inv(np.eye(2) + np.linalg.inv(R)))
    assert said(audit(path)) == []


@pytest.mark.parametrize(("factor", "fault"), [(0.5, False), (1.4, False), (2.6, True)])
def test_a_gain_that_makes_the_error_larger_is_a_fault(
    factor: float, fault: bool, tmp_path: Path
) -> None:
    """Its covariance is right for it; a filter may use another gain than Kalman's, not this one."""
    found = Drive(tmp_path / "a.trace", steps=6).record(gated=False, overshoot=factor)
    assert (found.verdict == "faulty") == fault
    assert any("it diverges" in one for one in said(found)) == fault


def test_what_is_not_kalmans_is_not_called_equal_to_least_squares(tmp_path: Path) -> None:
    found = Drive(tmp_path / "a.trace", steps=6).record(gated=False, overshoot=0.5)
    lines = dict(ask_events(found).lines)
    assert found.verdict == "sound"
    assert "equal" not in lines["algebra"]
    assert lines["gains"] == "6 compared, none of them Kalman's"


def test_all_of_a_sound_filter_is_called_equal(tmp_path: Path) -> None:
    lines = dict(ask_events(Drive(tmp_path / "a.trace").record()).lines)
    assert lines["algebra"].startswith("equal to least squares at every snapshot, to ")
    assert float(lines["algebra"].rpartition(" ")[2]) <= 1e-6
    assert lines["gains"].endswith("compared, all Kalman's")
