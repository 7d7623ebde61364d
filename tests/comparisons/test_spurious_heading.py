"""What a run says of its heading that nothing measured: cause, result.json, curve."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from comparisons.adapters.smoother_input import recorded_system_of
from comparisons.checks import causes
from comparisons.checks.diagnosis.spurious_heading import (
    LargestShare,
    SpuriousHeading,
    spurious_heading,
)
from comparisons.pipeline.compare import Comparison
from comparisons.report.html.curves import panel_data
from comparisons.report.panels import consistency_panels
from comparisons.report.result import build_result, run_rows
from comparisons.report.rows import spurious_rows
from ekf_reference.core.landmark_types import POINT
from graphslam.spurious import information_about_start
from tests.comparisons.test_ekf_run import initialised_boundless
from tests.comparisons.test_known_landmarks import with_survey
from tests.helpers import compared, present, simulated

EAST = np.array([1.0, 0.0, 0.0])


@cache
def sound() -> Comparison:
    return compared(simulated(seed=3, loop_s=30.0))


def learnt(c: Comparison) -> SpuriousHeading:
    return present(c.spurious_heading)


def test_a_run_says_how_its_information_grew() -> None:
    c = sound()
    found, result = learnt(c), build_result(c).spurious_heading
    assert result is not None
    assert found.total > 1.0
    assert (np.diff(found.information) >= 0.0).all()
    assert found.time_s[0] == c.ekf.estimate.time_s[0]
    assert found.time_s[-1] == c.ekf.estimate.time_s[-1]
    assert result.information == found.total == result.growth[-1]
    assert np.isclose(np.deg2rad(present(result.sigma_deg)), found.total**-0.5, rtol=1e-12)
    assert len(result.time_s) == len(result.growth) <= 101
    begin_s, end_s = result.fastest_s
    assert result.largest is not None
    assert begin_s <= result.largest.time_s <= end_s
    assert result.largest.landmark.startswith("landmark ")
    assert 0.0 < result.largest.information <= result.fastest <= result.information


def test_the_cause_says_it_where_it_matters() -> None:
    c = sound()
    found = SpuriousHeading(
        np.array([0.0, 10.0, 20.0]),
        np.array([0.0, 1.0, np.deg2rad(0.8) ** -2]),
        LargestShare(15.0, "landmark 7", 40.0),
        np.deg2rad(0.2),
    )
    said = causes.linearisation(c.agreement, c.ekf, None, found).evidence
    assert (
        "the filter has learnt its global heading to 0.8 degrees from measurements that cannot "
        "tell it, most from 10.0 to 20.0 s, there with landmark 7 at 15.0 s"
    ) in said
    far = replace(found, heading_sigma_rad=np.deg2rad(0.07))
    assert "learnt" not in causes.linearisation(c.agreement, c.ekf, None, far).evidence
    alone = replace(found, largest=None)
    said = causes.linearisation(c.agreement, c.ekf, None, alone).evidence
    assert said.endswith("from measurements that cannot tell it")


def test_surveyed_landmarks_tell_the_heading() -> None:
    c = compared(with_survey(simulated(seed=2, loop_s=30.0)))
    assert c.spurious_heading is None
    assert build_result(c).spurious_heading is None
    assert consistency_panels(c).learnt is None


def test_the_prior_of_a_landmark_that_is_not_measured_yet_does_not_count() -> None:
    """It would hold it to the world, whose shift would show as well as its turn."""
    c = initialised_boundless(1e2)
    trace, recorded = c.ekf.trace, recorded_system_of(c.ekf)
    weak = int(np.count_nonzero(trace.initialisations[POINT].weight <= 0.0))
    assert weak > 0
    none = np.zeros((3, 3)), np.zeros(0, dtype=np.intp)
    assert information_about_start(recorded, EAST, *none).total > 1e-2
    with_it = information_about_start(recorded, EAST[[1, 2, 0]], *none).total
    assert learnt(c).total < 0.99 * with_it
    alike = learnt(initialised_boundless(1e6)).total
    assert np.isclose(learnt(c).total, alike, rtol=0.05)


def test_a_pose_of_four_entries_is_turned_in_its_own() -> None:
    """Misono's full filter is linearised much like the EKF; without the columns it is not."""
    log = simulated(seed=1, loop_s=40.0)
    usual, full, published = (
        learnt(compared(log, filter=f)).total for f in ("full", "misono-full", "misono")
    )
    assert 0.2 < full / usual < 5.0
    assert published > 10.0 * usual


def test_positions_play_no_part() -> None:
    c = sound()
    assert spurious_heading(c.gaps.recorded, c.ekf) is not None
    told = replace(c.gaps.recorded.positions, a=np.ones((1, 2, 3)), b=np.ones((1, 2)))
    told = replace(told, node=np.array([5]), pose=np.zeros((1, 3)))
    found = present(spurious_heading(replace(c.gaps.recorded, positions=told), c.ekf))
    assert found.total == learnt(c).total


def test_the_curve_starts_where_something_was_learnt() -> None:
    c = sound()
    panel = present(consistency_panels(c).learnt)
    assert panel.logarithmic
    data = panel_data(panel, 0.0)
    spurious, own = data["curves"]
    assert spurious["name"] == "spurious"
    assert spurious["y"][0] is None
    known = [y for y in spurious["y"] if y is not None]
    assert known == sorted(known, reverse=True)
    assert own["name"] == "EKF's own"


def test_the_page_has_its_figures() -> None:
    c = sound()
    result = build_result(c)
    rows = [row for row in run_rows(c, result) if row.group.startswith("Heading learnt")]
    named = ["standard deviation", "grew fastest", "largest share of that"]
    assert [row.quantity for row in rows] == named
    assert rows[0].value == f"{present(result.spurious_heading).sigma_deg:.3g} deg"
    nothing = present(result.spurious_heading).model_copy(update={"sigma_deg": 1e12})
    assert [row.value for row in spurious_rows(nothing)] == ["nothing learnt"]
    assert spurious_rows(None) == []


def test_nothing_learnt_is_not_drawn() -> None:
    c = sound()
    rounding = replace(learnt(c), information=1e-26 * learnt(c).information)
    assert consistency_panels(replace(c, spurious_heading=rounding)).learnt is None
