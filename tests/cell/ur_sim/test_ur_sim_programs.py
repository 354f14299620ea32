"""Which program the stand-in's controller goes on with, and which one takes another's place."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.cell.ur_sim import Controller, ControllerParameters, Watchdog, WatchdogAction
from twin_node.cell.ur_sim.control_script import ControlScript
from twin_node.cell.ur_sim.controller import PERIOD_S
from twin_node.cell.ur_sim.own_program import OwnProgram


def run(machine: Controller, seconds: float) -> None:
    for _ in range(round(seconds / PERIOD_S)):
        machine.tick()


@pytest.fixture
def playing() -> Controller:
    """Under way on its own program."""
    machine = Controller(ControllerParameters(watchdog=Watchdog(action=WatchdogAction.IGNORE)))
    assert machine.play(OwnProgram())
    run(machine, 0.6)
    return machine


def test_play_goes_on_with_the_program_that_is_paused(playing: Controller) -> None:
    program, motion = playing.program, playing.motion
    playing.pause("test")
    run(playing, 0.4)
    assert playing.play(OwnProgram())
    assert (playing.program, playing.motion) == (program, motion)


def test_play_begins_anew_after_a_stop(playing: Controller) -> None:
    program = playing.program
    playing.stop("test")
    run(playing, 0.2)
    assert playing.play(OwnProgram())
    assert playing.program is not program


def test_a_script_takes_the_place_of_the_program_that_plays(playing: Controller) -> None:
    script = ControlScript()
    assert playing.replace(script)
    assert playing.program is script
    run(playing, 0.2)
    assert np.abs(playing.arm.qd).max() < 0.01
    assert any(event.text == "program stopped: another program came" for event in playing.events)
