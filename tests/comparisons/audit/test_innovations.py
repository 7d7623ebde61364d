"""Innovations by sensor: exact bands, gates that are undone, and faults that have a time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chi2, kstest

from comparisons.arrays import Array
from comparisons.audit.audit import audit
from comparisons.audit.consistency import (
    Anchors,
    BlockErrors,
    ConsistencyDeparture,
    EventInnovations,
    _gating,
    _Turned,
    _white,
    departures,
    first_error,
)
from comparisons.audit.replay import BlockLayout
from comparisons.innovations import InnovationLog, SensorInnovations, _lengthened
from comparisons.statistics import Nis, onset, rarity, stretch
from comparisons.trace.events import Augment, SensorDescription, Snapshot, Update
from comparisons.trace.recorder import Recorder
from graphslam.arrays import Marginal
from graphslam.event_smoother import Link
from tests.comparisons.drawn_innovations import drawn_sensor
from tests.helpers import present

LEVEL = 1e-3


def figures(
    white: Array, used: NDArray[np.bool_] | None = None, gate: float | None = None
) -> SensorInnovations:
    return drawn_sensor(SensorDescription(gate, ("range", "bearing")), white, used=used)


def departed(
    white: Array, used: NDArray[np.bool_] | None = None, gate: float | None = None
) -> list[ConsistencyDeparture]:
    return departures(figures(white, used, gate), LEVEL)


def white(n: int, seed: int = 0, d: int = 2) -> Array:
    return np.random.default_rng(seed).standard_normal((n, d))


def test_sound_innovations_have_no_departure() -> None:
    found = figures(white(2000))
    assert departures(found, LEVEL) == []
    assert [one.name for one in found.nis] == ["measurements", "range", "bearing"]
    assert all(one.band.holds(one.mean) for one in found.nis)
    assert len(found.windows.event) == 60
    assert found.windows.event[-1] == 0.5 * (19670 + 19990)


def test_what_passes_a_gate_is_lengthened_to_what_arrived() -> None:
    for d in (1, 3):
        z, gate = white(20_000, d=d), 0.9
        nis = (z**2).sum(axis=1)
        passed = z[nis <= chi2.ppf(gate, d)]
        dof = np.full(len(passed), d)
        factor = _lengthened((passed**2).sum(axis=1), dof, gate)
        assert kstest((passed[:, 0] * factor), "norm").pvalue > 0.01
        assert kstest(passed[:, 0], "norm").pvalue < 1e-6  # as it would be without


def test_a_gates_rate_and_lengths_are_sound_together() -> None:
    z, gate = white(4000, 1), 0.99
    used = (z**2).sum(axis=1) <= chi2.ppf(gate, 2)
    found = figures(z, used, gate)
    assert departures(found, LEVEL) == []
    assert found.gating.count == int((~used).sum())
    assert found.gating.band is not None
    assert found.gating.band[0] < found.gating.count / 4000 < found.gating.band[1]
    unknown = figures(z, used)
    assert unknown.nis[0].mean < found.nis[0].mean


def test_the_first_error_is_judged_by_itself() -> None:
    """A start that is off by ten of its sigmas is in no average over the snapshots after it."""
    noise, spread, mean = 0.1, 1.0, 0.0
    with_it, without = Anchors(), Anchors()
    with_it.begin(Marginal(np.zeros(1), np.eye(1)))
    for event, z in enumerate(10.0 + np.random.default_rng(7).normal(0.0, 0.5, 40), 1):
        predicted = spread + noise
        back = spread / predicted  # of a random walk with an error of 10 at its begin
        then = np.full(1, mean)
        link = Link(np.full((1, 1), back), then, then, np.full((1, 1), (1.0 - back) * spread))
        gain = predicted / (predicted + 0.25)
        mean, spread = mean + gain * (z - mean), (1.0 - gain) * predicted
        now = Marginal(np.full(1, mean), np.full((1, 1), spread))
        with_it.add(event, now, link)
        without.add(event, now, None if event == 1 else link)
    found, first = with_it.smoothed()
    assert found == without.smoothed().averaged
    assert without.smoothed().first is None
    assert present(first).mean[0] > 5.0


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda z: 1.2 * z, "NIS is too high"),
        (lambda z: 0.8 * z, "NIS is too low"),
        (lambda z: z + [0.0, 0.3], "mean of bearing"),
        (lambda z: z * [1.4, 1.0], "NIS of range is too high"),
        (
            lambda z: np.column_stack((z[:, 0], np.convolve(z[:, 1], [0.8, 0.6])[: len(z)])),
            "bearing is correlated in time",
        ),
    ],
)
def test_each_departure_is_found(spoil: object, text: str) -> None:
    assert callable(spoil)
    found = departed(np.asarray(spoil(white(2000, 2))))
    assert any(text in one.what for one in found), found


def test_a_fault_has_a_time() -> None:
    z = white(3000, 3)
    z[1234:1600] *= 2.5
    found = departed(z)
    assert found[0].what.startswith("NIS is too high: ")
    timed = [one for one in found if one.until is not None]
    assert len(timed) == 1
    assert found[0].event == timed[0].event, "all of them depart from the first stretch on"
    assert abs((timed[0].event or 0) - 12340) <= 100
    assert abs((timed[0].until or 0) - 15990) <= 500
    mean = float(timed[0].what.split(": ")[1].split(",")[0])
    first = (z[1200:1250] ** 2).sum(axis=1)  # of sixty stretches, the first one that is off
    assert mean == pytest.approx(first.mean(), rel=1e-2)
    assert timed[0].what.endswith(", expected 2")


@pytest.mark.parametrize("rejected", [0, 3, 20, 34])
def test_a_rate_of_rejections_has_the_binomials_two_tails(rejected: int) -> None:
    used = np.arange(2000) >= rejected
    gating = figures(white(2000, 5), used, 0.99).gating
    (found,) = _gating(gating, 2.0)
    tails = binom.cdf(rejected, 2000, 0.01), binom.sf(rejected - 1, 2000, 0.01)
    assert found.p_value == pytest.approx(min(1.0, 2.0 * min(tails)), rel=1e-9)
    if not rejected:  # no series of rejections weighs more
        assert found.weight == pytest.approx(-np.log(tails[0]), rel=1e-9)


def test_few_innovations_that_are_far_off_are_told() -> None:
    """Too few to be judged in stretches."""
    assert departed(white(8)) == []
    assert any("NIS is too high" in one.what for one in departed(6.0 * white(8)))


def test_what_is_correlated_at_many_lags_weighs_more() -> None:
    """Four sigma at each of five lags, beside six at one."""
    one = figures(white(100)).whiteness[0]
    band = (0.1,) * 5
    many, single = (
        _white(replace(one, autocorrelation=c, band=band, p_value=0.0), LEVEL)[0].weight
        for c in ((0.2,) * 5, (0.3, 0.0, 0.0, 0.0, 0.0))
    )
    assert many > single
    assert many == pytest.approx(rarity(16.0, 5))


def errors_of(squared: Array) -> BlockErrors:
    """Of a state of two numbers in one block, an event each tenth of a second."""
    layout = BlockLayout(("pose",), (2,))
    found = BlockErrors(layout)
    for number, value in enumerate(squared.tolist()):
        e = np.sqrt([value, 0.0])
        found.add(Snapshot(number, 0.1 * number, ("pose",), np.eye(2), None, e), e, layout)
    return found


def test_an_average_departs_beyond_its_share_of_the_level() -> None:
    """A quarter of it is the whole state's; the share itself is within."""
    errors = errors_of(np.full(20, 6.0))
    averages = errors.averages()
    p = averages[""].p_value
    assert 0.0 < p < 0.1
    assert [one.p_value for one in errors.departures(averages, 4.1 * p)] == [p]
    assert errors.departures(averages, 4.0 * p) == []


