"""A filter whose own lines are changed at random, and what the audit names of its trace.

    python -m research.trust.mutated_filters [--faults 400] [--seed 0] [--every 1] [--list]

The filter is a dozen lines of plain algebra that share nothing with the audit. One expression of
them is changed as a slip of a hand would: a factor or a term is left out, a transpose or an inverse
lost, @ written as *, a sign turned, another matrix put in, or the result spoilt; in one event or
from one on. A fault counts where the covariance after it is off by a tenth of a variance and more.
It is named if the audit finds, at that event, a change that gives the covariance to rounding.
"""

from __future__ import annotations

import ast
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.audit import audit
from comparisons.trace.recorder import Recorder
from research.script import options, print_head, print_row

LINES = {
    "predict": {"P": "F @ P @ F.T + Q"},
    "update": {"S": "H @ P @ H.T + R", "K": "P @ H.T @ inv(S)", "P": "P - K @ H @ P"},
    "update by S": {"S": "H @ P @ H.T + R", "K": "P @ H.T @ inv(S)", "P": "P - K @ S @ K.T"},
    "update by Joseph's form": {
        "S": "H @ P @ H.T + R", "K": "P @ H.T @ inv(S)", "A": "I - K @ H",
        "P": "A @ P @ A.T + K @ R @ K.T",
    },
    "augment": {"C": "G @ P", "N": "G @ P @ G.T + M @ R @ M.T"},
}  # fmt: skip
"""Of each event what it computes, in order."""
BLOCKS = {"place": 2, "speed": 2, "bias": 1}
STEPS, LEAST, SECOND = 24, 0.1, 0.5
FACTORS = (-1.0, 0.5, 2.0, 0.1, 10.0, 1.3, SECOND, float(np.degrees(1.0)))


class Slip(NamedTuple):
    """A change of a filter's lines.

    Attributes:
        event: Of LINES.
        result: Whose line it is in.
        operand: What is changed in it.
        change: How, in one word.
        line: The line with it.
        nth: The event of its kind that it is in.
        lasting: It is in all later ones, too.
    """

    event: str
    result: str
    operand: str
    change: str
    line: str
    nth: int
    lasting: bool

    @property
    def words(self) -> str:
        """What the filter does."""
        return f"{self.event}: {self.result} = {self.line}"


def slip(rng: np.random.Generator) -> Slip:
    """Draw a change: event, line, and place in it are as likely as any other."""
    event = str(rng.choice(list(LINES)))
    result = str(rng.choice(list(LINES[event])))
    tree = ast.parse(LINES[event][result], mode="eval")
    every = [(tree, "body"), *_places(tree.body)]
    holder, field = every[rng.integers(len(every))]
    node = getattr(holder, field)
    changes = _changes(node, rng, whole=node is tree.body)
    change, other = changes[rng.integers(len(changes))]
    setattr(holder, field, other)
    operand = node.id if isinstance(node, ast.Name) else ast.unparse(node)
    line = ast.unparse(ast.fix_missing_locations(tree))
    nth = int(rng.integers(3, 5)) if event == "augment" else int(rng.integers(6, 18))
    return Slip(event, result, operand, change, line, nth, bool(rng.integers(2)))


def _places(node: ast.AST) -> list[tuple[ast.AST, str]]:
    """Expressions below a node, each by what holds it; names of functions are none."""
    places: list[tuple[ast.AST, str]] = []
    for field, child in ast.iter_fields(node):
        if isinstance(child, ast.expr) and not (isinstance(node, ast.Call) and field == "func"):
            places += [(node, field), *_places(child)]
    return places


def _changes(
    node: ast.expr, rng: np.random.Generator, *, whole: bool
) -> list[tuple[str, ast.expr]]:
    """What may stand in a node's place."""
    changes: list[tuple[str, ast.expr]] = []
    match node:
        case ast.BinOp(left, ast.MatMult(), right):
            changes += [("factor left out", left), ("factor left out", right)]
            changes.append(("by entries", ast.BinOp(left, ast.Mult(), right)))
        case ast.BinOp(left, ast.Add() | ast.Sub(), right):
            other = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()
            changes += [("term left out", left), ("term left out", right)]
            changes.append(("sign", ast.BinOp(left, other, right)))
        case ast.Call(_, [inner]):
            changes.append(("inverse lost", inner))
        case ast.Attribute(value, "T"):
            changes.append(("transpose lost", value))
        case ast.Name(name):
            changes += [(change, _parsed(text.format(name))) for change, text in _of_name(rng)]
    if whole:
        text = ast.unparse(node)
        changes += [(change, _parsed(line.format(text))) for change, line in _of_result(rng)]
    return deepcopy(changes)


