"""The C++ header records what a filter does, as the Python recorder does of the same filter."""

import random
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.audit.algebra import faults_of
from comparisons.audit.audit import audit
from comparisons.errors import InputError
from comparisons.trace.events import Event, Snapshot, Update
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import Recorder
from comparisons.trace.wrapping import record
from tests.helpers import present
from tests.processes import compiled, ran, works

CPP = Path(__file__).resolve().parents[2] / "cpp"
Build = Callable[..., Path]


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Compile a program beside the header, with a piece of the header replaced."""
    folder, uses = tmp_path_factory.mktemp("probe"), "#include <sqlite3.h>\nint main() {}\n"
    header = CPP / "slamcheck_recorder.hpp"
    try:
        compiled(folder, uses, header)
    except AssertionError:
        pytest.skip("no sqlite3.h (Debian: libsqlite3-dev)")

    def built(source: str, old: str = "", new: str = "", *, raw: bool = False) -> Path:
        how = "-DSLAMCHECK_NO_SQLITE" if raw else "-lsqlite3"
        folder = tmp_path_factory.mktemp("cpp")
        return compiled(folder, source, header, "-Wconversion", how, old=old, new=new)

    return built


@pytest.fixture(scope="module")
def example(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The trace that cpp/example.cpp records."""
    program = build((CPP / "example.cpp").read_text())
    trace = tmp_path_factory.mktemp("example") / "cpp.trace"
    works(program, trace)
    return trace


def faults(one: Event, other: Event) -> list[str]:
    """Names of the fields in which two events differ by more than rounding."""
    if type(one) is not type(other):
        return [f"{one!r} and {other!r}"]
    found = []
    for name, a, b in zip(one._fields, one, other, strict=True):
        if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
            same = a.shape == b.shape and bool(np.allclose(a, b, rtol=1e-9, atol=1e-12))
        else:
            same = a == b
        if not same:
            found.append(f"event {one.number}: {name}")
    return found


def differences(one: Path, other: Path) -> list[str]:
    return [
        fault
        for a, b in zip(TraceReader(one), TraceReader(other), strict=True)
        for fault in faults(a, b)
    ]


