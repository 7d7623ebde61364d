"""MRPT's `kf-slam` in the plane, a C++ program, and our filters on its own demonstration log.

The log names the landmark of each measurement, and `kf-slam` goes by these names. Where they are
taken out it associates by nearest neighbour in Mahalanobis distance within 99 %; ours does the same
within 99.9 %. Both have the log's sigmas of the measurements and the covariances of its motions.

A time per step of `kf-slam` is the processor time of a run less that of a run on the log's first
frame alone: its start is not counted, its reading of the log is. Ours is the time in the process
from the log's first byte to the filter's last step. Of both, each repetition is the median of
three runs.
"""

from __future__ import annotations

import gzip
import json
import re
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.filter_loop import run_filter_loop
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.checks.accuracy import aligned
from comparisons.config import EkfConfig
from comparisons.logs.readers import rawlog
from comparisons.logs.readers import rawlog_stream as stream
from ekf_reference.core.trace import Trace
from research.timing import MissingError, Ran, Side, Spent, TimedPair, median, run, scratch

LOG = Path("/usr/share/mrpt/datasets/kf-slam_demo.rawlog")
INI = Path("/usr/share/mrpt/config_files/kf-slam/EKF-SLAM_test_2d.ini")
WITHIN = 3
"""Runs within a repetition, of which the median counts: a start takes longer than all steps."""
INSTALL = "not installed: sudo apt-get install mrpt-apps mrpt-common"
POSE = re.compile(r"Mean pose: \(([-\d.]+),([-\d.]+),([-\d.]+)deg\)")
COUNT = re.compile(r"# of landmarks in the map: (\d+)")


def rows(*, quick: bool) -> list[TimedPair]:
    """Return the pairs, the same for `quick`. Raises MissingError."""
    del quick
    if shutil.which("kf-slam") is None or not (LOG.is_file() and INI.is_file()):
        raise MissingError(f"MRPT {INSTALL}")
    work = scratch()
    unnamed, first = _write_variants(work)
    steps = len(rawlog.read(LOG).odometry.time_s)
    pairs = [
        TimedPair(
            name=f"kf-slam, {labels}: {kind} EKF",
            work=f"{steps} steps, 70 landmarks, {labels}",
            ours=_ours_per_step(log, kind),
            theirs=_theirs_per_step(work, log, first),
            goal=0.5,
            parts=(steps, "step"),
            notes=_Accuracy(work, log, kind),
        )
        for labels, log in (("labels", LOG), ("no labels", unnamed))
        for kind in ("full", "compressed")
    ]
    whole = pairs[0]
    alone = replace(
        whole,
        name="kf-slam, whole program: our EKF alone",
        work="the same with the start: reads the log, filters, ends",
        ours=lambda: run(_words(LOG, "full")).spent,
        theirs=lambda: _kf_slam(work, LOG).spent,
        goal=None,
        parts=(1, "all"),
        notes=tuple,
    )
    judged = replace(
        alone,
        name="kf-slam, whole program: slamcheck run",
        work="the same; ours also smooths, checks and reports",
        ours=lambda: _slamcheck(work),
    )
    return [*pairs, alone, judged]


def _write_variants(folder: Path) -> tuple[Path, Path]:
    """Write the log without the landmarks' names, and its first step alone."""
    data = bytearray(gzip.decompress(LOG.read_bytes()))
    items = list(stream.records(LOG))
    for frame in (item for item in items if isinstance(item, stream.RawlogFrame)):
        for seen in (o for o in frame.observations if isinstance(o, stream.RawlogRangeBearing)):
            at = data.index(seen.polar[0].astype("<f4").tobytes(), seen.at)
            for row in range(len(seen.polar)):
                behind = at + 16 * row + 12
                assert int.from_bytes(data[behind : behind + 4], "little") == seen.landmark[row]
                data[behind : behind + 4] = b"\xff\xff\xff\xff"  # -1: none
    frames = [item for item in items if isinstance(item, stream.RawlogFrame)]
    third = bytes(data).rindex(b"\x88", 0, items[3].at) + 1
    assert frames[1].at < third
    unnamed, first = folder / "unnamed.rawlog", folder / "first.rawlog"
    unnamed.write_bytes(gzip.compress(bytes(data)))
    first.write_bytes(gzip.compress(bytes(data[:third])))
    return unnamed, first


