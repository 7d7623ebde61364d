"""What of a filter's algebra is wrong: its snapshots beside the recursion over its events.

The recursion goes on from each snapshot that is wrong, so that every fault is found where it
happens. For `audit`, which has a trace, and for `run`, which goes through its filter once more.
"""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
from scipy.linalg.lapack import dpotrf

from comparisons.arrays import Array, Index
from comparisons.audit.replay import (
    BlockLayout,
    Fused,
    LongFormReplay,
    Replay,
    Unlike,
    check_gain,
)
from comparisons.covariances import entry_differences, units
from comparisons.explain.events import MOST_REPLAYED, EventCause, KnownFault, localise
from comparisons.faults.of_angles import told_gain
from comparisons.faults.of_corrections import name_correction, name_gain
from comparisons.faults.recursion import Remembering
from comparisons.faults.substitutions import continued
from comparisons.rounding import (
    ALL_BUT,
    BESIDE,
    FORMS,
    LEFT,
    LOST,
    NOTHING,
    ROUNDING,
    SINGLE_SIGMA,
    VANISHED,
    along_directions,
    stored_rounding,
)
from comparisons.trace.events import (
    Augment,
    Blocks,
    Clone,
    Directions,
    Evaluation,
    Event,
    Predict,
    Remove,
    Reset,
    Snapshot,
    TracePrior,
    Update,
)

MOST_SEARCHED = 20
"""Faults of the algebra whose cause is sought; more of other causes are counted."""
_MOST_CORRECTIONS = 4
"""Gains and corrections that were not named, after which no other's name is sought."""
_MOST_UNNAMED, _MOST_UNNAMED_IN_ALL = 2, 8
"""Events of a kind, and of all, whose cause was not found, after which no other's is sought."""
MOST_KEPT = 5_000
"""Events since the last snapshot that are kept for this."""
_REMEMBERED = 64
"""Events before a snapshot whose matrices may have been used in place of a later one's."""
_SMALL = 0.01
"""A correction, in radians, below which a reset may as well be the identity."""
_SLIGHT = 1e-3
"""Products of two sigmas by which a covariance may be off and explain no figure of consistency."""
_UNTOLD = "and the covariance is compared with nothing: record the gains"
_OF_EVENTS = ("noise", "use", "derivatives", "covariance", "algebra", "correction", "gain")
"""Checks that tell what is wrong at an event; the others tell what follows."""


@dataclass(frozen=True)
class AuditFinding:
    """What the audit found.

    Attributes:
        check: noise, use, derivatives, algebra, covariance, correction, gain, precision,
            innovations, smoother, nees or spurious.
        fault: whether it makes the trace faulty; what is only named does not.
        text: the finding as a sentence.
        event: number of the event where it is first seen.
        sensor: the sensor it is of.
        blocks: the blocks it is of.
        time_s: time of that event, or of the last one before it that has one; None where none has.
    """

    check: str
    fault: bool
    text: str
    event: int | None
    _: KW_ONLY
    sensor: str | None = None
    blocks: Blocks = ()
    time_s: float | None = None


class _Resets:
    """Whether resets do nothing. largest: of the corrections before them. first: of their events.

    The Jacobian of a reset is other than the identity by about half of the correction, in radians.
    """

    def __init__(self) -> None:
        self.largest, self.first, self._count, self._nothing = 0.0, 0, 0, True
        self._corrected = 0.0

    @property
    def all_nothing(self) -> bool:
        return self._nothing and self._count > 1 and self.largest > _SMALL

    def take(self, event: Event) -> None:
        match event:
            case Update() if event.used and event.correction is not None and self._nothing:
                self._corrected = max(self._corrected, float(np.abs(event.correction).max()))
            case Reset() if self._nothing:
                self.first = self.first or event.number
                self.largest = max(self.largest, self._corrected)
                self._nothing = np.array_equal(event.jacobian, np.eye(len(event.jacobian)))
                self._count, self._corrected = self._count + 1, 0.0


