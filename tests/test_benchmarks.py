"""The benchmarks run; what they measure is for people to read."""

from __future__ import annotations

import datetime
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from benchmarks import peers, ratios, scaling
from benchmarks.peer_pairs import MissingError, Pair, Side, Spent
from benchmarks.peer_pairs import run as ran
from tests.graphslam.skips import pass_on

ROOT = Path(__file__).resolve().parents[1]
STAGES = ("ekf", "frozen", "smoother", "marginals", "checks")


def run(*arguments: str) -> list[str]:
    """The lines that a benchmark prints."""
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={"PYTHONPATH": str(ROOT), "PATH": ""},
    )
    pass_on(done.stderr)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


class Benchmark(NamedTuple):
    """command: FOLDER is an empty one. lines: how those printed begin, by rows, parted by `; `."""

    command: str
    rows: slice
    lines: str
    pictures: int = 0


BENCHMARKS = (
    Benchmark(
        "map_size --sizes 30 70 --scans 3 --plot FOLDER/a.png", slice(2, None), "30; 70", pictures=1
    ),
    Benchmark("main_job --repeat 1 simulated-loop", slice(5), "wall; peak MiB; read; ekf; frozen"),
    Benchmark(
        "startup --repeat 1",
        slice(None),
        ".* all beside report share$; python -c pass; slamcheck --help; "
        "slamcheck --version; slamcheck logs; slamcheck run ten-seconds.*%$",
    ),
    Benchmark(
        "waypoint_run --seeds 1 --plot FOLDER/a.png",
        slice(1, None),
        "dead reckoning median; misono median; misono-full median; misono, aided median; "
        "misono-full, aided median",
        pictures=1,
    ),
    Benchmark(
        "attributes --seeds 1 --loops 0.3 --lost 2 --every 5",
        slice(1, 8),
        "nn attributes off; nn attributes on; jcbb attributes off; jcbb attributes on; "
        "simulated-loop, blind; 2 s off; 2 s on",
    ),
    Benchmark(
        "smoother --quick",
        slice(1, None),
        "graph; solution; all marginals; together; with its default; iSAM2; "
        "from nothing; with the evidence; errors: ours",
    ),
    Benchmark(
        "neglected_change --seeds 1 --figures FOLDER",
        slice(1, None),
        "scan-loop ; scan-loop-fine; occupancy-loop; its; simulated-loop",
        pictures=3,
    ),
    Benchmark(
        "dense_maps --only layers size --scans 3 --sizes 10 20",
        slice(None),
        "361 returns, 40 regions in view; ; ; points; occupancy; particles; sog; "
        r"all four ; all four, ; ; ; ; \S+ 12\b; \S+ 24\b",
    ),
    Benchmark("high_level --searches 1 --sizes 11 20 --only size", slice(2, None), "11; 20"),
    Benchmark(
        "defects --only steering --seeds 2 --loop-s 20",
        slice(1, 4),
        "steering sign; 1 of 1 caught, 1 with the right first cause$; "
        ".*0 of 2 flagged, 0.0 to 84.2 %",
    ),
    Benchmark("trust_bands --quick", slice(2, None), "; ".join((r".*\| yes \|$",) * 9)),
    Benchmark(
        "dynamic_regions --seeds 1 --seconds 6",
        slice(None),
        "lanes:; places:; lanes, nothing moving:; places, nothing moving:; landmark on a vehicle:",
    ),
    Benchmark(
        "audit_speed --events 3000 --rounds 1 --reset --keep FOLDER/ins.trace --audit",
        slice(1, None),
        "filter alone:; recorded:; recorder:; overhead:; file:; read:; audit:.*sound$",
    ),
)


@pytest.mark.slow
@pytest.mark.parametrize("one", BENCHMARKS, ids=lambda one: one.command.split()[0])
def test_a_benchmark_runs(one: Benchmark, tmp_path: Path) -> None:
    name, *arguments = one.command.replace("FOLDER", str(tmp_path)).split()
    printed = [" ".join(line.split()) for line in run(f"benchmarks/{name}.py", *arguments)]
    for line, begins in zip(printed[one.rows], one.lines.split("; "), strict=True):
        assert re.match(begins, line), line
    pictures = [path.read_bytes()[:4] for path in tmp_path.glob("*.png")]
    assert pictures == [b"\x89PNG"] * one.pictures


