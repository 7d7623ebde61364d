"""Pose graphs with a fault of their edges: what is named, and that nothing sound is accused."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.explain import edge_fits
from comparisons.explain import edges as search
from comparisons.explain.disagreement import disagreement
from comparisons.explain.edge_fits import are_white, fitted_noise, likelihood
from comparisons.explain.edges import EdgeCandidate, equally_good, explained
from comparisons.explain.loops import loop_sizes
from comparisons.faults.edges import (
    CLOSURES,
    LANDMARKS,
    ODOMETRY,
    POSITIONS,
    EdgeSlot,
    columns,
    composed,
    faults_of,
    inverse,
    slots,
    with_columns,
)
from graphslam.goodness_of_fit import Goodness
from graphslam.increments import dead_reckoned
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.scan import planar
from graphslam.smoother import smooth
from tests.graphslam.g2o_files import everything, loosened, rounds
from tests.graphslam.test_unclosed import squares

Spoil = Callable[[SlamProblem], SlamProblem]
FRAME = np.array((0.3, 0.1, np.pi))


def inverted_matrix(covariance: Array) -> Array:
    return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def root(covariance: Array) -> Array:
    """What is read where the root of an information, upper triangle, stands for it."""
    upper = np.linalg.cholesky(np.linalg.inv(covariance)).mT
    return inverted_matrix(np.triu(upper) + np.triu(upper, 1).mT)


def of_closures(change: Callable[[Array], Array]) -> Spoil:
    """Change what closures measure."""

    def spoil(problem: SlamProblem) -> SlamProblem:
        closed = problem.loop_closures
        return replace(problem, loop_closures=replace(closed, motion=change(closed.motion)))

    return spoil


def of_odometry(change: Callable[[Array], Array]) -> Spoil:
    return lambda problem: replace(problem, increment=change(problem.increment))


def weighed(change: Callable[[Array], Array], *kinds: str) -> Spoil:
    """Change covariances as they are read."""

    def spoil(problem: SlamProblem) -> SlamProblem:
        slot = EdgeSlot("", kinds)
        edges = columns(problem, slot)
        return with_columns(problem, slot, edges._replace(covariance=change(edges.covariance)))

    return spoil


def without_odometry(problem: SlamProblem) -> SlamProblem:
    """Its steps are closures, as in a graph whose edges join no poses in a row."""
    edges = columns(problem, EdgeSlot("", (ODOMETRY, CLOSURES)))
    none = np.full_like(problem.increment_covariance, np.nan)
    return replace(problem, increment_covariance=none, loop_closures=LoopClosures(*edges[:4]))


def winding(sigma_rad: float = 0.004) -> SlamProblem:
    """No two motions are alike, and most poses are closed to a later one."""
    rng, sigma = np.random.default_rng(0), np.array((0.05, 0.03, sigma_rad))
    moves = rng.uniform((0.5, -0.3, -0.9), (1.5, 0.3, 0.9), (48, 3))
    truth = dead_reckoned(np.zeros(3), moves)
    first = np.arange(1, 40)
    second = first + 3 + rng.integers(0, 5, len(first))
    pairs = zip(truth[first], truth[second], strict=True)
    closed = np.array([planar.between(*pair) for pair in pairs])
    spread = np.diag(sigma**2)
    return replace(
        rounds(),
        increment=moves + sigma * rng.standard_normal(moves.shape),
        increment_covariance=np.tile(spread, (len(moves), 1, 1)),
        loop_closures=LoopClosures(
            first,
            second,
            closed + sigma * rng.standard_normal(closed.shape),
            np.tile(spread, (len(first), 1, 1)),
        ),
    )


def of_sensor(motion: Array) -> Array:
    frame = FRAME[None]
    return composed(composed(inverse(frame), motion), frame)


def said(problem: SlamProblem) -> str:
    found = explained(smooth(problem, {}))
    return "" if found is None else found.words


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (of_closures(inverse), "the loop closures fit when inverted"),
        (of_odometry(inverse), "the odometry's edges fit when inverted"),
        (
            of_closures(lambda z: z * (1.0, -1.0, 1.0)),
            "the loop closures fit with the opposite sign of y",
        ),
        (
            of_odometry(lambda z: z[:, [1, 0, 2]]),
            "the odometry's edges fit when they stand in the order y, x, heading",
        ),
        (
            of_closures(lambda z: z * (1.0, 1.0, np.degrees(1.0))),
            "the loop closures fit when their headings are in degrees",
        ),
        (
            of_odometry(lambda z: np.concatenate((z[:1], z[:-1]))),
            "the odometry's edges fit when each holds what the edge before it measured",
        ),
        (
            lambda problem: without_odometry(
                weighed(inverted_matrix, ODOMETRY, CLOSURES)(problem)
            ),
            "all edges between poses fit when what .* is the covariance",
        ),
        (weighed(inverted_matrix, ODOMETRY), "the odometry's edges fit when .* is the covariance"),
        (
            weighed(inverted_matrix, ODOMETRY, CLOSURES),
            "all edges between poses fit when .* is the covariance",
        ),
        (weighed(root, CLOSURES), "the loop closures fit when .* is a square root of it"),
    ],
)  # fmt: skip
def test_what_was_meant_is_found(spoil: Spoil, words: str) -> None:
    problem = squares()
    right = smooth(problem, {})
    assert right.optimality.chi_square.reading == "plausible"
    found = explained(smooth(spoil(problem), {}))
    assert found is not None
    assert any(re.match(words, one) for one in found.words.split(", or ")), found.words


def test_the_order_of_an_information_is_told() -> None:
    words = said(weighed(lambda c: c[:, [2, 0, 1]][:, :, [2, 0, 1]], CLOSURES)(winding()))
    assert "the loop closures fit when their information stands in the order hh hx hy" in words


def test_equally_good_explanations_are_named_together() -> None:
    """A mirrored odometry is no other than mirrored closures, where nothing else tells."""
    mirrored = of_odometry(lambda z: z * (1.0, -1.0, -1.0))(squares())
    words = said(mirrored).split(", or ")
    assert "the odometry's edges fit with the opposite sign of y and heading" in words
    assert "the loop closures fit with the opposite sign of y and heading" in words


def test_numbers_are_fitted_with_their_interval() -> None:
    """Of a sensor that looks backwards, 0.3 m ahead and 0.1 m to the left, and of a scale."""
    found = said(of_closures(of_sensor)(winding()))
    frame = re.search(
        r"the loop closures fit as motions of a frame (\S+) m ahead and (\S+) m to the left and "
        r"turned by (\S+) degrees \(\+- (\S+) m, (\S+) degrees\)",
        found,
    )
    assert frame is not None
    ahead, left, turn, width_m, width_deg = map(float, frame.groups())
    assert max(abs(ahead - 0.3), abs(left - 0.1)) < width_m < 0.1
    assert 180.0 - abs(turn) < width_deg < 5.0
    found = said(of_odometry(lambda z: z * (1.3, 1.3, 1.0))(winding()))
    size = re.search(r"odometry's edges fit when their translations are (\S+) \((\S+) to (\S+)\)",
                     found)  # fmt: skip
    assert size is not None
    _, low, high = map(float, size.groups())
    assert low < 1.3 < high < 1.1 * low


def test_a_single_wrong_edge_is_named_with_its_change() -> None:
    problem = squares()
    closed = problem.loop_closures
    motion = closed.motion.copy()
    motion[5] = inverse(motion[5:6])[0]
    first, second = closed.first[5], closed.second[5]
    found = said(of_closures(lambda _: motion)(problem))
    assert found.startswith(
        f"edge {first} to {second} (a loop closure) does not agree with the rest, which fits "
        "without it"
    )
    assert "when inverted" in found


def test_informations_that_tell_nothing_still_tell_the_direction() -> None:
    """A plausible chi-square of an optimum that is not verified."""
    wrong = of_closures(inverse)(loosened(rounds(), 300.0))
    result = smooth(wrong, {})
    assert result.optimality.chi_square.reading == "plausible"
    found = explained(result)
    assert found is not None
    assert "the loop closures fit when inverted" in found.words
    assert found.chi_square.chi2 < 1e-2 * result.optimality.chi_square.chi2


@pytest.mark.parametrize("factor", [1.0, 30.0])
def test_noise_of_another_size_is_no_fault_of_the_edges(factor: float) -> None:
    """A chi-square far out, and no other reading that fits; broken: one that takes the nearest."""
    found = explained(smooth(loosened(rounds(), factor), {}))
    assert found is None or found.is_note


def _wild_later(motion: Array) -> Array:
    """Closures of squares: from the seventh on they are off by a metre and a radian."""
    wild = motion + np.random.default_rng(1).standard_normal(motion.shape)
    return np.where(np.arange(len(motion))[:, None] > 5, wild, motion)


def test_unlike_noise_is_no_explanation() -> None:
    """Errors that no change makes: nothing is named, and it is said where the edges disagree."""
    problem = squares()
    closed = problem.loop_closures
    result = smooth(of_closures(_wild_later)(problem), {})
    assert explained(result) is None
    place = re.search(r"all fit up to pose (\d+), and no longer", disagreement(result))
    assert place is not None
    assert closed.second[closed.first <= 6].min() <= int(place[1]) < closed.second.max()
    assert disagreement(smooth(problem, {})) == ""


def test_a_search_without_the_rule_of_the_noise_is_rejected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Broken: what is merely likelier is named."""
    result = smooth(of_closures(_wild_later)(squares()), {})
    assert explained(result) is None
    monkeypatch.setattr(Goodness, "sound", True)
    for module in (search, edge_fits):
        monkeypatch.setattr(module, "optimum_of", lambda p, low=None, any_size=False: _any(p))
    assert explained(result) is not None


