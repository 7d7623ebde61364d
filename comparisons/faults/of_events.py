"""Faults of a filter's events, each composed of the event's own formulas.

An event makes a new covariance by a recipe: of matrices that the trace has, and of some that are
made on the way. A fault is a change of one of them, or of a part of it, in all places or some, or
another formula in the place of one. All come of the recipes and the grammar's changes; `explain`
tries them on what a filter recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property, partial
from itertools import islice
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.replay import Replay
from comparisons.faults.formulas import Recipe, Use, alike, uses, variants, written
from comparisons.faults.grammar import (
    Composition,
    Text,
    Values,
)
from comparisons.faults.of_angles import angle_mean, by_angle_mean
from comparisons.faults.operands import (
    Operand,
    event_name,
    is_whole,
    numbered_of,
    operand_of,
    singles_of,
)
from comparisons.faults.recipes import AFTER, FOR_ANY_GAIN, FORMS, SUBJECTS, recipe_of
from comparisons.faults.recursion import AS_BEFORE, Remembering, recorded
from comparisons.faults.substitutions import (
    Matrices,
    OperandChange,
    Substitution,
    sound_substitution,
)
from comparisons.trace.events import (
    Augment,
    Blocks,
    Clone,
    Event,
    Predict,
    Remove,
    Reset,
    Update,
)

_MOST_GAINS_AT_ONCE, _MOST_ENTRIES = 256, 4_000_000
"""Gains that are computed together, and entries of the covariances for them."""
_IN_GAIN = ("S", "K")
_PARTED = ("", "Joseph's form")
"""Forms in which parts of matrices are changed: in the others they come to the same, or are rare.
"""
_FIRST_WITH_NUMBERS = "KRQ"
"""Of what fits alike, the last of these is said first: noises, then the gain, then the others."""
_ALL_OF_A_RESULT = ", in"
"""Beginning of what a scope is called that is all places in a result."""
_ORDER = {form: k for k, form in enumerate(FORMS)}


@dataclass(frozen=True)
class EventFault:
    """An error of an event.

    Attributes:
        words: What to say of it, made of its number where it has one.
        of: Blocks of the state, or what tells them when they are asked for.
        action: How the event is done by it, and any that is like it.
        tier: Errors of one tier are as simple as each other.
        start: Its number where there is no fault.
        sound: It is none, but a choice that is consistent.
        with_gain: It is the gain's as well.
        whole: It is of whole matrices, wherever they stand, and not too rare to be in all events.
        called: What it is in all events, where its words have figures of one.
    """

    words: Text
    of: Blocks | Callable[[], Blocks]
    action: Substitution | Callable[[Remembering, Any], None]
    tier: int
    _: KW_ONLY
    start: tuple[float, ...] = ()
    sound: bool = False
    with_gain: bool = False
    whole: bool = True
    called: str = ""

    @property
    def substitution(self) -> Substitution | None:
        """What stands where in the event's recipe; None of an error that is not composed."""
        return self.action if isinstance(self.action, Substitution) else None

    @cached_property
    def place(self) -> Substitution | None:
        """The substitution without what is changed there: errors of one are computed together."""
        return None if self.substitution is None else self.substitution._replace(composition=None)

    def do(self, replay: Remembering, event: Any) -> None:
        """Let an event be done so; as it is where that is impossible."""
        if not isinstance(self.action, Substitution):
            self.action(replay, event)
            return
        (after,) = afters([self], [self.start], replay, event)
        replay.apply(event)
        if after is not None:
            replay.covariance = after.copy()

    def said(self, *numbers: float) -> str:
        """Return its words with its number."""
        make = self.words.format if isinstance(self.words, str) else self.words
        return make(*numbers)

    @property
    def blocks(self) -> Blocks:
        """Blocks of the state that it is of."""
        return self.of() if callable(self.of) else self.of

    @property
    def terms(self) -> float:
        """How many terms of a matrix it changes; of what is no part, none are counted."""
        composition = None if self.substitution is None else self.substitution.composition
        if composition is None or composition.mask is None:
            return 0.0
        return float(np.count_nonzero(composition.mask))

    @property
    def kind(self) -> str:
        """What it is, whatever its number."""
        return self.called or self.said(*self.start)


