"""False alarms: whether bands cover what they say, and logs without stabilisation noise.

    python -m research.trust.bands [--quick] [--table]

400 short drives (40 with --quick) of a sound filter, with noise so small that all is linear; each
band of the consistency check must hold as often as it says, within binomial limits (a family of
two-sided tests, 1 % together). Then drives with the documents' noise, of which the verdict must
blame none, logs without stabilisation noise, and extreme logs that cost double precision digits:
a sound filter is not accused there, a broken one is found. --table prints every band. One process.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from comparisons.config import EkfConfig, Filter, RunConfig, SolveConfig
from comparisons.errors import InputError
from comparisons.faults.fault import with_state
from comparisons.jobs.run import Modified, compare, compare_prepared
from comparisons.logs.log import Log
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.pipeline.prepare import prepare
from comparisons.pipeline.solve import solve
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.state import Correction, KalmanState
from graphslam.marginals import SingularProblemError
from research.script import options, print_head, print_row
from research.trust.coverage import BandCoverage, coverage, figures_of, wrong
from research.trust.drives import extreme_log, sound_run, steering, without_noise
from research.trust.row import PromiseRow, print_table

SCALES = (0.3, 1.0)
_EXACT = 1e-9


def rows(quick: bool = False) -> list[PromiseRow]:
    """What is promised of rates and of stabilisation noise, and what was measured."""
    return [*_bands(quick), *_alarms(quick), *_without_noise(), *_rounding(quick)]


@cache
def tables(quick: bool) -> dict[str, list[BandCoverage]]:
    """The coverage of every band, without and with absolute positions."""
    seeds, seconds = (40, 10.0) if quick else (400, 20.0)
    return {
        world: coverage(
            [
                figures_of(sound_run(seed, seconds, positions=world == "with positions"))
                for seed in range(seeds)
            ]
        )
        for world in ("landmarks alone", "with positions")
    }


def _bands(quick: bool) -> Iterator[PromiseRow]:
    for world, table in tables(quick).items():
        off, least = wrong(table), min(table, key=lambda one: one.p_value)
        yield PromiseRow(
            f"the consistency check's bands cover their nominal share ({world}, "
            f"{table[0].runs} sound drives)",
            f"all {len(table)}",
            f"{len(table) - len(off)}; the least likely: {least.name}, {least.found:.3f} of "
            f"{least.nominal:g} (p {least.p_value:.2g})",
            not off,
        )


def _alarms(quick: bool) -> Iterator[PromiseRow]:
    seeds, seconds = (20, 15.0) if quick else (200, 30.0)
    for first, scale in enumerate(SCALES):
        outcomes, outside, nis, overconfident = Counter[str](), 0, 0, 0
        for seed in range(first * seeds, (first + 1) * seeds):
            log = simulate(np.random.default_rng(seed), Drive(noise_scale=scale, loop_s=seconds))
            c = compare(log)
            outcomes[c.verdict.outcome] += 1
            readings = [one.reading for sensor in c.consistency.sensors for one in sensor.nis]
            outside += len(readings) - readings.count("plausible")
            nis += len(readings)
            smoothed = c.consistency.smoothed
            overconfident += smoothed is not None and len(smoothed.overconfident) > 0
        share = outside / nis
        yield PromiseRow(
            f"a sound filter is not blamed, true and stated noise {scale:g} times the document's",
            f"disagree 0 of {seeds}, surer than the smoother 0, NIS outside its band 5 %",
            f"disagree {outcomes['disagree']}, unverified {outcomes['unverified']}, surer "
            f"{overconfident}, NIS outside {100.0 * share:.1f} %",
            outcomes["agree"] == seeds
            and not overconfident
            and abs(share - 0.05) < 3.0 * _deviation(seeds),
        )


def _deviation(seeds: int) -> float:
    """Of the share of NIS outside, the three of a run counting as two."""
    return float(np.sqrt(0.05 * 0.95 / (2.0 * seeds)))


def _without_noise() -> Iterator[PromiseRow]:
    log = without_noise(simulate(np.random.default_rng(1), Drive(loop_s=25.0)))
    filters: tuple[Filter, ...] = ("full", "compressed", "misono-full")
    for name in filters:
        c = compare(log, RunConfig(ekf=EkfConfig(filter=name)))
        gap = max(
            part
            for one in (c.agreement.algebra, c.agreement.model)
            for part in (one.sigma, one.covariance)
        )
        yield PromiseRow(
            f"no stabilisation noise: {name} EKF against the frozen smoothers",
            f"agree, gaps below {_EXACT:g}",
            f"{c.verdict.outcome}, {gap:.1g}",
            c.verdict.outcome == "agree" and gap < _EXACT,
        )
    verified = solve(log, SolveConfig()).result.optimality.verified
    yield PromiseRow(
        "no stabilisation noise: the smoother alone",
        "verified",
        "verified" if verified else "unverified",
        verified,
    )
    yield _refused(log)


def _refused(log: Log) -> PromiseRow:
    """A stop leaves two directions without noise."""
    still = (log.odometry.time_s >= 4.0) & (log.odometry.time_s < 6.0)
    speed, angle = (np.where(still, 0.0, control) for control in steering(log).controls)
    stopped = replace(log, odometry=replace(steering(log), speed_mps=speed, steering_rad=angle))
    try:
        compare(stopped)
    except InputError as error:
        said = str(error)
    else:
        said = "accepted"
    return PromiseRow(
        "no stabilisation noise and a stop: refused, with what to add",
        "one line with both rates",
        said.rpartition("; ")[2],
        "variance_rate_position" in said and "variance_rate_heading" in said and "\n" not in said,
    )


class _Extreme(NamedTuple):
    """One extreme log. outcome: of a sound filter; accused: of what rounding does.

    share: of ten times what rounding explains; found: where each update loses it. None where that
    is more than half, or nothing could be compared.
    """

    name: str
    outcome: str
    accused: bool = False
    share: float | None = None
    found: bool | None = None


def _rounding(quick: bool) -> Iterator[PromiseRow]:
    """Extreme logs: no sound filter is accused, and ten times what rounding explains is found."""
    sound, most = (6, 3) if quick else (30, 20)
    planted, every = 0, list[_Extreme]()
    for seed in range(sound):
        every.append(extreme(seed, plant=planted < most))
        planted += every[-1].found is not None
    outcomes = Counter(one.outcome for one in every)
    said = ", ".join(f"{n} {one}" for one, n in sorted(outcomes.items()))
    accused = [one.name for one in every if one.accused]
    missed = [f"{one.name}, {one.share:.1g}" for one in every if one.found is False]
    yield PromiseRow(
        "extreme logs: a sound filter is not accused of what rounding does",
        f"none of {sound}",
        f"{'; '.join(accused) or 'none'} ({said})",
        not accused,
    )
    yield PromiseRow(
        "extreme logs: a filter whose updates lose ten times what rounding explains is found",
        f"all of {planted}",
        f"all but {'; '.join(missed)}" if missed else "all",
        not missed and planted > 0,
    )


def extreme(seed: int, *, plant: bool) -> _Extreme:
    """Compare a sound filter on an extreme log, and one that loses more than rounding does."""
    what, log = extreme_log(seed)
    name = f"{seed}, {what}"
    try:
        c = compare(log)
    except (InputError, SingularProblemError, np.linalg.LinAlgError):  # one line on the terminal
        return _Extreme(name, "refused")
    accused = bool({"algebra", "model", "breakdown"} & {one.gap for one in c.verdict.causes})
    share = 10.0 * c.known.gaps.algebra_rounding.largest
    if not plant or share > 0.5:
        return _Extreme(name, c.verdict.outcome, accused)
    broken = Modified(with_state(_losing(share)))
    causes = compare_prepared(prepare(log, RunConfig(), also=(broken,))).verdict.causes
    found = "algebra" in {one.gap for one in causes}
    return _Extreme(name, c.verdict.outcome, accused, share, found)


def _losing(share: float) -> type[KalmanState]:
    """Each update takes a share too much of the covariance."""

    class Losing(KalmanState):
        def update(
            self, columns: Index, jacobian: Array, innovation: Array, noise: Array
        ) -> Correction:
            done = super().update(columns, jacobian, innovation, noise)
            self._covariance *= 1.0 - share
            return done

    return Losing


def print_bands(quick: bool) -> None:
    """Print every band of both worlds, those that are wrong marked."""
    for world, table in tables(quick).items():
        off = {one.name for one in wrong(table)}
        print(f"\n{world}, {table[0].runs} drives\n")
        print_head("figure", "nominal", "found", "p")
        for one in table:
            mark = " **" if one.name in off else ""
            print_row(
                one.name, f"{one.nominal:.4g}", f"{one.found:.4f}", f"{one.p_value:.2g}{mark}"
            )
    print()


if __name__ == "__main__":
    asked = options(__doc__, quick=False, table=False)
    if asked.table:
        print_bands(asked.quick)
    sys.exit(print_table(rows(asked.quick)))