def _any(problem: SlamProblem) -> Goodness | None:
    try:
        result = smooth(problem, {})
    except RuntimeError:
        return None
    return Goodness(result.problem, result.graph, result.values)


def test_likelihoods_do_not_depend_on_where_the_fault_is() -> None:
    """A scale of all edges and its inverse of all ranges are one model, whatever the map's size."""
    problem = everything().problem
    problem = replace(
        problem, position_pose=problem.position_pose[:0], position=problem.position[:0],
        position_covariance=problem.position_covariance[:0], surveyed=problem.surveyed[:0],
        surveyed_covariance=problem.surveyed_covariance[:0],
        prior_covariance=1e-12 * np.eye(3), prior_pose=np.zeros(3),
    )  # fmt: skip
    scaled = np.diag((1.1, 1.1, 1.0))
    larger = replace(
        problem,
        increment=problem.increment @ scaled,
        increment_covariance=scaled @ problem.increment_covariance @ scaled,
    )
    smaller = replace(problem, z=problem.z * (1.0 / 1.1, 1.0), sigma=problem.sigma * (1 / 1.1, 1.0))
    values: list[Goodness] = []
    for one in (larger, smaller):
        result = smooth(one, {})
        goodness = Goodness(result.problem, result.graph, result.values)
        values.append(goodness)
    steps, measurements = len(problem.steps), len(problem.z)
    volumes = 2.0 * np.log(1.1) * np.array((steps, -measurements))
    edges, ranges = (likelihood(*pair) for pair in zip(values, volumes, strict=True))
    assert edges == pytest.approx(ranges, abs=1.0)


