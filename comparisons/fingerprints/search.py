"""Run the reference filter with each known fault, as long as it keeps to the estimate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import get_args

from comparisons.adapters.motion import CLOCK_S
from comparisons.checks.grade import Likeness
from comparisons.config import SolveConfig
from comparisons.covariances import definite
from comparisons.estimates.external import ExternalEstimate
from comparisons.faults.catalogue import is_setting, own_start
from comparisons.faults.fault import Family, Fault
from comparisons.faults.streams import stream_families, stream_faults
from comparisons.faults.tried import TriedFaults
from comparisons.fingerprints.estimate_motion import in_words, integrations_by_steps
from comparisons.fingerprints.fit import FaultFit
from comparisons.fingerprints.trial import FaultTrial, Fingerprint, Way
from comparisons.logs.log import Log
from comparisons.logs.odometry import Named, RelativePoses, own_integration
from comparisons.pipeline.clock import Progress
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.references import KINDS, ORDERS
from comparisons.words import Cause

_MOST_OTHERS = 2
"""Most faults that are named beside one that reproduces an estimate as well."""


def fingerprints(
    given: ExternalEstimate,
    prepared: Prepared[SolveConfig],
    sound: Likeness,
    progress: Progress,
    *,
    several: bool = True,
) -> list[Fingerprint]:
    """Return what reproduces an estimate to rounding: one at most, with what does so as well.

    given: its poses at the reference's times, and no others. sound: what it is most like of what
    has no fault. several: whether to look for faults that explain it only together. The simplest
    are tried first: faults without a number, with one, two joined, those of filters of other
    kinds, and several together. Each runs until it leaves the estimate, in a filter of another
    order of updates or integration only where that may make the difference.
    """
    search, tried = _Search(given, prepared, sound, progress), TriedFaults(prepared.log)
    return (
        search.without_number([*_start(given, prepared.log), *tried.single])
        or search.with_number(tried.numbered)
        or search.without_number(tried.joined)
        or search.of_kinds()
        or (search.together() if several else [])
    )


def _joined(found: Sequence[Fingerprint]) -> list[Fingerprint]:
    """The one that lasts longest, of several the first, with the others that last as long."""
    if not found:
        return []
    first, *others = sorted(found, key=lambda fingerprint: fingerprint.rank[0])
    if first.whole:
        also = [
            fingerprint.fault
            for fingerprint in others
            if fingerprint.whole and fingerprint.way == first.way
        ]
        first = first._replace(others=tuple(dict.fromkeys(also))[:_MOST_OTHERS])
    return [first]


class _Search:
    """What `fingerprints` was asked for.

    trials: filters without a fault that equal the estimate for as long as any does. lasting,
    fitting: faults and families that do not contradict the estimate before it leaves these.
    """

    def __init__(
        self,
        given: ExternalEstimate,
        prepared: Prepared[SolveConfig],
        sound: Likeness,
        progress: Progress,
    ) -> None:
        """progress: is told what is tried."""
        self.given, self.prepared, self.sound, self.progress = given, prepared, sound, progress
        log, known = prepared.log, integrations_by_steps(given, prepared) is not None
        moving = [("", log), *([] if known else _integrated(log))]
        trials = [
            self._trial(Way(", ".join(filter(None, (by, steps))), other, order))
            for steps, other in moving
            for order, by in ORDERS.items()
        ]
        lasts = max(trial.equal_poses for trial in trials)
        self.trials = [trial for trial in trials if trial.equal_poses == lasts]
        self.fitting: list[Family] = []
        self.lasting: list[Fault] = []

    def _trial(self, way: Way) -> FaultTrial:
        prepared = replace(self.prepared, log=way.log)
        return FaultTrial(self.given, prepared, self.sound, way)

    def without_number(self, faults: Sequence[Fault]) -> list[Fingerprint]:
        """What reproduces the estimate, of faults without a number."""
        explained = list[Fingerprint]()
        for done, fault in enumerate(faults):
            self.progress("fingerprints", done, len(faults))
            fingerprint, early = self._tried(fault)
            explained += [] if fingerprint is None else [fingerprint]
            if not early:
                self.lasting.append(fault)
            if sum(fingerprint.whole for fingerprint in explained) > _MOST_OTHERS:
                break
        return _joined(explained)

    def _tried(self, fault: Fault) -> tuple[Fingerprint | None, bool]:
        """What a fault explains in the filter where it explains the most; whether it left early."""
        first, *others = self.trials
        tried = first.of(fault)
        best = tried.explained
        early = tried.departure is not None and first.is_early(tried.departure)
        if best is not None and best.whole:
            return best, False
        for trial in others:
            if tried.departure is not None and first.farther_than(trial, tried.departure):
                continue
            fingerprint = trial.of(fault).explained
            if fingerprint is not None and (best is None or fingerprint.rank < best.rank):
                best = fingerprint
            if best is not None and best.whole:
                break
        return best, early

    def with_number(self, every: Sequence[Family]) -> list[Fingerprint]:
        """What reproduces the estimate, of faults with a number: with the one that fits."""
        explained, first = list[Fingerprint](), self.trials[0]
        for done, family in enumerate(every):
            self.progress("fingerprints with a number", done, len(every))
            made = first.screened(family)
            if not made:
                continue
            self.fitting.append(family)
            if not first.may_fit(made):
                continue
            for trial in self.trials:
                fit = trial.fitted(family)
                found = None if fit is None else trial.of(fit.fault).explained
                explained += [] if found is None else [found]
                if fit is None or found is not None:
                    break
            if sum(fingerprint.whole for fingerprint in explained) > _MOST_OTHERS:
                break
        return _joined(explained)

    def of_kinds(self) -> list[Fingerprint]:
        """What reproduces the estimate in filters of other equations: faults of the log's."""
        log, explained = self.prepared.log, list[Fingerprint]()
        faults = [
            fault for fault in (*_start(self.given, log), *stream_faults(log)) if not fault.plant
        ]
        for kind in KINDS:
            trial = self._trial(Way(f"it is {kind}", log, kind))
            explained += filter(None, (trial.of(fault).explained for fault in faults))
            for family in stream_families(log):
                made = trial.screened(family)
                fit = trial.fitted(family) if made and trial.may_fit(made) else None
                found = None if fit is None else trial.of(fit.fault).explained
                explained += [] if found is None else [found]
            if any(fingerprint.whole for fingerprint in explained):
                break
        return _joined(explained)

    def together(self) -> list[Fingerprint]:
        """The faults that explain the estimate only together; none where none do."""
        self.progress("fingerprints together", 0, 0)
        effects = self.trials[0].effects(self.lasting, self.fitting)
        if effects is None:
            return []
        left: list[tuple[FaultTrial, FaultFit]] = []
        for trial in self.trials:
            if any(before.hopeless(fit, trial) for before, fit in left):
                continue
            fitted = trial.several(effects)
            if fitted is None:
                continue
            fit, faults = fitted
            left.append((trial, fit))
            explained = trial.of(fit.fault).explained if fit.near(trial.least) else None
            if explained is not None:
                if explained.whole:
                    others = trial.as_well(faults, explained.fault, _MOST_OTHERS)
                    explained = explained._replace(others=others)
                return [explained._replace(several=True)]
        return []


