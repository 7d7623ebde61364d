"""Stamps of a stranger's log: to the nanosecond, jittered, since 1970, with fewer decimals."""

import runpy
import sys
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

import slamcheck
from comparisons.arrays import Array
from comparisons.audit.own_filter import write_run
from comparisons.config import CheckConfig
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate, with_poses
from comparisons.estimates.folder import write_estimate
from comparisons.estimates.planar_trace import TRACE
from comparisons.fingerprints.clock import works_with_floats, written_from_floats
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.grading import Grader
from comparisons.jobs.readings import FAULT, MOTION, READINGS, stated
from comparisons.logs import stamps
from comparisons.logs.log import LandmarkMeasurements, Log, LoopClosures, Prior
from comparisons.logs.log_folder import write_log_folder
from comparisons.logs.odometry import RelativePoses, VelocityOdometry
from comparisons.logs.stamps import at_instants, resolved
from comparisons.logs.transforms.clock import timed_by_floats
from comparisons.pipeline.solve import prepare_solve
from comparisons.trace.reader import TraceReader
from research.trust.stranger_faults import HINTS
from research.trust.strangers import TextbookEkf, read_log
from tests.comparisons.newcomers import Course, Euler, simulate
from tests.helpers import compared, present, simulated

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


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["regular", "jittered", "epoch", "hours"])
def test_a_right_filter_is_equal_whatever_the_stamps(kind: str, tmp_path: Path) -> None:
    found = checked(written(kind, seed=1), tmp_path)
    assert (found.outcome, found.grade.value) == ("agree", "equal")
    assert present(found.trace).agreement.model.within(1e-6)


def test_stamps_resolved_to_a_tenth_of_a_millisecond_would_not_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in ("comparisons.adapters.timeline", "comparisons.jobs.external_trace"):
        monkeypatch.setattr(f"{place}.resolved", lambda time_s: np.round(time_s, 4))
    with pytest.raises(InputError, match="expected the time of a measurement"):
        checked(written("jittered", seed=1), tmp_path)


def retimed(folder: Path, change: Callable[[str], Decimal]) -> None:
    """Hand in an estimate with other times, in its trajectory and in its trace."""
    path = folder / "trajectory.tum"
    rows = [line.split(" ", 1) for line in path.read_text().splitlines()]
    path.write_text("".join(f"{change(time)} {rest}\n" for time, rest in rows))
    exact = list(TraceReader(folder / TRACE))
    (folder / TRACE).unlink()
    with slamcheck.Recorder(folder / TRACE) as record:
        for event in exact:
            if event.time_s is not None:
                event = event._replace(time_s=float(change(repr(event.time_s))))
            record.event(event)


@pytest.mark.slow
@pytest.mark.parametrize("decimals", [6, 9])
def test_an_estimate_with_fewer_decimals_is_of_the_same_instants(
    decimals: int, tmp_path: Path
) -> None:
    log = written("jittered", seed=2)
    checked(log, tmp_path)
    retimed(tmp_path / "mine", lambda time: round(Decimal(time), decimals))
    found = slamcheck.check(slamcheck.load_log(tmp_path / "log"), tmp_path / "mine")
    assert (found.outcome, found.grade.value) == ("agree", "equal")


def test_times_are_an_instants_within_their_last_decimal_only() -> None:
    instants = np.array([0.0, 0.1003, 0.2, 0.20000003])
    assert at_instants(np.array([0.1003, 0.20000003]), instants).tolist() == [0.1003, 0.20000003]
    assert at_instants(np.array([0.1]), instants).tolist() == [0.1003]  # milliseconds, all near
    assert at_instants(np.array([0.1, 0.15]), instants).tolist() == [0.1, 0.15]
    assert at_instants(np.array([0.10031, 0.15]), instants).tolist() == [0.10031, 0.15]
    assert at_instants(np.array([0.3]), np.array([0.0])).tolist() == [0.3]


