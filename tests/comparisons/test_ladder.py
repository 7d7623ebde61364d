"""The ladder of gaps: which estimates it joins, what passes, and the picture of it."""

import re
from dataclasses import replace

import pytest

from comparisons.jobs.run import Comparison
from comparisons.report.check import EXTERNAL, check_ladder
from comparisons.report.html.ladder import ladder_picture
from comparisons.report.ladder import (
    EKF,
    LINEAR,
    LINEAR_MODEL,
    OWN_ASSOCIATION,
    SMOOTHER,
    TRUTH,
    LadderStep,
    gap_steps,
    ladder,
)
from comparisons.report.models import Result
from comparisons.report.run import RunReport
from comparisons.words import Cause
from tests.helpers import compared, present, simulated


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compared(simulated(seed=2, loop_s=20.0), smoother_association="own")


@pytest.fixture(scope="module")
def result(comparison: Comparison) -> Result:
    return RunReport.build(comparison)


def caused(result: Result, gap: str) -> Result:
    cause = Cause(gap=gap, evidence="x", hint="y")
    return result.model_copy(update={"causes": [cause], "verdict": "disagree"})


def places(text: str, kind: str) -> list[float]:
    """Where marks of a kind lie, from left to right in the order of the gaps."""
    found = re.findall(rf'<circle class="{kind} [a-z-]+" cx="([\d.]+)"', text)
    return [float(x) for x in found]


def test_estimates_follow_each_other_from_the_filter_to_the_truth(result: Result) -> None:
    """The smoother with its own association branches off; the truth follows the smoother."""
    steps = ladder(result)
    assert [step.gap for step in steps] == [
        "algebra", "model", "linearisation", "association", "truth",
    ]  # fmt: skip
    assert [step.below for step in steps] == [
        LINEAR, LINEAR_MODEL, SMOOTHER, OWN_ASSOCIATION, TRUTH,
    ]  # fmt: skip
    assert [step.above for step in steps] == [EKF, LINEAR, LINEAR_MODEL, SMOOTHER, SMOOTHER]
    assert {step.state for step in steps} == {"passes"}
    assert steps[3].sigma == result.model_dump()["own_association"]["pose_distance_sigma"]


def test_a_gap_behind_a_wrong_filter_is_not_judged(result: Result) -> None:
    """Nor is one to an optimum that is not verified; both would count in a broken variant."""
    states = {step.gap: step.state for step in ladder(caused(result, "model"))}
    assert states["algebra"] == "passes"
    assert states["model"] == "fails"
    assert states["linearisation"] == "not judged"
    open_end = gap_steps(result.agreement, (), verified=False, first=EXTERNAL)
    assert [step.state for step in open_end] == ["passes", "passes", "not judged"]
    assert open_end[0].above == EXTERNAL


def test_the_picture_says_in_words_what_it_shows(result: Result) -> None:
    text = ladder_picture(ladder(caused(result, "linearisation")))
    words = present(re.search(r"<desc[^>]*>(.*?)</desc>", text))
    assert words[1].count("passes") == 4
    assert "Linearisation gap, linear problem, smoother&#x27;s factors to smoother" in words[1]
    assert text.count('class="box"') == 6
    assert text.count('class="state fails"') == 1
    assert not re.search(r"nan|inf\b|style=", text)


def test_marks_lie_on_one_scale(result: Result) -> None:
    """A larger gap is farther right, whichever it is; nothing leaves the picture."""
    step = ladder(result)[0]
    sizes = (0.0, 1e-12, 1e-7, 1e-3, 1.0, 1e40, float("inf"))
    text = ladder_picture([replace(step, sigma=size, covariance=None) for size in sizes])
    found = places(text, "mean")
    assert found == sorted(found)
    assert len(set(found)) == 6  # the last two lie on the end
    assert 0.0 < found[0] < found[-1] < 360.0


def test_a_limit_is_drawn_only_where_it_explains_the_outcome() -> None:
    """A filter that is conservative on purpose passes with more than rounding."""
    step = LadderStep(gap="algebra", above=EKF, below=LINEAR, sigma=1e-3, limit=1e-6)
    key = ladder_picture([replace(step, sigma=1e-9)]).count('class="limit"') - 1
    assert key == 1
    assert ladder_picture([step]).count('class="limit"') == 1
    assert ladder_picture([replace(step, fails=True)]).count('class="limit"') == 2
    assert step.deciding is None
    for other in (replace(step, sigma=1e-9), replace(step, fails=True)):
        assert other.deciding == 1e-6
    assert replace(step, judged=False).deciding == 1e-6
    assert replace(step, sigma=None).deciding is None


def test_nothing_is_drawn_of_nothing() -> None:
    assert ladder_picture([]) == ""


def test_a_grade_does_not_need_the_linearisation(result: Result) -> None:
    """An external filter like the reference passes far from the optimum: the gap is not judged."""
    trace = replace(result.agreement, linearisation_gap_sigma=2.2)

    class Check:
        causes: tuple[Cause, ...] = ()
        smoother = result.smoother

    found = Check()
    found.trace = trace  # type: ignore[attr-defined]
    assert [step.state for step in check_ladder(found)] == [  # type: ignore[arg-type]
        "passes", "passes", "not judged",
    ]  # fmt: skip
    found.causes = (Cause(gap="linearisation", evidence="x", hint="y"),)
    assert check_ladder(found)[-1].state == "fails"  # type: ignore[arg-type]


def test_an_infinite_gap_lies_on_the_scale_and_an_unknown_one_does_not() -> None:
    step = LadderStep(gap="algebra", above=EXTERNAL, below=LINEAR, sigma=None, fails=True)
    text = ladder_picture([step])
    assert "infinite" in text
    assert places(text, "mean") == [348.0]
    text = ladder_picture([replace(step, fails=False, judged=False)])
    assert "unknown: needs the joint covariance" in text
    assert places(text, "mean") == []


def test_a_long_name_stays_in_its_box() -> None:
    name = "EKF with sequential (one landmark at a time) updates"
    step = LadderStep(gap="reference", above=EXTERNAL, below=name, sigma=1.0)
    assert re.search(rf'textLength="\d+"[^>]*>{re.escape(name)}<', ladder_picture([step]))
    assert "textLength" not in ladder_picture([replace(step, below="reference EKF")])
