"""Which landmark of a map a scan's measurements are of, when all likely joint hypotheses agree."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from graphslam.arrays import Array, Index, Mask
from graphslam.running_estimate import RunningEstimate, wrapped

UNSEEN, PENDING = -1, -2
"""Not used, for it could be of several landmarks; not explained by any landmark, so far."""
_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True)
class Options:
    """What counts as the same, as possible, and as certain.

    gate, new_gate: normalised innovation squared up to which a pairing is possible, and beyond
    which a landmark is out of the question. odds: a joint hypothesis counts until the best is so
    many times likelier. new_density: landmarks expected that are not in the map, per m and rad.
    resolution_m: what stands nearer together than this is one landmark. measurements, spread_m: so
    many within such a root mean square distance make a landmark. piece: poses between two
    solutions. most_hypotheses: that are followed at a time.
    """

    gate: float = 13.8
    new_gate: float = 25.0
    odds: float = 60.0
    new_density: float = 1e-3
    resolution_m: float = 0.75
    measurements: int = 5
    spread_m: float = 0.5
    piece: int = 60
    first_piece: int = 60
    most_hypotheses: int = 60


def relocalise(running_estimate: RunningEstimate, z: Array, variance: Array, o: Options) -> Index:
    """Landmark index (m,) of each measurement (m, 2) with variances (m, 2), else UNSEEN or PENDING.

    The running estimate is narrowed by what is recognised. Measurements within the resolution of
    each other
    count as one, with the noise of one: what puts one of them wrong puts the next one wrong, too.
    """
    result = np.full(len(z), PENDING, dtype=np.intp)
    group, z = _grouped(z, o.resolution_m)
    share = np.equal.outer(np.arange(len(z)), group) / np.bincount(group)[:, None]
    noise = share @ variance + extent(z, o)
    near = running_estimate.near(running_estimate.reach_m(float(z[:, 0].max())))
    if not len(near):
        return result
    expected = running_estimate.expect(near)
    spread = running_estimate.spread(near, expected.jacobian)
    nu = wrapped(z[:, None] - expected.z[None])
    variance = spread.diagonal().reshape(-1, 2) + noise[:, None]
    nis, log_det = _misfit(nu, variance, spread.diagonal(1)[::2])
    chosen = _decide(nis, nis + log_det, nu, spread, noise, o)
    result[((nis.min(axis=1) <= o.new_gate) & (chosen < 0))[group]] = UNSEEN
    found = np.flatnonzero(chosen >= 0)
    if len(found):
        running_estimate.learn(near[chosen[found]], z[found], noise[found])
        result = np.where(chosen[group] >= 0, near[chosen][group], result)
    return result


def extent(z: Array, o: Options) -> Array:
    """(m, 2) variance of range and bearing by where in a disc of the resolution the thing is."""
    return (o.resolution_m**2 / 16.0) * np.stack((np.ones(len(z)), 1.0 / z[:, 0] ** 2), axis=1)


def _grouped(z: Array, within_m: float) -> tuple[Index, Array]:
    """Group (m,) of each measurement, by the nearest first member within reach; means (g, 2)."""
    place = z[:, :1] * np.column_stack((np.cos(z[:, 1]), np.sin(z[:, 1])))
    apart = np.linalg.norm(place[:, None] - place, axis=2)
    group, first = np.zeros(len(z), dtype=np.intp), [0]
    for k in range(1, len(z)):
        nearest = int(apart[k, first].argmin())
        group[k] = nearest if apart[k, first[nearest]] <= within_m else len(first)
        if group[k] == len(first):
            first.append(k)
    count = np.bincount(group)
    mean = np.column_stack([np.bincount(group, place[:, i]) / count for i in (0, 1)])
    return group, np.column_stack((np.hypot(*mean.T), np.arctan2(mean[:, 1], mean[:, 0])))


def _decide(
    nis: Array, surprise: Array, nu: Array, spread: Array, noise: Array, o: Options
) -> Index:
    """Column (m,) of the landmark that all likely hypotheses agree on, -1 without one."""
    cost_of_new, doubt = -2.0 * math.log(2.0 * math.pi * o.new_density), 2.0 * math.log(o.odds)
    possible = nis <= o.gate
    chosen = np.full(len(nis), -1, dtype=np.intp)
    rows = np.flatnonzero(possible.any(axis=1))
    if not len(rows):
        return chosen
    targets = nis[rows].argmin(axis=1)
    plain = possible[rows].sum(axis=1) == 1
    plain &= surprise[rows, targets] + doubt < cost_of_new
    if plain.all():
        chosen[rows] = targets
        return chosen
    likely = _likely(possible[rows], targets, (nu[rows], spread, noise[rows]), o)
    agreed = (likely == likely[0]).all(axis=0)
    chosen[rows[agreed]] = likely[0, agreed]
    return chosen


def _likely(possible: Mask, targets: Index, seen: tuple[Array, Array, Array], o: Options) -> Index:
    """(H, m) columns, -1 for a new landmark, that the likely joint hypotheses give to measurements.

    A hypothesis costs nis + ln |S| of its pairings, jointly, and a constant for what is new. It
    grows by one measurement at a time: nis and S are those given the pairings before. What would
    end too far above `targets` (m,), were all that is to come explained exactly, is dropped.

    possible: (m, n). seen: nu, spread, noise, as in relocalise.
    """
    cost_of_new, doubt = -2.0 * math.log(2.0 * math.pi * o.new_density), 2.0 * math.log(o.odds)
    nu, spread, noise = seen
    columns = np.flatnonzero(possible.any(axis=0))
    entries = _entries(columns)
    least = np.minimum(np.log(noise).sum(axis=1), cost_of_new)
    bound = _cost(targets, nu, spread, noise) + doubt - least.sum() + _ROUNDING
    beam = _Beam(
        np.zeros(1),
        np.zeros((1, 0), dtype=np.intp),
        np.zeros((1, len(entries))),
        spread[np.ix_(entries, entries)][None],
    )
    for i, row in enumerate(possible):
        own = np.flatnonzero(row[columns])
        bound += least[i]
        beam = _grown(
            beam, own, (nu[i, columns], noise[i]), cost_of_new, (bound, o.most_hypotheses)
        )
    likely: Index = np.append(columns, -1)[beam.choice[beam.cost <= beam.cost.min() + doubt]]
    return likely


class _Beam(NamedTuple):
    """H hypotheses about the first measurements, the most likely first.

    cost: (H,). choice: (H, i) landmarks of u, -1 for a new one. shift, covariance: (H, 2 u) and
    (H, 2 u, 2 u) of what all u would be measured as, given this.
    """

    cost: Array
    choice: Index
    shift: Array
    covariance: Array


def _grown(
    beam: _Beam,
    own: Index,
    seen: tuple[Array, Array],
    cost_of_new: float,
    limits: tuple[float, int],
) -> _Beam:
    """The hypotheses with one more measurement, up to a cost and a number.

    own: the landmarks of u that it may be of. seen: its innovations (u, 2) and noise (2,).
    """
    nu, noise = seen
    entries = _entries(own)
    nu_given = (nu[own].ravel() - beam.shift[:, entries]).reshape(-1, len(own), 2)
    variance = beam.covariance[:, entries, entries].reshape(-1, len(own), 2) + noise
    nis, log_det = _misfit(nu_given, variance, beam.covariance[:, 2 * own, 2 * own + 1])
    cost = beam.cost[:, None] + np.column_stack((nis + log_det, np.full(len(nis), cost_of_new)))
    best = np.argsort(cost, axis=None, kind="stable")[: limits[1]]
    best = best[cost.ravel()[best] <= limits[0]]
    parent, which = np.divmod(best, cost.shape[1])
    landmark: Index = np.append(own, -1)[which]
    shift, covariance = beam.shift[parent], beam.covariance[parent]
    paired = np.flatnonzero(landmark >= 0)
    pair = _entries(landmark[paired]).reshape(-1, 2)
    rows = covariance[paired[:, None], pair]
    s = np.take_along_axis(rows, pair[:, None], axis=2) + np.diag(noise)
    gain = np.linalg.solve(s, rows)
    innovation = nu[landmark[paired]] - np.take_along_axis(shift[paired], pair, axis=1)
    shift[paired] += (innovation[:, None] @ gain)[:, 0]
    covariance[paired] -= rows.transpose(0, 2, 1) @ gain
    choice = np.column_stack((beam.choice[parent], landmark))
    return _Beam(cost.ravel()[best], choice, shift, covariance)


def _misfit(nu: Array, variance: Array, covariance: Array) -> tuple[Array, Array]:
    """Nis and ln |S| of innovations (..., 2), of variance (..., 2) and covariance (...)."""
    det = variance[..., 0] * variance[..., 1] - covariance**2
    r, bearing = nu[..., 0], nu[..., 1]
    nis = r**2 * variance[..., 1] - 2.0 * covariance * r * bearing + bearing**2 * variance[..., 0]
    return nis / det, np.log(det)


def _cost(columns: Index, nu: Array, spread: Array, noise: Array) -> float:
    """Joint nis + ln |S| of measurements of the landmarks in columns (m,)."""
    entries = _entries(columns)
    s = spread[np.ix_(entries, entries)] + np.diag(noise.ravel())
    innovation = nu[np.arange(len(columns)), columns].ravel()
    return float(innovation @ np.linalg.solve(s, innovation) + np.linalg.slogdet(s)[1])


def _entries(columns: Index) -> Index:
    """(2 n,) where the measurements of landmarks (n,) stand."""
    return (2 * columns[:, None] + (0, 1)).ravel()
