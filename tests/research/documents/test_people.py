"""People's tracks equal a joint filter with its gain cut (Nieto 2005, 3.7.1); cars that leave."""

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.logs.simulate.dynamic_worlds import (
    CARS_LEAVE_S,
    Displaced,
    leaving_cars,
    parked_world,
)
from ekf_reference.core.geometry import Index
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.range_bearing import RangeBearing
from research.documents import nieto_people
from research.documents.interface import Sources
from research.documents.nieto_people import FullFilter, UnidirectionalFilter

SENSOR = RangeBearing()


class CutGain(FullFilter):
    """One joint covariance; what is seen of a person changes that person alone (Joseph's form)."""

    def see_people(self, which: Index, z: Array) -> None:
        state = self.state
        for k, seen in zip(which, z, strict=True):
            own = self._rows[k]
            at = SENSOR.predict(state.pose[:3], state.mean[None, own[:2]])
            h = np.zeros((2, len(state.mean)))
            h[:, :3], h[:, own[:2]] = at.jacobian_pose[0], at.jacobian_landmark[0]
            r, p = np.diag(nieto_people._SIGMA_Z**2), state.covariance
            gain = np.zeros((len(state.mean), 2))
            gain[own] = (p @ h.T @ np.linalg.inv(h @ p @ h.T + r))[own]
            left = np.eye(len(p)) - gain @ h
            state._mean[: len(p)] += gain @ (seen - at.z[0])
            state._covariance[: len(p), : len(p)] = left @ p @ left.T + gain @ r @ gain.T


def run(one: FullFilter, scans: int = 12) -> FullFilter:
    """Among people that come and go."""
    rng, pose, model = np.random.default_rng(1), np.zeros(3), UnicycleModel()
    landmark, person = places()
    for k in range(scans):
        pose = model.step(pose, np.array((1.5, 0.2)), 0.2).pose
        person = person + 0.1
        one.predict(model.step(one.state.pose[:3], np.array((1.4, 0.25)), 0.2))
        one.see(seen(pose, landmark, rng))
        which = np.arange(len(person))[k % 2 :]
        one.see_people(which, seen(pose, person[which], rng))
    return one


def seen(pose: Array, place: Array, rng: np.random.Generator) -> Array:
    z = SENSOR.predict(pose, place).z
    return z + 0.02 * rng.standard_normal(z.shape)


def places() -> tuple[Array, Array]:
    rng = np.random.default_rng(0)
    return rng.uniform(5.0, 15.0, (5, 2)), rng.uniform(4.0, 9.0, (4, 2))


def started(kind: type[FullFilter]) -> FullFilter:
    first = (SENSOR.predict(np.zeros(3), place).z for place in places())
    return kind(*first)


def test_the_tracks_are_those_of_a_joint_filter_whose_gain_is_cut() -> None:
    expected, found = run(started(CutGain)), run(started(UnidirectionalFilter))
    assert found.state.pose[:3] == pytest.approx(expected.state.pose[:3], rel=1e-9)
    for ours, theirs in zip(found.people, expected.people, strict=True):
        assert np.allclose(ours, theirs, rtol=1e-8, atol=1e-10)
    both = run(started(FullFilter))
    assert not np.allclose(both.state.pose[:3], found.state.pose[:3], rtol=1e-6)


def test_without_the_covariance_with_the_robot_tracks_are_too_sure() -> None:
    """The broken variant, as trackers are that take the robot's pose for the truth."""

    class Independent(UnidirectionalFilter):
        def see_people(self, which: Index, z: Array) -> None:
            super().see_people(which, z)
            self._cross[:] = 0.0

    expected, found = run(started(CutGain)), run(started(Independent))
    assert not np.allclose(found.people[1], expected.people[1], rtol=1e-3)


def test_people_who_hardly_change_their_speed_tell_the_robot_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """So that the claim is of the random walk."""
    calm = 1e-6 * nieto_people._STEP_NOISE
    monkeypatch.setattr(nieto_people, "_STEP_NOISE", calm)
    found = nieto_people.people_drives(Sources(drives=2))
    assert not next(iter(nieto_people._claims_3_7_1(found))).holds


def test_cars_made_of_discs_fill_their_outlines_until_they_leave() -> None:
    movers = [m for m in parked_world().movers if isinstance(m, Displaced)]
    place = np.array([m.place(np.array((0.0, CARS_LEAVE_S))) for m in movers])
    assert np.isnan(place[:, 1]).all()
    radius = 0.5 * movers[0].diameter_m
    for corner in leaving_cars():
        step = np.linspace(0.0, 1.0, 50)[:, None, None]
        side = ((1.0 - step) * corner + step * np.roll(corner, -1, axis=0)).reshape(-1, 2)
        away = np.linalg.norm(side[:, None] - place[:, 0], axis=2).min(axis=1)
        assert away.min() == pytest.approx(radius, rel=1e-3)
        assert away.max() < 1.5 * radius
