"""Environments: where the landmarks stand and where the vehicle drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array


@dataclass(frozen=True)
class LandmarkWorld:
    """A closed path among point landmarks.

    path: (P, 2) points of the loop, close together, in driving order, the first not repeated.
    landmark: (L, 2) [m].
    """

    path: Array
    landmark: Array


def nieto_loop() -> LandmarkWorld:
    """The environment of Nieto 2005, section 2.9: 100 m x 80 m, one loop of 255 m.

    The thesis shows the map in a figure only, so the places are ours: an ellipse driven
    counter-clockwise, with landmarks on rings inside and outside it at uneven spacing.
    """
    loop_m, aspect = 255.0, 0.8
    angle = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    unit = np.column_stack((np.cos(angle), aspect * np.sin(angle)))
    length = np.linalg.norm(np.roll(unit, -1, axis=0) - unit, axis=1).sum()
    half_axis = loop_m / length
    golden = np.pi * (3.0 - np.sqrt(5.0))
    rings = []
    for offset, count, phase in ((-7.0, 16, 0.1), (4.0, 20, 0.3), (-14.0, 10, 0.5), (5.0, 14, 0.9)):
        turn = phase + 2.0 * np.pi * np.arange(count) / count
        turn = turn + 0.15 * np.sin(golden * np.arange(count) + phase)
        radial = np.column_stack((np.cos(turn), aspect * np.sin(turn))) * half_axis
        outward = np.column_stack((aspect * np.cos(turn), np.sin(turn)))
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        rings.append(radial + offset * outward)
    return LandmarkWorld(half_axis * unit, np.vstack(rings))
