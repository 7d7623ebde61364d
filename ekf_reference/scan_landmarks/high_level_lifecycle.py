"""High level landmarks: passive until measured again, then in the state (Nieto 2005, 6.1).

A passive one is kept in the frame of two of its region's landmarks and moves with the map. The
first scan that aligns with its template initialises it in the state by eqs. 2.51 to 2.53, as any
new landmark; no covariance is made up. From then on it is observed like the others.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ekf_reference.core.ekf import NEW, Ekf
from ekf_reference.core.geometry import Array, Index, to_world
from ekf_reference.core.landmark_types import POSE
from ekf_reference.core.measurements import DynamicGuard
from ekf_reference.dense.local_pose import Frames, local_pose, read_local_poses
from ekf_reference.dense.view import FilterView
from ekf_reference.models.relative_pose import RelativePose
from ekf_reference.scan_landmarks.high_level import PlacedTemplate
from ekf_reference.scan_landmarks.scan_slam import GATE, MOVES, predicted_frames
from ekf_reference.scan_landmarks.templates import (
    APART,
    BLANK,
    ObservationOptions,
    SensorView,
    Template,
    TemplateMatching,
    observe,
)
from ekf_reference.scan_matching.alignment_covariance import CovarianceOptions
from ekf_reference.scan_matching.sog import SumOfGaussians

_COUNTED_AS = {BLANK: "no returns", APART: "no counterpart"}
"""Names of reasons in `counts`, where these are not the reasons themselves."""
SHARE = 0.3
"""Of a template, in view: it holds what was seen from several sides, which no scan sees at once."""
_MATCHED = ObservationOptions(overlap=0.4, ambiguous=0.8)
_OBSERVATION = RelativePose()


@dataclass(frozen=True, kw_only=True)
class HighLevelLandmark:
    """One of them.

    rectangle: (4, 2) in its axis. base: (2,) landmarks L1 and L2, and held: (3,) its pose in their
    frame when it was found. belief: in maxima of its correlation. landmark_index: among the
    filter's pose landmarks; NEW while passive.
    """

    template: Template
    rectangle: Array
    base: Index
    held: Array
    belief: CovarianceOptions
    landmark_index: int = NEW


class LandmarkPoseMeasurement(NamedTuple):
    """number: of the landmark. z: (3,) its pose in the vehicle's frame. covariance: (3, 3)."""

    number: int
    z: Array
    covariance: Array


@dataclass(frozen=True)
class Glimpse:
    """A scan to look for landmarks in.

    shape: its sum, bearings in order, in the scanner's frame; mount: (3,) of that in the vehicle.
    view: what the scanner can see.
    """

    shape: SumOfGaussians
    mount: Array
    view: SensorView


class ExpectedPose(NamedTuple):
    """A landmark's pose in some frame: z (3,), and covariance (3, 3) of what is known of it."""

    z: Array
    covariance: Array


