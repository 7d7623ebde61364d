"""Records a filter of a known library, or of one's own, without a change in it.

A filter is known by what it has, not by its class, so that no library is imported here: filterpy's
and bayesian-filters' KalmanFilter, ExtendedKalmanFilter and UnscentedKalmanFilter, Stone Soup's
Kalman predictor and updater, and any class with x, P, predict and update, and F, Q, H and R as
methods.

A UKF has no Jacobians, but its points imply them: of a step y = g(x) with P, P_xy, P_yy the
regression of y on x is A = P_xy' P^-1, and what it leaves over, P_yy - A P A', acts as noise
(Lefebvre, Bruyninckx and De Schutter 2002).
"""

from __future__ import annotations

import atexit
import inspect
from collections.abc import Callable, Mapping
from copy import copy
from functools import partial, wraps
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.trace.functions import Function
from comparisons.trace.recorder import MeasurementNotes, Recorder

_MEASUREMENT = "measurement"


class FilterStep(NamedTuple):
    """What a prediction used, or an update (H and R), and the sensor's name.

    function: f, of the state's numbers, or h; None where the filter has none. measured: of h.
    """

    jacobian: Any
    noise: Any
    sensor: str = _MEASUREMENT
    function: Function | None = None
    measured: Any = None


def record(
    filter: Any,  # noqa: A002 - it is what the caller has
    path: str | Path,
    *,
    blocks: Mapping[str, int] | None = None,
    sensor: str | None = None,
) -> Recorder:
    """Record what a filter does from now on.

    Each prediction and each update is recorded, with a snapshot of P after it. The recording ends
    with the recorder, which is a context manager, or with the process. Set times with its `at`.

    Args:
        filter: Of filterpy or bayesian-filters; Stone Soup's (predictor, updater), of one track; or
            of one's own, with x, P, predict and update, and as methods F and Q, which are given
            what predict is, and H, R and residual, which are given what update is, each before it.
            With f and h, given numbers of the state and the same, F and H are compared with their
            derivatives.
        path: Of the trace, a new file.
        blocks: Names and dimensions of the state's parts; by default one, `state`.
        sensor: Name of what is measured; by default that of the measurement function, if one is
            given to update, else `measurement`.

    Returns:
        The recorder, for its times, and more events.

    Raises:
        InputError: It is no such filter, or the file exists already or cannot be written.
    """
    if isinstance(filter, tuple) and len(filter) == 2 and hasattr(filter[0], "transition_model"):
        recorder = Recorder(path)
        _StoneSoup(recorder, *filter, blocks, sensor)
    else:
        using = _kind(filter)
        recorder = Recorder(path)
        _Wrapped(recorder, filter, using(filter), blocks, sensor)
    atexit.register(recorder.close)
    return recorder


class _Linear:
    """filterpy's KalmanFilter: matrices are attributes, or arguments of a call."""

    def __init__(self, filter: Any) -> None:  # noqa: A002
        self.filter = filter

    def predicts(self, given: Mapping[str, Any]) -> Callable[[], FilterStep]:
        """Return what tells, after a prediction, which matrices it used. given: its arguments."""
        f = self.filter

        def done() -> FilterStep:
            memory = getattr(f, "alpha", 1.0)
            q = _square(_first(given.get("Q"), f.Q), len(f.P))
            return FilterStep(memory * np.asarray(_first(given.get("F"), f.F)), q)

        return done

    def updates(self, given: Mapping[str, Any]) -> Callable[[], FilterStep]:
        """Return what tells, after an update, which matrices it used. given: its arguments."""
        f, h, r = self.filter, _first(given.get("H"), self.filter.H), given.get("R")

        def done() -> FilterStep:
            return FilterStep(h, _square(_first(r, f.R), np.size(f.y)))

        return done

    def residual(self) -> Any:
        """Return the last update's."""
        return self.filter.y

    def difference(self, after: Array, before: Array) -> Array:
        """Return what was added to the state."""
        return after - before


