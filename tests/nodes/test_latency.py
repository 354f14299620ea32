from __future__ import annotations

import math

from twin_node.nodes.latency import Latency


def measured(*latencies_ms: float) -> Latency:
    latency = Latency(33_000_000, is_measured=True)
    latency.start()
    for one in latencies_ms:
        latency.add(round(one * 1e6))
    return latency


def test_what_was_measured_takes_the_place_of_what_was_assumed_when_there_is_enough() -> None:
    assert measured(*[80.0] * 29).expected_ns == 33_000_000
    assert measured(*[80.0] * 30).expected_ns == 80_000_000
    assert math.isnan(measured().percentile_ms(50))


def test_a_camera_clock_that_is_ahead_makes_no_forecast_of_the_past() -> None:
    """Images stamped later than they come: they cannot, but who reads the forecast does so no sooner than now."""
    latency = measured(*[-40.0] * 60)
    assert latency.expected_ns == 0
    assert latency.percentile_ms(50) == -40.0
