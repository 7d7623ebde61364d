"""Files of others: each is read, and run or solved.

The drives are one: a circle at 1 m/s among twelve posts, with noise as stated, seed 4.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from comparisons.logs.log import Log
from comparisons.logs.new_log import UserFiles, build
from comparisons.logs.readers import read_log
from comparisons.pipeline.solve import solve
from comparisons.report.solution import SolutionReport
from graphslam.g2o import write_g2o
from research.trust.odometry_drives import travelled
from tests.graphslam.g2o_files import CLOSED_ELSEWHERE, everything
from tests.graphslam.test_g2o import ROWS, TORO, square
from tests.helpers import compared

pytest.importorskip("rosbags")

from tests.comparisons.logs.bags import EPOCH, Message, T, Types

STEP_S, SPEED, RATE, WHEELBASE = 0.1, 1.0, 0.2, 2.0
SIGMAS = {"sigma_range_m": 0.05, "sigma_bearing_rad": 0.01}
WHEELS = {"sigma_speed_mps": 0.05, "sigma_turn": 0.02}


class Circle(NamedTuple):
    """speed, turn: (N,) as measured. pose, truth: (N + 1, 3). seen: time, post and z of each."""

    time_s: np.ndarray
    speed: np.ndarray
    turn: np.ndarray
    pose: np.ndarray
    seen: list[tuple[float, int, float, float]]
    truth: np.ndarray


def circle(count: int = 320) -> Circle:
    rng = np.random.default_rng(4)
    controls = np.column_stack((np.full(count, SPEED), np.full(count, RATE)))
    reported = controls + rng.normal(
        0.0, (WHEELS["sigma_speed_mps"], WHEELS["sigma_turn"]), (count, 2)
    )
    truth, reckoned = (
        travelled(STEP_S * of[:, 0], STEP_S * of[:, 1], 0.5) for of in (controls, reported)
    )
    around = 9.0 * np.exp(2j * np.pi * np.arange(12) / 12) + 5j
    seen = []
    for k in range(5, count, 5):
        for post, at in enumerate(around):
            ray = (at - truth[k, 0] - 1j * truth[k, 1]) * np.exp(-1j * truth[k, 2])
            if abs(ray) < 8.0:
                z = (abs(ray), np.angle(ray)) + rng.normal(0.0, (0.05, 0.01))
                seen.append((k * STEP_S, post, *z.tolist()))
    time_s = STEP_S * np.arange(count)
    return Circle(time_s, reported[:, 0], reported[:, 1], reckoned, seen, truth)


DRIVE = circle()


def posts(delimiter: str = ",", name: str = "post_{}") -> str:
    rows = ["label,t,bearing [deg],range"]
    rows += [f"{name.format(p)},{t!r},{np.degrees(b)!r},{r!r}" for t, p, r, b in DRIVE.seen]
    return "\n".join(rows).replace("np.float64(", "").replace(")", "").replace(",", delimiter)


def table(header: str, *columns: np.ndarray, delimiter: str = ",") -> str:
    rows = [",".join(repr(value) for value in row) for row in np.column_stack(columns).tolist()]
    return "\n".join([header, *rows]).replace(",", delimiter)


def own(
    folder: Path, odometry: str, seen: str, stated: dict[str, Any] | None = None, **more: Any
) -> Log:
    (folder / "odometry.csv").write_text(odometry)
    (folder / "posts.csv").write_text(seen)
    paths = {"odometry": folder / "odometry.csv", "measurements": folder / "posts.csv"}
    return build(
        UserFiles(
            name="own",
            paths=paths | more.pop("paths", {}),
            stated=SIGMAS | (WHEELS if stated is None else stated),
            **more,
        )
    ).log


def moves(types: Types = T) -> list[Message]:
    """Odometry with the growth of its covariance, as a driver that knows its noise writes it."""
    grown, messages = np.zeros((3, 3)), []
    for k, (x, y, heading) in enumerate(DRIVE.pose[:-1].tolist()):
        more = {"y": y, "pose_covariance": grown.copy()}
        messages.append(types.odometry(EPOCH + k * STEP_S, x, heading, **more))
        step = DRIVE.pose[k + 1] - DRIVE.pose[k]
        carry = np.array(((1, 0, -step[1]), (0, 1, step[0]), (0, 0, 1)))
        c, s = np.cos(heading), np.sin(heading)
        along = np.array((c, s, 0.0)) * WHEELS["sigma_speed_mps"] * STEP_S
        turn = np.array((-s * 0.05, c * 0.05, 1.0)) * WHEELS["sigma_turn"] * STEP_S
        grown = carry @ grown @ carry.T + np.outer(along, along) + np.outer(turn, turn)
    return messages


def groups() -> dict[float, list[tuple[int, float, float]]]:
    found: dict[float, list[tuple[int, float, float]]] = {}
    for t, post, distance, bearing in DRIVE.seen:
        at = (post, distance * np.cos(bearing), distance * np.sin(bearing))
        found.setdefault(t, []).append(at)
    return found


def with_markers(folder: Path) -> Log:
    drawn = [T.markers(EPOCH + t, *points) for t, points in groups().items()]
    return read_log(T.write(folder / "bag", [*moves(), *drawn]), topics=("/markers",))


def with_detections(folder: Path) -> Log:
    """And fixes with 0.2 m, every second, 51 degrees north."""
    types = Types().with_detections()
    found = []
    for t, points in groups().items():
        spread = np.zeros((len(points), 6, 6))
        for row, (_, x, y) in zip(spread, points, strict=True):
            ray = np.array((x, y)) / np.hypot(x, y)
            row[:2, :2] = 0.05**2 * np.outer(ray, ray)
            row[:2, :2] += 0.01**2 * np.outer((-y, x), (-y, x))
        named = ((str(p), f"post_{p}", x, y) for p, x, y in points)
        found.append(types.detections(EPOCH + t, *named, covariance=spread))
    rng = np.random.default_rng(5)
    fixes = []
    for k in range(0, 320, 10):
        east, north = DRIVE.truth[k, :2] + rng.normal(0.0, 0.2, 2)
        fixes.append(types.fix(EPOCH + k * STEP_S, 51 + north / 111257.8, 7 + east / 70197.1))
    return read_log(types.write(folder / "bag", [*moves(types), *found, *fixes], mcap=False))


def graph(text: str) -> Callable[[Path], Log]:
    def read(folder: Path) -> Log:
        (folder / "graph.g2o").write_text(text)
        return read_log(folder / "graph.g2o")

    return read


def landmarks(folder: Path) -> Log:
    contents = everything()
    write_g2o(folder / "graph.g2o", contents)
    text = (folder / "graph.g2o").read_text().splitlines(keepends=True)
    kept = [line for line in text if not line.startswith("EDGE_PRIOR_XY")]
    return graph("".join(kept))(folder)


def squared(numbers: str) -> Callable[[Path], Log]:
    def read(folder: Path) -> Log:
        square(folder / "a.graph", numbers)
        return read_log(folder / "a.graph")

    return read


WHEEL = table("time,v,omega", DRIVE.time_s, DRIVE.speed, DRIVE.turn)
STEER = table(
    "steering_deg,stamp_ms,speed",
    np.degrees(np.arctan(DRIVE.turn * WHEELBASE / DRIVE.speed)),
    1e3 * DRIVE.time_s,
    DRIVE.speed,
    delimiter=";",
)
POSES = table("t,x,y,yaw", DRIVE.time_s, *DRIVE.pose[:-1].T)
FILES: dict[str, tuple[Callable[[Path], Log], str]] = {
    "mcap, odometry and markers": (with_markers, "agree"),
    "db3, odometry, detections, fixes": (with_detections, "agree"),
    "CSV, speed and yaw rate": (lambda folder: own(folder, WHEEL, posts()), "agree"),
    "CSV, steering, semicolons": (
        lambda folder: own(folder, STEER, posts(";", "{}"), WHEELS | {"wheelbase_m": WHEELBASE}),
        "verified",
    ),
    "CSV, poses, tabs": (lambda folder: own(folder, POSES, posts("\t"), {}), "agree"),
    "g2o, planar with landmarks": (landmarks, "verified"),
    "g2o, poses alone": (graph(CLOSED_ELSEWHERE), "solved"),
    "TORO": (squared(TORO), "solved"),
    "iSAM": (squared(ROWS), "solved"),
}


def outcome(read: Callable[[Path], Log], expected: str, folder: Path) -> str:
    """What became of a file, by as much work as is expected of it."""
    log = read(folder)
    if expected == "agree":
        return compared(log, gps="off" if log.positions is None else "on").verdict.outcome
    solution = solve(log)
    assert np.isfinite(solution.estimate.pose).all()
    return "solved" if expected == "solved" else SolutionReport.build(solution).verdict


@pytest.mark.parametrize("name", FILES)
def test_a_foreign_file(name: str, tmp_path: Path) -> None:
    read, expected = FILES[name]
    assert expected in outcome(read, expected, tmp_path)
