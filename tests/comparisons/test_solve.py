"""The smoother alone, as a user meets it, and its own association beside the filter's."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.smoother_association import OwnAssociator
from comparisons.adapters.smoother_input import position_rows
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.association import compare_partitions, score_association
from comparisons.config import EkfConfig, SmootherConfig, SolveConfig
from comparisons.errors import InputError
from comparisons.estimates.folder import read_estimate
from comparisons.extensions.own_association.extension import (
    OwnAssociationFinding,
    association_cause,
    association_differences,
    check_own_association,
)
from comparisons.logs.bundled import open_log
from comparisons.logs.readers.scan_odometry import no_measurements
from comparisons.logs.scans import Scans
from comparisons.pipeline.solve import solve
from comparisons.report.models import Result, SolutionResult
from comparisons.report.run import RunReport
from comparisons.report.solution import SolutionReport
from graphslam.g2o import read_g2o
from tests.commands import files_in, job_files, slamcheck, works
from tests.comparisons.test_known_landmarks import with_survey
from tests.helpers import compared, first_seconds, present, simulated, without_labels


@pytest.mark.slow
def test_solving_leaves_a_whole_folder(tmp_path: Path) -> None:
    assert "verdict: verified" in works("solve", "simulated-loop", "--out", "solved", cwd=tmp_path)
    folder = tmp_path / "solved"
    names = job_files("solution.json", "map.png", "graph.g2o", estimates=("smoother",))
    assert files_in(folder) == names
    result = SolutionResult.model_validate_json((folder / "solution.json").read_text())
    assert set(result.files) == names
    assert result.smoother.verified
    assert result.smoother.starts[0].name == "relaxed"
    assert result.accuracy is not None
    again, graph = read_estimate(folder / "smoother"), read_g2o(folder / "graph.g2o")
    order = np.argsort(again.landmark_id)
    assert np.array_equal(again.landmark_id[order], graph.landmark_ids)
    assert np.allclose(again.landmark[order], graph.landmarks)
    assert result.landmarks == len(graph.landmarks)
    works("solve", "solved/graph.g2o", "--out", "again", cwd=tmp_path)


@pytest.mark.slow
def test_what_is_not_proven_has_its_exit_code(tmp_path: Path) -> None:
    arguments = ("simulated-loop", "--smoother", "fixed-lag", "--lag", "5", "--out", "lagged")
    done = slamcheck("solve", *arguments, cwd=tmp_path)
    assert done.returncode == 3
    result = json.loads((tmp_path / "lagged" / "solution.json").read_text())
    assert result["smoother"]["distance_sigma"] > 0.0
    assert read_estimate(tmp_path / "lagged" / "smoother").information == "fixed-lag"


def test_a_small_graph_is_drawn(tmp_path: Path) -> None:
    solution = solve(simulated(0, loop_s=2.0))
    assert solution.result.values.size() < 50
    SolutionReport.of(solution).write(tmp_path / "small")
    assert "graph {" in (tmp_path / "small" / "graph.dot").read_text()


def test_labels_are_refused_where_there_are_none() -> None:
    with pytest.raises(InputError, match="do not all name their landmark"):
        solve(without_labels(simulated(0, loop_s=5.0)), SolveConfig(association="known"))


@pytest.mark.slow
def test_own_association_needs_no_labels() -> None:
    log = simulated(0)
    blind = solve(without_labels(log))
    assert blind.association_by == "own"
    seen = solve(log, SolveConfig(association="own"))
    assert np.array_equal(blind.landmark_index, seen.landmark_index)
    assert present(seen.association).landmarks.precision > 0.99
    assert present(seen.association).landmarks.recall > 0.97
    assert seen.result.optimality.verified


def test_too_little_to_make_a_map_of_is_said() -> None:
    with pytest.raises(InputError, match="no measurement could be used"):
        solve(without_labels(first_seconds(simulated(1), 1.0)))


def test_a_log_of_scans_alone_is_sent_to_odometry() -> None:
    log = simulated(loop_s=10.0)
    scans = Scans(
        time_s=log.odometry.time_s[:3],
        angle_rad=np.array([0.0, 0.1]),
        range_m=np.ones((3, 2)),
        intensity=np.zeros((3, 2)),
    )
    bare = replace(log, measurements=no_measurements(), scans=scans)
    with pytest.raises(InputError, match="no measurements of landmarks"):
        solve(bare)


@pytest.mark.slow
def test_surveyed_landmarks_keep_their_places() -> None:
    """Those known beforehand go by id, the others by the smoother's own reasoning."""
    log = with_survey(simulated(1))
    solution = solve(log, SolveConfig(association="own"))
    known = present(log.known_landmarks).position_m
    assert np.abs(solution.estimate.landmark[: len(known)] - known).max() < 0.1
    assert present(solution.association).landmarks.precision > 0.99


