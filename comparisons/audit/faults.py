"""Errors that filters are known for, each as what it does to the covariance at one event.

A snapshot that is not as replayed is explained by the error that gives it to rounding. Most errors
are the event's own formula with one of its matrices replaced: by zero, its transpose, its root, its
inverse, that of another event, or with a block, a row or a column of it lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from itertools import combinations, permutations
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.replay import Columns, Replay, noise_factor
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

Apply = Callable[["Remembering", Any], None]
Swap = Callable[["Remembering", Any], Any]
"""An event with another matrix in it; None where there is none."""
Gain = Callable[["Remembering", Update], Array]
Kind = tuple[object, ...]
WITH_GAIN = "gain and covariance are those of"
_ALIKE = 1e-6
"""Of the largest entry, within which a recorded gain is one that is known."""
PLAIN, _PLAINLY = 2, 1e-4
"""Digits of a number that somebody has written, and within which share it is that number."""


@dataclass(frozen=True)
class KnownFault:
    """what: predicate of the event, "was not ...". blocks: which it is of. sound: no error.

    apply: does the event so, and any that is like it. number: of a family of errors, the one with
    a number, which stands in `what` as {}; neutral: that of no error. kind: of errors that differ
    by a number; else it is what they are. general: it says which part of the covariance is wrong,
    not how it became so.
    """

    what: str
    blocks: Blocks
    apply: Apply
    _: KW_ONLY
    sound: bool = False
    number: Callable[[float], Apply] | None = None
    neutral: float = 1.0
    kind: str = ""
    general: bool = False

    def member(self, number: float) -> KnownFault:
        """The error of the family with a number."""
        assert self.number is not None  # noqa: S101 - asked for before
        what = self.what.format(number_text(number, self.neutral))
        return KnownFault(what, self.blocks, self.number(number), kind=self.what)


def number_text(number: float, neutral: float) -> str:
    """Return a number with four digits, or as many as tell it from the one of no error."""
    for count in range(4, 16):
        if float(text := f"{number:.{count}g}") != neutral:
            return text
    return f"{number:.17g}"


def digits(number: float, neutral: float) -> int:
    """Return how many digits an error's number has, its inverse, or what it is more than neutral.

    More than PLAIN count as one more.
    """
    off = _PLAINLY * abs(number - neutral)
    forms = [(number, off), (number - neutral, off)]
    if number:
        forms.append((1.0 / number, off / number**2))
    for count in range(1, PLAIN + 1):
        if any(abs(x - float(f"{x:.{count}g}")) <= allowed for x, allowed in forms):
            return count
    return PLAIN + 1


@dataclass(frozen=True)
class OtherGain:
    """A gain that is not Kalman's. what: of which it is. swap: the update that it is Kalman's of.

    prior: the P that it is Kalman's of, where that is another.
    """

    what: str
    blocks: Blocks
    gain: Gain
    swap: Swap = lambda replay, event: event
    prior: Callable[[Remembering], Array] | None = None


class Remembering(Replay):
    """A recursion that knows the event before, and of each kind the first and the last."""

    def __init__(self, replay: Replay, earlier: Iterable[Event] = ()) -> None:
        """Go on from another, which is left alone. earlier: events before."""
        self.layout = replay.layout.of(replay.layout.dims)
        self.covariance, self.mean = replay.covariance.copy(), replay.mean.copy()
        self.last: Event | None = None
        self._kinds: dict[Kind, tuple[Event, Event]] = {}
        for event in earlier:
            self.note(event)

    def copy(self) -> Remembering:
        """Return one that goes its own way."""
        other = Remembering(self)
        other.last, other._kinds = self.last, dict(self._kinds)
        return other

    def note(self, event: Event) -> None:
        """Remember an event that is done."""
        kind = _kind(event)
        self._kinds[kind] = self._kinds.get(kind, (event,))[0], event
        self.last = event

    def other(self, event: Event, which: int) -> Any:
        """The first event of its kind (0), or the last before (1); None if there is none."""
        found = self._kinds.get(_kind(event))
        return None if found is None else found[which]

    def without_noise(self) -> Array:
        """P without the noise of the prediction before."""
        p = self.covariance.copy()
        if isinstance(self.last, Predict):
            p[_square(self.layout.columns(self.last.blocks))] -= self.last.noise
        return p

    def unpredicted(self) -> Array:
        """P before the prediction before."""
        p = self.without_noise()
        if isinstance(self.last, Predict):
            at, back = self.layout.columns(self.last.blocks), _inverse(self.last.jacobian)
            p[at] = back @ p[at]
            p[:, at] = p[:, at] @ back.T
        return p


def _kind(event: Event) -> Kind:
    match event:
        case Update():
            return Update, event.sensor, event.jacobian.shape
        case Predict() | Augment():
            return type(event), event.jacobian.shape, event.noise.shape
    return (type(event),)


def known_faults(
    event: Event, replay: Remembering, wrong: Blocks | None = None
) -> Iterator[KnownFault]:
    """Yield the errors that an event may have been done with, the plain ones first.

    replay: as before the event; it is not changed. wrong: blocks with a covariance that is wrong
    after this event, None where others have followed.
    """
    match event:
        case Update():
            yield from _of_update(event, replay)
        case Predict():
            yield from _of_motion(event, replay)
            yield from _of_process_noise(event, replay)
        case Augment():
            yield from _of_augment(event, replay)
        case Clone():
            yield KnownFault(
                f"block {event.name} was not correlated with the others",
                (event.name, event.source),
                _then(partial(_uncorrelated, name=event.name)),
            )
        case Remove():
            yield from _of_remove(event, replay)
        case Reset():
            yield KnownFault("its Jacobian was not applied", event.blocks, _skipped)
            yield from _of_motion(event, replay)
        case _:
            return
    for one in (*_of_pairs(event, replay, wrong), *_of_whole(event, replay)):
        yield replace(one, general=True)


def families(event: Event) -> Iterator[KnownFault]:
    """Yield errors by a number, which is fitted."""
    if isinstance(event, Predict):
        text = "the process noise was added {} times"
        yield KnownFault(
            text,
            event.blocks,
            _skipped,
            number=lambda c: _swapped(_changed("noise", lambda q: c * q)),
        )
    if isinstance(event, Update) and event.used:
        for short, tail in ((True, ""), (False, ", in Joseph's form")):
            for text, neutral, gain in (
                ("{} R", 1.0, _gain_of_scaled_r),
                ("{} times Kalman's gain", 0.0, _scaled_gain),
            ):
                text = f"the covariance was updated with {text}{tail}"
                number = partial(_with_number, gain=gain, short=short)
                yield KnownFault(text, event.blocks, _skipped, number=number, neutral=neutral)
    if isinstance(event, Update | Predict):
        yield KnownFault(
            "the covariance was multiplied by {}",
            event.blocks,
            _skipped,
            number=lambda c: _then(partial(_rescaled, factor=c)),
        )
        yield KnownFault(
            "{} was added to the covariance's diagonal",
            event.blocks,
            _skipped,
            number=lambda c: _then(partial(_rescaled, added=c)),
            neutral=0.0,
        )


def name_gain(event: Update, replay: Remembering) -> OtherGain | None:
    """Return what a recorded gain is of, where it is known and not Kalman's.

    replay: as before the update.
    """
    given = event.gain
    if given is None:
        return None
    near = _ALIKE * float(np.abs(given).max())
    if np.abs(_gain(replay, event) - given).max() <= near:
        return None
    for one in _gains(event, replay):
        if np.abs(one.gain(replay, event) - given).max() <= near:
            return one
    return None


def name_correction(event: Update, replay: Remembering) -> str | None:
    """Return what a recorded correction is, where it is known and not gain times residual.

    replay: as before the update.
    """
    given = event.correction
    if given is None:
        return None
    gain = _used_gain(replay, event)
    tries = [("P H^T times residual, without the inverse of S", _by(replay, event, np.eye(1)))]
    tries.append(
        ("Kalman's gain times residual, not by the gain that it used", _gain(replay, event))
    )
    found = [(what, k @ event.residual) for what, k in tries]
    for which, name in ((1, "the update before"), (0, "the first update")):
        other = replay.other(event, which)
        if other is not None:
            found.append((f"gain times the residual of {name}", gain @ other.residual))
            if other.gain is not None and other.gain.shape == gain.shape:
                found.append((f"the gain of {name} times residual", other.gain @ event.residual))
            if other.correction is not None and other.correction.shape == given.shape:
                found.append((f"the correction of {name}", other.correction))
    near = _ALIKE * float(np.abs(given).max())
    return next((what for what, one in found if np.abs(one - given).max() <= near), None)


_Change = Callable[[Array], Array]
_NOISES: tuple[tuple[str, _Change], ...] = (
    ("the square root of {0} (sigma for variance)", lambda r: np.diag(np.sqrt(np.diag(r)))),
    ("the square of {0} ({0} is taken for sigma)", lambda r: r @ r),
    ("the inverse of {0} (information for covariance)", lambda r: _inverse(r)),
    ("the diagonal of {0} alone", lambda r: np.diag(np.diag(r))),
)


def _noises(name: str, event: str) -> Iterator[tuple[str, Swap]]:
    """What may stand in place of a noise. name: of it. event: what it is of."""
    for text, change in _NOISES:
        yield text.format(name), _changed("noise", change)
    yield from _of_others(name, "noise", event)


def _of_others(name: str, field: str, event: str) -> Iterator[tuple[str, Swap]]:
    """The same matrix of another event."""
    yield f"{name} of the {event} before", _taken(field, 1)
    yield f"{name} of the first {event}", _taken(field, 0)


def _changed(
    field: str, change: _Change, needs: Callable[[Array], bool] = lambda matrix: True
) -> Swap:
    """Change a matrix of an event. needs: whether it can be changed so."""

    def swap(replay: Remembering, event: Any) -> Any:
        matrix = getattr(event, field)
        return event._replace(**{field: change(matrix)}) if needs(matrix) else None

    return swap


def _square_matrix(matrix: Array) -> bool:
    return bool(matrix.shape[0] == matrix.shape[1])


def _taken(field: str, which: int) -> Swap:
    def swap(replay: Remembering, event: Any) -> Any:
        other = replay.other(event, which)
        return None if other is None else event._replace(**{field: getattr(other, field)})

    return swap


def _swapped(swap: Swap) -> Apply:
    """Do the event with another matrix; as it is, where there is none."""

    def apply(replay: Remembering, event: Any) -> None:
        replay.apply(swap(replay, event) or event)

    return apply


def _of_update(event: Update, replay: Remembering) -> Iterator[KnownFault]:
    if not event.used:
        what = "the rejected measurement was fused all the same"
        yield KnownFault(what, event.blocks, lambda replay, e: replay.fuse(e, _gain(replay, e)))
        return
    other = name_gain(event, replay) or _of_factor(event, replay)
    if other is not None:
        yield from _with_gain(other, WITH_GAIN, joseph=False)
    if corrects_otherwise(event, replay):
        yield from _of_told_gain(event, replay)
        return
    yield KnownFault("the covariance was not updated", event.blocks, _skipped)
    yield KnownFault("the covariance was updated twice", event.blocks, _twice)
    for what, form in _FORMS:
        yield KnownFault(what, event.blocks, form)
    first = event.blocks[0]
    others = tuple(name for name in replay.layout.dims if name != first)
    if len(others) > 2:
        what = f"all blocks but {first} were made independent of each other"
        yield KnownFault(what, others, _then(partial(_independent, but=first)))
    if event.gain is not None:
        what = "the covariance is P - K H P, which holds for Kalman's gain alone"
        yield KnownFault(what, event.blocks, lambda r, e: r.shorten(e, _used_gain(r, e)))
    for one in _gains(event, replay):
        yield from _with_gain(one, "the covariance was updated with", joseph=True)
    if event.gain is None:
        yield from _of_schmidt(event, replay)
    unseen = [name for name in replay.layout.dims if name not in event.blocks]
    if unseen:
        what = f"the covariances of blocks other than {', '.join(event.blocks)} were not updated"
        yield KnownFault(what, (*event.blocks, *unseen), _alone)


def corrects_otherwise(event: Update, replay: Remembering) -> bool:
    """Whether a correction without a recorded gain is of another gain than Kalman's."""
    if event.gain is not None or event.correction is None:
        return False
    return not _corrects(event, _gain(replay, event))


