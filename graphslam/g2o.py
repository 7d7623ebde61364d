"""Graphs and solutions as g2o text, landmarks included.

Other programs read the usual tags: VERTEX_SE2, VERTEX_XY, EDGE_SE2, EDGE_SE2_XY (a measurement as a
point in the pose's frame), EDGE_PRIOR_SE2, EDGE_PRIOR_SE2_XY, EDGE_PRIOR_XY, each edge with the
upper triangle of its information. What they would lose or round stands behind a `#` on the same
line: range, bearing and sigmas, and covariances in place of informations. With it, reading gives
back every bit that was written; files without it are read as well, and so are TORO's VERTEX2 and
EDGE2, iSAM's EDGE2, ODOMETRY and LANDMARK, gtsam's BR (bearing, range and their sigmas), FIX and
PARAMS_SE2OFFSET.

Landmarks keep their numbers. Poses have the lowest numbers from 0 that no landmark has, in driving
order: those of the file that a problem was read from, unless it had gaps.
"""

from __future__ import annotations

import bz2
import gzip
import math
import zlib
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphslam.arrays import Array, Index
from graphslam.extreme_edges import extreme_edges
from graphslam.graph_builder import to_tangent
from graphslam.increments import dead_reckoned
from graphslam.marginals import SingularProblemError
from graphslam.problem import OPEN_PRIOR, LoopClosures, SlamProblem
from graphslam.scan import planar
from graphslam.sensor_frame import in_words, other_frame

_FREE_PRIOR = 1e-12
"""Variance of the first pose where a file says nothing of the frame, or fixes that pose."""
_FIXING = 2
"""Poses and landmarks of known places that fix the frame."""


class _Tag(NamedTuple):
    """ids: whole numbers that come first. numbers: what follows them. name: as g2o has it."""

    ids: int
    numbers: int
    name: str


_TAGS = {
    "VERTEX_SE2": _Tag(1, 3, "VERTEX_SE2"),
    "VERTEX2": _Tag(1, 3, "VERTEX_SE2"),
    "VERTEX_XY": _Tag(1, 2, "VERTEX_XY"),
    "EDGE_SE2": _Tag(2, 9, "EDGE_SE2"),
    "EDGE2": _Tag(2, 9, "EDGE_SE2"),
    "ODOMETRY": _Tag(2, 9, "EDGE_SE2"),
    "EDGE_SE2_XY": _Tag(2, 5, "EDGE_SE2_XY"),
    "LANDMARK": _Tag(2, 5, "EDGE_SE2_XY"),
    "BR": _Tag(2, 4, "EDGE_SE2_XY"),
    "EDGE_PRIOR_SE2": _Tag(1, 9, "EDGE_PRIOR_SE2"),
    "EDGE_PRIOR_SE2_XY": _Tag(1, 5, "EDGE_PRIOR_SE2_XY"),
    "EDGE_PRIOR_XY": _Tag(1, 5, "EDGE_PRIOR_XY"),
    "FIX": _Tag(1, 0, "FIX"),
    "PARAMS_SE2OFFSET": _Tag(1, 3, "PARAMS_SE2OFFSET"),
    "EQUIV": _Tag(2, 0, "EQUIV"),
}
_SETTINGS = {
    "EDGE_SE2": "raise the odometry's sigmas or its stabilisation noise",
    "EDGE_PRIOR_SE2": "lower the correlations of the log's prior",
    "EDGE_PRIOR_SE2_XY": "lower the correlations of the log's positions",
    "EDGE_PRIOR_XY": "give the known landmarks larger variances",
}
"""What in a log to change where an edge of a tag has no information."""
_ISAM = ("ODOMETRY", "LANDMARK")
"""Tags of iSAM alone, whose landmarks are numbered apart from the poses."""
_SPATIAL = ("SE3", "XYZ", "VERTEX3", "EDGE3")
_LARGEST_ID = 2**53
_MOST_CHARACTERS = 1_000_000_000
_TORO = [0, 1, 4, 2, 5, 3]
"""Where xx, xy, xh, yy, yh, hh stand in what TORO writes: xx, xy, yy, hh, xh, yh."""
_ORDERS = {
    3: {
        "xx yy hh xy xh yh (diagonal first)": [0, 3, 4, 1, 5, 2],
        "xx xy yy xh yh hh (lower triangle)": [0, 1, 3, 2, 4, 5],
        "xx xy yy hh xh yh (TORO)": _TORO,
    },
    2: {"xx yy xy (diagonal first)": [0, 2, 1]},
}
"""Other orders of information, and where the entries of the upper triangle stand in each."""
_FEWEST = 3
"""Lines that tell the order of their entries."""
_SINGULAR = 1e-13
"""Least eigenvalue of a definite matrix whose diagonal is near one."""


