"""Matrices of shares as pictures within the page."""

import base64
import io
import re

import numpy as np
import pytest
from matplotlib.image import imread

from comparisons.arrays import Array
from comparisons.report.html import heat_map


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
