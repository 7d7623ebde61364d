from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from comparisons.adapters.timeline import build_timeline
from comparisons.errors import InputError
from comparisons.logs.log import LandmarkMeasurements, Landmarks, Log, Positions, Prior
from comparisons.logs.odometry import Ackermann, OdometryNoise, RelativePoses, SteeringOdometry
from comparisons.logs.scans import Scans
from tests.helpers import simulated

EYE = np.eye(2)


def measurements(**changes: object) -> LandmarkMeasurements:
    base: dict[str, object] = {
        "time_s": np.array((1.0, 1.0, 2.0)),
        "range_m": np.array((3.0, 4.0, 5.0)),
        "bearing_rad": np.zeros(3),
        "sigma_range_m": np.full(3, 0.1),
        "sigma_bearing_rad": np.full(3, 0.1),
        "landmark": np.array((0, 1, -1)),
        "diameter_m": np.full(3, np.nan),
    }
    return LandmarkMeasurements(**{**base, **changes})  # type: ignore[arg-type]


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"range_m": (3.0, NAN, 5.0)}, "row 1: range_m is nan, expected a finite number"),
        ({"diameter_m": (1.0, INF, NAN)}, "row 1: diameter_m is inf"),
        ({"intensity": (1.0, NAN, INF)}, "row 2: intensity is inf"),
        ({"time_s": (1.0, 2.0, 1.5)}, "row 2: time 1.500000 s follows 2.000000 s"),
        ({"range_m": (0.0, 0.0, 0.0)}, "row 0: range_m is 0.0, expected above"),
        ({"bearing_rad": (0.0, 45.0, 0.0)}, "row 1: bearing_rad is 45.0, expected between"),
        ({"landmark": (0, -7, 1)}, "row 1: landmark is -7"),
        ({"range_m": (3.0, 1e300, 5.0)}, "row 1: range_m is 1e.300"),
        ({"sigma_range_m": (1e-200,) * 3}, "row 0: sigma_range_m is 1e-200, expected between"),
        ({"landmark": (0.0, 1.5, 2.0)}, "row 1: landmark is 1.5, expected a whole number"),
        ({"landmark": (0, 2**60, 1)}, "row 1: landmark is 11"),
    ],
)
def test_faults_of_measurements_name_row_value_and_expectation(
    changes: dict[str, tuple[float, ...]], message: str
) -> None:
    with pytest.raises(InputError, match=f"measurements, {message}"):
        measurements(**{name: np.array(values) for name, values in changes.items()})


FAULTS: dict[str, tuple[Callable[[], object], str]] = {
    "length": (lambda: measurements(range_m=np.ones(2)), r"range_m has shape \(2,\), expected"),
    "negative landmark covariance": (
        lambda: Landmarks(np.array([4]), np.zeros((1, 2)), -EYE[None]),
        "landmarks, row 0: covariance is not positive definite",
    ),
    "turning about the encoder's wheel": (
        lambda: SteeringOdometry(
            np.zeros(1), np.ones(1), np.array([1.4]), Ackermann(1.0, 0.5), OdometryNoise(0.1, 0.1)
        ),
        "steering odometry, row 0: steering_rad is 1.4, expected a smaller",
    ),
    "antenna": (
        lambda: Positions(np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2, 2)), (0.0, INF)),
        "antenna_m is",
    ),
    "label gate": (lambda: measurements(label_gate=NAN), "label_gate is nan"),
    "indefinite prior": (
        lambda: Prior(0.0, np.zeros(3), np.diag((1.0, 1.0, -1.0))),
        "prior, row 0: covariance is not positive definite",
    ),
    "prior shape": (lambda: Prior(0.0, np.zeros(2), np.eye(3)), r"prior: pose must hold \(3,\)"),
    "prior time": (lambda: Prior(INF, np.zeros(3), np.eye(3)), "prior: time_s"),
    "indefinite increment": (
        lambda: RelativePoses(
            np.array((1.0, 2.0)), np.zeros((2, 3)), np.array((np.eye(3), np.zeros((3, 3))))
        ),
        "relative poses, row 1: covariance is not positive definite",
    ),
    "skew position covariance": (
        lambda: Positions(np.zeros(1), np.zeros((1, 2)), np.array([[[1.0, 0.5], [0.0, 1.0]]])),
        "positions, row 0: covariance",
    ),
    "repeated landmark": (
        lambda: Landmarks(np.array((4, 4)), np.zeros((2, 2)), np.array((EYE, EYE))),
        "landmarks, row 1: id 4 appears twice",
    ),
    "wheelbase": (lambda: Ackermann(0.0), "wheelbase_m is 0.0, expected at least 0.01"),
    "vehicle nan": (
        lambda: Ackermann(1.0, NAN),
        "encoder_offset_m is nan, expected at most 1000 m",
    ),
    "stabilisation": (
        lambda: OdometryNoise(0.1, 0.1, -1e-9),
        "variance_rate_position is -1e-09, expected between 0 and",
    ),
    "scan shape": (
        lambda: Scans(
            time_s=np.zeros(1),
            angle_rad=np.zeros(3),
            range_m=np.zeros((1, 2)),
            intensity=np.zeros((1, 2)),
        ),
        "scans: range_m has shape",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_name_stream_row_value_and_expectation(name: str) -> None:
    make, message = FAULTS[name]
    with pytest.raises(InputError, match=message):
        make()


def test_names_cannot_command_a_terminal() -> None:
    log = replace(simulated(loop_s=5.0), name="a\x1b]0;b\n", provenance={"k": "v\udcff"})
    assert log.name == "a?]0;b?"
    assert log.provenance == {"k": "v?"}


def test_records_are_frozen_copies() -> None:
    source = np.array((3.0, 4.0, 5.0))
    record = measurements(range_m=source)
    source[0] = 99.0
    assert record.range_m[0] == 3.0
    with pytest.raises(ValueError, match="read-only"):
        record.range_m[0] = 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda log: {"measurements": measurements(time_s=np.full(3, -1.0))}, "before the prior's"),
        (
            lambda log: {"known_measurements": measurements(landmark=np.array((1, 2, 99)))},
            "known measurements, row 0: landmark 1 is not a known landmark",
        ),
        (
            lambda log: {"measurements": measurements(**{k: np.zeros(0) for k in (
                "time_s", "range_m", "bearing_rad", "sigma_range_m", "sigma_bearing_rad",
                "landmark", "diameter_m")})},
            "no measurements",
        ),
    ],
)  # fmt: skip
def test_streams_are_checked_against_each_other(
    change: Callable[[Log], dict[str, LandmarkMeasurements]], message: str
) -> None:
    log = simulated(loop_s=5.0)
    with pytest.raises(InputError, match=message):
        replace(log, **change(log))  # type: ignore[arg-type]


