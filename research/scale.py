"""Time and memory of `slamcheck run` against the size of the log.

python -m research.scale [--sizes 1000x100 10000x200] [--largest 10000] [--write DIR]

Sizes of more poses than --largest are left out, also where --sizes names them. --write only writes
the logs.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from comparisons.logs.log import Log
from comparisons.logs.log_folder import write_log_folder
from comparisons.logs.simulate.drive import simulate as simulated
from comparisons.logs.simulate.worlds import LandmarkWorld
from research.fields import SPACING_M, field_drive

Array = NDArray[np.float64]

LANE_M = 40.0
"""Distance of neighbouring lanes of the loop through the field."""
BEND_M = 15.0
"""Length over which the path is smoothed at a corner."""
CLEAR_M = 3.0
"""Landmarks stand at least so far from the path."""

ROOT = Path(__file__).resolve().parents[1]
SIZES = ("1000x100", "3000x100", "10000x200", "10000x1000", "100000x2000", "1000000x100")
MARK = "scale: "


class Stage(NamedTuple):
    """What a stage took: seconds of the processor and the peak of memory."""

    name: str
    cpu_s: float
    peak_mib: float


def field(landmarks: int) -> LandmarkWorld:
    """A square field of landmarks on a disturbed grid, and a closed loop through all of it.

    The loop goes up and down in lanes, and back along the field's edge.
    """
    rng = np.random.default_rng(landmarks)
    side = math.ceil(math.sqrt(landmarks))
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    places = SPACING_M * (grid[:landmarks] + rng.uniform(0.1, 0.9, (landmarks, 2)))
    width, height = SPACING_M * side, SPACING_M * math.ceil(landmarks / side)
    lanes = 2 * max(1, round(width / LANE_M / 2.0))
    x = width * (np.arange(lanes) + 0.5) / lanes
    low, high = 0.15 * LANE_M + BEND_M, max(height - 0.5 * BEND_M, BEND_M + LANE_M)
    corners = [(x[0], 0.0)]
    for k, lane in enumerate(x):
        corners += [(lane, low), (lane, high)][:: 1 if k % 2 == 0 else -1]
    corners.append((x[-1], 0.0))
    path = _rounded(np.array(corners))
    near, point = cKDTree(path).query(places)
    aside = np.where(near[:, None] < CLEAR_M, places - path[point], 0.0)
    places += aside * (CLEAR_M / np.maximum(near, 0.01) - 1.0)[:, None]
    return LandmarkWorld(path, places)


def _rounded(corners: Array) -> Array:
    """Return a closed polygon (P, 2) as points 0.2 m apart, its corners smoothed over BEND_M."""
    closed = np.vstack((corners, corners[:1]))
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))))
    count = round(way[-1] / 0.2)
    at = way[-1] * np.arange(count) / count
    path = np.column_stack([np.interp(at, way, column) for column in closed.T])
    kernel = np.hanning(round(BEND_M / 0.2) + 2)[1:-1]
    kernel, reach = kernel / kernel.sum(), len(kernel)
    around = np.vstack((path[-reach:], path, path[:reach]))
    smooth = [np.convolve(column, kernel, mode="same")[reach:-reach] for column in around.T]
    return np.column_stack(smooth)


def simulate(poses: int, landmarks: int, seed: int = 0) -> Log:
    """A drive of so many poses (one a scan, five a second, 0.4 m apart) through a field."""
    log = simulated(np.random.default_rng(seed), field_drive(poses), field(landmarks))
    provenance = {"source": "research/scale.py"}
    return replace(log, name=f"scale-{poses}x{landmarks}", provenance=provenance)


def measure(log: Path, out: Path, options: list[str]) -> list[Stage]:
    """One run of the command in a process of its own, by stages."""
    code = f"from research.scale import run; run({[str(log), '--out', str(out), *options]!r})"
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 1, 3):
        raise SystemExit(f"slamcheck exited with {done.returncode}: {done.stderr}")
    lines = [line for line in done.stderr.splitlines() if line.startswith(MARK)]
    return [Stage(*json.loads(line.removeprefix(MARK))) for line in lines]


def run(arguments: list[str]) -> None:
    """Run the command here and print what each stage took, with all since the stage before it."""
    from comparisons.cli.app import main
    from comparisons.pipeline.clock import Clock

    began, stage = [0.0], Clock.stage

    def report(name: str) -> None:
        now = time.process_time()
        print(MARK + json.dumps((name, now - began[0], _peak_mib())), file=sys.stderr)
        began[0] = now

    @contextmanager
    def measured(clock: Clock, name: str) -> Iterator[None]:
        if not clock.seconds:
            report("read")
        with stage(clock, name):
            yield
        report(name)

    Clock.stage = measured  # type: ignore[method-assign, assignment]
    sys.argv = ["slamcheck", "run", *arguments]
    try:
        main()
    finally:
        report("report")


def _peak_mib() -> float:
    """Peak memory since this was last asked, or where the system keeps no such, of all."""
    try:
        text = Path("/proc/self/status").read_text(encoding="ascii")
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
        return float(text.split("VmHWM:")[1].split()[0]) / 1024.0
    except (OSError, IndexError):
        import resource

        in_bytes = 1 if sys.platform == "darwin" else 1024
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * in_bytes / 2**20


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--sizes", nargs="+", default=SIZES, metavar="POSESxLANDMARKS")
    parser.add_argument("--largest", type=int, default=10_000, help="poses; larger are left out")
    parser.add_argument("--write", type=Path, help="only write the logs, into this folder")
    parser.add_argument("run", nargs=argparse.REMAINDER, help="after --: options of slamcheck run")
    choices = parser.parse_args()
    options = [one for one in choices.run if one != "--"] or ["--filter", "compressed"]
    print("  poses  landmarks  stage       cpu s  peak MiB")
    for size in choices.sizes:
        poses, landmarks = map(int, size.split("x"))
        if poses > choices.largest:
            continue
        with tempfile.TemporaryDirectory() as folder:
            log = (choices.write or Path(folder)) / f"scale-{size}"
            write_log_folder(simulate(poses, landmarks), log)
            if choices.write:
                continue
            out = Path(folder) / "out"
            stages = measure(log, out, options)
            page = (out / "report.html").stat().st_size / 2**20
            result = json.loads((out / "result.json").read_text(encoding="utf-8"))
        for one in stages:
            row = f"{poses:7d}  {landmarks:9d}  {one.name:9}"
            print(f"{row}  {one.cpu_s:7.1f}  {one.peak_mib:8.0f}", flush=True)
        whole = Stage("all", sum(s.cpu_s for s in stages), max(s.peak_mib for s in stages))
        print(
            f"{poses:7d}  {landmarks:9d}  {whole.name:9}  {whole.cpu_s:7.1f}  "
            f"{whole.peak_mib:8.0f}  page {page:.1f} MiB, {result['verdict']}",
            flush=True,
        )


if __name__ == "__main__":
    main()
