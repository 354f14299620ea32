"""The controller without its sockets, on its own clock."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

from twin_node.cell.errors import CellError
from twin_node.cell.ur_sim import (
    Controller,
    ControllerParameters,
    StandIn,
    StandInParameters,
    TimedFault,
    Watchdog,
    WatchdogAction,
    free_loopback,
)
from twin_node.cell.ur_sim.control_script import Command, ControlScript
from twin_node.cell.ur_sim.controller import PERIOD_S
from twin_node.cell.ur_sim.dashboard import answer
from twin_node.cell.ur_sim.faults import Faults, switch
from twin_node.cell.ur_sim.motions import Target
from twin_node.cell.ur_sim.own_program import OwnProgram
from twin_node.cell.ur_sim.states import RuntimeState, SafetyMode
from twin_node.cell.ur_sim.status import from_line, status_of, to_line
from twin_node.robot import forward_kinematics

HEARTBEAT = "input_int_register_20"


def controller(action: WatchdogAction = WatchdogAction.PAUSE, hz: float = 10.0, delay_s: float = 0.1) -> Controller:
    return Controller(ControllerParameters(watchdog=Watchdog(HEARTBEAT, hz, action), unlock_delay_s=delay_s))


def run(machine: Controller, seconds: float, *, is_beating: bool = True) -> None:
    for _ in range(round(seconds / PERIOD_S)):
        if is_beating:
            machine.inputs.write(HEARTBEAT, 1, machine.clock)
        machine.tick()


def slide(machine: Controller, fraction: float) -> None:
    machine.inputs.write("speed_slider_mask", 1, machine.clock)
    machine.inputs.write("speed_slider_fraction", fraction, machine.clock)


def fastest(machine: Controller) -> float:
    return float(np.abs(machine.arm.qd).max())


def test_its_program_moves_the_arm_within_its_limits_along_the_cycle() -> None:
    machine = controller()
    assert machine.play(OwnProgram())
    speeds, errors = [], []
    for _ in range(800):
        run(machine, PERIOD_S)
        speeds.append(fastest(machine))
        errors.append(np.abs(machine.arm.q - machine.target.q).max())
    assert 0.3 < max(speeds) < 1.2
    assert max(errors) < 2e-3


def test_a_paused_heart_pauses_the_program_after_the_watchdogs_period_and_play_goes_on() -> None:
    machine = controller()
    machine.play(OwnProgram())
    run(machine, 0.6)
    assert fastest(machine) > 0.1
    silent_since = machine.clock
    run(machine, 0.4, is_beating=False)
    status = status_of(machine)
    paused = status.event("program paused: watchdog: no update of input_int_register_20")
    standing = status.event("standing: program paused")
    assert paused is not None
    assert standing is not None
    assert 0.1 - PERIOD_S <= paused.clock - silent_since + 1e-9 <= 0.1 + 2 * PERIOD_S
    assert paused.clock < standing.clock <= paused.clock + 0.25
    assert fastest(machine) < 0.01
    assert machine.runtime_state is RuntimeState.PAUSED
    place = machine.target.q
    assert machine.play(OwnProgram())
    run(machine, 0.4)
    assert fastest(machine) > 0.1
    assert np.abs(machine.target.q - place).max() < 0.5  # from where it stood


def test_a_program_that_plays_is_not_begun_anew() -> None:
    """A second 'play' stopped the arm within one period, and had the program's approach begin again."""
    machine = controller()
    side = SimpleNamespace(controller=machine, version=(5, 12, 0))
    machine.play(OwnProgram())
    run(machine, 0.6)
    program, speed = machine.program, fastest(machine)
    assert answer(side, "play") == "Failed to execute: play"
    run(machine, PERIOD_S)
    assert machine.program is program
    assert fastest(machine) == pytest.approx(speed, abs=0.05)


def test_a_watchdog_may_stop_or_ignore_instead() -> None:
    for action, state in ((WatchdogAction.STOP, RuntimeState.STOPPED), (WatchdogAction.IGNORE, RuntimeState.PLAYING)):
        machine = controller(action)
        machine.play(OwnProgram())
        run(machine, 0.5)
        run(machine, 0.5, is_beating=False)
        assert machine.runtime_state is state


