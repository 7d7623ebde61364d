"""The measurements run; what they measure is for people to read."""

import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from comparisons.extensions.dense_maps.accuracy import distance_to_segments
from comparisons.logs.simulate.scan_drive import dense_slam
from research import bench, dense_maps
from research.peers import __main__ as peers
from research.script import options
from research.timing import Side, Spent, TimedPair, interleaved
from research.timing import run as ran
from research.trust import damaged
from tests.graphslam.skips import pass_on
from tests.helpers import present
from tests.processes import ROOT, python

STAGES = ("ekf", "frozen", "smoother", "marginals", "checks")


def run(*arguments: str) -> list[str]:
    """The lines that a benchmark prints."""
    done = python(*arguments, cwd=ROOT)
    pass_on(done.stderr)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


class Benchmark(NamedTuple):
    """lines: how those printed begin, by rows, parted by `; `."""

    command: str
    rows: slice
    lines: str


BENCHMARKS = (
    Benchmark(
        "attributes --seeds 1 --loops 0.3 --lost 2 --every 5",
        slice(1, 8),
        "nn attributes off; nn attributes on; jcbb attributes off; jcbb attributes on; "
        "simulated-loop, blind; 2 s off; 2 s on",
    ),
    Benchmark(
        "trust.defects --only steering --seeds 2 --loop-s 20",
        slice(2, 5),
        r"\| steering sign: ; 1 of 1 caught, 1 with the right first cause$; "
        ".*0 of 2 flagged, 0.0 to 84.2 %",
    ),
    Benchmark("suboptimal --crossing --states 100 150", slice(2, None), "100 ; 150 "),
    Benchmark("suboptimal --size 200x20 --gains 0 0.5", slice(2, None), r"0e\+00; 5e-01"),
    Benchmark("trust.sound --quick", slice(2, None), "; ".join((r".*\| yes \|$",) * 3)),
    Benchmark("trust.damaged --quick", slice(2, None), r".*\| yes \|$"),
    Benchmark("trust.bands --quick", slice(2, None), "; ".join((r".*\| yes \|$",) * 11)),
    Benchmark(
        "audit_speed --events 3000 --rounds 1",
        slice(0, None),
        "filter alone:; recorded:; recorder:; commits:; file:; read:; audit:.*sound$",
    ),
)


def test_a_scripts_options_are_of_the_kind_of_their_defaults(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("log.toml", "--runs-a-day", "3", "--scale", "2", "--data", "x", "--names", "a", "b")
    monkeypatch.setattr(sys, "argv", ["script", *words, "--quick"])
    found = options(
        "Words.", "log", runs_a_day=1, scale=0.5, data=Path, names=(), seeds=(1, 2), quick=False
    )
    assert vars(found) == {
        "log": "log.toml", "runs_a_day": 3, "scale": 2.0, "data": Path("x"),
        "names": ["a", "b"], "seeds": (1, 2), "quick": True,
    }  # fmt: skip
    for wrong in (["log.toml", "--runs-a-day", "many"], ["log.toml", "--slow"], []):
        monkeypatch.setattr(sys, "argv", ["script", *wrong])
        with pytest.raises(SystemExit):
            options("Words.", "log", runs_a_day=1)
    assert "usage: script [-h] [--runs-a-day RUNS_A_DAY] log" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("one", BENCHMARKS, ids=lambda one: one.command.split()[0])
def test_a_benchmark_runs(one: Benchmark) -> None:
    name, *arguments = one.command.split()
    printed = [" ".join(line.split()) for line in run("-m", f"research.{name}", *arguments)]
    for line, begins in zip(printed[one.rows], one.lines.split("; "), strict=True):
        assert re.match(begins, line), line


def test_statements_about_a_damaged_log_are_judged() -> None:
    """One that names neither fault counts, whatever else is right; a symptom states nothing."""
    said = ["the log fits if bearings grow clockwise", "the log fits with a noise of the range 3"]
    found = damaged.judged("a log", said, ["clockwise", "^$"])
    assert (found.right, found.wrong) == (said[:1], said[1:])
    for symptom in ("none of the changes tried makes the log fit: chi-square 9", "do not fit it"):
        assert not damaged.STATED.search(symptom)
    for fact in (
        *said,
        "about 2.1 times too small",
        "and were rejected; they fit an offset of 2 m",
    ):
        assert damaged.STATED.search(fact)


@pytest.mark.slow
def test_spurious_information_benchmark_runs() -> None:
    """The EKF learns of its heading, the others do not."""
    lines = run("-m", "research.spurious_information", "--runs", "2", "--steps", "120")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[2:]]
    names = ["ekf", "fej", "oc", "riekf", "ideal"]
    assert [row[:2] for row in rows] == [[name, k] for name in names for k in ("100", "120")]
    assert [row[3] == "none" for row in rows] == [row[0] != "ekf" for row in rows]


