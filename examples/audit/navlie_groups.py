"""The Lie groups that navlie 0.0.1 needs, by GTSAM's.

navlie takes them from its authors' `pylie`, which no package index has: PyPI's package of that name
is another. What stands here has the part that poses need, in the same conventions: tangent vectors
hold rotation before translation.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

import gtsam
import numpy as np

from comparisons.arrays import Array


class MatrixLieGroup:
    """What navlie's annotations name."""


class Unused(MatrixLieGroup):
    """A group that poses do not need."""


class SO3(MatrixLieGroup):
    """Rotations."""

    dof = 3

    @staticmethod
    def odot(b: Array) -> Array:
        """Return the matrix (3, 3) by which a rotation's tangent vector moves a point."""
        return np.asarray(-gtsam.Rot3.Hat(np.ravel(b)))


class SE3(MatrixLieGroup):
    """Poses, as matrices (4, 4)."""

    dof = 6

    @staticmethod
    def Exp(xi: Array) -> Array:  # noqa: N802
        """Return the pose of a tangent vector (6,)."""
        return np.asarray(gtsam.Pose3.Expmap(np.ravel(xi)).matrix())

    @staticmethod
    def Log(pose: Array) -> Array:  # noqa: N802
        """Return a pose's tangent vector (6,)."""
        return np.asarray(gtsam.Pose3.Logmap(gtsam.Pose3(pose)))

    @staticmethod
    def inverse(pose: Array) -> Array:
        """Return the inverse pose."""
        return np.asarray(gtsam.Pose3(pose).inverse().matrix())

    @staticmethod
    def adjoint(pose: Array) -> Array:
        """Return the adjoint (6, 6)."""
        return np.asarray(gtsam.Pose3(pose).AdjointMap())

    @staticmethod
    def left_jacobian(xi: Array) -> Array:
        """Return J with Exp(xi + d) = Exp(J d) Exp(xi), (6, 6)."""
        return np.asarray(gtsam.Pose3.ExpmapDerivative(-np.ravel(xi)))


def navlie_with_groups() -> Any:
    """Import navlie, with these groups in the place of its authors' pylie, and return it."""
    parts = {name: ModuleType(name) for name in ("pylie", "pylie.numpy", "pylie.numpy.base")}
    groups = {"SO3": SO3, "SE3": SE3, **dict.fromkeys(("SO2", "SE2", "SE23", "SL3"), Unused)}
    vars(parts["pylie"]).update(groups, MatrixLieGroup=MatrixLieGroup)
    vars(parts["pylie.numpy.base"]).update(MatrixLieGroup=MatrixLieGroup)
    before = {name: sys.modules[name] for name in parts if name in sys.modules}
    sys.modules.update(parts)
    try:
        return import_module("navlie")
    finally:
        for name in parts:
            del sys.modules[name]
        sys.modules.update(before)
