"""What a job starts from, and what may change it before the estimators read it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, TypeVar

from comparisons.adapters.ekf_factory import fused_positions, held_out_positions
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.motion import check_regular
from comparisons.adapters.timeline import Timeline, build_timeline
from comparisons.arrays import Array
from comparisons.config import EkfConfig, JobConfig
from comparisons.logs.log import Log, Positions
from comparisons.pipeline.clock import Clock, Progress, no_progress

C = TypeVar("C", bound=JobConfig)


class Preparation:
    """One that changes nothing; who takes part in a job overrides what it needs.

    `prepare` comes first, once. `attach` comes before every run of the filter, which may be more
    than one: what it puts beside the filter is made anew each time.
    """

    brings_landmarks = False
    """The estimators need no measurements of the log's."""
    brings_motion = False
    """The estimators need no odometry of the log's."""

    def prepare(self, prepared: Prepared[Any]) -> Prepared[Any]:
        """Return what the estimators are given, changed. Raises InputError."""
        return prepared

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        """Put sources, observers or guards beside a filter that is about to run."""


@dataclass(frozen=True, kw_only=True)
class Prepared(Generic[C]):
    """What a job starts from.

    log: as the estimators read it. config: the job's. ekf: the filter's settings, nothing left
    open. extensions: who takes part. epochs: (N,) instants [s] at which the filter stops besides
    those of the log's observations. stretches: the positions that are good, where the settings ask
    for these alone.
    """

    log: Log
    config: C
    ekf: EkfConfig
    extensions: tuple[Preparation, ...] = ()
    epochs: Array | None = None
    stretches: Positions | None = None
    progress: Progress = no_progress
    clock: Clock = field(default_factory=Clock)

    @property
    def labelled(self) -> bool:
        """The log's labels say which landmark a measurement is of."""
        return self.ekf.association == "known"

    @cached_property
    def positions(self) -> Positions | None:
        """The absolute positions that both estimators fuse."""
        if self.stretches is not None:
            return self.stretches
        return fused_positions(self.log, self.ekf)

    @property
    def outside_stretches(self) -> int | None:
        """Positions left out, as they are in no good stretch; None where all are asked for."""
        given = fused_positions(self.log, self.ekf)
        if self.stretches is None or given is None:
            return None
        return len(given.time_s) - len(self.stretches.time_s)

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
