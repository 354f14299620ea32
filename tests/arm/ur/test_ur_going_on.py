"""How a halted driver goes on: acknowledged, or by itself where it may."""

from __future__ import annotations

import numpy as np
import pytest
from driver_bench import MS, Bench

from twin_node.arm import LimiterParameters
from twin_node.arm.ur import DriverState, Halt


def protectively_stopped(bench: Bench, milliseconds: int) -> None:
    """The arm is stopped for a while, and well again."""
    bench.run(320)
    bench.link.tell(safety_mode=3)
    bench.run(milliseconds)
    bench.link.tell(safety_mode=1)
    bench.run(40)


def test_an_acknowledged_arm_speeds_up_from_rest_whatever_was_decided_while_it_was_halted() -> None:
    bench = Bench(limiter=LimiterParameters(deadline_s=0.07))
    protectively_stopped(bench, 1500)  # forecasts would let it go all the while
    bench.acknowledge()
    told = bench.run(64)
    assert told.state is DriverState.READY
    assert told.speed_fraction is not None and told.speed_fraction < 0.1


def test_a_halt_of_an_earlier_connection_is_kept() -> None:
    bench = Bench(halt=Halt("driver process ended by signal 9"))
    assert bench.run(400).reason == "driver process ended by signal 9"
    assert bench.link.beats == []
    bench.acknowledge()
    assert bench.run(200).state is DriverState.READY


def test_a_driver_that_may_resume_waits_for_all_to_be_well_for_a_while() -> None:
    bench = Bench(resumes=True)
    bench.run(320)
    bench.is_alive = False
    bench.run(200)
    bench.is_alive = True
    assert bench.report.state is DriverState.HALTED
    assert 500 <= bench.ms_until(DriverState.READY) <= 560
    bench.is_fed = False
    assert (bench.run(300).state, bench.report.speed_fraction) == (DriverState.READY, 0.0)
    bench.is_fed = True
    assert bench.run(200).speed_fraction == 1.0


def test_a_driver_that_resumes_speeds_up_from_rest_whatever_was_decided_while_it_was_halted() -> None:
    bench = Bench(resumes=True, limiter=LimiterParameters(deadline_s=0.07))
    bench.run(1200)
    bench.is_alive = False
    bench.run(100)
    bench.is_alive = True
    before = len(bench.link.speeds)
    bench.ms_until(DriverState.READY)
    assert bench.report.reason == "stopped: no forecast yet"
    bench.run(64)
    assert max(bench.link.speeds[before:]) < 0.1


def test_a_driver_that_may_resume_waits_anew_after_each_time_that_something_was_wrong() -> None:
    bench = Bench(resumes=True)
    bench.run(320)
    for well_ms in (0, 300):
        bench.is_alive = True
        bench.run(well_ms)
        bench.is_alive = False
        bench.run(120)
    bench.is_alive = True
    assert bench.report.state is DriverState.HALTED
    assert bench.ms_until(DriverState.READY) >= 500


@pytest.mark.parametrize(
    ("mode", "name"),
    [(3, "PROTECTIVE_STOP"), (14, "TP_THREE_POSITION_ENABLING_STOP"), (20, "PROFISAFE_EMERGENCY_STOP"), (29, "29")],
)
def test_what_the_safety_system_stopped_never_resumes_by_itself(mode: int, name: str) -> None:
    """Nor where it was stopped in a mode that only newer controllers have."""
    bench = Bench(resumes=True)
    bench.run(320)
    bench.link.tell(safety_mode=mode)
    assert bench.run(200).reason.startswith(f"safety mode {name}: clear it")
    bench.link.tell(safety_mode=1)
    assert bench.run(2000).state is DriverState.HALTED


@pytest.mark.parametrize(("is_safety", "state"), [(False, DriverState.READY), (True, DriverState.HALTED)])
def test_an_earlier_halt_resumes_unless_it_was_a_safety_stop(is_safety: bool, state: DriverState) -> None:
    bench = Bench(halt=Halt("earlier", is_safety), resumes=True)
    assert bench.run(1000).state is state