def _of_told_gain(event: Update, replay: Remembering) -> Iterator[KnownFault]:
    """What the gain may be that a correction is of, which is no error by itself."""
    assert event.correction is not None  # noqa: S101 - asked for above
    if not event.correction.any():
        what = "the covariance was not updated"
        yield KnownFault(what, event.blocks, _skipped, sound=True)
    for one in _gains(event, replay):
        if _corrects(event, one.gain(replay, event)):
            yield from _with_gain(one, "the covariance was updated with", joseph=True, sound=True)
    yield from _of_schmidt(event, replay)


def _corrects(event: Update, gain: Array) -> bool:
    """Whether the recorded correction is a gain times the residual."""
    assert event.correction is not None  # noqa: S101 - asked for above
    off = np.abs(event.correction - gain @ event.residual).max()
    return bool(off <= _ALIKE * float(np.abs(event.correction).max()))


def _with_gain(
    one: OtherGain, text: str, *, joseph: bool, sound: bool = False
) -> Iterator[KnownFault]:
    """The covariances that come with a gain. sound: Joseph's form, which holds for any, is."""

    def short(replay: Remembering, event: Update) -> None:
        replay.shorten(one.swap(replay, event) or event, one.gain(replay, event))

    what, prior = f"{text} {one.what}", one.prior
    yield KnownFault(what, one.blocks, short)
    if joseph:
        tail = ", in Joseph's form"

        def fused(replay: Remembering, event: Update) -> None:
            replay.fuse(event, one.gain(replay, event))

        yield KnownFault(what + tail, one.blocks, fused, sound=sound)
    if prior is not None:
        yield KnownFault(
            what,
            one.blocks,
            lambda r, e: _less(r, one.gain(r, e), _spread(prior(r), r, e)),
        )
        yield KnownFault(what, one.blocks, lambda r, e: _from(r, e, one.gain(r, e), prior(r)))


