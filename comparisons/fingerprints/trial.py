"""One filter with a fault beside an estimate: what the fault explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from comparisons.adapters.filter_loop import FilterObserver, FilterObservers
from comparisons.arrays import Array
from comparisons.checks.grade import Likeness, likeness
from comparisons.config import SolveConfig
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.reference import Reference
from comparisons.faults.fault import NONE, Family, Fault
from comparisons.fingerprints.companion import (
    EXPLAINED,
    NEAR,
    Companion,
    EstimateLeftError,
    remainder,
)
from comparisons.fingerprints.fit import FaultFit, nearest, selected, settled
from comparisons.logs.log import Log
from comparisons.logs.transforms.clock import file_start
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.references import filter_named
from ekf_reference.core.ekf import Ekf

_DIVERGED = 1.0
"""A filter with a fault that reproduces the estimate until the sound one is so many sigma off has
this fault, whatever becomes of it: where a filter diverges, rounding grows."""
LEAST_SHARE = 0.5
"""Of the estimate's time that a filter with a fault must reproduce before it diverges: what parts
sooner is no explanation of the rest."""
_POSES = 10
"""A number is fitted to the poses until the sound filter leaves the estimate, and so many more."""
_BESIDE = 2
"""Numbers beside which a fault without one is looked for: none, and one."""
_STAMPS, _MOST_BY_STAMPS = 10.0, 1e-3
"""Last places of a stamp since 1970 by which poses may be off, and the most of it in sigma."""
_FAR = 10.0
"""What several faults leave, and so many times more than another order of updates can move."""


class Fingerprint(NamedTuple):
    """A fault that explains an estimate.

    fault: in words. way: how else the filter differs from the reference EKF, in words. sigma: the
    largest difference that is left. exact: none but rounding is. until_s: when the filter with the
    fault, diverging, leaves the estimate or breaks down; None where it does not. share: of the
    estimate's time until then. several: whether it is several faults at once.
    """

    fault: str
    way: str
    sigma: float
    exact: bool
    until_s: float | None = None
    several: bool = False
    share: float = 1.0

    @property
    def whole(self) -> bool:
        """Whether it reproduces all of the estimate."""
        return self.exact and self.until_s is None

    @property
    def rank(self) -> tuple[bool, float, float]:
        """Sorts what explains more before: to rounding, then longer, then with less left."""
        lasts_s = np.inf if self.until_s is None else self.until_s
        return not self.exact, -lasts_s, self.sigma


class Way(NamedTuple):
    """A filter that faults are tried in. words: how it differs from the reference EKF.

    log: as it moves. name: of FILTERS.
    """

    words: str
    log: Log
    name: str


def stamp_rounding(given: ExternalEstimate, sound: Likeness, start_s: float) -> float:
    """Return how far, in sigma, stamps as float64 may move poses whose times count since 1970.

    A filter may have its times exact or as float64 has them: one that has a fault does not show
    which. start_s: what the log's times count from.
    """
    if not start_s or len(given.time_s) < 2:
        return 0.0
    moved = np.diff(given.pose, axis=0)
    moved[:, 2] = np.angle(np.exp(1j * moved[:, 2]))
    rate = np.abs(moved / np.diff(given.time_s)[:, None]).max(axis=0)
    spread = np.sqrt(np.diagonal(sound.reference.pose_covariance, 0, 1, 2)).min(axis=0)
    found = _STAMPS * float(np.spacing(start_s) * np.max(rate / spread))
    return min(found, _MOST_BY_STAMPS)


class FaultTrial:
    """One filter beside an estimate, without a fault as yet.

    least: what a fault that reproduces the estimate may leave, in sigma.
    """

    def __init__(
        self, given: ExternalEstimate, prepared: Prepared[SolveConfig], sound: Likeness, way: Way
    ) -> None:
        """sound: as of `fingerprints`."""
        self.given, self.prepared, self.sound, self.way = given, prepared, sound, way
        self.least = max(NEAR, stamp_rounding(given, sound, float(file_start(way.log))))
        beside = Companion(given, sound)
        self._first, self._count = beside, beside.first(_POSES)

    @cached_property
    def neutral(self) -> Array | None:
        """What is left of the first poses without a fault."""
        return self._left(NONE)

    @cached_property
    def _bare(self) -> Likeness | None:
        """The filter without a fault beside the estimate; None where it cannot run."""
        found = self._run(NONE, FilterObservers())
        return None if found is None else self._likeness(found)

    def _likeness(self, found: Reference) -> Likeness:
        return likeness(self.given, found, labelled=self.prepared.labelled)

    def _equal(self, near: Likeness) -> bool:
        """Whether rounding is left, and no more, of numbers or of stamps since 1970."""
        return near.grade == "equal" or (self.least > NEAR and near.farthest <= self.least)

    def _wrong_without(self, until_s: float) -> bool:
        """Whether the filter without a fault had left the estimate for good by then."""
        if self._bare is None:
            return True
        return Companion(self.given, self._bare).sound_at(until_s) >= _DIVERGED

    def _left(self, fault: Fault) -> Array | None:
        """What is left of the first poses; None where the filter does not reach them all."""
        return remainder(self._first, self._count, lambda seen: self._run(fault, seen))

    def of(self, fault: Fault) -> Fingerprint | None:
        """What a fault explains; None where its filter leaves the estimate, or cannot run."""
        beside = Companion(self.given, self.sound, least=self.least)
        try:
            found = self._run(fault, beside)
        except EstimateLeftError:
            found = None
        except InputError:
            return None
        with np.errstate(invalid="ignore"):  # a fault may leave no covariance
            near = None if found is None else self._likeness(found)
        if near is not None and self._equal(near):
            if self._bare is not None and self._equal(self._bare):
                return None  # a fault without effect
            return Fingerprint(fault.what, self.way.words, near.farthest, exact=True)
        # Equal so long: then rounding grows, or it breaks down.
        begin_s, end_s = self.given.time_s[[0, -1]]
        share = float((beside.last_s - begin_s) / (end_s - begin_s)) if end_s > begin_s else 0.0
        lasted = beside.poses >= _POSES and beside.sound >= _DIVERGED and share >= LEAST_SHARE
        if lasted and self._wrong_without(beside.last_s):
            until_s = beside.last_s if beside.last_s < end_s else None
            return Fingerprint(
                fault.what,
                self.way.words,
                beside.farthest,
                exact=True,
                until_s=until_s,
                share=share,
            )
        if near is None or not near.farthest <= (1.0 - EXPLAINED) * self.sound.farthest:
            return None
        return Fingerprint(fault.what, self.way.words, near.farthest, exact=False)

    def fitted(self, family: Family) -> Fingerprint | None:
        """What a family explains with the number that fits the first poses best.

        None where nothing fits.
        """
        if self.neutral is None:
            return None
        fit = settled(FaultFit(NONE, (), np.empty(0), self.neutral).with_one(family), self._left)
        enough = max(self.least, (1.0 - EXPLAINED) * self._first.sound_until(self._count))
        return self.of(fit.fault) if fit is not None and fit.near(enough) else None

    def several(self, faults: Sequence[Fault], families: Sequence[Family]) -> FaultFit | None:
        """Up to three numbers, alone or beside a fault without one, that leave the least together.

        Without a number is one that leaves the least of the first poses, beside no number or one.
        None where the filter without a fault does not reach them. What is left only by rounding
        ends the search.
        """
        tried, bases = [], []
        for fit in selected(NONE, families, self._left, self.least):
            tried.append(fit)
            if len(fit.at) < _BESIDE and not fit.near(self.least):
                bases.append(nearest(fit, faults, self._left))
        for base in filter(None, bases):
            if any(fit.near(self.least) for fit in tried):
                break
            tried += selected(base, families, self._left, self.least)
        return min(tried, key=lambda fit: float(np.linalg.norm(fit.left)), default=None)

    def hopeless(self, fit: FaultFit, other: FaultTrial) -> bool:
        """Whether what a fit leaves is far more than what another filter does otherwise."""
        if self.neutral is None or other.neutral is None:
            return False
        apart = float(np.linalg.norm(self.neutral - other.neutral))
        return bool(np.linalg.norm(fit.left) > _FAR * apart)

    def _run(self, fault: Fault, beside: FilterObserver) -> Reference | None:
        return filter_with(fault, self.way.name, self.prepared, self.given.time_s, beside)


def filter_with(
    fault: Fault,
    name: str,
    prepared: Prepared[SolveConfig],
    time_s: Array,
    observer: FilterObserver,
) -> Reference | None:
    """Run a filter with a fault; None where it breaks down.

    Args:
        fault: What it does otherwise, or what it is given.
        name: Of FILTERS.
        prepared: The log, and how the filter is set.
        time_s: (n,) instants of the poses.
        observer: Sees each step.
    """

    def started(ekf: Ekf) -> FilterObserver:
        if fault.plant is not None:
            fault.plant(ekf)
        return observer

    if fault.feed is not None:
        prepared = replace(prepared, log=fault.feed(prepared.log))
    with np.errstate(all="ignore"):  # a fault may make it diverge
        return filter_named(name, prepared, time_s, started)
