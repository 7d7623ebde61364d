"""What several tests need."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.pose_landmark_measurements import PoseLandmarkSource
from comparisons.adapters.time_window import cut_log
from comparisons.config import EkfConfig, RunConfig
from comparisons.jobs.run import REQUIRED, Comparison, compare_prepared
from comparisons.logs.log import NO_LANDMARK, Log
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.pipeline.prepare import prepare
from comparisons.pipeline.prepared import Preparation, Prepared
from comparisons.report.models import Result
from comparisons.report.run import RunReport
from comparisons.settings import configure, run_options
from research.script import present as present
from tests.ekf_reference.numerics import central_difference as central_difference
from tests.ekf_reference.numerics import random_covariance as random_covariance
from tests.ekf_reference.numerics import relative_error as relative_error

Array = NDArray[np.float64]
T = TypeVar("T")


def altered(thing: T, path: str, value: object) -> T:
    """A dataclass or a named tuple with another value at a path of its fields."""
    name, _, rest = path.partition(".")
    if rest:
        value = altered(getattr(thing, name), rest, value)
    if isinstance(thing, tuple):
        return thing._replace(**{name: value})  # type: ignore[attr-defined, no-any-return]
    return replace(thing, **{name: value})  # type: ignore[type-var]


def simulated(seed: int = 0, **drive: float) -> Log:
    """A simulated log; keywords go to Drive."""
    return simulate(np.random.default_rng(seed), Drive(**drive))  # type: ignore[arg-type]


def first_seconds(log: Log, seconds: float) -> Log:
    """The beginning of a log's odometry and measurements; scans and truth stay whole."""
    part = cut_log(log, end_s=seconds)
    return replace(log, odometry=part.odometry, measurements=part.measurements)


def without_labels(log: Log) -> Log:
    """A log whose measurements name no landmark."""
    nobody = np.full(len(log.measurements.time_s), NO_LANDMARK)
    return replace(log, measurements=replace(log.measurements, landmark=nobody))


def assert_followed(found: Comparison, limit: float) -> None:
    """Both frozen smoothers end where the filter does: its algebra and its models are right."""
    assert found.agreement.algebra.within(limit), found.agreement.algebra
    assert found.agreement.model.within(limit), found.agreement.model


def written(found: Comparison, folder: Path, result: Result | None = None) -> Path:
    """A run's folder, with all that a run writes."""
    RunReport(found, result or RunReport.build(found)).write(folder)
    return folder


class Source(Preparation):
    """Puts a source of measurements of pose landmarks beside the filter."""

    def __init__(self, make: Callable[[], PoseLandmarkSource]) -> None:
        self._make = make

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        setup.source = self._make()


def compared(
    log: Log, *extensions: Preparation, ekf: EkfConfig | None = None, **options: Any
) -> Comparison:
    """Run and compare, with extensions that no configuration names; options as of the command."""
    over = {} if ekf is None else {"ekf": ekf.model_dump(exclude_none=True)}
    config = configure(RunConfig, flags=run_options(options), over=over)
    return compare_prepared(prepare(log, config, required=REQUIRED, also=extensions))