def test_a_stretch_departs_beyond_its_share_of_the_level() -> None:
    """One of ten stretches has a tenth of it."""
    squared = np.random.default_rng(0).chisquare(2, 1000)
    squared[300:400] *= 1.6
    errors = errors_of(squared)
    whole = errors.averages()[""]
    (found,) = errors._stretch(whole, 1.0)
    assert (found.event, found.until) == (300, 399)
    assert errors._stretch(whole, 9.9 * found.p_value) == []
    assert len(errors._stretch(whole, 10.1 * found.p_value)) == 1


def test_a_first_error_weighs_what_it_is_rare_by() -> None:
    """Of one number, or of two; the rarer one is told."""
    layout = BlockLayout(("place", "bias"), (2, 1))
    error = np.array([4.0, 4.0, 5.0])
    found = first_error(layout, np.eye(3), error, np.zeros((3, 3)), LEVEL)
    assert found is not None
    assert "block `place`" in found.what
    assert found.weight == pytest.approx(rarity(16.0, 2))
    alone = first_error(layout, np.eye(3), error * [0.1, 0.1, 1.0], np.zeros((3, 3)), LEVEL)
    assert alone is not None
    assert alone.weight == pytest.approx(rarity(25.0, 1))


def test_a_measurement_is_of_the_landmark_that_its_rows_touch() -> None:
    """Of two stacked ones each is of its own; one of two landmarks, or of none, is of neither."""
    log, layout = EventInnovations({}), BlockLayout(("pose", "a", "b"), (3, 2, 2))
    for number, name in enumerate(("a", "b")):
        g, noise = np.zeros((2, 3)), np.eye(2)
        log.begin(Augment(1, None, name, ("pose",), g, noise, noise, numbers=np.array([number])))
    h = np.zeros((8, 7))
    h[:, :3] = 1.0
    h[:2, 3:5] = h[2:4, 5:7] = h[4:6, 3:7] = 1.0
    one = np.eye(8)
    event = Update(2, None, "s", ("pose", "a", "b"), np.zeros(8), h, one, True, None, None)
    assert log._seen(event, layout, 4).tolist() == [0, 1, -1, -1]


