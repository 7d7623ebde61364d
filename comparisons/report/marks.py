"""Colours of the estimates and outlines of their ellipses, for figures and pages alike."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array

EKF_COLOUR = "#d1495b"
SMOOTHER_COLOUR = "#00798c"
TRUTH_COLOUR = "#444444"
SCANS_COLOUR = "#edae49"


def ellipses(centre: Array, covariance: Array, sigmas: float, points: int = 48) -> Array:
    """Outlines (L, points, 2) of the error ellipses of centres (L, 2), covariances (L, 2, 2).

    A covariance that is not finite, as a broken filter leaves it, is drawn as a point.
    """
    finite = np.isfinite(covariance).all(axis=(1, 2), keepdims=True)
    covariance = np.where(finite, covariance, 0.0)
    values, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    circle = np.column_stack((np.cos(angle), np.sin(angle)))
    scaled = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    result: Array = centre[:, None] + sigmas * circle @ scaled.transpose(0, 2, 1)
    return result
