"""Mutants: small changes of the code, each of which the tests nearest to it must reject.

A change is drawn by a hash of where it stands, so that a new line elsewhere does not draw others. A
child process is given the changed function in the old one's place, and runs the tests that pass
through the changed line, the quickest first. What survives is listed; `mutants.toml` has the
reasons of those that are known to change nothing, or to be let live.

    python -m research.mutants [--draw 200] [--seed 0] [--only GROUP]

--only tries what is drawn of one group. The exit code is 1 where too many survive, or one without a
reason.
"""

from __future__ import annotations

import ast
import contextlib
import gc
import hashlib
import json
import os
import resource
import signal
import sys
import tempfile
import time
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any, NamedTuple

from research.script import options

ROOT = Path(__file__).resolve().parents[1]
REASONS = "research/mutants.toml"
EQUIVALENT = "equivalent: "
LEAST_KILLED = 0.95
QUICK = "not slow and not browser and not nightly"
SPARE_S = 60.0
"""Of the processor, which a mutant may take beside ten times what its tests take."""
_MOST_S = 3600
"""By the clock, which ends what waits for ever."""


class Group(NamedTuple):
    """Files that change, and the tests nearest to them."""

    files: tuple[str, ...]
    tests: tuple[str, ...]


GROUPS = {
    "core": Group(
        ("ekf_reference/core/*.py",),
        ("tests/ekf_reference/core",),
    ),
    "graphslam": Group(
        (
            *("graphslam/model_system.py", "graphslam/recorded_system.py"),
            *("graphslam/linear_problem.py", "graphslam/increments.py", "graphslam/marginals.py"),
            *("graphslam/graph_builder.py", "graphslam/elimination.py", "graphslam/optimum.py"),
        ),
        ("tests/graphslam", "tests/comparisons/test_filter_and_smoother.py"),
    ),
    "checks": Group(
        (
            *("comparisons/checks/agreement.py", "comparisons/checks/verdict.py"),
            *("comparisons/checks/algebra.py", "comparisons/checks/model.py"),
            *("comparisons/checks/linearisation.py", "comparisons/checks/explaining.py"),
            *("comparisons/checks/optimum.py", "comparisons/checks/grade.py"),
            *("comparisons/checks/qualifiers.py", "comparisons/checks/external_agreement.py"),
            *("comparisons/checks/association.py", "comparisons/statistics.py"),
            "comparisons/covariances.py",
            "comparisons/checks/consistency/*.py",
        ),
        (
            *("tests/comparisons/test_checks.py", "tests/comparisons/test_causes.py"),
            "tests/comparisons/test_checks_contract.py",
            *("tests/comparisons/test_grades.py", "tests/comparisons/test_qualifiers.py"),
            *("tests/comparisons/test_consistency.py", "tests/comparisons/test_bands.py"),
            *("tests/comparisons/test_consistency_checks.py", "tests/comparisons/test_one_nis.py"),
            *("tests/comparisons/test_conditioning.py", "tests/comparisons/test_positions.py"),
            *("tests/comparisons/test_check_external.py", "tests/comparisons/test_ladder.py"),
            "tests/comparisons/test_association_score.py",
        ),
    ),
    "audit": Group(("comparisons/audit/*.py",), ("tests/comparisons/audit",)),
}


@dataclass(frozen=True)
class Mutant:
    """A change of one place: lines line to last, bytes begin to end, source old to new."""

    file: str
    line: int
    last: int
    begin: int
    end: int
    within: str
    old: str
    new: str
    number: int = 0

    @property
    def key(self) -> str:
        """What it is called, whatever else changes in its file."""
        return f"{self.file} {self.within}: {self.old} -> {self.new} ({self.number})"

    def applied(self, source: bytes) -> bytes:
        """Return the file with the change."""
        return source[: self.begin] + self.new.encode() + source[self.end :]


_COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_REVERSED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE,
}  # fmt: skip
_COMPUTED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
_CALLED = {
    "min": "max", "max": "min", "all": "any", "any": "all", "minimum": "maximum",
    "maximum": "minimum", "sin": "cos", "cos": "sin", "argmax": "argmin", "argmin": "argmax",
    "sum": "max", "mean": "max", "cumsum": "cumprod", "sqrt": "square",
}  # fmt: skip


