"""What the suboptimal global update spares, saves and loses over c1 (Guivant 2002, section 4.1).

    python -m research.suboptimal [--data victoria_park] [--size 4000x2000] [--gains 0 1e-4 ...]
    python -m research.suboptimal --crossing [--states 600 1200 2400 4800]

The first prints a row for each c1 (0: the exact compressed filter): the share of the passive block
that global updates leave as it is, processor time of all global updates and of the whole filter,
and the loss, the sigmas of the landmarks over those of the exact filter, where both have the same
landmarks. The second prints, for a map of so many states, the time of one global update by the
share of its passive states in set I over that of the exact one, and the share from which on sparing
takes less time: the crossing point.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from comparisons.config import EkfConfig, RunConfig
from comparisons.jobs.run import run_filter
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.pipeline.prepare import prepare
from ekf_reference.core import machine
from ekf_reference.core.geometry import Index
from ekf_reference.core.state import subtract
from ekf_reference.filters.compressed import CompressedState
from research.scale import simulate
from research.timing import timed

Array = NDArray[np.float64]

GAINS = (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
"""c1; the paper's example is 1e-4."""
STATES = (600, 1200, 2400, 4800)
SHARES = (0.0, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""Of passive states that are in set I."""
ACTIVE = 0.1
"""Share of the states that are in the area."""
LEARNT = 60
"""Rank of what an area has learnt of the rest, at most the active states that were seen."""


class Driven(NamedTuple):
    """A filter's run.

    sigma_m: (L,) of the landmarks. updates: global updates. spared: mean share of the passive block
    that they left as it was. updates_s, filter_s: processor time of these, and of the filter.
    """

    sigma_m: Array
    updates: int
    spared: float
    updates_s: float
    filter_s: float


def driven(log: Log, gain: float) -> Driven:
    """Run the compressed filter with c1, the exact one at 0."""
    update, spent = CompressedState._global_update, list[float]()

    def measured(state: CompressedState) -> None:
        spent.append(timed(update, state)[1])

    name = "compressed-suboptimal" if gain > 0.0 else "compressed"
    ekf = EkfConfig.of(filter=name, least_gain=gain if gain > 0.0 else None)
    with mock.patch.object(CompressedState, "_global_update", measured):
        (run, _), filter_s = timed(run_filter, prepare(log, RunConfig(ekf=ekf)))
    saved = run.compression
    assert saved is not None
    variance = np.trace(run.estimate.landmark_covariances(), axis1=1, axis2=2)
    return Driven(
        np.sqrt(variance), saved.global_updates, saved.global_update_spared, sum(spent), filter_s
    )


def over_gains(log: Log, gains: Sequence[float]) -> None:
    """Print a row for each c1."""
    print(f"{log.name}: {log.duration_s:.0f} s")
    print("    c1  landmarks  updates  block spared  updates s  filter s  sigmas, mean  largest")
    exact: Array | None = None
    for gain in gains:
        one = driven(log, gain)
        sigma = one.sigma_m
        exact = sigma if gain == 0.0 else exact
        ratio = sigma / exact if exact is not None and len(exact) == len(sigma) else None
        loss = "not the same" if ratio is None else f"{ratio.mean():12.4f}  {ratio.max():7.3f}"
        print(
            f"{gain:6.0e}  {len(sigma):9}  {one.updates:7}  {one.spared:12.1%}  "
            f"{one.updates_s:9.2f}  {one.filter_s:8.2f}  {loss:>12}",
            flush=True,
        )


def crossing(states: Sequence[int], repeat: int = 3) -> None:
    """Print times over that of the exact update, and from which share of set I on they are less."""
    print("time over the exact update's, by the share of passive states in set I")
    print("states  exact ms  " + "  ".join(f"{share:5.0%}" for share in SHARES) + "  crossing")
    for n in states:
        rng = np.random.default_rng(n)
        p, root = np.zeros((n, n)), 1e-6 * rng.standard_normal((n, LEARNT))
        passive = np.arange(round(ACTIVE * n), n)
        exact_s = min(timed(_exactly, p, root, passive)[1] for _ in range(repeat))
        ratios = []
        for share in SHARES:
            spared = np.sort(rng.permutation(passive)[: round(share * len(passive))])
            changed = np.setdiff1d(passive, spared)
            times = [timed(subtract, p, root, changed, spared)[1] for _ in range(repeat)]
            ratios.append(min(times) / exact_s)
        meets = _crosses(np.array(SHARES), np.array(ratios))
        row = "  ".join(f"{ratio:5.2f}" for ratio in ratios)
        print(f"{n:6}  {1e3 * exact_s:8.1f}  {row}  {meets:8.0%}", flush=True)


def _exactly(p: Array, root: Array, passive: Index) -> None:
    """As KalmanState.merge does it."""
    if len(p) > machine.WHOLE:
        subtract(p, root, passive, passive[:0])
    else:
        p -= root @ root.T


def _crosses(share: Array, ratio: Array) -> float:
    """The share from which on a ratio stays below 1, between two measured ones; NaN for none."""
    above = np.flatnonzero(ratio >= 1.0)
    if not len(above):
        return float(share[0])
    last = int(above[-1])
    if last + 1 == len(ratio):
        return float("nan")
    part = (ratio[last] - 1.0) / (ratio[last] - ratio[last + 1])
    return float(share[last] + part * (share[last + 1] - share[last]))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--data", type=Path, help="a log, as of Victoria Park's raw detections")
    parser.add_argument("--size", metavar="POSESxLANDMARKS", help="a simulated log in its place")
    parser.add_argument("--gains", nargs="+", type=float, default=GAINS, metavar="C1")
    parser.add_argument("--crossing", action="store_true")
    parser.add_argument("--states", nargs="+", type=int, default=STATES)
    choices = parser.parse_args()
    if choices.crossing:
        crossing(choices.states)
    elif choices.data is not None:
        over_gains(open_log(str(choices.data)), choices.gains)
    else:
        poses, landmarks = map(int, (choices.size or "4000x1000").split("x"))
        over_gains(simulate(poses, landmarks), choices.gains)


if __name__ == "__main__":
    main()
