"""What recording costs a filter, and how fast its trace is read and audited.

python benchmarks/audit_speed.py [--events 100000] [--rounds 5] [--reset] [--keep PATH] [--audit]

An error-state INS of 15 states in lean numpy (position, velocity, attitude, accelerometer bias,
gyro bias; inertial measurements at 100 Hz, GNSS positions at 10 Hz, a snapshot a second) goes over
the same simulated data with and without a recorder, in turns. --reset: the attitude's error is
expressed anew after each GNSS position. Times are of the processor, but for commits, which wait for
the disk or do not. --keep leaves the last trace; --audit audits it in a process of its own.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comparisons.audit.audit import audit
from comparisons.trace.reader import Trace
from comparisons.trace.recorder import COMMIT_EVENTS, Recorder

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[1]
STEP_S = 0.01
STEPS_A_FIX, STEPS_A_SNAPSHOT = 10, 100
GRAVITY = np.array([0.0, 0.0, -9.81])
SIGMA_FIX_M = 1.0
SIGMA_ACCELERATION, SIGMA_RATE = 0.02, 0.001
"""White noise, in m/s^2 and rad/s by the root of a hertz."""
SIGMA_ACCELERATION_BIAS, SIGMA_RATE_BIAS = 1e-4, 1e-5
"""Random walks, in m/s^2 and rad/s by the root of a second."""
BLOCKS = {
    "position": 3,
    "velocity": 3,
    "attitude": 3,
    "accelerometer bias": 3,
    "gyro bias": 3,
}
FIRST_SIGMA = np.repeat([1.0, 0.1, 0.02, 0.05, 0.002], 3)
NOISE = np.diag(
    np.repeat(
        [
            0.0,
            SIGMA_ACCELERATION**2,
            SIGMA_RATE**2,
            SIGMA_ACCELERATION_BIAS**2,
            SIGMA_RATE_BIAS**2,
        ],
        3,
    )
    * STEP_S
)
FIX_NOISE = SIGMA_FIX_M**2 * np.eye(3)
FIX_JACOBIAN = np.eye(3)


class Data(NamedTuple):
    """What the filter reads. rate (K, 3) rad/s, acceleration (K, 3) m/s^2, fix (K / 10, 3) m.

    position, velocity (3,), attitude (3, 3): where the filter believes to start.
    """

    rate: Array
    acceleration: Array
    fix: Array
    position: Array
    velocity: Array
    attitude: Array


def simulate(steps: int, seed: int = 1) -> Data:
    """Fly figures of eight with rolls, in the filter's own discretisation."""
    rng = np.random.default_rng(seed)
    t = STEP_S * np.arange(steps + 1)
    velocity = np.column_stack(
        (20.0 * np.cos(0.05 * t), 20.0 * np.cos(0.1 * t), 2.0 * np.sin(0.07 * t))
    )
    position = np.vstack((np.zeros(3), np.cumsum(STEP_S * velocity[:-1], axis=0)))
    angles = np.column_stack((0.3 * t, 0.2 * np.sin(0.11 * t), 0.4 * np.sin(0.13 * t)))
    attitude = Rotation.from_euler("ZYX", angles)
    rate = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / STEP_S
    force = attitude[:-1].inv().apply(np.diff(velocity, axis=0) / STEP_S - GRAVITY)
    walk = np.sqrt(STEP_S) * rng.standard_normal((2, steps, 3))
    first = FIRST_SIGMA * rng.standard_normal(15)
    accelerometer_bias = first[9:12] + SIGMA_ACCELERATION_BIAS * np.cumsum(walk[0], axis=0)
    gyro_bias = first[12:] + SIGMA_RATE_BIAS * np.cumsum(walk[1], axis=0)
    white = rng.standard_normal((2, steps, 3)) / np.sqrt(STEP_S)
    noise = SIGMA_FIX_M * rng.standard_normal((steps // STEPS_A_FIX, 3))
    return Data(
        rate=rate + gyro_bias + SIGMA_RATE * white[0],
        acceleration=force + accelerometer_bias + SIGMA_ACCELERATION * white[1],
        fix=position[STEPS_A_FIX::STEPS_A_FIX] + noise,
        position=position[0] - first[:3],
        velocity=velocity[0] - first[3:6],
        attitude=attitude[0].as_matrix() @ rotation(-first[6:9]),
    )


def skew(v: Array) -> Array:
    """Return the matrix of a cross product."""
    x, y, z = v.tolist()
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))