@pytest.fixture(scope="module")
def raw(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same without SQLite."""
    program = build((CPP / "example.cpp").read_text(), raw=True)
    trace = tmp_path_factory.mktemp("raw") / "cpp.events"
    works(program, trace)
    done = ran(program, trace.with_suffix(".trace"))
    assert "expected a name that ends in .events, for there is no SQLite" in done.stderr
    return trace


@pytest.mark.slow
def test_a_recording_without_sqlite_is_the_same(example: Path, raw: Path) -> None:
    assert TraceReader(raw).sensors == TraceReader(example).sensors
    assert TraceReader(raw).counts == TraceReader(example).counts
    assert differences(example, raw) == []


@pytest.mark.slow
def test_a_recording_without_sqlite_is_read_to_its_last_batch(raw: Path, tmp_path: Path) -> None:
    """Cut off anywhere, or with any byte changed: whole batches, or a refusal in one line."""
    whole, short = raw.read_bytes(), tmp_path / "short.events"
    assert TraceReader(raw).remarks == ()
    short.write_bytes(whole[:-1])
    (said,) = TraceReader(short).remarks
    assert said.startswith("short.events ends within a batch, as where its recording was killed")
    for length in range(0, len(whole), len(whole) // 97):
        short.write_bytes(whole[:length])
        with pytest.raises(InputError):
            list(TraceReader(short))
    draw, refused = random.Random(5), []  # noqa: S311
    for _ in range(300):
        damaged = bytearray(whole)
        damaged[draw.randrange(300)] = draw.randrange(256)
        short.write_bytes(damaged)
        try:
            list(TraceReader(short))
        except InputError as error:
            refused.append(str(error))
    assert len(refused) > 100
    assert all(one.isprintable() for one in refused)


def test_the_example_is_a_sound_filter(example: Path) -> None:
    """It rejects the wrong range alone, and its errors are as large as it says."""
    found = audit(example)
    assert found.sound
    assert found.gains_compared > 50
    assert present(found.largest_gap).worst < 1e-9
    assert TraceReader(example).sensors == {"beacon": (0.99, ("range", "bearing"))}
    assert TraceReader(example).counts == (436, 75, 30)
    events = list(TraceReader(example))
    rejected = [event.time_s for event in events if isinstance(event, Update) and not event.used]
    assert rejected == pytest.approx([15.0])
    nees = [
        event.error @ np.linalg.solve(event.covariance, event.error)
        for event in events
        if isinstance(event, Snapshot) and event.error is not None
    ]
    assert len(nees) == 15
    assert 1.5 < np.mean(nees) < 8.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("matrix(i, j)", "matrix(j % matrix.rows(), i % matrix.cols())"),
        ("ones[k - 1]->data() + 8 * i, 8) == 0", "ones[k - 1]->data() + 8 * i, 8) != 0"),
    ],
    ids=["transposed", "repeated wrongly"],
)
def test_a_wrong_header_is_noticed(
    build: Build, example: Path, tmp_path: Path, old: str, new: str
) -> None:
    """Soon: by the algebra of the first events, or because they cannot be read."""
    program = build((CPP / "example.cpp").read_text(), old, new)
    works(program, tmp_path / "wrong.trace")
    assert faults_of(list(TraceReader(example))[:20], 1e-9) == ()
    try:
        found = faults_of(list(TraceReader(tmp_path / "wrong.trace"))[:20], 1e-9)
    except ValueError as error:
        found = (str(error),)
    assert found


WRAPPED = r"""
#include "slamcheck_recorder.hpp"
using namespace slamcheck;

// A body with drag, of which the square of its position is measured.
class Drag {
 public:
  Vector x() const { return {p, v}; }
  Matrix P() const { return {{pp, pv}, {pv, vv}}; }
  Matrix F(double dt) const { return {{1.0, dt}, {0.0, 1.0 - 0.2 * dt * v}}; }
  Matrix Q(double dt) const { return {{0.0, 0.0}, {0.0, 0.1 * dt}}; }
  Matrix H(double) const { return {{2.0 * p, 0.0}}; }
  Matrix R(double) const { return {{0.25}}; }
  Vector residual(double z) const { return {z - p * p}; }
  void predict(double dt) {
    const double f = 1.0 - 0.2 * dt * v;
    p += dt * v;
    v -= 0.1 * dt * v * v;
    pp += 2.0 * dt * pv + dt * dt * vv;
    pv = f * (pv + dt * vv);
    vv = f * f * vv + 0.1 * dt;
  }
  bool update(double z) {
    const double h = 2.0 * p, s = h * h * pp + 0.25, nu = z - p * p;
    const double a = pp * h / s, b = pv * h / s;
    p += a * nu;
    v += b * nu;
    vv -= b * h * pv;
    pv -= a * h * pv;
    pp -= a * h * pp;
    return true;
  }

 private:
  double p = 1.0, v = 3.0, pp = 0.5, pv = 0.0, vv = 0.5;
};

// The same, with its state as members.
struct Open {
  Vector x = inner().x();
  Matrix P = inner().P();
  Drag filter;
  static Drag inner() { return {}; }
  Matrix F(double dt) const { return filter.F(dt); }
  Matrix Q(double dt) const { return filter.Q(dt); }
  Matrix H(double z) const { return filter.H(z); }
  Matrix R(double z) const { return filter.R(z); }
  Vector residual(double z) const { return filter.residual(z); }
  void predict(double dt) { filter.predict(dt); keep(); }
  void update(double z) { filter.update(z); keep(); }
  void keep() { x = filter.x(); P = filter.P(); }
};

int main(int, char** words) {
  Drag drag;
  Open open;
  Recorded filter(drag, words[1], {{"position", 1}, {"speed", 1}}, {{"square", 0.99, {}}});
  Recorded other(open, words[2]);
  for (int step = 1; step <= 20; ++step) {
    filter.record.at(0.1 * step);
    filter.predict(0.1);
    other.predict(0.1);
    if (step % 4 == 0) {
      if (!filter.update("square", 2.0 * step)) return 1;
      other.update("square", 2.0 * step);
    }
  }
  filter.record.close();
}
"""


class Drag:
    """The same filter."""

    def __init__(self) -> None:
        self.x, self.P = np.array([1.0, 3.0]), np.diag([0.5, 0.5])

    def F(self, dt: float) -> Array:  # noqa: N802
        return np.array([[1.0, dt], [0.0, 1.0 - 0.2 * dt * self.x[1]]])

    def Q(self, dt: float) -> Array:  # noqa: N802
        return np.diag([0.0, 0.1 * dt])

    def H(self, z: float) -> Array:  # noqa: N802
        return np.array([[2.0 * self.x[0], 0.0]])

    def R(self, z: float) -> Array:  # noqa: N802
        return np.array([[0.25]])

    def residual(self, z: float) -> Array:
        return np.array([z - self.x[0] ** 2])

    def predict(self, dt: float) -> None:
        f = self.F(dt)
        self.x = self.x + [dt * self.x[1], -0.1 * dt * self.x[1] ** 2]
        self.P = f @ self.P @ f.T + self.Q(dt)

    def update(self, z: float) -> None:
        h, nu = self.H(z), self.residual(z)
        gain = self.P @ h.T / (h @ self.P @ h.T + 0.25)
        self.x = self.x + gain @ nu
        self.P = self.P - gain @ h @ self.P


@pytest.fixture(scope="module")
def wrapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `slamcheck.record` of Python writes of it."""
    path, drag = tmp_path_factory.mktemp("wrapped") / "python.trace", Drag()
    with record(drag, path, blocks={"position": 1, "speed": 1}, sensor="square") as recorder:
        for step in range(1, 21):
            recorder.at(0.1 * step)
            drag.predict(0.1)
            if step % 4 == 0:
                drag.update(2.0 * step)
    return path


@pytest.mark.slow
def test_a_cpp_filter_is_recorded_without_a_change_in_it(
    build: Build, wrapped: Path, tmp_path: Path
) -> None:
    here, other = tmp_path / "methods.trace", tmp_path / "members.events"
    works(build(WRAPPED), here, other)
    assert differences(here, wrapped) == []
    assert TraceReader(here).sensors == {"square": (0.99, ())}
    assert TraceReader(here).counts == TraceReader(other).counts == (52, 5, 26)
    audited = audit(here)
    assert present(audited.largest_gap).worst < 1e-9
    for one, of_members in zip(TraceReader(here), TraceReader(other), strict=True):
        assert of_members.time_s is None
        if isinstance(one, Snapshot):
            assert isinstance(of_members, Snapshot)
            np.testing.assert_array_equal(of_members.covariance, one.covariance)
            assert of_members.blocks == ("state",)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("about.after = state();", "about.point = about.after = state();"),
        ("added[i] -= about", "added[i] += about"),
    ],
    ids=["its point is where it leads", "no correction"],
)
def test_a_filter_that_is_recorded_wrongly_is_noticed(
    build: Build, wrapped: Path, tmp_path: Path, old: str, new: str
) -> None:
    here = tmp_path / "wrong.trace"
    program = build(WRAPPED, old, new)
    works(program, here, tmp_path / "members.events")
    assert differences(here, wrapped)


