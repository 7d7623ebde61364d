"""NEES, NIS, whiteness and the filter-smoother identity, on Gaussians made by hand."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.distance import mahalanobis
from scipy.stats import chi2

from comparisons import statistics
from comparisons.checks.consistency.filter_smoother import (
    BLOCKS,
    FilterAgainstSmoother,
    filter_against_smoother,
)
from comparisons.checks.consistency.finding import (
    ConsistencyResult,
    consistency_lines,
    innovation_rows,
    smoothed_rows,
)
from comparisons.checks.consistency.nees import distances, map_errors, pose_errors, spanning_tree
from comparisons.covariances import units
from comparisons.innovations import SensorInnovations, whiten_alone
from comparisons.statistics import (
    BlockDeparture,
    Nis,
    Whiteness,
    independent,
    mean_band,
    normalise,
    normalised_difference,
    whiteness,
)
from comparisons.trace.events import SensorDescription
from tests.comparisons.drawn_innovations import drawn_sensor
from tests.helpers import Array, central_difference, present, random_covariance, relative_error

RUNS = 300
STEPS = 30
SIZE = 7
_MOTION = np.zeros((SIZE, SIZE))
_MOTION[:3, :3] = np.diag((0.04, 0.04, 0.04))
_PRIOR = np.diag((0.01, 0.01, 0.01, 4.0, 4.0, 4.0, 4.0))
_NOISE = np.diag((0.4, 0.2, 0.4, 0.2))
_MEAN = np.array([0.0, 0.0, 0.0, 5.0, 1.0, 4.0, -3.0])
_H = np.zeros((4, SIZE))
_H[:, :2] = -np.tile(np.eye(2), (2, 1))
_H[:, 2] = (0.5, -2.0, 0.7, 2.0)
_H[:, 3:] = np.eye(4)


@dataclass(frozen=True)
class Runs:
    """Of a linear Gaussian world: a vehicle's pose and two landmarks, many runs at once.

    A Kalman filter that knows the world is consistent exactly, and its covariances are the same in
    all runs; every wrong belief about the world is a broken variant.

    truth, filtered, smoothed: (T, R, 7). covariance, smoothed_covariance: (T, 7, 7).

    standard: (T, R, 4) whitened innovations.
    """

    truth: Array
    filtered: Array
    covariance: Array
    standard: Array
    smoothed: Array
    smoothed_covariance: Array


def simulate(
    runs: int,
    seed: int = 2,
    *,
    motion_scale: float = 1.0,
    noise_scale: float = 1.0,
    spoil: Callable[[Array], Array] = lambda covariance: covariance,
) -> Runs:
    """The scales are the filter's beliefs; `spoil` changes its covariance after each update."""
    rng = np.random.default_rng(seed)

    def draw(covariance: Array) -> Array:
        root = np.sqrt(np.diag(covariance))
        return root * rng.standard_normal((runs, len(root)))

    q, r = motion_scale * _MOTION, noise_scale * _NOISE
    truth, mean, p = _MEAN + draw(_PRIOR), np.tile(_MEAN, (runs, 1)), _PRIOR
    kept: list[tuple[Array, ...]] = []
    for _ in range(STEPS):
        truth, p = truth + draw(_MOTION), p + q
        predicted, predicted_p = mean, p
        innovation = truth @ _H.T + draw(_NOISE) - mean @ _H.T
        s = _H @ p @ _H.T + r
        gain = p @ _H.T @ np.linalg.inv(s)
        mean = mean + innovation @ gain.T
        p = p - gain @ s @ gain.T
        p = spoil(0.5 * (p + p.T))
        standard = np.linalg.solve(np.linalg.cholesky(s), innovation.T).T
        kept.append((truth, mean, p, standard, predicted, predicted_p))
    x, m, c, w, x_ahead, c_ahead = (np.array(column) for column in zip(*kept, strict=True))
    return Runs(x, m, c, w, *_smooth(m, c, x_ahead, c_ahead))


