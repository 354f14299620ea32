from __future__ import annotations

import math

import pytest

from twin_node.arm.limiter import LimiterParameters
from twin_node.nodes.latency import (
    FEWEST,
    HELD_UP_NS,
    LONGEST_BRIDGED_NS,
    MEMORY_NS,
    OFTEN,
    SETTLED_NS,
    SLOWS_NS,
    Latency,
)

ASSUMED_NS = 33_000_000
PERIOD_NS = 33_000_000


def add(latency: Latency, *latencies_ms: float, taken_ms: float = 0.0, begin: int = 0) -> None:
    """Forecasts that were published one period after the other, so long after their evidence, and took so long."""
    for number, one in enumerate(latencies_ms):
        published = begin + number * PERIOD_NS
        latency.add(published - round(one * 1e6), published - round(taken_ms * 1e6), published)


def measured(*latencies_ms: float, taken_ms: float = 0.0) -> Latency:
    latency = Latency(ASSUMED_NS, is_measured=True)
    latency.start()
    add(latency, *latencies_ms, taken_ms=taken_ms)
    return latency


def bridged_ms(latency: Latency, passed_ms: float) -> float:
    return latency.bridged_ns(7, 7 + round(passed_ms * 1e6)) / 1e6


def test_what_has_passed_is_bridged_and_what_forecasts_take() -> None:
    """Of the sets of one machine some wait for others: each is forecast for the time that it is read at itself."""
    latency = measured(*[80.0] * 30, taken_ms=25.0)
    assert bridged_ms(latency, 40.0) == pytest.approx(65.0)
    assert bridged_ms(latency, 110.0) == pytest.approx(135.0)
    assert math.isnan(measured().percentile_ms(50))


def test_a_forecast_bridges_what_one_in_twenty_take_longer() -> None:
    latency = Latency(ASSUMED_NS, is_measured=True)
    latency.start()
    add(latency, *[40.0] * 95, taken_ms=20.0)
    add(latency, *[90.0] * 5, taken_ms=70.0, begin=95 * PERIOD_NS)
    assert bridged_ms(latency, 20.0) == pytest.approx(90.0)
    assert latency.percentile_ms(50) == pytest.approx(40.0)


def test_until_there_is_enough_what_was_assumed_is_bridged_at_least() -> None:
    few = measured(*[80.0] * (FEWEST - 1), taken_ms=70.0)
    assert bridged_ms(few, 10.0) == ASSUMED_NS / 1e6
    assert bridged_ms(few, 60.0) == 60.0


def test_what_came_before_the_start_does_not_count() -> None:
    latency = Latency(ASSUMED_NS, is_measured=True)
    add(latency, *[900.0] * 60, taken_ms=800.0)
    assert bridged_ms(latency, 10.0) == ASSUMED_NS / 1e6


def test_forecasts_that_come_too_late_for_any_arm_are_told_of() -> None:
    """Each was sound, and the status said so; the arm stood for good."""
    assert measured(*[390.0] * 60).warnings == ()
    assert measured(*[900.0] * 29).warnings == ()
    assert measured(*[40.0] * 31, *[5000.0] * 29).warnings == ()
    assert measured(*[900.0] * 60).warnings == (
        "latency: forecasts come 900 ms after their images' stamps, and an arm stands for what is older than 400 ms; "
        "set the cameras' clocks if they are behind, else choose a smaller size or image width, or a faster machine",
    )


