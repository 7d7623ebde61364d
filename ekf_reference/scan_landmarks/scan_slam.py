"""Scan-SLAM: the landmarks of an EKF are templates, pieces of scans (Nieto 2005, section 5.2).

Where which noise belongs. A template's returns are noisy, so the axis in them is not where it
would be in the true surface. Let a landmark be the axis at which the template fits the true
surface best. Then the first sighting, at the template's own pose, errs by the template's noise
alone: its R is that of a registration of the segment with a noisy copy of itself. Later ones err
by the noise of their scans, and by nothing of the template's, whose error is the same each time.
The alignment's covariance, which holds both, is taken: too large, as chi-square says, and with it
the pose's NEES is honest as long as no loop is missed. What several sightings share through one
template is still not in the state, so the smoother may be too sure.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ekf_reference.dense.scan import Sensor
from ekf_reference.full_ekf import NEW, FullEkf
from ekf_reference.layout import ORIENTED
from ekf_reference.scan_landmarks.alignment_covariance import CovarianceOptions
from ekf_reference.scan_landmarks.enriching import Around, observe_enriched
from ekf_reference.scan_landmarks.problem import AlignmentOptions
from ekf_reference.scan_landmarks.segmentation import SegmentationOptions, quality, segments
from ekf_reference.scan_landmarks.sog import SumOfGaussians, rotation
from ekf_reference.scan_landmarks.templates import (
    BLANK,
    OUT_OF_VIEW,
    ObservationOptions,
    Template,
    View,
    observe,
    share_in_view,
)

Array = NDArray[np.float64]
Index = NDArray[np.intp]

USED = "used"
GATED = "gated"
LEFT_OUT = "left out"
"""In view, but others were longer out of sight and the scan's alignments were spent on them."""
GATE = 11.345
"""Chi-square, 99 % of three degrees of freedom."""

_SEGMENTATION = SegmentationOptions(
    least_points=15,
    displacement_m=1.5,
    displacement_rad=np.deg2rad(20.0),
    trials=2,
    residual=0.15,
    interleaved=False,
    open_directions=2,
)
_OBSERVATION, _ALIGNMENT = ObservationOptions(), AlignmentOptions()
_BELIEF = CovarianceOptions(neighbourhood_m=1.0, beyond_chance=3.0, sharp=6.0)


class Teller(Protocol):
    """By whom a filter is told of landmarks with a direction."""

    def observe(self, z: Array, covariance: Array, slot: Index) -> Index:
        """See FullEkf.observe_oriented."""
        ...


@dataclass(frozen=True)
class ScanSlamOptions:
    """How much is done per scan, and what counts. The thesis tells none of these but the gate.

    aligned: most landmarks that one scan is laid onto. begin_every: scans between two in which new
    landmarks are sought. tried: most segments whose quality is tried then. ahead_m: a segment must
    still be in view when the vehicle has gone so far. apart_m: a new
    landmark's axis is at least so far from all others; explained_m: a return that is nearer to a
    template's point is that landmark's, and explained: a segment with such a share of these is no
    new one; the landmark's uncertainty is added to both distances. floor_m, floor_rad: least sigma
    of where an alignment is sought. enrich_m: sigma of z^ from which on what stands around a
    landmark says where its template is sought (Nieto 2005, section 6.2).
    """

    aligned: int = 5
    begin_every: int = 2
    tried: int = 2
    ahead_m: float = 3.0
    apart_m: float = 4.0
    explained_m: float = 1.0
    explained: float = 0.5
    floor_m: float = 0.1
    floor_rad: float = 0.02
    enrich_m: float = math.inf
    gate: float = GATE
    segmentation: SegmentationOptions = _SEGMENTATION
    observation: ObservationOptions = _OBSERVATION
    alignment: AlignmentOptions = _ALIGNMENT
    belief: CovarianceOptions = _BELIEF


class Predicted(NamedTuple):
    """Landmarks (m,) as they should be seen from here. z: (m, 3) z^ in the scanner's frame.

    covariance: (m, 3, 3) H P H^T of the vehicle, the landmark, and what they share.
    """

    slot: Index
    z: Array
    covariance: Array


