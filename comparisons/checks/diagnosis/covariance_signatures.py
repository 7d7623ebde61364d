"""What would make covariances fit: known ways for them to be wrong, tried one after the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.checks.grade import LIKE_VARIANCE
from comparisons.covariances import eigenvalue_ranges
from graphslam.graph_builder import to_tangent

_FITS = 1.0 + LIKE_VARIANCE
_MOST_EXCEPTIONS = 0.02


class CovarianceFit(NamedTuple):
    """factor: of the covariances, 1 where it is near. exceptions: (N,) those that do not fit."""

    factor: float
    exceptions: NDArray[np.bool_]


def fit(given: Array, expected: Array, *, scaled: bool = True) -> CovarianceFit | None:
    """Fit covariances (N, n, n) by one factor in all directions; None where they do not fit.

    One in fifty may be an exception. scaled: another factor than one may be.
    """
    low, high = eigenvalue_ranges(given, expected)
    if not (low > 0.0).any():
        return None
    middle = _middle(low, high)
    factor = float(np.median(middle)) if scaled else 1.0
    factor = 1.0 if abs(factor - 1.0) <= LIKE_VARIANCE else factor
    bad = (low * _FITS < factor) | (high > factor * _FITS)
    most = max(1.0, _MOST_EXCEPTIONS * len(bad)) if len(bad) > 1 else 0.0
    return CovarianceFit(factor, bad) if bad.sum() <= most else None


def _middle(low: Array, high: Array) -> Array:
    """Return (N,) geometric means of eigenvalues; nearly 0 where one is not positive."""
    middle: Array = np.sqrt(np.maximum(low, 1e-300) * np.maximum(high, 1e-300))
    return middle


def invalid(given: Array) -> str:
    """What makes some of (N, n, n) no covariances, in words; empty where all are."""
    scale = np.sqrt(np.abs(np.diagonal(given, 0, 1, 2)))
    scale = scale[:, :, None] * scale[:, None]
    skew = np.abs(given - given.transpose(0, 2, 1)) > 1e-3 * np.maximum(scale, 1e-300)
    if skew.any():
        return _of(np.asarray(skew.any(axis=(1, 2))), "symmetric")
    bad = np.linalg.eigvalsh(0.5 * (given + given.transpose(0, 2, 1)))[:, 0] <= 0.0
    return _of(bad, "positive definite") if bad.any() else ""


class PoseCovariances(NamedTuple):
    """Covariances (N, 3, 3) that poses should have, and what they might have been taken from.

    time_s, heading: (N,). before: before each instant's measurements. smoothed: (N, 3, 3) of the
    smoother, NaN where it has none.
    """

    expected: Array
    time_s: Array
    heading: Array
    before: Array
    smoothed: Array


def of_poses(given: Array, poses: PoseCovariances, name: str) -> str:
    """Say how pose covariances (N, 3, 3) differ from those of an estimate of this name."""
    if wrong := invalid(given):
        return f"your pose covariances are invalid: {wrong}"
    for words, expected, scaled in _pose_candidates(poses):
        covariance_fit = fit(given, expected, scaled=scaled)
        if covariance_fit is not None:
            said = _are(words, covariance_fit.factor, name)
            return f"your pose covariances {said}{_but(covariance_fit)}"
    if len(given) > 2 and np.ptp(given, axis=0).max() <= 1e-9 * np.abs(given).max():
        return "your pose covariances are the same for all poses"
    diagonal = np.arange(3)
    ratio = given[:, diagonal, diagonal] / poses.expected[:, diagonal, diagonal]
    entry = np.median(ratio, axis=0)
    root = np.sqrt(np.maximum(entry, 1e-300))
    if fit(given, root[:, None] * poses.expected * root, scaled=False) is not None:
        listed = ", ".join(map(times, entry))
        degrees = " (the heading is in degrees)" if abs(root[2] - np.degrees(1.0)) < 3.0 else ""
        return (
            f"your pose covariances are those of {name} with the variances of x, y and heading "
            f"{listed} times as large{degrees}"
        )
    called = [f"the pose at {time:.9g} s" for time in poses.time_s.tolist()]
    return _varying("your pose covariances are", (given, poses.expected), name, "poses", called)


def of_landmarks(
    given: Array, expected: Array, heading: float, name: str, labels: Sequence[str]
) -> str:
    """Say how landmark covariances (L, 2, 2) differ. heading: of the last pose. labels: (L,)."""
    if wrong := invalid(given):
        return f"your landmark covariances are invalid: {wrong}"
    framed = "in the frame of the last pose instead of the log's frame"
    for words, other in (
        ("", expected),
        (framed, _turned(expected, np.array([heading]))),
        *_common(expected),
    ):
        covariance_fit = fit(given, other)
        if covariance_fit is not None:
            said = _are(words, covariance_fit.factor, name)
            return f"your landmark covariances {said}{_but(covariance_fit)}"
    order = _shuffled(given, expected)
    if order:
        return f"your landmark covariances are those of other landmarks: {order}"
    called = [f"landmark {label}" for label in labels]
    return _varying("your landmark covariances are", (given, expected), name, "landmarks", called)


def of_all(given: Array, expected: Array, name: str) -> str:
    """Say how the covariance of last pose and landmarks differs, each of which is right.

    given, expected: (3 + 2 L, 3 + 2 L), or (2 L, 2 L) of landmarks alone.
    """
    if wrong := invalid(given[None]):
        return f"the covariance of last pose and landmarks {wrong.replace('none is', 'is not')}"
    n = len(given)
    where = np.concatenate((np.zeros(3 * (n % 2)), 1 + np.arange(n - 3 * (n % 2)) // 2))
    same, pose = where[:, None] == where, (where == 0)[:, None] | (where == 0)
    flipped = np.where(pose & ~same, -1.0, 1.0)
    for words, other in (
        ("", expected),
        ("without the cross-covariances of pose and landmarks", expected * (same | ~pose)),
        ("without the cross-covariances of landmarks", expected * (same | pose)),
        ("without any cross-covariances", expected * same),
        ("with cross-covariances of pose and landmarks of opposite sign", expected * flipped),
    ):
        covariance_fit = fit(given[None], other[None])
        if covariance_fit is not None and not (words == "" and covariance_fit.factor == 1.0):
            if not words:
                return of_everything(covariance_fit.factor, name)
            return f"your covariance of last pose and landmarks is that of {name} {words}"
    low, high = eigenvalue_ranges(given[None], expected[None])
    return (
        f"your covariance of last pose and landmarks together is {times(low[0])} to "
        f"{times(high[0])} times that of {name}, depending on the direction"
    )


def of_everything(factor: float, name: str) -> str:
    """Say that one factor explains all covariances."""
    return f"your covariance is {times(factor)} times that of {name}, in all directions"


def times(factor: float) -> str:
    """A factor as people write it."""
    return f"{factor:.1f}" if 1.0 <= factor < 1000.0 else f"{factor:.2g}"


def _pose_candidates(poses: PoseCovariances) -> Iterator[tuple[str, Array, bool]]:
    """Names, covariances, and whether a factor may be added."""
    e = poses.expected
    yield "", e, True
    yield "in the body frame instead of the log's frame", _turned(e, poses.heading), True
    yield "those from before the measurement update", poses.before, False
    yield "those of the previous pose", np.concatenate((e[:1], e[:-1])), False
    for words, then in (("prediction", poses.before), ("pose", e)):
        text = f"those of the next {words}: the recorded array was overwritten (store a copy)"
        yield text, np.concatenate((then[1:], e[-1:])), False
    if np.isfinite(poses.smoothed).all():
        yield "those of the smoother, which uses later measurements", poses.smoothed, False
    for words, order in (("heading, x, y", [2, 0, 1]), ("y, x, heading", [1, 0, 2])):
        yield f"in the order {words}", e[:, order][:, :, order], False
    for words, other in _common(e):
        yield words, other, True


def _common(expected: Array) -> Sequence[tuple[str, Array]]:
    n = expected.shape[1]
    variance = np.diagonal(expected, 0, 1, 2)
    inverse = np.asarray(np.linalg.inv(expected), dtype=float)
    return (
        ("diagonal, without the correlations", variance[:, :, None] * np.eye(n)),
        ("standard deviations instead of variances", np.sqrt(variance)[:, :, None] * np.eye(n)),
        ("information matrices, the inverse of covariances", inverse),
    )


def _turned(covariance: Array, heading: Array) -> Array:
    """R^T P R of the position's entries (N, n, n), n at least 2, by headings (N,) or (1,)."""
    n = covariance.shape[1]
    back = to_tangent(heading)[:, :n, :n]
    turned: Array = back @ covariance @ back.transpose(0, 2, 1)
    return turned


