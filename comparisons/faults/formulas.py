"""Formulas of a filter as sums of products, and what may be written in their place by mistake.

A formula is text: names of matrices, with ^T or ^-1, products by a blank and of entries by *, as
`F P F^T + Q`. A recipe is formulas in the order in which they are computed; the last of them is
what an event makes of the covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array

_TRANSPOSED, _INVERTED, _BY_ENTRIES = "^T", "^-1", "*"
Shapes = Mapping[str, tuple[int, ...]]
_ALIKE = 1e-6
"""Of the largest entry, within which a recorded matrix is one that is known."""


class Factor(NamedTuple):
    """A matrix by its name. mark: ^T, ^-1 or nothing. joint: * where entries are multiplied."""

    name: str
    mark: str = ""
    joint: str = ""

    @property
    def text(self) -> str:
        """As it is written after the factor before it."""
        return f"{self.joint} {self.name}{self.mark}".strip()


class Term(NamedTuple):
    """A product with its sign."""

    sign: float
    factors: tuple[Factor, ...]


Formula = tuple[Term, ...]
Recipe = Mapping[str, Formula]


class Use(NamedTuple):
    """A place where a matrix stands: in the formula of a result, by numbers of term and factor."""

    result: str
    term: int
    factor: int


def formula(text: str) -> Formula:
    """Return the formula that a text says."""
    terms: list[Term] = []
    sign, joint, factors = 1.0, "", list[Factor]()
    for word in (*text.split(), "+"):
        if word in ("+", "-"):
            if factors:
                terms.append(Term(sign, tuple(factors)))
            sign, factors = (1.0 if word == "+" else -1.0), []
        elif word == _BY_ENTRIES:
            joint = word
        else:
            name, mark, power = word.partition("^")
            factors.append(Factor(name, mark + power, joint))
            joint = ""
    return tuple(terms)


def written(formula: Formula) -> str:
    """Return a formula's text."""
    text = ""
    for number, (sign, factors) in enumerate(formula):
        between = ("+ " if sign > 0.0 else "- ") if number or sign < 0.0 else ""
        text += f" {between}" + " ".join(factor.text for factor in factors)
    return text.strip()


def uses(recipe: Recipe, name: str) -> list[Use]:
    """Return the places where a matrix stands."""
    return [
        Use(result, i, k)
        for result, terms in recipe.items()
        for i, term in enumerate(terms)
        for k, factor in enumerate(term.factors)
        if factor.name == name
    ]


def evaluated(
    recipe: Recipe,
    matrices: Mapping[str, Array],
    places: frozenset[Use] = frozenset(),
    instead: Callable[[Mapping[str, Array]], Array] | None = None,
) -> dict[str, Array]:
    """Return the matrices with all results of a recipe.

    Args:
        recipe: Formulas in their order.
        matrices: By name; results among them are taken as they are, up to the first place.
        places: Where something else stands.
        instead: Makes it of the matrices that there are by then, one or a stack (N, r, c) of them.

    Raises:
        ValueError: Shapes do not go together.
    """
    values, changed = dict(matrices), {use.result for use in places}
    made = False
    for result, terms in recipe.items():
        made = made or result in changed or result not in values
        if not made:
            continue
        total: Array | None = None
        for i, (sign, factors) in enumerate(terms):
            product: Array | None = None
            for k, factor in enumerate(factors):
                value = values[factor.name]
                if instead is not None and (result, i, k) in places:
                    value = instead(values)
                product = _joined(product, _marked(value, factor.mark), factor.joint)
            assert product is not None  # noqa: S101 - a term has a factor
            product = sign * product if sign < 0.0 else product
            total = product if total is None else total + product
        assert total is not None  # noqa: S101 - a formula has a term
        values[result] = total
    return values


def _joined(left: Array | None, right: Array, joint: str) -> Array:
    if left is None:
        return right
    product: Array = left * right if joint == _BY_ENTRIES else left @ right
    return product


def _marked(value: Array, mark: str) -> Array:
    if mark == _TRANSPOSED:
        return value.mT
    return inverse(value) if mark == _INVERTED else value


def alike(matrix: Array, recorded: Array) -> bool:
    """Return whether a gain, a correction or another matrix is the recorded one."""
    near = _ALIKE * float(np.abs(recorded).max(initial=0.0))
    return matrix.shape == recorded.shape and bool(np.all(np.abs(matrix - recorded) <= near))