def _from(replay: Replay, event: Update, gain: Array, p: Array) -> None:
    """P - K H P with another P."""
    replay.covariance = p
    replay.shorten(event, gain)


def _gains(event: Update, replay: Remembering) -> Iterator[OtherGain]:
    """Yield what a gain that is not Kalman's may be of."""
    blocks = event.blocks
    for what, swap in _noises("R", "update"):
        yield _of_swap(what, blocks, swap)
    yield _of_swap("no R", blocks, _changed("noise", _nothing))
    for what, swap in _of_others("H", "jacobian", "update"):
        yield _of_swap(what, blocks, swap)
    if len(blocks) > 1:
        for block in blocks:
            yield _of_swap(f"H as zero on block {block}", (block,), _on_block(block, 0.0))
            yield _of_swap(
                f"the other sign of H on block {block}", (block,), _on_block(block, -1.0)
            )
    if isinstance(replay.last, Predict):
        yield OtherGain(
            "P without the process noise of the last prediction (sigma points that were not "
            "drawn anew)",
            blocks,
            lambda r, e: _gain(r, e, r.without_noise()),
            prior=Remembering.without_noise,
        )
        yield OtherGain(
            "P before the last prediction",
            blocks,
            lambda r, e: _gain(r, e, r.unpredicted()),
            prior=Remembering.unpredicted,
        )
    yield OtherGain("R in place of S", blocks, lambda r, e: _by(r, e, _inverse(e.noise)))
    yield OtherGain(
        "P H^T S, with S in place of its inverse",
        blocks,
        lambda r, e: _by(r, e, _spread(r.covariance, r, e)),
    )
    yield OtherGain("P H^T, without the inverse of S", blocks, lambda r, e: _by(r, e, np.eye(1)))
    m = len(event.residual)
    if m > 1:
        yield OtherGain(
            "S without what is off its diagonal (each component by itself, all with P as before)",
            blocks,
            lambda r, e: _by(r, e, np.diag(1.0 / np.diag(_spread(r.covariance, r, e)))),
        )
        for i in range(m):
            what = f"H as zero in the row of component {i}"
            yield _of_swap(
                what,
                blocks,
                _changed(
                    "jacobian",
                    partial(_part, rows=slice(i, i + 1), columns=slice(None), factor=0.0),
                ),
            )


