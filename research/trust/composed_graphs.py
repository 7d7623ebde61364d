"""Faults drawn by slot and change, planted in pose graphs, and what `slamcheck solve` says.

    python -m research.trust.composed_graphs [--faults 150] [--sound 50] [--seed 0] [--list]

Graphs are drawn: a drive with loop closures, often with landmarks or absolute positions, noise as
the informations state it, vertices by dead reckoning or at the true poses. What an edge measures,
its information, its ends or its labels are changed as a program with a fault would write them. A
fault counts where it has an effect: the optimum's likelihood falls by e^20 and more, or the file is
refused. It is named where its slot and its change are in what is said (`or`: among others that are
said to fit as well); `another`: something else is named; `located`: no change is named, but where
the edges disagree; `nothing`: no more than a chi-square. Sound graphs must be accused of nothing.
"""

from __future__ import annotations

import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from comparisons import plane
from comparisons.arrays import Array, Index
from comparisons.errors import InputError
from comparisons.logs.bundled import open_log
from comparisons.pipeline.solve import Solution, solve
from graphslam.increments import dead_reckoned
from graphslam.marginals import SingularProblemError
from graphslam.scan import planar
from research.script import options, print_head, print_row

EFFECT = 40.0
"""Twice the logarithm of the likelihoods' ratio from which a fault has an effect."""
OUTCOMES = "named", "or", "another", "located", "nothing"
CHAIN, CLOSURES, ALL, MARKS, FIXES = "odometry", "closures", "all edges", "landmarks", "positions"
SLOT_WORDS = {
    CHAIN: r"the odometry's edges",
    CLOSURES: r"the loop closures",
    ALL: r"all edges between poses",
    MARKS: r"the measurements of landmarks",
    FIXES: r"the positions",
}
"""What sentences call the slots."""


@dataclass(frozen=True)
class DrawnEdges:
    """Edges of a kind: ids (N, 2), measured (N, d), information's entries (N, d (d + 1) / 2)."""

    ids: Index
    z: Array
    entries: Array


@dataclass(frozen=True)
class DrawnGraph:
    """Edges by kind, vertices (K, 3), headings (K,) that are true, whether a line fixes pose 0."""

    edges: dict[str, DrawnEdges]
    vertices: Array
    heading: Array
    fixed: bool = True

    def changed(
        self,
        kind: str,
        z: Array | None = None,
        entries: Array | None = None,
        ids: Index | None = None,
    ) -> DrawnGraph:
        """Return the graph with other columns of one kind of edges."""
        old = self.edges[kind]
        new = DrawnEdges(
            old.ids if ids is None else ids,
            old.z if z is None else z,
            old.entries if entries is None else entries,
        )
        return replace(self, edges={**self.edges, kind: new})

    def text(self) -> str:
        """Return the file."""
        lines = [f"VERTEX_SE2 {k} {_row(pose)}" for k, pose in enumerate(self.vertices)]
        lines += ["FIX 0"] if self.fixed else []
        tags = {MARKS: "EDGE_SE2_XY", FIXES: "EDGE_PRIOR_SE2_XY"}
        for kind, edges in self.edges.items():
            tag = tags.get(kind, "EDGE_SE2")
            for ids, z, entries in zip(edges.ids, edges.z, edges.entries, strict=True):
                ends = ids[:1] if kind == FIXES else ids
                lines.append(f"{tag} {' '.join(map(str, ends))} {_row(z)} {_row(entries)}")
        return "\n".join(lines) + "\n"


class GraphFault(NamedTuple):
    """A fault. kind: slot. change: its name. plant: makes the graph. accepted: its words."""

    kind: str
    change: str
    plant: Callable[[DrawnGraph], DrawnGraph]
    accepted: str


@dataclass
class GraphSentences:
    """What is said of a graph: sentences by their kind."""

    named: list[str] = field(default_factory=list)
    located: list[str] = field(default_factory=list)


def _row(numbers: Array) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)


