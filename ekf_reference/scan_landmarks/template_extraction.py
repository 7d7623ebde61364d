"""Which returns of a scan become templates (Nieto 2005, sections 5.2.2, 5.2.3 and 5.7).

The thesis makes a template of each segment of 100 returns. With the noise of Table 5.1 the segment
of one object gives a heading to a degree and often nothing along its wall: a scan's segments, each
aligned alone, give about a twentieth of the information that they give together. `JoinedSegments`
makes one template of all. `SingleSegments` keeps them apart, so that regions of a dense map can be
anchored to objects.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, Self

import numpy as np
from scipy.spatial import cKDTree

from ekf_reference.core.geometry import Array, Index
from ekf_reference.scan_landmarks.segmentation import SegmentationOptions, segments
from ekf_reference.scan_landmarks.templates import SensorView, Template, share_in_view
from ekf_reference.scan_matching.sog import SumOfGaussians


class LandmarkInView(NamedTuple):
    """A landmark in view. z: (3,) where it should be seen, covariance: (3, 3) of that."""

    template: Template
    z: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True)
class TemplateExtraction(ABC):
    """Which returns become landmarks, and when.

    every: scans between two that may begin some. share: least part of a template that must be in
    view to be observed (see View). visible: only what should be seen of a template is aligned.
    segmentation: of the scan, and how a template is tried.
    """

    name: ClassVar[str]
    every: int
    share: float
    visible: bool
    segmentation: SegmentationOptions

    @property
    @abstractmethod
    def least_returns(self) -> int:
        """Returns that a template must have."""

    @abstractmethod
    def asking_for(self, returns: int) -> Self:
        """Return the same with another least number of returns of a template."""

    @abstractmethod
    def due(self, scans: int, initialised: int, used: int) -> bool:
        """Whether the scan of number `scans` may begin some: the last that did was `begun`.

        used: landmarks that were seen in this one.
        """

    @abstractmethod
    def found(
        self,
        scan: SumOfGaussians,
        view: SensorView,
        ahead: Array,
        known: Callable[[], list[LandmarkInView]],
    ) -> Iterator[Index]:
        """Rows of the scan's returns, by template. ahead: (2,) where the vehicle goes, length one.

        known: the landmarks in view, worked out when asked for.
        """


TRIAL = SegmentationOptions(
    displacement_m=1.5,
    displacement_rad=np.deg2rad(20.0),
    trials=2,
    residual=0.15,
    interleaved=False,
    open_directions=2,
)
"""Of a candidate."""
_JOINED, _SINGLE = (replace(TRIAL, least_points=least) for least in (8, 15))


@dataclass(frozen=True, kw_only=True)
class JoinedSegments(TemplateExtraction):
    """All segments of a scan in one landmark, as far as they stay in view.

    enough: a scan in which so many landmarks are observed begins none; one with none always does.
    ahead_m: returns are taken that stay in view when the vehicle moves so far, or where that leaves
    fewer than `least`, half, a quarter or nothing of it. share: less than the thesis' 90 %, since
    the view changes sooner than what is seen of one object.
    """

    name: ClassVar[str] = "joined"
    every: int = 5
    enough: int = 5
    ahead_m: float = 10.0
    least: int = 50
    share: float = 0.5
    visible: bool = True
    segmentation: SegmentationOptions = _JOINED

    @property
    def least_returns(self) -> int:
        """See TemplateExtraction."""
        return self.least

    def asking_for(self, returns: int) -> Self:
        """See TemplateExtraction."""
        return replace(self, least=returns)

    def due(self, scans: int, initialised: int, used: int) -> bool:
        """See TemplateExtraction."""
        return not used or (used < self.enough and scans >= initialised + self.every)

    def found(
        self,
        scan: SumOfGaussians,
        view: SensorView,
        ahead: Array,
        known: Callable[[], list[LandmarkInView]],
    ) -> Iterator[Index]:
        """One, or none."""
        parts = segments(scan, self.segmentation)
        if not parts:
            return
        rows = np.concatenate(parts)
        for share in (1.0, 0.5, 0.25, 0.0):
            left = rows[view.sees(scan.mean[rows] - share * self.ahead_m * ahead)]
            if len(left) >= self.least:
                yield left
                return


@dataclass(frozen=True, kw_only=True)
class SingleSegments(TemplateExtraction):
    """A landmark for each segment that no other one explains, the longest first.

    tried: most segments of a scan whose quality is tried, 0 for all. ahead_m: a segment must stay
    in view when the vehicle moves so far. apart_m: least distance of a new landmark's axis to all
    others. explained_m, explained: a return so near to a template's point belongs to that landmark,
    and a segment with a larger share of such returns is no new one. The landmark's uncertainty is
    added to both distances. share: the thesis' 90 %.
    """

    name: ClassVar[str] = "single"
    every: int = 2
    tried: int = 2
    ahead_m: float = 3.0
    apart_m: float = 4.0
    explained_m: float = 1.0
    explained: float = 0.5
    share: float = 0.9
    visible: bool = False
    segmentation: SegmentationOptions = _SINGLE

    @property
    def least_returns(self) -> int:
        """See TemplateExtraction."""
        return self.segmentation.least_points

    def asking_for(self, returns: int) -> Self:
        """See TemplateExtraction."""
        return replace(self, segmentation=replace(self.segmentation, least_points=returns))

    def due(self, scans: int, initialised: int, used: int) -> bool:
        """See TemplateExtraction."""
        return self.every == 1 or scans % self.every == 1

    def found(
        self,
        scan: SumOfGaussians,
        view: SensorView,
        ahead: Array,
        known: Callable[[], list[LandmarkInView]],
    ) -> Iterator[Index]:
        """See TemplateExtraction."""
        in_view, tried = known(), 0
        for rows in sorted(segments(scan, self.segmentation), key=len, reverse=True):
            if self.tried and tried >= self.tried:
                return
            segment = scan.take(rows)
            if self._passing(segment, scan, view, ahead) or self._explained(segment, in_view):
                continue
            tried += 1
            yield rows

    def _passing(
        self, segment: SumOfGaussians, scan: SumOfGaussians, view: SensorView, ahead: Array
    ) -> bool:
        """Whether a segment is about to leave the view."""
        if len(segment) < 3:
            return True
        then = np.append(segment.centroid - self.ahead_m * ahead, 0.0)
        shape = replace(segment, mean=segment.mean - segment.centroid)
        nothing = scan.take(np.zeros(0, dtype=np.intp))
        return share_in_view(Template(shape, then), nothing, then, view) < view.share

    def _explained(self, segment: SumOfGaussians, known: list[LandmarkInView]) -> bool:
        """Whether a segment is too near to a landmark's axis, or mostly its template's."""
        for template, z, covariance in known:
            shape = template.shape
            turned = covariance[2, 2] * shape.lever_m**2
            sigma = np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1] + turned)
            if np.hypot(*(z[:2] - segment.centroid)) < self.apart_m + 2.0 * sigma:
                return True
            away = cKDTree(shape.transformed(z).mean).query(segment.mean)[0]
            if np.mean(away < self.explained_m + 2.0 * sigma) > self.explained:
                return True
        return False
