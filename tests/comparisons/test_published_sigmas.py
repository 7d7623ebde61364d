"""Table A.1's sigmas for the logs of the thesis' vehicle, by setting and by preset."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.config import LogSection, RunConfig
from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.readers import read_log
from comparisons.logs.transforms.published_sigmas import FORMATS, with_published_sigmas
from comparisons.pipeline.read import load_log
from tests.helpers import first_seconds, simulated


def has_table_a_1(log: Log) -> bool:
    """Nieto 2005, Table A.1."""
    assert isinstance(log.odometry, SteeringOdometry)
    noise, seen = log.odometry.noise, log.measurements
    wheels = (noise.sigma_speed_mps, np.rad2deg(noise.sigma_turn))
    laser = np.column_stack((seen.sigma_range_m, np.rad2deg(seen.sigma_bearing_rad)))
    return bool(np.allclose(wheels, (0.2, 2.0)) and np.allclose(laser, (0.15, 1.5)))


@pytest.mark.parametrize("name", FORMATS)
def test_a_log_of_the_vehicle_gets_all_of_the_table(name: str) -> None:
    log = replace(first_seconds(simulated(), 5.0), format=name)
    found = with_published_sigmas(log)
    assert has_table_a_1(found)
    assert not has_table_a_1(log)
    assert not has_table_a_1(replace(found, odometry=log.odometry)), "of the measurements alone"
    assert not has_table_a_1(replace(found, measurements=log.measurements)), "of the wheels alone"
    assert np.array_equal(found.measurements.range_m, log.measurements.range_m)
    assert isinstance(found.odometry, SteeringOdometry)
    assert isinstance(log.odometry, SteeringOdometry)
    noise, old = found.odometry.noise, log.odometry.noise
    assert noise.variance_rate_position == old.variance_rate_position
    assert noise.variance_rate_heading == old.variance_rate_heading
    assert found.provenance["sigmas"] == "Nieto 2005, Table A.1"


def test_another_log_keeps_its_own() -> None:
    log = simulated()
    assert with_published_sigmas(log) is log


def test_the_preset_sets_it_and_what_is_given_stays() -> None:
    assert RunConfig().log.sigmas == "calibrated"
    car_park: dict[str, Any] = {"format": "acfr-car-park"}
    assert RunConfig.of(preset="as-published", log=car_park).log.sigmas == "published"
    given = RunConfig.of(preset="as-published", log=car_park | {"sigmas": "calibrated"})
    assert given.log.sigmas == "calibrated"


def test_the_car_park_with_either(shared_data: Path) -> None:
    source = str(shared_data / "acfr_car_park")
    usual = load_log(LogSection(source=source))
    kept = read_log(Path(source))
    assert np.array_equal(usual.measurements.sigma_range_m, kept.measurements.sigma_range_m)
    assert not has_table_a_1(usual)
    assert has_table_a_1(load_log(LogSection(source=source, sigmas="published")))