def _shuffled(given: Array, expected: Array) -> str:
    """Landmarks whose covariance is that of another."""
    own, other = eigenvalue_ranges(given, expected), []
    for k in np.flatnonzero((own[0] * _FITS < 1.0) | (own[1] > _FITS)):
        low, high = eigenvalue_ranges(np.broadcast_to(given[k], expected.shape), expected)
        other.append(bool(((low * 1.01 > 1.0) & (high < 1.01)).any()))
    return f"{sum(other)} of {len(given)}" if other and all(other) else ""


def _varying(
    begin: str, pair: tuple[Array, Array], name: str, what: str, called: Sequence[str]
) -> str:
    """Say between which factors a pair of covariances lies. called: each, the worst is named."""
    low, high = eigenvalue_ranges(*pair)
    middle = float(np.median(_middle(low, high)))
    off = (low * _FITS < 1.0) | (high > _FITS)
    even = " the same in all directions," if (high <= low * _FITS**2).all() else ""
    worst = int(np.argmax(np.maximum(high, 1.0 / np.maximum(low, 1e-300))))
    return (
        f"{begin} {times(low.min())} to {times(high.max())} times those of {name},{even} typically "
        f"{times(middle)}; {off.sum()} of {len(off)} {what} differ by more than "
        f"{100 * LIKE_VARIANCE:.0f} %, {called[worst]} most"
    )


def _are(words: str, factor: float, name: str) -> str:
    if factor == 1.0:
        return f"are {words or f'those of {name}'}"
    if not words:
        return f"are {times(factor)} times those of {name}, in all directions"
    return f"are {words}, and {times(factor)} times those of {name}"


def _but(covariance_fit: CovarianceFit) -> str:
    """Which ones do not fit."""
    count = int(covariance_fit.exceptions.sum())
    if not count:
        return ""
    which = f"{count} of {len(covariance_fit.exceptions)}"
    if count == 1 and (covariance_fit.exceptions[-1] or covariance_fit.exceptions[0]):
        which = "the last" if covariance_fit.exceptions[-1] else "the first"
    return f", all but {which}"


def _of(bad: NDArray[np.bool_], what: str) -> str:
    return f"none is {what}" if bad.all() else f"{bad.sum()} of {len(bad)} are not {what}"
