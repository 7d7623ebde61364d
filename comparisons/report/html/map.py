"""The map: estimates, what is known of the truth, associations, variance ratios."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log
from comparisons.report.html.curves import short
from comparisons.report.html.drawing import MOST_LINES, Drawing, association_lines, kept
from comparisons.report.html.errors import draw_errors
from comparisons.report.html.shell import colour_bar
from comparisons.report.marks import SCANS_COLOUR, ellipses
from comparisons.report.track_errors import TrackErrors

MOST_LANDMARKS = 1000
"""Landmarks that the page has, each with two ellipses, three marks and a row."""
_RATIO_LEGEND = "ratio-legend"
_SIGMAS = 3.0
_FAR = 4.0
"""Points that lie so many times the map's own size outside of it do not stretch it."""
_NO_RATIO = "#888888"
_RATIO_COLOURS = ("#7f3b08", "#e08214", "#fee0b6", "#f7f7f7", "#d8daeb", "#8073ac", "#2d004b")
"""From too sure to too careful; ColorBrewer's PuOr, which the colour-blind can read."""
_LEAST_DECADES, _MOST_DECADES = 0.5, 3.0

Draws = Callable[[Drawing], None]


@dataclass(frozen=True, kw_only=True)
class Track:
    """One estimate on the map.

    time_s: (K,) and pose: (K, 2 or more), its trajectory. landmark: (m, 2) of the map's marked
    landmarks, NaN where it has one not; landmark_covariance: (m, 2, 2). None without any.
    pose_covariance: (K, 2 or more, 2 or more), of east and north first. against_time: whether it is
    drawn so, too.
    """

    name: str
    colour: str
    dashes: str = ""
    time_s: Array
    pose: Array
    landmark: Array | None = None
    landmark_covariance: Array | None = None
    pose_covariance: Array | None = None
    against_time: bool = True


def estimate_track(
    name: str, colour: str, estimate: Estimate, ids: NDArray[np.int64], dashes: str = ""
) -> Track:
    """An estimate with those of the landmarks (m,) that it has, with covariances if it has any."""
    _, marked, own = np.intersect1d(ids, estimate.landmark_id, return_indices=True)
    place, spread = np.full((len(ids), 2), np.nan), np.full((len(ids), 2, 2), np.nan)
    place[marked], known = estimate.landmark[own], estimate.landmark_covariances()
    if len(known):
        spread[marked] = known[own]
    return Track(
        name=name,
        colour=colour,
        dashes=dashes,
        time_s=estimate.time_s,
        pose=estimate.pose,
        landmark=place,
        landmark_covariance=spread,
        pose_covariance=estimate.pose_covariance,
    )


@dataclass(frozen=True, kw_only=True)
class MapContent:
    """What the map shows.

    log: none of an estimate alone. tracks: the second, on top of all, is compared with the first.
    keys, labels, ratio: (m,) of the marked landmarks: what tables know them by, their labels, and
    the least variance of the second over the first's. names: of those that have another name than
    their key and stand in no table. view: points (N, 2) that must be seen; tracks
    widen the map unless they are far away. beneath, above: what else is drawn. errors: of tracks,
    by their names, and of other paths.
    """

    log: Log | None
    tracks: Sequence[Track]
    keys: Sequence[object] = ()
    labels: Sequence[str] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    ratio: Array = field(default_factory=lambda: np.empty(0))
    view: Sequence[Array]
    beneath: Sequence[Draws] = ()
    above: Sequence[Draws] = ()
    errors: Sequence[TrackErrors] = ()


def estimate_map(
    log: Log | None,
    name: str,
    colour: str,
    estimate: Estimate,
    *others: Track,
    cloud: tuple[str, Array] | None = None,
) -> MapContent:
    """One estimate with its landmarks, beside the paths of others.

    cloud: a name and points (N, 2) that lie beneath.
    """
    marked = farthest(np.zeros(len(estimate.landmark)))
    ids = estimate.landmark_id[marked]
    beneath = [*all_landmarks("all landmarks", estimate.landmark, marked)]
    names = dict(zip(ids.tolist(), [estimate.names[i] for i in marked.tolist()], strict=True))
    view = [estimate.pose[:, :2], estimate.landmark, estimate.pose_landmarks[:, :2]]
    if cloud is not None:
        said, points = cloud
        beneath.append(lambda drawing: drawing.dots(said, SCANS_COLOUR, points))
        view.append(points)
    return MapContent(
        log=log,
        tracks=[estimate_track(name, colour, estimate, ids), *others],
        keys=ids.tolist(),
        labels=[f"landmark {name}" for name in names.values()],
        names={str(key): name for key, name in names.items() if name != str(key)},
        view=view,
        beneath=beneath,
    )


