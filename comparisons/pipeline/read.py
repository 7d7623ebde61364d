"""From a configuration to the log and the estimate that it names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from comparisons.config import (
    CheckConfig,
    JobConfig,
    LogSection,
    check_unchanged,
    full_path,
    recorded_path,
)
from comparisons.errors import InputError
from comparisons.logs.bundled import NAMED, SimulationChoices, open_log
from comparisons.logs.hashing import log_hash
from comparisons.logs.log import Log
from comparisons.pipeline.clock import Clock
from graphslam.scan.libraries import require

if TYPE_CHECKING:
    from comparisons.estimates.external import ExternalEstimate

C = TypeVar("C", bound=JobConfig)


def load_log(section: LogSection) -> Log:
    """Return the log that a configuration names, with the features asked for. Raises InputError."""
    choices = SimulationChoices(section.seed, section.loops, section.noise_scale)
    topics = tuple(section.topics or ())
    source = str(recorded_path(section.source))
    return as_asked(open_log(source, section.format, section.robot, choices, topics), section)


def as_asked(log: Log, section: LogSection) -> Log:
    """Return a log with what a configuration asks of it: time, features, sigmas, start."""
    if section.start_s is not None or section.end_s is not None:
        from comparisons.adapters.time_window import cut_log

        log = cut_log(log, section.start_s, section.end_s)
    if section.features == "trees":
        from comparisons.adapters.tree_features import with_tree_features

        log = with_tree_features(log)
    if section.sigmas == "published":
        from comparisons.logs.transforms.published_sigmas import with_published_sigmas

        log = with_published_sigmas(log)
    if section.prior_pose is not None:
        from comparisons.adapters.alignment import with_prior_pose

        log = with_prior_pose(log, section.prior_pose)
    if section.align:
        from comparisons.adapters.alignment import with_truth_at_start

        log = with_truth_at_start(log)
    if section.sigma_position_m is not None and log.positions is not None:
        log = replace(log, positions=log.positions.with_sigma(section.sigma_position_m))
    return log


def read_estimate(config: CheckConfig) -> ExternalEstimate:
    """Return the estimate that a configuration names. Raises InputError."""
    from comparisons.estimates.external import read_external

    return read_external(Path(config.estimate), config.times, config.trace, _topics(config)[1])


def _topics(config: JobConfig) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Topics of the log, and of the estimate, where both may be bags."""
    topics = tuple(config.log.topics or ())
    if not topics or not isinstance(config, CheckConfig):
        return topics, ()
    from comparisons.estimates.bag_estimate import split_topics

    return split_topics(Path(config.estimate), recorded_path(config.log.source), topics)


def read_for(config: C, *, allow_changed: bool = False) -> tuple[Log, C, Clock]:
    """Return the log, the configuration with its hash and full path, and the time that took.

    Raises InputError where the configuration has the hash of another log, unless that is allowed,
    and MissingLibraryError where the job needs what is not installed.
    """
    require(config.libraries())
    section, clock = config.log, Clock()
    with clock.stage("read"):
        log = load_log(section.model_copy(update={"topics": _topics(config)[0]}))
        if section.align and log.truth.poses is None and not isinstance(config, CheckConfig):
            raise InputError(f"{log.name}: has no true poses, expected some for --align")
        found = log_hash(log)
    if not allow_changed:
        option = "--allow-changed-log, as for a hash of slamcheck 0.2 or older,"
        check_unchanged(section.source, found, section.sha256, option)
    path = Path(section.source)
    named = section.source in NAMED and section.format is None and not path.exists()
    full = section.source if named else full_path(path)
    return log, config.at_log(found, full), clock
