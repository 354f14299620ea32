"""The driver's loop, with a controller and a clock that the test holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from driver_bench import CLEAR, MS, STEP_MS, Bench
from fake_link import START, sample

from twin_node.arm.errors import ArmError
from twin_node.arm.ur import Decide, DriverMode, DriverState, Halt, UrParameters
from twin_node.runtime.parameters import fill


def test_the_arm_stands_until_the_first_forecast_and_then_goes() -> None:
    bench = Bench()
    bench.is_fed = False
    report = bench.run(500)
    assert (report.state, report.speed_fraction) == (DriverState.READY, 0.0)
    assert report.reason == "stopped: no forecast yet"
    assert set(bench.link.speeds) == {0.0}
    bench.is_fed = True
    assert bench.run(200).speed_fraction == 1.0
    assert bench.link.speeds[-1] == 1.0


def test_the_heart_beats_with_rising_counts_every_period() -> None:
    bench = Bench()
    bench.run(400)
    assert bench.link.beats == list(range(1, 101))


def test_a_decision_reaches_the_slider_in_the_same_step() -> None:
    bench = Bench()
    bench.run(320)
    bench.is_fed = False
    bench.driver.order(Decide(replace(CLEAR, evidence_stamp=bench.now, speed_fraction=0.25)), bench.now)
    bench.run(STEP_MS)
    assert bench.link.speeds[-1] == 0.25


def test_a_stop_reaches_the_slider_in_the_same_step_however_slow_the_arm_is() -> None:
    bench = Bench()
    bench.fraction = 0.004
    bench.run(640)
    assert bench.link.speeds[-1] == 0.004
    bench.is_fed = False
    bench.driver.order(Decide(replace(CLEAR, evidence_stamp=bench.now, speed_fraction=0.0)), bench.now)
    bench.run(STEP_MS)
    assert bench.link.speeds[-1] == 0.0


def test_a_slider_that_is_not_to_move_is_set_ten_times_a_second_all_the_same() -> None:
    """Nobody else's setting stays, and the controller is not flooded."""
    bench = Bench()
    bench.run(400)
    before = len(bench.link.speeds)
    bench.run(1000)
    assert 9 <= len(bench.link.speeds) - before <= 11
    bench.fraction = 0.998  # less than a package is worth
    bench.run(64)
    assert len(bench.link.speeds) - before <= 11


def test_missing_forecasts_slow_within_one_deadline_and_stop_within_two() -> None:
    bench = Bench()
    bench.run(312)  # up to a decision
    bench.is_fed = False
    assert bench.run(64).speed_fraction == 1.0
    slow = bench.run(12)
    assert (slow.state, slow.speed_fraction) == (DriverState.READY, 0.2)
    assert bench.ms_until(DriverState.HALTED) <= 150 - 76
    assert bench.report.reason.startswith("stopped: no forecast for 14")
    assert bench.link.speeds[-1] == 0.0


def test_forecasts_of_old_evidence_are_no_forecasts() -> None:
    bench = Bench()
    bench.run(320)
    bench.is_fed = False
    old = replace(CLEAR, evidence_stamp=bench.now - 30 * MS)
    for _ in range(20):
        bench.driver.order(Decide(old), bench.now)
        bench.run(20)
    assert bench.report.state is DriverState.HALTED
    assert "no forecast" in bench.report.reason


FAULTS = [
    ({"q": np.full(6, np.nan)}, "not finite"),
    ({"q": np.zeros(5)}, "5 joint angles"),
    ({"target_q": np.full(6, 1e9)}, "beyond its range"),
    ({"target_qd": np.full(6, -1e308)}, "beyond its rating"),
    ({"safety_mode": 3}, "PROTECTIVE_STOP"),
    ({"robot_mode": 3}, "POWER_OFF"),
    ({"robot_mode": 99}, "no such modes"),
]


@pytest.mark.parametrize(("changes", "word"), FAULTS)
def test_what_is_wrong_halts_at_once_and_stays_so_until_acknowledged(changes: dict[str, object], word: str) -> None:
    bench = Bench()
    bench.run(320)
    well = bench.link.state
    bench.link.tell(**changes)
    assert bench.ms_until(DriverState.HALTED) <= 12  # one package and one step
    assert word in bench.report.reason
    assert bench.report.speed_fraction == 0.0
    assert bench.link.speeds[-1] == 0.0
    beats = len(bench.link.beats)
    bench.run(400)
    with pytest.raises(ArmError, match="acknowledge: expected an arm that is well"):
        bench.acknowledge()
    bench.link.tell(q=well.q, target_q=well.target_q, target_qd=well.target_qd, robot_mode=7, safety_mode=1)
    bench.run(400)
    assert bench.report.state is DriverState.HALTED
    assert word in bench.report.reason
    assert len(bench.link.beats) == beats
    bench.acknowledge()
    assert bench.run(200).state is DriverState.READY
    assert bench.report.speed_fraction == 1.0
    assert len(bench.link.beats) > beats


