"""A user's script passes mypy, and a misspelt option in one does not."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = """
from pathlib import Path

from matplotlib.axes import Axes

import slamcheck


def report(place: Path) -> bool:
    log = slamcheck.load_log(place, seed=7)
    run = slamcheck.compare(log, filter="compressed", association="nn", gps="off")
    print(run.verdict.summary, run.agreement.algebra.sigma, run.to_pandas("gaps"))
    mine = slamcheck.read_estimate("mine")
    found = slamcheck.check(log, mine, require="like")
    print(found.outcome, found.grade.value, *found.causes, sep="\\n")
    apart = slamcheck.compare_estimates(mine, run.ekf.estimate, relation="independent")
    print(apart.rms_m, apart.nees_mean, apart.landmark)
    axis: Axes = slamcheck.plot_map(run)
    slamcheck.plot_trajectory(mine, axis, name="mine").set_title("paths")
    for result in (run, found):
        slamcheck.plot_errors(result, "heading").set_title("heading")
        slamcheck.plot_nees(result).set_ylim(0.0, 20.0)
        slamcheck.plot_ladder(result)
    slamcheck.write_report(found, place / "report")
    return found.outcome == "agree"
"""
WRONG = {
    'filter="compressed"': 'filter="compresed"',
    'gps="off"': 'gpz="off"',
    'require="like"': 'require="lik"',
    'relation="independent"': 'relation="dependent"',
    '"heading").set_title': '"yaw").set_title',
    'found.outcome == "agree"': "found.verdict",
}
"""What stands in the script, and a slip that the type checker sees in its place."""


@pytest.mark.slow
def test_a_users_script_passes_mypy_and_its_slips_do_not(tmp_path: Path) -> None:
    """One run for all: each slip stands in a file of its own, the sound script in another."""
    (tmp_path / "sound.py").write_text(SCRIPT)
    for number, (right, slip) in enumerate(WRONG.items()):
        assert right in SCRIPT
        (tmp_path / f"slip{number}.py").write_text(SCRIPT.replace(right, slip))
    files = [str(path) for path in sorted(tmp_path.glob("*.py"))]
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", *files]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    faulty = re.findall(r"^(?:.*/)?(\w+)\.py:\d+: error:", done.stdout, re.MULTILINE)
    assert set(faulty) == {f"slip{number}" for number in range(len(WRONG))}, (
        done.stdout + done.stderr
    )
