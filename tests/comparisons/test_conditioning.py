"""Sound filters stay green where numbers are awkward; broken ones are reported as such."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.config import RunConfig
from comparisons.errors import InputError
from comparisons.faults.fault import with_state
from comparisons.jobs.run import REQUIRED, Modified, compare_prepared
from comparisons.logs.log import LandmarkMeasurements, Log, Prior
from comparisons.logs.odometry import OdometryNoise, RelativePoses
from comparisons.pipeline.prepare import prepare
from comparisons.report.run import RunReport
from comparisons.rounding import EXACT
from comparisons.settings import configure
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.state import Correction, KalmanState
from graphslam.marginals import SingularProblemError
from research.trust.drives import far_away, fine, standing_still
from tests.helpers import assert_followed, compared, first_seconds, present, simulated


@pytest.mark.slow
@pytest.mark.parametrize("jitter_s", [0.02, 1e-3, 1e-4, 1e-6, 1e-7, 1e-8])
def test_measurements_that_come_one_by_one(jitter_s: float) -> None:
    """A millisecond or less, down to nanoseconds, between poses costs no digits that matter."""
    log = simulated(loop_s=20.0)
    shift = np.random.default_rng(0).uniform(0.0, jitter_s, len(log.measurements.time_s))
    time = np.sort(log.measurements.time_s + shift)
    c = compared(replace(log, measurements=replace(log.measurements, time_s=time)))
    limit = 1e-7 if jitter_s > 1e-7 else 5e-7
    assert_followed(c, limit)
    assert c.smoother.optimality.verified
    assert c.verdict.outcome == "agree"


def precise_log() -> Log:
    """Increments known to 20 micrometres, with errors that go together."""
    rng = np.random.default_rng(0)
    steps = 30
    covariance = 4e-10 * np.array([[1.0, 0.9, 0.3], [0.9, 1.0, 0.3], [0.3, 0.3, 1.0]])
    root = np.linalg.cholesky(covariance)
    move = np.array((0.5, 0.0, 0.2))
    displacement = move + rng.standard_normal((steps, 3)) @ root.T
    pose = np.zeros(3)
    z, when = [], []
    post = np.array((1.0, 4.0))
    for k in range(1, steps + 1):
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        pose = pose + (cos * 0.5, sin * 0.5, 0.2)
        offset = post - pose[:2]
        z.append((np.hypot(*offset), np.angle(np.exp(1j * (np.arctan2(*offset[::-1]) - pose[2])))))
        when.append(float(k))
    seen = np.array(z) + rng.standard_normal((steps, 2)) * (1e-3, 1e-3)
    return Log(
        name="precise",
        format="test",
        prior=Prior(0.0, np.zeros(3), 1e-10 * (np.eye(3) + 0.5)),
        odometry=RelativePoses(
            np.array(when), displacement, np.broadcast_to(covariance, (steps, 3, 3))
        ),
        measurements=LandmarkMeasurements(
            time_s=np.array(when),
            range_m=seen[:, 0],
            bearing_rad=seen[:, 1],
            sigma_range_m=np.full(steps, 1e-3),
            sigma_bearing_rad=np.full(steps, 1e-3),
            landmark=np.zeros(steps, dtype=np.int64),
            diameter_m=np.full(steps, np.nan),
        ),
    )


def test_small_correlations_are_kept() -> None:
    """gtsam's default takes covariances below 1e-9 for zero; ours must not."""
    c = compared(precise_log())
    assert_followed(c, 1e-8)
    assert c.verdict.outcome == "agree"


class Corrupted(KalmanState):
    """Goes wrong at the fifth update."""

    updates = 0

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        self.updates += 1
        done = super().update(columns, jacobian, innovation, noise)
        if self.updates == 5:
            self.corrupt()
        return done

    def corrupt(self) -> None:
        raise NotImplementedError


class NotANumber(Corrupted):
    """One entry of the covariance is NaN."""

    def corrupt(self) -> None:
        self._covariance[0, 0] = np.nan


