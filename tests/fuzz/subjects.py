"""What users hand in: a small valid one of each kind, and how it is opened."""

import functools
import json
import os
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.audit.audit import audit
from comparisons.audit.own_filter import write_run
from comparisons.baseline import build_baseline, read_baseline, write_baseline
from comparisons.config import EkfConfig, RunConfig
from comparisons.estimates.external import ExternalEstimate, read_external
from comparisons.estimates.folder import write_estimate
from comparisons.estimates.planar_trace import TRACE
from comparisons.estimates.trajectory_files import Trajectory, write_trajectory
from comparisons.experiments.montecarlo.chunk_files import ChunkFiles
from comparisons.experiments.montecarlo.runs import RunRecords
from comparisons.experiments.scenarios.scenario import read_scenario
from comparisons.experiments.scenarios.world import ScenarioWorld, build_world
from comparisons.logs.log import Log
from comparisons.logs.log_folder import write_log_folder
from comparisons.logs.readers import read_log
from comparisons.pipeline.solve import solve
from comparisons.report import side_by_side
from comparisons.report.models import Result
from comparisons.report.run import RunReport
from comparisons.settings import configure, run_config, run_options
from comparisons.trace.reader import RAW, VERSION
from graphslam.g2o import G2oContents, write_g2o
from tests.comparisons.audit.toy_filter import Toy
from tests.comparisons.logs.rawlogs import rawlog
from tests.comparisons.logs.test_log_folder import full_log, velocity_log
from tests.comparisons.logs.test_readers import car_park, graph, mrclam, victoria
from tests.comparisons.logs.test_scan_readers import carmen, trio
from tests.graphslam.g2o_files import CLOSED_ELSEWHERE
from tests.helpers import compared, simulated

SCENARIO = """description = "small"
from_paper = []
ours = ["all"]
steps = 20
step_s = 1.0
sigma_start_m = 1e-5
sigma_start_rad = 1e-5

[course]
kind = "waypoints"
speed_mps = 0.5
lookahead_m = 1.0
points = [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]]

[landmarks]
kind = "ring"
centre = [0.0, 1.0]
radii_m = [7.0, 13.0]
count = 5

[odometry]
sigma_speed_mps = 0.01
sigma_yaw_rate_radps = 0.01

[sensor]
kind = "range-bearing"
sigma_range_m = 0.1
sigma_bearing_rad = 0.01
max_range_m = 50.0
"""


@dataclass(frozen=True)
class Subject:
    """make: writes into an empty folder. read: given that folder. within: the part to open."""

    make: Callable[[Path], object]
    read: Callable[[Path], object]

    @functools.cached_property
    def files(self) -> dict[str, bytes]:
        """Contents of a valid one, by path."""
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            self.make(folder)
            found = sorted(p for p in folder.rglob("*") if p.is_file())
            return {p.relative_to(folder).as_posix(): p.read_bytes() for p in found}

    def write(self, folder: Path) -> None:
        """A valid one."""
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)

    @contextmanager
    def written(self) -> Iterator[Path]:
        """A folder that goes again, with a valid one."""
        with tempfile.TemporaryDirectory() as name:
            self.write(Path(name))
            yield Path(name)


@functools.cache
def small_solution() -> tuple[Log, G2oContents]:
    """Of a log of ten seconds."""
    log = simulated(2, loop_s=10.0)
    result = solve(log).result
    return log, G2oContents(result.problem, result.poses, result.landmarks)


def log_files(log: Log) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        write_log_folder(log, folder)

    return make


def check_log(log: Log) -> None:
    """What every log promises, whoever wrote it: finite numbers, gaps where there may be some."""
    gaps = ["diameter_m", "intensity", "range_m"]
    if log.loop_closures is not None:
        assert np.isfinite(log.loop_closures.covariance).all()
        gaps.append("covariance")
    for stream in (
        log.odometry,
        log.measurements,
        log.positions,
        log.known_measurements,
        log.scans,
    ):
        for name, value in vars(stream).items() if stream is not None else ():
            if isinstance(value, np.ndarray) and name not in gaps:
                assert np.isfinite(value).all(), name
    assert np.isfinite((log.end_s, log.duration_s)).all()
    assert log.records


