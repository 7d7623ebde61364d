from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes

from comparisons.report.picture import blank, save
from research.documents.decorrelation import Displacements
from research.documents.nieto_regions import (
    Examples,
    decorrelation_example,
    draw_3_5,
    draw_3_12,
)
from tests.helpers import present, simulated


@cache
def examples() -> Examples:
    return Examples("a drive", (decorrelation_example(simulated(2, extra_s=10.0)),), (0.0,))


def legend(axis: Axes) -> set[str]:
    found = present(axis.get_legend())
    return {text.get_text() for text in found.get_texts()}


@pytest.mark.slow
def test_the_decorrelation_is_drawn_as_in_fig_3_5(tmp_path: Path) -> None:
    shown = examples().each[0]
    figure = blank(9.0, 7.5)
    draw_3_5(figure, examples())
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
    figure = blank(9.0, 4.2)
    draw_3_12(figure, examples())
    change, wandering = figure.axes
    assert legend(change) == {"in the world", "in its region"}
    assert legend(wandering) == {"estimates", "the first", "truth"}
    save(figure, tmp_path / "displacement.png")
    assert (tmp_path / "displacement.png").stat().st_size > 10_000


def test_what_is_drawn_is_what_is_given() -> None:
    sound, figure = examples(), blank(9.0, 4.2)
    world, local = np.array([0.0, 0.3, 0.5]), np.array([0.0, 0.1, 0.05])
    moved = Displacements(world, local)
    one = replace(sound.each[0], time_s=np.arange(3.0), moved=moved)
    draw_3_12(figure, replace(sound, each=(one,)))
    lines = figure.axes[0].get_lines()
    assert [np.asarray(line.get_ydata()).tolist() for line in lines] == [
        world.tolist(),
        local.tolist(),
    ]
