"""East, north and heading of the map's paths and of the truth against time, with 3 sigma."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.log import Poses
from comparisons.report.html.map import MapContent, Track
from comparisons.report.marks import TIME, TRUTH_COLOUR, Curve, FilledBand, Panel

_COMPONENTS = (("x, east [m]", 1.0), ("y, north [m]", 1.0), ("heading [deg]", 180.0 / np.pi))
"""What a panel is called, and how much of its unit an SI unit is."""
_SIGMAS = 3.0
_TURN = 2.0 * np.pi
_POINTS, _DIGITS = 800, 5


class _TimedPath(NamedTuple):
    """A path at K instants: pose (K, 3), heading unwrapped; sigma (K, 3), None of the truth.

    Where there is no covariance, or a variance is negative, sigma is NaN.
    """

    name: str
    colour: str
    time_s: Array
    pose: Array
    sigma: Array | None


def path_panels(content: MapContent) -> tuple[Panel, ...]:
    """Return a panel of each component; none of paths that are no longer than an instant."""
    paths = [
        _timed(track)
        for track in content.tracks
        if track.against_time and len(track.time_s) > 1 and track.pose.shape[1] > 2
    ]
    if not paths:
        return ()
    first, truth = paths[0], None if content.log is None else content.log.truth.poses
    # Equal times are one array, so that the page has them once.
    paths = [
        path._replace(time_s=first.time_s) if np.array_equal(path.time_s, first.time_s) else path
        for path in paths
    ]
    if truth is not None:
        paths = [_true_path(truth, first.time_s), *paths]
    paths = [path._replace(pose=_beside(path, first)) for path in paths]
    return tuple(_panel(paths, k) for k in range(len(_COMPONENTS)))


def _timed(track: Track) -> _TimedPath:
    count, covariance = len(track.time_s), track.pose_covariance
    sigma = np.full((count, 3), np.nan)
    if covariance is not None and covariance.shape == (count, 3, 3):
        variance = np.einsum("kii->ki", covariance)
        sigma = np.sqrt(np.where(variance >= 0.0, variance, np.nan))
    return _TimedPath(track.name, track.colour, track.time_s, _unwrapped(track.pose), sigma)


def _true_path(truth: Poses, time_s: Array) -> _TimedPath:
    """The truth at times (K,), NaN where it is not known."""
    pose = np.full((len(time_s), 3), np.nan)
    known = (time_s >= truth.time_s[0]) & (time_s <= truth.time_s[-1])
    pose[known] = truth.at(time_s[known])
    return _TimedPath("truth", TRUTH_COLOUR, time_s, _unwrapped(pose), None)


def _unwrapped(pose: Array) -> Array:
    """Poses (K, 3 or more) as (K, 3), with headings that go on where they are wrapped."""
    pose = pose[:, :3].copy()
    known = np.isfinite(pose[:, 2])
    pose[known, 2] = np.unwrap(pose[known, 2])
    return pose


def _beside(path: _TimedPath, first: _TimedPath) -> Array:
    """Poses of a path with the turns of its headings counted as those of the first path."""
    pose, known = path.pose.copy(), np.isfinite(path.pose[:, 2])
    if known.any():
        start = int(np.argmax(known))
        there = np.interp(path.time_s[start], first.time_s, first.pose[:, 2])
        turns = np.round((there - pose[start, 2]) / _TURN)
        pose[:, 2] += _TURN * (turns if np.isfinite(turns) else 0.0)
    return pose


def _panel(paths: list[_TimedPath], k: int) -> Panel:
    """Return the panel of a component."""
    title, unit = _COMPONENTS[k]
    bands, without = [], []
    for path in paths:
        if path.sigma is None:
            continue
        if not np.isfinite(path.sigma).any():
            without.append(path.name)
            continue
        middle, half = unit * path.pose[:, k], _SIGMAS * unit * path.sigma[:, k]
        bands.append(
            FilledBand(
                name=f"{path.name}, 3 sigma",
                colour=path.colour,
                x=path.time_s,
                low=middle - half,
                high=middle + half,
                lack="a variance is negative",
                about=path.name,
            )
        )
    return Panel(
        title=title,
        x_label=TIME,
        curves=tuple(
            Curve(path.name, path.colour, path.time_s, unit * path.pose[:, k]) for path in paths
        ),
        bands=tuple(bands),
        lacks=(f"no 3 sigma of {', '.join(without)}: no covariances of poses",) * bool(without),
        points=_POINTS,
        digits=_DIGITS,
    )
