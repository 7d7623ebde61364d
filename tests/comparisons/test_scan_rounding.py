"""Scan-SLAM does not depend on rounding: inputs moved by 1e-12 change no decision and no figure.

What depended on it were ties: recorded ranges and bearings are multiples of a step, so that they
lie on bounds exactly, and the last digit decided on which side.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from comparisons.adapters import beam_noise
from comparisons.adapters.beam_noise import sensor_of
from comparisons.adapters.time_window import cut_log
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.logs.scans import Scans
from ekf_reference.scan_landmarks import segmentation, templates
from ekf_reference.scan_landmarks.segmentation import SegmentationOptions, segments
from ekf_reference.scan_landmarks.templates import SensorView, Template, share_in_view
from ekf_reference.scan_matching import scan_shape, search
from ekf_reference.scan_matching.scan_shape import of_scan
from ekf_reference.scan_matching.sog import SumOfGaussians
from research.scan_car_park import SIZE, perturbed
from tests.comparisons.scan_rounding import Difference, difference, outcome
from tests.ekf_reference.scan_matching.scenes import BEAMS, COURT, LASER, YARD, ranges
from tests.helpers import Array
from tests.scenarios import scenario

SIGMAS = 1e-6
"""Greatest difference of z and results; see tests/comparisons/scan_rounding.py for what it is."""
CAR_PARK_SIGMAS = 1e-4
"""The same where many directions are nearly open."""
STRETCH_S = 3.0
RNG = np.random.default_rng


def moved(log: Log, **options: object) -> Difference:
    """What 1e-12 changes."""
    other = perturbed(log, RNG(1))
    return difference(outcome(log, **options), outcome(other, **options))


def stretch(seed: int, number: int) -> Log:
    """A short part of a drive, ten to a drive."""
    return cut_log(scenario("scan-slam", seed=seed), 15.0 * number, 15.0 * number + STRETCH_S)


def test_every_input_is_moved_and_no_time() -> None:
    log = stretch(3, 1)
    other = perturbed(log, RNG(0))
    assert log.scans is not None
    assert other.scans is not None
    for one, two in (
        (log.scans.range_m, other.scans.range_m),
        (log.scans.angle_rad, other.scans.angle_rad),
        (log.prior.pose, other.prior.pose),
        *((getattr(log.odometry, c), getattr(other.odometry, c)) for c in ("speed_mps",)),
    ):
        known = np.isfinite(one) & (one != 0.0)
        off = two[known] / one[known] - 1.0
        assert np.abs(off).max() < 6.0 * SIZE
        assert np.count_nonzero(off) > 0.9 * off.size
    np.testing.assert_array_equal(log.scans.time_s, other.scans.time_s)
    np.testing.assert_array_equal(log.odometry.time_s, other.odometry.time_s)


Decision = Callable[[Array, Array], object]
"""Of ranges and bearings (361,), each nearly 1 m and exactly a multiple of half a degree."""


def made(range_m: Array, angle_rad: Array) -> SumOfGaussians:
    return of_scan(angle_rad, range_m, LASER)


def segments_cut(one: Array, angle_rad: Array) -> object:
    """At steps of 5 m, and where nothing returns for 3 degrees."""
    beam = np.arange(len(one))
    way = one * np.where(beam // 60 % 2, 15.0, 10.0)
    way[beam % 45 < 5] = np.nan
    cut = segments(made(way, angle_rad), SegmentationOptions(least_points=1))
    return [len(rows) for rows in cut]


def in_view(one: Array, angle_rad: Array) -> object:
    """Of returns at the rims, just where they were seen."""
    scan = made(10.0 * one, angle_rad)
    view = SensorView(50.0, float(angle_rad[0]), float(angle_rad[-1]))
    return share_in_view(Template(scan, np.zeros(3)), scan, np.zeros(3), view)


def hidden(one: Array, angle_rad: Array) -> object:
    """By returns that are two beams apart."""
    nearer = 10.0 * one
    nearer[5::10] = np.nan
    return seen_behind(nearer, one, angle_rad)


def hidden_by_the_least(one: Array, angle_rad: Array) -> object:
    """By returns that are nearer by the least length."""
    return seen_behind(19.0 * one, one, angle_rad)


def seen_behind(nearer: Array, one: Array, angle_rad: Array) -> float:
    template = Template(made(20.0 * one[::-1], angle_rad), np.zeros(3))
    view = SensorView(50.0, -2.0, 2.0)
    return share_in_view(template, made(nearer, angle_rad), np.zeros(3), view)


def boundaries(one: Array, angle_rad: Array) -> object:
    """Where returns end at nine tenths of the farthest."""
    beam = np.arange(len(one))
    way = one * np.where(beam // 20 % 2, 31.5, 35.0)
    way[beam % 20 > 15] = np.nan
    return made(way, angle_rad).boundary.tolist()


@cache
def recorded_ranges() -> Array:
    """(40, 361) in whole centimetres."""
    seen = [ranges(RNG(k), (YARD, COURT)[k % 2], np.zeros(3), LASER) for k in range(40)]
    return np.asarray(np.round(seen, 2))


def estimated_noise(one: Array, angle_rad: Array) -> object:
    """Of the scanner, by its scans."""
    seen = recorded_ranges()
    time_s = np.arange(float(len(seen)))
    scans = Scans(
        time_s=time_s, angle_rad=angle_rad, range_m=seen * one, intensity=np.zeros(seen.shape)
    )
    return round(float(np.log(sensor_of(scans).sigma_bearing_rad)), 6)


def promised(one: Array, angle_rad: Array) -> object:
    """By starts of an alignment."""
    scan = made(recorded_ranges()[0] * one, angle_rad).thinned(0.6)
    shift = np.linspace(-2.0, 2.0, 9)
    pose = np.stack((shift, 0.3 * shift, 0.1 * shift), axis=1)
    return np.round(search._scores(scan, scan, pose, 0.6), 9).tolist()


TIES: tuple[tuple[Decision, ModuleType, str, float], ...] = (
    (segments_cut, segmentation, "_TIE", 0.0),
    (in_view, templates, "_TIE", 0.0),
    (hidden, templates, "_BESIDE", 2.0),
    (hidden_by_the_least, templates, "_TIE", 0.0),
    (boundaries, scan_shape, "_TIE_M", 0.0),
    (estimated_noise, beam_noise, "_DIGITS", 15),
    (promised, search, "_BLURRED", 3.0),
)
"""Decisions, and what keeps them the same at a tie, and what would not."""


@pytest.mark.parametrize(("decision", "module", "name", "broken"), TIES)
def test_ties_fall_on_one_side(
    decision: Decision,
    module: ModuleType,
    name: str,
    broken: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Inputs are moved 20 times. Broken: without what keeps the decision it changes."""

    def decided(seed: int) -> object:
        off = 1.0 + SIZE * RNG(seed).standard_normal((2, len(BEAMS)))
        return decision(off[0], BEAMS * off[1])

    exact = decision(np.ones(len(BEAMS)), BEAMS)
    assert all(decided(seed) == exact for seed in range(20))
    monkeypatch.setattr(module, name, broken)
    exact = decision(np.ones(len(BEAMS)), BEAMS)
    assert not all(decided(seed) == exact for seed in range(20))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "number"), [(3, 0), (0, 4)])
def test_a_short_drive_stays(seed: int, number: int) -> None:
    found = moved(stretch(seed, number))
    assert found.first == ""
    assert found.stays
    assert max(found.z, found.result) < SIGMAS


@pytest.mark.slow
def test_50_drives_stay() -> None:
    """Five drives in ten stretches each, all along the way."""
    found = {(s, n): moved(stretch(s, n)) for s in range(5) for n in range(10)}
    assert {key: d.first for key, d in found.items() if d.first or not d.stays} == {}
    assert max(max(d.z, d.result) for d in found.values()) < SIGMAS


@pytest.mark.slow
def test_the_car_park_stays(shared_data: Path) -> None:
    """Its ranges are whole centimetres, its bearings half degrees."""
    found = moved(cut_log(open_log(str(shared_data / "acfr_car_park")), end_s=30.0))
    assert found.first == ""
    assert max(found.z, found.result) < CAR_PARK_SIGMAS
