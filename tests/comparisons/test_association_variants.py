"""An association is verified when other ways to make it end at the same place."""

import math
from pathlib import Path

import numpy as np
import pytest
from pydantic import TypeAdapter

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.smoother_association import AlternativeAssociation
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array, Index
from comparisons.checks.association_variants import APART, AssociationCheck, check_association
from comparisons.config import CheckConfig, EkfConfig, SolveConfig
from comparisons.estimates.external import ExternalEstimate
from comparisons.jobs.grading import check_external
from comparisons.logs.log_folder import write_log_folder
from comparisons.pipeline.solve import solve
from comparisons.report.models import SolutionResult
from comparisons.report.solution import SolutionReport
from tests.commands import slamcheck
from tests.helpers import present, simulated, without_labels

LANDMARK_INDEX = np.repeat(np.arange(3), 10)
TIME = np.arange(30.0)
POSES = np.column_stack((np.arange(5.0), np.zeros(5), np.zeros(5)))
COVARIANCE = np.tile(0.01 * np.eye(3), (5, 1, 1))


def split() -> Index:
    """The second landmark's later half becomes a fourth."""
    landmark_index = LANDMARK_INDEX.copy()
    landmark_index[15:20] = 3
    return landmark_index


def at(metres: float) -> Array:
    """All poses so far to the north."""
    return POSES + (0.0, metres, 0.0)


def checked(*others: AlternativeAssociation) -> AssociationCheck:
    return check_association(LANDMARK_INDEX, TIME, (POSES, COVARIANCE, 30.0, 30), others)


def test_another_partition_with_the_same_optimum_does_not_matter() -> None:
    found = checked(AlternativeAssociation("a", split(), at(0.001), 30.0))
    assert found.verified
    assert found.variants[0].disputed == 5
    assert not found.disputes


def test_another_optimum_that_explains_as_much_is_a_dispute() -> None:
    found = checked(AlternativeAssociation("a", split(), at(0.5), 10.0))
    assert not found.verified
    assert found.variants[0].apart_sigma == pytest.approx(0.5 / 0.1 / math.sqrt(3.0))
    assert found.variants[0].apart_m == pytest.approx(0.5)
    (dispute,) = found.disputes
    assert (dispute.landmark, dispute.measurements) == (1, 5)
    assert (dispute.begin_s, dispute.end_s) in ((10.0, 14.0), (15.0, 19.0))
    (remark,) = found.remarks
    assert "with a moves the poses by 0.50 m (2.9 sigma)" in remark
    assert "5 of landmark 1 (" in remark


def test_what_explains_less_speaks_only_with_others() -> None:
    worse = [AlternativeAssociation(name, split(), at(0.5), 300.0) for name in "abc"]
    assert checked(*worse[:2]).verified
    assert not checked(*worse).verified
    nothing = [AlternativeAssociation(name, split(), at(0.0), math.inf) for name in "abc"]
    assert checked(nothing[0]).verified
    assert not checked(*nothing).verified


def test_a_shift_below_the_limit_is_none() -> None:
    limit = APART * 0.1 * math.sqrt(3.0)
    assert checked(AlternativeAssociation("a", split(), at(0.99 * limit), 0.0)).verified
    assert not checked(AlternativeAssociation("a", split(), at(1.01 * limit), 0.0)).verified


def test_measurements_left_out_cost_something() -> None:
    """Broken variants of a comparison by chi-square alone would prefer to use nothing."""
    nobody = np.full(30, -1)
    found = checked(AlternativeAssociation("a", nobody, at(0.5), 0.0))
    assert found.variants[0].excess > 0.0
    assert found.verified


def test_a_check_stands_in_the_result() -> None:
    found = checked(AlternativeAssociation("a", split(), at(0.5), math.inf))
    kept = TypeAdapter(AssociationCheck).dump_python(found)
    assert kept["variants"][0]["apart_sigma"] is None
    assert kept["variants"][0]["elsewhere"]
    assert kept["verified"]


@pytest.mark.slow
def test_a_quiet_log_is_verified_and_a_wrong_association_is_not(tmp_path: Path) -> None:
    """The wrong one: the noise is six times what the log states."""
    good = solve(simulated(0), SolveConfig(association="own"))
    assert good.verified
    result = SolutionReport.build(good)
    assert len(present(result.association_check).variants) == 4
    bad = simulated(1, loops=1, noise_scale=6.0)
    write_log_folder(bad, tmp_path / "noisy")
    done = slamcheck("solve", "noisy", "-v", "--association", "own", "--out", "out", cwd=tmp_path)
    assert done.returncode == 3, done.stdout
    reported = SolutionResult.model_validate_json((tmp_path / "out" / "solution.json").read_text())
    assert reported.verdict == "unverified"
    assert not present(reported.association_check).verified
    assert present(reported.association_check).disputes
    assert "disputed measurements: " in " ".join(done.stdout.split())


@pytest.mark.slow
def test_a_filter_is_not_accused_by_an_association_that_is_in_doubt() -> None:
    """It knew the labels, which the log does not say; the smoother's own may be wrong."""
    labelled = simulated(1, loops=1, noise_scale=6.0)
    timeline, choices = build_timeline(labelled), settle(EkfConfig(), labelled)
    right = run_ekf(labelled, timeline, choices).estimate
    found = check_external(
        ExternalEstimate.of(right), solve(without_labels(labelled), CheckConfig())
    )
    assert found.outcome == "unverified"
    assert found.causes[0].evidence.startswith("the log has no labels, and ")
    assert {one.gap for one in found.causes} == {"oracle"}
