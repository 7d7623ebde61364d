from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from comparisons.checks.association import (
    AssociationFinding,
    compare_partitions,
    counterparts,
    differing_measurements,
    score_association,
    score_partition,
)
from comparisons.jobs.run import Modified
from comparisons.logs.log import Landmarks, Log, Truth
from comparisons.report.run import RunReport
from ekf_reference.association.joint_compatibility import JointCompatibility
from ekf_reference.association.known import SurveyedLandmarks
from ekf_reference.core.ekf import Ekf
from tests.helpers import compared, present, simulated, without_labels


@pytest.mark.parametrize("seed", range(5))
def test_pairs_equal_counting_them_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    landmark_index, label = rng.integers(-2, 4, 40), rng.integers(0, 4, 40)
    pairs = list(combinations(range(40), 2))
    together = {p for p in pairs if landmark_index[p[0]] == landmark_index[p[1]] >= 0}
    belong = {p for p in pairs if label[p[0]] == label[p[1]]}
    score = score_partition(landmark_index, label)
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


PLACES = np.array(((0.0, 0.0), (0.3, 0.0), (5.0, 0.0)))


def with_a_clump() -> Log:
    """Three landmarks in turn, of which two stand close together."""
    log = simulated(loop_s=5.0)
    truth = Truth(landmarks=Landmarks(np.array((0, 1, 2)), PLACES, np.zeros((3, 2, 2))))
    label = np.resize((0, 1, 2), len(log.measurements.time_s))
    return replace(log, truth=truth, measurements=replace(log.measurements, landmark=label))


def test_landmarks_too_near_to_tell_apart_count_as_one_cluster() -> None:
    log = with_a_clump()
    swapped = np.resize((1, 0, 2), len(log.measurements.time_s))
    swapped[:3] = (0, 1, 2)
    score = present(score_association(swapped, PLACES + 0.01, log))
    assert score.landmarks.precision < 1.0
    assert (score.used, score.labelled) == (3, 3)
    assert (present(score.clusters).precision, present(score.clusters).recall) == (1.0, 1.0)


def test_a_clump_taken_for_one_landmark_shows_by_landmarks_alone() -> None:
    """By clusters it scores in full, so these figures alone would hide it."""
    log = with_a_clump()
    one = np.resize((0, 0, 1), len(log.measurements.time_s))
    result = present(score_association(one, PLACES[1:], log))
    assert (present(result.clusters).precision, present(result.clusters).recall) == (1.0, 1.0)
    assert (result.used, result.labelled) == (2, 3)
    assert result.landmarks.precision < 0.8
    rows = {row.quantity: row.value for row in present(result).rows("the filter")}
    assert (rows["landmarks used"], rows["landmarks labelled"]) == ("2", "3")
    assert rows["pairs of measurements, same landmark: precision"].startswith("0.")


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["nn", "jcbb"])
def test_association_by_position_finds_the_labels_in_simulation(rule: str) -> None:
    c = compared(simulated(seed=1), association=rule)
    assert present(c.known.value(AssociationFinding)).landmarks.precision > 0.99
    assert present(c.known.value(AssociationFinding)).landmarks.recall > 0.97


def test_no_score_with_labels_or_without_any() -> None:
    log = simulated(seed=1, loop_s=5.0)
    assert compared(log).known.value(AssociationFinding) is None
    c = compared(without_labels(log))
    assert c.prepared.ekf.association == "nn"
    assert c.known.value(AssociationFinding) is None


def test_codes_of_unused_measurements_index_nothing() -> None:
    log = simulated(loop_s=5.0)
    landmark_index = np.resize((0, 1, -3), len(log.measurements.time_s))
    score = present(score_association(landmark_index, np.array(((0.0, 0.0), (5.0, 0.0))), log))
    assert 0.0 <= present(score.clusters).recall < 1.0


def test_partitions_are_compared_pair_by_pair() -> None:
    """The second splits landmark 0, merges 1 and 2, and leaves out one measurement."""
    first = np.array([0, 0, 0, 0, 1, 1, 2, 2, 2, -1])
    second = np.array([5, 5, 6, 6, 3, 3, 3, 3, -1, 3])
    found = compare_partitions(first, second)
    by_hand = {"both": 0, "first": 0, "second": 0}
    for i, j in combinations(range(len(first)), 2):
        a = first[i] >= 0 and first[i] == first[j]
        b = second[i] >= 0 and second[i] == second[j]
        if a or b:
            by_hand["both" if a and b else "first" if a else "second"] += 1
    assert (found.pairs_both, found.pairs_first, found.pairs_second) == tuple(by_hand.values())
    assert (found.splits, found.merges) == (1, 1)
    assert (found.only_first, found.only_second) == (1, 1)
    assert found.agreement == by_hand["both"] / sum(by_hand.values())
    same = compare_partitions(first, np.where(first >= 0, 7 - first, -1))
    assert same.agreement == 1.0
    assert (same.splits, same.merges, same.pairs_first) == (0, 0, 0)


def test_counterparts_are_mutual() -> None:
    first = np.array([0, 0, 0, 0, 1, 1, 2, 2, 2, -1])
    second = np.array([5, 5, 5, 6, 3, 3, 3, 3, 3, 3])
    ours, theirs = counterparts(first, second)
    assert ours.tolist() == [0, 2]
    assert theirs.tolist() == [5, 3]
    assert counterparts(np.array([-1]), np.array([0]))[0].tolist() == []


def test_measurements_differ_where_their_landmarks_are_no_counterparts() -> None:
    """Landmarks 0 and 1 swap their numbers, which is no difference; the rest is."""
    filters = np.array([0, 0, 1, 1, 1, -1, -1, 0, 2])
    own = np.array([1, 1, 0, 0, 1, 0, -1, -1, 3])
    first, second = counterparts(filters, own)
    matched = np.full(4, -1)
    matched[second] = first
    assert differing_measurements(filters, own, matched).tolist() == [4, 5, 7]
    assert np.flatnonzero(filters != own).tolist() != [4, 5, 7]  # a broken variant: the numbers


def test_searches_that_were_cut_off_are_counted_and_said() -> None:
    """Joint compatibility stops at 4,000 nodes, here at two; that is no silent fallback."""
    log, found = simulated(loop_s=10.0), {}
    for nodes in (2, 4000):

        def modify(ekf: Ekf, nodes: int = nodes) -> None:
            rule = JointCompatibility(most_nodes=nodes)
            ekf.association = SurveyedLandmarks(SurveyedLandmarks(rule, {}), {})

        found[nodes] = compared(log, Modified(modify), association="jcbb")
    reported = {
        n: [r for r in c.verdict.remarks if "reached its limit of" in r] for n, c in found.items()
    }
    assert found[4000].ekf.cut_off == 0 == len(reported[4000])
    assert found[2].ekf.cut_off > 10
    assert f"in {found[2].ekf.cut_off:,} scans" in reported[2][0]
    assert RunReport.build(found[2]).ekf.cut_off == found[2].ekf.cut_off