LEVELS = range(7)
_WHOLE, _WRITTEN, _SOME, _PARTS, _LEFT, _ONE_SIDE, _PARTS_OF_SOME = LEVELS
"""From simple to rare: whole matrices and events, formulas, some places, parts, those of the
result, of one side of its diagonal, and parts in some places."""
NUMBERED_LEVELS = range(3)
"""Of errors with a number: of whole matrices, of the result and some places, of parts."""


def _of_the_whole(event: Event) -> Iterator[EventFault]:
    if isinstance(event, Predict | Reset):
        verb = "predicted" if isinstance(event, Predict) else "reset"
        yield EventFault(f"the covariance was not {verb}", event.blocks, skipped, _WHOLE)
        yield EventFault(f"the covariance was {verb} twice", event.blocks, _twice, _WHOLE)


def skipped(replay: Replay, event: Event) -> None:
    """Do nothing."""
    del replay, event


def _twice(replay: Replay, event: Event) -> None:
    """Each time with Kalman's gain, as code does that is called twice."""
    if isinstance(event, Update):
        event = event._replace(gain=None)
    replay.apply(event)
    replay.apply(event)


def _of_rejected(event: Update, every: EventFaults) -> Iterator[EventFault]:
    del every
    what = "the rejected measurement was fused all the same"
    yield EventFault(what, event.blocks, lambda r, e: r.fuse(e, kalman_gain(r, e)), 0)


def _with_another_gain(event: Update, every: EventFaults) -> Iterator[EventFault]:
    """Of what a recorded gain is that is not Kalman's, and forms that hold for Kalman's alone."""
    yield from _of_angles(event, every)
    yield from every.with_gain(event.gain)
    for form in [form for form in FORMS if form not in FOR_ANY_GAIN]:
        text = written(recipe_of(event, form)[AFTER])
        words = f"the covariance is {text}, which holds for Kalman's gain alone"
        yield EventFault(words, event.blocks, Substitution(form, with_recorded=True), 0)


def _of_angles(event: Update, every: EventFaults) -> Iterator[EventFault]:
    mean = angle_mean(event, every.replay)
    if mean is not None:
        of = every.whole_blocks()
        yield EventFault(mean.words, of, by_angle_mean, -1, with_gain=True, called="angle mean")


def corrects_otherwise(event: Update, replay: Remembering) -> bool:
    """Whether a correction without a recorded gain is of another gain than Kalman's."""
    if event.gain is not None or event.correction is None:
        return False
    return not _corrects(event, kalman_gain(replay, event))


def has_another_gain(event: Update, replay: Remembering) -> bool:
    """Whether a recorded gain is not Kalman's."""
    return event.gain is not None and not alike(kalman_gain(replay, event), event.gain)


def _corrects(event: Update, gain: Array) -> bool:
    """Whether the recorded correction is a gain times the residual."""
    assert event.correction is not None  # noqa: S101 - asked for above
    return alike(gain @ event.residual, event.correction)


def kalman_gain(replay: Remembering, event: Update) -> Array:
    """Return (n, m) Kalman's gain; NaN where there is none."""
    return replay.sound_results(event, "")["K"]


def gain_faults(event: Update, replay: Remembering) -> Iterator[tuple[EventFault, Array]]:
    """Yield what a gain that is not Kalman's may be of, with the gain (n, m)."""
    yield from EventFaults(event, replay).other_gains()


def _of_correction(event: Update, every: EventFaults) -> Iterator[EventFault]:
    """What the gain may be that a correction is of, which is no error by itself."""
    assert event.correction is not None  # noqa: S101 - asked for above
    if not event.correction.any():
        what = "the covariance was not updated"
        yield EventFault(what, event.blocks, skipped, _WHOLE, sound=True)
    yield from _of_angles(event, every)
    for fault, gain in every.other_gains():
        if not _corrects(event, gain):
            continue
        yield fault
        consistent = partial(_by_gain_of, fault=fault)
        what = f"{fault.kind}, in Joseph's form"
        yield replace(fault, words=what, action=consistent, sound=True)
    yield from _schmidt(event, every)


