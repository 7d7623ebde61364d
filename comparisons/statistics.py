"""The judge of consistency: NEES, NIS, whiteness, their bands, chances and words, of any filter.

`run`, `check`, `audit`, `compare` and Monte Carlo ask here whether squared errors, innovations and
their correlations are what a sound filter has, and by which band.

Quantiles are from scipy.special, for scipy.stats takes 0.3 s to load; each is the expression that
scipy.stats itself evaluates, so the values are equal to the bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, computed_field, with_config
from scipy.special import chdtr, chdtrc, fdtri, gammaincinv

from comparisons.arrays import Array, Index
from comparisons.figures import Aside, Figure, Key, LeftOut, Nominal, OfDof, Share95

LEVEL, OUTSIDE = 0.95, 0.05
"""Of the figures that a band is for, as many lie inside, and outside, half of these on either side.
"""
Place = Literal["below", "inside", "above"]
_READINGS: dict[Place, str] = {"below": "too low", "inside": "plausible", "above": "too high"}
WORDS = 0.001
"""Share of sound runs of which words say that they leave a band of NIS, whichever."""
_SKEW = 1e-6
"""Largest asymmetry of a covariance, in units of its sigmas, that rounding explains."""
_LEAST_EIGENVALUE = 1e-13
"""Of the correlation matrix; below it the covariance is singular, or worse."""
CLEAR = 0.05
"""Least share of the filter's variance that the future took away, in a direction that is judged."""
_LEAST_VARIANCE = 1e-12
"""Eigenvalue of a correlation matrix, relative to the largest, of a direction that counts."""
LAGS = 10
_LEAST_PAIRS = 20
"""An autocorrelation from fewer products is not looked at."""
_PER_LAG = 20
"""So many numbers are asked for each lag: with more lags the statistic's tail is not chi-square's.
Of 40 numbers at 10 lags, 0.6 % of white series have a p-value below 0.1 %; at 2 lags 0.13 %."""
_TENTH = 0.1
"""Of a series: what follows a stretch and is shorter tells nothing of its end."""
_IMPROBABLE, _PROBABLE = 1e-6, 1e-2
"""Chance of a first error by a prior whose rows are in the wrong order, and by the right one."""


def chi2_quantile(probability: Any, dof: Any) -> Any:
    """Value that a chi-square variable stays below with a probability; arrays broadcast.

    Twice the inverse of the regularised lower incomplete gamma function of dof / 2.
    """
    return 2 * gammaincinv(0.5 * dof, probability)


def chi2_tail(value: float, dof: int) -> float:
    """Probability that a chi-square variable exceeds a value of at least 0."""
    return float(chdtrc(dof, value))


def two_sided(value: float, dof: float) -> float:
    """Probability that a chi-square variable is as far out as this, on either side."""
    return float(min(1.0, 2.0 * min(chdtr(dof, value), chdtrc(dof, value))))


def chance_of_sum(total: float, dof: float, least: float = 1.0) -> float:
    """Return the two-sided chance of a sum of chi-square with that many degrees of freedom.

    least: of the expected sum, what is left of it at least where a gate took large ones away.
    """
    return two_sided(total if total >= dof else min(total / least, dof), dof)


def f_quantile(probability: float, dof: float, dof_below: float) -> float:
    """Value that an F variable stays below with a probability. dof_below: of the denominator."""
    return float(fdtri(dof, dof_below, probability))