def test_an_arm_that_jumped_is_halted_and_believed_where_it_stays() -> None:
    bench = Bench()
    bench.run(320)
    bench.link.tell(q=START + 1.0)
    assert bench.ms_until(DriverState.HALTED) <= 12
    assert "jumped by 1.00 rad" in bench.report.reason
    bench.run(100)
    bench.acknowledge()
    assert bench.run(200).state is DriverState.READY


def test_a_silent_controller_halts_within_its_time_and_is_given_up_after_more() -> None:
    bench = Bench()
    bench.run(320)
    bench.is_alive = False
    assert bench.ms_until(DriverState.HALTED) <= 60
    assert bench.report.reason.startswith("controller silent for 5")
    assert not bench.report.is_over
    assert bench.run(1100).is_over


def test_a_controller_whose_clock_goes_back_was_restarted() -> None:
    bench = Bench()
    bench.run(320)
    bench.is_alive = False
    bench.link.tell(clock_s=0.008)
    assert bench.run(STEP_MS).is_over
    assert "restarted" in bench.report.reason


def test_a_lost_link_halts_and_is_over() -> None:
    bench = Bench()
    bench.run(320)
    bench.link.is_lost = True
    assert bench.run(STEP_MS).is_over
    assert (bench.report.state, bench.report.reason) == (DriverState.HALTED, "connection lost")


def test_a_slider_that_somebody_else_holds_halts() -> None:
    bench = Bench()
    bench.run(320)
    bench.link.is_obedient = False
    bench.fraction = 0.3
    assert bench.ms_until(DriverState.HALTED) <= 300
    assert bench.report.reason == "speed slider set to 30% reads 100%: somebody else moves it"


def test_a_slider_that_is_held_above_what_it_was_set_to_is_set_back_every_20_ms() -> None:
    bench = Bench()
    bench.fraction = 0.3
    bench.run(320)
    bench.link.is_obedient = False
    bench.link.tell(speed_slider=1.0)
    bench.run(20)
    before = len(bench.link.speeds)
    assert bench.run(60).state is DriverState.READY
    assert bench.link.speeds[before:] == [0.3] * 3


def test_a_slider_that_is_late_now_and_then_is_obedient() -> None:
    """Times of lateness do not add up to that of a slider which somebody else holds."""
    bench = Bench()
    bench.run(320)
    for _ in range(3):
        bench.link.is_obedient = False
        bench.link.tell(speed_slider=1.0)
        bench.fraction = 0.3
        bench.run(120)
        bench.link.is_obedient = True
        bench.link.tell(speed_slider=0.3)
        assert bench.run(200).state is DriverState.READY
        bench.fraction = 1.0
        bench.run(200)


def test_a_slider_that_somebody_drags_is_set_back_at_once_and_halts() -> None:
    """It was set back ten times a second, and obeyed for a moment each time: the arm went on all the while."""
    bench = Bench()
    bench.fraction = 0.0
    bench.run(400)
    bench.link.tell(speed_slider=0.6)
    bench.run(STEP_MS)
    assert bench.link.state.speed_slider == 0.0
    dragged = 0
    while bench.report.state is DriverState.READY and dragged < 40:
        dragged += 1
        for _ in range(6):  # the pendant's 24 ms outlast what is set meanwhile
            bench.link.tell(speed_slider=0.6)
            bench.run(STEP_MS)
        bench.run(40)
    assert dragged <= 10
    assert bench.report.reason == "speed slider set to 0% reads 60%: somebody else moves it"


@pytest.mark.parametrize("is_lost", [False, True])
def test_a_driver_that_ends_lets_the_arm_stand_as_the_last_thing(is_lost: bool) -> None:
    bench = Bench()
    bench.run(320)
    bench.link.is_lost = is_lost
    assert not bench.driver.stop("the driver ends")
    assert bench.link.speeds[-1] == 0.0
    beats = len(bench.link.beats)
    report = bench.run(40)
    assert (report.state, report.reason) == (DriverState.HALTED, "connection lost" if is_lost else "the driver ends")
    assert len(bench.link.beats) == beats


def test_a_report_holds_what_the_controller_said_and_the_halt_that_a_next_connection_is_to_keep() -> None:
    bench = Bench()
    report = bench.run(320)
    assert report.sample == bench.link.state
    assert bench.now - 8 * MS < report.sample_stamp <= bench.now
    assert report.halt is None
    bench.link.tell(safety_mode=3)
    report = bench.run(40)
    assert report.halt == Halt(report.reason, is_safety=True, interrupts=True)


def test_read_only_writes_nothing_and_tells_what_it_sees() -> None:
    bench = Bench(mode=DriverMode.READ_ONLY)
    report = bench.run(320)
    assert (report.state, report.reason, report.speed_fraction) == (DriverState.READY, "read only", None)
    link = bench.link
    assert (link.speeds, link.beats, link.servoed, link.preparations, link.plays) == ([], [], [], 0, 0)
    bench.link.tell(safety_mode=3)
    assert bench.run(40).state is DriverState.HALTED
    bench.link.tell(safety_mode=1)
    assert bench.run(40).state is DriverState.READY