def _of_factor(event: Update, replay: Remembering) -> OtherGain | None:
    """A recorded gain of c R; of one number only where c is round, as any gain is of some c."""
    if event.gain is None:
        return None
    s, r = _spread(replay.covariance, replay, event), event.noise
    c = noise_factor(event.gain, _by(replay, event, np.eye(len(r))), s - r, r)
    if c is None or abs(c - 1.0) <= _ALIKE or (len(r) == 1 and digits(c, 1.0) > PLAIN):
        return None
    return _of_swap(f"{c:.4g} R", event.blocks, _changed("noise", lambda noise: c * noise))


def _of_swap(what: str, blocks: Blocks, swap: Swap) -> OtherGain:
    """Kalman's gain of another update."""
    return OtherGain(what, blocks, lambda r, e: _gain(r, swap(r, e) or e), swap)


def _on_block(block: str, factor: float) -> Swap:
    def swap(replay: Remembering, event: Update) -> Update | None:
        if block not in event.blocks:
            return None
        h = event.jacobian.copy()
        h[:, replay.layout.of(event.blocks).entries(block)] *= factor
        return event._replace(jacobian=h)

    return swap


def _of_schmidt(event: Update, replay: Replay) -> Iterator[KnownFault]:
    """Of blocks whose variance stays: an error, unless the estimate is not corrected either."""
    for block in replay.layout.dims:
        part = replay.layout.entries(block)
        if event.correction is None:
            what = (
                f"the variance of block {block} was kept, which is right only where the estimate "
                "is kept, too (Schmidt): record gains to tell"
            )
            yield KnownFault(what, (block,), _schmidt((block,)))
        elif not event.correction[part].any():
            what = f"block {block} is not corrected, and its variance kept (Schmidt)"
            yield KnownFault(what, (block,), _schmidt((block,)), sound=True)