def recognises(tag: str) -> bool:
    """Return whether a word is the tag of a graph, be it one that is not read.

    Args:
        tag: A file's first word.

    Returns:
        True also for spatial graphs, so that an error can say what the file is.
    """
    return tag in _TAGS or tag.startswith(("VERTEX_", "EDGE_", "PARAMS_SE")) or _spatial(tag)


def _spatial(tag: str) -> bool:
    return tag.startswith(("VERTEX", "EDGE", "PARAMS")) and any(part in tag for part in _SPATIAL)


class G2oContents(NamedTuple):
    """A problem and its values: poses (K, 3), landmarks (L, 2).

    notes: how a file was read. landmark_ids: (L,) numbers of landmarks; where empty, from K on.
    """

    problem: SlamProblem
    poses: Array
    landmarks: Array
    notes: Mapping[str, str] = MappingProxyType({})
    landmark_ids: Index = np.zeros(0, dtype=np.intp)


def holds(problem: SlamProblem) -> bool:
    """Return whether g2o can say where positions were measured: it knows no antenna off the pose.

    Args:
        problem: What would be written.

    Returns:
        False where there are positions of an antenna with a lever arm.
    """
    return not len(problem.position) or problem.lever_m == (0.0, 0.0)


def write_g2o(path: Path, contents: G2oContents) -> None:
    """Write a problem with a solution.

    Args:
        path: The file, replaced if it exists.
        contents: Problem, poses (K, 3) and points (L, 2).

    Raises:
        ValueError: There are pose landmarks, or positions of an antenna off the pose's origin, for
            which g2o has no edge: they would be taken for the pose's own.
        SingularProblemError: A covariance has no inverse; its edge is named.
    """
    problem, poses, landmarks, _, landmark_ids = contents
    if problem.pose_landmarks.count:
        raise ValueError("g2o cannot distinguish pose landmarks from poses")
    if not holds(problem):
        raise ValueError("g2o has no edge for positions of an antenna away from the pose")
    count = problem.pose_count
    if not len(landmark_ids):
        landmark_ids = np.arange(count, count + len(landmarks))
    mark = landmark_ids.tolist()
    pose_ids = np.setdiff1d(np.arange(count + len(mark)), landmark_ids)[:count]
    node = pose_ids.tolist()
    lines = [f"VERTEX_SE2 {i} {_text(pose)}" for i, pose in zip(node, poses, strict=True)]
    lines += [f"VERTEX_XY {i} {_text(point)}" for i, point in zip(mark, landmarks, strict=True)]
    turn = to_tangent(problem.prior_pose[2:3])[0]
    covariance = turn @ problem.prior_covariance @ turn.T
    prior = problem.prior_covariance
    start, steps, closed = problem.prior_pose[None], problem.steps, problem.loop_closures
    lines += _edges("EDGE_PRIOR_SE2", [(node[0],)], start, covariance[None], prior[None])
    chain = list(zip(pose_ids[steps], pose_ids[steps + 1], strict=True))
    spread = problem.increment_covariance[steps]
    lines += _edges("EDGE_SE2", chain, problem.increment[steps], spread, spread)
    pairs = list(zip(pose_ids[closed.first], pose_ids[closed.second], strict=True))
    spread = closed.covariance
    lines += _edges("EDGE_SE2", pairs, closed.motion, spread, spread)
    for k, j, (r, bearing), sigma in zip(
        problem.measurement_pose,
        problem.measurement_landmark,
        problem.z,
        problem.sigma,
        strict=True,
    ):
        cos, sin = math.cos(bearing), math.sin(bearing)
        # Of the whitened point: its covariance would lose the smaller of two unlike sigmas.
        root = np.array([[cos, sin], [-sin / r, cos / r]]) / sigma[:, None]
        point = np.array([r * cos, r * sin])
        line = _line("EDGE_SE2_XY", (node[k], mark[j]), point, root.T @ root)
        lines.append(f"{line} # {_text((r, bearing, *sigma))}")
    at, spread = [(node[k],) for k in problem.position_pose], problem.position_covariance
    lines += _edges("EDGE_PRIOR_SE2_XY", at, problem.position, spread, spread)
    at, spread = [(i,) for i in mark[: len(problem.surveyed)]], problem.surveyed_covariance
    lines += _edges("EDGE_PRIOR_XY", at, problem.surveyed, spread, spread)
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


