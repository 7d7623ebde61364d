"""Work in a second process, beside this one, where another core is free; else here, when asked for.

gtsam keeps Python's global lock while it works, so a thread would only wait. The result is the same
to the bit wherever it is computed. The process has no part of the terminal's signals; it is ended
with the `with` block, and ends by itself when this process is gone.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import IO, TYPE_CHECKING, Any, Generic, TypeVar, cast

if TYPE_CHECKING:
    import subprocess

T = TypeVar("T")

PAYS_S = 4.0
"""Seconds of work beyond which a second process pays: to start one takes 1 to 2."""
_CODE = "import sys; sys.path[:] = {path!r}; from comparisons.pipeline.beside import serve; serve()"


class Beside(Generic[T]):
    """One call of a function. cpu_s: of the other process, known with the result."""

    def __init__(
        self,
        function: Callable[..., T],
        *arguments: Any,
        seconds: float,
        size: tuple[int, int, int] = (0, 0, 0),
    ) -> None:
        """Start the call where it pays.

        function: of a module's top level. arguments: that can be pickled. seconds: about what the
        call takes, or what is done meanwhile, whichever is less. size: poses, measurements and
        landmarks of what it solves, for which there must be memory beside this process.
        """
        self.cpu_s = 0.0
        self._function, self._arguments = function, arguments
        self._process: subprocess.Popen[bytes] | None = None
        if seconds > PAYS_S and _is_free() and _has_room(size):
            self._process = _started(function, arguments)

    @property
    def elsewhere(self) -> bool:
        """Whether another process has the work."""
        return self._process is not None

    def __enter__(self) -> Beside[T]:
        """Return itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the process if it is still at work."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            with suppress(OSError):  # what was not yet written finds nobody
                process.communicate()

    def result(self) -> T:
        """Return what the function returns, or raise what it raises.

        What a process leaves that was killed, or had too little memory, is computed here.
        """
        answer = None if self._process is None else _answer(self._process)
        if answer is None:
            return self._function(*self._arguments)
        value, error, self.cpu_s = answer
        if error is not None:
            raise error
        found: T = value
        return found


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
        and cores() > 1
    )


def _has_room(size: tuple[int, int, int]) -> bool:
    """Whether there is memory for two at once."""
    from comparisons.pipeline.size import available_bytes, needed

    room = available_bytes()
    return room is None or room > 2.0 * needed(*size)


def _started(
    function: Callable[..., Any], arguments: tuple[Any, ...]
) -> subprocess.Popen[bytes] | None:
    """Return a process that has its work; None where it cannot be had."""
    import subprocess

    try:
        asked = pickle.dumps((function, arguments), pickle.HIGHEST_PROTOCOL)
        process = subprocess.Popen(  # noqa: S603 - this very program
            [sys.executable, "-c", _CODE.format(path=sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            process_group=0,
        )
    except (OSError, ValueError, TypeError, AttributeError, pickle.PicklingError):
        return None
    with suppress(OSError):  # a process that is gone gives no answer
        _write(cast(IO[bytes], process.stdin), asked)
    return process


def _answer(process: subprocess.Popen[bytes]) -> tuple[Any, Exception | None, float] | None:
    """Return value, error and processor time; None where the process has none to give."""
    try:
        value, error, cpu_s = pickle.loads(_read(cast(IO[bytes], process.stdout)))  # noqa: S301 - our own process
    except (OSError, EOFError, pickle.UnpicklingError, TypeError, AttributeError, ImportError):
        return None
    return None if isinstance(error, MemoryError) else (value, error, cpu_s)


def serve() -> None:
    """Do what is asked for on standard input, and answer on standard output."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries' prints
    asked = _read(sys.stdin.buffer)  # whole, before the imports: the other side waits for it
    threading.Thread(target=_leave_at_end, args=(sys.stdin.buffer,), daemon=True).start()
    answer = _call(asked)
    with suppress(OSError):
        _write(answers, answer)


def _call(asked: bytes) -> bytes:
    import warnings

    import numpy as np

    value, error = None, None
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # as in the other process, whose log they would be for
        try:
            function, arguments = pickle.loads(asked)  # noqa: S301 - our own process
            value = function(*arguments)
        except Exception as caught:  # to be raised in the other process
            error = caught
    return pickle.dumps((value, error, time.process_time()), pickle.HIGHEST_PROTOCOL)


def _leave_at_end(source: IO[bytes]) -> None:
    """Leave when the process that asked is gone."""
    source.read(1)
    os._exit(1)


def _write(stream: IO[bytes], content: bytes) -> None:
    stream.write(len(content).to_bytes(8, "little") + content)
    stream.flush()


def _read(stream: IO[bytes]) -> bytes:
    """Raise EOFError where less is there than was announced."""
    length = int.from_bytes(stream.read(8), "little")
    content = stream.read(length)
    if not length or len(content) < length:
        raise EOFError
    return content
