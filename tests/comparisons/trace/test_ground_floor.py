"""A recording, and its audit, load neither an estimator nor the planar harness."""

from pathlib import Path

import numpy as np
import pytest

from comparisons.trace.recorder import Recorder
from tests.processes import printed

PLANAR = (
    *("ekf_reference", "comparisons.adapters", "comparisons.checks", "comparisons.config"),
    *("comparisons.estimates", "comparisons.extensions", "comparisons.jobs", "comparisons.logs"),
    *("comparisons.pipeline", "graphslam.problem", "graphslam.smoother"),
)
"""Beginnings of what knows a planar log, a filter or a smoother of it."""
OF_ANY = ("", ".causes", ".check", ".finding", ".of_events")
"""Of the checks: what one is, what each kind of cause decides, and those of events."""
_LIST = """
import sys
HOUSE = ("comparisons", "ekf_reference", "graphslam", "slamcheck")
print(*(name for name in sys.modules if name.split(".")[0] in HOUSE))
"""
_AUDIT = """
import runpy
sys.argv = ["slamcheck", "audit", {trace!r}, "--out", {out!r}, "--quiet"]
try:
    runpy.run_module("slamcheck", run_name="__main__")
except SystemExit as done:
    assert done.code == 1, done.code
"""


def _loaded(code: str) -> list[str]:
    """Modules of the house that a fresh process has loaded after some code."""
    return printed(f"import sys\n{code}\n{_LIST}").split()


def planar(found: list[str]) -> list[str]:
    """Those of modules that the ground floor and an audit do without."""
    any_job = [f"comparisons.checks{name}" for name in OF_ANY]
    return [name for name in found if name.startswith(PLANAR) and name not in any_job]


def _faulty(path: Path) -> None:
    """Record a filter that forgets its noise, so that the audit seeks the fault, too."""
    f, q, h, r, p = np.eye(2), 0.1 * np.eye(2), np.eye(1, 2), np.eye(1), np.eye(2)
    with Recorder(path) as record:
        record.prior({"place": 2}, p)
        for _ in range(3):
            record.predict(f, q)
            record.update("range", [0.1], h, r)
            p = p - p @ h.T @ np.linalg.inv(h @ p @ h.T + r) @ h @ p
            record.snapshot(p)


def test_recorder_loads_the_ground_floor_alone() -> None:
    found = _loaded("import slamcheck\nslamcheck.Recorder")
    assert not [name for name in found if name.split(".")[0] in ("ekf_reference", "graphslam")]
    assert planar(found) == []


@pytest.mark.slow
@pytest.mark.parametrize("module", ["", "comparisons.config", "comparisons.jobs.run"])
def test_audit_loads_no_planar_harness(module: str, tmp_path: Path) -> None:
    """And one that is loaded beside it is seen."""
    trace = tmp_path / "run.trace"
    _faulty(trace)
    code = _AUDIT.format(trace=str(trace), out=str(tmp_path / "out"))
    found = _loaded(f"import {module}\n{code}" if module else code)
    assert "comparisons.faults.of_events" in found
    assert module in planar(found) if module else planar(found) == []