class _Record(NamedTuple):
    """One line. tag: as g2o has it. ids, numbers: in front of the `#`; exact: behind it."""

    line: int
    written: str
    tag: str
    ids: tuple[int, ...]
    numbers: list[float]
    exact: list[float]


class _Nodes:
    """Vertices of one kind, numbered from 0 in the order of their ids, some of them first."""

    def __init__(
        self,
        path: Path,
        what: str,
        given: list[_Record],
        named: Iterator[int],
        first: Container[int] = (),
    ) -> None:
        """given: their VERTEX lines; where there are none, those that edges name."""
        self.path, self.what = path, what
        self.values: dict[int, list[float]] = {}
        for record in given:
            if record.ids[0] in self.values:
                raise ValueError(
                    f"{path}:{record.line}: {record.written} {record.ids[0]} is defined twice"
                )
            self.values[record.ids[0]] = record.numbers
        self.ids = sorted(self.values or set(named), key=lambda key: (key not in first, key))
        self._number = {key: k for k, key in enumerate(self.ids)}

    def of(self, records: Sequence[_Record], position: int) -> Index:
        """(N,) numbers of the vertices that lines name first (0) or second (1)."""
        for record in records:
            if record.ids[position] not in self._number:
                raise ValueError(
                    f"{self.path}:{record.line}: {record.written} names {record.ids[position]}, "
                    f"which is not a {self.what}"
                )
        return np.array([self._number[r.ids[position]] for r in records], dtype=np.intp)