@pytest.mark.parametrize("away_s", [4, 6])
def test_what_was_done_to_an_arm_that_nobody_saw_for_long_is_not_taken_for_nothing(away_s: int) -> None:
    """It may have hit somebody and been unlocked, and whoever paused its program may be beside it."""
    lost = Halt("connection lost", interrupts=True, seen=1000 * MS - away_s * 1_000_000_000)
    bench = Bench(halt=lost, resumes=True, plays=True)
    bench.link.tell(runtime_state=4)
    report = bench.run(1000)
    if away_s < 5:
        assert (report.state, bench.link.plays) == (DriverState.READY, 1)
        return
    assert (report.state, bench.link.plays) == (DriverState.HALTED, 0)
    assert report.reason.startswith("connection lost; the arm was not seen for 6 s")
    bench.acknowledge()
    report = bench.run(100)
    assert (report.state, bench.link.plays) == (DriverState.READY, 0)
    assert "press play" in report.reason


def test_an_arm_that_is_seen_again_is_not_unseen_for_as_long_as_its_halt_lasts() -> None:
    """Whoever resumes it later would find a stop of the safety system that there never was."""
    bench = Bench(halt=Halt("connection lost", seen=0))
    report = bench.run(8000)
    assert report.halt == Halt("connection lost")


@pytest.mark.parametrize("plays", [True, False])
def test_play_is_pressed_once_after_a_halt_where_that_is_wanted(plays: bool) -> None:
    bench = Bench(plays=plays)
    bench.run(320)
    bench.link.tell(safety_mode=3, runtime_state=4)
    bench.run(100)
    bench.link.tell(safety_mode=1)
    bench.run(100)
    assert bench.link.plays == 0
    bench.acknowledge()
    bench.run(400)
    assert bench.link.plays == int(plays)
    bench.link.tell(runtime_state=4)  # somebody pauses the program: that is not ours to end
    bench.run(400)
    assert bench.link.plays == int(plays)


def test_play_is_not_pressed_where_the_program_runs() -> None:
    bench = Bench(plays=True)
    protectively_stopped(bench, 100)
    bench.acknowledge()
    assert bench.link.plays == 0


@pytest.mark.parametrize("held_up_ms", [152, 40])
def test_play_is_pressed_where_the_drivers_own_lateness_has_paused_the_program(held_up_ms: int) -> None:
    """Nothing else is wrong then: no halt would ever end that play is pressed after."""
    bench = Bench(plays=True, resumes=True)
    bench.run(320)
    bench.now += held_up_ms * 1_000_000
    bench.run(12)
    bench.link.tell(runtime_state=4)
    bench.run(1000)
    assert bench.link.plays == (1 if held_up_ms > 100 else 0)


def test_a_driver_that_was_held_up_does_not_halt_for_it_while_the_program_runs() -> None:
    bench = Bench(plays=True, resumes=True)
    bench.run(320)
    bench.now += 152 * MS
    assert bench.run(12).state is DriverState.READY
    assert (bench.run(1000).state, bench.link.plays) == (DriverState.READY, 0)


@pytest.mark.parametrize("has_ended", [False, True])
def test_play_is_not_pressed_for_a_program_that_somebody_paused_before_the_halt(has_ended: bool) -> None:
    bench = Bench(plays=True, resumes=True)
    bench.run(320)
    if not has_ended:
        bench.link.tell(runtime_state=4)
        bench.run(200)
    bench.is_alive = False
    bench.run(100)
    bench.is_alive = True
    if has_ended:
        bench.link.tell(runtime_state=1)
        bench.run(100)
        bench.link.tell(runtime_state=4)  # of another one that was begun meanwhile
    report = bench.run(1500)
    assert (report.state, bench.link.plays) == (DriverState.READY, 0)
    assert "the robot's program is paused" in report.reason


def test_a_safety_stop_during_another_halt_does_not_resume_either() -> None:
    bench = Bench(resumes=True)
    bench.run(320)
    bench.is_alive = False
    bench.run(100)
    bench.is_alive = True
    bench.link.tell(safety_mode=3)
    assert "PROTECTIVE_STOP" in bench.run(100).reason
    bench.link.tell(safety_mode=1)
    assert bench.run(2000).state is DriverState.HALTED