def rotation(v: Array) -> Array:
    """Return the rotation by a small vector, to the fifth order (Rodrigues)."""
    x, y, z = v.tolist()
    square = x * x + y * y + z * z
    s, c = 1.0 - square / 6.0, 0.5 - square / 24.0
    return np.array(
        (
            (1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y),
            (c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x),
            (c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)),
        )
    )


class Ins:
    """Strapdown navigation with the errors of position, velocity, attitude (body) and biases."""

    def __init__(self, data: Data) -> None:
        """Start where the data say."""
        self.position, self.velocity = data.position.copy(), data.velocity.copy()
        self.attitude = data.attitude.copy()
        self.accelerometer_bias, self.gyro_bias = np.zeros(3), np.zeros(3)
        self.covariance = np.diag(FIRST_SIGMA**2)
        self.jacobian = np.eye(15)
        self.jacobian[:3, 3:6] = STEP_S * np.eye(3)
        self.jacobian[6:9, 12:] = -STEP_S * np.eye(3)
        self._half = np.empty((15, 15))

    def predict(self, rate: Array, acceleration: Array) -> None:
        """Go on by a step: P = F P F' + Q."""
        force = acceleration - self.accelerometer_bias
        turn = rotation(STEP_S * (rate - self.gyro_bias))
        rotated = STEP_S * self.attitude
        f, p = self.jacobian, self.covariance
        f[3:6, 9:12] = -rotated
        f[3:6, 6:9] = -rotated @ skew(force)
        f[6:9, 6:9] = turn.T
        np.matmul(f, p, out=self._half)
        np.matmul(self._half, f.T, out=p)
        p += NOISE
        self.position += STEP_S * self.velocity
        self.velocity += rotated @ force + STEP_S * GRAVITY
        self.attitude = self.attitude @ turn

    def update(self, fix: Array) -> tuple[Array, Array]:
        """Fuse a position; return the residual and the correction."""
        p = self.covariance
        across = p[:, :3]
        gain = across @ np.linalg.inv(p[:3, :3] + FIX_NOISE)
        residual = fix - self.position
        correction = gain @ residual
        p = p - gain @ across.T
        self.covariance = 0.5 * (p + p.T)
        self.position += correction[:3]
        self.velocity += correction[3:6]
        self.attitude = self.attitude @ rotation(correction[6:9])
        self.accelerometer_bias += correction[9:12]
        self.gyro_bias += correction[12:]
        return residual, correction

    def reset(self, correction: Array) -> Array:
        """Express the attitude's error about the corrected attitude; return the Jacobian."""
        j = np.eye(3) - skew(0.5 * correction[6:9])
        p = self.covariance
        p[6:9] = j @ p[6:9]
        p[:, 6:9] = p[:, 6:9] @ j.T
        return j


