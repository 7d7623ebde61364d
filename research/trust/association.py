"""Is an association that is called verified right, and does a shared mistake show in the verdict?

    python -m research.trust.association [--quick] [--data FOLDER] [--choose SEEDS]

Own associations of simulated sensors (seeds not used for choosing the constants), of pieces of the
MR.CLAM runs with other beginnings and with added noise, and of the car park. An association is
wrong where the smoother's trajectory with it is more than twice as far from the truth as with the
labels. Then runs whose EKF and smoother share an association. --choose: choose the constants anew,
by five-fold cross-validation over so many simulated sensors.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from comparisons.checks import association_variants
from comparisons.checks.qualifiers import TRUTH_GAP, UNCHECKED, TruthGapFinding
from comparisons.config import SmootherConfig, SolveConfig
from comparisons.errors import InputError
from comparisons.jobs.run import Comparison, compare
from comparisons.logs.bundled import open_log
from comparisons.logs.log import NO_LANDMARK, Log, Truth
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.pipeline.solve import solve
from comparisons.settings import run_config
from graphslam.marginals import SingularProblemError
from research.script import options, present
from research.trust.association_logs import piece, simulated_sensor
from research.trust.row import PromiseRow, print_table

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
_FIRST_TEST_SEED = 1000
_FEWEST_MEASUREMENTS = 40


@dataclass(frozen=True)
class AssociationTrial:
    """One own association. variants: what checking it found."""

    name: str
    own_m: float
    labels_m: float
    verified: bool
    variants: association_variants.AssociationCheck

    @property
    def wrong(self) -> bool:
        """By the trajectory."""
        return self.own_m > 2.0 * self.labels_m


def tried(log: Log, robust: str = "none") -> AssociationTrial | None:
    """Return the own association's trial, None where nothing can be associated.

    robust: of the smoother with the labels, some of which may be misread.
    """
    if len(log.measurements.time_s) < _FEWEST_MEASUREMENTS:
        return None
    labelled = SolveConfig(association="known", smoother=SmootherConfig(robust=robust))
    try:
        known, own = (solve(log, config) for config in (labelled, SolveConfig(association="own")))
    except (InputError, SingularProblemError):
        return None
    checked = present(own.association_check)
    own_m, labels_m = (present(present(one.accuracy).ate_m) for one in (own, known))
    return AssociationTrial(log.name, own_m, labels_m, checked.verified, checked)


def mrclam_pieces(data: Path, quick: bool) -> Iterator[Log]:
    """Pieces of the three runs: 150, 300 and 600 s, as they are and with as much noise again."""
    for robot in (1, 2) if quick else (1, 2, 3):
        log = open_log(str(data / "mrclam" / "MRCLAM_Dataset6"), robot=robot)
        for length in (150.0,) if quick else (150.0, 300.0, 600.0):
            begins = np.arange(40.0, log.end_s - length, min(length, 300.0))
            for begin in (begins[:1] if quick else begins).tolist():
                for noise in (0.0, 1.0):
                    yield piece(log, begin, begin + length, int(begin) + robot, noise)


def association_row(name: str, trials: Sequence[AssociationTrial]) -> PromiseRow:
    """How often a wrong association was called verified, and a right one not."""
    wrong, right = ([one for one in trials if one.wrong == which] for which in (True, False))
    missed = sum(one.verified for one in wrong)
    refused = sum(not one.verified for one in right)
    return PromiseRow(
        f"A wrong own association is not verified: {name}",
        "at most 10 % of the wrong ones verified, at most 20 % of the right ones refused",
        f"{missed} of {len(wrong)} wrong ones verified, {refused} of {len(right)} right ones "
        "refused",
        missed <= 0.1 * len(wrong) and refused <= 0.2 * len(right),
    )


@dataclass(frozen=True)
class SharedMistake:
    """A run whose estimators share an association."""

    name: str
    headline: str
    error_m: float
    labels_m: float
    measurement_m: float

    @property
    def wrong(self) -> bool:
        """More than twice as far off as with labels, and farther than one measurement errs."""
        return self.error_m > max(2.0 * self.labels_m, self.measurement_m)


def shared(log: Log, associations: Iterable[str]) -> Iterator[SharedMistake]:
    """Run a log with its labels and with other associations."""
    with_labels = _error(compare(log, run_config(association="known")))
    for association in associations:
        found = compare(log, run_config(association=association))
        gap, headline = present(found.known.value(TruthGapFinding)), found.verdict.headline
        name = f"{log.name}, {association}"
        yield SharedMistake(name, headline, _error(found), with_labels, gap.measurement_m)


def _error(found: Comparison) -> float:
    """Of the smoother: of its landmarks, or of its poses if that is more."""
    accuracy = present(found.accuracy.smoother)
    return max(accuracy.ate_m or 0.0, accuracy.landmark_rmse_m or 0.0)


def shared_mistake_rows(data: Path, quick: bool) -> Iterator[PromiseRow]:
    """Whether mistakes that both estimators share are named, and nothing else is."""
    names = ("jcbb",) if quick else ("nn", "jcbb", "consensus")
    logs = [log for log in mrclam_pieces(data, quick) if not log.name.endswith("-1")]
    runs = [one for log in logs for one in shared(log, names)]
    agreeing = [one for one in runs if one.headline.startswith("agree")]
    bare = [one for one in agreeing if one.wrong and one.headline == "agree"]
    yield PromiseRow(
        "Two that share a wrong association do not read a bare agree (MR.CLAM pieces, "
        f"{', '.join(names)})",
        "none",
        f"{len(bare)} of {sum(one.wrong for one in agreeing)} that agree and are wrong "
        f"({len(runs)} runs)",
        not bare,
    )
    false = [one for one in runs if not one.wrong and TRUTH_GAP in one.headline]
    right = [one for one in runs if not one.wrong]
    yield PromiseRow(
        "A run that is as good as with labels has no truth gap (the same)",
        "at most 10 %",
        f"{len(false)} of {len(right)}",
        len(false) <= 0.1 * len(right),
    )
    seeds = range(3 if quick else 60)
    sound = [
        compare(simulate(np.random.default_rng(seed), Drive()), run_config(association="known"))
        for seed in seeds
    ]
    gaps = sum(TRUTH_GAP in one.verdict.qualifiers for one in sound)
    yield PromiseRow(
        "A sound simulated run has no truth gap",
        "at most 1 %",
        f"{gaps} of {len(sound)}",
        gaps <= 0.01 * len(sound),
    )


def unchecked_row() -> PromiseRow:
    """Whether a run without truth and labels is checked by the own association, or says so."""
    log = simulate(np.random.default_rng(0), Drive())
    seen = replace(log.measurements, landmark=np.full(len(log.measurements.time_s), NO_LANDMARK))
    blind = replace(log, measurements=seen, truth=Truth())
    asked = compare(blind, run_config(association="nn"))
    declined = compare(blind, run_config(association="nn", smoother_association="ekf"))
    holds = "own_association" in asked.findings and UNCHECKED in declined.verdict.qualifiers
    return PromiseRow(
        "Without truth and labels the own association is asked, or the verdict says unchecked",
        "both",
        f"asked: {asked.verdict.headline}; declined: {declined.verdict.headline}",
        holds,
    )


def car_park_row(data: Path) -> PromiseRow:
    """The car park has no labels; its beacons' places say whether the association is right."""
    found = solve(open_log(str(data / "acfr_car_park")), SolveConfig(association="own"))
    accuracy, checked = present(found.accuracy), present(found.association_check)
    against = ", ".join(f"{one.name} {one.apart_sigma:.1f} sigma" for one in checked.against)
    return PromiseRow(
        "The car park's own association is verified",
        "verified, for it is right",
        f"{'verified' if checked.verified else f'unverified ({against})'}; "
        f"{accuracy.landmarks_found} of {accuracy.landmarks_true} beacons found, "
        f"{accuracy.landmark_rmse_aligned_m or 0.0:.3f} m off (aligned)",
        checked.verified,
    )


