"""The map coloured by error, its legend, and the table of statistics beside it."""

import re
from pathlib import Path

import numpy as np
import pytest

from comparisons.jobs.run import Comparison
from comparisons.report.html.drawing import Drawing
from comparisons.report.html.errors import draw_errors, error_colours, error_legends, error_table
from comparisons.report.html.page import page
from comparisons.report.run import RunReport
from comparisons.report.track_errors import TRUTH, TrackErrors, track_errors
from tests.comparisons.browser import noted
from tests.comparisons.test_html_report import contrast
from tests.helpers import altered, compared, simulated


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compared(simulated(loop_s=20.0))


def errors_of(distance: list[float], name: str = "EKF") -> TrackErrors:
    """A path that is off truth by so much, at 0, 1, 2 s and so on."""
    distance_m = np.array(distance)
    turn = np.radians(distance_m)
    rms_m = float(np.sqrt(np.mean(distance_m**2)))
    return TrackErrors(name, TRUTH, np.arange(float(len(distance))), distance_m, turn, rms_m)


def test_the_errors_are_those_of_the_result(comparison: Comparison) -> None:
    result = RunReport.build(comparison)
    assert result.accuracy is not None
    errors = {each.name: each for each in track_errors(comparison.known)}
    assert list(errors) == ["EKF", "smoother", "dead reckoning"]
    assert errors["EKF"].rms_m == result.accuracy.ekf.ate_m
    assert errors["smoother"].rms_m == result.accuracy.smoother.ate_m
    for each in errors.values():
        assert np.sqrt(np.mean(each.distance_m**2)) == pytest.approx(each.rms_m, rel=1e-12)
    text = page(RunReport(comparison, result).page())
    assert f"<td>{errors['EKF'].rms_m:.3g}</td>" in text
    assert re.findall(r'data-name="([^"]*, coloured by [^"]*)"', text) == [
        "EKF, coloured by error", "smoother, coloured by error",
    ]  # fmt: skip


def test_without_truth_the_colours_are_the_difference_from_the_smoother(
    comparison: Comparison,
) -> None:
    known = altered(comparison, "known.findings", {}).known
    (errors,) = track_errors(known)
    apart = comparison.ekf.estimate.pose - comparison.smoothed.pose
    assert (errors.name, errors.reference) == ("EKF", "smoother")
    assert errors.distance_m == pytest.approx(np.hypot(*apart[:, :2].T))
    assert errors.heading_rad.max() == pytest.approx(np.abs(apart[:, 2]).max())
    assert "Difference from the smoother" in error_table([errors])
    assert ">EKF, distance from the smoother<" in error_legends([errors])
    assert track_errors(altered(known, "solved", None)) == ()


def test_each_point_has_the_colour_of_its_error() -> None:
    drawing = Drawing.of(np.zeros((1, 2)))
    draw_errors(drawing, errors_of([0.0, 1.0, np.nan, 2.0]), np.array([-1, 0, 0.5, 1, 2, 3, 4]), 0)
    digits = re.search(r'data-classes="([^"]*)"', drawing.svg())
    assert digits is not None
    assert digits[1] == ".08g.v."  # half of the largest is the middle of 32 colours


def test_the_table_has_evos_statistics() -> None:
    text = error_table([errors_of([1.0, 2.0, 6.0], "<b>")])
    rows = re.findall(r"<tr>(.*?)</tr>", text)
    assert re.findall("<th>(.*?)</th>", rows[0])[1:] == ["mean", "median", "RMS", "max", "std"]
    cells = ["&lt;b&gt;, position [m]", "3", "2", "3.7", "6", "2.16"]
    assert re.findall("<td>(.*?)</td>", rows[1]) == cells
    assert re.findall("<td>(.*?)</td>", rows[2])[1:] == cells[1:]  # degrees
    assert "at 3 instants" in text
    assert error_table([]) == error_legends([]) == ""


def test_each_legend_ends_at_the_paths_largest_error() -> None:
    """Of a path without errors at 1 m."""
    text = error_legends([errors_of([1.0, 8.0]), errors_of([0.0, 0.0], "<b>")])
    first, second = text.split('id="error-legend-')[1:]
    assert re.findall("<text[^>]*>(.*?)</text>", first) == ["0 m", "2 m", "4 m", "6 m", "8 m"]
    assert re.findall("<text[^>]*>(.*?)</text>", second)[-1] == "1 m"
    assert ">&lt;b&gt;, distance from truth<" in second
    assert re.findall('fill="(.*?)"', first) == error_colours()


def test_the_colours_are_seen_on_white_and_on_black() -> None:
    for ground in ("#f6f7f8", "#1c1f23"):
        assert min(contrast(colour, ground) for colour in error_colours()) > 2.4


@pytest.mark.browser
@pytest.mark.slow
def test_the_layer_is_drawn_with_its_legend(comparison: Comparison, tmp_path: Path) -> None:
    report = tmp_path / "report.html"
    report.write_text(page(RunReport.of(comparison).page()), encoding="utf-8")
    steps = """
    const legend = document.getElementById('error-legend-0');
    noted.before = legend.hidden;
    const label = [...document.querySelectorAll('#layers label')]
      .find(one => one.textContent === 'EKF, coloured by error');
    label.querySelector('input').click();
    noted.after = legend.hidden;
    const group = document.querySelector('[data-of=EKF]');
    noted.shown = group.parentNode.getAttribute('display');
    noted.colours = [...group.children].map(one => one.getAttribute('stroke'));
    noted.pieces = [...group.children].map(one => one.getAttribute('d').split('M').length - 1);
    label.querySelector('input').click();
    noted.again = legend.hidden;
    """
    found = noted(report, tmp_path, steps)
    assert (found["before"], found["after"], found["again"]) == (True, False, True)
    assert found["shown"] is None
    assert set(found["colours"]) <= set(error_colours())
    assert len(found["colours"]) > 5
    assert sum(found["pieces"]) > 0.9 * len(comparison.ekf.estimate.pose)
