"""Functions written by users: right values, clear refusals, nothing that can do harm."""

from __future__ import annotations

import pickle
import time
from types import SimpleNamespace

import numpy as np
import pytest

from phantomnode.pipeline.expressions import MAX_LENGTH, ExpressionError, parse, time_function

T = np.linspace(0.0, 2.0, 41)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("-t", -T),
        ("3", np.full_like(T, 3.0)),
        ("5*(t - 0.1)", 5.0 * (T - 0.1)),
        ("0.5 + 0.05*sin(5*pi*t/2)", 0.5 + 0.05 * np.sin(5.0 * np.pi * T / 2.0)),
        ("t**2 % 1", T**2 % 1.0),
        ("e**-t", np.exp(-T)),
        ("max(0, t - 1, -t)", np.maximum(0.0, T - 1.0)),
        ("min(t, 1)", np.minimum(T, 1.0)),
        ("step(t - 1)", (T >= 1.0).astype(float)),
        (
            "2*ramp(t, 0.5, 1.5)",
            2.0 * (lambda s: s**3 * (10 - 15 * s + 6 * s**2))(np.clip(T - 0.5, 0.0, 1.0)),
        ),
        ("where(t < 0.5, -t, -0.5)", np.where(T < 0.5, -T, -0.5)),
        ("where(t > 0, sin(t)/t, 1)", np.sinc(T / np.pi)),  # the branch not taken may divide by zero
        ("log(exp(t)) + sqrt(abs(-t)) - tanh(t)", T + np.sqrt(T) - np.tanh(T)),
        ("  t ", T),
        ("(t >= 1)*t - (t < 1)", np.where(T >= 1.0, T, -1.0)),  # a comparison is 1 or 0
    ],
)
def test_an_expression_has_the_value_that_numpy_gives(text: str, expected: np.ndarray) -> None:
    # The same float64 operations, up to their order: a few ulp of numbers near 1.
    np.testing.assert_allclose(parse(text, "t")(T), expected, rtol=1e-14, atol=1e-15)


def test_a_constant_has_the_shape_of_its_argument_and_can_be_written_to() -> None:
    values = parse("2", "t")(np.zeros((3, 2)))
    values[0, 0] = 7.0
    assert values.shape == (3, 2) and values.dtype == np.float64


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "empty"),
        ("   ", "empty"),
        ("t +", "not an expression"),
        ("(" * 300 + "t" + ")" * 300, "characters"),
        ("(" * 240 + "t" + ")" * 240, "not an expression"),
        ("t\x00", "not an expression"),
        ("t; t", "not an expression"),
        ("t = 3", "not an expression"),
        ("import os", "not an expression"),
        ("x + 1", "unknown name 'x'"),
        ("time", "unknown name 'time'; use numbers, t, pi"),
        ("sn(t)", "did you mean 'sin'"),
        ("sin", r"write sin\(\.\.\.\)"),
        ("where(t, sin, t)", r"write sin\(\.\.\.\)"),
        ("sin()", "sin takes 1 argument, not 0"),
        ("max(t)", "max takes 2 or more arguments, not 1"),
        ("sin(t, out=t)", "not 1|plain arguments|sin takes"),
        ("sin(*[t])", "not allowed"),
        ("t^2", r"\*\*"),
        ("t if t else 0", "where"),
        ("t > 0 and t < 1", "step"),
        ("0 < t < 1", "one comparison"),
        ("'a'", "not a number"),
        ("1j", "not a number"),
        ("True", "not a number"),
        ("...", "not a number"),
        # hostile
        ("__import__('os').system('true')", "plain name"),
        ("t.__class__.__mro__", "dot"),
        ("().__class__", "dot"),
        ("t.tofile('x')", "plain name"),
        ("eval('1')", "unknown function 'eval'"),
        ("open('/etc/passwd')", "unknown function 'open'"),
        ("(lambda: 1)()", "plain name"),
        ("[t for t in t]", "not allowed"),
        ("[1, 2][0]", "square brackets"),
        ("{}", "not allowed"),
        ("f'{t}'", "not allowed"),
        ("(t := 3)", "not allowed"),
        ("sin.__globals__", "dot"),
        ("t @ t", "not allowed"),
        ("1 << 100000000", "not allowed"),
        ("'a' * 1000000000", "not a number"),
    ],
)
def test_anything_but_arithmetic_is_refused(text: str, reason: str) -> None:
    with pytest.raises(ExpressionError, match=reason):
        parse(text, "t")(T)


@pytest.mark.parametrize(
    "text", ["9**9**9**9", "-9**9**9**9", "10**(10**10)", "exp(exp(exp(10)))", "1e400*t"]
)
def test_huge_numbers_are_refused_at_once(text: str) -> None:
    began = time.perf_counter()
    with pytest.raises(ExpressionError, match="must be finite"):
        parse(text, "t")(T)
    assert time.perf_counter() - began < 1.0  # Python integers would take for ever


@pytest.mark.parametrize(
    ("text", "where"), [("1/t", "inf at t = 0"), ("log(t - 1)", "nan at t = 0"), ("1/(t-1)", "t = 1;")]
)
def test_a_value_that_is_not_finite_is_named_with_its_time(text: str, where: str) -> None:
    with pytest.raises(ExpressionError, match=where):
        parse(text, "t")(T)


def test_an_expression_of_the_longest_length_is_accepted() -> None:
    text = "t" + "+t" * ((MAX_LENGTH - 1) // 2)
    np.testing.assert_allclose(parse(text, "t")(T), T * (text.count("t")), rtol=1e-13)  # 250 roundings


def test_numbers_expressions_and_points_are_functions_of_time() -> None:
    points = SimpleNamespace(t=(0.5, 1.0), value=(1.0, 3.0))
    np.testing.assert_array_equal(time_function(2)(T), np.full_like(T, 2.0))
    np.testing.assert_array_equal(time_function("-t")(T), -T)
    np.testing.assert_array_equal(
        time_function(points)(np.array([0.0, 0.5, 0.75, 1.0, 9.0])), [1, 1, 2, 3, 3]
    )


def test_an_expression_can_be_sent_to_another_process() -> None:
    expression = parse("sin(t)", "t")
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(expression))(T), np.sin(T))


def test_a_ramp_is_smooth_and_needs_a_length() -> None:
    t = np.linspace(-1.0, 3.0, 4001)
    value = parse("ramp(t, 0.5, 2)", "t")(t)
    assert value[0] == 0.0 and value[-1] == 1.0 and value[t <= 0.5].max() == 0.0
    velocity, acceleration = np.gradient(value, t), np.gradient(np.gradient(value, t), t)
    assert np.all(velocity >= 0.0) and velocity.max() == pytest.approx(1.875 / 1.5, rel=1e-5)
    # No jump: an acceleration changes by at most the step, 1e-3, times 60/1.5^3 (differences over three steps).
    assert np.abs(np.diff(acceleration)).max() < 4e-3 * 60.0 / 1.5**3
    with pytest.raises(ExpressionError, match="t1 must be larger than t0"):
        parse("ramp(t, 1, 1)", "t")(t)