class Indefinite(Corrupted):
    """The covariance loses far too much."""

    def corrupt(self) -> None:
        self._covariance[:3, :3] -= 1e3 * np.eye(3)


@pytest.mark.parametrize("state", [NotANumber, Indefinite])
def test_a_filter_that_breaks_down_disagrees(state: type[KalmanState]) -> None:
    """It is the filter's fault, not the log's; everything is compared up to there."""
    log = simulated(loop_s=20.0)
    c = compared(log, Modified(with_state(state)))
    assert c.verdict.outcome == "disagree"
    assert "broke down at 1." in present(c.ekf.breakdown)
    assert c.ekf.timeline.epoch_time_s[-1] < 3.0
    assert len(c.ekf.landmark_index) < len(log.measurements.time_s)
    said = [*(cause.evidence for cause in c.verdict.causes), *c.verdict.remarks]
    assert any("broke down" in line for line in said)


SMALL = {"fastslam": {"particles": 10, "clouds": 16}, "posterior": {"draws": 800}}


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_extensions_show_a_filter_that_breaks_down(name: str, tmp_path: Path) -> None:
    """They end where the filter does, and so do the page and the figures."""
    log = simulated(loop_s=10.0)
    config = configure(RunConfig, over={"extensions": {name: SMALL[name]}})
    broken = Modified(with_state(NotANumber))
    c = compare_prepared(prepare(log, config, required=REQUIRED, also=(broken,)))
    assert c.ekf.breakdown
    assert len(c.ekf.estimate.time_s) < len(c.prepared.timeline.epoch_time_s)
    RunReport.of(c).write(tmp_path / "out")
    assert "broke down" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def with_prior_of(sigma_m: float) -> Log:
    log = simulated(loop_s=20.0)
    covariance = np.diag((sigma_m**2, sigma_m**2, 1e-6))
    return replace(log, prior=replace(log.prior, covariance=covariance))


@pytest.mark.parametrize("sigma_m", [550.0, 1e3, 1e4])
def test_a_wide_prior_is_no_fault_of_the_filter(sigma_m: float) -> None:
    """Rounding grows with the prior's variance, and the limit of the gaps with it."""
    c = compared(with_prior_of(sigma_m))
    assert c.agreement.algebra.covariance < 0.25 * c.known.gaps.rounding.covariance
    assert c.agreement.model.covariance < 0.25 * c.known.gaps.rounding.covariance
    assert c.verdict.outcome == "agree"
    said = any("double precision resolves" in remark for remark in c.verdict.remarks)
    assert said == (c.known.gaps.rounding.covariance > 1e-4)


def test_what_rounding_hides_is_no_verdict() -> None:
    """With a prior of 1e5 m double precision resolves nothing of the filter's algebra."""
    c = compared(with_prior_of(1e5))
    assert c.verdict.outcome == "unverified"
    assert "double precision resolves" in c.verdict.causes[0].evidence


@pytest.mark.slow
@pytest.mark.parametrize("still_s", [1e4, 86_400.0, 1e6])
def test_a_long_stand_still_is_no_fault_of_the_filter(still_s: float) -> None:
    """The filter forgets where it is: what rounding does is measured on a sound recursion."""
    c = compared(standing_still(simulated(loop_s=20.0), 10.0, still_s))
    assert "algebra" not in {cause.gap for cause in c.verdict.causes}
    assert not c.agreement.algebra.explained_by(c.known.gaps.rounding)
    assert c.agreement.algebra.explained_by(c.known.gaps.algebra_rounding)


@pytest.mark.parametrize("far_m", [5e6, 1e8, 1e9])
def test_an_origin_far_away_is_no_fault_of_the_filter(far_m: float) -> None:
    """Positions are rounded to their distance from the origin; UTM's lose nothing that counts."""
    c = compared(far_away(simulated(loop_s=20.0), far_m))
    assert c.verdict.outcome == "agree"
    assert (
        max(c.agreement.algebra.sigma, c.agreement.model.sigma) < 0.5 * c.known.gaps.rounding.sigma
    )
    assert (far_m == 5e6) == (c.known.gaps.rounding.sigma < 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5002, 5003])
