"""A stranger's way from raw CSV files to a verdict, by the lines of docs/your-own-log.md alone."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from comparisons.logs.message_csv import MESSAGES
from tests.commands import slamcheck
from tests.comparisons.logs.test_foreign_files import DRIVE, STEP_S
from tests.comparisons.logs.test_message_csv import EPOCH, quaternion, rostopic

PAGE = Path(__file__).resolve().parents[1] / "docs" / "your-own-log.md"
SECTION = re.compile(r"## What ROS writes\n.*?\n```\n(.*?)```", re.DOTALL)


def files(folder: Path) -> None:
    """Odometry as `rostopic echo -p` writes it; detections in degrees, nanoseconds, text labels."""
    rows = []
    for k, (x, y, yaw) in enumerate(DRIVE.pose[:-1].tolist()):
        stamp = divmod(round(k * STEP_S * 1e9) + EPOCH * 10**9, 10**9)
        pose = [x, y, 0.0, *quaternion(yaw), *[0.0] * 36]
        twist = [DRIVE.speed[k], 0.0, 0.0, 0.0, 0.0, DRIVE.turn[k], *[0.0] * 36]
        rows.append([*stamp, "odom", "base_link", *pose, *twist])
    (folder / "odom.csv").write_text(rostopic(MESSAGES["nav_msgs/Odometry"], rows))
    lines = ["label,stamp_ns,range_m,bearing_deg"]
    lines += [
        f"post {post},{round(t * 1e9) + EPOCH * 10**9},{distance:.4f},{np.degrees(bearing):.3f}"
        for t, post, distance, bearing in DRIVE.seen
    ]
    (folder / "detections.csv").write_text("\n".join(lines) + "\n")


@pytest.mark.slow
def test_from_raw_files_to_a_right_verdict_at_the_first_try(tmp_path: Path) -> None:
    """The same with detections that grow clockwise: said before the run, with the option."""
    files(tmp_path)
    block = SECTION.search(PAGE.read_text())
    assert block is not None
    make, run = (line.split()[1:] for line in block[1].splitlines())
    made = slamcheck(*make, cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert "warning" not in made.stdout
    assert "time_s from 'field.header.stamp' in ns, by their size" in made.stdout
    done = slamcheck(*run, "--out", "report", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("verdict: agree")
    result = json.loads((tmp_path / "report" / "result.json").read_text())
    assert result["agreement"]["landmarks"]
    assert (tmp_path / "report" / "ekf" / "landmarks.csv").read_text().count("post ") == 12

    detections = (tmp_path / "detections.csv").read_text()
    turned = re.sub(r",(-?)([\d.]+)$", r",\1-\2", detections, flags=re.MULTILINE)
    (tmp_path / "detections.csv").write_text(turned.replace("--", ""))
    make[1] = "other"
    wrong = slamcheck(*make, cwd=tmp_path)
    assert wrong.returncode == 0, wrong.stderr
    assert "warning: " in wrong.stdout
    assert "--unit bearing=-rad (or -deg)" in wrong.stdout
