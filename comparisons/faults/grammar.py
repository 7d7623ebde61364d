"""A grammar of faults: a slot of a filter, a part of it, and a change, sometimes with a number.

A slot is what a model gives a filter: F, the control's Jacobian B, H, R, the expected measurement,
the innovation, a new landmark's place and its Jacobians. Its parts are its rows, columns, blocks
and terms. A change says what stands in a part instead. Every combination that has a meaning exists
because slot, part and change do: words are made of theirs, and one function makes of sound values
what a filter with the fault has, for thousands of records at once, or for one as it runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index, rotations

Mask = NDArray[np.bool_]
Text = str | Callable[..., str]
"""What to say of a fault, as a format of its numbers, or made of them."""
_PLACES = ("x", "y")
_MOST_EXCHANGED = 20
"""Rows of a matrix, above which none are exchanged: it is that of many landmarks."""


class Part(NamedTuple):
    """Of a slot. words: as `the heading column of H`. mask: (r, c) which terms."""

    words: str
    mask: Mask


@dataclass(frozen=True, kw_only=True, eq=False)
class Slot:
    """Something that a model gives a filter.

    Attributes:
        name: In words, as `H`.
        rows: Names of its rows.
        columns: Of its columns; of a vector one without a name.
        blocks: Columns that belong together, by name; of a covariance rows as well.
        row_blocks: Rows that belong together, by name.
        covariance: Symmetric, of variances.
        named_parts: Its parts, where they are not all rows, columns, blocks and terms; none of what
            is changed as a whole alone.
        movable_rows: Rows that may change places together, by name.
        movable_columns: Columns likewise.
    """

    name: str
    rows: tuple[str, ...]
    columns: tuple[str, ...] = ("",)
    blocks: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    row_blocks: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    covariance: bool = False
    named_parts: tuple[Part, ...] | None = None
    movable_rows: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    movable_columns: Mapping[str, tuple[int, ...]] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, int]:
        """Of its values."""
        return len(self.rows), len(self.columns)


_POSE = ("x", "y", "heading")
_POSITION: Mapping[str, tuple[int, ...]] = {"position": (0, 1)}
_OF_LANDMARKS = ("landmark's x", "landmark's y")
_MEASURED = ("range", "bearing")
F = Slot(name="F", rows=_POSE, columns=_POSE, blocks=_POSITION, row_blocks=_POSITION)
B = Slot(name="the control's Jacobian", rows=_POSE, columns=("speed", "turn"),
         row_blocks=_POSITION)  # fmt: skip
B_OF_DISPLACEMENT = Slot(
    name="the displacement's Jacobian", rows=_POSE, columns=("ahead", "left", "turn"),
    row_blocks=_POSITION,
)  # fmt: skip
VELOCITY = Slot(name="the predicted velocity", rows=_POSE, row_blocks=_POSITION)
Q = Slot(name="Q", rows=_POSE, columns=_POSE, blocks=_POSITION, covariance=True)  # fmt: skip
H = Slot(name="H", rows=_MEASURED, columns=(*_POSE, *_OF_LANDMARKS),
         blocks={"pose": (0, 1, 2), "position and landmark": (0, 1, 3, 4), "position": (0, 1),
                 "landmark": (3, 4)})  # fmt: skip
R = Slot(name="R", rows=_MEASURED, columns=_MEASURED, covariance=True)
EXPECTED = Slot(name="the expected measurement", rows=_MEASURED)
INNOVATION = Slot(name="the innovation", rows=_MEASURED)
PLACE = Slot(name="the way to new landmarks", rows=_PLACES)
G_X = Slot(name="G_x", rows=_PLACES, columns=_POSE, blocks=_POSITION)
G_Z = Slot(name="G_z", rows=_PLACES, columns=_MEASURED)
_AXES = ("east", "north")
POSITION = Slot(name="the innovation of positions", rows=_AXES)
R_OF_POSITION = Slot(name="R of positions", rows=_AXES, columns=_AXES, covariance=True)  # fmt: skip
PRIOR = Slot(name="the prior's covariance", rows=_POSE, columns=_POSE, blocks=_POSITION,
             covariance=True)  # fmt: skip
SLOTS = (
    F, B, B_OF_DISPLACEMENT, VELOCITY, Q, H, R, EXPECTED, INNOVATION, PLACE, G_X, G_Z, POSITION,
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
            factors={name: factor[rows] for name, factor in self.factors.items()},
            heading=None if self.heading is None else self.heading[rows],
            elsewhere={words: values[rows] for words, values in self.elsewhere.items()},
        )


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
        return f"{what} is {number_text(factor, 1.0)} times {of}{unit}"

    return text


def number_text(number: float, neutral: float) -> str:
    """Return a number with six digits, or as many as tell it from the one of no fault."""
    for count in range(6, 16):
        if float(text := f"{number:.{count}g}") != neutral:
            return text
    return f"{number:.17g}"


def parts(slot: Slot) -> Iterator[Part]:
    """Yield a slot's parts, the largest first: all, rows, blocks and columns, their terms."""
    yield Part(slot.name, np.ones(slot.shape, dtype=bool))
    if slot.named_parts is not None:
        yield from slot.named_parts
    elif slot.covariance:
        yield from _parts_of_covariance(slot)
    elif slot.shape[1] == 1:
        for name, at in slot.row_blocks.items():
            yield Part(f"the {name} of {slot.name}", mask_of(slot.shape, at, (0,)))
        for k, row in enumerate(slot.rows):
            yield Part(f"the {row} of {slot.name}", mask_of(slot.shape, (k,), (0,)))
    else:
        yield from _parts_of_matrix(slot)


