"""The driver that servoes an arm along a path, and what it does with decisions that cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from driver_bench import CLEAR, MS, STEP_MS, Bench, servo_bench, steps_of
from fake_link import MODEL, START, FakeLink, quintic

from twin_node.arm.errors import ArmError
from twin_node.arm.ur import (
    Decide,
    DriverMode,
    DriverState,
    Follow,
    Halt,
    LeavePath,
    UrDriver,
    UrParameters,
)
from twin_node.robot import RobotError, ur_model
from twin_node.scene import JointPath


def test_servo_follows_a_trajectory_to_its_end_and_holds_it() -> None:
    bench = servo_bench()
    bench.run(2600)
    np.testing.assert_allclose(bench.link.servoed[-1], quintic().positions[-1])
    assert bench.link.preparations == 1
    assert bench.link.speeds == []


def test_servo_brakes_on_its_path_when_forecasts_stop_then_leaves_the_script_to_its_watchdog() -> None:
    bench = servo_bench()
    bench.run(1000)
    bench.is_fed = False
    bench.run(1500)
    assert bench.report.state is DriverState.HALTED
    last, sent = bench.link.servoed[-1], len(bench.link.servoed)
    assert quintic().positions[0, 0] < last[0] < quintic().positions[-1, 0]
    bench.run(400)
    assert len(bench.link.servoed) == sent
    with pytest.raises(ArmError, match="while halted"):
        bench.driver.order(Follow(quintic(), bench.now), bench.now)
    bench.is_fed = True
    bench.acknowledge()
    assert bench.link.preparations == 2
    bench.run(400)
    np.testing.assert_allclose(bench.link.servoed[-1], last)


def test_a_halted_arm_of_which_nothing_is_heard_is_sent_nowhere() -> None:
    bench = servo_bench()
    bench.run(1000)
    bench.is_alive = False
    bench.ms_until(DriverState.HALTED)
    sent = len(bench.link.servoed)
    bench.run(200)
    assert len(bench.link.servoed) == sent


def test_servo_commands_to_a_script_that_has_stopped_are_not_believed() -> None:
    bench = servo_bench()
    bench.run(400)
    bench.link.runs_script = False
    assert bench.ms_until(DriverState.HALTED) <= 8
    assert bench.report.reason == "the control script does not run: it refused a command"


def test_a_control_script_that_has_stopped_is_seen_before_the_arm_lags() -> None:
    bench = servo_bench()
    bench.run(400)
    bench.link.tell(runtime_state=1)
    assert bench.ms_until(DriverState.HALTED) <= 12
    assert bench.report.reason == "the control script has stopped"


def test_the_control_script_is_begun_where_nothing_is_wrong_and_after_each_halt() -> None:
    assert Bench().link.preparations == 0
    assert Bench(mode=DriverMode.SERVO).link.preparations == 1
    bench = Bench(halt=Halt("driver process ended by signal 9"), mode=DriverMode.SERVO)
    bench.run(200)
    assert (bench.link.preparations, bench.link.servoed) == (0, [])
    bench.acknowledge()
    assert bench.run(200).state is DriverState.READY
    assert bench.link.preparations == 1


@pytest.mark.parametrize(
    ("state", "reason"),
    [({"safety_mode": 7}, "safety mode ROBOT_EMERGENCY_STOP: clear it"), ({}, "control script: it does not start")],
)
def test_an_arm_that_cannot_be_servoed_yet_is_halted_and_told_of(state: dict[str, object], reason: str) -> None:
    link = FakeLink(script_starts=False)
    link.tell(**state)
    driver = UrDriver(UrParameters(mode=DriverMode.SERVO), link, 1000 * MS)
    report = driver.step(1004 * MS)
    assert (report.state, report.reason.startswith(reason)) == (DriverState.HALTED, True)
    assert report.sample is not None and not report.is_over
    assert link.servoed == []


def test_an_arm_that_does_not_follow_is_halted() -> None:
    bench = servo_bench()
    bench.run(400)
    bench.link.servo = lambda q: True  # taken, and nothing happens
    bench.run(1000)
    assert bench.report.state is DriverState.HALTED
    assert "from where it was sent" in bench.report.reason


@pytest.mark.parametrize(("model", "lookahead_s"), [("ur3e", 0.1), ("ur5e", 0.2)])
def test_an_arm_that_is_as_far_behind_as_its_look_ahead_has_it_is_not_halted(model: str, lookahead_s: float) -> None:
    """A UR3e's wrists turn at 6.28 rad/s and lag by 0.6 rad, more than any arm was let be behind."""
    bench = Bench(mode=DriverMode.SERVO, model=model, lookahead_s=lookahead_s)
    bench.link.lookahead_s = lookahead_s
    bench.run(200)
    way, rating = 3.0, ur_model(model).max_velocity[5]
    s = np.linspace(0, 1, 201)[:, None]
    turning = START + s**3 * (10 - 15 * s + 6 * s**2) * np.array([0, 0, 0, 0, 0, way])
    seconds = 1.875 * way / rating
    stamps = (s[:, 0] * seconds * 1e9).astype(np.int64)
    bench.driver.order(Follow(JointPath(MODEL.joint_names, stamps, turning), bench.now), bench.now)
    behind = []
    for _ in range(0, round(1000 * seconds) + 500, STEP_MS):
        assert bench.run(STEP_MS).state is DriverState.READY
        behind.append(bench.link.servoed[-1][5] - bench.link.state.q[5])
    assert max(behind) > 0.5
    np.testing.assert_allclose(bench.link.state.q, turning[-1], atol=0.05)


