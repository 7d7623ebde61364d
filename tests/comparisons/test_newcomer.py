"""A newcomer's filter, log and stamps: sound it passes, each fault is the first sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import slamcheck
from comparisons.checks.causes import Cause
from comparisons.fingerprints import search
from comparisons.logs.log_folder import write_log_folder
from comparisons.pipeline.check import ExternalCheck
from tests.comparisons.test_stamps import of_speeds_and_yaw_rates
from tests.comparisons.textbook_ekf import Array, TextbookEkf, run

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


def judged(kind: type[TextbookEkf], folder: Path, out: Path) -> ExternalCheck:
    run(kind, folder, out)
    return slamcheck.check(slamcheck.load_log(folder), out, require="like")


def test_a_sound_filter_is_equal_on_its_own_arc(folder: Path, tmp_path: Path) -> None:
    found = judged(TextbookEkf, folder, tmp_path / "mine")
    assert (found.outcome, found.grade.value) == ("agree", "equal")
    assert "along the arc" in found.remarks[0]


class HalfR(TextbookEkf):
    def r(self, sigma: Array) -> Array:
        return 0.5 * super().r(sigma)


class FourQ(TextbookEkf):
    def q(self, v: Array, dt: float) -> Array:
        return 4.0 * (v @ self.m @ v.T) + dt * self.drift


class NoCross(TextbookEkf):
    def cross(self, g: Array) -> Array:
        full = super().cross(g)
        full[:, 3:] = 0.0
        return full


class Unwrapped(TextbookEkf):
    def innovation(self, z: Array, expected: Array) -> Array:
        return z - expected


class Late(TextbookEkf):
    late = 1


class SigmaInR(TextbookEkf):
    def r(self, sigma: Array) -> Array:
        return np.diag(sigma)


class ThirdOfR(TextbookEkf):
    """No round number."""

    def r(self, sigma: Array) -> Array:
        return 0.317 * super().r(sigma)


FAULTS = {
    HalfR: "R is 0.5 times the log's",
    FourQ: "the controls' part of Q is 4 times the log's",
    NoCross: "P between a new landmark and the map is left zero",
    Unwrapped: "the innovation z - h(x) is not wrapped",
    Late: "the odometry is used 1 sample late, the first twice",
    SigmaInR: "R holds sigma",
    ThirdOfR: "R is 0.317 times the log's",
}


@pytest.mark.parametrize("kind", FAULTS)
def test_each_fault_is_the_first_sentence(
    kind: type[TextbookEkf], folder: Path, tmp_path: Path
) -> None:
    found = judged(kind, folder, tmp_path / "mine")
    assert found.outcome == "disagree"
    first = found.causes[0]
    assert first.gap == "fault"
    assert first.evidence.startswith(FAULTS[kind])
    assert "equals the estimate" in first.evidence


class Strange(TextbookEkf):
    """A fault that no catalogue has: every range is shortened by its bearing."""

    def innovation(self, z: Array, expected: Array) -> Array:
        return super().innovation(z - (0.3 * abs(z[1]), 0.0), expected)


def test_a_fault_that_nobody_knows_is_given_no_name(folder: Path, tmp_path: Path) -> None:
    found = judged(Strange, folder, tmp_path / "mine")
    assert found.outcome == "disagree"
    assert all(one.gap != "fault" for one in found.causes)
    assert any(said.startswith("the poses first differ from") for said in found.remarks)


def test_a_fault_that_explains_all_but_a_hundredth_is_not_said_to_be_equal() -> None:
    known = [search.Fingerprint("R is 2 times the log's", "", 0.004, exact=False)]

    class Sound:
        farthest = 0.8

    said = search.fault_cause(known, Sound)  # type: ignore[arg-type]
    assert isinstance(said, Cause)
    assert "99 % of the difference" in said.evidence
    assert "equals" not in said.evidence