def _smooth(mean: Array, p: Array, predicted: Array, predicted_p: Array) -> tuple[Array, Array]:
    """Rauch, Tung and Striebel, the state staying as it is but for noise."""
    mean, p = mean.copy(), p.copy()
    for k in range(len(mean) - 2, -1, -1):
        gain = p[k] @ np.linalg.inv(predicted_p[k + 1])
        mean[k] += (mean[k + 1] - predicted[k + 1]) @ gain.T
        p[k] += gain @ (p[k + 1] - predicted_p[k + 1]) @ gain.T
    return mean, p


def test_squared_errors_and_bands_are_scipys() -> None:
    rng = np.random.default_rng(1)
    error = rng.standard_normal((4, 3))
    covariance = np.array([random_covariance(rng, 3) for _ in range(4)]) * 1e-7
    found = normalise(error, covariance)
    for e, p, value in zip(error, covariance, found.squared, strict=True):
        assert value == pytest.approx(mahalanobis(e, np.zeros(3), np.linalg.inv(p)) ** 2)
    assert mean_band(50, 3) == pytest.approx(chi2.ppf((0.025, 0.975), 150) / 50)
    assert tuple(np.round(mean_band(50, 3), 2)) == (2.36, 3.72)
    assert not mean_band(50, 3).holds(float("nan"))


def test_what_is_no_covariance_is_counted_and_gives_no_number() -> None:
    covariance = np.tile(np.eye(3), (6, 1, 1))
    covariance[1, 0, 1] = 0.1
    covariance[2, 2, 2] = 0.0
    covariance[3, :2, :2] = 1.0
    covariance[4, 0, 0] = np.nan
    error = np.ones((6, 3))
    error[5, 0] = np.inf
    found = normalise(error, covariance)
    assert found.row.tolist() == [0]
    assert found.squared.tolist() == [3.0]
    assert found.unusable == {"asymmetric": 1, "not positive definite": 2, "not finite": 2}
    nothing = normalise(error[1:2], covariance[1:2])
    assert nothing.mean is None
    assert nothing.inside is None


def test_the_headings_error_is_wrapped_and_one_that_is_not_shows() -> None:
    pose, true = np.array([[1.0, 2.0, 3.2]]), np.array([[1.0, 2.0, 3.1 - 2.0 * np.pi]])
    covariance = np.diag((0.1, 0.1, 0.01))[None]
    assert pose_errors(np.zeros(1), pose, covariance, true).pose.squared == pytest.approx(1.0)
    assert normalise(pose - true, covariance).squared[0] > 1000.0


@pytest.mark.parametrize("block", ["position", "heading"])
def test_what_leaves_the_limit_is_named_by_block_and_stretch(block: str) -> None:
    """And nothing is named of errors as large as they should be."""
    rng = np.random.default_rng(3)
    sigma, count = np.array((0.1, 0.1, 0.01)), 200
    error: Array = sigma * rng.standard_normal((count, 3))
    time_s = np.linspace(0.0, 99.5, count)
    covariance = np.tile(np.diag(sigma**2), (count, 1, 1))
    true, smoothed = np.zeros((count, 3)), 1e-6 * covariance

    def of(poses: Array) -> list[BlockDeparture | None]:
        by_truth = pose_errors(time_s, poses.copy(), covariance, true)
        by_smoother = filter_against_smoother(time_s, poses, covariance, true, smoothed)
        return [by_truth.departure, by_smoother.departure]

    assert of(error) == [None, None]
    off: Array = error.copy()
    off[60:120, BLOCKS[block]] *= 8.0
    for found in map(present, of(off)):
        assert found.block == block
        assert found.since_s == pytest.approx(30.0, abs=1.5)
        assert found.until_s == pytest.approx(59.5, abs=1.5)
        squared = (off / sigma)[:, BLOCKS[block]] ** 2
        assert found.squared_per_dof == pytest.approx(squared.mean(), rel=1e-5)
        assert f"of the {block} " in found.words


def test_distances_along_a_tree_and_their_jacobian() -> None:
    state = np.random.default_rng(2).normal(0.0, 10.0, 13)
    ends = spanning_tree(np.concatenate((state[None, :2], state[3:].reshape(-1, 2))))
    assert len(ends) == 5
    assert set(ends.ravel().tolist()) == set(range(6))
    length, jacobian = distances(state, ends)
    by_hand = central_difference(lambda s: distances(s, ends)[0], state)
    assert relative_error(jacobian, by_hand) < 1e-7
    a, b = (np.concatenate((state[None, :2], state[3:].reshape(-1, 2)))[e] for e in ends.T)
    assert length == pytest.approx(np.linalg.norm(a - b, axis=1))


