"""A filter's run from within: stop after every scan and look, or put something beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from comparisons.logs.log import Log
from comparisons.runs.drive import NoWatcher, drive
from comparisons.runs.ekf_build import EkfChoices, build_ekf
from comparisons.runs.timeline import build_timeline
from ekf_reference.full_ekf import FullEkf
from ekf_reference.kalman import FilterDivergedError
from ekf_reference.trace import NullTrace, Trace


def watched_run(
    log: Log,
    choices: EkfChoices | None = None,
    trace: Trace | None = None,
    predicted: Callable[[FullEkf], None] = lambda ekf: None,
) -> Iterator[tuple[float, FullEkf]]:
    """The filter after every scan with sightings, and the scan's time [s]; one filter throughout.

    choices: the full filter by default. predicted: shown the filter before it fuses. Surveyed
    landmarks and positions are not used. Raises FilterDivergedError.
    """
    ekf = build_ekf(log, (choices or EkfChoices()).settle(log), trace or NullTrace())
    for stop in drive(ekf, log, build_timeline(log), watching=_Shown(predicted)):
        if stop.fault is not None:
            raise FilterDivergedError(stop.fault)
        if len(stop.slots):
            yield stop.time_s, ekf


class _Shown(NoWatcher):
    """Shows the filter to someone before it fuses."""

    def __init__(self, predicted: Callable[[FullEkf], None]) -> None:
        self._predicted = predicted

    def arrived(self, ekf: FullEkf) -> None:
        """Show it."""
        self._predicted(ekf)
