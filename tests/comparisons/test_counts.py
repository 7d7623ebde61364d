"""Counts of a report add up: what came in is what was used and what was left out, once each."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.audit.audit import audit
from comparisons.config import CheckConfig, EkfConfig, MapConfig, SmootherConfig, SolveConfig
from comparisons.estimates.external import ExternalEstimate
from comparisons.extensions.dense_maps.job import map_log
from comparisons.extensions.dense_maps.report import MapReport
from comparisons.jobs.check import check
from comparisons.logs.bundled import open_log
from comparisons.pipeline.solve import solve
from comparisons.trace.reader import TraceReader
from ekf_reference.core.landmark_types import POINT
from research.trust.drives import open_case
from tests.comparisons.audit.toy_filter import Toy
from tests.helpers import altered, compared, first_seconds, present, simulated, without_labels


def assert_adds_up(whole: int, parts: Mapping[str, int]) -> None:
    assert min(parts.values()) >= 0
    assert sum(parts.values()) == whole, parts


@pytest.mark.parametrize("association", ["known", "nn", "jcbb"])
def test_measurements_of_a_run(association: str) -> None:
    """Those that were fused, that began a landmark, and that were not used, by reason."""
    log = simulated(3, loop_s=30.0)
    if association != "known":
        log = without_labels(log)
    found = compared(log, ekf=EkfConfig(association=association)).ekf
    used = {
        "initialised": len(found.trace.initialisations[POINT].number),
        "fused": len(found.trace.measurements[POINT].number),
    }
    assert_adds_up(len(log.measurements.time_s), {**used, **found.unused})
    with pytest.raises(AssertionError):
        assert_adds_up(len(log.measurements.time_s) + 1, {**used, **found.unused})


@pytest.mark.slow
def test_positions_of_a_run() -> None:
    """Some lie far off, so that the gate rejects them."""
    log, choices = open_case("positions", seed=4)
    fixes = present(log.positions)
    far = np.arange(len(fixes.time_s)) % 7 == 3
    moved = fixes.position_m + 40.0 * far[:, None]
    log = altered(log, "positions.position_m", moved)
    run = compared(log, ekf=choices)
    result = run.known.findings["ekf"].entries["ekf"]
    assert result.fixes_rejected > 0
    parts = {"fused": result.fixes_fused, "rejected": result.fixes_rejected}
    assert_adds_up(len(fixes.time_s), parts)


def test_measurements_of_the_smoother() -> None:
    """Residuals and unknowns are the degrees of freedom, without what a kernel rejected."""
    log = simulated(3, loop_s=30.0)
    for robust in ("none", "gnc"):
        config = SolveConfig(smoother=SmootherConfig(robust=robust))
        result = solve(log, config).result
        problem, lost = result.problem, result.rejected
        measurements = len(log.measurements.time_s) - len(lost.measurements)
        unknowns = 3 * problem.pose_count + 2 * problem.landmark_count
        residuals = 3 + 3 * (problem.pose_count - 1) + 2 * measurements
        assert result.optimality.chi_square.dof == residuals - unknowns


def test_landmarks_of_a_check() -> None:
    """Each of the estimate is compared, or the log has it not."""
    log = simulated(3, loop_s=20.0)
    solution = solve(log)
    given = ExternalEstimate.of(solution.estimate)
    assert given.landmark_id is not None
    other = given.landmark_id.copy()
    other[:2] += 10_000
    found = check(
        log, altered(given, "landmark_id", other), CheckConfig(), solver=lambda *_: solution
    )
    parts = {"compared": len(found.agreement.landmarks), "unmatched": found.agreement.unmatched}
    assert_adds_up(len(other), parts)
    assert found.agreement.unmatched == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [{}, {"delayed": False}, {"capacity": 200}, {"patience": 2}, {"virtual_landmarks": False}],
    ids=["usual", "at once", "small buffer", "impatient", "no virtual landmarks"],
)
def test_returns_of_a_map(changes: dict[str, object]) -> None:
    """Each is fused, outside, waiting or lost; all of these are printed."""
    log = first_seconds(open_log("occupancy-loop"), 12.0)
    scans = log.scans
    assert scans is not None
    until = int(np.searchsorted(scans.time_s, 12.0))
    names = ("time_s", "range_m", "intensity")
    log = replace(log, scans=replace(scans, **{n: getattr(scans, n)[:until] for n in names}))
    config = MapConfig.of(extensions={"dense_maps": {"layers": ["points"], **changes}})
    report = MapReport.of(map_log(log, config))
    returns = report.result.returns
    assert_adds_up(returns.returns, returns.parts())
    rows = {row.quantity: row.value for row in report.summary().rows if row.group == "Scanner"}
    printed = [int(rows[f"returns {name}"].replace(",", "")) for name in returns.parts()]
    assert sum(printed) == int(rows["returns"].replace(",", ""))
    line = dict(report.summary().lines)["returns"]
    assert line.startswith(f"{returns.returns:,}: {returns.fused:,} fused at once")


def test_events_of_an_audit(tmp_path: Path) -> None:
    Toy(1, 40).record(tmp_path / "a.trace")
    found, trace = audit(tmp_path / "a.trace"), TraceReader(tmp_path / "a.trace")
    kinds: dict[str, int] = {}
    for event in trace:
        kinds[type(event).__name__] = kinds.get(type(event).__name__, 0) + 1
    assert_adds_up(found.events, kinds)
    assert (found.updates, found.snapshots) == (kinds["Update"], kinds["Snapshot"])