@dataclass(kw_only=True)
class HighLevelLandmarks:
    """All that were found.

    settled: sigmas [m, m, rad] of where the dense map holds a landmark within the frame of two
    others. only_in_view: what is out of view is left out of the alignment, else it draws the rest
    towards other returns. variance_factor: variance of a measurement over that of its alignment,
    since measurements of a visit share the template's errors: means of the two halves of a visit
    (about ten measurements each) differ with 4.1 NEES per degree of freedom, single measurements
    within a half with 1.4 (85 landmarks, `occupancy-loop`, seeds 0 to 9).
    counts: of looks that came to nothing, by reason, and of `seen`. guard: knows where things
    move. moving: numbers of those that are deactivated because their template lies there.
    """

    settled: tuple[float, float, float] = (0.3, 0.3, 0.05)
    only_in_view: bool = True
    variance_factor: float = 4.0
    landmark: list[HighLevelLandmark] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    guard: DynamicGuard | None = None
    moving: set[int] = field(default_factory=set)

    def take(self, found: PlacedTemplate, base: Index, point: Array) -> None:
        """Keep a landmark by its region's longest side between landmarks of the filter.

        base: (3,) as of LocalRegions. point: (L, 2) [m] the filter's.
        """
        real = base[base >= 0]
        ends = [(i, j) for i in real for j in real if i < j]
        pair = max(ends, key=lambda ij: float(np.hypot(*(point[ij[0]] - point[ij[1]]))))
        held = local_pose(found.place, point[pair[0]], point[pair[1]])
        kept = HighLevelLandmark(
            template=found.template,
            rectangle=found.rectangle,
            base=np.array(pair),
            held=held,
            belief=_belief(found),
        )
        self.landmark.append(kept)

    def places(self, ekf: Ekf) -> Array:
        """(K, 3) of all axes in the world now; NaN where their anchor has left the map."""
        point, pose_landmarks = FilterView.of(ekf).landmark, ekf.state.places(POSE)
        rows = [
            pose_landmarks[one.landmark_index]
            if one.landmark_index != NEW
            else _in_the_world(one, point)
            for one in self.landmark
        ]
        return np.reshape(rows, (-1, 3))

    def rectangles(self, ekf: Ekf) -> Array:
        """(K, 4, 2) in the world now, NaN as of `places`."""
        there = zip(self.landmark, self.places(ekf), strict=True)
        return np.reshape([to_world(at, one.rectangle) for one, at in there], (-1, 4, 2))

    def look(self, ekf: Ekf, scan: Glimpse) -> list[LandmarkPoseMeasurement]:
        """Measurements of what should be in view, those within the gate."""
        view = FilterView.of(ekf)
        places = self.places(ekf)
        near = np.linalg.norm(places[:, :2] - view.pose[:2], axis=1) <= scan.view.reach_m
        measurements = []
        for number in np.flatnonzero(near).tolist():
            one = self.landmark[number]
            if self._moves(number, places[number]):
                self.counts[MOVES] += 1
                continue
            expected = self.expected(ekf, view, one)
            if expected is None:
                self.counts["out of reach"] += 1
                continue
            made, reason = self._measure(one, scan, expected)
            self.counts[reason] += 1
            if made is not None:
                measurements.append(LandmarkPoseMeasurement(number, *made))
        return measurements

    def _moves(self, number: int, place: Array) -> bool:
        """Give up a landmark whose template lies where things move (Nieto 2005, section 6.5)."""
        if number in self.moving:
            return True
        if self.guard is not None and self.landmark[number].template.moves(place, self.guard):
            self.moving.add(number)
        return number in self.moving

    def expected(self, ekf: Ekf, view: FilterView, one: HighLevelLandmark) -> ExpectedPose | None:
        """Its pose in the vehicle's frame; None where the covariance of its anchor is old."""
        if one.landmark_index == NEW:
            return self._passive(view, one)
        z, covariance = predicted_frames(ekf, np.array([one.landmark_index]))
        return ExpectedPose(z[0], covariance[0])

    def initialised(
        self, measurements: list[LandmarkPoseMeasurement], landmark_index: Index
    ) -> None:
        """The filter has fused measurements and says which of its landmarks (m,) they are."""
        for one, own in zip(measurements, landmark_index.tolist(), strict=True):
            self.landmark[one.number] = replace(self.landmark[one.number], landmark_index=own)

    def _passive(self, view: FilterView, one: HighLevelLandmark) -> ExpectedPose | None:
        if not np.isin(one.base, view.landmark_index).all():
            return None
        vehicle, covariance = (part[0] for part in read_local_poses(view, one.base[None]))
        at = _OBSERVATION.predict(vehicle, one.held[None])
        by_vehicle, by_own = at.jacobian_pose[0], at.jacobian_landmark[0]
        spread = by_own @ np.diag(np.square(self.settled)) @ by_own.T
        return ExpectedPose(at.z[0], by_vehicle @ covariance @ by_vehicle.T + spread)

    def _measure(
        self, one: HighLevelLandmark, scan: Glimpse, expected: ExpectedPose
    ) -> tuple[ExpectedPose | None, str]:
        there = _OBSERVATION.predict(scan.mount, expected.z[None])
        turn = there.jacobian_landmark[0]
        prior = turn @ expected.covariance @ turn.T
        view = replace(scan.view, share=SHARE)
        options = replace(_MATCHED, visible=self.only_in_view)
        matching = TemplateMatching(view, options, belief=one.belief)
        seen = observe(one.template, scan.shape, there.z[0], prior, matching)
        if not seen.usable or seen.alignment is None:
            return None, _COUNTED_AS.get(seen.reason, seen.reason)
        if one.landmark_index == NEW and seen.alignment.open_directions:
            return None, "a direction is open"
        back = _OBSERVATION.invert(scan.mount, seen.alignment.pose[None])
        turn = back.jacobian_z[0]
        noise = self.variance_factor * turn @ seen.alignment.covariance @ turn.T
        innovation = _OBSERVATION.innovation(back.landmark[0], expected.z)
        distance = innovation @ np.linalg.solve(expected.covariance + noise, innovation)
        if distance > GATE:
            return None, "outside the gate"
        return ExpectedPose(back.landmark[0], noise), "seen"


def _belief(found: PlacedTemplate) -> CovarianceOptions:
    """Chance makes ripples of so many Gaussians as there were, not as they have become."""
    usual = CovarianceOptions()
    merged = found.gaussians / len(found.template.shape)
    return replace(usual, beyond_chance=usual.beyond_chance / math.sqrt(merged))


def _in_the_world(one: HighLevelLandmark, point: Array) -> Array:
    first, second = point[one.base]
    ahead = second - first
    place = Frames.of(first, second).to_world(one.held[:2])
    return np.append(place, one.held[2] + np.arctan2(ahead[1], ahead[0]))
