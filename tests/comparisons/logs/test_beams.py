"""Scans of 180 beams beside 181: the beam that is missing is no return, and all are counted."""

from pathlib import Path

import numpy as np
import pytest

from comparisons.logs.readers import read_log
from comparisons.logs.readers.beams import BeamGrid
from tests.comparisons.logs.rawlogs import action, frame, rawlog, sweep
from tests.comparisons.logs.test_scan_readers import carmen, flaser
from tests.helpers import present

DEGREE = np.pi / 180
WIDE = DEGREE * np.arange(-90.0, 91.0)


@pytest.mark.parametrize("first", [180, 181])
def test_carmen(tmp_path: Path, first: int) -> None:
    beams = [first, 361 - first, 180]
    lines = [flaser(float(k), 0.1 * k, beams=count) for k, count in enumerate(beams)]
    log = read_log(carmen(tmp_path, "".join(lines)), "carmen")
    scans = present(log.scans)
    assert np.allclose(scans.angle_rad, WIDE)
    assert scans.range_m.shape == (3, 181)
    short = np.array(beams) == 180
    assert np.isnan(scans.range_m[short, -1]).all()
    assert (scans.range_m[:, 3:180] == 3.0).all()
    assert (scans.range_m[~short, 180] == 3.0).all()
    assert log.provenance["scans"] == (
        f"FLASER lines; {short.sum()} of 3 scans have 180 beams of 181: the others are no returns"
    )


def test_bag(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from tests.comparisons.logs.bags import EPOCH, T

    ranges = np.array((1.0, 2.0, 3.0, 4.0, 5.0), np.float32)
    messages = [
        T.laser(EPOCH + k, ranges=ranges[:count], intensities=ranges[:count])
        for k, count in enumerate((4, 5, 4, 4))
    ]
    log = read_log(T.write(tmp_path / "bag", messages))
    scans = present(log.scans)
    assert np.array_equal(scans.range_m[1], ranges)
    assert np.array_equal(scans.range_m[[0, 2, 3], :4], np.tile(ranges[:4], (3, 1)))
    assert np.isnan(scans.range_m[[0, 2, 3], 4]).all()
    assert scans.intensity[0, 4] == 0.0
    assert log.provenance["LaserScan"] == (
        "/scan, 4 messages; 3 of 4 scans have 4 beams of 5: the others are no returns"
    )


def test_rawlog_counts_add_up(tmp_path: Path) -> None:
    """Of 12 scans 4 are of another scanner: they are counted as left out."""
    here, aside = 5 * [1.0], 5 * [1.0]
    parts = []
    for k in range(8):
        parts.append(frame(sweep(here, label="front"), *[sweep(aside, label="rear")] * (k % 2)))
        parts.append(action((1, 0, 0)))
    log = read_log(rawlog(tmp_path, b"".join(parts[:-1])))
    assert len(present(log.scans).time_s) == 8
    assert log.provenance["scans"] == "8 of 12 CObservation2DRangeScan (front)"
    assert log.provenance["left_out"].endswith("4 scans of another scanner, or repeated")


def test_beams_that_are_no_row_of_the_others_are_refused() -> None:
    grid = BeamGrid(WIDE)
    assert grid.take(WIDE[:-1])
    assert grid.take(WIDE[1:])
    assert grid.take(WIDE[30:90])
    assert not grid.take(WIDE[::2])
    assert not grid.take(WIDE[::-1])
    assert not grid.take(WIDE + 0.5 * DEGREE)
    assert grid.take(DEGREE * np.arange(-95.0, 91.0))
    assert len(grid.angle_rad) == 186
    found = grid.filled(WIDE[1:], np.arange(180.0))
    assert np.isnan(found[:6]).all()
    assert np.array_equal(found[6:], np.arange(180.0))
    with pytest.raises(ValueError, match="whose beams are not the grid's"):
        grid.filled(WIDE[:9] + 0.5 * DEGREE, np.zeros(9))
