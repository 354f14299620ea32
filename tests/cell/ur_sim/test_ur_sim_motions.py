"""Motions of the stand-in: as fast as they were asked to be, slowed by the slider, and watched while they go on."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.arm import default_path
from twin_node.cell.ur_sim.controller import PERIOD_S, Controller, ControllerParameters
from twin_node.cell.ur_sim.motions import (
    SERVO_ACCELERATION,
    STOP_DECELERATION,
    FollowCycle,
    Hold,
    Motion,
    MoveJ,
    ServoJ,
    SpeedJ,
    Target,
)
from twin_node.cell.ur_sim.own_program import OwnProgram
from twin_node.cell.ur_sim.states import RuntimeState
from twin_node.robot import ur_model
from twin_node.scene import Float64


def speeds_of(motion: Motion, target: Target, seconds: float, scale: float = 1.0) -> Float64:
    """Joint velocities [T, 6] (rad/s) of a motion's targets, by their places."""
    places = [target.q]
    for _ in range(round(seconds / PERIOD_S)):
        target = motion.advance(target, PERIOD_S, scale)
        places.append(target.q)
    return np.diff(places, axis=0) / PERIOD_S


@pytest.mark.parametrize(("way", "speed"), [(1.0, 0.5), (0.1, 5.0)], ids=["cruises", "never at full speed"])
def test_a_move_keeps_to_its_speed_and_its_acceleration(way: float, speed: float) -> None:
    start, goal = np.zeros(6), way * np.array([1, -0.5, 0, 0.25, 0, 0.125])
    motion = MoveJ(start, goal, speed, acceleration=2.0)
    speeds = speeds_of(motion, Target(start, np.zeros(6)), motion.duration_s + PERIOD_S)
    assert motion.is_done
    np.testing.assert_allclose(speeds.sum(axis=0) * PERIOD_S, goal, atol=1e-9)
    assert np.abs(speeds).max() == pytest.approx(min(speed, np.sqrt(2.0 * way)), rel=0.02)
    assert np.abs(np.diff(speeds, axis=0)).max() <= 2.0 * PERIOD_S * 1.01


def test_speeds_are_slowed_by_the_slider_and_stops_are_not() -> None:
    wanted = np.array([0.4, -0.2, 0, 0, 0, 0.1])
    speeds = speeds_of(SpeedJ(wanted, acceleration=1.0), Target(np.zeros(6), np.zeros(6)), 1.0, scale=0.5)
    np.testing.assert_allclose(speeds[-1], 0.5 * wanted, atol=1e-9)
    stopped = speeds_of(Hold(), Target(np.zeros(6), wanted), 0.4 / STOP_DECELERATION + PERIOD_S, scale=0.1)
    assert not stopped[-1].any()


def test_a_stop_brakes_every_joint_at_its_deceleration_and_is_done_when_all_stand() -> None:
    wanted = np.array([0.4, -0.2, 0, 0, 0, 0.1])
    motion, target = Hold(deceleration=2.0), Target(np.zeros(6), wanted)
    dones = []
    for _ in range(110):
        target = motion.advance(target, PERIOD_S, scale=1.0)
        dones.append(motion.is_done)
        assert motion.is_done == target.is_standing
    assert dones.index(True) == pytest.approx(0.2 / PERIOD_S, abs=1)  # the fastest joint's; the others stand before
    np.testing.assert_allclose(target.q, np.sign(wanted) * wanted**2 / (2 * 2.0), atol=0.4 * PERIOD_S)


def test_moves_and_cycles_take_as_much_longer_as_the_slider_says() -> None:
    path = default_path(ur_model("ur5e"))
    start = Target(path.at(0), np.zeros(6))
    np.testing.assert_allclose(
        start.q + speeds_of(FollowCycle(path), start, 1.0, scale=0.5).sum(axis=0) * PERIOD_S,
        path.at(500_000_000),
        atol=1e-9,
    )
    move = MoveJ(np.zeros(6), np.ones(6), 0.5, acceleration=2.0)
    speeds = speeds_of(move, Target(np.zeros(6), np.zeros(6)), 1.9 * move.duration_s, scale=0.5)
    assert not move.is_done
    assert speeds.max() == pytest.approx(0.25, rel=0.02)


def test_a_servo_keeps_to_its_acceleration_and_stands_while_its_program_is_paused() -> None:
    """The slider does not slow it: paused, it would go on to its goal."""

    class Servoing:
        name = "servo"

        def tick(self, controller: Controller) -> None:
            controller.motion = ServoJ(start + 1.0, 0.1, controller.parameters.model.max_velocity)

    def run(seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            machine.tick()

    machine = Controller(ControllerParameters())
    start = machine.target.q
    assert machine.play(Servoing())
    machine.tick()
    assert np.abs(machine.target.qd).max() <= SERVO_ACCELERATION * PERIOD_S + 1e-9
    run(0.1)
    assert not machine.target.is_standing
    assert machine.pause("test")
    run(0.5)
    assert machine.runtime_state is RuntimeState.PAUSED
    place = machine.target.q
    assert machine.target.is_standing and np.abs(place - start - 1.0).max() > 0.3
    assert machine.play(Servoing())
    run(2.0)
    np.testing.assert_allclose(machine.target.q, start + 1.0, atol=1e-2)


def test_a_move_that_is_paused_stands_on_its_way_and_goes_on_along_it() -> None:
    """Stopped off its path, a program would go on with a jump."""
    machine = Controller(ControllerParameters())
    start = machine.target.q
    way = np.array([0.6, -0.3, 0.2, 0, 0.1, 0])

    class Moving:
        name = "move"

        def tick(self, controller: Controller) -> None:
            if machine.motion is not move:
                machine.motion = move

    move = MoveJ(start, start + way, 1.0, acceleration=2.0)
    assert machine.play(Moving())
    speeds = []
    for period in range(1200):
        if period == 150:
            assert machine.pause("test")
        if period == 400:
            assert machine.runtime_state is RuntimeState.PAUSED and machine.target.is_standing
            assert machine.play(Moving())
        machine.tick()
        done = (machine.target.q - start)[0] / way[0]
        np.testing.assert_allclose(machine.target.q, start + done * way, atol=1e-9)
        speeds.append(machine.target.qd[0])
    assert (machine.target.q - start)[0] > 0.1 and move.is_done
    assert np.abs(np.diff(speeds)).max() <= (2.0 + 5.0) * PERIOD_S * 1.05  # the move's own, and that of the slider


def test_a_program_that_goes_on_is_given_a_whole_period_of_its_watchdog() -> None:
    machine = Controller(ControllerParameters())
    variable = machine.parameters.watchdog.variable
    machine.inputs.write(variable, 1, machine.clock)
    machine.play(OwnProgram())
    for _ in range(500):
        machine.tick()
    assert machine.runtime_state is RuntimeState.PAUSED
    assert machine.play(OwnProgram())
    plays = []
    for _ in range(100):
        machine.tick()
        plays.append(machine.runtime_state is RuntimeState.PLAYING)
    assert sum(plays) * PERIOD_S == pytest.approx(0.1, abs=2 * PERIOD_S)
