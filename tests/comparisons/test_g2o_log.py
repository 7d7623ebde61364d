"""g2o files as logs."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.jobs.check import check
from comparisons.logs.bundled import open_log
from comparisons.logs.hashing import log_hash
from comparisons.logs.log import Log, LoopClosures
from comparisons.logs.log_folder import write_log_folder
from comparisons.logs.odometry import RelativePoses
from comparisons.pipeline.solve import solve
from comparisons.report.solution import FRAME, SolutionReport
from comparisons.report.terminal import brief
from graphslam.g2o import G2oContents, read_g2o, write_g2o
from graphslam.increments import dead_reckoned
from graphslam.problem import SlamProblem
from graphslam.smoother import smooth
from tests.graphslam.g2o_files import CLOSED_ELSEWHERE, loosened, rounds
from tests.graphslam.test_unclosed import inverse, laps
from tests.helpers import compared, present, simulated


def test_as_a_log_it_gives_the_same_optimum(tmp_path: Path) -> None:
    solution = solve(simulated(3, loop_s=30.0))
    result = solution.result
    path = tmp_path / "loop.g2o"
    write_g2o(path, G2oContents(result.problem, result.poses, result.landmarks))
    log = open_log(str(path))
    assert log.format == "g2o"
    assert log.records["odometry"] == len(result.problem.increment)
    assert log.records["measurements"] == len(solution.landmark_index)
    comparison = compared(log)
    assert abs(comparison.smoother.error - result.error) < 1e-6 * result.error
    assert comparison.verdict.outcome == "agree"


def vertices(path: Path) -> set[tuple[str, ...]]:
    lines = path.read_text().splitlines()
    return {tuple(line.split()[:2]) for line in lines if line.startswith("VERTEX")}


@pytest.mark.parametrize("surveyed", [0, 2])
def test_landmarks_keep_their_numbers(tmp_path: Path, surveyed: int) -> None:
    """Numbers among those of the poses, in another order than that in which they are seen."""
    first = solve(simulated(3, loop_s=30.0)).result
    count = len(first.landmarks)
    ids = np.arange(count)[::-1] * 3 + 1
    problem = replace(
        first.problem,
        surveyed=first.landmarks[:surveyed],
        surveyed_covariance=np.tile(np.eye(2), (surveyed, 1, 1)),
    )
    contents = G2oContents(problem, first.poses, first.landmarks, landmark_ids=ids)
    write_g2o(tmp_path / "loop.g2o", contents)
    again = read_g2o(tmp_path / "loop.g2o")
    where = {i: tuple(place) for i, place in zip(ids.tolist(), first.landmarks, strict=True)}
    assert again.landmark_ids[:surveyed].tolist() == sorted(ids[:surveyed].tolist())
    assert [where[i] for i in again.landmark_ids.tolist()] == [tuple(p) for p in again.landmarks]
    if surveyed:  # such a graph is no log yet
        return
    log = open_log(str(tmp_path / "loop.g2o"))
    solution = solve(log)
    assert set(solution.estimate.landmark_id.tolist()) == set(ids.tolist())
    SolutionReport.of(solution).write(tmp_path / "out")
    assert vertices(tmp_path / "out" / "graph.g2o") == vertices(tmp_path / "loop.g2o")


LANDMARK = "VERTEX_XY 40 1 1\nEDGE_SE2_XY 10 40 1 1 9 0 9\n"


def pose_graph(path: Path, text: str = CLOSED_ELSEWHERE) -> Path:
    path.write_text(text)
    return path


def test_closures_are_a_stream_of_the_log(tmp_path: Path) -> None:
    log = open_log(str(pose_graph(tmp_path / "closed.g2o")))
    assert log.records == {"odometry": 2, "measurements": 0, "loop closures": 2}
    assert present(log.loop_closures).from_s.tolist() == [2.0, 0.0]
    without = replace(log, loop_closures=None, measurements=simulated(3, loop_s=30.0).measurements)
    assert log_hash(log) != log_hash(without)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ("", "2 loop closures from pose to pose and no landmarks; .* EKF has nothing to obs"),
        (
            LANDMARK,
            "2 loop closures from pose to pose beside its measurements; .* a landmark EKF cannot",
        ),
    ],
)
def test_a_filter_of_landmarks_has_no_use_for_closures(tmp_path: Path, more: str, why: str) -> None:
    log = open_log(str(pose_graph(tmp_path / "closed.g2o", CLOSED_ELSEWHERE + more)))
    with pytest.raises(InputError, match=why) as caught:
        compared(log)
    assert "slamcheck solve takes it" in str(caught.value)
    assert "\n" not in str(caught.value)
    solution = solve(log)
    assert len(solution.result.problem.loop_closures.first) == 2
    assert len(solution.estimate.landmark) == (1 if more else 0)


def test_a_solution_is_solved_again_to_the_bit(tmp_path: Path) -> None:
    """From its own graph.g2o, and from a log folder; one pair of poses has no edge forward."""
    text = CLOSED_ELSEWHERE.replace("EDGE_SE2 20 30 1 0 1.5", "EDGE_SE2 30 20 -0.1 1.1 -1.5")
    first = solve(open_log(str(pose_graph(tmp_path / "closed.g2o", text + LANDMARK))))
    result = SolutionReport.build(first)
    assert result.pose_graph is not None
    assert (result.pose_graph.loop_closures, result.pose_graph.unmeasured) == (3, 1)
    assert result.pose_graph.initial_chi2 > result.smoother.chi2
    SolutionReport(first, result).write(tmp_path / "solved")
    write_log_folder(first.log, tmp_path / "log")
    for place in ("solved/graph.g2o", "log"):
        again = solve(open_log(str(tmp_path / place)))
        assert again.result.error == first.result.error, place
        assert np.array_equal(again.estimate.pose, first.estimate.pose), place
        assert np.array_equal(again.estimate.pose_covariance, first.estimate.pose_covariance)


def test_only_closures_stand_for_odometry() -> None:
    """A motion that nothing measured is refused where none are, and a closure between no poses."""
    log = simulated(3, loop_s=30.0)
    moves, spread = np.zeros((2, 3)), np.array([np.eye(3), np.full((3, 3), np.nan)])
    start = log.prior.time_s
    odometry = RelativePoses(start + np.array((1.0, 2.0)), moves, spread)
    with pytest.raises(InputError, match="covariance is nan, which needs loop closures"):
        replace(log, odometry=odometry)
    spread[1, 0, 0] = 1.0
    with pytest.raises(InputError, match="covariance is nan in part"):
        RelativePoses(start + np.array((1.0, 2.0)), moves, spread)
    ends = np.array([start]), np.array([start + 1.5])
    loop_closures = LoopClosures(*ends, np.zeros((1, 3)), np.eye(3)[None])
    with pytest.raises(InputError, match=r"closures.*is not the time of a pose"):
        replace(log, odometry=odometry, loop_closures=loop_closures)
    with pytest.raises(InputError, match="to the same pose"):
        LoopClosures(ends[0], ends[0], np.zeros((1, 3)), np.eye(3)[None])


@pytest.mark.parametrize("name", ["Klaus3.g2o", "sphere2500.txt", "pose3example.txt"])
def test_spatial_graphs_say_so(name: str) -> None:
    with pytest.raises(InputError, match=r":1: .*3D is not supported yet"):
        open_log(str(Path(gtsam.__file__).parent / "Data" / name))


def turned_start(folder: Path, name: str, poses: Array, fixes: int) -> Path:
    """Closed rounds with some positions and no prior, their vertices at the poses given."""
    problem = rounds(2)
    optimum, sigma = smooth(problem, {}).poses, 0.1
    at = np.linspace(0, 24, fixes).astype(np.intp)
    noise = np.random.default_rng(0).standard_normal((fixes, 2))
    fixed = replace(
        problem,
        position_pose=at,
        position=optimum[at, :2] + sigma * noise,
        position_covariance=np.tile(sigma**2 * np.eye(2), (fixes, 1, 1)),
    )
    path = folder / f"{name}.g2o"
    write_g2o(path, G2oContents(fixed, poses, np.zeros((0, 2))))
    kept = [one for one in path.read_text().splitlines(True) if "EDGE_PRIOR_SE2 " not in one]
    path.write_text("".join(kept))
    return path


def test_positions_fix_the_frame_and_not_a_guess(tmp_path: Path) -> None:
    """Vertices turned by half have the optimum of those that are not; one position fixes none."""
    poses = smooth(rounds(2), {}).poses
    half = poses * (-1, -1, 1) + (3, 4, np.pi)
    right, other = (
        solve(open_log(str(turned_start(tmp_path, name, start, 9))))
        for name, start in (("right", poses), ("half", half))
    )
    for one in (right, other):
        result = SolutionReport.build(one)
        assert result.verdict == "verified"
        assert result.smoother.dof == 3 * (24 + 10) + 2 * 9 - 3 * 25
        assert result.gps == "on"
        assert result.remarks == [FRAME]
    assert np.abs(other.estimate.pose[:, :2] - right.estimate.pose[:, :2]).max() < 1e-3
    turns = (other.estimate.pose[:, 2] - right.estimate.pose[:, 2]) / (2.0 * np.pi)
    assert np.abs(turns - np.round(turns)).max() < 1e-3
    held = open_log(str(turned_start(tmp_path, "one", half, 1)))
    assert not held.prior.open
    assert held.provenance["frame"].startswith("pose 0 is held at its vertex")
    kept = SolutionReport.build(solve(held))
    assert (kept.gps, kept.remarks) == ("off", [])


def test_poses_alone_need_no_closure(tmp_path: Path) -> None:
    """A chain is where its odometry leads; positions fix it as they fix a graph with closures."""
    whole = turned_start(tmp_path, "whole", smooth(rounds(2), {}).poses, 9)
    lines = whole.read_text().splitlines(True)
    motions = [one.split() for one in lines if one.startswith("EDGE_SE2 ")]
    chain = {" ".join(one[:3]) for one in motions if int(one[2]) == int(one[1]) + 1}
    kept = [
        one
        for one in lines
        if not one.startswith("EDGE_SE2 ") or " ".join(one.split()[:3]) in chain
    ]
    (tmp_path / "fixed.g2o").write_text("".join(kept))
    bare = [one for one in kept if "EDGE_PRIOR" not in one]
    (tmp_path / "chain.g2o").write_text("".join(bare))
    fixed, alone = (solve(open_log(str(tmp_path / f"{name}.g2o"))) for name in ("fixed", "chain"))
    assert fixed.verified
    assert SolutionReport.build(fixed).remarks == [FRAME]
    assert fixed.result.optimality.chi_square.dof == 2 * 9 - 3
    assert alone.verified
    assert np.abs(alone.estimate.pose - alone.dead_reckoned).max() < 1e-9
    write_log_folder(alone.log, tmp_path / "log")
    assert log_hash(open_log(str(tmp_path / "log"))) == log_hash(alone.log)


@pytest.mark.parametrize("between_laps", [True, False])
def test_an_optimum_whose_loops_are_open_is_said_to_be_the_graphs(
    tmp_path: Path, between_laps: bool
) -> None:
    graph, path = laps(0.1, between_laps=between_laps), tmp_path / "laps.g2o"
    write_g2o(path, G2oContents(graph, smooth(graph, {}).poses, np.zeros((0, 2))))
    solution = solve(open_log(str(path)))
    assert solution.verified
    said = [one for one in SolutionReport.build(solution).remarks if "optimum of the graph" in one]
    assert len(said) == (not between_laps)
    assert between_laps or "without a loop closure between them; by the edges, " in said[0]


def test_what_is_lacking_is_said_first(tmp_path: Path) -> None:
    """Before a chi-square that is too low, which only is a note."""
    problem = rounds()
    for one, reason in (
        (loosened(problem, 100.0), ""),
        (misread(problem), "the odometry's edges fit when what"),
    ):
        write_g2o(tmp_path / "rounds.g2o", G2oContents(one, np.zeros((49, 3)), np.zeros((0, 2))))
        solution = solve(open_log(str(tmp_path / "rounds.g2o")))
        result = SolutionReport.build(solution)
        assert result.verdict == ("unverified" if reason else "verified")
        assert result.reasons[:1] == ([] if not reason else solution.lacks[:1])
        assert "".join(result.reasons).startswith(reason)
        assert bool(result.remarks) is not bool(reason)
    optimality = replace(solution.result.optimality, agreed=False)
    doubtful = replace(
        solution, misread=None, result=replace(solution.result, optimality=optimality)
    )
    report = SolutionReport.of(doubtful)
    result = report.result
    assert result.reasons == [optimality.lacks]
    assert "is too low" in result.remarks[0]
    shown = brief(report.summary())
    assert shown[1].text.strip() in optimality.lacks


@pytest.mark.parametrize(("variance", "kind"), [(0.25, "gtsam-2d"), (50.0, "g2o")])
def test_isam_and_gtsam_share_tags(tmp_path: Path, variance: float, kind: str) -> None:
    """A step's heading is known to better than a radian, be it by covariance or by root."""
    edge = f"{variance} 0 0 {variance} 0 {variance}"
    lines = [f"ODOMETRY {k} {k + 1} 1 0 0.1 {edge}\nLANDMARK {k} 9 {4 - k} 2 2 0 2" for k in (0, 1)]
    (tmp_path / "few.txt").write_text("\n".join(lines))
    log = open_log(str(tmp_path / "few.txt"))
    assert log.format == kind
    assert isinstance(log.odometry, RelativePoses)
    assert np.isclose(log.odometry.covariance[0, 2, 2], min(variance, variance**-2.0))


