"""A newcomer's filter, log and stamps: sound it passes, each fault is the first sentence."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slamcheck
from comparisons.checks.grade import likeness
from comparisons.estimates.external import read_external
from comparisons.faults.fault import Method
from comparisons.fingerprints.unscented import unscented_filters
from comparisons.jobs.external_check import ExternalCheck
from comparisons.logs.log_folder import write_log_folder
from comparisons.pipeline.references import reference_ekf
from comparisons.pipeline.solve import solve
from comparisons.report.check import CheckReport
from research.trust.stranger_faults import Plant, changed, instead, scaled, spread
from research.trust.strangers import Array, TextbookEkf, read_log
from tests.comparisons.newcomers import (
    Arc,
    ByRow,
    Course,
    Cubature,
    Euler,
    UnscentedHalf,
    UnscentedThird,
    simulate,
)
from tests.comparisons.test_stamps import of_speeds_and_yaw_rates
from tests.helpers import present

SEED = 3


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive with stamps to the nanosecond."""
    log, rng = of_speeds_and_yaw_rates(12.0), np.random.default_rng(SEED)
    lag = np.round(np.sort(rng.uniform(0.0, 1e-3, len(log.odometry.time_s))), 9)
    path = tmp_path_factory.mktemp("newcomer") / "log"
    odometry = replace(log.odometry, time_s=log.odometry.time_s + lag)
    first = float(odometry.time_s[0])
    instants, which = np.unique(log.measurements.time_s, return_inverse=True)
    seen = replace(log.measurements, time_s=(np.round(instants + 2e-3, 9))[which])
    write_log_folder(
        replace(log, odometry=odometry, measurements=seen, prior=replace(log.prior, time_s=first)),
        path,
    )
    return path


class Newcomer(ByRow, Arc):
    """Uses one measurement after the other, and leaves no trace."""


def judged(kind: type[TextbookEkf], folder: Path, out: Path) -> ExternalCheck:
    kind(read_log(folder)).run().write(out, traced=False)
    return slamcheck.check(slamcheck.load_log(folder), out, require="like")


@pytest.mark.slow
def test_a_sound_filter_is_equal_on_its_own_arc(folder: Path, tmp_path: Path) -> None:
    found = judged(Newcomer, folder, tmp_path / "mine")
    assert (found.outcome, found.grade.value) == ("agree", "equal")
    assert "along the arc" in found.remarks[0]


@pytest.mark.parametrize("traced", [True, False])
@pytest.mark.parametrize("apart", [True, False])
def test_a_filter_of_short_euler_steps_is_equal(
    folder: Path, tmp_path: Path, apart: bool, traced: bool
) -> None:
    """Steps of at most 10 ms, some to a sample: neither Euler's step nor an arc.

    Scans apart from the samples split these into parts of any length. Without a trace, poses
    between which nothing is fused tell how many.
    """
    if apart:
        folder = tmp_path / "log"
        simulate(Course("apart", duration_s=20.0, apart=True), SEED, folder)
    log = slamcheck.load_log(folder)
    Euler(read_log(folder)).run().write(tmp_path / "mine", traced=traced)
    found = slamcheck.check(log, tmp_path / "mine", require="like")
    assert (found.outcome, found.grade.value) == ("agree", "equal"), found.causes
    count = int(np.ceil(np.median(np.diff(log.odometry.time_s)) / 0.01))
    said = "in steps of at most 0.01 s" if apart else f"in {count} steps each"
    assert said in found.remarks[0]


def apart_from_the_map(own: Method, ekf: TextbookEkf, k: int) -> None:
    own(k)
    ekf.p[-2:, 3:-2] = ekf.p[3:-2, -2:] = 0.0


def unwrapped(own: Method, ekf: TextbookEkf, pose: Array, point: Array) -> Any:
    (x, y), found = point - pose[:2], own(pose, point)
    return (np.array([found[0][0], np.arctan2(y, x) - pose[2]]), *found[1:])


FAULTS: dict[str, Plant] = {
    "R is 0.5 times the log's": scaled("noise", 0.5),
    "the controls' part of Q is 4 times the log's": spread(lambda ekf, q, dt: 4.0 * q),
    "in the initialisation of landmarks, the new block's covariance with the": instead(
        initialise=apart_from_the_map
    ),
    "the innovation is z - h, not wrapped": instead(
        expected=unwrapped, residual=lambda own, ekf, z, expected: z - expected
    ),
    "the odometry is used 1 sample late, the first twice": instead(
        predict=lambda own, ekf, number, *args: own(max(number - 1, 0), *args)
    ),
    "R contains sigma, not its square": changed("noise", lambda ekf, k, r: np.sqrt(r)),
    "R is 0.317 times the log's": scaled("noise", 0.317),
}