def read_g2o(path: Path) -> G2oContents:
    """Read a planar graph of poses, in the order of their ids, and of landmarks.

    The first edge from a pose to the next is its increment, all others between poses are closures,
    whose robust kernel g2o cannot tell. Two poses that follow each other may have no such edge;
    vertices may be missing.

    Args:
        path: The file.

    Returns:
        The problem, and the values of the file's vertices.

    Raises:
        ValueError: Names the line at fault: an unknown tag, a number that is missing or not finite,
            information that is not positive definite, a pose that no edges connect.
    """
    found: dict[str, list[_Record]] = {tag.name: [] for tag in _TAGS.values()}
    for record in _records(path):
        found[record.tag].append(record)
    moves, seen = found["EDGE_SE2"], found["EDGE_SE2_XY"]
    pose_ids = (key for r in moves for key in r.ids)
    nodes = _Nodes(path, "pose", found["VERTEX_SE2"], pose_ids)
    survey = sorted(found["EDGE_PRIOR_XY"], key=lambda r: r.ids)
    known = {r.ids[0] for r in survey}
    marks = _Nodes(path, "landmark", found["VERTEX_XY"], (r.ids[1] for r in seen), known)
    if len(marks.of(survey, 0)) > len(known):
        raise ValueError(f"{path}: EDGE_PRIOR_XY must hold each landmark once")
    if not nodes.ids:
        raise ValueError(f"{path}: no VERTEX_SE2 and no EDGE_SE2 line, expected poses")
    both = sorted(set(nodes.ids) & set(marks.ids))
    isam = any(r.written in _ISAM for r in (*moves, *seen))
    if both and not isam:
        raise ValueError(f"{path}: {both[0]} is the number of a pose and of a landmark")
    first, second = nodes.of(moves, 0), nodes.of(moves, 1)
    for row in np.flatnonzero(first == second).tolist():
        record = moves[row]
        raise ValueError(
            f"{path}:{record.line}: {record.written} from pose {record.ids[0]} to itself"
        )
    motion = np.array([r.numbers[:3] for r in moves]).reshape(-1, 3)
    triangles, note = _informations(moves, isam=isam)
    spread = _covariances(path, moves, triangles, 3)
    count = len(nodes.ids)
    forward = np.flatnonzero(second == first + 1)
    step, earliest = np.unique(first[forward], return_index=True)
    chain = forward[earliest]
    closed = np.setdiff1d(np.arange(len(moves)), chain)
    start = np.array(nodes.values[nodes.ids[0]]) if nodes.values else np.zeros(3)
    increment, covariance = np.zeros((count - 1, 3)), np.full((count - 1, 3, 3), np.nan)
    if len(chain) < count - 1:
        guess = _spanned(path, nodes.ids, (first, second, motion), start)
        for k in range(count - 1):
            increment[k] = planar.wrapped(planar.between(guess[k], guess[k + 1]))
    increment[step], covariance[step] = motion[chain], spread[chain]
    unfiltered = len(closed) > 0 or not seen
    prior_pose, prior_covariance = _prior(path, found, start, nodes, unfiltered=unfiltered)
    fixes = found["EDGE_PRIOR_SE2_XY"]
    polar = _polar(path, seen)
    problem = SlamProblem(
        prior_pose=prior_pose,
        prior_covariance=prior_covariance,
        increment=increment,
        increment_covariance=covariance,
        measurement_pose=nodes.of(seen, 0),
        measurement_landmark=marks.of(seen, 1),
        z=polar[:, :2],
        sigma=polar[:, 2:],
        landmark_count=len(marks.ids),
        position_pose=nodes.of(fixes, 0),
        position=np.array([r.numbers[:2] for r in fixes]).reshape(-1, 2),
        position_covariance=_covariances(path, fixes, _behind(fixes, 2), 2),
        surveyed=np.array([r.numbers[:2] for r in survey]).reshape(-1, 2),
        surveyed_covariance=_covariances(path, survey, _behind(survey, 2), 2),
        loop_closures=LoopClosures(first[closed], second[closed], motion[closed], spread[closed]),
    )
    poses = np.array([nodes.values[key] for key in nodes.ids]) if nodes.values else None
    places = np.array([marks.values.get(key, (np.nan, np.nan)) for key in marks.ids])
    notes = {"edges": note} if note else {}
    if not (found["FIX"] or found["EDGE_PRIOR_SE2"]):
        held = f"pose {nodes.ids[0]} is held at its vertex, since no line fixes the frame"
        opened = "absolute positions fix it; the first vertex is a guess"
        notes["frame"] = opened if problem.open_prior else held
    if poses is not None and (said := _vertices((first, second, motion), spread, poses)):
        notes["vertices"] = said
    extreme = extreme_edges(spread)
    if len(extreme.rows):
        notes["extreme"] = extreme.words(
            [f"edge {r.ids[0]} to {r.ids[1]} (line {r.line})" for r in moves]
        )
    if found["EQUIV"]:
        notes["passed over"] = f"EQUIV on {len(found['EQUIV'])} lines"
    return G2oContents(
        problem,
        dead_reckoned(prior_pose, increment) if poses is None else poses,
        places.reshape(-1, 2),
        notes,
        np.array(marks.ids, dtype=np.intp),
    )


def _vertices(edges: tuple[Index, Index, Array], covariance: Array, poses: Array) -> str:
    """Say of which frame vertices (K, 3) are, where that is not the edges'; else nothing."""
    frame = other_frame(*edges, covariance, poses)
    if frame is None:
        return ""
    return (
        f"the edges fit the vertices as motions of a frame {in_words(*frame[:2])} of theirs and "
        f"turned by about {np.degrees(frame[2]):.1f} degrees: edges and vertices are of two frames"
    )


@contextmanager
def _opened(path: Path) -> Iterator[Iterator[str]]:
    """Lines of a file, unpacked where its suffix says so. Raises ValueError for a damaged one."""
    try:
        with _text_of(path) as file:
            yield _bounded(path, file)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise ValueError(f"{path}: damaged gzip or bzip2 file ({error})") from None


def _text_of(path: Path) -> IO[str]:
    suffix = path.suffix.lower()
    if suffix == ".gz":
        return gzip.open(path, "rt", encoding="utf-8", errors="replace")
    if suffix == ".bz2":
        return bz2.open(path, "rt", encoding="utf-8", errors="replace")
    return path.open(encoding="utf-8", errors="replace")


