"""Whether the matrices that a filter used are the derivatives of its functions: the ladder's F2.

In: each prediction, update and new block with an evaluation of its function behind it, and what the
recursion holds there. Out: figures by slot (F, H of a sensor, G_x), in sigma, and findings: which
change of the grammar makes of the derivatives what was recorded, in all events that deviate. What
is recorded of values is compared as well: the numbers after a step with the function's, a residual
with what was measured less what is predicted.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index, Mask
from comparisons.audit.replay import BlockLayout, Replay
from comparisons.explain.hypotheses import Hypothesis, Quantity, best
from comparisons.faults.grammar import (
    Composition,
    Slot,
    Values,
    compositions,
    numbered_changes,
    single_changes,
    transposed_parts,
)
from comparisons.faults.operands import Operand, slot_of
from comparisons.figures import Figure
from comparisons.trace.events import (
    ADDITIVE,
    OWN_CHART,
    Augment,
    Blocks,
    Clone,
    Evaluation,
    Event,
    Predict,
    SensorDescription,
    TracePrior,
    Update,
)
from comparisons.trace.functions import FIRST

KEPT = 300
"""Events of a slot that are kept: the first, and of those that deviate the first."""
_UNCERTAIN = 3.0
"""Times a derivative's own error, within which it is that of the function."""
_ROUNDING = 1e-9
"""Relative, of entries and of values."""
_SLIGHT = 1e-3
"""Share of what a step does in a column, below which a difference is slight; and in sigma."""
_SMALL_SIGMA = 0.01
"""What terms of second order in a small step change of an outcome at the most."""
_OF_MATRIX = 9
"""Numbers of an attitude that is recorded as a matrix."""
_WHOLE_TURN = 2.0 * np.pi
_AT_FIRST = 20
"""Events that deviate first, whose cause is named where that of all is not."""
_FEW_TERMS = 36
"""Entries of a matrix up to which two changes at once are tried."""
_BEFORE = "that of the event before of its kind"
AXES = {
    "in the body's axes by its rows (times the attitude's inverse from the left)": (True, -1),
    "in the world's axes by its rows (times the attitude from the left)": (True, 1),
    "by errors in the world's axes (times the attitude's inverse from the right)": (False, -1),
    "by errors in the body's axes (times the attitude from the right)": (False, 1),
}
"""Frames in which a matrix may be instead, by words: whether of its rows, and which power of R."""

Evaluable = Predict | Update | Augment


@dataclass(frozen=True, kw_only=True)
class FunctionFigures:
    """A slot of the filter beside the derivative of its function.

    Attributes:
        slot: F, G_x, or H of a sensor.
        events: how many were compared.
        differing: in how many of them an entry is not the derivative.
        largest_sigma: largest effect of a difference on the outcome, in its standard deviations, by
            an error of one standard deviation.
    """

    slot: str
    events: int
    differing: int
    largest_sigma: Figure


class FunctionDifference(NamedTuple):
    """What is not as a function says: what, in words; fault; since when; in which blocks."""

    what: str
    fault: bool
    event: int
    sensor: str | None
    blocks: Blocks


class _Compared(NamedTuple):
    """An event's matrix beside its function's derivative.

    have, meant, allowed: (m, n). value, expected: (k,) of values beside each other, none where
    nothing was recorded. value_allowed: (k,). elsewhere: by words, other derivatives (m, n).
    effect: the largest, in sigmas of the outcome.
    """

    event: int
    have: Array
    meant: Array
    allowed: Array
    value: Array
    expected: Array
    value_allowed: Array
    elsewhere: Mapping[str, Array]
    effect: float


@dataclass(kw_only=True)
class _SlotRecords:
    """What is kept of a slot. operand: how its rows and columns are called."""

    operand: Operand
    sensor: str | None
    blocks: Blocks
    words: str
    kept: list[_Compared] = field(default_factory=list)
    deviating: list[_Compared] = field(default_factory=list)
    count: int = 0
    off: int = 0
    wrong_values: int = 0
    largest: float = 0.0
    last: _Compared | None = None

    def add(self, record: _Compared) -> None:
        self.count += 1
        self.last = record
        self.largest = max(self.largest, record.effect)
        off = bool(_is_off(record).any())
        self.off += off
        wrong = _values_off(record)
        self.wrong_values += wrong
        if (off or wrong) and len(self.deviating) < KEPT:
            self.deviating.append(record)
        if len(self.kept) < KEPT:
            self.kept.append(record)

    def figures(self) -> FunctionFigures:
        return FunctionFigures(
            slot=self.words, events=self.count, differing=self.off, largest_sigma=self.largest
        )