CALLS = r"""
#include <cstdlib>
#include <functional>
#include <iostream>
#include "slamcheck_recorder.hpp"
using namespace slamcheck;

int main(int, char** words) {
  const std::string path = words[1];
  Recorder record(path, {{"g/\"\\\n\xc3\xa9", {}, {"x"}}});
  const Matrix P{{2.0, 0.5}, {0.5, 1.0}}, one{{1.0}};
  const auto refused = [](const std::function<void()>& call) {
    try {
      call();
      std::cout << "accepted\n";
    } catch (const std::runtime_error& error) {
      std::cout << error.what() << "\n";
    }
  };
  refused([&] { Recorder again(path); });
  refused([&] { Recorder again(path + "/no/folder"); });
  refused([&] { Recorder again(path + "2", {{"gps", 1.5, {}}}); });
  refused([&] { record.predict(one, one); });
  refused([&] { record.prior({{"a", 1}, {"a", 1}}, P); });
  refused([&] { record.prior({{"a", 30000}}, P); });
  refused([&] { record.prior({{"a", 1}, {"b", 2}}, P); });
  refused([&] { record.prior({{"a\xff", 2}}, P); });
  record.prior({{"a", 1}, {"\xe6\x98\x9f'\"/", 1}}, P);
  refused([&] { record.prior({{"a", 1}}, one); });
  refused([&] { record.predict(P, one); });
  refused([&] { record.predict(P, P, {"a", "a"}); });
  refused([&] { record.predict(P, P, {"c"}); });
  refused([&] { record.update("gps", {1.0, 2.0}, {{1.0, 0.0}}, one); });
  refused([&] { record.update("gps", {}, {{1.0, 0.0}}, one); });
  refused([&] { record.update("gps", {1.0}, {{1.0, 0.0}}, one, {}, {1.0}); });
  refused([&] { record.update("gps", {1.0}, {{1.0, 0.0}}, one, {}, {1.0, 2.0}, one); });
  refused([&] { record.augment("a", P, P, P); });
  refused([&] { record.augment("c", one, P, P); });
  refused([&] { record.clone("a", "a"); });
  refused([&] { record.clone("c", "d"); });
  refused([&] { record.remove({"a", "\xe6\x98\x9f'\"/"}); });
  refused([&] { record.remove({}); });
  refused([&] { record.reset(one); });
  refused([&] { record.snapshot(P, {"a"}); });
  refused([&] { record.snapshot(P, {}, {}, {1.0}); });
  refused([&] { record.directions({{"turn", {1.0}}}, {"gps"}); });
  refused([&] { record.directions({{"turn", {1.0, 0.0}}}, {}); });
  refused([&] { record.at(std::numeric_limits<double>::quiet_NaN()); });
  refused([&] { Matrix{{1.0}, {1.0, 2.0}}; });
  record.at(1.5);
  record.directions({{"turn", {1.0, 2.0}}, {"shift", std::vector<double>{3.0, 4.0}}}, {"gps"});
  record.augment("c", {{3.0}, {4.0}}, {{1.0, 0.0}, {0.0, 1.0}}, P, {"a"});
  record.reset({{7.0}}, {"a"});
  refused([&] { record.renew("a", P); });
  record.renew("c", P);
  record.clone("c", "d");
  record.update("g/\"\\\n\xc3\xa9", {0.5}, {{1.0}}, one, {"a"});
  record.remove({"a", "d"});
  record.snapshot({{5.0}}, {"\xe6\x98\x9f'\"/"}, {1.0, 2.0, 3.0});
  record.close();
  refused([&] { record.reset(one, {"c"}); });
}
"""
SAID = """
: exists already, or cannot be written; give a new name
/no/folder: exists already, or cannot be written; give a new name
2: gate of sensor "gps" is not a probability between 0 and 1
, event 0: is the first, expected the prior first
, event 0: block "a" is given twice
, event 0: a block's dimension is out of range
, event 0: P is 2 x 2, expected 3 x 3
, event 0: a name is not text in UTF-8
, event 1: is a second prior; a filter that begins anew has a new trace
, event 1: Q is 1 x 1, expected 2 x 2
, event 1: "a" is given twice
, event 1: block "c" is not in the state
, event 1: H is 1 x 2, expected 2 x 2
, event 1: residual is empty
, event 1: correction has 1 numbers, expected 2
, event 1: gain is 1 x 1, expected 2 x 1
, event 1: block "a" is in the state already
, event 1: G_x is 1 x 1, expected 2 x 2
, event 1: block "a" is in the state already
, event 1: block "c" is not in the state
, event 1: removes the last block of the state
, event 1: a removal has no blocks
, event 1: J is 1 x 1, expected 2 x 2
, event 1: P is 2 x 2, expected 1 x 1
, event 1: error has 1 numbers, expected 2
, event 1: basis has 1 numbers, expected 2
, event 1: directions or sensors are missing
, event 1: time_s is not finite
a matrix has rows of different lengths
, event 4: P is 2 x 2, expected 1 x 1
: is closed
"""


