"""Recipes: the formulas by which a filter's events make a new covariance.

`after` is the covariance after an event; C and N are those of a new block, with the others and its
own. An update has several forms that are equal for Kalman's gain.
"""

from __future__ import annotations

from comparisons.faults.formulas import Recipe, formula, written
from comparisons.trace.events import Augment, Clone, Event, Predict, Reset

AFTER = "after"
"""The result that is the covariance after an event."""


def _recipe(**formulas: str) -> Recipe:
    return {name: formula(text) for name, text in formulas.items()}


GAIN = {"S": "H P H^T + R", "K": "P H^T S^-1"}

FORMS = {
    "": {AFTER: "P - K H P"},
    "the form P - K S K^T": {AFTER: "P - K S K^T"},
    "Joseph's form": {"A": "I - K H", AFTER: "A P A^T + K R K^T"},
    "Joseph's form in two steps": {"U": "P - K H P", AFTER: "U - U H^T K^T + K R K^T"},
}

FOR_ANY_GAIN = ("Joseph's form", "Joseph's form in two steps")

_PREDICTION = _recipe(after="F P F^T + Q")

_RESET = _recipe(after="J P J^T")

_AUGMENTATION = _recipe(C="G_x P", N="G_x P G_x^T + G_z R G_z^T")

_CLONE = _recipe(C="G_x P", N="G_x P G_x^T")

_UPDATES = {form: _recipe(**GAIN, **last) for form, last in FORMS.items()}

_UPDATES_BY_RECORDED_GAIN = {form: _recipe(S=GAIN["S"], **last) for form, last in FORMS.items()}

SUBJECTS = {
    AFTER: "the covariance",
    "J": "its Jacobian",
    "C": "the new block's covariance with the others",
    "N": "the new block's own covariance",
}


def recipe_of(event: Event, form: str, *, with_recorded: bool = False) -> Recipe:
    """Return the recipe of an event; of an update by its form, with its gain or the recorded."""
    match event:
        case Predict():
            return _PREDICTION
        case Reset():
            return _RESET
        case Augment():
            return _AUGMENTATION
        case Clone():
            return _CLONE
    return (_UPDATES_BY_RECORDED_GAIN if with_recorded else _UPDATES)[form]


def formulas_in_words() -> dict[str, str]:
    """Return the formulas of each kind of event, and of an update in each form."""
    by_name = {
        "prediction": _PREDICTION,
        **{f"update{form and f' in {form}'}": recipe for form, recipe in _UPDATES.items()},
        "new block": _AUGMENTATION,
        "clone": _CLONE,
        "reset": _RESET,
    }
    return {
        name: "; ".join(
            f"{'P' if result == AFTER else result} = {written(text)}"
            for result, text in recipe.items()
        )
        for name, recipe in by_name.items()
    }
