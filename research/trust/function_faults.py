"""Does the audit name Jacobians and frames that are not those of a filter's own functions?

    python -m research.trust.function_faults [--seed 1] [--count 60] [--sound 30]

Three filters of examples/audit (a turning target, an inertial filter, an attitude filter with its
error on the world's side) have one fault each, drawn by the grammar: a slot (F, or H of a sensor),
a part of it (all, blocks, rows, columns, terms), a change (zero, sign, exchange, transposed,
identity, a factor, other axes). It is *named* where the audit says a change that makes of the
derivatives what was recorded, *located* where it says slot, entry and event; another slot that is
called faulty beside it is counted. What changes nothing by a millionth of a sigma is drawn again.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Mask
from comparisons.audit.audit import Audit, audit
from comparisons.audit.functions import AXES, turned_axes
from comparisons.audit.replay import BlockLayout
from comparisons.faults.grammar import (
    Composition,
    Slot,
    Values,
    numbered_changes,
    parts,
    single_changes,
    transposed_parts,
)
from comparisons.faults.operands import Operand, slot_of
from examples.audit import inertial, pointing, turning
from research.script import options, print_head, print_row
from research.trust.defects import share

_FACTORS = (0.1, 0.5, 2.0, 10.0, float(np.degrees(1.0)), float(np.radians(1.0)))
_ROTATION = 9
"""The first numbers of a state with an attitude."""
_LEAST = 1e-4
"""Relative, by which a drawn change changes a matrix."""

Change = Callable[[str, Array, Array], Array]


class AuditedFilter(NamedTuple):
    """record: runs and records it. state: its blocks. measured: names of its measurement."""

    record: Callable[..., None]
    state: dict[str, int]
    measured: tuple[str, ...]
    has_attitude: bool


FILTERS = {
    "turning": AuditedFilter(
        record=turning.track, state=turning.STATE, measured=("range", "bearing"),
        has_attitude=False,
    ),
    "inertial": AuditedFilter(
        record=inertial.fly, state=inertial.STATE, measured=("east", "north", "up"),
        has_attitude=True,
    ),
    "pointing": AuditedFilter(
        record=pointing.point, state=pointing.STATE, measured=(), has_attitude=True
    ),
}  # fmt: skip


class DrawnFunctionFault(NamedTuple):
    """A fault of a filter. words: what it is."""

    filter: str
    slot: str
    words: str
    change: Change


def slot(filtered: AuditedFilter, name: str) -> Slot:
    """Return F or H of a filter."""
    layout = BlockLayout(tuple(filtered.state), tuple(filtered.state.values()))
    rows = layout.size if name == "F" else len(filtered.measured) or 3
    inner = tuple(filtered.state.items())
    shape = rows, layout.size
    measured = filtered.measured if name == "H" else ()
    return slot_of(Operand(name, shape, inner, "", inner, tuple(filtered.state), measured))


def drawn_faults(rng: np.random.Generator) -> Iterator[DrawnFunctionFault]:
    """Yield faults, without end."""
    names = list(FILTERS)
    while True:
        filter_name, name = names[rng.integers(len(names))], ("F", "H")[rng.integers(2)]
        filtered = FILTERS[filter_name]
        of_matrix = slot(filtered, name)
        kind = rng.integers(4 if filtered.has_attitude else 3)
        if kind == 3:
            every = list(parts(of_matrix))
            part, words = every[rng.integers(len(every))], list(AXES)[rng.integers(len(AXES))]
            said, change = f"{part.words} is {words}", _in_axes(name, part.mask, words)
            yield DrawnFunctionFault(filter_name, name, said, change)
            continue
        values = Values(sound=np.zeros((0, *of_matrix.shape)))
        pools = single_changes(of_matrix, values), numbered_changes(of_matrix)
        pool = list(transposed_parts(of_matrix) if kind == 2 else pools[kind])
        if not pool:
            continue
        composition = pool[rng.integers(len(pool))]
        if composition.change == "plus":
            continue
        numbers = (_FACTORS[rng.integers(len(_FACTORS))],) if composition.start else ()
        yield DrawnFunctionFault(
            filter_name, name, composition.said(*numbers), _composed(name, composition, numbers)
        )


def _composed(name: str, composition: Composition, numbers: tuple[float, ...]) -> Change:
    def change(of: str, matrix: Array, x: Array) -> Array:
        if of != name:
            return matrix
        changed: Array = composition.values(Values(sound=matrix[None].copy()), *numbers)[0]
        return changed

    return change


def _in_axes(name: str, mask: Mask, words: str) -> Change:
    def change(of: str, matrix: Array, x: Array) -> Array:
        if of != name:
            return matrix
        turned = turned_axes(matrix, x[:_ROTATION].reshape(3, 3)).get(words, matrix)
        return np.where(mask, turned, matrix)

    return change


def matters(fault: DrawnFunctionFault) -> bool:
    """Whether a fault changes a matrix by more than rounding, at a state that is not special."""
    largest: list[float] = []

    def watched(of: str, matrix: Array, x: Array) -> Array:
        if of == fault.slot:
            other = fault.change(of, matrix.copy(), x)
            scale = float(np.abs(matrix).max())
            largest.append(float(np.nan_to_num(np.abs(other - matrix), nan=np.inf).max()) / scale)
        return matrix

    with tempfile.TemporaryDirectory() as folder:
        FILTERS[fault.filter].record(Path(folder) / "run.trace", watched, 0, 60)
    return bool(np.isfinite(largest).all()) and max(largest) > _LEAST


def judge(fault: DrawnFunctionFault, found: Audit) -> tuple[str, int]:
    """Return `named`, `located`, `no effect` or `missed`, and how many others are faults."""
    slots = [figures for figures in found.functions if figures.slot.startswith(fault.slot)]
    if all(figures.largest_sigma <= found.tolerance for figures in slots):
        return "no effect", 0
    findings = [finding for finding in found.findings if finding.check == "derivatives"]
    own = [one for one in findings if (one.sensor is not None) is (fault.slot == "H")]
    others = sum(one.fault for one in findings if one not in own)
    if not own:
        return "missed", others
    is_named = all("is not the derivative of its function (" not in one.text for one in own)
    return "named" if is_named else "located", others


def main() -> int:
    """Draw, record, audit and count."""
    chosen = options(__doc__, seed=1, count=60, sound=30)
    rng, counts, others = np.random.default_rng(chosen.seed), Counter[str](), 0
    print_head("filter", "fault", "outcome", "what the audit says")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.trace"
        faults = drawn_faults(rng)
        while sum(counts.values()) - counts["no effect"] < chosen.count:
            fault = next(faults)
            if not matters(fault):
                continue
            path.unlink(missing_ok=True)
            FILTERS[fault.filter].record(path, fault.change, int(rng.integers(1000)))
            found = audit(path)
            outcome, beside = judge(fault, found)
            counts[outcome] += 1
            others += beside
            if outcome != "no effect":
                said = [one.text for one in found.findings if one.check == "derivatives"]
                print_row(fault.filter, fault.words, outcome, "; ".join(said)[:200])
        accused = 0
        for seed in range(chosen.sound):
            for filtered in FILTERS.values():
                path.unlink(missing_ok=True)
                filtered.record(path, seed=seed)
                accused += any(one.check == "derivatives" for one in audit(path).findings)
    total = chosen.count
    print()
    print_head("", "count")
    print_row("named", share(counts["named"], total, "named"))
    print_row("located, not named", share(counts["located"], total, "located"))
    print_row("missed", share(counts["missed"], total, "missed"))
    print_row("another slot called faulty beside it", str(others))
    print_row("without effect, not counted", str(counts["no effect"]))
    print_row("sound ones accused", share(accused, chosen.sound * len(FILTERS), "accused"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