def _start(given: ExternalEstimate, log: Log) -> list[Fault]:
    """The estimate's own prior, where it has one and it is not the log's."""
    if given.pose_covariance is None or abs(given.time_s[0] - log.prior.time_s) > CLOCK_S:
        return []
    covariance = given.pose_covariance[0]
    positive = definite(0.5 * (covariance + covariance.T)[None])[0]
    return [own_start(log, covariance)] if positive else []


def fault_cause(known: Fingerprint, sound: Likeness) -> Cause:
    """Return what reproduces an estimate as a cause. sound: as above."""
    until = ""
    if known.until_s is not None:
        ends = "another difference begins" if known.jumps else "both diverge"
        until = (
            f" over {100.0 * known.share:.0f} % of the time, until {ends} at {known.until_s:.2f} s"
        )
    way = f"; {known.way}" if known.way else ""
    these = "these faults" if known.several else "this fault"
    also = "".join(f", or: {other}" for other in known.others)
    return Cause(
        "fault",
        f"{known.fault}{also}: with {these} the reference filter equals the estimate{until} "
        f"({known.sigma:.1g} sigma; without it {sound.farthest:.2g}){way}",
        "the log and the filter state different ones: correct the one that is wrong"
        if is_setting(known.fault)
        else "correct this in the filter",
    )


def _integrated(log: Log) -> Iterator[tuple[str, Log]]:
    """Yield the log with each other integration, and that in words."""
    if not isinstance(log.odometry, RelativePoses):
        ours = log.integration or own_integration(log.odometry)
        for other in get_args(Named):
            if other != ours:
                yield f"it integrates steps {in_words(other)}", replace(log, integration=other)
