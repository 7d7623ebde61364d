"""Which planted defects are caught and named, and how often a sound filter is flagged.

    python benchmarks/defects.py [--seed 4] [--seeds 200] [--noise-scale 1] [--only WORD]
                                [--table]

Every defect of adapters.defects runs on a log that shows it; `named` says whether the first
cause is the right one. Then the sound filter drives simulated loops, one per seed, with so much of
the document's noise, true and stated; a verdict of `disagree` is a false alarm, and each band's
share outside stands beside what is expected. The interval is Clopper and Pearson's, 95 %. --table
prints the defects as Markdown.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections import Counter

import numpy as np
from scipy.stats import beta

from comparisons.adapters.defects.registry import REGISTRY
from comparisons.checks.causes import FITTED
from comparisons.experiments.bands.coverage import figures_of
from comparisons.experiments.defects.trial import named_first, run_defect
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.pipeline.compare import compare


def interval(count: int, total: int) -> tuple[float, float]:
    """Clopper and Pearson's 95 % of a share."""
    low = float(beta.ppf(0.025, count, total - count + 1)) if count else 0.0
    high = float(beta.ppf(0.975, count + 1, total - count)) if count < total else 1.0
    return low, high


def short(evidence: str, hint: str) -> str:
    """What tells most: the known mistake, else what differs, else the evidence."""
    if hint.startswith(FITTED):
        return hint.removeprefix(FITTED)
    parts = evidence.split("; ")
    return parts[1] if len(parts) > 1 and "rounding allows" in parts[0] else parts[0]


def defects(seed: int, only: str, *, table: bool) -> None:
    """Print those whose name holds a word."""
    caught = named = 0
    if table:
        print("| defect | shows in | what the report says |\n|---|---|---|")
    else:
        print(f"{'defect':<42} {'verdict':<9} {'first':<8} named  evidence")
    chosen = [defect for defect in REGISTRY if only in defect.name]
    for defect in chosen:
        verdict = run_defect(defect, seed).verdict
        reported = named_first(defect, verdict)
        caught, named = caught + (verdict.outcome != "agree"), named + reported
        gap = verdict.causes[0].gap if verdict.causes else "none"
        said = short(verdict.causes[0].evidence, verdict.causes[0].hint) if verdict.causes else ""
        if table:
            print(f"| {defect.name}: {defect.what} | {gap} | {said} |")
        else:
            print(
                f"{defect.name:<42} {verdict.outcome:<9} {gap:<8} {'yes' if reported else 'NO':<6} "
                f"{said}",
                flush=True,
            )
    print(f"{caught} of {len(chosen)} caught, {named} with the right first cause")


def false_alarms(seeds: int, noise_scale: float, loop_s: float) -> None:
    """Print how often the sound filter is flagged, by the verdict and by each band."""
    drive = Drive(noise_scale=noise_scale, loop_s=loop_s)
    outcomes, blamed, outside = Counter[str](), Counter[str](), Counter[str]()
    for seed in range(seeds):
        c = compare(simulate(np.random.default_rng(seed), drive))
        outcomes[c.verdict.outcome] += 1
        blamed.update(cause.gap for cause in c.verdict.causes)
        figures = figures_of(c)
        outside.update(dict.fromkeys((name for name, one in figures.items() if one.band), 0))
        outside.update(name for name, one in figures.items() if one.band and not one.value)
    low, high = interval(outcomes["disagree"], seeds)
    print(
        f"sound filter, true and stated noise {noise_scale:g} times the document's, {loop_s:g} s: "
        f"{outcomes['disagree']} of {seeds} flagged, {100.0 * low:.1f} to {100.0 * high:.1f} %"
        + (f"; {outcomes['unverified']} unverified" if outcomes["unverified"] else "")
        + "".join(f"; {gap} {count}" for gap, count in blamed.items())
    )
    expected = {name: seeds * (1.0 - one.nominal) for name, one in figures.items() if one.band}
    print("outside the band of, with what is expected of a filter that is exact:")
    for name, count in outside.items():
        print(f"  {name:<60} {count:>4} of {seeds}, {expected[name]:.1f}")


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=4, help="of the defects' logs")
    parser.add_argument("--seeds", type=int, default=200, help="of the sound filter's drives")
    parser.add_argument("--noise-scale", type=float, default=1.0)
    parser.add_argument("--loop-s", type=float, default=85.0)
    parser.add_argument("--only", default="", help="defects whose name holds this")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    defects(options.seed, options.only, table=options.table)
    if options.seeds:
        false_alarms(options.seeds, options.noise_scale, options.loop_s)


if __name__ == "__main__":
    main()
