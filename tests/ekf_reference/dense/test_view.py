from collections.abc import Callable

import numpy as np
import pytest

from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array
from ekf_reference.dense.view import FilterView
from ekf_reference.filters.compressed import CompressedEkf
from ekf_reference.filters.misono import DirectionCosineEkf
from tests.ekf_reference.worlds import build, circuit, follow, followed


def test_what_it_shows_is_a_copy() -> None:
    ekf = followed(circuit(duration_s=8.0))
    view = FilterView.of(ekf)
    before = ekf.state.mean.copy(), ekf.state.covariance.copy()
    for shown in (view.pose, view.landmark, view.covariance):
        shown[:] = 0.0
    assert np.array_equal(ekf.state.mean, before[0])
    assert np.array_equal(ekf.state.covariance, before[1])


@pytest.mark.parametrize("make", [Ekf, CompressedEkf, DirectionCosineEkf])
def test_every_filter_is_read_as_pose_and_landmarks(make: type[Ekf]) -> None:
    """The last view of a drive is what the whole state says, pose as x, y, heading."""
    ekf = followed(circuit(duration_s=40.0), build(make))
    read, covariance = ekf.read_pose(), ekf.state.covariance
    p = len(read.own)
    lift = np.eye(len(covariance) - p + 3, len(covariance), p - 3)
    lift[:3, :p] = read.jacobian
    whole = lift @ covariance @ lift.T
    view = FilterView.of(ekf)
    assert np.allclose(view.pose, read.pose, atol=1e-12)
    assert np.allclose(view.landmark, ekf.state.landmarks, atol=1e-12)
    near = view.near(15.0)
    assert 2 < len(near) < len(view.landmark)
    columns = np.concatenate((np.arange(3), (3 + 2 * near[:, None] + (0, 1)).ravel()))
    assert np.allclose(view.joint(near), whole[np.ix_(columns, columns)], atol=1e-15)


def test_glancing_leaves_a_compressed_filter_as_it_is() -> None:
    """Passive landmarks stay as the last global update left them, and no bit changes."""
    drive = circuit(duration_s=40.0)

    def final(predicted: Callable[[Ekf], object]) -> Array:
        ekf = build(CompressedEkf)
        for _ in follow(drive, ekf, predicted):
            pass
        return np.concatenate((ekf.state.landmarks.ravel(), ekf.state.covariance.ravel()))

    assert np.array_equal(final(FilterView.of), final(lambda ekf: None))