def opened(path: Callable[[Path], Path] = lambda folder: folder) -> Callable[[Path], object]:
    return lambda folder: check_log(read_log(path(folder)))


def named(name: str, format_name: str) -> Callable[[Path], object]:
    """By name, as --format does: the reader itself meets what would not be recognised."""
    return lambda folder: check_log(read_log(folder / name, format_name))


def check_external_estimate(given: ExternalEstimate) -> None:
    for value in (given.time_s, given.pose, given.landmark, given.pose_covariance,
                  given.landmark_covariance, given.joint_covariance):  # fmt: skip
        assert value is None or np.isfinite(value**2).all()


def estimate_files(folder: Path) -> None:
    """A filter's, with its trace."""
    log, _ = small_solution()
    run = run_ekf(log, build_timeline(log), settle(EkfConfig(), log))
    write_estimate(run.estimate, folder)
    write_run(run, folder / TRACE)


def trajectory_file(format_name: str) -> Subject:
    """A trajectory on its own, also with a file of times."""

    def make(folder: Path) -> None:
        found = solve(small_solution()[0]).estimate
        trajectory = Trajectory(found.time_s, found.pose, found.pose_covariance)
        write_trajectory(trajectory, folder / "poses", format_name)

    return Subject(make, lambda folder: check_external_estimate(read_external(folder / "poses")))


@functools.cache
def small_result() -> str:
    return RunReport.build(compared(simulated(loop_s=10.0))).model_dump_json(indent=1)


def result_file(folder: Path) -> None:
    (folder / "result.json").write_text(small_result())


def read_result(folder: Path) -> None:
    results = side_by_side.read_results([folder, folder])
    with (folder / "printed").open("w") as file:
        side_by_side.print_side_by_side(
            ["a", "b"], side_by_side.side_by_side(results), Console(file=file)
        )


def baseline_file(folder: Path) -> None:
    result = Result.model_validate_json(small_result())
    write_baseline(build_baseline([result], RunConfig()), folder / "kept.json")


def config_file(folder: Path) -> None:
    """With a section of everything that a run may hold."""
    options = {"motion": "both", "landmarks": "both", "dense": ["points"], "dynamic": True}
    (folder / "run.toml").write_text(run_config(**options).toml(), encoding="utf-8")


def read_toml(folder: Path) -> None:
    """As --config does, with an option that goes over the file."""
    flags = run_options({"filter": "full", "resolution": 0.1})
    configure(RunConfig, folder / "run.toml", flags, over={"log": {"source": "simulated-loop"}})


def build_scenario(folder: Path) -> ScenarioWorld:
    place = str(folder / "small.toml")
    return build_world(read_scenario(place), place)


def chunk_files(folder: Path) -> ChunkFiles:
    """Of a Monte Carlo study of four recorded steps."""
    return ChunkFiles(folder, "0123456789abcdef" * 4, 4)


def chunk_file(folder: Path) -> None:
    """Packed, unlike those that a study writes, so that the unpacking is damaged as well."""
    records = np.random.default_rng(0).normal(size=(len(RunRecords._fields), 25, 4))
    chunk_files(folder).write("ekf", 0, RunRecords(*records))
    path = chunk_files(folder).path("ekf", 0)
    with np.load(path) as kept:
        arrays = dict(kept)
    np.savez_compressed(path, **arrays)


def read_chunk(folder: Path) -> None:
    """A damaged one counts as absent: no fault but that of another study's is ever told."""
    chunk_files(folder).read("ekf", 0)


def killed_trace(folder: Path) -> None:
    """Of a recording that was killed within a transaction, with the journal that undoes it."""
    path, left = folder / "whole", folder / "run.trace"
    Toy(1, 40).record(path)
    with closing(sqlite3.connect(path, isolation_level=None)) as file:
        file.execute("PRAGMA cache_size = 1")
        file.execute("BEGIN")
        file.execute("UPDATE batch SET data = zeroblob(300000)")
        shutil.copy(path, left)
        shutil.copy(f"{path}-journal", f"{left}-journal")
    path.unlink()


