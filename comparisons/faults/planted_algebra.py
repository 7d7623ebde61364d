"""Faults of a filter's algebra in a filter that runs: formulas, their operands and their results.

Prediction, update and new landmarks are done by their recipes with whole matrices, as in a
textbook. A fault is another formula in the place of a result's own, a number at an operand, or a
part of a result that is zero or as before the event. What is tried follows from recipes and parts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.faults.fault import Family, Fault, Plant, keeping
from comparisons.faults.formulas import (
    Formula,
    Recipe,
    Use,
    evaluated,
    formula,
    shape_of,
    uses,
    variants,
    written,
)
from comparisons.faults.recipes import AFTER, FORMS, GAIN, SUBJECTS
from ekf_reference.core.blocks import block_diagonal
from ekf_reference.core.geometry import Index
from ekf_reference.core.landmark_types import POINT, LandmarkKind, NewLandmarks
from ekf_reference.core.layout import Layout
from ekf_reference.core.state import Correction, FilterDivergedError, KalmanState

Matrices = Mapping[str, Array]
CORRECTION = "d"
"""The result that is added to the state."""
_PREDICTION, _UPDATE, _NEW = "the prediction", "the update", "the initialisation of landmarks"
_STATE, _MEASURED, _POSE = 7, 2, 3
"""Sizes by which formulas are told apart: of the state, of a measurement, of the pose."""
_SUBJECTS = {**SUBJECTS, CORRECTION: "the correction"}
_PARTED = {"C": "the new block's covariance"}


def _recipe(**texts: str) -> dict[str, Formula]:
    return {name: formula(text) for name, text in texts.items()}


RECIPES: Mapping[tuple[str, str], Recipe] = {
    (_PREDICTION, ""): _recipe(after="F P F^T + Q"),
    (_NEW, ""): _recipe(C="G_x P", N="G_x P G_x^T + G_z R G_z^T"),
    **{(_UPDATE, form): _recipe(**GAIN, **last, d="K v") for form, last in FORMS.items()},
    **{
        (_UPDATE, f"{form or 'its own formulas'} beside a correction by Kalman's gain"): _recipe(
            **GAIN, **last, d="P H^T S^-1 v"
        )
        for form, last in FORMS.items()
    },
}
"""By event and form."""
_OPERANDS = {
    _PREDICTION: {"P": (_STATE, _STATE), "F": (_STATE, _STATE), "Q": (_STATE, _STATE)},
    _NEW: {
        "P": (_STATE, _STATE), "G_x": (2, _STATE), "G_z": (2, _MEASURED),
        "R": (_MEASURED, _MEASURED),
    },
    _UPDATE: {
        "P": (_STATE, _STATE), "H": (_MEASURED, _STATE), "R": (_MEASURED, _MEASURED),
        "v": (_MEASURED, 1), "I": (_STATE, _STATE),
    },
}  # fmt: skip


class Entries(NamedTuple):
    """Of the state.

    owner: (n,) 0 for the pose, one number for each landmark. measured: (n,) which the event is of.
    """

    owner: NDArray[np.intp]
    measured: NDArray[np.bool_]

    @classmethod
    def of(cls, layout: Layout, columns: Index | None = None) -> Entries:
        """Return those of a layout. columns: that the event is of; of none where left out."""
        owner = np.zeros(layout.size, dtype=np.intp)
        for kind, first in layout.first.items():
            for at in first[first >= 0].tolist():
                owner[at : at + kind.width] = at
        measured = np.zeros(layout.size, dtype=bool)
        if columns is not None:
            measured[columns] = True
        return cls(owner, measured)


Part = Callable[[Entries], NDArray[np.bool_]]
"""(n, n) or (n, 1) which terms."""


def _across(entries: Entries) -> NDArray[np.bool_]:
    pose = entries.owner == 0
    above: NDArray[np.bool_] = pose[:, None] & ~pose
    return above


def between_landmarks(entries: Entries) -> NDArray[np.bool_]:
    """Return (n, n) where entries of one landmark meet those of another."""
    owner = entries.owner
    apart: NDArray[np.bool_] = (owner[:, None] != owner) & (owner[:, None] > 0) & (owner > 0)
    return apart


def _pairs(rows: NDArray[np.bool_], columns: NDArray[np.bool_]) -> NDArray[np.bool_]:
    entries: NDArray[np.bool_] = rows[:, None] & columns
    return entries | entries.T


COVARIANCE_PARTS: Mapping[str, Part] = {
    "of the pose": lambda e: _pairs(e.owner == 0, e.owner == 0),
    "of the pose with the landmarks": lambda e: _across(e) | _across(e).T,
    "of the pose with the landmarks above the diagonal": _across,
    "of the pose with the landmarks below the diagonal": lambda e: _across(e).T,
    "of the landmarks": lambda e: _pairs(e.owner > 0, e.owner > 0),
    "of different landmarks with each other": between_landmarks,
    "of different blocks with each other": lambda e: e.owner[:, None] != e.owner,
    "off its diagonal": lambda e: ~np.eye(len(e.owner), dtype=bool),
    "above the diagonal": lambda e: np.tri(len(e.owner), k=-1, dtype=bool).T,
    "below the diagonal": lambda e: np.tri(len(e.owner), k=-1, dtype=bool),
    "of what is not measured": lambda e: _pairs(~e.measured, ~e.measured),
    "of what is not measured with all others": lambda e: _pairs(~e.measured, e.measured),
    "of what is not measured, with all others as well,": lambda e: _pairs(
        ~e.measured, np.ones_like(e.measured)
    ),
}  # fmt: skip
ROW_PARTS: Mapping[str, Part] = {
    "of the pose": lambda e: (e.owner == 0)[:, None],
    "of the position": lambda e: (np.arange(len(e.owner)) < 2)[:, None],
    "of the heading": lambda e: (np.arange(len(e.owner)) == 2)[:, None],
    "of the landmarks": lambda e: (e.owner > 0)[:, None],
    "of the landmarks that are not measured": lambda e: ((e.owner > 0) & ~e.measured)[:, None],
    "of all but the pose and the landmarks that are measured": lambda e: ~e.measured[:, None],
}
_COLUMN_PARTS: Mapping[str, Part] = {
    "with the pose": lambda e: (e.owner == 0)[None],
    "with the landmarks": lambda e: (e.owner > 0)[None],
    "with the others": lambda e: np.ones((1, len(e.owner)), dtype=bool),
}
_PARTS: Mapping[str, Mapping[str, Part]] = {
    AFTER: COVARIANCE_PARTS, "K": ROW_PARTS, CORRECTION: ROW_PARTS, "C": _COLUMN_PARTS,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class AlgebraChange:
    """What is computed otherwise.

    Attributes:
        event: Which: prediction, update, or the initialisation of landmarks.
        recipe: The formulas.
        form: Which of several that are equal without a fault, in words; empty for the plain one.
        places: Of an operand that is multiplied by a factor.
        factor: That.
        result: A part of it is another.
        part: Of the result.
        becomes: `zero`, `as before` or `negated`.
        identity: [m^2] variance that stands in a new landmark's covariance; None for its own.
        symmetrised: Every covariance is made symmetric.
    """

    event: str
    recipe: Recipe
    form: str = ""
    places: frozenset[Use] = frozenset()
    factor: float = 1.0
    result: str = ""
    part: Part | None = None
    becomes: str = ""
    identity: float | None = None
    symmetrised: bool = False

    def results(self, matrices: Matrices, entries: Entries) -> dict[str, Array]:
        """Return all matrices of an event, the results among them."""
        values = dict(matrices)
        for name, terms in self.recipe.items():
            places = frozenset(use for use in self.places if use.result == name)
            made = evaluated({name: terms}, values, places, self._scaled)[name]
            values[name] = self._changed(name, made, values["P"], entries)
        if self.symmetrised and AFTER in values:
            values[AFTER] = 0.5 * (values[AFTER] + values[AFTER].T)
        if self.identity is not None and "N" in values:
            values["N"] = self.identity * np.eye(len(values["N"]))
        return values

    def _scaled(self, values: Matrices) -> Array:
        use = next(iter(self.places))
        name = self.recipe[use.result][use.term].factors[use.factor].name
        return self.factor * values[name]

    def _changed(self, name: str, made: Array, before: Array, entries: Entries) -> Array:
        if name != self.result or self.part is None:
            return made
        other = {
            "zero": np.zeros_like(made),
            "as before": before if made.shape == before.shape else np.zeros_like(made),
            "negated": -made,
        }[self.becomes]
        return np.where(self.part(entries), other, made)


def algebra_faults() -> Iterator[Fault]:
    """Yield faults of the plain formulas without a number, the simplest first."""
    for what, change in _distinct():
        if change.form == "":
            yield Fault(what, algebra_planted(change))


def joined_algebra_faults() -> Iterator[Fault]:
    """Yield faults of formulas of another form, or beside a correction by another gain."""
    for what, change in _distinct():
        if change.form != "":
            yield Fault(what, algebra_planted(change))


def algebra_families() -> Iterator[Family]:
    """Yield faults of the algebra with a number: an operand in a formula times a factor."""
    made = _DistinctValues(_signature(_sound(*key)) for key in RECIPES)
    for (event, form), recipe in RECIPES.items():
        for result, terms in recipe.items():
            for name in dict.fromkeys(f.name for term in terms for f in term.factors):
                if name in ("I", "v"):
                    continue
                places = frozenset(use for use in uses(recipe, name) if use.result == result)
                change = replace(_sound(event, form), places=places)
                if not made.adds(_signature(replace(change, factor=1.7))):
                    continue
                subject = _subject(event, form, result)
                yield Family(
                    f"{subject} is computed with {{}} times {name}",
                    plant=partial(_with_factor, change),
                )
    for with_others in (False, True):
        recipe = RECIPES[_NEW, ""]
        change = AlgebraChange(event=_NEW, recipe=recipe)
        words = ""
        if not with_others:
            every = _COLUMN_PARTS["with the others"]
            change = replace(change, result="C", part=every, becomes="zero")
            words = ", and without any cross-covariance"
        yield Family(
            f"a landmark is initialised with the covariance {{}} m^2 I{words}",
            plant=partial(_with_identity, change), neutral=0.01,
        )  # fmt: skip


def _with_factor(change: AlgebraChange, factor: float) -> Plant:
    return algebra_planted(replace(change, factor=factor))


def _with_identity(change: AlgebraChange, variance: float) -> Plant:
    return algebra_planted(replace(change, identity=variance))


def _sound(event: str, form: str) -> AlgebraChange:
    return AlgebraChange(event=event, recipe=RECIPES[event, form], form=form)


def _subject(event: str, form: str, result: str, part: str = "") -> str:
    subject = _SUBJECTS.get(result, result)
    if part:
        subject = f"{_PARTED.get(result, subject)} {part}"
    return f"in {event}{f' by {form}' if form else ''}, {subject}"


@cache
def _distinct() -> tuple[tuple[str, AlgebraChange], ...]:
    """Changes that make other values than a sound filter, each by the first of its words."""
    made = _DistinctValues(_signature(_sound(*key)) for key in RECIPES)
    distinct: list[tuple[str, AlgebraChange]] = []
    for what, change in (*_parts_changed(), *_formulas_changed()):
        signature = _signature(change)
        if not made.adds(signature):
            continue
        distinct.append((what, change))
        if change.event == _NEW:
            continue
        after = signature[: _STATE**2].reshape(_STATE, _STATE)
        if not np.allclose(after, after.T):
            also = replace(change, symmetrised=True)
            distinct.append((f"{what}, and then made symmetric", also))
    return tuple(distinct)


class _DistinctValues:
    """Values, of one length each, that differ from each other by more than rounding."""

    def __init__(self, first: Iterable[Array]) -> None:
        self._of_length: dict[int, Array] = {}
        for values in first:
            self.adds(values)

    def adds(self, values: Array) -> bool:
        """Whether values (k,) are finite and differ from all before; they are then among these."""
        if not np.isfinite(values).all():
            return False
        before = self._of_length.get(len(values), np.empty((0, len(values))))
        if (np.abs(before - values) <= 1e-9 + 1e-7 * np.abs(before)).all(axis=1).any():
            return False
        self._of_length[len(values)] = np.vstack((before, values))
        return True


def _parts_changed() -> Iterator[tuple[str, AlgebraChange]]:
    for event, form in ((_NEW, ""), (_PREDICTION, ""), (_UPDATE, "")):
        recipe = RECIPES[event, form]
        for result in recipe:
            for words, part in _PARTS.get(result, {}).items():
                for becomes, said in _becoming(result).items():
                    yield (
                        f"{_subject(event, form, result, words)} {said}",
                        AlgebraChange(
                            event=event, recipe=recipe, result=result, part=part, becomes=becomes
                        ),
                    )


def _becoming(result: str) -> Mapping[str, str]:
    words = {"zero": "is zero", "negated": "has the opposite sign"}
    return {**words, "as before": "is as before the event"} if result == AFTER else words


def _formulas_changed() -> Iterator[tuple[str, AlgebraChange]]:
    for (event, form), recipe in RECIPES.items():
        shapes: dict[str, tuple[int, ...]] = dict(_OPERANDS[event])
        for result, terms in recipe.items():
            for other in variants(terms, shapes):
                words = f"{_subject(event, form, result)} is {written(other)}"
                said = words.replace(AFTER, "the new P")
                changed = {**recipe, result: other}
                yield said, AlgebraChange(event=event, recipe=changed, form=form)
            shape = shape_of(terms, shapes)
            if shape is not None:
                shapes[result] = shape


def _signature(change: AlgebraChange) -> Array:
    """What a change makes of values drawn at random; the event's kind as the last number."""
    rng, values = np.random.default_rng(2), dict[str, Array]()
    for name, shape in _OPERANDS[change.event].items():
        values[name] = rng.standard_normal(shape)
        if name in ("P", "Q", "R"):
            values[name] = values[name] @ values[name].T + np.eye(shape[0])
    if change.event == _UPDATE:
        values["I"] = np.eye(_STATE)
        values["H"][:, 5:] = 0.0
    if change.event == _PREDICTION:
        values["F"][_POSE:], values["F"][:, _POSE:] = np.eye(_STATE)[_POSE:], 0.0
        values["F"][_POSE:, _POSE:] = np.eye(_STATE - _POSE)
        values["Q"][_POSE:] = values["Q"][:, _POSE:] = 0.0
    if change.event == _NEW:
        values["G_x"][:, _POSE:] = 0.0
    owner = np.array((0, 0, 0, 3, 3, 5, 5))
    entries = Entries(owner, owner < 5)
    with np.errstate(all="ignore"):
        made = change.results(values, entries)
    shown = [made[name].ravel() for name in (AFTER, CORRECTION, "C", "N") if name in made]
    return np.concatenate((*shown, [float(list(_OPERANDS).index(change.event))]))