@dataclass(frozen=True, kw_only=True)
class DrawnMap:
    """The drawing, and data for the script.

    times: [s] of each track's points, by its name. spreads: of those with covariances the variance
    to the east, the covariance and the variance to the north [m^2] of every point. decades: the
    colours of the variance ratio end at 10 to the power of so much, either way. outside: tracks
    that lie off the map, in part.
    """

    drawing: Drawing
    times: dict[str, list[float]]
    spreads: dict[str, list[list[float | None]]]
    decades: float
    outside: list[str]


def draw_map(c: MapContent) -> DrawnMap:
    """Draw it. Layers come in the order in which they lie upon each other."""
    drawing, outside = _bounded(c)
    if c.log is not None:
        _known(drawing, c.log)
    for draw in c.beneath:
        draw(drawing)
    times, spreads = {}, {}
    for track in (*c.tracks[:1], *c.tracks[2:], *c.tracks[1:2]):
        row = np.flatnonzero(np.isfinite(track.pose).all(axis=1))
        row = row[kept(len(row))]
        name, colour = track.name, track.colour
        path = track.pose[row, :2]
        drawing.path(f"{name} trajectory", colour, path, track.dashes, name)
        times[name] = np.round(track.time_s[row], 3).tolist()
        if track.pose_covariance is not None and len(track.pose_covariance):
            east, north = (0, 0, 1), (0, 1, 1)
            spreads[name] = [short(one) for one in track.pose_covariance[row][:, east, north].T]
        if track.landmark is not None and np.isfinite(track.landmark).any():
            reported = [f"{name}, {label}" for label in c.labels]
            if track.landmark_covariance is not None:
                outline = ellipses(track.landmark, track.landmark_covariance, _SIGMAS, 32)
                drawing.outlines(f"{name} landmarks, 3 sigma", colour, outline, reported)
            drawing.marks(f"{name} landmarks", colour, track.landmark, reported, c.keys)
    for number, errors in enumerate(c.errors):
        if errors.name in times:
            draw_errors(drawing, errors, np.array(times[errors.name]), number)
    for draw in c.above:
        draw(drawing)
    return DrawnMap(
        drawing=drawing,
        times=times,
        spreads=spreads,
        decades=_differences(drawing, c),
        outside=outside,
    )


def _bounded(c: MapContent) -> tuple[Drawing, list[str]]:
    """An empty map over what must be seen and what is near it, and what is not."""
    walls = _walls(c.log)
    drawing = Drawing.of(*c.view, walls[:, :2], walls[:, 2:])
    low, high = drawing.bounds[:2], drawing.bounds[2:]
    reach = _FAR * float((high - low).max())
    near, outside = [walls[:, :2], walls[:, 2:], *c.view], []
    for track in c.tracks:
        place = track.pose[np.isfinite(track.pose).all(axis=1), :2]
        within = ((place >= low - reach) & (place <= high + reach)).all(axis=1)
        near.append(place[within])
        if not within.all():
            outside.append(track.name)
    return Drawing.of(*near), outside


def _walls(log: Log | None) -> Array:
    surfaces = None if log is None else log.truth.surfaces
    return np.empty((0, 4)) if surfaces is None else surfaces.segment


def known_points(log: Log) -> list[Array]:
    """Return points (N, 2) that the log knows without its sensors: truth and positions."""
    poses, landmarks, positions = log.truth.poses, log.truth.landmarks, log.positions
    found = [] if poses is None else [poses.pose[:, :2]]
    found += [one.position_m for one in (landmarks, positions) if one is not None]
    return found