def test_a_program_waits_for_the_first_heartbeat() -> None:
    machine = controller()
    machine.play(OwnProgram())
    run(machine, 0.4, is_beating=False)
    assert machine.runtime_state is RuntimeState.PLAYING
    assert fastest(machine) < 1e-6
    run(machine, 0.4)
    assert fastest(machine) > 0.1


def test_the_slider_stretches_the_cycles_time_and_stops_it_on_its_path() -> None:
    machine, other = controller(), controller()
    for each in (machine, other):
        each.play(OwnProgram())
        run(each, 0.5)
    slide(machine, 0.0)
    run(machine, 0.5)
    assert fastest(machine) < 0.01
    assert machine.scale == 0
    standing = machine.arm.q
    run(other, 0.2)
    slide(machine, 1.0)
    run(machine, 0.02)
    assert np.abs(machine.arm.q - standing).max() < 0.02
    slide(machine, 0.5)
    run(machine, 0.4)
    assert machine.scale == pytest.approx(0.5)
    assert (machine.outputs.target_speed_fraction, machine.outputs.speed_scaling) == (0.5, 1.0)


def test_a_protective_stop_pauses_and_is_unlocked_only_after_its_delay() -> None:
    machine = controller(delay_s=0.5)
    machine.play(OwnProgram())
    run(machine, 0.6)
    machine.protective_stop("test")
    run(machine, 0.2)
    assert fastest(machine) < 0.01
    assert (machine.outputs.safety_mode, machine.outputs.safety_status_bits) == (3, 1 << 2 | 1 << 10)
    assert not machine.play(OwnProgram())
    assert not machine.unlock()
    run(machine, 0.4)
    assert machine.unlock()
    run(machine, 0.2)
    assert machine.runtime_state is RuntimeState.PAUSED
    assert machine.play(OwnProgram())
    run(machine, 0.4)
    assert fastest(machine) > 0.1


def test_an_emergency_stop_ends_the_program_and_power_comes_back_in_order() -> None:
    machine = controller()
    machine.play(OwnProgram())
    run(machine, 0.6)
    machine.emergency_stop()
    run(machine, 0.2)
    assert machine.runtime_state is RuntimeState.STOPPED
    side = SimpleNamespace(controller=machine, version=(5, 12, 0))
    assert answer(side, "power on") == "Failed to execute: power on"
    machine.release_emergency_stop()
    assert answer(side, "brake release") == "Failed to execute: brake release"
    assert answer(side, "play") == "Failed to execute: play"
    assert [answer(side, order) for order in ("power on", "brake release", "play")] == [
        "Powering on",
        "Brake releasing",
        "Starting program",
    ]


def test_the_tool_is_told_in_base_half_a_turn_from_base_link() -> None:
    machine = controller()
    flange = forward_kinematics(machine.parameters.model, machine.arm.q)[-1]
    told = machine.outputs.actual_TCP_pose
    np.testing.assert_allclose(told[:3], [-flange[0, 3], -flange[1, 3], flange[2, 3]], atol=1e-9)
    machine.set_tcp(np.array([0, 0, 0.1, 0, 0, 0]))
    beyond = flange[:3, 3] + 0.1 * flange[:3, 2]
    np.testing.assert_allclose(machine.outputs.actual_TCP_pose[:3], [-beyond[0], -beyond[1], beyond[2]], atol=1e-9)


def command(machine: Controller, number: int, doubles: list[float] | None = None, asynchronous: int = 0) -> None:
    for register, value in enumerate(doubles or []):
        machine.inputs.write(f"input_double_register_{register}", value, machine.clock)
    machine.inputs.write("input_int_register_1", asynchronous, machine.clock)
    machine.inputs.write("input_int_register_0", number, machine.clock)
    machine.tick()