def test_the_onset_of_a_step_and_its_end() -> None:
    values = np.concatenate((np.ones(50), 3.0 * np.ones(30)))
    assert onset(values, 3.0, 1.0) == 50
    assert onset(-values, -3.0, -1.0) == 50
    for sound, last in ((0, 79), (4, 83), (40, 79)):
        series = np.concatenate((values, np.ones(sound)))
        assert stretch(series, float(series.mean()), 1.0) == (50, last)


def test_no_innovation_no_figure() -> None:
    nothing = figures(np.full((5, 2), np.nan))
    assert (nothing.unusable, len(nothing.gating.event), nothing.nis) == (5, 0, ())
    assert departures(nothing, LEVEL) == []
    assert len(figures(white(3)).windows.event) == 1


def test_vectors_of_different_length_are_judged_together() -> None:
    log, rng = InnovationLog("features"), np.random.default_rng(5)
    for i in range(500):
        log.add(i, 0.1 * i, rng.standard_normal(1 + i % 4))
    found = log.judge()
    assert departures(found, LEVEL) == []
    assert len(found.nis) == 1
    assert found.nis[0].mean == pytest.approx(2.5, abs=0.3)


def test_the_words_of_different_lengths_rest_on_their_mean() -> None:
    """On 2.4 degrees of freedom, which are not 2: the reading of `run` is that of `audit`."""
    log, rng = InnovationLog("features"), np.random.default_rng(6)
    for i in range(5000):
        log.add(i, 0.1 * i, rng.standard_normal(2 if i % 5 < 3 else 3))
    (nis,) = log.judge().nis
    assert nis.worded(LEVEL)[0] == nis.reading == "plausible"
    assert (nis.dof, nis.expected, nis.expected_words) == (2, 2.4, "2.4")
    assert nis.chance() > LEVEL
    assert Nis(nis.name, nis.dof, nis.count, nis.mean, nis.band).worded(LEVEL)[0] == "too high"


def test_a_stacked_event_is_as_many_measurements() -> None:
    """Further parts of one, and those that initialised a landmark, are left out."""
    log, z = InnovationLog("radar", SensorDescription(None, ("range", "bearing"))), white(3, 7)
    for named in ([0, 1, 2], [1], [3, 4, 5]):
        numbers = np.array(named, dtype=float)
        landmarks = np.arange(len(numbers))
        log.add(0, 1.0, z[: len(numbers)].ravel(), number=numbers, landmark=landmarks)
    found = log.judge(initialised=(9, 4, 5))
    assert [one.count for one in found.nis] == [4, 4, 4]
    kept = np.vstack((z, z[:1]))
    assert found.nis[1].mean == pytest.approx(np.mean(kept[:, 0] ** 2))


@pytest.mark.slow
def test_the_level_is_kept() -> None:
    """Of 3,000 sound sensors about 1 % depart at a level of 1 %; at most 2 % do."""
    rng = np.random.default_rng(6)
    out = sum(bool(departures(figures(rng.standard_normal((60, 2))), 0.01)) for _ in range(3000))
    assert 3 <= out <= 60


