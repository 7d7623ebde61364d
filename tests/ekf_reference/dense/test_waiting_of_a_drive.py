"""Observations that wait as the filter drives a loop (Nieto 2005, section 3.7.3)."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array
from ekf_reference.dense.delayed_initialisation import DelayedCounts, DelayedInitialisation
from ekf_reference.dense.local_pose import Frames
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.triangles import axes, solve
from ekf_reference.dense.view import FilterView
from ekf_reference.filters.compressed import CompressedEkf
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.dense.waiting_rooms import anywhere
from tests.ekf_reference.worlds import build, circuit, follow


def dense_measurements(
    rng: np.random.Generator, true_pose: Array, pose: Array, count: int
) -> tuple[Array, Array, Array]:
    """Points seen once by a precise sensor, 3 to 20 m ahead, and by nobody else.

    Returns where they are (count, 2), where the estimated pose (3,) puts them (count, 2), and the
    sensor's covariance there (count, 2, 2).
    """
    z = rng.uniform((3.0, -1.5), (20.0, 1.5), (count, 2))
    sigma = np.array((0.03, 0.002))
    true = RangeBearing().invert(true_pose, z).landmark
    seen = RangeBearing().invert(pose, z + sigma * rng.standard_normal(z.shape))
    j = seen.jacobian_z
    return true, seen.landmark, j @ np.diag(sigma**2) @ j.transpose(0, 2, 1)


def newest_pair(view: FilterView) -> tuple[int, int] | None:
    """The last landmark of the map and the nearest of the others, 5 m apart at least."""
    last = len(view.landmark) - 1
    apart = np.linalg.norm(view.landmark[:last] - view.landmark[last:], axis=1)
    apart[apart < 5.0] = np.inf
    if last < 1 or apart.min() > 25.0:
        return None
    return int(apart.argmin()), last


class Driven(NamedTuple):
    """What a whole drive with regions left.

    mean, covariance: the filter's. regions, counts: of the drive. error: (k, 2) [m]
    of released points within their true regions, and of the same without correction.
    """

    mean: Array
    covariance: Array
    regions: LocalRegions
    counts: DelayedCounts
    error: Array


@cache
def driven(*, dense: bool) -> Driven:
    """As dense mapping will do it: regions, virtual ones, what lies in none waits."""
    drive = circuit(0, 60.0, range_m=25.0)
    landmark, rng = drive.met, np.random.default_rng(7)
    room, regions = DelayedInitialisation(patience=40), LocalRegions()
    offered: dict[int, tuple[Array, Array, Array]] = {}
    errors: list[Array] = [np.empty((0, 2))]

    def predicted(ekf: Ekf) -> None:
        if dense:
            room.predicted(FilterView.of(ekf))

    for scan, (done, ekf) in enumerate(follow(drive, predicted=predicted)):
        if not dense:
            continue
        view = FilterView.of(ekf)
        room.updated(view)
        landmark_index = view.near(30.0)
        joint = view.joint(landmark_index)
        regions.extend(view.landmark, landmark_index, joint[3:, 3:])
        overdue = room.overdue(view, scan)
        regions.extend_virtual(view.landmark, landmark_index, view.pose, joint, overdue, 5)
        placed = regions.placed(view.landmark)
        out = room.release(view, placed)
        corner = regions.corners(landmark)[regions.base]
        for region, point, number in zip(out.region, out.point, out.number, strict=True):
            axis, first, true = offered[int(number)]
            uncorrected = Frames.of(*view.landmark[axis]).to_world(first)
            side = np.stack(axes(corner[region]), axis=1)
            off = [
                np.linalg.norm(
                    side @ (solve(placed.triangle[region], p) - solve(corner[region], true))
                )
                for p in (point, uncorrected)
            ]
            errors.append(np.array([off]))
        true, point, noise = dense_measurements(rng, drive.pose[done], view.pose, 10)
        outside = placed.locate(point).region < 0
        true, point, noise = true[outside], point[outside], noise[outside]
        potential = regions.potential(view.landmark, landmark_index, view.pose, joint)
        number = room.add(view, point, noise, scan, potential)
        for row in np.flatnonzero(np.isin(room.points.number, number)):
            k = int(room.points.number[row])
            place = room.points.point[row].copy()
            axis = room.axis[room.points.group[row]]
            offered[k] = axis, place, true[int(np.flatnonzero(number == k)[0])]
    state = ekf.state
    return Driven(
        state.mean.copy(), state.covariance.copy(), regions, room.counts, np.concatenate(errors)
    )


@pytest.mark.slow
def test_the_filter_does_not_notice() -> None:
    """Unidirectional information flow (section 3.7), virtual landmarks included: to the bit."""
    with_maps, alone = driven(dense=True), driven(dense=False)
    assert len(with_maps.regions.virtual.depth) > 3
    assert np.array_equal(with_maps.mean, alone.mean)
    assert np.array_equal(with_maps.covariance, alone.covariance)


@pytest.mark.slow
def test_what_waited_is_fused_and_nearer_to_its_place() -> None:
    """Also where the regions are the thesis' own, which come up when little is left to learn."""
    found = driven(dense=True)
    assert found.counts.released == len(found.error) > 300
    assert found.counts.vanished == 0
    corrected, uncorrected = np.sqrt(np.square(found.error).mean(axis=0))
    assert corrected < 0.9 * uncorrected


def waiting_points(make: type[Ekf]) -> tuple[DelayedInitialisation, Array]:
    """Points taken in on the way, never released, and where the filter ends up."""
    drive, rng, room = circuit(0, 40.0), np.random.default_rng(3), DelayedInitialisation()

    def predicted(ekf: Ekf) -> None:
        room.predicted(FilterView.of(ekf))

    for done, ekf in follow(drive, build(make), predicted):
        view = FilterView.of(ekf)
        room.updated(view)
        pair = newest_pair(view)
        if pair is not None:
            _, point, noise = dense_measurements(rng, drive.pose[done], view.pose, 3)
            room.add(view, point, noise, len(room.points.scan), anywhere(pair))
    return room, ekf.state.landmarks.ravel()


@pytest.mark.slow
def test_a_compressed_filter_tells_them_the_same() -> None:
    """As long as their landmarks are active; after that they stay as they are."""
    full, expected = waiting_points(Ekf)
    compressed, landmark = waiting_points(CompressedEkf)
    assert np.allclose(landmark, expected, atol=1e-9)
    assert np.array_equal(full.points.number, compressed.points.number)
    coupled = compressed.points.cross.any(axis=(1, 2))
    assert full.points.cross.any(axis=(1, 2)).all()
    assert 0 < np.count_nonzero(coupled) < len(compressed.points.scan)
    assert np.allclose(full.points.point[coupled], compressed.points.point[coupled], atol=1e-7)
    assert (full.points.variance <= compressed.points.variance + 1e-9).all()
