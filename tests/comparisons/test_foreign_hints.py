"""A foreign filter's faults are named with their figures, and single precision by its name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fault_logs import open_case
from benchmarks.foreign_faults import FAULTS, Fault
from benchmarks.foreign_filter import Foreign, in_single
from comparisons.adapters.ekf_run import run_ekf
from comparisons.checks.causes import ALGEBRA_HINT, FITTED
from comparisons.checks.diagnosis.hypotheses import Quantity, instead, named, scaled
from comparisons.config import CheckConfig, SolveConfig
from comparisons.estimates.external import read_external
from comparisons.estimates.stored_precision import SINGLE, restored, stored_rounding
from comparisons.pipeline.external_trace import TraceCheck, check_trace
from comparisons.pipeline.prepare import Prepared, prepare
from graphslam.smoother import SmootherOptions
from tests.helpers import Array

Ready = tuple[Prepared[SolveConfig], Foreign]


def prepared(loop_s: float) -> Ready:
    log, choices = open_case("positions", seed=4, loop_s=loop_s)
    p: Prepared[SolveConfig] = prepare(log, CheckConfig(gps=choices.gps), choices)
    landmark_index = run_ekf(p.log, p.timeline, p.ekf, p.positions).landmark_index
    return p, Foreign(
        log=p.log, timeline=p.timeline, landmark_index=landmark_index, positions=p.positions
    )


@pytest.fixture(scope="module")
def ready() -> Ready:
    return prepared(30.0)


def checked(one: Foreign, ready: Ready, folder: Path, *, stored: bool = False) -> TraceCheck:
    one.run(folder)
    if stored:
        in_single(folder)
    return check_trace(read_external(folder), ready[0], SmootherOptions())


def said(check: TraceCheck) -> list[str]:
    hints = [c.hint for c in check.verdict.causes if c.gap in ("algebra", "model")]
    return [part for hint in hints for part in hint.removeprefix(FITTED).split("; ")]


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS[::9], ids=lambda fault: fault.name)
def test_a_fault_is_named(fault: Fault, ready: Ready, tmp_path: Path) -> None:
    parts = said(checked(fault.plant(ready[1]), ready, tmp_path))
    assert fault.judge(parts) == "right", parts


def test_a_sound_filter_is_told_nothing(ready: Ready, tmp_path: Path) -> None:
    assert said(checked(ready[1], ready, tmp_path)) == []


def test_storing_in_single_precision_is_no_fault(ready: Ready, tmp_path: Path) -> None:
    check = checked(ready[1], ready, tmp_path, stored=True)
    assert check.agreement.algebra.sigma > 1e-6
    assert said(check) == []


@pytest.mark.slow
def test_computing_in_single_precision_is_named(tmp_path: Path) -> None:
    """Of a drive long enough to tell it from storing."""
    long = prepared(85.0)
    single = replace(long[1], dtype=np.float32)
    parts = said(checked(single, long, tmp_path))
    assert parts
    assert all("in single precision" in p for p in parts)


def test_a_dropped_covariance_is_no_matter_of_precision(ready: Ready, tmp_path: Path) -> None:
    def forget(one: Foreign, p: Array, before: int) -> Array:
        p[:3, 3:] *= 0.99
        p[3:, :3] *= 0.99
        return p

    check = checked(replace(ready[1], keep=forget), ready, tmp_path, stored=True)
    (part,) = said(check)
    assert part == ALGEBRA_HINT


def test_precision_is_recognised_by_every_number() -> None:
    values = np.random.default_rng(0).normal(size=50)
    single = values.astype(np.float32).astype(np.float64)
    assert stored_rounding(single) == SINGLE
    assert stored_rounding(values) == 0.0
    assert stored_rounding(np.append(single, 0.1)) == 0.0
    assert stored_rounding(np.eye(3)) == 0.0


def test_restored_numbers_would_be_stored_alike() -> None:
    values = np.random.default_rng(0).normal(size=50).astype(np.float32).astype(np.float64)
    (moved,) = restored([np.append(values, (0.0, 1.0))], np.random.default_rng(1))
    assert (moved[:-2] != values).all()
    assert (moved[:-2].astype(np.float32) == values).all()
    assert moved[-2:].tolist() == [0.0, 1.0]


def quantity(have: Array, meant: Array) -> Quantity:
    return Quantity(have=have, meant=meant, tolerance=np.asarray(1e-9), records="records")


def test_a_hypothesis_must_leave_nothing_over() -> None:
    meant = np.linspace(1.0, 2.0, 20)
    factor = scaled("it", meant)
    assert named(quantity(1.5 * meant, meant), [factor]) == (
        "it is 1.5 times the correct value, in 20 of 20 records"
    )
    off = 1.5 * meant
    off[7] += 1e-6
    assert named(quantity(off, meant), [factor]) is None
    assert named(quantity(meant, meant), [factor, instead("never", meant)]) is None


def test_too_few_records_are_no_evidence_for_a_figure() -> None:
    meant = np.linspace(1.0, 2.0, 20)
    off = meant.copy()
    off[:2] *= 1.5
    assert named(quantity(off, meant), [scaled("it", meant)]) is None