class _Waiting(NamedTuple):
    """An event that may be followed by its function's evaluation, and P before and after it.

    spread: (m, m) of an update's innovation.
    """

    event: Evaluable
    layout: BlockLayout
    at: slice | Index
    before: Array
    after: Array
    spread: Array | None


class FunctionCheck:
    """Compares events with evaluations of their functions, as they come."""

    def __init__(self, sensors: Mapping[str, SensorDescription], tolerance: float) -> None:
        """Start.

        Args:
            sensors: What is known of them, names of components among it.
            tolerance: What a difference may change of an outcome, in its standard deviations, for
                an error of one standard deviation.
        """
        self._sensors, self._tolerance = sensors, tolerance
        self._slots: dict[tuple[object, ...], _SlotRecords] = {}
        self._charts: dict[str, str] = {}
        self._waiting: _Waiting | None = None

    @property
    def compared(self) -> bool:
        """Whether there was anything to compare."""
        return bool(self._slots)

    def take(
        self, event: Event, before: Array | None, spread: Array | None, replay: Replay
    ) -> None:
        """Note an event, or compare the one before.

        Args:
            event: Any.
            before: (n, n) P before it; None where that is not known.
            spread: (m, m) of an update's innovation, if known.
            replay: What the filter holds after it.
        """
        if isinstance(event, Evaluation):
            if self._waiting is not None:
                self._compare(self._waiting, event)
            self._waiting = None
            return
        self._waiting = None
        match event:
            case TracePrior():
                self._charts = dict(zip(event.blocks, event.charts, strict=False))
            case Augment():
                self._charts[event.name] = event.chart
            case Clone():
                self._charts[event.name] = self._charts.get(event.source, ADDITIVE)
        if isinstance(event, Evaluable) and before is not None:
            layout = replay.layout
            at = layout.columns(event.blocks)
            self._waiting = _Waiting(event, layout, at, before, replay.covariance, spread)

    def figures(self) -> tuple[FunctionFigures, ...]:
        """Return the figures of each slot."""
        return tuple(records.figures() for records in self._slots.values())

    def differences(self) -> Iterator[FunctionDifference]:
        """Yield what is not as the functions say, by slot."""
        for records in self._slots.values():
            if not records.deviating:
                continue
            yield from _of_values(records)
            if records.off:
                yield _of_matrix(records)

    def _compare(self, waiting: _Waiting, evaluation: Evaluation) -> None:
        event = waiting.event
        records = self._records(event, waiting.layout)
        sigma = _sigmas(waiting.before[waiting.at][:, waiting.at])
        unit = self._unit(waiting)
        have, meant = event.jacobian, evaluation.jacobian
        with np.errstate(all="ignore"):
            effects = np.abs(have - meant) * sigma / unit[:, None]
            allowed = self._tolerance * unit[:, None] / sigma
        scale = np.abs(meant).max(axis=1, keepdims=True, initial=0.0)
        allowed = np.minimum(allowed, _SLIGHT * np.maximum(scale, np.abs(have - _eye(have))))
        allowed = allowed + _UNCERTAIN * evaluation.uncertainty + _ROUNDING * scale
        off = np.abs(have - meant) > allowed
        effect = float(np.where(off, np.nan_to_num(effects), 0.0).max(initial=0.0))
        value, expected = _values(event, evaluation)
        size = float(np.abs(evaluation.value).max(initial=1.0))
        value_allowed = _ROUNDING * np.maximum(np.abs(value) + np.abs(expected), size)
        if len(unit) == len(value):
            value_allowed = value_allowed + self._tolerance * unit
        elsewhere = turned_axes(meant, self._attitude(event, waiting.layout))
        if records.last is not None and records.count < FIRST:
            elsewhere[_BEFORE] = records.last.meant
        matrices = have, meant, allowed
        records.add(
            _Compared(event.number, *matrices, value, expected, value_allowed, elsewhere, effect)
        )

    def _attitude(self, event: Evaluable, layout: BlockLayout) -> Array | None:
        """Return the rotation (3, 3) of an event's one attitude, where its point has its matrix."""
        if event.point is None:
            return None
        start, attitudes = 0, list[int]()
        for name in event.blocks:
            chart = self._charts.get(name, ADDITIVE)
            if chart.startswith(("so3", "se23")):
                attitudes.append(start)
                start += _OF_MATRIX if chart.startswith("so3") else _OF_MATRIX + 6
            elif chart == OWN_CHART:
                return None
            else:
                start += layout.dims[name]
        if len(attitudes) != 1 or start != len(event.point):
            return None
        return event.point[attitudes[0] : attitudes[0] + _OF_MATRIX].reshape(3, 3)

    def _unit(self, waiting: _Waiting) -> Array:
        """(m,) about the sigmas of what the function leads to."""
        event = waiting.event
        if isinstance(event, Update):
            spread = event.noise if waiting.spread is None else waiting.spread
            return _sigmas(spread)
        if isinstance(event, Augment):
            return _sigmas(waiting.after)[-len(event.jacobian) :]
        return _sigmas(waiting.after[waiting.at][:, waiting.at])

    def _records(self, event: Evaluable, layout: BlockLayout) -> _SlotRecords:
        names = _generic(event.blocks)
        sensor = event.sensor if isinstance(event, Update) else None
        shape = event.jacobian.shape
        key = type(event), sensor, names, shape
        if key in self._slots:
            return self._slots[key]
        inner = tuple(zip(names, (layout.dims[name] for name in event.blocks), strict=True))
        measured: tuple[str, ...] = ()
        new, name, words = "", "F", "F"
        if isinstance(event, Update):
            described = self._sensors.get(event.sensor)
            measured = described.components if described is not None else ()
            measured = measured if len(measured) == shape[0] else ()
            name, words = "H", f"H of `{event.sensor}`"
        elif isinstance(event, Augment):
            (new,) = _generic((event.name,))
            name, words = "G_x", f"G_x of {new}"
        operand = Operand(name, shape, inner, new, inner, names, measured)
        records = _SlotRecords(operand=operand, sensor=sensor, blocks=event.blocks, words=words)
        self._slots[key] = records
        return records