def mask_of(shape: tuple[int, int], rows: Iterable[int], columns: Iterable[int]) -> Mask:
    """Return (r, c) the terms in some rows and columns."""
    mask = np.zeros(shape, dtype=bool)
    mask[np.ix_(list(rows), list(columns))] = True
    return mask


def _parts_of_matrix(slot: Slot) -> Iterator[Part]:
    every_row, every_column = (tuple(range(n)) for n in slot.shape)
    for k, row in enumerate(slot.rows):
        yield Part(f"the {row} row of {slot.name}", mask_of(slot.shape, (k,), every_column))
    columns = {f"{name} block": at for name, at in slot.blocks.items()}
    columns |= {f"{name} column": (k,) for k, name in enumerate(slot.columns)}
    for name, at in columns.items():
        yield Part(f"the {name} of {slot.name}", mask_of(slot.shape, every_row, at))
    for row, of_row in slot.row_blocks.items():
        for name, at in columns.items():
            term = name.replace(" column", " term").replace(" block", " part")
            words = f"the {term} of the {row} rows of {slot.name}"
            yield Part(words, mask_of(slot.shape, of_row, at))
    for k, row in enumerate(slot.rows):
        for name, at in columns.items():
            term = name.replace(" column", " term").replace(" block", " part")
            yield Part(f"the {term} of the {row} row of {slot.name}", mask_of(slot.shape, (k,), at))


def _parts_of_covariance(slot: Slot) -> Iterator[Part]:
    for name, at in slot.blocks.items():
        yield Part(f"the {name} block of {slot.name}", mask_of(slot.shape, at, at))
    for k, row in enumerate(slot.rows):
        yield Part(f"{slot.name} of the {row}", mask_of(slot.shape, (k,), (k,)))
    for i, j in combinations(range(len(slot.rows)), 2):
        pair = f"the covariance of {slot.rows[i]} and {slot.rows[j]} in {slot.name}"
        yield Part(pair, mask_of(slot.shape, (i,), (j,)) | mask_of(slot.shape, (j,), (i,)))


def compositions(slot: Slot, like: Values) -> Iterator[Composition]:
    """Yield the faults of a slot, the simplest first.

    Args:
        slot: What is changed.
        like: Values with the same factors and elsewhere: what there is to make faults of.
    """
    yield from single_changes(slot, like)
    yield from joined_changes(slot, like)
    yield from numbered_changes(slot)


