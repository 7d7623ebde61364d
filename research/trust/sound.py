"""Is nothing sound accused: logs, other people's filters, graphs of poses?

    python -m research.trust.sound [--quick] [--list]

Drives with three kinds of odometry through `run`; traces of the filters in
examples/audit through `audit`; graphs whose edges are drawn from their information through `solve`.
A cause, a fault, a reading of the edges or a note on them counts as an accusation. What else stands
beside a verdict is counted; --list prints both. --quick takes a tenth of each. The exit code is 1
where a sound input is accused.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import numpy as np

from comparisons.audit.audit import audit
from comparisons.checks.optimum import misfit_remarks
from comparisons.jobs.run import compare
from comparisons.logs.bundled import open_log
from comparisons.pipeline.solve import solve
from graphslam.scan import planar
from research.script import options
from research.trust.audit_faults import FILTERS
from research.trust.odometry_drives import sound, travelled
from research.trust.row import PromiseRow, print_table

LOGS, EACH_FILTER, GRAPHS = 60, 8, 20
_FIRST_SEED = 7000


class Said(NamedTuple):
    """What a command says of a sound input: accused, and what else stands beside the verdict."""

    name: str
    accused: tuple[str, ...]
    beside: tuple[str, ...]


def of_logs(count: int) -> Iterator[Said]:
    """`run` with the log's labels."""
    for log in sound(count):
        verdict = compare(log).verdict
        accused = [f"{one.gap}: {one.evidence}" for one in verdict.causes]
        accused += [] if verdict.outcome == "agree" else [verdict.headline]
        beside = (*verdict.qualifiers, *(verdict.inconsistent or ()), *verdict.remarks)
        yield Said(log.name, tuple(accused), beside)


def of_traces(each: int) -> Iterator[Said]:
    """`audit` of filters that others wrote."""
    with tempfile.TemporaryDirectory() as folder:
        for name in (*FILTERS, "filterpy_ukf"):
            for seed in range(_FIRST_SEED, _FIRST_SEED + each):
                path = Path(folder) / f"{name}-{seed}"
                import_module(f"examples.audit.{name}").record(path, seed)
                found = audit(path)
                accused = [one.text for one in found.findings if one.fault]
                accused += [] if found.sound or accused else [found.verdict]
                beside = [one.text for one in found.findings if not one.fault]
                yield Said(path.name, tuple(accused), tuple(beside))


def of_graphs(count: int) -> Iterator[Said]:
    """`solve` of graphs of poses."""
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(_FIRST_SEED, _FIRST_SEED + count):
            path = Path(folder) / f"graph-{seed}.g2o"
            path.write_text(graph(seed))
            found = solve(open_log(str(path)))
            beside = (*found.notes, *found.open_loops, *misfit_remarks(found.result.optimality))
            yield Said(path.name, tuple(found.lacks), tuple(one for one in beside if one))


def graph(seed: int) -> str:
    """A drive of some rounds as g2o's text: edges of odometry, and where it comes past again.

    Steps, noise and number of closures are drawn; every third graph's informations differ by edge.
    """
    rng = np.random.default_rng(seed)
    count, around = int(rng.integers(80, 300)), int(rng.integers(30, 60))
    step = rng.uniform(0.3, 2.0)
    turned = 2.0 * np.pi / around * rng.choice((-1.0, 1.0)) * (1.0 + rng.uniform(-0.5, 0.5, count))
    true = travelled(np.full(count, step), turned, 0.5)
    near = np.linalg.norm(true[:, None, :2] - true[None, :, :2], axis=2) < 2.0 * step
    far = np.subtract.outer(np.arange(count + 1), np.arange(count + 1)) > around // 2
    back = np.argwhere(near & far)
    closed = back[rng.permutation(len(back))[: int(rng.integers(10, 80))]][:, ::-1]
    edges = np.vstack((np.column_stack((np.arange(count), np.arange(1, count + 1))), closed))
    sigma = step * rng.uniform(0.01, 0.05) * np.array((1.0, rng.uniform(0.3, 1.0), 0.3))
    start, lines = true[0].copy(), []
    for number, (i, j) in enumerate(edges):
        stated = sigma * (rng.uniform(0.5, 2.0) if seed % 3 == 0 else 1.0)
        z = planar.between(true[i], true[j]) + stated * rng.standard_normal(3)
        if number < count:
            lines.append(f"VERTEX_SE2 {i} " + " ".join(f"{one:.9g}" for one in start))
            start = planar.compose(start, z)
        upper = " ".join(f"{one:.9g}" for one in np.diag(stated**-2)[np.triu_indices(3)])
        lines.append(f"EDGE_SE2 {i} {j} " + " ".join(f"{one:.9g}" for one in z) + f" {upper}")
    lines.append(f"VERTEX_SE2 {count} " + " ".join(f"{one:.9g}" for one in start))
    return "\n".join(lines) + "\n"


def row(name: str, said: list[Said], listed: bool) -> PromiseRow:
    """None accused; how many carry a note is said."""
    accused = [one for one in said if one.accused]
    noted = [one for one in said if one.beside]
    for one in said if listed else ():
        print(f"{one.name}: accused {one.accused}, beside {one.beside}")
    return PromiseRow(
        f"A sound input is not accused: {name}",
        "none",
        f"{len(accused)} of {len(said)}; {len(noted)} with a note",
        not accused,
    )


def rows(quick: bool = False, *, listed: bool = False) -> Iterator[PromiseRow]:
    """Logs, traces, graphs."""
    part = 10 if quick else 1
    yield row("logs by `run`", list(of_logs(LOGS // part)), listed)
    yield row("filters' traces by `audit`", list(of_traces(max(1, EACH_FILTER // part))), listed)
    yield row("graphs of poses by `solve`", list(of_graphs(GRAPHS // part)), listed)


if __name__ == "__main__":
    asked = options(__doc__, quick=False, list=False)
    sys.exit(print_table(rows(asked.quick, listed=asked.list)))
