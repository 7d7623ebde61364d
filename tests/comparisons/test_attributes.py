from dataclasses import replace

import numpy as np
import pytest

from comparisons.adapters.attributes import measured_attributes
from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig
from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.report.run import RunReport
from comparisons.settings import run_config
from ekf_reference.association.attributes import RememberedAttributes
from ekf_reference.core.ekf import Ekf
from tests.helpers import compared, first_seconds, simulated, without_labels

ON = EkfConfig(association="nn", attributes="on")


def with_diameters(seed: int = 0, loop_s: float = 20.0) -> tuple[Log, np.ndarray]:
    """A drive without labels, every tree of its own diameter; and the diameters (L,)."""
    log = simulated(seed, loop_s=loop_s)
    seen, rng = log.measurements, np.random.default_rng(seed)
    diameter = rng.uniform(0.2, 0.8, int(seen.landmark.max()) + 1)
    log = replace(log, measurements=replace(seen, diameter_m=diameter[seen.landmark]))
    sigma = np.sqrt(measured_attributes(log).variance[:, 0])
    measured = rng.normal(log.measurements.diameter_m, sigma)
    log = replace(log, measurements=replace(seen, diameter_m=measured))
    return without_labels(log), diameter


def test_landmarks_remember_what_their_measurements_told() -> None:
    log, diameter = with_diameters()
    label = simulated(0, loop_s=20.0).measurements.landmark
    kept: list[Ekf] = []
    run = run_ekf(log, build_timeline(log), ON, setup=FilterSetup(modify=[kept.append]))
    rule = kept[0].association
    assert isinstance(rule, RememberedAttributes)
    memory = rule.memory
    used = run.landmark_index >= 0
    assert memory.count[:, 0].tolist() == np.bincount(run.landmark_index[used]).tolist()
    first = [
        int(label[np.flatnonzero(run.landmark_index == k)[0]]) for k in range(len(memory.count))
    ]
    off = (memory.mean[:, 0] - diameter[first]) / np.sqrt(memory.variance[:, 0])
    assert (np.abs(off) < 4.0).all()
    assert (memory.count[:, 1] == 0).all()


def test_both_estimators_follow_an_association_by_attributes() -> None:
    log, _ = with_diameters(loop_s=10.0)
    comparison = compared(log, ekf=ON)
    result = RunReport.build(comparison)
    assert result.ekf.attributes == "on"
    gaps = result.agreement.algebra_gap_sigma, result.agreement.model_gap_sigma
    assert all(gap is not None and gap < 1e-6 for gap in gaps)
    off = RunReport.build(compared(log, association="nn"))
    assert off.ekf.attributes == "off"


def test_diameters_that_say_nothing_change_nothing_when_off() -> None:
    log, _ = with_diameters(loop_s=10.0)
    bare = replace(log.measurements, diameter_m=np.full(len(log.measurements.time_s), np.nan))
    runs = [
        run_ekf(one, build_timeline(one), EkfConfig(association="nn")).estimate
        for one in (log, replace(log, measurements=bare))
    ]
    assert np.array_equal(runs[0].joint_mean, runs[1].joint_mean)
    assert np.array_equal(runs[0].joint_covariance, runs[1].joint_covariance)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"association": "known", "attributes": "on"}, "'known' takes no attributes"),
        ({"association": "consensus", "attributes": "on"}, "'consensus' takes no attributes"),
        ({"attributes": "on"}, "hold no diameter and no intensity"),
    ],
)
def test_what_cannot_be_had_is_said(options: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        settle(run_config(**options).ekf, simulated(loop_s=5.0))


def test_the_unit_of_an_intensity_is_its_own() -> None:
    """Its sigma is a share of the median, so that the sensor's scale does not matter."""
    log = first_seconds(simulated(loop_s=10.0), 5.0)
    bright = np.random.default_rng(0).uniform(1.0, 4.0, len(log.measurements.time_s))
    bright[0] = np.nan
    reported = [
        measured_attributes(
            replace(log, measurements=replace(log.measurements, intensity=unit * bright))
        )
        for unit in (1.0, 8192.0)
    ]
    share = [(one.value[1:, 1] ** 2) / one.variance[1:, 1] for one in reported]
    assert np.allclose(share[0], share[1], rtol=1e-12)
    assert np.isnan(reported[0].value[0, 1])
    assert np.isfinite(reported[0].variance).all()
