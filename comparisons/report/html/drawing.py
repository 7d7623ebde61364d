"""A map as an SVG drawing with layers that can be hidden, moved and zoomed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index
from comparisons.estimates.estimate import Estimate
from comparisons.report.html.shell import themed

MOST_POINTS = 4000
MOST_LINES = 3000
_SIDE = 1000.0


@dataclass
class Drawing:
    """Layers of shapes in metres, north up. Names, labels and keys may hold any text.

    bounds: (4,) west, south, east, north of what is drawn. A shape that is not finite is left out.
    """

    bounds: Array
    layers: list[str] = field(default_factory=list)

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

    def path(self, name: str, colour: str, point: Array, dashes: str = "", track: str = "") -> None:
        """A line through points (N, 2). track: what the script knows it by, if it does."""
        places = _finite(self._places(point[kept(len(point))]))
        shown = " ".join([f"{x:.2f},{y:.2f}" for x, y in places.tolist()])
        style = f' stroke-dasharray="{escape(dashes)}"' if dashes else ""
        style += f' data-track="{escape(track)}"' if track else ""
        self._add(name, colour, f'<polyline class="path" points="{shown}"{style}/>')

    def outlines(self, name: str, colour: str, outline: Array, labels: list[str]) -> None:
        """Closed lines (L, N, 2), each with a label."""
        shapes = []
        for label, places in zip(labels, outline, strict=True):
            if np.isfinite(places).all():
                shown = " ".join(f"{x:.2f},{y:.2f}" for x, y in self._places(places).tolist())
                shapes.append(f'<polygon points="{shown}"><title>{escape(label)}</title></polygon>')
        self._add(name, colour, "".join(shapes))

    def dots(self, name: str, colour: str, point: Array) -> None:
        """Points (N, 2), thinned."""
        places = _finite(self._places(point[:: -(-len(point) // MOST_POINTS) or 1]))
        shown = "".join([f"M{x:.2f},{y:.2f}h0" for x, y in places.tolist()])
        self._add(name, colour, f'<path class="dots" d="{shown}"/>')

    def marks(
        self,
        name: str,
        colour: str,
        point: Array,
        labels: Sequence[str],
        keys: Sequence[object],
        fills: Sequence[str] = (),
        legend: str = "",
    ) -> None:
        """Points (N, 2) to point at, each with a label and a key.

        fills: their own colours. legend: the page's element that explains these; such a layer is
        hidden at first.
        """
        shapes = []
        for i, (x, y) in enumerate(self._places(point).tolist()):
            if np.isfinite(x + y):
                fill = f' fill="{escape(fills[i])}"' if fills else ""
                shapes.append(
                    f'<circle cx="{x:.2f}" cy="{y:.2f}" r="2.2" data-key="{escape(str(keys[i]))}"'
                    f"{fill}><title>{escape(labels[i])}</title></circle>"
                )
        kind = "layer filled" if fills else "layer"
        self._add(name, colour, "".join(shapes), shown=not legend, kind=kind, legend=legend)

    def coloured(self, name: str, colour: str, track: str, classes: str, legend: str) -> None:
        """A path that the script draws again in colours, hidden at first.

        track: of which. classes: a digit for the colour of each of its points, `.` for none.
        legend: the page's element that is shown with it.
        """
        shapes = f'<g data-of="{escape(track)}" data-classes="{classes}"></g>'
        self._add(name, colour, shapes, shown=False, kind="layer errors", legend=legend)

    def links(
        self,
        name: str,
        colour: str,
        start: Array,
        end: Array,
        *,
        shown: bool = True,
        faint: bool = False,
    ) -> None:
        """Lines from points (N, 2) to points (N, 2). faint: there are so many that they cover."""
        both = np.hstack((self._places(start), self._places(end)))
        lines = "".join(
            f"M{a:.2f},{b:.2f}L{c:.2f},{d:.2f}"
            for a, b, c, d in both[np.isfinite(both).all(axis=1)].tolist()
        )
        kind = "layer faint" if faint else "layer"
        self._add(name, colour, f'<path class="path" d="{lines}"/>', shown=shown, kind=kind)

    def svg(self) -> str:
        """The drawing; its layers are the groups of class `layer`, in order.

        Its data say how many metres a unit has, and where its upper left corner lies.
        """
        width, height = ((self.bounds[2:] - self.bounds[:2]) * self._scale).tolist()
        return (
            f'<svg id="map" viewBox="0 0 {width:.1f} {height:.1f}" role="img" aria-label="map" '
            f'data-metres="{1.0 / self._scale:.9g}" data-west="{self.bounds[0]:.3f}" '
            f'data-north="{self.bounds[3]:.3f}"><g id="world">{"".join(self.layers)}</g></svg>'
        )

    @property
    def _scale(self) -> float:
        return _SIDE / float(max(self.bounds[2:] - self.bounds[:2]))

    def _places(self, point: Array) -> Array:
        west, _, _, north = self.bounds
        moved = (point - (west, north)) * (self._scale, -self._scale)
        result: Array = np.asarray(moved, dtype=float)
        return result

    def _add(
        self,
        name: str,
        colour: str,
        shapes: str,
        *,
        shown: bool = True,
        kind: str = "layer",
        legend: str = "",
    ) -> None:
        hidden = "" if shown else ' display="none"'
        hidden += f' data-legend="{legend}"' if legend else ""
        paint = escape(themed(colour))
        self.layers.append(
            f'<g class="{kind}" data-name="{escape(name)}" stroke="{paint}" '
            f'fill="{paint}"{hidden}>{shapes}</g>'
        )


def _finite(places: Array) -> Array:
    """The rows of places (N, 2) that are finite."""
    found: Array = places[np.isfinite(places).all(axis=1)]
    return found


def kept(count: int) -> NDArray[np.intp]:
    """Which of `count` points of a path are drawn, the first and the last among them."""
    most = np.linspace(0, count - 1, min(count, MOST_POINTS))
    return np.asarray(np.round(most), dtype=np.intp)


def association_lines(
    drawing: Drawing, look: tuple[str, str], estimate: Estimate, epoch: Index, landmark_index: Index
) -> None:
    """Add a line from the pose to the landmark of each measurement. look: name and colour."""
    start, end = estimate.pose[epoch, :2], estimate.landmark[landmark_index]
    drawing.links(*look, start, end, shown=False, faint=True)
