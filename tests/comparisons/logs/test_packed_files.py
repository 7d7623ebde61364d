"""Text files packed by gzip or bzip2, where their suffix says so, are read as they are."""

import bz2
import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.estimates.trajectory_files import read_trajectory_file
from comparisons.logs import table
from comparisons.logs.plain_csv import read_plain
from comparisons.logs.readers import read_log
from graphslam.g2o import read_g2o
from tests.comparisons.logs.test_scan_readers import CARMEN
from tests.graphslam.g2o_files import CLOSED_ELSEWHERE

PACK: dict[str, Callable[[bytes], bytes]] = {".gz": gzip.compress, ".bz2": bz2.compress}
GTSAM = "ODOMETRY 0 1 1 0 0.1 10 0 0 10 0 100\nLANDMARK 0 7 2 1 10 0 10\nLANDMARK 1 7 1 1 10 0 10\n"
LOGS = {"graph.g2o": CLOSED_ELSEWHERE, "drive.clf": CARMEN}


@pytest.mark.parametrize("suffix", PACK)
@pytest.mark.parametrize("name", LOGS)
def test_a_log(tmp_path: Path, name: str, suffix: str) -> None:
    (tmp_path / name).write_text(LOGS[name])
    packed = tmp_path / (name + suffix)
    packed.write_bytes(PACK[suffix](LOGS[name].encode()))
    plain, found = read_log(tmp_path / name), read_log(packed)
    assert (found.name, found.format) == (plain.name, plain.format)
    np.testing.assert_array_equal(found.odometry.time_s, plain.odometry.time_s)
    for field in ("displacement", "covariance"):
        np.testing.assert_array_equal(
            getattr(found.odometry, field), getattr(plain.odometry, field)
        )


@pytest.mark.parametrize("suffix", PACK)
def test_a_trajectory_and_a_table(tmp_path: Path, suffix: str) -> None:
    tum = tmp_path / f"path.tum{suffix}"
    tum.write_bytes(PACK[suffix](b"# time\r\n0 1 2 0 0 0 0 1\r\n1 2 2 0 0 0 0 1\r\n"))
    assert read_trajectory_file(tum).pose[:, 0].tolist() == [1.0, 2.0]
    csv = tmp_path / f"odo.csv{suffix}"
    csv.write_bytes(PACK[suffix](b"time,v,omega\n0,1,0.1\n1,1,0.1\n"))
    assert read_plain(csv, ("time_s", "speed_mps")).columns["speed_mps"].tolist() == [1.0, 1.0]


@pytest.mark.parametrize("suffix", PACK)
@pytest.mark.parametrize("damage", [lambda data: data[:-20], lambda data: b"VERTEX_SE2 0 0 0 0\n"])
def test_a_damaged_one_is_one_line(
    tmp_path: Path, suffix: str, damage: Callable[[bytes], bytes]
) -> None:
    text = "".join(f"{k} {k} {k % 7} 0 0 0 0 1\n" for k in range(999)).encode()
    path = tmp_path / f"path.tum{suffix}"
    path.write_bytes(damage(PACK[suffix](text)))
    with pytest.raises(InputError, match="damaged, or not packed as its suffix says"):
        read_trajectory_file(path)
    graph = tmp_path / f"graph.g2o{suffix}"
    graph.write_bytes(damage(PACK[suffix](CLOSED_ELSEWHERE.encode())))
    with pytest.raises(InputError, match=r"graph\.g2o.*damaged"):
        read_log(graph, "g2o")
    with pytest.raises(InputError, match=r"expected"):
        read_log(graph)


def test_what_has_no_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "_MOST_BYTES", 2**20)
    path = tmp_path / "zeros.tum.gz"
    path.write_bytes(gzip.compress(b"0 " * 2**20))
    with pytest.raises(InputError, match="holds more than 1 MiB, expected fewer"):
        read_trajectory_file(path)
    monkeypatch.setattr("graphslam.g2o._MOST_CHARACTERS", 100)
    graph = tmp_path / "graph.g2o.gz"
    graph.write_bytes(gzip.compress(CLOSED_ELSEWHERE.encode()))
    with pytest.raises(ValueError, match="more than 100 characters"):
        read_g2o(graph)
