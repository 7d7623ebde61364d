"""A foreign filter's faults are named with their figures, and single precision by its name."""

import numpy as np
import pytest

from comparisons.checks.algebra import HINT
from comparisons.checks.diagnosis.motion_hypotheses import motion_hints
from comparisons.explain.hypotheses import Quantity, instead, named, scaled
from comparisons.faults.fault import Method, moving
from comparisons.jobs.external_trace import TraceCheck
from comparisons.jobs.run import Modified
from comparisons.rounding import SINGLE, restored, stored_rounding
from ekf_reference.models.motion import MotionStep
from research.trust.hints import IN_SINGLE, HintCase, checked, hint_parts, simulated
from research.trust.stranger_faults import FORGETFUL, HINTS, StrangerFault
from research.trust.strangers import Single
from tests.helpers import Array, compared
from tests.helpers import simulated as driven


@pytest.fixture(scope="module")
def ready() -> HintCase:
    return simulated(loop_s=30.0)


def said(check: TraceCheck) -> list[str]:
    return [
        cause.hint for cause in check.verdict.causes if cause.gap in ("data", "algebra", "model")
    ]


@pytest.mark.slow
@pytest.mark.parametrize("fault", HINTS[::9], ids=lambda fault: fault.name)
def test_a_fault_is_named(fault: StrangerFault, ready: HintCase) -> None:
    parts = hint_parts(checked(fault.plant(ready.sound), ready))
    assert fault.judge(parts) == "right", parts


def test_a_sound_filter_is_told_nothing(ready: HintCase) -> None:
    assert said(checked(ready.sound, ready)) == []


def test_storing_in_single_precision_is_no_fault(ready: HintCase) -> None:
    check = checked(ready.sound, ready, stored_single=True)
    assert check.agreement.algebra.sigma > 1e-6
    assert said(check) == []


@pytest.mark.slow
def test_computing_in_single_precision_is_named() -> None:
    """Of a drive long enough to tell it from storing."""
    long = simulated(loop_s=85.0)
    single = type("InSingle", (Single, long.sound), {})
    parts = said(checked(single, long))
    assert parts
    assert all(IN_SINGLE in part for part in parts)


def test_a_dropped_covariance_is_no_matter_of_precision(ready: HintCase) -> None:
    check = checked(FORGETFUL(ready.sound), ready, stored_single=True)
    assert said(check) == [HINT]


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


def test_the_noise_of_another_speed_is_no_second_fault() -> None:
    """Of a car, whose speed and interval act alike but for their share of Q."""
    log = driven(loop_s=5.0)

    def faster(own: Method, pose: Array, control: Array, duration_s: float) -> MotionStep:
        found: MotionStep = own(pose, control * (1.1, 1.0), duration_s)
        return found

    run = compared(log, Modified(moving(faster))).ekf
    (hint,) = motion_hints(log, run, 0.0)
    assert hint.startswith("the speed is 1.1 times the log's, or every prediction lasts")


def quantity(have: Array, meant: Array) -> Quantity:
    return Quantity(have=have, meant=meant, tolerance=1e-9, records="records")


def test_a_hypothesis_must_leave_nothing_over() -> None:
    meant = np.linspace(1.0, 2.0, 20)
    factor = scaled("it", meant)
    assert named(quantity(1.5 * meant, meant), [factor]) == [
        "it is 1.5 times the correct value, in 20 of 20 records"
    ]
    off = 1.5 * meant
    off[7] += 1e-6
    assert not named(quantity(off, meant), [factor])
    assert not named(quantity(meant, meant), [factor, instead("never", meant)])


def test_too_few_records_are_no_evidence_for_a_figure() -> None:
    meant = np.linspace(1.0, 2.0, 20)
    off = meant.copy()
    off[:2] *= 1.5
    assert not named(quantity(off, meant), [scaled("it", meant)])
