"""Known faults of EKF-SLAM filters: planted in the filter, or made by feeding it another log."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from comparisons.arrays import Array
from comparisons.covariances import entry_differences
from comparisons.faults import algebra, data, models, noise
from comparisons.faults.fault import Family, Fault, moving, together
from comparisons.faults.streams import STABILISATION, stream_faults, with_prior
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.rounding import ROUNDING

NAMED = tuple(
    fault._replace(name=name)
    for module in (algebra, models, noise, data)
    for name, fault in module.FAULTS.items()
)
"""Faults with a short name each, planted in the filter."""
_POSITIONS = {"position fused twice"}
_LABELS = {"landmark initialised again", "labels exchanged"}
_ALONE = {"asymmetric covariance", "landmark from the old pose", "wrong quadrant"}
"""Faults that no composition of slot and change gives, as those before."""
_STARTS = (0.0, 1e-12, 1e-10, 1e-9, 1e-8, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
"""Variances by which filters begin that take them from no log."""
_EXACT_START = 1e-16
"""Stands for a variance of zero at the start, whose inverse a prior needs."""


def catalogue(log: Log) -> Iterator[Fault]:
    """Yield the faults without a number that are no composition of slot and change."""
    names = set(_ALONE)
    if log.positions is not None:
        names |= _POSITIONS
    if log.measurements.labelled:
        names |= _LABELS
    yield from (fault for fault in NAMED if fault.name in names)
    yield Fault("measurements of landmarks in the map are used twice in one update",
                noise.new_landmarks(0.5, 1.0))  # fmt: skip
    sigmas = _of_sigmas(log.prior.covariance)
    yield Fault(_SIGMAS_IN_PRIOR, feed=lambda log: with_prior(log, sigmas))
    yield _start(0.0)
    if not isinstance(log.odometry, RelativePoses):
        bare = _without_stabilisation(log)
        yield from (together(_start(value), bare) for value in _STARTS)
        yield Fault("the controls' part of Q grows with the interval, not with its square",
                    moving(models.noise_by_interval))  # fmt: skip


def _without_stabilisation(log: Log) -> Fault:
    (bare,) = (
        fault for fault in stream_faults(log) if fault.what == f"{STABILISATION} is left out"
    )
    return bare


def families(log: Log) -> Iterator[Family]:
    """Yield the faults with a number that are no composition of slot and change."""
    yield Family(
        "R of new landmarks is {} times the log's", plant=lambda k: noise.new_landmarks(1.0, k)
    )
    yield Family("R of updates, or of the gain alone, but not of new landmarks, is {} times the "
                 "log's", plant=lambda k: noise.new_landmarks(k, 1.0))  # fmt: skip


def _start(variance: float) -> Fault:
    """The fault of a filter that begins with a variance [m^2, rad^2] of its own."""
    what = f"the prior's covariance is {f'{variance:g} I' if variance else 'zero'}"
    covariance = max(variance, _EXACT_START) * np.eye(3)
    return Fault(what, feed=lambda log: with_prior(log, covariance))


_SIGMAS_IN_PRIOR = "the prior's covariance contains sigmas, not their squares"
EXCHANGED_ROWS = {
    "x and the heading": (2, 1, 0),
    "y and the heading": (0, 2, 1),
    "x and y": (1, 0, 2),
}
"""Orders of a pose's rows."""


def own_start(log: Log, covariance: Array) -> Fault:
    """The fault of a filter whose first pose has a covariance (3, 3) of its own."""
    prior = log.prior.covariance
    ratio = np.diag(covariance) / np.diag(prior)
    named = ", ".join(f"{share:.3g}" for share in ratio)
    if np.ptp(ratio) <= 1e-6 * ratio.max():
        named = f"{ratio[0]:.3g}"
    what = f"the prior's covariance is {named} times the log's"
    known = {_SIGMAS_IN_PRIOR: _of_sigmas(prior)}
    for names, order in EXCHANGED_ROWS.items():
        known[f"the rows of {names} in the prior's covariance are exchanged"] = prior[
            np.ix_(order, order)
        ]
    for named, other in known.items():
        if np.abs(entry_differences(other, covariance)).max() <= ROUNDING:
            what = named
    return Fault(what, feed=lambda log: with_prior(log, covariance))


def is_setting(what: str) -> bool:
    """Return whether a fault is one of a filter's own settings: where it starts, and padding of Q.

    Args:
        what: The fault in words, as of this catalogue.
    """
    return what.startswith(("the prior's covariance", "the stabilisation noise"))


def _of_sigmas(covariance: Array) -> Array:
    """The standard deviations in the variances' place, without correlations."""
    return np.diag(np.sqrt(np.diag(covariance)))