def _by_gain_of(replay: Remembering, event: Update, fault: EventFault) -> None:
    """Joseph's form with the gain of an error."""
    assert fault.substitution is not None  # noqa: S101 - of what is composed
    substitution = fault.substitution
    replay.fuse(event, substitution.gains(replay, event, substitution.own_changes())[0])


def _schmidt(event: Update, every: EventFaults) -> Iterator[EventFault]:
    """Of blocks whose variance stays: an error, unless the estimate is not corrected either."""
    layout = every.replay.layout
    for block in layout.dims:
        do = partial(_considered, block=block)
        if event.correction is None:
            what = (
                f"the variance of block {block} was kept, which is right only where the estimate "
                "is kept, too (Schmidt): record gains to tell"
            )
            yield EventFault(what, (block,), do, len(FORMS) * _SOME)
        elif not event.correction[layout.entries(block)].any():
            what = f"block {block} is not corrected, and its variance kept (Schmidt)"
            yield EventFault(what, (block,), do, len(FORMS) * _SOME, sound=True)


def _considered(replay: Remembering, event: Update, block: str) -> None:
    gain = kalman_gain(replay, event).copy()
    gain[replay.layout.entries(block)] = 0.0
    replay.fuse(event, gain)


def _of_remove(event: Remove, replay: Remembering) -> Iterator[EventFault]:
    dims = replay.layout.dims
    what = "the blocks were fixed (conditioned on), not marginalised out"
    yield EventFault(what, event.blocks, _conditioned, _WHOLE)
    gone = event.blocks[0]
    for other in dims:
        if len(event.blocks) == 1 and other != gone and dims[other] == dims[gone]:
            what = f"the rows of block {other} were removed in place of its own"
            do = partial(_removed_instead, other=other)
            yield EventFault(what, (gone, other), do, _WHOLE)


def _conditioned(replay: Replay, event: Remove) -> None:
    """Remove blocks as if they were known: the Schur complement."""
    gone = replay.layout.columns(event.blocks)
    p = replay.covariance
    inner = p[gone][:, gone]
    inverted = np.linalg.pinv(inner) if np.isfinite(inner).all() else np.full_like(inner, np.nan)
    replay.covariance = p - p[:, gone] @ inverted @ p[gone]
    replay.remove(event.blocks)


def _removed_instead(replay: Replay, event: Remove, other: str) -> None:
    """Remove another block's rows; the others then stand under the names before them."""
    kept = np.delete(np.arange(replay.layout.size), replay.layout.entries(other))
    p = replay.covariance[np.ix_(kept, kept)]
    replay.remove(event.blocks)
    replay.covariance = p


