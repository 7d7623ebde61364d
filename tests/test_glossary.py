"""The terms of rows and of the help stand in docs/glossary.md."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from comparisons.cli.app import COMMANDS, build

ROOT = Path(__file__).resolve().parents[1]
GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
PLAIN = """
alike area attributes beyond certain checked claimed closed common computed condition corners
duplicates duration ever failed fastest five found gain gained guess half jointly judgement kind
labelled last leaves left match matched median merged merges middle moves name nobody occupied
reached rejects restarts rule searches second shift smallest splits stamps steps these trial tried
turn unchanged under wheels
"""
"""Words of rows that mean what they mean elsewhere."""
TEXTS = {"Row": 2, "Named": 1, "rows_of": 1}
"""Calls whose first arguments are texts of rows, and how many are."""
NAMES = "CLAM CSV JSON KITTI MR ROS SI TOML TUM"
"""Upper case of the help that is no term: formats, data sets, units, figures of a document."""


def first_texts(tree: ast.AST) -> Iterator[str]:
    """Yield texts of groups and quantities.

    They are the first two arguments of `Row`, the first of `Named` and `rows_of`, and the first
    entry of each tuple within a function that returns rows.
    """
    for node in ast.walk(tree):
        found: list[ast.expr] = []
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            found = node.args[: TEXTS.get(node.func.id, 0)]
        elif (
            isinstance(node, ast.FunctionDef)
            and node.returns
            and "Row]" in ast.unparse(node.returns)
        ):
            tuples = (one for one in ast.walk(node) if isinstance(one, ast.Tuple))
            found = [one.elts[0] for one in tuples if one.elts]
        for part in (inner for one in found for inner in ast.walk(one)):
            if isinstance(part, ast.Constant) and isinstance(part.value, str):
                yield part.value


@cache
def words_of_rows() -> frozenset[str]:
    """Return all words of groups and quantities, in lower case."""
    texts = (path.read_text(encoding="utf-8") for path in (ROOT / "comparisons").rglob("*.py"))
    named = (source for source in texts if re.search("Row|Named", source))
    shown = (text for source in named for text in first_texts(ast.parse(source)))
    return frozenset(word.lower() for text in shown for word in re.findall(r"[A-Za-z]{2,}", text))


def help_texts(command: Any) -> Iterator[str]:
    """Yield what a command's help says, but the names of values."""
    values = " ".join(param.metavar or param.name.upper() for param in command.params)
    names = set(re.findall(r"\w+", values))
    for text in (command.help, *(getattr(param, "help", "") for param in command.params)):
        plain = re.sub(r"slamcheck-[A-Z-]+|[\w./-]*_[\w.-]*", "", text or "")
        yield " ".join(word for word in re.findall(r"\w+", plain) if word not in names)
    for part in getattr(command, "commands", {}).values():
        yield from help_texts(part)


@cache
def abbreviations_of_help() -> frozenset[str]:
    """Return the words in upper case of all commands' help."""
    whole = build(whole=True)
    texts = (text for name in COMMANDS for text in help_texts(whole.commands[name]))
    return frozenset(word for text in texts for word in re.findall(r"\b[A-Z][A-Z0-9]+\b", text))


def lacking(glossary: str) -> set[str]:
    """Return the terms of rows and help that a glossary lacks; a plural may stand for it."""
    terms = "\n".join(re.findall(r"^\| (.*?) \|", glossary, re.MULTILINE))
    said = set(re.findall(r"[a-z]+", glossary.lower()))
    words = {w for w in words_of_rows() - set(PLAIN.split()) if not {w, w.removesuffix("s")} & said}
    return words | {
        w for w in abbreviations_of_help() - set(NAMES.split()) if not re.search(rf"\b{w}\b", terms)
    }


def test_every_term_of_rows_and_help_is_in_the_glossary() -> None:
    assert lacking(GLOSSARY) == set()
    assert set(PLAIN.split()) - words_of_rows() == set()
    assert set(NAMES.split()) - abbreviations_of_help() == set()


def test_a_term_that_is_not_explained_is_seen() -> None:
    """The broken variants: a glossary without the line of a term of rows, and of one of help."""
    for word, term in (("skewness", "skewness"), ("GPS", "GPS"), ("whiteness", "whiteness, lag-1")):
        line = next(line for line in GLOSSARY.splitlines() if line.startswith(f"| {term}"))
        without = re.sub(rf"\b{word}\b", "", GLOSSARY.replace(line, ""))
        assert word in lacking(without)