class _Extended(_Linear):
    """filterpy's ExtendedKalmanFilter: H is a function of the state."""

    def updates(self, given: Mapping[str, Any]) -> Callable[[], FilterStep]:
        """Evaluate the Jacobian where the filter will."""
        more, jacobian = given.get("args", ()), given["HJacobian"]
        h = jacobian(self.filter.x, *(more if isinstance(more, tuple) else (more,)))
        r = _first(given.get("R"), self.filter.R)
        expected, shape = given["Hx"], np.shape(self.filter.x)
        arguments = given.get("hx_args", ())
        arguments = arguments if isinstance(arguments, tuple) else (arguments,)
        name = getattr(expected, "__name__", _MEASUREMENT)

        def function(x: Array) -> Array:
            return np.ravel(expected(x.reshape(shape), *arguments))

        return lambda: FilterStep(h, _square(r, np.size(self.filter.y)), name, function, given["z"])


class _Unscented(_Linear):
    """filterpy's UnscentedKalmanFilter: its points' regression, and what that leaves over."""

    def __init__(self, filter: Any) -> None:  # noqa: A002
        super().__init__(filter)
        self.moved: Array | None = None
        inner = filter.compute_process_sigmas

        @wraps(inner)
        def keeping(*args: Any, **kwargs: Any) -> Any:
            found = inner(*args, **kwargs)
            self.moved = np.array(filter.sigmas_f)
            return found

        filter.compute_process_sigmas = keeping

    def predicts(self, given: Mapping[str, Any]) -> Callable[[], FilterStep]:
        """Draw the points that the filter will draw."""
        f = self.filter
        x, p = np.array(f.x), np.array(f.P)
        points = f.points_fn.sigma_points(x, p)

        def done() -> FilterStep:
            assert self.moved is not None  # noqa: S101 - a prediction moves points
            apart = np.array([f.residual_x(point, x) for point in points])
            after = np.array([f.residual_x(one, f.x) for one in self.moved])
            return FilterStep(*_regression(p, (apart.T * f.Wc) @ after, f.P))

        return done

    def updates(self, given: Mapping[str, Any]) -> Callable[[], FilterStep]:
        """Regress the measurement on the state that it is fused with."""
        f, p = self.filter, np.array(self.filter.P)
        name = getattr(given.get("hx"), "__name__", _MEASUREMENT)
        return lambda: FilterStep(*_regression(p, f.K @ f.S, f.S), name)

    def difference(self, after: Array, before: Array) -> Array:
        """Subtract as the filter does."""
        return np.asarray(self.filter.residual_x(after, before))


class _Own(_Linear):
    """A class of one's own: F, Q, H, R and residual are methods, given what the calls are.

    So are f and h, where it has them, behind the state's numbers.
    """

    def predicts(self, given: Mapping[str, Any]) -> Callable[[], FilterStep]:
        """Ask for the matrices before the prediction."""
        function = self._function("f", given)
        step = FilterStep(self.filter.F(**given), self.filter.Q(**given), function=function)
        return lambda: step

    def updates(self, given: Mapping[str, Any]) -> Callable[[], FilterStep]:
        """Ask for the matrices and the residual before the update."""
        f = self.filter
        function, measured = self._function("h", given), given.get("z")
        step = FilterStep(f.H(**given), f.R(**given), function=function, measured=measured)
        self.last = f.residual(**given)
        return lambda: step

    def _function(self, name: str, given: Mapping[str, Any]) -> Function | None:
        """Return f or h as it is for a call."""
        function = getattr(self.filter, name, None)
        return partial(function, **given) if callable(function) else None

    def residual(self) -> Any:
        """Return the last update's."""
        return self.last