@pytest.mark.slow
def test_spurious_information_benchmark_runs(tmp_path: Path) -> None:
    """The EKF learns of its heading, the others do not."""
    picture = tmp_path / "learnt.png"
    options = ("--runs", "2", "--steps", "120", "--plot", str(picture))
    lines = run("benchmarks/spurious_information.py", *options)
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[2:]]
    names = ["ekf", "fej", "oc", "riekf", "ideal"]
    assert [row[:2] for row in rows] == [[name, k] for name in names for k in ("100", "120")]
    assert [row[3] == "none" for row in rows] == [row[0] != "ekf" for row in rows]
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_scan_front_end_benchmark_runs() -> None:
    lines = run("benchmarks/scan_front_end.py", "--seeds", "2", "--seeds-3d", "0")
    assert lines[0].startswith("scan-loop-fine: ")
    for name in ("scan-loop-fine", "scan-loop"):
        assert any(line.startswith(f"{name}, 2 seeds: NEES ") for line in lines)


@pytest.mark.slow
@pytest.mark.usefixtures("open3d_library")
def test_matchers_benchmark_runs(tmp_path: Path) -> None:
    picture = tmp_path / "basins.png"
    lines = run("benchmarks/matchers.py", "--pairs", "1", "--figure", str(picture))
    icp = ["surface", "kiss", "point-to-point", "point-to-plane", "generalised"]
    names = [*icp, "sog", "occupancy"]
    assert [line.split()[2] for line in lines[2:-1]] == names
    assert "with covariance" in lines[-1]
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_dense_maps_benchmark_drives() -> None:
    lines = run("benchmarks/dense_maps.py", "--only", "drives", "--seeds", "1", "--loops", "1")
    names = [line.split()[0] for line in lines[3:8]]
    assert names == ["points", "occupancy", "particles", "sog", "classic"]
    assert lines[-1].startswith("returns: ")


@pytest.mark.slow
def test_dense_maps_benchmark_rules() -> None:
    """By the thesis' settings all regions are made by correlation, and nothing is late."""
    lines = run(
        "benchmarks/dense_maps.py", *("--only", "rules", "--seeds", "1", "--rules", "as-published")
    )
    rows = [line.replace(" / ", "/").split() for line in lines if line.startswith("as-published  ")]
    assert len(rows) == 2
    for row in rows:
        regions, correlated, _, late, _ = row[-5:]
        assert int(regions) == int(correlated) > 0
        assert late == "0.0%"


@pytest.mark.slow
def test_scan_slam_benchmark_runs() -> None:
    lines = run("benchmarks/scan_slam.py", "--seeds", "2", "--seconds", "6", "--processes", "1")
    assert [line.split()[:2] for line in lines[1:3]] == [["100", "agree"], ["101", "agree"]]
    figures = dict(zip(lines[0].split(), lines[1].split(), strict=True))
    assert float(figures["algebra"]) < 1e-6
    assert float(figures["model"]) < 1e-6
    assert lines[-1] == "agree: 2 of 2"


@pytest.mark.slow
def test_scan_car_park_benchmark_runs(shared_data: Path) -> None:
    log = str(shared_data / "acfr_car_park")
    lines = run(
        "benchmarks/scan_car_park.py", log, "--runs", "1", "--processes", "1", "--end", "12"
    )
    assert lines[0].split()[0] == "0"
    assert lines[1].startswith("    EKF")
    assert lines[-3:-2] == ["verdict, landmarks and measurements as unmoved: 1 of 1"]


def test_pieces_benchmark_runs() -> None:
    lines = run("benchmarks/pieces.py", "--repeat", "2")
    assert len(lines) == 2
    assert all("median" in line for line in lines)


@pytest.mark.slow
def test_peers_benchmark_runs(tmp_path: Path) -> None:
    """One row for each pair whose peer is here; the others are named."""
    kept = tmp_path / "peers.json"
    few = ("--only", "gtsam", "dense-ekf", "filterpy", "--quick", "--json", str(kept))
    lines = run("-m", "benchmarks.peers", *few)
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


