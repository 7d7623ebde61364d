"""A user's script, for the type checker alone: what is right passes, and each slip is an error.

mypy calls an ignored error that is none an error, so an option that would take any word fails here.
"""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes

import slamcheck


def report(place: Path) -> bool:
    """Use what the README's Python block and the pages of the reference use."""
    log = slamcheck.load_log(place, seed=7)
    run = slamcheck.compare(log, filter="compressed", association="nn", gps="off")
    print(run.verdict.summary, run.agreement.algebra.sigma, run.to_pandas("gaps"))
    mine = slamcheck.read_estimate("mine")
    found = slamcheck.check(log, mine, require="like")
    print(found.outcome, found.grade.value, *found.causes, sep="\n")
    apart = slamcheck.compare_estimates(mine, run.ekf.estimate, relation="independent")
    print(apart.rms_m, apart.nees_mean, apart.landmark)
    axis: Axes = slamcheck.plot_map(run)
    slamcheck.plot_trajectory(mine, axis, name="mine").set_title("paths")
    for result in (run, found):
        slamcheck.plot_errors(result, "heading").set_title("heading")
        slamcheck.plot_nees(result).set_ylim(0.0, 20.0)
        slamcheck.plot_ladder(result)
    slamcheck.write_report(found, place / "report")
    return found.outcome == "agree"


def slips(log: slamcheck.Log, mine: slamcheck.ExternalEstimate) -> None:
    """Misspell an option, its value, a word and an attribute."""
    run = slamcheck.compare(log, filter="compresed")  # type: ignore[arg-type]
    slamcheck.compare(log, gpz="off")  # type: ignore[call-arg]
    found = slamcheck.check(log, mine, require="lik")  # type: ignore[arg-type]
    slamcheck.compare_estimates(mine, mine, relation="dependent")  # type: ignore[arg-type]
    slamcheck.plot_errors(run, "yaw")  # type: ignore[arg-type]
    print(found.verdict)  # type: ignore[attr-defined]