def joined_changes(slot: Slot, like: Values) -> Iterator[Composition]:
    """Yield the faults of a slot that are two changes: terms moved, and a part negated."""
    for structure in _structures(slot, like):
        for part in parts(slot):
            yield _also_negated(structure, part)


def single_changes(slot: Slot, like: Values) -> Iterator[Composition]:
    """Yield the faults of a slot that are one change without a number."""
    shapes = list(parts(slot))
    for part in shapes:
        yield from _of_terms(slot, part)
    yield from _structures(slot, like)
    for words in like.elsewhere:
        for part in shapes:
            yield _elsewhere(slot, part, words)
    for part in shapes:
        for factor in like.factors:
            yield from _by_factor(slot, part, factor)


def transposed_parts(slot: Slot) -> Iterator[Composition]:
    """Yield the faults of a slot that are a square part of it, transposed in its place."""
    for part in parts(slot):
        rows, columns = (np.flatnonzero(part.mask.any(axis=axis)) for axis in (1, 0))
        block = np.ix_(rows, columns)
        if 1 < len(rows) == len(columns) < max(slot.shape) and part.mask[block].all():
            yield Composition(
                slot, "transposed", f"{part.words} is transposed", _part_transposed(rows, columns),
                mask=part.mask,
            )  # fmt: skip


def _part_transposed(rows: Index, columns: Index) -> Callable[[Values], Array]:
    def changed(values: Values) -> Array:
        moved = values.sound.copy()
        block = np.ix_(np.arange(len(moved)), rows, columns)
        moved[block] = moved[block].mT
        return moved

    return changed


def numbered_changes(slot: Slot) -> Iterator[Composition]:
    """Yield the faults of a slot that have a number."""
    for part in parts(slot):
        yield Composition(
            slot, "times", times(part.words), times_number(part.mask), (1.0,), mask=part.mask
        )
    for part in parts(slot):
        on_diagonal = slot.covariance and bool(part.mask.diagonal().any())
        said = f"{part.words} has {{0:+.4g}} added{' on its diagonal' if on_diagonal else ''}"
        plus = _plus_on_diagonal if on_diagonal else plus_number
        yield Composition(slot, "plus", said, plus(part.mask), (0.0,), mask=part.mask)


def _within(mask: Mask, sound: Array, changed: Array) -> Array:
    """Changed values (N, r, c) in a part, sound ones in the rest."""
    return np.where(mask, changed, sound)


def times_number(mask: Mask) -> Callable[[Values, float], Array]:
    """Return what multiplies the terms of a part by a number."""
    return lambda values, factor: _within(mask, values.sound, factor * values.sound)


def plus_number(mask: Mask) -> Callable[[Values, float], Array]:
    """Return what adds a number to the terms of a part."""
    return lambda values, more: _within(mask, values.sound, values.sound + more)


def _plus_on_diagonal(mask: Mask) -> Callable[[Values, float], Array]:
    return lambda values, more: values.sound + more * (mask & np.eye(len(mask), dtype=bool))


def _of_terms(slot: Slot, part: Part) -> Iterator[Composition]:
    """Changes of each term by itself, or of variances."""
    mask = part.mask

    def made(change: str, words: str, changed: Callable[[Array], Array]) -> Composition:
        return Composition(
            slot, change, f"{part.words} {words}",
            lambda values: _within(mask, values.sound, changed(values.sound)), mask=mask,
        )  # fmt: skip

    yield made("zero", "is zero", np.zeros_like)
    on_diagonal = slot.shape[0] == slot.shape[1] and bool(mask.diagonal().any())
    variances = slot.covariance and on_diagonal
    if not variances or slot.named_parts:
        yield made("negated", "has the opposite sign", np.negative)
    if slot.named_parts and on_diagonal and not slot.covariance and not mask.all():
        yield made("identity", "is as in the identity", lambda v: np.eye(v.shape[-1]))
    if not variances:
        return
    diagonal = np.eye(len(slot.rows))
    yield made("root", "contains sigma instead of sigma squared",
               lambda v: np.sqrt(np.maximum(v * diagonal, 0.0)))  # fmt: skip
    yield made("square", "contains the square of the variances", lambda v: v**2 * diagonal)
    if mask.all():
        yield made("diagonal", "lacks its covariances", lambda v: v * diagonal)
        yield made("inverse", "is inverted, as information", _inverted)
        yield made("product", "is multiplied by itself", lambda v: v @ v)
        yield made("factor", "is its Cholesky factor L, not L L^T", _cholesky)
        yield made("order of factors", "is L^T L, not L L^T, of its Cholesky factor L",
                   lambda v: _cholesky(v).mT @ _cholesky(v))  # fmt: skip


