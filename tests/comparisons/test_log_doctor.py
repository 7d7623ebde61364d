"""Logs whose units, signs, columns or sigmas are wrong are told from sound ones before any filter.

`benchmarks/log_doctor.py` has more of each.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.log_doctor import EVERY, POSES, WHEELS, drive
from comparisons.checks.diagnosis.log_doctor import examine
from comparisons.logs.log import Log
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from comparisons.logs.odometry import VelocityOdometry
from tests.commands import slamcheck
from tests.helpers import compared

CASES = {
    "clockwise bearings": "velocity",
    "clockwise turns": "velocity",
    "radians taken for degrees": "steering",
    "turns in degrees": "velocity",
    "km/h": "steering",
    "bearing's variance": "velocity",
    "bearing's sigma taken for degrees": "velocity",
    "y to the right": "poses",
    "a clock of 0.5 s": "velocity",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_what_was_done_is_named(name: str) -> None:
    kind = CASES[name]
    change, words = {**EVERY, **WHEELS, **POSES}[name]
    found = examine(change(drive(7, kind)))
    assert words in found.words
    assert len(found.findings) <= 2
    assert re.search(r"chi-square falls from \S+ to \S+ with this changed", found.words)


@pytest.mark.slow
def test_a_unit_that_explains_a_part_hides_no_variance() -> None:
    """Ranges in cm take four fifths of chi-square here, and leave 35 times what is expected."""
    found = examine(EVERY["range's variance"][0](drive(309, "poses")))
    assert found.words.startswith("the sigma of ranges, 0.0025, is a variance")
    assert found.findings[0].chi2 < found.test.upper


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bearing's variance", "turns in degrees"])
def test_a_run_names_it_first(name: str) -> None:
    """What no scale, offset or delay explains; without it a sigma was said to be too small."""
    change, words = {**EVERY, **WHEELS}[name]
    found = compared(change(drive(7, "velocity"))).verdict
    first = found.causes[0]
    assert first.gap == "log"
    assert words in first.evidence
    assert "noise" not in [one.gap for one in found.causes]


@pytest.mark.parametrize("kind", ["velocity", "steering", "poses"])
def test_a_sound_log_is_not_accused(kind: str) -> None:
    found = examine(drive(8, kind))
    assert not found.findings
    assert found.test.reading == "plausible"


@pytest.mark.slow
def test_more_noise_than_stated_is_no_unit() -> None:
    """Three times: no single change explains it, and nothing is named."""
    log, rng = drive(9, "velocity"), np.random.default_rng(0)
    seen = log.measurements
    more = 3.0 * seen.sigma_bearing_rad * rng.standard_normal(len(seen.time_s))
    noisy = replace(log, measurements=replace(seen, bearing_rad=seen.bearing_rad + more))
    assert examine(noisy).test.reading == "too high"
    assert not examine(noisy).findings


def unlabelled(log: Log) -> Log:
    none = np.full(len(log.measurements.time_s), -1)
    return replace(log, measurements=replace(log.measurements, landmark=none))


def test_the_command_says_so(tmp_path: Path) -> None:
    change, words = EVERY["clockwise bearings"]
    for name, log in {"sound": drive(7, "velocity"), "wrong": change(drive(7, "velocity"))}.items():
        write_log_folder(log, tmp_path / name)
    write_log_folder(unlabelled(drive(7, "velocity")), tmp_path / "none")
    sound, wrong, none = (
        slamcheck("logs", name, cwd=tmp_path) for name in ("sound", "wrong", "none")
    )
    assert (sound.returncode, wrong.returncode, none.returncode) == (0, 1, 0)
    assert "no fault found" in sound.stdout
    assert words in wrong.stdout
    assert "--unit bearing=-rad" in wrong.stdout
    assert "not examined: the log has no labelled measurements" in none.stdout


def test_units_that_contradict_the_data_are_refused(tmp_path: Path) -> None:
    """A yaw rate in rad/s taken for degrees; the option that mends bearings alone is accepted."""
    log = drive(7, "velocity")
    seen, moved = log.measurements, log.odometry
    assert isinstance(moved, VelocityOdometry)
    controls = zip(moved.time_s, moved.speed_mps, moved.yaw_rate_radps, strict=True)
    text = "time,v,w\n" + "".join(f"{t:.3f},{v:.9g},{w:.9g}\n" for t, v, w in controls)
    (tmp_path / "odometry.csv").write_text(text)
    rows = zip(seen.time_s, seen.landmark, seen.range_m, np.degrees(seen.bearing_rad), strict=True)
    text = "time,label,range,bearing\n"
    text += "".join(f"{t:.3f},post {i},{r:.9g},{b:.9g}\n" for t, i, r, b in rows)
    (tmp_path / "seen.csv").write_text(text)
    command = "new-log mine --odometry odometry.csv --measurements seen.csv --sigma-speed 0.05 "
    command += "--sigma-turn 0.02radps --sigma-range 5cm --sigma-bearing 0.573 --unit bearing=deg"
    refused = slamcheck(*command.split(), "--unit", "w=degps", cwd=tmp_path)
    assert refused.returncode == 2
    assert "yaw_rate is in radians (give --unit yaw_rate=radps)" in refused.stderr
    assert not (tmp_path / "mine").exists()
    done = slamcheck(*command.split(), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stdout
    sigma = read_log_folder(tmp_path / "mine").measurements.sigma_bearing_rad
    assert np.allclose(sigma, 0.01, rtol=1e-3)