def _of_motion(event: Predict | Reset, replay: Remembering) -> Iterator[KnownFault]:
    """F P F^T with another F. Of a reset, F is its Jacobian."""
    blocks = event.blocks
    name = "F" if isinstance(event, Predict) else "its Jacobian"
    if isinstance(event, Predict):
        yield KnownFault("the covariance was not predicted", blocks, _skipped)
        yield KnownFault("the covariance was predicted twice", blocks, _twice)
        what = "the process noise was not added"
        yield KnownFault(what, blocks, _swapped(_changed("noise", _nothing)))
        what = f"{name} was not applied to the covariance"
        yield KnownFault(what, blocks, _swapped(_changed("jacobian", _identity)))
    for what, change in (
        (f"{name} was applied transposed", _transposed),
        (f"the inverse of {name} was applied", _inverse),
        (f"{name} was taken as zero", _nothing),
    ):
        yield KnownFault(what, blocks, _swapped(_changed("jacobian", change)))
    if isinstance(event, Predict):
        for what, swap in _of_others(name, "jacobian", "prediction"):
            yield KnownFault(f"{what} was applied", blocks, _swapped(swap))
    what = f"{name} was applied on one side alone: F P in place of F P F^T"
    yield KnownFault(what, blocks, partial(_one_side, right=_identity))
    what = f"{name} was applied on both sides alike: F P F in place of F P F^T"
    yield KnownFault(what, blocks, partial(_one_side, right=_transposed))
    what = f"{name} was not applied to the covariance with other blocks"
    yield KnownFault(what, blocks, _alone)
    side = "on one side of the diagonal alone"
    what = f"{name} was applied to the covariance with other blocks {side}"
    yield KnownFault(what, blocks, _one_sided)
    yield from _of_parts(event, replay, name)


def _of_parts(event: Predict | Reset, replay: Replay, name: str) -> Iterator[KnownFault]:
    """F with rows and columns of a block, or of one block by another, lost."""
    f, layout = event.jacobian, replay.layout.of(event.blocks)
    for a, b in permutations(event.blocks, 2):
        i, j = layout.entries(a), layout.entries(b)
        if f[i, j].any():
            for word, factor in (("was left zero", 0.0), ("has the wrong sign", -1.0)):
                swap = _changed("jacobian", partial(_part, rows=i, columns=j, factor=factor))
                what = f"the part of {name} that leads from block {b} to {a} {word}"
                yield KnownFault(what, (a, b), _swapped(swap))
    for a in event.blocks if len(event.blocks) > 1 else ():
        for word, turned in (("rows", False), ("columns", True)):
            swap = _changed("jacobian", partial(_lost, part=layout.entries(a), turned=turned))
            what = f"the {word} of block {a} in {name} were taken as those of the identity"
            if np.array_equal(_lost(f, layout.entries(a), turned=turned), f):
                continue
            yield KnownFault(what, (a,), _swapped(swap))


def _emptied(noise: Array, part: slice) -> Array:
    found = noise.copy()
    found[part] = found[:, part] = 0.0
    return found


def _part(f: Array, rows: slice, columns: slice, factor: float) -> Array:
    found = f.copy()
    found[rows, columns] *= factor
    return found


def _lost(f: Array, part: slice, *, turned: bool) -> Array:
    found = f.copy()
    (found.T if turned else found)[part] = np.eye(len(f))[part]
    return found


def _inverse(matrix: Array) -> Array:
    """The inverse; NaN of a matrix that has none, with which no error explains anything."""
    try:
        return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)


def _pseudo_inverse(matrix: Array) -> Array:
    """The pseudo-inverse; NaN of a matrix that is not finite."""
    if not np.isfinite(matrix).all():
        return np.full_like(matrix, np.nan)
    return np.asarray(np.linalg.pinv(matrix), dtype=np.float64)


