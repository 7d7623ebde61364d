"""Merging of duplicate scan landmarks (Nieto 2005, section 5.2.3).

Duplicates arise where a loop closes late, and a landmark is initialised a second time. The thesis
merges landmarks that are close. Here their templates must also fit each other, and the pose at
which they fit is fused as a measurement.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import POSE
from ekf_reference.core.measurement_update import Linearised
from ekf_reference.core.state import LocalMap
from ekf_reference.models.relative_pose import RelativePose
from ekf_reference.scan_landmarks.scan_slam import ScanSlam
from ekf_reference.scan_landmarks.templates import Template
from ekf_reference.scan_matching.alignment_covariance import scan_align
from ekf_reference.scan_matching.frames import moved_gaussians
from ekf_reference.scan_matching.sog import SumOfGaussians

_MODEL = RelativePose()


class MergeSink(Protocol):
    """Receives, for a filter, the measurement that two of its landmarks are one."""

    def fuse(self, first: int, second: int, z: Array, covariance: Array) -> LocalMap:
        """See merge_landmarks."""


@dataclass(frozen=True, kw_only=True)
class FusingOptions:
    """When two scan landmarks are merged; the thesis asks only that they are very close.

    within_m: greatest distance of their axes. certain_m, certain_rad: largest sigma of their
    relative pose. open_directions: most of x, y and heading that the fit may leave open. tried:
    most pairs per scan. again_after: scans until a pair that did not fit is tried again. Other
    bounds of a fit are those of ScanSlamOptions.
    """

    within_m: float = 1.5
    certain_m: float = 0.5
    certain_rad: float = 0.05
    open_directions: int = 0
    tried: int = 2
    again_after: int = 50


class LandmarkPair(NamedTuple):
    """Two landmarks, and z (3,) of the second in the first's frame with covariance (3, 3)."""

    first: int
    second: int
    z: Array
    covariance: Array


class DuplicateMerging:
    """Finds and merges duplicates around the vehicle. merged: how many, so far."""

    def __init__(self, slam: ScanSlam, options: FusingOptions | None = None) -> None:
        """slam: whose templates change as landmarks are fused."""
        self.found, self._slam, self.merged = slam.found, slam, 0
        self.options = options or FusingOptions()
        self._tried: dict[tuple[int, int], int] = {}

    def step(self, ekf: Ekf, sink: MergeSink) -> None:
        """Merge duplicates within reach, the closest first; call it after every scan."""
        gone = set[int]()
        for pair in self._close(ekf, self._slam.view.reach_m)[: self.options.tried]:
            if gone & {pair.first, pair.second}:
                continue
            self._tried[pair.first, pair.second] = self.found.scans
            fit = self._fit(pair)
            if fit is None:
                continue
            known = sink.fuse(pair.first, pair.second, *fit)
            self._unite(pair.first, pair.second, known)
            gone |= {pair.first, pair.second}  # what other pairs say of these is past

    def _close(self, ekf: Ekf, reach_m: float) -> list[LandmarkPair]:
        """Pairs that are near each other for certain; the larger template is the first of each."""
        o, size = self.options, {s: len(t.shape) for s, t in self.found.template.items()}
        near = ekf.state.within(reach_m, POSE)
        near = near[~np.isin(near, list(self.found.moving))]
        place = ekf.state.map_of(near, POSE).landmark
        away = np.hypot(*(place[:, None, :2] - place[None, :, :2]).transpose(2, 0, 1))
        pairs = []
        for i, j in np.argwhere(np.triu(away <= o.within_m, k=1)).tolist():
            both = sorted(
                (int(near[i]), int(near[j])), key=lambda landmark_index: -size[landmark_index]
            )
            last = self._tried.get((both[0], both[1]))
            if last is not None and self.found.scans - last < o.again_after:
                continue
            pair = relative(ekf, both[0], both[1])
            axis = np.sqrt(np.linalg.eigvalsh(pair.covariance[:2, :2])[-1])
            if axis <= o.certain_m and pair.covariance[2, 2] <= o.certain_rad**2:
                pairs.append(pair)
        return sorted(pairs, key=lambda pair: float(np.hypot(*pair.z[:2])))

    def _fit(self, pair: LandmarkPair) -> tuple[Array, Array] | None:
        """Align the second's template with the first's: z and R; None if it does not fit."""
        o, template = self._slam.options, self.found.template
        wide = pair.covariance + np.diag((o.floor_m, o.floor_m, o.floor_rad)) ** 2
        found = scan_align(
            template[pair.second].shape,
            template[pair.first].shape,
            pair.z,
            wide,
            o.alignment,
            o.belief,
        )
        evidence, innovation = found.alignment, _MODEL.innovation(found.pose, pair.z)
        spread = pair.covariance + found.covariance
        fits = (
            evidence.converged
            and found.open_directions <= self.options.open_directions
            and evidence.overlap >= o.observation.overlap
            and evidence.runner_up <= o.observation.ambiguous
            and innovation @ np.linalg.solve(spread, innovation) <= o.gate
        )
        return (pair.z + innovation, found.covariance) if fits else None

    def _unite(self, first: int, second: int, known: LocalMap) -> None:
        """Add the second's template to the first's, in the first's frame."""
        template, seen = self.found.template, self.found.measurements
        template[first] = replace(
            template[first], shape=united(template[first], template.pop(second), known)
        )
        seen[first] += seen.pop(second, 0)
        self.merged += 1