def test_the_control_script_moves_waits_and_answers_by_its_registers() -> None:
    machine = controller()
    machine.replace(ControlScript())
    machine.tick()
    assert machine.outputs.int_registers[0] == 1
    goal = machine.arm.q + np.array([0.2, 0, 0, 0, 0, 0])
    command(machine, Command.MOVEJ, [*goal, 1.0, 2.0])
    assert machine.outputs.int_registers[0] == 1
    run(machine, 1.0)
    assert machine.outputs.int_registers[0] == 2
    np.testing.assert_allclose(machine.arm.q, goal, atol=1e-4)
    command(machine, 0)
    assert machine.outputs.int_registers[0] == 1
    command(machine, Command.MOVEJ, [*(goal + 1.0), 0.5, 1.0], asynchronous=1)
    assert machine.outputs.int_registers[0] == 2
    run(machine, 0.4)
    assert machine.outputs.int_registers[2] & 1 << 15
    command(machine, 0)
    command(machine, Command.STOPJ, [2.0])
    run(machine, 0.6)
    assert fastest(machine) < 1e-3
    assert not machine.outputs.int_registers[2] & 1 << 15


def test_a_servo_goes_on_for_ever_unless_a_watchdog_was_set() -> None:
    machine = controller()
    machine.replace(ControlScript())
    machine.tick()
    goal = machine.arm.q + 0.3
    command(machine, Command.SERVOJ, [*goal, 0, 0, 0.002, 0.1, 300])
    run(machine, 2.0)
    assert machine.runtime_state is RuntimeState.PLAYING
    np.testing.assert_allclose(machine.arm.q, goal, atol=1e-3)
    command(machine, 0)
    command(machine, Command.SET_WATCHDOG, [10.0])
    run(machine, 0.3)
    assert machine.runtime_state is RuntimeState.STOPPED
    assert status_of(machine).event("program stopped: watchdog: no update of input_int_register_0") is not None


def test_commands_outside_the_stand_in_end_the_program_instead_of_pretending() -> None:
    machine = controller()
    machine.replace(ControlScript())
    machine.tick()
    command(machine, 46)
    assert machine.program is None
    assert status_of(machine).event("program stopped: ur_rtde command 46 is not part of the stand-in") is not None


@pytest.mark.parametrize(
    ("number", "first", "said"),
    [
        (Command.SET_WATCHDOG, 1000.0, "watchdog: expected 0 to 500 Hz, found 1000"),
        (Command.SET_WATCHDOG, np.nan, "input_double_register_0: expected a finite number, found nan"),
        (Command.SPEEDJ, np.inf, "input_double_register_0: expected a finite number, found inf"),
        (Command.GET_FORWARD_KINEMATICS_ARGS, 1e300, "joint values: expected finite angles of at most 1e+06 rad"),
    ],
)
def test_what_no_controller_can_do_ends_the_program_alone(number: Command, first: float, said: str) -> None:
    machine = controller()
    machine.replace(ControlScript())
    machine.tick()
    command(machine, number, [first])
    run(machine, 0.1)
    assert machine.runtime_state is RuntimeState.STOPPED
    assert np.isfinite(machine.arm.q).all()
    assert any(event.text.startswith(f"program stopped: {said}") for event in machine.events)


def test_a_speed_slider_that_is_no_number_ends_the_program_alone() -> None:
    machine = controller()
    machine.play(OwnProgram())
    run(machine, 0.6)
    slide(machine, np.nan)
    run(machine, 0.5)
    assert machine.runtime_state is RuntimeState.STOPPED
    assert fastest(machine) < 0.01
    assert (machine.slider, np.isfinite(machine.scale)) == (1.0, True)


class Dwell:
    """Rests for 20 ms of its own time, then turns all joints at 0.5 rad/s."""

    is_done = False
    can_be_slowed = True

    def __init__(self) -> None:
        self.time = 0.0

    def advance(self, target: Target, dt: float, scale: float) -> Target:
        self.time += dt * scale
        speed = 0.5 * scale if self.time > 0.02 else 0.0
        return Target(target.q + speed * dt, np.full(6, speed))


