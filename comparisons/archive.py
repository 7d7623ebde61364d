"""Arrays in `.npz` files: nothing is unpickled, nor unpacked before its size is known."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from comparisons.errors import InputError, check_regular

_MOST_BYTES = 2**32
_SPARE_BYTES, _MOST_TIMES = 2**26, 50
"""A log of scans packs to a quarter, zeros to a thousandth."""
_MOST_TEXT = 1000
_HEADER_BYTES = 10_000
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


Shape = tuple[int | str, ...]
"""Of an array: lengths, or names of lengths that all arrays of an archive share."""


def most_unpacked(file_bytes: int) -> int:
    """Bytes of float64 that a packed file may become: what data pack to, not what zeros do."""
    return min(_MOST_BYTES, _SPARE_BYTES + _MOST_TIMES * file_bytes)


def read_archive(path: Path, shapes: Mapping[str, Shape]) -> list[NDArray[np.float64]]:
    """All of the named arrays as float64. Raises InputError like read_arrays."""
    found = read_arrays(path, shapes)
    if len(found) < len(shapes):
        raise InputError(f"{path}: not an archive of {', '.join(shapes)}")
    return [found[name] for name in shapes]


def read_arrays(path: Path, shapes: Mapping[str, Shape]) -> dict[str, NDArray[np.float64]]:
    """Those of the named arrays that an archive holds, as float64.

    Raises InputError, before anything is unpacked, for anything but arrays of numbers of these
    shapes that take no more than most_unpacked.
    """
    with _opened(path, shapes) as archive:
        headers = {name: archive.header(name) for name in shapes if archive.holds(name)}
        lengths: dict[str, int] = {}
        for name, header in headers.items():
            _check_shape(f"{path}: {name}", header.shape, shapes[name], lengths)
        size = 8 * sum(math.prod(header.shape) for header in headers.values())
        _check_size(path, size, most_unpacked(path.stat().st_size))
        return {
            name: archive.unpacked(name, header).astype(np.float64)
            for name, header in headers.items()
        }


def read_entries(
    path: Path, names: tuple[str, ...], texts: tuple[str, ...], most: int
) -> dict[str, NDArray[Any]]:
    """Those of the named arrays that an archive holds, of the types that they are stored in.

    texts: those of the names that are one text each, the others are numbers. most: bytes that all
    of them unpacked may take. Raises InputError for all that a damaged or hostile archive may be.
    """
    with _opened(path, names) as archive:
        held = [name for name in names if archive.holds(name)]
        headers = {name: archive.header(name, is_text=name in texts) for name in held}
        _check_size(path, sum(header.entry_bytes for header in headers.values()), most)
        return {name: archive.unpacked(name, header) for name, header in headers.items()}


class _Header(NamedTuple):
    """Of an entry. start: bytes before the values."""

    shape: tuple[int, ...]
    column_major: bool
    dtype: np.dtype[Any]
    start: int
    entry_bytes: int


class _Archive(NamedTuple):
    path: Path
    archive: zipfile.ZipFile
    entries: Mapping[str, zipfile.ZipInfo]

    def holds(self, name: str) -> bool:
        return f"{name}.npy" in self.entries

    def header(self, name: str, *, is_text: bool = False) -> _Header:
        """Read of an entry what says what it is; that and its size must agree."""
        info, place = self.entries[f"{name}.npy"], f"{self.path}: {name}"
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputError(f"{place} is packed otherwise than by numpy")
        with self.archive.open(info) as entry:
            shape, column_major, dtype, start = _header(entry.read(_HEADER_BYTES), place)
        allowed = _is_short_text(dtype, shape) if is_text else dtype.kind in "fiu"
        if not allowed:
            what = "a short text" if is_text else "an array of numbers"
            raise InputError(f"{place} is not {what}")
        size = info.file_size
        if min(shape, default=0) < 0 or start + math.prod(shape) * dtype.itemsize != size:
            raise InputError(f"{place} is said to be {shape} and holds {size} bytes")
        return _Header(shape, column_major, dtype, start, size)

    def unpacked(self, name: str, header: _Header) -> NDArray[Any]:
        with self.archive.open(self.entries[f"{name}.npy"]) as entry:
            content = entry.read(header.entry_bytes)
        values = np.frombuffer(content, header.dtype, offset=header.start)
        return values.reshape(header.shape, order="F" if header.column_major else "C")


@contextmanager
def _opened(path: Path, names: Iterable[str]) -> Iterator[_Archive]:
    """Yield an archive. Raises InputError for all that a damaged or hostile one may be."""
    check_regular(path)
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            yield _Archive(path, archive, {entry.filename: entry for entry in archive.infolist()})
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (InputError, MemoryError):
        raise
    except Exception:  # a damaged archive fails in as many ways as zip, zlib and numpy know
        raise InputError(f"{path}: not an archive of {', '.join(names)}") from None


def _check_size(path: Path, size: int, most: int) -> None:
    if size > most:
        raise InputError(f"{path}: holds {size} bytes unpacked, expected {most} at most")


def _check_shape(
    name: str, shape: tuple[int, ...], expected: Shape, lengths: dict[str, int]
) -> None:
    """Raise InputError for another shape; named lengths are those that the first array gives."""
    if len(shape) == len(expected):
        for length, word in zip(shape, expected, strict=True):
            if isinstance(word, str):
                lengths.setdefault(word, length)
    wanted = tuple(lengths.get(one, one) if isinstance(one, str) else one for one in expected)
    if shape != wanted:
        words = ", ".join(map(str, wanted)) + ("," if len(wanted) == 1 else "")
        raise InputError(f"{name} has shape {shape}, expected ({words})")


def _header(begin: bytes, name: str) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Shape, whether by column, type, and the bytes before the values."""
    head = io.BytesIO(begin)
    try:
        read = _HEADERS[npy.read_magic(head)]
        shape, column_major, dtype = read(head, max_header_size=_HEADER_BYTES)
    except Exception:  # also MemoryError: the parser's, of a few kilobytes in deep brackets
        raise InputError(f"{name} is not an array of numbers") from None
    return shape, column_major, dtype, head.tell()


def _is_short_text(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bool:
    return dtype.kind == "U" and not shape and 0 < dtype.itemsize <= _MOST_TEXT
