"""What fuzzing, or thinking like it, has found: each is one line that names the file now."""

import gzip
import importlib.util
import io
import os
import tomllib
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from comparisons import archive
from comparisons.errors import InputError
from comparisons.experiments.montecarlo.chunk_files import ChunkFiles, check_folder
from comparisons.experiments.montecarlo.runs import RunRecords
from comparisons.logs.table import parse_toml
from comparisons.trace.recorder import Recorder
from tests.commands import refused
from tests.fuzz.damage import Damage
from tests.fuzz.subjects import BAGS, SUBJECTS, chunk_files
from tests.fuzz.test_hostile_files import assert_one_line, attempt, outcome

NEEDS_BAGS = pytest.mark.skipif(
    not importlib.util.find_spec("rosbags"), reason="the extra ros is missing"
)


def replaced(name: str, file: str, old: str, new: str) -> str:
    """What is said of a subject with a piece of text replaced."""
    subject = SUBJECTS[name]
    with subject.written() as folder:
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new, 1))
        code, reported = outcome(lambda: subject.read(folder))
        assert code == 2, reported
        assert_one_line(code, reported, folder)
        return reported


ENDLESS = "9" * 5000
"""More digits than Python turns into a number."""
REPLACED = {
    ("estimate folder", "estimate.toml"): [
        ("version = 1", f"version = {ENDLESS}", "not valid TOML")
    ],
    ("estimate folder", "landmarks.csv"): [
        ("x_m,y_m\n", "x_m,y_m\n1234,1e200,0\n", "x_m is 1e+200, expected between")
    ],
    ("scenario", "small.toml"): [
        ("steps = 20", f"steps = {ENDLESS}", "not valid TOML"),
        ("ours = [", "ours = [" + "[" * 3000, "not valid TOML"),
        ("lookahead_m = 1.0", "lookahead_m = 1e-8", "m long with a lookahead_m of 1e-08"),
        ("lookahead_m = 1.0", "lookahead_m = 5e-324", "greater than or equal to"),
        ("max_range_m", f"every = {10**30}\nmax_range_m", "sensor.every"),
    ],
    ("baseline", "kept.json"): [
        ('"robot": 1', '"robot": "abc"', "log.robot"),
        (
            '"version": 4',
            '"version": 1, "settings": {"robot": "abc"}',
            "is a baseline of version 1, which slamcheck 0.2 reads",
        ),
        ('"extensions": {}', '"extensions": {"dense_maps": 5}', "extensions.dense_maps"),
        ('"tolerance": 0.0', '"tolerance": Infinity', "not a baseline"),
        ('"log"', f'"{ENDLESS}"', "not a baseline"),
    ],
    ("configuration", "run.toml"): [
        ("[extensions.dynamic]", "[extensions]\ndynamic = 5", "extensions.dynamic is 5"),
        ("[ekf]", f'["{ENDLESS}"]', "is unknown"),
        ("[ekf]", '["one\\ntwo"]', "is unknown"),
        (".dynamic]", f'."{ENDLESS}"]', "is unknown"),
    ],
    ("log folder", "log.toml"): [
        ("time_s = 0.0", "time_s = nan", "time_s is nan"),
        ("[prior]", f"a{'.a' * 50_000} = 1\n[prior]", "a key of more than 64 parts"),
        ("[prior]", f"a = {{a{' . a' * 50_000} = 1}}\n[prior]", "a key of more than 64 parts"),
        ("[prior]", f"[{'a.' * 50_000}a]\n[prior]", "a key of more than 64 parts"),
    ],
}
"""By subject and file: what is replaced, by what, and what is said of it."""


@pytest.mark.parametrize(
    ("name", "file", "old", "new", "message"),
    [(*where, *change) for where, changes in REPLACED.items() for change in changes],
    ids=lambda word: word[:30].replace("\n", " "),
)
def test_hostile_values(name: str, file: str, old: str, new: str, message: str) -> None:
    assert message in replaced(name, file, old, new)


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("log folder", "scans.npz"),
        ("log folder", "measurements.csv"),
        ("aa3", "aa3_lsr2.mat"),
        ("g2o", "graph.g2o"),
        ("estimate folder", "filter.trace"),
        ("baseline", "kept.json"),
    ],
)
@pytest.mark.parametrize("kind", ["pipe", "link to a device"])
def test_what_never_ends_is_not_opened(name: str, file: str, kind: str) -> None:
    attempt(SUBJECTS[name], [Damage(kind, file)])