def matrices(entries: Array, size: int) -> Array:
    """(N, n, n) of upper triangles by rows."""
    full = np.zeros((len(entries), size, size))
    full[:, *np.triu_indices(size)] = entries
    return np.asarray(full + np.triu(full, 1).transpose(0, 2, 1))


def upper(matrix: Array) -> Array:
    """(N, n (n + 1) / 2) upper triangles by rows."""
    return np.asarray(matrix[:, *np.triu_indices(matrix.shape[1])])


def _inverted(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _root(matrix: Array) -> Array:
    """Upper Cholesky factors."""
    return np.asarray(np.linalg.cholesky(matrix).mT, dtype=np.float64)


def drawn_graph(rng: np.random.Generator) -> DrawnGraph:
    """Draw a sound graph."""
    true = _driven(rng)
    count = len(true)
    correlated = bool(rng.random() < 0.6)
    size = np.array((rng.uniform(0.02, 0.08), rng.uniform(0.01, 0.05), rng.uniform(0.004, 0.015)))
    edges = {CHAIN: _motions(rng, true, np.arange(count - 1), np.arange(1, count),
                             size, correlated)}  # fmt: skip
    first, second = _passages(rng, true)
    edges[CLOSURES] = _motions(
        rng, true, first, second, size * rng.uniform(0.5, 1.5, 3), correlated
    )
    if rng.random() < 0.4:
        edges[MARKS] = _landmarks(rng, true)
    if rng.random() < 0.35:
        edges[FIXES] = _positions(rng, true)
    vertices = true
    if rng.random() < 0.6:
        vertices = _wrapped(dead_reckoned(true[0], edges[CHAIN].z))
    return DrawnGraph(edges, vertices, true[:, 2], FIXES not in edges or rng.random() < 0.5)


def _driven(rng: np.random.Generator) -> Array:
    """Twice or more round a place with corners: (K, 3) true poses, the first at the origin."""
    sides = [int(n) for n in rng.integers(3, 7, 2)]
    lap = [k for n in (*sides, *sides) for k in [0.0] * (n - 1) + [0.5 * np.pi]]
    turn = np.array(lap * int(rng.integers(2, 4))) * rng.choice((-1.0, 1.0))
    turn += 0.1 * rng.standard_normal(len(turn))
    step = rng.uniform(0.5, 1.5) * (1.0 + 0.3 * rng.standard_normal(len(turn)))
    poses = [np.zeros(3)]
    for k in range(len(turn)):
        motion = np.array((abs(step[k]), 0.15 * step[k] * np.sin(1.3 * k), turn[k]))
        poses.append(planar.compose(poses[-1], motion))
    return np.array(poses)


def _passages(rng: np.random.Generator, true: Array) -> tuple[Index, Index]:
    """Ends of closures, the earlier pose first."""
    far = np.subtract.outer(np.arange(len(true)), np.arange(len(true))) > 8
    near = np.linalg.norm(true[:, None, :2] - true[None, :, :2], axis=2) < 4.0
    back = np.argwhere(near & far)
    chosen = back[rng.permutation(len(back))[: int(rng.integers(12, 40))]]
    return chosen[:, 1], chosen[:, 0]


def _informations(rng: np.random.Generator, sigma: Array, count: int, correlated: bool) -> Array:
    """(N, n, n) covariances, alike or drawn one by one."""
    size = len(sigma)
    spread = np.tile(np.diag(sigma**2), (count, 1, 1))
    if not correlated:
        return spread
    alike = rng.random() < 0.5
    mixed = rng.standard_normal((1 if alike else count, size, 2 * size)) * sigma[:, None]
    return np.broadcast_to(mixed @ mixed.mT / (2 * size), spread.shape)


def _motions(
    rng: np.random.Generator, true: Array, first: Index, second: Index, sigma: Array,
    correlated: bool,
) -> DrawnEdges:  # fmt: skip
    covariance = _informations(rng, sigma, len(first), correlated)
    noise = (np.linalg.cholesky(covariance) @ rng.standard_normal((len(first), 3, 1)))[..., 0]
    z = [
        planar.wrapped(planar.compose(planar.between(true[i], true[j]), error))
        for i, j, error in zip(first, second, noise, strict=True)
    ]
    return DrawnEdges(np.column_stack((first, second)), np.array(z), upper(_inverted(covariance)))


def _landmarks(rng: np.random.Generator, true: Array) -> DrawnEdges:
    count = int(rng.integers(6, 15))
    places = true[rng.integers(len(true), size=count), :2] + rng.uniform(-5.0, 5.0, (count, 2))
    sigma = np.array((rng.uniform(0.05, 0.2), rng.uniform(0.01, 0.03)))
    ids, z, entries = [], list[Array](), list[Array]()
    for k, (x, y, heading) in enumerate(true):
        for mark, place in enumerate(places):
            ahead = (complex(*place) - complex(x, y)) * np.exp(-1j * heading)
            if not 1.0 < abs(ahead) < 7.0 or rng.random() < 0.5:
                continue
            r, bearing = (abs(ahead), np.angle(ahead)) + sigma * rng.standard_normal(2)
            cos, sin = np.cos(bearing), np.sin(bearing)
            root = np.array(((cos, sin), (-sin / r, cos / r))) / sigma[:, None]
            ids.append((k, 10_000 + mark))
            z.append(np.array((r * cos, r * sin)))
            entries.append(upper((root.T @ root)[None])[0])
    return DrawnEdges(np.array(ids), np.array(z), np.array(entries))


def _positions(rng: np.random.Generator, true: Array) -> DrawnEdges:
    at = np.arange(0, len(true), int(rng.integers(2, 6)))
    sigma = rng.uniform(0.05, 0.3) * np.array((1.0, rng.uniform(0.4, 1.0)))
    z = true[at, :2] + sigma * rng.standard_normal((len(at), 2))
    entries = np.tile(upper(np.diag(sigma**-2.0)[None]), (len(at), 1))
    return DrawnEdges(np.column_stack((at, at)), z, entries)


Measured = Callable[[Array], Array]


def _composed(z: Array, before: Array | None = None, after: Array | None = None) -> Array:
    """Motions (N, 3) with a fixed one before or after each."""
    none = np.zeros(3)
    return np.array(
        [
            planar.compose(
                planar.compose(none if before is None else before, motion),
                none if after is None else after,
            )
            for motion in z
        ]
    )


def _inverse(z: Array) -> Array:
    return np.array([planar.between(motion, np.zeros(3)) for motion in z])


def _picked(order: list[int], entries: Array) -> Array:
    return entries[:, order]


def _labelled(by: Index, graph: DrawnGraph) -> DrawnGraph:
    return graph.changed(CLOSURES, ids=graph.edges[CLOSURES].ids + by)


def _everywhere(motion: Array, z: Array) -> Array:
    return np.broadcast_to(motion, z.shape)


def _previous(z: Array) -> Array:
    return np.concatenate((z[:1], z[:-1]))


def _wrapped(z: Array) -> Array:
    return np.array([planar.wrapped(motion) for motion in z])


def _turned(z: Array, angle: Array | float) -> Array:
    return np.column_stack((plane.turned(z[:, :2], angle), z[:, 2:]))


def _placed(z: Array, frame: Array) -> Array:
    """Points (N, 2) in a frame on the vehicle."""
    return plane.turned(z - frame[:2], -frame[2])


def _frame(rng: np.random.Generator) -> Array:
    place = rng.uniform(0.2, 1.2, 2) * rng.choice((-1.0, 1.0), 2)
    turn = rng.choice((0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi, 0.1, -0.2))
    return np.array((*place, turn))


def changes_of_motion(rng: np.random.Generator) -> dict[str, tuple[Measured, str]]:
    """Changes of what edges between poses measure, and the words that name each."""
    size, frame = float(rng.choice((0.5, 0.9, 1.1, 2.0))), _frame(rng)
    signs = np.array([(-1.0) ** k for k in map(int, f"{int(rng.integers(1, 8)):03b}")])
    minus = [name for name, sign in zip(("x", "y", "heading"), signs, strict=True) if sign < 0.0]
    listed = minus[0] if len(minus) == 1 else f"{', '.join(minus[:-1])} and {minus[-1]}"
    back = planar.between(frame, np.zeros(3))
    return {
        "inverse": (_inverse, r"inverted|two poses are exchanged"),
        "negated": (lambda z: z * signs, rf"opposite sign of {listed}\b|inverted"),
        "exchanged": (lambda z: z[:, [1, 0, 2]], r"in the order y, x, heading"),
        "degrees": (lambda z: z * (1.0, 1.0, np.degrees(1.0)), r"degrees"),
        "radians twice": (lambda z: z * (1.0, 1.0, np.radians(1.0)), r"radians twice"),
        "turned by itself": (
            lambda z: _turned(z, -z[:, 2]),
            r"in the second pose's axes|axes of the second pose",
        ),
        "size": (lambda z: z * (size, size, 1.0), r"translations"),
        "turns": (lambda z: z * (1.0, 1.0, size), r"headings .* times"),
        "frame": (lambda z: _composed(z, back, frame), r"motions of a frame"),
        "before": (lambda z: _composed(z, before=frame), r"before each"),
        "after": (lambda z: _composed(z, after=frame), r"after each"),
        "previous": (_previous, r"edge before"),
    }


def changes_of_point(rng: np.random.Generator) -> dict[str, tuple[Measured, str]]:
    """Changes of points."""
    size, frame = float(rng.choice((0.5, 0.9, 1.1, 2.0))), _frame(rng)
    return {
        "negated x": (lambda z: z * (-1.0, 1.0), r"opposite sign of x\b"),
        "negated y": (lambda z: z * (1.0, -1.0), r"opposite sign of y\b"),
        "exchanged": (lambda z: z[:, ::-1], r"in the order y, x"),
        "size": (lambda z: z * size, r"ranges|coordinates"),
        "frame": (lambda z: _placed(z, frame), r"frame"),
        "previous": (_previous, r"edge before"),
    }


def changes_of_information(rng: np.random.Generator, size: int) -> dict[str, tuple[Measured, str]]:
    """Changes of entries (N, n (n + 1) / 2), and the words that name each."""
    factor = float(rng.choice((0.01, 0.1, 0.25, 4.0, 10.0, 100.0)))

    def of(change: Measured) -> Measured:
        return lambda entries: upper(change(matrices(entries, size)))

    def sorted_by(order: list[int]) -> Measured:
        return of(lambda m: m[:, order][:, :, order])

    changes: dict[str, tuple[Measured, str]] = {
        "inverse": (of(_inverted), r"is the covariance(?!')"),
        "root": (of(_root), r"square root of it"),
        "sigmas": (of(lambda m: _root(_inverted(m))), r"covariance's root"),
        "square": (of(lambda m: m @ m), r"square(?! root)"),
        "diagonal": (of(lambda m: m * np.eye(size)), r"off its diagonal"),
        "times": (lambda entries: factor * entries, r"times (?:the|their) information"),
        "factors": (of(lambda m: np.linalg.cholesky(m).mT @ np.linalg.cholesky(m)), r"L\^T L"),
        "y first": (sorted_by([1, 0, 2][:size]), r"order yy"),
    }
    if size == 3:
        entries = {"lower triangle": [0, 1, 3, 2, 4, 5], "diagonal first": [0, 3, 5, 1, 2, 4]}
        changes["heading first"] = (sorted_by([2, 0, 1]), r"order hh|heading first")
        for name, order in entries.items():
            changes[name] = (partial(_picked, order), r"order xx|" + name)
    return changes


def faults(rng: np.random.Generator, graph: DrawnGraph) -> Iterator[GraphFault]:
    """Every fault that a graph can have, its numbers drawn."""
    for kind in graph.edges:
        for what in (kind, ALL) if kind == CHAIN else (kind,):
            yield from _of_kind(rng, graph, what)
    yield from _of_ends(rng)
    yield from _of_single(rng, graph)


def _of_kind(rng: np.random.Generator, graph: DrawnGraph, kind: str) -> Iterator[GraphFault]:
    kinds = (CHAIN, CLOSURES) if kind == ALL else (kind,)
    size = graph.edges[kinds[0]].z.shape[1]
    measured = changes_of_motion(rng) if size == 3 else changes_of_point(rng)
    wrapped = _wrapped if size == 3 else np.asarray
    for name, (change, words) in measured.items():

        def plant(g: DrawnGraph, change: Measured = change, name: str = name) -> DrawnGraph:
            z = change(np.concatenate([g.edges[one].z for one in kinds]))
            z = z if name == "degrees" else wrapped(z)
            for one in kinds:
                count = len(g.edges[one].z)
                g, z = g.changed(one, z=z[:count]), z[count:]
            return g

        yield GraphFault(kind, name, plant, words)
    for name, (change, words) in changes_of_information(rng, size).items():

        def weigh(g: DrawnGraph, change: Measured = change) -> DrawnGraph:
            for one in kinds:
                g = g.changed(one, entries=change(g.edges[one].entries))
            return g

        yield GraphFault(kind, f"information: {name}", weigh, words)
    if kind in (CHAIN, CLOSURES, MARKS):
        yield GraphFault(kind, "map's axes", lambda g: _in_maps_axes(g, kind), "axes of the map")


def _in_maps_axes(graph: DrawnGraph, kind: str) -> DrawnGraph:
    edges = graph.edges[kind]
    return graph.changed(kind, z=_turned(edges.z, graph.heading[edges.ids[:, 0]]))


def _of_ends(rng: np.random.Generator) -> Iterator[GraphFault]:
    """Which poses and landmarks the edges join, and how often they stand there."""
    ends = r"two poses are exchanged|inverted"
    yield GraphFault(
        CLOSURES, "ends exchanged",
        lambda g: g.changed(CLOSURES, ids=g.edges[CLOSURES].ids[:, ::-1]), ends,
    )  # fmt: skip
    for end, words in ((0, "first pose is the one before"), (1, "second pose is the one after")):
        by = np.eye(2, dtype=int)[end] * (1 if end == 0 else -1)
        yield GraphFault(
            CLOSURES, "ends off by one",
            partial(_labelled, by),
            words,
        )  # fmt: skip
    yield GraphFault(CLOSURES, "twice", _doubled, r"twice")


def _doubled(graph: DrawnGraph) -> DrawnGraph:
    e = graph.edges[CLOSURES]
    twice = DrawnEdges(
        np.concatenate((e.ids, e.ids)),
        np.concatenate((e.z, e.z)),
        np.concatenate((e.entries, e.entries)),
    )
    return replace(graph, edges={**graph.edges, CLOSURES: twice})


def _of_single(rng: np.random.Generator, graph: DrawnGraph) -> Iterator[GraphFault]:
    """One edge alone is wrong."""
    for kind in (CHAIN, CLOSURES):
        row = int(rng.integers(2, len(graph.edges[kind].z)))
        first, second = graph.edges[kind].ids[row]
        place = rf"\b{first} to {second}\b"
        some = changes_of_motion(rng)
        wild = np.array((*rng.uniform(-3.0, 3.0, 2), rng.uniform(-3.0, 3.0)))
        some = {name: some[name] for name in ("inverse", "negated", "before")}
        some["wild"] = partial(_everywhere, wild), ""
        for name, (change, _) in some.items():

            def plant(
                g: DrawnGraph, kind: str = kind, row: int = row, change: Measured = change
            ) -> DrawnGraph:
                z = g.edges[kind].z.copy()
                z[row] = planar.wrapped(change(z[row : row + 1])[0])
                return g.changed(kind, z=z)

            yield GraphFault("one edge", name, plant, place)


def likelihood(solution: Solution) -> float:
    """-2 log likelihood of the optimum, but for a constant."""
    p = solution.result.problem
    spreads = (p.increment_covariance[p.steps], p.loop_closures.covariance, p.position_covariance)
    total = 2.0 * solution.result.error + 2.0 * float(np.log(p.sigma).sum())
    return total + sum(float(np.linalg.slogdet(one)[1].sum()) for one in spreads if len(one))


def said_of(solution: Solution) -> GraphSentences:
    """What is named and what is located, of a solution's sentences."""
    said = GraphSentences()
    for one in (*solution.lacks, *solution.notes):
        if re.search(r"do not agree; |do not agree with the rest, which fits without them; ", one):
            said.located.append(one)
        elif re.search(r"\bfit\b|are of two frames|not agree with the rest|twice", one):
            said.named.append(one)
    return said


def judged(fault: GraphFault, said: GraphSentences) -> str:
    """How a fault was named, of OUTCOMES."""
    if not said.named:
        return "located" if said.located else "nothing"
    slot = SLOT_WORDS.get(fault.kind, r"edge|closure")
    text = said.named[0].partition(": chi-square")[0]
    parts = re.split(r", or ", text)
    right = [bool(re.search(slot, one) and re.search(fault.accepted, one)) for one in parts]
    if any(right):
        return "named" if len(parts) == 1 or right[0] else "or"
    return "another"


def solved(graph: DrawnGraph, folder: Path) -> Solution | str:
    """Return what `solve` finds, or why it refuses the file."""
    path = folder / "graph.g2o"
    path.write_text(graph.text())
    try:
        return solve(open_log(str(path)))
    except (InputError, SingularProblemError) as error:
        return str(error)


def outcome(graph: DrawnGraph, fault: GraphFault, folder: Path) -> tuple[str, str] | None:
    """How a fault is named, and what is said; None where it has no effect."""
    sound, spoilt = solved(graph, folder), solved(fault.plant(graph), folder)
    if isinstance(sound, str):
        return None
    if isinstance(spoilt, str):
        named = bool(re.search(fault.accepted, spoilt))
        return "named" if named else "located" if ":" in spoilt else "nothing", spoilt
    same = np.abs(spoilt.result.poses - sound.result.poses).max() < 1e-6
    worse, right = (likelihood(one) for one in (spoilt, sound))
    if same or worse < right + EFFECT:
        return None
    said = said_of(spoilt)
    return judged(fault, said), " / ".join((*said.named, *said.located, *spoilt.lacks[:1]))


def drawn_fault(rng: np.random.Generator, graph: DrawnGraph) -> GraphFault:
    """Draw a slot, then a change of it."""
    every = list(faults(rng, graph))
    kinds = sorted({one.kind for one in every})
    kind = kinds[int(rng.integers(len(kinds)))]
    some = [one for one in every if one.kind == kind]
    return some[int(rng.integers(len(some)))]


def main() -> None:
    """Draw, plant, solve and count."""
    given = options(__doc__, faults=150, sound=50, seed=0, list=False)
    counts: Counter[tuple[str, str, str]] = Counter()
    accused, number = list[str](), 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        while sum(counts.values()) < given.faults:
            number += 1
            rng = np.random.default_rng((given.seed, number))
            graph = drawn_graph(rng)
            fault = drawn_fault(rng, graph)
            found = outcome(graph, fault, folder)
            if found is None:
                continue
            counts[fault.kind, fault.change, found[0]] += 1
            if given.list and found[0] != "named":
                print(f"{number}: {found[0]:8} {fault.kind}, {fault.change}\n  {found[1][:400]}",
                      flush=True)  # fmt: skip
        for k in range(given.sound):
            solution = solved(drawn_graph(np.random.default_rng((given.seed, 1, k))), folder)
            said = GraphSentences([solution]) if isinstance(solution, str) else said_of(solution)
            accused += [f"{k}: {one}" for one in (*said.named, *said.located)]
    for index, title in ((0, "slot"), (1, "change")):
        print_head(title, "drawn", *OUTCOMES)
        for key in sorted({one[index] for one in counts}):
            each = [sum(n for one, n in counts.items() if one[index] == key and one[2] == which)
                    for which in OUTCOMES]  # fmt: skip
            print_row(key, sum(each), *each)
        print()
    total = [sum(n for one, n in counts.items() if one[2] == which) for which in OUTCOMES]
    print_row("all", sum(total), *total)
    print(f"sound graphs accused: {len(accused)} of {given.sound}", *accused, sep="\n  ")


if __name__ == "__main__":
    main()
