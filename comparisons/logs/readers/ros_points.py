"""ROS messages of points: markers, detections, fixes, and poses of odometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError, shorten
from comparisons.logs.odometry_noise import LARGEST_VARIANCE, Unusable
from comparisons.logs.readers.ros_messages import frame, planar_pose
from comparisons.logs.validation import LARGEST

SIGMA_RANGE_M, SIGMA_BEARING_RAD = 0.1, float(np.deg2rad(1.0))
"""Stated of points whose message has no covariance."""
SIGMA_FIX_M = 3.0
"""Stated of fixes without a covariance."""
LEAST_VARIANCE = 1e-6
"""No fix or point is better than 1 mm: drivers write less, and zero, for what is not known."""
_ADD, _SOLID = 0, (1, 2, 3)
PLANAR = [0, 1, 5]
_SLOTS = ("z", "roll", "pitch")


@dataclass(frozen=True)
class MessagePoints:
    """What one message holds. point_m: (P, 3) in its frame. covariance: (P, 3, 3), NaN for none.

    label: of each point, "" for none; kind: what it is taken for, which may tell it from others.
    """

    point_m: Array
    covariance: Array
    label: list[str]
    kind: list[str]


def markers(message: Any, place: str) -> MessagePoints | None:
    """A MarkerArray's cubes, spheres and cylinders, named by name space and number."""
    found = [m for m in message.markers if int(m.action) == _ADD and int(m.type) in _SOLID]
    frames = list(dict.fromkeys(frame(m.header.frame_id) for m in found))
    if len(frames) > 1:
        names = " and ".join(map(shorten, frames[:2]))
        raise InputError(f"{place}: frames are {names}, expected one")
    points = [_point(m.pose.position) for m in found]
    label = [f"{m.ns}/{m.id}" if m.ns else str(m.id) for m in found]
    return _points(points, [np.full((3, 3), np.nan)] * len(found), label, [""] * len(found), place)


def detections(message: Any, place: str) -> MessagePoints | None:
    """A Detection3DArray, or a Detection2DArray whose results have poses.

    The best result's position where it is not zero, else the box's centre. Named by the
    detection's own id, and separated by the class of the best result.
    """
    points, covariances, labels, kinds = [], [], [], []
    for detection in message.detections:
        best = max(detection.results, key=_score, default=None)
        position = np.zeros(3)
        covariance = np.full((3, 3), np.nan)
        if best is not None:
            position = _point(best.pose.pose.position)
            covariance = np.asarray(best.pose.covariance, dtype=float).reshape(6, 6)[:3, :3]
        if not position.any() and hasattr(detection.bbox.center, "orientation"):
            position, covariance = _point(detection.bbox.center.position), np.full((3, 3), np.nan)
        if position.any():
            points.append(position)
            covariances.append(covariance)
            labels.append(
                str(getattr(detection, "tracking_id", "") or getattr(detection, "id", ""))
            )
            kinds.append("" if best is None else _kind(best))
    return _points(points, covariances, labels, kinds, place)


def _points(
    points: list[Array], covariances: list[Array], label: list[str], kind: list[str], place: str
) -> MessagePoints | None:
    if not points:
        return None
    stacked = np.array(points)
    if not (np.abs(stacked) <= LARGEST).all():
        raise InputError(f"{place}: a position is not finite, expected at most {LARGEST:g}")
    return MessagePoints(stacked, np.array(covariances), label, kind)


def _point(value: Any) -> Array:
    return np.array((value.x, value.y, value.z), dtype=float)


def _score(result: Any) -> float:
    return float(getattr(result, "hypothesis", result).score)


def _kind(result: Any) -> str:
    hypothesis = getattr(result, "hypothesis", result)
    return str(getattr(hypothesis, "class_id", getattr(hypothesis, "id", "")))


def headed(message: Any) -> Any:
    """What has the header: of a MarkerArray the first marker."""
    return message.markers[0] if hasattr(message, "markers") else message