def bare(data: Data, *, reset: bool) -> None:
    """Run the filter alone."""
    ins = Ins(data)
    for step, (rate, acceleration) in enumerate(zip(data.rate, data.acceleration, strict=True), 1):
        ins.predict(rate, acceleration)
        if step % STEPS_A_FIX == 0:
            _, correction = ins.update(data.fix[step // STEPS_A_FIX - 1])
            if reset:
                ins.reset(correction)


def recorded(data: Data, path: Path, *, reset: bool) -> None:
    """Run the same filter with a recorder."""
    ins = Ins(data)
    with Recorder(path) as record:
        record.prior(BLOCKS, ins.covariance)
        for step, (rate, acceleration) in enumerate(
            zip(data.rate, data.acceleration, strict=True), 1
        ):
            ins.predict(rate, acceleration)
            record.at(step * STEP_S)
            record.predict(ins.jacobian, NOISE)
            if step % STEPS_A_FIX == 0:
                residual, correction = ins.update(data.fix[step // STEPS_A_FIX - 1])
                record.update(
                    "gnss", residual, FIX_JACOBIAN, FIX_NOISE, ["position"], correction=correction
                )
                if reset:
                    record.reset(ins.reset(correction), ["attitude"])
            if step % STEPS_A_SNAPSHOT == 0:
                record.snapshot(ins.covariance)


def commit_s(path: Path, *, synced: bool) -> float:
    """Return seconds by the clock that a full batch's commit takes."""
    with Recorder(path, synced=synced) as record:
        record.prior(BLOCKS, NOISE)
        for step in range(COMMIT_EVENTS - 2):
            record.predict(np.full((15, 15), step), NOISE)
        begin = time.perf_counter()
        record.commit()
        spent = time.perf_counter() - begin
    path.unlink()
    return spent


def read(path: Path) -> float:
    """Return processor seconds of reading a trace."""
    begin = time.process_time()
    for _ in Trace(path):
        pass
    return time.process_time() - begin


def audited(path: Path) -> None:
    """Audit a trace and print how fast, and with how much memory at its peak."""
    begin = time.process_time()
    found = audit(path)
    spent_s = time.process_time() - begin
    peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    events = Trace(path).counts.events
    verdict = "sound" if found.sound else "faulty"
    print(
        f"audit: {events / spent_s:,.0f} events a second, {1e6 * spent_s / events:.1f} us an "
        f"event, peak {peak_mib:,.0f} MiB, {verdict}"
    )


def main() -> None:
    """Run both ways in turns."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--events", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--reset", action="store_true")
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--audit", action="store_true")
    parser.add_argument("--audit-only", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.audit_only:
        audited(given.audit_only)
        return
    if given.keep and given.keep.exists():
        parser.error(f"{given.keep}: exists already")
    more = (2 if given.reset else 1) / STEPS_A_FIX + 1.0 / STEPS_A_SNAPSHOT
    data = simulate(max(STEPS_A_SNAPSHOT, round(given.events / (1.0 + more))))
    with tempfile.TemporaryDirectory() as folder:
        path = given.keep or Path(folder) / "ins.trace"
        alone, beside = [], []
        for _ in range(given.rounds):
            begin = time.process_time()
            bare(data, reset=given.reset)
            middle = time.process_time()
            path.unlink(missing_ok=True)
            between = time.process_time()
            recorded(data, path, reset=given.reset)
            beside.append(time.process_time() - between)
            alone.append(middle - begin)
        events = Trace(path).counts.events
        other = Path(folder) / "commit.trace"
        waited, unsynced = (
            1e6 / COMMIT_EVENTS * min(commit_s(other, synced=one) for _ in range(given.rounds))
            for one in (True, False)
        )
        without, with_recorder = (1e6 * statistics.median(one) / events for one in (alone, beside))
        ratios = [100.0 * (b / a - 1.0) for a, b in zip(alone, beside, strict=True)]
        print(f"{events:,} events, median of {given.rounds} rounds")
        print(f"filter alone: {without:.1f} us an event")
        print(f"recorded: {with_recorder:.1f} us an event")
        cost_us = 1e6 * (min(beside) - min(alone)) / events
        print(f"recorder: {cost_us:.2f} us an event, by the fastest rounds")
        print(
            f"commits: {waited:.2f} us an event by the clock, {unsynced:.2f} without waiting for "
            "the disk, by the fastest rounds"
        )
        print(
            f"overhead: {statistics.median(ratios):.0f} % "
            f"({min(ratios):.0f} to {max(ratios):.0f} %)"
        )
        print(f"file: {path.stat().st_size / events:,.0f} bytes an event")
        print(f"read: {1e6 * read(path) / events:.1f} us an event")
        sys.stdout.flush()
        if given.audit:
            words = (sys.executable, __file__, "--audit-only", path)
            subprocess.run(words, check=True, env={**os.environ, "PYTHONPATH": str(ROOT)})


if __name__ == "__main__":
    main()
