"""What scan odometry makes of scans and guesses that are no use."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from graphslam.scan import planar
from graphslam.scan.odometry import KissIcpOptions, ScanOdometry
from graphslam.scan.registration import ScanError
from tests.graphslam.numerics import Array
from tests.graphslam.scan.shapes import HALL, box, scan
from tests.graphslam.scan.yard import STEP, drive

BAD: dict[str, Callable[[], object]] = {
    "empty": lambda: np.zeros((0, 3)),
    "two columns": lambda: np.ones((360, 2)),
    "absurd": lambda: np.full((360, 3), 1e300),
    "another place": lambda: np.column_stack((np.linspace(40, 70, 90), np.ones((90, 2)))),
}


def started(options: KissIcpOptions | None = None, scans: int = 6) -> ScanOdometry:
    """Odometry that has got its first scans."""
    odometry = ScanOdometry(options)
    for points in drive(scans)[1]:
        odometry.register(points, STEP)
    return odometry


@pytest.mark.parametrize("guessed", [True, False])
@pytest.mark.parametrize("bad", BAD)
def test_a_bad_scan_leaves_no_trace(bad: str, guessed: bool) -> None:
    scans = drive(9)[1]
    guess = STEP if guessed else None
    with_it, without = started(), started()
    pose, known = with_it.pose.copy(), with_it.map_points()
    with pytest.raises(ScanError) as caught:
        with_it.register(BAD[bad](), guess)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
    assert np.array_equal(with_it.pose, pose)
    assert np.array_equal(with_it.map_points(), known)
    later = with_it.register(scans[7], guess)
    usual = without.register(scans[7], planar.compose(STEP, STEP))
    assert later is not None
    assert usual is not None
    assert (later.since, usual.since) == (2, 1)
    if guessed:
        assert np.array_equal(later.motion, usual.motion)
        assert np.array_equal(later.covariance, usual.covariance)
    else:
        assert np.abs(later.motion - usual.motion).max() < 1e-3
    following = with_it.register(scans[8], guess)
    assert following is not None
    assert following.since == 1


def test_after_a_gap_the_vehicle_is_taken_to_go_on_as_fast() -> None:
    """The increment over two scans is no velocity per scan: the next one is half as far away."""
    scans = drive(12)[1]
    odometry = started(KissIcpOptions(blind_jump_m=0.1, most_jump_rad=0.05))
    for _ in range(2):
        with pytest.raises(ScanError):
            odometry.register(np.zeros((0, 3)))
    over_three = odometry.register(scans[8])
    after = odometry.register(scans[9])
    assert over_three is not None
    assert after is not None
    assert (over_three.since, after.since) == (3, 1)


@pytest.mark.parametrize(
    "guess", [np.full(3, np.nan), np.array((np.inf, 0.0, 0.0)), np.full(3, -1e308), np.zeros(2)]
)
def test_a_guess_that_is_no_motion_costs_one_scan_only(guess: Array) -> None:
    """And does not end the process, which KISS-ICP would."""
    scans = drive(8)[1]
    odometry = started()
    with pytest.raises(ScanError, match=r"guess is .* expected three numbers"):
        odometry.register(scans[6], guess)
    found = odometry.register(scans[7], STEP)
    assert found is not None
    assert found.since == 2
    assert np.abs(found.motion - planar.compose(STEP, STEP)).max() < 0.01


def test_a_new_map_begins_where_the_guesses_lead() -> None:
    scans = drive(14)[1]
    odometry = started(KissIcpOptions(patience=3), 5)
    last = odometry.pose.copy()
    guess = np.array((0.19, 0.0, 0.07))
    expected = last
    for k in range(5, 10):
        with pytest.raises(ScanError):
            odometry.register(np.zeros((0, 3)), guess)
        expected = planar.compose(expected, guess)
        assert len(odometry.map_points()) == 0 if k > 7 else len(odometry.map_points()) > 100
    assert odometry.register(scans[10], guess) is None
    expected = planar.compose(expected, guess)
    assert np.abs(odometry.pose - expected).max() < 1e-12
    onward = odometry.register(scans[11], STEP)
    assert onward is not None
    assert onward.since == 1
    assert np.abs(onward.motion - STEP).max() < 0.02
    # The scan that began the map is exact by definition, and the old map's doubts end with it.
    assert np.array_equal(onward.covariance, onward.match.covariance)


def test_without_guesses_a_new_map_begins_where_the_velocity_leads() -> None:
    scans = drive(14)[1]
    odometry = started(KissIcpOptions(patience=2), 5)
    last = odometry.pose.copy()
    for _ in range(5):
        with pytest.raises(ScanError):
            odometry.register(np.zeros((0, 3)))
    assert odometry.register(scans[10]) is None
    driven = planar.between(last, odometry.pose)
    expected = planar.between(*drive(7)[0][[0, 6]])
    assert np.abs(driven - expected).max() < 0.05


def test_a_scan_of_another_place_is_refused() -> None:
    """Another room, which lies over the map but fits it nowhere."""
    rng = np.random.default_rng(0)
    round_room = np.vstack([box(0.0, 0.0, 3.0, 3.0, turn) for turn in np.linspace(0.0, 1.4, 6)])
    for points in (
        scan(rng, round_room, np.zeros(3), 0.01) + (0.5, 4.0, 0.0),
        scan(rng, HALL, np.zeros(3), 0.01) + (30.0, 0.0, 0.0),
    ):
        odometry = started()
        before = odometry.map_points()
        with pytest.raises(ScanError, match=r"surface near|from the guess"):
            odometry.register(points, STEP)
        assert np.array_equal(odometry.map_points(), before)


@pytest.mark.parametrize("aside", [(0.6, 0.0, 0.0), (0.0, -0.6, 0.0), (0.0, 0.0, 0.3)])
def test_a_jump_from_the_guess_is_refused(aside: tuple[float, ...]) -> None:
    scans = drive(7)[1]
    near = KissIcpOptions(blind_threshold_m=1.0, threshold_m=1.0)
    far = replace(near, most_jump_m=0.3, most_jump_rad=0.15)
    guess = STEP + aside
    found = started(near).register(scans[6], guess)
    assert found is not None
    assert np.abs(found.motion - STEP).max() < 0.02
    odometry = started(far)
    with pytest.raises(ScanError, match=r"from the guess, expected 0\.3 m and 0.15 rad at most"):
        odometry.register(scans[6], guess)


def test_headings_go_on_beyond_whole_turns() -> None:
    scans = drive(8)[1]
    turned = started()
    found = turned.register(scans[6], STEP + (0.0, 0.0, 2.0 * np.pi))
    plain = started().register(scans[6], STEP)
    assert found is not None
    assert plain is not None
    assert np.abs(found.motion - plain.motion - (0.0, 0.0, 2.0 * np.pi)).max() < 1e-9
    onward = turned.register(scans[7], STEP)
    assert onward is not None
    assert np.abs(onward.motion - STEP).max() < 0.02
