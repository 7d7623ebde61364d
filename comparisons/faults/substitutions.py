"""Events done by their recipes with something else in some places of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.formulas import Formula, Recipe, Use, evaluated
from comparisons.faults.grammar import Composition, Values
from comparisons.faults.operands import numbered_of, operand_of, singles_of
from comparisons.faults.recipes import AFTER, GAIN, recipe_of
from comparisons.faults.recursion import AS_BEFORE, Remembering, recorded, whole
from comparisons.trace.events import (
    Augment,
    Clone,
    Event,
    Predict,
    Remove,
    Reset,
    Update,
)

Matrices = Mapping[str, Array]


class OperandChange(NamedTuple):
    """Of an operand, with numbers."""

    composition: Composition
    numbers: tuple[float, ...] = ()


class Substitution(NamedTuple):
    """How an event is done: recipe, what stands where in it, and with which gain.

    composition: of an operand, by the grammar. other: formula in the place of an operand's own.
    with_recorded: by the recorded gain.
    """

    form: str
    operand: str = ""
    places: frozenset[Use] = frozenset()
    composition: Composition | None = None
    other: Formula | None = None
    with_recorded: bool = False

    def recipe(self, event: Event) -> Recipe:
        """Return the formulas that are computed."""
        return recipe_of(event, self.form, with_recorded=self.with_recorded)

    def results(
        self,
        replay: Remembering,
        event: Event,
        changes: Sequence[OperandChange] = (),
        stack: Array | None = None,
    ) -> dict[str, Array]:
        """Return all matrices; those that differ by changes of the operand as stacks (N, r, c).

        Args:
            replay: As before the event.
            event: What is done.
            changes: N of the operand.
            stack: (N, n, n) P before the event, where each change has another.

        Raises:
            ValueError: The event is of another shape.
        """
        sound = replay.sound_results(event, self.form, with_recorded=self.with_recorded)
        if stack is not None:
            recipe = self.recipe(event)
            given = {name: matrix for name, matrix in sound.items() if name not in recipe}
            sound = evaluated(recipe, {**given, "P": stack})
        if not self.operand:
            return sound
        changed = partial(self._changed, replay, event, changes)
        if self.places:
            return evaluated(self.recipe(event), sound, self.places, changed)
        return {**sound, self.operand: changed(sound)}

    def _changed(
        self, replay: Remembering, event: Event, changes: Sequence[OperandChange], values: Matrices
    ) -> Array:
        """What stands in the places."""
        if self.other is not None:
            others = {name: value for name, value in values.items() if name != self.operand}
            return evaluated({self.operand: self.other}, others)[self.operand]
        raw = recorded(event).get(self.operand)
        sound = values[self.operand] if raw is None else raw
        given = self._given(replay, event, sound, values["P"], len(changes))
        shape = sound.shape[-2:]
        if any(composition.slot.shape != shape for composition, _ in changes):
            changes = [
                _of_another(change, self.operand, given[0], event, replay) for change in changes
            ]
        made = np.concatenate(
            [
                composition.values(event_values, *numbers)
                for event_values, (composition, numbers) in zip(given, changes, strict=True)
            ]
        )
        return made if raw is None else whole(self.operand, made, event, replay)

    def _given(
        self, replay: Remembering, event: Event, sound: Array, before: Array, count: int
    ) -> list[Values]:
        """What each of some changes may make of a matrix, one or a stack. before: P, likewise."""
        if sound.ndim == 2:
            return [replay.values(self.operand, sound, event)] * count
        like = replay.values(self.operand, sound[0], event)
        if self.operand != AFTER:
            return [replace(like, sound=matrix[None]) for matrix in sound]
        return [
            replace(like, sound=matrix[None], elsewhere={**like.elsewhere, AS_BEFORE: p[None]})
            for matrix, p in zip(sound, _stacked(before, count), strict=True)
        ]

    def change(self, event: Event, replay: Remembering) -> OperandChange:
        """Return what is changed, as of an event. Raises ValueError where that is impossible."""
        assert self.composition is not None  # noqa: S101 - asked for before
        results = replay.sound_results(event, self.form, with_recorded=self.with_recorded)
        sound = recorded(event).get(self.operand, results.get(self.operand))
        if sound is None:
            raise ValueError(f"an event without {self.operand}")
        change = OperandChange(self.composition)
        if sound.shape == self.composition.slot.shape:
            return change
        values = replay.values(self.operand, sound, event)
        return _of_another(change, self.operand, values, event, replay)

    def afters(
        self,
        replay: Remembering,
        event: Event,
        changes: Sequence[OperandChange] = (),
        stack: Array | None = None,
    ) -> Array | None:
        """Return covariances (N, n, n) after the event; None where that is impossible.

        stack: (N, n, n) before it, where they are not the replay's.
        """
        try:
            values = self.results(replay, event, changes, stack)
        except (ValueError, KeyError):
            return None
        return _assembled(values, event, len(changes))

    def own_changes(self) -> list[OperandChange]:
        """Return its change, if it has one."""
        return [] if self.composition is None else [OperandChange(self.composition)]

    def gains(self, replay: Remembering, event: Event, changes: Sequence[OperandChange]) -> Array:
        """Return gains (N, n, m) of an update, one for each change of the operand."""
        sound = replay.sound_results(event, self.form, with_recorded=self.with_recorded)
        if self.operand == "K":
            return _stacked(self._changed(replay, event, changes, sound), len(changes))
        to_gain = {name: text for name, text in self.recipe(event).items() if name in GAIN}
        changed = partial(self._changed, replay, event, changes)
        return _stacked(evaluated(to_gain, sound, self.places, changed)["K"], len(changes))

    def matrix(self, replay: Remembering, event: Event) -> Array:
        """Return (r, c) what stands in the places."""
        sound = replay.sound_results(event, self.form, with_recorded=self.with_recorded)
        made = self._changed(replay, event, self.own_changes(), sound)
        return np.asarray(_stacked(made, 1)[0])


def _of_another(
    change: OperandChange, operand: str, values: Values, event: Event, replay: Remembering
) -> OperandChange:
    """The same change of an operand of another shape. Raises ValueError where there is none."""
    there = operand_of(operand, values.sound.shape[1:], event, replay.layout)
    start = change.composition.start
    others = numbered_of(there) if start else singles_of(there, values)
    other = others.get(change.composition.said(*start))
    if other is None:
        raise ValueError("an event of another shape")
    return change._replace(composition=other)


def _stacked(matrix: Array, count: int) -> Array:
    """(N, r, c) of one or of a stack."""
    return np.broadcast_to(matrix, (max(count, 1), *matrix.shape[-2:]))


def sound_substitution(event: Event) -> Substitution:
    """Return how an event is done without a fault."""
    if isinstance(event, Update) and event.gain is not None:
        return Substitution("Joseph's form", with_recorded=True)
    return Substitution("")


def continued(stack: Array, replay: Remembering, event: Event) -> Array:
    """Return what a sound event makes of covariances (N, n, n). replay: as before the event."""
    if isinstance(event, Remove):
        kept = np.ones(replay.layout.size, dtype=bool)
        for name in event.blocks:
            kept[replay.layout.entries(name)] = False
        return stack[:, kept][:, :, kept]
    if not isinstance(event, Predict | Update | Reset | Augment | Clone):
        return stack
    if isinstance(event, Update) and not event.used:
        return stack
    values = sound_substitution(event).results(replay, event, stack=stack)
    return _assembled(values, event, len(stack))


def _assembled(values: Matrices, event: Event, count: int) -> Array:
    """The covariances (N, n, n) after an event, of the results of its recipe."""
    if not isinstance(event, Augment | Clone):
        return _stacked(values[AFTER], count)
    p, across, inner = (_stacked(values[name], count) for name in ("P", "C", "N"))
    return np.block([[p, across.mT], [across, inner]])