def kept_ratio(ratio: float) -> ratios.Kept:
    day = datetime.date(2026, 1, 1)
    return ratios.Kept(name="made up", ratio=ratio, commit="0123456", date=day)


@pytest.mark.parametrize(("factor", "fallen"), [(1.3, True), (1.1, False), (0.5, False)])
def test_bench_rejects_a_slow_down_beyond_the_tolerance(factor: float, fallen: bool) -> None:
    sides = spending(0.4 * factor), spending(0.8)
    found = ratios.compare("made up", lambda: sides, kept_ratio(0.5))
    assert found.fallen == fallen
    assert found.ratio == pytest.approx(0.5 * factor)
    assert found.line.startswith(f"made up: {0.5 * factor:.4g} ")
    assert "kept 0.5 " in found.line
    assert ("SLOWER" in found.line) == fallen


def test_bench_measures_again_before_it_rejects() -> None:
    """Five repetitions beside other work, then five alone."""
    disturbed = spending(*[0.9] * 5, *[0.4] * 5)
    found = ratios.compare("made up", lambda: (disturbed, spending(0.8)), kept_ratio(0.5))
    assert not found.fallen
    assert found.ratio == pytest.approx(0.5)


def test_bench_takes_medians_of_interleaved_repetitions() -> None:
    """Two outliers of five leave the ratio; both sides slow together leave it, too."""
    outliers = spending(0.4, 4.0, 0.4, 4.0, 0.4)
    found = ratios.compare("made up", lambda: (outliers, spending(0.8)), kept_ratio(0.5))
    assert found.ratio == pytest.approx(0.5)
    slow = spending(0.4, 0.8, 1.2, 1.6, 2.0), spending(0.8, 1.6, 2.4, 3.2, 4.0)
    assert ratios.compare("made up", lambda: slow, None).ratio == pytest.approx(0.5)


def missing() -> ratios.Sides:
    raise MissingError("made-up not installed: make peers")


def test_missing_peers_are_skipped_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    found = ratios.compare("made up", missing, kept_ratio(0.5))
    assert not found.fallen
    assert found.line == "made up: skipped: made-up not installed: make peers"
    monkeypatch.setitem(peers.SOURCES, "grid", "benchmarks.peer_that_is_not")
    lines = list(peers.table(["grid"], 1, quick=True, kept=[]))
    assert lines[-1] == "skipped: grid: no module benchmarks.peer_that_is_not"


def failing() -> Spent:
    raise RuntimeError("made-up exited with 1: no window")


def test_programs_that_fail_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    found = ratios.compare("made up", lambda: (spending(1.0), failing), kept_ratio(0.5))
    assert found.fallen
    assert found.line == "made up: FAILED: made-up exited with 1: no window"
    pair = Pair(name="made-up: ours", work="none", ours=spending(1.0), theirs=failing)
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


def bench(monkeypatch: pytest.MonkeyPatch, make: ratios.Make, *arguments: str) -> int | str | None:
    """The exit code of `benchmarks.ratios` with one benchmark."""
    monkeypatch.setattr(ratios, "BENCHMARKS", {"made up": make})
    monkeypatch.setattr(sys, "argv", ["ratios", *arguments])
    try:
        ratios.main()
    except SystemExit as left:
        return left.code
    return 0


def test_bench_keeps_ratios_and_compares_with_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "ratios.toml"

    def half() -> ratios.Sides:
        return spending(0.4), spending(0.8)

    def worse() -> ratios.Sides:
        return spending(0.52), spending(0.8)

    assert bench(monkeypatch, half, "--file", str(file)) == 2
    assert bench(monkeypatch, half, "--file", str(file), "--keep") == 0
    assert ratios.read(file, ["made up"])["made up"].ratio == 0.5
    assert bench(monkeypatch, half, "--file", str(file)) == 0
    capsys.readouterr()
    assert bench(monkeypatch, worse, "--file", str(file)) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("made up: 0.65 (0.65 to 0.65), kept 0.5 of ")
    assert bench(monkeypatch, missing, "--file", str(file), "--keep") == 0
    assert ratios.read(file, ["made up"])["made up"].ratio == 0.5


