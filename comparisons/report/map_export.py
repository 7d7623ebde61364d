"""Layers of a dense map as files that other programs read: images with world file, ROS maps.

Images are grey, one pixel per cell: black occupied, white free, 205 unknown, the first row in the
north. A world file (`.pgw`) places the image for a geographic information system; `.pgm` and
`.yaml` are what ROS' map servers load.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.image import imsave
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError
from ekf_reference.dense.regions_at_map import RegionsAtMap

OCCUPIED_ABOVE, FREE_BELOW = 0.65, 0.25
"""Of the ROS map's three values."""
_UNKNOWN = 205
_FREE_SHADE = 0.196
"""Written as `free_thresh`: a map server takes (255 - shade) / 255, 0.19608 of unknown cells, for
free where it is below. With 0.25 all that nobody has seen would be free."""
_MOST_PIXELS = 25_000_000
_BAND = 1_000_000


@dataclass(frozen=True)
class Raster:
    """A window of the world in square cells.

    occupancy: (H, W) from south to north, west to east; NaN unknown. west_m, south_m: the corner.
    """

    occupancy: Array
    west_m: float
    south_m: float
    cell_m: float

    @property
    def grey(self) -> NDArray[np.uint8]:
        """(H, W) from north to south, for an image."""
        shade = np.where(
            np.isnan(self.occupancy), _UNKNOWN, np.round(254.0 * (1.0 - self.occupancy))
        )
        return shade[::-1].astype(np.uint8)

    @property
    def trinary(self) -> NDArray[np.uint8]:
        """(H, W) from north to south: 0 occupied, 254 free, 205 neither."""
        shade = np.full(self.occupancy.shape, _UNKNOWN, dtype=np.uint8)
        shade[self.occupancy > OCCUPIED_ABOVE] = 0
        shade[self.occupancy < FREE_BELOW] = 254
        return shade[::-1]


class Drawable(Protocol):
    """What a raster can be made of; every Layer is."""

    def occupancy(self, point: Array, placed: RegionsAtMap) -> Array:
        """(N,) from 0 to 1 at points (N, 2) [m], NaN where nothing is known."""
        ...


def window(placed: RegionsAtMap) -> tuple[float, float, float, float]:
    """West, south, east, north of all regions [m]. Raises InputError where there are none."""
    corner = placed.triangle.reshape(-1, 2)
    corner = corner[np.isfinite(corner).all(axis=1)]
    if not len(corner):
        raise InputError("no region was made, so there is no map to write")
    west, south = corner.min(axis=0)
    east, north = corner.max(axis=0)
    return float(west), float(south), float(east), float(north)


def rasterise(
    layer: Drawable,
    placed: RegionsAtMap,
    cell_m: float,
    bounds: tuple[float, float, float, float] | None = None,
) -> Raster:
    """A layer at the centres of square cells over a window (west, south, east, north) [m].

    Raises InputError for more cells than a picture can have.
    """
    west, south, east, north = bounds or window(placed)
    west, south = np.floor(west / cell_m) * cell_m, np.floor(south / cell_m) * cell_m
    width = max(int(np.ceil((east - west) / cell_m - 1e-9)), 1)
    height = max(int(np.ceil((north - south) / cell_m - 1e-9)), 1)
    if width * height > _MOST_PIXELS:
        raise InputError(
            f"a map of {width} x {height} cells is too large; choose a coarser --resolution"
        )
    x = west + (np.arange(width) + 0.5) * cell_m
    y = south + (np.arange(height) + 0.5) * cell_m
    point = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    bands = np.array_split(point, 1 + len(point) // _BAND)
    occupancy = np.concatenate([layer.occupancy(band, placed) for band in bands])
    return Raster(occupancy.reshape(height, width), float(west), float(south), cell_m)


def write_image(raster: Raster, path: Path) -> None:
    """A PNG, and beside it the world file that says where it lies."""
    grey = raster.grey
    imsave(path, np.repeat(grey[..., None], 3, axis=2), metadata={"Software": ""})
    top = raster.south_m + (len(grey) - 0.5) * raster.cell_m
    left = raster.west_m + 0.5 * raster.cell_m
    lines = (raster.cell_m, 0.0, 0.0, -raster.cell_m, left, top)
    path.with_suffix(".pgw").write_text("".join(f"{v:.10g}\n" for v in lines), encoding="ascii")


def write_ros_map(raster: Raster, path: Path) -> None:
    """A `.pgm` and, beside it, the `.yaml` that a ROS map server is given."""
    grey = raster.trinary
    header = f"P5\n{grey.shape[1]} {grey.shape[0]}\n255\n".encode("ascii")
    path.write_bytes(header + grey.tobytes())
    path.with_suffix(".yaml").write_text(
        f"image: {path.name}\n"
        "mode: trinary\n"
        f"resolution: {raster.cell_m:.10g}\n"
        f"origin: [{raster.west_m:.10g}, {raster.south_m:.10g}, 0.0]\n"
        "negate: 0\n"
        f"occupied_thresh: {OCCUPIED_ABOVE}\n"
        f"free_thresh: {_FREE_SHADE}\n",
        encoding="ascii",
    )