def _kf_slam(folder: Path, log: Path) -> Ran:
    """One run without window, with the log's own sigmas of the measurements."""
    chosen = {
        "SHOW_3D_LIVE": "false",
        "SAVE_LOG_FREQUENCY": "1000000",
        "logOutput_dir": str(folder / "LOG"),
        "std_sensor_range": "0.01",
        "std_sensor_yaw_deg": "0.1",
    }
    text = INI.read_text()
    for key, value in chosen.items():
        text, count = re.subn(rf"(?m)^{key}\s*=.*$", f"{key} = {value}", text)
        assert count == 1, key
    ini = folder / "kf-slam.ini"
    ini.write_text(text)
    return run(("kf-slam", ini, log))


def _theirs_per_step(folder: Path, log: Path, first: Path) -> Side:
    def side() -> Spent:
        spent = [
            (_kf_slam(folder, log).spent, _kf_slam(folder, first).spent) for _ in range(WITHIN)
        ]
        return median([whole for whole, _ in spent]) - median([start for _, start in spent])

    return side


def _words(log: Path, kind: str) -> tuple[str, ...]:
    return sys.executable, "-m", "research.peers.mrpt", str(log), kind


def _ours_per_step(log: Path, kind: str) -> Side:
    def once() -> Spent:
        return Spent(*json.loads(run(_words(log, kind)).printed))

    def side() -> Spent:
        return median([once() for _ in range(WITHIN)])

    return side


def _slamcheck(folder: Path) -> Spent:
    code = "from slamcheck.__main__ import main; main()"
    out = ("--out", folder / "run")
    return run((sys.executable, "-c", code, "run", LOG, *out), fine=(0, 1, 3)).spent


def filtered(log: Path, kind: str) -> tuple[Array, Array]:
    """Read the log and filter it: poses (K, 3), landmarks (L, 2)."""
    read = rawlog.read(log)
    config = settle(EkfConfig.model_validate({"filter": kind}), read)
    ekf = build_ekf(read, config, Trace())
    epochs = run_filter_loop(ekf, read, build_timeline(read))
    poses = np.array([ekf.read_pose().pose for _ in epochs])
    return poses, ekf.state.landmarks


class _Accuracy:
    """Errors of both against the log's truth, RMS after the best rigid motion."""

    def __init__(self, folder: Path, log: Path, kind: str) -> None:
        self.folder, self.log, self.kind = folder, log, kind

    def __call__(self) -> Sequence[str]:
        """Filter once more, untimed."""
        printed = _kf_slam(self.folder, self.log).printed
        printed_pose = np.array(POSE.findall(printed), dtype=float)
        poses, landmarks = filtered(self.log, self.kind)
        truth = rawlog.read(LOG).truth
        assert truth.poses is not None
        assert truth.landmarks is not None
        true, place = truth.poses.pose[-len(printed_pose) :, :2], truth.landmarks.position_m
        own, other = (
            _rms(aligned(one[-len(printed_pose) :, :2], true), true)
            for one in (poses, printed_pose)
        )
        nearest = place[np.linalg.norm(landmarks[:, None] - place, axis=2).argmin(axis=1)]
        apart = _rms(aligned(landmarks, nearest), nearest)
        return (
            f"ours: position {1e3 * own:.1f} mm, {len(landmarks)} landmarks {1e3 * apart:.1f} mm; "
            f"kf-slam: position {1e3 * other:.1f} mm (as printed, to 1 mm), "
            f"{COUNT.findall(printed)[-1]} landmarks, whose positions it does not write as text",
        )


def _rms(points: Array, reference: Array) -> float:
    return float(np.sqrt(((points - reference) ** 2).sum(axis=1).mean()))


def main() -> None:
    """Filter the log of the first argument by the filter of the second, print what that took."""
    cpu, wall = time.process_time(), time.perf_counter()
    filtered(Path(sys.argv[1]), sys.argv[2])
    print(json.dumps((time.process_time() - cpu, time.perf_counter() - wall)))


if __name__ == "__main__":
    main()