def _kind(filter: Any) -> type[_Linear]:  # noqa: A002
    """Return how a filter is recorded. Raises InputError."""
    has = {name for name in _NAMES if hasattr(filter, name)}
    if has >= {"x", "P", "predict", "update"}:
        if has >= {"points_fn", "compute_process_sigmas", "K", "S", "y"}:
            return _Unscented
        if all(callable(getattr(filter, name, None)) for name in ("F", "Q", "H", "R", "residual")):
            return _Own
        if has >= {"F", "Q", "R", "K", "y"}:
            if "HJacobian" in inspect.signature(filter.update).parameters:
                return _Extended
            if "H" in has:
                return _Linear
    raise InputError(
        f"{type(filter).__name__}: is no filter that can be recorded; expected a Kalman filter, "
        "EKF or UKF of filterpy or bayesian-filters, Stone Soup's (predictor, updater), or a class "
        "with x, P, predict, update, and F, Q, H, R and residual as methods"
    )


_NAMES = (
    *("x", "P", "predict", "update", "F", "Q", "H", "R", "K", "S", "y"),
    *("points_fn", "compute_process_sigmas"),
)


class _Wrapped:
    """A filter whose own calls are replaced by calls that record, too."""

    def __init__(
        self,
        recorder: Recorder,
        filter: Any,  # noqa: A002
        using: _Linear,
        blocks: Mapping[str, int] | None,
        sensor: str | None,
    ) -> None:
        self.recorder, self.filter, self.using, self.sensor = recorder, filter, using, sensor
        n = len(filter.P)
        recorder.prior(blocks or {"state": n}, filter.P, point=filter.x)
        recorder.snapshot(filter.P, mean=filter.x)
        filter.predict = self._around(filter.predict, self._predict)
        filter.update = self._around(filter.update, self._update)

    def _around(self, inner: Callable[..., Any], record_it: Callable[..., Any]) -> Any:
        """Return a call in place of one of the filter's."""
        signature = inspect.signature(inner)

        @wraps(inner)
        def outer(*args: Any, **kwargs: Any) -> Any:
            bound = signature.bind(*args, **kwargs)
            given = dict(bound.arguments)
            for name, parameter in signature.parameters.items():
                if parameter.kind is parameter.VAR_KEYWORD:
                    given |= given.pop(name, {})
            if "z" in given and given["z"] is None:
                return inner(*args, **kwargs)
            return record_it(given, lambda: inner(*args, **kwargs))

        return outer

    def _predict(self, given: Mapping[str, Any], inner: Callable[[], Any]) -> Any:
        before, step = np.array(self.filter.x), self.using.predicts(given)
        found = inner()
        f, q, _, function, _ = step()
        points = {"point": before, "after": self.filter.x}
        self.recorder.predict(f, q, function=function, **points)
        self.recorder.snapshot(self.filter.P, mean=self.filter.x)
        return found

    def _update(self, given: Mapping[str, Any], inner: Callable[[], Any]) -> Any:
        before, step = np.array(self.filter.x), self.using.updates(given)
        found = inner()
        h, r, name, function, measured = step()
        done = self.using.difference(np.asarray(self.filter.x), before)
        notes: MeasurementNotes = {"correction": done, "point": before}
        notes |= _with_function(function, measured)
        self.recorder.update(self.sensor or name, self.using.residual(), h, r, **notes)
        self.recorder.snapshot(self.filter.P, mean=self.filter.x)
        return found


