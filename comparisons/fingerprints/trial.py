"""One filter with a fault beside an estimate: what the fault explains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import islice
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
    RunDeparture,
    in_both,
    part_of_step,
    remainder,
    remainders,
)
from comparisons.fingerprints.fault_sets import FaultSet, LinearEffects
from comparisons.fingerprints.fit import STEP, FaultFit, settled, starts, unfitted
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
_STAMPS, _MOST_BY_STAMPS = 10.0, 1e-3
"""Last places of a stamp since 1970 by which poses may be off, and the most of it in sigma."""
_JUMP = 1e4
"""Times the largest difference until then by which a run leaves an estimate where another
difference begins: rounding that grows in a filter that diverges passes what lies between."""
_SCREENED = 2
"""Poses, from the first that differs, by which families are screened."""
_NO_EFFECT = 1.0
"""Most that a number may move a pose [sigma] by its unit, before the estimate differs."""
_UNFELT = 1e-3
"""Share of the largest difference that a number without an effect on an entry may leave there."""
_SAME_SIDE = 0.75
"""Least share of entries that a number moves to the side on which the estimate is."""
_MOST_LEFT = 0.2
"""Share of what is left without a fault, of which a run with it may leave as much in another
order."""
_NO_CHANGE = 1e-9
"""Share of what is left without a fault by which a fault without an effect may change it."""
_LITTLE, _MOST_LIKE = 0.1, 6
"""Share of the difference that a set of faults leaves for others like them to be tried, and how
many of these are."""
_CHOICES, _SOME = 3, 0.5
"""How often sets are chosen: again after a fit, beside what is not linear in it; and the most that
this may leave, as a share of the difference."""
_FAR = 10.0
"""What several faults leave, and so many times more than another order of updates can move."""


class Fingerprint(NamedTuple):
    """A fault that explains an estimate.

    fault: in words. way: how else the filter differs from the reference EKF, in words. sigma: the
    largest difference that is left, by rounding. until_s: when the filter with the fault leaves
    the estimate or breaks down; None where it does not. jumps: whether it leaves it at once, so
    that it does not diverge. share: of the estimate's time until then. several: whether it is
    several faults at once. others: faults that explain it as well.
    """

    fault: str
    way: str
    sigma: float
    until_s: float | None = None
    jumps: bool = False
    several: bool = False
    share: float = 1.0
    others: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether it reproduces all of the estimate."""
        return self.until_s is None

    @property
    def rank(self) -> tuple[float, float]:
        """Sorts what explains more before: for longer, then with less left."""
        lasts_s = np.inf if self.until_s is None else self.until_s
        return -lasts_s, self.sigma


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
    rounding = _STAMPS * float(np.spacing(start_s) * np.max(rate / spread))
    return min(rounding, _MOST_BY_STAMPS)


class Trial(NamedTuple):
    """A fault that was tried.

    explained: what it explains. departure: where its run was given up; None where it was not.
    """

    explained: Fingerprint | None = None
    departure: RunDeparture | None = None


