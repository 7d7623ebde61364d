"""Faults planted in a stranger's EKF, and the words that a cause which names them must hold."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np

from benchmarks.strangers import Array, Ekf, Log, rotation

Plant = Callable[[type[Ekf]], type[Ekf]]
Naming = Literal["named", "general", "false", "none"]


class Fault(NamedTuple):
    """words: what a right first cause holds, as a regular expression. plant: makes it."""

    name: str
    words: str
    plant: Plant


def instead(**methods: Callable[..., Any]) -> Plant:
    """Replace methods; each is given the one that it replaces first, bound to the filter."""

    def plant(base: type[Ekf]) -> type[Ekf]:
        def replaced(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
            return lambda self, *args: method(getattr(base, name).__get__(self), self, *args)

        found = {name: replaced(name, method) for name, method in methods.items()}
        return type(base.__name__, (base,), found)

    return plant


def scaled(name: str, factor: Any) -> Plant:
    """Multiply what a method returns."""
    return instead(**{name: lambda own, ekf, *args: factor * own(*args)})


def fed(change: Callable[[Log], dict[str, Any]]) -> Plant:
    """Change the log's content before the filter has it."""
    return instead(fed=lambda own, ekf, log: replace(log, **change(log)))


def rooted(k: int) -> Callable[..., Array]:
    """Return what puts a sigma in the place of a variance on a diagonal."""

    def method(own: Callable[..., Array], ekf: Ekf, *args: Any) -> Array:
        r = own(*args)
        r[k, k] = np.sqrt(r[k, k])
        return r

    return method


def signed(rows: Any, columns: Any) -> Plant:
    """Turn signs in H."""

    def expected(own: Callable[..., Any], ekf: Ekf, *args: Any) -> Any:
        z, hv, hl = own(*args)
        hv[rows, columns] *= -1.0
        return z, hv, hl

    return instead(expected=expected)


def body_noise(own: Callable[..., Any], ekf: Ekf, b: Array, noise: Array, dt: float) -> Array:
    """Q as if the vehicle headed east."""
    b = b.copy()
    b[:2] = rotation(-ekf.x[ekf.v[2]]) @ b[:2]
    return np.asarray(own(b, noise, dt))


def uncorrelated(own: Callable[..., None], ekf: Ekf, k: int) -> None:
    """Forget the new landmark's cross-covariance."""
    own(k)
    ekf.p[-2:, :-2] = ekf.p[:-2, -2:] = 0.0


def pose_alone(own: Callable[..., None], ekf: Ekf, f: Array, q: Array) -> None:
    """Move the pose's covariance and leave that with the map."""
    block = np.ix_(ekf.v, ekf.v)
    ekf.p[block] = f @ ekf.p[block] @ f.T + q


def placed(gx: Callable[[Array], Array], gz: Callable[[Array], Array]) -> Plant:
    """Change G_x and G_z."""

    def place(own: Callable[..., Any], ekf: Ekf, *args: Any) -> Any:
        point, x, z = own(*args)
        return point, gx(x), gz(z)

    return instead(place=place)


def late_odometry(own: Callable[..., None], ekf: Ekf, number: int, *args: float) -> None:
    """Drive by the sample before."""
    own(max(number - 1, 0), *args)


def late_scans(log: Log) -> dict[str, Any]:
    """Use a scan at the time of the next one."""
    times = np.unique(log.used_s)
    at = np.searchsorted(times, log.used_s) + 1
    kept = at < len(times)
    names = ("z", "sigma", "label", "row")
    return {name: getattr(log, name)[kept] for name in names} | {"used_s": times[at[kept]]}


def every_second(log: Log) -> dict[str, Any]:
    """Drop every second measurement."""
    names = ("z", "sigma", "label", "row", "used_s")
    return {name: getattr(log, name)[::2] for name in names}


def swapped(since: float) -> Callable[[Log], dict[str, Any]]:
    """Exchange the two labels that are measured most, from a share of the log on."""

    def change(log: Log) -> dict[str, Any]:
        labels, counts = np.unique(log.label, return_counts=True)
        a, b = labels[np.argsort(-counts, kind="stable")[:2]]
        late = np.arange(len(log.label)) >= since * len(log.label)
        label = np.where(late & (log.label == a), b, log.label)
        return {"label": np.where(late & (log.label == b), a, label)}

    return change


def twice(own: Callable[..., Array], ekf: Ekf, ks: Array) -> Array:
    """Use measurements of known landmarks twice."""
    known = np.array([ekf.log.label[k] in ekf.index for k in ks], bool)
    return np.concatenate((ks, ks[known]))


def degrees(own: Callable[..., list[float]], ekf: Ekf, pose: Array) -> list[float]:
    """Write a heading in degrees where radians belong."""
    return own(np.append(pose[:2], np.degrees(pose[2])))


