"""A grammar of faults: a slot of a filter, a part of it, and a change, sometimes with a number.

A slot is what a model gives a filter: F, the control's Jacobian B, H, R, the expected measurement,
the innovation, a new landmark's place and its Jacobians. Its parts are its rows, columns, blocks
and terms. A change says what stands in a part instead. Every combination that has a meaning exists
because slot, part and change do: words are made of theirs, and one function makes of sound values
what a filter with the fault has, for thousands of records at once, or for one as it runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index

Mask = NDArray[np.bool_]
Text = str | Callable[..., str]
"""What to say of a fault, as a format of its numbers, or made of them."""
_PLACES = ("x", "y")


@dataclass(frozen=True, kw_only=True, eq=False)
class Slot:
    """Something that a model gives a filter.

    Attributes:
        name: In words, as `H`.
        rows: Names of its rows.
        columns: Of its columns; of a vector one without a name.
        blocks: Columns that belong together, by name; of a covariance rows as well.
        covariance: Symmetric, of variances.
        records: What it is recorded for, in words.
    """

    name: str
    rows: tuple[str, ...]
    columns: tuple[str, ...] = ("",)
    blocks: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    covariance: bool = False
    records: str = "measurements"

    @property
    def shape(self) -> tuple[int, int]:
        """Of its values."""
        return len(self.rows), len(self.columns)


_POSE = ("x", "y", "heading")
_POSITION: Mapping[str, tuple[int, ...]] = {"position": (0, 1)}
_OF_LANDMARKS = ("landmark's x", "landmark's y")
_MEASURED = ("range", "bearing")
F = Slot(name="F", rows=_POSE, columns=_POSE, blocks=_POSITION, records="predictions")
B = Slot(name="the control's Jacobian", rows=_POSE, columns=("speed", "turn"),
         records="predictions")  # fmt: skip
B_OF_DISPLACEMENT = Slot(
    name="the displacement's Jacobian", rows=_POSE, columns=("ahead", "left", "turn"),
    records="predictions",
)  # fmt: skip
Q = Slot(name="Q", rows=_POSE, columns=_POSE, blocks=_POSITION, covariance=True,
         records="predictions")  # fmt: skip
H = Slot(name="H", rows=_MEASURED, columns=(*_POSE, *_OF_LANDMARKS),
         blocks={"pose": (0, 1, 2), "position and landmark": (0, 1, 3, 4), "position": (0, 1),
                 "landmark": (3, 4)})  # fmt: skip
R = Slot(name="R", rows=_MEASURED, columns=_MEASURED, covariance=True)
EXPECTED = Slot(name="the expected measurement", rows=_MEASURED)
INNOVATION = Slot(name="the innovation", rows=_MEASURED)
PLACE = Slot(name="the way to new landmarks", rows=_PLACES, records="new landmarks")
G_X = Slot(name="G_x", rows=_PLACES, columns=_POSE, blocks=_POSITION, records="new landmarks")
G_Z = Slot(name="G_z", rows=_PLACES, columns=_MEASURED, records="new landmarks")
_AXES = ("east", "north")
POSITION = Slot(name="the innovation of positions", rows=_AXES, records="positions")
R_OF_POSITION = Slot(name="R of positions", rows=_AXES, columns=_AXES, covariance=True,
                     records="positions")  # fmt: skip
PRIOR = Slot(name="the prior's covariance", rows=_POSE, columns=_POSE, blocks=_POSITION,
             covariance=True, records="priors")  # fmt: skip
SLOTS = (
    F, B, B_OF_DISPLACEMENT, Q, H, R, EXPECTED, INNOVATION, PLACE, G_X, G_Z, POSITION,
    R_OF_POSITION, PRIOR,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Values:
    """Sound values of a slot in N records, and what a change may make others of.

    Attributes:
        sound: (N, r, c).
        factors: (N,) each, by name: what a term may be multiplied with once too often, or not.
        heading: (N,) of the vehicle, where the first two rows are in the map's axes; or None.
        elsewhere: (N, r, c) each, by words: at another point, or of another event.
    """

    sound: Array
    factors: Mapping[str, Array] = field(default_factory=dict)
    heading: Array | None = None
    elsewhere: Mapping[str, Array] = field(default_factory=dict)

    def rows(self, rows: Index) -> Values:
        """Return those of some records."""
        return Values(
            sound=self.sound[rows],
            factors={name: one[rows] for name, one in self.factors.items()},
            heading=None if self.heading is None else self.heading[rows],
            elsewhere={words: one[rows] for words, one in self.elsewhere.items()},
        )


class Part(NamedTuple):
    """Of a slot. words: as `the heading column of H`. mask: (r, c) which terms."""

    words: str
    mask: Mask


class Composition(NamedTuple):
    """A fault: a slot, a change of a part of it.

    Attributes:
        slot: Where it is.
        change: The name of the change, whatever the part.
        words: What to say of it.
        values: Makes of sound values, and of the numbers, what a filter with the fault has.
        start: Its numbers where there is no fault.
        reads: What it needs beside the sound values, a key of `Values.factors` or `elsewhere`.
        mask: (r, c) the terms that it changes, where it moves none.
    """

    slot: Slot
    change: str
    words: Text
    values: Callable[..., Array]
    start: tuple[float, ...] = ()
    reads: str = ""
    mask: Mask | None = None

    def said(self, *numbers: float) -> str:
        """Return its words with numbers."""
        make = self.words.format if isinstance(self.words, str) else self.words
        return make(*numbers)


def times(what: str, of: str = "the correct value") -> Callable[[float], str]:
    """Return the text of a factor, signs and zeros named as such."""

    def text(factor: float) -> str:
        if abs(factor + 1.0) < 1e-6:
            return f"{what} has the opposite sign"
        if abs(factor) < 1e-6:
            return f"{what} is zero"
        unit = ""
        for size, named in ((np.degrees(1.0), "degrees instead of radians"),
                            (np.radians(1.0), "converted to radians twice")):  # fmt: skip
            if abs(factor / size - 1.0) < 1e-6:
                unit = f" ({named})"
        return f"{what} is {factor:.6g} times {of}{unit}"

    return text


def parts(slot: Slot) -> Iterator[Part]:
    """Yield a slot's parts, the largest first: all, rows, blocks and columns, their terms."""
    yield Part(slot.name, np.ones(slot.shape, dtype=bool))
    if slot.covariance:
        yield from _parts_of_covariance(slot)
    elif slot.shape[1] == 1:
        for k, row in enumerate(slot.rows):
            yield Part(f"the {row} of {slot.name}", _mask(slot, (k,), (0,)))
    else:
        yield from _parts_of_matrix(slot)