def test_times_are_said_to_be_rounded_where_that_is_sure() -> None:
    """Neither instants themselves, nor even steps, nor times between instants, nor chance."""
    rng = np.random.default_rng(0)
    instants = 1.7e9 + np.sort(rng.uniform(0.0, 30.0, 100))
    said = stamps.rounded(np.unique(np.round(instants, 2)), instants)
    assert said.startswith("the estimate's times are the log's rounded to 0.01 s, as '%.12g' does")
    assert "by up to 5 ms; write nine decimals" in said
    dense = np.sort(rng.uniform(0.0, 3.0, 100))  # half a decimal is near an instant anywhere
    assert stamps.rounded(np.unique(np.round(dense, 1)), dense) == ""
    for time_s in (instants, np.round(instants, 3), np.unique(np.round(instants, 2))[:3]):
        assert stamps.rounded(time_s, instants) == ""
    assert stamps.rounded(np.round(rng.uniform(0.0, 30.0, 100), 2) + 1.7e9, instants) == ""
    even = np.arange(0.0, 30.0, 0.1)
    assert stamps.rounded(np.arange(0.0, 30.0, 0.05), even + rng.uniform(0.0, 4e-3, 300)) == ""
    assert stamps.rounded(np.arange(0.0, 30.0, 0.05)[::2], even + 4e-3) == ""


def test_what_a_float_adds_is_no_time_of_its_own() -> None:
    assert resolved(np.array([0.1 + 0.2])).tolist() == [0.3]
    late = np.array([1_700_000_000.1234567])
    assert resolved(late).tolist() == late.tolist()
    assert stamps.resolved(np.array([1e-9])).tolist() == [1e-9]


def column(path: Path) -> list[Decimal]:
    """The times of a CSV file."""
    return [Decimal(row.split(",")[0]) for row in path.read_text().splitlines()[1:]]


def write_since_1970(
    folder: Path,
    out: Path,
    *,
    whole: bool,
    traced: bool = False,
    bare: bool = False,
    kind: type[TextbookEkf] = TextbookEkf,
) -> None:
    """Write the estimate of a filter that reads stamps as whole nanoseconds, or as floats.

    bare: it begins with a covariance of its own, and has no stabilisation noise. kind: the filter.
    traced: with a trace, whose times count from the first second where the stamps are whole.
    """
    log, start = read_log(folder), Decimal(0)
    if whole:
        sampled, seen = (column(folder / f"{one}.csv") for one in ("odometry", "measurements"))
        start = sampled[0] // 1
        begun = {"time_s": float(sampled[0] - start)}
        log = replace(
            log,
            meta=log.meta | {"prior": log.meta["prior"] | begun},
            odometry_s=np.array([float(one - start) for one in sampled]),
            used_s=np.array([float(one - start) for one in seen]),
        )
    if bare:
        log.meta["prior"]["covariance"] = (1e-9 * np.eye(3)).tolist()
        log.meta["odometry"]["noise"] |= {
            "variance_rate_position": 0.0, "variance_rate_heading": 0.0
        }  # fmt: skip
    kind(log).run().write(out, traced=traced)
    path = out / "trajectory.tum"
    rows = [line.split(" ", 1) for line in path.read_text().splitlines()]
    path.write_text("".join(f"{start + Decimal(time)} {rest}\n" for time, rest in rows))


def since_1970(
    folder: Path,
    out: Path,
    *,
    kind: type[TextbookEkf] = TextbookEkf,
    traced: bool = False,
    **more: bool,
) -> ExternalCheck:
    """The check of a filter, as of `write_since_1970`."""
    write_since_1970(folder, out, kind=kind, traced=traced, **more)
    found = slamcheck.check(slamcheck.load_log(folder), out, require="like")
    if traced and kind is TextbookEkf:
        assert present(found.trace).agreement.model.within(1e-6)
    return found


@pytest.mark.slow
def test_a_fault_is_named_of_a_filter_with_exact_times(tmp_path: Path) -> None:
    """Stamps since 1970 as floats move a path by more than rounding, and a fault hides by which."""
    log = tmp_path / "log"
    course = Course("since-1970", duration_s=6.0, apart=True, start_ns=1_700_000_000_123_456_789)
    simulate(course, 1, log)
    found = since_1970(log, tmp_path / "mine", whole=True, bare=True)
    assert found.causes[0].evidence.startswith(
        "the prior's covariance is 1e-09 I, and the stabilisation noise is left out: with this "
        "fault the reference filter equals the estimate ("
    )