def _transposed(matrix: Array) -> Array:
    return matrix.T


def _negative(matrix: Array) -> Array:
    return -matrix


def _nothing(matrix: Array) -> Array:
    return np.zeros_like(matrix)


def _identity(matrix: Array) -> Array:
    return np.eye(len(matrix))


def _of_process_noise(event: Predict, replay: Replay) -> Iterator[KnownFault]:
    blocks, layout = event.blocks, replay.layout.of(event.blocks)
    for block in blocks if len(blocks) > 1 else ():
        what = f"the process noise of block {block} was not added"
        swap = _changed("noise", partial(_emptied, part=layout.entries(block)))
        yield KnownFault(what, (block,), _swapped(swap))
    for what, swap in _noises("Q", "prediction"):
        yield KnownFault(f"{what} was added", blocks, _swapped(swap))
    what = "the process noise was subtracted"
    yield KnownFault(what, blocks, _swapped(_changed("noise", _negative)))
    what = "the process noise was added before F was applied: F (P + Q) F^T"
    f = event.jacobian
    yield KnownFault(what, blocks, _swapped(_changed("noise", lambda q: f @ q @ f.T)))
    noisy = {b for b in blocks if event.noise[layout.entries(b)].any()}
    for a, b in combinations(blocks, 2):
        if layout.dims[a] != layout.dims[b] or not noisy & {a, b}:
            continue
        what = f"the process noises of blocks {a} and {b} were exchanged"
        yield KnownFault(what, (a, b), partial(_exchanged, a=a, b=b))


def _of_augment(event: Augment, replay: Replay) -> Iterator[KnownFault]:
    name, blocks = event.name, event.blocks
    yield KnownFault(
        f"block {name} was not correlated with the others",
        (name, *blocks),
        _then(partial(_uncorrelated, name=name)),
    )
    others = [block for block in replay.layout.dims if block not in blocks]
    yield KnownFault(
        f"its covariance with blocks other than {', '.join(blocks)} was left zero",
        (name, *others),
        _then(partial(_cut, name=name, others=others)),
    )
    yield KnownFault("the noise was left out", (name,), partial(_augmented, own=True, noise=False))
    yield KnownFault(
        f"the uncertainty of {', '.join(blocks)} was left out of the new block's variance",
        (name,),
        partial(_augmented, own=False, noise=True),
    )
    for what, swap in (
        *_noises("R", "augmentation"),
        *_of_others("G_x", "jacobian", "augmentation"),
        *_of_others("G_z", "noise_jacobian", "augmentation"),
        ("the other sign of G_x", _changed("jacobian", _negative)),
        ("G_z transposed", _changed("noise_jacobian", _transposed, _square_matrix)),
        ("R in place of G_z R G_z^T", _changed("noise_jacobian", _identity, _square_matrix)),
        *((f"G_x as zero on block {b}", _on_block(b, 0.0)) for b in blocks if len(blocks) > 1),
    ):
        yield KnownFault(f"the block was initialised with {what}", (name, *blocks), _swapped(swap))


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
                partial(_removed_instead, other=other),
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
                f"the covariance of block {a} with {b} was not updated",
                (a, b),
                partial(_kept, a=a, others=(b,)),
            )
    for a in seen:
        if a in new:
            continue
        yield KnownFault(
            f"the covariance of block {a} was not updated", (a,), partial(_kept, a=a, others=(a,))
        )
        yield KnownFault(
            f"the covariances of block {a} with all others were not updated",
            (a,),
            partial(_kept, a=a, others=tuple(b for b in blocks if b != a)),
        )
        yield KnownFault(
            f"block {a}, with its covariances, was not updated",
            (a,),
            partial(_kept, a=a, others=tuple(blocks)),
        )
    for a, b in combinations(two, 2):
        yield KnownFault(
            f"the covariance of block {a} with {b} was set to zero",
            (a, b),
            _then(partial(_set, a=a, b=b, value=0.0)),
        )


def _of_whole(event: Event, replay: Replay) -> Iterator[KnownFault]:
    """Of what is done to the whole covariance after an event."""
    removed = event.blocks if isinstance(event, Remove) else ()
    blocks = tuple(name for name in replay.layout.dims if name not in removed)
    if len(blocks) > 1:
        what = "the covariances of different blocks were then set to zero"
        yield KnownFault(what, blocks, _then(_independent))
    what = "all that is off the covariance's diagonal was then set to zero"
    yield KnownFault(what, blocks, _then(_diagonal))
    for block in blocks if len(blocks) > 2 else ():
        what = f"the covariances of block {block} with all others were then set to zero"
        yield KnownFault(what, (block,), _then(partial(_uncorrelated, name=block)))


