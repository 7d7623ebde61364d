"""What every matcher must do, whatever is inside; covariances of matches against their errors."""

import numpy as np
import pytest
from scipy.stats import chi2

from graphslam.scan import planar
from graphslam.scan.matchers import MATCHERS, MatchOptions, SurfaceMatcher, thinned
from graphslam.scan.registration import Matcher, Registration, ScanError
from graphslam.scan.surfaces import SurfaceMap
from tests.graphslam.numerics import Array
from tests.graphslam.scan.shapes import (
    COURT,
    ELL,
    LONG,
    ROOM,
    YARD,
    hall_in_space,
    scan,
    scan_pair,
    seen_from,
)

TRUE = np.array((0.4, -0.3, 0.25))
EXACT = {
    "surface": 1e-3,  # patches reach round corners
    "kiss": 1e-4,  # it keeps one of the points that lie closer than its map's resolution
    "point-to-point": 1e-9,
    "point-to-plane": 1e-9,
    "generalised": 1e-9,
}
"""Greatest error on noise-free clouds, relative to the motion."""


def cloud(dimension: int) -> Array:
    rng = np.random.default_rng(3)
    if dimension == 3:
        return hall_in_space(rng)
    return scan(rng, ROOM, np.array((0.3, 0.5, 0.2)), 0.0)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_known_motion_is_found(matcher: Matcher, name: str, dimension: int) -> None:
    target = cloud(dimension)
    found = matcher.match(seen_from(TRUE, target), target, np.zeros(3))
    assert np.abs(found.motion - TRUE).max() < EXACT[name] * np.abs(TRUE).max()
    assert found.inliers == round(found.overlap * len(target)) > 0.5 * len(target)
    assert found.residual_m < 0.01
    assert (np.linalg.eigvalsh(found.covariance) > 0.0).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_moving_the_target_moves_the_result(matcher: Matcher, name: str, dimension: int) -> None:
    target = cloud(dimension)
    source = seen_from(TRUE, target)
    move, guess = np.array((5.0, -7.0, 2.0)), np.array((0.1, 0.0, 0.1))
    still = matcher.match(source, target, guess)
    moved = matcher.match(source, planar.moved(move, target), planar.compose(move, guess))
    difference = planar.between(planar.compose(move, still.motion), moved.motion)
    assert np.abs(difference).max() < EXACT[name]
    # The cells of the judge's grid lie elsewhere on the target.
    assert np.abs(np.log(np.diag(moved.covariance) / np.diag(still.covariance))).max() < 0.5


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_order_of_points_does_not_matter(matcher: Matcher, dimension: int) -> None:
    rng = np.random.default_rng(0)
    target = cloud(dimension)
    source = seen_from(TRUE, target)
    one = matcher.match(source, target, np.zeros(3))
    other = matcher.match(rng.permutation(source), rng.permutation(target), np.zeros(3))
    np.testing.assert_allclose(other.motion, one.motion, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-6)


def test_the_heading_is_the_nearest_to_the_guess(matcher: Matcher) -> None:
    target = cloud(2)
    far = np.array((0.0, 0.0, 2.0 * np.pi))
    found = matcher.match(seen_from(TRUE, target), target, far)
    np.testing.assert_allclose(found.motion, TRUE + far, atol=1e-3)