def test_an_estimate_of_rounded_stamps_is_told_so(tmp_path: Path) -> None:
    """To 10 ms it is another estimate; milliseconds, all near, are the log's instants."""
    log = tmp_path / "log"
    course = Course("since-1970", duration_s=4.0, apart=True, start_ns=1_700_000_000_123_456_789)
    simulate(course, 1, log)
    since_1970(log, tmp_path / "mine", whole=False)
    path = tmp_path / "mine" / "trajectory.tum"
    rows = [line.split(" ", 1) for line in path.read_text().splitlines()]
    for digits, grade in ((12, "plausible"), (13, "equal")):
        path.write_text("".join(f"{float(time):.{digits}g} {rest}\n" for time, rest in rows))
        found = slamcheck.check(slamcheck.load_log(log), path)
        assert found.grade.value == grade
        told = any("rounded to 0.01 s, as '%.12g' does" in said for said in found.remarks)
        assert told is (digits == 12)


@pytest.mark.parametrize("whole", [True, False])
def test_stamps_since_1970_are_taken_as_the_filter_had_them(
    whole: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Floats tell 0.24 us of them, which is more than rounding of an estimate.

    A trace may count as the log does beside a trajectory that counts since 1970.
    """
    log = tmp_path / "log"
    course = Course("since-1970", duration_s=6.0, apart=True, start_ns=1_700_000_000_123_456_789)
    simulate(course, 1, log)
    assert since_1970(log, tmp_path / "mine", whole=whole, traced=whole).grade.value == "equal"
    if whole:
        monkeypatch.setattr("comparisons.logs.log_folder.origin", lambda first_s: 0)
    else:
        monkeypatch.setattr("comparisons.jobs.check.timed_by_floats", lambda log: log)
    assert since_1970(log, tmp_path / "other", whole=whole).grade.value == "like"


RANGES = {fault.name: fault for fault in HINTS}["range scale"].plant(TextbookEkf)
"""A filter whose ranges are 1.03 times the log's: it leaves the reference at an update."""


@pytest.mark.parametrize("traced", [True, False])
@pytest.mark.parametrize("whole", [True, False])
def test_a_wrong_filter_leaves_where_its_fault_is(
    whole: bool, traced: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not at its first step, by intervals that it did not use; and the smoother runs once.

    By the other stamps it would leave there.
    """
    log, solved = tmp_path / "log", list[str]()
    course = Course("since-1970", duration_s=3.0, apart=True, start_ns=1_700_000_000_123_456_789)
    simulate(course, 1, log)

    def counted(grader: Grader, given: ExternalEstimate) -> tuple[Grader, ExternalCheck]:
        solved.append(grader.log.name)
        return stated(grader, given)

    as_it_is = [kind for kind in READINGS if kind not in (MOTION, FAULT)]
    monkeypatch.setattr("comparisons.jobs.check.READINGS", as_it_is)
    monkeypatch.setattr("comparisons.jobs.check.stated", counted)
    found = since_1970(log, tmp_path / "mine", whole=whole, traced=traced, kind=RANGES)
    assert len(solved) == 1
    assert present(found.departure).measurements
    assert not any("interval" in one.hint for one in found.causes)
    monkeypatch.setattr("comparisons.jobs.check.works_with_floats", lambda *parts: whole)
    found = since_1970(log, tmp_path / "other", whole=whole, traced=traced, kind=RANGES)
    assert not present(found.departure).measurements


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("kind", [TextbookEkf, Euler, RANGES])
def test_the_first_poses_tell_which_stamps_a_filter_worked_with(
    whole: bool, kind: type[TextbookEkf], tmp_path: Path
) -> None:
    """By steps, or without any, as where poses are those after each scan alone."""
    log_path = tmp_path / "log"
    course = Course("since-1970", duration_s=3.0, apart=True, start_ns=1_700_000_000_123_456_789)
    simulate(course, 1, log_path)
    write_since_1970(log_path, tmp_path / "mine", whole=whole, kind=kind)
    log = slamcheck.load_log(log_path)
    prepared = [prepare_solve(one, CheckConfig()) for one in (log, timed_by_floats(log))]
    given = slamcheck.read_estimate(tmp_path / "mine")
    assert written_from_floats(given) is not whole
    assert works_with_floats(given, prepared[0], prepared[1]) is not whole
    scans_s = np.unique(log.measurements.time_s) + float(log.provenance["time_origin_s"])
    near = np.abs(given.time_s[:, None] - scans_s).min(axis=1) < 1e-6
    after_scans = with_poses(given, near)
    expected = None if kind is Euler else not whole  # it leaves the reference at its first step
    assert works_with_floats(after_scans, prepared[0], prepared[1]) is expected


def driven(log: Log) -> Array:
    """Poses (N, 3) at the odometry's samples, by dead reckoning."""
    assert isinstance(log.odometry, VelocityOdometry)
    o, pose = log.odometry, np.zeros((len(log.odometry.time_s), 3))
    for k, dt in enumerate(np.diff(o.time_s).tolist()):
        middle = pose[k, 2] + 0.5 * dt * o.yaw_rate_radps[k]
        way = dt * o.speed_mps[k]
        pose[k + 1] = pose[k] + (way * np.cos(middle), way * np.sin(middle), middle - pose[k, 2])
        pose[k + 1, 2] = pose[k, 2] + dt * o.yaw_rate_radps[k]
    return pose


def bag(path: Path, seed: int) -> Path:
    """The drive as a ROS bag with jittered stamps since 1970, exact to the nanosecond."""
    from tests.comparisons.logs.bags import SECOND, Types

    types, rng = Types().with_detections(), np.random.default_rng(seed)
    log = of_speeds_and_yaw_rates(8.0)
    start = 1_700_000_000_123_456_789

    def since_1970(time_s: float) -> Fraction:
        jitter = int(rng.integers(0, 2_000_000))
        return Fraction(start + round(time_s * SECOND) + jitter, SECOND)

    messages = [
        types.odometry(since_1970(t), float(x), float(h), y=float(y))
        for t, (x, y, h) in zip(log.odometry.time_s, driven(log), strict=True)
    ]
    seen, covariance = log.measurements, np.diag((0.04, 0.04, 0, 0, 0, 0))
    # Within the odometry, which ends with its last sample.
    for t in np.unique(seen.time_s[seen.time_s < log.odometry.time_s[-1]]):
        rows = np.flatnonzero(seen.time_s == t)
        ahead = seen.range_m[rows] * np.exp(1j * seen.bearing_rad[rows])
        points = [
            (str(label), "", float(z.real), float(z.imag))
            for label, z in zip(seen.landmark[rows], ahead, strict=True)
        ]
        messages.append(types.detections(since_1970(t), *points, covariance=covariance))
    messages.sort(key=lambda one: one[2])
    return types.write(path, messages)


@pytest.mark.parametrize("since_1970", [False, True])
def test_a_right_filter_is_equal_on_a_ros_bag(since_1970: bool, tmp_path: Path) -> None:
    """With the times of the log folder, and with those of the bag, which no float holds."""
    pytest.importorskip("rosbags")
    log = slamcheck.load_log(bag(tmp_path / "drive", seed=4))
    origin = log.provenance["time_origin_s"]
    assert origin.startswith("1700000000.")
    assert np.any(np.round(log.odometry.time_s, 6) != log.odometry.time_s)
    run = compared(log).ekf
    write_estimate(run.estimate, tmp_path)
    write_run(run, tmp_path / TRACE)
    if since_1970:
        retimed(tmp_path, lambda time: Decimal(origin) + Decimal(time))
    found = slamcheck.check(log, tmp_path)
    assert (found.outcome, found.grade.value) == ("agree", "equal"), found.causes
    assert present(found.trace).agreement.model.within(1e-6)


def test_loop_closures_have_the_times_of_their_poses() -> None:
    """Both by the same clock: else closures would be between poses that are not there."""
    n = 9
    time_s = np.arange(1.0, n + 1.0) / 7.0 + 0.123456789
    log = Log(
        name="closed",
        format="arrays",
        prior=Prior(0.0, np.zeros(3), np.eye(3)),
        odometry=RelativePoses(time_s, np.ones((n, 3)), np.tile(np.eye(3), (n, 1, 1))),
        measurements=LandmarkMeasurements.of(time_s[:2], np.ones((2, 2)), (0.1, 0.1), 0),
        loop_closures=LoopClosures(time_s[:1], time_s[5:6], np.ones((1, 3)), np.eye(3)[None]),
        provenance={"time_origin_s": "1700000000"},
    )
    moved = timed_by_floats(log)
    assert moved.loop_closures is not None
    assert not np.array_equal(moved.odometry.time_s, time_s)
    assert moved.loop_closures.to_s == moved.odometry.time_s[5]
