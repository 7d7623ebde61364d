"""Known mistakes that reproduce a filter's recorded figures where its model differs.

Each is fitted to the records: it is named only when it explains all that deviates, to rounding.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.checks.diagnosis.measurement_hypotheses import measurement_hints
from comparisons.checks.diagnosis.motion_hypotheses import motion_hints
from comparisons.explain.hypotheses import (
    EQUAL,
    Hypothesis,
    Quantity,
    instead,
    named,
)
from comparisons.explain.recorded import explained
from comparisons.faults.columns import position_columns
from comparisons.faults.grammar import POSITION, PRIOR, R_OF_POSITION, Values, times
from comparisons.faults.misreadings import LAGS, Misreading, joined_misreadings, misreadings
from comparisons.logs.log import Log
from comparisons.plane import pose_difference, turned

_ENTRIES = (("x", "m"), ("y", "m"), ("heading", "rad"))
"""Of a pose, with their units."""


def explain(
    log: Log, run: EkfRun, rounding: float = 0.0, *, same_steps: bool = True
) -> tuple[str, ...]:
    """Return what the filter of a run seems to have done to a log.

    Nothing is said of filters of another state or observation. rounding: by how much, relative to
    their size, storing has rounded the records. same_steps: its steps are the log's own, so that
    they can be compared.
    """
    if run.trace.prior_pose.shape != (3,) or run.own_axes:
        return ()
    return (
        *_prior(log, run, rounding),
        *(motion_hints(log, run, rounding) if same_steps else ()),
        *measurement_hints(log, run, rounding),
        *_positions(run, rounding),
    )


def _prior(log: Log, run: EkfRun, rounding: float) -> Iterator[str]:
    (off,) = pose_difference(run.trace.prior_pose[None], log.prior.pose)
    sigma = np.sqrt(np.diag(log.prior.covariance))
    for (name, unit), apart, size in zip(_ENTRIES, off.tolist(), log.prior.pose, strict=True):
        if abs(apart) > EQUAL + 4.0 * rounding * max(abs(size), np.pi):
            yield f"the prior's {name} differs from the log's by {apart:+.4g} {unit}"
    scale = np.outer(sigma, sigma)
    quantity = Quantity(
        have=(run.trace.prior_covariance / scale)[None],
        meant=(log.prior.covariance / scale)[None],
        tolerance=EQUAL + 4.0 * rounding,
        records="priors",
    )
    if not quantity.off().any():
        return
    have, meant = quantity.have.ravel(), quantity.meant.ravel()
    factor = float(have @ meant / (meant @ meant))  # one record: fitted over its entries
    limit = quantity.tolerance * max(1.0, abs(factor))
    sigmas = np.sqrt(np.diag(np.diag(log.prior.covariance))) / scale
    if np.abs(quantity.have - sigmas).max() <= limit * max(1.0, float(sigmas.max())):
        yield "the prior's covariance contains sigma instead of sigma squared"
    elif np.abs(have - factor * meant).max() <= limit:
        yield times("the prior's covariance", "the log's")(factor)
    elif composed := explained(
        PRIOR,
        quantity,
        Values(sound=log.prior.covariance[None]),
        lambda values, rows: values / scale,
    ):
        yield from (line.partition(", in ")[0] for line in composed)
    else:
        for k, (name, _) in enumerate(_ENTRIES):
            ratio = run.trace.prior_covariance[k, k] / log.prior.covariance[k, k]
            if abs(ratio - 1.0) > limit:
                yield times(f"the prior's variance of {name}", "the log's")(ratio)


def _positions(run: EkfRun, rounding: float) -> Iterator[str]:
    r, positions = run.trace.positions, run.positions
    if positions is None or not len(r.step):
        return
    place, pose, stated = positions.position_m[r.number], r.pose, np.array(positions.antenna_m)
    apart = place - pose[:, :2]
    meant = apart - turned(stated, pose[:, 2])
    slack = 4.0 * rounding * float(max(np.abs(pose).max(), np.abs(place).max()))
    quantity = Quantity(
        have=r.innovation,
        meant=meant,
        tolerance=EQUAL + slack,
        records="positions",
        features={"time [s]": positions.time_s[r.number]},
    )
    departed = run.trace.departed[np.maximum(r.step - 1, 0)]
    older = place - departed[:, :2] - turned(stated, departed[:, 2])
    residual = Values(sound=meant[:, :, None], heading=pose[:, 2])
    yield from named(
        quantity,
        (
            instead("the lever arm of the antenna is ignored", apart),
            instead("the lever arm of the antenna is not rotated by the heading", apart - stated),
            instead("the innovation of positions has the opposite sign", -meant),
            instead("the expected position is that before the last prediction", older),
            Hypothesis(
                "the lever arm of the antenna is ({0:.3f}, {1:.3f}) m, in the log "
                f"({stated[0]:.3f}, {stated[1]:.3f}) m",
                lambda rows, *arm: apart[rows] - turned(np.array(arm), pose[rows, 2]),
                positions.antenna_m,
            ),
            *_misread(positions.position_m, r.number, meant),
        ),
    ) or explained(POSITION, quantity, residual, lambda values, rows: values[:, :, 0])
    noise = r.noise * r.weight[:, None, None]
    yield from _position_noise(noise, positions.covariance[r.number], quantity)


def _misread(values: Array, number: Index, meant: Array) -> Iterator[Hypothesis]:
    """Positions (L, 2) that are misread. number: (G,) which. meant: (G, 2) their residuals."""
    columns = position_columns()
    for misreading in (*misreadings(columns, LAGS), *joined_misreadings(columns)):

        def predict(rows: Index, *numbers: float, misreading: Misreading = misreading) -> Array:
            used: Array = misreading.values(values, *numbers) - values
            return meant[rows] + used[number[rows]]

        yield Hypothesis(misreading.said, predict, misreading.start)


def _position_noise(have: Array, stated: Array, of: Quantity) -> list[str]:
    """R (G, 2, 2) of positions with covariances (G, 2, 2) in the log."""
    sigma = np.sqrt(stated[:, (0, 1), (0, 1)])
    size = sigma[:, :, None] * sigma[:, None, :]
    diagonal = stated * np.eye(2)
    quantity = replace(of, have=have / size, meant=stated / size, tolerance=EQUAL)
    return named(
        quantity,
        (
            instead(
                "R of positions contains sigma instead of sigma squared", np.sqrt(diagonal) / size
            ),
            instead("R of positions contains the square of the variances", diagonal**2 / size),
            Hypothesis(
                times("R of positions"), lambda rows, k: k * stated[rows] / size[rows], (1.0,)
            ),
            Hypothesis(
                "R of positions has a constant of {0:.4g} added",
                lambda rows, c: (stated[rows] + c * np.eye(2)) / size[rows],
                (0.0,),
            ),
        ),
    ) or explained(
        R_OF_POSITION, quantity, Values(sound=stated), lambda values, rows: values / size[rows]
    )