def changes(node: ast.expr | ast.stmt) -> Iterator[ast.AST | str]:
    """Yield what may stand in a node's place, as a node or as text."""
    match node:
        case ast.Compare(left, [op], right):
            tables = (table for table in (_COMPARED, _REVERSED) if type(op) in table)
            yield from (ast.Compare(left, [table[type(op)]()], right) for table in tables)
        case ast.BinOp(left, op, right) if type(op) in _COMPUTED and not _is_text(left, right):
            yield ast.BinOp(left, _COMPUTED[type(op)](), right)
        case ast.BoolOp(op, values):
            yield ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
        case ast.UnaryOp(op, operand) if not isinstance(op, ast.UAdd):
            yield operand
        case ast.Constant(bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(int(value) | float(value)):
            yield ast.Constant(value + 1 if value else 1)
        case ast.IfExp(test, body, orelse):
            yield ast.IfExp(ast.UnaryOp(ast.Not(), test), body, orelse)
        case ast.Attribute(value, "T"):
            yield value
        case ast.Call():
            yield from _called(node)
        case ast.AugAssign():
            yield "pass"


def _called(node: ast.Call) -> Iterator[ast.AST]:
    match node.func:
        case ast.Name(name) if name in _CALLED:
            yield ast.Call(ast.Name(_CALLED[name]), node.args, node.keywords)
        case ast.Attribute(of, name) if name in _CALLED:
            yield ast.Call(ast.Attribute(of, _CALLED[name]), node.args, node.keywords)


def _is_text(*sides: ast.expr) -> bool:
    return any(
        isinstance(one, ast.JoinedStr | ast.Constant) and isinstance(getattr(one, "value", ""), str)
        for one in sides
    )


def mutants(file: str, source: bytes) -> list[Mutant]:
    """Return all of a file, within functions."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: list[Mutant] = []
    seen: dict[str, int] = defaultdict(int)
    for function, within in _functions(ast.parse(source), ""):
        for node in _places(function):
            last = node.end_lineno or node.lineno
            begin = starts[node.lineno - 1] + node.col_offset
            end = starts[last - 1] + (node.end_col_offset or 0)
            for change in changes(node):
                new = change if isinstance(change, str) else f"({ast.unparse(change)})"
                old = ast.unparse(node)
                one = Mutant(file, node.lineno, last, begin, end, within, old, new)
                found.append(replace(one, number=seen[one.key]))
                seen[one.key] += 1
    return found


_SILENT = (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import, ast.ImportFrom, ast.arguments)
"""Where a change is one of words, or of a type."""


def _functions(node: ast.Module | ast.ClassDef, within: str) -> Iterator[tuple[ast.AST, str]]:
    """Yield functions that stand in no other, with their names."""
    for child in node.body:
        if isinstance(child, ast.ClassDef):
            yield from _functions(child, f"{within}{child.name}.")
        elif isinstance(child, ast.FunctionDef):
            yield child, within + child.name


def _places(node: ast.AST) -> Iterator[ast.expr | ast.stmt]:
    """Yield what may change within a function."""
    for name, parts in ast.iter_fields(node):
        if name in ("decorator_list", "annotation", "returns"):
            continue
        for child in parts if isinstance(parts, list) else [parts]:
            if isinstance(child, ast.AST) and not isinstance(child, _SILENT):
                if isinstance(child, ast.expr | ast.stmt):
                    yield child
                yield from _places(child)


class _Watch:
    """Which lines of some files are passed through."""

    def __init__(self, files: set[str]) -> None:
        self.files, self.now = files, set[tuple[str, int]]()

    def called(self, frame: FrameType, event: str, about: object) -> Any:
        """Follow a call, of a function of these files."""
        if frame.f_code.co_filename not in self.files:
            return None
        return self._passed(frame, event, about)

    def _passed(self, frame: FrameType, event: str, about: object) -> Any:
        self.now.add((frame.f_code.co_filename, frame.f_lineno))
        return self._passed


class _Loop:
    """A plugin of pytest: instead of the tests once, those near to each mutant, in a child each.

    What this process has collected is never run here, so that every child begins afresh.
    """

    def __init__(self, chosen: Sequence[Mutant], kept: Path) -> None:
        self.chosen, self.kept = chosen, kept
        self.killed: dict[str, bool] = {}
        self.why = ""
        self._failed = False

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Note a failure."""
        self._failed |= report.failed

    def pytest_runtestloop(self, session: Any) -> bool:
        """Run them."""
        items = {item.nodeid: item for item in session.items}
        files = {str(ROOT / one.file) for one in self.chosen}
        if _child(lambda: self._watched(items, files)):
            self.why = "the tests fail without a mutant"
            return True
        seconds, lines = json.loads(self.kept.read_text(encoding="utf-8"))
        through: dict[tuple[str, int], list[str]] = defaultdict(list)
        for name, passed in lines.items():
            for file, line in passed:
                through[file, line].append(name)
        for one in self.chosen:
            at = range(one.line, one.last + 1)
            names = {name for line in at for name in through.get((str(ROOT / one.file), line), ())}
            near = sorted(names, key=seconds.__getitem__)
            cpu_s = SPARE_S + 10.0 * sum(seconds[name] for name in near)
            self.killed[one.key] = bool(near) and self._is_killed(one, near, items, cpu_s)
        return True

    def _watched(self, items: Mapping[str, Any], files: set[str]) -> bool:
        """Keep of each test which lines it passes through, and its processor time."""
        seconds, lines = {}, {}
        for name, item in items.items():
            watch, begin = _Watch(files), time.process_time()
            sys.settrace(watch.called)
            self._run(item)
            sys.settrace(None)
            seconds[name], lines[name] = time.process_time() - begin, sorted(watch.now)
        self.kept.write_text(json.dumps([seconds, lines]), encoding="utf-8")
        return self._failed

    def _is_killed(
        self, one: Mutant, near: Sequence[str], items: Mapping[str, Any], cpu_s: float
    ) -> bool:
        def act() -> bool:
            resource.setrlimit(resource.RLIMIT_CPU, (int(cpu_s), int(cpu_s) + 5))
            put_in_place(one)
            for name in near:
                self._run(items[name])
                if self._failed:
                    return True
            return False

        return _child(act) != 0

    def _run(self, item: Any) -> None:
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)


