"""A stranger's filter with one expression of its code changed, as a slip of a hand would.

The filter is `Car` of `strangers`, which shares no code with the reference. One expression of one
of its methods is changed: an operand is left out, a sign or an operator is another, a transpose is
lost, a name or a number is another, sine and cosine are exchanged. Nothing is known of slots.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from copy import deepcopy
from types import CodeType, FunctionType
from typing import Any, NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.estimates.external import ExternalEstimate
from comparisons.logs.log import Log
from research.trust import strangers
from research.trust.drives import steering
from research.trust.strangers import Car, StrangerLog, TextbookEkf

METHODS = (
    "prior", "of_control", "velocity", "motion", "driven", "process", "carry", "expected",
    "residual", "seen", "first_seen", "noise", "first_noise", "linearised", "correct", "place",
    "initialise",
)  # fmt: skip
_OPERATORS: dict[type[ast.operator], tuple[type[ast.operator], ...]] = {
    ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,),
    ast.MatMult: (ast.Mult,),
}  # fmt: skip
_FUNCTIONS = {"cos": "sin", "sin": "cos", "arctan2": "hypot", "tan": "sin"}
_SCALED = (
    "self.log.z", "self.log.u", "self.noise", "self.seen", "np.cos", "np.sin", "np.diag",
    "covariance", "noise", "moved", "gain", "speed", "bend", "dt", "dx", "dy", "d ", "r ", "nu",
)  # fmt: skip
"""Beginnings of expressions that may have another sign or factor."""
_FACTORS = (0.5, 2.0, 0.9, 3.0)


class ChangedLine(NamedTuple):
    """A method with another expression. before, after: the expression."""

    method: str
    before: str
    after: str
    kind: type[TextbookEkf]

    @property
    def words(self) -> str:
        """What the filter does."""
        return f"{self.method}: `{self.after}` instead of `{self.before}`"


def changed_line(rng: np.random.Generator) -> ChangedLine:
    """Draw a method, then one of its expressions, then a change of it."""
    places: list[tuple[ast.AST, str, int | None]] = []
    while not places:
        name = str(rng.choice(METHODS))
        tree = ast.parse(textwrap.dedent(inspect.getsource(getattr(Car, name))))
        places = [
            (holder, field, k)
            for line in _lines(tree)
            for holder, field, k in _places(line)
            if _changes(_at(holder, field, k), rng)
        ]
    holder, field, k = places[rng.integers(len(places))]
    node = _at(holder, field, k)
    changes = _changes(node, rng)
    before, other = ast.unparse(node), changes[rng.integers(len(changes))]
    _put(holder, field, k, other)
    return ChangedLine(name, before, ast.unparse(other), _with_method(name, tree))


def _lines(tree: ast.Module) -> list[ast.stmt]:
    """Statements of the method's body, without its docstring and what is noted for a trace."""
    method = tree.body[0]
    if not isinstance(method, ast.FunctionDef):
        raise TypeError("expected a method")
    return [one for one in method.body if not _is_note(one)]


def _is_note(line: ast.stmt) -> bool:
    text = ast.unparse(line)
    noted = "self.note" in text or text.startswith(("beside =", "blocks =", "labels =", "label:"))
    return noted or (isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant))


def _places(node: ast.AST) -> list[tuple[ast.AST, str, int | None]]:
    """Expressions below a node, each by what holds it; no targets, names of functions or types."""
    places: list[tuple[ast.AST, str, int | None]] = []
    skipped = {"func", "annotation", "targets", "target", "slice", "ops", "op", "ctx"}
    for field, child in ast.iter_fields(node):
        if field in skipped:
            if field == "func" and isinstance(child, ast.Attribute):
                places += _places(child)
            continue
        for k, one in enumerate(child) if isinstance(child, list) else ((None, child),):
            if isinstance(one, ast.AST):
                places += [(node, field, k)] if isinstance(one, ast.expr) else []
                places += _places(one)
    return places


def _at(holder: ast.AST, field: str, k: int | None) -> ast.expr:
    value = getattr(holder, field)
    expression: ast.expr = value if k is None else value[k]
    return expression


def _put(holder: ast.AST, field: str, k: int | None, other: ast.expr) -> None:
    if k is None:
        setattr(holder, field, other)
    else:
        getattr(holder, field)[k] = other


