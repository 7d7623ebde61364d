"""Whether a run with a compressed filter says what it saves (Guivant 2002, section 4)."""

import pytest

from comparisons.checks.compression import CompressionFinding
from comparisons.config import EkfConfig, RunConfig
from comparisons.jobs.run import compare
from comparisons.report.run import RunReport
from tests.helpers import simulated

FULL = "the compressed filter is the full filter here"


def test_a_map_within_one_area_is_said_to_be_the_full_filter() -> None:
    c = compare(simulated(loop_s=20.0), RunConfig(ekf=EkfConfig(filter="compressed")))
    said = c.findings["compression"]
    assert isinstance(said, CompressionFinding)
    assert said.value is not None
    assert (said.value.updates_with_passive, said.value.active_share) == (0, 1.0)
    assert any(remark.startswith(FULL) for remark in c.verdict.remarks)


def test_no_other_filter_is_asked() -> None:
    c = compare(simulated(loop_s=20.0))
    assert c.known.ekf.compression is None
    assert not any(FULL in remark for remark in c.verdict.remarks)
    assert RunReport.build(c).ekf.updates is None


@pytest.mark.slow
def test_a_map_beyond_the_area_leaves_landmarks_passive() -> None:
    """Of the bundled part of Victoria Park some updates, of which the rest is the full filter."""
    from comparisons.logs.bundled import open_log

    c = compare(open_log("victoria-park"), RunConfig(ekf=EkfConfig(filter="compressed")))
    said = c.known.ekf.compression
    assert said is not None
    assert said.updates > said.updates_with_passive > 0.5 * said.updates
    assert 0.3 < said.active_share < 0.8
    assert RunReport.build(c).ekf.updates_with_passive == said.updates_with_passive
    assert not any(FULL in remark for remark in c.verdict.remarks)