def test_a_wrong_frame_shows_in_the_map_and_not_in_its_distances() -> None:
    rng = np.random.default_rng(3)
    mean = np.concatenate(([1.0, 1.0, 0.3], rng.uniform(-20.0, 20.0, 20)))
    covariance, nothing = 0.01 * np.eye(23), np.zeros((23, 23))
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    true = mean.copy()
    true[:2] = turn @ mean[:2] + 3.0
    true[3:] = (mean[3:].reshape(-1, 2) @ turn.T + 3.0).ravel()
    found = map_errors(mean, covariance, true, nothing, with_pose=True)
    assert present(found.map).squared[0] > 1e4
    assert present(found.distances).squared[0] < 1e-9
    assert present(found.distances).dof + found.too_short == 10


def test_the_surveys_own_errors_count_for_each_landmark() -> None:
    """Known to 1 m, surveyed to 2 m, off by 5 m: NEES 5, alone and together."""
    mean = np.array([0.0, 0.0, 0.0, 9.0, 1.0, -30.0, 4.0])
    doubt = np.diag([0.0, 0.0, 0.0, *4.0 * np.ones(4)])
    true = mean + np.array([0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 5.0])
    found = map_errors(mean, np.eye(7), true, doubt, with_pose=True)
    assert present(found.landmarks).squared == pytest.approx([5.0, 5.0], rel=1e-12)
    assert present(found.map).squared == pytest.approx([10.0], rel=1e-12)


def test_short_distances_are_left_out() -> None:
    mean = np.array([0.0, 0.0, 0.0, 5.0, 0.0, 5.1, 0.0])
    found = map_errors(mean, 0.01 * np.eye(7), mean, np.zeros((7, 7)), with_pose=True)
    assert (present(found.distances).dof, found.too_short) == (1, 1)


@pytest.mark.parametrize(("sigmas", "skipped"), [(4.9, 1), (5.1, 0)])
def test_a_distance_counts_from_five_of_its_sigmas_on(sigmas: float, skipped: int) -> None:
    mean = np.array([0.0, 0.0, 0.0, sigmas * np.sqrt(0.02), 0.0])
    found = map_errors(mean, 0.01 * np.eye(5), mean, np.zeros((5, 5)), with_pose=True)
    assert found.too_short == skipped


def test_units_of_the_state_change_no_comparison() -> None:
    """Kilometres, or thousandths of a degree: the same squares, directions and ratios."""
    rng = np.random.default_rng(6)
    smoothed = np.array([random_covariance(rng, 3) for _ in range(20)])
    filtered = smoothed + np.array([random_covariance(rng, 3) for _ in range(20)])
    difference, unit = rng.standard_normal((20, 3)), np.array((1e5, 1.0, 1e-5))
    plain = normalised_difference(difference, filtered, smoothed)
    scaled = normalised_difference(
        difference * unit, filtered * np.outer(unit, unit), smoothed * np.outer(unit, unit)
    )
    assert plain[1].tolist() == [3] * 20
    for one, other in zip(plain, scaled, strict=True):
        assert other == pytest.approx(one, rel=1e-6)


def test_one_landmark_alone_has_no_distances() -> None:
    mean = np.array([0.0, 0.0, 0.0, 5.0, 0.0])
    found = map_errors(mean, 0.01 * np.eye(5), mean, np.zeros((5, 5)), with_pose=False)
    assert (found.distances, present(found.distance).mean, found.too_short) == (None, None, 0)


def test_whiteness_is_ljung_and_boxs() -> None:
    values = np.random.default_rng(4).standard_normal(200)
    found = present(whiteness("range", "time", values, lags=5))
    r = np.array([values[k:] @ values[:-k] for k in range(1, 6)]) / (values @ values)
    q = 200 * 202 * np.sum(r**2 / (200 - np.arange(1, 6)))
    assert found.p_value == pytest.approx(chi2.sf(q, 5))
    assert found.band == pytest.approx(2.0 * np.sqrt(200 / 202 / (200 - np.arange(1, 6))))


