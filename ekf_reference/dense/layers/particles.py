"""Weighted samples of occupied places (Nieto 2005, section 4.2)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.layers.association import associate, doubled
from ekf_reference.dense.layers.layer import Hits
from ekf_reference.dense.layers.points import PointLayer
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan
from ekf_reference.dense.sensor_model import InverseSensorModel, log_odds, probability
from ekf_reference.dense.triangles import solve


class Particles(PointLayer):
    """Samples drawn around the returns; a weight is how likely its place is occupied.

    per_return: samples drawn of each return. d_min_m: samples closer than that are of the same
    state (Nieto 2005, eq. 4.10); others are added. confidence: weights stay between 1 - confidence
    and confidence. least: particles of a smaller weight are dropped, 0 to keep them. thinned: so
    are those that have come to lie on a heavier one, so that their number levels off in a static
    scene; the thesis' maps are not subsampled.

    Erratum: in the normaliser of 4.11 stand the prior and the likelihood of the new sample i; for
    its terms to add up to one they are the prior of the old particle j that is updated, and the
    likelihood of the new observation for each of the two states.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        per_return: int = 2,
        d_min_m: float = 0.2,
        model: InverseSensorModel | None = None,
        confidence: float = 0.98,
        least: float = 0.3,
        *,
        thinned: bool = True,
    ) -> None:
        """Raises ValueError for a number of samples or a distance that is not above zero."""
        if per_return < 1:
            raise ValueError(f"{per_return} samples per return, they must be above zero")
        super().__init__(3, d_min_m)
        self.per_return, self.thinned = per_return, thinned
        self.model = model or InverseSensorModel()
        self._rng = rng
        self._most = float(log_odds(confidence))
        self._least = float(log_odds(least)) if least > 0.0 else -np.inf

    def fuse(self, hits: Hits, placed: RegionsAtMap, scan: Scan | None, near: Index) -> None:
        """Update the particles near new samples and those in free space, then add the others."""
        drawn, drawn_odds = self.sampled(hits, scan)
        old, where = self._placed(placed, np.union1d(near, hits.region))
        pair = associate(where, drawn, self._reach_m)
        triangle = placed.triangle[old.region[pair.old]]
        old.value[pair.old, :2] += solve(triangle, drawn[pair.new])
        old.value[pair.old, :2] *= 0.5
        old.value[pair.old, 2] += drawn_odds[pair.new]  # 4.11
        if scan is not None:
            rest = np.ones(len(where), dtype=bool)
            rest[pair.old] = False
            row = np.flatnonzero(rest)
            old.value[row, 2] += self.free_space(scan, where.take(row, axis=0))
        np.clip(old.value[:, 2], -self._most, self._most, out=old.value[:, 2])
        self._store.put(old)
        kept = old.value[:, 2] >= self._least
        if self.thinned:
            kept[doubled(pair, self._reach_m, old.value[pair.old, 2])] = False
        self._store.keep(old, kept)
        row = np.flatnonzero(~pair.met)
        region = np.repeat(hits.region, self.per_return)[row]
        local = solve(placed.triangle[region], drawn[row])
        self._store.append(region, np.column_stack((local, drawn_odds[row])))  # 4.12

    def sampled(self, hits: Hits, scan: Scan | None) -> tuple[Array, Array]:
        """Samples (N k, 2) [m] of the sensor model of returns, and the log-odds (N k,) of each.

        Source: Nieto 2005, eqs. 4.1, 4.2, 4.8 and 4.9. The k samples of a return follow each other.
        A late return's direction is not known: its samples are weighed by how far off they are,
        never as free.
        """
        ray = np.broadcast_to(np.array((1.0, 0.0)), hits.point.shape)
        if scan is not None:
            ray = hits.point - scan.origin
            ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
        turn = np.stack((ray, np.stack((-ray[:, 1], ray[:, 0]), axis=1)), axis=1)  # to the ray
        root = np.linalg.cholesky(turn @ hits.covariance @ turn.transpose(0, 2, 1))
        sigmas = self._rng.standard_normal((len(ray), self.per_return, 2))
        point = hits.point[:, None] + sigmas @ (turn.transpose(0, 2, 1) @ root).transpose(0, 2, 1)
        ahead, off = -sigmas[..., 0].ravel(), sigmas[..., 1].ravel()
        if scan is None:
            weight = replace(self.model, with_bearing=True).probability(-np.abs(ahead), off, 1, 1)
        else:
            weight = self.model.probability(ahead, off, 1.0, 1.0)
        return point.reshape(-1, 2), log_odds(weight)

    def free_space(self, scan: Scan, point: Array) -> Array:
        """(N,) log-odds, none above zero, that a scan adds to points (N, 2) [m] before its returns.

        What keeps an object that has gone from staying in the map (Nieto 2005, section 4.2.2).
        """
        met = scan.beams(point)
        row = np.flatnonzero(met.seen & (met.ahead_m > 0.0))
        sensor = scan.sensor
        weight = self.model.probability(
            met.ahead_m[row], met.off_rad[row], sensor.sigma_range_m, sensor.sigma_bearing_rad
        )
        change = np.zeros(len(point))
        change[row] = np.minimum(log_odds(weight), 0.0)
        return change

    def _occupied(self, value: Array) -> Array:
        """Particles are as occupied as they weigh."""
        return np.asarray(probability(value[:, 2]))