def _child(act: Callable[[], bool]) -> int:
    """Do something in a process of its own, without a word; 0 where it says no."""
    child = os.fork()
    if not child:
        code = 70
        try:
            os.setpgid(0, 0)
            signal.alarm(_MOST_S)
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            code = int(act())
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)  # what it has started
    return status


def put_in_place(one: Mutant) -> None:
    """Give the functions of this process the code that they have with a mutant."""
    path = ROOT / one.file
    source = path.read_bytes()
    was, now = (
        {(c.co_qualname, c.co_firstlineno): c for c in _codes(compile(text, str(path), "exec"))}
        for text in (source, one.applied(source))
    )
    changed = {key: code for key, code in now.items() if key in was and was[key] != code}
    for found in gc.get_objects():
        if isinstance(found, FunctionType) and found.__code__.co_filename == str(path):
            key = found.__code__.co_qualname, found.__code__.co_firstlineno
            if key in changed:
                found.__code__ = changed[key]


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for one in code.co_consts:
        if isinstance(one, CodeType):
            yield from _codes(one)


def drawn(found: Sequence[Mutant], count: int, seed: int) -> list[Mutant]:
    """Return those whose hashes come first."""
    ranked = sorted(found, key=lambda one: hashlib.sha256(f"{seed} {one.key}".encode()).digest())
    return sorted(ranked[:count], key=lambda one: (one.file, one.line, one.begin))


def survivors(group: Group, chosen: Sequence[Mutant]) -> list[Mutant]:
    """Return the mutants that no test near to them rejects."""
    import pytest

    with tempfile.TemporaryDirectory() as place:
        loop = _Loop(chosen, Path(place) / "lines.json")
        words = [*group.tests, "-q", "-s", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", QUICK]
        pytest.main(words, plugins=[loop])
    if loop.why or len(loop.killed) < len({one.key for one in chosen}):
        raise SystemExit(loop.why or "the tests were not collected")
    return [one for one in chosen if not loop.killed[one.key]]


def score(count: int, survived: Sequence[str]) -> tuple[float, int, int]:
    """Return the share that was killed of those that change something, and how many do not.

    And how many survived without a reason. survived: the reason of each survivor, empty where there
    is none; one that changes nothing has a reason that begins with `EQUIVALENT`.
    """
    same = sum(reason.startswith(EQUIVALENT) for reason in survived)
    killed = count - len(survived)
    return killed / max(count - same, 1), same, sum(not reason for reason in survived)


def main() -> int:
    """Draw mutants, run their tests and list what survives; return an exit code."""
    asked = options(__doc__, draw=200, seed=0, only="")
    os.chdir(ROOT)
    known = tomllib.loads((ROOT / REASONS).read_text(encoding="utf-8"))
    reasons = {one["mutant"]: one["reason"] for one in known.get("survivor", [])}
    all_of = {
        name: [
            one
            for pattern in group.files
            for path in sorted(ROOT.glob(pattern))
            for one in mutants(path.relative_to(ROOT).as_posix(), path.read_bytes())
        ]
        for name, group in GROUPS.items()
    }
    chosen = set(drawn([one for found in all_of.values() for one in found], asked.draw, asked.seed))
    left, tried = list[Mutant](), 0
    for name, found in all_of.items():
        mine = [one for one in found if one in chosen]
        if not mine or asked.only not in ("", name):
            continue
        tried += len(mine)
        live = survivors(GROUPS[name], mine)
        print(f"{name}: {len(mine)} drawn of {len(found)}, {len(live)} survive", flush=True)
        for one in live:
            print(f"  line {one.line}, {one.key}: {reasons.get(one.key, '?')}", flush=True)
        left += live
    share, same, unknown = score(tried, [reasons.get(one.key, "") for one in left])
    print(f"{share:.1%} of {tried - same} killed, expected {LEAST_KILLED:.0%}")
    print(f"{same} more change nothing; {unknown} survivors have no reason in {REASONS}")
    return int(share < LEAST_KILLED or unknown > 0)


if __name__ == "__main__":
    sys.exit(main())
