"""A filter's run from within: stop after every scan and look, or put something beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from comparisons.logs.log import Log
from comparisons.runs.ekf_build import EkfChoices, build_ekf
from comparisons.runs.timeline import build_timeline
from ekf_reference.full_ekf import FullEkf
from ekf_reference.trace import NullTrace, Trace


def watched_run(
    log: Log,
    choices: EkfChoices | None = None,
    trace: Trace | None = None,
    predicted: Callable[[FullEkf], None] = lambda ekf: None,
) -> Iterator[tuple[float, FullEkf]]:
    """The filter after every scan with sightings, and the scan's time [s]; one filter throughout.

    choices: the full filter by default. predicted: shown the filter before it fuses. Surveyed
    landmarks and positions are not used.
    """
    timeline, seen = build_timeline(log), log.sightings
    ekf = build_ekf(log, (choices or EkfChoices()).settle(log), trace or NullTrace())
    z = np.column_stack((seen.range_m, seen.bearing_rad))
    sigma = np.column_stack((seen.sigma_range_m, seen.sigma_bearing_rad))
    steps, first, done = timeline.steps_until(), timeline.sightings_until(), 0
    for k in np.flatnonzero(np.diff(first)):
        for i in range(done, int(steps[k])):
            ekf.predict(
                timeline.control[i],
                timeline.control_covariance[i],
                float(timeline.step_duration_s[i]),
            )
        done = int(steps[k])
        rows, time = slice(int(first[k]), int(first[k + 1])), float(timeline.epoch_time_s[k])
        predicted(ekf)
        ekf.observe(z[rows], sigma[rows], seen.landmark[rows], time)
        yield time, ekf
