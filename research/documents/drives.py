"""Drives behind the figures: their truth, and a filter watched from scan to scan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.filter_loop import run_filter_loop
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.config import EkfConfig
from comparisons.errors import InputError
from comparisons.logs.log import Log, Poses, Positions
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.state import FilterDivergedError
from ekf_reference.core.trace import Trace

D = TypeVar("D")


@dataclass(frozen=True)
class Drives(Generic[D]):
    """What each of several drives left. log: on which they ran, in words. The first is drawn."""

    log: str
    each: tuple[D, ...]


def watched_run(log: Log, positions: Positions | None = None) -> Iterator[tuple[float, Ekf]]:
    """Yield the one full filter after every scan with measurements, and the scan's time [s].

    positions: to be fused. Surveyed landmarks are not used. Raises FilterDivergedError.
    """
    ekf = build_ekf(log, settle(EkfConfig(), log), Trace())
    for state in run_filter_loop(ekf, log, build_timeline(log, positions), positions):
        if state.fault is not None:
            raise FilterDivergedError(state.fault)
        if len(state.landmark_indices):
            yield state.time_s, ekf


def truth_in_order(log: Log) -> tuple[Poses, Array]:
    """Poses, and landmarks (L, 2) in the order in which a filter that knows labels adds them.

    Raises InputError for a log without truth or labels.
    """
    poses, true = log.truth.poses, log.truth.landmarks
    if poses is None or true is None or not log.measurements.labelled:
        raise InputError(f"{log.name}: true poses, true landmarks and labels are needed")
    return poses, true.places_of(log.measurements.labels_in_order)


def true_surroundings(log: Log) -> tuple[Poses, Array]:
    """Poses, and surfaces as segments (S, 4) [m]. Raises InputError for a log without truth."""
    if log.truth.poses is None or log.truth.surfaces is None:
        raise InputError(f"{log.name}: true poses and surfaces are needed")
    return log.truth.poses, log.truth.surfaces.segment