class _StoneSoup:
    """Stone Soup's updater, with the predictor of the predictions that it is given.

    Predictions are recorded when they lead to an update: a tracker makes others for other
    hypotheses.
    """

    def __init__(
        self,
        recorder: Recorder,
        predictor: Any,
        updater: Any,
        blocks: Mapping[str, int] | None,
        sensor: str | None,
    ) -> None:
        self.recorder, self.updater, self.blocks = recorder, updater, blocks
        self.sensor, self.predictor, self.last = sensor, predictor, None
        for one in (predictor, updater):
            if hasattr(one, "kappa") or hasattr(one, "alpha"):
                raise InputError(
                    f"{type(one).__name__}: draws points, and has no Jacobians to record"
                )
        self.inner = updater.update
        updater.update = self.update

    def update(self, hypothesis: Any, **kwargs: Any) -> Any:
        """Update as the updater does, and record how its prediction came about."""
        found = self.inner(hypothesis, **kwargs)
        self._reach(hypothesis.prediction)
        measured, seen = hypothesis.measurement, hypothesis.prediction
        model = _first(measured.measurement_model, self.updater.measurement_model)
        h = model.jacobian(seen) if hasattr(model, "jacobian") else model.matrix()
        notes: MeasurementNotes = {
            "correction": _numbers(found.state_vector - seen.state_vector),
            "point": _numbers(seen.state_vector),
        }
        notes |= _with_function(_at_state(model, seen), _numbers(measured.state_vector))
        self.recorder.update(
            self.sensor or type(model).__name__,
            _numbers(measured.state_vector - hypothesis.measurement_prediction.state_vector),
            _numbers(h),
            _numbers(model.covar()),
            **notes,
        )
        self._snapshot(found)
        return found

    def _reach(self, state: Any) -> None:
        """Record the predictions between the last state that was recorded and another."""
        chain = [state]
        while chain[-1] is not self.last and getattr(chain[-1], "prior", None):
            chain.append(chain[-1].prior)
        if self.last is None:
            first = chain[-1]
            p = _numbers(first.covar)
            point = _numbers(first.state_vector)
            self.recorder.prior(self.blocks or {"state": len(p)}, p, point=point)
            self._snapshot(first)
        elif chain[-1] is not self.last:
            raise InputError("a prediction is not of the track that is recorded; record one alone")
        for before, after in zip(chain[:0:-1], chain[-2::-1], strict=True):
            self._predict(before, after)

    def _predict(self, before: Any, after: Any) -> None:
        model, over = self.predictor.transition_model, None
        if after.timestamp is not None and before.timestamp is not None:
            over = after.timestamp - before.timestamp
            self.recorder.at(after.timestamp.timestamp())
        if hasattr(model, "jacobian"):
            f = model.jacobian(before, time_interval=over)
        else:
            f = model.matrix(time_interval=over)
        points = _numbers(before.state_vector), _numbers(after.state_vector)
        q = _numbers(model.covar(time_interval=over))
        function = _at_state(model, before, time_interval=over)
        self.recorder.predict(_numbers(f), q, function=function, point=points[0], after=points[1])
        self._snapshot(after)

    def _snapshot(self, state: Any) -> None:
        self.recorder.snapshot(_numbers(state.covar), mean=_numbers(state.state_vector))
        self.last = state


def _at_state(model: Any, state: Any, **more: Any) -> Function | None:
    """Return a model's function of numbers, in place of those of a state; without noise."""
    if not callable(getattr(model, "function", None)):
        return None

    def function(numbers: Array) -> Array:
        other = copy(state)
        other.state_vector = type(state.state_vector)(numbers)
        return _numbers(model.function(other, noise=False, **more)).ravel()

    return function


def _with_function(function: Function | None, measured: Any) -> MeasurementNotes:
    """Return what is said of a measurement's function; nothing without one."""
    if function is None:
        return {}
    notes: MeasurementNotes = {"function": function}
    if measured is not None:
        notes["measured"] = measured
    return notes


def _regression(p: Array, cross: Array, covariance: Array) -> tuple[Array, Array]:
    """Return A = P_xy' P^-1 and P_yy - A P A' of P, P_xy and P_yy."""
    slope = np.asarray(np.linalg.solve(p, cross).T, dtype=np.float64)
    left = covariance - slope @ cross
    return slope, 0.5 * (left + left.T)


def _square(matrix: Any, size: int) -> Any:
    """Return a matrix; a number is that of each on the diagonal."""
    return float(matrix) * np.eye(size) if np.isscalar(matrix) else matrix  # type: ignore[arg-type]


def _first(given: Any, otherwise: Any) -> Any:
    return otherwise if given is None else given


def _numbers(values: Any) -> Array:
    """Return plain numbers of whatever types a library has for them."""
    return np.asarray(values, dtype=np.float64)
