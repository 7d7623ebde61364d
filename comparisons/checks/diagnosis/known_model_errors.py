"""Known mistakes that reproduce a filter's recorded figures where its model differs.

Each is fitted to the records: it is named only when it explains all that deviates, to rounding.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.checks.diagnosis.hypotheses import (
    Hypothesis,
    Quantity,
    instead,
    naming,
    says,
    times,
)
from comparisons.checks.diagnosis.measurement_hypotheses import measurement_hints
from comparisons.checks.diagnosis.motion_hypotheses import motion_hints
from comparisons.logs.log import Log
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.trace import MeasurementRecords

_EQUAL = 1e-7


def explain(
    log: Log, run: EkfRun, rounding: float = 0.0, *, same_steps: bool = True
) -> tuple[str, ...]:
    """Return what the filter seems to have done.

    Nothing is said of filters of another state or observation.

    Args:
        log: what the filter was given.
        run: what it recorded.
        rounding: by how much, relative to their size, storing has rounded the records.
        same_steps: whether its steps are the log's own, so that they can be compared.
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
    off = run.trace.prior_pose - log.prior.pose
    off[2] = wrap_angle(off[2])
    sigma = np.sqrt(np.diag(log.prior.covariance))
    for name, unit, apart, size in zip(
        ("x", "y", "heading"), ("m", "m", "rad"), off.tolist(), log.prior.pose.tolist(),
        strict=True,
    ):  # fmt: skip
        if abs(apart) > _EQUAL + 4.0 * rounding * max(abs(size), np.pi):
            yield f"the prior's {name} differs from the log's by {apart:+.4g} {unit}"
    scale = np.outer(sigma, sigma)
    quantity = Quantity(
        have=(run.trace.prior_covariance / scale)[None],
        meant=(log.prior.covariance / scale)[None],
        tolerance=np.asarray(_EQUAL + 4.0 * rounding),
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
    else:
        for k, name in enumerate(("x", "y", "heading")):
            ratio = run.trace.prior_covariance[k, k] / log.prior.covariance[k, k]
            if abs(ratio - 1.0) > limit:
                yield times(f"the prior's variance of {name}", "the log's")(ratio)


def _positions(run: EkfRun, rounding: float) -> Iterator[str]:
    r, positions = run.trace.positions, run.positions
    if positions is None or not len(r.step):
        return
    place, pose = positions.position_m[r.number], r.pose
    forward, left = positions.antenna_m
    apart = place - pose[:, :2]
    slack = 4.0 * rounding * float(max(np.abs(pose).max(), np.abs(place).max()))
    stated = np.array((forward, left))

    def lever(rows: Index, ahead: float, side: float) -> Array:
        result: Array = apart[rows] - _arms(pose[rows, 2], ahead, side)
        return result

    meant = lever(np.arange(len(pose)), forward, left)
    features = {"time [s]": positions.time_s[r.number]}
    quantity = Quantity(
        have=r.innovation,
        meant=meant,
        tolerance=np.asarray(_EQUAL + slack),
        records="positions",
        features=features,
    )
    departed = run.trace.departed[np.maximum(r.step - 1, 0)]
    older = place - departed[:, :2] - _arms(departed[:, 2], forward, left)
    yield from naming(
        quantity,
        (
            instead("the lever arm of the antenna is ignored", apart),
            instead("the lever arm of the antenna is not rotated by the heading", apart - stated),
            instead("the innovation of positions has the opposite sign", -meant),
            instead("the expected position is that before the last prediction", older),
            instead("the position's east and north are exchanged",
                    place[:, ::-1] - place + meant),
            Hypothesis(
                says("the lever arm of the antenna is ({0:.3f}, {1:.3f}) m, in the log "
                     f"({forward:.3f}, {left:.3f}) m"),
                lever,
                (forward, left),
            ),
            Hypothesis(
                says("positions have a bias of ({0:+.4g}, {1:+.4g}) m"),
                lambda rows, east, north: meant[rows] + (east, north),
                (0.0, 0.0),
            ),
            Hypothesis(
                times("positions", "the log's"),
                lambda rows, k: meant[rows] + (k - 1.0) * place[rows],
                (1.0,),
            ),
        ),
    )  # fmt: skip
    yield from _position_noise(r, positions.covariance[r.number], features)


def _arms(heading: Array, forward: float, left: float) -> Array:
    cos, sin = np.cos(heading), np.sin(heading)
    return np.column_stack((cos * forward - sin * left, sin * forward + cos * left))


def _position_noise(
    r: MeasurementRecords, stated: Array, features: dict[str, Array]
) -> Iterator[str]:
    """Of positions with covariances (G, 2, 2) in the log."""
    sigma = np.sqrt(stated[:, (0, 1), (0, 1)])
    size = sigma[:, :, None] * sigma[:, None, :]
    quantity = Quantity(
        have=r.noise * r.weight[:, None, None] / size,
        meant=stated / size,
        tolerance=np.asarray(_EQUAL),
        records="positions",
        features=features,
    )
    yield from naming(
        quantity,
        (
            instead("R of positions contains sigma instead of sigma squared",
                    np.sqrt(stated * np.eye(2)) / size),
            instead("R of positions contains the square of the variances",
                    (stated * np.eye(2)) ** 2 / size),
            Hypothesis(times("R of positions"), lambda rows, k: k * stated[rows] / size[rows],
                       (1.0,)),
            Hypothesis(
                says("R of positions has a constant of {0:.4g} added"),
                lambda rows, c: (stated[rows] + c * np.eye(2)) / size[rows],
                (0.0,),
            ),
        ),
    )  # fmt: skip
