"""Planted defects: every one is caught, and named; a sound filter is not."""

import re
from dataclasses import replace

import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.faults.catalogue import NAMED
from comparisons.faults.fault import Fault, Method, Plant, observing, stepping
from comparisons.faults.models import h_times
from comparisons.jobs.run import Modified
from comparisons.rounding import ROUNDING
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import PredictedMeasurements
from ekf_reference.core.state import KalmanState
from ekf_reference.models.position import PositionModel
from research.trust.defects import CAUSES, named_first, run_defect, shows
from research.trust.drives import LOGS, open_case
from tests.helpers import Array, assert_followed, compared, simulated

SEEDS = 12


def test_the_catalogue_is_broad_and_without_copies() -> None:
    names = [fault.name for fault in NAMED]
    assert sorted(set(names)) == sorted(names) == sorted(CAUSES)
    assert {shows(fault) for fault in NAMED} == set(LOGS)
    assert {*ALGEBRA, *MODEL} < set(names)


ALGEBRA = (
    "cross-covariance dropped at augmentation",
    "cross-covariance dropped at prediction",
    "gain not transposed",
)
MODEL = {
    "bearing Jacobian as printed": r"the Jacobian with respect to position differs.*updates",
    "innovation not wrapped": r"the innovation differs.*measurement updates",
    "sigma squared twice": r"the noise covariance differs.*measurement updates",
    "steering sign": r"the predicted pose differs.*predictions",
    "no heading column": r"the Jacobian with respect to heading is missing.*measurement updates",
}
"""Defects that leave the other gap at rounding, and what differs first in the model."""


@pytest.mark.slow
@pytest.mark.parametrize("defect", NAMED, ids=lambda defect: defect.name)
def test_a_defect_is_caught_and_named_first(defect: Fault) -> None:
    found = run_defect(defect)
    verdict, gaps = found.verdict, found.agreement
    assert verdict.outcome == "disagree"
    assert named_first(defect, verdict), f"{verdict.causes[0]}"
    if defect.name in (*ALGEBRA, *MODEL):
        gap = CAUSES[defect.name][0]
        assert gap == ("algebra" if defect.name in ALGEBRA else "model")
        red, green = (gaps.algebra, gaps.model) if gap == "algebra" else (gaps.model, gaps.algebra)
        assert max(red.sigma, red.covariance) > 1e3 * ROUNDING
        assert green.within(ROUNDING)
        assert [cause.gap for cause in verdict.causes] == [gap]
    if defect.name in MODEL:
        first = verdict.causes[0].evidence.split("; ")[1]
        assert re.fullmatch(MODEL[defect.name], first)


@pytest.mark.slow
@pytest.mark.parametrize("name", LOGS)
def test_a_sound_filter_passes_the_logs_that_show_defects(name: str) -> None:
    log, ekf = open_case(name, seed=4)
    found = compared(log, ekf=ekf)
    assert found.verdict.outcome == "agree", f"{found.verdict.causes}"
    assert not found.verdict.causes
    assert_followed(found, 1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(SEEDS))
def test_a_sound_filter_is_not_flagged(seed: int) -> None:
    verdict = compared(simulated(seed=seed, loop_s=30.0, noise_scale=0.3)).verdict
    assert verdict.outcome == "agree", f"{verdict.causes}"


def twice(own: Method, *args: object) -> object:
    own(*args)
    return own(*args)


@pytest.mark.parametrize(
    ("method", "reported"),
    [
        ("predict", "4800 predictions, expected 2400"),
        ("fix_position", "120 positions, expected 60"),
    ],
)
def test_a_filter_that_miscounts_its_data_is_refused(method: str, reported: str) -> None:
    log, ekf = open_case("positions", seed=4)
    with pytest.raises(InputError, match=reported):
        compared(log, Modified(stepping(**{method: twice})), ekf=ekf)


def start_elsewhere(ekf: Ekf) -> None:
    ekf.state = KalmanState(ekf.state.pose + (0.0, 0.0, 0.1), np.array(ekf.state.covariance))


def other_lever(ekf: Ekf) -> None:
    ekf.fixes = replace(ekf.fixes, model=PositionModel((-0.6, 0.3)))


def curved(own: Method, *args: Array) -> PredictedMeasurements:
    """A mistake that the explanations do not know."""
    found: PredictedMeasurements = own(*args)
    found.jacobian_landmark[:, 0] *= np.exp(0.01 * found.z[:, :1])
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "reported"),
    [
        (start_elsewhere, "; the prior: the estimate of pose is off by .*; check the prior$"),
        (other_lever, r"antenna is \(-0.600, 0.300\) m, in the log \(0.600, -0.300\) m"),
        (
            h_times(1.1, landmark=np.s_[:, 0]),
            "the landmark part of the range row of H is 1.1 times .* 1312 of",
        ),
        (observing(predict=curved), "the range row of H is wrong, the other row is right"),
    ],
)
def test_what_is_not_in_the_catalogue_is_told_as_far_as_it_goes(
    plant: Plant, reported: str
) -> None:
    log, ekf = open_case("positions", seed=4)
    verdict = compared(log, Modified(plant), ekf=ekf).verdict
    assert verdict.outcome == "disagree"
    cause = verdict.causes[0]
    assert re.search(reported, f"{cause.evidence}; {cause.hint}")


def test_a_log_that_is_unknown_is_refused() -> None:
    with pytest.raises(ValueError, match="expected one of loop"):
        open_case("night", seed=0)
