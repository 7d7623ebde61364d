"""Plot functions draw the result's figures on the axes that they are given."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

import slamcheck
from comparisons.arrays import Array
from comparisons.jobs.run import Comparison
from comparisons.report import panels
from comparisons.report.figures.style import draw_estimate
from comparisons.report.job import report_of
from comparisons.report.ladder import LadderStep
from comparisons.report.marks import ellipses
from comparisons.report.run import RunReport
from comparisons.report.terminal import Summary
from tests.helpers import compared, present, simulated


@pytest.fixture(scope="module")
def run() -> Comparison:
    return compared(simulated(seed=2, loop_s=20.0))


@pytest.fixture
def axis() -> Axes:
    return Figure().add_subplot()


def line(axis: Axes, label: str) -> Array:
    """Return the points (n, 2) of the line of a label."""
    (found,) = (one for one in axis.lines if one.get_label() == label)
    return np.array(found.get_xydata())


def assert_errors(axis: Axes, run: Comparison, row: int, unit: float) -> None:
    """The curve is the error, and the band reaches to three sigma."""
    poses = present(present(run.consistency.ekf).poses)
    expected = np.column_stack((poses.time_s, unit * poses.error[:, row]))
    assert_allclose(line(axis, "EKF - truth"), expected, rtol=1e-12)
    (band,) = (one for one in axis.collections if isinstance(one, PolyCollection))
    edge = np.asarray(band.get_paths()[0].vertices)[:, 1]
    assert edge.max() == pytest.approx(3.0 * unit * poses.sigma[:, row].max(), rel=1e-12)
    assert edge.min() == pytest.approx(-3.0 * unit * poses.sigma[:, row].max(), rel=1e-12)


def test_errors_are_those_of_the_result(run: Comparison) -> None:
    for row, (component, unit) in enumerate(
        (("east", 1.0), ("north", 1.0), ("heading", 180.0 / np.pi))
    ):
        axis = Figure().add_subplot()
        assert slamcheck.plot_errors(run, component, axis) is axis  # type: ignore[arg-type]
        assert_errors(axis, run, row, unit)
    with pytest.raises(slamcheck.InputError, match="'up' is unknown, expected east, north"):
        slamcheck.plot_errors(run, "up")  # type: ignore[arg-type]


def test_a_heading_drawn_in_radians_is_rejected(
    run: Comparison, axis: Axes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Broken variant."""
    monkeypatch.setitem(panels.COMPONENTS, "heading", ("heading [deg]", 1.0))
    slamcheck.plot_errors(run, "heading", axis)
    with pytest.raises(AssertionError):
        assert_errors(axis, run, 2, 180.0 / np.pi)


def test_nees_is_that_of_the_result(run: Comparison, axis: Axes) -> None:
    assert slamcheck.plot_nees(run, axis) is axis
    poses = present(present(run.consistency.ekf).poses)
    assert_allclose(line(axis, "EKF")[:, 1], poses.pose.squared, rtol=1e-12)
    smoothed = present(present(run.consistency.smoother).poses)
    assert_allclose(line(axis, "smoother")[:, 1], smoothed.pose.squared, rtol=1e-12)
    assert not np.allclose(poses.pose.squared, smoothed.pose.squared)  # exchanged ones are seen


def test_two_estimates_are_drawn_by_what_they_differ(run: Comparison) -> None:
    """The band is of the difference, not of either estimate."""
    mine, other = run.ekf.estimate, run.smoothed
    pair = slamcheck.compare_estimates(mine, other)
    axis = slamcheck.plot_errors(pair, "north", Figure().add_subplot())
    assert_allclose(line(axis, "first - second")[:, 1], pair.difference[:, 1], rtol=1e-12)
    (band,) = (one for one in axis.collections if isinstance(one, PolyCollection))
    edge = np.asarray(band.get_paths()[0].vertices)[:, 1].max()
    own, others = mine.pose_covariance[:, 1, 1], other.pose_covariance[:, 1, 1]
    assert edge == pytest.approx(3.0 * np.sqrt((own + others).max()), rel=1e-12)
    assert edge > 3.0 * np.sqrt(own.max()) * (1.0 + 1e-6)
    axis = slamcheck.plot_nees(pair, Figure().add_subplot())
    assert_allclose(line(axis, "first - second")[:, 1], pair.nees, rtol=1e-12)
    bare = slamcheck.ExternalEstimate(time_s=mine.time_s, pose=mine.pose)
    with pytest.raises(slamcheck.InputError, match="no NEES"):
        slamcheck.plot_nees(slamcheck.compare_estimates(bare, other))


