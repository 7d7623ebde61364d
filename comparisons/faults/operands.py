"""The matrices in recipes as slots of the grammar: names of rows and columns, and parts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np

from comparisons.audit.replay import BlockLayout
from comparisons.faults.grammar import (
    Composition,
    Mask,
    Part,
    Slot,
    Values,
    mask_of,
    numbered_changes,
    single_changes,
)
from comparisons.faults.recipes import AFTER, SUBJECTS
from comparisons.trace.events import Augment, Blocks, Clone, Event

_MOST_TERMS = 400
"""Entries of a matrix, above which its single ones are no parts: only its rows and blocks."""

_MOST_BLOCKS = 12
"""Of a covariance, above which those that an event is not of are no parts: they are the others."""

_COVARIANCES = ("P", "Q", "R", "S", "N", AFTER)

_KEPT = 64
"""Operands of which what is made of them is kept."""

_ON_THE_WAY = ("S", "A", "U", "I")
"""What is made on the way to the covariance; its parts are those of what it is made of."""


_OF_WHOLE = ("transposed", "identity", "inverse", "diagonal", "negated off the diagonal")
"""Changes without a mask that are of a whole matrix."""


class Operand(NamedTuple):
    """A matrix of an event, and all that its slot is made of.

    Attributes:
        name: Of the matrix in its recipe.
        shape: Of its values.
        inner: Blocks of the event with their sizes.
        new: The block that the event begins, if any.
        state: Blocks of the state with their sizes.
        parted: Blocks of the state that are parts of a covariance by themselves.
        measured: Names of a measurement's components, if any were given.
    """

    name: str
    shape: tuple[int, ...]
    inner: tuple[tuple[str, int], ...]
    new: str
    state: tuple[tuple[str, int], ...]
    parted: tuple[str, ...]
    measured: tuple[str, ...] = ()


def operand_of(
    name: str, shape: tuple[int, ...], event: Any, layout: BlockLayout, wrong: Blocks = ()
) -> Operand:
    """Return a matrix of an event as an operand. wrong: blocks that may be parts as well."""
    inner = tuple((block, layout.dims[block]) for block in getattr(event, "blocks", ()))
    new, parted = event_name(event), tuple(layout.dims)
    if len(parted) > _MOST_BLOCKS:
        of_event = [*(block for block, _ in inner), new, getattr(event, "source", "")]
        near = {*of_event, *wrong} if len(wrong) <= _MOST_BLOCKS else {*of_event}
        parted = tuple(block for block in parted if block in near)[:_MOST_BLOCKS]
    return Operand(name, shape, inner, new, tuple(layout.dims.items()), parted)


@lru_cache(maxsize=_KEPT)
def slot_of(operand: Operand) -> Slot:
    """Return an operand's slot: names of rows and columns, and parts by blocks and terms."""
    named = _Names(operand)
    rows, columns = named.of(operand.name, operand.shape)
    subject = SUBJECTS.get(operand.name, operand.name)
    covariance = operand.name in _COVARIANCES
    if operand.name in _ON_THE_WAY:
        return Slot(name=subject, rows=rows, columns=columns, covariance=covariance, named_parts=())
    by_mask: dict[bytes, Part] = {}
    for part in (
        _parts_of_covariance(subject, rows, named, of_result=operand.name == AFTER)
        if covariance
        else _parts_of_matrix(subject, rows, columns, named)
    ):
        by_mask.setdefault(part.mask.tobytes(), part)
    proper = [part for part in by_mask.values() if part.mask.any() and not part.mask.all()]
    movable_rows, movable_columns = ({}, {}) if covariance else named.movable(rows, columns)
    return Slot(
        name=subject, rows=rows, columns=columns, covariance=covariance, named_parts=tuple(proper),
        movable_rows=movable_rows, movable_columns=movable_columns,
    )  # fmt: skip


def singles_of(operand: Operand, like: Values) -> Mapping[str, Composition]:
    """Return the changes of an operand without a number, by their words, the simplest first."""
    return _singles_of(operand, tuple(like.factors), tuple(like.elsewhere))


@lru_cache(maxsize=_KEPT)
def _singles_of(
    operand: Operand, factors: tuple[str, ...], elsewhere: tuple[str, ...]
) -> Mapping[str, Composition]:
    no_records = np.zeros((0, *operand.shape))
    like = Values(
        sound=no_records,
        factors=dict.fromkeys(factors, np.zeros(0)),
        elsewhere=dict.fromkeys(elsewhere, no_records),
    )
    return {change.said(): change for change in single_changes(slot_of(operand), like)}


