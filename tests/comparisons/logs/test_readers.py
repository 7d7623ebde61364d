"""Readers on small files made here; every fault names file, line, value and expectation."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from comparisons.errors import InputError
from comparisons.logs.bundled import open_log
from comparisons.logs.odometry import RelativePoses, SteeringOdometry, VelocityOdometry
from comparisons.logs.readers import READERS, read_log
from comparisons.logs.readers.acfr_car_park import reflector_measurements
from comparisons.logs.readers.matlab import load_matlab
from comparisons.logs.scans import Scans
from tests.helpers import present


def assert_refused(path: Path, message: str, format_name: str | None = None) -> None:
    """Reading ends in one line that names the place, with this in it."""
    with pytest.raises(InputError) as caught:
        read_log(path, format_name)
    said = str(caught.value)
    assert path.name in said
    assert message in said
    assert said.isprintable()


GRAPH = """ODOMETRY 0 1 1.0 0.0 0.1 0.01 0 0 0.01 0 0.001
LANDMARK 0 2 3.0 4.0 0.04 0 0.04
ODOMETRY 1 3 1.0 0.0 0.1 0.01 0 0 0.02 0.0001 0.001
LANDMARK 3 2 1.0 3.0 0.04 0 0.04
"""


def graph(folder: Path, text: str = GRAPH) -> Path:
    path = folder / "graph_file.txt"
    path.write_text(text)
    return path


def mrclam(folder: Path) -> Path:
    (folder / "Barcodes.dat").write_text("# Subject Barcode\n1 5\n6 72\n7 25\n")
    (folder / "Landmark_Groundtruth.dat").write_text(
        "6 1.0 2.0 0.001 0.002\n7 3.0 -1.0 0.001 0.001\n"
    )
    (folder / "Robot1_Groundtruth.dat").write_text("1000.0 0.0 0.0 3.1\n1004.0 1.0 0.0 -3.1\n")
    (folder / "Robot1_Odometry.dat").write_text("1001.0 0.1 0.2\n1001.5 0.1 0.3\n1003.0 0 0\n")
    (folder / "Robot1_Measurement.dat").write_text(
        "# Time Barcode r b\n1000.5 72 2.0 0.1\n1002.0 5 1.0 0.0\n1002.0 72 2.0 0.1\n"
        "1002.5 25 3.0 -0.2\n1002.6 99 3.0 -0.2\n"
    )
    return folder


def victoria(folder: Path) -> Path:
    (folder / "measurements.dat").write_text("0.5 10 1.5707963267948966 0.3\n1.5 9 2.0 0.3\n")
    (folder / "inputs.dat").write_text("0.6 1.0 0.1\n1.0 1.0 0.1\n")
    (folder / "gps.dat").write_text("0.0 1.0 2.0\n")
    return folder


def car_park(folder: Path, **changes: object) -> Path:
    ranges = np.full((2, 361), 81.9)
    intensity = np.zeros((2, 361))
    ranges[:, 180:183], intensity[:, 180:183] = 10.0, 1.0
    ranges[0, 300], intensity[0, 300] = 81.91, 1.0
    data: dict[str, object] = {
        "Time_VS": np.arange(10.0, 12.0, 0.1),
        "Velocity": np.full(20, 1.0),
        "Steering": np.zeros(20),
        "TimeLaser": np.array((10.5, 11.0)),
        "Laser": ranges,
        "Intensity": intensity,
        "TimeGPS": np.array((10.1, 10.6, 11.1)),
        "GPSLon": np.array((0.0, 0.0, 0.0)) + 5.0,
        "GPSLat": np.array((0.1, 0.6, 1.1)),
    }
    savemat(folder / "data_set.mat", {**data, **changes})
    savemat(folder / "beac_juan3.mat", {"estbeac": np.array([[5.0, 10.5], [1.0, 2.0]])})
    return folder


def test_graph(tmp_path: Path) -> None:
    log = read_log(graph(tmp_path))
    assert (log.name, log.format) == ("graph-file", "gtsam-2d")
    assert isinstance(log.odometry, RelativePoses)
    expected = [[0.01, 0, 0], [0, 0.02, 0.0001], [0, 0.0001, 0.001]]
    assert np.allclose(log.odometry.covariance[1], expected)
    assert np.allclose(log.measurements.range_m, (5.0, np.sqrt(10.0)))
    assert np.allclose(log.measurements.bearing_rad, (np.arctan2(4, 3), np.arctan2(3, 1)))
    assert np.allclose(log.measurements.sigma_range_m, 0.2)
    assert np.allclose(log.measurements.sigma_bearing_rad, 0.2 / log.measurements.range_m)
    assert log.measurements.time_s.tolist() == [0.0, 2.0]
    assert log.measurements.landmark.tolist() == [2, 2]


def test_mrclam(tmp_path: Path) -> None:
    log = read_log(mrclam(tmp_path))
    assert isinstance(log.odometry, VelocityOdometry)
    assert np.allclose(log.odometry.time_s, (0.18, 0.68, 2.18))
    assert log.measurements.landmark.tolist() == [6, 7]
    depth = log.measurements.range_m * np.cos(log.measurements.bearing_rad)
    assert np.allclose(1.036 * depth, (2.0, 3.0))
    assert np.allclose(log.measurements.time_s, (1.0, 1.5))
    assert np.isclose(present(log.truth.poses).pose[1, 2], 2 * np.pi - 3.1)
    turned = 3.1 + 0.25 * (2 * np.pi - 6.2)
    assert np.allclose(log.prior.pose, (0.25, 0.0, turned))
    assert log.provenance["left_out"].startswith("1 measurements of robots, 1 of unlisted")


def test_victoria_park_detections(tmp_path: Path) -> None:
    log = read_log(victoria(tmp_path))
    assert isinstance(log.odometry, SteeringOdometry)
    assert np.allclose(log.measurements.bearing_rad, (0.0, 2.0 - np.pi / 2))
    assert not log.measurements.labelled
    assert log.prior.time_s == 0.5
    assert log.positions is not None


def test_car_park(tmp_path: Path) -> None:
    log = read_log(car_park(tmp_path))
    assert np.isnan(present(log.scans).range_m[0, 300])
    assert log.measurements.range_m.tolist() == [10.0, 10.0]
    assert np.allclose(log.measurements.bearing_rad, np.deg2rad(0.5))
    assert log.measurements.intensity.tolist() == [1.0, 1.0]
    # North along the GPS track, one metre per second, from y = 0.
    assert np.allclose(log.prior.pose, (5.0, 0.0, np.pi / 2), atol=1e-9)


def test_reflector_runs_part_at_gaps_and_at_range_jumps() -> None:
    angle = np.deg2rad(np.arange(12.0))
    lit = np.zeros((1, 12))
    distance = np.full((1, 12), 8.0)
    lit[0, [0, 1, 4, 8, 9]] = 1.0  # a gap of two dark beams, then of three
    distance[0, 9] = 9.0
    found = reflector_measurements(
        Scans(time_s=np.zeros(1), angle_rad=angle, range_m=distance, intensity=lit)
    )
    assert found.range_m.tolist() == [8.0, 8.0, 9.0]
    assert np.allclose(np.rad2deg(found.bearing_rad), (5 / 3, 8.0, 9.0))


BAD_GRAPH = {
    "nan": (GRAPH.replace("3.0 4.0", "nan 4.0"), ":2: x is 'nan', expected a finite number"),
    "word": (GRAPH.replace("0.001\nL", "oops\nL"), ":1: c22 is 'oops'"),
    "short": (GRAPH.replace(" 0.04\nO", "\nO"), ":2: 6 values after LANDMARK, expected 7"),
    "tag": ("EDGE 1 2\n" + GRAPH, ":1: starts with 'EDGE', expected ODOMETRY or LANDMARK"),
    "unknown pose": (GRAPH.replace("LANDMARK 3", "LANDMARK 8"), ":4: seen from 8"),
    "landmark is a pose": (GRAPH.replace("LANDMARK 3 2", "LANDMARK 3 1"), ":4: landmark 1 is a"),
    "broken chain": (GRAPH.replace("ODOMETRY 1 3", "ODOMETRY 0 3"), ":3: departs from 0"),
    "revisit": (GRAPH.replace("ODOMETRY 1 3", "ODOMETRY 1 0"), ":3: arrives at 0"),
    "indefinite": (
        GRAPH.replace("0.02 0.0001 0.001", "0.02 0.0001 -1"),
        ":3: covariance is not positive definite",
    ),
    "landmark covariance": (
        GRAPH.replace("0.04 0 0.04\nO", "0.04 0 -1\nO"),
        ":2: covariance 0.04 0",
    ),
    "at the sensor": (GRAPH.replace("3.0 4.0", "0 0"), ":2: range_m is 0.0, expected above 0"),
    "endless id": (GRAPH.replace("LANDMARK 0 2 3", "LANDMARK 0 " + "9" * 30 + " 3"), ":2: j is '9"),
    "fraction": (GRAPH.replace("LANDMARK 0 2 3", "LANDMARK 0 2.5 3"), ":2: j is '2.5'"),
    "empty": ("# nothing\n", "expected at least one ODOMETRY"),
}


@pytest.mark.parametrize("name", BAD_GRAPH)
def test_damaged_graphs(name: str, tmp_path: Path) -> None:
    text, message = BAD_GRAPH[name]
    assert_refused(graph(tmp_path, text), message, "gtsam-2d")


EDITS: dict[Callable[[Path], Path], list[tuple[str, str, str, str]]] = {
    mrclam: [
        ("Robot1_Odometry.dat", "1001.5 0.1", "1001.5 x", ":2: v is 'x', expected a finite number"),
        ("Robot1_Odometry.dat", "1003.0", "1001.2", ":3: time 0.200000 s follows 0.500000 s"),
        ("Robot1_Measurement.dat", "25 3.0", "25 -3.0", ":5: range_m is -3.0, expected above 0"),
        ("Landmark_Groundtruth.dat", " 0.002", "", ":1: 4 values, expected 5"),
        ("Landmark_Groundtruth.dat", "7 3.0", "7.5 3.0", ":2: subject is 7.5, expected a whole nu"),
        ("Robot1_Groundtruth.dat", "1000.0 0.0", "1001.5 0.0", ": does not cover the start of the"),
    ],
    victoria: [("measurements.dat", "1.5 9", "1.5 nan", ":2: range is 'nan'")],
}
"""By format: in which file what is replaced, by what, and what is said behind the file's name."""


