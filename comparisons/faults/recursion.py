"""A recursion over events that knows what a fault of the next one may be made of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.replay import Replay, square
from comparisons.faults.formulas import evaluated
from comparisons.faults.grammar import Values
from comparisons.faults.recipes import AFTER, recipe_of
from comparisons.trace.events import Augment, Clone, Event, Predict, Reset, Update

AS_BEFORE = "as before the event"
"""What is said of a covariance that an event has not changed."""
Kind = tuple[object, ...]


class _Made(NamedTuple):
    """Of an event that is to be done next: its matrices, results by form, and values by name."""

    number: int
    matrices: dict[str, Array]
    results: dict[tuple[str, bool], dict[str, Array]]
    values: dict[tuple[str, tuple[int, ...]], Values]


class Remembering(Replay):
    """A recursion that knows the event before, and of each kind the first and the last.

    stale: P before the last event; of another size, or None, where it is not known. first: P of the
    prior.
    """

    def __init__(
        self,
        replay: Replay,
        earlier: Iterable[Event] = (),
        stale: Array | None = None,
        first: Array | None = None,
    ) -> None:
        """Go on from another, which is left alone. earlier: events before."""
        self.layout = replay.layout.of(replay.layout.dims)
        self.covariance, self.mean = replay.covariance.copy(), replay.mean.copy()
        self.stale, self.first = stale, first
        self.last: Event | None = None
        self._kinds: dict[Kind, tuple[Event, Event]] = {}
        self._made: _Made | None = None
        for event in earlier:
            self.remember(event)

    def copy(self) -> Remembering:
        """Return one that goes its own way."""
        other = Remembering(self, stale=self.stale, first=self.first)
        other.last, other._kinds = self.last, dict(self._kinds)
        other._made = self._made
        return other

    def step(self, event: Event) -> None:
        """Do an event, and remember it."""
        self.stale, self._made = self.covariance.copy(), None
        self.apply(event)
        self.remember(event)

    def remember(self, event: Event) -> None:
        """Remember an event that is done."""
        kind = _kind(event)
        self._kinds[kind] = self._kinds.get(kind, (event,))[0], event
        self.last = event

    def other(self, event: Event, which: int) -> Any:
        """The first event of its kind (0), or the last before (1); None if there is none."""
        both = self._kinds.get(_kind(event))
        return None if both is None else both[which]

    def _of_next(self, event: Event) -> _Made:
        """What is made for the next event."""
        if self._made is None or self._made.number != event.number:
            self._made = _Made(event.number, _matrices(event, self), {}, {})
        return self._made

    def matrices(self, event: Event) -> dict[str, Array]:
        """Return what the recipe of the next event is computed of, on the whole state."""
        return self._of_next(event).matrices

    def sound_results(
        self, event: Event, form: str, *, with_recorded: bool = False
    ) -> dict[str, Array]:
        """Return all matrices of the next event, done by a form without a fault.

        Raises ValueError where the event has no recorded gain by which it is to be done.
        """
        made, key = self._of_next(event).results, (form, with_recorded)
        if key not in made:
            matrices = self.matrices(event)
            if with_recorded:
                if not isinstance(event, Update) or event.gain is None:
                    raise ValueError("an event without a recorded gain")
                matrices = {**matrices, "K": event.gain}
            recipe = recipe_of(event, form, with_recorded=with_recorded)
            made[key] = evaluated(recipe, matrices)
        return made[key]

    def values(self, name: str, sound: Array, event: Event) -> Values:
        """Return what a change may make another of a matrix of the next event."""
        made, key = self._of_next(event).values, (name, sound.shape)
        if key not in made:
            made[key] = _values(name, sound, event, self)
        return replace(made[key], sound=sound[None])

    def other_covariances(self) -> dict[str, Array]:
        """Return what may be taken for P, by words."""
        options = {"that before the event before": self.stale, "the prior's": self.first}
        if isinstance(self.last, Predict):
            at, noise = self.layout.columns(self.last.blocks), self.last.noise
            without = self.covariance.copy()
            without[square(at)] -= noise
            options["without the process noise of the last prediction (sigma points that were not "
                    "drawn anew)"] = without  # fmt: skip
        return {
            words: p
            for words, p in options.items()
            if p is not None and p.shape == self.covariance.shape
        }


def _kind(event: Event) -> Kind:
    match event:
        case Update():
            return Update, event.sensor, event.jacobian.shape
        case Predict() | Augment():
            return type(event), event.jacobian.shape, event.noise.shape
    return (type(event),)


def recorded(event: Event) -> dict[str, Array]:
    """The matrices of an event as it has them, on its own blocks."""
    match event:
        case Predict():
            return {"F": event.jacobian, "Q": event.noise}
        case Update():
            return {"H": event.jacobian, "R": event.noise}
        case Reset():
            return {"J": event.jacobian}
        case Augment():
            return {"G_x": event.jacobian, "G_z": event.noise_jacobian, "R": event.noise}
    return {}


def _matrices(event: Event, replay: Replay) -> dict[str, Array]:
    size = replay.layout.size
    matrices = {"P": replay.covariance, "I": np.eye(size)}
    if isinstance(event, Clone):
        return matrices | {"G_x": np.eye(size)[replay.layout.entries(event.source)]}
    for name, matrix in recorded(event).items():
        matrices[name] = whole(name, matrix, event, replay)
    return matrices


def whole(name: str, matrix: Array, event: Any, replay: Replay) -> Array:
    """Matrices (..., r, c) of an event on the whole state, from its own blocks."""
    if name in ("R", "G_z"):
        return matrix
    size, at = replay.layout.size, replay.layout.columns(event.blocks)
    if name in ("H", "G_x"):
        wide = np.zeros((*matrix.shape[:-1], size))
        wide[..., at] = matrix
        return wide
    whole = np.zeros((*matrix.shape[:-2], size, size))
    if name != "Q":
        whole += np.eye(size)
    whole[(..., *square(at))] = matrix
    return whole


def _values(name: str, sound: Array, event: Event, replay: Remembering) -> Values:
    """What a change may make a matrix of."""
    elsewhere: dict[str, Array] = {}
    if name == "P":
        elsewhere = replay.other_covariances()
    elif name == "I":
        elsewhere = {"all ones": np.ones_like(sound)}
    elif name == AFTER:
        elsewhere = {AS_BEFORE: replay.covariance}
        if replay.first is not None and replay.first.shape == sound.shape:
            elsewhere["the prior's"] = replay.first
    else:
        for which, words in ((1, "that of the event of its kind before"), (0, "the first one's")):
            other = replay.other(event, which)
            matrix = None if other is None else recorded(other).get(name)
            if matrix is not None and matrix.shape == sound.shape:
                elsewhere[words] = matrix
    last = replay.other(event, 1)
    factors = {}
    if name in "FQ" and last is not None and None not in (last.time_s, event.time_s):
        interval = event.time_s - last.time_s
        if interval > 0.0:
            factors["the interval"] = np.array([interval])
    return Values(
        sound=sound[None],
        elsewhere={words: matrix[None] for words, matrix in elsewhere.items()},
        factors=factors,
    )
