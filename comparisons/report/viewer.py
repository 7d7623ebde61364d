"""A run replayed in rerun, in the log's time: in its viewer, or into a file for it."""

from __future__ import annotations

import shutil
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.scan_source import ScanSource
from comparisons.arrays import Array
from comparisons.atomic import Kind, begins, check_file, write_whole
from comparisons.errors import InputError, shorten
from comparisons.estimates.estimate import Estimate
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log, Poses
from comparisons.report.marks import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, ellipses
from graphslam.scan import planar

SUFFIX = ".rrd"
_RECORDING = Kind("a recording of rerun", begins(b"RR(F|IO)"))
_TIME = "time"
_MOST_POSES, _MOST_SCANS = 2000, 1000
_SIGMAS = 3.0


def load_rerun() -> ModuleType:
    """The package, which is optional. Raises InputError that says what to install."""
    try:
        return import_module("rerun")
    except ImportError:
        raise InputError("--live and --record need rerun: pip install slamcheck[rerun]") from None


def check_viewer(live: bool, record: Path | None) -> None:
    """Before the work: whether what is asked for can be done. Raises InputError."""
    if record is not None and record.suffix != SUFFIX:
        raise InputError(f"{record}: expected a file name that ends with {SUFFIX}")
    if record is not None:
        check_file(record, _RECORDING)
    if live or record is not None:
        load_rerun()


def show_run(comparison: Comparison) -> None:
    """Open the viewer and send it the run. Raises InputError where it cannot be opened."""
    rr = load_rerun()
    stream = rr.RecordingStream("slamcheck")
    beside = shutil.which("rerun", path=str(Path(sys.executable).parent))
    try:
        rr.spawn(recording=stream, executable_path=beside)
        _send(comparison, stream)
    except (RuntimeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"rerun's viewer cannot be opened ({shorten(reason, 200)})") from None


def record_run(comparison: Comparison, path: Path) -> None:
    """Write what the viewer would be sent; the file appears whole or not at all."""

    def write(part: Path) -> None:
        stream = load_rerun().RecordingStream("slamcheck")
        try:
            stream.save(part)
        except RuntimeError as error:  # rerun's word for what the system refuses
            reason = str(error).splitlines()[0]
            raise InputError(f"{path}: cannot be written ({shorten(reason, 200)})") from None
        _send(comparison, stream)

    write_whole(path, write, _RECORDING)


def _send(comparison: Comparison, stream: Any) -> None:
    """Trajectories and pose ellipses, the final landmarks since each was first seen, scans."""
    rr, c = load_rerun(), comparison
    stream.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if c.log.truth.poses is not None:
        _path(stream, "map/truth", "#9a9a9a", c.log.truth.poses.pose[:, :2])
    for name, colour, estimate in (
        ("smoother", SMOOTHER_COLOUR, c.smoothed),
        ("ekf", EKF_COLOUR, c.ekf.estimate),
    ):
        _path(stream, f"map/{name}/trajectory", colour, estimate.pose[:, :2])
        _poses(stream, f"map/{name}", colour, estimate)
        _landmarks(stream, f"map/{name}", colour, estimate, comparison)
    if c.log.scans is not None or c.log.clouds is not None:
        _scans(stream, c.log, c.ekf.estimate)
    stream.flush()
    stream.disconnect()


def _poses(stream: Any, name: str, colour: str, estimate: Estimate) -> None:
    rr = load_rerun()
    row = _thinned(len(estimate.time_s), _MOST_POSES)
    pose, spread = estimate.pose[row], estimate.pose_covariance[row, :2, :2]
    outline = ellipses(pose[:, :2], spread, _SIGMAS, 32)
    for i, k in enumerate(row.tolist()):
        if np.isfinite(pose[i]).all():
            stream.set_time(_TIME, duration=float(estimate.time_s[k] - estimate.time_s[0]))
            place = rr.Points3D(_flat(pose[i : i + 1, :2]), colors=_rgb(colour), radii=_ui(5.0))
            stream.log(f"{name}/pose", place)
            ring = rr.LineStrips3D([_flat(outline[i])], colors=_rgb(colour), radii=_ui(1.0))
            stream.log(f"{name}/pose_3_sigma", ring)


def _landmarks(
    stream: Any, name: str, colour: str, estimate: Estimate, comparison: Comparison
) -> None:
    rr, landmark_index = load_rerun(), comparison.ekf.landmark_index
    outline = ellipses(estimate.landmark, estimate.landmark_covariances(), _SIGMAS, 32)
    used = np.flatnonzero(landmark_index >= 0)
    seen, first = np.unique(landmark_index[used], return_index=True)
    epoch = comparison.ekf.timeline.measurement_epoch[used[first]]
    for k in np.unique(epoch).tolist():
        known = seen[epoch <= k]
        known = known[np.isfinite(estimate.landmark[known]).all(axis=1)]
        stream.set_time(_TIME, duration=float(estimate.time_s[k] - estimate.time_s[0]))
        dots = rr.Points3D(_flat(estimate.landmark[known]), colors=_rgb(colour), radii=_ui(3.0))
        stream.log(f"{name}/landmarks", dots)
        rings = [_flat(one) for one in outline[known]]
        stream.log(
            f"{name}/landmarks_3_sigma",
            rr.LineStrips3D(rings, colors=_rgb(colour), radii=_ui(0.8)),
        )


def _scans(stream: Any, log: Log, estimate: Estimate) -> None:
    """Each scan where the filter stood."""
    rr, source = load_rerun(), ScanSource(log)
    inside = np.flatnonzero(
        (source.time_s >= estimate.time_s[0]) & (source.time_s <= estimate.time_s[-1])
    )
    row = inside[_thinned(len(inside), _MOST_SCANS)]
    stood = Poses(estimate.time_s, estimate.pose).at(source.time_s[row])
    for k, pose in zip(row.tolist(), stood, strict=True):
        points = source.points(k)
        placed = planar.moved(pose, points)
        stream.set_time(_TIME, duration=float(source.time_s[k] - estimate.time_s[0]))
        stream.log("map/scan", rr.Points3D(placed, colors=_rgb(SCANS_COLOUR), radii=_ui(1.5)))


def _path(stream: Any, name: str, colour: str, point: Array) -> None:
    rr = load_rerun()
    line = rr.LineStrips3D(
        [_flat(point[np.isfinite(point).all(axis=1)])], colors=_rgb(colour), radii=_ui(0.8)
    )
    stream.log(name, line, static=True)


def _thinned(count: int, most: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))


def _flat(point: Array) -> Array:
    """(N, 3) of points (N, 2) in the plane."""
    return np.column_stack((point, np.zeros(len(point))))


def _rgb(colour: str) -> list[int]:
    return [int(colour[i : i + 2], 16) for i in (1, 3, 5)]


def _ui(points: float) -> Any:
    """A radius on the screen."""
    return load_rerun().Radius.ui_points(points)