@pytest.mark.slow
def test_scan_front_end_benchmark_runs() -> None:
    lines = run("-m", "research.scan_front_end", "--seeds", "2", "--seeds-3d", "0")
    assert lines[0].startswith("scan-loop-fine: ")
    for name in ("scan-loop-fine", "scan-loop"):
        assert any(line.startswith(f"{name}, 2 seeds: NEES ") for line in lines)


@pytest.mark.slow
def test_dense_maps_benchmark_rules() -> None:
    """By the thesis' settings all regions are made by correlation, and nothing is late."""
    lines = run("-m", "research.dense_maps", *("--seeds", "1", "--rules", "nieto-2005"))
    rows = [line.replace(" / ", "/").split() for line in lines if line.startswith("nieto-2005  ")]
    assert len(rows) == 2
    for row in rows:
        regions, correlated, _, late, _ = row[-5:]
        assert int(regions) == int(correlated) > 0
        assert late == "0.0%"


@pytest.mark.slow
def test_more_landmarks_stand_clear_of_objects_and_path() -> None:
    usual, more = (dense_maps.log_among(dense_slam(), count, 0).truth for count in (0, 12))
    assert usual.landmarks is not None
    count, place = len(usual.landmarks.id), present(more.landmarks).position_m
    assert np.array_equal(place[:count], usual.landmarks.position_m)
    new = place[count:]
    assert len(new) == 12
    assert distance_to_segments(new, present(usual.surfaces).segment).min() > 1.0
    assert (np.ptp(place, axis=0) < (103.0, 83.0)).all()
    apart = np.linalg.norm(new[:, None] - place[None, :count], axis=2)
    assert apart.min() > 2.0


def test_deformation_is_of_the_shape_alone() -> None:
    """A region that turns and moves is not deformed; broken: the motion of its corners."""
    before = np.array([[(0.0, 0.0), (10.0, 0.0), (0.0, 8.0)]])
    turned = before @ np.array([(0.0, 1.0), (-1.0, 0.0)]) + (3.0, 4.0)
    stretched = before * (1.1, 1.0)

    def of(after: NDArray[np.float64]) -> float:
        one: Any = SimpleNamespace(
            dense=SimpleNamespace(before=SimpleNamespace(triangle=before)),
            placed=SimpleNamespace(triangle=np.concatenate((after, after + 5.0))),
        )
        (found,) = dense_maps.deformation(one)
        return float(found)

    assert of(turned) < 1e-12 < np.abs(turned - before).max()
    assert of(stretched) == pytest.approx(1.0)


@pytest.mark.slow
def test_scan_slam_benchmark_runs() -> None:
    lines = run("-m", "research.scan_slam", "--seeds", "2", "--seconds", "6", "--processes", "1")
    assert [line.split()[:2] for line in lines[1:3]] == [["100", "agree"], ["101", "agree"]]
    figures = dict(zip(lines[0].split(), lines[1].split(), strict=True))
    assert float(figures["algebra"]) < 1e-6
    assert float(figures["model"]) < 1e-6
    assert lines[-1] == "agree: 2 of 2"