@dataclass
class ScanLandmarks:
    """What a run has gathered. template: by slot. sightings: used, by slot.

    reasons: how often a landmark near the scanner was USED, or why not. rejected: segments
    that no landmark explained and that failed their trial. scans: looked at. enriched: alignments
    that began where what stands around the landmark fits. fused: how many landmarks were found to
    be others.
    """

    template: dict[int, Template] = field(default_factory=dict)
    sightings: Counter[int] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    rejected: int = 0
    scans: int = 0
    enriched: int = 0
    fused: int = 0


class ScanSlam:
    """Sees scan landmarks in scans and begins new ones; the filter and its map are the caller's."""

    def __init__(
        self,
        sensor: Sensor,
        view: View,
        mount: Array,
        options: ScanSlamOptions | None = None,
        seed: int = 0,
    ) -> None:
        """mount: (3,) of the scanner in the vehicle's frame. seed: of the quality's trials."""
        self.sensor = sensor
        self.view = view
        self.mount = np.asarray(mount, dtype=float)
        self.options = options or ScanSlamOptions()
        self.found = ScanLandmarks()
        self.around: Around | None = None
        self._rng = np.random.default_rng(seed)
        self._last_seen: dict[int, int] = {}

    def step(self, ekf: FullEkf, scan: SumOfGaussians, tell: Teller) -> None:
        """One scan, in the scanner's frame: predict, align, gate, update, augment."""
        self.found.scans += 1
        self._update(ekf, self._predict(ekf), scan, tell)
        if self.found.scans % self.options.begin_every == 1 or self.options.begin_every == 1:
            self._augment(self._predict(ekf), scan, tell)

    def _predict(self, ekf: FullEkf) -> Predicted:
        """Z^ and H P H^T of all landmarks that may be within reach (Nieto 2005, eq. 5.15)."""
        reading, reach_m = ekf.read_pose(), self.view.reach_m + float(np.hypot(*self.mount[:2]))
        near = ekf.state.within(reach_m, ORIENTED)
        local = ekf.state.map_of(near, ORIENTED)
        at = ekf.oriented_observation.predict(reading.pose, local.landmark)
        by_pose = at.jacobian_pose @ reading.jacobian
        h = np.concatenate((by_pose, at.jacobian_landmark), axis=2)
        p = len(reading.own)
        joint = np.empty((len(near), p + ORIENTED, p + ORIENTED))
        joint[:, :p, :p], joint[:, p:, p:] = local.vehicle, local.own
        joint[:, :p, p:], joint[:, p:, :p] = local.cross, local.cross.transpose(0, 2, 1)
        spread, out = h @ joint @ h.transpose(0, 2, 1), self._out()
        z = at.z - self.mount
        z[:, :2] = z[:, :2] @ out[:2, :2]
        return Predicted(near, z, out.T @ spread @ out)

    def _update(
        self, ekf: FullEkf, predicted: Predicted, scan: SumOfGaussians, tell: Teller
    ) -> None:
        """[z, R] = scan_align(G_L, G_o, z^) of those in view; those within the gate are fused."""
        seen: list[tuple[int, Array, Array]] = []
        for row in self._in_view(predicted, scan):
            slot, z = int(predicted.slot[row]), predicted.z[row]
            spread, o = predicted.covariance[row], self.options
            wide = spread + np.diag((o.floor_m, o.floor_m, o.floor_rad)) ** 2
            template, around = self.found.template[slot], None
            if self.around is not None and np.linalg.norm(wide[:2, :2], 2) > o.enrich_m**2:
                around = self.around(template, ekf.state.oriented[slot])
            how = self.view, o.observation, o.alignment, o.belief
            if around is None:
                what = observe(template, scan, z, wide, *how)
            else:
                what = observe_enriched(template, around, scan, z, wide, *how)
                self.found.enriched += 1
            kind = what.kind or USED
            if what.usable and what.alignment is not None:
                r = what.alignment.covariance
                innovation = what.alignment.pose - z
                innovation[2] = np.mod(innovation[2] + np.pi, 2.0 * np.pi) - np.pi
                if innovation @ np.linalg.solve(spread + r, innovation) <= o.gate:
                    seen.append((slot, z + innovation, r))
                else:
                    kind = GATED
            self.found.reasons[kind] += 1
        if seen:
            self._told(tell, seen)

    def _in_view(self, predicted: Predicted, scan: SumOfGaussians) -> list[int]:
        """Rows of the predicted that are in view, those first that were longest out of sight."""
        o, rows = self.options, []
        for row, slot in enumerate(predicted.slot.tolist()):
            if self._share(slot, predicted.z[row], scan) >= self.view.share:
                rows.append(row)
            else:
                self.found.reasons[OUT_OF_VIEW if len(scan) else BLANK] += 1
        rows.sort(key=lambda row: self._last_seen[int(predicted.slot[row])])
        self.found.reasons[LEFT_OUT] += max(len(rows) - o.aligned, 0)
        return rows[: o.aligned]

    def _share(self, slot: int, z: Array, scan: SumOfGaussians) -> float:
        """Of a landmark's template that should be seen; of a blank scan nothing is."""
        return share_in_view(self.found.template[slot], scan, z, self.view) if len(scan) else 0.0

    def _augment(self, predicted: Predicted, scan: SumOfGaussians, tell: Teller) -> None:
        """Segments that no landmark explains begin one, if they lay themselves onto themselves."""
        o, tried = self.options, 0
        inside = np.array(
            [
                self._share(s, z, scan) >= self.view.share
                for s, z, _ in zip(*predicted, strict=True)
            ],
            dtype=bool,
        )
        predicted = Predicted(*(column[inside] for column in predicted))
        for rows in sorted(segments(scan, o.segmentation), key=len, reverse=True):
            if tried >= o.tried:
                return
            segment = scan.take(rows)
            if self._passing(segment, scan) or self._explained(segment, predicted):
                continue
            tried += 1
            found = quality(segment, self.sensor, self._rng, o.segmentation, o.alignment, o.belief)
            if not found.accepted:
                self.found.rejected += 1
                continue
            template = Template.of_segment(scan, rows)
            slot = self._told(tell, [(NEW, template.pose, found.covariance)])
            self.found.template[slot] = template

    def _passing(self, segment: SumOfGaussians, scan: SumOfGaussians) -> bool:
        """Whether a segment is about to leave the view."""
        if len(segment) < 3:
            return True
        out = self._out()[:2, :2]
        ahead = np.append(segment.centroid - self.options.ahead_m * out[0], 0.0)
        shape = replace(segment, mean=segment.mean - segment.centroid)
        template = Template(shape, ahead)
        return (
            share_in_view(template, scan.take(np.zeros(0, dtype=np.intp)), ahead, self.view)
            < self.view.share
        )

    def _explained(self, segment: SumOfGaussians, predicted: Predicted) -> bool:
        """Whether a segment is too near to a landmark's axis, or mostly its template's."""
        o = self.options
        for slot, z, covariance in zip(*predicted, strict=True):
            shape = self.found.template[int(slot)].shape
            turned = covariance[2, 2] * shape.lever_m**2
            sigma = np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1] + turned)
            if np.hypot(*(z[:2] - segment.centroid)) < o.apart_m + 2.0 * sigma:
                return True
            away = cKDTree(shape.transformed(z).mean).query(segment.mean)[0]
            if np.mean(away < o.explained_m + 2.0 * sigma) > o.explained:
                return True
        return False

    def _told(self, tell: Teller, seen: list[tuple[int, Array, Array]]) -> int:
        """Tell of sightings (slot, z, R) in the scanner's frame; returns the last one's slot."""
        out = self._out()
        z = np.array([at for _, at, _ in seen]) @ out.T + self.mount
        r = np.array([out @ spread @ out.T for *_, spread in seen])
        slots = tell.observe(z, r, np.array([slot for slot, *_ in seen], dtype=np.intp))
        for slot in slots.tolist():
            self._last_seen[slot] = self.found.scans
            self.found.sightings[slot] += 1
        return int(slots[-1])

    def _out(self) -> Array:
        """(3, 3) from the scanner's axes to the vehicle's."""
        out = np.eye(3)
        out[:2, :2] = rotation(float(self.mount[2]))
        return out
