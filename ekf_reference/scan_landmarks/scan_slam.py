"""Scan-SLAM: landmarks of an EKF are templates, parts of scans (Nieto 2005, section 5.2).

A landmark is the axis at which its template fits the true surface best. So the error of the first
measurement, at the template's own pose, comes from the template's noise alone; its R is that of
aligning the segment with a noisy copy of itself. Errors of later measurements come from the noise
of their own scans, and from the template's as far as its view changes. What measurements share
through one scan or one template is not in the state: R counts it (see shared_noise), and one
alignment alone is better than its R by chi-square.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np

from ekf_reference.core.ekf import NEW, Ekf
from ekf_reference.core.geometry import Array, Index, rotation, wrap_angle
from ekf_reference.core.landmark_types import POSE
from ekf_reference.core.measurements import DynamicGuard
from ekf_reference.dense.scan import ScanSensor
from ekf_reference.scan_landmarks.segmentation import quality
from ekf_reference.scan_landmarks.template_extraction import (
    JoinedSegments,
    LandmarkInView,
    TemplateExtraction,
)
from ekf_reference.scan_landmarks.templates import (
    BLANK,
    OUT_OF_VIEW,
    ObservationOptions,
    SensorView,
    Template,
    TemplateMatching,
    observe,
    share_in_view,
)
from ekf_reference.scan_matching.alignment_covariance import CovarianceOptions, ScanAlignment
from ekf_reference.scan_matching.problem import AlignmentOptions
from ekf_reference.scan_matching.sog import SumOfGaussians

USED = "used"
GATED = "gated"
LEFT_OUT = "left out"
"""In view, but the scan's alignments were spent on others."""
MOVES = "where something moves"
GATE = 11.345
"""Chi-square, 99 % of three degrees of freedom."""

_EXTRACTION, _OBSERVATION, _ALIGNMENT = JoinedSegments(), ObservationOptions(), AlignmentOptions()
_BELIEF = CovarianceOptions(neighbourhood_m=1.0, beyond_chance=3.0)


class MeasurementSink(Protocol):
    """Receives measurements of pose landmarks for a filter."""

    def observe(self, z: Array, covariance: Array, landmark_index: Index) -> Index:
        """See Ekf.observe_known."""


@dataclass(frozen=True, kw_only=True)
class ScanSlamOptions:
    """Settings of Scan-SLAM.

    aligned: most templates that one scan is aligned with, 0 for all in view. extraction: which
    returns become templates. floor_m, floor_rad: least sigma of the prior of an alignment.
    shared_noise: returns that several alignments share are counted once (see shared_noise).
    """

    aligned: int = 5
    extraction: TemplateExtraction = _EXTRACTION
    floor_m: float = 0.1
    floor_rad: float = 0.02
    gate: float = GATE
    shared_noise: bool = True
    observation: ObservationOptions = _OBSERVATION
    alignment: AlignmentOptions = _ALIGNMENT
    belief: CovarianceOptions = _BELIEF


class Predicted(NamedTuple):
    """Predicted measurements z^ (m, 3) of landmarks, in the scanner's frame, with H P H^T."""

    landmark_index: Index
    z: Array
    covariance: Array


@dataclass(kw_only=True)
class ScanLandmarks:
    """Templates and counts of a run.

    template: by landmark index. measurements: measurements used, by landmark index. initialised:
    every template as it was initialised from one scan. reasons: how often a landmark near the
    scanner was USED, or why it was not. rejected: candidate templates that failed their trial.
    scans: processed so far. dynamic: returns left out because something moves there. moving:
    landmark indices that are deactivated because their template lies where something moves.
    """

    template: dict[int, Template] = field(default_factory=dict)
    initialised: dict[int, Template] = field(default_factory=dict)
    measurements: Counter[int] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    rejected: int = 0
    scans: int = 0
    dynamic: int = 0
    moving: set[int] = field(default_factory=set)


class _Seen(NamedTuple):
    """A measurement before the gate: z^ and z (3,), R and S (3, 3)."""

    landmark_index: int
    predicted: Array
    z: Array
    noise: Array
    covariance: Array
    alignment: ScanAlignment

    @property
    def normalised_squared(self) -> float:
        """The normalised innovation squared (Nieto 2005, eq. 2.58)."""
        innovation = self.z - self.predicted
        return float(innovation @ np.linalg.solve(self.covariance, innovation))


PERSISTENCE = 4.0
"""The mean error of a template's first alignments less that of its last has 4.3 times the variance
that independent ones would have (845 templates of Table 5.1's drives, seeds 0 to 9): 2.6 over a
third of a template's life, more over all of it, where distances have an NEES of 1.7 with 2.6."""