def _inverted(covariance: Array) -> Array:
    with np.errstate(all="ignore"):
        singular = np.linalg.cond(covariance) > 1.0 / np.finfo(float).eps
    safe = np.where(singular[:, None, None], np.eye(covariance.shape[-1]), covariance)
    return np.where(singular[:, None, None], np.nan, np.linalg.inv(safe))


def _cholesky(covariance: Array) -> Array:
    """Factors L (N, r, r), NaN where a covariance has none."""
    symmetric = 0.5 * (covariance + covariance.mT)
    return np.stack([_factor(matrix) for matrix in symmetric]) if len(symmetric) else symmetric


def _factor(covariance: Array) -> Array:
    try:
        return np.asarray(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError:
        return np.full_like(covariance, np.nan)


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
        words = f"{slot.name} lacks what is off its diagonal"
        diagonal = np.eye(rows)
        yield Composition(slot, "diagonal", words, lambda v: v.sound * diagonal)
        words = f"{slot.name} has the opposite sign off its diagonal"
        signs = 2.0 * diagonal - 1.0
        yield Composition(slot, "negated off the diagonal", words, lambda v: v.sound * signs)
        inverted = f"{slot.name} is inverted"
        yield Composition(slot, "inverse", inverted, lambda v: _inverted(v.sound))
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
    if slot.named_parts == () or rows > _MOST_EXCHANGED:
        return
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
            terms = _reordered(order, every_column, mask_of(slot.shape, (i, j), (k,)))
            yield Composition(slot, "exchanged", words, terms)
    for i, j in combinations(range(0 if slot.covariance else columns), 2):
        words = f"the columns of {slot.columns[i]} and {slot.columns[j]} in {slot.name}"
        order = _exchanged(columns, i, j)
        yield Composition(slot, "exchanged", f"{words} are exchanged", _reordered(every_row, order))
    yield from _exchanges_of_blocks(slot)


def _exchanges_of_blocks(slot: Slot) -> Iterator[Composition]:
    """Rows, or columns, of two blocks have changed places, in all of a matrix or in a block."""
    rows, columns = slot.shape
    every_row, every_column = np.arange(rows), np.arange(columns)
    for a, b in _alike(slot.movable_rows):
        order = _exchanged(rows, slot.movable_rows[a], slot.movable_rows[b])
        words = f"the rows of {a} and of {b} in {slot.name} are exchanged"
        yield Composition(slot, "exchanged", words, _reordered(order, every_column))
        for name, at in slot.movable_columns.items():
            words = f"the parts of {a} and of {b} by {name} in {slot.name} are exchanged"
            mask = mask_of(slot.shape, every_row, at)
            yield Composition(slot, "exchanged", words, _reordered(order, every_column, mask))
    for a, b in _alike(slot.movable_columns):
        order = _exchanged(columns, slot.movable_columns[a], slot.movable_columns[b])
        words = f"the columns of {a} and of {b} in {slot.name} are exchanged"
        yield Composition(slot, "exchanged", words, _reordered(every_row, order))


def _alike(blocks: Mapping[str, tuple[int, ...]]) -> Iterator[tuple[str, str]]:
    """Pairs of blocks of one size, of more than one entry."""
    for a, b in combinations(blocks, 2):
        if len(blocks[a]) == len(blocks[b]) > 1:
            yield a, b


def _exchanged(count: int, i: int | Sequence[int], j: int | Sequence[int]) -> Index:
    """Numbers up to count, some of them in each other's place."""
    order = np.arange(count)
    order[np.r_[i, j]] = np.r_[j, i]
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
        turn[:, :2, :2] = rotations(angle)
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
