"""Numbers in text files, with errors that name file, line, value and expectation."""

from __future__ import annotations

import errno
import io
import re
import tomllib
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from decimal import Decimal
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError, RecordError, check_regular, shorten, unusable_file
from comparisons.logs.stamps import Nanoseconds, nanoseconds, resolved_by_floats, seconds_after

_MOST_PARTS = 64
PACKED = {".gz": "gzip", ".bz2": "bz2"}
"""Modules that unpack files, by suffix."""
_MOST_BYTES = 256 * 2**20
_DAMAGED = "damaged, or not packed as its suffix says, expected a whole gzip or bzip2 file"
_QUOTED = re.compile(r"""\"[^"\n]*"|'[^'\n]*'""")
_LONG_INTEGER = re.compile(r"[0-9a-fA-F_]{16}")
_BETWEEN = re.compile(r"[=,#\[\]{}\n]")
"""Ends a dotted key of TOML."""


class TextTable:
    """A rectangular text file: one record per line, numbers separated by blanks or commas.

    Lines that are empty or start with `#` are passed over, and a header line when `header` says so.
    """

    def __init__(
        self,
        path: Path,
        columns: tuple[str, ...],
        *,
        comma: bool = False,
        header: bool = False,
        gaps: tuple[str, ...] = (),
        optional: tuple[str, ...] = (),
        starts_s: Mapping[str, int] | None = None,
    ) -> None:
        """Read the file; `gaps` are columns in which nan means not measured.

        optional: further columns, which a header may name behind the others, all or none.
        starts_s: what times count from, by column, subtracted from their decimals.
        Raises InputError at the first line that is not a full record.
        """
        self.path, self.columns = path, columns
        self._delimiter, self._header, self._gaps = "," if comma else None, header, gaps
        text = read_text(path)
        lines = text.splitlines()
        named = tuple(lines[0].strip().split(",")) if header and lines else ()
        if optional and named == columns + optional:
            self.columns = columns = named
        if header and named != columns:
            raise InputError(f"{path}:1: expected the header {','.join(columns)}")
        records = [line for line in lines[int(header) :] if is_record(line)]
        if not records:
            self.data: Array = np.zeros((0, len(columns)))
            return
        try:
            self.data = np.loadtxt(records, delimiter=self._delimiter, ndmin=2, dtype=float)
        except ValueError:
            self._explain(text)
        if self.data.shape[1] != len(columns):
            self._explain(text)
        required = [name not in gaps for name in columns]
        if not np.isfinite(self.data[:, required]).all() or np.isinf(self.data).any():
            self._explain(text)
        for name, start_s in (starts_s or {}).items():
            if start_s:
                place = columns.index(name)
                self.data[:, place] = seconds_after(self._words(records, place), start_s)

    def __getitem__(self, column: str) -> Array:
        """One column (N,) by name."""
        return self.data[:, self.columns.index(column)]

    def decimals(self, column: str) -> list[Decimal]:
        """Numbers (N,) of a column exactly as they are written."""
        lines = (line for _, line in self._lines(read_text(self.path)))
        return [Decimal(word) for word in self._words(lines, self.columns.index(column))]

    def nanoseconds(self, column: str, per_second: int = 1) -> Nanoseconds | None:
        """Times (N,) of a column as they are written; None where float64 has nanoseconds of them.

        per_second: how many of the file's units are a second.
        """
        if resolved_by_floats(self[column] / per_second):
            return None
        return nanoseconds(self.decimals(column), per_second)

    def __len__(self) -> int:
        """Number of records."""
        return len(self.data)

    def line(self, row: int) -> int:
        """The file's line number, from 1, of a zero-based record."""
        return self._lines(read_text(self.path))[row][0]

    def locating(self) -> AbstractContextManager[None]:
        """Turn a RecordError about a row of this table into one that names file and line."""
        return locate_rows(self.path, self.line)

    def _words(self, lines: Iterable[str], place: int) -> Iterator[str]:
        """One word of each record; what follows # is a comment."""
        return (line.partition("#")[0].split(self._delimiter)[place].strip() for line in lines)

    def _lines(self, text: str) -> list[tuple[int, str]]:
        """Line numbers and contents of the records."""
        start = int(self._header)
        return [
            (number, line)
            for number, line in enumerate(text.splitlines()[start:], start=start + 1)
            if is_record(line)
        ]

    def _explain(self, text: str) -> NoReturn:
        """Raise for the first line that does not hold one number per column."""
        for number, line in self._lines(text):
            words = [w.strip() for w in line.split("#")[0].strip().split(self._delimiter)]
            if len(words) != len(self.columns):
                raise InputError(
                    f"{self.path}:{number}: {len(words)} values, expected {len(self.columns)} "
                    f"({', '.join(self.columns)})"
                )
            for name, word in zip(self.columns, words, strict=True):
                if not (name in self._gaps and word == "nan"):
                    number_or_fail(word, self.path, number, name)
        raise InputError(f"{self.path}: not a table of {', '.join(self.columns)}")