def turned_axes(meant: Array, rotation: Array | None) -> dict[str, Array]:
    """Return a matrix in other frames, by words: its rows or columns turned, three and three."""
    if rotation is None:
        return {}
    turned = {}
    for words, (of_rows, power) in AXES.items():
        size = meant.shape[0 if of_rows else 1]
        if size % 3 == 0:
            turn = np.kron(np.eye(size // 3), rotation if power > 0 else rotation.T)
            turned[words] = turn @ meant if of_rows else meant @ turn
    return turned


def _values(event: Evaluable, evaluation: Evaluation) -> tuple[Array, Array]:
    """Return what the filter has, and what its function says it has: none where not recorded."""
    if isinstance(event, Update):
        if evaluation.measured is None:
            return np.zeros(0), np.zeros(0)
        return event.residual, evaluation.measured - evaluation.value
    if event.after is None or len(event.after) != len(evaluation.value):
        return np.zeros(0), np.zeros(0)
    if isinstance(event, Augment) or event.point is None or len(event.point) != len(event.after):
        return event.after, evaluation.value
    return event.after - event.point, evaluation.value - event.point


def _generic(names: Blocks) -> Blocks:
    """Names of blocks without the numbers of single landmarks, where that leaves them apart."""
    plain = tuple(re.sub(r"[ _-]*\d+$", "", name) or name for name in names)
    if len(set(plain)) == len(plain):
        return plain
    return tuple(f"{name}, number {k + 1}" for k, name in enumerate(plain))


def _sigmas(covariance: Array) -> Array:
    """Standard deviations, the least number where there is none."""
    variance = np.nan_to_num(covariance.diagonal())
    return np.asarray(np.sqrt(np.maximum(variance, np.finfo(float).tiny)))


def _eye(matrix: Array) -> Array:
    return np.eye(*matrix.shape) if matrix.shape[0] == matrix.shape[1] else np.zeros(matrix.shape)


def _is_off(record: _Compared) -> Mask:
    """(m, n) which entries are not the derivative's."""
    off: Mask = ~(np.abs(record.have - record.meant) <= record.allowed)
    return off


def _turns_off(record: _Compared) -> Array:
    """(k,) differences of values, but for whole turns."""
    difference = record.value - record.expected
    return np.asarray(difference - _WHOLE_TURN * np.round(difference / _WHOLE_TURN))


def _values_off(record: _Compared) -> bool:
    if not len(record.value):
        return False
    return bool((~(np.abs(_turns_off(record)) <= record.value_allowed)).any())


def _of_values(records: _SlotRecords) -> Iterator[FunctionDifference]:
    """What is wrong with residuals, or with the numbers that a step leads to."""
    wrong = [record for record in records.deviating if _values_off(record)]
    if not wrong:
        return
    operand, first = records.operand, wrong[0]
    subject, what = "the step of the estimate", "that of its function"
    if operand.name == "H":
        subject = f"the residual of `{records.sensor}`"
        what = "what was measured less what its function predicts"
    elif operand.new:
        subject = f"the estimate of a new {operand.new}"
    rows = slot_of(operand).rows
    if len(rows) != len(first.value):
        rows = tuple(f"number {k}" for k in range(len(first.value)))
    have, meant, allowed = (
        np.array([getattr(record, name) for record in wrong])[:, :, None]
        for name in ("value", "expected", "value_allowed")
    )
    either = np.stack((have - meant, have + meant))
    turns = np.round(either / _WHOLE_TURN)
    turned = (np.abs(either - turns * _WHOLE_TURN) <= allowed) & (turns != 0.0)
    quantity = Quantity(
        have=have,
        meant=meant,
        tolerance=allowed,
        records="events",
        angle=np.asarray(turned.any(axis=(0, 1))),
    )
    slot = Slot(name=subject, rows=rows, row_blocks=_row_blocks(rows))
    values = Values(sound=meant)
    fitted = best(quantity, (_hypothesis(c, values) for c in compositions(slot, values)))
    if fitted is not None:
        text = _said(*fitted)
    else:
        k = int(np.argmax(np.abs(_turns_off(first)) / first.value_allowed))
        beside = f"{rows[k]}: {first.value[k]:.6g}, not {first.expected[k]:.6g}"
        text = f"{subject} is not {what} ({beside}, at event {first.event})"
    text += f", in {records.wrong_values:,} of {records.count:,} that were evaluated"
    text += _since(records, first)
    yield FunctionDifference(text, True, first.event, records.sensor, records.blocks)


def _row_blocks(rows: Sequence[str]) -> dict[str, tuple[int, ...]]:
    blocks: dict[str, list[int]] = {}
    for k, name in enumerate(rows):
        blocks.setdefault(name.partition("[")[0], []).append(k)
    return {name: tuple(at) for name, at in blocks.items() if 1 < len(at) < len(rows)}


def _of_matrix(records: _SlotRecords) -> FunctionDifference:
    """What is wrong with a slot's matrix."""
    deviating = [record for record in records.deviating if _is_off(record).any()]
    first, slot = deviating[0], slot_of(records.operand)
    whose = f"{records.off:,} of {records.count:,} that were evaluated{_since(records, first)}"
    most = f"by up to {records.largest:.2g} sigma"
    is_small = records.largest < _SMALL_SIGMA
    if is_small and records.operand.name == "F" and all(map(_is_of_second_order, deviating)):
        text = "F is not the derivative of its function but for terms of second order in the step"
        return _difference(records, f"{text}, {most}, in {whose}", first, fault=False)
    lines, until = _named_changes(deviating, slot)
    if lines:
        whose_h = f"sensor `{records.sensor}`: " if records.sensor else ""
        text = f"{whose_h}{'; '.join(lines)}: not the derivative of its function, {most}{until}"
    else:
        entry = _largest_entry(first, slot)
        text = f"{records.words} is not the derivative of its function ({entry}), {most}"
    slight = max(_share(record) for record in deviating) < _SLIGHT and records.largest < _SLIGHT
    return _difference(records, f"{text}, in {whose}", first, fault=not slight)


def _since(records: _SlotRecords, first: _Compared) -> str:
    """Say since when something is wrong, where it was right before."""
    return "" if first is records.kept[0] else f", from event {first.event} on"


def _difference(
    records: _SlotRecords, text: str, first: _Compared, *, fault: bool
) -> FunctionDifference:
    return FunctionDifference(text, fault, first.event, records.sensor, records.blocks)


def _named_changes(deviating: list[_Compared], slot: Slot) -> tuple[list[str], str]:
    """Return which changes make of derivatives what was recorded, and, in words, up to when.

    Of all events that deviate; else of those that directly follow another, whose derivative may
    stand there still; else of the first: a filter that diverges has other differences later on.
    """
    following = [record for record in deviating if _BEFORE in record.elsewhere]
    for records in (deviating, following, deviating[:_AT_FIRST]):
        if not records:
            continue
        have, meant, allowed = (
            np.array([getattr(record, name) for record in records])
            for name in ("have", "meant", "allowed")
        )
        words = set.intersection(*(set(record.elsewhere) for record in records))
        elsewhere = {
            name: np.array([record.elsewhere[name] for record in records])
            for name in (*AXES, _BEFORE)
            if name in words
        }
        quantity = Quantity(have=have, meant=meant, tolerance=allowed, records="events")
        if lines := _lines(quantity, slot, Values(sound=meant, elsewhere=elsewhere)):
            at_first = len(records) == _AT_FIRST < len(deviating)
            return lines, f" (up to event {records[-1].event})" if at_first else ""
    return [], ""


def _lines(quantity: Quantity, slot: Slot, values: Values) -> list[str]:
    """Return which changes of a slot make of derivatives what was recorded; none where none do.

    One of the whole where there is one, else one for each row that deviates.
    """
    every = np.arange(len(quantity.have))
    terms = ~(np.abs(quantity.apart(every, quantity.meant)) <= 1.0)
    off: Mask = np.asarray(terms.any(axis=0)).reshape(slot.shape)
    whole = [
        change
        for change in _changes(slot, values)
        if change.mask is None or not (off & ~change.mask).any()
    ]
    whole.sort(key=_terms)
    fitted = best(quantity, (_hypothesis(change, values) for change in whole))
    if fitted is not None:
        return [_said(*fitted)]
    lines: list[str] = []
    rows = np.flatnonzero(off.any(axis=1)).tolist()
    for row in rows if len(rows) > 1 else ():
        fitted = best(quantity.part(row), _of_row(slot, values, off, row))
        if fitted is None:
            return []
        lines.append(_said(*fitted))
    return lines


def _changes(slot: Slot, values: Values) -> Iterator[Composition]:
    """Yield changes of a slot, the simplest first; two at once where they are few."""
    if slot.shape[0] * slot.shape[1] <= _FEW_TERMS:
        yield from compositions(slot, values)
    else:
        yield from single_changes(slot, values)
        yield from numbered_changes(slot)
    yield from transposed_parts(slot)


def _terms(change: Composition) -> int:
    """How many terms a change is of: what is of fewer goes first; two changes at once go last."""
    if change.mask is not None:
        return int(change.mask.sum())
    rows, columns = change.slot.shape
    return rows * columns * (2 if change.change.endswith("negated") else 1)


def _hypothesis(change: Composition, values: Values, row: int | None = None) -> Hypothesis:
    """Return a change as what it would have recorded, of all rows of a matrix or of one."""

    def predict(rows: Index, *numbers: float) -> Array:
        with np.errstate(all="ignore"):
            made = change.values(values.rows(rows), *numbers)
        return made if row is None else made[:, row]

    return Hypothesis(change.words, predict, change.start)


def _of_row(slot: Slot, values: Values, off: Mask, row: int) -> Iterator[Hypothesis]:
    """Yield changes of terms of one row, beside whatever is wrong in the others."""
    others = np.arange(len(off)) != row
    for change in (*single_changes(slot, values), *numbered_changes(slot)):
        mask = change.mask
        if mask is not None and not (off[row] & ~mask[row]).any() and not mask[others].any():
            yield _hypothesis(change, values, row)


def _said(hypothesis: Hypothesis, figures: tuple[float, ...]) -> str:
    text = hypothesis.text
    return text.format(*figures) if isinstance(text, str) else text(*figures)


def _is_of_second_order(record: _Compared) -> bool:
    """Whether what F lacks is no more than its step's square, as of I + A dt beside exp(A dt)."""
    step = np.abs(record.meant - np.eye(len(record.meant)))
    return bool((np.abs(record.have - record.meant) <= step @ step + record.allowed).all())


def _share(record: _Compared) -> float:
    """Largest difference, relative to what the function does by the same entry's column."""
    step = np.abs(record.meant - _eye(record.meant)).max(axis=0)
    off = np.where(_is_off(record), np.abs(record.have - record.meant), 0.0).max(axis=0)
    return float((off / np.where(step > 0.0, step, 1.0)).max(initial=0.0))


def _largest_entry(record: _Compared, slot: Slot) -> str:
    """Return in words the entry in which an event deviates most."""
    off = np.abs(record.have - record.meant) / np.maximum(record.allowed, np.finfo(float).tiny)
    i, k = np.unravel_index(int(np.argmax(off)), off.shape)
    have, meant = record.have[i, k], record.meant[i, k]
    entry = f"{slot.rows[int(i)]} by {slot.columns[int(k)]}"
    return f"{entry}: {have:.6g}, not {meant:.6g}, at event {record.event}"