class AlgebraCheck:
    """Goes through events, the prior first, and keeps what it finds.

    replay: the recursion. sound: no snapshot was wrong; optimal: no gain was other than Kalman's.
    gains: how many gains and corrections were compared with Kalman's. unlike: how many of them are
    others. known: the recursion stands
    for what the filter holds; not so from a noise that is no covariance to the next whole snapshot.
    """

    replay: Replay

    def __init__(self, tolerance: float = ROUNDING) -> None:
        """tolerance: what rounding explains, in standard deviations."""
        self.tolerance = tolerance
        self.sound = self.optimal = self.known = True
        self.gains = self.unlike = 0
        self._known: dict[str, KnownFault] = {}
        self._searched = 0
        self._broken: set[str] = set()
        self._found: dict[str, tuple[AuditFinding, float | None, int, float]] = {}
        self._pending: list[tuple[AuditFinding, str]] = []
        self._start: Replay | None = None
        self._kept: list[Event] = []
        self._first: list[Event] = []
        self._recent: deque[Event] = deque(maxlen=_REMEMBERED)
        self._unnamed = 0
        self._open: dict[int, Update] = {}
        self._rounding: Array | None = None
        self._largest: Array
        self._resets = _Resets()
        self._last: Event
        self._last_before: Array | None = None
        self._earlier: Array | None = None
        self._stale: Array | None = None
        self._prior: Array | None = None
        self._since = "the prior"
        self._numbers: dict[str, Array] = {}
        self._proposed = False
        self._unlike_any: Counter[str] = Counter()
        self._raw: Array | None = None

    @property
    def before(self) -> Array | None:
        """(n, n) P before the last event that changed it; None where that is not known."""
        return self._last_before

    def take(self, event: Event, unsound: str = "") -> Fused | None:
        """Do an event, or compare a snapshot; return what an update came to, if that is known.

        unsound: what is wrong with its noise, or the prior's P, where that is no covariance.
        """
        if isinstance(event, Directions | Evaluation):
            return None
        if unsound:
            self._last = event
            event = self._unsound(event, unsound)
        self._estimate(event)
        self._resets.take(event)
        if isinstance(event, Snapshot):
            self._snapshot(event)
            self._since = f"the snapshot at event {event.number}"
            return None
        self._last = event
        if isinstance(event, TracePrior):
            self.replay = Replay(event)
            self._prior = self.replay.covariance.copy()
            self._largest = self.replay.covariance.diagonal().copy()
            if self.known:
                self._restart()
            return None
        if self._start is not None:
            self._kept.append(event)
            if len(self._kept) > MOST_KEPT:
                self._start = None
        before = self._covariance_before(event)
        self._earlier, self._last_before = self._last_before, before
        if self._rounding is not None:
            self._rounding = self._carry(self._rounding, event)
        self._largest = self._carry(self._largest, event)
        fused = self.replay.apply(event)
        self._largest = np.maximum(self._largest, self.replay.covariance.diagonal())
        if fused is not None:
            self._note_known(before, fused)
        if not self.known:
            return None
        if isinstance(event, Update) and event.used and fused is not None:
            self._gain(event, fused, before)
        return fused

    def _covariance_before(self, event: Event) -> Array:
        """P before an event; a copy where the event may change it in place."""
        p = self.replay.covariance
        return p.copy() if isinstance(event, Predict | Reset) else p

    def _unsound(self, event: Event, what: str) -> Event:
        """Name a noise that is no covariance; return the event with a sound one in its place.

        What it leads to is compared with nothing, up to the next whole snapshot.
        """
        self._confirm(None)
        sensor = event.sensor if isinstance(event, Update) else None
        text = f"{name_of(event)}: {what}"
        number = event.number
        self.add(AuditFinding("noise", True, text, number, sensor=sensor), what, float("inf"))
        self.known = self.sound = False
        self._start, self._kept = None, []
        if isinstance(event, TracePrior):
            return event._replace(covariance=np.eye(len(event.covariance)))
        if isinstance(event, Predict | Update | Augment):
            return event._replace(noise=np.eye(len(event.noise)))
        return event

    def add(self, finding: AuditFinding, kind: str, weight: float = 0.0) -> None:
        """Keep the first finding of a kind, and count the others.

        weight: of a finding that is not of one event; what weighs more goes first. Negative of one
        event's that is slight.
        """
        key = f"{finding.check}|{finding.sensor}|{kind}"
        first, seen_s, count, most = self._found.get(key, (finding, self._last.time_s, 0, weight))
        self._found[key] = first, seen_s, count + 1, max(most, weight)

    def end(self) -> None:
        """Accept what was found since the last snapshot, and of the trace as a whole."""
        self._note_gains(_UNTOLD)
        self._confirm(None)
        if self._resets.all_nothing:
            text = f"all resets are the identity, though {self._resets.largest:.2g} is corrected "
            text += "before them: is the Jacobian made after the correction is set to zero?"
            number = self._resets.first
            self.add(AuditFinding("covariance", False, text, number), "resets")

    def findings(self, *, timed: bool = False) -> tuple[AuditFinding, ...]:
        """Return findings, faults first, those of one event's algebra before the others by weight.

        What is slight goes last. timed: with the time at which each is first seen, where events
        have times.
        """
        found, never = [], float("inf")
        for first, seen_s, count, weight in self._found.values():
            at = f" (at {seen_s:.6g} s)" if timed and seen_s is not None else ""
            more = f"; and {count - 1:,} more" if count > 1 else ""
            of_one_event = first.check in _OF_EVENTS
            event = first.event if of_one_event and first.event is not None else never
            late = not of_one_event or weight < 0.0
            order = not first.fault, late, -weight, event, first.check != "covariance"
            found.append((order, replace(first, text=first.text + at + more)))
        return tuple(one for _, one in sorted(found, key=lambda pair: pair[0]))

    def faults(self) -> tuple[str, ...]:
        """Return all faults in words, with their times where events have them."""
        self.end()
        return tuple(finding.text for finding in self.findings(timed=True) if finding.fault)

    def _gain(self, event: Update, fused: Fused, before: Array) -> None:
        """Compare gain and correction with Kalman's. before: P before the update."""
        if event.gain is None and event.correction is None:
            return
        self.gains += 1
        layout = self.replay.layout
        least = 0.0 if self._rounding is None else self._rounding
        sigma: Array = np.sqrt(np.maximum(self.replay.covariance.diagonal(), least))
        unlike = check_gain(event, fused, sigma, layout, self.tolerance)
        if unlike:
            self.unlike += 1
            self.note_precision(event.number, event.gain, event.correction)
            if event.gain is None:
                self._open[event.number] = event
        for mismatch in unlike:
            what = (self._name(event, before, mismatch) if mismatch.kind else None) or mismatch.what
            text = f"{name_of(event)} {what}"
            check = "correction" if mismatch.fault else "gain"
            finding = AuditFinding(
                check,
                mismatch.fault,
                text,
                event.number,
                sensor=event.sensor,
                blocks=mismatch.blocks,
            )
            kind = mismatch.kind if what == mismatch.what and mismatch.kind else what
            self._pending.append((finding, kind))
        if unlike:
            self._growth(event, before)

    def _growth(self, event: Update, before: Array) -> None:
        """Name a gain by which an update makes the estimate less certain. before: P before it.

        What a correction leaves of the error of what is measured is I - H K: where an eigenvalue
        of it is beyond one, it makes the error larger, and with each such update more so.
        """
        gain, p = event.gain, self.replay.covariance
        if gain is None or not np.isfinite(p).all():
            return
        was, now, layout = before.diagonal(), p.diagonal(), self.replay.layout
        unit = np.maximum(was, 0.0 if self._rounding is None else self._rounding)
        grown = now > was + self.tolerance * unit + NOTHING
        if not grown.any():
            return
        left = np.eye(len(event.noise)) - event.jacobian @ gain[layout.columns(event.blocks)]
        factor = float(np.abs(np.linalg.eigvals(left)).max()) if np.isfinite(left).all() else 0.0
        names = tuple(name for name in layout.dims if grown[layout.entries(name)].any())
        text = f"{name_of(event)} makes {', '.join(names)} less certain by its gain"
        if fault := factor > 1.0 + self.tolerance:
            text += f", which leaves {factor:.3g} times the error of what is measured: it diverges"
        finding = AuditFinding("gain", fault, text, event.number, sensor=event.sensor, blocks=names)
        self._pending.append((finding, f"less certain {fault}"))

    def _name(self, event: Update, before: Array, unlike: Unlike) -> str | None:
        """Say of what a gain or a correction is, if it is known. before: P before the update."""
        if self._unnamed >= _MOST_CORRECTIONS:
            return None
        replay = self._remembering(self.replay)
        replay.covariance, replay.stale = before, self._earlier
        for one in self._kept[:-1]:
            replay.remember(one)
        with np.errstate(all="ignore"):
            if unlike.fault:
                correction = name_correction(event, replay)
                said = None if correction is None else f"corrects the estimate by {correction}"
            else:
                gain = name_gain(event, replay)
                said = None if gain is None else f"uses the gain of an update where {gain.kind}"
        self._unnamed += said is None
        return said

    def _remembering(self, replay: Replay) -> Remembering:
        """Return a recursion that goes on from another, and knows the events before this interval.

        Those are the first of all, and some before the last snapshot.
        """
        return Remembering(replay, (*self._first, *self._recent), self._stale, self._prior)

    def _snapshot(self, snapshot: Snapshot) -> None:
        """Compare a snapshot with the recursion, which goes on from it where it is wrong."""
        if not np.isfinite(snapshot.covariance).all():
            text, number = f"{name_of(self._last)} leads to no finite covariance", snapshot.number
            self.add(AuditFinding("covariance", True, text, number), "not finite")
            return
        at = self.replay.layout.columns(snapshot.blocks)
        recorded, right = snapshot.covariance, self.replay.covariance[at][:, at]
        whole = len(recorded) == self.replay.layout.size and isinstance(at, slice)
        if not self.known:
            if whole:
                self.replay.covariance, self.known = 0.5 * (recorded + recorded.T), True
                self._restart()
            return
        if self._open and not whole:
            return  # what the gains have led to is told by the next one of the whole state
        least = self._least(snapshot.blocks)
        wrong = self._differs(recorded, right, least)
        if wrong and self._start is not None:
            wrong = self._differs_from_before(self._start, recorded, at, least)
        if self._open:
            wrong = self._is_wrong_for_any_gain(recorded, least, wrong)
        if wrong and not (not whole and self._broken >= set(snapshot.blocks)):
            difference = np.abs(entry_differences(recorded, right, least)).max()
            slight = bool(difference < _SLIGHT)
            wrong = self._localise(snapshot, -1.0 if slight else 0.0)
        else:
            self._confirm(None)
            # What an earlier error has made invalid is no second one.
            if wrong or self.sound:
                self._invalid(snapshot)
        if wrong:
            self.sound = False
            self._broken = set() if whole else self._broken | set(snapshot.blocks)
            if whole:
                self.replay.covariance = 0.5 * (recorded + recorded.T)
        if whole or self._start is not None:
            self._restart(recorded if whole else None)

    def _note_known(self, before: Array, fused: Fused) -> None:
        """Note entries of which an update leaves nothing but rounding. before: P before it."""
        was, now = before.diagonal(), self.replay.covariance.diagonal()
        if not (now <= ALL_BUT * was).any():
            return
        # What cancels in P - K S K^T is as large as this, more than P where K is.
        spread = np.sqrt(np.maximum(fused.spread.diagonal(), 0.0))
        size = np.maximum(was, (np.abs(fused.gain) @ spread) ** 2)
        known = now <= np.maximum(VANISHED * size, LEFT * self._largest)
        old = np.zeros(len(was)) if self._rounding is None else self._rounding
        self._rounding = np.where(known, np.maximum(BESIDE * size, old), old)

    def _carry(self, variances: Array, event: Event) -> Array:
        """Return bounds of variances (n,) after an event that makes no entry more certain."""
        layout = self.replay.layout
        match event:
            case Predict() | Reset():
                at, led = layout.columns(event.blocks), variances.copy()
                led[at] = (np.abs(event.jacobian) @ np.sqrt(variances[at])) ** 2
                return led
            case Augment():
                of = np.sqrt(variances[layout.columns(event.blocks)])
                return np.concatenate((variances, (np.abs(event.jacobian) @ of) ** 2))
            case Clone():
                return np.concatenate((variances, variances[layout.entries(event.source)]))
            case Remove():
                stays = np.ones(len(variances), dtype=bool)
                for name in event.blocks:
                    stays[layout.entries(name)] = False
                return variances[stays]
        return variances

    def _least(self, blocks: Blocks) -> Array | None:
        """(n,) variances of blocks below which there is nothing but rounding."""
        if self._rounding is None:
            return None
        return self._rounding[self.replay.layout.columns(blocks)]

    def _differs(
        self, recorded: Array, right: Array, least: Array | None, rounding: float = 0.0
    ) -> bool:
        """Whether two covariances are apart by more than the tolerance, along any direction.

        least: variances that are rounding. rounding: along any direction, in products of two
        sigmas, if it is more than usual.
        """
        off = entry_differences(recorded, right, least)
        largest = float(np.abs(off).max())
        if not largest <= self.tolerance:
            return True
        rounding = max(along_directions(recorded), rounding)
        if len(off) * largest <= rounding:
            return False
        unit = units(recorded, right, least)
        allowed = self.tolerance * right / np.outer(unit, unit) + rounding * np.eye(len(off))
        off = 0.5 * (off + off.T)
        return not all(_definite(allowed + sign * off) for sign in (1.0, -1.0))

    def _differs_from_before(
        self, start: Replay, recorded: Array, at: slice | Index, least: Array | None
    ) -> bool:
        """Whether a snapshot differs from what the events make of the one before, as recorded.

        Where it does not, what it differs by was rounding there, and the recursion goes on so.
        """
        if self._raw is not None and self._goes_on_uneven(recorded, at, least):
            return False
        again, other = start.copy(), LongFormReplay.of(start)
        with np.errstate(all="ignore"):
            for event in self._kept:
                again.apply(event)
                other.apply(event)
            right = again.covariance[at][:, at]
            between = entry_differences(right, other.covariance[at][:, at], least)
            forms = float(np.abs(between).max())
        if self._differs(recorded, right, least, FORMS * forms):
            return True
        self.replay.covariance = again.covariance
        return False

    def _goes_on_uneven(self, recorded: Array, at: slice | Index, least: Array | None) -> bool:
        """Whether a snapshot is what the events make of one that was not symmetric."""
        assert self._start is not None  # noqa: S101 - there are events since then
        assert self._raw is not None  # noqa: S101 - asked for before
        stack, replay = self._raw[None], Remembering(self._start)
        with np.errstate(all="ignore"):
            for event in self._kept:
                stack = continued(stack, replay, event)
                replay.step(event)
        right = stack[0][at][:, at]
        if self._differs(recorded, right, least):
            return False
        self.replay.covariance = 0.5 * (stack[0] + stack[0].T)
        return True

    def _tells_gains(self) -> bool:
        """Whether corrections tell the gains that are not recorded, with a snapshot of all.

        That of a scalar measurement does; of others that of the last event before the snapshot.
        """
        last = self._kept[-1].number if self._kept else None
        return self._start is not None and all(
            len(update.residual) == 1 or number == last for number, update in self._open.items()
        )

    def _is_wrong_for_any_gain(self, recorded: Array, least: Array | None, wrong: bool) -> bool:
        """Whether a snapshot of all is wrong whatever the gains that are not recorded.

        wrong: it is so for Kalman's.
        """
        if self._is_of_other_gains(recorded):
            return False
        if not wrong and (self._is_indifferent(recorded, least) or self._all_removed()):
            self._note_gains(_UNTOLD)
        return wrong

    def _all_removed(self) -> bool:
        """Whether no block is left that a correction without a gain moves by another."""
        others = {
            b for finding, _ in self._pending if finding.event in self._open for b in finding.blocks
        }
        return others.isdisjoint(self.replay.layout.dims)

    def _is_indifferent(self, recorded: Array, least: Array | None) -> bool:
        """Whether a snapshot of all is the same without updates whose gains are not recorded."""
        if self._start is None:
            return True
        again = self._start.copy()
        with np.errstate(all="ignore"):
            for event in self._kept:
                if event.number not in self._open:
                    again.apply(event)
        return not self._differs(recorded, again.covariance, least)

    def _is_of_other_gains(self, recorded: Array) -> bool:
        """Whether a snapshot of all is that of gains which are told by their corrections alone.

        A gain K' has to the correction K' r the covariance P' of the last update if, with Kalman's
        K and P, P' - P = (K' - K) S (K' - K)^T, which is d d^T / (r^T S^-1 r), d = (K' - K) r, and
        what is semidefinite and of one rank less than r has entries.
        """
        if self._start is None or not self._tells_gains():
            return False
        again, last, rank, beyond = self._start.copy(), self._kept[-1], 0, None
        with np.errstate(all="ignore"):
            for event in self._kept:
                update = self._open.get(event.number)
                fused = again.apply(event if update is None else _implied(update))
                if update is not None and event is last and fused is not None:
                    rank, beyond = len(update.residual) - 1, _beyond(update, fused)
            least = self._least(tuple(again.layout.dims))
            unit = units(recorded, again.covariance, least)
            off = entry_differences(recorded, again.covariance, least)
            if rank and beyond is not None:
                off -= np.outer(beyond / unit, beyond / unit)
        if not np.isfinite(off).all():
            return False
        allowed = self.tolerance * max(1.0, float(np.abs(off).max()))
        values = np.linalg.eigvalsh(0.5 * (off + off.T))
        known = values[: len(values) - rank] if rank < len(values) else values[:0]
        agrees = bool(values[0] >= -allowed and (known <= allowed).all())
        if agrees:
            self.replay.mean = again.mean
            self._allow(recorded, "with which the covariance agrees")
        return agrees

    def _allow(self, recorded: Array, tail: str) -> None:
        """Accept that corrections are of gains that are not recorded; go on from a snapshot."""
        self._note_gains(tail)
        self.replay.covariance = 0.5 * (recorded + recorded.T)

    def _note_gains(self, tail: str) -> None:
        """Name the corrections that are not of Kalman's gain, where none is recorded."""
        self._pending = [one for one in self._pending if one[0].event not in self._open]
        for event in self._open.values():
            text = f"{name_of(event)} corrects by another gain than Kalman's, {tail}"
            finding = AuditFinding("gain", False, text, event.number, sensor=event.sensor)
            self.add(finding, f"not recorded, {tail}")
            self.optimal = False
        self._open = {}

    def _restart(self, recorded: Array | None = None) -> None:
        """Begin an interval between snapshots. recorded: the snapshot, if it is of all blocks."""
        kept, self._stale = self._kept, self._last_before
        self._recent.extend(kept[-_REMEMBERED:])
        if len(self._first) < _REMEMBERED:
            self._first += kept[:_REMEMBERED]
        self._start, self._kept, self._open = self.replay.copy(), [], {}
        self._raw = None
        if recorded is not None:
            self._start.covariance = 0.5 * (recorded + recorded.T)
            self._raw = None if np.array_equal(recorded, recorded.T) else recorded

    def _invalid(self, snapshot: Snapshot, cause: AuditFinding | None = None) -> None:
        """Add that a covariance is invalid. cause: what is known of where it became so."""
        number = snapshot.number
        cause = cause or AuditFinding("covariance", True, "", number)
        for what in self._invalidity(snapshot):
            text = f"the covariance at event {number} {what}"
            self.add(replace(cause, check="covariance", text=text), what[:12])

    def _invalidity(self, snapshot: Snapshot) -> list[str]:
        """Symmetry and definiteness; a covariance may be singular, as of a clone."""
        p = snapshot.covariance
        unit = units(p, p, self._least(snapshot.blocks))
        scaled = p / np.outer(unit, unit)
        skew = float(np.abs(scaled - scaled.T).max())
        least = _least(0.5 * (scaled + scaled.T), -self.tolerance)
        found = []
        if skew > self.tolerance:
            found.append(f"is asymmetric, by {skew:.2g} of its sigmas")
        if least < -self.tolerance:
            found.append(f"is not positive semidefinite (least {least:.2g})")
        return found

    def _estimate(self, event: Event) -> None:
        """Keep the estimate's numbers as events lead to them, and compare a snapshot's."""
        numbers = self._numbers
        match event:
            case Predict():
                self._set(event.blocks, event.after)
            case TracePrior() if event.point is not None:
                self._numbers = _parts(event.point, BlockLayout(event.blocks, event.dims))
            case Augment():
                self._numbers.pop(event.name, None)
                if event.after is not None and len(event.after) == len(event.jacobian):
                    numbers[event.name] = event.after
            case Update() if event.used:
                self._correct(event.correction)
            case Clone() if event.source in numbers:
                numbers[event.name] = numbers[event.source]
            case Remove():
                self._set(event.blocks, None)
            case Snapshot() if event.mean is not None:
                self._compare_estimate(event, event.mean)

    def _set(self, blocks: Blocks, after: Array | None) -> None:
        """Set the numbers of blocks; None where they are not known any more."""
        if self._numbers:
            for name in blocks:
                self._numbers.pop(name, None)
        if after is not None:
            self._numbers |= _parts(after, self.replay.layout.of(blocks))

    def _correct(self, correction: Array | None) -> None:
        entries, before = self.replay.layout.entries, self._numbers
        self._numbers = (
            {} if correction is None else {b: n + correction[entries(b)] for b, n in before.items()}
        )

    def _compare_estimate(self, snapshot: Snapshot, mean: Array) -> None:
        """Find blocks whose estimate is not what the events lead to."""
        layout = self.replay.layout
        given = _parts(mean, layout.of(snapshot.blocks))
        wrong, largest = [], 0.0
        for name, value in given.items():
            expected = self._numbers.get(name)
            if expected is None:
                continue
            part = layout.entries(name)
            variance = self.replay.covariance.diagonal()[part]
            sigma: Array = np.sqrt(np.where(variance > 0.0, variance, 1.0))
            off = value - expected
            off -= 2.0 * np.pi * np.round(off / (2.0 * np.pi))  # an angle may go round
            allowed = self.tolerance * sigma + LOST * np.abs(value)
            if not (np.abs(off) <= allowed).all():
                wrong.append(name)
                largest = max(largest, float((np.abs(off) / sigma).max()))
        self._numbers |= given
        if wrong:
            last, names = self._last, ", ".join(wrong)
            text = f"{name_of(last)}: the estimate of {names} is off by {largest:.2g} sigma"
            sensor = last.sensor if isinstance(last, Update) else None
            finding = AuditFinding(
                "correction", True, text, last.number, sensor=sensor, blocks=tuple(wrong)
            )
            self.add(finding, f"estimate after {type(last).__name__}")

    def note_precision(self, number: int, *matrices: Array | None) -> None:
        """Propose another tolerance where what differs at an event is of single precision."""
        if self._proposed or self.tolerance >= SINGLE_SIGMA:
            return
        if any(matrix is not None and stored_rounding(matrix) for matrix in matrices):
            self._proposed = True
            text = f"the filter is in single precision: audit it with --tolerance {SINGLE_SIGMA:g}"
            self.add(AuditFinding("precision", False, text, number), "single")

    def _localise(self, snapshot: Snapshot, weight: float) -> bool:
        """Say where and how a snapshot became wrong. weight: negative where that is slight.

        Return False where it is not: of gains that are not recorded nothing is known.
        """
        if self.sound:
            self.note_precision(snapshot.number, snapshot.covariance)
        if self._start is None and self._open:
            self._allow(snapshot.covariance, _UNTOLD)
            return False
        if self._start is None or self._searched > MOST_SEARCHED:
            self._pending = []
            text = f"the covariance at event {snapshot.number} is not that of the events before it"
            self.add(AuditFinding("algebra", True, text, snapshot.number), "unknown")
            self._invalid(snapshot)
            return True
        start = self._remembering(self._start)
        least = self._least(snapshot.blocks)
        known = tuple(self._known.values())
        kinds = ", ".join(dict.fromkeys(map(_kind_of, self._kept)))
        alike, every = self._unlike_any[kinds], self._unlike_any.total()
        sought = alike < _MOST_UNNAMED and every < _MOST_UNNAMED_IN_ALL
        most = MOST_REPLAYED if sought else 0
        cause = localise(
            start, self._kept, snapshot, self.tolerance, known, least, most_replayed=most
        )
        if cause.kind not in self._known:
            self._searched += 1
            self._unlike_any[kinds] += not cause.kind
        tells = self._tells_gains() or (weight >= 0.0 and self._is_of_open(cause))
        if self._open and not tells:
            self._allow(snapshot.covariance, _UNTOLD)
            return False
        finding = self._finding(cause, snapshot)
        if cause.kind:
            assert cause.known is not None  # noqa: S101 - it has a kind
            self._known[cause.kind] = cause.known
            self._explain(cause)
            invalid = " and ".join(self._invalidity(snapshot))
            if invalid:
                finding = replace(finding, text=f"{finding.text}; the covariance {invalid}")
        elif cause.event is None and self._pending:
            first, _ = self._pending[0]
            finding = replace(finding, event=first.event, sensor=first.sensor)
        self._confirm(finding.event)
        self._add_cause(finding, cause.kind, weight)
        if not cause.kind:
            self._invalid(snapshot, finding)
        return True

    def _is_of_open(self, cause: EventCause) -> bool:
        """Whether a cause is a gain that a correction tells; others presume Kalman's."""
        return bool(cause.kind) and cause.event is not None and cause.event.number in self._open

    def _explain(self, cause: EventCause) -> None:
        """Leave out the gain that is named with the covariance."""
        if cause.event is None:
            return
        number = cause.event.number
        if cause.sound:  # a gain that is not recorded, by which the estimate is corrected
            self._pending = [one for one in self._pending if one[0].event != number]
            self._open.pop(number, None)
            self.optimal = False
        elif cause.known is not None and cause.known.fault.with_gain:
            told = self._open.pop(number, None) is not None  # by the correction, which is right
            kept = [
                one
                for one in self._pending
                if one[0].event != number or (one[0].fault and not told)
            ]
            self.optimal = self.optimal and len(kept) == len(self._pending)
            self._pending = kept

    def _add_cause(self, finding: AuditFinding, kind: str, weight: float) -> None:
        """Keep a cause; the second event of a kind has the first as the one before it."""
        twin = re.sub(r"of the first (\w+)", r"of the \1 before", kind)
        key = f"{finding.check}|{finding.sensor}|{twin}"
        if twin != kind and key in self._found and self._found[key][2] == 1:
            old, seen_s, count, most = self._found.pop(key)
            old = replace(old, text=old.text.replace(twin, kind))
            self._found[f"{finding.check}|{finding.sensor}|{kind}"] = old, seen_s, count, most
        self.add(finding, kind or "unknown", weight)

    def _finding(self, cause: EventCause, snapshot: Snapshot) -> AuditFinding:
        check = "gain" if cause.sound else "algebra"
        event = cause.event
        if event is None and not self._kept:
            text = f"{name_of(snapshot)}: {cause.what}, with no event between it and {self._since}"
            return AuditFinding(check, True, text, snapshot.number, blocks=cause.blocks)
        if event is None:
            first, last = self._kept[0].number, snapshot.number
            text = f"between events {first} and {last}, {cause.what}"
            return AuditFinding(check, True, text, first, blocks=cause.blocks)
        sensor = event.sensor if isinstance(event, Update) else None
        later = f" here and at later {name_of(event).split()[0]}s"
        tail = later if cause.repeated and not cause.sound else ""
        text = f"{name_of(event)}: {cause.what}{tail}"
        return AuditFinding(
            check, not cause.sound, text, event.number, sensor=sensor, blocks=cause.blocks
        )

    def _confirm(self, until: int | None) -> None:
        """Accept what gains were found unlike, up to an event that made the covariance wrong."""
        for finding, kind in self._pending:
            assert finding.event is not None  # noqa: S101 - gains are of updates
            if until is None or finding.event <= until:
                self.optimal = self.optimal and finding.fault
                self.add(finding, kind)
        self._pending = []