def _known(drawing: Drawing, log: Log) -> None:
    """Truth and positions."""
    truth, walls = log.truth, _walls(log)
    if len(walls):
        drawing.links("true surfaces", "#9a9a9a", walls[:, :2], walls[:, 2:])
    if truth.poses is not None:
        drawing.path("truth", "#9a9a9a", truth.poses.pose[:, :2])
    if truth.landmarks is not None:
        drawing.dots("true landmarks", "#9a9a9a", truth.landmarks.position_m)
    if log.positions is not None:
        drawing.dots("GPS", "#b08d57", log.positions.position_m)


def _differences(drawing: Drawing, c: MapContent) -> float:
    """Lines between the landmarks of the first two, and variance ratios; return its decades."""
    first, second, *_ = *(track.landmark for track in c.tracks[:2]), None, None
    decades = _decades(c.ratio)
    if first is None or second is None:
        return decades
    drawing.links("differences", "#7b4fa3", second, first)
    if np.isfinite(c.ratio).any():
        pairs = zip(c.labels, c.ratio.tolist(), strict=True)
        reported = [f"{label}; variance ratio {ratio:.3g}" for label, ratio in pairs]
        colours = ratio_colours(c.ratio, decades)
        look = ("variance ratio, least", "#666666")
        drawing.marks(*look, second, reported, c.keys, colours, _RATIO_LEGEND)
    return decades


def ratio_colours(ratio: Array, decades: float) -> list[str]:
    """Of variance ratios (n,), on a logarithmic scale from 10^-decades to 10^decades."""
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.clip(np.log10(ratio) / decades, -1.0, 1.0)
    stops = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in _RATIO_COLOURS])
    at = np.linspace(-1.0, 1.0, len(stops))
    mixed = np.column_stack([np.interp(place, at, stops[:, i]) for i in range(3)])
    usable = np.isfinite(ratio) & (ratio > 0.0)
    return [
        "#{:02x}{:02x}{:02x}".format(*np.rint(colour).astype(int).tolist()) if good else _NO_RATIO
        for colour, good in zip(mixed, usable.tolist(), strict=True)
    ]


def ratio_legend(decades: float) -> str:
    """The colours of the variance ratio with their figures."""
    place = np.linspace(-decades, decades, 41)
    colours = ratio_colours(10.0**place, decades)
    words = [f"{10.0 ** (share * decades):.2g}" for share in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    ends = ("the filter is too sure", "too careful")
    return colour_bar(_RATIO_LEGEND, "variance ratio", colours, words, ends)


def _decades(ratio: Array) -> float:
    usable = ratio[np.isfinite(ratio) & (ratio > 0.0)]
    most = float(np.abs(np.log10(usable)).max(initial=0.0))
    return min(max(float(np.ceil(2.0 * most)) / 2.0, _LEAST_DECADES), _MOST_DECADES)


def associations(estimate: Estimate, epoch: Index, landmark_index: Index) -> Draws:
    """A line from the pose to the landmark for each measurement that is used.

    epoch, landmark_index: (M,) of the measurements; a landmark index below 0 is not used.
    """
    used = np.flatnonzero(landmark_index >= 0)
    row = used[np.round(np.linspace(0, len(used) - 1, min(len(used), MOST_LINES))).astype(int)]
    look = ("associations", "#8a8a8a")
    return lambda drawing: association_lines(
        drawing, look, estimate, epoch[row], landmark_index[row]
    )


def all_landmarks(name: str, place: Array, marked: Index) -> Sequence[Draws]:
    """Landmarks (L, 2) as dots where there are more than those that are marked (m,)."""
    if len(marked) >= len(place):
        return ()
    return (lambda drawing: drawing.dots(name, "#666666", place),)


def farthest(distance: Array) -> Index:
    """Return the landmarks (m,) that the page has: all of (L,), or those farthest apart in sigma.

    distance: NaN where there is nothing to compare, which counts as far.
    """
    if len(distance) <= MOST_LANDMARKS:
        return np.arange(len(distance))
    order = np.argsort(-np.nan_to_num(distance, nan=np.inf), kind="stable")
    return np.sort(order[:MOST_LANDMARKS])
