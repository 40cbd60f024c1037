"""Functions that users write in a case file: numbers, expressions of one variable, tables of points.

An expression is evaluated by simpleeval, on NumPy arrays, and only after its syntax tree has been held
against a list of what is allowed: arithmetic, comparisons, the variable, pi, e and the functions below.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import reduce
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from simpleeval import InvalidExpression, SimpleEval

from phantomnode.pipeline.errors import CaseError

Floats = NDArray[np.float64]
TimeFunction = Callable[[Floats], Floats]
"""Values, (n,), of a function at times, (n,) s."""

MAX_LENGTH = 500
"""Characters in an expression: far more than anyone writes by hand, and too few to nest deeply."""


class ExpressionError(CaseError):
    """An expression cannot be used; the message says what is wrong with it and what to write instead."""


class PointTableLike(Protocol):
    """Points of a piecewise linear function: times ``t``, s, and values ``value``, of equal length."""

    @property
    def t(self) -> Sequence[float]:
        """Times, s, increasing."""

    @property
    def value(self) -> Sequence[float]:
        """Values at these times."""


def _step(x: Any) -> Any:
    """1 where x >= 0, else 0."""
    return np.where(np.asarray(x) >= 0.0, 1.0, 0.0)


def _ramp(t: Any, start: Any, end: Any) -> Any:
    """The smooth step of fifth order: 0 up to the start, 1 from the end on, no velocity or acceleration at either."""
    if not np.all(np.asarray(end) > np.asarray(start)):
        raise ValueError("ramp(t, t0, t1) rises from t0 to t1, so that t1 must be larger than t0")
    s = np.clip((np.asarray(t) - start) / (np.asarray(end) - start), 0.0, 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


FUNCTIONS: dict[str, tuple[Callable[..., Any], int, int | None]] = {
    "sin": (np.sin, 1, 1),
    "cos": (np.cos, 1, 1),
    "tan": (np.tan, 1, 1),
    "asin": (np.arcsin, 1, 1),
    "acos": (np.arccos, 1, 1),
    "atan": (np.arctan, 1, 1),
    "sinh": (np.sinh, 1, 1),
    "cosh": (np.cosh, 1, 1),
    "tanh": (np.tanh, 1, 1),
    "exp": (np.exp, 1, 1),
    "log": (np.log, 1, 1),
    "sqrt": (np.sqrt, 1, 1),
    "abs": (np.abs, 1, 1),
    "min": (lambda *values: reduce(np.minimum, values), 2, None),
    "max": (lambda *values: reduce(np.maximum, values), 2, None),
    "step": (_step, 1, 1),
    "ramp": (_ramp, 3, 3),
    "where": (np.where, 3, 3),
}
"""What an expression may call: the function, the least and the largest number of arguments."""

CONSTANTS = {"pi": np.pi, "e": np.e}

OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Mod: np.mod,
    ast.Pow: np.power,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
    # Comparisons give 1 or 0: NumPy refuses to subtract truth values.
    ast.Lt: lambda a, b: np.less(a, b) * 1.0,
    ast.LtE: lambda a, b: np.less_equal(a, b) * 1.0,
    ast.Gt: lambda a, b: np.greater(a, b) * 1.0,
    ast.GtE: lambda a, b: np.greater_equal(a, b) * 1.0,
}

_REFUSED: dict[type[ast.AST], str] = {
    ast.Attribute: "a dot after a name is not allowed",
    ast.Subscript: "square brackets are not allowed",
    ast.BitXor: "a power is written **, as in t**2, not ^",
    ast.BoolOp: "'and' and 'or' are not allowed; multiply step(...) functions or nest where(condition, a, b)",
    ast.IfExp: "'if ... else' is not allowed; write where(condition, a, b)",
    ast.keyword: "a function takes plain arguments, without '='",
    ast.Lambda: "'lambda' is not allowed",
}


class _Evaluator(SimpleEval):  # type: ignore[misc]
    """simpleeval with float64 numbers only, so that no operation can grow without bound."""

    nodes: dict[type[ast.AST], Callable[..., Any]]

    def __init__(self, variable: str, values: Floats) -> None:
        functions = {name: function for name, (function, _, _) in FUNCTIONS.items()}
        super().__init__(OPERATORS, functions, {**CONSTANTS, variable: values}, allowed_attrs={})
        kept = (ast.Expr, ast.Name, ast.UnaryOp, ast.BinOp, ast.Compare, ast.Call)
        handlers: dict[type[ast.AST], Callable[..., Any]] = {node: self.nodes[node] for node in kept}
        self.nodes = {**handlers, ast.Constant: lambda node: np.float64(node.value)}


@dataclass(frozen=True)
class Expression:
    """A function of one variable, written as text.

    Attributes
    ----------
    text : str
    variable : str
        "t" or "x".
    """

    text: str
    variable: str
    _tree: ast.Expr = field(repr=False, compare=False)

    def __call__(self, values: Floats) -> Floats:
        """(n,) The function at (n,) values.

        Raises
        ------
        ExpressionError
            Where it is not finite; the message names the first such value.
        """
        values = np.asarray(values, dtype=np.float64)
        try:
            with np.errstate(all="ignore"):
                raw = _Evaluator(self.variable, values).eval(self.text, previously_parsed=self._tree)
            result = np.array(np.broadcast_to(raw, values.shape), dtype=np.float64)
        except (InvalidExpression, TypeError, ValueError) as error:
            raise ExpressionError(f"{self.text!r} cannot be evaluated: {error}") from error
        bad = ~np.isfinite(result)
        if bad.any():
            where, what = values[bad].flat[0], result[bad].flat[0]
            raise ExpressionError(
                f"{self.text!r} is {what} at {self.variable} = {where:.6g}; it must be finite everywhere"
            )
        return result


def parse(text: str, variable: str) -> Expression:
    """An expression of one variable, checked but not yet evaluated.

    Parameters
    ----------
    text : str
        For example ``"0.5 + 0.05*sin(5*pi*x/2)"`` or ``"where(t < 0.1, -t, -0.1)"``.
    variable : str
        The one free name, "t" or "x".

    Raises
    ------
    ExpressionError
        If it is anything else than arithmetic of numbers, the variable, pi, e and the known functions.
    """
    if not text.strip():
        raise ExpressionError(f"the expression is empty; write a number or a function of {variable}")
    if len(text) > MAX_LENGTH:
        raise ExpressionError(f"the expression has {len(text)} characters; at most {MAX_LENGTH} are allowed")
    try:
        tree = ast.parse(text.strip(), mode="eval")
        called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
        for node in ast.walk(tree):
            _refuse(node, text, variable)
            if isinstance(node, ast.Name) and node.id in FUNCTIONS and id(node) not in called:
                raise ExpressionError(f"{text!r}: {node.id} is a function; write {node.id}(...)")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        if isinstance(error, ExpressionError):
            raise
        reason = error.msg if isinstance(error, SyntaxError) else type(error).__name__
        raise ExpressionError(f"{text!r} is not an expression of {variable} ({reason})") from error
    return Expression(text, variable, ast.Expr(tree.body))


def time_function(value: float | str | PointTableLike) -> TimeFunction:
    """The function of time that a number, an expression of t or a table of points stands for.

    Parameters
    ----------
    value : float, str or table of points
        A table is linear between its points and constant before the first and after the last.

    Returns
    -------
    callable
        Maps times, (n,) s, to values, (n,).
    """
    if isinstance(value, str):
        return parse(value, "t")
    if isinstance(value, int | float):
        constant = float(value)
        return lambda t: np.full(np.shape(t), constant)
    times, values = np.asarray(value.t, dtype=np.float64), np.asarray(value.value, dtype=np.float64)
    return lambda t: np.asarray(np.interp(t, times, values))


def _refuse(node: ast.AST, text: str, variable: str) -> None:
    """Raise unless a node of the syntax tree is on the list of what is allowed."""
    if type(node) in _REFUSED:
        raise ExpressionError(f"{text!r}: {_REFUSED[type(node)]}")
    if isinstance(node, ast.Constant) and type(node.value) not in (int, float):
        raise ExpressionError(f"{text!r}: {node.value!r} is not a number")
    if isinstance(node, ast.Compare) and len(node.ops) > 1:
        raise ExpressionError(f"{text!r}: write one comparison at a time, as in where(t < 1, ..., ...)")
    if isinstance(node, ast.Call):
        _refuse_call(node, text)
    elif isinstance(node, ast.Name):
        known = [variable, *CONSTANTS, *FUNCTIONS]
        if node.id not in known:
            raise ExpressionError(
                f"{text!r}: unknown name {node.id!r}{_hint(node.id, known)}; {_help(variable)}"
            )
    elif not isinstance(node, (ast.Expression, ast.Load, ast.Constant, *_NODES)):
        raise ExpressionError(f"{text!r}: {type(node).__name__} is not allowed; {_help(variable)}")


def _refuse_call(node: ast.Call, text: str) -> None:
    """Raise unless a known function is called with a fitting number of arguments."""
    if not isinstance(node.func, ast.Name):
        raise ExpressionError(f"{text!r}: only a function by its plain name can be called")
    name, count = node.func.id, len(node.args)
    if name not in FUNCTIONS:
        known = ", ".join(FUNCTIONS)
        raise ExpressionError(
            f"{text!r}: unknown function {name!r}{_hint(name, FUNCTIONS)}; there are {known}"
        )
    _, least, most = FUNCTIONS[name]
    if node.keywords or count < least or (most is not None and count > most):
        wanted = f"{least}" if least == most else f"{least} or more"
        raise ExpressionError(f"{text!r}: {name} takes {wanted} argument{'s' * (wanted != '1')}, not {count}")


def _hint(name: str, known: Any) -> str:
    """A suggestion for a misspelt name, or nothing."""
    close = get_close_matches(name, list(known), 1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def _help(variable: str) -> str:
    """What an expression may hold."""
    return f"use numbers, {variable}, pi, e, + - * / % ** and {', '.join(FUNCTIONS)}"


_NODES = (ast.UnaryOp, ast.BinOp, ast.Compare, *OPERATORS)