def _mask(slot: Slot, rows: tuple[int, ...], columns: tuple[int, ...]) -> Mask:
    mask = np.zeros(slot.shape, dtype=bool)
    mask[np.ix_(rows, columns)] = True
    return mask


def _parts_of_matrix(slot: Slot) -> Iterator[Part]:
    every_row, every_column = (tuple(range(n)) for n in slot.shape)
    for k, row in enumerate(slot.rows):
        yield Part(f"the {row} row of {slot.name}", _mask(slot, (k,), every_column))
    columns = {f"{name} block": at for name, at in slot.blocks.items()}
    columns |= {f"{name} column": (k,) for k, name in enumerate(slot.columns)}
    for name, at in columns.items():
        yield Part(f"the {name} of {slot.name}", _mask(slot, every_row, at))
    for k, row in enumerate(slot.rows):
        for name, at in columns.items():
            term = name.replace(" column", " term").replace(" block", " part")
            yield Part(f"the {term} of the {row} row of {slot.name}", _mask(slot, (k,), at))


def _parts_of_covariance(slot: Slot) -> Iterator[Part]:
    for name, at in slot.blocks.items():
        yield Part(f"the {name} block of {slot.name}", _mask(slot, at, at))
    for k, row in enumerate(slot.rows):
        yield Part(f"{slot.name} of the {row}", _mask(slot, (k,), (k,)))
    for i, j in combinations(range(len(slot.rows)), 2):
        pair = f"the covariance of {slot.rows[i]} and {slot.rows[j]} in {slot.name}"
        yield Part(pair, _mask(slot, (i,), (j,)) | _mask(slot, (j,), (i,)))


