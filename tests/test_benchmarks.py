"""The benchmarks run; what they measure is for people to read."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

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


@pytest.mark.slow
def test_map_size_benchmark_runs(tmp_path: Path) -> None:
    picture = tmp_path / "cost.png"
    lines = run(
        "benchmarks/map_size.py", "--sizes", "30", "70", "--scans", "3", "--plot", str(picture)
    )
    assert [line.split()[0] for line in lines[2:]] == ["30", "70"]
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_main_job_benchmark_runs() -> None:
    lines = run("benchmarks/main_job.py", "--repeat", "1", "simulated-loop")
    names = [line.split("  ")[0].strip() for line in lines]
    assert names[0] == "wall"
    assert "frozen" in names


@pytest.mark.slow
def test_waypoint_run_benchmark_runs(tmp_path: Path) -> None:
    picture = tmp_path / "run.png"
    lines = run("benchmarks/waypoint_run.py", "--seeds", "1", "--plot", str(picture))
    names = [line.split("  ")[0].removesuffix(" median") for line in lines[1:]]
    aided = ["misono, aided", "misono-full, aided"]
    assert names == ["dead reckoning", "misono", "misono-full", *aided]
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_layer_values_benchmark_runs() -> None:
    lines = run("benchmarks/layer_values.py", "--seeds", "1", "--loops", "0.08")
    assert [line.split()[:2] for line in lines[3:6]] == [
        ["nn", k] for k in ("off", "layer", "mixed")
    ]


@pytest.mark.slow
def test_attributes_benchmark_runs() -> None:
    few = ("--seeds", "1", "--loops", "0.3", "--lost", "2", "--every", "5")
    lines = run("benchmarks/attributes.py", *few)
    assert [line.split()[2] for line in lines[-3:-1]] == ["off", "on"]
    assert [line.split()[:3:2] for line in lines[1:5]] == [
        ["nn", "off"],
        ["nn", "on"],
        ["jcbb", "off"],
        ["jcbb", "on"],
    ]


@pytest.mark.slow
def test_smoother_benchmark_runs() -> None:
    lines = run("benchmarks/smoother.py", "--quick")
    assert lines[1].startswith("graph ")
    assert lines[-1].startswith("errors: ours ")


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
def test_neglected_change_benchmark_runs(tmp_path: Path) -> None:
    lines = run("benchmarks/neglected_change.py", "--seeds", "1", "--figures", str(tmp_path))
    assert [line.split()[0] for line in lines[1:]] == [
        "scan-loop",
        "scan-loop-fine",
        "occupancy-loop",
        "its",
        "simulated-loop",
    ]
    assert len(list(tmp_path.glob("*.png"))) == 3


@pytest.mark.slow
def test_dense_maps_benchmark_runs() -> None:
    lines = run(
        "benchmarks/dense_maps.py",
        "--only",
        "layers",
        "size",
        "--scans",
        "3",
        "--sizes",
        "10",
        "20",
    )
    assert lines[0].startswith("361 returns, 40 regions in view")
    names = [line[:10].strip() for line in lines[3:9]]
    assert names == ["points", "occupancy", "particles", "sog", "all four", "all four,"]
    assert [line.split()[1] for line in lines[12:]] == ["12", "24"]


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
def test_high_level_benchmark_runs() -> None:
    few = ("--searches", "1", "--sizes", "11", "20", "--only", "size")
    lines = run("benchmarks/high_level.py", *few)
    assert [line.split()[0] for line in lines[2:]] == ["11", "20"]


@pytest.mark.slow
def test_enriched_templates_benchmark_runs(tmp_path: Path) -> None:
    picture = tmp_path / "basin.png"
    few = ("--seeds", "1", "--draws", "1", "--errors", "0.25", "--figure", str(picture))
    lines = run("benchmarks/enriched_templates.py", *few)
    error, bare, enriched = (float(part.rstrip("%")) for part in lines[2].split())
    assert error == 0.25
    assert enriched > bare > 20.0
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_defects_benchmark_runs() -> None:
    lines = run("benchmarks/defects.py", "--only", "steering", "--seeds", "2", "--loop-s", "20")
    assert lines[1].startswith("steering sign ")
    assert lines[2] == "1 of 1 caught, 1 with the right first cause"
    assert "0 of 2 flagged, 0.0 to 84.2 %" in lines[3]


@pytest.mark.slow
def test_trust_bands_benchmark_runs() -> None:
    lines = run("benchmarks/trust_bands.py", "--quick")
    assert len(lines) == 11
    assert all(line.endswith("| yes |") for line in lines[2:])


@pytest.mark.slow
def test_dynamic_regions_benchmark_runs() -> None:
    lines = run("benchmarks/dynamic_regions.py", "--seeds", "1", "--seconds", "6")
    assert [line.split(":")[0] for line in lines] == [
        "lanes",
        "places",
        "lanes, nothing moving",
        "places, nothing moving",
        "landmark on a vehicle",
    ]


@pytest.mark.slow
def test_scan_slam_benchmark_runs() -> None:
    lines = run("benchmarks/scan_slam.py", "--seeds", "1", "--seconds", "6")
    assert [line.split()[0] for line in lines] == ["seed", "0", "median"]
    assert lines[1].split()[-1] == "agree"


def test_pieces_benchmark_runs() -> None:
    lines = run("benchmarks/pieces.py", "--repeat", "2")
    assert len(lines) == 2
    assert all("median" in line for line in lines)


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


@pytest.mark.slow
def test_own_association_benchmark_runs() -> None:
    lines = run("benchmarks/own_association.py", "--full", "--check")
    agreed = next(line for line in lines if line.startswith("own and full"))
    assert agreed.endswith("0 and 0 in one; 0 measurements at other landmarks, 0 and 0 used by one")
    assert len(lines) == 10
