"""`docs/settings.md`, generated: `python -m tools.settings_page > docs/settings.md`."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import math
import pkgutil
import sys
from collections.abc import Iterator
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

import ekf_reference
from comparisons.config import setting_default
from comparisons.documented.row import AnyBut, Documented, Value, same, shown
from research.documents.constants import GROUPS, ROWS

_HEAD = """\
# Settings

Generated from the code by `make settings`; `tests/comparisons/test_documented.py` fails when this
page is old, when a run's value differs from the document's without a reason, or when a reason
stands where nothing differs.

- **document**: the value that G (Guivant 2002), M (Misono 2007) or N (Nieto 2005) states.
- **runs use**: the value under `--preset recommended`, the default.
- **where**: a setting of a run (`--set NAME=VALUE`), or the code that has the constant. `--preset
  guivant-2002`, `misono-2007` or `nieto-2005` gives every setting that the document states its
  value, and no other; constants in code have no switch, so those below that differ differ under
  this preset, too.

"""
_SPLIT = """
## What differs

"""
_OURS = """
## Constants that no document states

All other numbers of `ekf_reference`: constants of modules, and defaults of fields and of arguments,
which runs may replace by settings. Of a constant set of options only what differs from the defaults
is listed. They are ours.

| where | value |
|---|---|
"""


def markdown() -> str:
    """Return the page."""
    different = [row for row in ROWS if differs(row)]
    lines = [_HEAD]
    lines.append(
        f"{len(ROWS)} constants; runs use another value than the document's for {len(different)}."
    )
    lines += [_SPLIT, *_table(different, why=True)]
    for title, rows in GROUPS.items():
        lines += [f"\n## {title}\n", *_table([row for row in rows if not differs(row)], why=False)]
    lines += [_OURS.rstrip("\n")]
    lines += [f"| `{at}` | {_by_name(at, value)} |" for at, value in undocumented()]
    return "\n".join(lines).replace("\n\n\n", "\n\n") + "\n"


def _table(rows: list[Documented], *, why: bool) -> Iterator[str]:
    yield "| place | constant | document |" + (" runs use | where | why |" if why else " where |")
    yield "|---|---|---|---|" + ("---|---|" if why else "")
    for row in rows:
        cells = [row.place, row.what + _under(row), _documented(row)]
        cells += [row.absent or _with_unit(used(row), row)] if why else []
        cells += [f"`{row.at}`"] + ([row.reason] if why else [])
        yield "| " + " | ".join(one.replace("|", "\\|") for one in cells) + " |"


def _under(row: Documented) -> str:
    words = []
    for path, values in row.when.items():
        word = "not " if isinstance(values, AnyBut) else ""
        words.append(f"{path} {word}{' or '.join(map(shown, values))}")
    return f" ({'; '.join(words)})" if words else ""


def _documented(row: Documented) -> str:
    value = _with_unit(row.value, row)
    return f"named, no number; preset {value}" if row.named else value


def _with_unit(value: Value, row: Documented) -> str:
    if row.unit == "rad" and isinstance(value, int | float) and math.isfinite(value):
        return f"{math.degrees(value):.6g} degrees"
    return shown(value) if value == math.inf else f"{shown(value)} {row.unit}".rstrip()


def _by_name(at: str, value: float) -> str:
    return f"{math.degrees(value):.6g} degrees" if at.endswith("_rad") else shown(value)


def undocumented() -> list[tuple[str, float]]:
    """Return numbers of `ekf_reference` that no row is about, with their values."""
    known = {one.replace("()", "") for row in ROWS for one in (row.at, *row.also, *row.defaults)}
    found = []
    for info in pkgutil.walk_packages(ekf_reference.__path__, "ekf_reference."):
        module = import_module(info.name)
        found += [(at, value) for at, value in _numbers(module) if at not in known]
    return found


def used(row: Documented) -> Value:
    """Return the value that runs use by default."""
    return setting_default(row.at) if row.is_setting else in_code(row.at)


def differs(row: Documented) -> bool:
    """Return whether runs use another value."""
    return not same(row.value, used(row))


def in_code(at: str) -> Value:
    """Return what `module:name.name` stands for: a name with () called, a field's default."""
    module, _, path = at.partition(":")
    found: Any = import_module(module)
    for name in path.split("."):
        found = _member(found, name.removesuffix("()"))
        found = found() if name.endswith("()") else found
    return tuple(map(float, found)) if isinstance(found, np.ndarray) else found


def _member(holder: Any, name: str) -> Any:
    if isinstance(holder, type) and dataclasses.is_dataclass(holder):
        fields = {one.name: one for one in dataclasses.fields(holder)}
        if name in fields and fields[name].default is not dataclasses.MISSING:
            return fields[name].default
    return getattr(holder, name)


def _numbers(module: ModuleType) -> Iterator[tuple[str, float]]:
    """Numbers that a module itself defines; zero and below, and infinity, set nothing."""
    for node in ast.parse(inspect.getsource(module)).body:
        if isinstance(node, ast.Assign):
            names = [one.id for one in ast.walk(node.targets[0]) if isinstance(one, ast.Name)]
        else:
            names = [node.name] if isinstance(node, ast.ClassDef | ast.FunctionDef) else []
        for key in names:
            if key.isupper() or not isinstance(node, ast.Assign):
                for path, value in _within(getattr(module, key)).items():
                    if _is_number(value):
                        yield f"{module.__name__}:{'.'.join(filter(None, (key, path)))}", value


def _within(thing: Any) -> dict[str, Any]:
    """A constant, or the defaults of what has some; of an instance the fields that have others."""
    if dataclasses.is_dataclass(thing):
        usual = {one.name: one.default for one in dataclasses.fields(thing)}
        if isinstance(thing, type):
            return usual
        return {k: v for k, v in vars(thing).items() if _is_number(usual[k]) and v != usual[k]}
    made = vars(thing).get("__init__") if isinstance(thing, type) else thing
    if not inspect.isfunction(made):
        return {"": thing}
    return {k: one.default for k, one in inspect.signature(made).parameters.items()}


def _is_number(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and 0 < value < math.inf


if __name__ == "__main__":
    sys.stdout.write(markdown())
