"""Which planted defects are caught and named, and how often a sound filter is flagged.

    python -m research.trust.defects [--only WORD] [--seeds 200] [--loop-s 85]

Every fault of comparisons.faults whose name holds the word runs on a log that shows it. Then the
sound filter drives simulated loops of so many seconds, one per seed; a verdict of `disagree` is a
false alarm, and each band's share outside stands beside what is expected. The interval is Clopper
and Pearson's, 95 %.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.stats import binomtest

from comparisons.checks.model import FITTED
from comparisons.checks.verdict import Verdict
from comparisons.config import RunConfig
from comparisons.faults.catalogue import NAMED
from comparisons.faults.fault import Fault
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.run import REQUIRED, Comparison, Modified, compare, compare_prepared
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.pipeline.prepare import prepare
from research.script import options, print_head, print_row
from research.trust.coverage import figures_of
from research.trust.drives import open_case

CAUSES: dict[str, tuple[str, ...]] = {
    "cross-covariance dropped at augmentation": (
        "algebra",
        "augmentation",
        "the new block's covariance with all but pose is zero",
    ),
    "vehicle dropped at augmentation": (
        "algebra",
        "augmentation",
        "the new block's covariance with the others is zero",
    ),
    "cross-covariance dropped at prediction": (
        "algebra",
        "prediction",
        "the covariance of pose with all others is as before the event",
    ),
    "F transposed": ("algebra", "prediction", "F is transposed"),
    "asymmetric covariance": (
        "algebra",
        "prediction",
        "on one side of the diagonal is as before the event",
    ),
    "gain not transposed": ("algebra", "update", "the covariance is A P A + K R K^T"),
    "cross-covariance dropped at update": (
        "algebra",
        "update",
        "the covariance of pose with all others is as before the event",
    ),
    "landmarks kept independent": (
        "algebra",
        "update",
        "the covariance of all blocks but pose with each other is zero",
    ),
    "only seen landmarks updated": (
        "algebra",
        "update",
        "does not correct the estimate of landmark",
    ),
    "innovation subtracted": (
        "algebra",
        "update",
        "corrects the estimate of all blocks with the wrong sign",
    ),
    "R left out of S": ("algebra", "update", "by residual times the gain where R is zero"),
    "bearing Jacobian as printed": ("model", "bearing row", "opposite sign"),
    "no heading column": ("model", "the Jacobian with respect to heading is missing"),
    "range only": ("model", "bearing row", "zero"),
    "innovation not wrapped": ("model", "the innovation", "not wrapped"),
    "bearing clockwise": ("model", "the innovation", "the bearing has the opposite sign"),
    "stale Jacobian": ("model", "the Jacobian", "the previous scan"),
    "R not rotated by G_z": ("model", "G_z is the identity"),
    "no heading at augmentation": (
        "model",
        "landmark initialisations",
        "the Jacobian with respect to heading is missing",
    ),
    "landmark from the old pose": ("model", "landmark initialisations", "pose before the update"),
    "wrong quadrant": ("model", "landmark initialisations", "quadrant"),
    "steering sign": ("model", "the predicted pose", "steering angle has the opposite sign"),
    "wheelbase wrong": ("model", "the predicted pose", "wheelbase"),
    "sensor's place left out": ("model", "the predicted pose", "sensor's position"),
    "F the identity": (
        "model",
        "the Jacobian with respect to heading",
        "the heading term of the position rows of F is zero",
    ),
    "B without dt": ("model", "the noise covariance", "not multiplied by the interval"),
    "heading drift": ("model", "the predicted pose", "yaw rate has a bias"),
    "F's position terms' sign": (
        "model",
        "the heading term of the position rows of F has the opposite sign",
    ),
    "lever arm left out": ("model", "position updates", "lever arm"),
    "sigma squared twice": ("model", "the noise covariance", "square of the variances"),
    "sigma for variance in R": ("model", "the noise covariance", "R contains sigma"),
    "twice the variance in R": ("model", "the noise covariance", "R is 2 times"),
    "degrees for radians in R": ("model", "the noise covariance", "degrees"),
    "sigma for variance in Q": ("model", "the noise covariance", "Q contains sigma"),
    "twice the variance in Q": ("model", "the noise covariance", "Q is 2 times"),
    "previous interval": ("model", "the predicted pose", "the interval of the previous one"),
    "interval ignored": ("model", "the predicted pose", "interval is always 0.025 s"),
    "control applied twice": ("model", "the predicted pose", "the control is applied twice"),
    "control applied half": ("model", "the predicted pose", "0.5 times its interval"),
    "measurement one scan late": ("data", "measurements", "late"),
    "measurement one step late": ("data", "measurements", "late"),
    "position fused twice": ("data", "positions", "more than once"),
    "measurement fused twice": ("data", "measurements", "more than once"),
    "landmark initialised again": ("data", "labels", "several landmarks"),
    "labels exchanged": ("data", "labels", "one landmark"),
    "gate of sigmas": ("data", "rejected", "gate"),
}
"""By a fault's name: the gap that the first cause must be of, and words it must hold."""
LOG = {
    "previous interval": "uneven",
    "interval ignored": "uneven",
    "position fused twice": "positions",
    "lever arm left out": "positions",
    "landmark initialised again": "closing",
}
"""Which log of `drives` shows a fault, where it is not the loop."""