def test_a_dashboard_that_refuses_to_play_keeps_the_halt_and_the_connection() -> None:
    bench = Bench(plays=True, resumes=True)
    bench.run(320)
    bench.link.is_remote = False
    bench.link.tell(runtime_state=4)
    bench.is_alive = False
    bench.run(100)
    bench.is_alive = True
    report = bench.run(1500)
    assert (report.state, report.is_over) == (DriverState.HALTED, False)
    assert report.reason == "the dashboard does not start the program"
    bench.link.is_remote = True
    assert bench.run(1000).state is DriverState.READY


def test_a_program_that_does_not_watch_the_heartbeat_is_told_of_at_the_first_halt() -> None:
    """The slider alone stopped it, and nobody knew until the day on which the slider did not reach it."""
    bench = Bench()
    bench.run(320)
    bench.is_fed = False
    halted = bench.run(1000).reason
    assert "heartbeat" not in halted
    told = bench.run(2000).reason
    assert told == f"{halted}; and the robot's program plays on without the heartbeat: let it call rtde_set_watchdog"
    bench.link.tell(runtime_state=4)
    assert bench.run(100).reason == halted


def test_a_program_that_waits_for_the_first_heartbeat_watches_it() -> None:
    bench = Bench(halt=Halt("connection lost"))
    assert bench.run(4000).reason == "connection lost"


def test_a_paused_program_that_the_driver_has_not_seen_run_begins_at_rest() -> None:
    """A driver's successor knows no velocity of it: the slider was at full speed beside whoever pressed play."""
    bench = Bench(halt=Halt("connection lost"), limiter=LimiterParameters(deadline_s=0.07))
    standing = np.zeros(6)
    bench.link.tell(runtime_state=4, qd=standing, target_qd=standing)
    bench.run(100)
    bench.acknowledge()
    report = bench.run(1000)
    assert (report.state, report.speed_fraction) == (DriverState.READY, 0.0)
    assert report.reason.endswith("this driver has not seen how it goes on; press play")
    assert len(bench.link.beats) > 100
    assert max(bench.link.speeds) == 0.0
    bench.link.tell(runtime_state=2)
    told = bench.run(100)
    assert told.reason == "clear; speeding up"
    assert told.speed_fraction is not None and 0 < told.speed_fraction < 0.15


def test_a_paused_program_goes_on_from_rest_however_long_it_was_let_go() -> None:
    bench = Bench(limiter=LimiterParameters(deadline_s=0.07))
    assert bench.run(1200).speed_fraction == 1.0
    bench.link.tell(runtime_state=4)
    report = bench.run(200)
    assert (report.state, report.speed_fraction, bench.link.state.speed_slider) == (DriverState.READY, 0.0, 0.0)
    assert report.reason == "stopped: the robot's program is paused; press play"
    bench.link.tell(runtime_state=2)
    going = bench.run(40)
    assert going.speed_fraction is not None and 0 < going.speed_fraction < 0.1
    assert bench.run(1200).reason == "clear"


def test_a_connection_that_was_cut_without_a_word_is_given_up() -> None:
    """What the driver writes does not arrive, what it reads does: the watchdog pauses the program, and no more."""
    bench = Bench()
    bench.run(320)
    bench.link.is_obedient = False
    bench.link.tell(runtime_state=4)
    assert bench.ms_until(DriverState.HALTED) <= 250
    assert not bench.report.is_over
    report = bench.run(2100)
    assert report.is_over
    assert "set to 0% reads 100% for 2 s: what is written does not arrive" in report.reason


def test_a_paused_program_whose_forecasts_stop_halts_for_that() -> None:
    bench = Bench(halt=Halt("connection lost"))
    bench.link.tell(runtime_state=4, target_qd=np.zeros(6))
    bench.run(100)
    bench.acknowledge()
    bench.run(200)
    bench.is_fed = False
    assert bench.run(200).reason.startswith("stopped: no forecast for")