def inverse(matrix: Array) -> Array:
    """Return inverses (..., n, n); NaN of what has none, with which nothing is explained."""
    try:
        return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        if matrix.ndim == 2:
            return np.full_like(matrix, np.nan)
        return np.stack([inverse(entry) for entry in matrix])


def shape_of(formula: Formula, shapes: Shapes) -> tuple[int, ...] | None:
    """Return the shape of what a formula makes; None where shapes do not go together."""
    total: tuple[int, ...] | None = None
    for _, factors in formula:
        product: tuple[int, ...] | None = None
        for factor in factors:
            shape = shapes[factor.name]
            if factor.mark == _INVERTED and shape[0] != shape[1]:
                return None
            shape = shape[::-1] if factor.mark == _TRANSPOSED else shape
            if product is None:
                product = shape
            elif factor.joint == _BY_ENTRIES:
                if shape != product:
                    return None
            elif shape[0] != product[1]:
                return None
            else:
                product = product[0], shape[1]
        if total not in (None, product):
            return None
        total = product
    return total


def variants(original: Formula, shapes: Shapes) -> Iterator[Formula]:
    """Yield what may be written in a formula's place, the simplest first, each of its shape.

    A term or factors are left out, a sign, a transpose or an inverse is another, another matrix
    stands in a place, entries are multiplied where matrices should be, or brackets stand elsewhere.
    """
    texts = {written(original)}
    shape = shape_of(original, shapes)
    for variant in _rewritten(original, shapes):
        text = written(variant)
        if variant and text not in texts and shape_of(variant, shapes) == shape:
            texts.add(text)
            yield variant


def _rewritten(original: Formula, shapes: Shapes) -> Iterator[Formula]:
    places = range(len(original))
    yield from (original[:i] + original[i + 1 :] for i in places)
    for left_out in (1, 2, 3):
        for i in places:
            factors = original[i].factors
            for staying in combinations(factors, max(len(factors) - left_out, 0)):
                yield _with(original, i, factors=staying)
    for i in places:
        yield from (
            _with(original, i, factors=factors_of) for factors_of in _marked_otherwise(original[i])
        )
    yield from (_with(original, i, sign=-original[i].sign) for i in places)
    for i in places:
        yield from (_with(original, i, factors=one) for one in _of_others(original[i], shapes))
        yield from (_with(original, i, factors=one) for one in _by_entries(original[i].factors))
    for i, j in permutations(places, 2):
        around = original[i].factors
        if len(around) > 2:
            inside = (around[0], *original[j].factors, around[-1])
            yield _with(original, j, factors=inside)


def _with(
    original: Formula,
    place: int,
    sign: float | None = None,
    factors: tuple[Factor, ...] | None = None,
) -> Formula:
    """A formula with another sign or other factors in a term; without the term if none are left."""
    if factors == ():
        return original[:place] + original[place + 1 :]
    term = original[place]
    term = term._replace(sign=term.sign if sign is None else sign)
    term = term._replace(factors=term.factors if factors is None else factors)
    return (*original[:place], term, *original[place + 1 :])


def _marked_otherwise(term: Term) -> Iterator[tuple[Factor, ...]]:
    for k, factor in enumerate(term.factors):
        for mark in ("", _TRANSPOSED, _INVERTED):
            if mark != factor.mark:
                yield _put(term.factors, k, factor._replace(mark=mark))


def _of_others(term: Term, shapes: Shapes) -> Iterator[tuple[Factor, ...]]:
    for k, factor in enumerate(term.factors):
        for name, shape in shapes.items():
            if name != factor.name and shape == shapes[factor.name]:
                yield _put(term.factors, k, factor._replace(name=name))


def _by_entries(factors: tuple[Factor, ...]) -> Iterator[tuple[Factor, ...]]:
    later = range(1, len(factors))
    for count in range(1, len(factors)):
        for places in combinations(later, count):
            yield tuple(
                factor._replace(joint=_BY_ENTRIES if k in places else factor.joint)
                for k, factor in enumerate(factors)
            )


def _put(factors: tuple[Factor, ...], place: int, factor: Factor) -> tuple[Factor, ...]:
    return (*factors[:place], factor, *factors[place + 1 :])