def _bounded(path: Path, file: Iterable[str]) -> Iterator[str]:
    """Lines up to what a graph may hold: a packed file may have no end."""
    total = 0
    for text in file:
        total += len(text)
        if total > _MOST_CHARACTERS:
            raise ValueError(f"{path}: more than {_MOST_CHARACTERS:,} characters, expected fewer")
        yield text


def _records(path: Path) -> Iterator[_Record]:
    with _opened(path) as file:
        for line, text in enumerate(file, start=1):
            front, _, behind = text.partition("#")
            words = front.split()
            if not words:
                continue
            place, tag = f"{path}:{line}", _TAGS.get(words[0])
            if tag is None and _spatial(words[0]):
                raise ValueError(f"{place}: {words[0][:40]}: 3D is not supported yet")
            if tag is None:
                raise ValueError(
                    f"{place}: unknown tag '{words[0][:40]}', expected one of {', '.join(_TAGS)}"
                )
            numbers, exact = (_numbers(place, words[0], w) for w in (words[1:], behind.split()))
            size = tag.ids + tag.numbers
            if len(numbers) != size:
                raise ValueError(f"{place}: {words[0]} has {len(numbers)} numbers, expected {size}")
            ids = numbers[: tag.ids]
            for key in ids:
                if not (key.is_integer() and 0 <= key < _LARGEST_ID):
                    raise ValueError(
                        f"{place}: {words[0]} names {key:g}, expected a whole number from 0"
                    )
            whole = tuple(int(key) for key in ids)
            yield _Record(line, words[0], tag.name, whole, numbers[tag.ids :], exact)


def _numbers(place: str, tag: str, words: list[str]) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        raise ValueError(f"{place}: {tag} contains a word that is not a number") from None
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"{place}: {tag} holds a number that is not finite")
    return numbers


