"""Scan-SLAM over a log: its scans, one by one, as measurements of scan landmarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from comparisons.adapters.beam_noise import sensor_of
from comparisons.adapters.planar_scans import PlanarScans, view_to
from comparisons.adapters.pose_landmark_measurements import PoseLandmarkRecorder
from comparisons.arrays import Array, Index, Mask
from comparisons.errors import InputError
from comparisons.extensions.scan_landmarks.config import ScanLandmarksConfig
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.stamps import resolved
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import POINT, POSE
from ekf_reference.core.measurements import DynamicGuard
from ekf_reference.core.state import FilterDivergedError, LocalMap
from ekf_reference.dense.scan import Scan
from ekf_reference.scan_landmarks.merging import DuplicateMerging, FusingOptions
from ekf_reference.scan_landmarks.scan_slam import ScanLandmarks, ScanSlam, ScanSlamOptions
from ekf_reference.scan_landmarks.template_extraction import (
    JoinedSegments,
    SingleSegments,
    TemplateExtraction,
)
from ekf_reference.scan_matching.scan_shape import of_scan
from ekf_reference.scan_matching.sog import SumOfGaussians

LANDMARKS = {"scans": (POSE,), "both": (POINT, POSE)}
"""Kinds of landmarks that regions of a dense map are anchored to."""
EXTRACTION: Mapping[str, TemplateExtraction] = {
    "whole-scan": JoinedSegments(),
    "per-segment": SingleSegments(),
}
"""Which returns of a scan become one landmark."""
_MARGIN_M = 0.01
"""The farthest return is in view."""


@dataclass(frozen=True)
class _Telling:
    """The recorder, at one epoch."""

    recorder: PoseLandmarkRecorder
    ekf: Ekf
    epoch: int

    def observe(self, z: Array, covariance: Array, landmark_index: Index) -> Index:
        """See PoseLandmarkRecorder.observe."""
        return self.recorder.observe(self.ekf, self.epoch, z, covariance, landmark_index)

    def fuse(self, first: int, second: int, z: Array, covariance: Array) -> LocalMap:
        """See PoseLandmarkRecorder.fuse."""
        return self.recorder.fuse(self.ekf, self.epoch, first, second, z, covariance)


def scan_slam_options(config: ScanLandmarksConfig, *, mapped: bool) -> ScanSlamOptions:
    """Return what is asked for. mapped: a dense map is anchored to the landmarks."""
    # A map's regions need landmarks that stand among objects.
    usual = EXTRACTION[config.template_extraction or ("per-segment" if mapped else "whole-scan")]
    trial = replace(
        usual.segmentation,
        residual=config.residual,
        open_directions=config.open_directions,
        trials=config.trials,
    )
    asked = replace(
        usual,
        segmentation=trial,
        every=config.every or usual.every,
        share=config.in_view or usual.share,
    ).asking_for(config.least_returns or usual.least_returns)
    if isinstance(asked, SingleSegments):
        asked = replace(asked, tried=config.tried)
    return ScanSlamOptions(
        extraction=asked,
        aligned=config.aligned,
        gate=config.gate,
        shared_noise=config.shared_noise,
        belief=replace(ScanSlamOptions.belief, form=config.alignment_covariance),
    )


class LogScans:
    """The planar scans of a log as sums of Gaussians, made when they are asked for.

    time_s: (N,), as epochs have them. sensor: what made them. mount: (3,) of the scanner in the
    vehicle's frame. view: what it sees.
    """

    def __init__(self, log: Log) -> None:
        """Raises InputError for a log without planar scans, or with none at the time of a pose."""
        if log.scans is None or not len(log.scans.time_s):
            raise InputError(
                f"{log.name}: has no planar scans, which scan landmarks need; "
                "use --landmarks points"
            )
        self._planar = PlanarScans(log)
        time_s, self._number = self._planar.time_s, np.arange(len(self._planar.time_s))
        if isinstance(log.odometry, RelativePoses):
            self._number = np.flatnonzero(np.isin(time_s, log.odometry.time_s))
            if not len(self._number):
                raise InputError(f"{log.name}: no scan was taken at the time of a relative pose")
        else:
            time_s = resolved(time_s)
        self.time_s = time_s[self._number]
        self.sensor, self.mount = sensor_of(log.scans), log.scans.mount.pose
        seen = (self.scan(k, np.zeros(3)) for k in range(len(self)))
        farthest = max(float(scan.range_m.max(initial=0.0)) for scan in seen)
        self.view = view_to(log.scans, farthest + _MARGIN_M)
        self._rims = np.array((self.view.first_rad, self.view.last_rad))

    def __len__(self) -> int:
        """N."""
        return len(self.time_s)

    def shape(self, number: int) -> SumOfGaussians:
        """Scan `number` in the scanner's frame."""
        return self.shape_of(self.scan(number, np.zeros(3)))

    def shape_of(self, scan: Scan, left_out: Mask | None = None) -> SumOfGaussians:
        """A scan in the scanner's frame. left_out: (R,) returns to take for none."""
        way = scan.range_m if left_out is None else np.where(left_out, np.nan, scan.range_m)
        # Beams without a return at the rims tell where the view ends.
        bearing = np.append(scan.bearing_rad, self._rims)
        return of_scan(bearing, np.append(way, (np.nan, np.nan)), self.sensor)

    def scan(self, number: int, vehicle: Array) -> Scan:
        """Scan `number`, seen with the vehicle at a pose (3,)."""
        return self._planar.scan(int(self._number[number]), vehicle)