def misread(problem: SlamProblem) -> SlamProblem:
    inverse: Array = np.asarray(np.linalg.inv(problem.increment_covariance), dtype=np.float64)
    return replace(problem, increment_covariance=inverse)


STEPS, CLOSURES = [4, 11], [2]
"""Edges of `rounds` whose information is made extreme."""


def few_changed(path: Path, change: Callable[[Array], Array]) -> SlamProblem:
    """Write `rounds` with other covariances of a few edges."""
    problem = rounds()
    closed, spread = problem.loop_closures, problem.increment_covariance.copy()
    closing = closed.covariance.copy()
    spread[STEPS], closing[CLOSURES] = change(spread[STEPS]), change(closing[CLOSURES])
    changed = replace(
        problem, increment_covariance=spread, loop_closures=replace(closed, covariance=closing)
    )
    write_g2o(path, G2oContents(changed, np.zeros((49, 3)), np.zeros((0, 2))))
    return problem


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            inverse,
            r"they fit when what stands for their information is the covariance: chi-square (\d+) "
            "for ",
        ),
        (lambda one: 1e-12 * np.broadcast_to(np.eye(3), one.shape), ""),
    ],
    ids=["inverse", "stiff"],
)
def test_few_edges_of_extreme_information_are_named(
    tmp_path: Path, change: Callable[[Array], Array], said: str
) -> None:
    """With their lines, and with the reading that fits; a broken one takes what says nothing."""
    path = tmp_path / "few.g2o"
    right = 2.0 * smooth(few_changed(path, change), {}).error
    solution = solve(open_log(str(path)))
    [note] = solution.notes
    named = re.findall(r"edge (\d+) to (\d+) \(line (\d+)\)", note)
    assert [int(i) for i, _, _ in named[:2]] == STEPS
    lines = path.read_text().splitlines()
    assert [lines[int(line) - 1].split()[1:3] for _, _, line in named] == [
        [i, j] for i, j, _ in named
    ]
    assert len(named) == 3
    found = re.search(said or "; they fit", note)
    assert bool(found) is bool(said)
    assert found is None or int(found[1]) == pytest.approx(right, abs=0.6)
    assert note in SolutionReport.build(solution).remarks


