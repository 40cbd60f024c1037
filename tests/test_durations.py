"""Intervals and wall limits as users write them."""

from __future__ import annotations

import pytest

from phantomnode.pipeline.durations import Schedule, parse_every, parse_limit


@pytest.mark.parametrize(
    ("text", "kind", "length"),
    [
        ("0.5ms", "simulated", 5e-4), ("2 us", "simulated", 2e-6), ("1e-3 s", "simulated", 1e-3),
        ("1000 steps", "steps", 1000.0), ("1 step", "steps", 1.0), ("10 min", "wall", 600.0),
        ("30 s wall", "wall", 30.0), ("1.5 H", "wall", 5400.0), ("1 d", "wall", 86400.0),
    ],
)  # fmt: skip
def test_intervals(text: str, kind: str, length: float) -> None:
    every = parse_every(text)
    assert every.kind == kind and every.length == pytest.approx(length, rel=1e-15)  # a product: rounding


@pytest.mark.parametrize(
    "text",
    ["", "10", "0 steps", "1.5 steps", "-1 ms", "0 s", "ten min", "5 ms wall", "1 step wall", "1e999 s"],
)
def test_what_is_no_interval_is_refused_with_examples(text: str) -> None:
    with pytest.raises(ValueError, match='is no interval; write "0.5 ms"'):
        parse_every(text)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("90 min", 5400.0), ("30 s", 30.0), ("0:10:00", 600.0), ("23:50:00", 85800.0), ("2-01:00:00", 176400.0)],
)
def test_limits(text: str, seconds: float) -> None:
    assert parse_limit(text) == seconds


@pytest.mark.parametrize("text", ["", "90", "0 s", "00:00:00", "5 ms", "1:2:3", "1000 steps"])
def test_what_is_no_limit_is_refused_with_examples(text: str) -> None:
    with pytest.raises(ValueError, match='is no wall time; write "90 min"'):
        parse_limit(text)


@pytest.mark.parametrize(
    ("every", "due"),
    [
        ("3 steps", [3, 6, 9]),
        ("2 ms", [2, 4, 6, 8, 10]),
        ("2.5 s wall", [3, 6, 9]),
        ("0.1 ms", list(range(1, 11))),
    ],
)
def test_due_at_the_first_frame_of_each_interval(every: str, due: list[int]) -> None:
    """Frames at steps 1, 2, ..., a millisecond and a second of wall time apart."""
    schedule, found = Schedule(parse_every(every), 0, 0.0, 100.0), []
    for step in range(1, 11):
        if schedule.due(step, step * 1e-3, 100.0 + step):
            schedule.written(step, step * 1e-3, 100.0 + step)
            found.append(step)
    assert found == due
