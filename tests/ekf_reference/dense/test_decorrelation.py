"""Examples 3.1 and 3.2 of the thesis on a drive like that of its section 2.9."""

from dataclasses import replace
from functools import cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.core.state import KalmanState
from ekf_reference.dense.conditions import Conditions, coordinate_correlation
from ekf_reference.dense.decorrelation import (
    Displacements,
    correlations,
    displacements,
    local_cross_covariance,
    passive_change,
)
from ekf_reference.dense.triangles import contains, is_degenerate, local_covariance, to_local
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.dense.test_triangles import random_triangles
from tests.ekf_reference.numerics import point_columns, random_covariance, relative_error
from tests.ekf_reference.worlds import LOOP_S, STEP_S, Scan, circuit, follow

POINT, BASE, DISTANT = 34, (33, 35, 38), 32
"""Landmarks in the order in which the filter meets them: a point within its triangle, and one
17 m away."""
FUSED = round(52.0 / STEP_S)
"""Steps after which the point is not measured any more, as a dense one."""
CLOSING = round(78.0 / STEP_S)
"""Steps after which the start of the loop comes into view again."""


class Snapshot(NamedTuple):
    """The filter after some steps. landmark: (L, 2). covariance: (n, n), the pose first."""

    step: int
    landmark: Array
    covariance: Array

    def among(self, *landmark_index: int) -> Array:
        """(2 k, 2 k) covariance of k landmarks, in this order."""
        columns = point_columns(np.array(landmark_index))[3:]
        return self.covariance[np.ix_(columns, columns)]

    @property
    def triangle(self) -> Array:
        """(3, 2) the base."""
        return self.landmark[list(BASE)]


@cache
def seen(seed: int) -> list[Snapshot]:
    """The filter after every scan from when the point has got its last look."""
    drive = circuit(seed, LOOP_S + 10.0, range_m=25.0)
    order: dict[int, None] = dict.fromkeys(np.concatenate([s.label for s in drive.scan]).tolist())
    point, shots = list(order)[POINT], []
    scans = tuple(
        scan if scan.step <= FUSED else Scan(scan.step, scan.z[keep], scan.label[keep])
        for scan in drive.scan
        for keep in [scan.label != point]
    )
    for step, ekf in follow(replace(drive, scan=scans)):
        if step >= FUSED:
            shots.append(Snapshot(step, ekf.state.landmarks.copy(), ekf.state.covariance.copy()))
    return shots


def fused() -> Snapshot:
    return seen(0)[0]


def moved(seed: int) -> Displacements:
    """Of the point, in the world and in its triangle, since it was fused."""
    shots = seen(seed)
    triangle = np.stack([now.triangle for now in shots])
    point = np.stack([now.landmark[POINT] for now in shots])
    return displacements(triangle[0], point[0], triangle, point)


@pytest.mark.parametrize("seed", range(6))
def test_example_3_1_correlation_falls_from_above_095_to_below_01(seed: int) -> None:
    """From when the point is fused until the loop closes, as in Fig. 3.5 (b), (c) and (d)."""
    before = [now for now in seen(seed) if now.step <= CLOSING]
    assert len(before) > 100
    for now in before:
        joint = now.among(DISTANT, *BASE, POINT)
        found = correlations(now.triangle, now.landmark[POINT], joint)
        assert np.diag(found.world).min() > 0.95
        assert found.local.max() < 0.1
        assert (found.sigma_local_m < 0.2 * found.sigma_world_m).all()
        sigma = np.sqrt(np.diag(joint))
        rho = np.abs(joint) / np.outer(sigma, sigma)
        assert min(rho[2 * i + axis, 8 + axis] for i in (1, 2, 3) for axis in (0, 1)) > 0.9


