"""Scan matchers by Open3D: iterated closest points to points and to planes, generalised ICP.

Open3D finds normals and covariances by the principal axes of neighbourhoods in space. In a planar
cloud the thinnest axis is then the vertical one, which says nothing; here they come from
SurfaceMap, which looks in the plane.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from graphslam.arrays import Array
from graphslam.scan import planar
from graphslam.scan.libraries import open3d
from graphslam.scan.matchers import JudgedMatcher, MatchOptions
from graphslam.scan.surfaces import SurfaceMap

_THIN = 1e-3
"""Variance across a surface relative to along it (Segal, Haehnel and Thrun 2009, section III)."""

_WEAK = 1e-4
_BELOW_M = 2e2


class _Open3dMatcher(JudgedMatcher):
    def __init__(self, options: MatchOptions | None = None) -> None:
        """Without options the defaults hold. Raises MissingLibraryError."""
        super().__init__(options)
        self._open3d = open3d()

    def align(self, source: Array, target: Array, start: Array) -> Iterator[Array]:
        """See JudgedMatcher."""
        clouds = self.cloud(source, target=False), self.cloud(target, target=True)
        limits = self._open3d.pipelines.registration.ICPConvergenceCriteria(
            self.options.converged, self.options.converged, self.options.iterations
        )
        motion = planar.matrix(start)
        for reach_m in self.options.reaches_m:
            found = self.register(*clouds, reach_m, motion, limits)
            motion = planar.matrix(planar.from_matrix(np.asarray(found.transformation)))
            yield motion

    def cloud(self, points: Array, target: bool) -> Any:
        """Points (N, 3) as Open3D wants them, with what the method needs of the two clouds."""
        return as_open3d(points)

    def register(self, source: Any, target: Any, reach_m: float, start: Array, limits: Any) -> Any:
        """Open3D's result from a start (4, 4)."""
        raise NotImplementedError


class PointToPointMatcher(_Open3dMatcher):
    """Besl and McKay 1992. Slow to slide along surfaces, sure of its pairs nowhere."""

    calibration = 25.0

    def register(self, source: Any, target: Any, reach_m: float, start: Array, limits: Any) -> Any:
        """See the base."""
        methods = self._open3d.pipelines.registration
        estimation = methods.TransformationEstimationPointToPoint()
        return methods.registration_icp(source, target, reach_m, start, estimation, limits)


class PointToPlaneMatcher(_Open3dMatcher):
    """Chen and Medioni 1992, with a Cauchy kernel. Points whose pair is on no surface say nothing.

    kernel: its scale, as a share of the reach.
    """

    calibration = 1.74
    kernel: ClassVar[float] = 0.1

    def cloud(self, points: Array, target: bool) -> Any:
        """With the target's normals, zero where it is no surface."""
        cloud = as_open3d(points)
        if target:
            normal, flat = surface_normals(points)
            normal[~flat] = 0.0
            cloud.normals = self._open3d.utility.Vector3dVector(normal)
        return cloud

    def register(self, source: Any, target: Any, reach_m: float, start: Array, limits: Any) -> Any:
        """See the base."""
        methods = self._open3d.pipelines.registration
        estimation = methods.TransformationEstimationPointToPlane(
            methods.CauchyLoss(self.kernel * reach_m)
        )
        held, normal = _anchors(reach_m)
        back = planar.between(planar.from_matrix(start), np.zeros(3))
        source = source + as_open3d(planar.moved(back, held))
        anchor = as_open3d(held)
        anchor.normals = self._open3d.utility.Vector3dVector(normal)
        target = target + anchor
        return methods.registration_icp(source, target, reach_m, start, estimation, limits)


class GeneralisedMatcher(_Open3dMatcher):
    """Segal, Haehnel and Thrun 2009: both clouds are surfaces, thin across and wide along.

    kernel: as in PointToPlaneMatcher.
    """

    calibration = 1.81
    kernel: ClassVar[float] = 0.1

    def cloud(self, points: Array, target: bool) -> Any:
        """With the covariance of every point, a ball where it is on no surface."""
        cloud = as_open3d(points)
        normal, flat = surface_normals(points)
        across = np.where(flat, 1.0 - _THIN, 0.0)[:, None, None]
        covariance = np.eye(3) - across * normal[:, :, None] * normal[:, None, :]
        cloud.covariances = self._open3d.utility.Matrix3dVector(covariance)
        return cloud

    def register(self, source: Any, target: Any, reach_m: float, start: Array, limits: Any) -> Any:
        """See the base."""
        methods = self._open3d.pipelines.registration
        # Open3D whitens the residuals before the kernel; two thin surfaces have twice the variance.
        scale = self.kernel * reach_m / np.sqrt(2.0 * _THIN)
        estimation = methods.TransformationEstimationForGeneralizedICP(
            _THIN, methods.CauchyLoss(scale)
        )
        return methods.registration_generalized_icp(
            source, target, reach_m, start, estimation, limits
        )


def _anchors(reach_m: float) -> tuple[Array, Array]:
    """Points (A, 3) far below, for both clouds, and the target's normals there.

    Open3D solves the normal equations as they are, and where nothing fixes a direction, as along
    two walls without noise, it steps anywhere. A level ring keeps the motion in the plane and
    says nothing of it; two normals of next to no length hold what the clouds do not.
    """
    turn = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = reach_m * np.column_stack((np.cos(turn), np.sin(turn), 0.0 * turn))
    depth = np.append(np.ones(len(ring)), (2.0, 3.0))
    place = np.vstack((ring, np.zeros((2, 3))))
    place[:, 2] = -_BELOW_M * depth
    normal = np.vstack((np.tile((0.0, 0.0, 1.0), (len(ring), 1)), _WEAK * np.eye(3)[:2]))
    return place, normal


def as_open3d(points: Array) -> Any:
    """An Open3D point cloud of points (N, 3)."""
    library = open3d()
    return library.geometry.PointCloud(library.utility.Vector3dVector(points))


def surface_normals(points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Level unit normals (N, 3), and which points (N,) have one: those of upright surfaces."""
    surfaces = SurfaceMap(points)
    patch = surfaces.patches(points[:, : surfaces.dimension])
    normal = np.zeros((len(points), 3))
    normal[:, :2] = patch.normal
    return normal, patch.flat