def test_joints_are_called_as_others_know_them() -> None:
    names = tuple(f"left_{name}" for name in MODEL.joint_names)
    bench = Bench(mode=DriverMode.SERVO, joints=names)
    bench.run(200)
    with pytest.raises(RobotError, match="expected left_shoulder_pan_joint, "):
        bench.driver.order(Follow(quintic(), bench.now), bench.now)
    bench.driver.order(Follow(replace(quintic(), names=names), bench.now), bench.now)
    future = bench.run(400).future
    assert future is not None and future.names == names
    assert bench.link.servoed[-1][0] > START[0]


def test_trajectories_are_refused_in_other_modes_and_while_one_is_followed() -> None:
    with pytest.raises(ArmError, match="expected servo mode"):
        Bench().driver.order(Follow(quintic(), 0), 0)
    bench = servo_bench()
    bench.run(100)
    with pytest.raises(ArmError, match="another is followed"):
        bench.driver.order(Follow(quintic(), bench.now), bench.now)


def test_a_path_that_has_waited_for_a_driver_that_hung_is_refused() -> None:
    """It was followed whenever the driver went on, with nobody beside the arm who still expected that."""
    bench = Bench(mode=DriverMode.SERVO)
    bench.run(200)
    with pytest.raises(ArmError, match=r"trajectory: refused, it has waited 0\.30 s"):
        bench.driver.order(Follow(quintic(), bench.now - 300 * MS), bench.now)
    bench.run(200)
    np.testing.assert_allclose(bench.link.servoed[-1], START)
    bench.driver.order(Follow(quintic(), bench.now - 100 * MS), bench.now)
    bench.run(400)
    assert bench.link.servoed[-1][0] > START[0]


def test_a_path_that_is_left_is_braked_on_as_by_a_decision_and_the_arm_holds_where_that_ends() -> None:
    left, slowed = servo_bench(), servo_bench()
    for bench in (left, slowed):
        bench.run(1000)
    left.driver.order(LeavePath(), left.now)
    slowed.driver.order(Decide(replace(CLEAR, evidence_stamp=slowed.now, speed_fraction=0.0)), slowed.now)
    slowed.fraction = 0.0
    with pytest.raises(ArmError, match="being left; send it once the arm stands"):
        left.driver.order(Follow(quintic(), left.now), left.now)
    for bench in (left, slowed):
        bench.run(1000)
    np.testing.assert_array_equal(left.link.servoed, slowed.link.servoed)
    assert START[0] + 0.1 < left.link.servoed[-1][0] < quintic().positions[-1, 0] - 0.1
    assert (left.report.state, left.report.speed_fraction) == (DriverState.READY, 1.0)
    future = left.report.future
    assert future is not None
    held = np.broadcast_to(left.link.servoed[-1], future.positions.shape)
    np.testing.assert_allclose(future.positions, held, atol=1e-4)


def test_another_path_is_taken_once_the_one_that_was_left_has_been_braked_on() -> None:
    bench = servo_bench()
    bench.run(1000)
    bench.driver.order(LeavePath(), bench.now)
    bench.run(1000)
    onwards = quintic(bench.link.servoed[-1], way=-0.3)
    bench.driver.order(Follow(onwards, bench.now), bench.now)
    bench.run(2600)
    np.testing.assert_allclose(bench.link.servoed[-1], onwards.positions[-1])
    assert bench.link.preparations == 1


def test_a_path_along_which_nobody_lets_the_arm_go_is_left_at_once() -> None:
    bench = Bench(mode=DriverMode.SERVO)
    bench.fraction = 0.0
    bench.run(200)
    bench.driver.order(Follow(quintic(), bench.now), bench.now)
    bench.run(200)
    bench.driver.order(LeavePath(), bench.now)
    bench.driver.order(Follow(quintic(way=-0.3), bench.now), bench.now)
    bench.fraction = 1.0
    bench.run(2600)
    np.testing.assert_allclose(bench.link.servoed[-1], quintic(way=-0.3).positions[-1])


def test_forecasts_that_stop_halt_an_arm_that_leaves_its_path() -> None:
    bench = servo_bench()
    bench.run(1000)
    bench.is_fed = False
    bench.driver.order(LeavePath(), bench.now)
    assert bench.run(500).state is DriverState.HALTED
    bench.driver.order(LeavePath(), bench.now)  # said again: it stands
    bench.is_fed = True
    bench.acknowledge()
    assert bench.run(200).state is DriverState.READY
    assert steps_of(bench)[-20:].max() == 0