class EventFaults:
    """The errors that an event may have been done with, by levels, each composed once."""

    def __init__(
        self,
        event: Event,
        replay: Remembering,
        wrong: Blocks | None = None,
        *,
        after_snapshot: bool = True,
    ) -> None:
        """Compose none yet.

        Args:
            event: What was done.
            replay: As before the event; it is not changed.
            wrong: Blocks with a covariance that is wrong after this event, None where others have
                followed.
            after_snapshot: P before it is recorded. Where it is not, another P for all of the event
                is what the event before has left.
        """
        self.after_snapshot = after_snapshot
        self.event, self.replay, self.wrong = event, replay, wrong
        self._changes: dict[str, list[Composition]] = {}
        self._plain: dict[int, list[EventFault]] = {}
        self._with_numbers: list[list[EventFault]] | None = None

    def at(self, level: int) -> list[EventFault]:
        """Return the errors of a level that have no number."""
        if level not in self._plain:
            self._plain[level] = list(self._composed(level))
        return self._plain[level]

    def numbered(self, level: int) -> list[EventFault]:
        """Return the errors of a level that have a number, which is to be fitted."""
        if self._with_numbers is None:
            self._with_numbers = self._numbered_by_level()
        return self._with_numbers[level]

    def _composed(self, level: int) -> Iterator[EventFault]:
        event = self.event
        if isinstance(event, Update):
            yield from self._of_update(event, level)
            return
        if isinstance(event, Remove):
            yield from _of_remove(event, self.replay) if level == _WHOLE else ()
            return
        new = isinstance(event, Augment | Clone)
        if level == _WHOLE:
            yield from _of_the_whole(event)
            yield from self._of_result(None) if new else ()
        if level in (_LEFT, _ONE_SIDE):
            yield from self._of_result(level) if not new else ()
        else:
            yield from self.of_level(level, "")

    def _of_update(self, event: Update, level: int) -> Iterator[EventFault]:
        unlike = has_another_gain(event, self.replay)
        if not event.used or corrects_otherwise(event, self.replay):
            only = _of_rejected if not event.used else _of_correction
            yield from only(event, self) if level == _WHOLE else ()
            return
        if level in (_LEFT, _ONE_SIDE):
            yield from self._of_result(level)
            return
        if level == _WHOLE:
            yield EventFault("the covariance was not updated", event.blocks, skipped, 0)
            yield EventFault("the covariance was updated twice", event.blocks, _twice, 0)
            yield from _with_another_gain(event, self) if unlike else ()
        if level == _SOME and event.gain is None:
            yield from _schmidt(event, self)
        forms = FOR_ANY_GAIN if unlike else tuple(FORMS)
        if level in (_PARTS, _PARTS_OF_SOME):
            forms = tuple(form for form in forms if form in _PARTED)
        for form in forms if event.gain is not None and level != _PARTS_OF_SOME else ():
            yield from self.of_level(level, form, with_recorded=True)
        for form in FORMS:
            yield from self.of_level(level, form)

    def operands(self, recipe: Recipe) -> list[str]:
        """Return what stands in a recipe's formulas, each once."""
        names = [f.name for terms in recipe.values() for term in terms for f in term.factors]
        return list(dict.fromkeys(names))

    def scopes(self, recipe: Recipe, name: str) -> Iterator[tuple[str, frozenset[Use]]]:
        """Yield some of the places where a matrix stands, and how they are called."""
        every = uses(recipe, name)
        groups = {
            "in S": [u for u in every if u.result == "S"],
            "in P H^T": [u for u in every if u.result == "K"],
            "in the gain": [u for u in every if u.result in _IN_GAIN],
            "in the covariance": [u for u in every if u.result not in _IN_GAIN],
        }
        if len({use.result for use in every} & {"C", "N"}) > 1:
            groups = {SUBJECTS[r]: [u for u in every if u.result == r] for r in ("C", "N")}
            groups = {f"in {words}": places for words, places in groups.items()}
        different = {frozenset(every)}
        for words, places in groups.items():
            if places and frozenset(places) not in different:
                different.add(frozenset(places))
                yield f", {words} alone", frozenset(places)
        for use in every if len(every) > 1 else ():
            if frozenset({use}) not in different:
                text = written(recipe[use.result])
                order = [other for other in every if other.result == use.result].index(use)
                place = ("first", "second", "third")[min(order, 2)]
                yield f", at its {place} place in {text} alone", frozenset({use})

    def operand(self, name: str, values: Matrices) -> Operand:
        """Return what a matrix of the event is a slot of."""
        raw = recorded(self.event).get(name)
        shape = (values[name] if raw is None else raw).shape
        return operand_of(name, shape, self.event, self.replay.layout, self.wrong or ())

    def of_level(
        self, level: int, form: str, *, with_recorded: bool = False
    ) -> Iterator[EventFault]:
        """Yield the errors of a level in one form of the recipe."""
        recipe = recipe_of(self.event, form, with_recorded=with_recorded)
        base = Substitution(form, with_recorded=with_recorded)
        values = self._sound(base)
        if values is None:
            return
        names = [name for name in self.operands(recipe) if not (with_recorded and name == "K")]
        for name in names:
            if level == _WRITTEN and name in recipe:
                yield from self._of_formula(base, recipe, name, values)
            elif level in (_WHOLE, _SOME, _PARTS, _PARTS_OF_SOME):
                yield from self._of_operand(base, recipe, name, level, values)
        if level == _WRITTEN:
            for name in (AFTER, "C", "N"):
                if name in recipe:
                    yield from self._of_result_formula(base, recipe, name, values)

    def _sound(self, base: Substitution) -> dict[str, Array] | None:
        try:
            return base.results(self.replay, self.event)
        except (ValueError, KeyError):
            return None

    def _of_operand(
        self, base: Substitution, recipe: Recipe, name: str, level: int, values: Matrices
    ) -> Iterator[EventFault]:
        everywhere = level in (_WHOLE, _PARTS)
        whole = level in (_WHOLE, _SOME)
        scopes = [("", frozenset(uses(recipe, name)))]
        if not everywhere:
            scopes = list(self.scopes(recipe, name))
        if not self._differs(base, name, everywhere=everywhere, whole=whole):
            return
        changes = [change for change in self._single(name, values) if is_whole(change) == whole]
        if level == _PARTS_OF_SOME and base.form:
            scopes = [scope for scope in scopes if scope[0].startswith(_ALL_OF_A_RESULT)]
            changes = [change for change in changes if change.mask is not None]
        for composition in changes:
            for words, places in scopes:
                substitution = base._replace(operand=name, places=places, composition=composition)
                yield self._fault(substitution, f"{composition.words}{words}", level, composition)

    def _differs(self, base: Substitution, name: str, *, everywhere: bool, whole: bool) -> bool:
        """Whether changes of a matrix in a form are others than in the forms before it."""
        if name == "P" and everywhere and not self.after_snapshot:
            return False
        if base.with_recorded:
            return True
        if everywhere:  # with Kalman's gain of what is changed, all forms are the first
            of_form = name in ("K", "I", "A", "U")
            return not base.form or (of_form and (whole or base.form == "Joseph's form"))
        return True

    def _of_formula(
        self, base: Substitution, recipe: Recipe, name: str, values: Matrices
    ) -> Iterator[EventFault]:
        """A matrix that is made on the way by another formula, everywhere or in some places."""
        shapes = {key: values[key].shape for key in values if key not in (name, AFTER)}
        for other in variants(recipe[name], shapes):
            text = f"{name} is {written(other)}, not {written(recipe[name])}"
            for words, places in (("", frozenset(uses(recipe, name))), *self.scopes(recipe, name)):
                substitution = base._replace(operand=name, places=places, other=other)
                yield self._fault(substitution, text + words, _WRITTEN, None)

    def _of_result_formula(
        self, base: Substitution, recipe: Recipe, name: str, values: Matrices
    ) -> Iterator[EventFault]:
        shapes = {key: values[key].shape for key in values if key not in ("C", "N", AFTER)}
        for other in variants(recipe[name], shapes):
            substitution = base._replace(operand=name, other=other)
            text = f"{SUBJECTS[name]} is {written(other)}, not {written(recipe[name])}"
            yield self._fault(substitution, text, _WRITTEN, None)

    def _single(self, name: str, values: Matrices) -> list[Composition]:
        """Changes of an operand without a number."""
        if name not in self._changes:
            changes = singles_of(self.operand(name, values), self._like(name, values)).values()
            # A part of P that the event before has not changed is what that event has left.
            left = name == "P"
            self._changes[name] = [
                change for change in changes if not (left and _is_stale_part(change))
            ]
        return self._changes[name]

    def _of_result(self, level: int | None) -> Iterator[EventFault]:
        """Yield what may have become of the covariance after the event. level: None of any."""
        for substitution, name, composition in self._results(numbered=False):
            mask = composition.mask
            even = mask is None or mask.shape[0] != mask.shape[1] or bool((mask == mask.T).all())
            side = _LEFT if even else _ONE_SIDE
            if level not in (None, side):
                continue
            if name == AFTER and self._touches_right_blocks(composition):
                continue
            blocks, tier = partial(self._blocks, composition), len(FORMS) * side
            yield EventFault(composition.words, blocks, substitution, tier)

    def _results(self, *, numbered: bool) -> Iterator[tuple[Substitution, str, Composition]]:
        if isinstance(self.event, Remove):
            return
        substitution = sound_substitution(self.event)
        values = self._sound(substitution)
        for name in (AFTER, "C", "N"):
            if values is None or name not in values:
                continue
            with_number = numbered_of(self.operand(name, values)).values()
            for composition in with_number if numbered else self._single(name, values):
                yield (
                    substitution._replace(operand=name, composition=composition),
                    name,
                    composition,
                )

    def _touches_right_blocks(self, composition: Composition) -> bool:
        """Whether a change is of blocks that are not wrong, and would make them so."""
        if self.wrong is None or composition.mask is None or is_whole(composition):
            return False
        if composition.reads == AS_BEFORE:  # what an event does not change may be left as well
            return False
        return not set(self._blocks(composition)) <= set(self.wrong)

    def _numbered_by_level(self) -> list[list[EventFault]]:
        """Factors of matrices and of their parts, and what is added to them."""
        event = self.event
        if not isinstance(event, Predict | Update | Augment | Reset):
            return [[], [], []]
        if isinstance(event, Update) and (not event.used or corrects_otherwise(event, self.replay)):
            return [[], [], []]
        by_scope: list[list[EventFault]] = [[], [], []]
        for form in FORMS if isinstance(self.event, Update) else ("",):
            recipe, base = recipe_of(self.event, form), Substitution(form)
            values = self._sound(base)
            names = sorted(self.operands(recipe), key=_FIRST_WITH_NUMBERS.find, reverse=True)
            for name in names if values is not None else ():
                assert values is not None  # noqa: S101 - asked for above
                every = ("", frozenset(uses(recipe, name)))
                for composition in numbered_of(self.operand(name, values)).values():
                    whole = is_whole(composition)
                    if not self._differs(base, name, everywhere=not whole, whole=whole):
                        continue
                    for words, places in (every, *(self.scopes(recipe, name) if whole else ())):
                        if name == "P" and not words and not self.after_snapshot:
                            continue
                        substitution = base._replace(
                            operand=name, places=places, composition=composition
                        )
                        fault = self._numbered(
                            substitution, composition, words + self._of_form(substitution)
                        )
                        by_scope[0 if whole and not words else 1 if whole else 2].append(fault)
        left: list[list[EventFault]] = [[], [], []]
        for substitution, _, composition in self._results(numbered=True):
            fault = self._numbered(substitution, composition, "")
            left[1 if is_whole(composition) else 2].append(fault)
        parts = [replace(fault, whole=False) for fault in left[2] + by_scope[2]]
        return [by_scope[0], left[1] + by_scope[1], parts]

    def _numbered(
        self, substitution: Substitution, composition: Composition, tail: str
    ) -> EventFault:
        return EventFault(
            lambda number: composition.said(number) + tail, self._blocks(composition), substitution,
            _WHOLE, start=composition.start,
        )  # fmt: skip

    def other_gains(self) -> Iterator[tuple[EventFault, Array]]:
        """Yield what a gain that is not Kalman's may be of, with the gain."""
        at_once = max(1, min(_MOST_GAINS_AT_ONCE, _MOST_ENTRIES // self.replay.covariance.size))
        for level in (_WHOLE, _WRITTEN, _SOME, _PARTS, _PARTS_OF_SOME):
            of_gain = filter(_is_of_gain, self.of_level(level, ""))
            while some := list(islice(of_gain, at_once)):
                for fault, gain in zip(some, self._gains_of(some), strict=True):
                    if gain is not None:
                        yield fault, gain

    def _gains_of(self, faults: Sequence[EventFault]) -> list[Array | None]:
        """The gains of errors; None where one is impossible."""
        gains: list[Array | None] = [None] * len(faults)
        for place, members in _by_place(faults).items():
            changes = _changes(faults, members, [fault.start for fault in faults])
            try:
                made = place.gains(self.replay, self.event, changes)
            except (ValueError, KeyError):
                continue
            for k, gain in zip(members, _of_each(made, len(members)), strict=True):
                gains[k] = gain
        return gains

    def with_gain(self, gain: Array | None) -> Iterator[EventFault]:
        """Yield errors by which a recorded gain is not Kalman's, of gain and covariance alike."""
        for fault, other in self.other_gains():
            if gain is not None and alike(other, gain):
                what = f"gain and covariance are those where {fault.kind}"
                yield replace(fault, words=what, with_gain=True, tier=-1)

    def _fault(
        self, substitution: Substitution, words: str, tier: int, composition: Composition | None
    ) -> EventFault:
        simplicity = len(FORMS) * tier + _ORDER[substitution.form]
        blocks = partial(self._blocks, composition)
        whole = tier != _PARTS_OF_SOME
        words += self._of_form(substitution)
        return EventFault(words, blocks, substitution, simplicity, whole=whole)

    def _of_form(self, substitution: Substitution) -> str:
        return f", in {substitution.form}" if substitution.form else ""

    def _blocks(self, composition: Composition | None) -> Blocks:
        """The blocks of the state that a change is of."""
        event: Any = self.event
        if composition is None or composition.mask is None or is_whole(composition):
            return self.whole_blocks()
        slot, mask = composition.slot, composition.mask
        names = [slot.rows[i] for i in np.flatnonzero(mask.any(axis=1))]
        names += [slot.columns[i] for i in np.flatnonzero(mask.any(axis=0))]
        known = [name.partition("[")[0] for name in names]
        dims = self.replay.layout.dims
        blocks = tuple(dict.fromkeys(b for b in known if b in dims or b == event_name(event)))
        return blocks or self.whole_blocks()

    def whole_blocks(self) -> Blocks:
        """Return the blocks that the whole event is of."""
        event: Any = self.event
        if isinstance(event, Clone):
            return (event.name, event.source)
        return (event.name, *event.blocks) if isinstance(event, Augment) else tuple(event.blocks)

    def _like(self, name: str, values: Matrices) -> Values:
        raw = recorded(self.event).get(name)
        return self.replay.values(name, values[name] if raw is None else raw, self.event)


def _is_stale_part(composition: Composition) -> bool:
    return bool(composition.reads) and not is_whole(composition)


def afters(
    faults: Sequence[EventFault],
    numbers: Sequence[tuple[float, ...]],
    replay: Remembering,
    event: Event,
    stack: Array | None = None,
) -> list[Array | None]:
    """Return what each of some errors makes of the covariance; None where one is impossible.

    Those that differ by what is changed in the same places are computed together. stack: (N, n, n)
    covariances before the event, where each error has another.
    """
    covariances: list[Array | None] = [None] * len(faults)
    for k, fault in enumerate(faults):
        if fault.place is None:
            other = replay.copy()
            other.covariance = other.covariance if stack is None else stack[k].copy()
            fault.do(other, event)
            covariances[k] = other.covariance
    for place, members in _by_place(faults).items():
        changes = _changes(faults, members, numbers)
        made = place.afters(replay, event, changes, None if stack is None else stack[members])
        if made is not None:
            for k, covariance in zip(members, _of_each(made, len(members)), strict=True):
                covariances[k] = covariance
    return covariances


def _is_of_gain(fault: EventFault) -> bool:
    """Whether an error is of the gain, too."""
    substitution = fault.substitution
    return substitution is not None and any(
        use.result in _IN_GAIN or substitution.operand == "K" for use in substitution.places
    )


def _by_place(faults: Sequence[EventFault]) -> dict[Substitution, list[int]]:
    """Which composed errors are computed together, for they are in the same places."""
    together: dict[Substitution, list[int]] = {}
    for k, fault in enumerate(faults):
        if fault.place is not None:
            together.setdefault(fault.place, []).append(k)
    return together


def _changes(
    faults: Sequence[EventFault], members: Sequence[int], numbers: Sequence[tuple[float, ...]]
) -> list[OperandChange]:
    """What some errors change, with their numbers."""
    return [
        change._replace(numbers=numbers[k])
        for k in members
        if (substitution := faults[k].substitution) is not None
        for change in substitution.own_changes()
    ]


def _of_each(made: Array, count: int) -> Array:
    """(N, r, c) of a stack, or of one that is the same for all."""
    return made if len(made) > 1 else np.broadcast_to(made[0], (count, *made.shape[1:]))


def adapted(fault: EventFault, event: Event, replay: Remembering) -> EventFault:
    """Return a fault of another event as one of this, whose matrices may be of another shape."""
    substitution = fault.substitution
    if substitution is None or substitution.composition is None:
        return fault
    try:
        change = substitution.change(event, replay)
    except (ValueError, KeyError):
        return fault
    if change.composition is substitution.composition:
        return fault
    return replace(fault, action=substitution._replace(composition=change.composition))
