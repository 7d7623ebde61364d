"""What a user reads: every kind of cause is explained, and no text has a word of the old idiom."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from comparisons.checks.causes import EXPLANATIONS

ROOT = Path(__file__).resolve().parents[2]
VERDICTS = (ROOT / "docs" / "verdicts.md").read_text(encoding="utf-8")
USER_FACING = ("comparisons", "graphslam", "slamcheck")
BANNED = re.compile(
    r"\b(sightings?|told|begun|wild|(un)?proven|culprits?|hangs? on|held against|worth|handed in"
    r"|hand in|look at|surer|as meant|as if|judged by|beginnings?)\b",
    re.IGNORECASE,
)
NAMES = re.compile(r"sightings\.csv")
"""What version 0.1 called a file, which is still read."""


def literals(source: str) -> Iterator[str]:
    """Yield texts of several words that are not docstrings, f-strings without their values."""
    tree = ast.parse(source)
    skipped: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped.add(id(node.value))
        if isinstance(node, ast.FormattedValue):
            skipped |= {id(inner) for inner in ast.walk(node.value)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Constant) or id(node) in skipped:
            continue
        if isinstance(node.value, str) and " " in node.value.strip():
            yield node.value


def old_words(source: str) -> list[str]:
    return [text for text in literals(source) if BANNED.search(NAMES.sub("", text))]


def kinds_in(source: str) -> set[str]:
    """Return the kinds that calls of Cause or motion name, where they name one by a literal."""
    return {
        str(call.args[0].value)
        for call in ast.walk(ast.parse(source))
        if isinstance(call, ast.Call)
        and isinstance(call.func, ast.Name)
        and call.func.id in ("Cause", "motion")
        and call.args
        and isinstance(call.args[0], ast.Constant)
        and call.args[0].value
    }


def sources() -> Iterator[Path]:
    for name in USER_FACING:
        path = ROOT / name
        assert path.exists(), name
        yield from sorted(path.rglob("*.py")) if path.is_dir() else [path]


@pytest.mark.slow
def test_every_kind_of_cause_is_explained() -> None:
    used: set[str] = set()
    for path in (ROOT / "comparisons").rglob("*.py"):
        used |= kinds_in(path.read_text(encoding="utf-8"))
    used |= {"frame", "scale"}  # a variable's values in checks.diagnosis.diagnosis
    assert used == set(EXPLANATIONS)


@pytest.mark.parametrize("kind", EXPLANATIONS)
def test_the_page_of_verdicts_has_a_section_for_each_kind(kind: str) -> None:
    sections = re.split(r"^## ", VERDICTS, flags=re.MULTILINE)
    (section,) = (one for one in sections if one.startswith(f"Cause: {kind}\n"))
    words, one = " ".join(section.split()), EXPLANATIONS[kind]
    assert f"**{one.title}.** {one.meaning}" in words
    assert f"What to check: {one.check}" in words


@pytest.mark.parametrize("kind", EXPLANATIONS)
def test_an_explanation_is_of_whole_sentences(kind: str) -> None:
    one = EXPLANATIONS[kind]
    for text in (one.meaning, one.check):
        assert text.endswith(".")
        assert 1 <= len(re.findall(r"\.(?: |$)", text)) <= 4
    assert not BANNED.search(f"{one.title} {one.meaning} {one.check}")


@pytest.mark.slow
def test_no_text_has_a_word_of_the_old_idiom() -> None:
    found = {
        str(path.relative_to(ROOT)): words
        for path in sources()
        if (words := old_words(path.read_text(encoding="utf-8")))
    }
    assert found == {}


def test_a_text_with_an_old_word_is_found() -> None:
    assert old_words('raise InputError(f"{path}: {count} sightings were begun twice")') == [
        " sightings were begun twice"
    ]
    assert old_words('"""Sightings are told."""') == []
    assert old_words('text = "no such file as sightings.csv"') == []
    assert old_words('text = f"the {told} of {sighting}"') == []
