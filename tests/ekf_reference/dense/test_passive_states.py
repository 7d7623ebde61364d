"""Passive states are what they would be in the filter's own state (Nieto 2005, Example 3.3)."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.measurement_update import UpdateSplitter
from ekf_reference.core.trace import RecordedTrace, StepRecord
from ekf_reference.dense.triangles import local_jacobians, to_local
from ekf_reference.filters.compressed import CompressedEkf
from ekf_reference.filters.misono import DirectionCosineEkf
from ekf_reference.models.motion import UnicycleModel
from tests.ekf_reference.dense.passive_states import (
    PassiveStates,
    StaleCross,
    local_coordinates,
    points,
)
from tests.ekf_reference.numerics import point_columns, relative_error
from tests.ekf_reference.worlds import LOOP_S, build, circuit, follow

EVERY, FIX_EVERY, SPLIT_FROM = 20, 25, 100
"""Scans between two new dense points, between two position fixes, and until updates are split."""
SIGMA = np.array((0.2, 0.02))
FIRST_LABEL = 10_000


class Outcome(NamedTuple):
    """point: (q, 2). cross: (2 q, n) with pose and landmarks. own: (q, 2, 2). mean: (n,)."""

    point: Array
    cross: Array
    own: Array
    mean: Array
    covariance: Array


def drive(look: Callable[[Ekf, int, Array], None], start: Callable[[Ekf], None]) -> Ekf:
    """A loop with position fixes and split updates; `look` gets z (3, 2) of new dense points."""
    rng = np.random.default_rng(0)
    for k, (_, ekf) in enumerate(follow(circuit(0, LOOP_S + 10.0))):
        if k == 0:
            start(ekf)
            ekf.insert_surveyed(np.array([(5.0, 5.0)]), 0.1 * np.eye(2)[None])
            assert isinstance(ekf.association, KnownAssociation)
            ekf.association.index_of[FIRST_LABEL - 1] = len(ekf.association.index_of)
        if k == SPLIT_FROM:
            ekf.splitter = UpdateSplitter(largest_turn_rad=2e-3, largest_move_m=0.05)
        if k % EVERY == 5:
            z = np.column_stack((rng.uniform(3.0, 20.0, 3), rng.uniform(-1.5, 1.5, 3)))
            look(ekf, k // EVERY, z)
        if k % FIX_EVERY == 10:
            ekf.fix_position(ekf.state.pose[:2] + 0.3 * rng.standard_normal(2), 0.3 * np.eye(2))
    return ekf


@cache
def carried() -> Outcome:
    """Points in the filter's state, measured once and never again."""

    def look(ekf: Ekf, k: int, z: Array) -> None:
        ekf.observe(z, np.tile(SIGMA, (3, 1)), FIRST_LABEL + 3 * k + np.arange(3))

    ekf = drive(look, lambda ekf: None)
    assert isinstance(ekf.association, KnownAssociation)
    landmark_index = ekf.association.index_of
    dense = np.array([s for label, s in landmark_index.items() if label >= FIRST_LABEL])
    real = np.array([s for label, s in landmark_index.items() if label < FIRST_LABEL])
    p, rows = ekf.state.covariance, point_columns(dense)[3:]
    own = np.array([p[np.ix_(r, r)] for r in rows.reshape(-1, 2)])
    columns = point_columns(real)
    return Outcome(
        ekf.state.landmarks[dense],
        p[np.ix_(rows, columns)],
        own,
        ekf.state.mean[columns],
        p[np.ix_(columns, columns)],
    )


def watched(make: type[PassiveStates]) -> tuple[PassiveStates, Ekf]:
    kept: list[PassiveStates] = []
    noise = np.broadcast_to(np.diag(SIGMA**2), (3, 2, 2))

    def look(ekf: Ekf, k: int, z: Array) -> None:
        kept[0].watch(points(ekf.models[POINT], ekf.state.pose, z, noise))

    ekf = drive(look, lambda ekf: kept.append(make(ekf)))
    return kept[0], ekf


def gaps(passive: PassiveStates) -> tuple[float, float, float]:
    full = carried()
    return (
        float(np.abs(passive.value - full.point).max()),
        relative_error(passive.cross, full.cross),
        relative_error(passive.own, full.own),
    )


