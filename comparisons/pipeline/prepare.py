"""One preparation for every job: settle the settings, transform the log, line up its instants."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, NamedTuple, TypeVar

from comparisons.adapters.ekf_factory import fused_positions, held_out_positions, settle
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.motion import check_regular
from comparisons.adapters.timeline import Timeline, build_timeline
from comparisons.arrays import Array
from comparisons.config import Configured, EkfConfig, JobConfig
from comparisons.errors import InputError
from comparisons.extensions.interface import Extension
from comparisons.extensions.registry import EXTENSIONS
from comparisons.logs.hashing import log_hash
from comparisons.logs.log import Log, Positions
from comparisons.logs.transforms.known_landmarks import join_known_measurements
from graphslam.scan.libraries import require

C = TypeVar("C", bound=JobConfig)
Progress = Callable[[str, int, int], None]
"""Called with the stage, what is done and what there is to do (0 when not known)."""


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
        clocks = [*(one for one in others if one is not None), self]
        return {
            "seconds": {k: v for one in clocks for k, v in one.seconds.items()},
            "cpu_s": {k: v for one in clocks for k, v in one.cpu_s.items()},
        }


def _return_memory() -> None:
    """Give what is free back to the system: gtsam's graphs leave the heap in pieces.

    100,000 poses: 1.3 GiB in place of 3.2 after the smoother. Only the GNU C library can.
    """
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


ASKED_BEYOND = 50_000
"""Records of a log beyond which a job asks first whether there is memory enough."""


def no_progress(stage: str, done: int, total: int) -> None:
    """Show nothing."""


@dataclass(frozen=True, kw_only=True)
class Prepared(Generic[C]):
    """What a job starts from.

    log: as the estimators read it. config: the job's. ekf: the filter's settings, nothing left
    open. epochs: (N,) instants [s] at which the filter stops besides those of the log's
    observations.
    """

    log: Log
    config: C
    ekf: EkfConfig
    extensions: tuple[Extension, ...] = ()
    epochs: Array | None = None
    progress: Progress = no_progress
    clock: Clock = field(default_factory=Clock)

    @property
    def labelled(self) -> bool:
        """The log's labels say which landmark a measurement is of."""
        return self.ekf.association == "known"

    @cached_property
    def positions(self) -> Positions | None:
        """The absolute positions that both estimators fuse."""
        return fused_positions(self.log, self.ekf)

    @cached_property
    def timeline(self) -> Timeline:
        """The instants at which something is fused, and the odometry in between.

        Raises InputError where the odometry leaves a motion without full rank.
        """
        check_regular(self.log, self.filter_timeline)
        return self.filter_timeline

    @cached_property
    def filter_timeline(self) -> Timeline:
        """The same whatever the odometry's rank, which filters alone do not need."""
        return build_timeline(self.log, self.positions, self.epochs)

    @cached_property
    def judged(self) -> Log:
        """The log with those positions only that no estimator was given."""
        return replace(self.log, positions=held_out_positions(self.log, self.ekf))

    def beside_filter(self) -> FilterSetup:
        """What the extensions put beside a filter that is about to run, made anew."""
        setup = FilterSetup()
        for extension in self.extensions:
            extension.attach(setup, self)
        return setup

    def stage_progress(self, stage: str) -> Callable[[int, int], None]:
        """Return a progress function for one stage."""
        return lambda done, total: self.progress(stage, done, total)


class Required(NamedTuple):
    """What a job cannot do without, with a hint where the log lacks it; None to do without.

    loop_closures: the job takes motions between poses that do not follow each other.
    """

    measurements: str | None = None
    odometry: str | None = None
    loop_closures: bool = False


def prepare(
    log: Log,
    config: C,
    ekf: EkfConfig | None = None,
    progress: Progress = no_progress,
    required: Required | None = None,
    also: Sequence[Extension] = (),
) -> Prepared[C]:
    """Settle what is left open and let every extension change what the estimators are given.

    ekf: the filter's settings, where the job's configuration has none. also: extensions that no
    configuration names; they come first. Raises InputError for what the log cannot serve, and
    MissingLibraryError where the job needs what is not installed.
    """
    require(config.libraries())
    if config.log.sha256 is None:
        config = config.at_log(log_hash(log), log.name)
    configured = config if isinstance(config, Configured) else None
    if ekf is None:
        ekf = EkfConfig() if configured is None else configured.ekf
    prepared = Prepared(
        log=join_known_measurements(log),
        config=config,
        ekf=settle(ekf, log),
        extensions=(*also, *_extensions(configured)),
        progress=progress,
    )
    _check_streams(prepared, required or Required())
    for extension in prepared.extensions:
        prepared = extension.prepare(prepared)
    return prepared


def check_memory(prepared: Prepared[Any]) -> None:
    """Raise InputError where the job needs more memory than the machine has; see size."""
    if sum(prepared.log.records.values()) > ASKED_BEYOND:
        from comparisons.pipeline.size import check_size

        check_size(prepared)


def _check_streams(prepared: Prepared[Any], required: Required) -> None:
    log, extensions = prepared.log, prepared.extensions
    if log.loop_closures is not None and not required.loop_closures:
        raise InputError(f"{log.name}: {_why_no_filter(log)}")
    landmarks = any(one.brings_landmarks for one in extensions)
    if required.measurements is not None and not landmarks and not len(log.measurements.time_s):
        raise InputError(
            f"{log.name}: holds no measurements of landmarks ({required.measurements})"
        )
    motion = any(one.brings_motion for one in extensions)
    if required.odometry is not None and not motion and not len(log.odometry.time_s):
        raise InputError(f"{log.name}: holds no odometry; {required.odometry}")


def _why_no_filter(log: Log) -> str:
    """Why a filter of landmarks cannot serve a log with closures."""
    closures = f"holds {log.records['loop closures']:,} loop closures from pose to pose"
    takes = "slamcheck solve takes it, and no other job that estimates"
    if len(log.measurements.time_s):
        return (
            f"{closures} beside its measurements; {takes}: a landmark EKF cannot fuse them, and "
            "without them it would not read the same log as the smoother"
        )
    return f"{closures} and no landmarks; {takes}: a landmark EKF has nothing to observe"


def _extensions(config: Configured | None) -> list[Extension]:
    if config is None:
        return []
    order = list(EXTENSIONS)
    named = sorted(config.extensions.items(), key=lambda one: order.index(one[0]))
    return [settings.build(config) for _, settings in named]
