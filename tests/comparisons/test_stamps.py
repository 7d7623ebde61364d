"""Stamps of a stranger's log: to the nanosecond, jittered, since 1970, with fewer decimals."""

from __future__ import annotations

import runpy
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

import slamcheck
from comparisons.arrays import Array
from comparisons.audit.run_trace import write_event
from comparisons.errors import InputError
from comparisons.logs import stamps
from comparisons.logs.log import Log
from comparisons.logs.log_folder import write_log_folder
from comparisons.logs.odometry import RelativePoses, VelocityOdometry
from comparisons.logs.stamps import at_instants, resolved
from comparisons.pipeline.check import ExternalCheck
from comparisons.trace.reader import Trace
from tests.helpers import present, simulated

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_filter" / "my_ekf.py"


def of_speeds_and_yaw_rates(seconds: float = 15.0) -> Log:
    """A short drive as speeds and yaw rates, with labels."""
    log = simulated(loop_s=seconds)
    assert not isinstance(log.odometry, RelativePoses)
    o = log.odometry
    rate = o.speed_mps * 0.05 + 0.1 * np.sin(o.time_s)
    return replace(log, odometry=VelocityOdometry(o.time_s, o.speed_mps, rate, o.noise))


def stamped(log: Log, sampled_s: Array, seen_s: Array, start_s: float) -> Log:
    """The log at other times."""
    return replace(
        log,
        odometry=replace(log.odometry, time_s=sampled_s),
        measurements=replace(log.measurements, time_s=seen_s),
        prior=replace(log.prior, time_s=start_s),
        truth=replace(log.truth, poses=None),
    )


def written(kind: str, seed: int) -> Log:
    """The log with stamps as drivers write them: to the nanosecond."""
    rng, log = np.random.default_rng(seed), of_speeds_and_yaw_rates()
    sampled, scan = log.odometry.time_s, log.measurements.time_s
    instants, which = np.unique(scan, return_inverse=True)
    epoch = {"epoch": 1.7e9, "hours": 20_000.0}.get(kind, 0.0)
    least = 1e-9 if kind == "regular" else 2e-3
    sampled = np.round(sampled + np.sort(rng.uniform(0.0, least, len(sampled))), 9) + epoch
    instants = np.round(instants + np.sort(rng.uniform(0.0, least, len(instants))), 9)
    return stamped(log, sampled, instants[which] + epoch, float(sampled[0]))


def checked(log: Log, folder: Path) -> ExternalCheck:
    """What `check` says of the example filter on a log folder."""
    write_log_folder(log, folder / "log")
    with patch.object(sys, "argv", [str(EXAMPLE), str(folder / "log"), str(folder / "mine")]):
        runpy.run_path(str(EXAMPLE), run_name="__main__")
    return slamcheck.check(slamcheck.load_log(folder / "log"), folder / "mine")


@pytest.mark.parametrize("kind", ["regular", "jittered", "epoch", "hours"])
def test_a_right_filter_is_equal_whatever_the_stamps(kind: str, tmp_path: Path) -> None:
    found = checked(written(kind, seed=1), tmp_path)
    assert (found.outcome, found.grade.value) == ("agree", "equal")
    assert present(found.trace).agreement.model.within(1e-6)


def test_stamps_resolved_to_a_tenth_of_a_millisecond_would_not_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in ("comparisons.adapters.timeline", "comparisons.pipeline.external_trace"):
        monkeypatch.setattr(f"{place}.resolved", lambda time_s: np.round(time_s, 4))
    with pytest.raises(InputError, match="before the prior"):
        checked(written("jittered", seed=1), tmp_path)


@pytest.mark.parametrize("decimals", [6, 9])
def test_an_estimate_with_fewer_decimals_is_of_the_same_instants(
    decimals: int, tmp_path: Path
) -> None:
    log = written("jittered", seed=2)
    checked(log, tmp_path)
    path = tmp_path / "mine" / "trajectory.tum"
    rows = [line.split(" ", 1) for line in path.read_text().splitlines()]
    path.write_text("".join(f"{float(time):.{decimals}f} {rest}\n" for time, rest in rows))
    trace = tmp_path / "mine" / "filter.trace"
    exact = list(Trace(trace))
    trace.unlink()
    with slamcheck.Recorder(trace) as record:
        for event in exact:
            if event.time_s is not None:
                record.at(round(event.time_s, decimals))
            write_event(event, record)
    found = slamcheck.check(slamcheck.load_log(tmp_path / "log"), tmp_path / "mine")
    assert (found.outcome, found.grade.value) == ("agree", "equal")


def test_times_are_an_instants_within_their_last_decimal_only() -> None:
    instants = np.array([0.0, 0.1003, 0.2, 0.20000003])
    assert at_instants(np.array([0.1003, 0.20000003]), instants).tolist() == [0.1003, 0.20000003]
    assert at_instants(np.array([0.1]), instants).tolist() == [0.1003]  # milliseconds, all near
    assert at_instants(np.array([0.1, 0.15]), instants).tolist() == [0.1, 0.15]
    assert at_instants(np.array([0.10031, 0.15]), instants).tolist() == [0.10031, 0.15]
    assert at_instants(np.array([0.3]), np.array([0.0])).tolist() == [0.3]


def test_what_a_float_adds_is_no_time_of_its_own() -> None:
    assert resolved(np.array([0.1 + 0.2])).tolist() == [0.3]
    late = np.array([1_700_000_000.1234567])
    assert resolved(late).tolist() == late.tolist()
    assert stamps.resolved(np.array([1e-9])).tolist() == [1e-9]