def test_to_leave_a_path_is_refused_where_the_driver_follows_none_and_does_nothing_without_one() -> None:
    with pytest.raises(ArmError, match="expected servo mode, found slider mode"):
        Bench().driver.order(LeavePath(), 0)
    bench = Bench(mode=DriverMode.SERVO)
    bench.run(200)
    bench.driver.order(LeavePath(), bench.now)
    assert bench.run(200).state is DriverState.READY


@pytest.mark.parametrize("mode", [DriverMode.SLIDER, DriverMode.SERVO])
@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"speed_fraction": np.nan}, "expected a speed fraction of 0 to 1, found nan"),
        ({"speed_fraction": 2.0}, "expected a speed fraction of 0 to 1, found 2"),
        ({"speed_fraction": -0.5}, "expected a speed fraction of 0 to 1, found -0.5"),
        ({"evidence_stamp": 5_000_000_000}, "evidence lies [23][.0-9]* s in the future"),
    ],
)
def test_decisions_that_cannot_be_halt_at_once_and_leave_the_path_alone(
    mode: DriverMode, changes: dict[str, object], word: str
) -> None:
    bench = servo_bench() if mode is DriverMode.SERVO else Bench()
    bench.run(1000)
    decision = replace(CLEAR, **{"evidence_stamp": bench.now, **changes})
    with pytest.raises(ArmError, match=word):
        bench.driver.order(Decide(decision), bench.now)
    report = bench.run(STEP_MS)
    assert (report.state, report.speed_fraction, report.is_over) == (DriverState.HALTED, 0.0, False)
    bench.run(1500)
    assert bench.report.state is DriverState.HALTED
    if mode is DriverMode.SERVO:
        assert steps_of(bench).max() < 0.01
    bench.acknowledge()
    assert bench.run(200).state is DriverState.READY


def test_an_arm_whose_driver_was_held_up_is_not_sent_all_the_missed_way_at_once() -> None:
    bench = servo_bench()
    bench.run(1000)
    usual = steps_of(bench).max()
    bench.now += 88 * MS  # within the script's watchdog
    bench.run(400)
    assert steps_of(bench).max() <= 3.2 * usual  # three periods' way, and the path still gains speed


def halted_at_speed(**changes: object) -> Bench:
    """A servoed arm at 2.9 rad/s whose driver has just been halted, all being well otherwise."""
    bench = Bench(mode=DriverMode.SERVO, **changes)
    bench.run(200)
    bench.driver.order(Follow(quintic(way=5.5, seconds=3.5), bench.now), bench.now)
    bench.run(1900)
    with pytest.raises(ArmError, match="found nan"):
        bench.driver.order(Decide(replace(CLEAR, evidence_stamp=bench.now, speed_fraction=np.nan)), bench.now)
    bench.run(STEP_MS)
    return bench


def hardest_braking(bench: Bench) -> float:
    """Largest acceleration of the first joint that was commanded, rad/s^2."""
    velocities = np.diff(np.array(bench.link.servoed)[:, 0]) / (STEP_MS * 1e-3)
    return float(np.abs(np.diff(velocities)).max() / (STEP_MS * 1e-3))


def test_an_arm_that_still_brakes_is_not_stopped_dead_by_an_acknowledgement() -> None:
    """To hold it where it was just then took 740 rad/s^2."""
    bench = halted_at_speed()
    for _ in range(25):
        with pytest.raises(ArmError, match="expected an arm that stands, found one that still brakes"):
            bench.acknowledge()
        bench.run(STEP_MS)
    bench.run(900)
    assert bench.report.state is DriverState.HALTED
    bench.acknowledge()
    assert bench.run(200).state is DriverState.READY
    assert hardest_braking(bench) < 4 * MODEL.max_acceleration[0]


def test_a_driver_that_ends_brakes_its_arm_on_the_path_first() -> None:
    """It left the arm to servoJ's last angles, and that stopped it at five times its acceleration."""
    bench = Bench(mode=DriverMode.SERVO)
    bench.run(200)
    bench.driver.order(Follow(quintic(way=5.5, seconds=3.5), bench.now), bench.now)
    bench.run(1900)
    assert bench.driver.stop("the driver ends")
    passed = 0
    while bench.driver.is_braking and passed < 2000:
        bench.run(STEP_MS)
        passed += STEP_MS
    assert 500 < passed < 1500
    assert hardest_braking(bench) < 4 * MODEL.max_acceleration[0]
    assert bench.report.reason == "the driver ends"


def test_a_driver_whose_arm_stands_ends_at_once() -> None:
    bench = servo_bench()
    bench.run(2600)
    bench.driver.stop("the driver ends")
    bench.run(24)
    assert not bench.driver.is_braking
    assert not Bench().driver.stop("the driver ends")


def test_a_driver_that_resumes_waits_for_the_arm_to_stand() -> None:
    bench = halted_at_speed(resumes=True)
    assert bench.ms_until(DriverState.READY) > 600  # it settles in 500, and brakes from 2.9 rad/s in 580
    bench.run(200)
    assert hardest_braking(bench) < 4 * MODEL.max_acceleration[0]