class FaultTrial:
    """One filter beside an estimate, without a fault as yet.

    least: what a fault that reproduces the estimate may leave, in sigma.
    """

    def __init__(
        self, given: ExternalEstimate, prepared: Prepared[SolveConfig], sound: Likeness, way: Way
    ) -> None:
        """sound: as of `fingerprints`."""
        self.given, self.prepared, self.sound, self.way = given, prepared, sound, way
        self._by_stamps = stamp_rounding(given, sound, float(file_start(way.log)))
        self.least = max(NEAR, self._by_stamps, *sound.parts[0].rounding)
        self._between = part_of_step(way.log)
        beside = self._companion()
        self._first, self._count = beside, beside.first(_POSES)

    def _companion(self) -> Companion:
        return Companion(self.given, self.sound, least=self.least, between=self._between)

    @cached_property
    def neutral(self) -> Array | None:
        """What is left of the first poses without a fault."""
        rows = self._neutral_rows
        return np.concatenate(rows) if len(rows) == self._count else None

    @cached_property
    def _neutral_rows(self) -> list[Array]:
        """The same of each pose; as many as the filter reaches."""
        return remainders(self._first, self._count, lambda beside: self._run(NONE, beside))

    @cached_property
    def _bare(self) -> Likeness | None:
        """The filter without a fault beside the estimate; None where it cannot run."""
        reference = self._run(NONE, FilterObservers())
        return None if reference is None else self._likeness(reference)

    def _likeness(self, reference: Reference) -> Likeness:
        return likeness(self.given, reference, labelled=self.prepared.labelled)

    def _equal(self, near: Likeness) -> bool:
        """Whether rounding is left, and no more, of numbers or of stamps since 1970."""
        by_stamps = self._by_stamps > NEAR and near.farthest <= self._by_stamps
        return near.grade == "equal" or by_stamps

    def _wrong_without(self, until_s: float) -> bool:
        """Whether the filter without a fault had left the estimate for good by then."""
        if self._bare is None:
            return True
        return Companion(self.given, self._bare).sound_at(until_s) >= _DIVERGED

    def _left(self, fault: Fault, count: int | None = None) -> Array | None:
        """What is left of the first poses, or so many; None where the filter does not reach all."""
        count = self._count if count is None else count
        return remainder(self._first, count, lambda beside: self._run(fault, beside))

    @cached_property
    def equal_poses(self) -> int:
        """How many of the first poses are those of the filter without a fault."""
        off = [
            k
            for k, neutral_row in enumerate(self._neutral_rows)
            if np.abs(neutral_row).max() > self.least
        ]
        return off[0] if off else len(self._neutral_rows)

    def is_early(self, departure: RunDeparture) -> bool:
        """Whether a run left the estimate where the filter without a fault had not."""
        return departure.row < self.equal_poses

    def farther_than(self, other: FaultTrial, departure: RunDeparture) -> bool:
        """Whether a run left by far more than this filter without a fault and another differ by.

        Then the same fault in the other filter leaves the estimate as well; not where the run left
        by little beside what is left without the fault, whose large residuals part both filters,
        and not where it left as without the fault, which may do something in another order only.
        """
        until = slice(departure.row + 1)
        both = list(zip(self._neutral_rows[until], other._neutral_rows[until], strict=False))
        if len(both) <= departure.row:
            return False
        without = float(np.abs(self._neutral_rows[departure.row]).max())
        apart = max(float(np.abs(np.subtract(*in_both(*rows))).max()) for rows in both)
        if abs(departure.distance - without) <= _NO_CHANGE * without:
            return False
        far = self.least + _FAR * apart
        return departure.distance > max(far, _MOST_LEFT * without)

    def of(self, fault: Fault) -> Trial:
        """Try a fault: what it explains, or where its filter leaves the estimate."""
        beside = self._companion()
        try:
            reference = self._run(fault, beside)
        except EstimateLeftError:
            reference = None
        except InputError:
            return Trial()
        with np.errstate(all="ignore"):  # a fault may leave no covariance, or zero
            near = None if reference is None else self._likeness(reference)
        if near is not None and self._equal(near):
            if self._bare is not None and self._equal(self._bare):
                return Trial()  # a fault without effect
            return Trial(Fingerprint(fault.what, self.way.words, near.farthest))
        # Equal so long: then rounding grows, or it breaks down.
        begin_s, end_s = self.given.time_s[[0, -1]]
        share = float((beside.last_s - begin_s) / (end_s - begin_s)) if end_s > begin_s else 0.0
        lasted = beside.poses >= _POSES and beside.sound >= _DIVERGED and share >= LEAST_SHARE
        if lasted and self._wrong_without(beside.last_s):
            until_s = beside.last_s if beside.last_s < end_s else None
            fingerprint = Fingerprint(
                fault.what,
                self.way.words,
                beside.farthest,
                until_s=until_s,
                jumps=beside.jumps(_JUMP),
                share=share,
            )
            return Trial(fingerprint, beside.departure)
        return Trial(None, beside.departure)

    def screened(self, family: Family) -> list[Array]:
        """Return what is left of the poses up to the first few that differ, with a small number.

        Nothing where it moves a pose before these, or does not reach them.
        """
        early = self.equal_poses
        if len(self._neutral_rows) < self._count or early >= self._count:
            return []
        return self._moved(family, min(early + _SCREENED, self._count))

    @cached_property
    def _most_early(self) -> list[Array]:
        """What a small number may leave of the poses before those that differ."""
        return [
            np.abs(neutral_row) + STEP * _NO_EFFECT
            for neutral_row in self._neutral_rows[: self.equal_poses]
        ]

    def _moved(self, family: Family, count: int) -> list[Array]:
        """The same of so many poses."""
        moved = unfitted((family,), NONE, np.empty(0)).moved(0)
        made = remainders(
            self._first, count, lambda beside: self._run(moved, beside), self._most_early
        )
        return made if len(made) == count else []

    def may_fit(self, made: Sequence[Array]) -> bool:
        """Whether some number of a family alone may leave less of the first poses that differ.

        By the difference that a small number makes: in no entry to the other side than in the
        others. made: as `screened` returns it.
        """
        rows, early, count = self._neutral_rows, self.equal_poses, len(made)
        pairs = [in_both(*both) for both in zip(rows[early:count], made[early:count], strict=True)]
        left, change = (np.concatenate(column) for column in zip(*pairs, strict=True))
        with np.errstate(all="ignore"):
            slope = (change - left) / STEP
        if not np.isfinite(slope).all() or not np.abs(slope).max() > 0.0:
            return False
        weight = np.abs(left) / np.abs(left).max()
        felt = np.abs(slope) > 1e-6 * np.abs(slope).max()
        if weight[~felt].max(initial=0.0) > _UNFELT:
            return False
        signs = np.sign(slope * left)[felt & (weight > _UNFELT)]
        same = max(np.count_nonzero(signs > 0), np.count_nonzero(signs < 0))
        return bool(same >= _SAME_SIDE * len(signs))

    def fitted(self, family: Family) -> FaultFit | None:
        """Return the number that fits the first poses best; None where nothing fits.

        It is fitted to the first that differ, then to all.
        """
        if self.neutral is None:
            return None
        few = min(self.equal_poses + _SCREENED, self._count)
        for start in starts(family):
            fit = self._settled(family, start, few)
            if fit is not None:
                return self._settled(family, float(fit.at[0]), self._count)
        return None

    def _settled(self, family: Family, start: float, count: int) -> FaultFit | None:
        """The number that fits so many of the first poses; None where that leaves too much."""
        left = partial(self._left, count=count)
        fit = FaultFit(NONE, (family,), np.array([start]), np.empty(0))
        at_start = left(fit.at_numbers(fit.at))
        if at_start is None:
            return None
        settling = settled(replace(fit, left=at_start), left)
        enough = max(self.least, (1.0 - EXPLAINED) * self._first.sound_until(count))
        return settling if settling is not None and settling.near(enough) else None

    def effects(self, faults: Sequence[Fault], families: Sequence[Family]) -> LinearEffects | None:
        """Return what each does alone to the first poses; None where no filter reaches them."""
        neutral = self.neutral
        if neutral is None:
            return None
        whole = list[tuple[Fault, Array]]()
        for fault in faults:
            left = self._left(fault)
            if left is not None and len(left) == len(neutral):
                whole.append((fault, left - neutral))
        slopes = list[tuple[Family, Array]]()
        for family in families:
            made = np.concatenate([np.empty(0), *self._moved(family, self._count)])
            if len(made) == len(neutral):
                slopes.append((family, (made - neutral) / STEP))
        return LinearEffects(whole, slopes, len(neutral))

    def several(self, effects: LinearEffects) -> tuple[FaultFit, FaultSet] | None:
        """Return the faults that leave the least of the first poses together, with their set.

        None where no filter reaches them. What is left only by rounding ends the search.
        """
        if self.neutral is None or len(self.neutral) != effects.size:
            return None
        best: tuple[FaultFit, FaultSet] | None = None
        left, tried = self.neutral, set[tuple[Fault, tuple[Family, ...]]]()
        for _ in range(_CHOICES):
            before = best
            for faults in effects.likely(left):
                if faults[:2] in tried:
                    continue
                tried.add(faults[:2])
                for fit in self._fits(faults):
                    if best is None or fit.norm < best[0].norm:
                        best = fit, faults
                    if fit.near(self.least):
                        return best
            if best is before or best is None or self._share_left(best[0]) > _SOME:
                break
            left = best[0].left - effects.change(best[0].base, best[0].from_neutral)
        return best

    def _share_left(self, fit: FaultFit) -> float:
        """What a fit leaves of the first poses, as a share of what is left without a fault."""
        without = 0.0 if self.neutral is None else float(np.linalg.norm(self.neutral))
        return fit.norm / without if without else np.inf

    def _fits(self, faults: FaultSet) -> Iterator[FaultFit]:
        """Fits of a set, then, where it leaves little, of those that are nearly the same."""
        fit = self._settled_set(faults.base, faults.families)
        if fit is None:
            return
        yield fit
        if self._share_left(fit) <= _LITTLE:
            for families in islice(faults.others(), _MOST_LIKE):
                other = self._settled_set(faults.base, families)
                if other is not None:
                    yield other

    def as_well(self, faults: FaultSet, named: str, most: int) -> tuple[str, ...]:
        """Return sets that reproduce the estimate as one does, with another in a fault's place.

        named: the one, in words.
        """
        words = list[str]()
        for families in faults.others():
            if len(words) >= most:
                break
            fit = self._settled_set(faults.base, families)
            explained = None if fit is None or not fit.near(self.least) else self.of(fit.fault)[0]
            if explained is not None and explained.whole and explained.fault != named:
                words.append(explained.fault)
        return tuple(words)

    def _settled_set(self, base: Fault, families: tuple[Family, ...]) -> FaultFit | None:
        """The numbers of some families that fit the first poses best beside a fault."""
        left = self.neutral if base is NONE else self._left(base)
        if left is None or self.neutral is None or len(left) != len(self.neutral):
            return None
        return settled(unfitted(families, base, left), self._left)

    def hopeless(self, fit: FaultFit, other: FaultTrial) -> bool:
        """Whether what a fit leaves is far more than what another filter does otherwise."""
        if self.neutral is None or other.neutral is None:
            return False
        if len(self.neutral) != len(other.neutral):
            return False
        apart = float(np.linalg.norm(self.neutral - other.neutral))
        return bool(fit.norm > _FAR * apart)

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
