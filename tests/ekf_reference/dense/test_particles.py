import math

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.layers.layer import Hits
from ekf_reference.dense.layers.particles import Particles
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan
from ekf_reference.dense.sensor_model import InverseSensorModel
from tests.ekf_reference.dense.scenes import (
    HERE,
    SENSOR,
    mapped,
    place,
    reported,
    simulation,
    wall_scan,
)

MODEL = InverseSensorModel()


def one_return(placed: RegionsAtMap, range_m: float, bearing: float = 0.0) -> Scan:
    return Scan.of_ranges(HERE, np.array([bearing]), np.array([range_m]), SENSOR)


def exactly(particles: Particles, hits: Hits, placed: RegionsAtMap, weight: float) -> None:
    """Place particles of one weight at the returns."""
    odds = np.full(len(hits.region), math.log(weight / (1.0 - weight)))
    particles._store.append(hits.region, np.column_stack((hits.local, odds)))


def test_samples_are_drawn_from_the_sensor_model_and_weighed_by_the_occupancy_model() -> None:
    """N 4.8 and 4.9."""
    placed = place()
    hits, _, scan, _ = reported(placed, one_return(placed, 9.0, 0.3))
    assert scan is not None
    point, odds = Particles(np.random.default_rng(0), 20_000).sampled(hits, scan)
    assert np.allclose(point.mean(axis=0), hits.point[0], atol=0.005)
    assert np.allclose(np.cov(point.T), hits.covariance[0], atol=3e-4)
    ahead = 9.0 - (point - scan.origin) @ ((hits.point[0] - scan.origin) / 9.0)
    expected = MODEL.probability(ahead, np.zeros(len(ahead)), SENSOR.sigma_range_m, 1.0)
    assert np.allclose(1.0 / (1.0 + np.exp(-odds)), expected)
    flipped = MODEL.probability(-ahead, np.zeros(len(ahead)), SENSOR.sigma_range_m, 1.0)
    assert not np.allclose(1.0 / (1.0 + np.exp(-odds)), flipped, atol=0.1)
    peak = np.abs(ahead) < 0.1
    assert (1.0 / (1.0 + np.exp(-odds[peak])) > 0.58).all()


def test_with_bearing_samples_are_weighed_by_both() -> None:
    placed = place()
    hits, _, scan, _ = reported(placed, one_return(placed, 9.0))
    assert scan is not None
    model = InverseSensorModel(with_bearing=True)
    point, odds = Particles(np.random.default_rng(0), 500, model=model).sampled(hits, scan)
    apart = point - hits.point[0]
    square = np.einsum("ni,ij,nj->n", apart, np.linalg.inv(hits.covariance[0]), apart)
    near = square < 2.0 * math.log(2.0)
    expected = 0.1 + 0.8 * np.exp(-0.5 * square)
    assert np.allclose(1.0 / (1.0 + np.exp(-odds[near])), expected[near])


def test_weights_and_places_by_brute_force() -> None:
    """N 4.10 to 4.12 and 4.2.3, one particle after the other; all in one region."""
    placed, seed = place(), 3
    rng = np.random.default_rng(0)
    particles = Particles(np.random.default_rng(seed), 3, least=0.0, confidence=0.999)
    first, _, _, _ = reported(placed, wall_scan(rng=rng))
    exactly(particles, first, placed, 0.6)
    before = particles.samples(placed)
    hits, _, scan, near = reported(placed, wall_scan(rng=rng))
    assert scan is not None
    drawn, odds = Particles(np.random.default_rng(seed), 3).sampled(hits, scan)
    said = 1.0 / (1.0 + np.exp(-odds))
    particles.fuse(hits, placed, scan, near)
    expected_point, expected_weight, taken = [], [], np.zeros(len(drawn), dtype=bool)
    crowd: dict[int, list[tuple[float, int]]] = {}
    for n, (point, weight) in enumerate(zip(before.point, before.occupancy, strict=True)):
        apart = np.linalg.norm(drawn - point, axis=1)
        taken |= apart < 0.2
        i = int(apart.argmin())
        if apart[i] < 0.2:
            occupied = said[i] * weight
            posterior = occupied / (occupied + (1.0 - said[i]) * (1.0 - weight))
            expected_weight.append(posterior)
            expected_point.append(0.5 * (point + drawn[i]))
            if apart[i] < 0.02:
                crowd.setdefault(i, []).append((posterior, n))
        else:
            met = scan.beams(point[None])
            free = MODEL.probability(met.ahead_m, met.off_rad, 0.1, 1.0)[0]
            free = free if met.seen[0] and met.ahead_m[0] > 0.0 else 0.5
            free = min(free, 0.5)
            expected_weight.append(free * weight / (free * weight + (1 - free) * (1 - weight)))
            expected_point.append(point)
    gone = {n for group in crowd.values() for _, n in sorted(group)[:-1]}
    kept = [n for n in range(len(before.point)) if n not in gone]
    point = np.vstack((np.array(expected_point)[kept], drawn[~taken]))
    weight = np.concatenate((np.array(expected_weight)[kept], said[~taken]))
    after = particles.samples(placed)
    order, other = np.lexsort(point.T), np.lexsort(after.point.T)
    assert len(point) == len(after.point)
    assert (~taken).sum() > 10
    assert np.allclose(point[order], after.point[other], atol=1e-9)
    assert np.allclose(weight[order], after.occupancy[other], atol=1e-9)


