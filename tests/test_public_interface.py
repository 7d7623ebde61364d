"""`import slamcheck`: what it offers is what it says, and importing it loads nothing heavy."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import slamcheck

SOURCE = Path(slamcheck.__file__)


def test_every_name_exists_and_type_checkers_see_the_same_object() -> None:
    tree = ast.parse(SOURCE.read_text())
    typed = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            for one in node.body:
                assert isinstance(one, ast.ImportFrom)
                for alias in one.names:
                    typed[alias.asname] = f"{one.module}:{alias.name}"
    places = {
        name: place if ":" in place else f"{place}:{name}"
        for name, place in slamcheck._PLACES.items()
    }
    assert typed == places
    assert set(slamcheck.__all__) == {*places, "check", "load_log"}
    for name in slamcheck.__all__:
        assert getattr(slamcheck, name) is not None
    assert dir(slamcheck) == sorted(slamcheck.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = slamcheck.nothing


def test_importing_it_loads_nothing_heavy() -> None:
    code = (
        "import sys, slamcheck; "
        "print([m for m in ('numpy', 'gtsam', 'pydantic', 'comparisons') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_log_is_run_checked_and_solved(tmp_path: Path) -> None:
    log = slamcheck.load_log("simulated-loop", seed=7)
    run = slamcheck.compare(log, slamcheck.run_config(filter="compressed"))
    assert run.verdict.outcome == "agree"
    estimate = run.ekf.estimate
    slamcheck.write_estimate(estimate, tmp_path)
    for handed_in in (estimate, slamcheck.ExternalEstimate.of(estimate), tmp_path, str(tmp_path)):
        assert slamcheck.check(log, handed_in).outcome == "agree"
    solution = slamcheck.solve(log)
    assert np.isfinite(solution.estimate.pose).all()
    counts = "3,400 odometry, 1,900 measurements, 3,401 truth poses"
    assert repr(log) == f"<Log simulated-loop: {counts}; 85.0 s>"
    assert repr(run) == f"<Comparison of simulated-loop: {run.verdict.summary}>"
    assert repr(estimate) == "<Estimate: 426 filtered poses, 60 landmarks>"
    checked = slamcheck.check(log, estimate)
    assert repr(checked) == "<ExternalCheck of simulated-loop: agree, grade equal>"
    assert repr(solution).endswith(", verified>")


def test_faults_are_input_errors() -> None:
    with pytest.raises(slamcheck.InputError, match="seed"):
        slamcheck.load_log("simulated-loop", seed=-1)
    with pytest.raises(slamcheck.InputError, match="sede"):
        slamcheck.load_log("simulated-loop", sede=1)
    with pytest.raises(slamcheck.InputError, match="no-such-log"):
        slamcheck.load_log("no-such-log")
