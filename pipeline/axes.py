"""The axes of a sweep: which keys of the case they set, and to which values."""

from __future__ import annotations

import math
import zlib
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from phantomnode.pipeline.values import Number, Positive, Switch, Table

Floats = NDArray[np.float64]

DIGITS = 12
"""Significant digits of computed values, so that 0.3 is not 0.30000000000000004."""
LARGEST = 100_000
"""Values of one axis; more is a slip of the pen."""

Seed = Annotated[int, Field(strict=True, ge=0)]


class Linspace(Table):
    """Values at equal distances."""

    first: Number = Field(description="the first value")
    last: Number = Field(description="the last value")
    count: Annotated[int, Field(strict=True, ge=2, le=LARGEST)] = Field(description="number of values")


class Logspace(Table):
    """Values at equal ratios."""

    first: Number = Field(description="the first value, not 0")
    last: Number = Field(description="the last value, of the same sign")
    count: Annotated[int, Field(strict=True, ge=2, le=LARGEST)] = Field(description="number of values")

    @model_validator(mode="after")
    def _same_sign(self) -> Logspace:
        if self.first * self.last <= 0.0:
            raise ValueError(
                f"first = {self.first:g} and last = {self.last:g} must have the same sign, not 0"
            )
        return self


class Range(Table):
    """Values from the first in steps, the last one included where a step meets it."""

    first: Number = Field(description="the first value")
    last: Number = Field(description="no value goes past it")
    step: Number = Field(description="from one value to the next")

    @model_validator(mode="after")
    def _reachable(self) -> Range:
        if self.step == 0.0 or (self.last - self.first) / self.step < 0.0:
            raise ValueError(f"steps of {self.step:g} do not lead from {self.first:g} to {self.last:g}")
        if (self.last - self.first) / self.step > LARGEST:
            raise ValueError(f"more than {LARGEST} values; take a larger step")
        return self


class Span(Table):
    """Random values between two limits."""

    low: Number = Field(description="no value is below it")
    high: Number = Field(description="no value is above it")

    @model_validator(mode="after")
    def _in_order(self) -> Span:
        if self.low >= self.high:
            raise ValueError(f"low = {self.low:g} must be below high = {self.high:g}")
        return self


class PositiveSpan(Span):
    """Random values between two positive limits."""

    low: Positive = Field(description="no value is below it; greater than 0")


class Normal(Table):
    """Random values about a mean."""

    mean: Number = Field(description="the mean")
    deviation: Positive = Field(description="the standard deviation")


class Samples(Table):
    """How many random values each random axis has; the n-th values go together."""

    count: Annotated[int, Field(strict=True, ge=1, le=LARGEST)] = Field(description="number of samples")
    seed: Seed = Field(default=0, description="the same seed gives the same values")


KINDS = ("values", "linspace", "logspace", "range", "uniform", "loguniform", "normal")
RANDOM = ("uniform", "loguniform", "normal")


class Axis(Table):
    """Keys of the case and the values that they take."""

    key: str | None = Field(default=None, description='what it sets, as "time.end" or "body.a.grid.cell"')
    keys: tuple[str, ...] | None = Field(
        default=None, min_length=1, description="several keys that all take the value"
    )
    values: tuple[Any, ...] | None = Field(
        default=None, min_length=1, description="the values, as in the case"
    )
    names: tuple[str, ...] | None = Field(
        default=None, description="what each of the values is called in folders, tables and pictures"
    )
    linspace: Linspace | None = Field(default=None, description="{ first, last, count }")
    logspace: Logspace | None = Field(default=None, description="{ first, last, count }: equal ratios")
    range: Range | None = Field(default=None, description="{ first, last, step }, the last included")
    uniform: Span | None = Field(default=None, description="random: { low, high }")
    loguniform: PositiveSpan | None = Field(
        default=None, description="random, its logarithm uniform: { low, high }"
    )
    normal: Normal | None = Field(default=None, description="random: { mean, deviation }")
    integer: Switch = Field(default=False, description="round to whole numbers")

    @model_validator(mode="after")
    def _complete(self) -> Axis:
        self.exactly_one("key", "keys")
        kind = self.exactly_one(*KINDS)
        if len({*self.paths}) < len(self.paths):
            raise ValueError("keys: one of them stands twice")
        if kind == "values" and self.integer:
            raise ValueError("integer is for computed values; write whole numbers")
        if self.names is not None and len(self.names) != len(self.values or ()):
            raise ValueError(f"names needs a name for each of values = [...], not {len(self.names)}")
        return self

    @property
    def paths(self) -> tuple[str, ...]:
        """The keys that it sets."""
        return self.keys if self.keys is not None else (self.key or "",)

    @property
    def random(self) -> bool:
        """Whether its values are drawn."""
        return any(getattr(self, kind) is not None for kind in RANDOM)


def axis_values(name: str, axis: Axis, samples: Samples | None) -> list[Any]:
    """The values of an axis.

    Parameters
    ----------
    name : str
        Of the axis: random values depend on it and on the seed, but not on the other axes.
    axis : Axis
    samples : Samples or None
        How many random values, and their seed; needed where the axis is random.
    """
    if axis.values is not None:
        return list(axis.values)
    if axis.random:
        assert samples is not None
        return _tidy(_drawn(name, axis, samples), axis.integer)
    return _tidy(_spaced(axis), axis.integer)


def _spaced(axis: Axis) -> Floats:
    """Values of a linspace, logspace or range."""
    if axis.range is not None:
        first, last, step = axis.range.first, axis.range.last, axis.range.step
        # 1e-9 of a step: what rounding may take from the last one.
        return first + step * np.arange(math.floor((last - first) / step + 1e-9) + 1, dtype=np.float64)
    if axis.linspace is not None:
        between = np.linspace(axis.linspace.first, axis.linspace.last, axis.linspace.count)
        return between.astype(np.float64)
    assert axis.logspace is not None
    ratios = np.geomspace(axis.logspace.first, axis.logspace.last, axis.logspace.count)
    return ratios.astype(np.float64)


def _drawn(name: str, axis: Axis, samples: Samples) -> Floats:
    """Random values."""
    generator = np.random.default_rng([samples.seed, zlib.crc32(name.encode())])
    if axis.uniform is not None:
        return generator.uniform(axis.uniform.low, axis.uniform.high, samples.count)
    if axis.loguniform is not None:
        low, high = axis.loguniform.low, axis.loguniform.high
        return np.exp(generator.uniform(math.log(low), math.log(high), samples.count)).clip(low, high)
    assert axis.normal is not None
    return generator.normal(axis.normal.mean, axis.normal.deviation, samples.count)


def _tidy(values: Floats, whole: bool) -> list[Any]:
    """Numbers as one would write them."""
    if whole:
        return [round(value) for value in values.tolist()]
    return [float(f"{value:.{DIGITS}g}") for value in values.tolist()]
