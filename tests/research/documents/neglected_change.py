"""How much a dense map loses by keeping local coordinates for good (Nieto 2005, section 3.6).

One dense point per region stands for its data: seen once, near the middle of the region, with the
scanner's noise. What later scans would have done to it is computed in four ways: by eq. 3.16 summed
up beside the filter, by a filter that has the points in its state, by the truth, and by the error
layer, which has to say it beforehand.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.errors import InputError
from comparisons.logs.log import Log
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.landmark_types import POINT
from ekf_reference.dense.conditions import Conditions
from ekf_reference.dense.neglected_correlation import NeglectedCorrelation
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.triangles import axes, to_local
from ekf_reference.dense.view import FilterView
from ekf_reference.models.range_bearing import RangeBearing
from research.documents.drives import truth_in_order, watched_run
from tests.ekf_reference.dense.passive_states import PassiveStates, local_coordinates, points

_FIRST_LABEL = 1_000_000
"""Of dense points in the state; log labels lie below."""


class Look(NamedTuple):
    """Dense points of regions (k,) at z (k, 2) range and bearing, seen at one time."""

    time_s: float
    region: Index
    z: Array


@dataclass(frozen=True)
class NeglectedChange:
    """Changes of alpha and beta times a region's axes when its point was seen: (R, 2) [m] each.

    East and north, as the world lay then. predicted: eq. 3.16 summed. observed: in a filter that
    has the points in its state. error: by truth, minus what a dense map keeps. sigma_m: (R,) from
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
    def slope(self) -> float:
        """Error per predicted change: 1 where later scans take away what they claim to."""
        return float((self.predicted * self.error).sum() / np.square(self.predicted).sum())

    @property
    def expected(self) -> float:
        """What `explained` comes to at a slope of 1, what later scans leave being independent."""
        return float(np.sqrt(np.square(self.predicted).sum() / np.square(self.error).sum()))

    @property
    def observed_m(self) -> Array:
        """(R,) sizes of the observed changes."""
        size: Array = np.linalg.norm(self.observed, axis=1)
        return size

    @property
    def in_sigmas(self) -> Array:
        """(R,) sizes of the observed changes over the error layer's sigma."""
        return self.observed_m / self.sigma_m


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
    true_pose, true_landmark = truth_in_order(log)
    noise, looks = np.diag(np.square(sigma)), list[Look]()
    regions = LocalRegions(conditions=conditions or Conditions())
    layer = NeglectedCorrelation(regions)
    passive, axes_then, true_local = None, list[Array](), list[Array]()
    for time, ekf in watched_run(log):
        passive = passive or PassiveStates(ekf)
        view = FilterView.of(ekf)
        near = view.near(reach_m + 10.0)
        regions.extend(view.landmark, near, view.joint(near)[3:, 3:])
        waiting = np.setdiff1d(np.arange(len(regions.base)), _regions(looks))
        centre = true_landmark[regions.base[waiting]].mean(axis=1)
        exact = _measured(true_pose.at(np.array([time]))[0], centre)
        ahead = (exact[:, 0] <= reach_m) & (np.abs(exact[:, 1]) <= np.pi / 2)
        region, exact, centre = waiting[ahead], exact[ahead], centre[ahead]
        if not len(region):
            continue
        look = Look(time, region, exact + sigma * rng.standard_normal(exact.shape))
        base = regions.base[region]
        each = np.broadcast_to(noise, (len(base), 2, 2))
        seen = points(ekf.models[POINT], view.pose, look.z, each)
        passive.watch(local_coordinates(seen, base, view.landmark))
        layer.note(view, region, seen.value)
        looks.append(look)
        axes_then.append(np.stack(axes(view.landmark[base]), axis=-1))
        true_local.append(to_local(true_landmark[base], centre))
    if passive is None or not looks:
        raise InputError(f"{log.name}: no region came into view")
    region, along = _regions(looks), np.concatenate(axes_then)
    final = _in_the_state(log, looks, sigma, regions.base[region])

    def metres(change: Array) -> Array:
        moved: Array = (along @ change[..., None])[..., 0]
        return moved

    return NeglectedChange(
        metres(passive.change),
        metres(final - passive.initial),
        metres(np.concatenate(true_local) - passive.initial),
        layer.sigma_m(region),
        np.concatenate([np.full(len(look.region), look.time_s) for look in looks]),
    )


def _measured(pose: Array, point: Array) -> Array:
    """Exact range and bearing (k, 2) of points (k, 2) from pose (3,)."""
    z = RangeBearing().predict(pose, point).z
    return np.column_stack((z[:, 0], wrap_angle(z[:, 1])))


def _regions(looks: list[Look]) -> Index:
    return np.concatenate((np.empty(0, dtype=np.intp), *(look.region for look in looks)))


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
    landmark_index, landmark = np.concatenate(dense), ekf.state.landmarks
    own = np.setdiff1d(np.arange(len(landmark)), landmark_index)
    return to_local(landmark[own][base], landmark[landmark_index])
