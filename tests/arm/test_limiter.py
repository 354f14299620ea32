"""The limiter: down at once, up slowly, slow within one deadline of silence and standing within two."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from obstacle_sets import MS, NOW

from twin_node.arm import ArmError, LimiterParameters, SpeedLimiter
from twin_node.scene import NO_EVIDENCE, Separation

FREE = Separation(NOW, NOW, 1.0, 0.3, 0.0, 0.05, 0.05, 0.2, 0.0, "wrist_1_link", 3, 1.0, "clear of MOVING")


def decision(fraction: float, at_ms: int) -> Separation:
    return replace(FREE, stamp=NOW + at_ms * MS, evidence_stamp=NOW + at_ms * MS, speed_fraction=fraction)


def at_full_speed() -> SpeedLimiter:
    """A limiter that was told to go for three seconds, the last time at `NOW`."""
    limiter = SpeedLimiter()
    for at_ms in range(-3000, 1, 50):
        limiter.decide(decision(1.0, at_ms), NOW + at_ms * MS)
    return limiter


def test_the_arm_stands_until_the_first_forecast() -> None:
    limiter = SpeedLimiter()
    assert limiter.tick(NOW).speed_fraction == 0.0
    assert limiter.tick(NOW + 5_000 * MS).reason == "stopped: no forecast yet"
    assert limiter.silence_s(NOW) == math.inf
    assert limiter.decide(decision(1.0, 5_000), NOW + 5_000 * MS).speed_fraction == 0.0


def test_what_the_arm_is_told_has_the_time_at_which_it_is_told() -> None:
    told = at_full_speed().tick(NOW + 50 * MS)
    assert (told.stamp, told.evidence_stamp) == (NOW + 50 * MS, NOW)


@pytest.mark.parametrize("share", [math.nan, -0.1, 1.01, math.inf])
def test_what_is_no_share_of_the_speed_is_told_to_no_arm(share: float) -> None:
    """NaN was passed on, and the next decision at its full limit at once."""
    limiter = at_full_speed()
    with pytest.raises(ArmError, match="speed fraction of 0 to 1"):
        limiter.decide(decision(share, 10), NOW + 10 * MS)
    assert limiter.tick(NOW + 50 * MS).speed_fraction == 1.0
    assert limiter.tick(NOW + 300 * MS).speed_fraction == 0.0


def test_an_arm_that_was_stopped_rises_from_rest() -> None:
    limiter = at_full_speed()
    limiter.stand()
    assert limiter.tick(NOW + 30 * MS).speed_fraction == pytest.approx(0.03 * LimiterParameters().rise_per_s)


def test_down_at_once_and_up_slowly() -> None:
    limiter = at_full_speed()
    assert limiter.tick(NOW).speed_fraction == 1.0
    down = limiter.decide(decision(0.1, 30), NOW + 30 * MS)
    assert (down.speed_fraction, down.obstacle_id, down.reason) == (0.1, 3, "clear of MOVING")
    up = limiter.decide(decision(1.0, 60), NOW + 60 * MS)
    assert up.speed_fraction == pytest.approx(0.1 + LimiterParameters().rise_per_s * 0.03)
    assert up.reason == "clear of MOVING; speeding up"
    later = [limiter.decide(decision(1.0, at_ms), NOW + at_ms * MS) for at_ms in range(90, 900, 30)]
    assert (later[-1].speed_fraction, later[-1].reason) == (1.0, "clear of MOVING")


def test_the_arm_is_at_full_speed_again_after_three_quarters_of_a_second() -> None:
    limiter = SpeedLimiter()
    told = [limiter.decide(decision(1.0, at_ms), NOW + at_ms * MS).speed_fraction for at_ms in range(0, 770, 10)]
    assert told[74] < 1.0 == told[76]


def test_silence_slows_within_one_deadline_and_stops_within_two() -> None:
    limiter = at_full_speed()
    assert limiter.tick(NOW + 99 * MS).speed_fraction == 1.0
    slow = limiter.tick(NOW + 100 * MS)
    assert slow.speed_fraction == LimiterParameters().slow_fraction
    assert slow.reason == "slow: no forecast for 100 ms"
    stopped = limiter.tick(NOW + 200 * MS)
    assert stopped.speed_fraction == 0.0
    assert stopped.reason == "stopped: no forecast for 200 ms"
    assert limiter.tick(NOW + 9_000 * MS).speed_fraction == 0.0
    again = limiter.decide(decision(1.0, 9_010), NOW + 9_010 * MS)
    assert 0 < again.speed_fraction <= LimiterParameters().rise_per_s * 0.01 + 1e-9


def test_old_evidence_is_silence_however_often_it_is_sent() -> None:
    limiter = at_full_speed()
    for at_ms in range(33, 600, 33):
        told = limiter.decide(replace(decision(1.0, at_ms), evidence_stamp=NOW), NOW + at_ms * MS)
        if at_ms >= 400:
            assert told.speed_fraction == 0.0
        elif at_ms >= 300:
            assert told.speed_fraction <= 0.2
        else:
            assert told.speed_fraction == 1.0


@pytest.mark.parametrize(
    ("age_ms", "word"), [(320, "slow: no forecast that is young"), (540, "stopped: no forecast that is young")]
)
def test_forecasts_that_come_and_are_old_are_not_said_to_be_missing(age_ms: int, word: str) -> None:
    """Of a driver whose clock was half a second ahead the twin was sought, which had never been silent."""
    limiter = at_full_speed()
    told = limiter.decide(replace(decision(1.0, 600), evidence_stamp=NOW + (600 - age_ms) * MS), NOW + 600 * MS)
    assert told.reason.startswith(word)
    assert f"are of {age_ms} ms before" in told.reason
    assert f"are of {age_ms} ms before" in limiter.tick(NOW + 1500 * MS).reason, "not now this, now that of slow ones"
    assert "no forecast for" in limiter.tick(NOW + 1600 * MS).reason


def test_a_decision_without_a_stamp_of_its_evidence_stops_the_arm_and_says_why() -> None:
    """The arm stood, and was said to be clear of whoever moved."""
    told = at_full_speed().decide(replace(decision(1.0, 10), evidence_stamp=NO_EVIDENCE), NOW + 10 * MS)
    assert (told.speed_fraction, told.reason) == (0.0, "stopped: nobody knows how old the evidence is; stamp it")
    waiting = replace(decision(0.0, 10), evidence_stamp=NO_EVIDENCE, reason="stopped: no forecast yet")
    assert at_full_speed().decide(waiting, NOW + 10 * MS).reason == "stopped: no forecast yet"


def test_a_clock_that_is_put_back_does_not_make_a_forecast_last() -> None:
    limiter = at_full_speed()
    limiter.tick(NOW - 1_000 * MS)
    assert limiter.tick(NOW - 901 * MS).speed_fraction == 1.0
    assert limiter.tick(NOW - 900 * MS).speed_fraction == LimiterParameters().slow_fraction
    assert limiter.tick(NOW - 800 * MS).speed_fraction == 0.0


def test_a_clock_that_is_put_back_does_not_make_the_arm_faster() -> None:
    limiter = at_full_speed()
    limiter.decide(decision(0.1, 10), NOW + 10 * MS)
    assert limiter.decide(decision(1.0, -1000), NOW - 1000 * MS).speed_fraction == pytest.approx(0.1)


def test_a_stop_stays_a_stop_when_the_forecast_is_late() -> None:
    limiter = at_full_speed()
    limiter.decide(replace(decision(0.0, 10), reason="stopped for MOVING"), NOW + 10 * MS)
    late = limiter.tick(NOW + 150 * MS)
    assert (late.speed_fraction, late.reason) == (0.0, "stopped for MOVING")


@given(steps=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 300)), min_size=1, max_size=30))
def test_never_above_the_decision_and_never_rising_too_fast(steps: list[tuple[float, int]]) -> None:
    limiter, now_ms, before = SpeedLimiter(), 0, 0.0
    for fraction, wait_ms in steps:
        now_ms += wait_ms
        told = limiter.decide(decision(fraction, now_ms), NOW + now_ms * MS).speed_fraction
        assert 0 <= told <= fraction
        assert told <= before + 1e-3 * limiter.parameters.rise_per_s * wait_ms + 1e-9
        before = told


@pytest.mark.parametrize(("silence_ms", "told"), [(99, 1.0), (110, 0.2), (1000, 0.0)])
def test_a_silence_that_nobody_asked_through_slows_and_stops_as_any_other(silence_ms: int, told: float) -> None:
    """In lockstep no alarm rings: after a second without forecasts the first one let the arm go at full speed."""
    limiter = at_full_speed()
    first = limiter.decide(decision(1.0, silence_ms), NOW + silence_ms * MS)
    assert first.speed_fraction == told
    then = limiter.decide(decision(1.0, silence_ms + 30), NOW + (silence_ms + 30) * MS)
    assert then.speed_fraction == pytest.approx(min(told + 0.03 * LimiterParameters().rise_per_s, 1.0))


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"deadline_s": 0.0}, "deadline_s: expected more than 0 and at most 10, found 0"),
        ({"deadline_s": math.nan}, "deadline_s: expected more than 0 and at most 10, found nan"),
        ({"deadline_s": 100.0}, "deadline_s: expected more than 0 and at most 10, found 100"),
        ({"evidence_latency_s": -0.1}, "evidence_latency_s: expected 0 to 10, found -0.1"),
        ({"evidence_latency_s": math.nan}, "evidence_latency_s: expected 0 to 10, found nan"),
        ({"slow_fraction": 20.0}, "slow_fraction: expected 0 to 1, found 20"),
        ({"rise_per_s": 0.0}, "rise_per_s: expected a number above 0, found 0"),
        ({"rise_per_s": math.inf}, "rise_per_s: expected a number above 0, found inf"),
    ],
)
def test_parameters_that_let_nothing_stop_or_nothing_go_are_refused(changes: dict[str, float], word: str) -> None:
    with pytest.raises(ArmError, match=word):
        LimiterParameters(**changes)