def test_timeline_cuts_samples_where_measurements_fall() -> None:
    """Durations add up, and every piece carries the control that held then."""
    log = simulated(loop_s=10.0)
    shifted = replace(
        log, measurements=replace(log.measurements, time_s=log.measurements.time_s - 0.011)
    )
    timeline = build_timeline(shifted)
    assert np.isclose(timeline.step_duration_s.sum(), shifted.duration_s)
    begin = np.cumsum(np.concatenate(([0.0], timeline.step_duration_s[:-1])))
    sample = np.searchsorted(log.odometry.time_s, begin + 1e-9, side="right") - 1
    assert np.array_equal(timeline.control[:, 0], log.odometry.speed_mps[sample])  # type: ignore[union-attr]
    epoch_of = timeline.epoch_time_s[timeline.measurement_epoch]
    assert np.array_equal(epoch_of, np.round(shifted.measurements.time_s, 4))
    ends = np.cumsum(timeline.step_duration_s)[timeline.steps_until()[1:] - 1]
    assert np.allclose(ends, timeline.epoch_time_s[1:], rtol=0, atol=1e-9)


def test_a_blind_drive_keeps_its_corners() -> None:
    """Without measurements there is still an epoch every half second, at odometry samples."""
    log = simulated(loop_s=20.0)
    seen = log.measurements
    early = seen.time_s < 5.0
    names = ("time_s", "range_m", "bearing_rad", "sigma_range_m", "sigma_bearing_rad", "landmark")
    columns = {name: getattr(seen, name)[early] for name in (*names, "diameter_m")}
    blind = build_timeline(replace(log, measurements=LandmarkMeasurements(**columns)))
    assert np.max(np.diff(blind.epoch_time_s)) < 1.0
    assert np.isin(blind.epoch_time_s[:-1], np.round(log.odometry.time_s, 4)).all()
    assert len(blind.epoch_time_s) < 80
    assert len(build_timeline(log).epoch_time_s) == 1 + len(np.unique(seen.time_s))


def test_the_vehicle_stands_still_before_the_first_sample() -> None:
    log = simulated(loop_s=10.0)
    late = replace(log, prior=replace(log.prior, time_s=-1.0))
    timeline = build_timeline(late)
    assert timeline.control[0].tolist() == [0.0, 0.0]
    assert np.isclose(timeline.step_duration_s[0], 1.0)


def test_of_two_samples_at_one_instant_the_later_holds() -> None:
    log = simulated(loop_s=10.0)
    odometry = log.odometry
    time = odometry.time_s.copy()
    time[5] = time[4]
    doubled = build_timeline(replace(log, odometry=replace(odometry, time_s=time)))
    assert np.array_equal(doubled.control[4], build_timeline(log).control[5])
    assert np.all(doubled.step_duration_s > 0)


@pytest.mark.slow
def test_measurements_between_relative_poses_are_refused(victoria_park: object) -> None:
    from comparisons.jobs.run import Comparison

    assert isinstance(victoria_park, Comparison)
    log = victoria_park.log
    time = log.measurements.time_s.copy()
    time[3] += 0.5
    with pytest.raises(InputError, match=r"measurements, row 3: time .* is no pose's"):
        build_timeline(replace(log, measurements=replace(log.measurements, time_s=np.sort(time))))
