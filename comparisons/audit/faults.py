"""Errors that filters are known for, each as what it does to the covariance at one event.

A snapshot that is not as replayed is explained by the error that gives it to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.replay import Replay
from comparisons.trace.events import (
    Augment,
    Blocks,
    Clone,
    Event,
    Predict,
    Remove,
    Reset,
    Update,
)

_FACTORS = (0.0, 0.25, 0.5, 2.0, 4.0)


@dataclass(frozen=True)
class KnownFault:
    """what: predicate of the event, "was not ...". blocks: which it is of. sound: no error."""

    what: str
    blocks: Blocks
    apply: Callable[[Replay, Event], None]
    sound: bool = False


def known_faults(event: Event, replay: Replay, wrong: Blocks | None = None) -> Iterator[KnownFault]:
    """Yield the errors that an event may have been done with, the plain ones first.

    replay: as before the event; it is not changed. wrong: blocks with a covariance that is wrong
    after this event, None where others have followed.
    """
    match event:
        case Update():
            yield from _of_update(event, replay)
        case Predict():
            yield from _of_predict(event)
        case Augment():
            yield from _of_augment(event, replay)
        case Clone():
            yield KnownFault(
                f"block {event.name} was not correlated with the others",
                (event.name, event.source),
                _then(_uncorrelated(event.name)),
            )
        case Remove():
            yield from _of_remove(event, replay)
        case Reset():
            yield KnownFault("its Jacobian was not applied", event.blocks, _skipped)
        case _:
            return
    yield from _of_pairs(event, replay, wrong)


def _of_update(event: Update, replay: Replay) -> Iterator[KnownFault]:
    if not event.used:
        yield KnownFault(
            "the rejected measurement was fused all the same",
            event.blocks,
            lambda replay, e: replay.fuse(_update(e), _gain(replay, _update(e))),
        )
        return
    yield KnownFault("the covariance was not updated", event.blocks, _skipped)
    yield KnownFault("the covariance was updated twice", event.blocks, _twice)
    yield KnownFault(
        "the covariance is Joseph's form without K R K^T", event.blocks, _without_noise_term
    )
    yield KnownFault(
        "the covariance is Joseph's form with I - K H in place of its transpose",
        event.blocks,
        _not_transposed,
    )
    yield KnownFault(
        f"all blocks but {event.blocks[0]} were made independent of each other",
        tuple(name for name in replay.layout.dims if name != event.blocks[0]),
        _then(partial(_independent, but=event.blocks[0])),
    )
    yield KnownFault("the covariance is P - K (S - R) K^T: S lacks R", event.blocks, _without_r)
    if replay.added is not None:
        yield KnownFault(
            "gain and covariance are those of P without the process noise of the last prediction "
            "(sigma points that were not drawn anew)",
            event.blocks,
            _before_noise,
        )
    if event.gain is not None:
        yield KnownFault(
            "the covariance is P - K H P, which holds for Kalman's gain alone",
            event.blocks,
            lambda replay, e: _short(replay, _update(e), _recorded_gain(e)),
        )
    yield from _of_noise(event)
    if event.gain is None:
        yield from _of_schmidt(event, replay)
    for block in event.blocks:
        if len(event.blocks) > 1:
            yield KnownFault(
                f"H was taken as zero on block {block}", (block,), _without_jacobian(block)
            )


def _of_remove(event: Remove, replay: Replay) -> Iterator[KnownFault]:
    dims = replay.layout.dims
    yield KnownFault(
        "the blocks were fixed (conditioned on), not marginalised out", event.blocks, _conditioned
    )
    gone = event.blocks[0]
    for other in dims:
        if len(event.blocks) == 1 and other != gone and dims[other] == dims[gone]:
            yield KnownFault(
                f"the rows of block {other} were removed in place of its own",
                (gone, other),
                _removed_instead(other),
            )


def _of_schmidt(event: Update, replay: Replay) -> Iterator[KnownFault]:
    """Of blocks whose variance stays: an error, unless the estimate is not corrected either."""
    for block in replay.layout.dims:
        part = replay.layout.entries(block)
        if event.correction is not None and not event.correction[part].any():
            what = f"block {block} is not corrected, and its variance kept (Schmidt)"
            yield KnownFault(what, (block,), _schmidt((block,)), sound=True)
        elif event.correction is None:
            what = (
                f"the variance of block {block} was kept, which is right only where the estimate "
                "is kept, too (Schmidt): record gains to tell"
            )
            yield KnownFault(what, (block,), _schmidt((block,)))


def _of_noise(event: Update) -> Iterator[KnownFault]:
    """Of a noise that is not the recorded one."""
    r = event.noise
    diagonal = np.diag(np.diag(r))
    others = [
        ("the square root of R (sigma for variance)", np.sqrt(diagonal)),
        ("the square of R (R is taken for sigma)", diagonal @ diagonal),
        *((f"{factor:g} R" if factor else "no R", factor * r) for factor in _FACTORS),
    ]
    for name, noise in others:
        for short in (True, False):
            tail = "" if short else ", in Joseph's form"
            yield KnownFault(
                f"the covariance was updated with {name}{tail}",
                event.blocks,
                _other_noise(noise, short=short),
            )


def _of_predict(event: Predict) -> Iterator[KnownFault]:
    n = len(event.noise)
    yield KnownFault("the covariance was not predicted", event.blocks, _skipped)
    yield KnownFault("the covariance was predicted twice", event.blocks, _twice)
    yield KnownFault(
        "the process noise was not added", event.blocks, _predicted(event.jacobian, None)
    )
    for factor in _FACTORS[1:]:
        yield KnownFault(
            f"the process noise was added {factor:g} times",
            event.blocks,
            _predicted(event.jacobian, factor * event.noise),
        )
    yield KnownFault(
        "F was not applied to the covariance",
        event.blocks,
        _predicted(np.eye(n), event.noise),
    )
    yield KnownFault(
        "F was applied transposed", event.blocks, _predicted(event.jacobian.T, event.noise)
    )
    yield KnownFault(
        "F was not applied to the covariance with other blocks",
        event.blocks,
        _without_others(event),
    )
    yield KnownFault(
        "F was applied to the covariance with other blocks on one side of the diagonal alone",
        event.blocks,
        _one_sided,
    )
    for block in event.blocks:
        yield KnownFault(
            f"the process noise of block {block} was not added",
            (block,),
            _without_noise(block),
        )


def _of_augment(event: Augment, replay: Replay) -> Iterator[KnownFault]:
    name = event.name
    yield KnownFault(
        f"block {name} was not correlated with the others",
        (name, *event.blocks),
        _then(_uncorrelated(name)),
    )
    others = [block for block in replay.layout.dims if block not in event.blocks]
    yield KnownFault(
        f"its covariance with blocks other than {', '.join(event.blocks)} was left zero",
        (name, *others),
        _then(partial(_cut, name=name, others=others)),
    )
    yield KnownFault("the noise was left out", (name,), _augmented(own=True, noise=False))
    yield KnownFault(
        f"the uncertainty of {', '.join(event.blocks)} was left out of the new block's variance",
        (name,),
        _augmented(own=False, noise=True),
    )


def _of_pairs(event: Event, replay: Replay, wrong: Blocks | None) -> Iterator[KnownFault]:
    """Of single blocks of the covariance that stayed as they were, or were set to zero."""
    removed = set(event.blocks) if isinstance(event, Remove) else set()
    blocks = [name for name in replay.layout.dims if name not in removed]
    new = [event.name] if isinstance(event, Augment | Clone) else []
    # What is wrong with one block, or two, makes no more than these wrong.
    seen = [*blocks, *new] if wrong is None else [b for b in (*blocks, *new) if b in wrong]
    two = seen if wrong is None or len(wrong) <= 2 else []
    for a, b in combinations(two, 2):
        if b not in new:
            yield KnownFault(
                f"the covariance of block {a} with {b} was not updated", (a, b), _kept(a, b)
            )
    for a in seen:
        if a in new:
            continue
        yield KnownFault(f"the covariance of block {a} was not updated", (a,), _kept(a, a))
        yield KnownFault(
            f"the covariances of block {a} with all others were not updated",
            (a,),
            _kept_all(a, [b for b in blocks if b != a]),
        )
        yield KnownFault(
            f"block {a}, with its covariances, was not updated", (a,), _kept_all(a, blocks)
        )
    for a, b in combinations(two, 2):
        yield KnownFault(
            f"the covariance of block {a} with {b} was set to zero",
            (a, b),
            _then(partial(_set, a=a, b=b, value=0.0)),
        )


def _update(event: Event) -> Update:
    assert isinstance(event, Update)  # noqa: S101 - a fault of an update is of updates
    return event


def _recorded_gain(event: Event) -> Array:
    gain = _update(event).gain
    assert gain is not None  # noqa: S101
    return gain


def _skipped(replay: Replay, event: Event) -> None:
    del replay, event


def _twice(replay: Replay, event: Event) -> None:
    """Each time with Kalman's gain, as code does that is called twice."""
    if isinstance(event, Update):
        event = event._replace(gain=None)
    replay.apply(event)
    replay.apply(event)