def _parsed(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


def _of_name(rng: np.random.Generator) -> list[tuple[str, str]]:
    i, j = rng.integers(0, 5, 2).tolist()
    return [
        ("transposed", "{0}.T"),
        ("inverted", "inv({0})"),
        ("root", "root({0})"),
        ("squared", "{0} @ {0}"),
        ("diagonal", "diag({0})"),
        ("zero", "0 * {0}"),
        ("factor", f"{rng.choice(FACTORS):g} * {{0}}"),
        ("of the event before", "before['{0}']"),
        ("of the first event", "first['{0}']"),
        ("term's sign", f"term({{0}}, {i}, {j}, -1)"),
        ("term zero", f"term({{0}}, {i}, {j}, 0)"),
        ("rows exchanged", f"exchanged({{0}}, {i}, {j})"),
        ("columns exchanged", f"exchanged({{0}}.T, {i}, {j}).T"),
        ("block zero", f"block({{0}}, {i % 3}, {j % 3}, 0)"),
        ("block's sign", f"block({{0}}, {i % 3}, {j % 3}, -1)"),
    ]


def _of_result(rng: np.random.Generator) -> list[tuple[str, str]]:
    i, j = rng.integers(0, 3, 2).tolist()
    return [
        ("factor of the result", f"{rng.choice(FACTORS):g} * ({{0}})"),
        ("added to the result", f"({{0}}) + {rng.choice((0.01, 0.1)):g} * one({{0}})"),
        ("diagonal of the result", "diag({0})"),
        ("block of the result zero", f"both(0 * ({{0}}), {{0}}, {i}, {j})"),
        ("block of the result stale", f"both(P, {{0}}, {i}, {j})"),
    ]


def _block(k: int) -> slice:
    ends = np.cumsum([0, *BLOCKS.values()])
    return slice(int(ends[k]), int(ends[k + 1]))


def _term(matrix: Array, i: int, j: int, factor: float) -> Array:
    changed = matrix.copy()
    changed[i % len(matrix), j % matrix.shape[1]] *= factor
    return changed


def _exchanged(matrix: Array, i: int, j: int) -> Array:
    order = np.arange(len(matrix))
    order[[i % len(matrix), j % len(matrix)]] = j % len(matrix), i % len(matrix)
    return matrix[order]


def _of_block(matrix: Array, a: int, b: int, factor: float) -> Array:
    changed = matrix.copy()
    rows = _block(a) if len(matrix) >= 5 else slice(None)
    changed[rows, _block(b) if matrix.shape[1] >= 5 else slice(None)] *= factor
    return changed


def _both(source: Array, matrix: Array, a: int, b: int) -> Array:
    """The covariance of two blocks from elsewhere."""
    if matrix.shape[0] < 5 or matrix.shape != source.shape:
        raise ValueError("no covariance of the state")
    changed = matrix.copy()
    for rows, columns in ((_block(a), _block(b)), (_block(b), _block(a))):
        changed[rows, columns] = source[rows, columns]
    return changed


TOOLS: Mapping[str, Callable[..., Array]] = {
    "inv": lambda m: np.linalg.inv(m), "root": lambda m: np.sqrt(np.diag(np.abs(np.diag(m)))),
    "diag": lambda m: np.diag(np.diag(m)), "one": lambda m: np.eye(len(m)), "term": _term,
    "exchanged": _exchanged, "block": _of_block, "both": _both,
}  # fmt: skip


class SlipFilter:
    """A filter of place, speed and bias, to which new places are added."""

    def __init__(self, seed: int, form: str, planted: Slip | None) -> None:
        """form: of the update, of LINES."""
        self.rng, self.form, self.planted = np.random.default_rng(seed), form, planted
        root = 0.4 * self.rng.standard_normal((5, 5)) + np.eye(5)
        self.covariance: Array = root @ root.T
        self.before: dict[str, dict[str, Array]] = {}
        self.first: dict[str, dict[str, Array]] = {}
        self.stale = self.covariance
        self.counts: Counter[str] = Counter()
        self.planted_event, self.effect = -1, 0.0

    def compute(self, event: str, number: int, **matrices: Array) -> dict[str, Array]:
        """Compute an event's lines, with the slip where it is due."""
        nth, planted = self.counts[event], self.planted
        self.counts[event] += 1
        matrices["P"], matrices["I"] = self.covariance, np.eye(len(self.covariance))
        lines = LINES[event]
        sound = self._run(event, lines, matrices)
        due = planted is not None and event == planted.event and nth >= planted.nth
        if planted is not None and due and (planted.lasting or nth == planted.nth):
            made = self._run(event, {**lines, planted.result: planted.line}, matrices)
            if self.planted_event < 0:
                self.planted_event, self.effect = number, _effect(sound, made)
        else:
            made = sound
        known = {**made, **matrices}
        self.first.setdefault(event, known)
        self.before[event] = known
        self.stale = self.covariance
        return made

    def _run(
        self, event: str, lines: Mapping[str, str], matrices: Mapping[str, Array]
    ) -> dict[str, Array]:
        known: dict[str, Any] = {**TOOLS, **matrices}
        known |= {"before": {**self.before.get(event, matrices), "P": self.stale}}
        known |= {"first": self.first.get(event, matrices)}
        made: dict[str, Array] = {}
        for name, line in lines.items():
            value = np.asarray(eval(line, {"__builtins__": {}}, {**known, **made}))  # noqa: S307
            made[name] = value
            known[name] = value if name != "P" else known["P"]
        return made

    def record(self, path: Path, every: int) -> None:
        """Drive and record, with a snapshot after so many events."""
        blocks, number, since = dict(BLOCKS), 2, 0
        with Recorder(path) as record:
            record.prior(blocks, self.covariance)
            record.snapshot(self.covariance)
            for step in range(STEPS):
                record.at(SECOND * step)
                for event in ("predict", self.form, *(("augment",) if step % 5 == 4 else ())):
                    self._do(record, event, number, blocks)
                    number, since = number + 1, since + 1
                    if since == every:
                        record.snapshot(self.covariance)
                        number, since = number + 1, 0

    def _do(self, record: Recorder, event: str, number: int, blocks: dict[str, int]) -> None:
        rng, size = self.rng, len(self.covariance)
        if event == "predict":
            f, q = np.eye(5) + 0.3 * rng.standard_normal((5, 5)), _covariance(rng, 5, 0.05)
            whole, noise = np.eye(size), np.zeros((size, size))
            whole[:5, :5], noise[:5, :5] = f, q
            self.covariance = self.compute(event, number, F=whole, Q=noise)["P"]
            record.predict(f, q, list(BLOCKS))
        elif event == "augment":
            g = np.zeros((2, size))
            g[:, :5], m = rng.standard_normal((2, 5)), rng.standard_normal((2, 2))
            r = _covariance(rng, 2, 0.1)
            made = self.compute(event, number, G=g, M=m, R=r)
            name = f"landmark {len(blocks)}"
            record.augment(name, g[:, :5], m, r, list(BLOCKS))
            blocks[name] = 2
            corner = made["C"]
            self.covariance = np.block([[self.covariance, corner.T], [corner, made["N"]]])
        else:
            h = np.zeros((2, size))
            h[:, :5] = rng.standard_normal((2, 5))
            r = _covariance(rng, 2, 0.3)
            self.covariance = self.compute(event, number, H=h, R=r)["P"]
            record.update("range", rng.standard_normal(2), h[:, :5], r, list(BLOCKS))


def _covariance(rng: np.random.Generator, size: int, scale: float) -> Array:
    root = rng.standard_normal((size, size))
    return np.asarray(scale * (0.3 * root @ root.T + np.eye(size)))


def _effect(sound: Mapping[str, Array], made: Mapping[str, Array]) -> float:
    """The largest difference of a covariance, in products of sigmas."""
    worst = 0.0
    for name in ("P", "N", "C"):
        if name in sound:
            if made[name].shape != sound[name].shape:
                raise ValueError("another shape")
            apart = np.abs(made[name] - sound[name])
            sigma = np.sqrt(np.abs(np.diag(sound[name] if name == "P" else sound["N"])))
            unit = np.outer(sigma, sigma if name != "C" else np.full(apart.shape[1], sigma.max()))
            worst = max(worst, float((apart / unit).max()))
    return worst


class SlipOutcome(NamedTuple):
    """Whether the first fault is at the event, and named; what is said."""

    event: bool
    named: bool
    said: str


def tried(planted: Slip, seed: int, every: int, path: Path) -> SlipOutcome | None:
    """Record a filter with a slip and audit it; None where it has no effect, or breaks down."""
    form = planted.event if planted.event.startswith("update") else "update"
    subject = SlipFilter(seed, form, planted)
    try:
        with np.errstate(all="ignore"):
            subject.record(path, every)
    except (ValueError, np.linalg.LinAlgError, IndexError):
        return None
    if not subject.effect > LEAST or not np.isfinite(subject.covariance).all():
        return None
    faults = [one for one in audit(path).findings if one.fault]
    if not faults:
        return SlipOutcome(False, False, "sound")
    first = faults[0]
    at = first.event is not None and abs(first.event - subject.planted_event) <= every
    named = at and first.check == "algebra" and " is off by " not in first.text
    return SlipOutcome(at, named, first.text)


def main() -> None:
    """Print a table by what is changed, and each that is not named."""
    given = options(__doc__, faults=400, seed=0, every=1, list=False)
    rng, rows = np.random.default_rng(given.seed), list[tuple[Slip, SlipOutcome]]()
    with tempfile.TemporaryDirectory() as folder:
        while len(rows) < given.faults:
            one = slip(rng)
            outcome = tried(one, len(rows), given.every, Path(folder) / "trace")
            (Path(folder) / "trace").unlink(missing_ok=True)
            if outcome is not None:
                rows.append((one, outcome))
                if given.list and not outcome.named:
                    print(f"{one.words} ({one.change}): {outcome.said}", flush=True)
    print_head("change", "faults", "named", "right event")
    for change in sorted({one.change for one, _ in rows}):
        some = [outcome for one, outcome in rows if one.change == change]
        print_row(change, len(some), sum(o.named for o in some), sum(o.event for o in some))
    every = [outcome for _, outcome in rows]
    named, at = sum(o.named for o in every), sum(o.event for o in every)
    print(f"\n{named} of {len(every)} named, {at} at the right event")


if __name__ == "__main__":
    main()
