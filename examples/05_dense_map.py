"""DenseSLAM on a page: what a scanner sees is kept between landmarks, and moves with them.

A vehicle drives around a block and drifts; when it meets its first landmarks again, the filter
moves the map. Points in local triangular regions (Nieto 2005, chapter 3) move along; points placed
once, from the pose of their time, stay wrong.

python examples/05_dense_map.py [FIGURE.png]
"""

import math
import sys

import numpy as np

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array
from ekf_reference.dense.conditions import Conditions
from ekf_reference.dense.dense_map import DenseMap
from ekf_reference.dense.layers.points import AllReturns
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.scan import Scan, ScanSensor
from ekf_reference.dense.view import FilterView
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.range_bearing import RangeBearing

SIDE_M, SPEED_MPS, STEP_S, REACH_M, RADIUS_M = 60.0, 1.0, 1.0, 14.0, 0.5
SIGMA = np.array((0.05, math.radians(0.5)))  # range [m], bearing [rad]
SIGMA_CONTROL = np.array((0.02, math.radians(0.8)))  # speed [m/s], yaw rate [rad/s]
SENSOR = ScanSensor(float(SIGMA[0]), float(SIGMA[1]), beam_rad=math.radians(1.0))


def main(figure: str | None = None) -> dict[str, float]:
    """Return the root mean square distance [m] of the points from true surfaces, for both maps."""
    rng = np.random.default_rng(4)
    along = np.arange(0.0, 4.0 * SIDE_M, 8.0)
    landmarks = np.vstack([around(s, off) for s in along for off in (-5.0, 5.0)])
    objects = np.vstack([around(s + 4.0, off) for s in along for off in (-3.0, 3.0)])
    motion, sensor = UnicycleModel(), RangeBearing()
    ekf = Ekf(motion, KnownAssociation(), np.zeros(3), np.diag((1e-4, 1e-4, 1e-6)))
    regions = LocalRegions(conditions=Conditions(known_apart_m=0.5))
    dense, fixed, pose = DenseMap(layers={"points": AllReturns()}, regions=regions), [], np.zeros(3)
    turn = [math.radians(90.0) if k % 60 == 59 else 0.0 for k in range(4 * 60 + 20)]
    for k, yaw in enumerate(turn):
        control = np.array((0.0 if yaw else SPEED_MPS, yaw))
        pose = motion.step(pose, control, STEP_S).pose
        measured = control + SIGMA_CONTROL * rng.standard_normal(2)
        ekf.predict(measured, np.diag(SIGMA_CONTROL**2), STEP_S)
        dense.predicted(FilterView.of(ekf))
        z = sensor.predict(pose, landmarks).z
        label = np.flatnonzero(z[:, 0] < REACH_M)
        z = z[label] + SIGMA * rng.standard_normal((len(label), 2))
        ekf.observe(z, np.tile(SIGMA, (len(z), 1)), label)
        view = FilterView.of(ekf)
        dense.updated(view)
        bearing, distance = scan(pose, objects, rng)
        seen = Scan.of_ranges(view.pose, bearing, distance, SENSOR)
        dense.insert(view, seen, k * STEP_S)
        fixed.append(seen.point)

    moved = dense.layers["points"].samples(dense.place(FilterView.of(ekf))).point
    maps = {"in regions": moved, "placed once": np.concatenate(fixed)}
    errors = {name: off_surface(point, objects) for name, point in maps.items()}
    for name, error in errors.items():
        print(f"{len(maps[name]):,} points {name}: {error:.3f} m off the surfaces (rms)")
    if figure:
        plot(figure, maps, objects, landmarks)
    return errors


def around(along_m: float, off_m: float) -> Array:
    """Return the place (2,) beside the block's road, off to the left."""
    side, s = divmod(along_m, SIDE_M)
    heading = 0.5 * math.pi * (side % 4)
    corner = SIDE_M * np.array(((0, 0), (1, 0), (1, 1), (0, 1)))[int(side) % 4]
    ahead = np.array((math.cos(heading), math.sin(heading)))
    place: Array = corner + s * ahead + off_m * np.array((-ahead[1], ahead[0]))
    return place


def scan(pose: Array, objects: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return bearings and noisy ranges (B,) of the nearest circles; NaN for no return."""
    bearing = np.radians(np.arange(-180.0, 180.0))
    ray = np.column_stack((np.cos(bearing + pose[2]), np.sin(bearing + pose[2])))
    centre = objects - pose[:2]
    ahead = ray @ centre.T
    inside = RADIUS_M**2 - (np.sum(centre**2, axis=1) - ahead**2)
    distance = np.where((inside > 0) & (ahead > 0), ahead - np.sqrt(np.maximum(inside, 0)), np.inf)
    nearest = distance.min(axis=1)
    noisy = nearest + SIGMA[0] * rng.standard_normal(len(bearing))
    return bearing, np.where(nearest < REACH_M, noisy, np.nan)


def off_surface(point: Array, objects: Array) -> float:
    """Return the root mean square distance [m] of points (N, 2) from the nearest circle's line."""
    away = np.linalg.norm(point[:, None] - objects[None], axis=2).min(axis=1) - RADIUS_M
    return float(np.sqrt(np.mean(away**2)))


def plot(figure: str, maps: dict[str, Array], objects: Array, landmarks: Array) -> None:
    """Draw both maps."""
    import matplotlib.pyplot as plt
    from matplotlib.patches import Circle

    _, axes = plt.subplots(1, 2, figsize=(12, 6), sharex=True, sharey=True)
    for ax, (name, point) in zip(axes, maps.items(), strict=True):
        for centre in objects:
            ax.add_patch(Circle((centre[0], centre[1]), RADIUS_M, fill=False, color="k", lw=0.5))
        ax.plot(*landmarks.T, "k^", ms=3)
        ax.plot(*point.T, ".", ms=1, color="tab:blue")
        ax.set(xlabel="x [m]", title=f"points {name}", aspect="equal")
    axes[0].set_ylabel("y [m]")
    plt.savefig(figure, dpi=110, bbox_inches="tight")
    plt.close()


if __name__ == "__main__":
    main(*sys.argv[1:2])
