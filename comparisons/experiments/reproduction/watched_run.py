"""A filter's run from within: stop after every scan and look, or put something beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.filter_loop import Beside, NoObserver, run_filter_loop
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.config import EkfConfig
from comparisons.errors import InputError
from comparisons.logs.log import Log, Poses, Positions
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.state import FilterDivergedError
from ekf_reference.core.trace import Trace


def watched_run(
    log: Log,
    choices: EkfConfig | None = None,
    trace: Trace | None = None,
    predicted: Callable[[Ekf], None] = lambda ekf: None,
    positions: Positions | None = None,
) -> Iterator[tuple[float, Ekf]]:
    """Yield the one filter after every scan with measurements, and the scan's time [s].

    choices: the full filter by default. predicted: shown the filter before it fuses. positions:
    to be fused. Surveyed landmarks are not used. Raises FilterDivergedError.
    """
    ekf = build_ekf(log, settle(choices or EkfConfig(), log), trace or Trace())
    beside = Beside(watching=_Shown(predicted))
    for state in run_filter_loop(ekf, log, build_timeline(log, positions), positions, beside):
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


class _Shown(NoObserver):
    """Shows the filter to someone before it fuses."""

    def __init__(self, predicted: Callable[[Ekf], None]) -> None:
        self._predicted = predicted

    def on_predict(self, ekf: Ekf) -> None:
        """Show it."""
        self._predicted(ekf)