@dataclass(frozen=True)
class Closing:
    """The scan whose fusion moved the scan landmarks the most, as a rule a loop's closing.

    shift_m: root mean square over the landmarks. landmark_index: (Q,) those that were there and
    still are. before, after: (Q, 3).
    """

    time_s: float
    shift_m: float
    landmark_index: Index
    before: Array
    after: Array


class ScanSlamSource:
    """An PoseLandmarkSource: scans of a log at their times. See ScanSlam and DuplicateMerging."""

    def __init__(
        self,
        scans: LogScans,
        options: ScanSlamOptions | None = None,
        fusing: FusingOptions | None = None,
    ) -> None:
        """Start without landmarks. fusing: of landmarks that are one; None to leave them two."""
        self._scans, self._next = scans, 0
        self._slam = ScanSlam(scans.sensor, scans.view, scans.mount, options)
        self._duplicates = None if fusing is None else DuplicateMerging(self._slam, fusing)
        self._guard: DynamicGuard | None = None
        self.closing: Closing | None = None

    @property
    def found(self) -> ScanLandmarks:
        """Templates, and what became of their measurements."""
        return self._slam.found

    @property
    def options(self) -> ScanSlamOptions:
        """Of templates and their observation."""
        return self._slam.options

    @property
    def merged(self) -> int:
        """Landmarks that were found to be others."""
        return 0 if self._duplicates is None else self._duplicates.merged

    def keep_from(self, guard: DynamicGuard) -> None:
        """Returns and landmarks that lie where something moves are left out, and counted."""
        self._guard = self._slam.guard = guard

    def _scan(self, ekf: Ekf) -> SumOfGaussians:
        """This epoch's, without what moves."""
        if self._guard is None:
            return self._scans.shape(self._next)
        scan = self._scans.scan(self._next, ekf.read_pose().pose)
        moves = self._guard.is_dynamic(scan.point)
        self.found.dynamic += int(np.count_nonzero(moves))
        return self._scans.shape_of(scan, moves)

    def look(self, ekf: Ekf, epoch: int, time_s: float, recorder: PoseLandmarkRecorder) -> None:
        """The scan of this epoch, if there is one. Raises FilterDivergedError."""
        times = self._scans.time_s
        while self._next < len(times) and times[self._next] < time_s:
            self._next += 1
        if self._next < len(times) and times[self._next] == time_s:
            if not np.isfinite(ekf.state.pose_covariance).all():
                raise FilterDivergedError("the pose's covariance is not finite")
            before = ekf.state.places(POSE).copy()
            telling = _Telling(recorder, ekf, epoch)
            self._slam.step(ekf, self._scan(ekf), telling)
            if self._duplicates is not None:
                self._duplicates.step(ekf, telling)
            self._note(time_s, before, ekf.state.places(POSE)[: len(before)].copy())
            self._next += 1

    def _note(self, time_s: float, before: Array, after: Array) -> None:
        there = np.flatnonzero(np.isfinite(after[:, 0]))
        before, after = before[there], after[there]
        squared = np.square(after[:, :2] - before[:, :2]).sum(axis=1)
        known = self.closing
        if known is None or squared.sum() > known.shift_m**2 * len(known.before):
            shift = float(np.sqrt(squared.mean())) if len(squared) else 0.0
            self.closing = Closing(time_s, shift, there, before, after)