@pytest.mark.slow
def test_example_3_1_holds_for_every_landmark_within_a_correlated_triangle() -> None:
    now = fused()
    near = np.flatnonzero(np.linalg.norm(now.landmark - now.landmark[POINT], axis=1) < 25.0)
    alike = coordinate_correlation(now.among(*near)) >= 0.9
    found = []
    for triple in combinations(range(len(near)), 3):
        base = near[list(triple)]
        triangle = now.landmark[base]
        if not alike[np.ix_(triple, triple)].all() or is_degenerate(triangle):
            continue
        others = np.setdiff1d(np.arange(len(now.landmark)), base)
        for i in others[contains(to_local(triangle, now.landmark[others]))]:
            for j in others[np.linalg.norm(now.landmark[others] - now.landmark[i], axis=1) > 15]:
                rho = correlations(triangle, now.landmark[i], now.among(j, *base, i))
                if np.diag(rho.world).min() > 0.95:
                    found.append(rho.local.max())
    assert len(found) > 50
    assert max(found) < 0.1


@pytest.mark.parametrize("dropped", ["with_landmarks", "with_point"])
def test_half_of_equation_3_5_does_not_decorrelate(dropped: str) -> None:
    now = fused()
    covariance = now.among(DISTANT, *BASE, POINT)
    triangle, point = now.triangle, now.landmark[POINT]
    terms = {"with_landmarks": covariance[:2, 2:8], "with_point": covariance[:2, 8:]}
    terms[dropped] = np.zeros_like(terms[dropped])
    cross = local_cross_covariance(triangle, point, **terms)
    own = np.diag(local_covariance(triangle, point, covariance[2:, 2:]))
    assert (np.abs(cross) / np.sqrt(np.outer(np.diag(covariance)[:2], own))).max() > 0.5


@pytest.mark.parametrize("seed", range(6))
def test_example_3_2_local_change_is_at_most_a_fifth_of_the_global_one(seed: int) -> None:
    """At the closing of the loop; the thesis shows 0.1 m against 0.5 m."""
    change = moved(seed)
    assert change.world_m.max() > 0.2
    assert change.local_m.max() < 0.2 * change.world_m.max()
    assert change.local_m.max() < 0.1


def test_the_example_is_of_a_point_within_its_triangle_that_is_never_seen_again() -> None:
    now = fused()
    point, joint = now.landmark[POINT], now.among(*BASE)
    assert contains(to_local(now.triangle, point))
    assert Conditions().pairs(now.triangle, joint)[np.triu_indices(3, 1)].all()
    assert Conditions().well_conditioned(now.triangle[None], joint[None]).all()
    assert np.linalg.norm(now.landmark[DISTANT] - point) > 10.0


def test_displacement_is_zero_under_a_common_motion_and_in_metres_otherwise() -> None:
    triangle = np.array([(0.0, 0.0), (20.0, 0.0), (5.0, 15.0)])
    point, shift = np.array((6.0, 4.0)), np.array((1.5, -2.0))
    moved = displacements(triangle, point, triangle + shift, point + shift)
    assert np.allclose((moved.world_m, moved.local_m), (2.5, 0.0), atol=1e-12)
    moved = displacements(triangle, point, triangle, point + shift)
    assert np.allclose((moved.world_m, moved.local_m), 2.5)


NOISE = np.diag((0.1, 1e-3))


def seen_once(rng: np.random.Generator) -> KalmanState:
    """Five landmarks, all initialised at one pose."""
    state = KalmanState(np.array((1.0, 2.0, 0.4)), 1e-2 * random_covariance(rng, 3))
    z = np.column_stack((rng.uniform(5, 20, 5), rng.uniform(-2, 2, 5)))
    new = RangeBearing().invert(state.pose, z)
    spread = np.broadcast_to(NOISE, (5, 2, 2))
    state.augment(new, spread)
    return state


def measured(state: KalmanState, landmark_index: int) -> Array:
    """Jacobian (2, 5) of a measurement by the pose and the landmark."""
    predicted = RangeBearing().predict(state.pose, state.landmarks[[landmark_index]])
    return np.hstack((predicted.jacobian_pose[0], predicted.jacobian_landmark[0]))