def compositions(slot: Slot, like: Values) -> Iterator[Composition]:
    """Yield the faults of a slot, the simplest first.

    Args:
        slot: What is changed.
        like: Values with the same factors and elsewhere: what there is to make faults of.
    """
    shapes = list(parts(slot))
    for part in shapes:
        yield from _of_terms(slot, part)
    for structure in _structures(slot, like):
        yield structure
    for words in like.elsewhere:
        for part in shapes:
            yield _elsewhere(slot, part, words)
    for part in shapes:
        for factor in like.factors:
            yield from _by_factor(slot, part, factor)
    for structure in _structures(slot, like):
        for part in shapes:
            yield _also_negated(structure, part)
    for part in shapes:
        yield Composition(
            slot, "times", times(part.words), _times(part.mask), (1.0,), mask=part.mask
        )
    for part in shapes:
        said = f"{part.words} has {{0:+.4g}} added"
        yield Composition(slot, "plus", said, _plus(part.mask), (0.0,), mask=part.mask)


def _within(mask: Mask, sound: Array, changed: Array) -> Array:
    """Changed values (N, r, c) in a part, sound ones in the rest."""
    return np.where(mask, changed, sound)


def _times(mask: Mask) -> Callable[[Values, float], Array]:
    return lambda values, factor: _within(mask, values.sound, factor * values.sound)


def _plus(mask: Mask) -> Callable[[Values, float], Array]:
    return lambda values, more: _within(mask, values.sound, values.sound + more)


def _of_terms(slot: Slot, part: Part) -> Iterator[Composition]:
    """Changes of each term by itself, or of variances."""
    mask = part.mask

    def made(change: str, words: str, changed: Callable[[Array], Array]) -> Composition:
        return Composition(
            slot, change, f"{part.words} {words}",
            lambda values: _within(mask, values.sound, changed(values.sound)), mask=mask,
        )  # fmt: skip

    yield made("zero", "is zero", np.zeros_like)
    if not slot.covariance or not mask.diagonal().any():
        yield made("negated", "has the opposite sign", np.negative)
        return
    diagonal = np.eye(len(slot.rows))
    yield made("root", "contains sigma instead of sigma squared",
               lambda v: np.sqrt(np.maximum(v * diagonal, 0.0)))  # fmt: skip
    yield made("square", "contains the square of the variances", lambda v: v**2 * diagonal)
    if mask.all():
        yield made("diagonal", "lacks its covariances", lambda v: v * diagonal)
        yield made("inverse", "is inverted, as information", _inverted)


def _inverted(covariance: Array) -> Array:
    with np.errstate(all="ignore"):
        singular = np.linalg.cond(covariance) > 1.0 / np.finfo(float).eps
    safe = np.where(singular[:, None, None], np.eye(covariance.shape[-1]), covariance)
    return np.where(singular[:, None, None], np.nan, np.linalg.inv(safe))


def _elsewhere(slot: Slot, part: Part, words: str) -> Composition:
    return Composition(
        slot, "elsewhere", f"{part.words} is {words}",
        lambda values: _within(part.mask, values.sound, values.elsewhere[words]), reads=words,
        mask=part.mask,
    )  # fmt: skip


def _by_factor(slot: Slot, part: Part, factor: str) -> Iterator[Composition]:
    for power, words in (
        (1, f"is multiplied by {factor} once too often"),
        (-1, f"is not multiplied by {factor}, or divided by it once too often"),
        (2, f"is multiplied by the square of {factor}"),
        (-2, f"is divided by the square of {factor}"),
    ):
        yield Composition(
            slot, f"factor {power:+d}", f"{part.words} {words}",
            lambda values, power=power: _within(
                part.mask, values.sound,
                values.sound * values.factors[factor][:, None, None] ** float(power),
            ),
            reads=factor,
            mask=part.mask,
        )  # fmt: skip


