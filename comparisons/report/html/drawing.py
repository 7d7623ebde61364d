"""A map as an SVG drawing with layers that can be hidden, moved and zoomed."""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MOST_POINTS = 4000
_SIDE = 1000.0


@dataclass
class Drawing:
    """Layers of shapes in metres, north up. Names and labels may hold any text.

    bounds: (4,) west, south, east, north of what is drawn.
    """

    bounds: Array
    layers: list[tuple[str, str, str]] = field(default_factory=list)

    @classmethod
    def of(cls, *points: Array) -> Drawing:
        """Over points (N, 2) [m], with a margin; not finite ones do not count."""
        every = np.concatenate([np.empty((0, 2)), *points])
        every = every[np.isfinite(every).all(axis=1)]
        if not len(every):
            every = np.zeros((1, 2))
        low, high = every.min(axis=0), every.max(axis=0)
        margin = 0.04 * max(float((high - low).max()), 1.0)
        return cls(np.concatenate((low - margin, high + margin)))

    def path(self, name: str, colour: str, point: Array, dashes: str = "") -> None:
        """A line through points (N, 2)."""
        step = -(-len(point) // _MOST_POINTS) or 1
        places = self._places(point[::step])
        shown = " ".join(f"{x:.2f},{y:.2f}" for x, y in places.tolist())
        style = f' stroke-dasharray="{escape(dashes)}"' if dashes else ""
        self._add(name, colour, f'<polyline class="path" points="{shown}"{style}/>')

    def outlines(self, name: str, colour: str, outline: Array, labels: list[str]) -> None:
        """Closed lines (L, N, 2), each with a label."""
        shapes = []
        for label, places in zip(labels, outline, strict=True):
            if np.isfinite(places).all():
                shown = " ".join(f"{x:.2f},{y:.2f}" for x, y in self._places(places).tolist())
                shapes.append(f'<polygon points="{shown}"><title>{escape(label)}</title></polygon>')
        self._add(name, colour, "".join(shapes))

    def dots(self, name: str, colour: str, point: Array, labels: list[str] | None = None) -> None:
        """Points (N, 2), each with a label if there are any."""
        step = 1 if labels else -(-len(point) // _MOST_POINTS) or 1
        places = self._places(point[::step])
        shapes = []
        for i, (x, y) in enumerate(places.tolist()):
            if np.isfinite((x, y)).all():
                title = f"<title>{escape(labels[i])}</title>" if labels else ""
                shapes.append(f'<circle cx="{x:.2f}" cy="{y:.2f}" r="2.2">{title}</circle>')
        self._add(name, colour, "".join(shapes))

    def links(self, name: str, colour: str, start: Array, end: Array) -> None:
        """Lines from points (N, 2) to points (N, 2)."""
        shapes = [
            f'<line x1="{a:.2f}" y1="{b:.2f}" x2="{c:.2f}" y2="{d:.2f}"/>'
            for (a, b), (c, d) in zip(
                self._places(start).tolist(), self._places(end).tolist(), strict=True
            )
        ]
        self._add(name, colour, "".join(shapes))

    def svg(self) -> str:
        """The drawing; its layers are the groups of class `layer`, in order."""
        width, height = self._size
        groups = "".join(
            f'<g class="layer" data-name="{escape(name)}" stroke="{escape(colour)}" '
            f'fill="{escape(colour)}">{shapes}</g>'
            for name, colour, shapes in self.layers
        )
        return (
            f'<svg id="map" viewBox="0 0 {width:.1f} {height:.1f}" role="img" '
            f'aria-label="map" preserveAspectRatio="xMidYMid meet"><g id="world">{groups}</g></svg>'
        )

    @property
    def _scale(self) -> float:
        return _SIDE / float(max(self.bounds[2:] - self.bounds[:2]))

    @property
    def _size(self) -> tuple[float, float]:
        width, height = ((self.bounds[2:] - self.bounds[:2]) * self._scale).tolist()
        return width, height

    def _places(self, point: Array) -> Array:
        west, _, _, north = self.bounds
        moved = (point - (west, north)) * (self._scale, -self._scale)
        result: Array = np.asarray(moved, dtype=float)
        return result

    def _add(self, name: str, colour: str, shapes: str) -> None:
        self.layers.append((name, colour, shapes))
