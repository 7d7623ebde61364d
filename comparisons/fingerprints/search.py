"""Run the reference filter with each known fault, as long as it keeps to the estimate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from comparisons.adapters.motion import CLOCK_S
from comparisons.checks.grade import Likeness
from comparisons.config import SolveConfig
from comparisons.estimates.external import ExternalEstimate
from comparisons.faults.catalogue import catalogue, families, is_setting, own_start
from comparisons.faults.fault import Family, Fault
from comparisons.faults.planting import composed_faults
from comparisons.fingerprints.companion import EXPLAINED
from comparisons.fingerprints.estimate_motion import in_words
from comparisons.fingerprints.fit import FaultFit
from comparisons.fingerprints.trial import FaultTrial, Fingerprint, Way
from comparisons.logs.log import Log
from comparisons.logs.odometry import Named, RelativePoses, own_integration
from comparisons.pipeline.beside import BackgroundCall
from comparisons.pipeline.clock import Progress, no_progress
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.references import KINDS, ORDERS
from comparisons.pipeline.size import counts
from comparisons.words import Cause


def fingerprints(
    given: ExternalEstimate,
    prepared: Prepared[SolveConfig],
    sound: Likeness,
    progress: Progress,
    *,
    several: bool = True,
) -> list[Fingerprint]:
    """Return the faults that explain an estimate, the nearest first.

    given: its poses at the reference's times, and no others. sound: what it is most like of what
    has no fault. several: whether to look for faults that explain it only together. Each fault is
    tried with each order of updates, until a run leaves the estimate; then those of the log's
    numbers in filters of other kinds, and several together; then each with other integrations,
    which another core does meanwhile where one is free. What reproduces it to rounding ends the
    search.
    """
    log, search = prepared.log, _Search(given, prepared, sound)
    ordered = [Way(by, log, order) for order, by in ORDERS.items()]
    kinds = [Way(f"it is {kind}", log, kind) for kind in KINDS]
    moving = [
        Way(", ".join(filter(None, (by, steps))), other, order)
        for steps, other in _integrated(log)
        for order, by in ORDERS.items()
    ]
    found = search.through(ordered, search.faults, progress)
    if not _exact(found):
        composed, numbered = composed_faults(log)
        found += search.through(ordered, composed, progress, exactly=True)
        if not _exact(found):
            found += search.through(ordered, list(families(log)), progress)
        if not _exact(found):
            found += search.through(ordered, numbered, progress, exactly=True)
    if not _exact(found):
        known: list[Fault | Family] = [*search.faults, *families(log)]
        size = counts(prepared)
        with BackgroundCall(search.through, moving, known, size=size, pays_from=0) as second:
            found += search.through(kinds, known, progress)
            if not _exact(found):
                if several:
                    progress("fingerprints together", 0, 0)
                    found += search.together(ordered)
                if not _exact(found):
                    found += second.result()
    return _exact(found) or sorted(found, key=lambda one: one.sigma)


def _exact(found: Iterable[Fingerprint]) -> list[Fingerprint]:
    """The exact one that lasts longest, of several the first; none where none is."""
    exact = sorted((one for one in found if one.exact), key=lambda one: one.rank[:2])
    return exact[:1]


@dataclass(frozen=True)
class _Search:
    """What `fingerprints` was asked for."""

    given: ExternalEstimate
    prepared: Prepared[SolveConfig]
    sound: Likeness

    @property
    def faults(self) -> list[Fault]:
        """The catalogue's, and the estimate's own start."""
        log = self.prepared.log
        return [*_start(self.given, log), *catalogue(log)]

    def _trial(self, way: Way) -> FaultTrial:
        prepared = replace(self.prepared, log=way.log)
        return FaultTrial(self.given, prepared, self.sound, way)

    def through(
        self,
        ways: Sequence[Way],
        todo: Sequence[Fault | Family],
        progress: Progress = no_progress,
        *,
        exactly: bool = False,
    ) -> list[Fingerprint]:
        """What each fault explains, with the way that leaves the least; an exact one is the last.

        In filters of other kinds only faults of the log's numbers are tried. exactly: those that
        leave more than rounding explain nothing.
        """
        found: dict[int, Fingerprint] = {}
        trials = [self._trial(way) for way in ways]
        for done, fault in enumerate(todo):
            progress("fingerprints", done, len(todo))
            for trial in trials:
                if trial.way.name in KINDS and fault.plant is not None:
                    continue
                one = trial.fitted(fault) if isinstance(fault, Family) else trial.of(fault)
                if one is None or (exactly and not one.exact):
                    continue
                if not one.rank > found.get(done, one).rank:
                    found[done] = one
                if one.whole:
                    return [one]
            if _exact(found.values()):
                break
        return list(found.values())

    def together(self, ways: Iterable[Way]) -> list[Fingerprint]:
        """The faults that explain the estimate only together; none where none do."""
        faults, numbers = self.faults, list(families(self.prepared.log))
        left: list[tuple[FaultTrial, FaultFit]] = []
        for trial in (self._trial(way) for way in ways):
            if any(before.hopeless(fit, trial) for before, fit in left):
                continue
            fit = trial.several(faults, numbers)
            if fit is None:
                continue
            left.append((trial, fit))
            found = trial.of(fit.fault) if fit.near(trial.least) else None
            if found is not None and found.exact:
                return [found._replace(several=True)]
        return []


def _start(given: ExternalEstimate, log: Log) -> list[Fault]:
    """The estimate's own prior, where it has one and it is not the log's."""
    if given.pose_covariance is None or abs(given.time_s[0] - log.prior.time_s) > CLOCK_S:
        return []
    own = given.pose_covariance[0]
    positive = np.linalg.eigvalsh(0.5 * (own + own.T))[0] > 0.0
    return [own_start(log, own)] if positive else []


def fault_cause(known: Sequence[Fingerprint], sound: Likeness) -> Cause:
    """Return the faults that explain an estimate as a cause, the first two. sound: as above."""
    first, *rest = known
    if first.exact:
        until = ""
        if first.until_s is not None:
            until = (
                f" over {100.0 * first.share:.0f} % of the time, until both diverge at "
                f"{first.until_s:.2f} s"
            )
        way = f"; {first.way}" if first.way else ""
        these = "these faults" if first.several else "this fault"
        return Cause(
            "fault",
            f"{first.fault}: with {these} the reference filter equals the estimate{until} "
            f"({first.sigma:.1g} sigma; without it {sound.farthest:.2g}){way}",
            "the log and the filter state different ones: correct the one that is wrong"
            if is_setting(first.fault)
            else "correct this in the filter",
        )
    others = [f"{one.fault} ({one.sigma:.2g})" for one in rest[:1]]
    named = ", or: ".join((f"{first.fault} ({first.sigma:.2g} sigma)", *others))
    return Cause(
        "fault",
        f"one of the known faults explains {100.0 * EXPLAINED:.0f} % of the difference from the "
        f"reference filter ({sound.farthest:.2g} sigma): {named}",
        f"look in the filter for this: {first.fault}",
    )


def _integrated(log: Log) -> Iterator[tuple[str, Log]]:
    """Yield the log with each other integration, and that in words."""
    if not isinstance(log.odometry, RelativePoses):
        ours = log.integration or own_integration(log.odometry)
        for other in get_args(Named):
            if other != ours:
                yield f"it integrates steps {in_words(other)}", replace(log, integration=other)
