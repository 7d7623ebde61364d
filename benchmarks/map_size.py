"""Cost of one scan against the size of the map: full EKF, compressed EKF.

    python benchmarks/map_size.py [--sizes 70 200 500 1000 2000] [--scans 60] [--plot FILE]

A vehicle drives a few metres among 8 visible landmarks of a map of N; each scan is 8 predictions,
association by nearest neighbour, and a stacked update. The compressed filter's global update is
timed apart, since it happens on leaving an area only. Processor time of one thread; compare within
one call.
"""

from __future__ import annotations

import argparse
import os

from ekf_reference.core.landmark_types import NewLandmarks

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import SHARE
from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core.ekf import Ekf, Stabilisation
from ekf_reference.filters.compressed import CompressedEkf, CompressedState, LocalAreas
from ekf_reference.models.motion import UnicycleModel

Array = NDArray[np.float64]

SPACING_M = 12.0
RANGE_M = 20.0
PREDICTIONS = 8


def world(count: int) -> Array:
    """A square grid of landmarks, the vehicle's place in the middle of a cell near its centre."""
    side = int(np.ceil(np.sqrt(count)))
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)[:count]
    places: Array = SPACING_M * (grid - side // 2 + 0.5).astype(np.float64)
    return places


def build(kind: str, landmarks: Array) -> Ekf:
    """A filter whose map is known to 0.3 m and correlated through the vehicle."""
    common = (
        UnicycleModel(),
        NearestNeighbour(),
        np.zeros(3),
        np.diag((0.01, 0.01, 1e-4)),
        Stabilisation(1e-6, 1e-8),
    )
    gain, share = (1e-4, 1.0) if kind == "suboptimal" else (0.0, SHARE)
    areas = LocalAreas(25.0, RANGE_M + 10.0, gain, share)
    ekf = Ekf(*common) if kind == "full" else CompressedEkf(*common, areas=areas)
    m = len(landmarks)
    through = np.zeros((m, 2, 3))
    through[:, 0, 0] = through[:, 1, 1] = 1.0
    through[:, 0, 2], through[:, 1, 2] = -landmarks[:, 1], landmarks[:, 0]
    noise = np.tile(0.09 * np.eye(2), (m, 1, 1))
    ekf.state.augment(NewLandmarks(landmarks, through, np.tile(np.eye(2), (m, 1, 1))), noise)
    if isinstance(ekf.state, CompressedState):
        _ = ekf.state.mean  # a global update, so that the far landmarks become passive
        ekf.state.local_map(RANGE_M + 10.0)
        ekf.state.leave()
    return ekf


def measure(kind: str, count: int, scans: int) -> tuple[float, float]:
    """Milliseconds per scan (median), and of one global update."""
    landmarks = world(count)
    ekf = build(kind, landmarks)
    rng = np.random.default_rng(0)
    near = landmarks[np.argsort(np.linalg.norm(landmarks, axis=1))[:8]]
    sigma, labels = np.tile((0.15, 0.02), (8, 1)), np.full(8, -1)
    pose, spent = np.zeros(3), []
    for _ in range(scans):
        start = time.process_time()
        for _ in range(PREDICTIONS):
            ekf.predict(np.array((0.5, 0.0)), np.diag((0.01, 0.001)), 0.025)
        middle = time.process_time()
        pose = pose + (0.1, 0.0, 0.0)
        offset = near - pose[:2]
        z = np.column_stack((np.hypot(*offset.T), np.arctan2(offset[:, 1], offset[:, 0])))
        z += rng.standard_normal((8, 2)) * sigma * 0.3
        begin = time.process_time()
        landmark_indices = ekf.observe(z, sigma, labels)
        spent.append(middle - start + time.process_time() - begin)
        if (landmark_indices < 0).any() or (landmark_indices >= count).any():
            raise SystemExit(f"{kind}, {count}: a measurement was not recognised")
    start = time.process_time()
    _ = ekf.state.mean
    return 1e3 * float(np.median(spent)), 1e3 * (time.process_time() - start)


def main() -> None:
    """Measure, print a table, draw it if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--sizes", type=int, nargs="+", default=[70, 200, 500, 1000, 2000])
    parser.add_argument("--scans", type=int, default=60)
    parser.add_argument("--plot", type=Path)
    choices = parser.parse_args()
    print("           full       compressed           global update   suboptimal one")
    print("landmarks  ms a scan  ms a scan    ratio   ms              ms")
    rows = []
    for count in choices.sizes:
        full, _ = measure("full", count, choices.scans)
        compressed, update = measure("compressed", count, choices.scans)
        _, spared = measure("suboptimal", count, choices.scans)
        rows.append((count, full, compressed, update))
        ratio = full / compressed
        print(
            f"{count:9d}  {full:9.3f}  {compressed:9.3f}  {ratio:7.1f}   {update:6.1f}   "
            f"{spared:15.1f}"
        )
    if choices.plot:
        draw(np.array(rows), choices.plot)


def draw(rows: Array, path: Path) -> None:
    """Both costs over the size, on logarithmic axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.add_subplot()
    for column, label, style in (
        (1, "full EKF, a scan", "o-"),
        (2, "compressed EKF, a scan", "s-"),
        (3, "compressed EKF, a global update", "^:"),
    ):
        axis.loglog(rows[:, 0], rows[:, column], style, label=label)
    axis.set_xlabel("landmarks in the map")
    axis.set_ylabel("milliseconds")
    axis.grid(visible=True, which="both", color="#eeeeee")
    axis.legend()
    figure.savefig(path, dpi=130, metadata={"Software": None})


if __name__ == "__main__":
    main()
