"""A run's length: the chain goes on to and fro, and what it costs and holds is told span by span."""

from __future__ import annotations

import gc
import json
from dataclasses import replace
from pathlib import Path

import pytest

from twin_node.bench.errors import BenchError
from twin_node.bench.pareto.length import Length, LengthParameters, Span, draw, markdown, run, text

SHORT = LengthParameters(seconds=3.2, rate_hz=5.0, span_s=1.0)
"""Sixteen sets in spans of five: the last one is short."""


def drifting(count: int) -> Length:
    """A minute per span; every set takes a tenth of a millisecond longer, and a tenth of a MB more is held."""
    spans = [Span(60.0 * (n + 1), 20 + 0.1 * n, 25, 400 + 0.1 * n, 500, 100, 300) for n in range(count)]
    return Length(tuple(spans), LengthParameters())


@pytest.fixture(scope="module")
def short() -> Length:
    found = run(SHORT, seed_steps=5)
    assert gc.get_freeze_count() == 0, "a chain that has not been stopped is never freed: 100 MB a run"
    return found


def test_every_set_is_worked_on_and_forecast(short: Length) -> None:
    assert [round(span.until_s, 3) for span in short.spans] == [1.0, 2.0, 3.0, 3.2]
    assert sum(span.forecasts for span in short.spans) == 16
    assert all(span.ms_p50 > 0 and span.resident_mb > 0 and span.gaussians > 100 for span in short.spans)


def test_what_grows_is_told() -> None:
    found = drifting(61)
    assert found.growth_mb == pytest.approx(5.9)
    assert found.growth_mb_per_hour == pytest.approx(6.0)
    assert found.last_over_first == pytest.approx((20 + 0.1 * 57.5) / (20 + 0.1 * 3.5), rel=1e-3)
    assert json.loads(json.dumps(found.as_json()))["growth_mb_per_hour"] == pytest.approx(6.0)


@pytest.mark.parametrize("count", [1, 2])
def test_a_short_run_does_not_say_that_nothing_grows(count: int) -> None:
    found = drifting(count)
    assert found.last_over_first is found.growth_mb is found.growth_mb_per_hour is None
    assert "too short to tell" in text(found)
    assert drifting(3).growth_mb == pytest.approx(0.1)


def test_a_long_run_is_told_in_a_dozen_lines(tmp_path: Path) -> None:
    found = drifting(61)
    assert text(found).count("\n") <= 13
    assert markdown(found).startswith("| until s |")
    assert "memory +5.9 MB, at the end +6.0 MB per hour" in text(found)
    assert draw(found, tmp_path).stat().st_size < 200_000


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"size": "huge"}, "--size: expected one of tiny"),
        ({"rate_hz": 7.0}, "--rate: expected 30 divided by a whole number, found 7"),
        ({"rate_hz": 90.0}, "--rate: expected 30"),
        ({"rate_hz": 0.3, "seconds": 60.0}, "--rate: expected more than 0.33, so that the clip of 3 s has two sets"),
        ({"seconds": 0.1}, "--seconds: expected time for two sets"),
    ],
)
def test_what_does_not_fit_is_named(changed: dict[str, object], said: str) -> None:
    with pytest.raises(BenchError, match=said):
        run(replace(SHORT, **changed))