def test_a_program_that_is_paused_where_its_path_rests_stands_when_it_says_so() -> None:
    machine = controller()
    machine.play(OwnProgram())
    run(machine, 1.0)
    machine.motion = Dwell()
    run(machine, PERIOD_S)
    machine.pause("test")
    for _ in range(200):
        run(machine, PERIOD_S)
        if machine.runtime_state is RuntimeState.PAUSED:
            break
    place = machine.target.q
    assert machine.runtime_state is RuntimeState.PAUSED
    run(machine, 0.3)
    np.testing.assert_array_equal(machine.target.q, place)


def test_a_status_is_the_same_after_its_way_over_the_wire() -> None:
    machine = controller()
    machine.play(OwnProgram())
    run(machine, 0.2)
    status = status_of(machine)
    assert from_line(to_line(status)) == status
    assert status.q == tuple(machine.arm.q)


@pytest.mark.parametrize(
    ("order", "reply"),
    [
        ("PolyscopeVersion", "URSoftware 5.12.0.0 (twin_node stand-in)"),
        ("robotmode", "Robotmode: RUNNING"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("running", "Program running: false"),
        ("programState", "STOPPED twin_cell.urp"),
        ("pause", "Failed to execute: pause"),
        ("load other.urp", "File not found: other.urp"),
        ("load twin_cell.urp", "Loading program: twin_cell.urp"),
        ("dance", "could not understand: 'dance'"),
    ],
)
def test_the_dashboard_answers_as_the_real_one(order: str, reply: str) -> None:
    assert answer(SimpleNamespace(controller=controller(), version=(5, 12, 0)), order) == reply


class Recorder:
    """Something that faults are done to."""

    def __init__(self) -> None:
        self.faults = Faults()
        self.done: list[str] = []

    def __getattr__(self, name: str) -> object:
        return lambda *arguments: self.done.append(" ".join([name, *map(str, arguments)]))


def test_switches_set_what_they_say() -> None:
    target = Recorder()
    for line in ("freeze", "slow 10", "nan", "restart 2.5", "claim speed_slider_mask", "e-stop"):
        switch(target, line)
    assert target.faults == Faults(is_frozen=True, slowness=10.0, sends_nan=True)
    assert [item for item in target.done if not item.startswith(("note", "refresh"))] == [
        "restart 2.5",
        "claim speed_slider_mask",
        "press_emergency_stop",
    ]


@pytest.mark.parametrize("line", ["", "frieze", "slow", "slow fast", "slow 0", "slow nan", "freeze 3", "restart -1"])
def test_lines_that_are_no_switches_are_refused(line: str) -> None:
    with pytest.raises(CellError, match="fault"):
        switch(Recorder(), line)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.4", "example.org", ""])
def test_it_listens_to_this_computer_only(host: str) -> None:
    with pytest.raises(CellError, match="loopback"):
        StandInParameters(host=host)


@pytest.mark.parametrize(("variable", "hz"), [("input_int_register_99", 10.0), (HEARTBEAT, -1.0), (HEARTBEAT, 1e4)])
def test_watchdogs_that_no_program_can_set_are_refused(variable: str, hz: float) -> None:
    with pytest.raises(CellError, match="watchdog"):
        Watchdog(variable, hz)


def test_safety_modes_have_their_bits() -> None:
    assert [mode.status_bits for mode in SafetyMode] == [1, 0b10000000100, 0b10011000000]


def test_what_is_raised_in_a_period_ends_the_stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in = StandIn(StandInParameters(host=free_loopback(), admin_port=None))

    def fail() -> None:
        if stand_in.controller.clock > 0:
            raise RuntimeError("no more")
        stand_in.controller._periods += 1

    monkeypatch.setattr(stand_in.controller, "tick", fail)
    with pytest.raises(RuntimeError, match="no more"):
        asyncio.run(stand_in.run(lambda: None))


@pytest.mark.parametrize("line", ["slow abc", "slow 0", "restart -1", "claim nonsense", "release nonsense"])
def test_a_fault_of_the_start_is_read_at_once(line: str) -> None:
    """When its time comes there is nobody to tell: the stand-in went on without it, and a test of it passed."""
    with pytest.raises(CellError, match=line.partition(" ")[2]):
        TimedFault(line, 5.0)
