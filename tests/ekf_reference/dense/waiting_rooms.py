"""Waiting rooms that are wrong, and what several tests offer to right ones."""

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.box_tree import BoxTree, boxes
from ekf_reference.dense.delayed_initialisation import DelayedInitialisation
from ekf_reference.dense.regions import Potential
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.view import FilterView

EVERYWHERE = np.array([[(-1e4, -1e4), (1e4, -1e4), (0.0, 1e4)]])
LANDMARK = np.array([(10.0, 4.0), (2.0, 12.0), (-7.0, 6.0), (4.0, -9.0)])
START = np.array((1.0, 0.5, 2.0))
DENSE = np.array([(3.0, 7.0), (8.0, 9.0), (-4.0, 2.0)])


def anywhere(*axis: tuple[int, int]) -> Potential:
    """Potential regions of these axes, the first of which has the whole plane."""
    triangle = np.repeat(EVERYWHERE, len(axis), axis=0)
    tree = BoxTree.pack(boxes(triangle), np.arange(len(axis)))
    return Potential(np.array(axis).reshape(-1, 2), RegionsAtMap(triangle, tree))


class NoCross(DelayedInitialisation):
    """A broken variant: the covariance with the vehicle is left out."""

    def add(
        self,
        view: FilterView,
        point: Array,
        noise: Array,
        scan: int,
        potential: Potential,
        origin: Array | None = None,
    ) -> Index:
        number = super().add(view, point, noise, scan, potential, origin)
        self.points.cross[:] = 0.0
        return number


class NoMotion(DelayedInitialisation):
    """A broken variant: F is left out."""

    def predicted(self, view: FilterView) -> None:
        self._read(view)


class WrongSign(DelayedInitialisation):
    """A broken variant: the correction goes the other way."""

    def updated(self, view: FilterView) -> None:
        before = self.points.point
        super().updated(view)
        self.points = self.points._replace(point=2.0 * before - self.points.point)


BROKEN = [NoCross, NoMotion, WrongSign]


def view_at(pose: Array, landmark: Array = LANDMARK, sigma: float = 0.3) -> FilterView:
    """A filter that knows the pose and the landmarks so well, each on its own."""
    landmark_index = np.arange(len(landmark))
    variance = np.concatenate(
        ((sigma**2, sigma**2, 0.01), np.full(2 * len(landmark_index), sigma**2))
    )
    return FilterView(pose, landmark, landmark_index, np.diag(variance))


def noise(count: int, sigma: float = 0.1) -> Array:
    return np.broadcast_to(sigma**2 * np.eye(2), (count, 2, 2))