def test_the_printed_normaliser_of_4_11_is_none() -> None:
    """Prior 0.9 of the old particle j, 0.5 of the new sample i, which says 0.8."""
    said, old, new = 0.8, 0.9, 0.5
    printed = said * old / (said * new + (1.0 - said) * (1.0 - new))
    printed_free = (1.0 - said) * (1.0 - old) / (said * new + (1.0 - said) * (1.0 - new))
    assert printed > 1.0
    assert not math.isclose(printed + printed_free, 1.0, abs_tol=0.1)
    placed = place()
    particles = Particles(np.random.default_rng(0), least=0.0, confidence=0.999)
    hits, _, scan, near = reported(placed, one_return(placed, 9.0))
    exactly(particles, hits, placed, old)
    point, odds = Particles(np.random.default_rng(0)).sampled(hits, scan)
    i = int(np.linalg.norm(point - hits.point[0], axis=1).argmin())
    said = 1.0 / (1.0 + math.exp(-odds[i]))
    particles.fuse(hits, placed, scan, near)
    holds = said * old / (said * old + (1.0 - said) * (1.0 - old))
    assert particles.samples(placed).occupancy[0] == pytest.approx(holds)


class Blind(Particles):
    """Draws from the sensor model and learns nothing of free space."""

    def free_space(self, scan: Scan, point: Array) -> Array:
        return np.zeros(len(point))


@pytest.mark.parametrize("kind", [Particles, Blind])
def test_what_has_gone_is_removed_by_the_free_space_update(kind: type[Particles]) -> None:
    """N 4.2.2: without it a place stays occupied for ever."""
    placed, rng = place(), np.random.default_rng(0)
    particles = kind(np.random.default_rng(1))
    for _ in range(6):
        particles.fuse(*reported(placed, wall_scan(rng=rng, wall_m=9.3)))
    there = np.column_stack((np.full(10, 9.3), np.linspace(4.5, 6.5, 10)))
    assert np.nanmean(particles.occupancy(there, placed)) > 0.8
    for _ in range(12):
        particles.fuse(*reported(placed, wall_scan(rng=rng)))
    now = particles.occupancy(there, placed)
    assert np.isnan(now).all() == (kind is Particles)
    assert (np.nan_to_num(now) > 0.8).any() == (kind is Blind)


def test_what_is_hidden_or_out_of_view_stays() -> None:
    placed, rng = place(), np.random.default_rng(0)
    particles = Particles(np.random.default_rng(1))
    for _ in range(4):
        particles.fuse(*reported(placed, wall_scan(rng=rng)))
    before = particles.samples(placed)
    for _ in range(10):
        particles.fuse(*reported(placed, wall_scan(rng=rng, wall_m=9.3, half_rad=0.1)))
    after = particles.samples(placed)
    old = after.point[:, 0] > 12.0
    assert np.array_equal(after.point[old], before.point)
    assert np.array_equal(after.occupancy[old], before.occupancy)


def test_numbers_level_off_in_a_scene_that_stays() -> None:
    placed, rng = place(), np.random.default_rng(0)
    particles = Particles(np.random.default_rng(1))
    size = []
    for _ in range(300):
        particles.fuse(*reported(placed, wall_scan(rng=rng)))
        size.append(len(particles))
    assert max(size[200:]) < 1.15 * max(size[:100])
    assert min(np.diff(size)) < 0  # some are dropped


def test_those_that_meet_are_kept_where_the_map_is_not_thinned() -> None:
    """More of them weigh much: those that are dropped lie where samples are dense."""
    placed, scans = place(), np.random.default_rng(0)
    each = [wall_scan(rng=scans) for _ in range(150)]

    def weight(*, thinned: bool) -> Array:
        particles = Particles(np.random.default_rng(1), thinned=thinned)
        for scan in each:
            particles.fuse(*reported(placed, scan))
        return particles.samples(placed).occupancy

    kept, thinned = weight(thinned=False), weight(thinned=True)
    assert len(kept) > 1.5 * len(thinned)
    assert (kept > 0.8).mean() > (thinned > 0.8).mean()


def test_shares_of_weights_on_the_simulation() -> None:
    """N 4.2.3: 87 % above 0.8, 11 % between, 2 % below 0.5; here 82, 14 and 4."""
    placed, scans = simulation()
    weight = mapped("particles").samples(placed).occupancy
    assert 0.78 < (weight > 0.8).mean() < 0.92
    assert (weight < 0.5).mean() < 0.06
    returns = sum(len(scan.range_m) for scan in scans)
    assert 0.1 * returns < len(weight) < returns


@pytest.mark.parametrize(("count", "d_min_m"), [(0, 0.2), (2, 0.0), (2, math.nan)])
def test_bad_settings_are_refused(count: int, d_min_m: float) -> None:
    with pytest.raises(ValueError, match="must be above zero"):
        Particles(np.random.default_rng(0), count, d_min_m)
