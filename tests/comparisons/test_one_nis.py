"""NIS by sensor is one figure: of a run, of its trace as it is checked, and as it is audited."""

from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import fused_positions, settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.audit.audit import audit
from comparisons.audit.consistency import event_innovations
from comparisons.audit.own_filter import run_events, write_run
from comparisons.checks.consistency.consistency import check_innovations
from comparisons.config import EkfConfig
from comparisons.innovations import SensorInnovations
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.trace.events import Update
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import Recorder
from ekf_reference.core.landmark_types import POINT

CASES = {
    "compressed": ("simulated-loop", 1, {"filter": "compressed", "association": "nn"}),
    "compressed, in parts": (
        "waypoint-run",
        0,
        {"filter": "compressed", "gps": "on", "split_shrink": 0.3},
    ),
    "misono": ("waypoint-run", 0, {"filter": "misono", "gps": "on"}),
}
COMPONENTS = {"compressed": ["range", "bearing"], "misono": ["forward", "left"]}


@cache
def filtered(name: str) -> EkfRun:
    """The filter of a golden case's log, without a smoother."""
    log_name, seed, options = CASES[name]
    log = open_log(log_name, choices=SimulationChoices(seed=seed))
    chosen = settle(EkfConfig.model_validate(options), log)
    positions = fused_positions(log, chosen)
    return run_ekf(log, build_timeline(log, positions), chosen, positions)


def figures(sensors: Iterable[SensorInnovations]) -> dict[str, float]:
    """Everything that reports say of them, by name."""
    found = dict[str, float]()
    for one in sensors:
        for nis in one.nis:
            values = nis.dof, nis.count, nis.mean, *nis.band
            found |= {f"{one.sensor} {nis.name} {i}": float(v) for i, v in enumerate(values)}
        for white in one.whiteness:
            name = f"{one.sensor} {white.component} by {white.order}"
            found |= {f"{name} {i}": 1.0 + float(v) for i, v in enumerate(white.autocorrelation)}
        windows = (one.windows.time_s, one.windows.mean, one.windows.low)
        found |= {f"{one.sensor} windows {i}": float(w.sum()) for i, w in enumerate(windows)}
        found[f"{one.sensor} unusable"] = one.unusable
    return found


def of_trace(folder: Path) -> tuple[SensorInnovations, ...]:
    trace = TraceReader(folder / "run.trace")
    return event_innovations(trace, trace.sensors)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_run_check_and_audit_say_the_same(name: str, tmp_path: Path) -> None:
    run = filtered(name)
    own = check_innovations(run)
    sensors = ["measurements", "positions"] if run.positions is not None else ["measurements"]
    assert [one.sensor for one in own] == sensors
    assert [nis.name for nis in own[0].nis[1:]] == COMPONENTS[name.partition(",")[0]]
    parts = run.trace.measurements[POINT].weight < 1.0
    assert parts.any() == name.endswith("in parts")
    write_run(run, tmp_path / "run.trace")
    expected = pytest.approx(figures(own), rel=1e-6)
    assert figures(audit(tmp_path / "run.trace").sensors) == expected
    assert figures(of_trace(tmp_path)) == expected


def test_another_noise_in_the_trace_is_another_nis(tmp_path: Path) -> None:
    """The broken variant: R of every measurement is halved in the recording."""
    run = filtered("compressed, in parts")
    components = {name: sensor.components for name, sensor in run.sensors.items()}
    with Recorder(tmp_path / "run.trace", components=components) as record:
        for event in run_events(run):
            if isinstance(event, Update):
                event = event._replace(noise=0.5 * event.noise)
            record.event(event)
    own, other = figures(check_innovations(run)), figures(of_trace(tmp_path))
    assert own.keys() == other.keys()
    counts = [name for name in own if name.endswith((" 0", " 1")) and " by " not in name]
    means = [name for name in own if name.endswith(("bearing 2", "measurements 2", "positions 2"))]
    assert len(means) == 3
    assert all(not np.isclose(own[name], other[name], rtol=1e-2) for name in means)
    assert all(np.isclose(own[name], other[name]) for name in counts if "windows" not in name)