def _implied(event: Event) -> Event:
    """An update with the gain that its correction tells, or else with Kalman's."""
    assert isinstance(event, Update)  # noqa: S101 - of updates alone
    gain = told_gain(event)
    return event._replace(gain=gain, correction=None if gain is None else event.correction)


def _beyond(event: Update, fused: Fused) -> Array:
    """(n,) what a correction has beyond Kalman's, over the length of the whitened residual."""
    assert event.correction is not None  # noqa: S101 - of corrections alone
    length = float(np.linalg.norm(fused.inverse_root @ event.residual))
    off = event.correction - fused.gain @ event.residual
    return off / length if length > 0.0 else off


def faults_of(events: Iterable[Event], tolerance: float) -> tuple[str, ...]:
    """Return what is wrong with the algebra of events, in words.

    tolerance: what rounding explains, in standard deviations.
    """
    check = AlgebraCheck(tolerance)
    with np.errstate(all="ignore"):  # a filter that has broken down may overflow anything
        for event in events:
            check.take(event)
        return check.faults()


def _definite(matrix: Array) -> bool:
    """Whether a symmetric matrix is positive definite; never one with numbers that are none."""
    return not dpotrf(matrix, lower=1)[1]


def _least(scaled: Array, allowed: float) -> float:
    """Return the least eigenvalue of a symmetric matrix, or what is allowed if it is above that."""
    try:
        np.linalg.cholesky(scaled - allowed * np.eye(len(scaled)))
    except np.linalg.LinAlgError:
        return float(np.linalg.eigvalsh(scaled)[0])
    return allowed


def _parts(numbers: Array, layout: BlockLayout) -> dict[str, Array]:
    """Return the numbers of each block; none where there are not as many as its errors have."""
    if len(numbers) != layout.size:
        return {}
    return {name: numbers[layout.entries(name)] for name in layout.dims}


def _kind_of(event: Event) -> str:
    """Of events that an error is likely to be in alike."""
    return f"update of {event.sensor}" if isinstance(event, Update) else type(event).__name__


def name_of(event: Event) -> str:
    """Return what an event is called: "event 12 (update of sensor `gps`)"."""
    match event:
        case Update():
            what = f"update of sensor `{event.sensor}`"
        case Augment():
            what = f"augmentation by block `{event.name}`"
        case Clone():
            what = f"clone of block `{event.source}`"
        case Predict() if not event.jacobian.any():
            what = f"renewal of {', '.join(f'`{b}`' for b in event.blocks)}"
        case Predict():
            what = "prediction"
        case Remove():
            what = f"removal of {', '.join(f'`{b}`' for b in event.blocks)}"
        case Reset():
            what = "reset"
        case TracePrior():
            return "the prior"
        case Snapshot() | Directions() | Evaluation():
            return f"event {event.number}"
    return f"event {event.number} ({what})"