@NEEDS_BAGS
def test_bags_in_parts_that_never_end_are_not_opened() -> None:
    for file in BAGS["rosbag2, MCAP"].files:
        attempt(BAGS["rosbag2, MCAP"], [Damage("pipe", file)])


@NEEDS_BAGS
def test_a_bag_whose_topic_has_no_name(tmp_path: Path) -> None:
    subject = BAGS["rosbag2, SQLite"]
    subject.write(tmp_path)
    path = tmp_path / "bag" / "metadata.yaml"
    path.write_text(path.read_text().replace("/scan", ""))
    code, reported = outcome(lambda: subject.read(tmp_path))
    assert_one_line(code, reported, tmp_path)


def test_an_archive_larger_than_memory_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.savez_compressed(tmp_path / "a.npz", pose=np.zeros(10_000))
    monkeypatch.setattr(archive, "_MOST_BYTES", 10_000)
    code, reported = outcome(lambda: archive.read_arrays(tmp_path / "a.npz", {"pose": ("N",)}))
    assert code == 2
    assert "bytes unpacked, expected 10000 at most" in reported


def patched(change: Callable[[bytearray, int, int], object]) -> Callable[[bytes], bytes]:
    """An archive with something changed, given its first entry in the directory and its place."""

    def damage(data: bytes) -> bytes:
        changed = bytearray(data)
        change(changed, data.index(b"PK\x01\x02"), data.index(b"PK\x03\x04"))
        return bytes(changed)

    return damage


def packed_as(number: int) -> Callable[[bytes], bytes]:
    def change(data: bytearray, directory: int, entry: int) -> None:
        data[directory + 10] = data[entry + 8] = number

    return patched(change)


def torn(data: bytearray, directory: int, entry: int) -> None:
    data[entry + 120 : entry + 130] = bytes(10)


def encrypted(data: bytearray, directory: int, entry: int) -> None:
    data[directory + 8] |= 1
    data[entry + 6] |= 1


def with_header(text: str, size: int = 0) -> Callable[[bytes], bytes]:
    """The first array of a chunk with another header, and packed zeros for its values."""

    def damage(data: bytes) -> bytes:
        with np.load(io.BytesIO(data)) as kept:
            arrays = dict(kept)
        del arrays["pose_nees"]
        target = io.BytesIO()
        np.savez(target, **arrays)
        line = text.encode("latin-1") + b"\n"
        with zipfile.ZipFile(target, "a", zipfile.ZIP_DEFLATED) as archive:
            header = b"\x93NUMPY\x01\x00" + len(line).to_bytes(2, "little") + line
            archive.writestr("pose_nees.npy", header + bytes(size))
        return target.getvalue()

    return damage


def header_of(descr: str, shape: str) -> str:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}"


CHUNKS: dict[str, Callable[[bytes], bytes]] = {
    "unknown packing": packed_as(99),
    "LZMA": packed_as(14),
    "bzip2": packed_as(12),
    "torn": patched(torn),
    "encrypted": patched(encrypted),
    "open bracket": with_header("{'descr': '<f8', 'shape': ("),
    "deep brackets": with_header("(" * 9000),
    "huge": with_header(header_of("'<f8'", "(10000000000,)"), 800),
    "negative": with_header(header_of("'<f8'", "(-25, -4)"), 800),
    "no bytes each": with_header(header_of("'<U0'", "(25, 4)")),
    "many of nothing": with_header(header_of("'<f8'", f"(0, {10**30})")),
    "objects": with_header(header_of("'|O'", "(25, 4)"), 800),
    "record": with_header(header_of("[('a', '<f8')]", "(25, 4)"), 800),
    "bomb": with_header(header_of("'<f8'", "(3000000,)"), 24_000_000),
    "too short": with_header(header_of("'<f8'", "(25, 4)"), 792),
}


@pytest.mark.parametrize("name", CHUNKS)
def test_a_damaged_chunk_is_computed_again(name: str, tmp_path: Path) -> None:
    subject = SUBJECTS["Monte Carlo chunk"]
    subject.write(tmp_path)
    files = chunk_files(tmp_path)
    assert files.read("ekf", 0) is not None
    path = files.path("ekf", 0)
    path.write_bytes(CHUNKS[name](path.read_bytes()))
    assert files.read("ekf", 0) is None