def test_the_future_of_a_slowed_program_is_that_of_its_full_speed() -> None:
    bench = Bench()
    bench.run(100)
    bench.fraction = 0.2
    future = bench.run(40).future  # told to be slow, still fast: not five times as fast
    assert future is not None
    np.testing.assert_allclose(future.positions[-1, 0] - future.positions[0, 0], 0.1, atol=1e-12)
    bench.link.tell(target_qd=sample().target_qd * 0.2)
    future = bench.run(400).future
    assert future is not None
    np.testing.assert_allclose(future.positions[-1] - future.positions[0], [0.1, 0, 0, 0, 0, 0], atol=1e-12)
    bench.fraction = 0.0
    bench.run(40)
    bench.link.tell(target_qd=np.zeros(6))
    still = bench.run(800).future
    assert still is not None
    np.testing.assert_allclose(still.positions[-1] - still.positions[0], [0.1, 0, 0, 0, 0, 0], atol=1e-12)
    bench.link.tell(runtime_state=1)
    stopped = bench.run(40).future
    assert stopped is not None
    np.testing.assert_allclose(stopped.positions[-1], stopped.positions[0])


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"robot": "two words"}, "address or host name"),
        ({"heartbeat_register": 24}, "18 to 22"),
        ({"receive_hz": 1000.0}, "receive_hz: expected 1 to 500, found 1000"),
        ({"period_s": 0.2}, "half the watchdog's period"),
        ({"period_s": 0.03}, "half of stale_s, 0.025 s, found 0.03"),
        ({"watchdog_hz": 0.0}, "watchdog_hz: expected 1 to 500, found 0"),
        ({"watchdog_hz": 0.001, "period_s": 100.0}, "watchdog_hz: expected 1 to 500, found 0.001"),
        ({"stale_s": 0.01}, "more than two packages"),
        ({"stale_s": 50.0, "lost_s": 1000.0}, "stale_s: expected more than 0 and at most 1, found 50"),
        ({"lost_s": np.inf}, "lost_s: expected more than 0 and at most 10, found inf"),
        ({"lookahead_s": 0.02}, "lookahead_s: expected 0.03 to 0.2, found 0.02"),
        ({"lookahead_s": 0.3}, "lookahead_s: expected 0.03 to 0.2, found 0.3"),
        ({"lookahead_s": np.nan}, "lookahead_s: expected 0.03 to 0.2, found nan"),
        ({"realtime_priority": 100}, "0 to 99"),
    ],
)
def test_parameters_that_no_controller_accepts_are_refused(changes: dict[str, object], word: str) -> None:
    with pytest.raises(ArmError, match=word):
        UrParameters(**changes)


def test_an_arm_node_that_has_no_forecast_yet_halts_nobody() -> None:
    """It says so until its first obstacles; who was driven by forecasts before halts for want of them."""
    bench = Bench()
    bench.is_fed = False
    nothing = replace(CLEAR, speed_fraction=0.0, reason="stopped: no forecast yet")
    for _ in range(20):
        bench.driver.order(Decide(nothing), bench.now)
        report = bench.run(48)
    assert (report.state, report.speed_fraction, report.reason) == (DriverState.READY, 0.0, "stopped: no forecast yet")
    bench.is_fed = True
    assert bench.run(200).speed_fraction == 1.0
    bench.is_fed = False
    bench.driver.order(Decide(nothing), bench.now)
    assert bench.run(STEP_MS).speed_fraction == 0.0
    for _ in range(4):
        bench.driver.order(Decide(nothing), bench.now)
        report = bench.run(48)
    assert (report.state, report.reason) == (DriverState.HALTED, "stopped: no forecast yet")


def test_a_parameter_file_that_changes_the_limiters_ramp_leaves_the_drivers_deadline_alone() -> None:
    assert fill(UrParameters, {"limiter": {"rise_per_s": 0.5}}, "ur_driver").limiter.deadline_s == 0.07


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"runtime_state": 1}, "no program runs on the robot; press play"),
        ({"speed_slider": 0.0}, "the speed slider stays at 0%"),
    ],
)
def test_an_arm_that_may_go_and_stands_says_why(changes: dict[str, object], why: str) -> None:
    bench = Bench()
    assert bench.run(320).reason == "clear"
    bench.link.is_obedient = False
    bench.link.tell(**changes)
    report = bench.run(1200)
    assert (report.state, report.speed_fraction) == (DriverState.READY, 1.0)
    assert report.reason == f"clear; but {why}"
    bench.link.is_obedient = True
    bench.link.tell(runtime_state=2)
    assert bench.run(200).reason == "clear"


def test_the_future_begins_where_the_arm_has_gone_to_since_it_was_heard_of() -> None:
    bench = Bench()
    bench.run(400)
    bench.is_alive = False
    future = bench.run(40).future
    assert future is not None
    assert future.stamps[0] == bench.now
    np.testing.assert_allclose(future.positions[0, 0] - START[0], 0.5 * 0.040, atol=1e-12)
