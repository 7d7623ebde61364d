"""What moves is neither fused nor matched, and both filters stay what they are."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from ekf_reference.association.dynamic_rejection import DynamicRejection
from ekf_reference.association.known import KnownAssociation
from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.measurements import DYNAMIC, Association
from ekf_reference.filters.compressed import CompressedEkf, LocalAreas
from ekf_reference.models.motion import RelativePoseModel

LANDMARK = np.array([(8.0, 3.0), (14.0, -4.0), (20.0, 5.0), (28.0, -3.0), (34.0, 4.0), (3.0, -5.0)])
SIGMA = np.array((0.1, 0.02))
REPORTED = 6
"""Step from which it is told that things move."""


class Yard:
    """Things move within a radius of a place, from when it is told."""

    def __init__(self, place: Array, radius_m: float = 1.5) -> None:
        self.place, self.radius_m, self.known = place, radius_m, False

    def is_dynamic(self, point: Array) -> NDArray[np.bool_]:
        near: NDArray[np.bool_] = np.linalg.norm(point - self.place, axis=1) <= self.radius_m
        return near & self.known


def everything(ekf: Ekf, k: int, seen: Index) -> Index:
    """All that is seen in step k is used."""
    return seen


def drive(
    kind: str,
    rule: Association,
    yard: Yard | None,
    used: Callable[[Ekf, int, Index], Index] = everything,
) -> tuple[Ekf, DynamicRejection | None, list[Index]]:
    """Twenty steps east past LANDMARK; of all within 16 m those are used that `used` says."""
    rng = np.random.default_rng(0)
    guarded = None if yard is None else DynamicRejection(rule, yard)
    parts = RelativePoseModel(), guarded or rule, np.zeros(3), np.diag((1e-4, 1e-4, 1e-6))
    ekf = Ekf(*parts) if kind == "full" else CompressedEkf(*parts, areas=LocalAreas(4.0, 30.0))
    noise, landmark_indices = np.diag((0.01, 0.01, 1e-4)), []
    x = 0.0
    for k in range(20):
        if yard is not None:
            yard.known = k >= REPORTED
        step = rng.multivariate_normal((2.0, 0.0, 0.0), noise)
        x += 2.0
        ekf.predict(step, noise, 1.0)
        apart = LANDMARK - (x, 0.0)
        z = np.column_stack((np.hypot(*apart.T), np.arctan2(apart[:, 1], apart[:, 0])))
        seen = np.flatnonzero(z[:, 0] < 16.0)
        z[seen] += SIGMA * rng.standard_normal((len(seen), 2))
        seen = used(ekf, k, seen)
        if len(seen):
            landmark_indices.append(ekf.observe(z[seen], np.tile(SIGMA, (len(seen), 1)), seen))
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
    struck = 3 + 2 * landmark_index, 4 + 2 * landmark_index

    def without(own: Ekf, k: int, seen: Index) -> Index:
        if k == REPORTED:
            own.state = own.state.part(np.delete(np.arange(len(own.state.mean)), struck))
        return seen if k < REPORTED else seen[seen != 2]

    own, *_ = drive("full", KnownAssociation(), Yard(LANDMARK[2]), without)
    kept = np.delete(np.arange(len(ekf.state.mean)), struck)
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
    ekf, *_ = drive("full", NearestNeighbour(), None)
    place = ekf.state.landmarks
    landmark_index = int(np.linalg.norm(place - LANDMARK[2], axis=1).argmin())
    apart = place[landmark_index] + (0.0, 0.12) - ekf.state.pose[:2]
    z = np.array([(np.hypot(*apart), np.arctan2(apart[1], apart[0]) - ekf.state.pose[2])])
    assert ekf.observe(z, SIGMA[None], np.array([-1])).tolist() == [landmark_index]
    yard.place, yard.known = ekf.state.landmarks[landmark_index].copy(), True
    ekf.association = guarded = DynamicRejection(NearestNeighbour(), yard)
    far = np.array([(np.hypot(*apart) + 0.1, z[0, 1])])
    found = ekf.observe(far, SIGMA[None], np.array([-1]))
    assert guarded.deactivated == {landmark_index}
    assert found[0] != landmark_index
