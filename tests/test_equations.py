"""docs/equations.md points to functions and tests that exist, and covers what it says it does."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def rows() -> list[list[str]]:
    lines = (ROOT / "docs" / "equations.md").read_text().splitlines()
    table = [line for line in lines if line.startswith("|")][2:]
    return [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in table]


def defined(path: Path) -> set[str]:
    """Names of functions, classes and methods of a module."""
    names: set[str] = set()

    def visit(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                names.add(prefix + child.name)
                visit(child, f"{prefix}{child.name}.")

    visit(ast.parse(path.read_text()), "")
    return names


def test_every_row_points_to_something() -> None:
    assert len(rows()) > 25
    for equation, _, function, test, _ in rows():
        for place, mark in ((function, ":"), (test, "::")):
            path, _, name = place.partition(mark)
            assert (ROOT / path).is_file(), f"{equation}: {path}"
            assert name in defined(ROOT / path), f"{equation}: {place}"


def test_all_equations_in_scope_are_listed() -> None:
    """G 1 to 23; M 1 to 17; the filter's part of N 2 (2.32 to 2.60, 2.62); N 4; N A.1 to A.20."""
    cells = [row[0] for row in rows()]
    for stem, wanted in (
        ("G ", [*range(1, 24)]),
        ("M ", [*range(1, 18)]),
        ("2.", [*range(32, 61), 62]),
        ("N 4.", [*range(1, 21)]),
        ("A.", [*range(1, 12), *range(13, 21)]),
    ):
        listed: set[int] = set()
        for cell in cells:
            for a, b in re.findall(
                rf"{re.escape(stem)}(\d+)(?: to (?:{re.escape(stem)})?(\d+))?", cell
            ):
                listed |= set(range(int(a), int(b or a) + 1))
        missing = sorted(set(wanted) - listed)
        assert not missing, f"{stem}{missing}"
