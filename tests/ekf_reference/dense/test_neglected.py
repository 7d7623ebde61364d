import math
from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pytest

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.neglected_correlation import (
    Carriers,
    NeglectedCorrelation,
    neglected_covariance,
)
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.triangles import axes, local_jacobians
from ekf_reference.dense.view import FilterView
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.numerics import relative_error
from tests.ekf_reference.worlds import circuit, follow


@cache
def seen() -> tuple[FilterView, Index]:
    """A filter in the midst of a drive, and the regions around."""
    ekf = next(islice(follow(circuit(0, range_m=25.0)), 300, None))[1]
    view, regions = FilterView.of(ekf), LocalRegions()
    near = view.near(30.0)
    regions.extend(view.landmark, near, view.joint(near)[3:, 3:])
    return view, regions.base


def over(base: Index) -> NeglectedCorrelation:
    return NeglectedCorrelation(LocalRegions(base=base))


def carriers_of(view: FilterView, base: Index, point: Array) -> Carriers:
    return over(base).carriers(view, np.arange(len(base)), point)


def centres() -> tuple[FilterView, Index, Array]:
    view, base = seen()
    assert len(base) > 5
    return view, base, view.landmark[base].mean(axis=1) + (0.7, -0.4)


def test_it_is_the_covariance_of_alpha_and_beta_in_metres() -> None:
    """J P J^T by the Jacobians of Appendix C and of the measurement, one region after another."""
    view, base, point = centres()
    found = neglected_covariance(view, carriers_of(view, base, point), point)
    for landmark_index, at, spread in zip(base, point, found, strict=True):
        triangle = view.landmark[landmark_index]
        h = local_jacobians(triangle, at)
        offset = at - view.pose[:2]
        bearing = math.atan2(offset[1], offset[0]) - view.pose[2]
        z = np.array([(np.linalg.norm(offset), bearing)])
        by_pose = RangeBearing().invert(view.pose, z).jacobian_pose[0]
        order = np.argsort(landmark_index)
        columns = np.concatenate(
            (np.arange(3), (3 + 2 * order.argsort()[:, None] + (0, 1)).ravel())
        )
        joint = view.joint(landmark_index[order])[np.ix_(columns, columns)]
        j = np.hstack((h.by_point @ by_pose, h.by_landmarks))
        a, b = axes(triangle)
        metres = np.column_stack((a, b))
        assert relative_error(spread, metres @ (j @ joint @ j.T) @ metres.T) < 1e-9


@pytest.mark.parametrize("left_out", ["pose", "landmarks", "cross"])
def test_every_part_of_the_joint_covariance_counts(left_out: str) -> None:
    """Most of what pose and landmarks doubt, they doubt together."""
    view, base, point = centres()
    carriers = carriers_of(view, base, point)
    part = view.covariance.copy()
    if left_out == "pose":
        part[:3] = part[:, :3] = 0.0
    elif left_out == "landmarks":
        part[3:] = part[:, 3:] = 0.0
    else:
        part[:3, 3:] = part[3:, :3] = 0.0
    whole = neglected_covariance(view, carriers, point)
    broken = neglected_covariance(replace(view, covariance=part), carriers, point)
    assert (np.trace(broken, axis1=1, axis2=2) > 3.0 * np.trace(whole, axis1=1, axis2=2)).all()


def test_a_region_keeps_its_largest_and_its_mean_over_points() -> None:
    view, base, point = centres()
    layer, both = over(base), np.array([1, 3])
    first = layer.note(view, both, point[both], np.array([2.0, 1.0]))
    doubtful = replace(view, covariance=4.0 * view.covariance)
    second = layer.note(doubtful, both[:1], point[both[:1]], np.array([6.0]))
    assert np.isclose(second[0], 2.0 * first[0])
    assert np.isclose(layer.sigma_m(both), ((2 * first[0] + 6 * second[0]) / 8, first[1])).all()
    assert np.isclose(layer.largest_m[both], (second[0], first[1])).all()
    assert np.isnan(layer.sigma_m(np.array([0, len(base)]))).all()
    assert np.array_equal(layer.count[:4], (0, 8, 0, 1))


def test_the_worst_direction_is_the_larger_eigenvalue() -> None:
    view, base, point = centres()
    sigma = over(base).note(view, np.arange(len(base)), point)
    spread = neglected_covariance(view, carriers_of(view, base, point), point)
    assert np.allclose(np.square(sigma), np.linalg.eigvalsh(spread)[:, 1], rtol=1e-9)


def test_a_region_whose_covariance_is_not_current_is_left_alone() -> None:
    view, base, point = centres()
    lost = int(base[0, 1])
    kept = np.delete(view.landmark_index, np.searchsorted(view.landmark_index, lost))
    part = replace(view, landmark_index=kept, covariance=view.joint(kept))
    layer = over(base)
    sigma = layer.note(part, np.arange(len(base)), point)
    touched = (base == lost).any(axis=1)
    assert np.array_equal(np.isnan(sigma), touched)
    assert np.array_equal(np.isnan(layer.sigma_m(np.arange(len(base)))), touched)
    assert np.allclose(sigma[~touched], over(base).note(
        view, np.flatnonzero(~touched), point[~touched]))  # fmt: skip
    nothing = replace(view, landmark_index=kept[:0], covariance=view.covariance[:3, :3])
    assert np.isnan(layer.note(nothing, np.arange(2), point[:2])).all()
    assert len(layer.sigma_now(view, np.arange(0), point[:0])) == 0


def test_corners_may_be_linear_functions_of_landmarks() -> None:
    """A landmark may come twice among the carriers, which sums its shares."""
    view, base, point = centres()
    landmark_index, share = carriers_of(view, base, point)
    other = np.roll(base[:, 0], 1)
    half = np.concatenate((0.5 * share[:, :, :2], share[:, :, 2:], 0.5 * share[:, :, :2]), axis=2)
    split = Carriers(np.column_stack((landmark_index, landmark_index[:, 0])), half)
    whole = neglected_covariance(view, Carriers(landmark_index, share), point)
    assert np.allclose(neglected_covariance(view, split, point), whole, atol=1e-12)
    moved = Carriers(np.column_stack((landmark_index, other)), half)
    assert np.trace(neglected_covariance(view, moved, point), axis1=1, axis2=2).max() > 0.0
