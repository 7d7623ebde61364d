"""Functions of a filter are evaluated where it was, in its charts; what fails ends no recording."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.trace.charts import (
    BlockChart,
    JointChart,
    chart_of,
    quaternion_of,
    rotation_by,
    rotation_of,
    rotation_vector,
)
from comparisons.trace.derivatives import evaluate
from comparisons.trace.events import Evaluation, Update
from comparisons.trace.functions import FIRST, NotEvaluatedWarning
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import Recorder
from tests.helpers import Array

KNOWN = {"additive": 4, "angle": 1, "se2": 3, "so3 left": 3, "so3 right": 3, "se23 left": 9,
         "se23 right": 9}  # fmt: skip
ORDERS = (None, "wxyz", "xyzw")


def drawn(name: str, chart: BlockChart, quaternions: str | None, rng: np.random.Generator) -> Array:
    """Numbers of a block."""
    if not name.startswith("s") or name == "se2":
        return rng.normal(size=chart.numbers)
    turn = rotation_by(rng.normal(size=3))
    attitude = turn.ravel() if quaternions is None else quaternion_of(turn)
    if quaternions == "xyzw":
        attitude = np.roll(attitude, -1)
    return np.concatenate((attitude, rng.normal(size=chart.numbers - len(attitude))))


@pytest.mark.parametrize("quaternions", ORDERS)
@pytest.mark.parametrize("name", KNOWN)
def test_minus_undoes_plus_in_every_chart(name: str, quaternions: str | None) -> None:
    rng, dim = np.random.default_rng(0), KNOWN[name]
    chart = chart_of(name, dim, quaternions)
    for _ in range(20):
        numbers, error = drawn(name, chart, quaternions, rng), rng.uniform(-0.9, 0.9, dim)
        moved = chart.plus(numbers, error)
        assert len(moved) == chart.numbers
        np.testing.assert_allclose(chart.minus(moved, numbers), error, atol=1e-13)
        np.testing.assert_allclose(chart.minus(numbers, numbers), 0.0, atol=1e-13)


def test_the_sides_of_an_attitudes_error_are_the_worlds_and_the_bodys() -> None:
    rng = np.random.default_rng(1)
    rotation, error = rotation_by(rng.normal(size=3)), 0.3 * rng.normal(size=3)
    left, right = (chart_of(f"so3 {side}", 3, None) for side in ("left", "right"))
    numbers = rotation.ravel()
    np.testing.assert_allclose(
        left.plus(numbers, error), (rotation_by(error) @ rotation).ravel(), atol=1e-15
    )
    np.testing.assert_allclose(
        right.plus(numbers, error), (rotation @ rotation_by(error)).ravel(), atol=1e-15
    )
    on_world = left.minus(right.plus(numbers, error), numbers)
    np.testing.assert_allclose(on_world, rotation @ error, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 0.3, 1.5, 2.0, 3.1, np.pi - 1e-9])
def test_rotations_and_their_vectors(angle: float) -> None:
    axis = np.array((1.0, -2.0, 0.5)) / np.linalg.norm((1.0, -2.0, 0.5))
    rotation = rotation_by(angle * axis)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(rotation_vector(rotation), angle * axis, atol=1e-7 * angle + 1e-15)
    np.testing.assert_allclose(rotation_of(quaternion_of(rotation)), rotation, atol=1e-14)


def additive(size: int) -> JointChart:
    return JointChart([chart_of("additive", size, None)], [size])


def test_derivatives_are_those_of_calculus() -> None:
    """And their uncertainty holds the error, where numbers are small and large beside the bend."""
    for x in (np.array((0.3, -2.0)), np.array((1e6, 1e6 + 3.0)), np.array((1e-7, 2e-7))):
        size = abs(x[1] - x[0]) or 1.0

        def function(p: Array, size: float = float(size)) -> Array:
            return np.array((np.sin((p[1] - p[0]) / size), p[0] * p[1]))

        found, _ = evaluate(function, x, (additive(2), None), np.zeros(2))
        slope = np.cos((x[1] - x[0]) / size) / size
        right = np.array(((-slope, slope), (x[1], x[0])))
        assert (np.abs(found.jacobian - right) <= found.uncertainty).all(), x
        assert (found.uncertainty <= 1e-4 * np.abs(right)).all(), x


def test_an_angle_that_jumps_by_a_turn_has_no_derivative_of_a_jump() -> None:
    x = np.array((-5.0, 1e-4))
    found, _ = evaluate(
        lambda p: [np.arctan2(p[1], p[0])], x, (additive(2), None), np.array((0.1, 0.1))
    )
    np.testing.assert_allclose(found.jacobian, [[-x[1] / 25.0, -0.2]], rtol=1e-6, atol=1e-9)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.trace"


def test_known_steps_give_what_two_steps_give(path: Path) -> None:
    """All but one of ten evaluations of a slot take over the steps of the one before."""
    with Recorder(path) as record:
        record.prior({"a": 2}, np.eye(2), point=[1.0, 2.0])
        for k in range(30):
            x = np.array((1.0 + 0.1 * k, 2.0))
            record.predict(
                *(np.eye(2), np.eye(2)), function=lambda p: [p[0] ** 2, p[0] * p[1]], point=x
            )
    found = [event for event in TraceReader(path) if isinstance(event, Evaluation)]
    assert len(found) == 30
    for k, event in enumerate(found):
        x = np.array((1.0 + 0.1 * k, 2.0))
        right = np.array(((2.0 * x[0], 0.0), (x[1], x[0])))
        assert (np.abs(event.jacobian - right) <= event.uncertainty + 1e-12).all()
        np.testing.assert_allclose(event.value, (x[0] ** 2, x[0] * x[1]))


def test_the_first_hundred_are_evaluated_and_then_a_share(path: Path) -> None:
    with Recorder(path, derivatives=0.1) as record:
        record.prior({"a": 1}, np.eye(1))
        for k in range(400):
            record.update("x", 0.0, 1.0, 1.0, point=[1.0], function=lambda p: p, numbers=k)
    number, evaluated = -1.0, []
    for event in TraceReader(path):
        if isinstance(event, Update) and event.numbers is not None:
            number = event.numbers[0]
        elif isinstance(event, Evaluation):
            evaluated.append(number)
    assert evaluated[:FIRST] == list(range(FIRST))
    assert evaluated[FIRST:] == list(range(FIRST + 9, 400, 10))


def raises(x: Array) -> Array:
    raise RuntimeError("no map")


FAILING: dict[str, tuple[Callable[[Array], Any], str]] = {
    "raises": (raises, "raised RuntimeError (no map)"),
    "not finite": (lambda x: x / 0.0, "gives a number that is not finite"),
    "shape": (lambda x: np.zeros(3), "gives 3 numbers, expected 2"),
    "words": (lambda x: "right", "could not convert string to float"),
}


@pytest.mark.parametrize("name", FAILING)
def test_a_function_that_fails_is_a_warning_once_and_the_event_is_recorded(
    path: Path, name: str
) -> None:
    function, said = FAILING[name]
    with Recorder(path) as record:
        record.prior({"a": 2}, np.eye(2))
        with pytest.warns(NotEvaluatedWarning) as caught:
            record.predict(np.eye(2), np.eye(2), function=function, point=[1.0, 2.0])
        record.predict(np.eye(2), np.eye(2), function=function, point=[1.0, 2.0])
    (warning,) = caught
    assert said in str(warning.message)
    assert f"{path}, event 1: the function for F" in str(warning.message)
    assert "its derivative is not recorded" in str(warning.message)
    kinds = [type(event).__name__ for event in TraceReader(path)]
    assert kinds == ["TracePrior", "Predict", "Predict"]


def test_a_point_of_other_numbers_than_the_charts_is_a_warning(path: Path) -> None:
    with Recorder(path) as record:
        record.prior({"attitude": 3}, np.eye(3), charts={"attitude": "so3 right"})
        with pytest.warns(NotEvaluatedWarning, match="point has 4 numbers, its blocks' charts 9"):
            record.predict(np.eye(3), np.eye(3), function=lambda x: x, point=np.ones(4))


def test_a_function_without_a_point_is_refused(path: Path) -> None:
    with Recorder(path) as record:
        record.prior({"a": 1}, np.eye(1))
        with pytest.raises(InputError, match="has a function for F, and no point"):
            record.predict(1.0, 1.0, function=lambda x: x)
        with pytest.raises(InputError, match="measured is 2, expected 1 numbers"):
            record.update("x", 0.0, 1.0, 1.0, point=[1.0], function=lambda x: x, measured=[1, 2])
    assert TraceReader(path).counts.events == 1


@pytest.mark.parametrize(
    ("options", "said"),
    [({"derivatives": 1.5}, "derivatives is 1.5"), ({"quaternions": "wzyx"}, "quaternions is")],
)
def test_other_options_are_refused(path: Path, options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Recorder(path, **options)
    assert not path.exists()


def test_a_chart_of_the_filters_own(path: Path) -> None:
    """An angle kept as a unit vector, of one error."""
    chart = BlockChart(
        2,
        lambda numbers, error: np.array(
            (
                np.cos(error[0]) * numbers[0] - np.sin(error[0]) * numbers[1],
                np.sin(error[0]) * numbers[0] + np.cos(error[0]) * numbers[1],
            )
        ),
        lambda numbers, others: np.array(
            [np.arctan2(others[0] * numbers[1] - others[1] * numbers[0], numbers @ others)]
        ),
    )
    with Recorder(path) as record:
        record.prior({"direction": 1}, np.eye(1), charts={"direction": chart})
        record.update("x", 0.0, 1.0, 1.0, point=[0.6, 0.8], function=lambda n: 10.0 * n[:1])
        record.predict(1.0, 1.0, point=[0.6, 0.8], function=lambda n: np.array((-n[1], n[0])))
    found = [event for event in TraceReader(path) if isinstance(event, Evaluation)]
    np.testing.assert_allclose(found[0].jacobian, [[-8.0]], rtol=1e-9)
    np.testing.assert_allclose(found[1].jacobian, [[1.0]], rtol=1e-9)