def range_bearing(points: MessagePoints, place: Array) -> tuple[Array, Array]:
    """(P, 2) range and bearing in the vehicle's plane, and their sigmas (P, 2), NaN for none.

    place: (4, 4) from the points' frame into the vehicle's. Height is dropped.
    """
    x, y, _ = (points.point_m @ place[:3, :3].T + place[:3, 3]).T
    distance = np.hypot(x, y)
    if not distance.all():
        raise InputError("a point lies at the vehicle's pose, expected at a distance from it")
    slope = np.array(((x / distance, y / distance), (-y / distance**2, x / distance**2)))
    planar = (place[:3, :3] @ points.covariance @ place[:3, :3].T)[:, :2, :2]
    variance = np.einsum("ijp,pjk,ikp->pi", slope, planar, slope)
    with np.errstate(invalid="ignore"):
        known = ((variance > 1e-14) & (variance < LARGEST_VARIANCE)).all(axis=1)
    least = np.linalg.eigvalsh(np.where(np.isfinite(planar), planar, 0.0))[:, 0]
    known &= least > 0.999 * LEAST_VARIANCE
    sigma = np.sqrt(np.where(known[:, None], variance, np.nan))
    return np.column_stack((distance, np.arctan2(y, x))), sigma


def fix(message: Any, place: str) -> Array | None:
    """(7,) latitude, longitude [degrees], altitude [m], and variances xx, xy, yx, yy, or NaN."""
    values = np.array((message.latitude, message.longitude, message.altitude), dtype=float)
    if int(message.status.status) < 0 or not np.isfinite(values[:2]).all():
        return None
    if abs(values[0]) > 90.0 or abs(values[1]) > 360.0:
        raise InputError(
            f"{place}: latitude and longitude are {values[:2].tolist()}, expected up to 90 and 360"
        )
    covariance = np.asarray(message.position_covariance, dtype=float).reshape(3, 3)[:2, :2]
    reported = int(message.position_covariance_type) > 0 and np.isfinite(covariance).all()
    if (
        not reported
        or not LEAST_VARIANCE <= np.linalg.eigvalsh(covariance)[0] <= LARGEST_VARIANCE**2
    ):
        covariance = np.full((2, 2), np.nan)
    return np.concatenate((values, ((covariance + covariance.T) / 2).ravel()))


def moved(message: Any, place: str) -> Array:
    """(75,) of an Odometry: pose (3), and the covariances (6, 6) of twist and pose as they are."""
    twist, pose = message.twist.covariance, message.pose.covariance
    return np.concatenate((planar_pose(message.pose.pose, place), twist, pose), dtype=float)


def planar_rows(rows: Array) -> tuple[Array, Unusable]:
    """Return rows (M, 75) of `moved` as (M, 15) for `reckoned_motion`, and what is not usable."""
    twist, pose = (rows[:, begin : begin + 36].reshape(-1, 6, 6) for begin in (3, 39))
    variances = np.diagonal(twist, axis1=1, axis2=2)[:, PLANAR]
    block = pose[:, PLANAR][:, :, PLANAR]
    planar = np.column_stack((rows[:, :3], variances, block.reshape(-1, 9)))
    return planar, Unusable(slots_fault(pose), slots_fault(twist))


def slots_fault(covariance: Array) -> str:
    """Return why covariances (M, 6, 6) of ROS are none of a motion in the plane, else nothing.

    Their slots are x, y, z, roll, pitch and yaw.
    """
    if not np.isfinite(covariance).all():
        return "are not finite"
    turned = covariance.transpose(0, 2, 1)
    scale = np.maximum(np.abs(covariance), np.abs(turned))
    with np.errstate(over="ignore"):
        skew = np.abs(covariance - turned) > 1e-6 * scale
    if skew.any():
        _, row, column = np.argwhere(skew)[0].tolist()
        return (
            f"are not symmetric (slots {6 * row + column} and {6 * column + row} differ), "
            "expected rows of 6 for x, y, z, roll, pitch and yaw"
        )
    if covariance.any() and not covariance[:, PLANAR][:, :, PLANAR].any():
        names = [name for name, k in zip(_SLOTS, (2, 3, 4), strict=True) if covariance[:, k].any()]
        return f"stand in slots of {' and '.join(names)} alone, which no planar pose has"
    return ""


def labels_of(messages: list[MessagePoints]) -> tuple[list[str], NDArray[np.intp]]:
    """Labels of all points, and (P,) the message that each is of.

    A class names a landmark where no message holds it twice: so it is of numbered tags, while
    several trees are all of one class.
    """
    message = np.repeat(np.arange(len(messages)), [len(one.label) for one in messages])
    twice = any(len(set(one.kind)) < len(one.kind) for one in messages)
    found = [
        label or ("" if twice else kind)
        for one in messages
        for label, kind in zip(one.label, one.kind, strict=True)
    ]
    return found, message