def _then(change: Callable[[Replay], None]) -> Callable[[Replay, Event], None]:
    """Do the event, then a change."""

    def apply(replay: Replay, event: Event) -> None:
        replay.apply(event)
        change(replay)

    return apply


def _set(replay: Replay, a: str, b: str, value: Array | float) -> None:
    """Set the covariance of two blocks."""
    i, j = replay.layout.entries(a), replay.layout.entries(b)
    replay.covariance[i, j] = value
    replay.covariance[j, i] = value.T if isinstance(value, np.ndarray) else value


def _kept(a: str, b: str) -> Callable[[Replay, Event], None]:
    def apply(replay: Replay, event: Event) -> None:
        i, j = replay.layout.entries(a), replay.layout.entries(b)
        before = replay.covariance[i, j].copy()
        replay.apply(event)
        _set(replay, a, b, before)

    return apply


def _kept_all(a: str, blocks: list[str]) -> Callable[[Replay, Event], None]:
    def apply(replay: Replay, event: Event) -> None:
        i = replay.layout.entries(a)
        before = {b: replay.covariance[i, replay.layout.entries(b)].copy() for b in blocks}
        replay.apply(event)
        for b, value in before.items():
            _set(replay, a, b, value)

    return apply


def _uncorrelated(name: str) -> Callable[[Replay], None]:
    def change(replay: Replay) -> None:
        i = replay.layout.entries(name)
        own = replay.covariance[i, i].copy()
        replay.covariance[i] = 0.0
        replay.covariance[:, i] = 0.0
        replay.covariance[i, i] = own

    return change


