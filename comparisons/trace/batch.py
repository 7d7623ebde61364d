"""Events by the batch, as bytes: what a recorder writes and a reader reads, whatever holds them.

docs/audit-format.md describes the bytes for other languages. A batch is a table of events, the
texts that they name and the matrices that they refer to, each stored once. Of matrices of one size
only the numbers that are not those of the one before are stored, which takes a tenth of the time
of zlib and leaves a filter's F no larger.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Collection, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from comparisons.arrays import Array, Mask

COLUMNS: dict[str, tuple[str, ...]] = {
    "prior": ("covariance", "point"),
    "predict": ("jacobian", "noise", "point", "after"),
    "update": (
        *("residual", "jacobian", "noise", "correction", "gain", "point", "numbers", "weight"),
    ),
    "augment": ("jacobian", "noise", "noise_jacobian", "point", "after", "numbers", "weight"),
    "clone": (),
    "remove": (),
    "reset": ("jacobian",),
    "snapshot": ("covariance", "mean", "error"),
    "directions": ("jacobian",),
    "evaluation": ("jacobian", "value", "uncertainty", "measured"),
}
"""The matrices of an event of each kind, in their order in the table; the rest of it is -1."""
KINDS = tuple(COLUMNS)
MOST_COLUMNS = max(map(len, COLUMNS.values()))
ROW = struct.Struct(f"<dBB2xi{MOST_COLUMNS + 1}i4x")
"""Time, kind, whether it was used, text of the blocks, text of its own, and its matrices."""
_TABLE = np.dtype(
    {
        "names": ["time_s", "kind", "used", "blocks", "text", "matrices"],
        "formats": ["<f8", "u1", "u1", "<i4", "<i4", ("<i4", MOST_COLUMNS)],
        "offsets": [0, 8, 9, 12, 16, 20],
        "itemsize": ROW.size,
    }
)
_HEAD = struct.Struct("<4I")
SPARE_NUMBERS = 1 << 22
"""All matrices of a batch may have so many numbers, and one more for each of its bytes."""


class Batch(NamedTuple):
    """What a batch holds.

    time_s: NaN where there is none. blocks, text: indices of texts, -1 for none. matrices: by
    event MOST_COLUMNS indices of arrays, -1 for none. texts: whatever JSON can say. arrays: the
    numbers of each matrix, row by row; None where one is not finite, or too large to be squared.
    """

    time_s: list[float]
    kind: list[int]
    used: list[int]
    blocks: list[int]
    text: list[int]
    matrices: list[list[int]]
    texts: list[Any]
    arrays: list[Array | None]


def pack(rows: Sequence[bytes], texts: Iterable[str], matrices: Collection[bytes]) -> bytes:
    """Return a batch.

    rows: of the table, each as ROW packs it. texts: that it names, in order, in JSON. matrices:
    that it refers to, in order, as float64.
    """
    spoken = f"[{','.join(texts)}]".encode()
    sizes = np.fromiter(map(len, matrices), "<u4", len(matrices)) // 8
    parts = [_HEAD.pack(len(rows), len(spoken), len(matrices), 0), *rows, _padded(spoken)]
    parts.append(_padded(sizes.tobytes()))
    alike: dict[int, list[bytes]] = {}
    for matrix in matrices:
        alike.setdefault(len(matrix), []).append(matrix)
    for length in sorted(alike):
        if length:
            stack = np.frombuffer(b"".join(alike[length]), "<u8").reshape(-1, length // 8)
            new = np.ones(stack.shape, dtype=bool)
            np.not_equal(stack[1:], stack[:-1], out=new[1:])
            parts += [_padded(np.packbits(new, bitorder="little").tobytes()), stack[new].tobytes()]
    return b"".join(parts)


def unpack(data: bytes) -> Batch:
    """Return what a batch holds. Raises ValueError, in a few words, for what is none."""
    bytes_of = _Bytes(data)
    count, spoken, matrices, _ = _HEAD.unpack(bytes_of.take(_HEAD.size))
    table = np.frombuffer(bytes_of.take(count * ROW.size), _TABLE)
    texts = _texts(bytes_of.take(spoken, padded=True))
    sizes = np.frombuffer(bytes_of.take(4 * matrices, padded=True), "<u4")
    most = SPARE_NUMBERS + len(data)
    if sizes.sum(dtype=np.int64) > most:
        raise ValueError(f"more than {most} numbers")
    arrays: list[Array | None] = [np.zeros(0)] * matrices
    for size in np.unique(sizes[sizes > 0]).tolist():
        alike = np.flatnonzero(sizes == size).tolist()
        stack = _stack(bytes_of, len(alike), size)
        with np.errstate(all="ignore"):
            squares = np.einsum("ij,ij->i", stack, stack)
        sound = np.isfinite(squares).tolist()
        for at, one, finite in zip(alike, stack, sound, strict=True):
            arrays[at] = one if finite else None
    if not bytes_of.ended:
        raise ValueError("more bytes than expected")
    for name, most in (("kind", len(KINDS)), ("blocks", len(texts)), ("text", len(texts))):
        column = table[name]
        if len(column) and not (column.min(initial=0) >= -1 and column.max(initial=0) < most):
            raise ValueError(f"a {name} that it does not hold")
    found = table["matrices"]
    if not ((found >= -1) & (found < matrices)).all():
        raise ValueError("a matrix that it does not hold")
    names = "time_s", "kind", "used", "blocks", "text"
    time_s, kind, used, blocks, text = (table[name].tolist() for name in names)
    return Batch(time_s, kind, used, blocks, text, found.tolist(), texts, arrays)


class _Bytes:
    """A batch, from the front."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = memoryview(data), 0

    def take(self, count: int, *, padded: bool = False) -> memoryview:
        """Return the next bytes. Raises ValueError where there are fewer."""
        begin, end = self._at, self._at + count
        self._at = end + (-count % 8 if padded else 0)
        if self._at > len(self._data):
            raise ValueError(f"is cut off: {len(self._data)} bytes, expected {self._at}")
        return self._data[begin:end]

    @property
    def ended(self) -> bool:
        """Whether nothing is left."""
        return self._at == len(self._data)


def _stack(data: _Bytes, count: int, size: int) -> Array:
    """Return matrices (count, size) of one size; what is not new is of the one before."""
    mask = np.frombuffer(data.take(-(-count * size // 8), padded=True), np.uint8)
    new: Mask = np.unpackbits(mask, count=count * size, bitorder="little").view(bool)
    new = new.reshape(count, size)
    if not new[0].all():
        raise ValueError("a first matrix that is not whole")
    values = np.frombuffer(data.take(8 * int(np.count_nonzero(new))), "<f8")
    if len(values) == new.size:
        return values.reshape(count, size)
    place = np.cumsum(new, dtype=np.int32).reshape(count, size) - 1
    place[~new] = 0
    return values[np.maximum.accumulate(place, axis=0)]


def _texts(spoken: memoryview) -> list[Any]:
    try:
        found = json.loads(bytes(spoken))
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, list):
        raise ValueError("texts that are no list")
    return found


def _padded(part: bytes) -> bytes:
    return part + bytes(-len(part) % 8)