@lru_cache(maxsize=_KEPT)
def numbered_of(operand: Operand) -> Mapping[str, Composition]:
    """Return the changes of an operand with a number, by their words where there is no fault."""
    return {change.said(*change.start): change for change in numbered_changes(slot_of(operand))}


class _Names:
    """Names of the entries of an event's matrices."""

    def __init__(self, operand: Operand) -> None:
        self.state = self.entries(dict(operand.state))
        self.inner = self.entries(dict(operand.inner))
        self.new, self.measured = operand.new, operand.measured
        self.blocks = tuple(name for name, _ in operand.inner)
        self.others = dict(operand.state).keys() - set(operand.parted)

    @staticmethod
    def entries(dims: Mapping[str, int]) -> tuple[str, ...]:
        """Names of the entries of blocks."""
        return tuple(
            name if dim == 1 else f"{name}[{k}]" for name, dim in dims.items() for k in range(dim)
        )

    def of(self, name: str, shape: tuple[int, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of rows and columns of a matrix."""
        measured = self.measured or tuple(f"component {k}" for k in range(min(shape)))
        new = self.entries({self.new: shape[0]}) if self.new else ()
        noise = tuple(f"noise {k}" for k in range(shape[1]))
        by_name = {
            "F": (self.inner, self.inner), "Q": (self.inner, self.inner),
            "J": (self.inner, self.inner), "H": (measured, self.inner),
            "R": (measured, measured), "S": (measured, measured), "K": (self.state, measured),
            "G_x": (new, self.inner), "G_z": (new, noise), "C": (new, self.state),
            "N": (new, new),
        }  # fmt: skip
        rows, columns = by_name.get(name, (self.state, self.state))
        if (len(rows), len(columns)) != shape:
            rows, columns = (tuple(f"{w} {k}" for k in range(n)) for w, n in
                             zip(("row", "column"), shape, strict=True))  # fmt: skip
        return rows, columns

    @staticmethod
    def groups(names: tuple[str, ...]) -> dict[str, list[int]]:
        """Entries of blocks by name; none of what has a single entry in all."""
        blocks: dict[str, list[int]] = {}
        for k, name in enumerate(names):
            blocks.setdefault(name.partition("[")[0], []).append(k)
        return blocks

    def movable(
        self, rows: tuple[str, ...], columns: tuple[str, ...]
    ) -> tuple[dict[str, tuple[int, ...]], dict[str, tuple[int, ...]]]:
        """Rows and columns of blocks; of a measurement, runs of components as long as a block."""
        of_rows, of_columns = (
            {name: tuple(at) for name, at in self.groups(names).items()}
            for names in (rows, columns)
        )
        sizes = {len(at) for at in of_columns.values() if 1 < len(at) < len(rows)}
        if rows != columns:
            for size in sorted(size for size in sizes if len(rows) % size == 0):
                for k in range(0, len(rows), size):
                    of_rows[f"{rows[k]} to {rows[k + size - 1]}"] = tuple(range(k, k + size))
        return of_rows, of_columns

    def is_parted(self, block: str) -> bool:
        """Whether a block is a part of a covariance by itself."""
        return block not in self.others

    def together(self, names: tuple[str, ...]) -> dict[str, list[int]]:
        """Entries of the event's blocks, where they are several of more."""
        groups = self.groups(names)
        blocks = [name for name in self.blocks if name in groups]
        if not 1 < len(blocks) < len(groups):
            return {}
        words = f"{', '.join(blocks[:-1])} and {blocks[-1]}"
        return {words: sorted(k for name in blocks for k in groups[name])}


def _parts_of_matrix(
    subject: str, rows: tuple[str, ...], columns: tuple[str, ...], named: _Names
) -> Iterator[Part]:
    shape = len(rows), len(columns)
    by_rows, by_columns = named.groups(rows), named.groups(columns)
    for name, at in by_rows.items():
        yield Part(f"the row block of {name} in {subject}", mask_of(shape, at, range(shape[1])))
    across = subject == SUBJECTS["C"]
    of_columns = (
        "the new block's covariance with {0}"
        if across
        else f"the column block of {{0}} in {subject}"
    )
    for name, at in by_columns.items():
        mask = mask_of(shape, range(shape[0]), at)
        yield Part(of_columns.format(name), mask)
        if len(by_columns) > 2:
            yield Part(of_columns.format(f"all but {name}"), ~mask)
    for (row, of_row), (column, of_column) in product(by_rows.items(), by_columns.items()):
        words = f"the part of {subject} that leads from {column} to {row}"
        yield Part(words, mask_of(shape, of_row, of_column))
    if shape[0] * shape[1] > _MOST_TERMS:
        return
    for k, row in enumerate(rows):
        if row not in by_rows:
            yield Part(f"the {row} row of {subject}", mask_of(shape, [k], range(shape[1])))
    for k, column in enumerate(columns):
        if column not in by_columns:
            yield Part(f"the {column} column of {subject}", mask_of(shape, range(shape[0]), [k]))
    for (i, row), (k, column) in product(enumerate(rows), enumerate(columns)):
        if row not in by_rows or column not in by_columns:
            words = f"the {column} term of the {row} row of {subject}"
            yield Part(words, mask_of(shape, [i], [k]))


def _parts_of_covariance(
    subject: str, rows: tuple[str, ...], named: _Names, *, of_result: bool
) -> Iterator[Part]:
    shape, every, groups = (len(rows), len(rows)), range(len(rows)), named.groups(rows)
    parted = {name: at for name, at in groups.items() if named.is_parted(name)}
    block_of = np.empty(len(rows), dtype=int)
    for number, at in enumerate(groups.values()):
        block_of[at] = number
    across: Mask = block_of[:, None] != block_of
    off = "with all others"
    for a, b in combinations(parted, 2):
        if len(groups) != 2:
            yield Part(f"{subject} of {a} with {b}", _both(shape, groups[a], groups[b]))
        for side, (row, column) in (("above", (a, b)), ("below", (b, a))):
            words = f"{subject} of {a} with {b} {side} the diagonal"
            yield Part(words, mask_of(shape, groups[row], groups[column]))
    sets = {**parted, **named.together(rows)}
    for name, at in sets.items() if len(groups) > 1 else ():
        others = [k for k in every if k not in at]
        yield Part(f"{subject} of {name}", mask_of(shape, at, at))
        yield Part(f"{subject} of {name} {off}", _both(shape, at, others))
        yield Part(f"{subject} of {name}, {off} as well,",
                   _both(shape, at, others) | mask_of(shape, at, at))  # fmt: skip
        if len(groups) > 2:
            of_others = mask_of(shape, others, others)
            yield Part(f"{subject} of all but {name}", of_others)
            yield Part(f"{subject} of all blocks but {name} with each other", across & of_others)
        yield Part(f"{subject} of {name} {off} on one side of the diagonal",
                   mask_of(shape, others, at))  # fmt: skip
        yield Part(f"{subject} of {name} {off} on the other side of the diagonal",
                   mask_of(shape, at, others))  # fmt: skip
    if len(groups) > 1:
        yield Part(f"{subject} of different blocks with each other", across)
    yield Part(f"{subject} off its diagonal", ~np.eye(len(rows), dtype=bool))
    if of_result:
        lower = np.tri(len(rows), k=-1, dtype=bool)
        yield Part(f"the upper triangle of {subject}", lower.T)
        yield Part(f"the lower triangle of {subject}", lower)
    if len(rows) ** 2 > _MOST_TERMS:
        return
    yield from _entries_of_covariance(subject, rows)
    for k in every if len(groups) < len(rows) else ():
        yield Part(f"{subject} of {rows[k]}", mask_of(shape, [k], [k]))
        yield Part(f"{subject} of {rows[k]} {off}", _both(shape, [k], [i for i in every if i != k]))


def _entries_of_covariance(subject: str, rows: tuple[str, ...]) -> Iterator[Part]:
    """Single covariances, on both sides of the diagonal or on one."""
    shape = len(rows), len(rows)
    for i, k in combinations(range(len(rows)), 2):
        words = f"{subject} of {rows[i]} with {rows[k]}"
        yield Part(words, _both(shape, [i], [k]))
        yield Part(f"{words} above the diagonal", mask_of(shape, [i], [k]))
        yield Part(f"{words} below the diagonal", mask_of(shape, [k], [i]))


def _both(shape: tuple[int, int], rows: Iterable[int], columns: Iterable[int]) -> Mask:
    """Terms on both sides of the diagonal."""
    rows, columns = list(rows), list(columns)
    return mask_of(shape, rows, columns) | mask_of(shape, columns, rows)


def event_name(event: Event) -> str:
    """Return the block that an event begins, if any."""
    return event.name if isinstance(event, Augment | Clone) else ""


def is_whole(composition: Composition) -> bool:
    """Whether a change is of a whole matrix; what moves its terms is of parts."""
    if composition.mask is not None:
        return bool(composition.mask.all())
    return composition.change in _OF_WHOLE
