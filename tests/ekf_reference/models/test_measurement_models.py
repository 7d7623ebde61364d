"""What all measurement models have in common."""

from __future__ import annotations

import numpy as np
import pytest

from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.filters.misono import OwnAxesObservation, PairRelativePose, UnwrappedPose
from ekf_reference.models.range_bearing import RangeBearing
from ekf_reference.models.relative_pose import RelativePose

MODELS: tuple[tuple[MeasurementModel, int, int], ...] = (
    (RangeBearing(), 3, 2),
    (OwnAxesObservation(), 4, 2),
    (RelativePose(), 3, 3),
    (PairRelativePose(UnwrappedPose(0.0)), 4, 3),
)
"""Each with the entries of its pose and of its landmarks."""


@pytest.mark.parametrize(("model", "_p", "width"), MODELS)
def test_the_innovation_is_what_was_measured_less_what_was_predicted(
    model: MeasurementModel, _p: int, width: int
) -> None:
    rng = np.random.default_rng(0)
    z, predicted = rng.uniform(-1.0, 1.0, (2, 5, width))
    assert np.allclose(model.innovation(z, predicted), z - predicted, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize(("model", "p", "width"), MODELS)
def test_the_range_is_the_distance_to_the_landmark(
    model: MeasurementModel, p: int, width: int
) -> None:
    pose, landmark = np.array((1.0, -2.0, 0.6, 0.8))[:p], np.zeros((1, width))
    landmark[0, :2] = 4.0, 2.0
    assert np.isclose(model.range_m(model.predict(pose, landmark).z)[0], 5.0)