def relative(ekf: Ekf, first: int, second: int) -> LandmarkPair:
    """Return the relative pose of two landmarks and its covariance (Nieto 2005, eq. 5.15)."""
    local = ekf.state.map_of(np.array((first, second), dtype=np.intp), POSE)
    z, h = _second_in_first(local)
    return LandmarkPair(first, second, z, h @ _joint(local) @ h.T)


def _second_in_first(local: LocalMap) -> tuple[Array, Array]:
    """Z (3,) of the second of two landmarks in the first's frame, and H (3, 6) by both."""
    at = _MODEL.predict(local.landmark[0], local.landmark[1:])
    return at.z[0], np.hstack((at.jacobian_pose[0], at.jacobian_landmark[0]))


def _joint(local: LocalMap) -> Array:
    """(6, 6) covariance of two landmarks."""
    return local.covariance[len(local.pose) :, len(local.pose) :]


def merge_landmarks(ekf: Ekf, first: int, second: int, z: Array, covariance: Array) -> LocalMap:
    """Fuse where the second's frame is in the first's, and remove the second (section 5.2.3).

    z: (3,) such as the alignment of their templates says, with covariance (3, 3); zero with little
    covariance makes them equal. Returns the two as they were before the removal, to move what the
    second's frame holds (`united`). Raises ValueError for one landmark, or one removed.
    """
    if first == second:
        raise ValueError(f"landmark {first} is one already")
    both = np.array((first, second), dtype=np.intp)

    def linearise() -> Linearised:
        local = ekf.state.map_of(both, POSE)
        expected, h = _second_in_first(local)
        jacobian = np.hstack((np.zeros((3, len(local.pose))), h))
        return Linearised(local, jacobian, _MODEL.innovation(z, expected))

    ekf.fuse(linearise, covariance[None], ekf.take_numbers("merge"), both[1:], first)
    known = ekf.state.map_of(both, POSE)
    ekf.remove(both[1:], POSE)
    return known


def united(first: Template, second: Template, known: LocalMap) -> SumOfGaussians:
    """Return the union of two templates in the first's frame (Nieto 2005, eqs. 5.6 to 5.12).

    known: the two landmarks, as merge_landmarks returns them; the uncertainty between the frames
    is added to that of the second's Gaussians. Errata: see frames.
    """
    (one, other), shape = known.landmark, second.shape
    mean, covariance = moved_gaussians(one, other, _joint(known), shape.mean, shape.covariance)
    return SumOfGaussians.of_equal_height(
        np.concatenate((first.shape.mean, mean)),
        np.concatenate((first.shape.covariance, covariance)),
        np.concatenate((first.shape.boundary, second.shape.boundary)),
    )
