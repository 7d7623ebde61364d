"""Short stretches of a receiver's good positions, where nothing in the log says which they are.

Guivant 2002, section 5: "the GPS were able to report position with 10 cm accuracy for short periods
of time". The receiver reports its deviation (Fig. 6); a public log may not have it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.smoother_input import build_problem, position_rows, run_smoother
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.config import EkfConfig
from comparisons.errors import InputError
from comparisons.logs.log import Log, Positions
from comparisons.plane import turned
from graphslam.smoother import SmootherOptions

STRETCH_S = 5.0
"""Shortest stretch."""
MOST_OFFSET = 3.0
"""Largest mean distance of a stretch from SLAM, in sigmas."""
FULL = 0.8
"""Least share of the positions that a stretch would have at the usual interval."""
LEAST_FIXES = 3
"""In a stretch; a spread is of several."""


def agreeing_positions(
    log: Log, choices: EkfConfig, given: Positions, beside: FilterSetup
) -> Positions:
    """Return the positions of stretches of RTK quality, each with their sigma.

    A first run of filter and smoother fuses all, with the log's sigmas and a gate; where a stretch
    keeps one distance from that path, to one sigma, and a small one, it is good.

    Args:
        log: as the estimators read it.
        choices: the filter's, settled, with `stretch_sigma_m`.
        given: the positions that may be fused.
        beside: what stands beside the filter in the first run.

    Raises:
        InputError: where no stretch is good.
        ValueError: without `stretch_sigma_m`.
    """
    sigma_m = choices.stretch_sigma_m
    if sigma_m is None:
        raise ValueError("stretch_sigma_m is None, expected the sigma of a good position")
    first = settle(choices.model_copy(update={"stretch_sigma_m": None, "position_gate": None}), log)
    timeline = build_timeline(log, given)
    run = run_ekf(log, timeline, first, given, beside)
    smoothed = run_smoother(build_problem(log, run), run, SmootherOptions())
    rows = position_rows(run.timeline, given)
    poses = smoothed.poses[rows.epoch]
    antenna = poses[:, :2] + turned(np.array(rows.antenna_m), poses[:, 2])
    offset = rows.position - antenna
    kept = in_stretches(given.time_s[: len(offset)], offset, sigma_m)
    if not kept.any():
        raise InputError(
            f"{log.name}: no {STRETCH_S:g} s in which its {len(kept):,} positions keep one "
            f"distance from SLAM, to {sigma_m:g} m, of at most {MOST_OFFSET * sigma_m:g} m, "
            "expected some for ekf.stretch_sigma_m; a larger one takes more, without one all are "
            "fused"
        )
    return given.chosen(np.flatnonzero(kept)).with_sigma(sigma_m)


def in_stretches(time_s: Array, offset_m: Array, sigma_m: float) -> NDArray[np.bool_]:
    """Return which positions (N,) lie in a stretch of STRETCH_S that is good throughout.

    Args:
        time_s: (N,) ascending.
        offset_m: (N, 2) from a path.
        sigma_m: of a good position on each axis. The standard deviation within a stretch is at most
            this on both axes, the length of its mean at most MOST_OFFSET of it.
    """
    kept = np.zeros(len(time_s), dtype=bool)
    ends = np.searchsorted(time_s, time_s + STRETCH_S, side="right")
    interval_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf
    least = max(LEAST_FIXES, round(FULL * STRETCH_S / interval_s))
    for begin, end in enumerate(ends):
        stretch = offset_m[begin:end]
        if (
            len(stretch) >= least
            and stretch.std(axis=0).max() <= sigma_m
            and np.linalg.norm(stretch.mean(axis=0)) <= MOST_OFFSET * sigma_m
        ):
            kept[begin:end] = True
    return kept