def _skipped(replay: Replay, event: Event) -> None:
    del replay, event


def _twice(replay: Replay, event: Event) -> None:
    """Each time with Kalman's gain, as code does that is called twice."""
    if isinstance(event, Update):
        event = event._replace(gain=None)
    replay.apply(event)
    replay.apply(event)


def _then(change: Callable[[Replay], None]) -> Apply:
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


def _kept(replay: Replay, event: Event, a: str, others: Blocks) -> None:
    """Do the event, but for the covariance of a block with some, of those that there are."""
    entries, dims = replay.layout.entries, replay.layout.dims
    before = {b: replay.covariance[entries(a), entries(b)].copy() for b in others if b in dims}
    replay.apply(event)
    for b, value in before.items():
        _set(replay, a, b, value)


def _uncorrelated(replay: Replay, name: str) -> None:
    i = replay.layout.entries(name)
    own = replay.covariance[i, i].copy()
    replay.covariance[i] = 0.0
    replay.covariance[:, i] = 0.0
    replay.covariance[i, i] = own


def _cut(replay: Replay, name: str, others: Sequence[str]) -> None:
    for other in others:
        _set(replay, name, other, 0.0)


def _independent(replay: Replay, but: str | None = None) -> None:
    for a, b in combinations([name for name in replay.layout.dims if name != but], 2):
        _set(replay, a, b, 0.0)


def _diagonal(replay: Replay) -> None:
    replay.covariance = np.diag(replay.covariance.diagonal())


def _rescaled(replay: Replay, factor: float = 1.0, added: float = 0.0) -> None:
    replay.covariance = factor * replay.covariance + added * np.eye(replay.layout.size)


def _conditioned(replay: Replay, event: Remove) -> None:
    """Remove blocks as if they were known: the Schur complement."""
    gone = replay.layout.columns(event.blocks)
    p = replay.covariance
    own = p[gone][:, gone]
    replay.covariance = p - p[:, gone] @ _pseudo_inverse(own) @ p[gone]
    replay.remove(event.blocks)


def _removed_instead(replay: Replay, event: Remove, other: str) -> None:
    """Remove another block's rows; the others then stand under the names before them."""
    kept = np.delete(np.arange(replay.layout.size), replay.layout.entries(other))
    p = replay.covariance[np.ix_(kept, kept)]
    replay.remove(event.blocks)
    replay.covariance = p


def _square(at: Columns) -> Any:
    """Index of the rows and columns alike."""
    return (at, at) if isinstance(at, slice) else np.ix_(at, at)


def _spread(p: Array, replay: Replay, event: Update) -> Array:
    """H P H^T + R."""
    at, h = replay.layout.columns(event.blocks), event.jacobian
    return np.asarray(h @ p[_square(at)] @ h.T + event.noise)


def _gain(replay: Replay, event: Update, p: Array | None = None) -> Array:
    """Kalman's gain for P, or for another one."""
    p = replay.covariance if p is None else p
    at, h = replay.layout.columns(event.blocks), event.jacobian
    return p[:, at] @ h.T @ _pseudo_inverse(_spread(p, replay, event))


def _by(replay: Replay, event: Update, right: Array) -> Array:
    """P H^T times a matrix; (1, 1) is a factor."""
    at = replay.layout.columns(event.blocks)
    across = replay.covariance[:, at] @ event.jacobian.T
    return across @ right if right.size > 1 or across.shape[1] == 1 else right.item() * across


def _used_gain(replay: Replay, event: Update) -> Array:
    """The recorded gain, or Kalman's where there is none."""
    return _gain(replay, event) if event.gain is None else event.gain


def _less(replay: Replay, gain: Array, s: Array) -> None:
    """P - K S K^T with a matrix in place of S."""
    replay.covariance = replay.covariance - gain @ s @ gain.T


def _without_noise_term(replay: Replay, event: Update) -> None:
    without = event._replace(noise=_nothing(event.noise))
    replay.fuse(without, _used_gain(replay, event))