@pytest.mark.slow
@pytest.mark.parametrize("words", FAULTS)
def test_each_fault_is_the_first_sentence(words: str, folder: Path, tmp_path: Path) -> None:
    found = judged(FAULTS[words](Newcomer), folder, tmp_path / "mine")
    assert found.outcome == "disagree"
    first = found.causes[0]
    assert first.gap == "fault"
    assert first.evidence.startswith(words)
    assert "equals the estimate" in first.evidence
    whole = "until both diverge" not in first.evidence
    summary = CheckReport.of(found).summary()
    assert bool(summary.explained) is whole
    assert set(summary.explained) <= {"first difference", "estimate", "covariance", "consistency"}
    departed = any(remark.startswith("first difference") for remark in summary.remarks)
    assert departed is not whole
    unknown = CheckReport.of(replace(found, consequences=())).summary()
    assert not unknown.explained
    assert any(remark.startswith("first difference") for remark in unknown.remarks)


@pytest.fixture(scope="module")
def hard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive so far from linear that no unscented filter is like another."""
    path = tmp_path_factory.mktemp("hard") / "log"
    simulate(Course("hard", hard=True, duration_s=12.0), SEED, path)
    return path


def unscented_grades(kind: type[TextbookEkf], folder: Path, out: Path) -> list[str | None]:
    """Grades of an estimate beside the unscented filters that are fitted to it."""
    kind(read_log(folder)).run().write(out, traced=False)
    prepared, given = solve(slamcheck.load_log(folder)).prepared, read_external(out)
    ekf, _ = present(reference_ekf(prepared, given.time_s))
    fitted = unscented_filters(given, prepared, likeness(given, ekf, labelled=True))
    return [likeness(given, one, labelled=True).grade for one in fitted]


@pytest.mark.slow
@pytest.mark.parametrize("kind", [UnscentedHalf, UnscentedThird, Cubature])
def test_sigma_points_are_found_and_no_fault_is_taken_for_them(
    kind: type[TextbookEkf], hard: Path, tmp_path: Path
) -> None:
    assert "equal" in unscented_grades(kind, hard, tmp_path / "mine")
    faulty = scaled("noise", 0.5)(kind)
    assert not any(unscented_grades(faulty, hard, tmp_path / "worse"))


def test_an_unscented_filter_is_equal_whatever_its_sigma_points(hard: Path, tmp_path: Path) -> None:
    """Where no other reference is like it."""
    found = judged(UnscentedHalf, hard, tmp_path / "mine")
    assert (found.outcome, found.grade.value) == ("agree", "equal"), found.causes
    assert present(found.grade.by).reference is found.variants[-1]
    others = [likeness(found.inside, one, labelled=True) for one in found.variants[:-1]]
    assert all(one.grade is None for one in others)


def shortened(own: Method, ekf: TextbookEkf, z: Array, expected: Array) -> Any:
    """A fault that no catalogue has: every range is shortened by its bearing."""
    return own(z - (0.3 * abs(z[1]), 0.0), expected)


@pytest.mark.slow
def test_a_fault_that_nobody_knows_is_given_no_name(folder: Path, tmp_path: Path) -> None:
    found = judged(instead(residual=shortened)(Newcomer), folder, tmp_path / "mine")
    assert found.outcome == "disagree"
    assert all(one.gap != "fault" for one in found.causes)
    assert found.remarks[0].startswith("first difference from")


@pytest.mark.slow
@pytest.mark.parametrize("traced", [True, False])
def test_a_fault_that_comes_late_is_dated(folder: Path, tmp_path: Path, traced: bool) -> None:
    """The nearest by the largest difference is another filter, which it leaves much earlier.

    With a trace the measurement is known, without one the scan.
    """
    log = slamcheck.load_log(folder)
    since = float(np.unique(log.measurements.time_s)[8])

    def smaller(ekf: TextbookEkf, k: int, r: Array) -> Array:
        return 0.3 * r if ekf.log.used_s[k] >= since else r

    changed("noise", smaller)(Newcomer)(read_log(folder)).run().write(
        tmp_path / "mine", traced=traced
    )
    found = slamcheck.check(log, tmp_path / "mine", require="like")
    left, rows = found.departure, np.flatnonzero(log.measurements.time_s == since)
    assert found.outcome == "disagree"
    assert left is not None
    assert left.time_s == pytest.approx(since, rel=1e-9)
    assert left.measurements == (rows[:1] if traced else rows).tolist()
    assert left.landmarks == np.unique(log.measurements.landmark[left.measurements]).tolist()
    assert str(left) == found.remarks[0]