def observed(rng: np.random.Generator) -> tuple[KalmanState, Array, Array, Array]:
    """Landmarks seen from two places; Jacobian, S and innovation of a measurement of the first."""
    state = seen_once(rng)
    state.predict(state.pose + (3.0, 1.0, 0.2), np.eye(3), np.diag((0.2, 0.3, 0.01)))
    for landmark_index in range(1, 5):
        columns = point_columns(np.array([landmark_index]))
        state.update(columns, measured(state, landmark_index), 0.1 * rng.standard_normal(2), NOISE)
    jacobian = measured(state, 0)
    spread = jacobian @ state.covariance[:5, :5] @ jacobian.T + NOISE
    return state, jacobian, spread, np.array((0.3, -0.02))


@pytest.mark.parametrize("seed", range(3))
def test_passive_change_is_what_the_filter_does(seed: int) -> None:
    """And what 3.16 spells out; 3.12 as printed, P grad h S^-1 nu, has no product."""
    state, jacobian, spread, innovation = observed(np.random.default_rng(seed))
    before, covariance = state.mean.copy(), state.covariance.copy()
    change = passive_change(covariance[5:, :5], jacobian, spread, innovation)
    p_jv, p_ji, s = covariance[5:, :3], covariance[5:, 3:5], np.linalg.inv(spread)
    spelt = (p_jv @ jacobian[0, :3] + p_ji @ jacobian[0, 3:]) * (s[0] @ innovation) + (
        p_jv @ jacobian[1, :3] + p_ji @ jacobian[1, 3:]
    ) * (s[1] @ innovation)
    assert relative_error(change, spelt) < 1e-10
    state.update(np.arange(5), jacobian, innovation, NOISE)
    assert relative_error(change, (state.mean - before)[5:]) < 1e-9
    with pytest.raises(ValueError, match="mismatch"):
        covariance[5:, :5] @ jacobian


@pytest.mark.parametrize("seed", range(3))
def test_passive_change_of_local_coordinates(seed: int) -> None:
    """To first order it is how far the update moves a landmark within its triangle."""
    rng = np.random.default_rng(seed)
    _, jacobian, spread, innovation = observed(rng)
    covariance, innovation = random_covariance(rng, 13), 1e-5 * innovation
    triangle, point = random_triangles(rng, 1)[0], rng.uniform(-40, 40, 2)
    cross = local_cross_covariance(triangle, point, covariance[:5, 5:11], covariance[:5, 11:])
    change = passive_change(cross.T, jacobian, spread, innovation)
    shift = passive_change(covariance[:, :5], jacobian, spread, innovation)[5:].reshape(4, 2)
    after = to_local(triangle + shift[:3], point + shift[3])
    assert relative_error(change, after - to_local(triangle, point)) < 1e-3


def test_what_is_seen_from_one_pose_has_no_local_correlation_at_all() -> None:
    """The pose's error moves and turns base and point as one, which alpha and beta do not see."""
    once, (twice, *_) = seen_once(np.random.default_rng(0)), observed(np.random.default_rng(0))
    for state, none in ((once, True), (twice, False)):
        cross = state.covariance[:5, 5:]
        local = local_cross_covariance(
            state.landmarks[1:4], state.landmarks[4], cross[:, :6], cross[:, 6:]
        )
        assert (np.abs(local).max() < 1e-12 * np.abs(cross).max()) is np.bool_(none)


def test_one_dimension_of_the_argument() -> None:
    """Equation 3.4: P_vL = P_vv - P_vb vanishes when robot and base are one."""
    triangle = random_triangles(np.random.default_rng(0), 1)[0]
    common = np.tile(np.eye(2), (1, 4)) * 9.0
    cross = local_cross_covariance(triangle, triangle.mean(axis=0), common[:, :6], common[:, 6:])
    assert np.abs(cross).max() < 1e-12
