"""Landmarks are called by label or by number, in any order, in map and trace: one set of ids."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.ekf_run import EkfRun
from comparisons.audit.own_filter import run_events
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate, read_external
from comparisons.estimates.folder import write_estimate
from comparisons.estimates.landmark_names import LandmarkNames
from comparisons.estimates.planar_trace import TRACE
from comparisons.jobs.check import check
from comparisons.jobs.external_check import ExternalCheck
from comparisons.logs.log import Log
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from comparisons.logs.log_meta import toml_text
from comparisons.trace.events import Augment, Event, Snapshot, Update
from comparisons.trace.recorder import Recorder
from ekf_reference.core.landmark_types import POINT
from tests.comparisons.test_text_labels import NAMES, labelled_drive
from tests.helpers import compared, present

TAGS = ("tag_A", "tag_D", "tree 12", "D")
"""One ends in a number, one in another; the numbers of the log are of another order."""
PLACE = {name: np.array([5.0 + k, -2.0 * k]) for k, name in enumerate(TAGS)}
EYE = np.eye(2)


def recorded(folder: Path, called: Mapping[str, str], order: Iterable[str]) -> None:
    """A trace of a pose and four landmarks, each measured twice. called: the blocks."""
    pose = np.zeros(3)
    with Recorder(folder / TRACE) as record:
        record.prior({"pose": 3}, np.eye(3), point=pose)
        record.at(1.0)
        record.predict(np.eye(3), np.eye(3), ["pose"], point=pose, after=pose)
        for row, name in enumerate(order):
            block, state = called[name], np.append(pose, PLACE[name])
            record.augment(
                block, np.eye(2, 3), EYE, EYE, ["pose"], point=pose, after=PLACE[name], numbers=row
            )
            h = np.hstack((np.eye(2, 3), EYE))
            blocks = ["pose", block]
            record.update("trees", np.zeros(2), h, EYE, blocks, point=state, numbers=row)


def map_of(folder: Path, called: Mapping[str, str], order: Iterable[str]) -> None:
    rows = "".join(f"{called[name]},{PLACE[name][0]},{PLACE[name][1]}\n" for name in order)
    (folder / "landmarks.csv").write_text("id,x_m,y_m\n" + rows)
    (folder / "trajectory.tum").write_text("1 0 0 0 0 0 0 1\n")


def assert_of_one_id(given: ExternalEstimate, numbers: Mapping[str, int]) -> None:
    """Each landmark has the log's number, in the map and wherever the trace has its position."""
    ids, places = present(given.landmark_id), present(given.landmark)
    for name, number in numbers.items():
        np.testing.assert_array_equal(places[ids == number], PLACE[name][None])
    trace = present(given.trace).trace
    for records in (trace.initialisations[POINT], trace.measurements[POINT]):
        assert len(records.landmark_index) == len(numbers)
        np.testing.assert_array_equal(places[records.landmark_index], records.landmark)


MANNERS = list(product(("label", "number"), repeat=2))


@pytest.mark.parametrize(("of_map", "of_trace"), MANNERS)
def test_all_orders(tmp_path: Path, of_map: str, of_trace: str) -> None:
    """Of the map's rows, beside an order of the trace that neither map nor log has."""
    numbers = {"tag_A": 3, "tag_D": 0, "tree 12": 2, "D": 1}
    called = {"label": dict(zip(TAGS, TAGS, strict=True)),
              "number": {name: str(number) for name, number in numbers.items()}}  # fmt: skip
    blocks = {name: f"landmark {called[of_trace][name]}" for name in TAGS}
    recorded(tmp_path, blocks, ("tree 12", "tag_A", "D", "tag_D"))
    labels = {number: name for name, number in numbers.items()}
    for order in permutations(TAGS):
        map_of(tmp_path, called[of_map], order)
        given = read_external(tmp_path).numbered_as(labels)
        assert_of_one_id(given, numbers)
        assert_of_one_id(given.numbered_as(labels), numbers)


def test_all_orders_of_log_and_map() -> None:
    """Without files: by whatever the map and the trace call them."""
    for of_log, of_map in product(permutations(TAGS), repeat=2):
        labels = dict(enumerate(of_log))
        numbers = {name: number for number, name in labels.items()}
        expected = [numbers[name] for name in of_map]
        for words in (list(of_map), [str(number) for number in expected], expected):
            names = LandmarkNames(labels, words)
            assert names.numbers == expected
            assert names.of_blocks([f"landmark {name}" for name in TAGS]) == [
                numbers[name] for name in TAGS
            ]
            assert names.of_blocks([f"l{numbers[name]}" for name in TAGS]) == [
                numbers[name] for name in TAGS
            ]


@pytest.mark.parametrize(
    ("labels", "words", "numbers"),
    [
        # Numbers that are labels are labels; those of the log are numbers.
        ({0: "7", 1: "8", 2: "oak"}, ["8", "7"], [1, 0]),
        ({0: "7", 1: "8", 2: "oak"}, ["1", "0"], [1, 0]),
        ({0: "1", 1: "2", 2: "oak"}, ["1", "2"], [0, 1]),
        ({0: "1", 1: "2", 2: "oak"}, ["0", "1", "2"], [0, 1, 2]),
        # What the log lacks has a number of its own.
        ({0: "7", 1: "8", 2: "oak"}, ["elm", "7", "ash"], [3, 0, 4]),
        ({0: "oak", 5: "elm"}, ["5", "9"], [5, 9]),
        ({}, ["12", "3"], [12, 3]),
    ],
)
def test_numbers_and_labels(labels: dict[int, str], words: list[str], numbers: list[int]) -> None:
    assert LandmarkNames(labels, words).numbers == numbers


