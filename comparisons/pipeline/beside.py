"""Work in a second process, beside this one, where another core is free; else here, when asked for.

gtsam keeps Python's global lock while it works, so a thread would only wait. The result is the same
to the bit wherever it is computed. The pool is joblib's, an executor of concurrent.futures that
does not load the user's `__main__` once more, as the standard library's would.
"""

from __future__ import annotations

import functools
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Generic, TypeVar

from comparisons.errors import InputError

T = TypeVar("T")

ASSOCIATION_PAYS_FROM = 10_000
"""Poses and measurements from which an association by the smoother is worth a second process."""


class BackgroundCall(Generic[T]):
    """One call of a function. cpu_s: of the other process, known with the result."""

    def __init__(
        self,
        function: Callable[..., T],
        *arguments: Any,
        size: tuple[int, int, int],
        pays_from: int,
    ) -> None:
        """Start the call where it pays.

        size: poses, measurements and landmarks of what the call solves, for which there must be
        memory beside this process. pays_from: poses and measurements from which a second process,
        which takes a second or two to start, gains time.
        """
        self.cpu_s = 0.0
        self._function, self._arguments = function, arguments
        self._pool: Executor | None = None
        self._future: Future[tuple[T, float]] | None = None
        if size[0] + size[1] >= pays_from and _is_free() and _has_room(size):
            self._pool = _pool()
            if self._pool is not None:
                self._future = self._pool.submit(_measured, function, arguments)

    @property
    def elsewhere(self) -> bool:
        """Whether another process has the work."""
        return self._future is not None

    def __enter__(self) -> BackgroundCall[T]:
        """Return itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the process, also if it is still at work."""
        pool, self._pool = self._pool, None
        if pool is not None and self._future is not None:
            pool.shutdown(kill_workers=not self._future.done())  # type: ignore[call-arg]

    def result(self) -> T:
        """Return what the function returns, or raise what it raises.

        What cannot be sent to another process is computed here. Raises InputError where that
        process was ended from outside.
        """
        if self._future is None:
            return self._function(*self._arguments)
        try:
            value, self.cpu_s = self._future.result()
        except pickle.PicklingError:
            return self._function(*self._arguments)
        except BrokenProcessPool as error:
            raise InputError(
                "a second process, which worked beside this one, was ended from outside, perhaps "
                "for lack of memory; on one core (taskset -c 0) there is none"
            ) from error
        return value


def cores() -> int:
    """Cores that this process may use: of its affinity, and of its control group."""
    import joblib

    return int(joblib.cpu_count())


def _is_free() -> bool:
    """Whether a core is; never in a worker of someone else's, process or thread."""
    import multiprocessing

    return (
        multiprocessing.parent_process() is None
        and threading.current_thread() is threading.main_thread()
        and os.access(sys.executable or "", os.X_OK)
        and cores() > 1
    )


def _has_room(size: tuple[int, int, int]) -> bool:
    """Whether there is memory for two at once."""
    from comparisons.pipeline.size import available_bytes, needed

    room = available_bytes()
    return room is None or room > 2.0 * needed(*size)


def _pool() -> Executor | None:
    """Return a pool of one process; None where the system has none to give."""
    from joblib.externals.loky import ProcessPoolExecutor

    try:
        pool: Executor = ProcessPoolExecutor(1, initializer=_become_worker, initargs=(os.getpid(),))
    except (OSError, NotImplementedError, ImportError):  # such as no shared memory
        return None
    return pool


def _become_worker(parent: int) -> None:
    """Print to standard error only, leave interrupts to the parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)
    end_with(parent)


@functools.cache
def end_with(parent: int) -> None:
    """Have this process, a worker, leave when the one that asked is gone, killed or not."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.2)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _measured(function: Callable[..., T], arguments: tuple[Any, ...]) -> tuple[T, float]:
    """Return value and processor time, without warnings, which would be for the parent's log."""
    import warnings

    import numpy as np

    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return function(*arguments), time.process_time()
