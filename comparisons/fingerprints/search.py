"""Run the reference filter with each known fault, as long as it keeps to the estimate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple, get_args

import numpy as np

from comparisons.adapters.filter_loop import FilterObserver, NoObserver
from comparisons.adapters.motion import CLOCK_S
from comparisons.arrays import Array
from comparisons.checks.causes import Cause
from comparisons.checks.grade import Likeness, Reference, likeness
from comparisons.config import SolveConfig
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.faults.catalogue import catalogue, families, own_start
from comparisons.faults.fault import Family, Fault
from comparisons.fingerprints.companion import EXPLAINED, NEAR, Companion, First, Left
from comparisons.logs.log import Log
from comparisons.logs.odometry import Named, RelativePoses, own_integration
from comparisons.pipeline.estimate_motion import in_words
from comparisons.pipeline.prepare import Prepared, Progress
from comparisons.pipeline.references import KINDS, ORDERS, filter_named
from ekf_reference.core.ekf import Ekf

_DIVERGED = 1.0
"""A filter with a fault that reproduces the estimate until the sound one is so many sigma off has
this fault, whatever becomes of it: where a filter diverges, rounding grows."""
_POSES = 10
"""A number is fitted to the poses until the sound filter leaves the estimate, and so many more."""
_ROUNDS, _STEP, _MOST_STEP = 12, 1e-4, 1.5
"""Of a fit: rounds, the step of a difference, and the largest of a round, in the number or its
logarithm."""
_ALONG = 0.7
"""Least cosine between what is left and what the number changes; another fault has less."""


class Fingerprint(NamedTuple):
    """A fault that explains an estimate.

    fault: in words. way: how else the filter differs from the reference EKF, in words. sigma: the
    largest difference that is left. exact: none but rounding is. until_s: when the filter with the
    fault, diverging, leaves the estimate or breaks down; None where it does not.
    """

    fault: str
    way: str
    sigma: float
    exact: bool
    until_s: float | None = None

    @property
    def whole(self) -> bool:
        """Whether it reproduces all of the estimate."""
        return self.exact and self.until_s is None


def fingerprints(
    given: ExternalEstimate, prepared: Prepared[SolveConfig], sound: Likeness, progress: Progress
) -> list[Fingerprint]:
    """Return the faults that explain an estimate, the nearest first.

    given: its poses at the reference's times, and no others. sound: what it is most like of what
    has no fault. Each fault is tried with each integration and order of updates, and those of the
    log's numbers in filters of other kinds, until a run leaves the estimate. One that reproduces it
    to rounding ends the search.
    """
    found: dict[str, Fingerprint] = {}
    todo = [*_start(given, prepared.log), *catalogue(prepared.log), *families(prepared.log)]
    trials = [
        (
            ", ".join(filter(None, (by, steps))),
            _Trial(given, replace(prepared, log=log), sound, order),
        )
        for steps, log in _integrated(prepared.log)
        for order, by in ORDERS.items()
    ]
    kinds = [(f"it is {kind}", _Trial(given, prepared, sound, kind)) for kind in KINDS]
    for done, fault in enumerate(todo):
        progress("fingerprints", done, len(todo))
        exact: Fingerprint | None = None
        for way, trial in (*trials, *(kinds if fault.plant is None else ())):
            one = trial.fitted(fault) if isinstance(fault, Family) else trial.of(fault)
            if one is None or (one.sigma > found.get(fault.what, one).sigma and not one.whole):
                continue
            one = found[fault.what] = one._replace(way=way)
            if one.whole:
                return [one]
            if one.exact:
                exact = exact or one
        if exact is not None:
            return [exact]
    return sorted(found.values(), key=lambda one: one.sigma)


def _start(given: ExternalEstimate, log: Log) -> list[Fault | Family]:
    """The estimate's own prior, where it has one and it is not the log's."""
    if given.pose_covariance is None or abs(given.time_s[0] - log.prior.time_s) > CLOCK_S:
        return []
    own = given.pose_covariance[0]
    if not np.linalg.eigvalsh(0.5 * (own + own.T))[0] > 0.0:
        return []
    return [own_start(log, own)]


def fault_cause(known: Sequence[Fingerprint], sound: Likeness) -> Cause:
    """Return the faults that explain an estimate as a cause, the first two. sound: as above."""
    first, *rest = known
    if first.exact:
        until = "" if first.until_s is None else f" until it diverges at {first.until_s:.2f} s"
        way = f"; {first.way}" if first.way else ""
        return Cause(
            "fault",
            f"{first.fault}: with this fault the reference filter equals the estimate{until} "
            f"({first.sigma:.1g} sigma; without it {sound.farthest:.2g}){way}",
            f"correct this in the filter: {first.fault}",
        )
    others = [f"{one.fault} ({one.sigma:.2g})" for one in rest[:1]]
    named = ", or: ".join((f"{first.fault} ({first.sigma:.2g} sigma)", *others))
    return Cause(
        "fault",
        f"one of the known faults explains {100.0 * EXPLAINED:.0f} % of the difference from the "
        f"reference filter ({sound.farthest:.2g} sigma): {named}",
        f"look in the filter for this: {first.fault}",
    )


class _Trial:
    """One filter, without a fault as yet. sound: as of `fingerprints`. name: of FILTERS."""

    def __init__(
        self,
        given: ExternalEstimate,
        prepared: Prepared[SolveConfig],
        sound: Likeness,
        name: str,
    ) -> None:
        self.given, self.prepared, self.sound, self.name = given, prepared, sound, name
        beside = Companion(given, sound)
        self._first, self._count = beside, beside.first(_POSES)

    @cached_property
    def _neutral(self) -> Array | None:
        """What is left of the first poses without a fault."""
        return self._left(Fault("none"))

    @cached_property
    def _bare(self) -> Likeness | None:
        """The filter without a fault beside the estimate; None where it cannot run."""
        found = self._run(Fault("none"), NoObserver())
        if found is None:
            return None
        return likeness(self.given, found, labelled=self.prepared.labelled)

    def _wrong_without(self, until_s: float) -> bool:
        """Whether the filter without a fault had left the estimate for good by then."""
        if self._bare is None:
            return True
        return Companion(self.given, self._bare).sound_at(until_s) >= _DIVERGED

    def _left(self, fault: Fault) -> Array | None:
        """What is left of the first poses; None where the filter does not reach them all."""
        seen = First(self._first, self._count)
        try:
            self._run(fault, seen)
        except Left:
            return np.concatenate(seen.left)
        except InputError:
            return None
        return np.concatenate(seen.left) if len(seen.left) == self._count else None

    def of(self, fault: Fault) -> Fingerprint | None:
        """What a fault explains; None where its filter leaves the estimate, or cannot run."""
        beside = Companion(self.given, self.sound)
        try:
            found = self._run(fault, beside)
        except Left:
            found = None
        except InputError:
            return None
        near = None
        if found is not None:
            with np.errstate(invalid="ignore"):  # a fault may leave no covariance
                near = likeness(self.given, found, labelled=self.prepared.labelled)
        if near is not None and near.grade == "equal":
            if self._bare is not None and self._bare.grade == "equal":
                return None  # a fault without effect
            return Fingerprint(fault.what, "", near.farthest, exact=True)
        # Equal so long: then rounding grows, or it breaks down.
        if beside.sound >= _DIVERGED and self._wrong_without(beside.last_s):
            return Fingerprint(fault.what, "", beside.farthest, exact=True, until_s=beside.last_s)
        if near is None or not near.farthest <= (1.0 - EXPLAINED) * self.sound.farthest:
            return None
        return Fingerprint(fault.what, "", near.farthest, exact=False)

    def fitted(self, family: Family) -> Fingerprint | None:
        """What a family explains with the number that fits the first poses best.

        By Gauss and Newton; the derivative is a difference. None where nothing fits.
        """

        def member(number: float) -> Fault:
            return family.member(float(np.exp(number)) if family.factor else number)

        at = float(np.log(family.neutral)) if family.factor else family.neutral
        now = self._neutral
        for _ in range(_ROUNDS):
            other = None if now is None else self._left(member(at + _STEP))
            if now is None or other is None:
                return None
            slope = (other - now) / _STEP
            along = float(slope @ now)
            if along**2 < _ALONG**2 * (slope @ slope) * (now @ now) or not along:
                break  # rounding is left, or another fault
            step = float(np.clip(-along / (slope @ slope), -_MOST_STEP, _MOST_STEP))
            at, now = at + step, self._left(member(at + step))
            if abs(step) < _STEP**2 or now is None or np.abs(now).max() <= 1e-3 * NEAR:
                break
        enough = max(NEAR, (1.0 - EXPLAINED) * self._first.sound_until(self._count))
        if now is None or np.abs(now).max() > enough:
            return None
        return self.of(member(at))

    def _run(self, fault: Fault, beside: FilterObserver) -> Reference | None:
        def started(ekf: Ekf) -> FilterObserver:
            if fault.plant is not None:
                fault.plant(ekf)
            return beside

        log = self.prepared.log if fault.feed is None else fault.feed(self.prepared.log)
        other = replace(self.prepared, log=log)
        with np.errstate(all="ignore"):  # a fault may make it diverge
            return filter_named(self.name, other, self.given.time_s, started)


def _integrated(log: Log) -> Iterator[tuple[str, Log]]:
    """Yield the log with each integration, and what is other than the log's in words."""
    yield "", log
    if not isinstance(log.odometry, RelativePoses):
        ours = log.integration or own_integration(log.odometry)
        for other in get_args(Named):
            if other != ours:
                yield f"its steps lead {in_words(other)}", replace(log, integration=other)
