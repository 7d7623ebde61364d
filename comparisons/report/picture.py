"""A figure to draw on, and its way to a file; loads nothing but matplotlib."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def blank(width: float, height: float, *, fitted: bool = True) -> Figure:
    """An empty figure, in inches. fitted: margins follow what is drawn."""
    figure = Figure(figsize=(width, height), layout="constrained" if fitted else None)
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a PNG."""
    figure.savefig(path, dpi=130, metadata={"Software": None})


def encoded(figure: Figure) -> tuple[bytes, bytes]:
    """A PNG and a PDF, the same bytes for the same drawing."""
    png, pdf = io.BytesIO(), io.BytesIO()
    figure.savefig(png, format="png", dpi=130, metadata={"Software": None})
    figure.savefig(pdf, format="pdf", metadata={"CreationDate": None})
    return png.getvalue(), pdf.getvalue()