def test_few_edges_that_say_nothing_are_refused_by_line(tmp_path: Path) -> None:
    path = tmp_path / "few.g2o"
    few_changed(path, lambda one: 1e12 * np.broadcast_to(np.eye(3), one.shape))
    with pytest.raises(InputError, match=r"edge 4 to 5 \(line \d+\), .* a variance of 1e\+12 says"):
        open_log(str(path))


def test_a_chi_square_that_no_chance_makes_so_low_qualifies_the_verdict(tmp_path: Path) -> None:
    """Sigmas ten times too large; those that are right, or slightly too large, do not."""
    problem, path = rounds(), tmp_path / "rounds.g2o"
    for factor, words in ((1.0, ""), (1.5, ""), (10.0, ", sigmas too large")):
        one = loosened(problem, factor**2)
        write_g2o(path, G2oContents(one, np.zeros((49, 3)), np.zeros((0, 2))))
        report = SolutionReport.of(solve(open_log(str(path))))
        assert report.summary().headline == f"verdict: verified{words}"
    fits, remark = sorted(report.result.remarks)  # the odometry's noise alone explains it not
    times = present(re.search(r"the stated sigmas are about (\S+) times too large", remark))
    assert float(times[1]) == pytest.approx(10.0, rel=0.25)
    said = r"all edges between poses fit with \S+ \((\S+) to (\S+)\) times the information"
    low, high = map(float, present(re.match(said, fits)).groups())
    assert low < 100.0 < high