def shows(fault: Fault) -> str:
    """Return the name of the log that shows a fault."""
    return LOG.get(fault.name, "loop")


def run_defect(fault: Fault, seed: int = 4) -> Comparison:
    """Return the comparison of a filter with the fault, on a log that shows it."""
    log, ekf = open_case(shows(fault), seed)
    if fault.plant is None:
        raise ValueError(f"{fault.name} is not planted in a filter")
    planted = [Modified(fault.plant)]
    return compare_prepared(prepare(log, RunConfig(ekf=ekf), required=REQUIRED, also=planted))


def named_first(fault: Fault, verdict: Verdict | ExternalCheck) -> bool:
    """Return whether the first cause is the fault: the right gap, and all of its words."""
    if not verdict.causes:
        return False
    first = verdict.causes[0]
    gap, *words = CAUSES[fault.name]
    text = f"{first.evidence}; {first.hint}"
    return first.gap == gap and all(word in text for word in words)


def share(count: int, total: int, what: str = "flagged") -> str:
    """A count of something, and the interval of its share."""
    low, high = binomtest(count, total).proportion_ci()
    return f"{count} of {total} {what}, {100.0 * low:.1f} to {100.0 * high:.1f} %"


def short(evidence: str, hint: str) -> str:
    """What tells most: the known mistake, else what differs, else the evidence."""
    if hint.startswith(FITTED):
        return hint.removeprefix(FITTED)
    parts = evidence.split("; ")
    return parts[1] if len(parts) > 1 and "rounding allows" in parts[0] else parts[0]


def defects(chosen: Sequence[Fault]) -> None:
    """Print what the report says of each, and which have another first cause."""
    print_head("defect", "shows in", "what the report says")
    caught, other = 0, list[str]()
    for defect in chosen:
        verdict = run_defect(defect).verdict
        caught += verdict.outcome != "agree"
        other += [] if named_first(defect, verdict) else [defect.name]
        first = next(iter(verdict.causes), None)
        said = ("none", "") if first is None else (first.gap, short(first.evidence, first.hint))
        print_row(f"{defect.name}: {defect.what}", *said)
    right = len(chosen) - len(other)
    print(
        f"{caught} of {len(chosen)} caught, {right} with the right first cause"
        + (f"; not: {', '.join(other)}" if other else "")
    )


def false_alarms(seeds: int, loop_s: float) -> None:
    """Print how often the sound filter is flagged, by the verdict and by each band."""
    drive = Drive(loop_s=loop_s)
    outcomes, blamed, outside = Counter[str](), Counter[str](), Counter[str]()
    for seed in range(seeds):
        c = compare(simulate(np.random.default_rng(seed), drive))
        outcomes[c.verdict.outcome] += 1
        blamed.update(cause.gap for cause in c.verdict.causes)
        bands = {name: one for name, one in figures_of(c).items() if one.band}
        outside.update({name: not one.value for name, one in bands.items()})
    print(
        f"sound filter, true and stated noise {drive.noise_scale:g} times the document's, "
        f"{loop_s:g} s: {share(outcomes['disagree'], seeds)}"
        + (f"; {outcomes['unverified']} unverified" if outcomes["unverified"] else "")
        + "".join(f"; {gap} {count}" for gap, count in blamed.items())
    )
    print("outside the band of, with what is expected of a filter that is exact:")
    for name, count in outside.items():
        expected = seeds * (1.0 - bands[name].nominal)
        print(f"  {name:<60} {count:>4} of {seeds}, {expected:.1f}")


def main() -> None:
    """Print both."""
    given = options(__doc__, only="", seeds=200, loop_s=85.0)
    if chosen := [one for one in NAMED if given.only in one.name]:
        defects(chosen)
    if given.seeds:
        false_alarms(given.seeds, given.loop_s)


if __name__ == "__main__":
    main()
