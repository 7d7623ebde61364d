"""Public docstrings: an imperative summary, and Args, Returns and Raises that match the code.

Public is what a user may lean on: every name of `slamcheck.__all__` with the public methods of the
classes among them, and the public functions, classes and methods of the modules in COVERED. A
dataclass of `slamcheck.__all__` describes every field in Attributes. Ruff's rules (D417, preview
DOC) and pydoclint do not know which functions are public, and let a docstring without an Args
section pass; hence this test.
"""

import ast
import importlib
import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from pydantic import BaseModel

import slamcheck
from comparisons.figures import kept_fields, meanings
from tests.test_docs import script

ROOT = Path(__file__).resolve().parents[1]
COVERED = (
    "ekf_reference.core",
    "ekf_reference.models",
    "ekf_reference.filters",
    "ekf_reference.association",
    "ekf_reference.features",
    "ekf_reference.fastslam",
    "graphslam.problem",
    "graphslam.increments",
    "graphslam.smoother",
    "graphslam.optimum",
    "graphslam.marginals",
    "graphslam.graph_builder",
    "graphslam.g2o",
    "graphslam.sampling",
    "graphslam.chain_diagnostics",
)
"""Packages and modules of the estimators whose public docstrings are complete."""
SECTIONS = ("Args", "Attributes", "Returns", "Yields", "Raises", "Source")
_HEAD = re.compile(rf"^({'|'.join(SECTIONS)}): *(.*)$")
_IMPERATIVE = re.compile(
    r"(?!(This|The|A|An|It|Its|Whether|All|As|One|What|How|By)\b)[A-Z]\w*[^s\W]\b|[A-Z]\w*(ss|us)\b"
)
"""Verbs in the third person end in s; what is no verb mostly starts with an article or pronoun."""


def members(name: str, kind: Any) -> Iterator[tuple[str, Callable[..., Any] | property]]:
    """A function, or the public methods that a class defines itself."""
    if not inspect.isclass(kind):
        yield name, kind
        return
    for key, value in vars(kind).items():
        if isinstance(value, staticmethod | classmethod):
            value = value.__func__
        if (inspect.isfunction(value) or isinstance(value, property)) and (
            not key.startswith("_") or (key == "__init__" and written(value, kind))
        ):
            yield f"{name}.{key}", value


def written(value: Any, kind: Any) -> bool:
    """An __init__ that stands in the source, not one that a dataclass or pydantic makes."""
    return "__dataclass_fields__" not in vars(kind) and value.__module__ == kind.__module__


def of_modules() -> Iterator[tuple[str, Any]]:
    """Every public function and class that a covered module defines."""
    for module in modules():
        for name, value in vars(module).items():
            own = getattr(value, "__module__", "") == module.__name__
            if own and name[0] != "_" and (inspect.isclass(value) or inspect.isfunction(value)):
                yield f"{module.__name__}.{name}", value


def modules() -> Iterator[ModuleType]:
    """What COVERED names, packages with all modules that lie directly in them."""
    for name in COVERED:
        path = ROOT / name.replace(".", "/")
        names = (
            [name]
            if not path.is_dir()
            else [
                f"{name}.{one.stem}" for one in sorted(path.glob("*.py")) if one.stem != "__init__"
            ]
        )
        yield from map(importlib.import_module, names)


def public() -> dict[str, Any]:
    """Every public function and method by name, each once, those of contracts that others keep."""
    found: dict[int, tuple[str, Any]] = {}
    own = [(name, getattr(slamcheck, name)) for name in slamcheck.__all__]
    for name, kind in [*own, *of_modules()]:
        for key, value in members(name, kind):
            if not (inspect.isclass(kind) and of_contract(key.rpartition(".")[2], value, kind)):
                found.setdefault(id(value), (key, value))
    return dict(found.values())