@pytest.mark.parametrize(
    ("make", "file", "old", "new", "message"),
    [(make, *edit) for make, edits in EDITS.items() for edit in edits],
)
def test_damaged_lines(
    make: Callable[[Path], Path], file: str, old: str, new: str, message: str, tmp_path: Path
) -> None:
    path = make(tmp_path) / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    assert_refused(tmp_path, f"{file}{message}")


@pytest.mark.parametrize(
    ("make", "file", "content", "message"),
    [
        (mrclam, "Robot1_Groundtruth.dat", None, "no such file"),
        (car_park, "beac_juan3.mat", None, "no such file"),
        (car_park, "data_set.mat", b"MATLAB 5.0", "not a MATLAB file"),
        (victoria, "inputs.dat", b"", "holds no records"),
        (victoria, "gps.dat", b"\xff\xfe\x00", "not a text file in UTF-8"),
    ],
)
def test_damaged_files(
    make: Callable[[Path], Path], file: str, content: bytes | None, message: str, tmp_path: Path
) -> None:
    path = make(tmp_path) / file
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    assert_refused(tmp_path, f"{file}: {message}")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"Steering": np.full(20, np.nan)}, "Steering holds a value that is not a finite number"),
        ({"Velocity": np.ones(19)}, "steering odometry: speed_mps has shape"),
        ({"GPSLat": "abc"}, "GPSLat is not numeric"),
        ({"GPSLat": np.zeros(2)}, "GPSLon and GPSLat differ in length"),
        (
            {"TimeGPS": np.array([10.1]), "GPSLon": np.array([5.0]), "GPSLat": np.array([0.1])},
            "positions: the first 6 s do not determine the heading",
        ),
    ],
)
def test_damaged_variables(changes: dict[str, object], message: str, tmp_path: Path) -> None:
    assert_refused(car_park(tmp_path, **changes), f"data_set.mat: {message}")


