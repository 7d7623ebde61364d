"""Faults a user can mend, each reported in one line."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


class InputError(ValueError):
    """Unusable input or usage: what, where, what was expected. The command line exits with 2."""


class RecordError(InputError):
    """A record of a log that breaks its contract.

    row: zero-based row within the stream, for readers that can name the file's line instead.
    """

    def __init__(self, stream: str, row: int | None, fault: str) -> None:
        """fault: the column, its value and what was expected."""
        self.stream, self.row, self.fault = stream, row, fault
        place = stream if row is None else f"{stream}, row {row}"
        super().__init__(f"{place}: {fault}")


@contextmanager
def naming(place: object, kind: type[InputError] = InputError) -> Iterator[None]:
    """Say where a fault of a kind comes from, such as its file."""
    try:
        yield
    except kind as error:
        raise InputError(f"{place}: {error}") from None


def note(text: str) -> None:
    """Print one line on standard error, which changes no result."""
    with suppress(OSError, ValueError, AttributeError):
        print(f"slamcheck: {printable(text)}", file=sys.stderr)


def printable(text: str) -> str:
    """Text without control characters or broken code points, which a terminal might obey."""
    return "".join(c if c.isprintable() else "?" for c in text)


def check_regular(path: Path) -> None:
    """Raise InputError where there is something that is not a regular file, such as a folder.

    A pipe or a device may never end.
    """
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is not a regular file")
