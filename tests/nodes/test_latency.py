from __future__ import annotations

import math

import pytest

from twin_node.nodes.latency import LONGEST_BRIDGED_NS, SAMPLES, Latency

ASSUMED_NS = 33_000_000


def add(latency: Latency, *latencies_ms: float) -> None:
    for one in latencies_ms:
        latency.add(round(one * 1e6))


def measured(*latencies_ms: float) -> Latency:
    latency = Latency(ASSUMED_NS, is_measured=True)
    latency.start()
    add(latency, *latencies_ms)
    return latency


def test_what_was_measured_takes_the_place_of_what_was_assumed_when_there_is_enough() -> None:
    assert measured(*[80.0] * 29).expected_ns == ASSUMED_NS
    assert measured(*[80.0] * 30).expected_ns == 80_000_000
    assert math.isnan(measured().percentile_ms(50))


def test_a_forecast_bridges_what_one_in_twenty_take_longer() -> None:
    latency = measured(*[40.0] * 95, *[90.0] * 5)
    assert latency.expected_ns == pytest.approx(90e6)
    assert latency.percentile_ms(50) == 40.0


def test_what_came_before_the_start_does_not_count() -> None:
    latency = Latency(ASSUMED_NS, is_measured=True)
    add(latency, *[900.0] * 60)
    assert latency.expected_ns == ASSUMED_NS


def test_forecasts_that_come_too_late_for_any_arm_are_told_of() -> None:
    """Each was sound, and the status said so; the arm stood for good."""
    assert measured(*[390.0] * 60).warnings == ()
    assert measured(*[900.0] * 29).warnings == ()
    assert measured(*[40.0] * 31, *[5000.0] * 29).warnings == ()
    assert measured(*[900.0] * 60).warnings == (
        "latency: forecasts come 900 ms after their images' stamps, and an arm stands for what is older than 400 ms; "
        "set the cameras' clocks if they are behind, else choose a smaller size or image width, or a faster machine",
    )


def test_lockstep_measures_nothing() -> None:
    """Its results would depend on the computer."""
    latency = Latency(ASSUMED_NS, is_measured=False)
    latency.start()
    add(latency, *[900.0] * 60)
    assert latency.expected_ns == ASSUMED_NS


def test_what_was_long_ago_is_forgotten() -> None:
    assert measured(*[900.0] * 50, *[40.0] * SAMPLES).expected_ns == 40_000_000


def test_a_camera_clock_that_is_ahead_makes_no_forecast_of_the_past() -> None:
    """Images stamped later than they come: they cannot, but who reads the forecast does so no sooner than now."""
    latency = measured(*[-40.0] * 60)
    assert latency.expected_ns == 0
    assert latency.percentile_ms(50) == -40.0


def test_one_set_that_was_held_up_moves_nothing_minutes_away() -> None:
    """Among the first ones the p99 is nearly that of the latest."""
    latency = measured(*[40.0] * 29, 3_600_000.0)
    assert latency.expected_ns == LONGEST_BRIDGED_NS
    assert latency.percentile_ms(100) == 3_600_000.0
