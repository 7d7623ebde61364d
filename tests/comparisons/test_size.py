"""A log that is too large for the machine is refused before the work, and no other."""

import tracemalloc
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.config import CheckConfig, EkfConfig, RunConfig
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.jobs.check import check
from comparisons.jobs.run import REQUIRED, compare_prepared, run_filter
from comparisons.logs.log import Log
from comparisons.pipeline import prepare as prepare_module
from comparisons.pipeline import size
from comparisons.pipeline.clock import Progress
from comparisons.pipeline.prepare import prepare
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.size import GIB, announce_time, check_size, needed, seconds
from comparisons.pipeline.solve import Solution, solve
from tests.helpers import present, simulated, without_labels


def prepared(kind: str = "compressed", loop_s: float = 20.0) -> Prepared[RunConfig]:
    config = RunConfig(ekf=EkfConfig(filter=kind))
    return prepare(simulated(loop_s=loop_s), config, required=REQUIRED)


def test_what_fits_is_not_refused() -> None:
    check_size(prepared())
    check_size(prepared(), 4.0 * GIB)


def test_what_does_not_fit_is_refused_in_one_line() -> None:
    one = prepared()
    with pytest.raises(InputError, match=r"poses.*landmarks need about 0\.3 GiB") as reported:
        check_size(one, 0.2 * GIB)
    assert "\n" not in str(reported.value)
    assert "part of the log" in str(reported.value)


@pytest.mark.parametrize("large", [False, True])
def test_jobs_ask_where_a_log_is_large(large: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(size, "available_bytes", lambda: 1.0)
    one = prepared()
    monkeypatch.setattr(prepare_module, "ASKED_BEYOND", sum(one.log.records.values()) - large)
    with pytest.raises(InputError, match="GiB are free") if large else nullcontext():
        compare_prepared(one)
    with pytest.raises(InputError, match="GiB are free") if large else nullcontext():
        solve(one.log)


def test_nothing_is_refused_where_the_memory_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(size, "_limits", lambda: iter(()))
    monkeypatch.setattr(size, "BASE", 1e18)
    check_size(prepared())
    monkeypatch.setattr(size, "_limits", lambda: iter((1.0,)))
    with pytest.raises(InputError):
        check_size(prepared())


@pytest.mark.parametrize("most", ["3000", "max"])
def test_a_control_group_leaves_its_limit_and_what_files_hold(
    most: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in (
        ("memory.max", most),
        ("memory.current", "2500"),
        ("memory.stat", "anon 1500\ninactive_file 1000"),
    ):
        (tmp_path / name).write_text(f"{text}\n")
    monkeypatch.setattr(size, "_CGROUP", tmp_path)
    available = present(size.available_bytes())
    assert (available == 1500.0) == (most == "3000")


def test_the_need_is_linear_in_poses_and_square_in_landmarks() -> None:
    base = needed(0, 0, 0)
    one, two = (needed(n, 9 * n, 0) - base for n in (100_000, 200_000))
    assert two == pytest.approx(2.0 * one)
    few, many = (needed(0, 0, n) - base for n in (2_000, 4_000))
    assert many == pytest.approx(4.0 * few, rel=0.01)
    assert needed(10, 90, 2_000, full=True) > needed(10, 90, 2_000)


@pytest.mark.parametrize(
    ("poses", "landmarks", "used", "measured_s"),
    [(99_747, 2_000, "compressed", 784.0), (10_000, 200, "compressed", 20.0),
     (1_000, 2_000, "full", 185.0)],
)  # fmt: skip
def test_the_time_is_about_what_was_measured(
    poses: int, landmarks: int, used: str, measured_s: float
) -> None:
    """As docs/limits.md has it."""
    assert seconds(poses, 9 * poses, landmarks, used) == pytest.approx(measured_s, rel=0.1)


@pytest.mark.parametrize("kind", ["full", "compressed", "compressed-suboptimal"])
def test_long_work_is_announced(
    kind: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    one = prepared(kind)
    announce_time(one)
    assert not capsys.readouterr().err
    monkeypatch.setattr(size, "PER_ENTRY_S", {"full": 3.0, "compressed": 1.0})
    announce_time(one)
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert " landmarks take about " in said
    assert ("; --filter compressed takes about" in said) == (kind == "full")


def test_a_long_check_is_announced_before_its_work(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(log: Log, config: CheckConfig, progress: Progress) -> Solution:
        raise InterruptedError

    log, given = simulated(loop_s=20.0), ExternalEstimate(time_s=np.zeros(1), pose=np.zeros((1, 3)))
    said = []
    for seconds_of_an_entry in (9e-9, 3.0):
        monkeypatch.setitem(size.PER_ENTRY_S, "full", seconds_of_an_entry)
        with pytest.raises(InterruptedError):
            check(log, given, solver=stop)
        said.append(capsys.readouterr().err)
    assert not said[0]
    assert said[1].count("\n") == 1
    assert said[1].endswith(", longer where the estimate is not as the reference EKF's\n")
    assert "--filter" not in said[1]


@pytest.mark.parametrize("labelled", [True, False])
def test_landmarks_without_labels_are_counted_by_scans(labelled: bool) -> None:
    log = simulated(loop_s=20.0)
    one = prepare(log if labelled else without_labels(log), RunConfig(), required=REQUIRED)
    _, _, found = size.counts(one)
    most = np.bincount(one.timeline.measurement_epoch).max()
    assert found == (len(np.unique(log.measurements.landmark)) if labelled else most)


@pytest.mark.slow
@pytest.mark.parametrize("pairs", [False, True])
def test_the_filters_memory_is_linear_in_poses(pairs: bool) -> None:
    """From 200 to 400 poses its peak at most doubles, and some; a matrix over poses is seen."""
    peaks = []
    for loop_s in (40.0, 80.0):
        one = prepared(loop_s=loop_s)
        _ = one.timeline
        tracemalloc.start()
        run, _ = run_filter(replace(one))
        if pairs:
            kept = np.multiply.outer(run.departed, run.departed)
            del kept
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert (peaks[1] < 2.5 * peaks[0]) != pairs, peaks
