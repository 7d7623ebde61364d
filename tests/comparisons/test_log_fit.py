"""Logs of a sensor that is scaled, offset or late: the number that would make them fit is named."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.log_doctor import drive
from comparisons.checks.diagnosis.log_doctor import examine
from comparisons.checks.diagnosis.log_fit import explains, log_fits
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.logs.transforms.calibration import delayed, driven, sensed
from graphslam.optimum import ChiSquareTest
from tests.helpers import compared, present


@pytest.fixture(scope="module")
def log() -> Log:
    """Nothing is seen at its ends, so that measurements may come a little earlier or later."""
    drive = simulate(np.random.default_rng(3), Drive(noise_scale=0.1, loop_s=30.0))
    seen, last_s = drive.measurements, float(drive.odometry.time_s[-1])
    middle = (seen.time_s > 1.0) & (seen.time_s < last_s - 1.0)
    return replace(drive, measurements=seen.chosen(middle))


def fits_of(found: Comparison) -> list[str]:
    return [one.what for one in log_fits(found.log, found.ekf, found.smoother)]


WRONG: dict[str, tuple[Callable[[Log], Log], str, float]] = {
    "speed": (lambda log: driven(log, (0.8, 0.0)), "speeds", 1.25),
    "turn": (lambda log: driven(log, turn=(0.8, 0.0)), "steering angles .* times", 1.25),
    "turn's offset": (lambda log: driven(log, turn=(1.0, 0.05)), "on the steering angles", -0.05),
    "opposite turn": (lambda log: driven(log, turn=(-1.0, 0.0)), "steering angles", -1.0),
    "range": (lambda log: sensed(log, (1.0, 1.0)), "m on the ranges", -1.0),
    "bearing": (lambda log: sensed(log, bearing=(1.0, 0.2)), "rad on the bearings", -0.2),
    "clock": (lambda log: delayed(log, 0.9), "s later than the log says", -0.9),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_the_number_is_named_first_thing(log: Log, name: str) -> None:
    change, words, number = WRONG[name]
    found = compared(change(log))
    assert found.verdict.outcome != "agree"
    first = found.verdict.causes[0]
    assert first.gap == "log"
    named = re.split(r"(?:, or )?to \d+ with ", first.evidence)[1:]
    said = next(one for one in named if re.search(words, one))
    fitted = present(re.search(r"[-+]?\d+\.?\d*(e-\d+)?", said))
    assert float(fitted[0]) == pytest.approx(number, rel=0.15)


@pytest.mark.slow
def test_noise_that_is_larger_than_stated_is_no_number(log: Log) -> None:
    rng, seen = np.random.default_rng(0), log.measurements
    more = 3.0 * seen.sigma_bearing_rad * rng.standard_normal(len(seen.time_s))
    found = compared(replace(log, measurements=replace(seen, bearing_rad=seen.bearing_rad + more)))
    assert not found.smoother.optimality.verified
    assert not fits_of(found)
    assert any(one.gap == "noise" for one in found.verdict.causes)


@pytest.mark.parametrize(
    ("chi2", "said"), [(410.0, True), (330.0, True), (300.0, False), (600.0, False)]
)
def test_a_number_explains_what_is_too_high_and_no_more(chi2: float, said: bool) -> None:
    """A scale that shrinks all residuals leaves less than noise does."""
    assert explains(ChiSquareTest(812.0, 400, 318.0, 493.0), chi2, 8) is said


def test_a_clock_far_off_is_reached() -> None:
    """1.5 s; broken: Newton's method from zero."""
    found = examine(delayed(drive(12, "velocity"), 1.5))
    first = found.findings[0]
    fitted = present(re.fullmatch(r"measurements (\S+) s later than the log says", first.what))
    assert float(fitted[1]) == pytest.approx(-1.5, abs=0.05)
    mended = examine(first.change(delayed(drive(12, "velocity"), 1.5)))
    assert mended.test.reading == "plausible"


@pytest.mark.slow
def test_a_sound_log_has_none(log: Log) -> None:
    found = compared(log)
    assert found.verdict.outcome == "agree"
    assert not fits_of(found)