def settled(gaps_ms: tuple[float, ...], drops: int = 1, late_ms: int = 50) -> Latency:
    """Forecasts so long after their images, for as long as it takes to count, and then such gaps among them."""
    latency = Latency(ASSUMED_NS, is_measured=True)
    latency.start()
    published = dropped = 0
    for gap_ms in (*[33.0] * (SETTLED_NS // PERIOD_NS + 2), *gaps_ms):
        published += round(gap_ms * 1e6)
        dropped += drops
        latency.add(published - late_ms * 1_000_000, published - 20_000_000, published, dropped)
    return latency


def test_an_arm_slows_and_stands_when_it_is_said_to() -> None:
    limiter = LimiterParameters()
    assert round(1e9 * (limiter.evidence_latency_s + limiter.deadline_s)) == SLOWS_NS
    assert round(1e9 * (limiter.evidence_latency_s + 2 * limiter.deadline_s)) == LONGEST_BRIDGED_NS


def test_forecasts_that_slow_an_arm_down_again_and_again_are_told_of() -> None:
    """An arm that was never to be fast again stood beside a twin that had nothing to say."""
    slow, quick = SLOWS_NS / 1e6 - 50 + 1, 33.0
    told = settled((slow, *[quick] * 40) * OFTEN)
    assert told.slowed == OFTEN
    assert told.warnings == (
        f"latency: {OFTEN} times in 10 s the next forecast took so long that an arm slowed down (300 ms after the "
        "images' stamps); choose a smaller size or image width, or free the processor",
    )
    assert settled((slow, *[quick] * 40) * (OFTEN - 1)).warnings == ()
    assert settled((slow - 2, *[quick] * 40) * 9).slowed == 0
    assert settled((slow, *[quick] * 40) * 9, drops=0).slowed == 0, "cameras that send nothing are not the twin's fault"
    assert settled((*[slow] * 9, *[quick] * 400)).slowed == 0, "it was long ago"
    assert settled((quick,) * 99, late_ms=280).slowed == 0, "images that come late are not either"
    assert settled((HELD_UP_NS / 1e6 + 1,) * 99, late_ms=280).slowed > OFTEN


def test_what_holds_the_first_sets_up_is_no_slowness() -> None:
    slow = [SLOWS_NS / 1e6] * 20
    latency = Latency(ASSUMED_NS, is_measured=True)
    latency.start()
    published = 0
    for number, gap_ms in enumerate(slow):
        published += round(gap_ms * 1e6)
        latency.add(published - 50_000_000, published, published, number)
    assert latency.slowed == 0
    told = settled(tuple(slow))
    assert told.slowed == len(slow)
    told.begin_anew()
    assert told.slowed == 0


def test_lockstep_measures_nothing() -> None:
    """Its results would depend on the computer."""
    latency = Latency(ASSUMED_NS, is_measured=False)
    latency.start()
    add(latency, *[900.0] * 60, taken_ms=800.0)
    assert bridged_ms(latency, 500.0) == ASSUMED_NS / 1e6


@pytest.mark.parametrize("period_ns", [PERIOD_NS, 200_000_000])
def test_what_was_long_ago_is_forgotten(period_ns: int) -> None:
    """On a slow machine, too: three slow sets of its start-up had all that moved foreseen twice as far for a minute."""
    latency = measured(*[900.0] * 50, taken_ms=800.0)
    for published in range(50 * PERIOD_NS, 50 * PERIOD_NS + MEMORY_NS + 50 * PERIOD_NS, period_ns):
        latency.add(published - 40_000_000, published - 20_000_000, published)
    assert bridged_ms(latency, 20.0) == pytest.approx(40.0)
    assert latency.percentile_ms(100) == pytest.approx(40.0)


def test_what_was_before_a_clock_was_set_back_is_forgotten() -> None:
    """It would never have been old enough again, and a percentile of all sets of an hour is slow."""
    latency = measured(*[80.0] * 60, taken_ms=70.0)
    add(latency, *[40.0] * FEWEST, taken_ms=20.0, begin=-3_600_000_000_000)
    assert bridged_ms(latency, 20.0) == pytest.approx(40.0)
    assert latency.percentile_ms(100) == pytest.approx(40.0)


def test_a_camera_clock_that_is_ahead_makes_no_forecast_of_the_past() -> None:
    """Images stamped later than they come: they cannot, but who reads the forecast does so no sooner than now."""
    latency = measured(*[-40.0] * 60, taken_ms=20.0)
    assert bridged_ms(latency, -60.0) == 0
    assert latency.percentile_ms(50) == -40.0


def test_one_set_that_was_held_up_moves_nothing_minutes_away() -> None:
    """Neither the one that was under way while a clock was set, nor those after a forecast that took long."""
    assert bridged_ms(measured(*[40.0] * 30, taken_ms=20.0), 3_600_000.0) == LONGEST_BRIDGED_NS / 1e6
    assert bridged_ms(measured(*[40.0] * 9, taken_ms=20.0), 3_600_000.0) == LONGEST_BRIDGED_NS / 1e6
    assert measured(*[40.0] * 29, 3_600_000.0).percentile_ms(100) == 3_600_000.0
    assert bridged_ms(measured(*[3_600_000.0] * 30, taken_ms=3_600_000.0), 20.0) == LONGEST_BRIDGED_NS / 1e6