def of_contract(key: str, value: Any, kind: type) -> bool:
    """Whether a base class or a Protocol describes a method, which then says only what it adds."""
    if key == "__init__" or isinstance(value, property):
        return False
    if any(key in vars(base) for base in kind.__mro__[1:]):
        return True
    return any(
        key in vars(one) and len(names_of(getattr(one, key))) == len(names_of(value))
        for one in CONTRACTS
        if one is not kind
    )


def faults(value: Callable[..., Any] | property) -> list[str]:
    """What is wrong with one docstring."""
    text = inspect.getdoc(value) or ""
    summary = text.splitlines()[0] if text else ""
    found = [] if summary else ["no summary"]
    if isinstance(value, property):
        return found  # a noun, as of a field
    if summary and getattr(value, "__name__", "") != "__init__" and not _IMPERATIVE.match(summary):
        found.append(f"summary is not in the imperative: {summary!r}")
    parts, source = sections(text), parsed(value)
    arguments = names_of(value)
    described = entries(parts.get("Args", ()))
    found += [f"{one} is not described" for one in arguments if one not in described]
    found += [
        f"{one} is described, and is no parameter" for one in described if one not in arguments
    ]
    found += [f"{k} says nothing" for k, words in described.items() if len(words) < 2]
    gives = returns(source)
    if gives != bool({"Returns", "Yields"} & parts.keys()) and not (
        summary.startswith("Return ") and gives and not arguments
    ):
        found.append("Returns is missing" if gives else "Returns, but nothing is returned")
    raised = {one for one in raises(source) if one not in ("NotImplementedError", "AssertionError")}
    reported = {one.rpartition(".")[2] for one in entries(parts.get("Raises", ()))}
    return found + [f"{one} is raised, and not in Raises" for one in sorted(raised - reported)]


def sections(text: str) -> dict[str, list[str]]:
    """The lines of each section of a Google docstring, without their indent."""
    found: dict[str, list[str]] = {}
    current: list[str] | None = None
    for line in text.splitlines():
        if head := _HEAD.match(line):
            current = found.setdefault(head[1], [])
        elif line and not line.startswith(" "):
            current = None
        elif current is not None:
            current.append(line[4:])
    return found


def entries(lines: list[str] | tuple[()]) -> dict[str, list[str]]:
    """What each entry of a section says, as words."""
    found: dict[str, list[str]] = {}
    for line in lines:
        if entry := re.match(r"([\w.*, ]+): *(.*)$", line):
            words = entry[2].split()
            found |= {name.strip(" *"): words for name in entry[1].split(",")}
            last = entry[1]
        elif line.startswith(" ") and found:
            for name in last.split(","):
                found[name.strip(" *")] += line.split()
    return found


def names_of(value: Callable[..., Any]) -> list[str]:
    return [one for one in inspect.signature(value).parameters if one not in ("self", "cls")]


def parsed(value: Callable[..., Any]) -> ast.FunctionDef:
    source = inspect.getsource(inspect.unwrap(value))
    indent = len(source) - len(source.lstrip())
    node = ast.parse("\n".join(line[indent:] for line in source.splitlines())).body[0]
    assert isinstance(node, ast.FunctionDef)
    return node