def algebra_planted(change: AlgebraChange) -> Plant:
    """Return what makes a filter's state compute its events by recipes, one of them changed."""
    events = {
        key: _sound(key, "") if key != change.event else change
        for key in (_PREDICTION, _UPDATE, _NEW)
    }
    if change.symmetrised:
        events = {key: replace(change, symmetrised=True) for key, change in events.items()}

    def predict(original: Any, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        state: KalmanState = original.__self__
        p = state.covariance.copy()
        f, q, v = np.eye(len(p)), np.zeros_like(p), len(pose)
        f[:v, :v], q[:v, :v] = jacobian_pose, noise
        entries = Entries.of(state.layout, np.arange(v))
        values = events[_PREDICTION].results({"P": p, "F": f, "Q": q}, entries)
        state._mean[:v] = pose
        state._covariance[: len(p), : len(p)] = values[AFTER]

    def update(
        original: Any, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        state: KalmanState = original.__self__
        p, mean = state.covariance.copy(), state.mean.copy()
        done: Correction = original(columns, jacobian, innovation, noise)
        h = np.zeros((len(jacobian), len(p)))
        np.add.at(h.T, columns, jacobian.T)
        given = {"P": p, "H": h, "R": noise, "v": innovation[:, None], "I": np.eye(len(p))}
        values = events[_UPDATE].results(given, Entries.of(state.layout, columns))
        if not np.isfinite(values[AFTER]).all():
            raise FilterDivergedError("the covariance is not finite")
        state._mean[: len(p)] = mean + values[CORRECTION][:, 0]
        state._covariance[: len(p), : len(p)] = values[AFTER]
        return done

    def augment(original: Any, new: NewLandmarks, noise: Array, kind: LandmarkKind = POINT) -> None:
        state: KalmanState = original.__self__
        p, entries = state.covariance.copy(), Entries.of(state.layout)
        original(new, noise, kind)
        n, v = len(p), state.layout.pose_size
        g_x = np.zeros((new.landmark.size, n))
        g_x[:, :v] = new.jacobian_pose.reshape(-1, v)
        given = {
            "P": p, "G_x": g_x, "G_z": block_diagonal(new.jacobian_z), "R": block_diagonal(noise)
        }  # fmt: skip
        values = events[_NEW].results(given, entries)
        end = n + len(g_x)
        state._covariance[n:end, :n] = values["C"]
        state._covariance[:n, n:end] = values["C"].T
        state._covariance[n:end, n:end] = values["N"]

    return keeping(predict=predict, update=update, augment=augment)
