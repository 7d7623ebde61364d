"""Defects of mean and covariance: recorded matrices are right, what is done with them is not."""

from __future__ import annotations

import numpy as np

from comparisons.adapters.defects.defect import Defect, with_state
from comparisons.arrays import Array
from ekf_reference.core.geometry import Index
from ekf_reference.core.landmark_types import POINT, LandmarkKind, NewLandmarks
from ekf_reference.core.state import Correction, KalmanState


class NoCrossAtAugmentation(KalmanState):
    """New landmarks know the vehicle but not the map."""

    def augment(self, new: NewLandmarks, noise: Array, kind: LandmarkKind = POINT) -> None:
        """Append, then forget."""
        n = self._layout.size
        super().augment(new, noise, kind)
        self._covariance[3:n, n : self._layout.size] = 0.0
        self._covariance[n : self._layout.size, 3:n] = 0.0


class NoVehicleAtAugmentation(KalmanState):
    """New landmarks know the map but not the vehicle."""

    def augment(self, new: NewLandmarks, noise: Array, kind: LandmarkKind = POINT) -> None:
        """Append, then forget."""
        n = self._layout.size
        super().augment(new, noise, kind)
        self._covariance[:3, n : self._layout.size] = 0.0
        self._covariance[n : self._layout.size, :3] = 0.0


class NoCrossAtPrediction(KalmanState):
    """The vehicle moves, its covariance with the map does not."""

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        """Move, then put the old cross-covariance back."""
        n = self._layout.size
        cross = self._covariance[:3, 3:n].copy()
        super().predict(pose, jacobian_pose, noise)
        self._covariance[:3, 3:n] = cross
        self._covariance[3:n, :3] = cross.T


class TransposedAtPrediction(KalmanState):
    """F^T P F where F P F^T belongs."""

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        """Move by the transpose."""
        super().predict(pose, jacobian_pose.T, noise)


class OneSidedPrediction(KalmanState):
    """The cross-covariance moves above the diagonal only, so that P is not symmetric."""

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        """Move, then put the lower block back."""
        n = self._layout.size
        lower = self._covariance[3:n, :3].copy()
        super().predict(pose, jacobian_pose, noise)
        self._covariance[3:n, :3] = lower


class GainNotTransposed(KalmanState):
    """Joseph's form with (I - W H) where its transpose belongs."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """The mean as it should be, the covariance not."""
        n = self._layout.size
        p = self._covariance[:n, :n].copy()
        h = np.zeros((len(jacobian), n))
        np.add.at(h.T, columns, jacobian.T)
        w = p @ h.T @ np.linalg.inv(h @ p @ h.T + noise)
        keep = np.eye(n) - w @ h
        done = super().update(columns, jacobian, innovation, noise)
        broken = keep @ p @ keep + w @ noise @ w.T
        self._covariance[:n, :n] = 0.5 * (broken + broken.T)
        return done


class NoCrossAtUpdate(KalmanState):
    """The vehicle's covariance with the map is not updated."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Update, then put the old cross-covariance back."""
        n = self._layout.size
        cross = self._covariance[:3, 3:n].copy()
        done = super().update(columns, jacobian, innovation, noise)
        self._covariance[:3, 3:n] = cross
        self._covariance[3:n, :3] = cross.T
        return done


class IndependentLandmarks(KalmanState):
    """Landmarks are kept independent of each other, as in a map of single filters."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Update, then forget what ties landmarks together."""
        done = super().update(columns, jacobian, innovation, noise)
        for kind, first in self._layout.first.items():
            for at in first.tolist():
                self._covariance[at : at + kind.width, 3:at] = 0.0
                self._covariance[3:at, at : at + kind.width] = 0.0
        return done


class OnlySeenUpdated(KalmanState):
    """An update moves the vehicle and the landmarks in view, not the rest of the map."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Update, then put the rest of the mean back."""
        n = self._layout.size
        before = self._mean[:n].copy()
        done = super().update(columns, jacobian, innovation, noise)
        unseen = np.setdiff1d(np.arange(n), columns)
        self._mean[unseen] = before[unseen]
        return done


class InnovationSubtracted(KalmanState):
    """The mean moves away from what was measured."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """X - W nu."""
        return super().update(columns, jacobian, -innovation, noise)


class NoiseLeftOut(KalmanState):
    """S = H P H^T, all but without R."""

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """As if measurements were exact."""
        return super().update(columns, jacobian, innovation, 1e-6 * noise)


DEFECTS = (
    Defect(
        "cross-covariance dropped at augmentation",
        "P between a new landmark and the map is left zero",
        ("algebra", "augmentation", "with blocks other than pose was left zero"),
        with_state(NoCrossAtAugmentation),
    ),
    Defect(
        "vehicle dropped at augmentation",
        "P between a new landmark and the vehicle is left zero",
        ("algebra", "augmentation", "was not correlated with the others"),
        with_state(NoVehicleAtAugmentation),
    ),
    Defect(
        "cross-covariance dropped at prediction",
        "the cross-covariance of vehicle and map is not multiplied by F",
        ("algebra", "prediction", "F was not applied to the covariance with other blocks"),
        with_state(NoCrossAtPrediction),
    ),
    Defect(
        "F transposed",
        "F^T P F in the prediction",
        ("algebra", "prediction", "F was applied transposed"),
        with_state(TransposedAtPrediction),
    ),
    Defect(
        "asymmetric covariance",
        "the prediction writes the upper cross-covariance only",
        ("algebra", "prediction", "on one side of the diagonal alone"),
        with_state(OneSidedPrediction),
    ),
    Defect(
        "gain not transposed",
        "Joseph's form with (I - W H) on both sides",
        ("algebra", "update", "with I - K H in place of its transpose"),
        with_state(GainNotTransposed),
    ),
    Defect(
        "cross-covariance dropped at update",
        "the update leaves P between vehicle and map as it was",
        ("algebra", "update", "covariances of block pose with all others were not updated"),
        with_state(NoCrossAtUpdate),
    ),
    Defect(
        "landmarks kept independent",
        "P between landmarks is set to zero after every update",
        ("algebra", "update", "all blocks but pose were made independent of each other"),
        with_state(IndependentLandmarks),
    ),
    Defect(
        "only seen landmarks updated",
        "the gain is applied to the vehicle and the landmarks in view",
        ("algebra", "update", "does not correct the estimate of landmark"),
        with_state(OnlySeenUpdated),
    ),
    Defect(
        "innovation subtracted",
        "x - W nu in the update",
        ("algebra", "update", "corrects the estimate of all blocks with the wrong sign"),
        with_state(InnovationSubtracted),
    ),
    Defect(
        "R left out of S",
        "S = H P H^T in the gain",
        ("algebra", "update", "the covariance was updated with no R"),
        with_state(NoiseLeftOut),
    ),
)