@pytest.mark.parametrize(
    ("block", "number"),
    [
        ("landmark tag_D", 1),
        ("tag_D", 1),
        ("m/D", 3),
        ("landmark 12", 0),
        ("L12", 0),
        ("landmark tree 12", 2),
        ("landmark 112", None),
        ("bad", None),
        ("landmark", None),
        ("landmark tag_E", None),
    ],
)
def test_a_block_ends_in_a_label(block: str, number: int | None) -> None:
    """The longest; it begins where a word or a number begins."""
    labels = {0: "12", 1: "tag_D", 2: "tree 12", 3: "D"}
    assert LandmarkNames(labels, list(labels.values())).of_blocks([block]) == [number]


@pytest.mark.parametrize(
    ("block", "fault"),
    [
        ("landmark tag_E", "block 'landmark tag_E' must end in the number or label of a landmark"),
        ("landmark 9", "block 'landmark 9' must end in the number or label of a landmark"),
        ("my tree 12", "landmark tag_A is initialised 0 times, expected once"),
    ],
)
def test_blocks_that_are_no_landmarks(tmp_path: Path, block: str, fault: str) -> None:
    blocks = {name: f"landmark {name}" for name in TAGS} | {"tag_A": block}
    recorded(tmp_path, blocks, TAGS)
    map_of(tmp_path, dict(zip(TAGS, TAGS, strict=True)), TAGS)
    given = read_external(tmp_path)
    with pytest.raises(InputError, match=fault):
        given.numbered_as(dict(enumerate(TAGS)))
    with pytest.raises(InputError, match=r"landmarks by text \('tag_A'\), the log by numbers"):
        given.numbered_as({})


def test_rows_in_place_of_numbers_are_noticed(tmp_path: Path) -> None:
    """The mistake that there was: blocks by the log's numbers, taken for rows of the map."""
    numbers = {"tag_A": 3, "tag_D": 0, "tree 12": 2, "D": 1}
    recorded(tmp_path, {name: f"landmark {numbers[name]}" for name in TAGS}, TAGS)
    map_of(tmp_path, dict(zip(TAGS, TAGS, strict=True)), TAGS)
    given = read_external(tmp_path)
    by_rows = present(given.trace).placed(LandmarkNames({}, [0, 1, 2, 3]))
    with pytest.raises(AssertionError):
        assert_of_one_id(
            replace(given.numbered_as({n: k for k, n in numbers.items()}), trace=by_rows), numbers
        )


@pytest.mark.parametrize(
    "text",
    [
        '"oak"',
        '["oak"]',
        '{"oak": "1"}',
        '{"oak": 1.5}',
        '{"oak": 0, "elm": 0}',
        "{",
        '{"oak": 1e99}',
    ],
)
def test_labels_of_a_log_are_names_and_numbers(tmp_path: Path, text: str) -> None:
    log = labelled_drive(20)
    write_log_folder(log, tmp_path / "log")
    meta = tmp_path / "log" / "log.toml"
    spelt = meta.read_text().replace(toml_text(log.provenance["labels"]), toml_text(text))
    meta.write_text(spelt)
    with pytest.raises(InputError, match="provenance: labels is "):
        read_log_folder(tmp_path / "log")


def renamed(event: Event, names: Mapping[str, str]) -> Event:
    """An event with other names of its blocks."""
    match event:
        case Augment():
            return event._replace(name=names.get(event.name, event.name))
        case Update() | Snapshot():
            return event._replace(blocks=tuple(names.get(block, block) for block in event.blocks))
    return event


@pytest.mark.slow
@pytest.mark.parametrize("of_trace", ["label", "number"])
@pytest.mark.parametrize("of_map", ["label", "number"])
def test_a_right_filter_is_equal_by_any_names(tmp_path: Path, of_map: str, of_trace: str) -> None:
    """With a trace; its map's rows stand in another order than the log's numbers."""
    log = labelled_drive(120)
    run = compared(log).ekf
    found = handed_in(log, run, tmp_path, of_map, of_trace)
    assert found.grade.value == "equal"
    assert not found.causes
    assert present(present(found.trace).algebra).sigma < 1e-6


def handed_in(log: Log, run: EkfRun, folder: Path, of_map: str, of_trace: str) -> ExternalCheck:
    estimate = run.estimate
    order = np.argsort([name[::-1] for name in estimate.names])
    state = np.concatenate((np.arange(3), *(3 + 2 * k + np.arange(2) for k in order.tolist())))
    moved = replace(
        estimate,
        landmark_id=estimate.landmark_id[order],
        landmark=estimate.landmark[order],
        joint_covariance=estimate.joint_covariance[np.ix_(state, state)],
        labels=estimate.labels if of_map == "label" else {},
    )
    write_estimate(moved, folder)
    names = {f"landmark {number}": f"landmark {name}" for number, name in log.labels.items()}
    with Recorder(folder / TRACE) as record:
        for event in run_events(run):
            record.event(renamed(event, names if of_trace == "label" else {}))
    return check(log, read_external(folder))


def test_names_are_of_text() -> None:
    assert set(labelled_drive(20).labels.values()) <= set(NAMES)
