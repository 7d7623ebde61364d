"""High level landmarks on the map of a run, and on the page's."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from comparisons.extensions.high_level.source import HighLevelRun
from comparisons.report.html.drawing import Drawing

HIGH_LEVEL_COLOUR = "#2e7d32"
_SEEN = {True: "seen again", False: "never seen again"}


def draw_high_level(axis: Axes, made: HighLevelRun) -> None:
    """Rectangles of high level landmarks, dashed where never seen again, and their axes."""
    closed = np.concatenate((made.rectangle, made.rectangle[:, :1]), axis=1)
    for style, name, chosen in (
        ("solid", "high level landmarks", made.landmark_index >= 0),
        ("dashed", "found, not seen again", made.landmark_index < 0),
    ):
        lines = LineCollection(list(closed[chosen]), linestyles=style, linewidths=0.9, label=name)
        lines.set_color(HIGH_LEVEL_COLOUR)
        axis.add_collection(lines)
    both = list(np.stack(made.axes, axis=1))
    axis.add_collection(LineCollection(both, colors=HIGH_LEVEL_COLOUR, linewidths=1.6))


def high_level_layers(drawing: Drawing, made: HighLevelRun) -> None:
    """Add rectangles and axes."""
    labels = [f"high level landmark, {_SEEN[s >= 0]}" for s in made.landmark_index.tolist()]
    drawing.outlines("high level landmarks", HIGH_LEVEL_COLOUR, made.rectangle, labels)
    drawing.links("their axes", HIGH_LEVEL_COLOUR, *made.axes)