def test_a_file_without_its_variable(tmp_path: Path) -> None:
    savemat(car_park(tmp_path) / "beac_juan3.mat", {"other": 1.0})
    assert_refused(tmp_path, "beac_juan3.mat: no variable estbeac")


def test_unknown_paths_and_formats(tmp_path: Path) -> None:
    for path in (tmp_path / "missing", Path("waypoint-rum")):
        with pytest.raises(InputError, match="no such file or folder"):
            open_log(str(path))
    with pytest.raises(InputError, match=r"did you mean waypoint-run\?"):
        open_log("waypoint-rum")
    with pytest.raises(InputError, match="format not recognised, expected one of log-folder"):
        read_log(tmp_path)
    with pytest.raises(InputError, match="format 'hdf5' is unknown"):
        read_log(tmp_path, "hdf5")
    for name, said in (
        ("odo.csv", r"odo\.csv: is a CSV file, .*; slamcheck new-log FOLDER --odometry FILE"),
        ("mine.tum", r"mine\.tum: is an estimate, .* slamcheck check LOG --estimate \S*mine\.tum$"),
        ("mine/trajectory.tum", r"mine: is an estimate, .* check LOG --estimate \S*mine$"),
        ("run.trace", r"run\.trace: is a filter's trace, .* say slamcheck audit \S*run\.trace$"),
        ("done/config.toml", r"done: is a folder of results, .*; \S*done/config\.toml repeats"),
    ):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("1 2\n")
        taken = path.parent if "/" in name else path
        with pytest.raises(InputError, match=said):
            read_log(taken)
    assert set(READERS) == {
        *("log-folder", "gtsam-2d", "g2o", "mrclam", "acfr-car-park", "victoria-park"),
        *("aa3", "carmen", "rosbag", "rawlog"),
    }


