"""Places of passive landmarks: read exactly, and without a global update."""

import numpy as np
import pytest

from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT, POSE, LandmarkKind, PredictedMeasurements
from ekf_reference.filters.compressed import CompressedState, LocalAreas
from ekf_reference.models.relative_pose import RelativePose
from tests.ekf_reference.both_kinds import AREAS, PRIOR, Script, build, drive

FAR_M = 18.0
"""Some landmarks are farther away, and some that are not are passive."""
KINDS = (POINT, POSE)


class Reading(RelativePose):
    """Asks a filter, whenever it predicts a measurement, for all its places and who is near."""

    def __init__(self, ekf: Ekf) -> None:
        self.ekf = ekf
        self.places: list[Array] = []
        self.near: list[list[int]] = []

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        state = self.ekf.state
        for kind, place in zip(KINDS, (state.landmarks, state.places(POSE)), strict=True):
            self.places.append(place.copy())
            self.near.append(state.within(FAR_M, kind).tolist())
        return super().predict(pose, landmarks)


class Stale(CompressedState):
    """Broken: read as the last global update left them."""

    def places(self, kind: LandmarkKind) -> Array:
        theta, self._theta = self._theta, np.zeros_like(self._theta)
        place = super().places(kind)
        self._theta = theta
        return place


def asked(ekf: Ekf) -> Reading:
    """What was read in a drive of two laps, some landmarks being fused and some removed."""
    ekf.models[POSE] = reading = Reading(ekf)
    drive(ekf, 1, Script(order="in turn", fuse_at=60, remove_at=75))
    return reading


def equal(one: Reading, other: Reading) -> None:
    assert one.near == other.near
    for read, expected in zip(one.places, other.places, strict=True):
        assert np.array_equal(np.isnan(read), np.isnan(expected))
        assert np.nanmax(np.abs(read - expected), initial=0.0) < 1e-9  # of some ten metres


def test_places_are_the_full_filters_and_cost_no_update() -> None:
    quiet, compressed = build("compressed"), build("compressed")
    full = asked(build())
    drive(quiet, 1, Script(order="in turn", fuse_at=60, remove_at=75))
    equal(asked(compressed), full)
    assert any(np.isnan(place).any() for place in full.places)
    assert isinstance(compressed.state, CompressedState)
    assert isinstance(quiet.state, CompressedState)
    assert max(u.passive for u in compressed.state.updates) > 10
    # Areas are larger for those who asked so far, and so are left as often, or less.
    assert len(compressed.state.updates) <= len(quiet.state.updates)


def test_stale_places_are_found_out() -> None:
    broken = build("compressed")
    broken.state = Stale(broken.state.pose, PRIOR, AREAS)
    with pytest.raises(AssertionError):
        equal(asked(broken), asked(build()))


class Forgetful(CompressedState):
    """Broken: areas do not allow for the reach of who asks."""

    def within(self, reach_m: float, kind: LandmarkKind = POINT) -> Index:
        found, self._reach_m = super().within(reach_m, kind), self.areas.reach_m
        return found


@pytest.mark.parametrize(("made", "cost"), [(CompressedState, 0), (Forgetful, 1)])
def test_areas_reach_as_far_as_is_asked(made: type[CompressedState], cost: int) -> None:
    ekf = build("compressed")
    areas = LocalAreas(2.0, 6.0)
    ekf.state = state = made(ekf.state.pose, PRIOR, areas)
    drive(ekf, 1, Script(order="in turn"))
    state.within(FAR_M, POSE)
    state.leave()
    state.predict(ekf.state.pose + (0.1, 0.0, 0.0), np.eye(3), 1e-6 * np.eye(3))
    before = len(state.updates)
    found = state.map_of(state.within(FAR_M, POSE), POSE)
    away = np.abs(found.landmark[:, :2] - found.pose[:2]).max()
    assert areas.half_m + areas.reach_m < away < FAR_M
    assert len(state.updates) - before == cost