R_WORDS = (
    r"\bR\b|noise of (the )?measurement|measurement noise|"
    r"noise covariance differs [^;]* measurement updates"
)
Q_WORDS = (
    r"\bQ\b|process noise|odometry('s)? noise|noise of (the )?(odometry|motion)|"
    r"noise covariance differs [^;]* predictions"
)
LABEL_WORDS = r"label|assigned|exchanged|another id|position of another landmark"
PRIOR_WORDS = r"prior|covariance at the start|start(ing|'s)? covariance"
FAULTS = (
    Fault("R times 2", R_WORDS, scaled("noise", 2.0)),
    Fault("R times 0.5", R_WORDS, scaled("noise", 0.5)),
    Fault("R times 4", R_WORDS, scaled("noise", 4.0)),
    Fault("Q times 4", Q_WORDS, scaled("process", 4.0)),
    Fault("Q times 0.25", Q_WORDS, scaled("process", 0.25)),
    Fault("sigma for variance, range", R_WORDS, instead(noise=rooted(0))),
    Fault("sigma for variance, bearing", R_WORDS, instead(noise=rooted(1))),
    Fault("sigma for variance, turn", Q_WORDS, instead(of_control=rooted(1))),
    Fault(
        "sigma for variance, prior",
        PRIOR_WORDS,
        instead(prior=lambda own, ekf, p: np.sqrt(own(p))),
    ),
    Fault("prior times 100", PRIOR_WORDS, scaled("prior", 100.0)),
    Fault(
        "innovation not wrapped",
        r"wrap",
        instead(residual=lambda own, ekf, z, expected: z - expected),
    ),
    Fault(
        "new landmark uncorrelated",
        r"cross-covariance|(landmark )?initialis",
        instead(initialise=uncorrelated),
    ),
    Fault("Q in the body's axes", r"\bQ\b.*(rotat|frame)", instead(process=body_noise)),
    Fault(
        "odometry one sample late",
        r"(odometry|control|sample).*(late|previous)|late.*odometry",
        instead(predict=late_odometry),
    ),
    Fault(
        "measurements one scan late",
        r"measurements? .*late|late.*measurements?|previous scan",
        fed(late_scans),
    ),
    Fault("sign of H's heading", r"heading('s)? (column|term).*\bH\b|\bH\b.*heading", signed(1, 2)),
    Fault(
        "sign of H's position, bearing row",
        r"position.*bearing row of H|bearing row.*\bH\b",
        signed(1, slice(0, 2)),
    ),
    Fault("measurements used twice", r"more than once|twice", instead(chosen=twice)),
    Fault(
        "every second measurement dropped",
        r"(not|never|un)[- ]?used|dropped|missing|omitted|left out|rejected",
        fed(every_second),
    ),
    Fault(
        "sigmas exchanged",
        r"exchanged|swapped",
        instead(noise=lambda own, ekf, k: own(k)[::-1, ::-1].copy()),
    ),
    Fault(
        "x and y exchanged in the output",
        r"mirror|axes|exchanged",
        instead(tum=lambda own, ekf, pose: own(pose[[1, 0, 2]])),
    ),
    Fault(
        "heading in degrees in the output",
        r"in degrees|are degrees|degrees (instead|where)",
        instead(tum=degrees),
    ),
    Fault(
        "gain of another R",
        r"gain|update (computes|is)|covariance.*update",
        instead(gain=lambda own, ekf, h, r: own(h, 4.0 * r)),
    ),
    Fault(
        "cross-covariance not predicted",
        r"prediction.*cross|cross-covariance",
        instead(carry=pose_alone),
    ),
    Fault(
        "F transposed",
        r"\bF\b|prediction computes",
        instead(carry=lambda own, ekf, f, q: own(f.T, q)),
    ),
    Fault(
        "bearing mirrored",
        r"clockwise|mirror|bearing.*sign|sign.*bearing",
        fed(lambda log: {"z": log.z * (1.0, -1.0)}),
    ),
    Fault("range bias 0.2 m", r"range.*bias", fed(lambda log: {"z": log.z + (0.2, 0.0)})),
    Fault("bearing bias 0.02", r"bearing.*bias", fed(lambda log: {"z": log.z + (0.0, 0.02)})),
    Fault("speed times 1.02", r"speed|scale", fed(lambda log: {"u": log.u * (1.02, 1.0)})),
    Fault(
        "yaw rate times 0.98",
        r"yaw rate|steering|turn",
        fed(lambda log: {"u": log.u * (1.0, 0.98)}),
    ),
    Fault(
        "G_x without heading",
        r"G_x|initialis",
        placed(lambda gx: gx * (1.0, 1.0, 0.0), lambda gz: gz),
    ),
    Fault("without G_z", r"G_z|initialis", placed(lambda gx: gx, lambda gz: np.eye(2))),
    Fault(
        "R of new landmarks times 4", r"\bR\b.*new landmark|initialis", scaled("first_noise", 4.0)
    ),
    Fault(
        "two labels swapped at half time",
        LABEL_WORDS,
        fed(swapped(0.5)),
    ),
    Fault(
        "two labels swapped throughout",
        LABEL_WORDS,
        fed(swapped(0.0)),
    ),
)

_SPECIFIC = re.compile(
    r"time stamps|too late|too early|poses are those from before|shifted|rotated by|scaled|mirror|"
    r"another (frame|point)|lever|constant offset|opposite sign|in degrees|half angle|"
    r"position of another|headings differ|more than once|assigned to|exchanged|another id|"
    r"rejected although|"
    r"sigma instead|standard deviations|square of the|times those of|times that of|"
    r"without (the|any) (cross-)?c|body frame|previous pose|transposed|not rotated|"
    r"computes .* wrongly|prior|clockwise|wrapped|bias"
)
"""Words by which a statement names a fault, whichever."""


def naming(fault: Fault, evidence: str, hint: str) -> Naming:
    """Return whether a cause names the fault, another one, or none.

    A hint counts as far as it says what was found; what it lists to be checked does not.
    """
    _, fitted, listed = hint.partition("fitted to the trace: ")
    said = f"{evidence}; {listed}"
    if re.search(fault.words, said):
        return "named"
    return "false" if fitted or _SPECIFIC.search(evidence) else "general"
