from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from comparisons.experiments.reproduction.nieto_regions import (
    DecorrelationExample,
    decorrelation_example,
    draw_displacement,
    draw_example_3_1,
    draw_example_3_2,
)
from comparisons.report.picture import blank, save
from tests.helpers import present, simulated


@cache
def example() -> DecorrelationExample:
    return decorrelation_example(simulated(2, extra_s=10.0))


def legend(axis: Axes) -> set[str]:
    found = present(axis.get_legend())
    return {text.get_text() for text in found.get_texts()}


@pytest.mark.slow
def test_the_decorrelation_is_drawn_as_in_fig_3_5(tmp_path: Path) -> None:
    shown = example()
    figure = blank(9.0, 7.5)
    draw_example_3_1(figure, shown)
    region, base, decorrelation, sigma = figure.axes
    assert legend(region) == {"landmarks", "point $i$ in its region", "to landmark $j$"}
    assert legend(base) == {"L1", "L2", "L3"}
    assert legend(decorrelation) == legend(sigma) == {"in the world", "in its region"}
    lines = [np.asarray(line.get_ydata()) for line in decorrelation.get_lines()]
    assert np.array_equal(lines[0], shown.correlations.world[:, 0, 0])
    assert np.array_equal(lines[3], shown.correlations.local[:, 1, 1])
    save(figure, tmp_path / "decorrelation.png")
    assert (tmp_path / "decorrelation.png").stat().st_size > 20_000


def test_the_change_of_place_is_drawn_as_in_fig_3_12(tmp_path: Path) -> None:
    shown = example()
    figure = blank(9.0, 4.2)
    draw_example_3_2(figure, shown)
    change, wandering = figure.axes
    assert legend(change) == {"in the world", "in its region"}
    assert legend(wandering) == {"estimates", "the first", "truth"}
    save(figure, tmp_path / "displacement.png")
    assert (tmp_path / "displacement.png").stat().st_size > 10_000


def test_what_is_drawn_is_what_is_given() -> None:
    axis = Figure().add_subplot()
    time, world, local = np.arange(3.0), np.array([0.0, 0.3, 0.5]), np.array([0.0, 0.1, 0.05])
    draw_displacement(axis, time, world, local)
    assert [np.asarray(line.get_ydata()).tolist() for line in axis.get_lines()] == [
        world.tolist(),
        local.tolist(),
    ]
