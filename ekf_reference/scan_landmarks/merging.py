"""Two scan landmarks that are one, found and fused while driving (Nieto 2005, section 5.2.3).

They arise where a loop closes late: what was met again had not been recognised and was begun for a
second time. The thesis makes one template of two landmarks that are close. Here the two templates
must also fit each other, and where they do is fused as a measurement, so that what both
landmarks know comes together; close landmarks that are different things stay two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array
from ekf_reference.core.layout import POSE
from ekf_reference.core.local_map import LocalMap
from ekf_reference.models.relative_pose import RelativePose
from ekf_reference.scan_landmarks.scan_slam import ScanSlam
from ekf_reference.scan_landmarks.templates import Template
from ekf_reference.scan_matching.alignment_covariance import scan_align
from ekf_reference.scan_matching.frames import moved_gaussians
from ekf_reference.scan_matching.sog import SumOfGaussians

_MODEL = RelativePose()


class Fuser(Protocol):
    """By whom a filter is told that two of its landmarks are one."""

    def fuse(self, first: int, second: int, z: Array, covariance: Array) -> LocalMap:
        """See Ekf.fuse_oriented."""
        ...


@dataclass(frozen=True, kw_only=True)
class FusingOptions:
    """When two scan landmarks are one. The thesis says no more than that they are very close.

    within_m: most between their axes. certain_m, certain_rad: largest sigma of where the one is
    seen from the other. open_directions: most of x, y and heading that the fit may leave open; what
    it does not fix would stay wrong between the points of one template. tried: most pairs that
    one scan has time for. again_after: scans until a pair that does not fit is tried again. What
    else makes a fit is for ScanSlamOptions to say.
    """

    within_m: float = 1.5
    certain_m: float = 0.5
    certain_rad: float = 0.05
    open_directions: int = 0
    tried: int = 2
    again_after: int = 50


class Pair(NamedTuple):
    """Two landmarks, and where the second's frame is in the first's: (3,), covariance (3, 3)."""

    first: int
    second: int
    z: Array
    covariance: Array


class Twins:
    """Looks for them among the landmarks around the vehicle. merged: how many have been, so far."""

    def __init__(self, slam: ScanSlam, options: FusingOptions | None = None) -> None:
        """slam: whose templates change as landmarks are fused."""
        self.found, self._slam, self.merged = slam.found, slam, 0
        self.options = options or FusingOptions()
        self._tried: dict[tuple[int, int], int] = {}

    def step(self, ekf: Ekf, tell: Fuser) -> None:
        """Fuse those within reach that are one, the closest first; call it after every scan."""
        gone = set[int]()
        for pair in self._close(ekf, self._slam.view.reach_m)[: self.options.tried]:
            if gone & {pair.first, pair.second}:
                continue
            self._tried[pair.first, pair.second] = self.found.scans
            fit = self._fit(pair)
            if fit is None:
                continue
            known = tell.fuse(pair.first, pair.second, *fit)
            self._unite(pair.first, pair.second, known)
            gone |= {pair.first, pair.second}  # what other pairs say of these is past

    def _close(self, ekf: Ekf, reach_m: float) -> list[Pair]:
        """Pairs that are near each other for certain; the larger template is the first of each."""
        o, size = self.options, {s: len(t.shape) for s, t in self.found.template.items()}
        near = ekf.state.within(reach_m, POSE)
        place = ekf.state.map_of(near, POSE).landmark
        away = np.hypot(*(place[:, None, :2] - place[None, :, :2]).transpose(2, 0, 1))
        pairs = []
        for i, j in np.argwhere(np.triu(away <= o.within_m, k=1)).tolist():
            both = sorted((int(near[i]), int(near[j])), key=lambda slot: -size[slot])
            last = self._tried.get((both[0], both[1]))
            if last is not None and self.found.scans - last < o.again_after:
                continue
            pair = relative(ekf, both[0], both[1])
            axis = np.sqrt(np.linalg.eigvalsh(pair.covariance[:2, :2])[-1])
            if axis <= o.certain_m and pair.covariance[2, 2] <= o.certain_rad**2:
                pairs.append(pair)
        return sorted(pairs, key=lambda pair: float(np.hypot(*pair.z[:2])))

    def _fit(self, pair: Pair) -> tuple[Array, Array] | None:
        """Where the second's template lies in the first's, and R; None if it does not fit there."""
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
        """The second's template, told in the first's frame, joins the first's."""
        template, seen = self.found.template, self.found.sightings
        template[first] = replace(
            template[first], shape=united(template[first], template.pop(second), known)
        )
        seen[first] += seen.pop(second, 0)
        self.merged += 1


def relative(ekf: Ekf, first: int, second: int) -> Pair:
    """Where one landmark's frame is in another's, and how well that is known (eq. 5.15)."""
    local = ekf.state.map_of(np.array((first, second), dtype=np.intp), POSE)
    at = _MODEL.predict(local.landmark[0], local.landmark[1:])
    h = np.hstack((at.jacobian_pose[0], at.jacobian_landmark[0]))
    joint = local.covariance[len(local.pose) :, len(local.pose) :]
    return Pair(first, second, at.z[0], h @ joint @ h.T)


def united(first: Template, second: Template, known: LocalMap) -> SumOfGaussians:
    """One sum of two templates', in the first's frame (Nieto 2005, eqs. 5.6 to 5.12).

    known: the two landmarks, as Ekf.fuse_oriented returns them. Every Gaussian of the second
    has the uncertainty between the frames added to its own. Errata: see frames.
    """
    joint = known.covariance[len(known.pose) :, len(known.pose) :]
    mean, covariance = moved_gaussians(
        known.landmark[0], known.landmark[1], joint, second.shape.mean, second.shape.covariance
    )
    return SumOfGaussians.of_equal_height(
        np.concatenate((first.shape.mean, mean)),
        np.concatenate((first.shape.covariance, covariance)),
        np.concatenate((first.shape.seam, second.shape.seam)),
    )