def _cut(replay: Replay, name: str, others: Sequence[str]) -> None:
    for other in others:
        _set(replay, name, other, 0.0)


def _independent(replay: Replay, but: str) -> None:
    for a, b in combinations([name for name in replay.layout.dims if name != but], 2):
        _set(replay, a, b, 0.0)


def _conditioned(replay: Replay, event: Event) -> None:
    """Remove blocks as if they were known: the Schur complement."""
    assert isinstance(event, Remove)  # noqa: S101
    gone = replay.layout.columns(event.blocks)
    p = replay.covariance
    own = p[gone][:, gone]
    replay.covariance = p - p[:, gone] @ np.linalg.pinv(own) @ p[gone]
    replay.remove(event.blocks)


def _removed_instead(other: str) -> Callable[[Replay, Event], None]:
    """Remove another block's rows; the others then stand under the names before them."""

    def apply(replay: Replay, event: Event) -> None:
        assert isinstance(event, Remove)  # noqa: S101
        kept = np.delete(np.arange(replay.layout.size), replay.layout.entries(other))
        p = replay.covariance[np.ix_(kept, kept)]
        replay.remove(event.blocks)
        replay.covariance = p

    return apply


def _gain(replay: Replay, event: Update, noise: Array | None = None) -> Array:
    """Kalman's gain with a noise."""
    at, h = replay.layout.columns(event.blocks), event.jacobian
    across = replay.covariance[:, at] @ h.T
    s = h @ across[at] + (event.noise if noise is None else noise)
    return across @ np.linalg.pinv(s)


def _short(replay: Replay, event: Update, gain: Array) -> None:
    """P - K H P."""
    at = replay.layout.columns(event.blocks)
    p = replay.covariance
    replay.covariance = p - gain @ (event.jacobian @ p[at])


def _without_noise_term(replay: Replay, event: Event) -> None:
    update = _update(event)
    gain = _gain(replay, update) if update.gain is None else update.gain
    replay.fuse(update._replace(noise=np.zeros_like(update.noise)), gain)


def _without_r(replay: Replay, event: Event) -> None:
    update, p = _update(event), replay.covariance
    gain = _gain(replay, update) if update.gain is None else update.gain
    at, h = replay.layout.columns(update.blocks), update.jacobian
    replay.covariance = p - gain @ h @ p[at][:, at] @ h.T @ gain.T