def test_inputs_stay_as_they_are(matcher: Matcher) -> None:
    target = cloud(2)
    source, guess = seen_from(TRUE, target), np.zeros(3)
    before = [array.copy() for array in (source, target, guess)]
    matcher.match(source, target, guess)
    for array, copy in zip((source, target, guess), before, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_points_that_are_no_numbers_are_left_out(matcher: Matcher) -> None:
    target = cloud(2)
    source = seen_from(TRUE, target)
    holes = np.vstack((source, np.full((5, 3), np.nan), np.full((1, 3), np.inf)))
    assert_same(matcher.match(holes, target, TRUE), matcher.match(source, target, TRUE))


def assert_same(one: Registration, other: Registration) -> None:
    np.testing.assert_array_equal(one.motion, other.motion)
    np.testing.assert_array_equal(one.covariance, other.covariance)


NOTHING = np.full((100, 3), np.nan)
"""Of what there is of clouds that cannot be used, test_points tells."""
REFUSED: dict[str, tuple[Array, Array, Array, str]] = {
    "no source": (NOTHING, cloud(2), np.zeros(3), "source: .*0 of 100 points"),
    "no target": (cloud(2), NOTHING, np.zeros(3), "target: .*0 of 100 points"),
    **{
        f"{far} m apart": (cloud(2) + (far, 0.0, 0.0), cloud(2), np.zeros(3), "have a surface near")
        for far in (30.0, 600.0, 8e3)
    },
    "in space and planar": (cloud(3), cloud(2), np.zeros(3), "planar"),
    "guess is nan": (cloud(2), cloud(2), np.array((0.0, np.nan, 0.0)), "guess"),
    "guess is no pose": (cloud(2), cloud(2), np.zeros(2), "guess"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_matched_is_refused(matcher: Matcher, what: str) -> None:
    source, target, guess, said = REFUSED[what]
    with pytest.raises(ScanError, match=said):
        matcher.match(source, target, guess)


def corridor(rng: np.random.Generator, count: int, half_m: float, sigma_m: float) -> Array:
    """(count, 3) two parallel walls along x, evenly hit but for where that begins."""
    side = np.where(np.arange(count) % 2, 1.5, -1.5) + sigma_m * rng.standard_normal(count)
    along = half_m * np.linspace(-1.0, 1.0, count) + rng.uniform(-0.1, 0.1)
    return np.column_stack((along, side, np.zeros(count)))


@pytest.mark.parametrize(("count", "sigma_m"), [(200, 0.0), (200, 0.02), (4000, 0.02)])
@pytest.mark.parametrize("turned", [0.0, 0.7])
def test_a_corridor_fixes_nothing_along_it(
    matcher: Matcher, name: str, count: int, sigma_m: float, turned: float
) -> None:
    if name == "kiss":
        count = min(count, 1500)  # of more it keeps so few that noise decides on the heading
    rng = np.random.default_rng(7)
    true, guess = np.array((0.5, 0.1, 0.05)), np.array((0.2, 0.05, 0.02))
    target = corridor(rng, count, 10.0, sigma_m)
    source = seen_from(true, corridor(rng, count, 8.0, sigma_m))
    turn = np.array((0.0, 0.0, turned))
    found = matcher.match(source, planar.moved(turn, target), planar.compose(turn, guess))
    motion = planar.between(turn, found.motion)
    assert found.stiffness[0] < 3.0 < 0.05 * found.stiffness[1]
    assert abs(motion[0] - guess[0]) < 0.01
    assert np.abs(motion[1:] - true[1:]).max() < 0.02
    cos, sin = np.cos(motion[2]), np.sin(motion[2])
    along, across = np.array((cos, -sin, 0.0)), np.array((sin, cos, 0.0))
    assert along @ found.covariance @ along == pytest.approx(1.0, rel=0.02)
    assert across @ found.covariance @ across < 0.02**2


def test_the_nearest_few_points_of_a_dense_wall_look_like_poles() -> None:
    """The fault that lone clumps and thinning answer: with neither, a corridor seems fixed."""
    rng = np.random.default_rng(7)
    target = corridor(rng, 4000, 10.0, 0.02)
    place = corridor(rng, 500, 8.0, 0.0)[:, :2]
    few = SurfaceMap(target).patches(place)
    wide = SurfaceMap(thinned(target, 0.1), 24, 0.5, lone=True).patches(place)
    assert (few.filled & ~few.flat).mean() > 0.2
    assert not (wide.filled & ~wide.flat).any()
    assert np.abs(wide.normal[wide.flat, 0]).max() < 0.1 < np.abs(few.normal[few.flat, 0]).mean()


def test_thinning_gives_the_means_of_cells() -> None:
    points = np.array(((0.1, 0.1, 0.0), (0.3, 0.5, 0.0), (-0.1, 0.1, 0.0), (7.0, 7.0, 2.5)))
    kept = thinned(points, 1.0)
    expected = np.array(((-0.1, 0.1, 0.0), (0.2, 0.3, 0.0), (7.0, 7.0, 2.5)))
    np.testing.assert_allclose(kept, expected, atol=1e-12)


def test_a_matcher_that_makes_no_finite_motion_is_not_believed() -> None:
    class Broken(SurfaceMatcher):
        def align(self, source, target, start):  # type: ignore[no-untyped-def]
            yield np.full(3, np.nan)

    with pytest.raises(ScanError, match="finite"):
        Broken().match(cloud(2), cloud(2), np.zeros(3))


def test_a_wrong_motion_is_not_believed(matcher: Matcher) -> None:
    """A reach too short for the guess's error."""
    short = type(matcher)(MatchOptions(reaches_m=(0.05,)))  # type: ignore[call-arg]
    target = cloud(2)
    with pytest.raises(ScanError, match="surface near"):
        short.match(seen_from(np.array((1.5, 1.5, 0.8)), target), target, np.zeros(3))


def test_all_names_are_there() -> None:
    assert list(MATCHERS) == ["surface", "kiss", "point-to-point", "point-to-plane", "generalised"]


SIGMA_M = 0.02
PAIRS = 200


def trials(matcher: Matcher, rooms: list[Array], seed: int, pairs: int) -> tuple[Array, Array]:
    """Errors (N, 3) as right perturbations, and covariances (N, 3, 3)."""
    rng = np.random.default_rng(seed)
    error, covariance = [], []
    for k in range(pairs):
        source, target, true = scan_pair(rng, rooms[k % len(rooms)], SIGMA_M)
        guess = true + rng.normal(size=3) * (0.1, 0.1, 0.03)
        found = matcher.match(source, target, guess)
        error.append(planar.between(found.motion, true))
        covariance.append(found.covariance)
    return np.array(error), np.array(covariance)


def average_nees(error: Array, covariance: Array) -> float:
    whitened = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    return float(np.einsum("ni,ni->n", error, whitened).mean())


def within_band(value: float, pairs: int) -> bool:
    """Two-sided 95 % of an average of `pairs` chi-squares with three degrees of freedom."""
    low, high = chi2.ppf((0.025, 0.975), 3 * pairs) / pairs
    return bool(low < value < high)


@pytest.mark.slow
def test_covariances_are_as_wide_as_the_errors(matcher: Matcher) -> None:
    error, covariance = trials(matcher, [ELL, COURT, YARD], 2, PAIRS)
    assert within_band(average_nees(error, covariance), PAIRS)
    assert not within_band(average_nees(error, 0.5 * covariance), PAIRS)
    assert not within_band(average_nees(error, 2.0 * covariance), PAIRS)


@pytest.mark.slow
def test_covariances_lie_the_right_way(matcher: Matcher) -> None:
    """In a long hall: turned as the target's frame is, they no longer fit the errors."""
    error, covariance = trials(matcher, [LONG], 2, 60)
    rng = np.random.default_rng(2)
    right, wrong = average_nees(error, covariance), []
    for k in range(len(error)):
        *_, true = scan_pair(rng, LONG, SIGMA_M)
        rng.normal(size=3)
        cos, sin = np.cos(2.0 * true[2]), np.sin(2.0 * true[2])
        turn = np.array(((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)))
        wrong.append(average_nees(error[k : k + 1], turn @ covariance[k : k + 1] @ turn.T))
    assert np.mean(wrong) > 2.0 * right