@pytest.mark.slow
def test_equal_to_a_filter_that_has_them_in_its_state() -> None:
    passive, ekf = watched(PassiveStates)
    assert len(passive.value) > 50
    assert np.linalg.norm(passive.change, axis=1).max() > 0.3
    assert max(gaps(passive)) < 1e-9
    assert np.allclose(ekf.state.mean, carried().mean, atol=1e-9)
    active, kept = ekf.state.landmark_count, len(passive.value)
    of_landmarks = ekf.state.covariance[3:, 3:].size + passive.cross[:, 3:].size + passive.own.size
    assert of_landmarks == 4 * (active * (active + kept) + kept)  # Example 3.3, in pairs
    assert of_landmarks < 4 * (active + kept) ** 2


@pytest.mark.slow
def test_the_filter_does_not_notice() -> None:
    alone = drive(lambda ekf, k, z: None, lambda ekf: None)
    _, ekf = watched(PassiveStates)
    assert np.array_equal(ekf.state.mean, alone.state.mean)
    assert np.array_equal(ekf.state.covariance, alone.state.covariance)


class WithoutF(PassiveStates):
    def step(self, step: StepRecord) -> None:
        super().step(step._replace(f=np.eye(3)))


class WrongSign(PassiveStates):
    def _receive(self, columns: Index, jacobian: Array, innovation: Array, noise: Array) -> None:
        super()._receive(columns, jacobian, -innovation, noise)


class NoiseForS(PassiveStates):
    """R^-1 in place of S^-1, as if P+ H^T were not a gain yet."""

    def _receive(self, columns: Index, jacobian: Array, innovation: Array, noise: Array) -> None:
        seen = self.cross[:, columns] @ jacobian.T
        super()._receive(columns, jacobian, np.zeros_like(innovation), noise)
        self.value = self.value + (seen @ np.linalg.solve(noise, innovation)).reshape(-1, 2)


@pytest.mark.slow
@pytest.mark.parametrize("broken", [WithoutF, WrongSign, StaleCross, NoiseForS])
def test_the_equality_rejects(broken: type[PassiveStates]) -> None:
    assert max(gaps(watched(broken)[0])) > 1e-3


def test_local_coordinates_change_as_their_point_and_landmarks_do() -> None:
    """To rounding by the Jacobians they began with, and nearly so by alpha and beta themselves."""
    z = np.array([(9.0, 0.3), (14.0, -0.4)])
    noise = np.broadcast_to(np.diag(SIGMA**2), (2, 2, 2))
    for k, (_, ekf) in enumerate(follow(circuit(0, LOOP_S + 10.0))):
        if k == 200:
            passive, then = PassiveStates(ekf), ekf.state.landmarks.copy()
            near = ekf.state.local_map(20.0).landmark_index
            base = near[[(0, 1, 3), (1, 2, 4)]]
            seen = points(ekf.models[POINT], ekf.state.pose, z, noise)
            world = passive.watch(seen)
            local = passive.watch(local_coordinates(seen, base, then))
    triangle, now = then[base], ekf.state.landmarks[base]
    h = local_jacobians(triangle, seen.value)
    moved = (now - triangle).reshape(2, 6, 1)
    expected = h.by_landmarks @ moved + h.by_point @ passive.change[world][..., None]
    assert np.allclose(passive.change[local], expected[..., 0], rtol=0.0, atol=1e-11)
    observed = to_local(now, passive.value[world]) - to_local(triangle, seen.value)
    size = np.abs(observed).max()
    assert size > 1e-3
    assert np.abs(passive.change[local] - observed).max() < 0.1 * size


def test_another_trace_goes_on_receiving_everything() -> None:
    tour, alone, behind = circuit(0, 10.0), RecordedTrace(), RecordedTrace()
    for trace in (alone, behind):
        for k, (_, ekf) in enumerate(follow(tour, build(trace=trace))):
            if k == 0 and trace is behind:
                PassiveStates(ekf)
        ekf.fix_position(ekf.state.pose[:2], np.eye(2))
    one, other = alone.arrays(), behind.arrays()
    assert len(one.positions.step) == 1
    assert np.array_equal(one.f, other.f)
    for ours, theirs in (
        (one.measurements[POINT], other.measurements[POINT]),
        (one.initialisations[POINT], other.initialisations[POINT]),
        (one.positions, other.positions),
    ):
        assert len(ours.step)
        assert all(
            np.array_equal(column, vars(theirs)[name]) for name, column in vars(ours).items()
        )


@pytest.mark.parametrize("kind", [CompressedEkf, DirectionCosineEkf])
def test_filters_it_would_be_wrong_for_are_refused(kind: type[Ekf]) -> None:
    ekf = kind(UnicycleModel(), KnownAssociation(), np.zeros(3), np.eye(3))
    with pytest.raises(TypeError, match="expected a KalmanState of 3"):
        PassiveStates(ekf)