def _spanned(
    path: Path, ids: list[int], measured: tuple[Index, Index, Array], start: Array
) -> Array:
    """(K, 3) poses along a tree of edges, breadth first: from (N,), to (N,), motion (N, 3)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order

    first, second, motion = measured
    count, nowhere = len(ids), np.zeros(3)
    touching = coo_matrix((np.ones(len(first)), (first, second)), (count, count))
    order, before = breadth_first_order(touching.tocsr(), 0, directed=False)
    if len(order) < count:
        lost = ids[int(np.setdiff1d(np.arange(count), order)[0])]
        raise ValueError(
            f"{path}: no edges between poses connect pose {lost} with pose {ids[0]}, expected "
            "one connected graph"
        )
    edges = list(zip(first.tolist(), second.tolist(), motion, strict=True))
    known = {(j, i): planar.between(m, nowhere) for i, j, m in edges}
    known |= {(i, j): m for i, j, m in edges}
    poses = np.tile(start, (count, 1))
    for k in order[1:].tolist():
        poses[k] = planar.compose(poses[before[k]], known[before[k], k])
    return poses


def _prior(
    path: Path, found: Mapping[str, list[_Record]], start: Array, nodes: _Nodes, *, unfiltered: bool
) -> tuple[Array, Array]:
    """Pose (3,) and covariance (3, 3), of the additive global error.

    unfiltered: there are loop closures, or no landmarks, so that no filter, which must know its
    start, reads the graph.
    """
    records, fixed = found["EDGE_PRIOR_SE2"], found["FIX"]
    wrong = [r for r in (*fixed, *records) if r.ids[0] != nodes.ids[0]]
    if wrong or len(records) > 1 or (records and fixed):
        record = (wrong or [*fixed, *records][1:])[0]
        raise ValueError(
            f"{path}:{record.line}: {record.tag}, expected one only, of the first pose "
            f"({nodes.ids[0]})"
        )
    if not records:
        placed = {r.ids for r in (*found["EDGE_PRIOR_SE2_XY"], *found["EDGE_PRIOR_XY"])}
        held = fixed or not unfiltered or len(placed) < _FIXING
        return start, _FREE_PRIOR * np.eye(3) if held else OPEN_PRIOR
    [record] = records
    pose = np.array(record.numbers[:3])
    [covariance] = _covariances(path, records, _behind(records, 3), 3)
    if record.exact:
        return pose, covariance
    back = to_tangent(pose[2:3])[0].T
    return pose, back @ covariance @ back.T


def _behind(records: Sequence[_Record], start: int) -> Array:
    """(N, 6) or (N, 3) upper triangles of informations, behind the measurement."""
    size = {3: 6, 2: 3}[start]
    return np.array([r.numbers[start:] for r in records]).reshape(-1, size)


def _informations(moves: Sequence[_Record], *, isam: bool) -> tuple[Array, str]:
    """(N, 6) upper triangles of edges between poses, and a note where there is a choice.

    TORO's EDGE2 holds xx, xy, yy, hh, xh, yh of the information, iSAM's the upper triangle of its
    square root by rows. A file without iSAM's own tags is of the program whose reading makes more
    lines regular, of TORO where both do.
    """
    triangles = _behind(moves, 3)
    rows = np.array([r.written in ("EDGE2", *_ISAM) and not r.exact for r in moves], dtype=bool)
    if not rows.any():
        return triangles, ""
    toro, squared = triangles[rows][:, _TORO], _squared(triangles[rows], 3)
    regular = [int(np.count_nonzero(inverses(_symmetric(one, 3))[1])) for one in (toro, squared)]
    if isam or regular[1] > regular[0]:
        triangles[rows] = squared
        tags = ", ".join(sorted({r.written for r in moves if r.written in ("EDGE2", *_ISAM)}))
        return triangles, f"{tags} as iSAM writes it: the square root of the information, by rows"
    triangles[rows] = toro
    return triangles, "EDGE2 as TORO writes it: the information as xx, xy, yy, hh, xh, yh"


def _squared(triangles: Array, size: int) -> Array:
    """(N, n (n + 1) / 2) upper triangles of informations, from those of their square roots."""
    root = np.zeros((len(triangles), size, size))
    root[:, *np.triu_indices(size)] = triangles
    return np.asarray((root.transpose(0, 2, 1) @ root)[:, *np.triu_indices(size)])


def _covariances(path: Path, records: Sequence[_Record], triangles: Array, size: int) -> Array:
    """(N, n, n) the exact covariances, or inverses of the informations (N, n (n + 1) / 2).

    Raises ValueError naming the first line whose matrix is not positive definite.
    """
    triangles, length = triangles.copy(), size * (size + 1) // 2
    exact = np.array([len(r.exact) == length for r in records], dtype=bool)
    if exact.any():
        triangles[exact] = [r.exact for r in records if len(r.exact) == length]
    matrix = _symmetric(triangles, size)
    inverse, regular = inverses(matrix)
    for row in np.flatnonzero(~regular)[:1].tolist():
        what = "covariance" if exact[row] else "information"
        bare = [record for record in records if not record.exact]
        raise ValueError(
            f"{path}:{records[row].line}: {records[row].written}: the {what} is singular or not "
            f"positive definite{'' if exact[row] else _other_order(bare, size)}"
        )
    matrix[~exact] = 0.5 * (inverse + inverse.transpose(0, 2, 1))[~exact]
    return matrix


def _other_order(records: Sequence[_Record], size: int) -> str:
    """Name the orders of their entries in which all informations are positive definite, if any."""
    if any(record.written in ("EDGE2", *_ISAM) for record in records):
        return ""  # these have orders of their own
    triangles = _behind(records, size)
    fitting = [
        name
        for name, order in _ORDERS[size].items()
        if inverses(_symmetric(triangles[:, order], size))[1].all()
    ]
    lines = f"all {len(records)} of these lines"
    if not fitting:
        wrong = triangles[~inverses(_symmetric(triangles, size))[1]]
        fitting = [
            name
            for name, order in _ORDERS[size].items()
            if len(wrong) >= _FEWEST and inverses(_symmetric(wrong[:, order], size))[1].all()
        ]
        lines = f"all {len(wrong)} of these lines that are not"
    if not fitting:
        return ""
    usual = {3: "xx xy xh yy yh hh", 2: "xx xy yy"}[size]
    return (
        f"; read as {' or as '.join(fitting)}, {lines} are positive "
        f"definite: write the upper triangle by rows ({usual})"
    )


def inverses(matrix: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the inverses of covariances or informations, and which there are.

    The variances are scaled to near one first, by powers of two, which round nothing: sigmas as far
    apart as 1e-12 and 1e12 cost no digits.

    Args:
        matrix: (N, n, n), symmetric.

    Returns:
        (N, n, n), and (N,) which are positive definite; the inverse of another is of no use.
    """
    variance = np.einsum("nii->ni", matrix)
    regular: NDArray[np.bool_] = ((variance > 0.0) & np.isfinite(variance)).all(axis=1)
    power = np.exp2(-np.round(0.5 * np.log2(np.where(regular[:, None], variance, 1.0))))
    scale = power[:, :, None] * power[:, None, :]
    scaled = matrix * scale
    regular &= np.isfinite(scaled).all(axis=(1, 2))
    scaled[~regular] = np.eye(matrix.shape[1])
    regular &= np.linalg.eigvalsh(scaled)[:, 0] > _SINGULAR
    scaled[~regular] = np.eye(matrix.shape[1])
    return np.linalg.inv(scaled).astype(np.float64, copy=False) * scale, regular