def _before_noise(replay: Replay, event: Event) -> None:
    update, p = _update(event), replay.covariance
    assert replay.added is not None  # noqa: S101 - asked for before
    blocks, noise = replay.added
    before, at = p.copy(), replay.layout.columns(blocks)
    before[(at, at) if isinstance(at, slice) else np.ix_(at, at)] -= noise
    at, h = replay.layout.columns(update.blocks), update.jacobian
    s = h @ before[at][:, at] @ h.T + update.noise
    gain = before[:, at] @ h.T @ np.linalg.inv(s)
    replay.covariance = p - gain @ s @ gain.T


def _not_transposed(replay: Replay, event: Event) -> None:
    update, p = _update(event), replay.covariance
    gain = _gain(replay, update) if update.gain is None else update.gain
    keep = np.eye(len(p))
    keep[:, replay.layout.columns(update.blocks)] -= gain @ update.jacobian
    wrong = keep @ p @ keep + gain @ update.noise @ gain.T
    replay.covariance = 0.5 * (wrong + wrong.T)


def _other_noise(noise: Array, *, short: bool) -> Callable[[Replay, Event], None]:
    def apply(replay: Replay, event: Event) -> None:
        update = _update(event)
        gain = _gain(replay, update, noise)
        if short:
            _short(replay, update, gain)
        else:
            replay.fuse(update, gain)

    return apply


def _schmidt(blocks: Blocks) -> Callable[[Replay, Event], None]:
    def apply(replay: Replay, event: Event) -> None:
        gain = _gain(replay, _update(event))
        gain[replay.layout.columns(blocks)] = 0.0
        replay.fuse(_update(event), gain)

    return apply


def _without_jacobian(block: str) -> Callable[[Replay, Event], None]:
    def apply(replay: Replay, event: Event) -> None:
        update = _update(event)
        h, start = update.jacobian.copy(), 0
        for name in update.blocks:
            dim = replay.layout.dims[name]
            if name == block:
                h[:, start : start + dim] = 0.0
            start += dim
        replay.apply(update._replace(jacobian=h, gain=None))

    return apply


def _predicted(f: Array, noise: Array | None) -> Callable[[Replay, Event], None]:
    def apply(replay: Replay, event: Event) -> None:
        assert isinstance(event, Predict)  # noqa: S101
        replay.predict(event.blocks, f, noise)

    return apply


def _without_others(event: Predict) -> Callable[[Replay, Event], None]:
    def apply(replay: Replay, now: Event) -> None:
        assert isinstance(now, Predict)  # noqa: S101
        before = replay.covariance.copy()
        replay.apply(now)
        others = [name for name in replay.layout.dims if name not in event.blocks]
        for a in event.blocks:
            for b in others:
                _set(replay, a, b, before[replay.layout.entries(a), replay.layout.entries(b)])

    return apply


def _one_sided(replay: Replay, event: Event) -> None:
    assert isinstance(event, Predict)  # noqa: S101
    at = replay.layout.columns(event.blocks)
    others = np.delete(np.arange(replay.layout.size), at)
    before = replay.covariance[others][:, at]
    replay.apply(event)
    after = replay.covariance[others]
    after[:, at] = before
    replay.covariance[others] = after


def _without_noise(block: str) -> Callable[[Replay, Event], None]:
    def apply(replay: Replay, event: Event) -> None:
        assert isinstance(event, Predict)  # noqa: S101
        noise, start = event.noise.copy(), 0
        for name in event.blocks:
            dim = replay.layout.dims[name]
            if name == block:
                noise[start : start + dim] = 0.0
                noise[:, start : start + dim] = 0.0
            start += dim
        replay.predict(event.blocks, event.jacobian, noise)

    return apply


def _augmented(*, own: bool, noise: bool) -> Callable[[Replay, Event], None]:
    def apply(replay: Replay, event: Event) -> None:
        assert isinstance(event, Augment)  # noqa: S101
        replay.augment(event)
        g, n = event.noise_jacobian, len(event.jacobian)
        at = replay.layout.columns(event.blocks)
        p = replay.covariance
        if not noise:
            p[-n:, -n:] -= g @ event.noise @ g.T
        if not own:
            p[-n:, -n:] -= event.jacobian @ p[at][:, at] @ event.jacobian.T

    return apply
