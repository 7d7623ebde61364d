"""How long the stages of a job take, and whom it tells how far it is."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

Progress = Callable[[str, int, int], None]
"""Called with the stage, what is done and what there is to do (0 when not known)."""


def no_progress(stage: str, done: int, total: int) -> None:
    """Show nothing."""


class Clock:
    """seconds: on the wall by stage, in their order. cpu_s: of the processor, by stage.

    Processor time is that of this process, all its threads counted (time.process_time), and of one
    beside it, in the stage that waits for its result: more than the wall's where several work, less
    where the machine was busy with others.
    """

    def __init__(self) -> None:
        """Nothing has been measured."""
        self.seconds: dict[str, float] = {}
        self.cpu_s: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure what is done within."""
        start, cpu = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
            self.cpu_s[name] = self.cpu_s.get(name, 0.0) + time.process_time() - cpu
            _return_memory()

    def add_cpu(self, name: str, cpu_s: float) -> None:
        """Add what another process has done for a stage."""
        self.cpu_s[name] = self.cpu_s.get(name, 0.0) + cpu_s

    def after(self, *others: Clock | None) -> dict[str, dict[str, float]]:
        """Return `seconds` and `cpu_s` as result files have them, stages of others first."""
        clocks = [*(clock for clock in others if clock is not None), self]
        return {
            "seconds": {k: v for clock in clocks for k, v in clock.seconds.items()},
            "cpu_s": {k: v for clock in clocks for k, v in clock.cpu_s.items()},
        }


def _return_memory() -> None:
    """Give what is free back to the system: gtsam's graphs leave the heap in pieces.

    100,000 poses: 1.3 GiB in place of 3.2 after the smoother. Only the GNU C library can.
    """
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
