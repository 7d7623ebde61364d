"""What is left of a problem is the stated noise by all its parts, or the part that is not is named.

Broken variant throughout: chi-square of the whole, which a raised sigma takes into its band.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from graphslam import goodness_of_fit
from graphslam.goodness_of_fit import Goodness, far_less, rescaled, row_origins
from graphslam.graph_builder import COMPONENTS, build_graph
from graphslam.optimisers import levenberg_marquardt
from graphslam.optimum import chi_square_test
from graphslam.problem import SlamProblem
from graphslam.search import relaxed_values
from tests.graphslam import worlds

_POSES = 120


def solved(problem: SlamProblem) -> Goodness:
    graph = build_graph(problem)
    values = levenberg_marquardt(graph, relaxed_values(problem), 1e-6)[0]
    return Goodness(problem, graph, values)


def drive(seed: int = 0) -> SlamProblem:
    return worlds.loop(seed, _POSES).problem


def raised(problem: SlamProblem, entry: int) -> Goodness:
    """The problem with the sigma of ranges or bearings that takes chi-square to its middle."""
    goodness, name = solved(problem), ("range", "bearing")[entry]
    low, high = 1.0, 50.0
    for _ in range(12):
        factor = (low * high) ** 0.5
        test = rescaled(goodness, name, factor).test
        low, high = (factor, high) if test.chi2 > test.dof else (low, factor)
    return rescaled(goodness, name, high)


@pytest.mark.parametrize("seed", range(4))
def test_a_right_problem_fits(seed: int) -> None:
    goodness = solved(drive(seed))
    assert goodness.sound
    assert goodness.within
    assert goodness.departure is None


def test_more_noise_than_stated_fits_by_that_sigma_alone() -> None:
    problem = drive()
    more = np.array((0.0, 2.5)) * problem.sigma
    z = problem.z + more * np.random.default_rng(1).standard_normal(problem.z.shape)
    noisy = replace(problem, z=z)
    assert not solved(noisy).sound
    assert rescaled(solved(noisy), "bearing", np.sqrt(7.25)).sound
    assert not raised(noisy, 0).sound


def exchanged(problem: SlamProblem) -> SlamProblem:
    """Two landmarks take each other's label half way on."""
    label = problem.measurement_landmark.copy()
    rows = [np.flatnonzero(label == number) for number in (2, 3)]
    for own, other in ((rows[0], 3), (rows[1], 2)):
        label[own[len(own) // 2 :]] = other
    return replace(problem, measurement_landmark=label)


def wrong_rows(problem: SlamProblem) -> SlamProblem:
    """Two in a hundred are far off."""
    rows = np.random.default_rng(2).random(len(problem.z)) < 0.02
    return replace(problem, z=problem.z + rows[:, None] * np.array((0.0, 0.4)))


def one_landmark(problem: SlamProblem) -> SlamProblem:
    """A landmark's bearings are off half way on."""
    rows = np.flatnonzero(problem.measurement_landmark == 3)
    z = problem.z.copy()
    z[rows[len(rows) // 2 :], 1] += 0.4
    return replace(problem, z=z)


def offset(problem: SlamProblem) -> SlamProblem:
    """All bearings are off by five degrees, for a sensor that stands so."""
    return replace(problem, z=problem.z + (0.0, np.radians(5.0)))


@pytest.mark.parametrize("change", [exchanged, wrong_rows, one_landmark, offset])
def test_a_raised_sigma_explains_no_other_fault(
    change: Callable[[SlamProblem], SlamProblem],
) -> None:
    problem = change(drive())
    assert solved(problem).test.reading == "too high"
    for entry in (0, 1):
        other = raised(problem, entry)
        if other.test.reading == "plausible":  # as the broken variant asks
            assert not other.sound


def test_the_part_that_departs_is_named() -> None:
    problem = one_landmark(drive())
    part = solved(problem).departure
    assert part is not None
    assert (part.component, part.landmark) == ("bearing", 3)
    rows = np.flatnonzero(problem.measurement_landmark == 3)
    first, *_, last = problem.measurement_pose[rows]
    assert first <= part.first <= last


def test_less_noise_than_stated_is_within() -> None:
    quiet = worlds.loop(0, _POSES, noise=0.3).problem
    goodness = solved(quiet)
    assert goodness.test.reading == "too low"
    assert not goodness.sound
    assert goodness.within
    assert not solved(offset(drive())).within


def test_rows_come_from_their_factors() -> None:
    """As many as the graph's, each measurement's bearing before its range."""
    problem = worlds.with_frames(worlds.loop(0, 60), 0).problem
    rows = row_origins(problem)
    assert len({len(column) for column in rows}) == 1
    bearings = rows.component == COMPONENTS.index("bearing")
    assert rows.landmark[bearings].tolist() == problem.measurement_landmark.tolist()
    assert rows.pose[bearings].tolist() == problem.measurement_pose.tolist()
    assert set(rows.entry[bearings].tolist()) == {0}


def test_of_many_rows_some_are_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(goodness_of_fit, "_MOST_ROWS", 600)
    assert solved(drive()).sound
    assert not solved(offset(drive())).sound


def test_one_optimum_is_far_below_another() -> None:
    assert far_less(chi_square_test(20.0, 200), chi_square_test(200.0, 200))
    assert not far_less(chi_square_test(90.0, 200), chi_square_test(110.0, 200))
    assert not far_less(chi_square_test(200.0, 200), chi_square_test(20.0, 200))
