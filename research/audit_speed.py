"""What recording costs a filter, and how fast its trace is read and audited.

    python -m research.audit_speed [--events 100000] [--rounds 5]

A linear filter of 15 states (five blocks of three, full matrices, positions every tenth step, a
reset after each, a snapshot every hundredth step) goes over the same data with and without a
recorder, in turns. Its errors are drawn, so that it is sound. Times are of the processor, but for
commits, which wait for the disk or do not.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comparisons.audit.audit import audit
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import COMMIT_EVENTS, Recorder
from research.script import options
from research.timing import timed

Array = NDArray[np.float64]

STEPS_A_FIX, STEPS_A_SNAPSHOT = 10, 100
BLOCKS = dict.fromkeys(("position", "velocity", "attitude", "drift", "scale"), 3)
SIZE = sum(BLOCKS.values())
RNG = np.random.default_rng(1)
F = 0.99 * np.eye(SIZE) + 0.002 * RNG.standard_normal((SIZE, SIZE))
RESET = np.eye(3) + 0.01 * RNG.standard_normal((3, 3))
"""Of the attitude's error."""
NOISE, FIX_NOISE, H = 1e-3 * np.eye(SIZE), np.eye(3), np.eye(3, SIZE)


def run(steps: int, path: Path | None = None) -> None:
    """Run the filter; with a recorder where a path is given."""
    rng, p = np.random.default_rng(0), np.eye(SIZE)
    error = rng.standard_normal(SIZE)
    record = None if path is None else Recorder(path)
    if record:
        record.prior(BLOCKS, p)
    for step in range(1, steps + 1):
        error = F @ error + np.sqrt(1e-3) * rng.standard_normal(SIZE)
        p = F @ p @ F.T + NOISE
        if record:
            record.at(0.01 * step)
            record.predict(F, NOISE)
        if step % STEPS_A_FIX == 0:
            gain = p[:, :3] @ np.linalg.inv(p[:3, :3] + FIX_NOISE)
            residual = error[:3] + rng.standard_normal(3)
            correction = gain @ residual
            error = error - correction
            p = p - gain @ p[:3]
            p = 0.5 * (p + p.T)
            p[6:9], error[6:9] = RESET @ p[6:9], RESET @ error[6:9]
            p[:, 6:9] = p[:, 6:9] @ RESET.T
            if record:
                record.update(
                    "gnss", residual, H[:, :3], FIX_NOISE, ["position"], correction=correction
                )
                record.reset(RESET, ["attitude"])
        if record and step % STEPS_A_SNAPSHOT == 0:
            record.snapshot(p)
    if record:
        record.close()


def commit_s(path: Path, *, synced: bool) -> float:
    """Return seconds by the clock that a full batch's commit takes."""
    with Recorder(path, synced=synced) as record:
        record.prior(BLOCKS, NOISE)
        for step in range(COMMIT_EVENTS - 2):
            record.predict(np.full((SIZE, SIZE), step), NOISE)
        begin = time.perf_counter()
        record.commit()
        spent = time.perf_counter() - begin
    path.unlink()
    return spent


def read(path: Path) -> int:
    """Go through a trace; return the number of its events."""
    return sum(1 for _ in TraceReader(path))


def main() -> None:
    """Run both ways in turns, then read and audit what was recorded last."""
    given = options(__doc__, events=100_000, rounds=5)
    more = 2.0 / STEPS_A_FIX + 1.0 / STEPS_A_SNAPSHOT
    steps = max(STEPS_A_SNAPSHOT, round(given.events / (1.0 + more)))
    with tempfile.TemporaryDirectory() as folder:
        path, other = Path(folder) / "filter.trace", Path(folder) / "commit.trace"
        turns = []
        for _ in range(given.rounds):
            path.unlink(missing_ok=True)
            turns.append((timed(run, steps)[1], timed(run, steps, path)[1]))
        events = TraceReader(path).counts.events
        waited, unsynced = (
            1e6 / COMMIT_EVENTS * min(commit_s(other, synced=one) for _ in range(given.rounds))
            for one in (True, False)
        )
        for name, times in zip(("filter alone", "recorded"), zip(*turns, strict=True), strict=True):
            print(f"{name}: {1e6 * statistics.median(times) / events:.1f} us an event")
        cost_us = 1e6 * statistics.median(beside - alone for alone, beside in turns) / events
        print(f"recorder: {cost_us:.2f} us an event")
        print(f"commits: {waited:.2f} us an event by the clock, {unsynced:.2f} without the disk")
        print(f"file: {path.stat().st_size / events:,.0f} bytes an event")
        print(f"read: {1e6 * timed(read, path)[1] / events:.1f} us an event")
        found, audit_s = timed(audit, path)
        verdict = "sound" if found.sound else "faulty"
        print(f"audit: {1e6 * audit_s / events:.1f} us an event, {verdict}")


if __name__ == "__main__":
    main()