@pytest.mark.slow
def test_cpp_checks_its_calls_and_records_every_kind(build: Build, tmp_path: Path) -> None:
    path = tmp_path / "run.trace"
    assert works(build(CALLS), path).replace(str(path), "") == SAID.lstrip("\n")
    assert [file.name for file in tmp_path.iterdir()] == ["run.trace"]
    trace, star, sensor = TraceReader(path), "\u661f'\"/", 'g/"\\\n\u00e9'
    assert list(trace.sensors.items()) == [(sensor, (None, ("x",)))]
    shown = [
        (
            type(event).__name__,
            *(np.asarray(x).tolist() if isinstance(x, np.ndarray) else x for x in event[1:]),
        )
        for event in trace
    ]
    p, nothing = [[2.0, 0.5], [0.5, 1.0]], (None, None, None, 1.0)
    assert shown == [
        ("TracePrior", None, ("a", star), (1, 1), p, None, ()),
        ("Directions", 1.5, ("a", star), [[1, 3], [2, 4]], ("turn", "shift"), ("gps",)),
        ("Augment", 1.5, "c", ("a",), [[3], [4]], [[1, 0], [0, 1]], p, *nothing, "additive"),
        ("Reset", 1.5, ("a",), [[7]]),
        ("Predict", 1.5, ("c",), [[0, 0], [0, 0]], p, None, None),
        ("Clone", 1.5, "d", "c"),
        ("Update", 1.5, sensor, ("a",), [0.5], [[1]], [[1]], True, None, *nothing),
        ("Remove", 1.5, ("a", "d")),
        ("Snapshot", 1.5, (star,), [[5]], [1, 2, 3], None),
    ]


