"""Logs without stabilisation noise: used where the motion has full rank, else refused."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters import motion
from comparisons.adapters.motion import check_regular
from comparisons.adapters.time_window import cut_log
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig, Filter, SolveConfig
from comparisons.errors import InputError
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from comparisons.logs.odometry import RelativePoses, SteeringOdometry, VelocityOdometry
from comparisons.logs.readers import read_log
from comparisons.pipeline.solve import solve
from tests.comparisons.test_external_trace import checked, filtered, hand_in
from tests.golden.cases import SHARED
from tests.helpers import assert_followed, compared, first_seconds, present, simulated


def with_rates(log: Log, position: float = 0.0, heading: float = 0.0) -> Log:
    assert not isinstance(log.odometry, RelativePoses)
    noise = replace(
        log.odometry.noise, variance_rate_position=position, variance_rate_heading=heading
    )
    return replace(log, odometry=replace(log.odometry, noise=noise))


def standing(log: Log, begin_s: float, end_s: float) -> Log:
    """The same with a stop, as its wheels would tell it; measurements there are left out."""
    odometry = log.odometry
    assert isinstance(odometry, SteeringOdometry)
    still = (odometry.time_s >= begin_s) & (odometry.time_s < end_s)
    speed, steering = (np.where(still, 0.0, c) for c in (odometry.speed_mps, odometry.steering_rad))
    return replace(log, odometry=replace(odometry, speed_mps=speed, steering_rad=steering))


def with_velocities(log: Log) -> Log:
    """The same drive by speed and yaw rate; measurements from the rear axle are not needed here."""
    odometry = log.odometry
    assert isinstance(odometry, SteeringOdometry)
    turn = odometry.speed_mps * np.tan(odometry.steering_rad) / odometry.vehicle.wheelbase_m
    noise = replace(odometry.noise, sigma_turn=0.05)
    return replace(log, odometry=VelocityOdometry(odometry.time_s, odometry.speed_mps, turn, noise))


def refusal(log: Log) -> str:
    with pytest.raises(InputError) as caught:
        check_regular(log, build_timeline(log))
    return str(caught.value)


def advised(log: Log) -> Log:
    """The log with the noise that its refusal asks for."""
    said = dict(re.findall(r"variance_rate_(\w+) = (\S+)", refusal(log)))
    return with_rates(log, **{name: float(value) for name, value in said.items()})


@pytest.mark.parametrize("kind", ["full", "compressed", "misono-full"])
def test_every_filter_equals_the_frozen_smoothers_without_it(kind: Filter) -> None:
    c = compared(with_rates(simulated(seed=1, loop_s=25.0)), filter=kind)
    assert c.verdict.outcome == "agree", c.verdict.causes
    assert_followed(c, 1e-9)


def test_the_published_misono_has_right_algebra_without_it() -> None:
    """Its covariance is a sum for each of four entries; the model gap is its own."""
    c = compared(with_rates(simulated(seed=1, loop_s=25.0)), filter="misono")
    assert c.agreement.algebra.within(1e-6)


@pytest.mark.parametrize("rates", [{"heading": 1e-9}, {"position": 1e-7}])
def test_either_alone_will_do(rates: dict[str, float]) -> None:
    c = compared(with_rates(simulated(seed=1, loop_s=15.0), **rates))
    assert c.verdict.outcome == "agree"
    assert c.agreement.algebra.within(1e-9)


def test_solve_and_a_trace_without_it(tmp_path: Path) -> None:
    log = with_rates(simulated(seed=1, loop_s=25.0))
    assert solve(log, SolveConfig()).result.optimality.verified
    hand_in(filtered(log, EkfConfig()), tmp_path)
    found = checked(tmp_path, log, EkfConfig())
    assert found.outcome == "agree", found.causes
    assert found.trace is not None
    assert present(found.trace.algebra).within(1e-9)
    assert found.trace.agreement.model.within(1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["scan", "both"])
def test_motion_from_scans_without_it(motion: str) -> None:
    c = compared(with_rates(first_seconds(open_log("scan-loop-fine"), 20.3)), motion=motion)
    assert c.verdict.outcome == "agree", c.verdict.causes
    assert c.agreement.algebra.within(1e-6)


def test_the_log_keeps_its_zeros_on_disk(tmp_path: Path) -> None:
    log = with_rates(simulated(seed=1, loop_s=5.0))
    write_log_folder(log, tmp_path / "log")
    again = read_log_folder(tmp_path / "log").odometry
    assert not isinstance(again, RelativePoses)
    assert again.noise.variance_rate_position == again.noise.variance_rate_heading == 0.0


@pytest.mark.slow
def test_a_stop_is_refused_and_the_advice_makes_it_regular() -> None:
    log = with_rates(standing(simulated(seed=1, loop_s=12.0), 4.0, 6.0))
    said = refusal(log)
    assert "the motion from 4.0000 to 4.2000 s is singular, one of 10 among 60" in said
    assert "variance_rate_position" in said
    assert "variance_rate_heading" in said
    assert "\n" not in said
    with pytest.raises(InputError, match="is singular"):
        compared(log)
    with pytest.raises(InputError, match="is singular"):
        solve(log, SolveConfig())
    mended = compared(advised(log))
    assert_followed(mended, 1e-6)


def test_one_sample_between_poses_is_singular_and_several_of_a_curve_are_not() -> None:
    """Speed and yaw rate are two numbers for three. Far less than the advice is too little."""
    log = with_rates(with_velocities(simulated(seed=1, loop_s=5.0, scan_every=1)))
    assert "such as variance_rate_position = 1e-10 (m^2/s)" in refusal(log)
    assert "is singular" in refusal(with_rates(log, 1e-15))
    check_regular(advised(log), build_timeline(log))
    several = with_rates(with_velocities(simulated(seed=1, loop_s=5.0)))
    check_regular(several, build_timeline(several))


def test_a_check_that_is_too_easy_lets_a_singular_motion_through(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What elimination then says is no help to a user."""
    monkeypatch.setattr(motion, "LEAST_EIGENVALUE", -1.0)
    log = with_rates(standing(simulated(seed=1, loop_s=12.0), 4.0, 6.0))
    with pytest.raises((np.linalg.LinAlgError, RuntimeError, RuntimeWarning)):
        compared(log)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the real logs (../shared/data) are not here")
def test_the_car_park() -> None:
    """As recorded it stands at times; where it drives no noise is needed."""
    log = first_seconds(read_log(SHARED / "acfr_car_park"), 36.0)
    assert "variance_rate_position = 1e-10" in refusal(with_rates(log))
    c = compared(advised(with_rates(log)))
    assert c.verdict.outcome == "agree"
    assert c.agreement.algebra.within(1e-6)


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="the real logs (../shared/data) are not here")
@pytest.mark.parametrize(
    ("folder", "begin_s", "end_s"),
    [("acfr_car_park", 57.2, 120.9), ("victoria_park", 149.4, 190.0)],
)
def test_real_logs_where_the_vehicle_drives(folder: str, begin_s: float, end_s: float) -> None:
    whole = replace(read_log(SHARED / folder), positions=None, scans=None)
    log = cut_log(whole, begin_s, end_s)
    c = compared(with_rates(log))
    assert_followed(c, 1e-6)
    assert c.smoother.optimality.verified