def outlines(axis: Axes) -> Array:
    """Return the first ellipses (n, P, 2) that were drawn."""
    first = next(one for one in axis.collections if isinstance(one, LineCollection))
    return np.array(first.get_segments())


def test_a_trajectory_has_ellipses_of_its_covariances(run: Comparison, axis: Axes) -> None:
    estimate = run.ekf.estimate
    assert slamcheck.plot_trajectory(estimate, axis, name="mine") is axis
    assert_allclose(line(axis, "mine trajectory"), estimate.pose[:, :2], rtol=1e-12)
    drawn, covariance = outlines(axis), estimate.pose_covariance[[-1], :2, :2]
    assert len(drawn) == 20
    assert_allclose(drawn[-1], ellipses(estimate.pose[[-1], :2], covariance, 3.0)[0], rtol=1e-12)
    wrong = ellipses(estimate.pose[[-1], :2], covariance, 1.0)[0]  # broken: one sigma
    assert not np.allclose(drawn[-1], wrong, rtol=1e-6, atol=0.0)
    bare = slamcheck.ExternalEstimate(time_s=estimate.time_s, pose=estimate.pose)
    assert not slamcheck.plot_trajectory(bare, Figure().add_subplot()).collections


def test_the_map_holds_both_trajectories(run: Comparison, axis: Axes) -> None:
    assert slamcheck.plot_map(run, axis) is axis
    for name, estimate in (("EKF", run.ekf.estimate), ("smoother", run.smoothed)):
        assert_allclose(line(axis, f"{name} trajectory"), estimate.pose[:, :2], rtol=1e-12)
        assert_allclose(line(axis, f"{name} landmarks, 3 sigma"), estimate.landmark, rtol=1e-12)
    assert "EKF and smoother" in axis.get_title()
    assert {text.get_text() for text in present(axis.get_legend()).get_texts()} == {
        "truth", "true landmarks", "smoother trajectory", "EKF trajectory", "dead reckoning",
        "smoother landmarks, 3 sigma", "EKF landmarks, 3 sigma",
    }  # fmt: skip


def test_fastslam_has_a_look_on_the_map(run: Comparison, axis: Axes) -> None:
    draw_estimate(axis, "FastSLAM", run.smoothed)
    assert len(line(axis, "FastSLAM trajectory")) == len(run.smoothed.pose)


def assert_ladder(axis: Axes, steps: list[LadderStep]) -> None:
    """A row for each gap, in the ladder's order, its disc at the difference of the means."""
    assert len(axis.get_yticks()) == len(steps)
    for row, step in enumerate(steps):
        assert_allclose(line(axis, f"{step.gap} mean"), [[present(step.sigma), row]], rtol=1e-12)
        if step.covariance is not None:
            drawn = line(axis, f"{step.gap} covariance")
            assert_allclose(drawn, [[max(step.covariance, 1e-16), row]], rtol=1e-12)


def test_the_ladder_has_the_gaps_of_the_result(run: Comparison, axis: Axes) -> None:
    steps = list(report_of(run).summary().steps)
    assert slamcheck.plot_ladder(run, axis) is axis
    assert [step.gap for step in steps][:3] == ["algebra", "model", "linearisation"]
    assert_ladder(axis, steps)
    with pytest.raises(AssertionError):  # broken variant: rows in another order
        assert_ladder(axis, steps[::-1])
    top, bottom = axis.get_ylim()[::-1]
    assert top < bottom  # the first gap on top


def test_the_ladder_has_the_limits_that_the_page_has(
    run: Comparison, axis: Axes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None of a gap that passes though it is beyond: rounding explains it."""
    step = LadderStep(gap="algebra", above="EKF", below="linear", sigma=1e-3, limit=1e-6)
    steps = [step, replace(step, sigma=1e-9), replace(step, fails=True)]
    monkeypatch.setattr(RunReport, "summary", lambda _: Summary(headline="", steps=steps))
    slamcheck.plot_ladder(run, axis)
    drawn = (np.array(one.get_xydata()) for one in axis.lines)
    limits = [points[:, 1].mean() for points in drawn if len(points) == 2]
    assert limits == [1.0, 2.0]


def test_what_has_no_such_figures_is_refused(run: Comparison, axis: Axes) -> None:
    with pytest.raises(TypeError, match="has no map"):
        slamcheck.plot_map(run.log, axis)  # type: ignore[arg-type]