GOOD = """[[ratio]]
name = "made up"
ratio = 0.5
commit = "0123456"
date = 2026-01-01
tolerance = 0.2
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("ratio = 0.5", "ratio = 0.0", "ratio.0.ratio: input should be greater than 0"),
        ("ratio = 0.5", "ratio = nan", "ratio.0.ratio: input should be"),
        ("ratio = 0.5", "time = 0.5", "ratio.0.ratio: field required"),
        ('commit = "0123456"', 'commit = "yesterday"', "ratio.0.commit: string should match"),
        ("tolerance = 0.2", "tolerance = 2", "ratio.0.tolerance: input should be less than 1"),
        ('"made up"', '"gone"', "gone: no such benchmark; take it out"),
        ("[[ratio]]", "[[ratio]", "ratios.toml: "),
        (GOOD, GOOD + GOOD, "made up: stands there twice"),
    ],
)
def test_a_bad_file_of_ratios_is_one_line(
    old: str,
    new: str,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "ratios.toml"
    file.write_text(GOOD)
    assert ratios.read(file, ["made up"]) == {"made up": kept_ratio(0.5)}
    file.write_text(GOOD.replace(old, new))
    assert bench(monkeypatch, missing, "--file", str(file)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("ratios: ratios.toml: ")
    assert said in line


def test_the_kept_ratios_are_of_the_benchmarks() -> None:
    assert ratios.read(ratios.FILE, list(ratios.BENCHMARKS))


def scale(size: str) -> tuple[dict[str, tuple[float, float]], str]:
    """Processor seconds and peak MiB by stage, and the rest of the last line."""
    lines = [line.split(maxsplit=5) for line in run("benchmarks/scale.py", "--sizes", size)[1:]]
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
    from benchmarks import peer_trajectory as peer

    peer.write_pair(tmp_path, 400)
    ours, theirs = peer.check_trajectory(tmp_path)[0], peer.evo_in_process(tmp_path)
    assert abs(ours - theirs()) <= 1e-9
    lines = (tmp_path / "estimate.txt").read_text().splitlines(keepends=True)
    (tmp_path / "estimate.txt").write_text("".join(lines[1:]))  # broken: a pose is missing
    assert abs(ours - theirs()) > 1e-9


def test_the_peers_scan_is_like_mrpts_example() -> None:
    """361 beams, cut at 15 m; MRPT's: 1,098 m of beams, 32 m^2 in view, 15 beams cut."""
    from benchmarks import peer_grid as peer

    distance = peer.ranges()
    assert distance.shape == (361,)
    assert 1098.0 <= distance.sum() <= 1.15 * 1098.0
    assert 32.0 <= np.square(distance).sum() * np.radians(0.25) <= 1.15 * 32.0
    assert 10 <= np.count_nonzero(distance == peer.MOST_M) <= 20


@pytest.mark.slow
def test_scaling_benchmark_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a cluster, which tests/comparisons/montecarlo starts."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    few = ("--chunks", "1", "--repeat", "1", "--scenario", "nieto-loop", "--price", "2")
    monkeypatch.setattr(sys, "argv", ["scaling.py", *few])
    scaling.main()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("dask: not installed")
    curve = [line.split()[:2] for line in lines if line.startswith("joblib ")]
    assert curve[:2] == [["joblib", "1"], ["joblib", "2"]]
    assert "100,000 runs of one filter, projected, not measured" in lines
    assert lines[-1].endswith("at 2.0 a core-hour")


def test_a_projection_is_bounded_by_the_process_that_writes() -> None:
    assert scaling.projected_hours(2, 10.0, 0.8, 0.1) == pytest.approx(6.25)
    assert scaling.projected_hours(128, 10.0, 0.8, 0.5) == 0.5
    assert (
        scaling.projected_hours(128, 10.0, 0.8, 0.0) < 0.1
    )  # the broken variant: without the bound


@pytest.mark.slow
def test_own_association_benchmark_runs() -> None:
    lines = run("benchmarks/own_association.py", "--full", "--check")
    agreed = next(line for line in lines if line.startswith("own and full"))
    assert agreed.endswith("0 and 0 in one; 0 measurements at other landmarks, 0 and 0 used by one")
    assert len(lines) == 10