def _structures(slot: Slot, like: Values) -> Iterator[Composition]:
    """Changes that move terms: transposed, exchanged, in other axes, the identity."""
    rows, columns = slot.shape
    if rows == columns and not slot.covariance:
        yield Composition(slot, "transposed", f"{slot.name} is transposed", lambda v: v.sound.mT)
        yield Composition(slot, "identity", f"{slot.name} is the identity", _identity)
    for name, at in slot.blocks.items():
        if len(at) == rows < columns:
            words = f"the {name} block of {slot.name} is transposed"
            yield Composition(slot, "transposed", words, _block_transposed(at))
    yield from _exchanges(slot)
    if like.heading is not None:
        for sign, words in (
            (-1.0, "is in the vehicle's axes, not in the map's"),
            (1.0, "is turned by the heading once too often"),
            (-2.0, "is turned by the negative heading"),
        ):
            yield Composition(
                slot, f"axes {sign:+.0f}", f"{slot.name} {words}", _turned(slot, sign)
            )


def _exchanges(slot: Slot) -> Iterator[Composition]:
    """Two rows, two columns, or two terms of a column have changed places."""
    rows, columns = slot.shape
    every_row, every_column = np.arange(rows), np.arange(columns)
    for i, j in combinations(range(rows), 2):
        order, pair = _exchanged(rows, i, j), f"{slot.rows[i]} and {slot.rows[j]}"
        if slot.covariance:
            words = f"the variances of {pair} in {slot.name} are exchanged"
            yield Composition(slot, "exchanged", words, _reordered(order, order))
            continue
        words = f"{pair} in {slot.name}" if columns == 1 else f"the rows of {pair} in {slot.name}"
        yield Composition(
            slot, "exchanged", f"{words} are exchanged", _reordered(order, every_column)
        )
        for k, column in enumerate(slot.columns if columns > 1 else ()):
            words = f"the {pair} terms in the {column} column of {slot.name} are exchanged"
            terms = _reordered(order, every_column, _mask(slot, (i, j), (k,)))
            yield Composition(slot, "exchanged", words, terms)
    for i, j in combinations(range(0 if slot.covariance else columns), 2):
        words = f"the columns of {slot.columns[i]} and {slot.columns[j]} in {slot.name}"
        order = _exchanged(columns, i, j)
        yield Composition(slot, "exchanged", f"{words} are exchanged", _reordered(every_row, order))


def _exchanged(count: int, i: int, j: int) -> Index:
    """Numbers up to count, two of them in each other's place."""
    order = np.arange(count)
    order[[i, j]] = j, i
    return order


def _reordered(rows: Index, columns: Index, mask: Mask | None = None) -> Callable[[Values], Array]:
    """Terms in another order. mask: in these alone."""

    def changed(values: Values) -> Array:
        moved = values.sound[:, rows][:, :, columns]
        return moved if mask is None else _within(mask, values.sound, moved)

    return changed


def _identity(values: Values) -> Array:
    return np.broadcast_to(np.eye(values.sound.shape[-1]), values.sound.shape)


def _block_transposed(at: tuple[int, ...]) -> Callable[[Values], Array]:
    """Square columns transposed in their place."""

    def changed(values: Values) -> Array:
        moved = values.sound.copy()
        moved[:, :, list(at)] = values.sound[:, :, list(at)].mT
        return moved

    return changed


def _turned(slot: Slot, sign: float) -> Callable[[Values], Array]:
    """The first two rows, of a covariance the columns as well, turned by the heading."""

    def changed(values: Values) -> Array:
        if values.heading is None:
            raise ValueError("heading is None, expected the vehicle's")
        angle, size = sign * values.heading, slot.shape[0]
        turn = np.tile(np.eye(size), (len(angle), 1, 1))
        cos, sin = np.cos(angle), np.sin(angle)
        turn[:, :2, :2] = np.stack((cos, -sin, sin, cos), axis=-1).reshape(-1, 2, 2)
        moved: Array = turn @ values.sound
        return moved @ turn.mT if slot.covariance else moved

    return changed


def _also_negated(structure: Composition, part: Part) -> Composition:
    """Two changes joined: terms are moved, and a part has the opposite sign."""

    def changed(values: Values) -> Array:
        moved = structure.values(values)
        return _within(part.mask, moved, -moved)

    said = f"{structure.said()}, and {part.words} has the opposite sign"
    change = f"{structure.change}, negated"
    return structure._replace(change=change, words=said, values=changed)