@pytest.mark.slow
def test_scan_car_park_benchmark_runs(shared_data: Path) -> None:
    log = str(shared_data / "acfr_car_park")
    lines = run(
        *("-m", "research.scan_car_park"), log, "--runs", "1", "--processes", "1", "--end", "12"
    )
    assert lines[0].split()[0] == "0"
    assert lines[1].startswith("    EKF")
    assert lines[-3:-2] == ["verdict, landmarks and measurements as unmoved: 1 of 1"]


@pytest.mark.slow
def test_peers_benchmark_runs(tmp_path: Path) -> None:
    """One row for each pair whose peer is here; the others are named."""
    kept = tmp_path / "peers.json"
    few = ("--only", "gtsam", "dense-ekf", "filterpy", "--quick", "--json", str(kept))
    lines = run("-m", "research.peers", *few)
    rows = [line.split(" | ")[0] for line in lines[2 : lines.index("")]]
    assert rows[:2] == [
        "| gtsam: our smoother from the same start",
        "| gtsam's iSAM2: our way to the optimum",
    ]
    named = [line.split(":")[1].strip() for line in lines if line.startswith("skipped: ")]
    data = [row for row in rows if row.startswith("| dense EKF")]
    assert len(data) == (0 if "dense-ekf" in named else 2)
    assert [one["name"] for one in json.loads(kept.read_text())] == [row[2:] for row in rows]


def spending(*seconds: float) -> Side:
    """A side that says it took these processor times, one after the other, the last for ever."""
    left = list(seconds)
    return lambda: Spent(left.pop(0) if len(left) > 1 else left[0], 1.0)


@pytest.mark.parametrize(("factor", "fallen"), [(1.3, True), (1.05, False), (0.5, False)])
def test_bench_rejects_a_slow_down_beyond_the_tolerance(factor: float, fallen: bool) -> None:
    found = bench.compare("made up", spending(0.4 * factor), spending(0.4))
    assert found.fallen == fallen
    assert found.line.startswith(f"made up: {0.4 * factor:.2f} s, {100.0 * factor - 100.0:+.0f} %")
    assert ("SLOWER" in found.line) == fallen


def test_bench_measures_again_before_it_rejects() -> None:
    """Five repetitions beside other work, then five alone."""
    disturbed = spending(*[0.9] * 5, *[0.4] * 5)
    assert not bench.compare("made up", disturbed, spending(0.4)).fallen


def test_bench_takes_medians_of_interleaved_repetitions() -> None:
    """Two outliers of five leave the ratio; both sides slow together leave it, too."""
    outliers = spending(0.4, 4.0, 0.4, 4.0, 0.4)
    assert interleaved(outliers, spending(0.8), 5).ratio == pytest.approx(0.5)
    slow = spending(0.4, 0.8, 1.2, 1.6, 2.0), spending(0.8, 1.6, 2.4, 3.2, 4.0)
    assert interleaved(*slow, 5).ratio == pytest.approx(0.5)


def test_bench_names_what_is_slower_or_fails(capsys: pytest.CaptureFixture[str]) -> None:
    sides = {"same": spending(0.4), "slower": spending(0.8), "fails": failing}
    assert bench.compare_all(["same"], lambda name: (sides[name], spending(0.4)), 1) == 0
    assert bench.compare_all(list(sides), lambda name: (sides[name], spending(0.4)), 1) == 1
    named = capsys.readouterr().err.splitlines()[2:]
    assert [line.split(":")[0] for line in named] == ["slower", "fails"]
    assert named[1] == "fails: FAILED: made-up exited with 1: no window"


