"""A figure to draw on, and its way to a file; loads nothing but matplotlib."""

from __future__ import annotations

import io
from collections.abc import Collection
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def blank(width: float, height: float, *, fitted: bool = True) -> Figure:
    """An empty figure, in inches. fitted: margins follow what is drawn."""
    figure = Figure(figsize=(width, height), layout="constrained" if fitted else None)
    FigureCanvasAgg(figure)
    return figure


FORMATS = ("png", "pdf")
_PNG: dict[str, Any] = {
    "dpi": 130,
    "metadata": {"Software": None},
    "pil_kwargs": {"compress_level": 3},
}
"""Compressed less than usual: half the time, and curves and maps hardly grow."""


def save(figure: Figure, path: Path, formats: Collection[str] = ()) -> None:
    """Write a PNG and, where formats hold `pdf`, a PDF beside it that a paper can take.

    The PDF keeps text as text, in TrueType, which publishers ask for, and no date: the same run
    gives the same file.
    """
    figure.savefig(path, **_PNG)
    if "pdf" in formats:
        path.with_suffix(".pdf").write_bytes(_pdf(figure))


def encoded(figure: Figure) -> tuple[bytes, bytes]:
    """A PNG and a PDF, as `save` writes them."""
    png = io.BytesIO()
    figure.savefig(png, format="png", **_PNG)
    return png.getvalue(), _pdf(figure)


def _pdf(figure: Figure) -> bytes:
    drawn = io.BytesIO()
    with matplotlib.rc_context({"pdf.fonttype": 42}):
        figure.savefig(drawn, format="pdf", dpi=300, metadata={"CreationDate": None})
    return drawn.getvalue()
