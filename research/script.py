"""What the scripts share: options by their defaults, rows of Markdown."""

from __future__ import annotations

import argparse
from typing import Any, TypeVar

T = TypeVar("T")


def options(doc: str | None, *given: str, **defaults: Any) -> argparse.Namespace:
    """Read a script's arguments; its docstring says what they mean.

    Args:
        doc: The docstring, which --help prints.
        given: Names of texts that must be given, in their order.
        defaults: By the option's name. False makes a switch, a type an option of it that may be
            left out, a tuple one that takes several of the kind of the first.

    Returns:
        The values by name.
    """
    kept = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=doc, formatter_class=kept)
    for name in given:
        parser.add_argument(name)
    for name, default in defaults.items():
        kind: dict[str, Any] = {"type": type(default), "default": default}
        if default is False:
            kind = {"action": "store_true"}
        elif isinstance(default, type):
            kind = {"type": default}
        elif isinstance(default, tuple):
            kind = {"nargs": "+", "type": type(default[0]) if default else str, "default": default}
        parser.add_argument(f"--{name.replace('_', '-')}", **kind)
    return parser.parse_args()


def print_row(*cells: object) -> None:
    """Print a row of a Markdown table at once."""
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def print_head(*titles: str) -> None:
    """Print a table's first two lines."""
    print_row(*titles)
    print("|" + "---|" * len(titles))


def present(value: T | None) -> T:
    """Return a value that has to be there."""
    assert value is not None
    return value
