"""Normalised innovations squared, and whether innovations are white, per sensor.

Measurements of one instant share the pose's error, so the filter whitens them together: with
S = L L^T of the stacked innovation nu, L^-1 nu holds independent standard normal numbers if the
filter is consistent, within an instant and over time. A measurement's range is then judged given
the measurements fused before it at that instant, and its bearing given its range as well. Each
squared has one degree of freedom, and the averages over a whole run have an exact band.

What a gate rejects is missing: with a gate at 99 % the average of a consistent filter is 4 % low.
Association by distance shortens innovations, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.checks.consistency.normalised import Band, faults, mean_band
from comparisons.checks.quantiles import chi2_tail
from ekf_reference.core.landmark_types import POINT

LAGS = 10
_LEAST_PAIRS = 20
"""An autocorrelation from fewer products is not looked at."""
_PER_LAG = 20
"""So many numbers are asked for each lag: with more lags the statistic's tail is not chi-square's.
Of 40 numbers at 10 lags, 0.6 % of white series have a p-value below 0.1 %; at 2 lags 0.13 %."""
_WINDOWS = 60
"""So many averages over a run are drawn."""


@dataclass(frozen=True)
class Nis:
    """An average of `count` normalised innovations squared, each with `dof`, and its 95 % band."""

    name: str
    dof: int
    count: int
    mean: float
    band: Band

    @property
    def reading(self) -> str:
        """`plausible`, `too high`: the filter is too sure, or `too low`."""
        return self._reading(self.band)

    def worded(self, outside: float) -> tuple[str, Band]:
        """Return the reading by the band that so many sound runs leave, and that band."""
        band = mean_band(self.count, self.dof, outside)
        return self._reading(band), band

    def _reading(self, band: Band) -> str:
        if band.holds(self.mean):
            return "plausible"
        return "too low" if self.mean < band.low else "too high"


@dataclass(frozen=True, kw_only=True)
class Whiteness:
    """Autocorrelation of a standardised component at lags 1 to k, and its average.

    order: `time`, one number per instant, the sum of its n numbers over root n: correlated when
    something lasts, a bias of the sensor, coloured noise of the motion, a wrong heading.
    `landmark`, from one measurement of a landmark to the next, with all landmarks pooled:
    correlated when the filter is overconfident of landmarks, for each then has a lasting
    error.
    coefficient, band: (k,), the band being two standard deviations of a white series, root of
    n / (m (n + 2)) with m products of n numbers. p_value: of the Ljung-Box statistic over the k
    lags, which are as many as the numbers allow. mean: 0 is right, within mean_band of it.
    """

    component: str
    order: str
    coefficient: Array
    band: Array
    p_value: float
    mean: float
    mean_band: float


@dataclass(frozen=True)
class Windows:
    """Average NIS over stretches of a run. time_s, mean, low, high: (n,)."""

    time_s: Array
    mean: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class SensorInnovations:
    """One sensor. nis: of both components jointly, and of each. unusable: without a valid S."""

    sensor: str
    nis: tuple[Nis, ...]
    whiteness: tuple[Whiteness, ...]
    windows: Windows
    unusable: int


def check_innovations(run: EkfRun) -> tuple[SensorInnovations, ...]:
    """Of all measurements of mapped landmarks, and of the positions fused, where there are any.

    What was fused in parts is judged by its first part, with the whole observation's S, and
    alone. A measurement that began its landmark predicts nothing.
    """
    time_s = run.timeline.epoch_time_s
    u, fixes = run.trace.measurements[POINT], run.trace.positions
    initialised = run.trace.initialisations[POINT].number
    first = np.sort(np.unique(u.number, return_index=True)[1])
    rows = first[~np.isin(u.number[first], initialised)]
    weight = u.weight[rows]
    alone, bad = whiten(
        u.innovation[rows], u.spread[rows] + (weight[:, None, None] - 1.0) * u.noise[rows]
    )
    split = (weight < 1.0)[:, None]
    kept = ~(split[:, 0] & bad)
    standard = np.where(split, alone, u.whitened[rows])[kept]
    seen = u.number[rows][kept]
    names = ("forward", "left") if run.own_axes else ("range", "bearing")
    epoch = run.timeline.measurement_epoch[seen]
    landmark_index = u.landmark_index[rows][kept]
    made = [
        sensor(
            "measurements",
            names,
            standard,
            time_s[epoch],
            epoch,
            landmark_index,
            int((~kept).sum()),
        )
    ]
    first = np.sort(np.unique(fixes.number, return_index=True)[1])
    spread = fixes.spread[first] + (fixes.weight[first, None, None] - 1.0) * fixes.noise[first]
    standard, bad = whiten(fixes.innovation[first], spread)
    epoch = run.timeline.position_epoch[fixes.number[first]][~bad]
    names = ("east", "north")
    made.append(
        sensor("positions", names, standard[~bad], time_s[epoch], epoch, None, int(bad.sum()))
    )
    return tuple(one for one in made if one.nis)


def sensor(
    name: str,
    components: tuple[str, str],
    standard: Array,
    time_s: Array,
    epoch: Index,
    landmark_index: Index | None,
    unusable: int = 0,
) -> SensorInnovations:
    """Of standardised innovations (n, 2) at times (n,), in the order of their fusion.

    epoch, landmark_index: (n,) instants and landmarks, if it sees landmarks.
    """
    squared = standard**2
    rows = ((name, slice(0, 2)), (components[0], slice(0, 1)), (components[1], slice(1, 2)))
    nis = [average(title, squared[:, part]) for title, part in rows] if len(squared) else []
    white = []
    for i, component in enumerate(components):
        _, instant, count = np.unique(epoch, return_inverse=True, return_counts=True)
        summed = np.bincount(instant, standard[:, i]) / np.sqrt(count)
        white.append(whiteness(component, "time", summed))
        if landmark_index is not None:
            order = np.argsort(landmark_index, kind="stable")
            white.append(
                whiteness(component, "landmark", standard[order, i], landmark_index[order])
            )
    drawn = tuple(w for w in white if w is not None)
    return SensorInnovations(name, tuple(nis), drawn, _windows(squared, time_s), unusable)


def average(name: str, squared: Array) -> Nis:
    """Of independent (n, d) squared numbers of one degree of freedom each."""
    count, dof = squared.shape
    return Nis(name, dof, count, float(squared.sum() / count), mean_band(count, dof))


def whiten(innovation: Array, spread: Array) -> tuple[Array, NDArray[np.bool_]]:
    """L^-1 nu (n, 2) of innovations (n, 2) by S = L L^T (n, 2, 2); and which S is no covariance."""
    bad = faults(spread) != ""
    safe = np.where(bad[:, None, None], np.eye(2), spread)
    standard = np.linalg.solve(np.linalg.cholesky(safe), innovation[:, :, None])[:, :, 0]
    return np.where(bad[:, None], 0.0, standard), bad


def whiteness(
    component: str, order: str, values: Array, group: Index | None = None, lags: int = LAGS
) -> Whiteness | None:
    """Of numbers (n,), products being taken within a group (n,), sorted. None of too few.

    The mean is not subtracted: it should be zero, and one that is not is itself a correlation.
    With one group the statistic is Ljung's and Box's: n (n + 2) sum r_k^2 / (n - k).
    """
    n, power = len(values), float(np.mean(values**2)) if len(values) else 0.0
    if power <= 0.0:
        return None
    coefficient, pairs = [], []
    for k in range(1, min(lags, max(n // _PER_LAG, 1)) + 1):
        product = values[k:] * values[:-k]
        if group is not None:
            product = product[group[k:] == group[:-k]]
        if len(product) < _LEAST_PAIRS:
            break
        coefficient.append(float(product.mean()) / power)
        pairs.append(len(product))
    if not pairs:
        return None
    c, m = np.array(coefficient), np.array(pairs, dtype=float)
    sigma = np.sqrt(n / (m * (n + 2.0)))
    return Whiteness(
        component=component,
        order=order,
        coefficient=c,
        band=2.0 * sigma,
        p_value=chi2_tail(float(np.sum((c / sigma) ** 2)), len(c)),
        mean=float(values.mean()),
        mean_band=2.0 * float(np.sqrt(power / n)),
    )


def _windows(squared: Array, time_s: Array) -> Windows:
    parts = np.array_split(np.arange(len(squared)), min(_WINDOWS, len(squared)) or 1)
    parts = [part for part in parts if len(part)]
    bands = [mean_band(len(part), 2) for part in parts]
    return Windows(
        np.array([time_s[part].mean() for part in parts]),
        np.array([squared[part].sum() / len(part) for part in parts]),
        np.array([band.low for band in bands]),
        np.array([band.high for band in bands]),
    )
