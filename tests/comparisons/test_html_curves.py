"""Curves and matrices on the page: few points, nothing extreme lost, no number that is none."""

import base64
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from comparisons.arrays import Array, Index
from comparisons.report.html import heat_map
from comparisons.report.html.curves import curve_data, data_block, panel_data, short, thinned
from comparisons.report.html.map import ratio_colours
from comparisons.report.marks import MOST_POINTS, Curve, FilledBand, Panel


def spiky(count: int = 50_000) -> Array:
    """A random walk with lone spikes, and gaps."""
    rng = np.random.default_rng(3)
    value = np.cumsum(rng.standard_normal(count))
    value[[17, 20_001, count - 2]] = 1e4, -2e4, 3e4
    value[100:200] = np.nan
    return value


def extremes_held(value: Array, row: Index, reach: int = 100) -> bool:
    """Whether no tenth of the values goes beyond what is kept of it and of `reach` about it."""
    for tenth in np.array_split(np.arange(len(value)), 10):
        kept = value[row[(row >= tenth[0] - reach) & (row <= tenth[-1] + reach)]]
        if np.nanmin(kept) > np.nanmin(value[tenth]) or np.nanmax(kept) < np.nanmax(value[tenth]):
            return False
    return True


def test_thinning_keeps_extremes() -> None:
    value = spiky()
    row = thinned(value)
    assert len(row) <= MOST_POINTS
    assert (np.diff(row) > 0).all()
    assert row[0] == 0
    assert row[-1] == len(value) - 1
    assert extremes_held(value, row)
    every = np.arange(0, len(value), len(value) // MOST_POINTS + 1)
    assert not extremes_held(value, every)  # a broken variant: every n-th point


def test_thinning_keeps_the_extremes_of_both_sides() -> None:
    low, high = -np.abs(spiky()), np.abs(np.roll(spiky(), 777))
    row = thinned(low, high)
    assert len(row) <= MOST_POINTS
    assert extremes_held(low, row)
    assert extremes_held(high, row)


@pytest.mark.parametrize("count", [0, 1, 2, MOST_POINTS])
def test_few_points_stay(count: int) -> None:
    assert np.array_equal(thinned(np.ones(count)), np.arange(count))


def test_figures_keep_four_digits_and_no_more() -> None:
    said = short([0.0, 1.0, -123456.0, 1.23456e-9, np.pi, np.nan, np.inf, 1e300, 5e-324])
    assert said[:7] == [0, 1, -123500, 1.235e-9, 3.142, None, None]
    assert len(json.dumps(said)) < 90


def test_a_panel_counts_time_from_the_start_and_survives_nan() -> None:
    time_s = 1.6e9 + np.arange(5.0)
    bad = np.array((1.0, np.nan, -np.inf, 2.0, 3.0))
    panel = Panel(
        title="</script>", x_label="time [s]", curves=(Curve("'\"", "#000", time_s, bad),),
        bands=(FilledBand(name="b", colour="#000", x=time_s, low=-bad, high=bad),),
        logarithmic=True,
    )  # fmt: skip
    said = panel_data(panel, 1.6e9)
    assert said["curves"][0]["x"] == [0, 1, 2, 3, 4]
    assert said["curves"][0]["y"] == [1, None, None, 2, 3]
    assert "</script>" not in data_block(said).removesuffix("</script>")


def test_a_band_that_is_even_has_half_its_width() -> None:
    """About zero or about a curve; one that is not has both sides."""
    x, y, half = np.arange(4.0), np.array((10.0, 20.0, np.nan, 40.0)), np.array((1.0, 2, 3, np.nan))
    said = panel_data(
        Panel(
            title="t", x_label="time [s]",
            curves=(Curve("a", "#000", x, x), Curve("b", "#000", x, y)),
            bands=(
                FilledBand(name="zero", colour="#000", x=x, low=-half, high=half),
                FilledBand(name="b", colour="#000", x=x, low=y - half, high=y + half, about="b"),
                FilledBand(name="no", colour="#000", x=x, low=0.0 * half, high=half),
            ),
        ),
        0.0,
    )["bands"]  # fmt: skip
    assert (said[0]["half"], said[0]["about"]) == ([1, 2, 3, None], None)
    assert (said[1]["half"], said[1]["about"]) == ([1, 2, None, None], 1)
    assert (said[2]["low"], said[2]["high"]) == ([0, 0, 0, None], [1, 2, 3, None])


def test_where_a_band_is_not_is_said() -> None:
    x, half = np.arange(2000.0), np.where(np.arange(2000) < 1500, np.nan, 1.0)
    band = FilledBand(name="3 sigma", colour="#000", x=x, low=-half, high=half, lack="why")
    panel = Panel(title="t", x_label="lag", curves=(), bands=(band,), lacks=("no NEES",))
    assert panel.lacking == ["no NEES", "no 3 sigma at 1,500 of 2,000 instants: why"]
    assert panel_data(panel, 0.0)["lacks"] == panel.lacking
    assert replace(band, low=x, high=x).gap == ""


def test_a_list_of_x_is_on_the_page_once() -> None:
    time_s, value = np.arange(5.0), np.ones(5)
    panels = [
        Panel(title=title, x_label="time [s]", curves=(Curve("c", "#000", at, value),), bands=())
        for title, at in (("a", time_s), ("b", time_s.copy()), ("c", time_s + 1.0))
    ]
    data = curve_data(panels, 0.0)
    assert [panel["curves"][0]["x"] for panel in data["panels"]] == [0, 0, 1]
    assert data["axes"] == [(0, 1, 2, 3, 4), (1, 2, 3, 4, 5)]


def test_curves_over_the_same_x_are_thinned_together() -> None:
    """The panel's own number of points holds, and no curve loses its extremes."""
    x, first, second = np.arange(50_000.0), spiky(), np.roll(spiky(), 777)
    curves = (Curve("a", "#000", x, first), Curve("b", "#000", x, second))
    data = panel_data(Panel(title="t", x_label="lag", curves=curves, bands=(), points=500), 0.0)
    a, b = data["curves"]
    assert a["x"] == b["x"]
    assert len(a["x"]) <= 500
    assert 3e4 in a["y"]
    assert -2e4 in b["y"]


def test_colours_of_variance_ratios_diverge_at_one() -> None:
    low, right, high, none, negative = ratio_colours(
        np.array([0.01, 1.0, 100.0, np.nan, -1.0]), 2.0
    )
    assert low == "#7f3b08"
    assert right == "#f7f7f7"
    assert high == "#2d004b"
    assert none == negative == "#888888"


def drawn(share: Array) -> Array:
    """What a reader of PNG finds in the page: 1 for black."""
    page = heat_map.heat_maps("Shares", {"EKF": share})
    found = re.search(r"base64,([^\"]+)", page)
    assert found is not None
    grey: Array = 1.0 - imread(io.BytesIO(base64.b64decode(found[1])), format="png")
    return grey


def shares(size: int) -> Array:
    return np.random.default_rng(0).random((size, size))


def test_each_entry_is_a_pixel() -> None:
    share = shares(40)
    assert np.abs(drawn(share) - share).max() <= 0.5 / 255.0 + 1e-6
    assert np.abs(drawn(share.T) - share).max() > 0.5  # broken: rows for columns


def test_of_a_large_matrix_no_peak_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    share = np.zeros((heat_map.MOST_PIXELS + 501, heat_map.MOST_PIXELS + 501))
    share[1007, 12] = 1.0
    found = drawn(share)
    assert found.shape == (651, 651)
    assert np.argwhere(found == 1.0).tolist() == [[503, 6]]
    monkeypatch.setattr(heat_map, "_reduced", lambda given: given[::2, ::2])  # broken: thinned out
    assert not drawn(share).any()


def test_what_is_no_number_is_white_and_the_page_names_the_estimate() -> None:
    assert not drawn(np.full((3, 3), np.nan)).any()
    page = heat_map.heat_maps("Shares", {"EKF": shares(2), "smoother": shares(2)})
    assert page.count("<img ") == 2
    assert "<figcaption>smoother</figcaption>" in page