def test_a_chunk_that_never_ends_is_computed_again(tmp_path: Path) -> None:
    path = chunk_files(tmp_path).path("ekf", 0)
    path.parent.mkdir()
    os.mkfifo(path)
    assert chunk_files(tmp_path).read("ekf", 0) is None


@pytest.mark.parametrize("kind", ["pipe", "link to a device", "folder"])
def test_a_chunk_that_cannot_be_replaced_is_told_before_the_work(kind: str, tmp_path: Path) -> None:
    SUBJECTS["Monte Carlo chunk"].write(tmp_path)
    check_folder(tmp_path)
    Damage(kind, "chunks/ekf-000000.npz").apply(tmp_path)
    with pytest.raises(InputError, match=r"already holds chunks/ekf-000000\.npz"):
        check_folder(tmp_path)


def test_a_chunk_of_another_size_is_of_another_study(tmp_path: Path) -> None:
    other = ChunkFiles(tmp_path, "another", 500)
    other.write("ekf", 0, RunRecords(*np.zeros((len(RunRecords._fields), 25, 500))))
    with pytest.raises(InputError, match="another scenario"):
        chunk_files(tmp_path).read("ekf", 0)


@pytest.mark.parametrize("header", [False, True])
def test_only_what_is_read_is_unpacked(
    header: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Values are unpacked only where header and entry agree on their size."""
    path, small = tmp_path / "a.npz", io.BytesIO()
    np.save(small, np.zeros(10))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as kept:
        kept.writestr("pose.npy", (small.getvalue() if header else b"") + bytes(10_000_000))
    asked = list[int]()
    read = zipfile.ZipExtFile.read

    def watched(entry: zipfile.ZipExtFile, n: int | None = -1) -> bytes:
        asked.append(10**9 if n is None or n < 0 else n)
        return read(entry, n)

    monkeypatch.setattr(zipfile.ZipExtFile, "read", watched)
    code, reported = outcome(lambda: archive.read_arrays(path, {"pose": ("N",)}))
    assert code == 2
    assert ("pose is said to be (10,)" if header else "pose is not an array of numbers") in reported
    assert max(asked) <= 10_000


ZEROS = np.zeros((1500, 1500), dtype=np.uint8)


def packed_arrays(**arrays: np.ndarray) -> Callable[[Path], object]:
    return lambda path: np.savez_compressed(path, allow_pickle=False, **arrays)


def packed_matlab(path: Path) -> None:
    scipy.io.savemat(path, {"LASER": ZEROS}, do_compression=True)


def packed_rawlog(path: Path) -> None:
    path.write_bytes(gzip.compress(gzip.decompress(path.read_bytes()) + bytes(4 * ZEROS.nbytes)))


BEAMS = np.arange(1500.0)
SMALL_AND_LARGE: dict[str, tuple[str, str, Callable[[Path], object], str]] = {
    "another shape": (
        "estimate folder",
        "covariances.npz",
        packed_arrays(last_pose_and_landmarks=ZEROS),
        "last_pose_and_landmarks has shape (1500, 1500), expected (",
    ),
    "a right shape": (
        "log folder",
        "scans.npz",
        packed_arrays(time_s=BEAMS, angle_rad=BEAMS, range_m=ZEROS, intensity=ZEROS),
        "holds 36024000 bytes unpacked, expected",
    ),
    "beams of another number": (
        "log folder",
        "scans.npz",
        packed_arrays(time_s=BEAMS, angle_rad=BEAMS[1:], range_m=ZEROS, intensity=ZEROS),
        "range_m has shape (1500, 1500), expected (1500, 1499)",
    ),
    "matlab": ("aa3", "aa3_lsr2.mat", packed_matlab, "LASER of 18000000 bytes, expected"),
    "rawlog": ("rawlog, packed", "drive.rawlog", packed_rawlog, "bytes unpacked, expected at most"),
}
"""Subject, file, what makes it a small file of much, and what is said."""


@pytest.mark.parametrize("name", SMALL_AND_LARGE)
def test_a_small_file_takes_little_memory(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    subject, file, write, message = SMALL_AND_LARGE[name]
    SUBJECTS[subject].write(tmp_path)
    write(tmp_path / file)
    monkeypatch.setattr(archive, "_SPARE_BYTES", 2**22)
    tracemalloc.start()
    try:
        code, reported = outcome(lambda: SUBJECTS[subject].read(tmp_path))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert code == 2
    assert message in reported
    assert peak < 2**24 + 50 * (tmp_path / file).stat().st_size


def test_memory_that_is_short_is_not_a_damaged_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.savez(tmp_path / "a.npz", pose=np.zeros(10))

    def short(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(np, "frombuffer", short)
    code, reported = outcome(lambda: archive.read_arrays(tmp_path / "a.npz", {"pose": ("N",)}))
    assert (code, reported) == (2, "slamcheck: not enough memory for this log\n")


def twice(folder: Path) -> None:
    path = folder / "landmarks.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, lines[1]]) + "\n")


def dangling(folder: Path) -> None:
    (folder / "trajectory.tum").unlink()
    os.symlink("nowhere", folder / "trajectory.tum")


BEYOND = {
    "reach": (
        ["map", "scan-loop", "--set", "extensions.dense_maps.reach_m=1e300"],
        "less than or equal to 10000",
    ),
    "loops": (["convert", "simulated-loop", "o", "--loops", "1001"], "less than or equal to 1000"),
    "runs": (["baseline", "save", "victoria-park", "k.json", "--runs", "1001"], "1 to 1000"),
    "study": (["montecarlo", "--runs", "9" * 400], "less than or equal to 1000000"),
    "tolerance": (["audit", "a.trace", "--tolerance", "inf"], "tolerance is inf"),
    "deep setting": (["solve", "--set", f"log{'.a' * 2000}=1"], "2001 parts, expected SECTION"),
    "deep value": (["solve", "--set", f"log.seed={{a{'.a' * 2000}=1}}"], "log.seed is '{a.a.a"),
    **{
        f"{workers} workers of {command[0]}": (
            [*command, "--workers", workers],
            f"slamcheck: --workers is {workers}, expected 1 to 1000",
        )
        for command in (["montecarlo"],)
        for workers in ("0", "-1", "1001", "9223372036854775808")
    },
    **{
        f"noise of {' '.join(command)}": ([*command, "--noise-scale", "1e300"], "is 1e+300")
        for log in ("simulated-loop", "waypoint-run", "scan-slam")
        for command in (["run", log], ["convert", log, "o"])
    },
}


@pytest.mark.parametrize("name", BEYOND)
def test_settings_beyond_every_need(name: str, tmp_path: Path) -> None:
    words, message = BEYOND[name]
    said = refused(*words, cwd=tmp_path)
    assert said.startswith("slamcheck: ")
    assert message in said
    assert not list(tmp_path.iterdir())


def test_figures_that_overflow(tmp_path: Path) -> None:
    """They are no result, nor is half of one left."""
    with Recorder(tmp_path / "a.trace") as record:
        record.prior({"a": 1}, [[1e-300]], point=[0.0])
        for _ in range(20):
            record.update("s", [1.0], [[1.0]], [[1e-300]])
            record.snapshot([[1e-300]], error=[1.0])
    said = refused("audit", "a.trace", "--out", "out", cwd=tmp_path)
    assert "numbers of the input are so large that it overflows" in said
    assert [path.name for path in tmp_path.iterdir()] == ["a.trace"]


def test_what_is_nested_too_deep_is_one_line() -> None:
    def deeper() -> None:
        deeper()

    assert outcome(deeper) == (2, "slamcheck: an input is nested too deep\n")


@pytest.mark.parametrize(
    ("text", "sound"),
    [
        ("a.b.c = 'a.b" + ".c" * 100 + "'", True),
        ("a = [" + "1.0, " * 100 + "]\nb = 1.5", True),
        ("a" + ".a" * 64 + " = 1", True),
        ("a" + ".a" * 65 + " = 1", False),
        ("'a'" + ".'a'" * 65 + " = 1", False),
        ("a = " + "[" * 3000, False),
    ],
)
def test_a_key_has_few_parts(text: str, sound: bool) -> None:
    if sound:
        assert parse_toml(text) == tomllib.loads(text)
        return
    with pytest.raises(ValueError, match=r"parts|too deep"):
        parse_toml(text)


@pytest.mark.parametrize(
    ("edit", "message"), [(twice, "appears twice"), (dangling, "trajectory.tum: no such file")]
)
def test_hostile_estimates(edit: Callable[[Path], None], message: str, tmp_path: Path) -> None:
    SUBJECTS["estimate folder"].write(tmp_path)
    edit(tmp_path)
    code, reported = outcome(lambda: SUBJECTS["estimate folder"].read(tmp_path))
    assert code == 2
    assert_one_line(code, reported, tmp_path)
    assert message in reported