def with_persistence(alignment: ScanAlignment) -> Array:
    """Return R (3, 3) of an alignment as one of many of the same template."""
    return alignment.covariance * (1.0 + (PERSISTENCE - 1.0) * alignment.first_share)


def with_shared_returns(alignments: Sequence[ScanAlignment], noise: Array) -> Array:
    """Return R (m, 3, 3) of alignments of one scan with m templates, each return counted once.

    noise: (m, 3, 3) of each for itself. The sum of squares over a return's alignments is bounded.
    """
    by_return = np.stack([one.by_second for one in alignments])
    others = by_return.any(axis=1).sum(axis=0) - 1
    more: Array = (by_return * np.maximum(others, 0)) @ by_return.transpose(0, 2, 1)
    return noise + more


class ScanSlam:
    """Measures templates in scans and initialises new ones; the filter is the caller's."""

    def __init__(
        self,
        sensor: ScanSensor,
        view: SensorView,
        mount: Array,
        options: ScanSlamOptions | None = None,
    ) -> None:
        """mount: (3,) of the scanner in the vehicle's frame."""
        self.sensor = sensor
        self.mount = np.asarray(mount, dtype=float)
        self.options = options or ScanSlamOptions()
        self.view = replace(view, share=self.options.extraction.share)
        self._matching = TemplateMatching(
            self.view,
            replace(self.options.observation, visible=self.options.extraction.visible),
            self.options.alignment,
            self.options.belief,
        )
        self.found = ScanLandmarks()
        self.guard: DynamicGuard | None = None
        self._last_seen: dict[int, int] = {}
        self._last_tried: Counter[int] = Counter()
        self._initialised = 0

    def step(self, ekf: Ekf, scan: SumOfGaussians, sink: MeasurementSink) -> None:
        """Process a scan, in the scanner's frame: predict, align, gate, update, augment."""
        self.found.scans += 1
        predicted = self._predict(ekf)
        self._deactivate(ekf, predicted.landmark_index)
        used = self._update(ekf, predicted, scan, sink)
        if self.options.extraction.due(self.found.scans, self._initialised, used):
            self._augment(ekf, scan, sink)

    def _deactivate(self, ekf: Ekf, near: Index) -> None:
        """Give up the landmarks whose template lies where things move (Nieto 2005, section 6.5)."""
        if self.guard is None:
            return
        place = ekf.state.places(POSE)
        for landmark_index in set(near.tolist()) - self.found.moving:
            if self.found.template[landmark_index].moves(place[landmark_index], self.guard):
                self.found.moving.add(landmark_index)

    def _predict(self, ekf: Ekf) -> Predicted:
        """Z^ and H P H^T of all landmarks that may be within reach (Nieto 2005, eq. 5.15)."""
        reach_m = self.view.reach_m + float(np.hypot(*self.mount[:2]))
        near, out = ekf.state.within(reach_m, POSE), self._out()
        frame, spread = predicted_frames(ekf, near)
        z = frame - self.mount
        z[:, :2] = z[:, :2] @ out[:2, :2]
        return Predicted(near, z, out.T @ spread @ out)

    def _update(
        self, ekf: Ekf, predicted: Predicted, scan: SumOfGaussians, sink: MeasurementSink
    ) -> int:
        """Fuse [z, R] = scan_align(G_L, G_o, z^) of those in view and gate; returns how many."""
        seen: list[_Seen] = []
        for row in self._in_view(predicted, scan):
            one = self._observe(predicted, row, scan)
            if one is None:
                continue
            within = one.normalised_squared <= self.options.gate
            self.found.reasons[USED if within else GATED] += 1
            if within:
                seen.append(one)
        if seen:
            noise = np.array([one.noise for one in seen])
            if self.options.shared_noise:
                noise = with_shared_returns([one.alignment for one in seen], noise)
            self._reported(
                sink, [(one.landmark_index, one.z, r) for one, r in zip(seen, noise, strict=True)]
            )
        return len(seen)

    def _observe(self, predicted: Predicted, row: int, scan: SumOfGaussians) -> _Seen | None:
        """Align a template with the scan; None, and the reason counted, where it is not seen."""
        o, landmark_index = self.options, int(predicted.landmark_index[row])
        z, spread = predicted.z[row], predicted.covariance[row]
        wide = spread + np.diag((o.floor_m, o.floor_m, o.floor_rad)) ** 2
        template = self.found.template[landmark_index]
        what = observe(template, scan, z, wide, self._matching)
        found = what.alignment
        if not what.usable or found is None:
            self.found.reasons[what.reason] += 1
            return None
        r = with_persistence(found) if o.shared_noise else found.covariance
        innovation = found.pose - z
        innovation[2] = wrap_angle(innovation[2])
        return _Seen(landmark_index, z, z + innovation, r, spread + r, found)

    def _in_view(self, predicted: Predicted, scan: SumOfGaussians) -> list[int]:
        """Rows of the predicted that are to be aligned.

        Of more than may be, most are the last observed, which keep the pose however wrong the
        odometry is; the others are those whose last trial is the longest ago, which close loops.
        """
        o, rows = self.options, []
        for row, landmark_index in enumerate(predicted.landmark_index.tolist()):
            if landmark_index in self.found.moving:
                self.found.reasons[MOVES] += 1
            elif self._share(landmark_index, predicted.z[row], scan) >= self.view.share:
                rows.append(row)
            else:
                self.found.reasons[OUT_OF_VIEW if len(scan) else BLANK] += 1
        most = o.aligned or len(rows)
        self.found.reasons[LEFT_OUT] += max(len(rows) - most, 0)
        if len(rows) > most:
            index = predicted.landmark_index
            rows.sort(key=lambda row: -self._last_seen[int(index[row])])
            rest = sorted(
                rows[most - most // 2 :], key=lambda row: self._last_tried[int(index[row])]
            )
            rows = rows[: most - most // 2] + rest[: most // 2]
        for row in rows:
            self._last_tried[int(predicted.landmark_index[row])] = self.found.scans
        return rows

    def _share(self, landmark_index: int, z: Array, scan: SumOfGaussians) -> float:
        """Of a landmark's template that should be seen; of a blank scan nothing is."""
        return (
            share_in_view(self.found.template[landmark_index], scan, z, self.view)
            if len(scan)
            else 0.0
        )

    def _augment(self, ekf: Ekf, scan: SumOfGaussians, sink: MeasurementSink) -> None:
        """Initialise landmarks of those candidate templates that align with themselves."""
        o = self.options

        def known() -> list[LandmarkInView]:
            near = zip(*self._predict(ekf), strict=True)
            return [
                LandmarkInView(self.found.template[int(landmark_index)], z, spread)
                for landmark_index, z, spread in near
                if self._share(int(landmark_index), z, scan) >= self.view.share
            ]

        # Anew for each scan: one trial more or less must not change the noise of all later ones.
        rng = np.random.default_rng((0, self.found.scans))
        for rows in o.extraction.found(scan, self.view, self._out()[0, :2], known):
            segment, trial = scan.take(rows), o.extraction.segmentation
            found = quality(segment, self.sensor, rng, trial, o.alignment, o.belief)
            if not found.accepted:
                self.found.rejected += 1
                continue
            template = Template.of_segment(scan, rows)
            landmark_index = self._reported(sink, [(NEW, template.pose, found.covariance)])
            self.found.template[landmark_index] = self.found.initialised[landmark_index] = template
            self._initialised = self.found.scans

    def _reported(self, sink: MeasurementSink, seen: list[tuple[int, Array, Array]]) -> int:
        """Fuse measurements (index, z, R) in the scanner's frame; returns the last index."""
        out = self._out()
        z = np.array([at for _, at, _ in seen]) @ out.T + self.mount
        r = np.array([out @ spread @ out.T for *_, spread in seen])
        landmark_indices = sink.observe(
            z, r, np.array([landmark_index for landmark_index, *_ in seen], dtype=np.intp)
        )
        for landmark_index in landmark_indices.tolist():
            self._last_seen[landmark_index] = self.found.scans
            self.found.measurements[landmark_index] += 1
        return int(landmark_indices[-1])

    def _out(self) -> Array:
        """(3, 3) from the scanner's axes to the vehicle's."""
        out = np.eye(3)
        out[:2, :2] = rotation(float(self.mount[2]))
        return out


def predicted_frames(ekf: Ekf, landmark_index: Index) -> tuple[Array, Array]:
    """Predict the frames of landmarks (m,) in the vehicle's (Nieto 2005, eq. 5.15).

    Returns z^ (m, 3) and H P H^T (m, 3, 3) of the vehicle, the landmark, and what they share.
    """
    local = ekf.state.map_of(landmark_index, POSE)
    at = ekf.models[POSE].predict(local.pose, local.landmark)
    h = np.concatenate((at.jacobian_pose, at.jacobian_landmark), axis=2)
    p = len(local.pose)
    joint = np.empty((len(landmark_index), p + POSE.width, p + POSE.width))
    joint[:, :p, :p], joint[:, p:, p:] = local.vehicle, local.own
    joint[:, :p, p:], joint[:, p:, :p] = local.cross, local.cross.transpose(0, 2, 1)
    return at.z, h @ joint @ h.transpose(0, 2, 1)
