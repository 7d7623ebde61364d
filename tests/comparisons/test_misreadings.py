"""What a program misreads is a column and a change: each is named, with a trace and without."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import fused_positions, settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.checks.diagnosis.known_model_errors import explain
from comparisons.checks.diagnosis.motion_hypotheses import read_controls
from comparisons.config import EkfConfig
from comparisons.errors import InputError
from comparisons.faults.columns import LogColumn, read_columns
from comparisons.faults.misreadings import Misreading, joined_misreadings, misreadings
from comparisons.faults.streams import stream_faults
from comparisons.logs.log import Log
from tests.comparisons.kinds_of_logs import MAPS, ODOMETRY

STREAMS = "odometry", "measurements", "positions"
LAGS = (1, -1, 2, -2)
DRAWN = 16
SAME = {"the odometry is zero": "the speed is zero"}
"""Of a car: one that stands turns nowhere."""
LEAST = {"odometry": -np.inf, "measurements": 1e-3}
"""Of a stream's first column, in a log."""


@pytest.fixture(scope="module", params=ODOMETRY)
def log(request: pytest.FixtureRequest) -> Log:
    return MAPS["positions at the end"](ODOMETRY[request.param]())


def of_stream(log: Log, stream: str) -> list[Misreading]:
    columns = read_columns(log, stream)
    return [*misreadings(columns, LAGS), *joined_misreadings(columns)]


@pytest.mark.parametrize("stream", STREAMS)
def test_each_changes_its_own_columns_and_has_its_own_words(log: Log, stream: str) -> None:
    whole = read_columns(log, stream)[0]
    values, words = whole.read(log), Counter[str]()
    for one in of_stream(log, stream):
        words[one.said(*one.start)] += 1
        if one.start and one.change.is_neutral:
            assert np.allclose(one.values(values, *one.start), values, rtol=0.0, atol=1e-15)
        changed = one.values(values, *(number + 0.3 for number in one.start))
        entries = {entry for column, _ in one.parts for entry in column.entries}
        others = [k for k in range(values.shape[1]) if k not in entries]
        assert changed.shape == values.shape
        assert np.array_equal(changed[:, others], values[:, others])
        unsigned = "without its sign" in one.words and (values[:, sorted(entries)] >= 0.0).all()
        assert np.array_equal(changed, values) == unsigned, one.words
    assert words.most_common(1)[0][1] == 1


def test_a_column_is_read_and_written_alike(log: Log) -> None:
    for stream in STREAMS:
        whole, *columns = read_columns(log, stream)
        for column in columns:
            moved = column.changed(log, lambda values: 1.01 * values)
            before, after = whole.read(log).copy(), whole.read(moved)
            before[:, column.entries] *= 1.01
            assert np.allclose(after, before, rtol=0.0, atol=1e-12), column.name


def test_a_step_has_the_control_that_the_log_gives_it(log: Log) -> None:
    timeline = build_timeline(log, log.positions)
    values, row = read_controls(log, timeline)
    assert np.array_equal(values[row], timeline.control)


def test_no_two_faults_of_streams_have_the_same_words(log: Log) -> None:
    words = Counter(one.what for one in stream_faults(log))
    assert words.most_common(1)[0][1] == 1


def run_of(log: Log) -> EkfRun | None:
    """A filter's run without a gate of positions; None where it breaks down."""
    choices = settle(EkfConfig(gps="on", position_gate=1e12), log)
    fixes = fused_positions(log, choices)
    with np.errstate(all="ignore"):
        run = run_ekf(log, build_timeline(log, fixes), choices, fixes, FilterSetup())
    return None if run.breakdown else run


def named(log: Log, read: Log) -> tuple[str, ...]:
    """What is said of a filter that takes `read` for a log; empty where it breaks down."""
    run = run_of(read)
    if run is None:
        return ()
    as_of = replace(run, timeline=build_timeline(log, log.positions), positions=log.positions)
    with np.errstate(all="ignore"):
        return explain(log, as_of)


def number_of(rng: np.random.Generator, one: Misreading) -> tuple[float, ...]:
    if not one.start:
        return ()
    return (float(rng.choice((0.5, 0.9, 1.2, 2.0) if one.change.is_factor else (0.02, 0.2))),)


@pytest.mark.slow
@pytest.mark.parametrize("stream", STREAMS[:2])
def test_a_misreading_that_is_drawn_is_named(log: Log, stream: str) -> None:
    """By its words and number, of all that have an effect; the filter has read another log."""
    rng, columns, said = np.random.default_rng(7), read_columns(log, stream), list[bool]()
    every, missed = misreadings(columns, LAGS), list[tuple[str, tuple[str, ...]]]()
    while len(said) < DRAWN:
        one = every[rng.integers(len(every))]
        numbers = number_of(rng, one)
        values = columns[0].read(log)
        changed = one.values(values, *numbers)
        if np.array_equal(changed, values) or changed[:, 0].min() < LEAST[stream]:
            continue
        try:
            read = columns[0].write(log, changed)
        except InputError:
            continue
        if run_of(read) is None:
            continue
        lines = named(log, read)
        words = one.said(*numbers)
        said.append(any(line.startswith((words, SAME.get(words, words))) for line in lines))
        missed += [] if said[-1] else [(words, lines)]
    assert missed == []


def halved_where_it_turns(column: LogColumn, log: Log) -> Log:
    """Broken: no change of the column, but one of what another says."""

    def change(values: Array) -> Array:
        return values / (1.0 + np.arange(len(values)) % 3)

    return column.changed(log, change)


@pytest.mark.slow
def test_what_no_change_makes_is_not_named(log: Log) -> None:
    column = read_columns(log, "measurements")[1]
    assert not any(
        line.startswith("the range") for line in named(log, halved_where_it_turns(column, log))
    )
