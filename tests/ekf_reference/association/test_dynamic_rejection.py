"""What moves is neither fused nor matched, and both filters stay what they are."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ekf_reference.association.dynamic_rejection import DynamicRejection
from ekf_reference.association.known import KnownAssociation
from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array
from ekf_reference.core.measurements import DYNAMIC, Association
from ekf_reference.filters.compressed import CompressedEkf, LocalAreas
from ekf_reference.models.motion import RelativePoseModel

LANDMARK = np.array([(8.0, 3.0), (14.0, -4.0), (20.0, 5.0), (28.0, -3.0), (34.0, 4.0), (3.0, -5.0)])
SIGMA = np.array((0.1, 0.02))


class Yard:
    """Things move within a radius of a place, from when it is told."""

    def __init__(self, place: Array, radius_m: float = 1.5) -> None:
        self.place, self.radius_m, self.known = place, radius_m, False

    def is_dynamic(self, point: Array) -> NDArray[np.bool_]:
        near: NDArray[np.bool_] = np.linalg.norm(point - self.place, axis=1) <= self.radius_m
        return near & self.known


def drive(
    kind: str, rule: Association, yard: Yard | None, reported_at: int = 6, seed: int = 0
) -> tuple[Ekf, DynamicRejection | None, list[NDArray[np.intp]]]:
    """Twenty steps east past LANDMARK; all that is within 16 m is seen."""
    rng = np.random.default_rng(seed)
    guarded = None if yard is None else DynamicRejection(rule, yard)
    parts = RelativePoseModel(), guarded or rule, np.zeros(3), np.diag((1e-4, 1e-4, 1e-6))
    ekf = Ekf(*parts) if kind == "full" else CompressedEkf(*parts, areas=LocalAreas(4.0, 30.0))
    noise, landmark_indices = np.diag((0.01, 0.01, 1e-4)), []
    x = 0.0
    for k in range(20):
        if yard is not None:
            yard.known = k >= reported_at
        step = rng.multivariate_normal((2.0, 0.0, 0.0), noise)
        x += 2.0
        ekf.predict(step, noise, 1.0)
        apart = LANDMARK - (x, 0.0)
        z = np.column_stack((np.hypot(*apart.T), np.arctan2(apart[:, 1], apart[:, 0])))
        seen = np.flatnonzero(z[:, 0] < 16.0)
        z = z[seen] + SIGMA * rng.standard_normal((len(seen), 2))
        if len(seen):
            landmark_indices.append(ekf.observe(z, np.tile(SIGMA, (len(seen), 1)), seen))
    return ekf, guarded, landmark_indices


@pytest.mark.parametrize("rule", [KnownAssociation, NearestNeighbour])
def test_full_and_compressed_stay_equal(rule: type[Association]) -> None:
    ekf, guarded, landmark_indices = drive("full", rule(), Yard(LANDMARK[2]))
    other, also, theirs = drive("compressed", rule(), Yard(LANDMARK[2]))
    assert guarded is not None
    assert also is not None
    assert guarded.deactivated == also.deactivated
    assert len(guarded.deactivated) == 1
    for a, b in zip(landmark_indices, theirs, strict=True):
        assert np.array_equal(a, b)
    assert sum(int(np.count_nonzero(s == DYNAMIC)) for s in landmark_indices) > 3
    assert np.allclose(ekf.state.mean, other.state.mean, rtol=1e-10, atol=1e-10)
    assert np.allclose(ekf.state.covariance, other.state.covariance, rtol=1e-9, atol=1e-12)


def test_the_rest_is_as_with_the_landmark_marginalised_out() -> None:
    """The oracle: the same drive with the landmark's rows struck out when it is deactivated."""
    ekf, guarded, _ = drive("full", KnownAssociation(), Yard(LANDMARK[2]))
    assert guarded is not None
    (landmark_index,) = guarded.deactivated
    kept = np.delete(
        np.arange(len(ekf.state.mean)), (3 + 2 * landmark_index, 4 + 2 * landmark_index)
    )

    yard, rule, done = Yard(LANDMARK[2]), KnownAssociation(), False
    watched = DynamicRejection(rule, yard)
    rng, x = np.random.default_rng(0), 0.0
    own = Ekf(RelativePoseModel(), watched, np.zeros(3), np.diag((1e-4, 1e-4, 1e-6)))
    noise = np.diag((0.01, 0.01, 1e-4))
    for k in range(20):
        yard.known = k >= 6
        step = rng.multivariate_normal((2.0, 0.0, 0.0), noise)
        x += 2.0
        own.predict(step, noise, 1.0)
        apart = LANDMARK - (x, 0.0)
        z = np.column_stack((np.hypot(*apart.T), np.arctan2(apart[:, 1], apart[:, 0])))
        seen = np.flatnonzero(z[:, 0] < 16.0)
        z = z[seen] + SIGMA * rng.standard_normal((len(seen), 2))
        if yard.known and not done:
            state = own.state
            rest = np.delete(
                np.arange(len(state.mean)), (3 + 2 * landmark_index, 4 + 2 * landmark_index)
            )
            own.state = state.part(rest)
            done = True
        still = seen != 2 if yard.known else np.ones(len(seen), dtype=bool)
        if still.any():
            own.observe(z[still], np.tile(SIGMA, (int(still.sum()), 1)), seen[still])
    assert done
    mean, covariance = ekf.state.mean, ekf.state.covariance
    assert np.allclose(mean[kept], own.state.mean, rtol=0.0, atol=1e-9)
    assert np.allclose(covariance[np.ix_(kept, kept)], own.state.covariance, rtol=0.0, atol=1e-11)


def test_a_landmark_that_is_merely_not_asked_about_is_not_retired() -> None:
    _, guarded, landmark_indices = drive("full", KnownAssociation(), Yard(np.array((500.0, 0.0))))
    assert guarded is not None
    assert not guarded.deactivated
    assert all((s >= 0).all() for s in landmark_indices)


def test_nothing_is_matched_with_a_retired_landmark() -> None:
    """A measurement beside the yard that the nearest neighbour would give to what stands in it."""
    yard = Yard(LANDMARK[2], 0.05)
    ekf, guarded, _ = drive("full", NearestNeighbour(), None)
    place = ekf.state.landmarks
    landmark_index = int(np.linalg.norm(place - LANDMARK[2], axis=1).argmin())
    yard.place, yard.known = place[landmark_index].copy(), True
    guarded = DynamicRejection(NearestNeighbour(), yard)
    ekf.association = guarded
    apart = place[landmark_index] + (0.0, 0.12) - ekf.state.pose[:2]
    z = np.array([(np.hypot(*apart), np.arctan2(apart[1], apart[0]) - ekf.state.pose[2])])
    plain = NearestNeighbour()
    ekf.association = plain
    assert ekf.observe(z, SIGMA[None], np.array([-1])).tolist() == [landmark_index]
    yard.place = ekf.state.landmarks[landmark_index].copy()
    ekf.association = guarded
    far = np.array([(np.hypot(*apart) + 0.1, z[0, 1])])
    found = ekf.observe(far, SIGMA[None], np.array([-1]))
    assert guarded.deactivated == {landmark_index}
    assert found[0] != landmark_index