FOR_EVER = r"""
#include <iostream>
#include <sys/wait.h>
#include "slamcheck_recorder.hpp"
int main(int count, char** words) {
  try {
    slamcheck::Recorder record(words[1]);
    record.prior({{"a", 2}}, slamcheck::Matrix{{1.0, 0.0}, {0.0, 1.0}});
    if (count > 2) {
      if (fork() == 0) {
        try {
          record.snapshot(slamcheck::Matrix{{1.0, 0.0}, {0.0, 1.0}});
        } catch (const std::runtime_error& error) {
          std::cout << error.what() << std::endl;
        }
        return 0;
      }
      wait(nullptr);
      record.snapshot(slamcheck::Matrix{{1.0, 0.0}, {0.0, 1.0}});
      return 0;
    }
    for (int i = 0;; ++i) {
      record.predict({{1.0, i * 0.1}, {0.0, 1.0}}, {{1.0, 0.0}, {0.0, 1.0}});
      if (i == 4999) std::cout << "half" << std::endl;
      if (i == 5500) std::cin.get();
    }
  } catch (const std::runtime_error& error) {
    std::cerr << error.what() << std::endl;
    return 2;
  }
}
"""


@pytest.fixture(scope="module")
def for_ever(build: Build) -> Path:
    """A program that records two commits and more, and waits; with a second word it forks."""
    return build(FOR_EVER)


@pytest.mark.slow
def test_a_killed_cpp_recording_is_valid_to_its_last_commit(for_ever: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.trace"
    job = subprocess.Popen((for_ever, path), stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert present(job.stdout).readline() == b"half\n"
    assert len(list(TraceReader(path))) == 4000, "while it is recorded"
    job.kill()
    job.communicate()
    assert job.returncode == -signal.SIGKILL
    assert [event.number for event in TraceReader(path)] == list(range(4000))
    with Recorder(path, append=True) as record:
        record.predict(np.eye(2), np.eye(2))
    assert TraceReader(path).counts.events == 4001


def test_a_full_disk_is_one_line(for_ever: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.trace"
    limited = f"ulimit -f 300; exec {for_ever} {path}"
    done = ran("bash", "-c", f"trap '' XFSZ; {limited} < /dev/null")
    assert done.returncode == 2
    assert done.stderr.startswith(f"{path}: cannot be written (")
    assert done.stderr.endswith("; the recording ends before event 2000\n")
    assert TraceReader(path).counts.events == 2000


def test_a_child_of_a_fork_leaves_the_file_alone(for_ever: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.trace"
    said = "was opened by another process; after a fork only the parent records"
    assert works(for_ever, path, "fork") == f"{path}: {said}\n"
    assert [type(event).__name__ for event in TraceReader(path)] == ["TracePrior", "Snapshot"]