@pytest.mark.parametrize("name", sorted(READERS))
def test_a_named_format_on_the_wrong_path_is_an_input_error(name: str, tmp_path: Path) -> None:
    """Neither a text file nor an empty folder makes any reader fail otherwise."""
    text = tmp_path / "text.txt"
    text.write_text("hello\n")
    for path in (text, tmp_path):
        with pytest.raises(InputError):
            read_log(path, name)


def test_matlab_files_are_read_as_scipy_reads_them(tmp_path: Path, shared_data: Path) -> None:
    """Every numeric type, compressed or not, small and large, and the real files."""
    rng = np.random.default_rng(0)
    kinds = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "f4", "f8", "bool")
    arrays = {f"{k}_{n}": rng.integers(0, 2, (n, 3)).astype(k) for k in kinds for n in (1, 40)}
    arrays |= {"cube": rng.random((2, 3, 4)), "none": np.zeros((0, 0)), "one": np.array(2.5)}
    for compressed in (False, True):
        path = tmp_path / f"{compressed}.mat"
        savemat(path, arrays, do_compression=compressed)
        assert_as_scipy(path)
    for path in sorted(shared_data.glob("*/*.mat")):
        assert_as_scipy(path)


def assert_as_scipy(path: Path) -> None:
    expected = {name: value for name, value in loadmat(path).items() if name[0] != "_"}
    found = load_matlab(path, tuple(expected))
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert np.array_equal(found[name], value.astype(float)), name
        assert found[name].shape == value.shape
