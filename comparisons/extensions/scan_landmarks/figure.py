"""Scan landmarks on the map of a run, and on the page's."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from comparisons.arrays import Array, Index
from comparisons.estimates.estimate import Estimate
from comparisons.pipeline.known import Known
from comparisons.report.html.drawing import Drawing
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, ellipses
from ekf_reference.scan_landmarks.scan_slam import ScanLandmarks

_SIGMAS = 3.0


def draw_scan_landmarks(axis: Axes, c: Known, landmarks: ScanLandmarks) -> None:
    """Draw templates where the filter has them, and both estimates' axes and ellipses."""
    ekf, surfaces = c.ekf.estimate, c.prepared.log.truth.surfaces
    if surfaces is not None:
        segment = surfaces.segment.reshape(-1, 2, 2)
        axis.add_collection(LineCollection(list(segment), colors="#bbbbbb", linewidths=1.5))
    points = template_points(landmarks, ekf.pose_landmark_id, ekf.pose_landmarks)
    axis.plot(*points.T, ".", color="#222222", markersize=1.2, label="EKF's templates", zorder=1)
    for name, colour, estimate in _both(c):
        outline = ellipses(estimate.pose_landmarks[:, :2], place_covariances(estimate), _SIGMAS)
        axis.add_collection(LineCollection(list(outline), colors=colour, linewidths=0.7))
        label = f"{name} scan landmarks, 3 sigma"
        frames = LineCollection(list(axes_of(estimate)), colors=colour, linewidths=1.2, label=label)
        axis.add_collection(frames)


def scan_landmark_layers(drawing: Drawing, c: Known, landmarks: ScanLandmarks) -> None:
    """Add templates, ellipses and axes; their keys tell them from points."""
    ekf = c.ekf.estimate
    points = template_points(landmarks, ekf.pose_landmark_id, ekf.pose_landmarks)
    drawing.dots("templates", "#333333", points)
    keys = [f"s{i}" for i in ekf.pose_landmark_id.tolist()]
    blocks = c.gaps.agreement.pose_landmarks
    for name, colour, estimate in _both(c):
        labels = [
            f"{name}, scan landmark {i}: {b.difference_m:.3f} m apart, {b.distance_sigma:.2g} sigma"
            for i, b in zip(ekf.pose_landmark_id.tolist(), blocks, strict=True)
        ]
        place, ends = estimate.pose_landmarks[:, :2], axes_of(estimate)
        outline = ellipses(place, place_covariances(estimate), _SIGMAS, 32)
        drawing.outlines(f"{name} scan landmarks, 3 sigma", colour, outline, labels)
        start, end = np.repeat(place, 2, axis=0), ends[:, ::2].reshape(-1, 2)
        drawing.links(f"{name} scan landmarks' axes", colour, start, end)
        drawing.marks(f"{name} scan landmarks", colour, place, labels, keys)


def _both(c: Known) -> tuple[tuple[str, str, Estimate], ...]:
    return (("smoother", SMOOTHER_COLOUR, c.gaps.smoothed), ("EKF", EKF_COLOUR, c.ekf.estimate))


def template_points(landmarks: ScanLandmarks, landmark_index: Index, place: Array) -> Array:
    """(P, 2) the points of templates with their axes at places (Q, 3) [m]."""
    placed = [
        landmarks.template[s].shape.transformed(pose).mean
        for s, pose in zip(landmark_index.tolist(), place, strict=True)
    ]
    return np.vstack([np.zeros((0, 2)), *placed])


def axes_of(estimate: Estimate, length_m: float = 2.0) -> Array:
    """(Q, 3, 2) the ends of each landmark's two axes, left's, origin, ahead's."""
    place, heading = estimate.pose_landmarks[:, :2], estimate.pose_landmarks[:, 2]
    ahead = np.stack((np.cos(heading), np.sin(heading)), axis=1)
    left = np.stack((-ahead[:, 1], ahead[:, 0]), axis=1)
    return np.stack((place + length_m * left, place, place + length_m * ahead), axis=1)


def place_covariances(estimate: Estimate) -> Array:
    """(Q, 2, 2) of the places of scan landmarks."""
    return estimate.pose_landmark_covariances()[:, :2, :2]