def white_series(count: int, landmarks: int = 1) -> list[Whiteness]:
    rng, group = np.random.default_rng(7), np.repeat(np.arange(landmarks), count // landmarks)
    found = [whiteness("range", "time", rng.standard_normal(count), group) for _ in range(4000)]
    return [w for w in found if w is not None]


def test_ten_lags_of_a_short_series_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("comparisons.statistics._PER_LAG", 1)
    p = np.array([w.p_value for w in white_series(60)])
    assert np.mean(p < 0.01) > 0.016


@pytest.mark.parametrize("count", [30, 60, 150])
@pytest.mark.parametrize("landmarks", [1, 5])
def test_white_numbers_lie_in_the_bands_as_often_as_said(count: int, landmarks: int) -> None:
    """Of 4000 short series: p-values below 5 % and 1 %, first coefficients, and averages."""
    drawn = white_series(count, landmarks)
    p = np.array([w.p_value for w in drawn])
    assert 0.035 < np.mean(p < 0.05) < 0.06
    assert 0.004 < np.mean(p < 0.01) < 0.016
    assert 0.945 < np.mean([abs(w.autocorrelation[0]) < w.band[0] for w in drawn]) < 0.967
    assert 0.94 < np.mean([abs(w.mean) < w.mean_band for w in drawn]) < 0.967


def test_coloured_innovations_are_found_in_the_order_in_which_they_are_coloured() -> None:
    rng = np.random.default_rng(5)
    landmark = np.tile(np.arange(20), 50)
    lasting = rng.standard_normal(20)
    values = rng.standard_normal(1000) + lasting[landmark]
    order = np.argsort(landmark, kind="stable")
    by_landmark = present(whiteness("range", "landmark", values[order], landmark[order]))
    by_time = present(whiteness("range", "time", rng.permutation(values)))
    assert by_landmark.p_value < 1e-6 < 0.01 < by_time.p_value
    assert by_landmark.autocorrelation[0] == pytest.approx(0.5, abs=0.15)


def test_an_innovation_covariance_that_is_none_is_marked() -> None:
    spread = np.array([np.eye(2), -np.eye(2), 4.0 * np.eye(2)])
    standard = whiten_alone(np.full((3, 2), 2.0), spread, spread, np.ones(3))
    assert standard[[0, 2]].tolist() == [[2.0, 2.0], [1.0, 1.0]]
    assert np.isnan(standard[1]).all()


def test_a_part_is_whitened_as_if_it_were_whole() -> None:
    p, r, weight = 3.0 * np.eye(2), np.diag((1.0, 6.0)), 0.25
    part = whiten_alone(np.full((1, 2), 6.0), p + (r / weight)[None], (r / weight)[None],
                        np.array([weight]))  # fmt: skip
    assert part.tolist() == [[3.0, 2.0]]


def innovations(runs: Runs) -> SensorInnovations:
    """Of all runs, one after the other, the landmarks being 0 and 1 anew in each."""
    standard = runs.standard.transpose(1, 0, 2).reshape(-1, 2)
    count = len(standard)
    epoch = np.arange(count) // 2
    landmark_index = 2 * (np.arange(count) // (2 * STEPS)) + np.arange(count) % 2
    return drawn_sensor(
        SensorDescription(None, ("range", "bearing")), standard, epoch.astype(float), landmark_index
    )


@pytest.mark.parametrize(("first", "inside"), [(0.2, False), (-0.2, False), (0.1, True)])
def test_a_first_coefficient_has_the_first_band(first: float, inside: bool) -> None:
    sensor = innovations(simulate(1))
    one = replace(sensor.whiteness[0], autocorrelation=(first, 0.0), band=(0.15, 0.3))
    row = innovation_rows([replace(sensor, whiteness=(one,))])[-1]
    assert (row.value, row.band) == (f"{first:.2g}", "-0.15 to 0.15")
    assert row.inside is inside


def test_a_line_has_what_there_is() -> None:
    runs = simulate(1)
    sensor, smoothed = innovations(runs), against_smoother(runs, 0)
    nis = f"NIS {sensor.nis[0].mean / sensor.nis[0].dof:.2g}"
    beside = f"vs smoother {present(smoothed.squared_per_dof):.2g}"
    unclear = replace(smoothed, squared_per_dof=None)
    for one, words in ((replace(smoothed, departure=None), f"{nis}; {beside}"), (unclear, nis)):
        found = ConsistencyResult(
            ekf=None, smoother=None, innovations=[sensor], filter_against_smoother=one
        )
        assert consistency_lines((), found)[0][1] == f"per dof, expect 1: {words}"
    assert smoothed_rows("EKF", smoothed)
    assert smoothed_rows("EKF", unclear) == smoothed_rows("EKF", None) == []


def figures(runs: Runs) -> dict[str, tuple[float | None, tuple[float, float]]]:
    """Averages over the runs, at the end, with the bands that hold for them."""
    last, p = -1, np.broadcast_to(runs.covariance[-1], (RUNS, 7, 7))
    error = runs.filtered[last] - runs.truth[last]
    pose = pose_errors(np.zeros(RUNS), runs.filtered[last, :, :3], p[:, :3, :3],
                       runs.truth[last, :, :3]).pose  # fmt: skip
    found: dict[str, tuple[float | None, tuple[float, float]]] = {
        "pose": (pose.mean, mean_band(RUNS, 3)),
        "map": (normalise(error[:, 3:], p[:, 3:, 3:]).mean, mean_band(RUNS, 4)),
        "whole": (normalise(error, p).mean, mean_band(RUNS, 7)),
    }
    for nis in innovations(runs).nis:
        found[nis.name] = (nis.mean, nis.band)
    return found


def outside(runs: Runs) -> set[str]:
    return {
        name
        for name, (mean, (low, high)) in figures(runs).items()
        if mean is None or not low <= mean <= high
    }


def drop_cross_terms(covariance: Array) -> Array:
    dropped = covariance.copy()
    dropped[:3, 3:] = dropped[3:, :3] = 0.0
    return dropped


def test_a_filter_that_knows_its_world_lies_within_all_bands() -> None:
    runs = simulate(RUNS)
    assert outside(runs) == set()
    for one in innovations(runs).whiteness:
        assert one.p_value > 0.01
        assert abs(one.mean) < 1.5 * one.mean_band


@pytest.mark.parametrize(
    ("belief", "seen", "reading"),
    [
        ({"noise_scale": 2.0}, {"pose", "measurements", "range", "bearing"}, "too low"),
        ({"noise_scale": 0.5}, {"pose", "measurements", "range", "bearing"}, "too high"),
        ({"motion_scale": 0.5}, {"pose", "measurements", "range", "bearing"}, "too high"),
        ({"spoil": drop_cross_terms}, {"pose", "measurements"}, None),
    ],
)
def test_a_wrong_belief_falls_outside(
    belief: dict[str, Any], seen: set[str], reading: str | None
) -> None:
    runs = simulate(RUNS, **belief)
    assert outside(runs) >= seen
    if reading:
        both: Nis = innovations(runs).nis[0]
        assert both.reading == reading


def against_smoother(runs: Runs, run: int) -> FilterAgainstSmoother:
    k = np.arange(STEPS, dtype=float)
    pose = runs.filtered[:, run, :3], runs.covariance[:, :3, :3]
    return filter_against_smoother(
        k, *pose, runs.smoothed[:, run, :3], runs.smoothed_covariance[:, :3, :3]
    )


def test_an_asymmetric_covariance_gives_no_figure() -> None:
    runs = simulate(RUNS)
    runs.covariance[-1, 0, 2] += 0.01
    assert outside(runs) == {"pose", "whole"}
    f = against_smoother(runs, 0)
    assert f.unusable == {"asymmetric": 1}


@pytest.mark.parametrize("turns", [0, 1])
def test_filter_minus_smoother_has_the_difference_of_their_covariances(turns: int) -> None:
    """Per epoch, over the runs; whole turns between the headings change nothing."""
    runs = simulate(RUNS)
    runs.smoothed[:, :, 2] += turns * 2.0 * np.pi
    found = [against_smoother(runs, run) for run in range(RUNS)]
    for k in (3, 12, 24):
        dof = int(found[0].dof[k])
        assert dof >= 2
        assert mean_band(RUNS, dof).holds(float(np.mean([f.squared[k] for f in found])))
    assert found[0].dof[-1] == 0
    assert len(found[0].overconfident) == 0


@pytest.mark.parametrize(("factor", "holds"), [(1.0, True), (0.2, False)])
def test_the_mean_against_the_smoother_stays_in_its_band(factor: float, holds: bool) -> None:
    """Of a sound filter in most runs; not of one five times too sure."""
    runs = simulate(RUNS)
    found = [against_smoother(runs, run) for run in range(RUNS)]
    inside = [
        f.band.holds(f.squared_per_dof / factor) for f in found if f.band and f.squared_per_dof
    ]
    assert len(inside) == RUNS
    assert bool(np.mean(inside) >= 0.9) is holds
    single = [present(f.inside) for f in found]  # of a sound filter's epochs, one by one
    assert np.mean(single) == pytest.approx(0.95, abs=0.02)
    gap = np.diagonal(runs.covariance - runs.smoothed_covariance, 0, 1, 2)[:, :3]
    assert found[0].sigma == pytest.approx(np.sqrt(np.maximum(gap, 0.0)))


def test_correlated_numbers_count_for_fewer() -> None:
    """Of x_k = a x_k-1 + e, n (1 - a) / (1 + a); a series of one number repeated counts once."""
    rng = np.random.default_rng(0)
    white = rng.standard_normal(20000)
    assert independent(white) == pytest.approx(20000, rel=0.1)
    red = lfilter((1.0,), (1.0, -0.8), white)
    assert independent(red) == pytest.approx(20000 * 0.2 / 1.8, rel=0.2)
    assert independent(np.ones(100)) < 2.0


def test_the_identity_rejects_a_filter_that_is_not_sure_enough() -> None:
    runs = simulate(RUNS)
    runs.covariance[:] *= 1.3
    found = [against_smoother(runs, run) for run in range(RUNS)]
    for k in (3, 12, 24):
        assert np.mean([f.squared[k] for f in found]) < mean_band(RUNS, int(found[0].dof[k])).low


def test_a_filter_surer_than_the_smoother_is_told_with_its_begin() -> None:
    runs = simulate(2)
    runs.covariance[20:] *= 0.2
    found = against_smoother(runs, 0)
    assert found.overconfident[0] == 20
    assert found.ratio[-1] == pytest.approx(0.2)
    relinearised = simulate(2)
    relinearised.covariance[20:] *= 0.92 / against_smoother(relinearised, 0).ratio[-1]
    assert len(against_smoother(relinearised, 0).overconfident) == 0
    covariance = runs.covariance[:, :3, :3].copy()
    covariance[5] = -np.eye(3)
    covariance[6, 0, 0] = np.nan
    broken = filter_against_smoother(
        np.arange(STEPS, dtype=float),
        runs.filtered[:, 0, :3],
        covariance,
        runs.smoothed[:, 0, :3],
        runs.smoothed_covariance[:, :3, :3],
    )
    assert broken.unusable == {"not positive definite": 1, "not finite": 1}
    assert len(broken.time_s) == STEPS - 2
    assert np.isfinite(broken.squared).all()


def test_single_values_lie_in_the_band_of_one() -> None:
    """Not in that of a mean of two, which is narrower."""
    found = statistics.normalise(np.array([[1.0, 0.0], [0.2, 0.1]]), np.tile(np.eye(2), (2, 1, 1)))
    assert found.single_band == pytest.approx(chi2.ppf((0.025, 0.975), 2))
    assert found.inside == 0.5


def test_differences_are_measured_in_what_is_expected_else_in_what_is_recorded() -> None:
    recorded, expected = np.diag((4.0, 9.0, 0.0)), np.diag((1.0, 0.0, -1.0))
    assert units(recorded, expected).tolist() == [1.0, 3.0, 1.0]