def plain_trace(folder: Path) -> None:
    """Of batches one after the other, as C++ writes them."""
    Toy(1, 40).record(folder / "whole")
    with closing(sqlite3.connect(folder / "whole")) as file:
        batches = list(file.execute("SELECT * FROM batch"))
        about = [[n, g, c and json.loads(c)] for n, g, c in file.execute("SELECT * FROM sensor")]
    (folder / "whole").unlink()
    spoken = _spaced(json.dumps(about))
    parts = [RAW, struct.pack("<2q", VERSION, len(spoken)), spoken]
    for *numbers, state, data in batches:
        parts += [
            struct.pack("<6q", *numbers, len(_spaced(state)), len(data)),
            _spaced(state),
            data,
        ]
    (folder / "run.events").write_bytes(b"".join(parts))


def _spaced(text: str) -> bytes:
    return text.encode() + b" " * (-len(text.encode()) % 8)


def audited(name: str) -> Callable[[Path], object]:
    """Audit a trace, and see that nothing that was handed in is written."""

    def read(folder: Path) -> None:
        files = [path for path in folder.iterdir() if path.is_file() and not path.is_symlink()]
        before = {path: path.read_bytes() for path in files if os.access(path, os.R_OK)}
        try:
            audit(folder / name)
        finally:
            assert before == {path: path.read_bytes() for path in before}

    return read


def g2o_file(folder: Path) -> None:
    write_g2o(folder / "graph.g2o", small_solution()[1])


def pose_graph_file(folder: Path) -> None:
    (folder / "graph.g2o").write_text(CLOSED_ELSEWHERE)


def bag(mcap: bool) -> Callable[[Path], None]:
    """A rosbag2 folder."""

    def make(folder: Path) -> None:
        from tests.comparisons.logs.bags import T, drive

        T.write(folder / "bag", drive(T), mcap=mcap)

    return make


def ros1_bag(folder: Path) -> None:
    from rosbags.typesys import Stores

    from tests.comparisons.logs.bags import Types, drive

    types = Types(Stores.ROS1_NOETIC)
    types.write(folder / "drive.bag", drive(types))


SUBJECTS: dict[str, Subject] = {
    "log folder": Subject(log_files(full_log()), opened()),
    "log folder, velocity": Subject(log_files(velocity_log()), opened()),
    "log folder, relative poses": Subject(
        lambda folder: write_log_folder(read_log(graph(folder)), folder / "log"),
        opened(lambda folder: folder / "log"),
    ),
    "g2o": Subject(g2o_file, named("graph.g2o", "g2o")),
    "g2o, pose graph": Subject(pose_graph_file, named("graph.g2o", "g2o")),
    "gtsam text": Subject(graph, named("graph_file.txt", "gtsam-2d")),
    "MR.CLAM": Subject(mrclam, opened()),
    "Victoria Park detections": Subject(victoria, opened()),
    "ACFR car park": Subject(car_park, opened()),
    "aa3": Subject(trio, opened()),
    "CARMEN": Subject(carmen, named("drive.clf", "carmen")),
    "rawlog": Subject(lambda folder: rawlog(folder, packed=False), named("drive.rawlog", "rawlog")),
    "rawlog, packed": Subject(rawlog, named("drive.rawlog", "rawlog")),
    "TUM trajectory": trajectory_file("tum"),
    "KITTI trajectory": trajectory_file("kitti"),
    "CSV trajectory": trajectory_file("csv"),
    "estimate folder": Subject(
        estimate_files, lambda folder: check_external_estimate(read_external(folder))
    ),
    "baseline": Subject(baseline_file, lambda folder: read_baseline(folder / "kept.json")),
    "configuration": Subject(config_file, read_toml),
    "scenario": Subject(
        lambda folder: (folder / "small.toml").write_text(SCENARIO), build_scenario
    ),
    "result": Subject(result_file, read_result),
    "Monte Carlo chunk": Subject(chunk_file, read_chunk),
    "trace": Subject(lambda folder: Toy(1, 40).record(folder / "run.trace"), audited("run.trace")),
    "trace of a killed filter": Subject(killed_trace, audited("run.trace")),
    "trace without SQLite": Subject(plain_trace, audited("run.events")),
}
BAGS: dict[str, Subject] = {
    "rosbag2, MCAP": Subject(bag(mcap=True), opened(lambda folder: folder / "bag")),
    "rosbag2, SQLite": Subject(bag(mcap=False), opened(lambda folder: folder / "bag")),
    "ROS 1": Subject(ros1_bag, opened(lambda folder: folder / "drive.bag")),
}