@pytest.mark.slow
def test_misread_labels_are_left_out(shared_data: Path) -> None:
    """MR.CLAM's robot 3 has four measurements under a wrong barcode."""
    log = open_log(str(shared_data / "mrclam" / "MRCLAM_Dataset6"), robot=3)
    solution = solve(log, SolveConfig(association="known", smoother=SmootherConfig(robust="gnc")))
    assert 4 <= len(solution.result.rejected.measurements) < 20
    assert present(present(solution.accuracy).landmark_rmse_aligned_m) < 0.06


@pytest.mark.slow
def test_both_associations_are_compared() -> None:
    comparison = compared(simulated(1), association="nn", smoother_association="own")
    own = comparison.find(OwnAssociationFinding).own
    assert own.agreement > 0.9
    assert own.pose.distance_sigma < 1.0
    assert comparison.verdict.outcome == "agree"
    result = RunReport.build(comparison)
    again = Result.model_validate_json(result.model_dump_json())
    assert (again.model_extra or {})["own_association"]["landmarks"] == 60


def test_what_a_wrong_association_costs() -> None:
    comparison = compared(simulated(1))
    run, smoothed = comparison.ekf, comparison.smoothed
    wrong = run.landmark_index.copy()
    row = int(np.flatnonzero(wrong >= 0)[50])
    wrong[row] = (wrong[row] + 1) % len(smoothed.landmark)
    found = check_own_association(
        comparison.log.measurements,
        run.timeline.measurement_epoch,
        (wrong, run.landmark_index),
        smoothed,
        smoothed,
        comparison.smoother.optimality,
    )
    assert found.differing.tolist() == [row]
    assert found.cost[0, 0] > 1e3 > 20.0 > found.cost[0, 1]
    reported = association_cause(found, replace(run, landmark_index=wrong)).evidence
    assert f"measurement {row} at " in reported
    assert f"is {found.cost[0, 0] ** 0.5:.1f} sigma" in reported


@pytest.mark.slow
def test_a_wrong_association_of_the_filter_is_named() -> None:
    """Labels that send a tenth of the measurements, all at one loop's end, to wrong landmarks."""
    log = simulated(2)
    seen = log.measurements
    wrong = seen.landmark.copy()
    late = seen.time_s > 70.0
    wrong[late] = (wrong[late] + 1) % 60
    spoilt = replace(log, measurements=replace(seen, landmark=wrong))
    comparison = compared(spoilt, association="known", smoother_association="own")
    assert comparison.verdict.outcome == "disagree"
    causes = {cause.gap: cause for cause in comparison.verdict.causes}
    assert "association" in causes
    assert "share" in causes["association"].evidence
    own = comparison.find(OwnAssociationFinding).own
    table = association_differences(own, comparison.ekf)
    assert table.count("<tr data-key") == 200
    more = len(own.differing) - 200
    assert f"{len(own.differing):,} of {len(seen.time_s):,} measurements differ" in table
    assert f"{more:,} more are not" in table


def test_measurements_that_are_left_out_make_no_landmark() -> None:
    log = simulated(0, loop_s=10.0)
    timeline, few = build_timeline(log), np.arange(0, 20)
    rows = position_rows(timeline, None)
    found = OwnAssociator(log, timeline, rows, few).associate()
    assert (found.landmark_index[few] == -1).all()
    assert (np.delete(found.landmark_index, few) >= 0).any()
    assert (OwnAssociator(log, timeline, rows).associate().landmark_index[few] >= 0).any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "precision", "recall"), [(1, 0.95, 0.93), (2, 0.99, 0.98), (3, 0.98, 0.95)]
)
def test_own_association_finds_the_labels_of_mrclam(
    shared_data: Path, robot: int, precision: float, recall: float
) -> None:
    log = open_log(str(shared_data / "mrclam" / "MRCLAM_Dataset6"), robot=robot)
    timeline = build_timeline(log)
    found = OwnAssociator(log, timeline, position_rows(timeline, None)).associate()
    clusters = present(score_association(found.landmark_index, found.landmarks, log))
    assert present(clusters.clusters).precision > precision
    assert present(clusters.clusters).recall > recall


@pytest.mark.slow
def test_own_association_of_raw_detections_is_as_the_filters(shared_data: Path) -> None:
    """The first five minutes of Victoria Park: most pairs as in the filter's association."""
    log = open_log(str(shared_data / "victoria_park"))
    whole = build_timeline(log)
    timeline = whole.prefix(int(np.searchsorted(whole.epoch_time_s, 300.0)))
    run = run_ekf(log, timeline, settle(EkfConfig(filter="compressed"), log))
    found = OwnAssociator(log, timeline, position_rows(timeline, None)).associate()
    agreement = compare_partitions(run.landmark_index, found.landmark_index)
    assert agreement.agreement > 0.9
    assert 0.8 < found.problem.landmark_count / len(run.estimate.landmark) < 1.25