def _not_transposed(replay: Replay, event: Update) -> None:
    p, gain = replay.covariance, _used_gain(replay, event)
    keep = np.eye(len(p))
    keep[:, replay.layout.columns(event.blocks)] -= gain @ event.jacobian
    wrong = keep @ p @ keep + gain @ event.noise @ gain.T
    replay.covariance = 0.5 * (wrong + wrong.T)


def _by_row(replay: Replay, event: Update) -> None:
    """Joseph's form in two steps, whose second takes H U of the unsymmetric U = P - K H P."""
    gain, at = _used_gain(replay, event), replay.layout.columns(event.blocks)
    replay.shorten(event, gain)
    u = replay.covariance
    u = u - (event.jacobian @ u[at]).T @ gain.T + gain @ event.noise @ gain.T
    replay.covariance = np.tril(u) + np.tril(u, -1).T


_FORMS: tuple[tuple[str, Apply], ...] = (
    ("the covariance is Joseph's form without K R K^T", _without_noise_term),
    (
        "the covariance is Joseph's form with I - K H in place of its transpose",
        _not_transposed,
    ),
    (
        "the covariance is P - K (S - R) K^T: S lacks R",
        lambda r, e: _less(r, _used_gain(r, e), _spread(r.covariance, r, e) - e.noise),
    ),
    (
        "the covariance is P - K R K^T: R in place of S",
        lambda r, e: _less(r, _used_gain(r, e), e.noise),
    ),
    (
        "the covariance is P - K K^T, without S",
        lambda r, e: _less(r, _used_gain(r, e), np.eye(len(e.noise))),
    ),
    (
        "the covariance is P + K H P, of the wrong sign",
        lambda r, e: r.shorten(e, -_used_gain(r, e)),
    ),
    (
        "the covariance is Joseph's form with the row H (P - K H P) in place of the column "
        "(P - K H P) H^T",
        _by_row,
    ),
)


def _gain_of_scaled_r(replay: Replay, event: Update, factor: float) -> Array:
    return _gain(replay, event._replace(noise=factor * event.noise))


def _scaled_gain(replay: Replay, event: Update, factor: float) -> Array:
    return factor * _gain(replay, event)


def _with_number(
    number: float, *, gain: Callable[[Replay, Update, float], Array], short: bool
) -> Apply:
    def apply(replay: Replay, event: Update) -> None:
        form = replay.shorten if short else replay.fuse
        form(event, gain(replay, event, number))

    return apply


def _schmidt(blocks: Blocks) -> Apply:
    def apply(replay: Replay, event: Update) -> None:
        gain = _gain(replay, event)
        gain[replay.layout.columns(blocks)] = 0.0
        replay.fuse(event, gain)

    return apply


def _alone(replay: Replay, event: Predict | Reset | Update) -> None:
    """Do the event on the covariance of its own blocks alone."""
    at = _square(replay.layout.columns(event.blocks))
    before = replay.covariance.copy()
    replay.apply(event)
    before[at] = replay.covariance[at]
    replay.covariance = before


def _one_side(replay: Replay, event: Predict | Reset, right: _Change) -> None:
    """F P G in place of F P F^T, where G is made of F^T."""
    at, f, p = replay.layout.columns(event.blocks), event.jacobian, replay.covariance
    p[at] = f @ p[at]
    p[:, at] = p[:, at] @ right(f.T)
    if isinstance(event, Predict):
        p[_square(at)] += event.noise


def _one_sided(replay: Replay, event: Predict | Reset) -> None:
    at = replay.layout.columns(event.blocks)
    others = np.delete(np.arange(replay.layout.size), at)
    before = replay.covariance[others][:, at]
    replay.apply(event)
    after = replay.covariance[others]
    after[:, at] = before
    replay.covariance[others] = after


def _exchanged(replay: Replay, event: Predict, a: str, b: str) -> None:
    layout = replay.layout.of(event.blocks)
    order = np.arange(layout.size)
    order[layout.entries(a)], order[layout.entries(b)] = (
        np.arange(layout.size)[layout.entries(one)] for one in (b, a)
    )
    replay.apply(event._replace(noise=event.noise[np.ix_(order, order)]))


def _augmented(replay: Replay, event: Augment, *, own: bool, noise: bool) -> None:
    replay.augment(event)
    g, n = event.noise_jacobian, len(event.jacobian)
    at = replay.layout.columns(event.blocks)
    p = replay.covariance
    if not noise:
        p[-n:, -n:] -= g @ event.noise @ g.T
    if not own:
        p[-n:, -n:] -= event.jacobian @ p[at][:, at] @ event.jacobian.T