def is_record(line: str) -> bool:
    """Whether a line is neither empty nor a comment."""
    start = line.lstrip()
    return start != "" and start[0] != "#"


def first_record(path: Path) -> str:
    """The first record of a text file without blanks around it, or nothing. Raises InputError."""
    with reading(path), unpacked(path) as file:
        lines = io.TextIOWrapper(file, encoding="utf-8-sig")
        return next((line.strip() for line in lines if is_record(line)), "")


@contextmanager
def locate_rows(path: Path, line_of: Callable[[int], int]) -> Iterator[None]:
    """Turn a RecordError about a row into an InputError that names file and line."""
    try:
        yield
    except RecordError as error:
        place = f"{path}" if error.row is None else f"{path}:{line_of(error.row)}"
        raise InputError(f"{place}: {error.fault}") from error


def is_number(word: str) -> bool:
    """Whether a word is a number; a blank is none."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def number_or_fail(word: str, path: Path, line: int, name: str) -> float:
    """The finite number a word spells, or an InputError naming where it stands."""
    try:
        value = float(word)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(f"{path}:{line}: {name} is '{shorten(word)}', expected a finite number")
    return value


def first_words(path: Path) -> list[str]:
    """Return the words of a text file's first record; none of what has none, or is no file."""
    if not path.is_file():
        return []
    try:
        with reading(path), unpacked(path) as file:
            lines = file.read(65536).splitlines()
    except InputError:
        return []
    kept = (line for line in lines if line.strip() and not line.startswith(b"#"))
    return next(kept, b"").decode("ascii", "replace").split()


def read_text(path: Path) -> str:
    """A file's text, unpacked where its suffix says so.

    Raises InputError when it is missing, unreadable or not text.
    """
    packed = path.suffix.lower() in PACKED
    with reading(path), unpacked(path) as file:
        content = file.read(_MOST_BYTES + 1 if packed else -1)
        if packed and len(content) > _MOST_BYTES:
            raise InputError(f"{path}: holds more than {_MOST_BYTES >> 20} MiB, expected fewer")
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")


def unpacked(path: Path) -> IO[bytes]:
    """Open a file, one that is packed as its suffix says, for its contents."""
    if path.suffix.lower() not in PACKED:
        return path.open("rb")
    from importlib import import_module

    opened: IO[bytes] = import_module(PACKED[path.suffix.lower()]).open(path, "rb")
    return opened


def stem(path: Path) -> str:
    """Return a file's name without its suffix, and without that of its packing."""
    return (path.with_suffix("") if path.suffix.lower() in PACKED else path).stem


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what may go wrong with a file into an InputError."""
    try:
        check_regular(path)
        yield
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8, expected one") from None
    except (EOFError, zlib.error):
        raise InputError(f"{path}: {_DAMAGED}") from None
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise InputError(unusable_file(error, path)) from None
        if error.errno is None and path.suffix.lower() in PACKED:
            raise InputError(f"{path}: {_DAMAGED}") from None
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as nested mappings. Raises InputError."""
    try:
        return parse_toml(read_text(path))
    except ValueError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None


def parse_toml(text: str) -> dict[str, Any]:
    """A TOML text as nested mappings. Raises ValueError, also for what would take tomllib hours.

    Its time and memory grow with the square of a key's parts. A whole number beyond 64 bits is
    refused: hexadecimal digits may make one that Python cannot spell.
    """
    for piece in _BETWEEN.split(_QUOTED.sub('""', text)):
        if piece.count(".") > _MOST_PARTS:
            raise ValueError(f"a key of more than {_MOST_PARTS} parts")
    try:
        found = tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None
    if _LONG_INTEGER.search(text):
        _check_integers(found)
    return found


def _check_integers(value: Any, key: str = "") -> None:
    """Raise ValueError for a whole number that TOML does not promise to hold. key: of the value."""
    if isinstance(value, dict):
        for name, part in value.items():
            _check_integers(part, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for part in value:
            _check_integers(part, key)
    elif isinstance(value, int) and abs(value) >= 2**64:
        raise ValueError(f"{shorten(key)} is a whole number of more than 64 bits")
