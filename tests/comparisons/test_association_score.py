from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from comparisons.checks.association import score_association, score_partition
from comparisons.compare import compare_estimators
from comparisons.logs.log import NO_LANDMARK, Landmarks, Truth
from comparisons.runs.ekf_build import EkfChoices
from tests.helpers import simulated


@pytest.mark.parametrize("seed", range(5))
def test_pairs_equal_counting_them_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    slot, label = rng.integers(-2, 4, 40), rng.integers(0, 4, 40)
    pairs = list(combinations(range(40), 2))
    together = {p for p in pairs if slot[p[0]] == slot[p[1]] >= 0}
    belong = {p for p in pairs if label[p[0]] == label[p[1]]}
    score = score_partition(slot, label)
    assert np.isclose(score.precision, len(together & belong) / len(together))
    assert np.isclose(score.recall, len(together & belong) / len(belong))


def test_perfect_split_merged_and_unused() -> None:
    label = np.array((7, 7, 7, 9, 9, 9))
    perfect = score_partition(np.array((1, 1, 1, 0, 0, 0)), label)
    assert (perfect.precision, perfect.recall) == (1.0, 1.0)
    split = score_partition(np.array((0, 0, 2, 1, 1, 1)), label)
    assert (split.precision, split.recall) == (1.0, 4 / 6)
    merged = score_partition(np.zeros(6, dtype=np.intp), label)
    assert (merged.precision, merged.recall) == (6 / 15, 1.0)
    unused = score_partition(np.full(6, -1), label)
    assert (unused.precision, unused.recall) == (1.0, 0.0)


def test_landmarks_too_near_to_tell_apart_count_as_one_cluster() -> None:
    log = simulated(loop_s=5.0)
    count = len(log.sightings.time_s)
    places = np.array(((0.0, 0.0), (0.3, 0.0), (5.0, 0.0)))
    truth = Truth(landmarks=Landmarks(np.array((1, 2, 3)), places, np.zeros((3, 2, 2))))
    label = np.resize((1, 2, 3), count)
    log = replace(log, truth=truth, sightings=replace(log.sightings, landmark=label))
    swapped = np.resize((1, 0, 2), count)
    swapped[:3] = (0, 1, 2)
    score = score_association(swapped, places + 0.01, log)
    assert score is not None
    assert score.clusters is not None
    assert score.landmarks.precision < 1.0
    assert (score.clusters.precision, score.clusters.recall) == (1.0, 1.0)


@pytest.mark.parametrize("rule", ["nn", "jcbb"])
def test_association_by_position_finds_the_labels_in_simulation(rule: str) -> None:
    c = compare_estimators(simulated(seed=1), EkfChoices(association=rule))
    assert c.association is not None
    assert c.association.landmarks.precision > 0.99
    assert c.association.landmarks.recall > 0.97


def test_no_score_with_labels_or_without_any() -> None:
    log = simulated(seed=1, loop_s=5.0)
    assert compare_estimators(log).association is None
    seen = log.sightings
    blank = replace(seen, landmark=np.full(len(seen.time_s), NO_LANDMARK))
    c = compare_estimators(replace(log, sightings=blank))
    assert c.choices.association == "nn"
    assert c.association is None


def test_codes_of_unused_sightings_index_nothing() -> None:
    log = simulated(loop_s=5.0)
    slot = np.resize((0, 1, -3), len(log.sightings.time_s))
    score = score_association(slot, np.array(((0.0, 0.0), (5.0, 0.0))), log)
    assert score is not None
    assert score.clusters is not None
    assert 0.0 <= score.clusters.recall < 1.0
