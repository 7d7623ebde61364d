"""Faults a user can mend, each reported in one line.

Whatever a message quotes of a user's goes through `shorten`, or `quoted` with quotation marks.
"""

from __future__ import annotations

import errno
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_MOST = 40
"""Characters of a value in a message."""
_NO_FILE = re.compile(r"[^\s/]{256,}")
"""A word that is longer than a file's name may be."""
_LONGEST = 3000
"""Characters of a message."""


class InputError(ValueError):
    """Unusable input or usage: what, where, what was expected. The command line exits with 2."""

    def __init__(self, message: str = "") -> None:
        """Hold a message.

        Args:
            message: What, where, what was expected; cut by `one_line`.
        """
        super().__init__(one_line(message))


def outdated_format(place: object, what: str, mend: str) -> InputError:
    """Return the error for what the release 0.2 was the last to read.

    Args:
        place: A file or folder.
        what: Its format, with an article.
        mend: How a file of today's format is made.
    """
    return InputError(
        f"{place}: is {what}, which slamcheck 0.2 reads and this release does not; {mend}"
    )


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
        print(f"slamcheck: {printable(one_line(text))}", file=sys.stderr)


def shorten(value: object, limit: int = _MOST) -> str:
    """Return a user's value, of any kind and size, as it may stand in a message.

    Text stands as it is, anything else as Python spells it, and it spells no whole number of 5,000
    digits.
    """
    try:
        text = value if isinstance(value, str) else repr(value)
    except ValueError:
        return "a number of thousands of digits"
    short = printable(text[: limit + 1])
    return short if len(text) <= limit else short[: limit - 3] + "..."


def quoted(value: object, limit: int = _MOST) -> str:
    """Return a user's value as `shorten` does, but text in quotation marks."""
    return shorten(repr(value[: limit + 1]) if isinstance(value, str | bytes) else value, limit)


def unusable_file(error: OSError, path: object = None) -> str:
    """Return which file the system refused, and why. path: unless the error names it."""
    name = str(error.filename or path or "a file")
    shown = shorten(name, 200) if error.errno == errno.ENAMETOOLONG else name
    return f"{shown}: {error.strerror or error}"


def one_line(message: str) -> str:
    """Return a message without the rest of words that are too long to be the name of a file.

    The middle of what is too long all the same is left out.
    """
    short = _NO_FILE.sub(lambda word: shorten(word[0]), message)
    if len(short) <= _LONGEST:
        return short
    return f"{short[: _LONGEST // 2]} ... {short[-_LONGEST // 2 :]}"


def printable(text: str) -> str:
    """Text without control characters or broken code points, which a terminal might obey."""
    return "".join(c if c.isprintable() else "?" for c in text)


def check_regular(path: Path) -> None:
    """Raise InputError where there is something that is not a regular file, such as a folder.

    A pipe or a device may never end.
    """
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is not a regular file")
