"""`--posterior samples`: draws of the exact posterior judge both Gaussians."""

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.extensions.posterior.extension import (
    GaussianJudgement,
    PosteriorFinding,
    check_posterior,
    fails,
    failures,
    judged,
)
from comparisons.jobs.run import Comparison, compare
from comparisons.report.run import RunReport
from comparisons.settings import run_config
from graphslam.chain_diagnostics import SampledFigure, chain_evidence
from graphslam.sampling import PosteriorComparison, PosteriorDraws
from tests.helpers import first_seconds, present, simulated


@cache
def short() -> Comparison:
    log = first_seconds(simulated(seed=1, loop_s=20.0), 2.5)
    return compare(log, run_config(posterior="samples"))


def finding() -> PosteriorFinding:
    return short().find(PosteriorFinding)


def judgement(coverage: float, least: float) -> PosteriorComparison:
    return PosteriorComparison(
        SampledFigure(coverage, 0.003), SampledFigure(least, 0.02), SampledFigure(1.0, 0.02)
    )


def test_a_short_run_has_an_entry_and_rows() -> None:
    found = short()
    result = RunReport.build(found)
    entry = json.loads(result.model_dump_json())["posterior"]
    assert entry["converged"]
    assert entry["draws"] == 8000
    assert entry["r_hat"] <= 1.01
    assert min(entry["bulk"], entry["tail"]) >= 400
    problem = found.known.gaps.result.problem
    assert entry["unknowns"] == problem.state_dimension
    assert len(entry["moments"]["mean"]) == 3 + 2 * problem.landmark_count
    rows = [row for row in RunReport.of(found).summary().rows if row.group == "Posterior (draws)"]
    assert {row.inside for row in rows} == {True, None}
    assert any(row.quantity.startswith("EKF, last pose") for row in rows)
    assert any(row.quantity.startswith("smoother, whole") for row in rows)


def test_on_a_nearly_linear_run_both_gaussians_hold() -> None:
    check = finding().check
    assert not finding().remarks
    ((name, words),) = finding().lines
    assert name == "posterior"
    assert re.fullmatch(r"95 % ellipsoids hold 9\d % \(EKF\) and 9\d % \(smoother\) .*", words)
    for one in (present(check.smoother), present(check.ekf)):
        assert abs(one.pose.coverage.value - 0.95) < 0.02


def test_a_filter_that_is_overconfident_is_found_out() -> None:
    """The broken variant: half of the filter's sigmas."""
    estimate = short().ekf.estimate
    quarter = replace(estimate, joint_covariance=0.25 * estimate.joint_covariance)
    found = judged(finding().check.posterior, quarter)
    assert fails(found.pose)
    assert found.pose.least.value == pytest.approx(0.25, abs=0.03)
    assert failures(found, estimate.landmark_id)[0] == "the last pose"


def test_what_fails_is_named() -> None:
    good, narrow, flat = judgement(0.95, 1.0), judgement(0.5, 1.0), judgement(0.95, 0.3)
    ids = np.array([4, 7, 9, 11])

    def named(
        pose: PosteriorComparison, whole: PosteriorComparison, *landmarks: PosteriorComparison
    ) -> list[str]:
        return failures(GaussianJudgement(pose, landmarks, whole), ids)

    assert named(good, good, good, good, good, good) == []
    assert named(narrow, good, good, flat, good, good) == ["the last pose", "landmark 7"]
    assert named(good, good, flat, flat, flat, flat) == ["4 of 4 landmarks"]
    assert named(good, flat, good, good, good, good) == ["the last pose and all landmarks together"]


def test_chance_does_not_fail_a_gaussian() -> None:
    near = PosteriorComparison(
        SampledFigure(0.895, 0.003), SampledFigure(0.75, 0.02), SampledFigure(1.0, 0.02)
    )
    assert not fails(near)
    assert fails(replace(near, coverage=SampledFigure(0.885, 0.003)))


def test_without_convergence_nothing_is_judged() -> None:
    draws = np.random.default_rng(0).standard_normal((16, 100, 7))
    draws[0] += 3.0
    stuck = PosteriorDraws(draws=draws, acceptance=0.9, step=1.0, evidence=chain_evidence(draws))
    check = check_posterior(stuck, short().ekf.estimate, short().known.gaps.smoothed)
    assert not check.converged
    assert (check.moments, check.ekf, check.smoother) == (None, None, None)
    rows = PosteriorFinding(check, np.arange(2)).rows()
    assert rows[-1].value == "not converged"
    assert any(row.inside is False for row in rows)
    assert "did not converge: R-hat" in PosteriorFinding(check, np.arange(2)).remarks[0]


def test_a_long_log_is_refused_before_the_smoother_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("comparisons.extensions.posterior.extension.LARGEST_DIMENSION", 30)
    with pytest.raises(InputError, match=r"draws at most 30 unknowns .* not \d+; --end S") as error:
        compare(short().log, run_config(posterior="samples"), no_smoother)
    assert "\n" not in str(error.value)


def no_smoother(stage: str, done: int, total: int) -> None:
    assert "smoother" not in stage, stage


def test_who_does_not_ask_has_none_of_it() -> None:
    assert "posterior" not in run_config().extensions
    assert "posterior" not in run_config(posterior="none").extensions
