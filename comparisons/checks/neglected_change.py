"""How much a dense map loses by keeping local coordinates for good (Nieto 2005, section 3.6).

One dense point per region stands for its data: seen once, near the middle of the region, with the
scanner's noise. What later scans would have done to it is told in four ways: by eq. 3.16 summed
up beside the filter, by a filter that has the points in its state, by the truth, and by the error
layer, which has to say it beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.runs.watched_run import watched_run
from ekf_reference.dense.conditions import Conditions
from ekf_reference.dense.neglected import NeglectedCorrelation
from ekf_reference.dense.passive_states import PassiveStates, local_coordinates, points
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.triangles import axes, to_local
from ekf_reference.dense.view import FilterView
from ekf_reference.observation import RangeBearing

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_FIRST_LABEL = 1_000_000
"""Of dense points in the state; log labels lie below."""


class Look(NamedTuple):
    """Dense points of regions (k,) at z (k, 2) range and bearing, seen at one time."""

    time_s: float
    region: Index
    z: Array


@dataclass(frozen=True)
class NeglectedChange:
    """Changes in metres along a region's axes, as they were when its point was seen; (R, 2) each.

    predicted: eq. 3.16 summed. observed: of alpha and beta in a filter that has the points in its
    state. error: alpha and beta by truth minus those that a dense map keeps. sigma_m: (R,) from
    the error layer. time_s: (R,) when seen.
    """

    predicted: Array
    observed: Array
    error: Array
    sigma_m: Array
    time_s: Array

    @property
    def agreement(self) -> float:
        """Correlation coefficient of predicted and observed changes."""
        return correlation(self.predicted, self.observed)

    @property
    def explained(self) -> float:
        """Correlation coefficient of predicted changes and true errors."""
        return correlation(self.predicted, self.error)

    @property
    def in_sigmas(self) -> Array:
        """(R,) size of the observed change over the error layer's sigma."""
        size: Array = np.linalg.norm(self.observed, axis=1) / self.sigma_m
        return size


def correlation(first: Array, second: Array) -> float:
    """Correlation coefficient of changes (R, 2) and (R, 2), about zero: none is the null."""
    return float((first * second).sum() / np.sqrt(np.square(first).sum() * np.square(second).sum()))


def neglected_change(
    log: Log,
    sigma: tuple[float, float],
    rng: np.random.Generator,
    conditions: Conditions | None = None,
    reach_m: float = 25.0,
) -> NeglectedChange:
    """Drive a simulated log twice: with the points beside the filter, and with them in it.

    sigma: of range [m] and bearing [rad] of a dense point. reach_m: a region's point is seen at
    the first scan that has it ahead, within this distance. Regions that never are, are left out.
    Raises InputError for a log without truth or labels.
    """
    if log.truth.poses is None or log.truth.landmarks is None or not log.sightings.labelled:
        raise InputError(f"{log.name}: true poses, true landmarks and labels are needed")
    labels, first = np.unique(log.sightings.landmark, return_index=True)
    row = np.searchsorted(log.truth.landmarks.id, labels[np.argsort(first)])
    true_landmark = log.truth.landmarks.position_m[row]  # by place in the map
    noise = np.diag(np.square(sigma))
    regions, layer, looks = LocalRegions(conditions or Conditions()), NeglectedCorrelation(), []
    passive, scale, true_local = None, np.empty((0, 2, 2)), np.empty((0, 2))
    for time, ekf in watched_run(log):
        passive = passive or PassiveStates(ekf)
        view = FilterView.of(ekf)
        near = view.near(reach_m + 10.0)
        regions.extend(view.landmark, near, view.joint_of_landmarks(near))
        known = np.concatenate([np.empty(0, dtype=np.intp), *(look.region for look in looks)])
        wanting = np.setdiff1d(np.arange(len(regions.base)), known)
        triangle = true_landmark[regions.base[wanting]]
        centre = triangle.mean(axis=1)
        z = RangeBearing().predict(log.truth.poses.at(np.array([time]))[0], centre).z
        z[:, 1] = np.angle(np.exp(1j * z[:, 1]))
        ahead = (z[:, 0] <= reach_m) & (np.abs(z[:, 1]) <= np.pi / 2)
        if not ahead.any():
            continue
        seen_z = z[ahead] + sigma * rng.standard_normal((ahead.sum(), 2))
        look = Look(time, wanting[ahead], seen_z)
        base = regions.base[look.region]
        each = np.broadcast_to(noise, (len(base), 2, 2))
        seen = points(ekf.observation, view.pose, look.z, each)
        passive.watch(local_coordinates(seen, base, view.landmark))
        layer.note(view, regions.base, look.region, seen.value)
        looks.append(look)
        scale = np.concatenate((scale, np.stack(axes(view.landmark[base]), axis=-1)))
        true_local = np.concatenate((true_local, to_local(triangle[ahead], centre[ahead])))
    if passive is None or not looks:
        raise InputError(f"{log.name}: no region came into view")
    region = np.concatenate([look.region for look in looks])
    final = _in_the_state(log, looks, sigma, regions.base[region])

    def metres(change: Array) -> Array:
        along: Array = (scale @ change[..., None])[..., 0]
        return along

    return NeglectedChange(
        metres(passive.change),
        metres(final - passive.begun),
        metres(true_local - passive.begun),
        layer.sigma_m(region),
        np.repeat([look.time_s for look in looks], [len(look.region) for look in looks]),
    )


def _in_the_state(log: Log, looks: list[Look], sigma: tuple[float, float], base: Index) -> Array:
    """Alpha and beta (R, 2) at the end, of a filter that has the points in its state.

    Since nothing sights them again, it says the same of everything else.
    """
    at = {look.time_s: look for look in looks}
    dense = []
    for time, ekf in watched_run(log):
        if time in at:
            look = at[time]
            stated = np.tile(sigma, (len(look.z), 1))
            dense.append(ekf.observe(look.z, stated, _FIRST_LABEL + look.region, time))
    slot, landmark = np.concatenate(dense), ekf.state.landmarks
    own = np.setdiff1d(np.arange(len(landmark)), slot)
    return to_local(landmark[own][base], landmark[slot])