class Band(NamedTuple):
    """Where 95 % of a figure lie, half of the rest on either side."""

    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Neither end is passed; never true for NaN."""
        return self.low <= value <= self.high

    def place(self, value: float) -> Place:
        """Return on which side a figure is; NaN is above."""
        if self.holds(value):
            return "inside"
        return "below" if value < self.low else "above"

    def reading(self, value: float) -> str:
        """Return what the figure is in words: `plausible`, `too high` or `too low`."""
        return _READINGS[self.place(value)]


def mean_band(count: float, dof: float, outside: float = OUTSIDE) -> Band:
    """Of the mean of `count` independent chi-square variables with `dof` degrees of freedom.

    chi2_quantile(q, R d) / R (Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2). Everything lies
    in the band of none.
    """
    if count * dof == 0:
        return Band(0.0, float("inf"))
    low, high = chi2_quantile((0.5 * outside, 1.0 - 0.5 * outside), count * dof) / count
    return Band(float(low), float(high))


@dataclass(frozen=True, kw_only=True)
class Normalised:
    """Normalised errors squared, e^T P^-1 e, each with `dof` degrees of freedom.

    Over time, and over landmarks of one run, the values are correlated: no band holds for their
    average.

    Attributes:
        dof: degrees of freedom of a value.
        count: number of values.
        mean: average; `dof` is right.
        last: the last value.
        single_band: interval of 95 % of single values.
        inside: share of the values in it.
        unusable: errors without a value, by reason: `not finite`, `asymmetric`, `not positive
            definite`.
        row: (n,) which of the errors given have a value; no part of a result file.
        squared: (n,) finite numbers; likewise.
    """

    dof: LeftOut[int]
    count: int
    mean: OfDof[float | None]
    last: LeftOut[float | None]
    single_band: Band
    inside: Share95[float | None]
    unusable: Mapping[str, int]
    row: Aside[Index]
    squared: Aside[Array]


def squared_distance(error: Array, covariance: Array) -> Array:
    """Return e^T P^-1 e (N,) of errors (N, d) by covariances (N, d, d)."""
    solved = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    squared: Array = np.einsum("ni,ni->n", error, solved)
    return squared


def inside(squared: Array, dof: Index) -> NDArray[np.bool_]:
    """Return which squared errors (N,) are in the 95 % band of one. dof: (N,), or one for all."""
    within = np.zeros(len(squared), dtype=bool)
    every = np.broadcast_to(dof, squared.shape)
    for each in np.unique(every).tolist():
        (low, high), rows = mean_band(1, each), every == each
        within[rows] = (squared[rows] >= low) & (squared[rows] <= high)
    return within


def normalise(error: Array, covariance: Array) -> Normalised:
    """Errors (N, d) by covariances (N, d, d), which must be symmetric and positive definite.

    Judged after scaling to correlations, so that metres and radians count alike.
    """
    fault = faults(covariance)
    fault[~np.isfinite(error).all(axis=1)] = "not finite"
    row = np.flatnonzero(fault == "")
    e, p = error[row], covariance[row]
    sigma = np.sqrt(np.einsum("nii->ni", p))
    e, p = e / sigma, p / (sigma[:, :, None] * sigma[:, None])
    squared, some = squared_distance(e, p), len(row) > 0
    within = inside(squared, np.asarray(error.shape[1]))
    return Normalised(
        dof=error.shape[1],
        count=len(row),
        mean=float(squared.mean()) if some else None,
        last=float(squared[-1]) if some else None,
        single_band=mean_band(1, error.shape[1]),
        inside=float(within.mean()) if some else None,
        unusable=counted(fault),
        row=row,
        squared=squared,
    )


def faults(covariance: Array) -> NDArray[np.str_]:
    """(N,) what is wrong with covariances (N, d, d), empty where nothing is."""
    fault = np.full(len(covariance), "", dtype="<U24")
    diagonal = np.einsum("nii->ni", covariance)
    finite = np.isfinite(covariance).all(axis=(1, 2))
    positive = finite & (diagonal > 0.0).all(axis=1)
    fault[~positive] = "not positive definite"
    fault[~finite] = "not finite"
    row = np.flatnonzero(positive)
    sigma = np.sqrt(diagonal[row])
    scaled = covariance[row] / (sigma[:, :, None] * sigma[:, None])
    turned = scaled.transpose(0, 2, 1)
    some = len(row) and covariance.shape[1]  # of no components nothing is wrong
    least = np.linalg.eigvalsh(0.5 * (scaled + turned))[:, 0] if some else np.ones(len(row))
    fault[row[least <= _LEAST_EIGENVALUE]] = "not positive definite"
    fault[row[np.abs(scaled - turned).max(axis=(1, 2), initial=0.0) > _SKEW]] = "asymmetric"
    return fault


def counted(fault: NDArray[np.str_]) -> dict[str, int]:
    """How many there are of each fault (N,), the empty ones left out."""
    kinds, counts = np.unique(fault[fault != ""], return_counts=True)
    return dict(zip(kinds.tolist(), counts.tolist(), strict=True))


@with_config(ConfigDict(extra="ignore"))  # the reading of a file is computed anew
@dataclass(frozen=True)
class Nis:
    """An average of normalised innovations squared, with its own 95 % band.

    Attributes:
        name: sensor or component.
        dof: degrees of freedom of a value; rounded where values have different ones.
        count: number of innovations.
        mean: average; `dof` is right.
        band: 95 % band of the average.
        freedom: degrees of freedom of all values together; no part of a result file.
        reading: `plausible`, `too high`: the filter is too sure, or `too low`.
    """

    name: Key[str]
    dof: LeftOut[int]
    count: int
    mean: OfDof[float]
    band: Band
    _: KW_ONLY
    freedom: Aside[float | None] = None

    @computed_field
    @property
    def reading(self) -> str:
        """What the average says, in a word or two."""
        return self.band.reading(self.mean)

    def worded(self, outside: float) -> tuple[str, Band]:
        """Return the reading by the band that so many sound runs leave, and that band."""
        band = mean_band(self.count, self.expected, outside)
        return band.reading(self.mean), band

    @property
    def total_dof(self) -> float:
        """Degrees of freedom of all values together."""
        return float(self.count * self.dof) if self.freedom is None else self.freedom

    @property
    def expected(self) -> float:
        """The average that is right: the degrees of freedom of a value, or their mean."""
        return self.dof if self.freedom is None else self.freedom / self.count

    @property
    def expected_words(self) -> str:
        """The same as text."""
        return f"{self.dof}" if self.freedom is None else f"{self.expected:.3g}"

    def chance(self, least: float = 1.0) -> float:
        """Return the two-sided chance of an average as far out. least: as of `chance_of_sum`."""
        return chance_of_sum(self.mean * self.count, self.total_dof, least)


@dataclass(frozen=True, kw_only=True)
class Whiteness:
    """Autocorrelation of one component's standardised innovations, and their average.

    By time there is one number per instant, the sum of its n numbers over root n: correlated when
    something lasts, a bias of the sensor, coloured noise of the motion, a wrong heading. By
    landmark, from one measurement of a landmark to the next, with all landmarks pooled: correlated
    when the filter is overconfident of landmarks, for each then has a lasting error. The band is
    two standard deviations of a white series, root of n / (m (n + 2)) with m products of n numbers.

    Attributes:
        component: component of the innovation.
        order: by `time`, or by `landmark`.
        autocorrelation: coefficients, by lag from 1; as many lags as the numbers allow.
        band: half widths of their bands, by lag.
        p_value: chance of such coefficients for white innovations, by the Ljung-Box statistic.
        mean: average of the standardised innovations; 0 is right.
        mean_band: half width of its 95 % band.
    """

    component: str
    order: str
    autocorrelation: tuple[float, ...]
    band: tuple[float, ...]
    p_value: float
    mean: float
    mean_band: float


def average(name: str, squared: Array) -> Nis:
    """Of independent (n, d) squared numbers of one degree of freedom each."""
    count, dof = squared.shape
    return Nis(name, dof, count, float(squared.sum() / count), mean_band(count, dof))


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
    coefficient, pairs = list[float](), list[int]()
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
        autocorrelation=tuple(coefficient),
        band=tuple((2.0 * sigma).tolist()),
        p_value=chi2_tail(float(np.sum((c / sigma) ** 2)), len(c)),
        mean=float(values.mean()),
        mean_band=2.0 * float(np.sqrt(power / n)),
    )


def independent(values: Array) -> float:
    """Return how many independent numbers have a mean as certain as that of a series (n,).

    n over 1 + 2 sum r_k with autocorrelations about zero, which is where the series belongs, summed
    until two neighbours cancel (Geyer 1992, section 3.3, initial positive sequence). Of a series of
    vectors (n, d) the products of all components are taken together.
    """
    n = len(values)
    spectrum = np.fft.rfft(values.reshape(n, -1), 2 * n, axis=0)
    r = np.fft.irfft(spectrum * spectrum.conj(), 2 * n, axis=0)[:n].sum(axis=1)
    if not r[0] > 0.0:
        return float(n)
    pairs = r[: n - n % 2].reshape(-1, 2).sum(axis=1) / r[0]
    cancelled = np.flatnonzero(pairs <= 0.0)
    lasting = pairs[: cancelled[0]] if len(cancelled) else pairs
    return n / max(2.0 * float(lasting.sum()) - 1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Averaged:
    """Squared errors per degree of freedom, of snapshots or epochs.

    Attributes:
        mean: the average; 1 is right.
        band: of 95 % of sound runs, by the effective number of independent ones.
        p_value: the same, two-sided.
        snapshots: how many.
        worst: number of the one that is largest; no part of a result file.
        dof: degrees of freedom of all independent ones together; likewise.
    """

    mean: Figure
    band: Band
    p_value: Figure
    snapshots: int
    worst: Aside[int]
    dof: Aside[float]


def averaged(squared: Array, dof: Index, number: Index) -> Averaged | None:
    """Average squared errors (n,) of dof (n,) directions each, in the order of time.

    number: (n,) what each is called. None where none has a direction.
    """
    some = dof > 0
    if not some.any():
        return None
    squared, dof = squared[some], dof[some]
    per, each = squared / dof, float(dof.mean())
    count, mean = independent(per - 1.0), float(squared.sum() / dof.sum())
    low, high = mean_band(count, each)
    return Averaged(
        mean=mean,
        band=Band(low / each, high / each),
        p_value=two_sided(mean * count * each, count * each),
        snapshots=len(per),
        worst=int(number[some][np.argmax(per)]),
        dof=count * each,
    )


def rarity(ratio: float, dof: float) -> float:
    """Return -log of the chance of a chi-square average that is `ratio` times its mean.

    By Chernoff's bound, dof / 2 (ratio - 1 - log(ratio)), which tells what is far off apart where
    all p-values are zero.
    """
    ratio = max(ratio, 1e-300)
    return 0.5 * dof * (ratio - 1.0 - float(np.log(ratio)))


def rarest(averages: Mapping[str, Averaged]) -> str | None:
    """Return the name of the average that chance makes most rarely, None of none."""
    weight = {name: rarity(one.mean, one.dof) for name, one in averages.items()}
    return max(weight, key=lambda name: weight[name], default=None)


def onset(values: Array, mean: float, right: float) -> int:
    """Return where a series most likely changes from one mean to another.

    The least cumulative sum of the differences from halfway between the two.
    """
    return int(np.argmin(_excess(values, mean, right)[:-1]))


def stretch(values: Array, mean: float, right: float) -> tuple[int, int]:
    """Return the first and last number between which a series is most likely off.

    From its onset up to the largest cumulative sum behind it; up to the end where what follows is
    shorter than a tenth of the series.
    """
    total, first = _excess(values, mean, right), onset(values, mean, right)
    last = first + int(np.argmax(total[first + 1 :]))
    return first, len(values) - 1 if len(values) - 1 - last < _TENTH * len(values) else last


def _excess(values: Array, mean: float, right: float) -> Array:
    """(n + 1,) cumulative sum of a series (n,) beyond halfway from the right mean to its own."""
    apart = values - 0.5 * (mean + right)
    return np.concatenate(([0.0], np.cumsum(apart if mean > right else -apart)))


class SquaredErrors(NamedTuple):
    """Squared errors (n,) of dof (n,) directions each, at times (n,)."""

    time_s: Array
    squared: Array
    dof: Index


@dataclass(frozen=True, kw_only=True)
class BlockDeparture:
    """What of an estimate leaves its band, where the whole does.

    Attributes:
        block: the block whose errors chance makes most rarely; empty where no block leaves its band
            by itself.
        squared_per_dof: its squared error per degree of freedom; 1 is right.
        since_s: time from which on it is off.
        until_s: time up to which it is.
    """

    block: str
    squared_per_dof: Nominal[float]
    since_s: LeftOut[float]
    until_s: LeftOut[float]

    @property
    def words(self) -> str:
        """The block, and the stretch."""
        of = f"of the {self.block} {self.squared_per_dof:.3g} " if self.block else ""
        return f"{of}from {self.since_s:.6g} s to {self.until_s:.6g} s"


def block_departure(
    whole: SquaredErrors, blocks: Mapping[str, SquaredErrors]
) -> BlockDeparture | None:
    """Return the block that is off most, on the side on which the whole is, and since when.

    whole: out of its band. blocks: of it. None where no error has a direction.
    """
    every = {name: _clear(errors) for name, errors in {"": whole, **blocks}.items()}
    found = {name: averaged(e.squared, e.dof, np.arange(len(e.dof))) for name, e in every.items()}
    of = found.pop("")
    if of is None:
        return None
    above = of.mean > 1.0
    out = {
        name: one
        for name, one in found.items()
        if one is not None and not one.band.holds(one.mean) and (one.mean > 1.0) == above
    }
    block = rarest(out) or ""
    mean, (time_s, squared, dof) = out.get(block, of).mean, every[block]
    first, last = stretch(squared / dof, mean, 1.0)
    return BlockDeparture(
        block=block,
        squared_per_dof=mean,
        since_s=float(time_s[first]),
        until_s=float(time_s[last]),
    )


def _clear(errors: SquaredErrors) -> SquaredErrors:
    """Return those that have a direction."""
    some = errors.dof > 0
    return SquaredErrors(errors.time_s[some], errors.squared[some], errors.dof[some])


def normalised_difference(
    difference: Array, filtered: Array, smoothed: Array
) -> tuple[Array, Index, Array]:
    """Return d^T (P_f - P_s)^-1 d over clear directions, their numbers, and least P_f over P_s.

    A direction is clear in which the future took away at least 5 % of the filter's variance.

    Args:
        difference: (n, d) filtered minus smoothed.
        filtered: (n, d, d) covariances; one may be singular, as of a clone.
        smoothed: (n, d, d) likewise.

    Returns:
        (n,) each; the ratio is 1 along directions without variance.
    """
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", filtered), 0.0))
    unit = np.where(sigma > 0.0, sigma, 1.0)
    scale = unit[:, :, None] * unit[:, None, :]
    values, axes = np.linalg.eigh(filtered / scale)
    some = values > _LEAST_VARIANCE * values[:, -1:]
    white = np.where(some[:, None, :], axes / np.sqrt(np.where(some, values, 1.0))[:, None], 0.0)
    share = white.transpose(0, 2, 1) @ (smoothed / scale) @ white
    share += np.where(some, 0.0, 1.0)[:, :, None] * np.eye(share.shape[-1])
    left, turn = np.linalg.eigh(0.5 * (share + share.transpose(0, 2, 1)))
    gained = 1.0 - left
    clear = gained > CLEAR
    scaled = (difference / unit)[:, :, None]
    along = (turn.transpose(0, 2, 1) @ (white.transpose(0, 2, 1) @ scaled))[:, :, 0]
    squared = np.where(clear, along**2 / np.where(clear, gained, 1.0), 0.0).sum(axis=1)
    return squared, clear.sum(axis=1), 1.0 / left[:, -1]


class RowOrder(NamedTuple):
    """Rows of a prior in another order (n,). p_value: of the first error by it."""

    order: Index
    p_value: float


def likelier_orders(
    error: Array, prior: Array, left: Array, orders: Iterable[Index]
) -> list[RowOrder]:
    """Return orders of a prior's rows that make an improbable first error probable, the best first.

    The measurements say of the error e: z = e + v with Cov(v) = V. The smoothed error is m = P w,
    w = S^-1 z, and P - left = P S^-1 P, S = P + V. By another prior P' of the same measurements
    S' = S + P' - P, so that w' = (I + S^-1 (P' - P))^-1 w.

    Args:
        error: (n,) m, or the true error.
        prior: (n, n) P.
        left: (n, n) the smoothed covariance; zero of the true error.
        orders: Each (n,), rows and columns in another order.

    Returns:
        Those of orders; none where the error is probable as the rows stand, or a row says that it
        is exactly zero.
    """
    if not _first_chance(error, prior, left) < _IMPROBABLE:
        return []
    found = []
    try:
        inverse = np.linalg.inv(prior)
        told = np.column_stack((inverse @ error, inverse @ (prior - left) @ inverse))
        for order in orders:
            other = prior[np.ix_(order, order)]
            change = np.eye(len(prior)) + told[:, 1:] @ (other - prior)
            mean, gained = np.split(other @ np.linalg.solve(change, told), [1], axis=1)
            p = _first_chance(mean[:, 0], other, other - gained @ other)
            if p > _PROBABLE:
                found.append(RowOrder(order, p))
    except np.linalg.LinAlgError:
        return []
    return sorted(found, key=lambda order: -order.p_value)


def _first_chance(error: Array, prior: Array, left: Array) -> float:
    """Chance of a first error (n,) as large; 1 where nothing tells it."""
    with np.errstate(divide="ignore"):  # of the true error nothing is left
        squared, dof, _ = normalised_difference(error[None], prior[None], left[None])
    return chi2_tail(float(squared[0]), int(dof[0])) if dof[0] else 1.0
