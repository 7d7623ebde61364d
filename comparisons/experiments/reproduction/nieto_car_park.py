"""Nieto 2005, sections 3.10, 4.4, 6.1.1 and 6.5: the car park, and what is claimed of its maps.

The log at hand (--data) is another part of the drives than the thesis': 125 s and 200 m of way
around the reflectors between buildings, with RTK GPS throughout, where the thesis has 1 km in an
area of 120 by 200 m. In its last 15 s the steering reading saturates with no reflector in view, and
walls are drawn a second time, metres beside the first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from comparisons.adapters.motion import motion_between
from comparisons.arrays import Array
from comparisons.checks.accuracy import match_by_distance
from comparisons.config import EkfConfig, MapConfig
from comparisons.errors import InputError
from comparisons.estimates.estimate import landmark_blocks
from comparisons.experiments.reproduction.interface import (
    SHARE_WITHIN_3_SIGMA,
    THREE_SIGMA_SQUARED,
    Claim,
    Experiment,
    Sources,
    at_least,
    at_most,
)
from comparisons.extensions.dense_maps.accuracy import OCCUPIED
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.source import BeforeClosing
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.pipeline.dense_map import DenseMapping, map_log
from ekf_reference.dense.layers.gaussians import Ellipses, Gaussians
from ekf_reference.dense.layers.layer import Samples
from ekf_reference.scan_landmarks.high_level import (
    Around,
    Found,
    Search,
    SearchOptions,
    search,
    to_world,
)
from graphslam.increments import dead_reckoned

FOLDER = "acfr_car_park"
CELL_M, COARSE_M, PAIR_M = 0.4, 0.5, 7.0
"""Cells of Fig. 4.15; cells, and greatest distance of two corners, in section 6.5."""
HIGH_LEVEL_COUNT = 9
"""High level landmarks in Fig. 6.18."""
ERROR_BEFORE_M = 3.0
"""Of the map before the loop closes, section 4.4."""
LEAST = 20
"""Gaussians of a high level landmark: section 6.5 names no number; with 200 there are none."""
_WHOLE_MAP_M = 1e3
_LAST = "returns of the last 15 s are put where the saturated steering leads"
OTHER_PART = "the log is another part of the drives than the thesis'"


@dataclass(frozen=True, kw_only=True)
class CarPark:
    """The car park's maps.

    fine, coarse: by the landmarks alone, with cells of CELL_M and COARSE_M. aided_path: (T, 2) of
    the filter that is given GPS. image: (M, 2) all returns from there, the thesis' reference.
    wheels: (K, 2) dead reckoning. gps: (G, 2). path_gps, aided_gps, wheels_gps: (G',) distances to
    GPS at its times. beacon: (L, 2) surveyed, NaN where a landmark has none. searched,
    searched_fine: corners and high level landmarks of the coarse and of the fine map.
    """

    log: str
    fine: DenseMapping
    coarse: DenseMapping
    aided_path: Array
    image: Array
    wheels: Array
    gps: Array
    path_gps: Array
    aided_gps: Array
    wheels_gps: Array
    beacon: Array
    searched: Search
    searched_fine: Search

    def off(self, point: Array) -> Array:
        """(N,) distances of points (N, 2) to the laser image."""
        away: Array = cKDTree(self.image).query(point)[0]
        return away

    @property
    def before(self) -> BeforeClosing:
        """The fine map before the update that moved it the most."""
        if self.fine.dense.before is None:
            raise InputError(f"{self.log}: no update moved the map")
        return self.fine.dense.before

    @property
    def landmark(self) -> Array:
        """(L, 2) by the filter without GPS."""
        place: Array = self.fine.ekf.estimate.landmark
        return place

    @property
    def blocks(self) -> Array:
        """(L, 2, 2) [m^2]."""
        return landmark_blocks(self.fine.ekf.estimate.joint_covariance)

    @property
    def ellipses(self) -> Ellipses:
        """Of the coarse map's Gaussians."""
        layer = self.coarse.dense.dense.layers["sog"]
        if not isinstance(layer, Gaussians):
            raise TypeError(f"{type(layer).__name__} is no sum of Gaussians")
        return layer.ellipses(self.coarse.placed)

    @property
    def surface(self) -> Samples:
        """The sum of Gaussians, each of peak one, on a grid of COARSE_M; height as `occupancy`."""
        held = self.ellipses
        low, high = held.mean.min(axis=0) - COARSE_M, held.mean.max(axis=0) + COARSE_M
        axes = [np.arange(a, b, COARSE_M) for a, b in zip(low, high, strict=True)]
        point = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        height = np.zeros(len(point))
        for mean, covariance in zip(held.mean, held.covariance, strict=True):
            away = point - mean
            squared = np.einsum("ni,ni->n", away, np.linalg.solve(covariance, away.T).T)
            height += np.exp(-0.5 * squared)
        return Samples(point, height, np.zeros(len(point), dtype=np.intp))


def car_park(sources: Sources) -> CarPark:
    """Drive the log three times: cells of 0.4 m and 0.5 m, and with GPS. Raises InputError."""
    return of_log(read_car_park(sources))


def read_car_park(sources: Sources) -> Log:
    """Return the log with calibrated sigmas. Raises InputError where it is not given."""
    folder = sources.folder(FOLDER)
    if folder is None:
        raise InputError(f"needs --data FOLDER with {FOLDER}/")
    return open_log(str(folder))


def of_log(log: Log) -> CarPark:
    """The same of any log with scans, GPS and surveyed landmarks. Raises InputError."""
    positions, known = log.positions, log.truth.landmarks
    if positions is None or known is None:
        raise InputError(f"{log.name}: GPS and surveyed landmarks are needed")
    fine, coarse = (_mapped(log, cell) for cell in (CELL_M, COARSE_M))
    aided = _mapped(log, CELL_M, gps=True)
    run = aided.dense
    image = [run.scans.scan(k, pose).point for k, pose in enumerate(run.scan_pose)]
    time_s = fine.dense.scan_time_s
    wheels = dead_reckoned(log.prior.pose, motion_between(log, time_s).displacement)[1:]
    landmark = fine.ekf.estimate.landmark
    beacon = np.full_like(landmark, np.nan)
    ours, theirs = match_by_distance(landmark, known.position_m)
    beacon[ours] = known.position_m[theirs]
    return CarPark(
        log=f"{log.name}, {log.duration_s:.0f} s, another part of the drives than the thesis'",
        fine=fine,
        coarse=coarse,
        aided_path=run.scan_pose[:, :2],
        image=np.vstack(image),
        wheels=wheels[:, :2],
        gps=positions.position_m,
        path_gps=off_gps(log, time_s, fine.dense.scan_pose),
        aided_gps=off_gps(log, run.scan_time_s, run.scan_pose),
        wheels_gps=off_gps(log, time_s, wheels),
        beacon=beacon,
        searched=_searched(coarse, COARSE_M),
        searched_fine=_searched(fine, CELL_M),
    )


def _mapped(log: Log, cell_m: float, *, gps: bool = False) -> DenseMapping:
    maps = DenseMapsConfig(
        layers=("points", "occupancy", "sog"), resolution_m=cell_m, d_min_m=cell_m
    )
    ekf = EkfConfig(gps="on" if gps else "off")
    return map_log(log, MapConfig(ekf=ekf, extensions={"dense_maps": maps}))


def off_gps(log: Log, time_s: Array, pose: Array) -> Array:
    """(G,) distances of a path to GPS at its times. Raises InputError for a log without."""
    fixes = log.positions
    if fixes is None:
        raise InputError(f"{log.name}: holds no positions")
    inside = (fixes.time_s >= time_s[0]) & (fixes.time_s <= time_s[-1])
    at = [np.interp(fixes.time_s[inside], time_s, pose[:, k]) for k in (0, 1)]
    away: Array = np.linalg.norm(np.column_stack(at) - fixes.position_m[inside], axis=1)
    return away


def _searched(mapping: DenseMapping, cell_m: float) -> Search:
    layers = mapping.dense.dense.layers
    gaussians = layers["sog"]
    if not isinstance(gaussians, Gaussians):
        raise TypeError(f"{type(gaussians).__name__} is no sum of Gaussians")
    pose, landmark = mapping.ekf.departed[-1], mapping.dense.landmark
    around = Around(layers["occupancy"], gaussians, mapping.placed, pose, landmark)
    options = SearchOptions(reach_m=_WHOLE_MAP_M, cell_m=cell_m, pair_m=PAIR_M, least=LEAST)
    return search(around, np.empty((0, 4, 2)), options)


def occupied(samples: Samples) -> Array:
    """(N, 2) what a layer holds with a probability above 0.8."""
    point: Array = samples.point[samples.occupancy > OCCUPIED]
    return point


def claims_3_20(found: CarPark) -> list[Claim]:
    """The path, the landmarks and their ellipses."""
    known = np.isfinite(found.beacon[:, 0])
    error = (found.landmark - found.beacon)[known]
    blocks = found.blocks
    squared = np.einsum(
        "qi,qi->q", error, np.linalg.solve(blocks[known], error[:, :, None])[:, :, 0]
    )
    sigma = np.sqrt(np.trace(blocks, axis1=1, axis2=2))
    far = np.linalg.norm(found.landmark - found.aided_path[0], axis=1)
    farther = far > np.median(far)
    return [
        at_most(
            "SLAM stays closer to GPS than dead reckoning (RMS distance, over that of the wheels)",
            _rms(found.path_gps) / _rms(found.wheels_gps),
            0.5,
            why="the last 15 s, without a reflector in view, are dead reckoning in both",
        ),
        at_most(
            "where landmarks are in view it is close to GPS (median distance)",
            float(np.median(found.path_gps)),
            0.5,
            "m",
        ),
        at_least(
            "the landmarks' surveyed places are within the 3-sigma ellipses (share)",
            float(np.mean(squared <= THREE_SIGMA_SQUARED)),
            SHARE_WITHIN_3_SIGMA,
        ),
        at_least(
            "landmarks far from the start are the most uncertain (mean sigma of the farther half "
            "over that of the nearer)",
            float(sigma[farther].mean() / sigma[~farther].mean()),
            1.0,
        ),
    ]


def claims_3_22(found: CarPark) -> list[Claim]:
    """The final map beside the laser image."""
    regions = found.fine.dense.dense.regions
    away = found.off(found.fine.layers["points"].point)
    return [
        at_most(
            "the dense map lies on the laser image (median distance of its points)",
            float(np.median(away)),
            CELL_M,
            "m",
        ),
        at_most(
            "all of it does (95 % of the distances)",
            float(np.percentile(away, 95.0)),
            CELL_M,
            "m",
            why=_LAST,
        ),
        at_least(
            "virtual landmarks were needed (regions with one)",
            int(np.count_nonzero((regions.base < 0).any(axis=1))),
            1,
        ),
    ]


def claims_3_23(found: CarPark) -> list[Claim]:
    """The closing, by points."""
    return _closing_claims(found, "points")


def claims_4_14(found: CarPark) -> list[Claim]:
    """The closing, by cells; and how they compare with raw points."""
    cells, points = (
        float(np.median(found.off(occupied(found.fine.layers[name]))))
        for name in ("occupancy", "points")
    )
    return [
        *_closing_claims(found, "occupancy"),
        at_most(
            "the grid is as accurate as the raw observations (median distance to the laser image, "
            "difference; limit: a cell)",
            abs(cells - points),
            CELL_M,
            "m",
        ),
    ]


def _closing_claims(found: CarPark, layer: str) -> list[Claim]:
    """Of the map as it was, against the laser image, and of its landmarks, against the survey."""
    b = found.before
    then = found.off(occupied(b.layers[layer]))
    known = np.flatnonzero(np.isfinite(found.beacon[: len(b.landmark), 0]))
    true = found.beacon[known]
    off = [_rms(np.linalg.norm(x[known] - true, axis=1)) for x in (b.landmark, found.landmark)]
    return [
        at_least(
            "before the loop closes the map is visibly off (95 % of its distances to the laser "
            "image)",
            float(np.percentile(then, 95.0)),
            ERROR_BEFORE_M,
            "m",
            why=f"{OTHER_PART}: in a loop of 60 m only {b.shift_m:.2f} m of error come together",
        ),
        at_most(
            "closing the loop corrects the map (RMS distance of its landmarks to the surveyed "
            "ones, in the end over before)",
            off[1] / off[0],
            1.0,
        ),
        at_most(
            "by a large part (the same)",
            off[1] / off[0],
            0.5,
            why=f"from {off[0]:.2f} m to {off[1]:.2f} m",
        ),
    ]


def claims_4_15(found: CarPark) -> list[Claim]:
    """The final grid with cells of 0.4 m."""
    return [_near_image(found, "the grid's occupied cells", "occupancy", found.fine, CELL_M)]


def _near_image(
    found: CarPark, what: str, layer: str, mapping: DenseMapping, limit_m: float
) -> Claim:
    return at_most(
        f"{what} lie on the laser image (median distance; limit: a cell)",
        float(np.median(found.off(occupied(mapping.layers[layer])))),
        limit_m,
        "m",
    )


def placed_template(one: Found) -> Array:
    """(N, 2) points [m] of a high level landmark's template."""
    return to_world(one.place, one.template.shape.mean)


def claims_6_1(found: CarPark) -> list[Claim]:
    """Corners of the grid of 0.4 m."""
    return _corner_claims(found.searched_fine.corner, found.fine, CELL_M)


def claims_6_17(found: CarPark) -> list[Claim]:
    """Corners of the grid of 0.5 m."""
    return _corner_claims(found.searched.corner, found.coarse, COARSE_M)


def _corner_claims(corner: Array, mapping: DenseMapping, cell_m: float) -> list[Claim]:
    held = occupied(mapping.layers["occupancy"])
    away = cKDTree(held).query(corner)[0] if len(corner) else np.array([np.nan])
    return [
        at_least("corners are found in the grid that no single scan shows", len(corner), 2),
        at_most(
            "they are corners of what stands there (largest distance to an occupied cell; limit: "
            "two cells)",
            float(away.max()),
            2.0 * cell_m,
            "m",
        ),
    ]


def claims_6_11(found: CarPark) -> list[Claim]:
    """SLAM with GPS, of which the laser image is made."""
    return [
        at_most(
            "SLAM combined with GPS follows GPS (median distance)",
            float(np.median(found.aided_gps)),
            0.1,
            "m",
        ),
    ]


def claims_6_12(found: CarPark) -> list[Claim]:
    """Raw observations."""
    return [_near_image(found, "raw observations", "points", found.coarse, COARSE_M)]


def claims_6_13(found: CarPark) -> list[Claim]:
    """The grid with cells of 0.5 m."""
    return [_near_image(found, "the grid's occupied cells", "occupancy", found.coarse, COARSE_M)]


def claims_6_14(found: CarPark) -> list[Claim]:
    """Gaussians."""
    return [_near_image(found, "the Gaussians' means", "sog", found.coarse, COARSE_M)]


def claims_6_15(found: CarPark) -> list[Claim]:
    """The surface of the sum."""
    surface = found.surface
    high = surface.point[surface.occupancy > 0.5]
    return [
        at_most(
            "the sum of Gaussians is high where the laser image is (95 % of the distances of what "
            "is above half a peak; limit: two cells)",
            float(np.percentile(found.off(high), 95.0)) if len(high) else np.nan,
            2.0 * COARSE_M,
            "m",
            why=_LAST,
        )
    ]


def claims_6_16(found: CarPark) -> list[Claim]:
    """Three layers of one run."""
    layers = found.coarse.layers
    grid = cKDTree(occupied(layers["occupancy"]))
    return [
        at_most(
            f"{name} and the grid show the same surfaces (median distance to an occupied cell; "
            "limit: two cells)",
            float(np.median(grid.query(occupied(layers[key]))[0])),
            2.0 * COARSE_M,
            "m",
        )
        for name, key in (("raw observations", "points"), ("Gaussians", "sog"))
    ]


def claims_6_18(found: CarPark) -> list[Claim]:
    """High level landmarks."""
    s = found.searched
    return [
        at_least("pairs of corners up to 7 m apart are found", len(s.candidate) + s.known, 1),
        at_least(
            f"nine are accepted as high level landmarks (with at least {LEAST} Gaussians each)",
            len(s.found),
            HIGH_LEVEL_COUNT,
            why=f"{OTHER_PART}, and holds {len(found.ellipses.mean)} Gaussians in all; how many a "
            "landmark must have is not stated",
        ),
    ]


def _rms(distance: Array) -> float:
    return float(np.sqrt(np.mean(np.square(distance))))


CAR_PARK = Experiment("the car park, dense maps", car_park, FOLDER)
