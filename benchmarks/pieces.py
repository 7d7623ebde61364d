"""Small pieces that every scan passes through, by processor time.

    python benchmarks/pieces.py [--repeat 200]

The least and the median of many calls, in milliseconds of this process; other work on the machine
moves the median, hardly the least.
"""

from __future__ import annotations

import argparse
import os

from ekf_reference.core.landmark_types import NewLandmarks

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable

import numpy as np

from comparisons.logs.simulate.ray_casting import Solids, cast
from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf
from ekf_reference.dense.neglected_correlation import NeglectedCorrelation
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.view import FilterView
from ekf_reference.models.motion import UnicycleModel


def cast_a_scan() -> Callable[[], object]:
    """361 beams among 400 walls."""
    rng = np.random.default_rng(0)
    start = rng.uniform(-40, 40, (400, 2))
    segment = np.hstack((start, start + rng.uniform(-5, 5, (400, 2))))
    solids = Solids(segment, np.arange(400), np.ones(400))
    angle = np.deg2rad(np.linspace(-90.0, 90.0, 361))
    return lambda: cast(angle, np.zeros(3), solids)


def note_neglected() -> Callable[[], object]:
    """The correlations that 40 regions neglect, of one scan."""
    rng = np.random.default_rng(0)
    ekf = Ekf(UnicycleModel(), KnownAssociation(), np.zeros(3), 0.01 * np.eye(3))
    place = rng.uniform(-20, 20, (30, 2))
    through = np.zeros((30, 2, 3))
    through[:, 0, 0] = through[:, 1, 1] = 1.0
    eye, noise = np.tile(np.eye(2), (30, 1, 1)), np.tile(0.09 * np.eye(2), (30, 1, 1))
    ekf.state.augment(NewLandmarks(place, through, eye), noise)
    base = np.array([rng.choice(30, 3, replace=False) for _ in range(40)])
    point, region = place[base].mean(axis=1), np.arange(40)
    view, layer = FilterView.of(ekf), NeglectedCorrelation(LocalRegions(base=base))
    return lambda: layer.note(view, region, point)


PIECES = {
    "cast 361 beams among 400 walls": cast_a_scan,
    "note the neglected correlations of 40 regions": note_neglected,
}


def milliseconds(call: Callable[[], object], repeat: int) -> tuple[float, float]:
    """Least and median processor time of a call."""
    taken = []
    for _ in range(repeat):
        start = time.process_time()
        call()
        taken.append(1e3 * (time.process_time() - start))
    return min(taken), float(np.median(taken))


def main() -> None:
    """Print a line for each piece."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=200)
    repeat = parser.parse_args().repeat
    for name, make in PIECES.items():
        least, median = milliseconds(make(), repeat)
        print(f"{name:48} least {least:.3f} ms, median {median:.3f} ms")


if __name__ == "__main__":
    main()