@pytest.mark.parametrize(("turn", "said"), [(2.0 * np.pi, "2 pi"), (360.0, "360"), (5.0, "")])
def test_differences_that_are_whole_turns_off_are_told(
    turn: float, said: str, tmp_path: Path
) -> None:
    """A gate before the wrap rejects good measurements; other outliers are no turns."""
    rng = np.random.default_rng(3)
    with Recorder(tmp_path / "run.trace", gates={"compass": 0.99}) as record:
        record.prior({"heading": 1}, 1e-4)
        for k in range(100):
            seen = 0.03 * rng.standard_normal()
            if k % 30 == 10:
                record.reject("compass", seen - turn, 1.0, 9e-4)
            else:
                record.update("compass", seen, 1.0, 9e-4)
    found = [one for one in audit(tmp_path / "run.trace").findings if "wrap the" in one.text]
    assert [one.event for one in found] == ([11] if said else [])
    assert not said or f"3 innovations of component 0 are {said} off" in found[0].text


@pytest.mark.parametrize(("spread", "told"), [(0.03, True), (2.0, False)])
def test_turns_are_told_among_many_outliers_where_chance_does_not_make_them(
    spread: float, told: bool
) -> None:
    """As many outliers lie anywhere; those near to a turn are too many only if they are near."""
    rng, turned = np.random.default_rng(4), _Turned()
    for number in range(12):
        turned.add(2 * number, 2.0 * np.pi + spread * rng.uniform(-1.0, 1.0), 0.03)
        turned.add(2 * number + 1, rng.uniform(0.5, 20.0), 0.03)
    found = turned.departure("heading")
    assert (found is not None) == told
    assert found is None or "of heading are 2 pi off" in found.what


@pytest.mark.parametrize("count", [1, 2])
def test_two_whole_turns_are_no_accident(count: int) -> None:
    turned = _Turned()
    for number in range(count):
        turned.add(number, 2.0 * np.pi, 0.03)
    found = turned.departure("heading")
    assert (found is not None) == (count == 2)
    assert found is None or found.what.startswith("2 innovations of heading are 2 pi off")


def test_what_is_farther_off_weighs_more() -> None:
    values = white(400)
    values[:, 0] *= 1.5
    values[:, 1] *= 3.0
    first = max(departed(values), key=lambda one: one.weight)
    assert first.what.startswith("NIS of bearing is too high")


@pytest.mark.parametrize("ratio", [0.1, 0.5, 1.5, 20.0])
def test_rarity_bounds_the_chance(ratio: float) -> None:
    """By how many powers of e, also where the chance itself is no number above zero."""
    for dof in (1, 10, 1000):
        tail = chi2.logsf if ratio > 1.0 else chi2.logcdf
        chance = -float(tail(ratio * dof, dof))
        assert 0.0 < rarity(ratio, dof) <= chance
        assert chance == np.inf or rarity(ratio, dof) > chance - 5.0 - np.log(dof)
    assert rarity(1.0, 100.0) == 0.0
    assert chi2.sf(6e4 * 100, 100) == chi2.sf(50.0 * 100, 100) == 0.0
    assert rarity(6e4, 100.0) > rarity(50.0, 100.0) > rarity(0.1, 100.0)


def gate_of(rejected: NDArray[np.bool_], gate: float | None) -> list[ConsistencyDeparture]:
    time_s: Array = 0.1 * np.arange(len(rejected), dtype=np.float64)
    sensor = SensorDescription(gate, ("range", "bearing"))
    drawn = drawn_sensor(sensor, white(len(rejected), 8), time_s, used=~rejected)
    return _gating(drawn.gating, LEVEL)


def test_a_lock_out_is_said_with_its_beginning() -> None:
    """A gate that rejects as often, but now and then, has none."""
    rows = np.arange(400)
    (found,) = gate_of(rows >= 360, 0.99)
    assert found.what.endswith("nominal 1 %): everything from 36 s on, 40 in a row")
    assert (found.event, found.fault) == (3600, True)
    (found,) = gate_of((rows >= 100) & (rows < 140) | (rows == 390), 0.99)
    assert found.what.endswith("nominal 1 %): 40 in a row, from 10 s to 13.9 s")
    assert found.event == 1000
    (found,) = gate_of(rows % 10 == 0, 0.99)
    assert found.what == "rejects 40 of 400 (10 %, nominal 1 %)"
    assert gate_of(rows == 7, 0.99) == []


def test_without_a_declared_gate_only_a_lock_out_to_the_end_is_told() -> None:
    rows = np.arange(400)
    (found,) = gate_of(rows >= 360, None)
    assert (found.what, found.fault) == ("rejects everything from 36 s on, 40 in a row", False)
    for rejected in ((rows >= 100) & (rows < 140), rows >= 395, rows % 2 == 0):
        assert gate_of(rejected, None) == []