def test_sigmas_near_the_last_place_are_no_fault_of_the_filter(seed: int) -> None:
    """What rounding does to the records and to a sound recursion is measured.

    The gap itself is of the processor: 1e-5 to 2e-3 sigma by OpenBLAS' code for four of them.
    """
    c = compared(fine(simulated(seed, loop_s=12.0)))
    assert not {"algebra", "model"} & {cause.gap for cause in c.verdict.causes}
    assert not c.agreement.algebra.explained_by(c.known.gaps.rounding)
    assert not c.agreement.model.explained_by(c.known.gaps.rounding)
    assert c.agreement.algebra.explained_by(c.known.gaps.algebra_rounding)
    assert c.agreement.model.explained_by(c.known.gaps.model_rounding)
    assert c.known.gaps.algebra_rounding.sigma < 1.0


def test_a_filter_that_rounding_breaks_down_is_not_blamed() -> None:
    """After a day without a measurement sigmas of 1e-7 are lost to rounding: nothing is told."""
    c = compared(fine(standing_still(simulated(5004, loop_s=20.0), 5.0, 86_400.0)))
    assert c.ekf.breakdown
    assert c.verdict.outcome == "unverified"
    assert "double precision resolves" in c.verdict.causes[0].evidence
    assert c.ekf.breakdown in c.verdict.remarks[0]


WRONG: dict[str, tuple[Callable[[], Log], float, int]] = {
    "behind a long stand still": (
        lambda: standing_still(simulated(loop_s=20.0), 10.0, 3e4), 0.98, -60
    ),
    "beside sigmas near the last place": (lambda: fine(simulated(5002, loop_s=12.0)), 0.99, 0),
    "beside a wide prior": (lambda: with_prior_of(1e3), 0.999, 0),
}  # fmt: skip
"""Logs, what is kept of the covariance at an update, and which update it is."""


@pytest.mark.parametrize("where", WRONG)
def test_a_wrong_update_shows(where: str) -> None:
    log, kept, first = WRONG[where]

    class TooSure(Corrupted):
        updates = first

        def corrupt(self) -> None:
            self._covariance *= kept

    c = compared(log(), Modified(with_state(TooSure)))
    assert c.verdict.outcome == "disagree"
    assert c.verdict.causes[0].gap == "algebra"
    assert c.known.gaps.algebra_rounding.covariance < 0.1 * c.agreement.algebra.covariance


def test_ordinary_priors_leave_the_limit_where_it_is() -> None:
    assert compared(simulated(loop_s=20.0)).known.gaps.rounding == EXACT


@pytest.mark.parametrize(
    ("sigmas", "smoother", "line"),
    [
        ((1e6, 1e-7), "batch", "lower the other"),
        ((1e6, 1e6), "isam2", ""),
        ((1e6, 1e6), "batch", ""),
    ],
)
def test_absurd_sigmas_end_in_a_verdict_or_a_line(
    sigmas: tuple[float, float], smoother: str, line: str
) -> None:
    log = first_seconds(simulated(), 5.0)
    count = len(log.measurements.time_s)
    of_range, of_bearing = (np.full(count, sigma) for sigma in sigmas)
    seen = replace(log.measurements, sigma_range_m=of_range, sigma_bearing_rad=of_bearing)
    if line:
        with pytest.raises(InputError, match=line):
            compared(replace(log, measurements=seen), smoother=smoother)
    else:
        found = compared(replace(log, measurements=seen), smoother=smoother)
        assert np.isfinite(found.agreement.optimism)


def test_a_smoother_that_gtsam_gives_up_on_is_told_in_one_line() -> None:
    log = first_seconds(simulated(), 5.0)
    exact = replace(log.odometry, noise=OdometryNoise(0.0, 0.0, 1e-12, 1e-300))  # type: ignore[arg-type]
    with pytest.raises(SingularProblemError) as caught:
        compared(replace(log, odometry=exact), smoother="fixed-lag")
    assert "\n" not in str(caught.value)
