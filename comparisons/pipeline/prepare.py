"""One preparation for every job: settle the settings, transform the log, line up its instants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from comparisons.adapters.ekf_factory import settle
from comparisons.config import Configured, EkfConfig
from comparisons.errors import InputError
from comparisons.extension_names import EXTENSIONS
from comparisons.logs.hashing import log_hash
from comparisons.logs.log import Log
from comparisons.logs.transforms.known_landmarks import join_known_measurements
from comparisons.pipeline.clock import Progress, no_progress
from comparisons.pipeline.prepared import C, Preparation, Prepared
from comparisons.pipeline.size import check_size
from graphslam.scan.libraries import require

ASKED_BEYOND = 50_000
"""Records of a log beyond which a job asks first whether there is memory enough."""


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
    also: Sequence[Preparation] = (),
) -> Prepared[C]:
    """Settle what is left open and let all that take part change what the estimators are given.

    ekf: the filter's settings, where the job's configuration has none. also: those that take part
    though no configuration names them; they come first. Raises InputError for what the log cannot
    serve, and MissingLibraryError where the job needs what is not installed.
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
    return prepared if prepared.ekf.stretch_sigma_m is None else _with_stretches(prepared)


def _with_stretches(prepared: Prepared[C]) -> Prepared[C]:
    """Leave only those positions to be fused that are good by a first run with all."""
    if prepared.positions is None or not len(prepared.positions.time_s):
        return prepared
    from comparisons.adapters.agreeing_positions import agreeing_positions

    prepared.progress("stretches of good positions", 0, 0)
    with prepared.clock.stage("stretches"):
        stretches = agreeing_positions(
            prepared.log, prepared.ekf, prepared.positions, prepared.beside_filter()
        )
    return replace(prepared, stretches=stretches)


def check_memory(prepared: Prepared[Any]) -> None:
    """Raise InputError where the job needs more memory than the machine has; see size."""
    if sum(prepared.log.records.values()) > ASKED_BEYOND:
        check_size(prepared)


def _check_streams(prepared: Prepared[Any], required: Required) -> None:
    log, extensions = prepared.log, prepared.extensions
    if log.loop_closures is not None and not required.loop_closures:
        raise InputError(f"{log.name}: {_why_no_filter(log)}")
    landmarks = any(extension.brings_landmarks for extension in extensions)
    if required.measurements is not None and not landmarks and not len(log.measurements.time_s):
        raise InputError(
            f"{log.name}: holds no measurements of landmarks ({required.measurements})"
        )
    motion = any(extension.brings_motion for extension in extensions)
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


def _extensions(config: Configured | None) -> list[Preparation]:
    if config is None:
        return []
    order = list(EXTENSIONS)
    named = sorted(config.extensions.items(), key=lambda one: order.index(one[0]))
    return [settings.build(config) for _, settings in named]
