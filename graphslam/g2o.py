"""Graphs and solutions as g2o text, landmarks included.

Other programs read the usual tags: VERTEX_SE2, VERTEX_XY, EDGE_SE2, EDGE_SE2_XY (a sighting as a
point in the pose's frame), EDGE_PRIOR_SE2, EDGE_PRIOR_SE2_XY, EDGE_PRIOR_XY, each edge with the
upper triangle of its information. What they would lose or round stands behind a `#` on the same
line: range, bearing and sigmas, and covariances in place of informations. With it, reading gives
back every bit that was written; files without it are read as well.

Poses are vertices 0 to K - 1 in driving order, landmarks follow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from graphslam.arrays import Array
from graphslam.graph_builder import to_tangent
from graphslam.marginals import SingularProblemError, inverse
from graphslam.problem import Closures, SlamProblem

_FREE_PRIOR = 1e-12
"""Variance of the first pose where a file has no prior."""
_NUMBERS = {
    "VERTEX_SE2": 4,
    "VERTEX_XY": 3,
    "EDGE_SE2": 11,
    "EDGE_SE2_XY": 7,
    "EDGE_PRIOR_SE2": 10,
    "EDGE_PRIOR_SE2_XY": 6,
    "EDGE_PRIOR_XY": 6,
}
TAGS = tuple(_NUMBERS)
"""What is written and read."""
_SETTINGS = {
    "EDGE_SE2": "raise the odometry's sigmas or its stabilisation noise",
    "EDGE_PRIOR_SE2": "lower the correlations of the log's prior",
    "EDGE_PRIOR_SE2_XY": "lower the correlations of the log's positions",
    "EDGE_PRIOR_XY": "give the known landmarks larger variances",
}
"""What in a log to change where an edge of a tag has no information."""


class G2oContents(NamedTuple):
    """A problem and its values: poses (K, 3), landmarks (L, 2)."""

    problem: SlamProblem
    poses: Array
    landmarks: Array


def holds(problem: SlamProblem) -> bool:
    """Whether g2o can say where positions were measured: it knows no antenna off the pose."""
    return not len(problem.position) or problem.lever_m == (0.0, 0.0)


def write_g2o(path: Path, contents: G2oContents) -> None:
    """Write a problem with a solution. Raises ValueError for an antenna off the pose's origin.

    g2o has no edge for one; such positions would be taken for the pose's own. Raises
    SingularProblemError that names the edge whose covariance has no inverse.
    """
    problem, poses, landmarks = contents
    if problem.oriented.count:
        raise ValueError("oriented landmarks cannot be told from poses in g2o")
    if not holds(problem):
        raise ValueError("g2o has no edge for positions of an antenna away from the pose")
    count = problem.pose_count
    lines = [f"VERTEX_SE2 {k} {_text(pose)}" for k, pose in enumerate(poses)]
    lines += [f"VERTEX_XY {count + j} {_text(point)}" for j, point in enumerate(landmarks)]
    turn = to_tangent(problem.prior_pose[2:3])[0]
    covariance = turn @ problem.prior_covariance @ turn.T
    prior = problem.prior_covariance
    lines.append(_edge("EDGE_PRIOR_SE2", (0,), problem.prior_pose, covariance, prior))
    for k, (move, spread) in enumerate(
        zip(problem.increment, problem.increment_covariance, strict=True)
    ):
        lines.append(_edge("EDGE_SE2", (k, k + 1), move, spread, spread))
    closed = problem.closures
    for i, j, move, spread in zip(
        closed.first, closed.second, closed.motion, closed.covariance, strict=True
    ):
        lines.append(_edge("EDGE_SE2", (i, j), move, spread, spread))
    for k, j, (r, bearing), sigma in zip(
        problem.sighting_pose, problem.sighting_landmark, problem.z, problem.sigma, strict=True
    ):
        cos, sin = math.cos(bearing), math.sin(bearing)
        # Of the whitened point: its covariance would lose the smaller of two unlike sigmas.
        root = np.array([[cos, sin], [-sin / r, cos / r]]) / sigma[:, None]
        point = np.array([r * cos, r * sin])
        line = _line("EDGE_SE2_XY", (k, count + j), point, root.T @ root)
        lines.append(f"{line} # {_text((r, bearing, *sigma))}")
    for k, z, spread in zip(
        problem.position_pose, problem.position, problem.position_covariance, strict=True
    ):
        lines.append(_edge("EDGE_PRIOR_SE2_XY", (k,), z, spread, spread))
    for j, (z, spread) in enumerate(
        zip(problem.surveyed, problem.surveyed_covariance, strict=True)
    ):
        lines.append(_edge("EDGE_PRIOR_XY", (count + j,), z, spread, spread))
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def read_g2o(path: Path) -> G2oContents:
    """Read a planar graph of one chain of poses and of landmarks.

    The first edge from a pose to the next is its increment, all others between poses are closures,
    whose robust kernel g2o cannot tell. Raises ValueError naming the line at fault, for unknown
    tags, and for numbers that are missing or not finite.
    """
    vertices: dict[str, dict[int, list[float]]] = {"VERTEX_SE2": {}, "VERTEX_XY": {}}
    edges: dict[str, list[_Record]] = {tag: [] for tag in _NUMBERS if tag not in vertices}
    for record in _records(path):
        if record.tag in vertices:
            vertices[record.tag][int(record.numbers[0])] = record.numbers[1:]
        else:
            edges[record.tag].append(record)
    pose_of = {key: k for k, key in enumerate(sorted(vertices["VERTEX_SE2"]))}
    slot_of = {key: j for j, key in enumerate(sorted(vertices["VERTEX_XY"]))}
    if not pose_of:
        raise ValueError(f"{path}: no VERTEX_SE2 line, expected poses")

    def place(record: _Record, position: int, table: dict[int, int], what: str) -> int:
        key = int(record.numbers[position])
        if key not in table:
            raise ValueError(f"{record.place}: {record.tag} names {key}, which is no {what}")
        return table[key]

    chain: dict[int, _Record] = {}
    closed: list[tuple[int, int, _Record]] = []
    for record in edges["EDGE_SE2"]:
        i, j = place(record, 0, pose_of, "pose"), place(record, 1, pose_of, "pose")
        if i == j:
            raise ValueError(f"{record.place}: EDGE_SE2 from pose {i} to itself")
        if j == i + 1 and i not in chain:
            chain[i] = record
        else:
            closed.append((i, j, record))
    missing = set(range(len(pose_of) - 1)) - set(chain)
    if missing:
        raise ValueError(f"{path}: no EDGE_SE2 departs from pose {min(missing)}")
    moves = [chain[i] for i in range(len(chain))]
    poses = np.array([vertices["VERTEX_SE2"][key] for key in pose_of])
    landmarks = np.array([vertices["VERTEX_XY"][key] for key in slot_of]).reshape(-1, 2)
    seen, fixes, survey = edges["EDGE_SE2_XY"], edges["EDGE_PRIOR_SE2_XY"], edges["EDGE_PRIOR_XY"]
    slots = [place(r, 0, slot_of, "landmark") for r in survey]
    if sorted(slots) != list(range(len(slots))):
        raise ValueError(f"{path}: EDGE_PRIOR_XY must hold the first landmarks, each once")
    survey = [survey[i] for i in np.argsort(slots)] if slots else []
    polar = np.array([_polar(r) for r in seen]).reshape(-1, 4)
    prior_pose, prior_covariance = _prior(edges["EDGE_PRIOR_SE2"], poses[0], pose_of)
    return G2oContents(
        SlamProblem(
            prior_pose=prior_pose,
            prior_covariance=prior_covariance,
            increment=np.array([r.numbers[2:5] for r in moves]).reshape(-1, 3),
            increment_covariance=np.array([_covariance(r, 5) for r in moves]).reshape(-1, 3, 3),
            sighting_pose=np.array([place(r, 0, pose_of, "pose") for r in seen], dtype=np.intp),
            sighting_landmark=np.array(
                [place(r, 1, slot_of, "landmark") for r in seen], dtype=np.intp
            ),
            z=polar[:, :2],
            sigma=polar[:, 2:],
            landmark_count=len(slot_of),
            position_pose=np.array([place(r, 0, pose_of, "pose") for r in fixes], dtype=np.intp),
            position=np.array([r.numbers[1:3] for r in fixes]).reshape(-1, 2),
            position_covariance=np.array([_covariance(r, 3) for r in fixes]).reshape(-1, 2, 2),
            surveyed=np.array([r.numbers[1:3] for r in survey]).reshape(-1, 2),
            surveyed_covariance=np.array([_covariance(r, 3) for r in survey]).reshape(-1, 2, 2),
            closures=Closures(
                np.array([i for i, _, _ in closed], dtype=np.intp),
                np.array([j for _, j, _ in closed], dtype=np.intp),
                np.array([r.numbers[2:5] for *_, r in closed]).reshape(-1, 3),
                np.array([_covariance(r, 5) for *_, r in closed]).reshape(-1, 3, 3),
            ),
        ),
        poses,
        landmarks,
    )


class _Record(NamedTuple):
    """One line. place: file and line. numbers: in front of the `#`; exact: behind it."""

    place: str
    tag: str
    numbers: list[float]
    exact: list[float]


def _records(path: Path) -> Iterator[_Record]:
    with path.open(encoding="utf-8", errors="replace") as file:
        for line, text in enumerate(file, start=1):
            front, _, behind = text.partition("#")
            words = front.split()
            if not words:
                continue
            tag = words[0]
            if tag not in _NUMBERS:
                raise ValueError(
                    f"{path}:{line}: unknown tag '{tag[:40]}', expected one of "
                    f"{', '.join(_NUMBERS)}"
                )
            try:
                numbers = [float(word) for word in words[1:]]
                exact = [float(word) for word in behind.split()]
            except ValueError:
                raise ValueError(f"{path}:{line}: {tag} holds what is no number") from None
            if len(numbers) != _NUMBERS[tag]:
                raise ValueError(
                    f"{path}:{line}: {tag} has {len(numbers)} numbers, expected {_NUMBERS[tag]}"
                )
            if not np.isfinite(numbers + exact).all():
                raise ValueError(f"{path}:{line}: {tag} holds a number that is not finite")
            yield _Record(f"{path}:{line}", tag, numbers, exact)


def _prior(records: list[_Record], first: Array, pose_of: dict[int, int]) -> tuple[Array, Array]:
    """Pose (3,) and covariance (3, 3), of the additive global error."""
    if not records:
        return first, _FREE_PRIOR * np.eye(3)
    [record, *more] = records
    if more or pose_of.get(int(record.numbers[0])) != 0:
        place = (more or records)[0].place
        raise ValueError(f"{place}: EDGE_PRIOR_SE2, expected one only, of the first pose")
    pose = np.array(record.numbers[1:4])
    if record.exact:
        return pose, _covariance(record, 4)
    back = to_tangent(pose[2:3])[0].T
    return pose, back @ _covariance(record, 4) @ back.T


def _covariance(record: _Record, start: int) -> Array:
    """The exact covariance, or the inverse of the information that starts there."""
    size = 3 if len(record.numbers) - start == 6 else 2
    entries = record.exact if len(record.exact) == size * (size + 1) // 2 else None
    matrix = _symmetric(entries or record.numbers[start:], size)
    if entries is not None:
        return matrix
    try:
        covariance = inverse(matrix)
    except np.linalg.LinAlgError:
        raise ValueError(
            f"{record.place}: {record.tag} has an information that is not positive definite"
        ) from None
    return 0.5 * (covariance + covariance.T)


def _polar(record: _Record) -> list[float]:
    """Range, bearing and their sigmas; an information that mixes them loses the mixture."""
    if len(record.exact) == 4:
        return record.exact
    x, y = record.numbers[2:4]
    r, bearing = math.hypot(x, y), math.atan2(y, x)
    if not r > 0.0:
        raise ValueError(f"{record.place}: {record.tag} lies on its pose, which has no bearing")
    cos, sin = math.cos(bearing), math.sin(bearing)
    into = np.array([[cos, sin], [-sin / r, cos / r]])
    spread = into @ _covariance(record, 4) @ into.T
    return [r, bearing, *np.sqrt(np.diag(spread)).tolist()]


def _edge(tag: str, ids: tuple[int, ...], z: Array, covariance: Array, exact: Array) -> str:
    try:
        line = _line(tag, ids, z, inverse(covariance))
    except np.linalg.LinAlgError:
        named = " ".join(str(int(i)) for i in ids)
        sigmas = ", ".join(f"{v:.3g}" for v in np.sqrt(np.abs(np.diag(covariance))))
        raise SingularProblemError(
            f"graph.g2o: the covariance of {tag} {named} (sigmas {sigmas}) is singular to "
            f"rounding, so that it has no information; {_SETTINGS[tag]}"
        ) from None
    return f"{line} # {_text(exact[np.triu_indices(len(exact))])}"


def _line(tag: str, ids: tuple[int, ...], z: Array, information: Array) -> str:
    upper = information[np.triu_indices(len(information))]
    return f"{tag} {' '.join(str(int(i)) for i in ids)} {_text(z)} {_text(upper)}"


def _symmetric(entries: list[float], size: int) -> Array:
    matrix = np.zeros((size, size))
    upper = np.triu_indices(size)
    matrix[upper] = entries
    matrix.T[upper] = entries
    return matrix


def _text(numbers: Array | tuple[float, ...]) -> str:
    """The shortest text that reads back as the same numbers."""
    return " ".join(repr(float(number)) for number in numbers)
