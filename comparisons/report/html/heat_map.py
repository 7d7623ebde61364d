"""Matrices of shares as grey pictures within the page, without a drawing library."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping

import numpy as np

from comparisons.arrays import Array
from comparisons.report.html.shell import picture

MOST_PIXELS = 800
"""On a side; of a larger matrix each pixel is the largest of a square of entries."""


def heat_maps(title: str, shares: Mapping[str, Array]) -> str:
    """Return a section with matrices (n, n) from 0, white, to 1, black, side by side, by name."""
    drawn = "".join(
        f"<figure>{picture(f'{title}, {name}', _png(share))}"
        f"<figcaption>{name}</figcaption></figure>"
        for name, share in shares.items()
    )
    return (
        f'<section class="heat"><h2>{title}</h2><div>{drawn}</div>'
        '<p class="note">White is 0, black 1. Entries: pose, then landmarks in order of arrival.'
        "</p></section>"
    )


def _png(share: Array) -> bytes:
    """A PNG of 8-bit grey."""
    grey = np.round(255.0 * (1.0 - np.clip(np.nan_to_num(_reduced(share)), 0.0, 1.0)))
    height, width = grey.shape
    rows = np.zeros((height, width + 1), dtype=np.uint8)  # the first byte of a row: no filter
    rows[:, 1:] = grey
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(*chunk) for chunk in chunks)


def _chunk(kind: bytes, content: bytes) -> bytes:
    checked = kind + content
    return struct.pack(">I", len(content)) + checked + struct.pack(">I", zlib.crc32(checked))


def _reduced(share: Array) -> Array:
    """The largest of each square of entries, so that no side exceeds MOST_PIXELS."""
    step = -(-len(share) // MOST_PIXELS)
    if step == 1:
        return share
    missing = -len(share) % step
    whole = np.pad(share, ((0, missing), (0, missing)))
    squares = whole.reshape(len(whole) // step, step, len(whole) // step, step)
    largest: Array = squares.max(axis=(1, 3))
    return largest
