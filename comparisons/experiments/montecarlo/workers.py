"""Independent pieces of work, on this machine's cores or on a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import Any, TypeVar

from comparisons.errors import InputError, quoted, shorten
from comparisons.pipeline.beside import cores, end_with

Result = TypeVar("Result")
_MOST_WORKERS = 1000


def spread(
    function: Callable[..., Result],
    tasks: Sequence[tuple[Any, ...]],
    workers: int = 1,
    scheduler: str | None = None,
) -> Iterator[tuple[int, Result]]:
    """Results as they come, each with its task's place; scheduler: a Dask cluster's address.

    Raises InputError where Dask is missing or the scheduler does not answer.
    """
    import joblib

    with ExitStack() as stack:
        parent = None
        if scheduler is None:
            backend: dict[str, Any] = {"n_jobs": min(workers, max(len(tasks), 1))}
            if workers > 1:
                backend |= {"backend": "loky", "inner_max_num_threads": 1}
                parent = os.getpid()
        else:
            stack.enter_context(_client(scheduler))
            backend = {"backend": "dask", "n_jobs": -1}
        stack.enter_context(joblib.parallel_config(**backend))
        jobs = (joblib.delayed(_placed)(function, i, task, parent) for i, task in enumerate(tasks))
        yield from joblib.Parallel(return_as="generator_unordered", batch_size=1)(jobs)


def one_each_core() -> int:
    """Return how many processes have a core each that this one may use."""
    return min(cores(), _MOST_WORKERS)


def check_workers(workers: int) -> None:
    """Raise InputError for a number of processes that no machine has."""
    if not 1 <= workers <= _MOST_WORKERS:
        raise InputError(f"--workers is {quoted(workers)}, expected 1 to {_MOST_WORKERS}")


def _placed(
    function: Callable[..., Result], place: int, task: tuple[Any, ...], parent: int | None
) -> tuple[int, Result]:
    """parent: process with which a worker ends, None where no other process works for it."""
    if parent not in (None, os.getpid()):
        end_with(parent)
    return place, function(*task)


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "--scheduler needs Dask, which is not installed: pip install 'slamcheck[dask]'"
        ) from None
    connect: Any = Client
    try:
        return connect(address, timeout=10)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"scheduler {shorten(address, 200)}: cannot be reached ({error})"
        ) from None