def test_a_small_chi_square_is_not_told_as_zero() -> None:
    path = Path(gtsam.__file__).parent / "Data" / "noisyToyGraph.txt"
    [remark] = SolutionReport.build(solve(open_log(str(path)))).remarks
    assert remark.startswith("chi-square 0.14 for 6 degrees of freedom is too low (band 0.")


def ring(path: Path) -> Log:
    """Three rounds of a square, each pose tied to the one of the round before."""
    rng, info, true = np.random.default_rng(2), np.diag((4e2, 4e2, 1e4)), [np.zeros(3)]
    lines = []

    def edge(first: int, second: int) -> None:
        a, b = true[first], true[second]
        c, s = np.cos(a[2]), np.sin(a[2])
        moved = np.append(np.array(((c, s), (-s, c))) @ (b - a)[:2], b[2] - a[2])
        moved += rng.standard_normal(3) / np.sqrt(np.diag(info))
        moved[2] = np.angle(np.exp(1j * moved[2]))
        numbers = (*moved, *info[np.triu_indices(3)])
        lines.append(" ".join(("EDGE_SE2", str(first), str(second), *map(str, numbers))))

    for k in range(60):
        x, y, heading = true[-1]
        after = heading + (k % 5 == 4) * np.pi / 2
        true.append(np.array((x + np.cos(heading), y + np.sin(heading), after)))
        edge(k, k + 1)
    for k in range(20, 61, 4):
        edge(k - 20, k)
    places = [f"VERTEX_SE2 {k} {x} {y} {t}" for k, (x, y, t) in enumerate(true)]
    path.write_text("\n".join((*places, *lines)) + "\n")
    return open_log(str(path))


def test_an_estimate_that_uses_no_closure_is_told(tmp_path: Path) -> None:
    """A reference that saw less than the smoother grants no grade."""
    log = ring(tmp_path / "ring.g2o")
    solution = solve(log)
    problem, time_s = solution.result.problem, solution.estimate.time_s
    dead = dead_reckoned(problem.prior_pose, problem.increment)
    found = check(log, ExternalEstimate(time_s=time_s, pose=dead))
    assert found.outcome == "disagree"
    assert "no loop closure is used" in found.causes[0].evidence
    sound = check(log, ExternalEstimate(time_s=time_s, pose=solution.estimate.pose))
    assert sound.outcome == "agree"
    assert present(sound.grade.by).reference.smoothed
