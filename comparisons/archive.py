"""Arrays in `.npz` files: nothing is unpickled, nor unpacked before its size is known."""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from comparisons.errors import InputError, check_regular

_MOST_BYTES = 2**32
_MOST_TEXT = 1000
_HEADER_BYTES = 10_000
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_archive(path: Path, names: tuple[str, ...]) -> list[NDArray[np.float64]]:
    """The named arrays as float64. Raises InputError for anything but an archive of numbers."""
    found = read_arrays(path, names)
    if len(found) < len(names):
        raise InputError(f"{path}: not an archive of {', '.join(names)}")
    return [found[name] for name in names]


def read_arrays(path: Path, names: tuple[str, ...]) -> dict[str, NDArray[np.float64]]:
    """Those of the named arrays that an archive holds. Raises InputError like read_archive."""
    found = read_entries(path, names)
    for name, array in found.items():
        if not array.ndim:
            raise InputError(f"{path}: {name} is not an array of numbers")
    return {name: array.astype(np.float64) for name, array in found.items()}


def read_entries(
    path: Path, names: tuple[str, ...], texts: tuple[str, ...] = (), most: int | None = None
) -> dict[str, NDArray[Any]]:
    """Those of the named arrays that an archive holds, of the types that they are stored in.

    texts: those of the names that are one text each, the others are numbers. most: bytes that all
    of them unpacked may take. Raises InputError for all that a damaged or hostile archive may be.
    """
    check_regular(path)
    most = _MOST_BYTES if most is None else most
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            entries = {info.filename: info for info in archive.infolist()}
            wanted = {name: entries[f"{name}.npy"] for name in names if f"{name}.npy" in entries}
            size = sum(info.file_size for info in wanted.values())
            if size > most:
                raise InputError(f"{path}: holds {size} bytes unpacked, expected {most} at most")
            return {
                name: _array(archive, info, f"{path}: {name}", is_text=name in texts)
                for name, info in wanted.items()
            }
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (InputError, MemoryError):
        raise
    except Exception:  # a damaged archive fails in as many ways as zip, zlib and numpy know
        raise InputError(f"{path}: not an archive of {', '.join(names)}") from None


def _array(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo, name: str, *, is_text: bool
) -> NDArray[Any]:
    """One entry. Its header and its size must agree before the rest of it is unpacked."""
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(f"{name} is packed otherwise than by numpy")
    with archive.open(info) as entry:
        shape, column_major, dtype, start = _header(entry.read(_HEADER_BYTES), name)
    allowed = _is_short_text(dtype, shape) if is_text else dtype.kind in "fiu"
    if not allowed:
        raise InputError(f"{name} is not {'a short text' if is_text else 'an array of numbers'}")
    if min(shape, default=0) < 0 or start + math.prod(shape) * dtype.itemsize != info.file_size:
        raise InputError(f"{name} is said to be {shape} and holds {info.file_size} bytes")
    with archive.open(info) as entry:
        content = entry.read(info.file_size)
    values = np.frombuffer(content, dtype, offset=start)
    return values.reshape(shape, order="F" if column_major else "C")


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
