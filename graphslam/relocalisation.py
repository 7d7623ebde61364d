"""Which landmark of a map a scan's measurements are of, when all likely joint hypotheses agree."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from graphslam.arrays import Array, Index
from graphslam.running_estimate import RunningEstimate, wrapped

UNSEEN, PENDING = -1, -2
"""Not used, for it could be of several landmarks; not explained by any landmark, so far."""


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
    longest = float(z[:, 0].max())
    p = running_estimate.covariance.diagonal()
    reach = longest + 5.0 + 4.0 * (math.sqrt(p[0] + p[1]) + longest * math.sqrt(p[2]))
    near = running_estimate.near(reach)
    if not len(near):
        return result
    expected = running_estimate.expect(near)
    spread = running_estimate.spread(near, expected.jacobian)
    which = np.arange(len(near))
    blocks = spread.reshape(len(near), 2, len(near), 2)[which, :, which, :]
    nu = wrapped(z[:, None] - expected.z[None])
    s = blocks[None] + noise[:, None, :, None] * np.eye(2)
    nis = np.einsum("mli,mlij,mlj->ml", nu, np.linalg.inv(s), nu)
    chosen = _decide(nis, nis + np.linalg.slogdet(s)[1], nu, spread, noise, o)
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
    group, first = np.zeros(len(z), dtype=np.intp), place[:1]
    for k in range(1, len(z)):
        distance = np.linalg.norm(first - place[k], axis=1)
        group[k] = distance.argmin()
        if distance[group[k]] > within_m:
            group[k], first = len(first), np.vstack((first, place[k]))
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
    beam: list[tuple[float, tuple[int, ...], list[tuple[int, int]]]] = [(0.0, (), [])]
    for row in rows.tolist():
        grown = [(cost + cost_of_new, (*c, -1), pairs) for cost, c, pairs in beam]
        for _, choice, pairs in beam:
            fresh = cost_of_new * choice.count(-1)
            for column in np.flatnonzero(possible[row]).tolist():
                joint = [*pairs, (row, column)]
                grown.append((fresh + _cost(joint, nu, spread, noise), (*choice, column), joint))
        beam = sorted(grown)[: o.most_hypotheses]
    likely = [c for cost, c, _ in beam if cost <= beam[0][0] + doubt]
    for i, row in enumerate(rows.tolist()):
        said = {choice[i] for choice in likely}
        if len(said) == 1:
            chosen[row] = said.pop()
    return chosen


def _cost(pairs: list[tuple[int, int]], nu: Array, spread: Array, noise: Array) -> float:
    """Joint nis + ln |S| of pairings (measurement, landmark)."""
    rows, columns = (np.array(side) for side in zip(*pairs, strict=True))
    entries = (2 * columns[:, None] + (0, 1)).ravel()
    s = spread[np.ix_(entries, entries)] + np.diag(noise[rows].ravel())
    innovation = nu[rows, columns].ravel()
    return float(innovation @ np.linalg.solve(s, innovation) + np.linalg.slogdet(s)[1])