def _changes(node: ast.expr, rng: np.random.Generator) -> list[ast.expr]:
    """What may stand in a node's place."""
    changes: list[ast.expr] = []
    match node:
        case ast.BinOp(left, operator, right):
            others = _OPERATORS.get(type(operator), ())
            changes += [left, right, *(ast.BinOp(left, other(), right) for other in others)]
        case ast.UnaryOp(ast.USub(), operand):
            changes.append(operand)
        case ast.Attribute(value, "T"):
            changes.append(value)
        case ast.Call(ast.Attribute(ast.Name("np"), name) as function, arguments):
            if name in _FUNCTIONS:
                other_name = ast.Attribute(function.value, _FUNCTIONS[name], ast.Load())
                changes.append(ast.Call(other_name, arguments, []))
        case ast.Call(ast.Name("wrapped"), [inner]):
            changes.append(inner)
        case ast.Constant(float(number)):
            changes.append(ast.Constant(0.0 if number else 1.0))
        case ast.Subscript(ast.Attribute(), ast.Name("number")):
            earlier = ast.BinOp(ast.Name("number", ast.Load()), ast.Sub(), ast.Constant(1))
            changes.append(ast.Subscript(node.value, earlier, ast.Load()))
    if ast.unparse(node).startswith(_SCALED):
        changes += [_scaled(node, rng), ast.UnaryOp(ast.USub(), node)]
    return deepcopy(changes)


def _scaled(node: ast.expr, rng: np.random.Generator) -> ast.expr:
    return ast.BinOp(ast.Constant(float(rng.choice(_FACTORS))), ast.Mult(), node)


def _with_method(name: str, tree: ast.Module) -> type[TextbookEkf]:
    """A filter with another method, in the module that the filter is of."""
    code = compile(ast.fix_missing_locations(tree), f"<changed {name}>", "exec", dont_inherit=True)
    body = next(one for one in code.co_consts if isinstance(one, CodeType))
    defaults = getattr(Car, name).__defaults__
    method = FunctionType(body, vars(strangers), name, defaults)
    return type("ChangedCar", (Car,), {name: method})


def stranger_log(log: Log) -> StrangerLog:
    """Return a log of a steering vehicle as a stranger reads it."""
    odometry, seen, prior = steering(log), log.measurements, log.prior
    vehicle, noise = odometry.vehicle, odometry.noise
    meta: dict[str, Any] = {
        "prior": {"time_s": prior.time_s, "pose": prior.pose, "covariance": prior.covariance},
        "odometry": {"noise": vars(noise), "vehicle": vars(vehicle)},
    }
    return StrangerLog(
        meta=meta,
        odometry_s=odometry.time_s,
        u=np.column_stack((odometry.speed_mps, odometry.steering_rad)),
        used_s=seen.time_s,
        z=np.column_stack((seen.range_m, seen.bearing_rad)),
        sigma=np.column_stack((seen.sigma_range_m, seen.sigma_bearing_rad)),
        label=seen.landmark.astype(int),
        row=np.arange(len(seen.time_s)),
        fixed_s=np.zeros(0),
        fix=np.zeros((0, 2)),
        fix_noise=np.zeros((0, 2, 2)),
    )


def estimate_of(log: Log, kind: type[TextbookEkf]) -> ExternalEstimate | None:
    """Return the estimate of a stranger's filter; None where it breaks down."""
    try:
        with np.errstate(all="ignore"):
            ekf = kind(stranger_log(log)).run()
    except (ArithmeticError, IndexError, TypeError, ValueError, np.linalg.LinAlgError):
        return None
    pose, spread = (np.array([one[k] for one in ekf.path]) for k in (1, 2))
    joint: Array = ekf.p
    if not all(np.isfinite(one).all() for one in (pose, spread, joint)):
        return None
    points = np.array([ekf.x[at] for at in ekf.index.values()])
    return ExternalEstimate(
        time_s=np.array([one[0] for one in ekf.path]),
        pose=pose,
        landmark_id=np.array(list(ekf.index), dtype=np.int64),
        landmark=points,
        pose_covariance=spread,
        joint_covariance=joint,
        information="filtered",
        estimator="ekf",
    )