def test_informations_are_judged_entry_by_entry() -> None:
    """Of heading, x, y as of x, y, heading, multiplied so that their chi-square is plausible."""
    problem, odometry = winding(0.02), EdgeSlot("", (ODOMETRY,))
    assert are_white(optimum(problem), odometry)
    wrong = weighed(lambda c: c[:, [2, 0, 1]][:, :, [2, 0, 1]], ODOMETRY)(problem)
    noise, goodness = fitted_noise(odometry, optimum(wrong)) or (None, None)
    assert noise is not None
    assert goodness is not None
    assert goodness.test.reading == "plausible"
    assert not are_white(goodness, odometry)


def optimum(problem: SlamProblem) -> Goodness:
    result = smooth(problem, {})
    return Goodness(result.problem, result.graph, result.values)


def test_nothing_is_named_where_something_likelier_leaves_more_than_noise() -> None:
    test = smooth(squares(), {}).optimality.chi_square
    sound = EdgeCandidate("this", "edges", -100.0, test)
    for value, named in ((-200.0, []), (-110.0, ["this"])):
        other = EdgeCandidate("that", "edges", value, test, is_sound=False)
        assert [one.words for one in equally_good([sound, other])] == named
    vague = EdgeCandidate("vaguely", "edges", -120.0, test, is_vague=True)
    assert equally_good([vague]) == []
    assert [one.words for one in equally_good([vague, sound])] == ["vaguely", "this"]


@pytest.mark.parametrize("kind", [ODOMETRY, CLOSURES, LANDMARKS, POSITIONS])
def test_columns_go_back_as_they_came(kind: str) -> None:
    closed = everything().problem
    problem = replace(closed, loop_closures=squares().loop_closures)
    slot = EdgeSlot("", (kind,))
    again = with_columns(problem, slot, columns(problem, slot))
    for name in ("increment", "z", "sigma", "position"):
        assert np.allclose(getattr(again, name), getattr(problem, name), rtol=1e-12)
    assert again.loop_closures.motion.tolist() == problem.loop_closures.motion.tolist()


def test_words_of_faults_say_the_slot_and_the_change() -> None:
    """No two changes of one slot say the same, but for what the information does."""
    problem = replace(everything().problem, loop_closures=squares().loop_closures)
    for slot in slots(problem):
        said_words = [one.kind for one in faults_of(slot)]
        assert all(one.startswith(slot.words) for one in said_words)
        assert max(map(said_words.count, said_words)) <= 2


def test_loops_close_in_a_right_graph_alone() -> None:
    """About one in the median; a wrong sign opens them."""
    problem = rounds(8)
    assert loop_sizes(problem).max() < 2.0
    assert loop_sizes(of_closures(lambda z: z * (1.0, 1.0, -1.0))(problem)).max() > 100.0


def test_a_frames_motion_is_carried_back() -> None:
    """Also the noise: of a perturbation before and after the frame."""
    motion, frame = np.array([[1.0, 0.2, 0.3]]), FRAME
    back = planar.compose(planar.compose(frame, of_sensor(motion)[0]), inverse(frame[None])[0])
    assert np.allclose(planar.wrapped(back), motion[0])