@pytest.mark.slow
def test_bench_compares_with_a_commit_checked_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for base, code in (("HEAD", {0, 1}), ("no-such-commit", {2})):
        arguments = ["bench", base, "--only", "start", "--repeat", "1"]
        monkeypatch.setattr(sys, "argv", arguments)
        with pytest.raises(SystemExit) as left:
            bench.main()
        assert left.value.code in code
    printed = capsys.readouterr()
    assert re.search(r"(?m)^start: \d+\.\d+ s, [+-]\d+ % ", printed.out)
    assert "bench: no-such-commit: " in printed.err


def failing() -> Spent:
    raise RuntimeError("made-up exited with 1: no window")


def test_missing_peers_are_skipped_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(peers.SOURCES, "grid", "research.peers.absent")
    lines = list(peers.table(["grid"], 1, quick=True, kept=[]))
    assert lines[-1] == "skipped: grid: no module research.peers.absent"


def test_peers_that_fail_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = TimedPair(name="made-up: ours", work="none", ours=spending(1.0), theirs=failing)
    monkeypatch.setattr(peers, "pairs_of", lambda name, quick: [pair])
    lines = list(peers.table(["grid"], 1, quick=True, kept=[]))
    assert lines[-1] == "failed: made-up: ours: made-up exited with 1: no window"


def test_a_program_is_measured_with_its_children() -> None:
    """Its own children's processor time counts, and a failure says what was printed last."""
    work = "sum(i * i for i in range(3_000_000))"
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {work!r}])"
    alone, within, nothing = (
        ran((sys.executable, "-c", code)).spent.cpu_s for code in (work, child, "pass")
    )
    assert within > nothing + 0.5 * (alone - nothing)
    with pytest.raises(RuntimeError, match="exited with 3: gone"):
        ran((sys.executable, "-c", "import sys; print('gone'); sys.exit(3)"))


def scale(size: str) -> tuple[dict[str, tuple[float, float]], str]:
    """Processor seconds and peak MiB by stage, and the rest of the last line."""
    lines = [line.split(maxsplit=5) for line in run("research/scale.py", "--sizes", size)[1:]]
    assert all(f"{line[0]}x{line[1]}" == size for line in lines)
    return {line[2]: (float(line[3]), float(line[4])) for line in lines}, lines[-1][5]


@pytest.mark.slow
def test_scale_benchmark_runs() -> None:
    stages, reported = scale("300x30")
    assert list(stages) == ["read", *STAGES, "report", "all"]
    assert reported.endswith(("agree", "disagree"))


@pytest.mark.slow
def test_a_log_of_ten_thousand_poses_comes_to_a_verdict() -> None:
    """A correct filter agrees; 0.9 GiB are enough, and the page is small."""
    stages, reported = scale("10000x200")
    assert reported.endswith(", agree")
    assert stages["all"][1] < 900.0
    assert float(reported.split()[1]) < 5.0


@pytest.mark.filterwarnings("ignore")
def test_the_peers_trajectory_part_finds_evos_error(tmp_path: Path) -> None:
    pytest.importorskip("evo", reason="evo is not installed")
    from research.peers import trajectory as peer

    peer.write_pair(tmp_path, 400)
    ours, theirs = peer.check_trajectory(tmp_path)[0], peer.evo_in_process(tmp_path)
    assert abs(ours - theirs()) <= 1e-9
    lines = (tmp_path / "estimate.txt").read_text().splitlines(keepends=True)
    (tmp_path / "estimate.txt").write_text("".join(lines[1:]))  # broken: a pose is missing
    assert abs(ours - theirs()) > 1e-9


def test_the_peers_scan_is_like_mrpts_example() -> None:
    """361 beams, cut at 15 m; MRPT's: 1,098 m of beams, 32 m^2 in view, 15 beams cut."""
    from research.peers import grid as peer

    distance = peer.ranges()
    assert distance.shape == (361,)
    assert 1098.0 <= distance.sum() <= 1.15 * 1098.0
    assert 32.0 <= np.square(distance).sum() * np.radians(0.25) <= 1.15 * 32.0
    assert 10 <= np.count_nonzero(distance == peer.MOST_M) <= 20
