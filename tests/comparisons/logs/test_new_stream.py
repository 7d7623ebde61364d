"""A stream more touches two files: its columns in the schema, its record and field in `log`."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]
SCHEMA = {
    "STREAMS = (\n": """\
SIGMA_HEADING = Column(
    "sigma_heading_rad",
    ("sigma_heading",),
    limits=SIGMA,
    stated=Stated("--sigma-heading", "RAD", "Sigma of headings.", ("heading_rad",)),
)
HEADINGS = _table("headings", TIME, HEADING, SIGMA_HEADING, order="increasing")
STREAMS = (
""",
    '    LogStream("scans"': '''\
    LogStream("headings", "headings.csv", (HEADINGS,), "--headings", "Of a compass."),
    LogStream("scans"''',
}
"""What stands in the place of a text."""
LOG = {
    "@dataclass(frozen=True)\nclass LoopClosures": '''\
@dataclass(frozen=True, repr=False)
class Headings(Stream, Brief):
    """Absolute headings [rad]."""

    table = schema.HEADINGS

    time_s: Array
    heading_rad: Array
    sigma_heading_rad: Array


@dataclass(frozen=True)
class LoopClosures''',
    "    scans: Scans | None = None\n": (
        "    headings: Headings | None = None\n    scans: Scans | None = None\n"
    ),
    "        truth: Columns | None = None,\n": (
        "        headings: Columns | None = None,\n        truth: Columns | None = None,\n"
    ),
    '            "truth": truth,\n': (
        '            "headings": headings,\n            "truth": truth,\n'
    ),
}
SIGMAS = "--sigma-speed 0.1 --sigma-turn 0.02 --sigma-range 0.1 --sigma-bearing 0.01"
FIRST_S = 1_700_000_000


def with_headings(folder: Path) -> None:
    """Copy the project's packages, and add the stream to two of their files."""
    for name in ("comparisons", "ekf_reference", "graphslam", "slamcheck"):
        shutil.copytree(ROOT / name, folder / name)
    for name, texts in (("schema.py", SCHEMA), ("log.py", LOG)):
        path = folder / "comparisons" / "logs" / name
        source = path.read_text()
        for old, new in texts.items():
            assert source.count(old) == 1, old
            source = source.replace(old, new)
        path.write_text(source)


def called(folder: Path, *words: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, "-m", "slamcheck", *words],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.stdout + done.stderr


def write_files(folder: Path) -> None:
    time_s = np.arange(20) / 10
    rows = {
        "odometry.csv": ["t,v,w", *(f"{FIRST_S + t:.1f},1,0.1" for t in time_s)],
        "trees.csv": ["t,range,bearing,id", *(f"{FIRST_S + t:.1f},3,0.2,1" for t in time_s[3:9])],
        "compass.csv": ["stamp,yaw_deg", *(f"{FIRST_S + t:.1f},{10 * t:g}" for t in time_s[2:8])],
    }
    for name, lines in rows.items():
        (folder / name).write_text("\n".join(lines) + "\n")


@pytest.mark.slow
def test_a_stream_more_is_read_written_cut_and_counted(tmp_path: Path) -> None:
    with_headings(tmp_path)
    write_files(tmp_path)
    first = "new-log mine --odometry odometry.csv --measurements trees.csv --headings compass.csv"
    refused = called(tmp_path, *first.split(), *SIGMAS.split())
    assert "--sigma-heading is missing, expected a number or a column sigma_heading_rad" in refused
    done = called(tmp_path, *first.split(), *SIGMAS.split(), "--sigma-heading", "2deg")
    assert "headings: compass.csv, 6 rows: time_s from 'stamp' (0.200 to 0.700)" in done
    assert "mine: 20 odometry, 6 measurements, 6 headings;" in done
    lines = (tmp_path / "mine" / "headings.csv").read_text().splitlines()
    assert lines[0] == "time_s,heading_rad,sigma_heading_rad"
    assert [float(word) for word in lines[1].split(",")] == [0.2, np.radians(2.0), np.radians(2.0)]

    assert "6 headings" in called(tmp_path, "convert", "mine", "again")
    assert (tmp_path / "again" / "headings.csv").read_text().splitlines() == lines
    part = called(tmp_path, *["convert", "mine", "part", "--start", "0.2", "--end", "0.5"])
    assert "3 headings" in part
    (tmp_path / "mine" / "headings.csv").write_text("\n".join([*lines[:2], "0.3,nan,0.1"]) + "\n")
    expected = "mine/headings.csv:3: heading_rad is 'nan', expected a finite number"
    assert expected in called(tmp_path, "convert", "mine", "never")
