"""A smoother that grows with a log: iSAM2, of which only what new factors touch is solved anew."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from graphslam.arrays import Array
from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, graph_of
from graphslam.marginals import SingularProblemError

MOVED_M, MOVED_RAD = 0.1, 0.01
"""A variable is linearised anew when it has moved by this much since it was.

At 80 m such a turn bends a bearing-range factor by 4 mm, at 5 m such a step by 1 mm.
"""
_STAYS = 1e-5
"""A change [m or rad] below this is not carried on to the variables that depend on it."""
_MOST_STEPS = 6
_UNFIXED = "the measurements do not fix every pose and landmark"


class GrowingSmoother:
    """All factors so far, and their optimum within the thresholds above.

    By Cholesky, and from where that breaks down on an ill-conditioned problem by the slower QR.
    """

    def __init__(self) -> None:
        """Without any variable."""
        self._isam, self._exact = _isam2("CHOLESKY"), False
        self._graph, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def extend(self, factors: Sequence[gtsam.NonlinearFactor], start: gtsam.Values) -> None:
        """Take in factors, and variables where they start; take `values` to the optimum.

        Raises SingularProblemError where the factors leave a direction without information.
        """
        new = graph_of(factors)
        self._graph.push_back(new)
        everything = gtsam.Values(self.values)
        everything.insert(start)
        try:
            self._update(new, start)
        except RuntimeError:
            self._by_qr(everything)

    def joint_covariance(self, keys: Sequence[int]) -> Array:
        """(n, n) of variables in the order of their keys, poses in their own tangent."""
        try:
            found = self._isam.jointMarginalCovariance(list(keys))
        except RuntimeError:
            self._by_qr(self.values)
            found = self._isam.jointMarginalCovariance(list(keys))
        return np.asarray(found.fullMatrix())

    def _by_qr(self, start: gtsam.Values) -> None:
        """Begin again from all factors so far."""
        if self._exact:
            raise SingularProblemError(_UNFIXED)
        self._isam, self._exact = _isam2("QR"), True
        try:
            self._update(self._graph, start)
        except RuntimeError as error:
            raise SingularProblemError(_UNFIXED) from error

    def _update(self, new: gtsam.NonlinearFactorGraph, start: gtsam.Values) -> None:
        """Gauss-Newton steps until nothing moves by more than the thresholds."""
        found = self._isam.update(new, start)
        for _ in range(_MOST_STEPS - 1):
            if not found.getVariablesRelinearized():
                break
            found = self._isam.update()
        self.values = self._isam.calculateEstimate()


def _isam2(factorization: str) -> gtsam.ISAM2:
    steps = gtsam.ISAM2GaussNewtonParams()
    steps.setWildfireThreshold(_STAYS)
    moved = gtsam.ISAM2ThresholdMap()
    moved.insert((chr(gtsam.symbolChr(POSE_KEY)), np.array([MOVED_M, MOVED_M, MOVED_RAD])))
    moved.insert((chr(gtsam.symbolChr(LANDMARK_KEY)), np.array([MOVED_M, MOVED_M])))
    parameters = gtsam.ISAM2Params()
    parameters.setOptimizationParams(steps)
    parameters.setRelinearizeThreshold(moved)
    parameters.relinearizeSkip = 1
    parameters.setFactorization(factorization)
    return gtsam.ISAM2(parameters)
