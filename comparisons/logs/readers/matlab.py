"""Numeric variables of MATLAB files of version 5, with errors that name file and variable.

Read here rather than by scipy, whose reader crashes the interpreter on some damaged files.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from comparisons.archive import most_unpacked
from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.table import reading

_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8",
            13: "u8"}  # fmt: skip
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX_FLAG = 0x0800
_HEADER_BYTES = 128


def load_matlab(path: Path, names: tuple[str, ...]) -> dict[str, Array]:
    """The named variables as float64, in the shapes that they have in the file.

    Raises InputError for a missing or damaged file, and for a variable that is missing, not a full
    array of real numbers, or not finite throughout.
    """
    with reading(path):
        content = path.read_bytes()
    try:
        found = _variables(content, names)
    except ValueError as error:
        raise InputError(f"{path}: not a MATLAB file of version 5 ({error})") from None
    result: dict[str, Array] = {}
    for name in names:
        if name not in found:
            raise InputError(f"{path}: no variable {name}, expected {', '.join(names)}")
        value = found[name]
        if value is None:
            raise InputError(f"{path}: {name} is not numeric")
        if not np.isfinite(value).all():
            raise InputError(f"{path}: {name} holds a value that is not a finite number")
        result[name] = value
    return result


def _variables(content: bytes, names: tuple[str, ...]) -> dict[str, Array | None]:
    """Those of the names that are there; None for what is not a full array of real numbers."""
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None:
        raise ValueError("its header does not say so")
    found: dict[str, Array | None] = {}
    most = most_unpacked(len(content))
    for kind, data in _elements(memoryview(content)[_HEADER_BYTES:], order):
        body = data
        if kind == _COMPRESSED:
            kind, body = next(_elements(_inflated(data, order, most), order), (0, data))
        if kind == _MATRIX:
            name, value = _matrix(body, order, names, most)
            if name in names:
                found[name] = value
                most -= 0 if value is None else value.nbytes
    return found


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and content of each element; up to four bytes sit within the tag itself."""
    at = 0
    while at < len(data):
        if len(data) - at < 8:
            raise ValueError("it ends within a tag")
        kind, size = np.frombuffer(data[at : at + 8], order + "u4").tolist()
        start, room = at + 8, size
        if kind >> 16:
            kind, size = kind & 0xFFFF, kind >> 16
            start, room = at + 4, 4
        if size > room or size > len(data) - start:
            raise ValueError(f"an element of {size} bytes where {len(data) - start} are left")
        yield kind, data[start : start + size]
        at = start + (room if kind == _COMPRESSED or room == 4 else -(-room // 8) * 8)


def _inflated(data: memoryview, order: str, most: int) -> memoryview:
    """One compressed element, no longer than its own tag says, and than `most`."""
    stream = zlib.decompressobj()
    try:
        tag = stream.decompress(data, 8)
        size = int(np.frombuffer(tag, order + "u4")[1]) if len(tag) == 8 else 0
        if size > most:
            raise ValueError(f"a variable of {size} bytes, expected {most} at most")
        rest = stream.decompress(stream.unconsumed_tail, size) if size else b""
    except zlib.error as error:
        raise ValueError(str(error)) from None
    return memoryview(tag + rest)


def _matrix(
    data: memoryview, order: str, names: tuple[str, ...], most: int
) -> tuple[str, Array | None]:
    """Name and value: flags, dimensions, name and real part, one element each, by column.

    most: bytes that the value may take as float64.
    """
    parts = _elements(data, order)
    kinds = [next(parts, (0, memoryview(b""))) for _ in range(3)]
    flags, shape, name = (part for _, part in kinds)
    if len(flags) != 8 or len(shape) % 4 or len(shape) < 8:
        raise ValueError("a variable without flags or dimensions")
    title = bytes(name).decode("ascii", "replace")
    word = int(np.frombuffer(flags, order + "u4")[0])
    if title not in names or word & 0xFF not in _NUMERIC_CLASSES or word & _COMPLEX_FLAG:
        return title, None
    dims = np.frombuffer(shape, order + "i4").tolist()
    kind, real = next(parts, (0, memoryview(b"")))
    dtype = np.dtype(order + _NUMBERS[kind]) if kind in _NUMBERS else None
    count = 1
    for length in dims:
        count *= max(length, 0)
    if dtype is None or len(real) != count * dtype.itemsize or min(dims) < 0:
        raise ValueError(f"{title} is said to be {dims} and holds {len(real)} bytes")
    if 8 * count > most:
        raise ValueError(f"{title} of {8 * count} bytes, expected {most} at most")
    values = np.frombuffer(real, dtype).astype(float)
    return title, np.ascontiguousarray(values.reshape(dims, order="F"))