def own_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """A function's nodes without those of functions within it."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.Lambda | ast.ClassDef):
            yield child
            yield from own_nodes(child)


def returns(node: ast.FunctionDef) -> bool:
    """Whether it returns something, by its annotation where it has no body to speak of."""
    if node.returns is not None:
        return ast.unparse(node.returns) not in ("None", "NoReturn")
    return any(isinstance(one, ast.Return) and one.value is not None for one in own_nodes(node))


def raises(node: ast.FunctionDef) -> set[str]:
    """Names of the exceptions that its own body raises."""
    found = [one.exc for one in own_nodes(node) if isinstance(one, ast.Raise) and one.exc]
    calls = [one.func if isinstance(one, ast.Call) else one for one in found]
    return {ast.unparse(one).rpartition(".")[2] for one in calls if ast.unparse(one)[0].isupper()}


CONTRACTS = [kind for _, kind in of_modules() if getattr(kind, "_is_protocol", False)]
PUBLIC = public()


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_a_public_docstring_is_complete(name: str) -> None:
    assert faults(PUBLIC[name]) == []


CLASSES = [
    kind
    for name in slamcheck.__all__
    if inspect.isclass(kind := getattr(slamcheck, name)) and is_dataclass(kind)
]


@pytest.mark.parametrize("kind", CLASSES, ids=lambda kind: kind.__name__)
def test_every_field_of_a_public_dataclass_is_described(kind: type) -> None:
    assert undescribed_fields(kind) == set()


def undescribed_fields(kind: type) -> set[str]:
    """Fields that Attributes lacks, and entries of it that are no fields."""
    reported = entries(sections(inspect.getdoc(kind) or "").get("Attributes", ()))
    return {one.name for one in fields(kind)} ^ {name for name, words in reported.items() if words}


def test_a_field_without_a_word_is_found() -> None:
    @dataclass
    class Small:
        """Hold two numbers.

        Attributes:
            first: A number.
        """

        first: int
        second: int

    assert undescribed_fields(Small) == {"second"}
    assert len(CLASSES) == 11


def test_the_list_of_what_is_public_is_whole() -> None:
    for name in ("Ekf.predict", "compare", "Log.from_arrays", "Comparison.to_pandas"):
        assert name in PUBLIC
    assert "ekf_reference.core.state.KalmanState.update" in PUBLIC
    assert "ekf_reference.core.landmark_types.MeasurementModel.predict" in PUBLIC
    assert len(PUBLIC) > 200


def undescribed(first: int, second: int) -> int:
    """Return the sum.

    Args:
        first: One addend.

    Returns:
        Their sum.
    """
    return first + second


def unraised(value: float) -> float:
    """Return the root of a number.

    Args:
        value: Any number [m^2].

    Returns:
        Its root [m].
    """
    if value < 0.0:
        raise ValueError("negative")
    return float(value**0.5)


def unreturned(value: float) -> float:
    """Double a number.

    Args:
        value: Any number.
    """
    return 2.0 * value


def filler(value: float) -> None:
    """Take a number.

    Args:
        value: Value.
        other: Which there is none of.
    """


def not_imperative(value: float) -> None:
    """The number that is taken.

    Args:
        value: Any number.
    """


@pytest.mark.parametrize(
    ("broken", "reported"),
    [
        (undescribed, ["second is not described"]),
        (unraised, ["ValueError is raised, and not in Raises"]),
        (unreturned, ["Returns is missing"]),
        (filler, ["other is described, and is no parameter", "value says nothing"]),
        (not_imperative, ["summary is not in the imperative: 'The number that is taken.'"]),
    ],
)
def test_a_broken_docstring_is_found(broken: Callable[..., Any], reported: list[str]) -> None:
    assert faults(broken) == reported


def unexplained(site: ModuleType, *kinds: type) -> list[str]:
    """Fields of result models, and of those in them, without a meaning for the result schema."""
    return [
        f"{kind.__name__}.{name}"
        for kind in site._nested(*kinds)
        for name in kept_fields(kind)
        if name not in meanings(kind)
    ]


def test_every_field_of_a_result_has_a_meaning() -> None:
    """Otherwise the site does not build."""
    pytest.importorskip("mkdocs")
    site = script("site")
    assert [one for kinds in site.RESULTS.values() for one in unexplained(site, *kinds)] == []


def test_a_field_without_a_meaning_is_found() -> None:
    pytest.importorskip("mkdocs")

    class Renamed(BaseModel):
        """Attributes:
        wrong source: a name that lost its underscore.
        """

        wrong_source: str

    assert unexplained(script("site"), Renamed) == ["Renamed.wrong_source"]
