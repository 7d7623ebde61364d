"""A landmark that is in a map twice bars `like`, and is named with what began it."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from comparisons.checks.diagnosis.duplicate_landmarks import duplicate_cause, duplicates
from comparisons.checks.grade import Likeness, likeness
from comparisons.config import CheckConfig
from comparisons.estimates.external import ExternalEstimate, read_external
from comparisons.jobs.grading import check_external
from comparisons.logs.log import Log
from comparisons.pipeline.references import EKF, filter_named
from comparisons.pipeline.solve import prepare_solve, solve
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.landmark_types import POINT
from tests.comparisons.test_external_trace import hand_in
from tests.comparisons.test_records_as_used import all_round, filtered
from tests.helpers import present, without_labels

AGAIN = 999
"""The label of the landmark that begins again."""


@cache
def crossing() -> int:
    """A measurement of a landmark of the map, on the other side of the cut than is expected."""
    log = all_round()
    used = filtered(log).trace.measurements[POINT]
    offset = used.landmark - used.pose[:, :2]
    expected = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - used.pose[:, 2])
    apart = np.abs(log.measurements.bearing_rad[used.number] - expected) > np.pi
    return int(used.number[apart][0])


def straight() -> int:
    """A later measurement of a landmark of the map, far from the cut."""
    seen = all_round().measurements
    label, count = np.unique(seen.landmark, return_counts=True)
    rows = np.flatnonzero(seen.landmark == label[np.argmax(count)])
    return int(rows[1:][np.argmin(np.abs(seen.bearing_rad[rows[1:]]))])


def begun_again(number: int) -> Log:
    """The log whose landmark has another label from a measurement on."""
    seen = all_round().measurements
    same = (seen.landmark == seen.landmark[number]) & (np.arange(len(seen.time_s)) >= number)
    label = np.where(same, AGAIN, seen.landmark)
    return replace(all_round(), measurements=replace(seen, landmark=label))


def handed_in(log: Log, folder: Path) -> ExternalEstimate:
    hand_in(filtered(log), folder)
    return read_external(folder)


def beside_the_reference(given: ExternalEstimate) -> Likeness:
    prepared = prepare_solve(all_round(), CheckConfig())
    return likeness(given, present(filter_named(EKF, prepared, given.time_s)), labelled=True)


@pytest.mark.parametrize("wrapped", [True, False])
def test_a_landmark_that_begins_again_is_named(tmp_path: Path, wrapped: bool) -> None:
    number = crossing() if wrapped else straight()
    log = begun_again(number)
    given = handed_in(log, tmp_path)
    near = beside_the_reference(given)
    original = int(all_round().measurements.landmark[number])
    (found,) = duplicates(given, near, log, filtered(log))
    assert (found.first, found.second) == (original, AGAIN)
    beginning = present(found.beginning)
    assert (beginning.number, beginning.turns != 0) == (number, wrapped)
    cause = duplicate_cause([found])
    assert f"landmark {AGAIN} lies at landmark {original}" in cause.evidence
    assert ("wrap the difference of bearings" in cause.hint) == wrapped
    (found,) = duplicates(given, near, log, None)  # without a trace
    assert (found.first, found.second, found.beginning) == (original, AGAIN, None)


def test_a_landmark_elsewhere_is_no_duplicate(tmp_path: Path) -> None:
    log = begun_again(straight())
    given = handed_in(log, tmp_path)
    row = int(np.flatnonzero(present(given.landmark_id) == AGAIN)[0])
    place = present(given.landmark).copy()
    place[row] += 30.0
    given = replace(given, landmark=place)
    assert not duplicates(given, beside_the_reference(given), log, None)


def test_a_sound_map_has_no_duplicates(tmp_path: Path) -> None:
    log = all_round()
    given = handed_in(log, tmp_path)
    assert not duplicates(given, beside_the_reference(given), log, filtered(log))


@pytest.mark.slow
def test_a_trace_does_not_weaken_what_a_map_shows(tmp_path: Path) -> None:
    """Of a log without labels: the trace's equations are right, and the map is not."""
    bare = without_labels(all_round())
    solution = solve(bare)
    assert present(solution.association_check).verified
    given = replace(handed_in(begun_again(crossing()), tmp_path / "twice"), estimator="ekf")
    found = check_external(given, solution)
    assert found.outcome == "disagree"
    assert found.causes[0].gap == "association"
    assert {"estimate", "covariance", "map"}.isdisjoint(one.gap for one in found.causes)
    assert "wrap the difference of bearings" in found.causes[0].hint
    sound = replace(handed_in(all_round(), tmp_path / "sound"), estimator="ekf")
    assert check_external(sound, solution).outcome == "agree"