def _polar(path: Path, records: Sequence[_Record]) -> Array:
    """(M, 4) range, bearing and sigmas; an information that mixes them loses the mixture."""
    polar = np.array([r.exact if len(r.exact) == 4 else [0.0] * 4 for r in records])
    polar = polar.reshape(-1, 4)
    for row, r in enumerate(records):
        if r.written == "BR":
            polar[row] = [r.numbers[i] for i in (1, 0, 3, 2)]
    bare = [i for i, r in enumerate(records) if r.written != "BR" and len(r.exact) != 4]
    points = [records[i] for i in bare]
    triangles = _behind(points, 2)
    roots = np.array([r.written == "LANDMARK" for r in points], dtype=bool)
    triangles[roots] = _squared(triangles[roots], 2)
    spread = _covariances(path, points, triangles, 2)
    for i, record, covariance in zip(bare, points, spread, strict=True):
        x, y = record.numbers[:2]
        distance, bearing = math.hypot(x, y), math.atan2(y, x)
        if distance == 0.0:
            raise ValueError(f"{path}:{record.line}: {record.written} at range 0 has no bearing")
        cos, sin = math.cos(bearing), math.sin(bearing)
        into = np.array([[cos, sin], [-sin / distance, cos / distance]])
        polar[i] = [distance, bearing, *np.sqrt(np.diag(into @ covariance @ into.T)).tolist()]
    wrong = np.flatnonzero(~(polar[:, [0, 2, 3]] > 0.0).all(axis=1))
    if len(wrong):
        record = records[int(wrong[0])]
        raise ValueError(
            f"{path}:{record.line}: {record.written}: range and sigmas must lie above 0"
        )
    return polar


def _edges(
    tag: str, ids: Sequence[tuple[int, ...]], z: Array, covariance: Array, exact: Array
) -> list[str]:
    information, regular = inverses(covariance)
    for row in np.flatnonzero(~regular)[:1].tolist():
        named = " ".join(str(int(i)) for i in ids[row])
        sigmas = ", ".join(f"{v:.3g}" for v in np.sqrt(np.abs(np.diag(covariance[row]))))
        raise SingularProblemError(
            f"graph.g2o: the covariance of {tag} {named} (sigmas {sigmas}) is singular to "
            f"rounding, so that it has no information; {_SETTINGS[tag]}"
        )
    lines = [_line(tag, *edge) for edge in zip(ids, z, information, strict=True)]
    upper = exact[:, *np.triu_indices(exact.shape[1])]
    return [f"{line} # {_text(entries)}" for line, entries in zip(lines, upper, strict=True)]


def _line(tag: str, ids: tuple[int, ...], z: Array, information: Array) -> str:
    upper = information[np.triu_indices(len(information))]
    return f"{tag} {' '.join(str(int(i)) for i in ids)} {_text(z)} {_text(upper)}"


def _symmetric(entries: Array, size: int) -> Array:
    """(N, n, n) from upper triangles (N, n (n + 1) / 2) by rows."""
    matrix = np.zeros((len(entries), size, size))
    row, column = np.triu_indices(size)
    matrix[:, row, column] = matrix[:, column, row] = entries
    return matrix


def _text(numbers: Array | tuple[float, ...]) -> str:
    """The shortest text that reads back as the same numbers."""
    return " ".join(repr(float(number)) for number in numbers)