def simulated_trials(seeds: Iterable[int]) -> list[AssociationTrial]:
    """Trials of simulated sensors."""
    return [one for seed in seeds if (one := tried(simulated_sensor(seed))) is not None]


def rows(quick: bool = False, data: Path = DATA) -> list[PromiseRow]:
    """Return the rows of points 2 and 3 of the table of trust."""
    seeds = range(_FIRST_TEST_SEED, _FIRST_TEST_SEED + (4 if quick else 120))
    found = [association_row("simulated sensors", simulated_trials(seeds))]
    if (data / "mrclam").is_dir():
        pieces = (tried(log, "gnc") for log in mrclam_pieces(data, quick))
        found.append(association_row("MR.CLAM pieces", [one for one in pieces if one]))
        found += shared_mistake_rows(data, quick)
    if (data / "acfr_car_park").is_dir() and not quick:
        found.append(car_park_row(data))
    return [*found, unchecked_row()]


def choose(trials: Sequence[AssociationTrial]) -> str:
    """Choose distance and number of variants by five-fold cross-validation.

    A wrong association that is verified counts as ten right ones refused.
    """
    grid = list(product((0.3, 0.5, 0.7, 0.85, 1.0, 1.25, 1.5), (2, 3, 4, 5)))
    wrong = np.array([one.wrong for one in trials])
    refused = np.array([[_refused(one, *point) for point in grid] for one in trials])
    missed, turned = ~refused & wrong[:, None], refused & ~wrong[:, None]
    loss, fold = 10 * missed + turned, np.arange(len(trials)) % 5
    best = np.array([int(np.argmin(loss[fold != k].sum(axis=0))) for k in range(5)])[fold]
    held_out = np.arange(len(trials)), best
    apart, several = grid[int(np.argmin(loss.sum(axis=0)))]
    return (
        f"apart {apart} sigma, several {several}; held out: {missed[held_out].sum()} of "
        f"{wrong.sum()} wrong ones verified, {turned[held_out].sum()} of {np.sum(~wrong)} right "
        "ones refused"
    )


def _refused(one: AssociationTrial, apart: float, several: int) -> bool:
    far = [v for v in one.variants.variants if not v.apart_sigma < apart]
    return len(far) >= several or any(v.excess <= 0.0 for v in far)


if __name__ == "__main__":
    asked = options(__doc__, quick=False, data=DATA, choose=int)
    if asked.choose is None:
        sys.exit(print_table(rows(asked.quick, asked.data)))
    print(choose(simulated_trials(range(asked.choose))))
